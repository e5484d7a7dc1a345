"""Every example of every help text: it runs to its end, or until the first log is driven."""

import re
import shlex
import shutil
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from command_line import RUNNER, replan
from commonroad_files import problem, straight, written
from short_logs import short
from typer.main import get_command

from replan.cli import app
from replan.logs.catalogue import scenario
from replan.logs.mcap import write_scenario

pytestmark = pytest.mark.nightly
pytest.importorskip("duckdb")
pytest.importorskip("optuna")
PLANNER = (
    "from replan.planners.constant_speed import ConstantSpeed\n\n\nclass "
    "MyPlanner(ConstantSpeed):\n    pass\n"
)
GATES = (
    '[[gate]]\nmetric = "collision_at_fault.count"\nmax = 0\n\n[[compare]]\nmetric = '
    '"ttc.min"\nmax_decrease = 9\n'
)
SPACE = "[loop]\nplan_period_s = { low = 0.1, high = 0.3 }\n"
WORDS = {
    "my_bags/": "my_logs",
    "my_bag/": "my_bag.mcap",
    "my_bag": "my_bag.mcap",
    "17": "pedestrian",
}
"""Names in the examples, and what stands for them here."""
SHOWN = re.compile(
    r"replan (view results/\S+( results/\S+)?( --log \S+| -p idm --mode closed)?$|view "
    r".*--screenshot)"
)
"""Examples that need a display."""
LONG = (
    "replan synth all",
    "replan synth raw",
    "replan tune -p idm --space space.toml --suite full",
)


class BegunError(Exception):
    """The first log is about to be driven."""


def examples(command: Any) -> Iterator[str]:
    for line in re.findall(r"^ *(replan \S[^\n]*)", command.help or "", re.MULTILINE):
        yield re.split(r" {3,}", line)[0]
    for inner in getattr(command, "commands", {}).values():
        yield from examples(inner)


def marked(line: str) -> Any:
    return pytest.param(line, marks=pytest.mark.slow) if line.startswith(LONG) else line


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all that the examples name."""
    place = tmp_path_factory.mktemp("examples")
    (place / "my_logs").mkdir()
    for name in ("everyday/cut_in", "paper/crossing_pedestrian"):
        write_scenario(place / "my_logs" / f"{name.split('/')[1]}.mcap", scenario(name))
    (place / "many_logs").mkdir()
    for k in range(20):
        write_scenario(place / "many_logs" / f"{k}.mcap", short(f"test/{k}", v=8.0 + k / 10))
    for name in ("a", "drive", "my_log", "my_bag"):
        shutil.copy(place / "my_logs" / "crossing_pedestrian.mcap", place / f"{name}.mcap")
    (place / "my_pkg").mkdir()
    (place / "my_pkg" / "mine.py").write_text(PLANNER, encoding="utf-8")
    poses = [("everyday/cut_in", 0.5, 5.0 * k, 0.0, 0.0) for k in range(1, 9)]
    pd.DataFrame(poses, columns=["log", "t_s", "x", "y", "yaw"]).to_parquet(place / "agent.parquet")
    (place / "gates.toml").write_text(GATES, encoding="utf-8")
    (place / "space.toml").write_text(SPACE, encoding="utf-8")
    quick, results = ("--workers", 0, "--no-recording"), place / "results"
    replan(
        "evaluate", place / "my_logs", "-p", "idm", "-p", "dp_qp", *quick, "-o", results / "both"
    )
    replan("evaluate", place / "my_logs", "-p", "constant_speed", *quick, "-o", results / "one")
    for name in ("main", "mine"):
        shutil.copytree(results / "both", results / name)
    for part in (1, 2):
        words = ("-p", "constant_speed", *quick, "--shard", f"{part}/2")
        replan("evaluate", place / "my_logs", *words, "-o", place / f"shard-{part}")
    file = written(place, straight(1), problem(7, 0.0, 0.0, 10.0), benchmark="USA_US101-6_1_T-1")
    file.rename(place / "USA_US101-6_1_T-1.xml")
    car = (
        "--vehicle",
        "kinematic_bicycle",
        "--car",
        "bmw_320i",
        "-p",
        "constant_speed",
        "--mode",
        "closed",
    )
    replan("evaluate", place / "USA_US101-6_1_T-1.xml", *car, *quick, "-o", results / "us101")
    replan("mine", place / "my_logs", "--workers", 0, "-o", results / "mined")
    replan("suite", results / "mined", "-o", place / "suite.toml")
    replan("baseline", results / "both", "-o", place / "baseline.parquet")
    (results / "tuned").mkdir()
    (results / "tuned" / "best.toml").write_text(
        "[planner.idm]\ntime_gap_s = 1.5\n", encoding="utf-8"
    )
    return place


@pytest.mark.parametrize(
    "line", [marked(line) for line in dict.fromkeys(examples(get_command(app)))]
)
def test_an_example_of_a_help_text_runs(
    place: Path, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    if SHOWN.match(line):
        pytest.skip("opens a window")
    monkeypatch.chdir(place)
    monkeypatch.syspath_prepend(str(place))

    def begun(*args: object, **more: object) -> None:
        raise BegunError

    monkeypatch.setattr("replan.run.evaluate.Local.evaluate", begun)
    shutil.rmtree("results/run-001", ignore_errors=True)
    shutil.copytree("results/both" if "idm" in line else "results/one", "results/run-001")
    shutil.rmtree("new", ignore_errors=True)
    words = [WORDS.get(word, word) for word in shlex.split(line)[1:]]
    words = ["many_logs" if (words[0], word) == ("tune", "my_logs/") else word for word in words]
    words = [
        f"new/{word}" if before in ("-o", "--out") else word
        for before, word in pairwise(["", *words])
    ]
    result = RUNNER.invoke(app, words)
    if not isinstance(result.exception, BegunError):
        assert result.exit_code in (0, 1, 4), result.output
