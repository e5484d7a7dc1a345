"""The tables of recorded drives and of planted faults: what a run's tables say."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest

from studies.diagnosis import broken
from studies.raw_drives import table


def written(run: Path, accel: list[float], outcomes: list[str]) -> Path:
    folder = run / "drive-1a2b"
    folder.mkdir()
    (folder / "log.json").write_text(json.dumps({"log": "drive"}), encoding="utf-8")
    who = {"log": "drive", "planner": "idm", "mode": "closed"}
    frames = [
        {**who, "t_s": 0.1 * k, "metric": "lon_accel", "value": value}
        for k, value in enumerate(accel)
    ]
    pd.DataFrame(frames).to_parquet(folder / "frames.parquet")
    values = {"goal.final": 1.0, "lon_accel.min": min(accel), "ttc.min": 2.0}
    pd.DataFrame(
        [{**who, "metric": name, "value": value} for name, value in values.items()]
    ).to_parquet(run / "metrics.parquet")
    pd.DataFrame([{**who, "outcome": one} for one in outcomes]).to_parquet(run / "verdicts.parquet")
    return run


@pytest.mark.parametrize(
    ("outcomes", "verdict"),
    [
        (["pass", "not asked"], "pass"),
        (["pass", "inconclusive"], "inconclusive"),
        (["inconclusive", "fail"], "fail"),
    ],
)
def test_a_row_says_what_the_tables_say(tmp_path: Path, outcomes: list[str], verdict: str) -> None:
    rows = table(written(tmp_path, [0.0, -4.0, -3.6, -1.0, 0.0], outcomes))
    assert rows.loc[("drive", "idm"), "verdict"] == verdict
    assert rows.loc[("drive", "idm"), "hardest"] == -4.0
    assert rows.loc[("drive", "idm"), "hard, s"] == pytest.approx(0.2)
    assert pd.isna(rows.loc[("drive", "idm"), "gap to people"])


def run(**outcomes: tuple[str, str]) -> Any:
    """The verdicts of two gates by log."""
    rows = [
        (log, gate, said)
        for log, two in outcomes.items()
        for gate, said in zip("ab", two, strict=True)
    ]
    return SimpleNamespace(verdicts=pd.DataFrame(rows, columns=["log", "gate", "outcome"]))


def test_a_drive_fails_for_a_fault_if_it_passes_without_it() -> None:
    faulty = run(
        mended=("fail", "pass"),
        fails=("fail", "fail"),
        unsure=("fail", "pass"),
        well=("pass", "pass"),
        otherwise=("fail", "pass"),
    )
    sound = run(
        mended=("pass", "inconclusive"),
        fails=("pass", "fail"),
        unsure=("inconclusive", "pass"),
        well=("pass", "pass"),
        otherwise=("pass", "fail"),
    )
    assert broken(faulty, sound) == ["mended"]
