"""Recorded roads in windows: folds by recording, starts that are moved, and what a drive costs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from handmade import drive, lanes_along, scenario, straight, track, tracks
from hypothesis import given, settings, strategies as st

from replan.logs.mcap import write_scenario
from replan.logs.scenario import Scenario
from studies import roads
from studies.roads import SHOWN, VARIANTS, changes, interval, main, tasks, worse


def recording(name: str, seconds: float) -> Scenario:
    """Straight on at 8 m/s, and a car that stands beside the road."""
    ego = drive(straight, 8.0, seconds)
    parked = tracks(track("1", [0.0], [60.0], [6.0], static=True))
    return replace(
        scenario(ego, agents=parked, road=lanes_along(ego)), name=name, tags=("recorded", "ngsim")
    )


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Two recordings, and one that is not of a known kind."""
    (tmp_path / "data").mkdir()
    for name, seconds in (("a", 14.0), ("b", 6.0)):
        write_scenario(tmp_path / "data" / f"{name}.mcap", recording(name, seconds))
    write_scenario(tmp_path / "data" / "other.mcap", replace(recording("other", 8.0), tags=()))
    return tmp_path / "data"


def test_no_recording_is_in_two_folds(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(roads, "SCENES", 0)
    found = tasks([data], tmp_path / "out")
    assert len({task.path for task in found if task.recording == "a"}) == 3, "from 0, 2 and 4 s on"
    assert {task.recording for task in found} == {"a", "b"}
    for name in ("a", "b"):
        assert len({task.fold for task in found if task.recording == name}) == 1
    for path in {task.path for task in found}:
        mine = [task.variant for task in found if task.path == path]
        assert mine[:2] == ["as recorded", "mirrored"] and len(mine) == 3
    assert tasks([data], tmp_path / "out") == found  # from the windows that are there


@given(st.sampled_from(sorted(VARIANTS)))
@settings(max_examples=7)
def test_a_variant_changes_the_start_and_leaves_the_end_of_the_drive(name: str) -> None:
    log = recording("a", 10.0)
    made = VARIANTS[name](log)
    first, last = made.ego.state(0), made.ego.state(len(made.ego) - 1)
    changed = {
        "faster": (0.0, 8.8),
        "slower": (0.0, 7.2),
        "aside": (0.3, 8.0),
        "other side": (-0.3, 8.0),
    }
    assert (first.y - log.ego.y[0], first.v) == pytest.approx(changed.get(name, (0.0, 8.0)))
    assert (last.x, last.y, last.v) == pytest.approx((log.ego.x[-1], log.ego.y[-1], 8.0))


def rows(costs: list[float], planner: str) -> pd.DataFrame:
    n = len(costs)
    same = dict.fromkeys(SHOWN, costs)
    of = {
        "log": [f"{k}" for k in range(n)],
        "recording": [f"{k // 2}" for k in range(n)],
        "fold": [k % 5 for k in range(n)],
    }
    return pd.DataFrame(
        {**of, "variant": "as recorded", "kind": "city", "planner": planner, **same}
    )


@given(st.lists(st.floats(0.0, 100.0), min_size=1, max_size=20))
@settings(max_examples=20)
def test_an_interval_holds_the_mean_and_no_change_is_none(costs: list[float]) -> None:
    mine = rows(costs, "a")
    mean, low, high = (
        float(word.strip("()")) for word in interval(mine, "cost").replace("to ", "").split()
    )
    slack = 0.06 * (1.0 + max(costs))
    assert (
        min(costs) - slack <= low <= high <= max(costs) + slack
        and low - slack <= mean <= high + slack
    )
    same = changes(mine, mine)
    assert set(same["cost"]) == {"0 (0 to 0)"} and same["drives"].iloc[0] == len(costs)


@given(st.lists(st.tuples(st.floats(0.0, 9.0), st.floats(0.0, 9.0)), min_size=1, max_size=20))
@settings(max_examples=20)
def test_the_worse_drives_are_those_that_another_planner_drives_better(
    pairs: list[tuple[float, float]],
) -> None:
    both = pd.concat([rows([a for a, _ in pairs], "mine"), rows([b for _, b in pairs], "other")])
    found = worse(both, "mine")
    assert sorted(found["log"]) == sorted(str(k) for k, (a, b) in enumerate(pairs) if a > b)
    assert (np.diff(found["more"]) <= 0.0).all()


@pytest.mark.slow
def test_the_recorded_driver_makes_its_own_way_and_a_parked_one_does_not(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(roads, "SCENES", 0)
    out = tmp_path / "out"
    main([str(data), "-o", str(out), "-p", "parked", "logged", "--workers", "1"])
    human, parked = (pd.read_csv(out / f"{name}.csv") for name in ("logged", "parked"))
    assert (human["progress"] > 0.95).all() and (human["cost"] < 1.0).all()
    assert (
        (parked["progress"] < 0.6).all()
        and (parked["delay_s"] > 3.0).all()
        and (parked["stands_s"] > 2.0).all()
    )
    assert "| logged |" in capsys.readouterr().out
    main(
        [
            str(data),
            "-o",
            str(out),
            "-p",
            "logged",
            "--workers",
            "1",
            "--against",
            str(out / "logged.csv"),
        ]
    )
    assert "0 (0 to 0)" in capsys.readouterr().out
