"""Speed QP: it keeps its bounds at the least cost, and reports what it cannot keep."""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError
from replan.planners.dp_qp.speed.qp import Rows, SpeedProblem, SpeedQp, SpeedQpConfig, rows_of
from replan.planners.frenet.profiles import STEP_S, SpeedLimits, braking

SEED = st.integers(0, 2**32 - 1)
CONFIG = SpeedQpConfig()


def speed_problem(seed: int) -> SpeedProblem:
    """A start that can brake for the bound: a limit, and an agent ahead who drives at constant
    speed.
    """
    rng = np.random.default_rng(seed)
    t = STEP_S * np.arange(CONFIG.knots)
    v0, limit = rng.uniform(0.0, 14.0), rng.uniform(8.0, 15.0)
    a0 = max(rng.uniform(-1.0, 1.0), -np.sqrt(2.0 * 0.9 * 3.0 * v0))
    stop = braking(v0, a0, 0.85 * 3.0, 0.85 * 3.0, STEP_S, CONFIG.knots)
    upper = np.maximum(rng.uniform(20.0, 60.0) + rng.uniform(0.0, 8.0) * t, stop[0])
    v_ref = np.minimum(limit, v0 + 1.0 * t)
    s_ref = np.minimum(np.cumsum(STEP_S * v_ref), upper)
    bound = np.maximum(np.full(CONFIG.knots, limit + 0.8), stop[1] + 0.05)
    return SpeedProblem((v0, a0), np.zeros(CONFIG.knots), upper, bound, s_ref, v_ref)


OWN, SURE = SpeedQp(CONFIG), SpeedQp(CONFIG, "piqp")


def rows(problem: SpeedProblem, limits: SpeedLimits = CONFIG.comfort) -> Rows:
    return rows_of(problem, limits.columns, CONFIG.comfort.decel_mps2)


def cost_of(x: FloatArray, problem: SpeedProblem) -> float:
    """(1), written down from the module's docstring."""
    s, v, a = x.reshape(3, -1)
    squares = (np.sum(e**2) for e in (s - problem.s_ref, v - problem.v_ref, a, np.diff(a) / STEP_S))
    return float(sum(w * square for w, square in zip((0.2, 1.0, 2.0, 3.0), squares, strict=True)))


def assert_drivable(
    x: FloatArray, problem: SpeedProblem, limits: SpeedLimits, slack: float
) -> None:
    s, v, a = x.reshape(3, -1)
    jerk = np.diff(a) / STEP_S
    np.testing.assert_allclose((s[0], v[0], a[0]), (0.0, *problem.start), atol=slack)
    assert (s[1:] <= problem.upper[1:] + slack).all() and (s[1:] >= problem.lower[1:] - slack).all()
    assert v.min() >= -slack and (v[1:] <= problem.limit[1:] + slack).all()
    assert a.min() >= -limits.decel_mps2 - slack and a.max() <= limits.accel_mps2 + slack
    assert np.abs(jerk).max() <= limits.jerk_mps3 + 10.0 * slack
    np.testing.assert_allclose(v[1:], v[:-1] + STEP_S * a[:-1] + 0.5 * STEP_S**2 * jerk, atol=slack)
    steps = s[:-1] + STEP_S * v[:-1] + 0.5 * STEP_S**2 * a[:-1] + STEP_S**3 / 6.0 * jerk
    np.testing.assert_allclose(s[1:], steps, atol=slack)


@given(SEED)
@settings(max_examples=25)
def test_the_speed_qp_keeps_its_bounds_and_finds_the_least_cost(seed: int) -> None:
    problem = speed_problem(seed)
    fast, sure = (program.solve(rows(problem)) for program in (OWN, SURE))
    assert fast.report.solved and sure.report.solved and "PIQP" in sure.report.status
    assert_drivable(fast.x, problem, CONFIG.comfort, 2e-2)
    assert_drivable(sure.x, problem, CONFIG.comfort, 1e-6)
    found = cost_of(fast.x, problem)
    assert found == pytest.approx(cost_of(sure.x, problem), rel=1e-2, abs=0.3)
    assert sum(value for _, value in OWN.costs(fast.x, problem).terms) == pytest.approx(
        found, rel=1e-9
    )


@given(SEED, st.floats(0.0, 10.0))
@settings(max_examples=15)
def test_every_step_towards_another_profile_within_the_bounds_costs_more(
    seed: int, less: float
) -> None:
    """The variational inequality of a convex problem, towards what a tighter bound of s allows."""
    problem = speed_problem(seed)
    best = SURE.solve(rows(problem)).x
    tight = SpeedProblem(
        problem.start,
        problem.lower,
        problem.upper - less,
        problem.limit,
        problem.s_ref,
        problem.v_ref,
    )
    other = SURE.solve(rows(tight))
    assume(other.report.solved)
    assert cost_of(best + 1e-3 * (other.x - best), problem) >= cost_of(best, problem) - 1e-7


def test_braking_is_a_profile_of_the_qp() -> None:
    """What `braking` says can be kept, the QP can keep."""
    s, v, a = braking(12.0, 0.5, 3.0, 3.0, STEP_S, CONFIG.knots)
    still = SpeedProblem((12.0, 0.5), s - 1e-3, s + 1e-3, v + 1e-3, s, v)
    result = SURE.solve(rows(still))
    assert result.report.solved
    np.testing.assert_allclose(result.x.reshape(3, -1)[2][:30], a[:30], atol=0.3)


def test_a_bound_behind_the_braking_distance_is_reported() -> None:
    problem = speed_problem(3)
    near = SpeedProblem(
        (12.0, 0.0),
        problem.lower,
        np.full(CONFIG.knots, 5.0),
        problem.limit,
        problem.s_ref,
        problem.v_ref,
    )
    assert not OWN.solve(rows(near, CONFIG.emergency)).report.solved


def test_one_weight_has_to_be_positive() -> None:
    with pytest.raises(ConfigError, match="w_s"):
        SpeedQpConfig(w_s=0.0, w_v=0.0, w_a=0.0, w_j=0.0)
