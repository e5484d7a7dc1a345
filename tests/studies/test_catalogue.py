"""The picture of a suite: what a cell is called, and that every cell is in the table, the page and
the picture.
"""

import json
from pathlib import Path

import pandas as pd
import pytest

from replan.logs.catalogue import suite
from replan.results.schema import SCHEMA_VERSION
from studies.catalogue import OUTCOMES, main, table_of

AT_FAULT, CONTACT, IMPACT = (
    "collision_at_fault.count",
    "replay_contact.final",
    "collision_severity.impact_speed.max",
)
MEETS = {"reference_cc.applies": 1.0, "reference_cc.avoids": 0.0}
AVOIDS = {"reference_cc.applies": 1.0, "reference_cc.avoids": 1.0}


def results(
    folder: Path, logs: dict[str, tuple[dict[str, float], float | None, str | None]]
) -> Path:
    """A result folder: per log the planner's values, the careful driver's impact, and the gate that
    failed.
    """
    folder.mkdir()
    rows = [
        (log, "dp_qp", "closed", name, value)
        for log, (own, _, _) in logs.items()
        for name, value in own.items()
    ]
    rows += [
        (log, "careful", "reference", IMPACT, v) for log, (_, v, _) in logs.items() if v is not None
    ]
    pd.DataFrame(rows, columns=["log", "planner", "mode", "metric", "value"]).to_parquet(
        folder / "metrics.parquet"
    )
    gates = [
        (gate or "x", log, "dp_qp", "fail" if gate else "pass")
        for log, (_, _, gate) in logs.items()
    ]
    verdicts = pd.DataFrame(gates, columns=["gate", "log", "planner", "outcome"])
    verdicts.to_parquet(folder / "verdicts.parquet")
    drives = {
        log: [{"log": log, "planner": "dp_qp", "end": "x", "detail": "", "t_end_s": 1.0}]
        for log in logs
    }
    found = [
        {"log": log, "drives": drives[log] if own else []} for log, (own, _, _) in logs.items()
    ]
    summary = {"schema_version": SCHEMA_VERSION, "logs": found}
    (folder / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    ("own", "careful", "gate", "said"),
    [
        ({}, None, None, "not evaluated"),
        (AVOIDS, None, None, "pass"),
        (AVOIDS, None, "ttc", "fails a gate"),
        (MEETS, 3.0, None, "better"),
        (MEETS | {AT_FAULT: 1.0, IMPACT: 3.9}, 3.0, "x", "unavoidable"),
        (MEETS | {AT_FAULT: 1.0, IMPACT: 4.1}, 3.0, "x", "contact"),
        (AVOIDS | {AT_FAULT: 1.0, IMPACT: 1.0}, None, "x", "contact"),
        ({"reference_cc.applies": 0.0, AT_FAULT: 1.0}, None, "x", "contact"),
        (MEETS | {CONTACT: 1.0}, 3.0, None, "run into"),
    ],
)
def test_a_cell(
    own: dict[str, float], careful: float | None, gate: str | None, said: str, tmp_path: Path
) -> None:
    table = table_of(results(tmp_path / "r", {"paper/free_road": (own, careful, gate)}), "dp_qp")
    assert list(table["outcome"]) == [said] and said in OUTCOMES


@pytest.mark.slow
def test_every_cell_is_drawn_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = (*suite("smoke"), *suite("unece_r157/cut_in")[:50])
    kinds = [AVOIDS, MEETS, AVOIDS | {AT_FAULT: 1.0}]
    made = results(
        tmp_path / "r", {name: (kinds[k % 3], None, None) for k, name in enumerate(names)}
    )
    assert main(["-o", str(tmp_path / "out"), "--results", str(made), "--suite", "smoke"]) == 0
    table = pd.read_csv(tmp_path / "out" / "catalogue.csv")
    assert list(table["log"]) == list(names)
    assert capsys.readouterr().out.splitlines()[-1].split()[:3] == [
        "all",
        "70",
        str(len(names[::3])),
    ]
    page = (tmp_path / "out" / "catalogue.md").read_text(encoding="utf-8")
    failed = table[table["outcome"] == "contact"]
    assert f"## {len(failed)} cells not passed" in page and all(
        log in page for log in failed["log"]
    )
    assert (tmp_path / "out" / "catalogue.png").stat().st_size > 20_000


def test_a_folder_without_results_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["-o", str(tmp_path / "out"), "--results", str(tmp_path)])
    assert "no results of replan evaluate" in capsys.readouterr().err


@pytest.mark.slow
def test_smoke_runs(tmp_path: Path) -> None:
    assert main(["-o", str(tmp_path), "--suite", "smoke", "--workers", "0"]) == 0
    table = pd.read_csv(tmp_path / "catalogue.csv")
    assert list(table["log"]) == list(suite("smoke")) and set(table["outcome"]) <= {
        "pass",
        "better",
    }
