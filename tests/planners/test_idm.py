"""IDM: its equilibrium, its order, and how it drives behind, before and among others."""

import numpy as np
import pytest
from followed import Drive, decided, followed, gaps
from hypothesis import given, strategies as st
from roads import along_x, beside, lanes, strip
from scenes import CAR, Other, driving, frame, standing

from replan.logs.frame import PlannerContext
from replan.logs.plan import DecisionKind, PlanStart, StGraph
from replan.logs.road import Goal, Road
from replan.logs.states import EgoState
from replan.planners.idm import Idm, IdmConfig, idm_acceleration

A, B, TAU, S0 = (
    IdmConfig().accel_mps2,
    IdmConfig().decel_mps2,
    IdmConfig().time_gap_s,
    IdmConfig().standstill_gap_m,
)


def idm(road: Road, ego: EgoState, goal: Goal | None = None) -> Idm:
    return Idm(PlannerContext(road, goal, CAR, 0.1, ego))


def drives(road: Road, ego: EgoState, *others: Other, seconds: float) -> Drive:
    return followed(road, ego, others, seconds=seconds, build=idm)


@given(st.floats(0.0, 0.98), st.floats(2.0, 40.0))
def test_in_equilibrium_nothing_accelerates(share: float, v0: float) -> None:
    v = share * v0
    gap = (S0 + v * TAU) / np.sqrt(1.0 - share**4)
    assert idm_acceleration(v, v0, 0.0, gap, v, A, B, TAU, S0) == pytest.approx(0.0, abs=1e-9)


@given(
    st.floats(0.0, 40.0),
    st.floats(2.0, 40.0),
    st.floats(0.5, 200.0),
    st.floats(0.0, 40.0),
    st.floats(0.01, 20.0),
)
def test_less_room_or_a_slower_leader_never_accelerate(
    v: float, v0: float, gap: float, lead: float, more: float
) -> None:
    here = idm_acceleration(v, v0, 0.0, gap, lead, A, B, TAU, S0)
    assert idm_acceleration(v, v0, 0.0, gap + more, lead, A, B, TAU, S0) >= here
    assert idm_acceleration(v, v0, 0.0, gap, lead + more, A, B, TAU, S0) >= here - 1e-9
    assert idm_acceleration(v, v0 + more, 0.0, gap, lead, A, B, TAU, S0) >= here - 1e-9
    assert here <= A


@given(st.floats(0.5, 40.0))
def test_the_free_terms_below_and_above_the_wanted_speed_join(v0: float) -> None:
    below, above = (
        idm_acceleration(v, v0, 0.0, np.inf, 0.0, A, B, TAU, S0)
        for v in (v0 * (1 - 1e-9), v0 * (1 + 1e-9))
    )
    assert below == pytest.approx(above, abs=1e-6)


def test_the_ego_stops_before_a_standing_agent_and_records_it() -> None:
    drive = drives(
        lanes(along_x()),
        EgoState(0.0, 0.0, 0.0, 0.0, 12.0),
        standing("parked", 90.0, 0.8),
        seconds=30.0,
    )
    assert 1.0 < gaps(drive, "parked")[-1] < 3.5
    assert drive[-1][0].ego.v < 0.1
    assert decided(drive[50][1], "parked", "speed") is DecisionKind.STOP
    assert min(plan.trajectory.a.min() for _, plan in drive) > -4.0


def test_followers_and_agents_beside_are_no_leaders() -> None:
    points = along_x()
    road = Road(
        {0: strip(0, points, left_neighbour=1), 1: strip(1, beside(points, 3.5), right_neighbour=0)}
    )
    others = (driving("behind", -15.0, 0.0, 14.0), driving("beside", 3.0, 3.5, 10.0))
    drive = drives(road, EgoState(0.0, 0.0, 0.0, 0.0, 10.0), *others, seconds=3.0)
    assert min(plan.trajectory.a.min() for _, plan in drive) > -0.5
    assert all(
        decided(plan, name, "speed") is None for _, plan in drive for name in ("behind", "beside")
    )


def test_the_ego_returns_smoothly_from_an_offset() -> None:
    drive = drives(lanes(along_x()), EgoState(0.0, 0.0, 1.2, 0.05, 10.0), seconds=14.0)
    offset = np.array([now.ego.y for now, _ in drive])
    assert abs(offset[-1]) < 0.05
    assert offset.max() < 1.6
    assert max(abs(plan.trajectory.kappa[0]) for _, plan in drive) < 0.03
    assert all(plan.start is PlanStart.PREVIOUS_PLAN for _, plan in drive[1:])


def test_the_graph_holds_the_leader_and_the_profile() -> None:
    ego = EgoState(0.0, 0.0, 0.0, 0.0, 10.0)
    plan = idm(lanes(along_x()), ego).plan(frame(ego, [driving("lead", 30.0, 0.0, 6.0)]))
    graph = next(item for item in plan.internals if isinstance(item, StGraph))
    assert [obstacle.agent for obstacle in graph.obstacles] == ["lead"]
    assert graph.corridor is not None
    assert (graph.qp[:, 1] <= graph.corridor.upper + 1e-6).all()
