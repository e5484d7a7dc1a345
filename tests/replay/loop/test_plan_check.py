from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest
from drives import along, grid, scenario
from hypothesis import given, strategies as st

from replan.logs.catalogue import CATALOGUE
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Plan, PlanStart, PlanStatus
from replan.logs.road import Road
from replan.logs.states import EgoState, Trajectory, wrapped
from replan.logs.tracks import Tracks
from replan.planners.constant_speed import arc
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop.plan_check import checked, of_positions
from replan.replay.loop_config import LoopConfig, PlannerProcessConfig
from replan.replay.planner_process.messages import LONGEST_REASON, MOST_POINTS
from replan.replay.prediction import predict

AHEAD = 0.1 * np.arange(51)
NOBODY = Tracks.empty().perceived(0.0)


def ego(v: float = 10.0, kappa: float = 0.0, yaw: float = 0.3) -> EgoState:
    return EgoState(2.0, 5.0, -3.0, yaw, v, 0.0, kappa)


def frame(state: EgoState, previous: Plan | None = None) -> Frame:
    return Frame(state.t, state, NOBODY, predict(NOBODY, state.t, horizon=1.0, step=0.5), previous)


def arcs(state: EgoState) -> Trajectory:
    return arc(state, state.t + AHEAD)


STATES = st.builds(ego, st.floats(-3.0, 30.0), st.floats(-0.02, 0.02), st.floats(-7.0, 7.0))


@given(STATES)
def test_a_plan_that_is_what_it_says_passes_untouched(state: EgoState) -> None:
    plan = Plan(arcs(state))
    assert checked(plan, frame(state)) is plan


@given(STATES)
def test_the_columns_follow_from_the_positions(state: EgoState) -> None:
    """A chord is shorter than its arc by (kappa step)^2 / 24, at most 1.5e-4 here."""
    plan = arcs(state)
    derived = of_positions(plan)
    assert np.allclose(derived.v, plan.v, atol=0.02)
    if abs(state.v) > 2.0:
        assert np.allclose(derived.kappa, plan.kappa, rtol=2e-4, atol=1e-6)
        assert np.allclose(wrapped(derived.yaw - plan.yaw)[1:-1], 0.0, atol=1e-6)


@pytest.mark.parametrize("step", [5e-324, 1e-300, 1e-12])
def test_a_plan_of_states_at_one_time_is_refused(step: float) -> None:
    """Also where it moves so far within that time that its speed overflows."""
    plan = arcs(ego())
    times = plan.t.copy()
    times[:2] = 0.0, step
    for x in (plan.x, np.where(plan.t > 0.0, 1e300, plan.x)):
        refused = checked(Plan(replace(plan, t=times, x=x)), frame(ego()))
        assert refused.status is PlanStatus.REFUSED
        assert f"its states are {step:.1e} s apart, less than 1e-10 s" in refused.reason


def test_a_plan_that_is_too_fast_for_its_columns_is_refused() -> None:
    plan = arcs(ego())
    sides = np.where(np.arange(len(plan)) % 2, 1e308, -1e308)
    sides[0] = plan.y[0]
    refused = checked(Plan(replace(plan, y=sides)), frame(ego()))
    assert refused.status is PlanStatus.REFUSED
    assert "it asks for inf m/s" in refused.reason


@pytest.mark.parametrize("states", [MOST_POINTS, MOST_POINTS + 1, 1_000_000])
def test_a_plan_of_too_many_states_is_refused_with_its_size(states: int) -> None:
    plan = checked(Plan(arc(ego(), ego().t + np.linspace(0.0, 8.0, states))), frame(ego()))
    if states <= MOST_POINTS:
        assert plan.status is PlanStatus.PLANNED
    else:
        assert plan.status is PlanStatus.REFUSED
        assert f"it has {states} states, more than {MOST_POINTS}" in plan.reason
        assert len(plan.trajectory) < 100


def test_a_reason_without_end_is_cut_and_marked() -> None:
    plan = checked(Plan(arcs(ego()), PlanStatus.PREVIOUS, "x" * 50_000_000), frame(ego()))
    assert (plan.status, len(plan.reason)) == (PlanStatus.PREVIOUS, LONGEST_REASON)
    assert plan.reason.endswith("xxx ... (cut, 50000000 characters)")
    longest = replace(plan, reason="x" * LONGEST_REASON)
    assert checked(longest, frame(ego())) is longest


LIES: dict[str, Callable[[Trajectory], Trajectory]] = {
    "speed": lambda t: replace(t, v=t.v + np.where(t.t > t.t[0], 3.0, 0.0)),
    "heading": lambda t: replace(t, yaw=t.yaw + 0.2),
    "curvature": lambda t: replace(t, kappa=t.kappa + 0.05),
    "acceleration": lambda t: replace(t, a=t.a + 3.0),
}


@pytest.mark.parametrize("column", LIES)
def test_a_false_column_is_computed_anew_and_marked(column: str) -> None:
    state = ego(kappa=0.01)
    plan = checked(Plan(LIES[column](arcs(state))), frame(state))
    assert plan.status is PlanStatus.CORRECTED
    assert not plan.status.is_fallback
    assert f"its {column} is" in plan.reason
    for name in ("v", "kappa", "a"):
        assert np.allclose(getattr(plan.trajectory, name), getattr(arcs(state), name), atol=0.02)


def test_a_zigzag_that_declares_no_curvature_is_judged_by_its_curvature() -> None:
    state = ego(yaw=0.0)
    straight = arcs(state)
    zigzag = replace(straight, y=straight.y + 2.0 * np.sin(0.5 * np.pi * (straight.t - 2.0)) ** 3)
    plan = checked(Plan(zigzag), frame(state))
    assert plan.status is PlanStatus.CORRECTED
    assert np.abs(plan.trajectory.v**2 * plan.trajectory.kappa).max() > 5.0


def far_off(t: Trajectory) -> Trajectory:
    """Starts 0.45 m ahead of the ego."""
    return replace(t, x=t.x + 0.45)


@pytest.mark.parametrize(
    ("bend", "why"),
    [
        (far_off, "starts 0.45 m from the ego"),
        (
            lambda t: replace(t, v=t.v + 3.0, x=t.x + 3.0 * (t.t - t.t[0])),
            "starts at 13.0 m/s, the ego drives 10.0 m/s",
        ),
        (lambda t: replace(t, x=t.x + 1e6 * (t.t - t.t[0]) / 5.0), "asks for 2000"),
        (lambda t: replace(t, y=t.y + (np.arange(len(t)) % 2)), "asks for an acceleration of"),
    ],
)
def test_a_plan_that_cannot_be_driven_is_refused_with_the_reason(
    bend: Callable[[Trajectory], Trajectory], why: str
) -> None:
    state = ego(yaw=0.0)
    plan = checked(Plan(bend(arcs(state))), frame(state))
    assert plan.status is PlanStatus.REFUSED
    assert plan.status.is_fallback
    assert why in plan.reason


def test_the_rest_of_the_previous_plan_replaces_a_refused_one() -> None:
    state = ego(yaw=0.0)
    before = Plan(arcs(replace(arcs(state).state(0), t=1.9, x=state.x - 1.0)))
    plan = checked(Plan(far_off(arcs(state))), frame(state, before))
    assert plan.start is PlanStart.PREVIOUS_PLAN
    assert np.allclose(plan.trajectory.x, before.trajectory.x[1:])


def test_a_stop_replaces_a_refused_first_plan_and_is_itself_accepted() -> None:
    state, decel = ego(v=10.0, yaw=0.0), 4.0
    stop = checked(Plan(far_off(arcs(state))), frame(state))
    assert stop.trajectory.v[-1] == 0.0
    assert stop.trajectory.x[-1] == pytest.approx(state.x + state.v**2 / (2.0 * decel))
    again = checked(replace(stop, status=PlanStatus.PLANNED, reason=""), frame(state))
    assert again.status is PlanStatus.PLANNED


def test_a_plan_may_start_on_the_plan_being_driven_where_that_is_near() -> None:
    state = ego(yaw=0.0)
    before = Plan(replace(arcs(state), y=arcs(state).y + 0.4))
    plan = Plan(before.trajectory, start=PlanStart.PREVIOUS_PLAN)
    assert checked(plan, frame(state, before)) is plan
    far = Plan(replace(arcs(state), y=arcs(state).y + 1.4))
    assert checked(far, frame(state, far)).status is PlanStatus.REFUSED


@pytest.mark.slow
@pytest.mark.parametrize("planner", ["dp_qp", "idm", "lattice", "pdm", "constant_speed"])
def test_plans_of_built_in_planners_are_never_refused(planner: str) -> None:
    for name in ("everyday/nudge", "everyday/cut_in"):
        log = CATALOGUE[name].scenario()
        for run in (run_open_loop, run_closed_loop):
            statuses = {frame.plan.status for frame in run(log, planner).trace.frames}
            assert not statuses & {PlanStatus.REFUSED, PlanStatus.CORRECTED}


class KeepsRoads:
    roads: ClassVar[list[Road]] = []

    def __init__(self, context: PlannerContext) -> None:
        self.roads.append(context.road)

    def plan(self, now: Frame) -> Plan:
        return Plan(arc(now.ego, now.t + AHEAD))


def test_each_loop_hands_its_planner_a_copy_of_the_road() -> None:
    log = scenario(along(grid(1.0), 10.0))
    KeepsRoads.roads.clear()
    for run in (run_open_loop, run_closed_loop):
        trusted = LoopConfig(apart=PlannerProcessConfig(trust=True))
        run(log, f"{__name__}:KeepsRoads", config=trusted)
    roads = [log.road, *KeepsRoads.roads]
    assert len({id(road) for road in roads}) == 3
    lanes = [id(lane) for road in roads for lane in road.lanes.values()]
    assert len(set(lanes)) == len(lanes)


@pytest.mark.parametrize(("speed", "fits"), [(-0.096, True), (-0.29, True), (-0.4, False)])
def test_a_plan_may_start_at_rest_where_the_speed_of_a_stop_swings_below_zero(
    speed: float, fits: bool
) -> None:
    state = ego(v=speed)
    plan = checked(Plan(arcs(replace(state, v=0.0))), frame(state))
    assert (plan.status is not PlanStatus.REFUSED) is fits
