"""The table of planners over CommonRoad scenarios: what is counted, of which drives, and whose goal
is within reach.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st
from short_logs import short

from replan.logs.mcap import write_scenario
from replan.logs.road import Goal
from replan.logs.scenario import Scenario
from replan.metrics.judge import CAREFUL
from replan.replay.loop.reference_drives import reference_table
from studies.commonroad import COLUMNS, HAND_MADE, SOURCES, compare, main, source_of

FILES = ("C-DEU_MONAWest-2_720_T-799", "ZAM_Tutorial-1_1_T-1", "USA_US101-6_1_T-1")


@given(st.lists(st.sampled_from([*SOURCES, "recorded", "highway"])))
def test_every_scenario_has_one_source(tags: list[str]) -> None:
    name = source_of(tags)
    assert (name == HAND_MADE) is not any(tag in SOURCES for tag in tags)
    assert name in {*SOURCES.values(), HAND_MADE}


def careful_reaches(scenario: Scenario) -> float:
    rows = reference_table(scenario).set_index(["planner", "metric"])
    return float(rows.loc[(CAREFUL, "goal.final"), "value"])


def test_the_careful_driver_enters_a_goal_ahead_in_its_time_and_at_its_speed_only() -> None:
    free = short("ahead")
    assert free.goal is not None
    assert careful_reaches(free) == 1.0
    aside = tuple(region + np.array([0.0, 30.0]) for region in free.goal.regions)
    assert careful_reaches(replace(free, goal=Goal(aside))) == 0.0
    assert careful_reaches(replace(free, goal=replace(free.goal, v=(0.0, 3.0)))) == 0.0
    late = replace(free.goal, t=(1.9, 2.0))
    assert careful_reaches(replace(free, goal=late)) == 1.0
    # No vehicle does
    assert np.isnan(careful_reaches(replace(free, goal=replace(late, t=(0.1, 0.5)))))


def test_drives_and_failures_are_counted_by_source(tmp_path: Path) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    for name, tags in (("a", ("mona",)), ("b", ("mona", "recorded")), ("c", ())):
        write_scenario(
            logs / f"{name}.mcap", replace(short(name, v=6.0 + ord(name) % 5), tags=tags)
        )
    (logs / "d.mcap").write_bytes(b"no log")
    said: list[str] = []
    table = compare(
        [logs], tmp_path / "out", planners=("constant_speed",), traffic=("time",), say=said.append
    )
    rows = table.set_index(["source", "planner"])
    assert set(rows.index) == {
        (s, p) for s in ("MONA", HAND_MADE, "all") for p in ("constant_speed", "logged")
    }
    assert list(
        rows.loc[("MONA", "logged"), ["logs", "goal", "reachable", "goal_of_reachable"]]
    ) == [2, 2, 2, 2]
    counted = rows[["logs", "reachable", "goal_of_reachable"]]
    assert (counted.diff(axis=1).iloc[:, 1:] <= 0).all(axis=None)
    judged = rows.xs("constant_speed", level="planner")
    assert (judged["passed"] + judged["failed"] + judged["inconclusive"] == judged["logs"]).all()
    assert list(rows.loc[("all", "constant_speed"), ["logs", "not_evaluated"]]) == [3, 1]
    assert rows.loc[("MONA", "constant_speed"), "not_evaluated"] == 0
    assert (
        rows["at_fault"] == rows["avoidable"] + rows["unavoidable"] + rows["not_applicable"]
    ).all()
    assert len(said) == 1 and "d.mcap" in said[0]


@pytest.mark.slow
def test_three_files_of_three_sources(
    shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [str(shared_data / "commonroad" / f"{name}.xml") for name in FILES]
    words = [*files, "-o", str(tmp_path / "out"), "-p", "constant_speed", "--workers", "0"]
    assert main(words) == 0
    page = capsys.readouterr().out
    table = pd.read_csv(tmp_path / "out" / "commonroad.csv")
    assert list(table.columns) == ["traffic", "source", "planner", *COLUMNS]
    assert set(table["traffic"]) == {"give_way", "time", "reactive"}
    for traffic, rows in table.groupby("traffic"):
        assert set(rows["source"]) == {"MONA", "NGSIM", HAND_MADE, "all"}, traffic
        whole = rows[rows["source"] == "all"].set_index("planner")
        parts = rows[rows["source"] != "all"].groupby("planner")
        for name in (
            "logs",
            "goal",
            "reachable",
            "goal_of_reachable",
            "collisions",
            "at_fault",
            "comfort",
        ):
            assert (parts[name].sum() == whole[name]).all(), name
        assert (whole["logs"] == 3).all()
        assert (whole["p99_ms"] >= whole["p50_ms"]).all()
        mona = rows[(rows["source"] == "MONA") & (rows["planner"] == "logged")].iloc[0]
        assert (mona["goal"], mona["goal_of_reachable"]) == (1, 1)
    drives = pd.read_csv(tmp_path / "out" / "commonroad_logs.csv")
    assert len(drives) == 3 * 3 * 2
    assert set(drives["verdict"]) <= {"avoidable", "unavoidable", "not applicable"}
    assert page.startswith((tmp_path / "out" / "commonroad.md").read_text(encoding="utf-8"))
    assert main([*words, "--resume"]) == 0
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "out" / "commonroad.csv"), table)


def test_a_wrong_command_is_an_error_of_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path / "nowhere"), "-o", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert "no such file or folder" in capsys.readouterr().err
