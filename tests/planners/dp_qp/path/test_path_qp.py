"""Path QP: it keeps its bounds at the least cost, leaves a closed corridor as little as it must,
and can be steered.
"""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from scenes import CAR

from replan.core.arrays import FloatArray
from replan.planners.dp_qp.path.corridor import COMFORT, MAX_DL
from replan.planners.dp_qp.path.qp import PathQp, PathQpConfig
from replan.planners.dp_qp.path.steering_reach import expected_speed, steering_bounds
from replan.planners.piecewise_jerk.problem import DDDX, DDX, DX, LEADS, PiecewiseJerkProblem, X
from replan.planners.piecewise_jerk.solvers import DEFAULT

SEED = st.integers(0, 2**32 - 1)
OFFSET, SLOPE, BEND = st.floats(-3.0, 3.0), st.floats(-0.5, 0.5), st.floats(-0.1, 0.1)

LENGTH, SPEED = 90.0, 6.0
KNOTS = PathQpConfig().knots
AHEAD = (0.0, CAR.axle_to_front)
POINTS = [X, LEADS]
"""Rows of the ego's points."""
MAX_RATE = 0.5


def path_problem(seed: int) -> PiecewiseJerkProblem:
    """A start near the line and a corridor with two obstacles nudged, wide enough to be driven."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, LENGTH, KNOTS) + np.array(AHEAD)[:, None]
    lower, upper = np.full(s.shape, -1.5), np.full(s.shape, 3.0)
    lower[(s > 30.0) & (s < 42.0)] = rng.uniform(-1.0, 1.5)
    upper[(s > 62.0) & (s < 74.0)] = rng.uniform(-0.8, 1.0)
    kappa = 0.01 * np.sin(s[0] / 20.0 + rng.uniform(0.0, 6.0))
    start = np.array([rng.uniform(-0.5, 0.5), rng.uniform(-0.05, 0.05), rng.uniform(-0.01, 0.01)])
    both, ones = np.array([[-1.0], [1.0]]), np.ones(KNOTS)
    return asked(
        start,
        lower,
        upper,
        MAX_DL * both * ones,
        CAR.max_kappa * both - kappa,
        MAX_RATE * both * ones,
    )


def asked(
    start: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    slope: FloatArray,
    bend: FloatArray,
    rate: FloatArray,
) -> PiecewiseJerkProblem:
    """A problem with bounds of the points `(points, knots)`, and of the first to third derivative
    `(2, knots)`.
    """
    rows = np.array(
        [[at[0], slope[i], bend[i], rate[i], at[1]] for i, at in enumerate((lower, upper))]
    )
    return OWN.stated(
        start, np.array([OWN.middle * (rows[0, X] + rows[1, X]), np.zeros(KNOTS)]), rows
    )


def cost_of(program: PathQp, x: FloatArray, middle: FloatArray) -> float:
    """J_1 + ... + J_5, written down from the module's docstring."""
    settle = max(1.2 * SPEED, 4.0)
    l, dl, ddl = x.reshape(3, -1)
    squares = (np.sum(v**2) for v in (l, dl, ddl, np.diff(ddl) / program.step, l - middle))
    weights = 1.0, (0.5 * settle) ** 2, settle**4, (0.7 * settle) ** 6, 0.1
    return float(sum(w * square for w, square in zip(weights, squares, strict=True)))


OWN, SURE = (PathQp(LENGTH, SPEED, AHEAD, PathQpConfig(), solver) for solver in (DEFAULT, "piqp"))


def points_of(x: FloatArray) -> FloatArray:
    """Offsets `(points, knots)` of the ego's points along a straight line."""
    l, dl, _ = x.reshape(3, -1)
    return np.asarray(l + np.array(AHEAD)[:, None] * dl)


def assert_drivable(
    program: PathQp, x: FloatArray, problem: PiecewiseJerkProblem, slack: float
) -> None:
    l, dl, ddl = x.reshape(3, -1)
    h = program.step
    np.testing.assert_allclose((l[0], dl[0], ddl[0]), problem.start, atol=slack)
    dddl = np.diff(ddl) / h
    points = points_of(x)
    for row, value in ((X, points[0]), (LEADS, points[1]), (DX, dl), (DDX, ddl), (DDDX, dddl)):
        low, high = problem.lower[row, 1 : len(value)], problem.upper[row, 1 : len(value)]
        assert (value[1:] >= low - slack).all() and (value[1:] <= high + slack).all()
    np.testing.assert_allclose(dl[1:], dl[:-1] + h * ddl[:-1] + 0.5 * h**2 * dddl, atol=slack)
    steps = l[:-1] + h * dl[:-1] + 0.5 * h**2 * ddl[:-1] + h**3 / 6.0 * dddl
    np.testing.assert_allclose(l[1:], steps, atol=slack)


@given(SEED)
@settings(max_examples=25)
def test_the_path_qp_keeps_its_bounds_and_finds_the_least_cost(seed: int) -> None:
    problem = path_problem(seed)
    fast, sure = OWN.solve(problem), SURE.solve(problem)
    assert fast.report.solved and sure.report.solved and "PIQP" in sure.report.status
    assert_drivable(OWN, fast.x, problem, 5e-3)
    assert_drivable(SURE, sure.x, problem, 1e-6)
    middle = 0.5 * (problem.lower[X] + problem.upper[X])
    best, found = cost_of(SURE, sure.x, middle), cost_of(OWN, fast.x, middle)
    assert found == pytest.approx(best, rel=2e-2, abs=0.05)
    assert sum(value for _, value in OWN.costs(fast.x, problem).terms) == pytest.approx(
        found, rel=1e-9
    )


@given(SEED, st.floats(0.0, 0.6), st.floats(0.0, 0.6))
@settings(max_examples=15)
def test_every_step_towards_another_path_of_the_corridor_costs_more(
    seed: int, low: float, high: float
) -> None:
    """The variational inequality of a convex problem: what a narrower corridor allows is allowed,
    but not better.
    """
    problem = path_problem(seed)
    middle = 0.5 * (problem.lower[X] + problem.upper[X])
    best = SURE.solve(problem)
    narrower = problem._replace(lower=problem.lower.copy(), upper=problem.upper.copy())
    narrower.lower[POINTS] += low
    narrower.upper[POINTS] -= high
    other = SURE.solve(narrower)
    assume(other.report.solved)
    step = best.x + 1e-3 * (other.x - best.x)
    assert cost_of(SURE, step, middle) >= cost_of(SURE, best.x, middle) - 1e-7


def closed(seed: int) -> PiecewiseJerkProblem:
    """A corridor that no path can keep."""
    problem = path_problem(seed)
    problem.lower[POINTS, 40], problem.upper[POINTS, 43] = 2.9, -1.4
    return problem


def test_a_closed_corridor_is_reported() -> None:
    assert not OWN.solve(closed(0)).report.solved


@given(SEED)
@settings(max_examples=10)
def test_a_softened_corridor_is_left_as_little_as_it_must(seed: int) -> None:
    """Where it is open hardly at all.

    Where it is closed to both sides alike, and steering keeps its bounds.
    """
    free = OWN.solve(path_problem(seed), softly=True)
    shut = OWN.solve(closed(seed), softly=True)
    assert free.report.solved and shut.report.solved
    asked_, at = path_problem(seed), points_of(free.x)
    out = np.maximum(asked_.lower[POINTS] - at, at - asked_.upper[POINTS])
    assert out[:, 1:].max() < 0.05
    wide = closed(seed)
    wide.lower[POINTS], wide.upper[POINTS] = -50.0, 50.0
    assert_drivable(OWN, shut.x, wide, 5e-3)
    at = points_of(shut.x)
    assert 0.5 < (2.9 - at[:, 40]).max() < 4.3 and 0.5 < (at[:, 43] + 1.4).max() < 4.3


@given(OFFSET, SLOPE, BEND, st.floats(1.0, 25.0), SEED)
@settings(max_examples=30)
def test_a_corridor_loosened_to_the_reach_can_be_kept(
    l0: float, dl0: float, ddl0: float, v: float, seed: int
) -> None:
    """Whatever one bound asks for, with the lateral acceleration and the steering rate of the
    speed.
    """
    rng = np.random.default_rng(seed)
    s, leads = np.linspace(0.0, LENGTH, KNOTS), np.array(AHEAD)[:, None]
    upper = np.interp(s + leads, np.linspace(0.0, LENGTH, 8), rng.uniform(0.2, 4.0, 8))
    start, none = np.array([l0, dl0, ddl0]), np.zeros(KNOTS)
    bend, rate, left, right = steering_bounds(
        np.r_[start, v], none + 30.0, none, none, OWN.step, TURNS, COMFORT
    )
    slope = np.array([np.minimum(-MAX_DL, left[1]), np.maximum(MAX_DL, right[1])])
    high = np.maximum(upper, right[0] + leads * right[1])
    result = SURE.solve(asked(start, 0.0 * high - 90.0, high, slope, bend, np.c_[rate, (0.0, 0.0)]))
    assert result.report.solved


TURNS = np.array([CAR.max_kappa, CAR.max_steer_rate / CAR.wheelbase, 3.0])


@given(st.floats(0.5, 30.0), st.floats(1.0, 40.0), st.floats(-0.2, 0.2))
def test_the_expected_speed_brakes_for_curves_as_hard_as_it_may(
    v0: float, limit: float, kappa: float
) -> None:
    bends = np.r_[np.zeros(20), np.full(20, kappa), np.zeros(20)]
    v = expected_speed(v0, np.full(60, limit), bends, 1.0, 1.8, 3.0, 3.0)
    assert (
        v[0] == v0
        and (np.diff(v**2) <= 2.0 * 1.8 + 1e-9).all()
        and (np.diff(v**2) >= -2.0 * 3.0 - 1e-9).all()
    )
    slow_enough = v**2 * np.abs(bends) <= 3.0 + 1e-9
    braking = np.r_[True, np.diff(v**2) < -6.0 + 1e-6]
    assert (slow_enough | braking).all()
