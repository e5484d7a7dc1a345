"""A result folder read back: its tables are those that were written, its drives those that were driven."""

from pathlib import Path

import pandas as pd
import pytest

from logs import ConfigError, StGraph
from metrics.judge.aggregate import LogLabels, groups, standings
from replay.config import RunConfig
from replay.draw.drawn_results import Results, load
from replay.run import evaluate_logs

LOG = "paper/crossing_pedestrian"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Results:
    config = RunConfig(planners=("dp_qp", "constant_speed"), recording=False)
    return evaluate_logs((), config, tmp_path_factory.mktemp("results") / "run", suite=LOG)


def test_the_tables_are_those_of_the_run(run: Results) -> None:
    result = load(run.path)
    assert result.path == run.path and result.summary == run.summary and result.run == run.run
    pd.testing.assert_frame_equal(result.metrics, run.metrics)
    assert list(result.gates["gate"]) == [gate["rule"] for gate in run.summary["gates"]]
    assert set(map(tuple, result.drives[["planner", "mode"]].to_numpy())) == set(run.run.drives)
    labels = {LOG: LogLabels(LOG, "replan catalogue", tuple(result.logs["tags"][0]))}
    assert result.labels == labels
    stand = standings(result.verdicts, result.drives, [LOG], result.run.drives)
    pd.testing.assert_frame_equal(result.groups, groups(result.metrics, stand, labels), check_dtype=False)
    assert list(result.logs["family"]) == [LOG] and list(result.logs["dataset"]) == ["replan catalogue"]
    assert set(result.frames["log"]) == {LOG} and len(result.timings) == len(run.timings)


def test_a_drive_has_its_plans_with_their_inside(run: Results) -> None:
    drive = load(run.path).drive(LOG, "dp_qp")
    plan = drive.plan(at=3.04)
    assert plan.trajectory.t[0] == pytest.approx(3.0) and drive.frame(3.04).t == pytest.approx(3.0)
    graph = next(item for item in plan.internals if isinstance(item, StGraph))
    assert graph.qp.shape == (81, 2)
    graphs = [item for frame in drive.trace.frames for item in frame.plan.internals if isinstance(item, StGraph)]
    assert "pedestrian" in {obstacle.agent for graph in graphs for obstacle in graph.obstacles}
    gap = drive.metrics.set_index("metric").loc["gap.min"]
    assert drive.series["gap"].min() == gap["value"] and drive.series["gap"].idxmin() == gap["time_s"]
    assert drive.trace.end.value == drive.info["end"]


def test_what_is_not_there_is_named(run: Results, tmp_path: Path) -> None:
    result = load(run.path)
    for ask, words in (
        (lambda: load(tmp_path), "no results of a finished run"),
        (lambda: result.drive("paper/crossing_pedestrain"), LOG),
        (lambda: result.drive(LOG), "name a planner of dp_qp"),
        (lambda: result.drive(LOG, "idm"), "no closed loop of idm"),
        (lambda: result.drive(LOG, "dp_qp").plan(-1.0), "its first is at 0.00 s"),
        (lambda: result.drive(LOG, "dp_qp").plan(1e9), r"it ended at \d+.\d\d s: "),
    ):
        with pytest.raises(ConfigError, match=words):
            ask()


@pytest.mark.parametrize("at", [float("nan"), float("inf"), -1.0])
def test_a_time_without_a_plan_is_an_error_and_a_run_is_said_in_one_line(run: Results, at: float) -> None:
    results = load(run.path)
    first = results.drives.iloc[0]
    with pytest.raises(ConfigError, match="no plan at"):
        results.drive(first["log"], first["planner"], first["mode"]).frame(at)
    assert len(repr(results)) < 300
