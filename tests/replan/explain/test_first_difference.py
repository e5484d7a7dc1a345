"""Where two drives part: what is changed in one frame is found in that frame, in its stage.

Where two planners part.
"""

from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import sample_drive
from hypothesis import given, settings, strategies as st

from replan.explain.first_difference import AXES, STAGES, first_difference
from replan.explain.planners_part import AHEAD_S, PARTED_M, PARTED_MPS, planners_part
from replan.explain.value_changes import TOLERANCE
from replan.logs.catalogue import scenario
from replan.logs.frame import Predictions
from replan.logs.plan import (
    Candidates,
    CostTerms,
    Decision,
    DecisionKind,
    Graph,
    LaneOption,
    PlanStatus,
    SlGraph,
    StGraph,
)
from replan.logs.states import Trajectory
from replan.logs.trace import EndReason, Mode, PlannedFrame, Trace
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop

ROWS, FRAMES = 301, 31
LANES = (
    LaneOption("keep", (("time lost", 1.0),)),
    LaneOption("left", (("time lost", 3.0),), "slower"),
)


@cache
def drive(mode: Mode = Mode.CLOSED) -> Trace:
    """Three seconds of the sample drive, with predictions and lanes."""
    whole = sample_drive.drive(mode)[0].trace
    rows = ROWS if mode is Mode.CLOSED else FRAMES
    frames = []
    for frame in whole.frames[:FRAMES]:
        plan = replace(frame.plan, internals=(*LANES, *frame.plan.internals))
        ahead = frame.t + np.arange(0.0, 8.1, 2.0)
        x = np.array([ahead, 2.0 * ahead])
        future = Predictions(
            ahead, np.array([0, 1]), np.ones(2), x, 0.0 * x, 0.0 * x, "lane_following"
        )
        frames.append(replace(frame, agents=("car 12", "truck 40"), predictions=future, plan=plan))
    cut = {name: first(getattr(whole, name), rows) for name in ("ego", "commands", "actuation")}
    return replace(whole, frames=tuple(frames), tracking=None, **cut)


def first(columns: Any, rows: int) -> Any:
    """The first rows of a struct of arrays."""
    if columns is None:
        return None
    return replace(
        columns, **{field.name: getattr(columns, field.name)[:rows] for field in fields(columns)}
    )


def changed(trace: Trace, k: int, change: Callable[[PlannedFrame], PlannedFrame]) -> Trace:
    """The drive with one frame changed."""
    frames = list(trace.frames)
    frames[k] = change(frames[k])
    return replace(trace, frames=tuple(frames))


def inside(kind: type, change: Callable[[Any], Any]) -> Callable[[PlannedFrame], PlannedFrame]:
    """What changes the first artefact of a kind."""

    def apply(frame: PlannedFrame) -> PlannedFrame:
        items = list(frame.plan.internals)
        i = next(i for i, item in enumerate(items) if isinstance(item, kind))
        items[i] = change(items[i])
        return replace(frame, plan=replace(frame.plan, internals=tuple(items)))

    return apply


def raised(values: np.ndarray, row: int, column: int, by: float) -> np.ndarray:
    out = np.array(values)
    out[row, column] += by
    return out


def _corridor(graph: Graph, **columns: np.ndarray) -> Graph:
    assert graph.corridor is not None
    return replace(graph, corridor=replace(graph.corridor, **columns))


def _elsewhere(frame: PlannedFrame) -> PlannedFrame:
    some = frame.predictions
    assert some is not None
    return replace(frame, predictions=replace(some, y=raised(some.y, 1, 2, 0.4)))


def _plan(**columns: Callable[[Trajectory], np.ndarray]) -> Callable[[PlannedFrame], PlannedFrame]:
    def apply(frame: PlannedFrame) -> PlannedFrame:
        path = frame.plan.trajectory
        moved = replace(path, **{name: column(path) for name, column in columns.items()})
        return replace(frame, plan=replace(frame.plan, trajectory=moved))

    return apply


def _overtaken(graph: StGraph) -> StGraph:
    other = replace(graph.obstacles[0], decision=DecisionKind.OVERTAKE)
    return replace(graph, obstacles=(other, *graph.obstacles[1:]))


def _ignored(decision: Decision) -> Decision:
    return replace(decision, kind=DecisionKind.IGNORE)


PLANTED: dict[str, tuple[str, Callable[[PlannedFrame], PlannedFrame], str]] = {
    "agents": (
        "input frame",
        lambda f: replace(f, agents=("car 12", "ped")),
        "agents: truck 40 ",
    ),
    "a prediction": ("prediction", _elsewhere, "y of truck 40 in 4 s 0.00 -> 0.40 m"),
    "a refusal": (
        "contract",
        lambda f: replace(
            f, plan=replace(f.plan, status=PlanStatus.REFUSED, reason="it starts too slowly")
        ),
        "it starts too slowly",
    ),
    "the start": (
        "start of the plan",
        _plan(v=lambda p: np.where(p.t == p.t[0], p.v + 0.5, p.v)),
        "v ",
    ),
    "the reference line": (
        "route",
        inside(SlGraph, lambda g: _corridor(g, first=g.corridor.first + 0.5)),
        "station",
    ),
    "the lane": (
        "lane choice",
        inside(LaneOption, lambda x: replace(x, name="pass")),
        "keep -> pass (now pass 1.00 s",
    ),
    "a side": (
        "path DP",
        inside(SlGraph, lambda g: replace(g, dp=raised(g.dp, 3, 1, 0.5))),
        "offset of the DP",
    ),
    "room": (
        "path DP",
        inside(SlGraph, lambda g: _corridor(g, lower=g.corridor.lower - 0.2)),
        "lower bound",
    ),
    "the path": (
        "path QP",
        inside(SlGraph, lambda g: replace(g, qp=raised(g.qp, 9, 1, 0.3))),
        "offset at station",
    ),
    "the graph": (
        "S-T graph",
        inside(StGraph, lambda g: replace(g, obstacles=())),
        "obstacles: car 12 ",
    ),
    "who goes first": ("speed DP", inside(StGraph, _overtaken), "car 12: follow -> overtake"),
    "a decision": ("speed DP", inside(Decision, _ignored), "car 12: follow -> ignore"),
    "the speed": (
        "speed QP",
        inside(StGraph, lambda g: replace(g, qp=raised(g.qp, 40, 1, -2.0))),
        "station at 4 s",
    ),
    "the plan": ("plan", _plan(x=lambda p: p.x + np.linspace(0.0, 1.0, len(p))), "x in 8 s"),
    "a shorter path": (
        "path QP",
        inside(SlGraph, lambda g: replace(g, qp=g.qp[:-3])),
        "lateral offset ends at",
    ),
    "a shorter, other path": (
        "path QP",
        inside(SlGraph, lambda g: replace(g, qp=raised(g.qp, 9, 1, 0.3)[:-3])),
        "offset at station",
    ),
    "its status": (
        "plan",
        lambda f: replace(f, plan=replace(f.plan, status=PlanStatus.HARD_STOP)),
        "hard stop",
    ),
}

ANY_FRAME = st.integers(0, FRAMES - 1)


@pytest.mark.parametrize("mode", list(Mode))
def test_a_drive_has_no_difference_from_itself(mode: Mode) -> None:
    assert first_difference(drive(mode), drive(mode)) is None


@settings(max_examples=25, deadline=None)
@given(ANY_FRAME, st.sampled_from(list(PLANTED)), st.sampled_from(list(Mode)))
def test_a_change_in_a_frame_is_its_first_difference(k: int, name: str, mode: Mode) -> None:
    stage, change, words = PLANTED[name]
    trace = drive(mode)
    other = changed(trace, k, change)
    found = first_difference(trace, other)
    assert found is not None and (found.t, found.stage) == (trace.frames[k].t, stage)
    assert words in found.what and found.what.startswith(f"t = {found.t:.2f} s, {stage}: ")
    back = first_difference(other, trace)
    assert back is not None and (back.t, back.stage) == (found.t, found.stage)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, FRAMES - 2), st.integers(1, FRAMES), st.booleans())
def test_an_obstacle_that_comes_late_is_not_called_gone(k: int, frames: int, swap: bool) -> None:
    one = two = drive()
    for row in range(k, min(k + frames, FRAMES)):
        two = changed(two, row, PLANTED["the graph"][1])
    found = first_difference(two, one) if swap else first_difference(one, two)
    assert found is not None and found.agent == "car 12" and found.stage == "S-T graph"
    later = drive().frames[k + frames].t if k + frames < FRAMES else None
    word = "earlier" if swap else "later"
    if later is None:
        assert ("is new: in no" if swap else "is gone, now and in all later") in found.what
    else:
        assert f"comes {later - found.t:.2f} s {word} (t = {later:.2f} s)" in found.what


@settings(max_examples=20, deadline=None)
@given(st.sampled_from([SlGraph, StGraph]), st.integers(0, 1), st.floats(0.01, 50.0), st.data())
def test_an_outline_differs_in_a_number_with_axis_unit_and_point(
    kind: type[Graph], column: int, by: float, data: Any
) -> None:
    k = next(
        k
        for k, frame in enumerate(drive().frames)
        for item in frame.plan.internals
        if isinstance(item, kind) and any(len(other.outline) for other in item.obstacles)
    )
    graph = next(item for item in drive().frames[k].plan.internals if isinstance(item, kind))
    which = next(i for i, other in enumerate(graph.obstacles) if len(other.outline))
    outline = graph.obstacles[which].outline
    row = data.draw(st.integers(0, len(outline) - 1))
    moved = replace(graph.obstacles[which], outline=raised(outline, row, column, by))
    others = (*graph.obstacles[:which], moved, *graph.obstacles[which + 1 :])
    two = changed(drive(), k, inside(kind, lambda item: replace(item, obstacles=others)))
    found = first_difference(drive(), two)
    (first_axis, first_unit), second = AXES[kind]
    axis, unit = (first_axis, first_unit) if column == 0 else second
    assert found is not None and found.agent == moved.agent
    assert f"corner at {first_axis} {outline[row, 0]:.4g} {first_unit}: {axis} " in found.what
    assert found.what.endswith(f" {unit}")


@given(st.floats(0.01, 5.0), st.sampled_from(["x", "y", "v"]))
@settings(max_examples=10, deadline=None)
def test_another_start_of_the_plan_comes_before_what_was_planned_from_it(
    by: float, name: str
) -> None:
    """All stages differ, as they do if the planner is given another own speed."""
    two = drive()
    for planted in ("the path", "the speed", "a decision", "room", "the graph"):
        two = changed(two, 0, PLANTED[planted][1])
    two = changed(two, 0, _plan(**{name: lambda p: getattr(p, name) + by}))
    found = first_difference(drive(), two)
    assert found is not None and (found.t, found.stage) == (0.0, "start of the plan")
    assert found.what.startswith(f"t = 0.00 s, start of the plan: {name} ")


@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(ANY_FRAME, st.sampled_from(list(PLANTED))), min_size=2, max_size=4))
def test_the_first_difference_is_first_in_time_then_in_stage(
    planted: list[tuple[int, str]],
) -> None:
    other = drive()
    # last: it leaves nobody to overtake
    for k, name in sorted(planted, key=lambda one: one[1] == "the graph"):
        other = changed(other, k, PLANTED[name][1])
    k, place = min((k, STAGES.index(PLANTED[name][0])) for k, name in planted)
    found = first_difference(drive(), other)
    assert found is not None and (found.t, STAGES.index(found.stage)) == (
        drive().frames[k].t,
        place,
    )


OWN: dict[str, tuple[Callable[[object], object], str]] = {
    "a decision": (
        lambda x: replace(x, kind=DecisionKind.YIELD) if isinstance(x, Decision) else x,
        "truck 40: follow",
    ),
    "a cost": (
        lambda x: replace(x, terms=(("courtesy", 2.0),)) if isinstance(x, CostTerms) else x,
        "cost of courtesy",
    ),
    "candidates": (
        lambda x: replace(x, rejected=(("late", 3),)) if isinstance(x, Candidates) else x,
        "rejected, late",
    ),
}


@settings(max_examples=10, deadline=None)
@given(ANY_FRAME, st.sampled_from(list(OWN)))
def test_a_stage_that_a_planner_names_itself_is_found(k: int, name: str) -> None:
    inner = (
        Decision("truck 40", DecisionKind.FOLLOW, "bargain", "it is ahead"),
        CostTerms("bargain", (("courtesy", 1.0),)),
        Candidates("bargain", 9, (("late", 1),)),
    )
    frames = [replace(frame, plan=replace(frame.plan, internals=inner)) for frame in drive().frames]
    trace = replace(drive(), frames=tuple(frames))
    change, words = OWN[name]
    other = changed(
        trace, k, lambda f: replace(f, plan=replace(f.plan, internals=tuple(map(change, inner))))
    )
    found = first_difference(trace, other)
    assert found is not None and (found.t, found.stage) == (trace.frames[k].t, "bargain")
    assert words in found.what


@settings(max_examples=10, deadline=None)
@given(st.integers(1, ROWS - 1), st.sampled_from(["controller", "vehicle"]))
def test_between_frames_the_controller_and_the_car_act(row: int, stage: str) -> None:
    trace = drive()
    assert trace.commands is not None
    step = np.where(np.arange(ROWS) >= row, 0.2, 0.0)
    other = replace(trace, ego=replace(trace.ego, x=trace.ego.x + step))
    if stage == "controller":
        other = replace(trace, commands=replace(trace.commands, brake=trace.commands.brake + step))
    found = first_difference(trace, other)
    assert found is not None and (found.t, found.stage) == (trace.ego.t[row], stage)


@given(st.floats(0.0, 0.9e-8))
@settings(max_examples=5, deadline=None)
def test_rounding_is_no_difference(size: float) -> None:
    trace = drive()
    assert (
        first_difference(trace, replace(trace, ego=replace(trace.ego, x=trace.ego.x + size)))
        is None
    )


def test_a_small_cause_is_named_and_not_its_larger_effect() -> None:
    """The QP is off by half a millimetre at 1 s; the car is off by 2 mm from 2 s on."""
    small = changed(
        drive(), 10, inside(StGraph, lambda g: replace(g, qp=raised(g.qp, 40, 1, 0.5 * TOLERANCE)))
    )
    assert first_difference(drive(), small) is None
    step = np.where(drive().ego.t >= 2.0, 2.0 * TOLERANCE, 0.0)
    found = first_difference(drive(), replace(small, ego=replace(small.ego, x=small.ego.x + step)))
    assert found is not None and (found.t, found.stage) == (1.0, "speed QP")
    assert found.what.endswith("; more than 0.001 from t = 2.00 s on (vehicle)")


def test_other_positions_of_agents_are_a_difference_of_the_input() -> None:
    trace = drive()
    agents = replace(trace.agents, x=trace.agents.x + np.where(trace.agents.t > 1.05, 0.3, 0.0))
    found = first_difference(trace, replace(trace, agents=agents))
    assert (
        found is not None
        and (found.t, found.stage) == (1.1, "input frame")
        and "x of " in found.what
    )


def test_another_start_is_an_input_and_a_late_plan_the_controllers() -> None:
    trace = drive()
    moved = replace(trace, ego=replace(trace.ego, y=trace.ego.y + 0.1))
    found = first_difference(trace, moved)
    assert (
        found is not None
        and (found.t, found.stage) == (0.0, "input frame")
        and "the ego's y" in found.what
    )
    open_loop = drive(Mode.OPEN)
    moved = replace(
        open_loop, ego=replace(open_loop.ego, y=open_loop.ego.y + 0.1 * (open_loop.ego.t > 0.95))
    )
    found = first_difference(open_loop, moved)
    assert found is not None and (found.t, found.stage) == (1.0, "input frame")


def test_an_earlier_end_is_the_first_difference() -> None:
    trace = drive()
    cut = {name: first(getattr(trace, name), 200) for name in ("ego", "commands")}
    short = replace(
        trace, frames=trace.frames[:20], end=EndReason.COLLISION, detail="car 12", **cut
    )
    found = first_difference(trace, short)
    assert found is not None and (round(found.t, 6), found.stage) == (1.99, "end")
    assert "goal reached: goal region 1 at 3.00 s -> collision: car 12 at 1.99 s" in found.what


def test_a_planner_without_internals_parts_in_its_plan() -> None:
    bare = replace(
        drive(),
        frames=tuple(replace(f, plan=replace(f.plan, internals=())) for f in drive().frames),
    )
    other = changed(drive(), 5, PLANTED["the speed"][1])
    assert first_difference(bare, other) is None
    found = first_difference(bare, changed(other, 7, PLANTED["the plan"][1]))
    assert found is not None and (round(found.t, 6), found.stage) == (0.7, "plan")


def test_plans_at_other_times_part_at_the_first_of_them() -> None:
    trace = drive()
    found = first_difference(trace, replace(trace, frames=trace.frames[::2]))
    assert found is not None and (round(found.t, 6), found.stage) == (0.1, "input frame")
    assert "in the first drive only" in found.what


LOOPS = {Mode.CLOSED: run_closed_loop, Mode.OPEN: run_open_loop}


@cache
def planner_drive(mode: Mode, planner: str = "idm") -> Trace:
    return LOOPS[mode](scenario("everyday/nudge"), planner, keep_internals=True).trace


@pytest.mark.parametrize("mode", LOOPS)
def test_planners_part_finds_nothing_for_equal_drives(mode: Mode) -> None:
    assert planners_part(planner_drive(mode), planner_drive(mode)) is None


@given(st.integers(1, 100), st.floats(-3.0, 3.0), st.floats(-1.5, 1.5))
def test_the_first_frame_beyond_a_bound_is_found(k: int, faster: float, aside: float) -> None:
    one = planner_drive(Mode.CLOSED)
    ego, since = one.ego, one.ego.t >= one.frames[k].t - 1e-9
    moved = replace(
        ego,
        v=ego.v + faster * since,
        x=ego.x - aside * np.sin(ego.yaw) * since,
        y=ego.y + aside * np.cos(ego.yaw) * since,
    )
    found = planners_part(one, replace(one, ego=moved))
    if abs(faster) > PARTED_MPS + 1e-6 or abs(aside) > PARTED_M + 1e-6:
        assert found is not None and found.t == one.frames[k].t
        assert ("to the left" in found.what) == (aside > PARTED_M + 1e-6) or abs(
            abs(aside) - PARTED_M
        ) < 1e-5
    elif abs(faster) < PARTED_MPS - 1e-6 and abs(aside) < PARTED_M - 1e-6:
        assert found is None


@pytest.mark.parametrize("mode", LOOPS)
def test_planners_part_states_the_decision_of_each_planner(mode: Mode) -> None:
    found = planners_part(planner_drive(mode), planner_drive(mode, "dp_qp"))
    assert (
        found is not None
        and "(stop parked) -> " in found.what
        and "(nudge left parked)" in found.what
    )
    assert (f"in {AHEAD_S:g} s" in found.what) == (mode is Mode.OPEN)
