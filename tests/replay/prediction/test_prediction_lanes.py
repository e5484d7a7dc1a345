"""Lane following and pedestrians: what a future on lanes must keep, and who has which
hypotheses.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from roads import curve, lanes, strip

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind, Agents
from replan.logs.frame import Predictions
from replan.logs.road import Lane, Road
from replan.replay.prediction import LaneMap, predict
from replan.replay.prediction.lane_following import CURVE_MPS2
from replan.replay.prediction.lane_map import lane_point, lane_project
from replan.replay.prediction.off_lanes import BRAKE_MPS2, KERB_M, walked

STRAIGHT = curve((400.0, 0.0))


def one(
    x: float,
    y: float,
    yaw: float,
    v: float,
    *,
    kind: AgentKind = AgentKind.CAR,
    reference: float | None = None,
    accel: float = 0.0,
    yaw_rate: float = 0.0,
) -> Agents:
    reference = yaw if reference is None else reference
    columns = (4.5, 1.8, x, y, yaw, v * np.cos(reference), v * np.sin(reference), yaw_rate, accel)
    return Agents(("a",), (kind,), *(np.array([value]) for value in columns))


@pytest.mark.parametrize(
    ("v", "turns", "rate"), [(10.0, 0.3, 0.3), (10.0, -3.0, -0.5), (2.0, 3.0, 0.4)]
)
def test_a_car_goes_on_turning_as_far_as_tyres_and_steering_permit(
    v: float, turns: float, rate: float
) -> None:
    found = predict(one(0.0, 0.0, 0.0, v, yaw_rate=turns), 0.0, method="constant_turn_rate")
    np.testing.assert_allclose(found.yaw[0], rate * found.t, atol=1e-9)


def future(now: Agents, road: Road, method: str = "lanes_and_pedestrians") -> Predictions:
    return predict(now, 0.0, method=method, lanes=LaneMap.of(road))


def road_of(*found: Lane) -> Road:
    return Road({lane.id: lane for lane in found})


@given(st.floats(0.0, 99.9), st.floats(-3.0, 3.0))
def test_projection_inverts_the_point_of_a_lane(s: float, left: float) -> None:
    """Up to the curve within a step: half a sample times the angle between two."""
    arrays = MAP.arrays
    x, y, yaw, _ = lane_point(arrays, 0, s)
    back = lane_project(arrays, 0, x - left * np.sin(yaw), y + left * np.cos(yaw), 5.0)
    assert back[0] == pytest.approx(s, abs=0.06) and back[1] == pytest.approx(left, abs=0.01)
    assert back[2] == pytest.approx(1.75, abs=0.01)


MAP = LaneMap.of(lanes(curve((40.0, 0.02), (60.0, -0.01))))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_jumping_over_samples_misses_no_nearer_one(seed: int) -> None:
    """Against the brute-force nearest point of the polyline, on wildly bent lanes."""
    rng = np.random.default_rng(seed)
    found = LaneMap.of(
        lanes(curve(*((10.0, k) for k in rng.uniform(-0.3, 0.3, 8))), width=1.0)
    ).arrays
    x, y = rng.uniform(-40.0, 40.0, 2)
    s, _, _ = lane_project(found, 0, x, y, 1e3)
    foot = lane_point(found, 0, min(max(s, 0.0), 80.0))
    assert np.isinf(lane_project(found, 0, x, y, 0.5 * np.hypot(foot[0] - x, foot[1] - y) - 1.0)[1])
    dense = [lane_point(found, 0, u)[:2] for u in np.linspace(0.0, 80.0, 1601)]
    assert (
        np.hypot(foot[0] - x, foot[1] - y)
        <= min(np.hypot(px - x, py - y) for px, py in dense) + 1e-2
    )


@given(st.floats(-0.8, 0.8), st.floats(3.0, 15.0), st.floats(-0.01, 0.01))
@settings(max_examples=30)
def test_who_keeps_an_offset_keeps_it_along_the_bend(offset: float, v: float, kappa: float) -> None:
    path = curve((20.0, 0.0), (300.0, kappa))
    found = future(one(10.0, offset, 0.0, v), lanes(path))
    assert len(found) == 1
    line = LaneMap.of(lanes(path)).arrays
    back = np.array(
        [lane_project(line, 0, x, y, 5.0) for x, y in zip(found.x[0], found.y[0], strict=True)]
    )
    np.testing.assert_allclose(back[:, 1], offset, atol=0.05)
    covered = np.hypot(np.diff(found.x[0]), np.diff(found.y[0]))
    np.testing.assert_allclose(covered, 0.1 * v, rtol=0.01)


def test_who_straddles_the_marking_moves_in_and_never_slides_while_standing() -> None:
    road = lanes(STRAIGHT)
    moving, standing = (
        future(one(10.0, 1.6, 0.0, 10.0), road),
        future(one(10.0, 1.6, 0.1, 0.0), road),
    )
    assert 0.5 < moving.y[0, -1] < 0.9 and moving.y[0, 30] < 1.1
    np.testing.assert_allclose(standing.y[0], 1.6, atol=1e-9)
    np.testing.assert_allclose(standing.yaw[0], 0.1, atol=1e-9)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_lane_change_in_progress_is_completed(side: float) -> None:
    road = lanes(STRAIGHT, 3)
    drifting = future(one(10.0, 3.5 + side * 1.0, side * 0.08, 12.0), road)
    keeping = future(one(10.0, 3.5 + side * 1.0, 0.0, 12.0), road)
    assert abs(drifting.y[0, -1] - (3.5 + side * 3.5)) < 0.9
    assert abs(keeping.y[0, -1] - 3.5) < 1.1


def fork(sharp: float) -> Road:
    stem = strip(0, curve((60.0, 0.0)), successors=(1, 2))
    end = stem.center[-1]
    onward, aside = curve((200.0, 0.0)), curve((20.0, sharp), (100.0, 0.0))
    return road_of(stem, strip(1, end + onward), strip(2, end + aside))


def test_at_a_fork_there_is_a_future_for_each_branch_that_can_be_taken() -> None:
    slow = future(one(30.0, 0.0, 0.0, 8.0), fork(0.03))
    assert len(slow) == 2 and (slow.probability > 0.1).all()
    ends = sorted(slow.y[:, -1])
    assert abs(ends[0]) < 0.5 and ends[1] > 5.0
    likely = slow.y[np.argmax(slow.probability), -1]
    assert abs(likely) < 0.5, "straight on is more probable than the turn"
    assert len(future(one(50.0, 0.0, 0.0, 25.0), fork(0.08))) == 1, (
        "nobody turns that sharply at 25 m/s"
    )
    assert len(future(one(30.0, 0.0, 0.0, 2.0), fork(0.03))) == 1, "the fork is out of reach"


def test_a_vehicle_slows_for_a_bend_and_not_for_a_straight() -> None:
    bend = curve((60.0, 0.0), (40.0, 0.08), (60.0, 0.0))
    found = future(one(10.0, 0.0, 0.0, 14.0), lanes(bend))
    speed = np.hypot(np.diff(found.x[0]), np.diff(found.y[0])) / 0.1
    assert speed[0] == pytest.approx(14.0, rel=0.01) and speed.min() < 1.1 * np.sqrt(
        CURVE_MPS2 / 0.08
    )


def test_braking_dies_away_and_never_becomes_reversing() -> None:
    road = lanes(STRAIGHT)
    braking, stopping = (
        future(one(10.0, 0.0, 0.0, 10.0, accel=-2.0), road),
        future(one(10.0, 0.0, 0.0, 1.0, accel=-3.0), road),
    )
    assert np.diff(braking.x[0])[-1] == pytest.approx(0.8, abs=0.02)
    assert (np.diff(stopping.x[0]) >= 0.0).all() and stopping.x[0, -1] < 11.0


@pytest.mark.parametrize(
    ("now", "why"),
    [
        (one(50.0, 0.0, np.pi, 10.0), "against the lane"),
        (one(50.0, 9.0, 0.0, 10.0), "beside the lanes"),
        (one(50.0, 0.0, 0.0, 5.0, reference=np.pi), "reverses"),
        (one(50.0, 0.0, 0.05, 5.0, kind=AgentKind.BICYCLE, yaw_rate=0.1), "a bicycle"),
        (one(50.0, 0.0, 1.2, 10.0, yaw_rate=0.2), "across the lane"),
    ],
)
def test_who_follows_no_lane_goes_round_a_circle(now: Agents, why: str) -> None:
    found, round_ = (
        future(now, lanes(STRAIGHT), "lane_following"),
        predict(now, 0.0, method="constant_turn_rate"),
    )
    np.testing.assert_array_equal(found.x, round_.x, err_msg=why)
    np.testing.assert_array_equal(found.y, round_.y, err_msg=why)


def test_lanes_that_no_car_may_drive_are_followed_by_none() -> None:
    path = lanes(curve((100.0, 0.02)))
    sidewalk = Road({0: replace(path.lanes[0], drivable=False)})
    now = one(10.0, 0.0, 0.2, 10.0)
    np.testing.assert_array_equal(
        future(now, sidewalk).y, predict(now, 0.0, method="constant_turn_rate").y
    )


def test_500_vehicles_and_a_road_of_loops_end() -> None:
    """Two lanes that follow each other for ever, everybody on them."""
    loop = [
        strip(i, curve((31.0, 0.1)) if i == 0 else -curve((31.0, 0.1)) + curve((31.0, 0.1))[-1])
        for i in range(2)
    ]
    road = road_of(replace(loop[0], successors=(1,)), replace(loop[1], successors=(0,)))
    many = [one(5.0, 1.3, 0.5, v) for v in np.linspace(0.0, 60.0, 500)]
    crowd = Agents(
        tuple(map(str, range(500))),
        500 * (AgentKind.CAR,),
        *(
            np.concatenate([getattr(a, c) for a in many])
            for c in ("length", "width", "x", "y", "yaw", "vx", "vy")
        ),
    )
    found = future(crowd, road)
    assert len(found) >= 500 and np.isfinite(found.x).all()


def walker(x: float, y: float, reference: float, v: float, accel: float = 0.0) -> Agents:
    return one(x, y, reference, v, kind=AgentKind.PEDESTRIAN, accel=accel)


def said(found: Predictions) -> dict[str, tuple[float, FloatArray]]:
    """The hypotheses by what the walker does in the end: probability and path along y."""
    names = {}
    for i in range(len(found)):
        last = np.hypot(found.x[i, -1] - found.x[i, -2], found.y[i, -1] - found.y[i, -2]) / 0.1
        back = abs(found.yaw[i, -1] - found.yaw[i, 0]) > 3.0
        names["back" if back else "on" if last > 0.2 else "stop"] = (
            float(found.probability[i]),
            found.y[i],
        )
    return names


def test_who_walks_on_the_road_goes_on_or_stops_and_turns_back_only_when_slowing() -> None:
    steady, slowing = (
        said(future(walker(50.0, 0.0, np.pi / 2, 1.4, a), lanes(STRAIGHT))) for a in (0.0, -1.0)
    )
    assert set(steady) == {"on", "stop"} and set(slowing) == {"on", "stop", "back"}
    assert steady["on"][0] > 0.5 > slowing["on"][0]
    np.testing.assert_allclose(np.diff(steady["on"][1]), 0.14, atol=1e-9)
    assert steady["stop"][1][-1] == pytest.approx(1.4**2 / (2 * BRAKE_MPS2))
    assert slowing["back"][1][-1] < 0.0 < slowing["back"][1].max()


def test_who_comes_to_the_kerb_may_stop_before_it() -> None:
    found = said(future(walker(50.0, -5.0, np.pi / 2, 1.4), lanes(STRAIGHT)))
    assert set(found) == {"on", "stop"}
    assert found["stop"][1][-1] == pytest.approx(-1.75 - KERB_M, abs=0.26), (
        "found in steps of 0.25 m"
    )
    assert found["stop"][1].max() < -1.75


def test_who_walks_elsewhere_goes_on_and_who_stands_there_stands() -> None:
    along = said(future(walker(50.0, -5.0, 0.0, 1.4), lanes(STRAIGHT)))
    assert set(along) == {"on"}
    standing = future(walker(50.0, -5.0, np.pi / 2, 0.0), lanes(STRAIGHT))
    assert len(standing) == 1 and (standing.y[0] == -5.0).all()
    assert set(said(future(walker(50.0, -5.0, np.pi / 2, 0.1, -1.0), lanes(STRAIGHT)))) == {
        "on",
        "stop",
    }


def test_who_stands_on_the_road_may_go_either_way() -> None:
    found = said(future(walker(50.0, 0.0, np.pi / 2, 0.0), lanes(STRAIGHT)))
    assert set(found) == {"on", "stop", "back"} and found["stop"][0] > 0.5
    assert found["on"][1][-1] > 5.0 and found["back"][1][-1] < -5.0


@given(st.floats(0.3, 3.0), st.floats(0.0, 10.0))
def test_walking_and_stopping_is_smooth_and_ends_where_it_should(v: float, more: float) -> None:
    distance = v**2 / (2 * BRAKE_MPS2) + more
    t = np.linspace(0.0, distance / v + v / BRAKE_MPS2, 2001)
    way = walked(t, v, distance)
    speed = np.diff(way) / np.diff(t)
    assert abs(way[0]) < 1e-12 and way[-1] == pytest.approx(distance)
    assert (speed > -1e-9).all() and (speed < v + 1e-9).all()
    assert np.abs(np.diff(speed) / np.diff(t)[1:]).max() < BRAKE_MPS2 * 1.01
