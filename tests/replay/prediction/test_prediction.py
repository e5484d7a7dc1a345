"""Predictions: what holds for every method, and the two that need no road."""

from dataclasses import replace

import numpy as np
import pytest
from handmade import track, tracks
from hypothesis import given, settings, strategies as st
from roads import curve, lanes

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind, Agents
from replan.logs.frame import Predictions
from replan.logs.road import Lane, Road
from replan.logs.states import wrap, wrapped
from replan.replay.parts import PREDICTION
from replan.replay.prediction import LaneMap, predict

COORDINATE = st.floats(-500.0, 500.0)
STATE = st.tuples(
    COORDINATE, COORDINATE, st.floats(-4.0, 4.0), st.floats(-30.0, 30.0), st.floats(-30.0, 30.0)
)
KINDS = tuple(AgentKind)
COLUMNS = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "accel")


def agents(states: list[tuple[float, ...]]) -> Agents:
    x, y, yaw, vx, vy = np.array(states, float).reshape(-1, 5).T
    n = len(x)
    return Agents(
        tuple(map(str, range(n))),
        n * (AgentKind.CAR,),
        np.full(n, 4.5),
        np.full(n, 1.8),
        x,
        y,
        yaw,
        vx,
        vy,
    )


def crossing() -> Road:
    """Two lanes that bend, a fork at the end of the right one, and a lane across."""
    bend = curve((60.0, 0.0), (30.0, 0.02), (60.0, 0.0))
    roads = [
        lanes(bend, 2),
        lanes(np.column_stack([np.full(40, 40.0), np.arange(-40.0, 40.0, 2.0)])),
    ]
    found = [*roads[0].lanes.values()]
    c, s = np.cos(0.6), np.sin(0.6)
    onward = curve((60.0, 0.0)) @ np.array([[c, s], [-s, c]]) + bend[-1]
    aside = curve((60.0, -0.05)) @ np.array([[c, s], [-s, c]]) + bend[-1]
    forks = [next(iter(lanes(points).lanes.values())) for points in (onward, aside)]
    across = next(iter(roads[1].lanes.values()))
    parts = [renamed(lane, i) for i, lane in enumerate([*found, *forks, across])]
    parts[0] = renamed(parts[0], 0, successors=(2, 3))
    return Road({lane.id: lane for lane in parts})


def renamed(lane: Lane, number: int, **changes: object) -> Lane:
    return replace(lane, id=number, **changes)  # type: ignore[arg-type]


def crowd(seed: int, n: int = 12) -> Agents:
    """Road users of all kinds about the lanes of `crossing`, moving mostly along them."""
    rng = np.random.default_rng(seed)
    path = curve((60.0, 0.0), (30.0, 0.02), (60.0, 0.0))
    at = rng.integers(0, len(path) - 1, n)
    heading = np.arctan2(*(path[at + 1] - path[at]).T[::-1]) + rng.normal(0.0, 0.15, n)
    x, y = path[at].T + rng.normal(0.0, 2.0, (2, n))
    v = np.where(rng.uniform(size=n) < 0.2, 0.0, rng.uniform(0.0, 20.0, n))
    kinds = tuple(KINDS[i] for i in rng.integers(0, len(KINDS), n))
    yaw = heading + np.where(rng.uniform(size=n) < 0.15, np.pi, 0.0)
    return Agents(
        tuple(map(str, range(n))),
        kinds,
        np.full(n, 4.5),
        np.full(n, 1.8),
        x,
        y,
        yaw,
        v * np.cos(yaw),
        v * np.sin(yaw),
        rng.normal(0.0, 0.2, n),
        rng.normal(0.0, 1.0, n),
    )


def placed(now: Agents, turn: float, dx: float, dy: float, sign: float = 1.0) -> Agents:
    """Mirrored at the x axis (sign -1), then turned about the origin, then shifted."""
    c, s = np.cos(turn), np.sin(turn)
    return Agents(
        now.ids,
        now.kinds,
        now.length,
        now.width,
        dx + c * now.x - s * sign * now.y,
        dy + s * now.x + c * sign * now.y,
        sign * now.yaw + turn,
        c * now.vx - s * sign * now.vy,
        s * now.vx + c * sign * now.vy,
        sign * now.yaw_rate,
        now.accel,
    )


def placed_road(road: Road, turn: float, dx: float, dy: float, sign: float = 1.0) -> Road:
    c, s = np.cos(turn), np.sin(turn)

    def side(points: FloatArray) -> FloatArray:
        x, y = points[:, 0], sign * points[:, 1]
        return np.column_stack([dx + c * x - s * y, dy + s * x + c * y])

    found = {}
    for i, lane in road.lanes.items():
        left, right = side(lane.left), side(lane.right)
        beside = (lane.left_neighbour, lane.right_neighbour)
        if sign < 0.0:
            left, right, beside = right, left, beside[::-1]
        found[i] = renamed(
            lane, i, left=left, right=right, left_neighbour=beside[0], right_neighbour=beside[1]
        )
    return Road(found)


def same(one: Predictions, two: Predictions, atol: float = 1e-6) -> None:
    np.testing.assert_array_equal(one.agent, two.agent)
    order = [
        np.lexsort((np.round(p.x[:, -1], 3), np.round(p.probability, 6), p.agent))
        for p in (one, two)
    ]
    for name in ("probability", "x", "y"):
        mine, theirs = getattr(one, name)[order[0]], getattr(two, name)[order[1]]
        np.testing.assert_allclose(mine, theirs, atol=atol, err_msg=name)
    turned = wrapped(one.yaw[order[0]] - two.yaw[order[1]])
    np.testing.assert_allclose(turned, 0.0, atol=atol)


@pytest.mark.parametrize("method", PREDICTION.causal)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 100.0))
@settings(max_examples=15)
def test_every_future_begins_at_its_agent_and_is_one_of_some(
    method: str, seed: int, t: float
) -> None:
    now = crowd(seed)
    future = predict(now, t, method=method, lanes=LANES)
    assert future.method == method and future.x.shape == (len(future), 81)
    np.testing.assert_allclose(future.t, t + 0.1 * np.arange(81))
    np.testing.assert_allclose(np.bincount(future.agent, future.probability, len(now)), 1.0)
    assert (np.diff(future.agent) >= 0).all() and (future.probability > 0.0).all()
    np.testing.assert_allclose(future.x[:, 0], now.x[future.agent], atol=1e-9)
    np.testing.assert_allclose(future.y[:, 0], now.y[future.agent], atol=1e-9)
    np.testing.assert_allclose(future.yaw[:, 0], now.yaw[future.agent], atol=1e-9)
    assert (
        np.isfinite(future.x).all()
        and np.isfinite(future.y).all()
        and np.isfinite(future.yaw).all()
    )


LANES = LaneMap.of(crossing())


@pytest.mark.parametrize("method", PREDICTION.causal)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(-3.0, 3.0),
    COORDINATE,
    COORDINATE,
    st.sampled_from([1.0, -1.0]),
)
@settings(max_examples=15)
def test_predictions_move_with_the_world(
    method: str, seed: int, turn: float, dx: float, dy: float, sign: float
) -> None:
    now = crowd(seed)
    here = predict(now, 0.0, method=method, lanes=LANES)
    moved = LaneMap.of(placed_road(crossing(), turn, dx, dy, sign))
    there = predict(placed(now, turn, dx, dy, sign), 0.0, method=method, lanes=moved)
    c, s = np.cos(turn), np.sin(turn)
    expected = Predictions(
        here.t,
        here.agent,
        here.probability,
        dx + c * here.x - s * sign * here.y,
        dy + s * here.x + c * sign * here.y,
        sign * here.yaw + turn,
        method,
    )
    same(expected, there)


@pytest.mark.parametrize("method", PREDICTION.causal)
def test_who_else_is_there_changes_no_prediction(method: str) -> None:
    now = crowd(5)
    alone = Agents(
        now.ids[:1],
        now.kinds[:1],
        now.length[:1],
        now.width[:1],
        *(getattr(now, name)[:1] for name in COLUMNS),
    )
    all_, one = (predict(who, 0.0, method=method, lanes=LANES) for who in (now, alone))
    mine = all_.agent == 0
    np.testing.assert_array_equal(all_.x[mine], one.x)
    np.testing.assert_array_equal(all_.probability[mine], one.probability)


@pytest.mark.parametrize("method", PREDICTION.causal)
def test_every_method_keeps_the_form_without_lanes_and_without_agents(method: str) -> None:
    now = agents([(0.0, 1.0, 0.0, 5.0, 0.0), (3.0, 1.0, 0.2, 0.0, 0.0)])
    future = predict(now, 2.0, horizon=4.0, step=0.2, method=method)
    np.testing.assert_allclose(future.t, 2.0 + 0.2 * np.arange(21))
    np.testing.assert_allclose(np.bincount(future.agent, future.probability, len(now)), 1.0)
    nobody = predict(agents([]), 0.0, method=method, lanes=LANES)
    assert len(nobody) == 0 and nobody.x.shape == (0, 81)


@given(st.lists(STATE, max_size=6))
def test_constant_velocity_keeps_velocity_and_heading(states: list[tuple[float, ...]]) -> None:
    now = agents(states)
    future = predict(now, 0.0)
    np.testing.assert_allclose(
        np.diff(future.x, axis=1), 0.1 * now.vx[:, None] * np.ones(80), atol=1e-8
    )
    np.testing.assert_allclose(
        np.diff(future.y, axis=1), 0.1 * now.vy[:, None] * np.ones(80), atol=1e-8
    )
    np.testing.assert_array_equal(future.yaw, np.repeat(now.yaw[:, None], 81, axis=1))


@given(st.floats(2.0, 20.0), st.floats(-0.15, 0.15), st.floats(-3.0, 3.0))
def test_who_drives_a_circle_in_the_log_is_predicted_on_it(
    v: float, kappa: float, yaw: float
) -> None:
    """Yaw rate by backward differences, then the arc: exact, as long as it is within what a vehicle
    can turn.
    """
    rate = np.clip(v * kappa, -4.9 / v, 4.9 / v)
    t = np.arange(0.0, 3.0, 0.1)
    r = v / rate if abs(rate) > 1e-8 else np.inf

    def place(time: FloatArray) -> tuple[FloatArray, FloatArray]:
        turned = yaw + rate * time
        if not np.isfinite(r):
            return v * time * np.cos(yaw), v * time * np.sin(yaw)
        return r * (np.sin(turned) - np.sin(yaw)), r * (np.cos(yaw) - np.cos(turned))

    x, y = place(t)
    heading = yaw + rate * t
    seen = tracks(
        track("a", t, x, y, yaw=heading, vx=v * np.cos(heading), vy=v * np.sin(heading))
    ).perceived(t[-1])
    assert seen.yaw_rate[0] == pytest.approx(rate, abs=1e-9) and seen.accel[0] == pytest.approx(
        0.0, abs=1e-6
    )
    future = predict(seen, t[-1], method="constant_turn_rate")
    x, y = place(future.t)
    np.testing.assert_allclose(future.x[0], x, atol=1e-4)
    np.testing.assert_allclose(future.y[0], y, atol=1e-4)


def test_pedestrians_and_who_hardly_moves_do_not_turn() -> None:
    now = crowd(1, 2)
    for kind, v in ((AgentKind.PEDESTRIAN, 2.0), (AgentKind.CAR, 0.5)):
        one = Agents(
            ("a", "b"),
            (kind, kind),
            now.length,
            now.width,
            now.x,
            now.y,
            now.yaw,
            v * np.cos(now.yaw),
            v * np.sin(now.yaw),
            np.full(2, 0.3),
        )
        straight, turning = (
            predict(one, 0.0, method=m) for m in ("constant_velocity", "constant_turn_rate")
        )
        np.testing.assert_allclose(turning.x, straight.x, atol=1e-9)
        np.testing.assert_allclose(turning.yaw, straight.yaw, atol=1e-9)


def test_trends_are_backward_differences_and_unknown_is_zero() -> None:
    t = np.array([0.0, 0.5, 1.0, 1.5])
    log = tracks(
        track("car", t, [0.0, 1.0, 3.0, 6.0], np.zeros(4), yaw=[0.0, 0.1, 0.3, 0.6]),
        track("new", [1.5], [9.0], [0.0], vx=3.0, vy=0.0),
        track("walker", t, t, np.zeros(4), yaw=[0.0, 1.0, 2.0, 3.0], kind=AgentKind.PEDESTRIAN),
        track("cone", [0.0], [5.0], [5.0], static=True),
    )
    seen = log.perceived(1.5)
    assert seen.yaw_rate == pytest.approx([0.5, 0.0, 0.0, 0.0])
    assert seen.accel == pytest.approx([4.0, 0.0, 0.0, 0.0])  # 6 m/s now, 2 m/s one second before
    assert abs(wrap(float(log.perceived(1.0).yaw_rate[0]) - 0.3)) < 1e-9
