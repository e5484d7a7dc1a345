"""Who goes slowly along the lane is passed with room where there is some, and followed where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from handmade import track, tracks
from hypothesis import given
from hypothesis import strategies as st
from worlds import CAR, Other, along_x, frame, lanes

from logs import AgentKind, EgoState, Road, Scenario, Trajectory
from logs.trace import EndReason, Trace
from planners.dp_qp.reference_line import make_course
from planners.dp_qp.route import find_route
from planners.dp_qp.slower import ASIDE_M, CLOSING_MPS, slower
from replay.closed_loop import run_closed_loop

LENGTH, WIDTH = 1.8, 0.6
EGO = EgoState(0.0, 20.0, 0.0, 0.0, 10.0, 0.0, 0.0)
ROAD = lanes(along_x(0.0, 600.0))
COURSE = make_course(ROAD, find_route(ROAD, EGO, None), EGO, CAR)


def rider(x: float, y: float, vx: float, vy: float = 0.0, kind: AgentKind = AgentKind.BICYCLE) -> Other:
    yaw = float(np.arctan2(vy, vx))
    return Other("rider", lambda t: (x + vx * t, y + vy * t, yaw, vx, vy), kind, LENGTH, WIDTH)


def boxes(who: Other, v: float) -> list[tuple[float, float, float, float]]:
    """Those of an ego at x = 20 m, in world coordinates."""
    at = COURSE.line.project(EGO.x, 0.0)[0]
    found = slower(COURSE, frame(EGO, [who]), at, v, CAR)
    return [(box.s_from - at + EGO.x, box.s_to - at + EGO.x, box.l_from, box.l_to) for box in found]


@given(st.floats(5.0, 80.0), st.floats(0.6, 6.5), st.floats(0.5, 14.0), st.floats(-1.2, 1.2))
def test_the_box_holds_him_as_long_as_the_ego_is_beside_him(ahead: float, u: float, more: float, y: float) -> None:
    v = u + more
    x = EGO.x + CAR.axle_to_front + ahead + 0.5 * LENGTH
    for s_from, s_to, l_from, l_to in boxes(rider(x, y, u), v):
        assert (l_from, l_to) == pytest.approx((y - 0.5 * WIDTH - ASIDE_M, y + 0.5 * WIDTH + ASIDE_M), abs=1e-3)
        t = np.arange(0.0, 60.0, 0.05)
        ego = EGO.x + max(v, u + CLOSING_MPS) * t
        rear, front = x + u * t - 0.5 * LENGTH, x + u * t + 0.5 * LENGTH
        beside = (ego + CAR.axle_to_front > rear) & (ego - CAR.rear_overhang < front)
        assert beside.any() and rear[beside].min() > s_from - 0.1 and front[beside].max() < s_to + 0.1


@pytest.mark.parametrize(
    "who",
    [
        rider(60.0, 0.0, 0.0),
        rider(60.0, 0.0, 9.0),
        rider(60.0, -1.0, 0.2, 1.2),
        rider(60.0, 0.0, -3.0),
        rider(60.0, 0.0, 3.0, kind=AgentKind.CAR),
        rider(60.0, 3.2, 3.0),
        rider(10.0, 0.0, 3.0),
    ],
    ids=["stands", "fast", "crosses", "oncoming", "car", "beside the lane", "behind"],
)
def test_who_is_not_meant(who: Other) -> None:
    assert boxes(who, 10.0) == []


def drive(road: Road, y: float, u: float = 4.0) -> tuple[Trace, float, float]:
    """12 s at 12 m/s towards a rider 40 m ahead: the drive, how far before him it ends, the room beside him."""
    t = np.arange(0.0, 12.05, 0.1)
    who = track(
        "rider", t.tolist(), (40.0 + u * t).tolist(), np.full(len(t), y).tolist(),
        yaw=0.0, vx=u, vy=0.0, kind=AgentKind.BICYCLE, length=LENGTH, width=WIDTH,
    )  # fmt: skip
    ego = Trajectory(*(np.array([value]) for value in (0.0, 0.0, 0.0, 0.0, 12.0, 0.0, 0.0)))
    trace = run_closed_loop(Scenario("rider", ego, tracks(who), road, 12.0, vehicle=CAR), "dp_qp").trace
    ego, x = trace.ego, 40.0 + u * trace.ego.t
    beside = (ego.x + CAR.axle_to_front > x - 0.5 * LENGTH) & (ego.x - CAR.rear_overhang < x + 0.5 * LENGTH)
    room = np.abs(ego.y - y)[beside].min(initial=np.inf) - 0.5 * (CAR.width + WIDTH)
    return trace, float(ego.x[-1] - CAR.rear_overhang - x[-1]), float(room)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_in_a_wide_lane_he_is_passed_with_room_and_without_braking(side: float) -> None:
    trace, before, room = drive(lanes(along_x(-20.0, 400.0), width=5.5), 1.6 * side)
    assert before > 10.0 and room > 1.4
    assert trace.ego.v.min() > 11.5 and np.abs(trace.ego.v**2 * trace.ego.kappa).max() < 2.0


def test_a_free_lane_beside_is_borrowed_for_him() -> None:
    trace, before, room = drive(lanes(along_x(-20.0, 400.0), 2), -0.8)
    assert before > 10.0 and room > 1.4 and trace.ego.y.max() < 3.0


def test_in_a_narrow_lane_he_is_followed() -> None:
    trace, before, room = drive(lanes(along_x(-20.0, 400.0)), -1.2)
    assert trace.end is EndReason.END_OF_LOG and before < -5.0 and np.isinf(room)
    assert np.abs(trace.ego.y).max() < 0.1
