"""Predictions: constant velocity is a straight line, whatever the frame of reference."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from logs import AgentKind, Agents, ConfigError
from planners.prediction import PREDICTORS, predict

COORDINATE = st.floats(-500.0, 500.0)
STATE = st.tuples(COORDINATE, COORDINATE, st.floats(-4.0, 4.0), st.floats(-30.0, 30.0), st.floats(-30.0, 30.0))


def agents(states: list[tuple[float, ...]]) -> Agents:
    x, y, yaw, vx, vy = np.array(states, float).reshape(-1, 5).T
    n = len(x)
    return Agents(tuple(map(str, range(n))), n * (AgentKind.CAR,), np.full(n, 4.5), np.full(n, 1.8), x, y, yaw, vx, vy)


@given(st.lists(STATE, max_size=6), st.floats(0.0, 100.0))
def test_constant_velocity_starts_at_the_agent_and_keeps_its_velocity(
    states: list[tuple[float, ...]], t: float
) -> None:
    now = agents(states)
    future = predict(now, t)
    assert len(future) == len(now) and future.x.shape == (len(now), 81)
    np.testing.assert_array_equal(future.x[:, 0], now.x)
    np.testing.assert_array_equal(future.y[:, 0], now.y)
    np.testing.assert_allclose(np.diff(future.x, axis=1), 0.1 * now.vx[:, None] * np.ones(80), atol=1e-8)
    np.testing.assert_allclose(np.diff(future.y, axis=1), 0.1 * now.vy[:, None] * np.ones(80), atol=1e-8)
    np.testing.assert_array_equal(future.yaw, np.repeat(now.yaw[:, None], 81, axis=1))


@given(st.lists(STATE, min_size=1, max_size=4), st.floats(-3.0, 3.0), COORDINATE, COORDINATE)
def test_prediction_turns_and_moves_with_the_world(
    states: list[tuple[float, ...]], turn: float, dx: float, dy: float
) -> None:
    now = agents(states)
    c, s = np.cos(turn), np.sin(turn)
    moved = Agents(
        now.ids, now.kinds, now.length, now.width,
        dx + c * now.x - s * now.y, dy + s * now.x + c * now.y, now.yaw + turn,
        c * now.vx - s * now.vy, s * now.vx + c * now.vy,
    )  # fmt: skip
    here, there = predict(now, 0.0), predict(moved, 0.0)
    np.testing.assert_allclose(there.x, dx + c * here.x - s * here.y, atol=1e-9)
    np.testing.assert_allclose(there.y, dy + s * here.x + c * here.y, atol=1e-9)


@pytest.mark.parametrize("method", PREDICTORS)
def test_every_method_keeps_the_form(method: str) -> None:
    now = agents([(0.0, 1.0, 0.0, 5.0, 0.0), (3.0, 1.0, 0.2, 0.0, 0.0)])
    future = predict(now, 2.0, horizon=4.0, step=0.2, method=method)
    assert future.method == method
    np.testing.assert_allclose(future.t, 2.0 + 0.2 * np.arange(21))
    np.testing.assert_allclose(np.bincount(future.agent, future.probability, len(now)), 1.0)


def test_an_unknown_method_is_named_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match="did you mean 'constant_velocity'"):
        predict(agents([]), 0.0, method="constant_velocty")
