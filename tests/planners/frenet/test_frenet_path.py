"""Path: the Frenet transform is exact there and back, and states between its points lie on it."""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from roads import curve

from replan.core.arrays import FloatArray
from replan.logs.reference_line import ReferenceLine
from replan.logs.states import EgoState
from replan.planners.frenet.path import (
    Path,
    frenet_start,
    make_path,
    out_of_frame,
    quintic,
    states_on_path,
)

SEED = st.integers(0, 2**32 - 1)
OFFSET, SLOPE, BEND = st.floats(-3.0, 3.0), st.floats(-0.5, 0.5), st.floats(-0.1, 0.1)


def quintic_at(
    l0: float, dl0: float, ddl0: float, l1: float, length: float, d: FloatArray
) -> FloatArray:
    """Rows l, l', l'' `(3, n)` of the quintic, by its definition as a polynomial."""
    polynomial = np.polynomial.Polynomial(
        [l0, dl0, 0.5 * ddl0, *quintic(l0, dl0, ddl0, l1, length)]
    )
    return np.array([polynomial(d), polynomial.deriv(1)(d), polynomial.deriv(2)(d)])


@given(OFFSET, SLOPE, BEND, OFFSET, st.floats(2.0, 40.0))
def test_the_quintic_meets_its_ends(
    l0: float, dl0: float, ddl0: float, l1: float, length: float
) -> None:
    begin, end = quintic_at(l0, dl0, ddl0, l1, length, np.array([0.0, length])).T
    np.testing.assert_allclose(begin, (l0, dl0, ddl0), atol=1e-12)
    np.testing.assert_allclose(end, (l1, 0.0, 0.0), atol=1e-9)


BENDS = st.lists(st.tuples(st.floats(15.0, 60.0), st.floats(-0.06, 0.06)), min_size=1, max_size=4)


def smooth_line(bends: list[tuple[float, float]]) -> ReferenceLine:
    """A line whose curvature is continuous: arcs with clothoids between them."""
    ends = np.cumsum([0.0, 20.0] + [length for length, _ in bends])
    kappa = np.interp(
        np.arange(0.0, ends[-1] + 20.0, 0.5), ends, [0.0, 0.0] + [k for _, k in bends]
    )
    return ReferenceLine.through(curve(*[(0.5, float(k)) for k in kappa], step=0.5))


@given(
    BENDS, st.floats(-2.0, 2.0), st.floats(-0.6, 0.6), st.floats(-0.05, 0.05), st.floats(5.0, 60.0)
)
@settings(max_examples=60)
def test_frenet_there_and_back(
    bends: list[tuple[float, float]],
    l: float,
    dl: float,
    ddl: float,
    s0: float,
) -> None:
    line = smooth_line(bends)
    assume(s0 < line.length - 5.0)
    knots = np.array([[l, l + dl + 0.5 * ddl], [dl, dl + ddl], [ddl, ddl]])
    path = make_path(line, s0, 1.0, knots)
    state = EgoState(0.0, path.x[0], path.y[0], path.yaw[0] + 4.0 * np.pi, 5.0, 0.0, path.kappa[0])
    s, offset = line.project(state.x, state.y, s0, 5.0)
    assert out_of_frame(line, state, s, offset) == ""
    assert s == pytest.approx(s0, abs=1e-6)
    np.testing.assert_allclose(frenet_start(line, state, s, offset), (l, dl, ddl), atol=1e-6)


@given(BENDS, SEED)
@settings(max_examples=40)
def test_heading_and_curvature_are_those_of_the_points(
    bends: list[tuple[float, float]], seed: int
) -> None:
    line = smooth_line(bends)
    rng = np.random.default_rng(seed)
    step, n = 0.25, round((line.length - 12.0) / 0.25)
    ddl = np.interp(step * np.arange(n), np.arange(0.0, 400.0, 15.0), rng.uniform(-0.02, 0.02, 27))
    dl = np.r_[0.0, np.cumsum(0.5 * step * (ddl[1:] + ddl[:-1]))]
    dl, ddl = dl * 0.2 / max(0.2, np.abs(dl).max()), ddl * 0.2 / max(0.2, np.abs(dl).max())
    l = np.r_[0.0, np.cumsum(step * dl[:-1] + step**2 * (ddl[:-1] / 3.0 + ddl[1:] / 6.0))]
    shrink = 2.0 / max(2.0, np.abs(l).max())
    path = make_path(line, 6.0, step, shrink * np.array([l, dl, ddl]))
    yaw = np.unwrap(np.arctan2(np.diff(path.y), np.diff(path.x)))
    middle = 0.5 * (path.yaw[1:] + path.yaw[:-1])
    np.testing.assert_allclose(
        yaw - 2.0 * np.pi * np.round((yaw[0] - middle[0]) / 2.0 / np.pi), middle, atol=2e-3
    )
    kappa = np.diff(path.yaw) / np.diff(path.sigma)
    np.testing.assert_allclose(kappa, 0.5 * (path.kappa[1:] + path.kappa[:-1]), atol=2e-3)


@given(st.floats(12.0, 80.0), st.booleans(), st.floats(-4.0, 4.0))
@settings(max_examples=30)
def test_a_constant_offset_from_a_circle_is_a_concentric_circle(
    radius: float, left: bool, offset: float
) -> None:
    kappa = (1.0 if left else -1.0) / radius
    line = ReferenceLine.through(curve((4.0 * radius, kappa), step=0.5))
    n = int(2.0 * radius)
    path = make_path(line, radius, 1.0, np.vstack([np.full(n, offset), np.zeros((2, n))]))
    x, y, yaw, _ = line.frame(2.0 * radius)
    center = np.array([x - np.sin(yaw) / kappa, y + np.cos(yaw) / kappa])
    away = np.hypot(path.x - center[0], path.y - center[1])
    np.testing.assert_allclose(away, abs(1.0 / kappa - offset), atol=2e-3)
    np.testing.assert_allclose(path.kappa, kappa / (1.0 - kappa * offset), rtol=5e-3)


def arc(radius: float, length: float, spacing: float) -> Path:
    sigma = np.arange(0.0, length, spacing)
    yaw = sigma / radius
    x, y = radius * np.sin(yaw), radius * (1.0 - np.cos(yaw))
    return Path(sigma, x, y, yaw, np.full(len(sigma), 1.0 / radius), sigma)


def states(path: Path, stations: FloatArray) -> FloatArray:
    return states_on_path(path.sigma, path.x, path.y, path.yaw, path.kappa, stations)


@given(st.floats(5.0, 200.0), st.lists(st.floats(0.0, 29.0), min_size=1, max_size=20))
def test_states_between_the_points_lie_on_the_circle(radius: float, stations: list[float]) -> None:
    at = np.sort(stations)
    x, y, yaw, kappa = states(arc(radius, 30.0, 0.4), at)
    np.testing.assert_allclose(x, radius * np.sin(at / radius), atol=1e-4)
    np.testing.assert_allclose(y, radius * (1.0 - np.cos(at / radius)), atol=1e-4)
    np.testing.assert_allclose(yaw, at / radius, atol=1e-9)
    np.testing.assert_allclose(kappa, 1.0 / radius, rtol=1e-9)


def test_beyond_its_end_a_path_goes_straight_on() -> None:
    path = arc(20.0, 10.0, 0.5)
    x, y, yaw, kappa = states(path, np.array([path.length, path.length + 3.0]))
    assert np.hypot(x[1] - x[0], y[1] - y[0]) == pytest.approx(3.0)
    assert yaw[1] == yaw[0] == path.yaw[-1] and kappa[1] == 0.0


def test_a_state_outside_the_frame_has_a_reason() -> None:
    line = ReferenceLine.through(curve((60.0, 0.1)))
    x, y, yaw, _ = line.frame(30.0)
    assert "120 degrees" in out_of_frame(
        line, EgoState(0.0, x, y, yaw + np.radians(120.0), 5.0), 30.0, 0.0
    )
    assert "centre" in out_of_frame(line, EgoState(0.0, x, y, yaw, 5.0), 30.0, 9.5)
    assert out_of_frame(line, EgoState(0.0, x, y, yaw + np.radians(-60.0), 5.0), 30.0, 8.0) == ""
