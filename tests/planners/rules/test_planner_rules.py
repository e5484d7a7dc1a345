"""Traffic rules: lights, stop signs, crosswalks, right of way.

The rulebook itself, and the planners that obey it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache

import handmade
import numpy as np
import pytest
from followed import PERIOD_S
from hypothesis import given, settings, strategies as st
from roads import along_x, strip
from scenes import CAR, Other, agents, driving, standing

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Decision, DecisionKind, Plan
from replan.logs.road import Lane, Road
from replan.logs.route import find_route
from replan.logs.rules import Colour, Crosswalk, StopLine, TrafficLight
from replan.logs.states import EgoState, Trajectory
from replan.planners.frenet.reference_path import ReferencePath, make_reference_path
from replan.planners.frenet.scene import Occupancy, Scene, scene_of
from replan.planners.rules import Rulebook, RuleMemory
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.parts import PLANNER
from replan.replay.prediction import predict

LINE_X = 100.0
ACROSS = np.array([[LINE_X, 1.75], [LINE_X, -1.75]])
FRONT = CAR.axle_to_front
LIGHT = StopLine(7, 0, ACROSS, light=9)
SIGN = StopLine(7, 0, ACROSS, must_stop=True)
WALK = Crosswalk(3, np.array([[100.0, -6.0], [104.0, -6.0], [104.0, 6.0], [100.0, 6.0]]))
OBEYING = ("dp_qp", "idm", "lattice", "pdm")
Lights = Callable[[float], Mapping[int, Colour]]


def straight(*lines: StopLine, crosswalks: Sequence[Crosswalk] = ()) -> Road:
    """Lane 0 along x up to x = 100 m, lane 1 beyond."""
    first, second = along_x(-50.0, LINE_X), along_x(LINE_X, 450.0)
    road = {
        0: strip(0, first, successors=(1,), speed_limit=13.89),
        1: strip(1, second, speed_limit=13.89),
    }
    return Road(road, stop_lines=lines, crosswalks=tuple(crosswalks))


def along_y(begin: float, end: float) -> FloatArray:
    y = np.arange(begin, end + 1.0, 2.0)
    return np.column_stack([np.full(len(y), 100.0), y])


def junction(*lines: StopLine, mirror: bool = False) -> Road:
    """The ego's lanes 0, 1, 2 along x.

    From the right, lanes 10, 11, 12 along y; where they meet, 11 goes first.
    """
    lanes = {
        0: strip(0, along_x(-50.0, 94.0), successors=(1,)),
        1: strip(1, along_x(94.0, 106.0), successors=(2,), yields_to=(11,)),
        2: strip(2, along_x(106.0, 450.0)),
        10: strip(10, along_y(-200.0, -6.0), successors=(11,)),
        11: strip(11, along_y(-6.0, 6.0), successors=(12,)),
        12: strip(12, along_y(6.0, 200.0)),
    }
    if mirror:
        lanes = {i: mirrored(lane) for i, lane in lanes.items()}
    return Road(lanes, drives_on_right=not mirror, stop_lines=lines)


def mirrored(lane: Lane) -> Lane:
    flip = np.array([1.0, -1.0])
    return replace(lane, left=flip * lane.right, right=flip * lane.left)


def at_front(front: float, v: float, a: float = 0.0) -> EgoState:
    """The ego with its front bumper at x = `front`."""
    return EgoState(0.0, front - FRONT, 0.0, 0.0, v, a)


def frame_of(
    ego: EgoState,
    others: Sequence[Other] = (),
    lights: Mapping[int, Colour] | None = None,
    *,
    t: float = 0.0,
    previous: Plan | None = None,
) -> Frame:
    known = agents(others, t)
    return Frame(t, ego, known, predict(known, t), previous, lights=lights or {})


def scene(
    road: Road,
    ego: EgoState,
    others: Sequence[Other] = (),
    lights: Mapping[int, Colour] | None = None,
    *,
    t: float = 0.0,
) -> Scene:
    """A frame along the ego's way."""
    return scene_of(frame_of(ego, others, lights, t=t), ego, along(road)[1], CAR)


@cache
def along(road: Road) -> tuple[Rulebook, ReferencePath]:
    start = EgoState(0.0, 0.0, 0.0, 0.0, 10.0)
    reference = make_reference_path(road, find_route(road, start, None), start)
    return Rulebook(road, reference, CAR), reference


def demands(
    road: Road,
    ego: EgoState,
    others: Sequence[Other] = (),
    lights: Mapping[int, Colour] | None = None,
) -> tuple[Occupancy, ...]:
    """What is demanded of an ego of which nothing is remembered."""
    return along(road)[0].stops(scene(road, ego, others, lights), RuleMemory())[0]


def drive(
    name: str,
    road: Road,
    ego: EgoState,
    others: Sequence[Other] = (),
    *,
    seconds: float,
    lights: Lights = lambda t: {},
) -> tuple[Trajectory, list[Plan]]:
    """How the ego moves when it follows each plan without any error, and the plans."""
    planner, previous, states, plans = (
        PLANNER.builtin[name](PlannerContext(road, None, CAR, PERIOD_S, ego)),
        None,
        [],
        [],
    )
    for k in range(round(seconds / PERIOD_S)):
        now = frame_of(ego, others, lights(k * PERIOD_S), t=k * PERIOD_S, previous=previous)
        previous = planner.plan(now)
        states.append(replace(ego, t=k * PERIOD_S))
        plans.append(previous)
        ego = previous.trajectory.at((k + 1) * PERIOD_S)
    columns = [
        [getattr(state, column) for state in states]
        for column in ("t", "x", "y", "yaw", "v", "a", "kappa")
    ]
    return Trajectory(*map(np.array, columns)), plans


def said(plan: Plan, name: str) -> Decision | None:
    found = [item for item in plan.internals if isinstance(item, Decision) and item.agent == name]
    return found[0] if found else None


def walker(name: str, x: float, y: float, vy: float) -> Other:
    return replace(driving(name, x, y, 0.0, vy, length=0.5, width=0.5), kind=AgentKind.PEDESTRIAN)


def waiter(name: str, x: float, y: float, yaw: float = 0.0) -> Other:
    return replace(standing(name, x, y, yaw, length=0.5, width=0.5), kind=AgentKind.PEDESTRIAN)


LIT, JUNCTION, MIRRORED = straight(LIGHT), junction(), junction(mirror=True)
speeds = st.floats(0.0, 20.0)


@given(speeds, st.floats(-3.0, 1.5), st.floats(0.0, 90.0), st.floats(0.0, 50.0))
def test_a_yellow_that_is_farther_is_never_less_stoppable(
    v: float, a: float, ahead: float, more: float
) -> None:
    yellow = {9: Colour.YELLOW}
    near, far = (
        demands(LIT, at_front(LINE_X - d, v, a), (), yellow) for d in (ahead, ahead + more)
    )
    assert len(far) >= len(near)


@given(speeds, st.floats(0.0, 90.0), st.sampled_from([Colour.RED, Colour.RED_YELLOW]))
def test_a_stop_at_yellow_is_a_stop_at_red(v: float, ahead: float, red: Colour) -> None:
    ego = at_front(LINE_X - ahead, v)
    assert len(demands(LIT, ego, (), {9: red})) >= len(demands(LIT, ego, (), {9: Colour.YELLOW}))


@given(speeds, st.floats(0.0, 140.0), st.sampled_from([{}, {9: Colour.OFF}, {9: Colour.GREEN}]))
def test_green_off_and_unknown_demand_nothing(
    v: float, ahead: float, lights: Mapping[int, Colour]
) -> None:
    assert demands(LIT, at_front(LINE_X - ahead, v), (), lights) == ()


@pytest.mark.parametrize("name", OBEYING)
@settings(max_examples=8)
@given(st.floats(0.0, 13.0), st.floats(1.0, 80.0), st.floats(5.0, 60.0))
def test_a_green_light_changes_no_bit_of_the_plan(
    name: str, v: float, ahead: float, gap: float
) -> None:
    ego = at_front(LINE_X - ahead, v)
    others = [driving("car", ego.x + CAR.axle_to_front + gap, 0.0, 6.0)]
    plans = [
        PLANNER.builtin[name](PlannerContext(road, None, CAR, PERIOD_S, ego)).plan(
            frame_of(ego, others, {9: Colour.GREEN})
        )
        for road in (straight(LIGHT), straight())
    ]
    for column in ("t", "x", "y", "yaw", "v", "a", "kappa"):
        one, two = (getattr(plan.trajectory, column) for plan in plans)
        assert np.array_equal(one, two)


@given(st.floats(40.0, 92.0), st.floats(0.0, 12.0), st.floats(-70.0, 10.0), st.floats(0.0, 14.0))
def test_a_mirrored_junction_demands_the_same(
    front: float, v: float, y: float, speed: float
) -> None:
    ego, car = at_front(front, v), driving("car", 100.0, y, 0.0, max(speed, 1e-3))
    other = driving("car", 100.0, -y, 0.0, -max(speed, 1e-3))
    one, two = demands(JUNCTION, ego, [car]), demands(MIRRORED, ego, [other])
    assert [(stop.agent, stop.kind) for stop in one] == [(stop.agent, stop.kind) for stop in two]
    for a, b in zip(one, two, strict=True):
        assert (a.s_from, a.until) == pytest.approx((b.s_from, b.until), abs=1e-6)


def test_a_later_change_of_a_light_does_not_change_the_plan() -> None:
    """Until the light changes in one of two logs, every plan is the same to the last bit."""
    line = straight(LIGHT)
    log = handmade.scenario(handmade.drive(handmade.straight, 12.0, 6.0), road=line, duration=6.0)
    plans = []
    for change in (4.0, 5.5):
        light = TrafficLight(9, np.array([0.0, change]), (Colour.RED, Colour.GREEN))
        trace = run_closed_loop(replace(log, lights=(light,)), "dp_qp").trace
        plans.append({round(frame.t, 3): frame.plan.trajectory for frame in trace.frames})
    same = [np.array_equal(plans[0][t].v, plans[1][t].v) for t in sorted(plans[0])]
    assert all(same[:40])
    assert not same[45]


# --- lights


@pytest.mark.parametrize("name", OBEYING)
@pytest.mark.parametrize("v", [pytest.param(5.0, marks=pytest.mark.slow), 13.0])
def test_red_stops_before_the_line_and_green_lets_go(name: str, v: float) -> None:
    ego = at_front(LINE_X - 60.0, v)
    green = 22.0
    motion, plans = drive(
        name,
        straight(LIGHT),
        ego,
        seconds=25.0,
        lights=lambda t: {9: Colour.RED if t < green else Colour.GREEN},
    )
    waiting = motion.between(green - 1.0, green)
    assert LINE_X - 3.0 <= waiting.x.max() + FRONT <= LINE_X - 0.3
    assert waiting.v.max() < 0.1
    assert motion.a.min() >= -3.0 - 1e-6
    assert motion.at(green + 1.5).v > 0.3
    decision = said(plans[20], "stop line 7")
    assert decision is not None
    assert (decision.kind, decision.reason) == (DecisionKind.STOP, "red light 9")


@pytest.mark.parametrize("name", OBEYING)
def test_at_a_yellow_that_comes_too_late_the_ego_drives_on(name: str) -> None:
    ego = at_front(LINE_X - 20.0, 13.0)
    motion, _ = drive(name, straight(LIGHT), ego, seconds=4.0, lights=lambda t: {9: Colour.YELLOW})
    assert motion.x[-1] + FRONT > LINE_X
    assert motion.a.min() > -0.2


def test_braking_for_a_yellow_light_is_continued() -> None:
    """Also where, on the edge of what is comfortable, the next frame would say otherwise."""
    for ahead in np.arange(34.0, 44.0, 1.25):
        ego = at_front(LINE_X - ahead, 13.0)
        motion, plans = drive(
            "dp_qp", straight(LIGHT), ego, seconds=6.0, lights=lambda t: {9: Colour.YELLOW}
        )
        stops = said(plans[0], "stop line 7") is not None
        assert (motion.x[-1] + FRONT < LINE_X) == stops
        assert motion.a.min() >= -3.05


def test_a_skewed_line_is_met_by_the_nearer_corner() -> None:
    skewed = replace(LIGHT, points=np.array([[LINE_X + 1.75, 1.75], [LINE_X - 1.75, -1.75]]))
    plain, nearer = (
        demands(straight(line), at_front(60.0, 8.0), (), {9: Colour.RED})[0]
        for line in (LIGHT, skewed)
    )
    assert plain.s_from - nearer.s_from == pytest.approx(0.5 * CAR.width, abs=0.02)


# --- stop signs


@pytest.mark.parametrize("name", OBEYING)
def test_at_a_stop_sign_the_ego_comes_to_rest_once_and_goes(name: str) -> None:
    motion, _ = drive(name, straight(SIGN), at_front(60.0, 10.0), seconds=16.0)
    front = motion.x + FRONT
    near = (front > LINE_X - 3.0) & (front < LINE_X)
    assert motion.v[near].min() < 0.1
    assert front[-1] > LINE_X + 3.0
    assert (motion.v[front > LINE_X] > 0.3).all()


def test_the_memory_of_a_stop_is_dropped_with_the_previous_plan() -> None:
    road, ego = straight(SIGN), at_front(LINE_X - 1.0, 0.0)
    rules, moving = along(road)[0], scene(road, replace(ego, v=0.5))
    stops, memory = rules.stops(scene(road, ego), RuleMemory())
    assert stops == () and memory.rested
    assert rules.stops(moving, memory)[0] == ()
    assert rules.stops(moving, RuleMemory())[0]


# --- crosswalks


def test_a_pedestrian_who_stands_at_a_crosswalk_is_waited_for_with_patience() -> None:
    patient = waiter("p", 102.0, -6.6, yaw=0.5 * np.pi)
    motion, plans = drive(
        "dp_qp", straight(crosswalks=[WALK]), at_front(55.0, 10.0), [patient], seconds=18.0
    )
    rest = motion.t[motion.v < 0.1]
    assert 2.9 <= rest[-1] - rest[0] <= 4.5
    assert motion.x[motion.v < 0.1].max() + FRONT < 100.0
    assert motion.x[-1] + FRONT > 106.0
    assert motion.a.min() > -3.05
    assert said(plans[60], "crosswalk 3") is not None


@pytest.mark.parametrize("name", OBEYING)
def test_the_ego_waits_for_a_pedestrian_and_goes_on(name: str) -> None:
    walk = walker("p", 102.0, -8.0, 1.0)
    motion, _ = drive(name, straight(crosswalks=[WALK]), at_front(50.0, 10.0), [walk], seconds=16.0)
    front, y = motion.x + FRONT, -8.0 + 1.0 * motion.t
    taken = (np.abs(y) < 1.75) & (y > -6.0)
    assert (front[taken] < 100.0).all()
    assert front[-1] > 104.0
    assert motion.a.min() > -4.0


# --- right of way


@pytest.mark.parametrize("name", OBEYING)
def test_a_large_gap_is_taken_and_a_small_one_not(name: str) -> None:
    ego = at_front(60.0, 10.0)
    for y, first in ((-120.0, True), (-45.0, False)):
        car = driving("car", 100.0, y, 0.0, 10.0)
        motion, _ = drive(name, junction(), ego, [car], seconds=14.0)
        front, rear = motion.x + FRONT, motion.x + FRONT - CAR.length
        enters, leaves = (
            np.interp(edge, at, motion.t) for edge, at in ((98.2, front), (101.8, rear))
        )
        arrives, gone = (-1.7 - y - 2.25) / 10.0, (1.7 - y + 2.25) / 10.0
        assert (leaves + 1.5 < arrives) if first else (enters >= gone)
        assert front[-1] > 106.0


def merging() -> Road:
    """The ego's lanes 0 and 1 along x.

    Lane 10, which goes first, comes from the right and goes on as lane 1 too.
    """
    u = np.linspace(0.0, 1.0, 60)[:, None]
    bend = (1.0 - u) ** 2 * (60.0, -40.0) + 2.0 * u * (1.0 - u) * (80.0, 0.0) + u**2 * (100.0, 0.0)
    return Road(
        {
            0: strip(0, along_x(-50.0, 100.0), successors=(1,), yields_to=(10,)),
            1: strip(1, along_x(100.0, 450.0)),
            10: strip(10, np.vstack([[25.0, -110.0], bend]), successors=(1,)),
        }
    )


def towards(away: float) -> Other:
    """A car with 10 m/s on lane 10, `away` m before its bend."""
    way = np.array([35.0, 70.0]) / np.hypot(35.0, 70.0)
    return driving("car", *(np.array([60.0, -40.0]) - away * way), *(10.0 * way))


def crossing(y: float, vy: float = 10.0, x: float = 100.0, vx: float = 0.0) -> Other:
    return driving("car", x, y, vx, vy)


CROSSWALK, THEIRS = (
    straight(crosswalks=[WALK]),
    StopLine(6, 10, np.array([[98.25, -8.0], [101.75, -8.0]]), light=2),
)
ELSEWHERE, MINE = (straight(replace(LIGHT, towards=(lane,))) for lane in (5, 1))
STANDS = waiter("p", 102.0, -6.6, yaw=0.5 * np.pi)


@pytest.mark.parametrize(
    ("road", "front", "v", "others", "light", "demanded"),
    [
        (straight(), 60.0, 10.0, [], Colour.OFF, False),  # a road without rules
        (LIT, LINE_X - 4.0, 13.0, [], Colour.RED, False),  # turns red under the bumper
        (LIT, LINE_X + 0.1, 5.0, [], Colour.RED, False),
        (ELSEWHERE, 60.0, 10.0, [], Colour.RED, False),  # a line counts only for its way
        (MINE, 60.0, 10.0, [], Colour.RED, True),
        # Without a memory: who stands there has stopped
        (straight(SIGN), LINE_X - 1.0, 0.0, [], Colour.OFF, False),
        (straight(SIGN), LINE_X - 1.0, 0.5, [], Colour.OFF, True),
        (straight(SIGN), LINE_X - 6.0, 0.0, [], Colour.OFF, True),
        # Stands beside it and looks elsewhere
        (CROSSWALK, 85.0, 10.0, [waiter("p", 102.0, -6.8)], Colour.OFF, False),
        # Stands on the other half
        (CROSSWALK, 85.0, 10.0, [waiter("p", 102.0, 4.0)], Colour.OFF, False),
        # Is still far from it
        (CROSSWALK, 85.0, 10.0, [walker("p", 102.0, -9.0, 1.2)], Colour.OFF, False),
        # Walks away from the ego's half
        (CROSSWALK, 85.0, 10.0, [walker("p", 102.0, 2.6, 1.2)], Colour.OFF, False),
        # Crosses far behind it
        (CROSSWALK, 85.0, 10.0, [walker("p", 110.0, -4.0, 1.2)], Colour.OFF, False),
        (CROSSWALK, 80.0, 12.0, [STANDS], Colour.OFF, False),  # is not braked for hard
        (CROSSWALK, 80.0, 12.0, [walker("p", 102.0, -5.0, 1.2)], Colour.OFF, True),
        # The ego's rear is in the lane after 3.5 s, at the end of the zone after 4.4 s; the other
        # comes after 5.2 s.
        (merging(), 60.0, 10.0, [towards(0.5)], Colour.OFF, False),
        (merging(), 60.0, 10.0, [towards(-7.0)], Colour.OFF, True),
        # A gap of 1.5 s after the ego
        (JUNCTION, 70.0, 10.0, [crossing(-51.0)], Colour.OFF, False),
        (JUNCTION, 70.0, 10.0, [crossing(-46.0)], Colour.OFF, True),
        (junction(THEIRS), 70.0, 10.0, [crossing(-40.0)], Colour.GREEN, True),  # their light
        (junction(THEIRS), 70.0, 10.0, [crossing(-40.0)], Colour.RED, False),
        (JUNCTION, 70.0, 8.0, [crossing(12.0, 8.0)], Colour.OFF, False),  # behind the zone
        (JUNCTION, 70.0, 8.0, [crossing(-150.0, 8.0)], Colour.OFF, False),
        (JUNCTION, 70.0, 8.0, [crossing(-30.0, 8.0, 130.0)], Colour.OFF, False),
        # Turns off before
        (JUNCTION, 70.0, 8.0, [crossing(-40.0, 1.0, 100.0, 8.0)], Colour.OFF, False),
    ],
)
def test_a_stop_is_demanded_exactly_for_agents_with_priority(
    road: Road, front: float, v: float, others: list[Other], light: Colour, *, demanded: bool
) -> None:
    found = demands(
        road, at_front(front, v), others, {9: light, 2: light} if light is not Colour.OFF else {}
    )
    assert bool(found) is demanded
    assert road is not MINE or [stop.agent for stop in found] == ["stop line 7"]


@given(st.floats(0.0, 12.0), st.floats(50.0, 70.0), st.floats(-10.0, 60.0), st.floats(0.0, 15.0))
def test_an_agent_farther_from_the_merging_never_demands_more(
    v: float, front: float, away: float, more: float
) -> None:
    near, far = (
        demands(merging(), at_front(front, v), [towards(at)]) for at in (away, away + more)
    )
    assert near or not far


def test_the_wait_is_before_the_line_where_there_is_one() -> None:
    line = StopLine(5, 0, np.array([[91.0, 1.75], [91.0, -1.75]]))
    car, ego = driving("car", 100.0, -45.0, 0.0, 10.0), at_front(60.0, 8.0)
    (with_line,), (without,) = demands(junction(line), ego, [car]), demands(junction(), ego, [car])
    assert with_line.s_from == pytest.approx(50.0 + 91.0 - 0.8, abs=0.3)
    assert without.s_from > with_line.s_from + 4.0


def test_no_stop_where_lanes_cross() -> None:
    """A queue behind the junction leaves no room: the ego waits before it, though no one comes."""
    queue = [standing("last", 109.0, 0.0), standing("first", 115.5, 0.0)]
    motion, plans = drive("dp_qp", junction(), at_front(60.0, 8.0), queue, seconds=12.0)
    assert motion.v[-1] == pytest.approx(0.0, abs=0.05)
    assert motion.x[-1] + FRONT < 98.2
    decision = said(plans[-1], "lane 11")
    assert decision is not None
    assert "no room" in decision.reason


# stops end


@pytest.mark.parametrize(
    "who", [standing("parked", 109.0, -1.5), waiter("p", 102.0, -2.0, np.pi)], ids=["car", "walker"]
)
def test_the_ego_drives_on_after_waiting_for_a_pedestrian_who_stays_at_the_edge(
    who: Other,
) -> None:
    """A parked car behind it that the path passes.

    A pedestrian who stands half on the lane's edge.
    """
    trajectory, _ = drive(
        "dp_qp",
        straight(crosswalks=[WALK]),
        EgoState(0.0, 60.0, 0.0, 0.0, 8.0),
        [who],
        seconds=25.0,
    )
    assert trajectory.x[-1] > 120.0


def test_patience_with_one_pedestrian_gives_no_priority_over_the_next() -> None:
    """Who waited in a queue, and drives on, has not waited for those who stand there then."""
    road = straight(crosswalks=[WALK])
    memory, found = RuleMemory(), []
    for t, front, v, name in ((0.0, 91.0, 0.0, "p"), (2.9, 93.0, 2.0, "p"), (60.0, 93.0, 5.0, "q")):
        now = scene(
            road, replace(at_front(front, v), t=t), [waiter(name, 102.0, -3.0, 0.5 * np.pi)], t=t
        )
        stops, memory = along(road)[0].stops(now, memory)
        found.append(stops)
    assert all(found) and "pedestrian q goes first" in found[-1][0].reason
