"""`replan.evaluate` is the command: the same tables and reports from the same settings."""

from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from bad_planners import Raises as BadPlanner
from command_line import replan as command
from short_logs import free_and_blocked

import replan
from replan.api import named
from replan.logs.mcap import write_scenario
from replan.logs.readers import LogSettings
from replan.results.tables import REPORTS
from replan.run.output import scenario_of


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    for name, log in zip("ab", free_and_blocked(), strict=True):
        write_scenario(folder / f"{name}.mcap", log)
    return folder


def test_the_function_and_the_command_write_the_same(logs: Path, tmp_path: Path) -> None:
    given = {"planners": "constant_speed", "mode": "closed", "recording": False, "ensemble": 1}
    made = replan.evaluate(logs, out=tmp_path / "one", **given)
    words = [
        "--planner",
        "constant_speed",
        "--mode",
        "closed",
        "--no-recording",
        "--ensemble",
        "1",
        "--workers",
        "0",
    ]
    assert command("evaluate", logs, "--out", tmp_path / "two", *words).exit_code == made.exit_code
    # They have planning times of the clock
    assert all((made.path / name).stat().st_size for name in REPORTS)
    for name in ("metrics.parquet", "verdicts.parquet", "run.toml", "junit.xml"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes(), (
            name
        )


def test_a_part_of_the_logs_and_a_run_beside_another(logs: Path, tmp_path: Path) -> None:
    given = {"planners": "constant_speed", "mode": "closed", "recording": False}
    parts = [
        replan.evaluate(logs, out=tmp_path / f"{k}", shard=f"{k}/2", report=False, **given)
        for k in (1, 2)
    ]
    assert [list(part.logs["log"]) for part in parts] == [["test/free"], ["test/blocked"]]
    assert not any((part.path / name).exists() for part in parts for name in REPORTS)
    whole = replan.evaluate(logs, out=tmp_path / "whole", report=False, **given)
    replan.evaluate(logs, out=tmp_path / "again", baseline=whole, **given)
    assert "# Compared: " in (tmp_path / "again" / "report.md").read_text(encoding="utf-8")


CLOSED = {"mode": "closed", "planners": "constant_speed", "recording": False, "report": False}


def test_scenarios_in_memory_are_driven_as_their_files(logs: Path, tmp_path: Path) -> None:
    one, two = free_and_blocked()
    filed = replan.evaluate(logs, out=tmp_path / "filed", **CLOSED)
    mixed = replan.evaluate([one, logs / "b.mcap"], out=tmp_path / "mixed", **CLOSED)
    for name in ("metrics.parquet", "verdicts.parquet", "groups.parquet"):
        assert (filed.path / name).read_bytes() == (mixed.path / name).read_bytes(), name
    assert list(mixed.logs["source"]) == ["test/free", str(logs / "b.mcap")]
    assert list(mixed.logs["sha256"]) == list(filed.logs["sha256"])
    again = replan.evaluate([one, logs / "b.mcap"], out=tmp_path / "mixed", resume=True, **CLOSED)
    assert again.resumed == 2
    # a log in memory and its file are one log
    alone = replan.evaluate([two, logs / "b.mcap"], out=tmp_path / "alone", **CLOSED)
    assert list(alone.logs["log"]) == ["test/blocked"]
    row = alone.logs.iloc[0].to_dict()
    assert scenario_of(alone.path, row, LogSettings()).name == "test/blocked"


def test_a_worker_drives_scenarios_in_memory_and_two_of_one_name(tmp_path: Path) -> None:
    one, two = free_and_blocked()
    two = replace(two, name=one.name)
    made = replan.evaluate([one, two], out=tmp_path / "two", workers=1, **CLOSED)
    assert list(made.logs["log"]) == ["test/free", f"test/free@{made.logs['sha256'][1][:8]}"]
    ends = made.drives.set_index("log")["end"]
    assert list(ends) == ["goal reached", "collision"] and not len(made.failures)


def test_an_object_that_is_no_log_is_refused_with_a_remedy() -> None:
    table = pd.DataFrame({"t": [0.0]})
    for logs in (table, [table], 7):
        with pytest.raises(replan.ConfigError, match=r"not a (DataFrame|int); replan.from_frames"):
            replan.evaluate(logs)


def test_a_planner_that_is_an_object_is_refused_with_what_to_pass(tmp_path: Path) -> None:
    planner = BadPlanner.__new__(BadPlanner)
    for planners in (planner, [planner]):
        with pytest.raises(replan.ConfigError, match='its name, "bad_planners:Raises"; its keyw'):
            replan.evaluate(out=tmp_path / "out", planners=planners)
    assert named(BadPlanner) == named("bad_planners:Raises") == "bad_planners:Raises"
    assert named(free_and_blocked) == "short_logs:free_and_blocked"  # a factory
    assert not (tmp_path / "out").exists()
