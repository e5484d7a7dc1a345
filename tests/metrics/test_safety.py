from dataclasses import replace
from itertools import pairwise
from math import pi

import numpy as np
import pandas as pd
import pytest
from drives import (
    CAR,
    EGO,
    NOSE,
    Agent,
    along,
    car,
    drive,
    grid,
    moved,
    moving,
    plans,
    scenario,
    straight_road,
    world,
)
from hypothesis import given, settings, strategies as st

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.polylines import inside
from replan.logs.road import Lane, Road
from replan.logs.scenario import Scenario
from replan.logs.shapes import distance, point_segment, time_to_contact
from replan.logs.states import Trajectory
from replan.logs.trace import Mode
from replan.logs.tracks import Tracks
from replan.metrics import evaluate, series
from replan.metrics.boxes import ego_boxes, others_at
from replan.metrics.collisions import ContactKind, contacts
from replan.metrics.lanes import drivable_lanes, limits_at, off_lanes, under
from replan.metrics.off_road import OUTLINE_M
from replan.metrics.time_to_collision import least_contact_times

TAIL = -EGO.rear_overhang


def walker(x: float, y: float, vy: float) -> Agent:
    return car(x, y, 0.0, vy, AgentKind.PEDESTRIAN)


def judged(log: Scenario, **changes: object) -> pd.DataFrame:
    return evaluate(drive(log, **changes), log).set_index("metric")


# the others on a grid -----------------------------------------------------------------------------


def test_others_on_a_grid_equal_the_truth_at_each_time() -> None:
    rng = np.random.default_rng(5)
    counts = np.array([1, 4, 9, 2])
    m = int(counts.sum())
    ragged = Tracks(
        ("a", "b", "c", "d"),
        (AgentKind.CAR,) * 4,
        np.ones(4),
        np.ones(4),
        np.array([True, False, False, False]),
        np.r_[0, np.cumsum(counts)],
        np.concatenate([rng.uniform(0, 1) + 0.3 * np.arange(n) for n in counts]),
        *rng.normal(0, 9, (2, m)),
        rng.uniform(-3, 3, m),
        np.where(rng.random(m) < 0.5, np.nan, 1.0),
        np.full(m, np.nan),
    )
    t = np.unique(np.r_[np.linspace(-1.0, 5.0, 200), ragged.t])
    others = others_at(ragged, t)
    for k, time in enumerate(t):
        truth = ragged.truth(float(time))
        assert tuple(ragged.ids[i] for i in np.flatnonzero(others.there[:, k])) == truth.ids
        expected = np.stack([truth.x, truth.y, truth.yaw, truth.vx, truth.vy])
        assert others.pose[:, others.there[:, k], k] == pytest.approx(expected, abs=1e-12)
    assert np.isnan(others.pose[:, ~others.there]).all()


@given(st.floats(-0.1, 0.1), st.floats(1.0, 20.0), st.floats(-3.0, 3.0))
def test_the_centre_of_a_turning_ego_moves_sideways_too(kappa: float, v: float, yaw: float) -> None:
    """Velocity against positions 1 ms apart, on a circle."""
    t = np.array([0.0, 0.5e-3, 1e-3])
    turned = yaw + kappa * v * t
    x, y = np.cumsum(np.r_[0.0, v * 0.5e-3 * np.ones(2)] * [np.cos(turned), np.sin(turned)], axis=1)
    boxes = ego_boxes(Trajectory(t, x, y, turned, v + 0 * t, 0 * t, kappa + 0 * t), world(v))
    assert boxes[3:, 1] == pytest.approx(
        (boxes[:2, 2] - boxes[:2, 0]) / 1e-3, abs=2e-2 * (1.0 + abs(kappa) * v)
    )


# collisions ---------------------------------------------------------------------------------------

KINDS = [
    ("a standing car ahead", 10.0, car(30.0, 0.0, 0.0, yaw=0.0), ContactKind.STOPPED_TRACK, True),
    ("a slower car ahead", 10.0, car(20.0, 0.0, 2.0), ContactKind.ACTIVE_FRONT, True),
    ("an oncoming car", 10.0, car(60.0, 0.0, -10.0), ContactKind.ACTIVE_FRONT, True),
    ("a faster car behind", 5.0, car(-15.0, 0.0, 15.0), ContactKind.ACTIVE_REAR, False),
    ("a car behind, the ego stands", 0.0, car(-15.0, 0.0, 10.0), ContactKind.STOPPED_EGO, False),
    (
        "a crossing pedestrian hits the side",
        5.0,
        walker(10.0, -6.0, 2.2),
        ContactKind.LATERAL,
        False,
    ),
    (
        "the ego hits a crossing pedestrian",
        10.0,
        walker(28.0, -4.0, 1.6),
        ContactKind.ACTIVE_FRONT,
        True,
    ),
    (
        "a moved cone",
        10.0,
        car(30.0, 0.0, 1.0, kind=AgentKind.OBJECT),
        ContactKind.STOPPED_TRACK,
        True,
    ),
]


@pytest.mark.parametrize(
    ("name", "v", "agent", "kind", "fault"), KINDS, ids=[case[0] for case in KINDS]
)
def test_kinds_of_collision(
    name: str, v: float, agent: Agent, kind: ContactKind, fault: bool
) -> None:
    log = world(v, agent)
    (contact,) = contacts(drive(log), log)
    assert (contact.kind, contact.at_fault) == (kind, fault), name
    table = judged(log)
    assert table.loc["collision.count", "value"] == 1
    assert table.loc["collision_at_fault.count", "value"] == fault
    assert table.loc["collision.count", "reason"].startswith(f"{agent[1].value} 7: {kind.value}")
    assert table.loc["gap.min", "value"] == 0.0
    assert table.loc["collision.count", "time_s"] == log.ego.t[contact.step]


@pytest.mark.parametrize(
    ("kind", "stops"), [(AgentKind.OBJECT, False), (AgentKind.CAR, True), (AgentKind.OBJECT, True)]
)
def test_a_hit_from_behind_on_a_slowing_ego_is_no_stopped_track(
    kind: AgentKind, stops: bool
) -> None:
    """Neither one whose kind a detector does not know, nor one that stops 2 cm behind, where its
    boxes jitter.
    """
    t = grid(10.0, 0.1)
    ego = along(t, np.maximum(6.0 - t, 0.06))
    tail = ego.x + TAIL - 0.5 * CAR[0]
    follower = np.minimum(3.0 * t - 6.0, tail[75] - 0.02 if stops else np.inf)
    follower += 0.01 * np.random.default_rng(5).normal(size=len(t))
    log = scenario(
        ego, [("7", kind, CAR, lambda at: (np.interp(at, t, follower), 0.0 * at, 0.0 * at))]
    )
    (contact,) = contacts(drive(log), log)
    assert (contact.kind, contact.at_fault) == (ContactKind.ACTIVE_REAR, False)
    planned = drive(log, frames=plans(log.ego, np.arange(0.0, 6.0, 0.1), 4.0))
    assert evaluate(planned, log).set_index("metric").loc["plan_collision.rate", "value"] == 0.0


def test_an_ego_in_reverse_hits_a_standing_road_user_at_fault() -> None:
    log = world(-3.0, car(-12.0, 0.0, 0.0, yaw=0.0))
    (contact,) = contacts(drive(log), log)
    assert (contact.kind, contact.at_fault) == (ContactKind.STOPPED_TRACK, True)


def test_a_track_counts_once_and_two_count_twice() -> None:
    stops = ("wave", AgentKind.CAR, CAR, lambda t: (15.0 + 6.0 * np.sin(4 * t), 0 * t, 0 * t))
    other = ("b", AgentKind.CAR, CAR, moving(25.0, 1.0, 0.0, 0.0, 0.0))
    log = world(6.0, stops, other)
    assert [contact.agent for contact in contacts(drive(log), log)] == [0, 1]
    assert judged(log).loc["collision.count", "value"] == 2


def test_a_collision_from_the_side_is_at_fault_outside_ones_lane() -> None:
    merging = car(1.0, 4.5, 5.0, -1.0, yaw=0.0)
    inside, astride = (
        world(5.0, merging, road=straight_road(lanes=2)),
        world(5.0, merging, road=straight_road(half=0.7)),
    )
    for log, fault in ((inside, False), (astride, True)):
        (contact,) = contacts(drive(log), log)
        assert (contact.kind, contact.at_fault) == (ContactKind.LATERAL, fault)


def test_a_road_user_that_appears_at_the_ego_is_not_hit_at_fault() -> None:
    log = world(0.5, car(1.0, 0.5, 0.5))
    (contact,) = contacts(drive(log), log)
    assert (contact.step, contact.kind, contact.at_fault) == (0, ContactKind.FROM_START, False)
    late = replace(log, tracks=replace(log.tracks, t=log.tracks.t + 1.0))
    (contact,) = contacts(drive(late), late)
    assert (contact.kind, late.ego.t[contact.step]) == (ContactKind.FROM_START, pytest.approx(1.0))


def test_without_others_there_is_no_collision_and_no_gap() -> None:
    table = judged(world(10.0))
    assert table.loc["collision.count", "value"] == 0
    assert (table.loc["gap.min", "available"], table.loc["gap.min", "reason"]) == (
        False,
        "no other road user in the scene",
    )
    assert not table.loc["gap.time_below_20cm", "available"]
    assert table.loc["gap_vulnerable.min", "reason"] == "no pedestrian or rider in the scene"


@given(st.integers(0, 300))
@settings(max_examples=25)
def test_gap_and_ttc_are_the_least_over_all_agents(seed: int) -> None:
    rng = np.random.default_rng(seed)
    agents = [
        (str(i), AgentKind.CAR, CAR, moving(*rng.uniform(-30, 30, 2), *rng.uniform(-9, 9, 2)))
        for i in range(12)
    ]
    log = scenario(along(grid(1.0, 0.1), 7.0), agents)
    frames, met = series(drive(log), log), contacts(drive(log), log)
    until = {contact.agent: contact.step for contact in met}
    gaps, times = (
        frames.loc[frames["metric"] == name, "value"].to_numpy() for name in ("gap", "ttc")
    )
    for k, t in enumerate(log.ego.t):
        x, others = 7.0 * t + EGO.axle_to_center, log.tracks.truth(float(t))
        ego, gap = (x, 0.0, 0.0, EGO.length, EGO.width), []
        ttc = [0.0 if any(contact.at_fault and contact.step == k for contact in met) else np.inf]
        for i in range(12):
            box = (others.x[i], others.y[i], others.yaw[i], *CAR)
            gap.append(distance(*ego, *box))
            behind = np.degrees(np.abs(np.arctan2(others.y[i], others.x[i] - 7.0 * t))) > 150.0
            if not behind and k < until.get(i, len(log.ego)):
                ttc.append(time_to_contact(*ego, *box, others.vx[i] - 7.0, others.vy[i]))
        assert gaps[k] == pytest.approx(min(gap), abs=1e-9)
        assert (
            times[k] == pytest.approx(min(ttc), abs=1e-6) if min(ttc) < 10.0 else np.isnan(times[k])
        )


# gaps ---------------------------------------------------------------------------------------------


def test_gap_to_the_vulnerable_is_apart() -> None:
    table = judged(
        world(
            5.0,
            car(40.0, 3.0, 5.0),
            ("p", AgentKind.PEDESTRIAN, (0.6, 0.6), moving(15.0, 4.0, 0.0, 0.1)),
        )
    )
    assert table.loc["gap_vulnerable.min", "reason"] == "pedestrian p"
    assert table.loc["gap_vulnerable.min", "value"] == pytest.approx(
        4.0 - 0.3 - 0.5 * EGO.width, abs=0.4
    )
    assert table.loc["gap_vulnerable.min", "value"] == table.loc["gap.min", "value"]


# time to collision --------------------------------------------------------------------------------


def test_a_pedestrian_who_crosses_counts_with_the_velocity_vector() -> None:
    """The box is turned along the road, the walk goes across it: heading times speed would miss
    it.
    """
    walker = ("7", AgentKind.PEDESTRIAN, (0.6, 0.6), moving(20.0 + NOSE, -4.0, 0.0, 2.0, 0.0))
    table = judged(world(10.0, walker, seconds=0.5))
    assert table.loc["ttc.min", "available"]
    assert table.loc["ttc.min", "value"] == pytest.approx((20.0 - 0.3) / 10.0 - 0.5, abs=0.02)
    away = ("7", AgentKind.PEDESTRIAN, (0.6, 0.6), moving(20.0 + NOSE, -4.0, 0.0, -2.0, 0.0))
    assert not judged(world(10.0, away, seconds=0.5)).loc["ttc.min", "available"]


def test_agents_behind_and_a_standing_ego_have_no_ttc() -> None:
    assert not judged(world(5.0, car(-20.0, 0.0, 10.0), seconds=1.0)).loc["ttc.min", "available"]
    assert not judged(world(0.0, car(20.0, 0.0, -10.0), seconds=1.0)).loc["ttc.min", "available"]


def circling(
    t: FloatArray, radius: float, v: float, begin: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """x, y, yaw of who drives around (0, radius), from `begin` rad on.

    A negative v goes the other way round.
    """
    angle = begin + v / abs(radius) * t
    side = np.sign(radius)
    return (
        abs(radius) * np.sin(angle),
        side * abs(radius) * (1.0 - np.cos(angle)),
        side * angle + pi * (v < 0.0),
    )


def curve(
    radius: float, mine: float, theirs: float, aside: float, begin: float, rate: float = 20.0
) -> Scenario:
    """The ego on a circle, and a car on one `aside` m outside, `begin` rad ahead.

    Both rear axles on their circles.
    """
    t = grid(1.2, 0.05)
    x, y, yaw = circling(t, radius, mine)
    ego = Trajectory(t, x, y, yaw, mine + 0 * t, 0 * t, 1.0 / radius + 0 * t)
    side = np.sign(radius)

    def motion(at: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        u, v, heading = circling(at, radius + side * aside, theirs, begin)
        return u, v - side * aside, heading

    seen = np.arange(round(1.2 * rate) + 1) / rate
    log = scenario(ego, [("7", AgentKind.CAR, CAR, motion)])
    return replace(
        log, tracks=scenario(along(seen, 1.0), [("7", AgentKind.CAR, CAR, motion)]).tracks
    )


@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0])
@pytest.mark.parametrize("radius", [12.0, -12.0])
def test_a_turning_ego_is_on_no_course_to_agents_in_the_next_lane(
    radius: float, rate: float
) -> None:
    """6 m/s on 12 m towards a car that comes with 5 m/s in the next lane outside: straight on they
    touch in less than 0.95 s. The turned, shifted and delayed scene has the same times."""
    log = curve(radius, 6.0, -5.0, 3.3, 0.9, rate)
    (least, straight), _ = least_contact_times(drive(log), log, False)
    assert np.nanmin(straight) < 0.95
    table = judged(log)["value"]
    assert (table["ttc.time_below_950ms"], table["ttc.time_below_1500ms"]) == (0.0, 0.0)
    assert table["gap.min"] > 1.0
    turned = moved(log, 2.0, 300.0, -20.0)
    later = replace(
        log,
        ego=replace(log.ego, t=log.ego.t + 1.0),
        tracks=replace(log.tracks, t=log.tracks.t + 1.0),
        duration=2.2,
    )
    for other in (turned, later):
        assert least_contact_times(drive(other), other, False)[0] == pytest.approx(
            np.stack([least, straight]), abs=1e-3, nan_ok=True
        )


@given(st.floats(25.0, 80.0), st.booleans(), st.floats(5.0, 9.0), st.floats(4.0, 6.0))
@settings(max_examples=20)
def test_an_obstacle_on_the_arc_of_the_ego_counts(
    radius: float, left: bool, v: float, gap: float
) -> None:
    """The distance along the circle over the speed, up to the corner that comes first."""
    begin = (gap + NOSE + 2.25) / radius
    log = curve(radius if left else -radius, v, 1e-9, 0.0, begin)
    found = judged(log)["value"]["ttc.min"] if not contacts(drive(log), log) else 0.0
    (least, straight), _ = least_contact_times(drive(log), log, False)
    assert least[0] == pytest.approx(gap / v, abs=0.12) and least[0] >= straight[0]
    assert found <= least[0]


@given(st.integers(0, 1000))
@settings(max_examples=25)
def test_ttc_is_never_less_than_the_straight_time(seed: int) -> None:
    rng = np.random.default_rng(seed)
    t, radius, v = (
        grid(1.0, 0.1),
        rng.choice([-1.0, 1.0]) * rng.uniform(6.0, 60.0),
        rng.uniform(1.0, 12.0),
    )
    ego = Trajectory(t, *circling(t, radius, v), v + 0 * t, 0 * t, 1.0 / radius + 0 * t)
    agents = [
        (str(i), AgentKind.CAR, CAR, moving(*rng.uniform(-20, 20, 2), *rng.uniform(-9, 9, 2)))
        for i in range(8)
    ]
    log = scenario(ego, agents)
    (least, straight), who = least_contact_times(drive(log), log, False)
    assert all(
        least[contact.step] == 0.0 for contact in contacts(drive(log), log) if contact.at_fault
    )
    assert (~(least < straight) | (least == 0.0)).all() and (np.isfinite(least) == (who >= 0)).all()


def test_an_agent_has_no_ttc_after_its_contact() -> None:
    """A faster car in the next lane drives into the ego's rear corner, not behind by nuPlan's 150
    degrees, and goes on beside it: no fault, no TTC. nuPlan never asks: it is not ahead, and the
    ego keeps its lane."""
    log = world(5.0, car(-6.0, 2.6, 9.0, -0.9, yaw=0.0), seconds=3.0, road=straight_road(lanes=2))
    (contact,) = contacts(drive(log), log)
    assert not contact.at_fault
    (least, straight), _ = least_contact_times(drive(log), log, False)
    assert np.isnan(least[contact.step :]).all() and np.isnan(straight[contact.step :]).all()
    assert judged(log).loc["nuplan_closed.ttc.final", "value"] == 1.0


# off the road -------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_corner_off_the_lane(side: float) -> None:
    """The ego drifts to y = 2 m: its corners stand out by 2 + half its width - 1.75 m."""
    t = grid(4.0)
    y = side * np.minimum(t, 2.0)
    ego = Trajectory(t, 10 * t, y, 0 * t, 10 + 0 * t, 0 * t, 0 * t)
    table = judged(scenario(ego))
    out = 2.0 + 0.5 * EGO.width - 1.75
    assert table.loc["off_road.max", "value"] == pytest.approx(out)
    crossing = 1.75 + 0.3 - 0.5 * EGO.width
    assert table.loc["off_road.time_beyond_30cm", "value"] == pytest.approx(
        4.0 - crossing, abs=0.02
    )


def test_a_kerb_between_the_corners_is_off_the_road() -> None:
    """A kerb's square corner reaches to y = 0.2 m into the side of an ego whose four corners are on
    the lane.
    """
    x, edge = np.array([-100.0, 8.0, 10.0, 12.0, 500.0]), np.array([2.2, 2.2, 0.2, 2.2, 2.2])
    lane = Lane(0, np.column_stack([x, edge]), np.column_stack([x, np.full(5, -2.0)]))
    t = grid(1.0)
    ego = Trajectory(t, 10.0 - EGO.axle_to_center + 0 * t, *(0 * t for _ in range(5)))
    table = judged(scenario(ego, road=Road({0: lane})))
    deep = (0.5 * EGO.width - 0.2) / np.sqrt(2.0)
    assert table.loc["off_road.max", "value"] == pytest.approx(deep, abs=0.5 * OUTLINE_M)
    assert table.loc["off_road.time_beyond_30cm", "value"] == pytest.approx(1.0, abs=0.02)


def test_two_lanes_are_one_road_and_a_sidewalk_is_none() -> None:
    t = grid(2.0)
    ego = Trajectory(t, 10 * t, 1.75 + 0 * t, 0 * t, 10 + 0 * t, 0 * t, 0 * t)
    both = straight_road(lanes=2)
    assert judged(scenario(ego, road=both)).loc["off_road.max", "value"] == 0.0
    walk = Road({0: both.lanes[0], 1: replace(both.lanes[1], drivable=False)})
    assert judged(scenario(ego, road=walk)).loc["off_road.max", "value"] == pytest.approx(
        0.5 * EGO.width
    )


def test_the_end_of_the_map_is_not_the_edge_of_the_road() -> None:
    """The lanes end at 500 m: the nose may stand out, the whole car may not."""
    assert judged(scenario(along(grid(2.0), 10.0, x=479.0))).loc["off_road.max", "value"] == 0.0
    out = judged(scenario(along(grid(5.0), 10.0, x=479.0)))
    assert out.loc["off_road.max", "value"] == pytest.approx(479.0 + 50.0 + NOSE - 510.0)


@given(st.lists(st.tuples(st.floats(-120, 520), st.floats(-9, 9)), min_size=1, max_size=9))
def test_distance_off_the_lanes_is_exact(points: list[tuple[float, float]]) -> None:
    x, y = np.array(points).T
    lanes = drivable_lanes(straight_road(lanes=2))
    assert lanes is not None
    out_x, out_y = (
        np.maximum(np.maximum(-110 - x, x - 510), 0),
        np.maximum(np.maximum(-1.75 - y, y - 5.25), 0),
    )
    assert off_lanes(lanes, x, y) == pytest.approx(np.hypot(out_x, out_y), abs=1e-9)


@given(st.integers(0, 2**32 - 1), st.integers(2, 400))
@settings(max_examples=8, deadline=None)
def test_boxes_of_edges_do_not_change_results(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    yaw = np.cumsum(rng.normal(0.0, 0.15, count))
    center = np.cumsum(3.0 * np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0)
    normal = 1.75 * np.column_stack([-np.sin(yaw), np.cos(yaw)])
    lanes = drivable_lanes(Road({0: Lane(0, center + normal, center - normal, speed_limit=13.9)}))
    assert lanes is not None
    points = center[rng.integers(0, count, 40)] + rng.normal(0.0, 4.0, (40, 2))

    def away(line: FloatArray) -> list[float]:
        return [min(point_segment(*p, *a, *b) for a, b in pairwise(line)) for p in points]

    held = [inside(*p, lanes.outline) for p in points]
    closed = np.vstack([lanes.outline[-1:], lanes.outline])
    np.testing.assert_array_equal(off_lanes(lanes, *points.T), np.where(held, 0.0, away(closed)))
    np.testing.assert_array_equal(np.isfinite(limits_at(lanes, *points.T)), held)
    left = under(lanes, *points.T, np.zeros(40)).left
    np.testing.assert_array_equal(np.abs(left), np.where(held, away(lanes.center), np.nan))


@given(st.integers(0, 500))
def test_distance_off_many_lanes_is_the_least_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    strips = {}
    for i in range(12):
        start, heading = rng.uniform(-40, 40, 2), rng.uniform(-3, 3)
        along_it, aside = (
            np.array([np.cos(heading), np.sin(heading)]),
            np.array([-np.sin(heading), np.cos(heading)]),
        )
        center = start + rng.uniform(3, 20) * np.array([[0.0], [1.0]]) * along_it
        strips[i] = Lane(
            i, center + 1.75 * aside, center - 1.75 * aside, (i,), drivable=bool(rng.random() < 0.8)
        )
    road = Road(strips)
    x, y = rng.uniform(-50, 50, (2, 40))
    lanes = drivable_lanes(road)
    assert lanes is not None
    for found, px, py in zip(off_lanes(lanes, x, y), x, y, strict=True):
        edges = [
            point_segment(px, py, *lane.polygon[j - 1], *lane.polygon[j])
            for lane in strips.values()
            if lane.drivable
            for j in range(4)
        ]
        assert found == (0.0 if road.is_drivable(px, py) else pytest.approx(min(edges), abs=1e-9))


# invariances --------------------------------------------------------------------------------------

SAFETY = (
    "collision",
    "collision_at_fault",
    "gap",
    "gap_vulnerable",
    "ttc",
    "off_road",
    "lat_accel",
    "yaw_rate",
    "lat_jerk_state",
    "progress",
    "distance",
    "speed_excess",
)


@settings(max_examples=25)
@given(
    st.integers(0, 40), st.floats(-3.1, 3.1), st.floats(-90, 90), st.floats(-90, 90), st.booleans()
)
def test_moved_and_mirrored_worlds_change_no_metric(
    seed: int, turn: float, dx: float, dy: float, mirror: bool
) -> None:
    rng = np.random.default_rng(seed)
    t = grid(3.0, 0.05)
    yaw = 0.2 * np.sin(t)
    ego = Trajectory(t, 8 * t, 0.6 * t, yaw, 8 + 0 * t, 0 * t, 0.025 * np.cos(t))
    kinds = (AgentKind.CAR, AgentKind.PEDESTRIAN, AgentKind.BICYCLE)
    agents = [
        (
            str(i),
            kind,
            CAR,
            moving(*rng.uniform(-5, 40, 1), *rng.uniform(-6, 6, 1), *rng.uniform(-6, 6, 2)),
        )
        for i, kind in enumerate(kinds)
    ]
    log = scenario(ego, agents, road=straight_road(lanes=2, limit=7.0))
    other = moved(log, turn, dx, dy, mirror=mirror)
    one, two = judged(log), judged(other)
    rows = [name for name in one.index if name.split(".")[0] in SAFETY]
    assert (one.loc[rows, "available"] == two.loc[rows, "available"]).all()
    assert two.loc[rows, "value"].to_numpy() == pytest.approx(
        one.loc[rows, "value"].to_numpy(), abs=0.051, nan_ok=True
    )
    steady = [name for name in rows if "time" not in name]
    assert two.loc[steady, "value"].to_numpy() == pytest.approx(
        one.loc[steady, "value"].to_numpy(), abs=1e-6, nan_ok=True
    )


def test_where_a_drive_is_cut_changes_no_step_before() -> None:
    whole = world(10.0, car(30.0, 2.0, 4.0))
    part = replace(whole, ego=whole.ego.between(0.0, 2.0))
    one, two = series(drive(whole), whole), series(drive(part), part)
    one = one[one["t_s"] <= 2.0]
    for name in ("gap", "ttc", "collision", "lon_jerk_state", "lat_accel", "yaw_rate", "distance"):
        a, b = (frame.loc[frame["metric"] == name, "value"].to_numpy() for frame in (one, two))
        assert a.tobytes() == b.tobytes(), name


# plans in open loop -------------------------------------------------------------------------------


def opened(log: Scenario, **how: object) -> pd.DataFrame:
    frames = plans(log.ego, grid(3.0, 0.1)[:11], 5.0, **how)
    return evaluate(drive(log, mode=Mode.OPEN, frames=frames), log).set_index("metric")


def test_a_plan_that_would_hit_somebody() -> None:
    """The log brakes for nobody: a car stands 40 m ahead and the plans go on at 10 m/s."""
    table = opened(scenario(along(grid(9.0), 10.0), [car(40.0, 0.0, 0.0, yaw=0.0)]))
    touch = (40.0 - 2.25 - NOSE) / 10.0
    assert table.loc["plan_collision.rate", "value"] == 1.0
    assert table.loc["plan_collision.min", "value"] == pytest.approx(touch - 1.0, abs=0.1)
    assert table.loc["plan_collision.min", "time_s"] == pytest.approx(1.0)
    assert table.loc["plan_collision.min", "reason"] == "car 7"


def test_plans_that_keep_away_and_plans_against_the_future_as_it_was() -> None:
    gone = scenario(along(grid(9.0), 10.0), [car(40.0, 0.0, 0.0, 4.0, yaw=0.0)])
    table = opened(gone)
    assert table.loc["plan_collision.rate", "value"] == 0.0
    assert table.loc["plan_collision.min", "reason"] == "no plan has a contact at fault within 4 s"
    comes = scenario(along(grid(9.0), 10.0), [car(43.0, -16.0, 0.0, 4.0, yaw=0.0)])
    assert opened(comes).loc["plan_collision.rate", "value"] == 1.0


def test_a_touch_at_the_start_of_a_plan_is_not_its_fault() -> None:
    beside = scenario(along(grid(9.0), 10.0), [car(1.0, 1.0, 10.0)])
    assert opened(beside).loc["plan_collision.rate", "value"] == 0.0


def test_the_logs_own_gaps_are_not_in_an_open_loop_table() -> None:
    log = scenario(along(grid(9.0), 10.0), [car(40.0, 0.0, 0.0, yaw=0.0)])
    assert not any(name.startswith(("gap", "ttc", "collision")) for name in opened(log).index)


@pytest.mark.parametrize(
    ("speed", "beside", "away", "near"),
    [(8.0, 0.7, 0.0, True), (8.0, 1.1, 0.0, False), (2.5, 0.7, 0.0, False), (8.0, 0.7, 1.0, False)],
)
def test_room_to_a_passed_pedestrian_grows_with_speed(
    speed: float, beside: float, away: float, near: bool
) -> None:
    """One who walks away to the side has crossed."""
    y = 0.5 * EGO.width + 0.3 + beside - away * 12.0 / speed
    table = judged(world(speed, walker(12.0 + EGO.axle_to_center, y, away), seconds=6.0))
    assert (table.loc["passing_room.time_too_near", "value"] > 0.0) == near
