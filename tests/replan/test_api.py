"""`replan.evaluate` is the command: the same tables and reports from the same settings."""

from pathlib import Path

import pytest
from command_line import replan as command
from short_logs import free_and_blocked

import replan
from replan.logs.mcap import write_scenario
from replan.results.tables import REPORTS


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
