"""Who goes slowly along the lane is passed with room, at a speed that goes with it.

Where there is none, followed.
"""

from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
import pytest
from cap_views import limit_of, view
from handmade import track, tracks
from hypothesis import given, settings, strategies as st
from roads import along_x, lanes, two_way
from scenes import CAR, Other, driving, reference, scene

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.frame import Visibility
from replan.logs.plan import Candidates
from replan.logs.road import Road
from replan.logs.rules import Colour, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState, Trajectory
from replan.logs.trace import EndReason, Trace
from replan.planners.dp_qp.path.bounds import CorridorConfig
from replan.planners.dp_qp.path.passing import (
    ASIDE_M,
    NEAR_M,
    SPARE_S,
    find_slow_agents,
    free_stations,
    obstacles_to_pass,
    pass_targets,
)
from replan.planners.dp_qp.planner import endangered
from replan.planners.dp_qp.speed.caps import LEAST_MPS, REACTION_S, CautionConfig, passing_caps
from replan.planners.frenet.path import make_path
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import LoopConfig

LENGTH, WIDTH = 1.8, 0.6
EGO = EgoState(0.0, 20.0, 0.0, 0.0, 10.0, 0.0, 0.0)
ROAD = lanes(along_x(0.0, 600.0))
COURSE = reference(ROAD, ego=EGO)
AT = COURSE.line.project(EGO.x, 0.0)[0]
BRAKE = 6.4
WALK_MPS = CautionConfig().walk_mps


def goer(
    x: float, y: float, vx: float, vy: float = 0.0, kind: AgentKind = AgentKind.BICYCLE
) -> Other:
    yaw = float(np.arctan2(vy, vx))
    return Other("goer", lambda t: (x + vx * t, y + vy * t, yaw, vx, vy), kind, LENGTH, WIDTH)


# who, where, how fast


@pytest.mark.parametrize(
    "who",
    [
        goer(60.0, 0.0, 0.0),
        goer(60.0, 0.0, 9.0),
        goer(60.0, -1.0, 0.2, 1.2),
        goer(60.0, 0.0, -3.0),
        goer(60.0, 0.0, 3.0, kind=AgentKind.CAR),
        goer(60.0, 0.0, 3.0, kind=AgentKind.MOTORCYCLE),
        goer(60.0, 3.2, 3.0),
        goer(10.0, 0.0, 3.0),
    ],
    ids=["stands", "fast", "crosses", "oncoming", "car", "motorcycle", "beside the road", "behind"],
)
def test_only_slow_agents_along_the_lane_are_passed(who: Other) -> None:
    assert find_slow_agents(scene(COURSE, EGO, [who])) == []


@given(
    st.floats(3.0, 50.0),
    st.floats(0.6, 6.5),
    st.floats(2.5, 14.0),
    st.floats(-1.2, 1.2),
    st.floats(-0.1, 0.1),
)
def test_the_box_holds_the_agent_while_the_ego_is_beside_it(
    ahead: float, u: float, more: float, y: float, aside: float
) -> None:
    x = EGO.x + CAR.axle_to_front + ahead + 0.5 * LENGTH
    now = scene(COURSE, EGO, [goer(x, y, u, aside * u)])
    t = now.frame.predictions.t
    stations = free_stations(t, AT, u + more, u + more)
    found = pass_targets(now, find_slow_agents(now), stations)
    rear, front = (x + u * t + sign * 0.5 * LENGTH for sign in (-1.0, 1.0))
    ego = stations - AT + EGO.x
    beside = (ego + CAR.axle_to_front > rear) & (ego - CAR.rear_overhang < front)
    if not found:
        late = t > t[-1] - SPARE_S - 0.2
        assert not beside.any() or (ego - CAR.rear_overhang < front + 0.2)[late].any()
        return
    (one,) = found
    box, offset = one.box, y + aside * u * t[beside]
    assert (
        box.s_from - AT + EGO.x <= rear[beside].min() + 0.2
        and box.s_to - AT + EGO.x >= front[beside].max() - 0.2
    )
    assert box.l_from <= min(offset.min(), y) - 0.5 * WIDTH - ASIDE_M + 0.02
    assert box.l_to >= max(offset.max(), y) + 0.5 * WIDTH + ASIDE_M - 0.02
    assert one.begin - AT <= ahead + u * t[beside][0] + NEAR_M + 1.0


def test_an_agent_is_passed_within_the_predictions_or_not_at_all() -> None:
    now = scene(COURSE, EGO, [goer(60.0, 0.0, 6.5)])
    assert pass_targets(now, [0], free_stations(now.frame.predictions.t, AT, 7.0, 7.0)) == ()


@given(st.floats(1.0, 3.0), st.sampled_from([AgentKind.BICYCLE, AgentKind.PEDESTRIAN]))
def test_more_room_permits_more_speed_and_only_beside_the_agent(
    room: float, kind: AgentKind
) -> None:
    """Who comes into the way with w is passed, or the ego stops before them: wherever it is when
    they do.
    """
    y = -room - 0.5 * (CAR.width + WIDTH)
    now = scene(
        COURSE,
        EGO,
        [Other("goer", lambda t: (50.0 + 2.0 * t, y, 0.0, 2.0, 0.0), kind, LENGTH, WIDTH)],
    )
    found = pass_targets(now, [0], free_stations(now.frame.predictions.t, AT, 10.0, 10.0))
    path = make_path(COURSE.line, AT, 1.0, np.zeros((3, 150)))
    limit = np.full(len(path.s), 60.0)
    seen = view(now, path, limit=limit, targets=found, hard_mps2=BRAKE, margin_m=0.6)
    lowered = limit_of(seen, passing_caps).v
    v = float(lowered.min())
    w = WALK_MPS if kind is AgentKind.PEDESTRIAN else CautionConfig().ride_mps
    assert v == pytest.approx(max(2.0 * BRAKE * (room / w - REACTION_S), LEAST_MPS), rel=0.02)
    slow = path.s[lowered < 60.0]
    stop = v * REACTION_S + v * v / (2.0 * BRAKE)
    if v < 60.0:
        assert slow.min() == pytest.approx(max(found[0].begin - stop, AT), abs=0.6)
        assert slow.max() == pytest.approx(found[0].end + NEAR_M, abs=0.6)
        # As far before them, at v: past in time, or stopped in time
        for x in np.linspace(0.0, stop, 50):
            assert (
                x <= v * room / w + 1e-9
                or v * REACTION_S + v * v / (2.0 * BRAKE) <= x + 1e-9
                or v == LEAST_MPS
            )
    near = limit_of(replace(seen, margin_m=room + 0.1), passing_caps).v
    assert (near == limit).all()  # an agent nearer to the path than the margin is followed


# drives


@dataclass(frozen=True)
class Passed:
    """A drive; how far before each goer it ends; the least room beside any."""

    trace: Trace
    before: float
    room: float


def moving(
    name: str,
    x: float,
    y: float,
    u: float,
    kind: AgentKind,
    length: float,
    width: float,
    seconds: float,
) -> object:
    t = np.arange(0.0, seconds + 0.05, 0.1)
    yaw = 0.0 if u > 0.0 else np.pi
    return track(
        name,
        t.tolist(),
        (x + u * t).tolist(),
        np.full(len(t), y).tolist(),
        yaw=yaw,
        vx=u,
        vy=0.0,
        kind=kind,
        length=length,
        width=width,
    )


def drive(
    road: Road,
    goers: list[tuple[float, float, float]],
    *,
    v: float = 9.0,
    seconds: float = 14.0,
    kind: AgentKind = AgentKind.BICYCLE,
    cars: tuple[tuple[float, float, float], ...] = (),
    config: LoopConfig | None = None,
    lights: tuple[TrafficLight, ...] = (),
) -> Passed:
    """A drive from the origin among goers and cars (x, y, speed)."""
    those = [moving(f"goer{i}", *one, kind, LENGTH, WIDTH, seconds) for i, one in enumerate(goers)]
    those += [
        moving(f"car{i}", *one, AgentKind.CAR, 4.5, 1.8, seconds) for i, one in enumerate(cars)
    ]
    ego = Trajectory(*(np.array([value]) for value in (0.0, 0.0, 0.0, 0.0, v, 0.0, 0.0)))
    log = Scenario("goers", ego, tracks(*those), road, seconds, vehicle=CAR, lights=lights)
    trace = run_closed_loop(log, "dp_qp", config=config or LoopConfig()).trace
    room, before = np.inf, np.inf
    for x, y, u in goers:
        at = x + u * trace.ego.t
        rear, front = trace.ego.x - CAR.rear_overhang, trace.ego.x + CAR.axle_to_front
        beside = (front > at - 0.5 * LENGTH) & (rear < at + 0.5 * LENGTH)
        room = min(
            room,
            float(np.abs(trace.ego.y - y)[beside].min(initial=np.inf)) - 0.5 * (CAR.width + WIDTH),
        )
        before = min(before, float(rear[-1] - at[-1]))
    return Passed(trace, before, room)


def hardest(trace: Trace) -> tuple[float, float]:
    """Deceleration and lateral acceleration, m/s2."""
    v: FloatArray = trace.ego.v
    return -float(trace.ego.a.min()), float(np.abs(v**2 * trace.ego.kappa).max())


@pytest.mark.parametrize("side", [-1.0, pytest.param(1.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "kind", [AgentKind.BICYCLE, pytest.param(AgentKind.PEDESTRIAN, marks=pytest.mark.slow)]
)
def test_agents_in_a_wide_lane_are_passed_with_room(side: float, kind: AgentKind) -> None:
    u = 4.0 if kind is AgentKind.BICYCLE else 1.3
    found = drive(lanes(along_x(-20.0, 400.0), width=5.5), [(40.0, 1.6 * side, u)], kind=kind)
    assert found.before > 10.0 and found.room > 1.4
    decel, lateral = hardest(found.trace)
    assert decel < 2.0 and lateral < 2.5
    if kind is AgentKind.BICYCLE:
        assert found.trace.ego.v.min() > 8.5


def test_a_free_neighbouring_lane_is_borrowed_and_recorded() -> None:
    found = drive(lanes(along_x(-20.0, 400.0), 2), [(40.0, -0.8, 4.0)])
    assert found.before > 10.0 and found.room > 1.4 and found.trace.ego.y.max() < 3.0
    assert "pass" in choices(found.trace)


@pytest.mark.slow
def test_agents_are_followed_until_oncoming_traffic_has_gone() -> None:
    found = drive(
        two_way(),
        [(40.0, -1.0, 3.0)],
        seconds=26.0,
        cars=((120.0, 3.5, -10.0), (160.0, 3.5, -10.0)),
    )
    assert found.before > 5.0 and found.room > 1.4
    assert found.trace.end is EndReason.END_OF_LOG
    assert found.trace.ego.v.min() < 6.0
    met = found.trace.ego.t[np.argmax(found.trace.ego.x > 160.0 - 10.0 * found.trace.ego.t)]
    assert np.abs(found.trace.ego.y[found.trace.ego.t < met]).max() < 0.9


@pytest.mark.parametrize(("reach", "free"), [(60.0, False), (300.0, True), (np.inf, True)])
def test_the_facing_lane_must_be_seen_as_far_as_traffic_may_come_from(
    reach: float, free: bool
) -> None:
    road = two_way()
    sight = (
        None
        if np.isinf(reach)
        else Visibility(EGO.x, 0.0, 0.0, reach, 2.0 * np.pi, np.empty((0, 4, 2)))
    )
    now = scene(reference(road, ego=EGO, lane=0), EGO, [goer(45.0, -1.0, 3.0)], seen=sight)
    stations = free_stations(now.frame.predictions.t, now.s, 9.0, 10.0)
    way = obstacles_to_pass(
        now, pass_targets(now, [0], stations), stations, (True, False), CorridorConfig(), ()
    )
    assert len(way.obstacles) == 1 and way.facing == (frozenset({"goer"}) if free else frozenset())


def choices(trace: Trace) -> list[str]:
    """Frame by frame "pass" or "keep"; empty: there is no agent to pass."""
    of_frames = []
    for frame in trace.frames:
        passing = [
            item.chosen
            for item in frame.plan.internals
            if isinstance(item, Candidates) and item.stage == "passing"
        ]
        of_frames.append("".join(passing))
    return of_frames


@pytest.mark.parametrize(
    ("road", "goers", "v"),
    [
        (lanes(along_x(-20.0, 500.0), 2), [(30.0, -1.8, 4.0)], 10.0),
        pytest.param(
            lanes(along_x(-20.0, 500.0), 2), [(40.0, 1.8, 4.0)], 9.0, marks=pytest.mark.slow
        ),
        pytest.param(two_way(crossable=False), [(25.0, -1.75, 3.0)], 9.0, marks=pytest.mark.slow),
        pytest.param(
            two_way(), [(30.0, -1.0, 1.2), (48.0, -0.6, 1.3)], 9.0, marks=pytest.mark.slow
        ),
        pytest.param(two_way(), [(12.0, -0.8, 1.3)], 1.0, marks=pytest.mark.slow),
        (two_way(), [(8.0, -0.8, 1.3)], 0.0),
    ],
    ids=[
        "at the edge",
        "at the left edge",
        "room in the lane",
        "one after the other",
        "walking pace",
        "standing",
    ],
)
def test_an_agent_is_passed_once(
    road: Road, goers: list[tuple[float, float, float]], v: float
) -> None:
    found = drive(road, goers, v=v, seconds=20.0)
    assert found.before > 5.0 and found.room > 1.15
    assert hardest(found.trace)[0] < 2.0
    passes = [choice for choice, _ in groupby(choices(found.trace)) if choice == "pass"]
    assert len(passes) <= len(goers)


@pytest.mark.parametrize(
    "rule", [{"light": 1}, {"must_stop": True}], ids=["red light", "stop sign"]
)
def test_no_agent_is_passed_near_a_waiting_place(rule: dict[str, object]) -> None:
    mark = StopLine(7, 0, np.array([[80.0, -1.75], [80.0, 1.75]]), **rule)  # type: ignore[arg-type]
    red = TrafficLight(1, np.array([0.0]), (Colour.RED,))
    found = drive(replace(two_way(), stop_lines=(mark,)), [(35.0, -1.0, 3.0)], lights=(red,))
    assert np.abs(found.trace.ego.y).max() < 0.1 and hardest(found.trace)[0] < 2.0
    assert found.trace.ego.x[-1] < 80.0


@pytest.mark.slow
def test_a_solid_marking_is_not_crossed_and_a_narrow_lane_has_no_room() -> None:
    for road in (two_way(crossable=False), lanes(along_x(-20.0, 400.0))):
        found = drive(road, [(40.0, -1.2, 4.0)])
        assert (
            found.trace.end is EndReason.END_OF_LOG and found.before < -5.0 and np.isinf(found.room)
        )
        assert np.abs(found.trace.ego.y).max() < 0.1


def test_a_follower_in_the_neighbouring_lane_need_not_brake_hard() -> None:
    """A faster car that is nearly beside goes first; the ego waits behind the rider for it."""
    found = drive(lanes(along_x(-20.0, 400.0), 2), [(35.0, -0.8, 4.0)], cars=((-8.0, 3.5, 12.0),))
    y = found.trace.ego.y[
        found.trace.ego.x + CAR.axle_to_front > -8.0 - 2.25 + 12.0 * found.trace.ego.t - 2.0
    ]
    assert np.abs(y).max(initial=0.0) < 0.9
    assert found.before > 5.0 and found.room > 1.0


@pytest.mark.slow
@settings(max_examples=12, deadline=None)
@given(st.floats(-2.3, -1.2), st.floats(1.2, 2.3), st.floats(-5.0, 25.0), st.floats(7.0, 13.5))
def test_pedestrians_at_both_edges_cause_neither_braking_nor_swerving(
    right: float, left: float, gap: float, v: float
) -> None:
    goers = [(50.0, right, 1.3), (50.0 + gap, left, 1.2)]
    found = drive(
        lanes(along_x(-20.0, 400.0), width=6.0), goers, v=v, kind=AgentKind.PEDESTRIAN, seconds=10.0
    )
    assert found.trace.end is EndReason.END_OF_LOG and found.room > 0.55
    decel, lateral = hardest(found.trace)
    assert decel < 3.2 and lateral < 3.0


@given(st.floats(1.0, 60.0), st.floats(0.0, 10.0), st.booleans())
def test_the_neighbouring_lane_is_borrowed_where_no_follower_brakes_hard(
    gap: float, closing: float, left: bool
) -> None:
    road = lanes(along_x(-100.0, 400.0), 2)
    lane, beside = (0, 3.5) if left else (1, 0.0)
    ego = EgoState(0.0, 20.0, 3.5 - beside, 0.0, 10.0, 0.0, 0.0)
    course = reference(road, ego=ego, lane=lane)
    x = ego.x - CAR.rear_overhang - gap - 2.25
    now = scene(course, ego, [driving("car", x, beside, ego.v + closing, length=4.5, width=1.8)])
    against = endangered(now, "left" if left else "right")
    needed = 2.0 + closing + closing**2 / 4.0
    assert bool(against) == (gap < needed) or gap == pytest.approx(needed, abs=0.01)
    assert endangered(now, "right" if left else "left") == ""
