"""A trace is a log that we drove: read again it is the drive, and what was planned stands beside
it.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from differences import differences
from mcap.reader import make_reader
from rich_scenario import START_NS, rich_scenario, seconds

from replan.core.errors import LogError
from replan.logs.frame import Predictions
from replan.logs.mcap import native, read_scenario, read_trace, write_scenario, write_trace
from replan.logs.mcap.writer import BLOCK, scenario_entries, scenario_records, write_log
from replan.logs.plan import (
    Candidates,
    Corridor,
    CostTerms,
    Decision,
    DecisionKind,
    GraphObstacle,
    GridCost,
    LaneOption,
    Plan,
    PlanStart,
    PlanStatus,
    SlGraph,
    SolverReport,
    StGraph,
)
from replan.logs.states import Alternative, Controls
from replan.logs.summary import summarise
from replan.logs.trace import EndReason, Mode, PlannedFrame, Trace, TrackingErrors
from replan.logs.tracks import Tracks


def drive() -> Trace:
    """A closed loop of two frames over the rich scenario, with all artefacts in the second plan."""
    scenario = rich_scenario()
    t = seconds(10_000_000 * k for k in range(40))
    ego = scenario.ego.resampled(t)
    grid = GridCost(
        np.arange(2.0), np.arange(3.0), np.array([[0.0, np.inf, 1.0]] * 2), np.array([0, -1])
    )
    corridor = Corridor(np.arange(2.0), np.array([-np.inf, -1.0]), np.array([np.inf, 2.0]))
    obstacle = GraphObstacle("walker", np.array([[0.0, 1.0], [2.0, 3.0]]), DecisionKind.NUDGE_LEFT)
    line = np.array([[0.0, 0.0], [1.0, 0.5]])
    internals = (
        Decision("walker", DecisionKind.YIELD, "speed", "it crosses"),
        CostTerms("path", (("jerk", 1.5), ("centre", np.float64(0.25)))),
        Candidates("passing", 2, (("no plan", 1),), chosen="keep"),
        LaneOption("left", (("time lost", 0.3), ("change", 1.0)), "car 7 is beside"),
        SolverReport("path", True, "solved", 25, 1e-6, np.nan),
        SlGraph(grid, corridor, line, line, (obstacle,)),
        StGraph(None, None, line, line, ()),
    )
    fan = (Alternative(ego.between(0.0, 0.2), 0.75, "left"), Alternative(ego))
    plans = (
        Plan(ego.between(0.0, 0.1)),
        Plan(ego, PlanStatus.HARD_STOP, "no way", PlanStart.PREVIOUS_PLAN, internals, fan),
    )
    half = np.full(len(t), 0.5)
    return Trace(
        scenario.name,
        "dp_qp",
        Mode.CLOSED,
        False,
        ego,
        scenario.tracks,
        (PlannedFrame(0.0, plans[0]), PlannedFrame(0.1, plans[1])),
        EndReason.COLLISION,
        "with car 1",
        Controls(t, half, half, 0.0 * t),
        Controls(t, 0.4 * half, half, 0.0 * t),
        TrackingErrors(t, half, half, half, np.where(t > 0.2, np.nan, half)),
        ("A drive.", "A note."),
    )


def messages(path: Path, topic: str) -> list[tuple[int, Any]]:
    with path.open("rb") as file:
        return [
            (m.log_time, json.loads(m.data))
            for _, _, m in make_reader(file).iter_messages(topics=[topic])
        ]


@pytest.mark.parametrize(("chosen", "other"), [("keep", "pass"), ("pass", "keep")])
def test_former_traces_name_the_rejected_candidate_in_the_reason(
    tmp_path: Path, chosen: str, other: str
) -> None:
    former = Candidates("passing", 2, ((f"{other}: no plan", 1),))
    trace = drive()
    plan = replace(trace.frames[1].plan, internals=(former,))
    frames = (trace.frames[0], replace(trace.frames[1], plan=plan))
    write_trace(
        tmp_path / "a.mcap", replace(trace, frames=frames), rich_scenario(), internals="full"
    )
    _, frame = read_trace(tmp_path / "a.mcap")[0].frames
    assert frame.plan.internals == (Candidates("passing", 2, (("no plan", 1),), chosen),)


def test_a_trace_read_again_is_the_drive(tmp_path: Path) -> None:
    scenario, trace = rich_scenario(), drive()
    write_trace(tmp_path / "closed.mcap", trace, scenario)
    again = read_scenario(tmp_path / "closed.mcap")
    assert differences(trace.ego, again.ego) == []
    assert differences(trace.agents, again.tracks) == []
    assert differences(trace.actuation, again.controls) == []
    assert (
        differences(
            (scenario.road, scenario.goal, scenario.vehicle),
            (again.road, again.goal, again.vehicle),
        )
        == []
    )
    assert (again.duration, again.start_ns, again.notes) == (
        trace.ego.t[-1],
        START_NS,
        ("A note.", "A drive."),
    )
    assert again.metadata["seed"] == "7" and again.metadata["trace_planner"] == "dp_qp"
    assert (
        again.metadata["trace_end"] == "collision"
        and again.metadata["trace_detail"] == "with car 1"
    )
    assert again.metadata["trace_mode"] == "closed" and again.metadata["trace_oracle"] == "false"


def test_plans_are_kept_with_all_their_internals(tmp_path: Path) -> None:
    write_trace(tmp_path / "log.mcap", drive(), rich_scenario(), internals="full")
    (_, first), (time, plan) = messages(tmp_path / "log.mcap", "/plan")
    assert time == START_NS + 100_000_000
    assert (first["status"], first["start"], first["reason"]) == ("planned", "ego", "")
    assert (plan["status"], plan["start"], plan["reason"]) == (
        "hard_stop",
        "previous_plan",
        "no way",
    )
    assert plan["trajectory"]["x_m"] == drive().ego.x.tolist()
    assert plan["decisions"] == [
        {"agent": "walker", "kind": "yield", "stage": "speed", "reason": "it crosses"}
    ]
    assert plan["costs"] == [{"stage": "path", "terms": {"jerk": 1.5, "centre": 0.25}}]
    assert plan["lanes"] == [
        {"name": "left", "terms": {"time lost": 0.3, "change": 1.0}, "against": "car 7 is beside"}
    ]
    assert plan["solvers"][0]["dual_residual"] is None and plan["solvers"][0]["iterations"] == 25
    path_graph, speed_graph = plan["graphs"]
    assert (path_graph["plane"], speed_graph["plane"], speed_graph["grid"]) == ("sl", "st", None)
    assert path_graph["grid"]["cost"][0] == [0.0, None, 1.0] and path_graph["grid"]["chosen"] == [
        0,
        -1,
    ]
    assert path_graph["corridor"]["lower"] == [None, -1.0]
    assert path_graph["obstacles"][0]["decision"] == "nudge left"
    left, other = plan["alternatives"]
    assert (left["score"], left["name"], other["score"]) == (0.75, "left", None)
    assert left["trajectory"]["x_m"] == drive().ego.between(0.0, 0.2).x.tolist()


@pytest.mark.parametrize(
    ("internals", "decisions", "graphs"), [("none", 0, 0), ("summary", 1, 2), ("full", 1, 2)]
)
def test_internals_are_kept_as_asked(
    tmp_path: Path, internals: Any, decisions: int, graphs: int
) -> None:
    write_trace(tmp_path / "log.mcap", drive(), rich_scenario(), internals=internals)
    plan = messages(tmp_path / "log.mcap", "/plan")[1][1]
    assert (len(plan["decisions"]), len(plan["graphs"])) == (decisions, graphs)


def test_commands_actuation_and_tracking_have_topics_and_stand_in_blocks(tmp_path: Path) -> None:
    write_trace(tmp_path / "log.mcap", drive(), rich_scenario())
    assert messages(tmp_path / "log.mcap", "/command")[0][1]["steer_rad"] == [0.5] * 40
    assert messages(tmp_path / "log.mcap", "/actuation")[0][1]["steer_rad"] == [0.2] * 40
    ((time, tracking),) = messages(tmp_path / "log.mcap", "/tracking")
    assert (
        time == tracking["log_time_ns"][0] == START_NS
        and tracking["log_time_ns"][-1] == START_NS + 390_000_000
    )
    assert {name: column[-1] for name, column in tracking.items() if name != "log_time_ns"} == {
        "lateral_m": 0.5,
        "heading_rad": 0.5,
        "speed_mps": 0.5,
        "station_m": None,
    }


@pytest.mark.parametrize("count", [1, BLOCK, BLOCK + 1, 2 * BLOCK + 7])
def test_blocks_and_single_messages_read_the_same(tmp_path: Path, count: int) -> None:
    t = seconds(10_000_000 * k for k in range(count))
    half = np.where(np.arange(count) % 3 > 0, 0.5, np.nan)
    scenario = replace(
        rich_scenario(),
        ego=rich_scenario().ego.resampled(t),
        controls=Controls(t, half, half, 0.0 * t),
    )
    found = []
    for blocks in (False, True):
        path = tmp_path / f"{blocks}.mcap"
        write_log(path, scenario_records(scenario), scenario_entries(scenario, blocks=blocks))
        found.append(read_scenario(path))
        assert len(messages(path, "/ego")) == (-(-count // BLOCK) if blocks else count)
    assert differences(*found) == [] and differences(scenario.ego, found[1].ego) == []


def test_a_block_whose_columns_or_times_disagree_is_refused(tmp_path: Path) -> None:
    scenario, block = rich_scenario(), native.BLOCKS[native.Ego]
    zero = [0.0, 0.0]
    for times, yaw, what in (
        ([START_NS, START_NS + 5], [0.0], "columns differ in length: .*yaw_rad 1"),
        ([START_NS + 5, START_NS], zero, "time goes backwards"),
        ([START_NS, START_NS], zero, "two messages have the same time"),
        ([START_NS, 2**63], zero, "beyond any clock"),
    ):
        message = block(times, zero, zero, yaw, zero, zero, zero)
        write_log(tmp_path / "log.mcap", scenario_records(scenario), [(START_NS, "/ego", message)])
        with pytest.raises(LogError, match=f"topic /ego.*{what}"):
            read_scenario(tmp_path / "log.mcap")


def test_without_internals_a_plan_is_kept_every_half_second_and_at_its_end(tmp_path: Path) -> None:
    plan = Plan(rich_scenario().ego.resampled(np.r_[np.arange(0.0, 1.25, 0.1), 1.23]))
    trace = replace(drive(), frames=(PlannedFrame(0.0, plan),))
    write_trace(tmp_path / "log.mcap", trace, rich_scenario(), internals="none")
    ((_, message),) = messages(tmp_path / "log.mcap", "/plan")
    assert message["trajectory"]["t_s"] == pytest.approx([0.0, 0.5, 1.0, 1.23])
    assert message["trajectory"]["x_m"] == plan.trajectory.x[[0, 5, 10, 13]].tolist()


def seen_once(trace: Trace) -> Tracks:
    """The first agent as a sensor showed it in the second frame."""
    one = trace.agents.samples(0)
    columns = {
        name: getattr(trace.agents, name)[one][:1] + 0.25 for name in ("x", "y", "yaw", "vx", "vy")
    }
    return Tracks(
        trace.agents.ids[:1],
        trace.agents.kinds[:1],
        trace.agents.length[:1],
        trace.agents.width[:1],
        trace.agents.static[:1],
        np.array([0, 1]),
        np.array([0.1]),
        **columns,
    )


def test_what_a_sensor_showed_is_on_a_topic_of_its_own(tmp_path: Path) -> None:
    trace = drive()
    shown = seen_once(trace)
    write_trace(
        tmp_path / "log.mcap", replace(trace, perceived=shown), rich_scenario(), internals="none"
    )
    first, (time, second) = messages(tmp_path / "log.mcap", "/perceived")
    assert first == (
        START_NS,
        {"id": [], "x_m": [], "y_m": [], "yaw_rad": [], "vx_mps": [], "vy_mps": []},
    )
    assert (time, second["id"], second["x_m"]) == (
        START_NS + 100_000_000,
        [trace.agents.ids[0]],
        [shown.x[0]],
    )
    assert differences(trace.agents, read_scenario(tmp_path / "log.mcap").tracks) == []
    write_trace(tmp_path / "log.mcap", trace, rich_scenario())
    assert messages(tmp_path / "log.mcap", "/perceived") == []


def test_an_infinite_command_is_refused(tmp_path: Path) -> None:
    t = drive().ego.t
    trace = replace(drive(), commands=Controls(t, np.full(len(t), np.inf), t, t))
    with pytest.raises(
        LogError, match=r"log.mcap, topic /command: steer_rad is infinite at index 0"
    ):
        write_trace(tmp_path / "log.mcap", trace, rich_scenario())


def test_the_summary_tells_what_a_log_holds(tmp_path: Path) -> None:
    write_scenario(tmp_path / "log.mcap", rich_scenario())
    summary = summarise(tmp_path / "log.mcap")
    assert summary.error is None and summary.scenario is not None
    found = summary.scenario
    assert summary.profile == "scenario log, native format 1"
    assert {t.topic: t.messages for t in summary.topics}["/ego"] == 30
    assert {t.topic: t.schema for t in summary.topics}["/agents"] == "replan.AgentColumns"
    assert (found["agents"], found["obstacles"]) == ({"car": 1, "pedestrian": 1}, 1)
    assert (found["ego_samples"], found["ego_rate"]) == (30, pytest.approx(10.0))
    assert [found["road"][of] for of in ("lanes", "drivable", "without_speed_limit")] == [2, 1, 1]
    assert found["road"]["length_km"] == pytest.approx(0.44)
    assert (
        found["goal"] == "in 1 region(s), time 1 to 20 s, speed 0 to 9 m/s, heading -0.1 to 0.1 rad"
    )
    assert all(e.possible for e in summary.evaluations)
    assert any("30 states from 0.00 to 2.90 s (10.0 Hz)" in line for line in summary.lines())


def test_a_trace_with_all_its_inside_is_read_back(tmp_path: Path) -> None:
    trace = drive()
    walker = np.array([[1.0, 2.0, 3.0]])
    shown = Predictions(
        np.array([0.1, 0.6, 1.1]),
        np.array([0]),
        np.array([1.0]),
        walker,
        -walker,
        0.0 * walker,
        "cv",
    )
    frames = (trace.frames[0], replace(trace.frames[1], agents=("walker",), predictions=shown))
    trace = replace(trace, frames=frames, perceived=seen_once(trace))
    write_trace(tmp_path / "log.mcap", trace, rich_scenario(), internals="full")
    again, scenario = read_trace(tmp_path / "log.mcap")
    unwritten = replace(shown, yaw=np.full_like(walker, np.nan))
    expected = replace(
        trace, frames=(frames[0], replace(frames[1], predictions=unwritten)), notes=scenario.notes
    )
    assert differences(expected, again) == []
    assert differences(rich_scenario().road, scenario.road) == []


def test_a_log_that_is_no_trace_is_refused(tmp_path: Path) -> None:
    write_scenario(tmp_path / "log.mcap", rich_scenario())
    with pytest.raises(LogError, match=r"log\.mcap.*no drive of a planner"):
        read_trace(tmp_path / "log.mcap")
