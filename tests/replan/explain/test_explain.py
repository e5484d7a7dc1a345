"""A drive in words, one frame planned again, and where the agents really were: the words match the
run.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import one_error, replan
from handmade import drive, lanes_along, scenario, straight, track, tracks

from replan.config import RunConfig
from replan.core.arrays import FloatArray
from replan.core.errors import LogError, PlannerError
from replan.draw.drawn_results import Results, load as results_of
from replan.explain import accounts
from replan.explain.causes import Cause, CauseKind
from replan.explain.explanation import MOST_PHASES, changes, explained, lines_of, summary
from replan.explain.input_changes import parse
from replan.explain.planner_input import actual_occupancy
from replan.logs.catalogue import CATALOGUE
from replan.logs.mcap import write_scenario
from replan.logs.plan import Decision, DecisionKind, GraphObstacle, Plan, StGraph
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Mode, PlannedFrame, Trace
from replan.planners.piecewise_jerk.solvers import solve
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.run import evaluate_logs
from replan.run.frame_dump import dump, load, replan_frame

LOG = "paper/crossing_pedestrian"


def log() -> Scenario:
    made = CATALOGUE[LOG].scenario()
    return replace(made, ego=made.ego.between(0.0, 7.0), duration=7.0)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """Both loops on the first 7 s of the log of the paper's pedestrian."""
    folder = tmp_path_factory.mktemp("logs")
    write_scenario(folder / "pedestrian.mcap", log())
    run = RunConfig(recording=False)
    return results_of(
        evaluate_logs([folder], run, tmp_path_factory.mktemp("out") / "run", workers=0).path
    )


def test_a_run_read_back_is_explained_as_it_was_when_driven(results: Results) -> None:
    """The recording explains the drive in memory, `explain` the one on the disk: the same
    accounts.
    """
    driven = run_closed_loop(log(), "dp_qp").trace
    read = results.drive(LOG, "dp_qp")
    again = list(accounts(read.trace, read.scenario, results.run.drive_loop))
    assert repr(again) == repr(list(accounts(driven, log())))  # a NaN is not equal to itself
    assert any(account.causes for account in again)


def test_explain_prints_each_change_of_decision_once(results: Results) -> None:
    drive = results.drive(LOG, "dp_qp")
    found = explained(drive)
    kinds = [frozenset((d.agent, d.kind) for d in one.decisions) for one in found]
    driven = [
        frozenset((d.agent, d.kind) for d in frame.plan.internals if isinstance(d, Decision))
        for frame in drive.trace.frames
    ]
    assert set(kinds) == set(driven)
    assert 2 < len(found) < 0.2 * len(driven)
    text = "\n".join(line for one in found for line in lines_of(one))
    for words in (
        "Slows down for pedestrian (yield): ",
        "active",
        "S-T upper bound (pedestrian)",
        "speed QP: ",
    ):
        assert words in text


def test_the_summary_has_ten_lines_with_the_hardest_braking_and_its_agent(results: Results) -> None:
    drive = results.drive(LOG, "dp_qp")
    lines = summary(drive)
    accounts_of = list(accounts(drive.trace, drive.scenario, drive.result.run.drive_loop))
    hardest = min(one.course.a_least for one in accounts_of if one.causes)
    assert len(lines) <= MOST_PHASES + 1
    assert any(f"{hardest:.1f} m/s²" in line and "pedestrian" in line for line in lines)
    begins = [float(line.split()[0]) for line in lines if line[0].isdigit()]
    assert begins == sorted(begins)
    short, whole = (
        replan("explain", results.path, *words).stdout.splitlines() for words in ((), ("--all",))
    )
    assert len(short) <= 11 < len(whole)


def test_a_cause_that_does_not_account_for_the_braking_is_not_first() -> None:
    weak, named = (
        Cause(CauseKind.CURVE, need_mps2=0.5),
        Cause(CauseKind.CURVE, need_mps2=0.5, inferred=False),
    )
    assert not weak.accounts_for(-3.4)
    assert (
        weak.accounts_for(-1.4)
        and named.accounts_for(-3.4)
        and Cause(CauseKind.AGENT).accounts_for(-3.4)
    )
    assert replace(weak, need_mps2=1.2).accounts_for(-3.4)


def test_explain_prints_one_instant_or_one_json_document(results: Results) -> None:
    said = replan("explain", results.path, "--planner", "dp_qp", "--at", 6.55).stdout
    assert "t = 6.50 s: slows down" in said and said.count("t = ") == 1
    document = json.loads(replan("explain", results.path, "--mode", "open", "--json").stdout)
    assert (document["planner"], document["mode"]) == ("dp_qp", "open")
    causes = [cause for frame in document["frames"] for cause in frame["account"]["causes"]]
    assert {"agent"} <= {cause["kind"] for cause in causes}
    assert "no plan at" in one_error(replan("explain", results.path, "--at", -1))


def accepted(world: Scenario) -> Mapping[str, list[str]]:
    found: Mapping[str, list[str]] = json.loads(world.metadata.get("expected_decisions", "{}"))
    return found


def check_states_what_is_accepted(name: str) -> None:
    world = CATALOGUE[name].scenario()
    text = [
        line
        for one in changes(run_open_loop(world, "dp_qp").trace, world)
        for line in lines_of(one)
    ]
    for agent, kinds in accepted(world).items():
        said = [line for line in text if f"{agent}: " in line or f"for {agent} (" in line]
        assert any(
            f"{agent}: {kind} (" in line or f"for {agent} ({kind})" in line
            for kind in kinds
            for line in said
        )


def test_explain_states_a_decision_that_the_family_accepts() -> None:
    check_states_what_is_accepted("everyday/nudge")


@pytest.mark.slow
@pytest.mark.parametrize("name", CATALOGUE)
def test_explain_states_a_decision_that_every_family_accepts(name: str) -> None:
    check_states_what_is_accepted(name)


@pytest.mark.parametrize("mode", ["closed", "open"])
def test_a_dump_gives_the_same_plan_to_the_bit(results: Results, mode: str, tmp_path: Path) -> None:
    again = replan_frame(results.drive(LOG, "dp_qp", mode), 2.0)
    assert again.is_same
    dump(tmp_path / "frame.msgpack", again.dump)
    read = load(tmp_path / "frame.msgpack")
    assert len(read.frames) == (21 if mode == "closed" else 1)
    assert read.frame.t == 2.0 and read.frame.agents.ids == again.dump.frame.agents.ids
    recorded = results.drive(LOG, "dp_qp", mode).plan(2.0).trajectory
    for plan in (read.plan, read.planned()):
        for name in ("t", "x", "y", "yaw", "v", "a", "kappa"):
            np.testing.assert_array_equal(getattr(plan.trajectory, name), getattr(recorded, name))


def test_the_problems_of_a_dump_have_the_answers_that_are_with_them(
    results: Results, tmp_path: Path
) -> None:
    dump(tmp_path / "frame.msgpack", replan_frame(results.drive(LOG, "dp_qp"), 6.5).dump)
    read = load(tmp_path / "frame.msgpack")
    assert {asked.result.report.stage for asked in read.problems} == {"path QP", "speed QP"}
    for problem, result in read.problems:
        np.testing.assert_array_equal(solve(problem, stage="again", tolerance=1e-3).x, result.x)


def test_another_planner_gets_only_the_frame_of_a_dump(results: Results) -> None:
    drive = results.drive(LOG, "dp_qp")
    again = replan_frame(drive, 6.5, "idm")
    assert again.is_same is None and again.dump.planner == "idm" and len(again.dump.frames) == 1
    assert again.dump.frame.ego == replan_frame(drive, 6.5).dump.frame.ego
    assert again.dump.frame.previous is None
    late = replan_frame(drive, 6.5, "idm", [parse("delay agents 3")])
    assert late.is_same is False, "compared with the plan of the run: that is what changes are for"


def test_the_command_reports_stages_sizes_and_residuals(results: Results, tmp_path: Path) -> None:
    file = tmp_path / "frame.msgpack"
    asked = replan("frame", results.path, "-p", "dp_qp", "--at", 6.5, "--dump", file)
    said = asked.stdout
    wanted = (
        "the one in the results, to the bit",
        "path QP: ",
        " unknowns, ",
        "residuals",
        "stages [ms",
        str(file),
    )
    assert all(words in said for words in wanted)
    unknown = replan("frame", results.path, "-p", "idm", "--at", 6.5, "--with", "nix")
    assert "knows no log" not in one_error(unknown)


@pytest.mark.parametrize("content", [b"", b"\x80", b"no dump at all"])
def test_an_invalid_dump_is_a_clean_error(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "frame.msgpack").write_bytes(content)
    with pytest.raises(LogError, match="is not a dump of a frame"):
        load(tmp_path / "frame.msgpack")


def test_another_planner_that_raises_is_named(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "class Raises:\n    def __init__(self, _):\n        pass\n\n    def plan(self, _):\n"
    text += "        raise KeyError('no')\n"
    (tmp_path / "raises_at_a_frame.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        PlannerError, match=r"raised at 1\.00 s: KeyError: 'no' \(raises_at_a_frame\.py:6\)"
    ):
        replan_frame(results.drive(LOG, "dp_qp"), 1.0, "raises_at_a_frame:Raises")


NONE = np.empty((0, 2))


def outlines(*agents: dict[str, object], end: float = 8.0) -> list[FloatArray]:
    """Of one frame at 0 s of an ego at 10 m/s along x, with all agents in its S-T graph."""
    ego = drive(straight, 10.0, 8.0)
    world = scenario(ego, agents=tracks(*agents), road=lanes_along(ego))
    things = tuple(GraphObstacle(str(agent["id"]), NONE, DecisionKind.FOLLOW) for agent in agents)
    frame = PlannedFrame(0.0, Plan(ego, internals=(StGraph(None, None, NONE, NONE, things),)))
    driven = ego.between(0.0, end)
    trace = Trace(
        "handmade", "x", Mode.CLOSED, False, driven, world.tracks, (frame,), EndReason.GOAL
    )
    (found,) = actual_occupancy(trace, world)
    return found


def test_a_car_ahead_occupies_the_path_from_rear_to_front() -> None:
    t = np.arange(0.0, 8.01, 0.1)
    (found,) = outlines(
        track("a", list(t), list(30.0 + 5.0 * t), [0.0] * len(t), length=4.0, width=2.0)
    )
    car = scenario(drive(straight, 10.0, 1.0)).vehicle
    low, high = np.split(found, 2)
    assert low[:, 0] == pytest.approx(np.arange(0.0, 8.01, 0.25))
    assert low[:, 1] == pytest.approx(30.0 + 5.0 * low[:, 0] - 2.0 - car.axle_to_front, abs=0.3)
    rear = car.length - car.axle_to_front
    assert high[::-1, 1] == pytest.approx(32.0 + 5.0 * low[:, 0] + rear, abs=0.3)


def test_occupancy_is_empty_beside_the_path_and_after_the_drive() -> None:
    assert outlines(track("beside", [0.0], [30.0], [6.0], static=True)) == []
    (found,) = outlines(track("wall", [0.0], [30.0], [0.0], static=True), end=2.0)
    assert found[:, 0].max() == pytest.approx(2.0)


def test_occupancy_is_of_agents_of_the_graph_alone() -> None:
    ego = drive(straight, 10.0, 8.0)
    world = scenario(
        ego, agents=tracks(track("wall", [0.0], [30.0], [0.0], static=True)), road=lanes_along(ego)
    )
    frame = PlannedFrame(0.0, Plan(ego))
    trace = Trace("handmade", "x", Mode.CLOSED, False, ego, world.tracks, (frame,), EndReason.GOAL)
    assert list(actual_occupancy(trace, world)) == [[]]
    stop = StGraph(None, None, NONE, NONE, (GraphObstacle("stop line 1", NONE, DecisionKind.STOP),))
    stopping = PlannedFrame(0.0, Plan(ego, internals=(stop,)))
    assert list(actual_occupancy(replace(trace, frames=(stopping,)), world)) == [[]]
