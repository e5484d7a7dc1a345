"""Speed profiles: the limit can be driven, cruising follows it, braking keeps its limits and its
distance.
"""

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from replan.core.arrays import FloatArray
from replan.planners.frenet.profiles import STEP_S, braking, cruising, limit_profile

KAPPA = st.lists(st.floats(-0.2, 0.2), min_size=2, max_size=8)
LIMIT = st.lists(st.floats(0.0, 20.0), min_size=2, max_size=8)


def profile(
    kappa: list[float], limit: list[float]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Stations, curvature, limit and the profile (2) of them."""
    sigma = 0.5 * np.arange(300)
    k, v = (
        np.interp(sigma, np.linspace(0.0, 150.0, len(values)), values) for values in (kappa, limit)
    )
    return sigma, k, v, limit_profile(sigma, k, v, 3.0, 1.5)


@given(KAPPA, LIMIT)
def test_the_limit_profile_keeps_every_limit_and_can_be_driven(
    kappa: list[float], limit: list[float]
) -> None:
    sigma, k, allowed, v = profile(kappa, limit)
    assert (v <= allowed + 1e-12).all() and (v**2 * np.abs(k) <= 3.0 + 1e-9).all()
    falling = -np.diff(v**2) / (2.0 * np.diff(sigma))
    assert falling.max() <= 1.5 + 1e-9
    own = np.minimum(allowed, np.sqrt(3.0 / np.maximum(np.abs(k), 1e-9)))
    # Lowered only as far as the deceleration asks for
    lowered = np.flatnonzero(v[:-1] < own[:-1] - 1e-9)
    np.testing.assert_allclose(falling[lowered], 1.5, atol=1e-9)


@given(KAPPA, LIMIT, st.floats(0.0, 1.0))
def test_cruising_follows_the_limit(kappa: list[float], limit: list[float], share: float) -> None:
    """Less than 1 m/s late where the limit bends down; at a constant limit it stays there."""
    sigma, _, _, v_limit = profile(kappa, limit)
    s, v = cruising(sigma, v_limit, share * v_limit[0], 0.0, 1.8, 3.0, 3.0, STEP_S, 81)
    assert (v >= 0.0).all() and (np.diff(s) >= 0.0).all()
    assert (v - np.interp(s, sigma, v_limit)).max() < 1.0
    assert np.abs(np.diff(v)).max() <= 3.0 * STEP_S + 1e-9
    even = np.full(300, 10.0)
    assert cruising(sigma, even, 10.0 * share, 0.0, 1.8, 3.0, 3.0, STEP_S, 81)[1].max() < 10.3
    assert cruising(sigma, even, 10.0, 0.0, 1.8, 3.0, 3.0, STEP_S, 81)[1].max() <= 10.0 + 1e-9


JERK = st.floats(2.0, 15.0)


def stopped(v0: float, a0: float, decel: float, jerk: float) -> FloatArray:
    return braking(v0, a0, decel, jerk, STEP_S, 600)


@given(st.floats(0.0, 35.0), st.floats(0.0, 1.0), st.floats(1.0, 8.0), JERK)
def test_braking_keeps_its_limits_and_ends_at_rest(
    v0: float, share: float, decel: float, jerk: float
) -> None:
    hardest = -min(decel, np.sqrt(2.0 * jerk * v0))
    s, v, a = stopped(v0, hardest + share * (1.8 - hardest), decel, jerk)
    assert (v >= 0.0).all() and (np.diff(s) >= 0.0).all()
    assert a.min() >= -decel - 1e-9
    assert np.abs(np.diff(a)).max() / STEP_S <= 1.01 * jerk
    assert v[-1] == a[-1] == 0.0 and s[-1] == s[-2]


@given(st.floats(0.3, 35.0), st.floats(1.0, 8.0), JERK)
def test_braking_takes_the_distance_of_the_closed_form(
    v0: float, decel: float, jerk: float
) -> None:
    """Jerk to the full deceleration, hold, jerk to rest.

    Where the speed is too low for it, jerk and jerk.
    """
    assume(decel >= jerk * STEP_S)  # the ramp takes a step at least: a profile knows no shorter one
    held = v0 >= decel**2 / jerk
    expected = (
        v0**2 / (2.0 * decel) + v0 * decel / (2.0 * jerk) if held else v0 * np.sqrt(v0 / jerk)
    )
    assert stopped(v0, 0.0, decel, jerk)[0, -1] == pytest.approx(expected, abs=0.05 + 0.007 * v0)


@given(st.floats(0.0, 30.0), st.floats(0.2, 3.0))
def test_harder_braking_is_shorter(v0: float, more: float) -> None:
    soft, hard = stopped(v0, 0.0, 3.0, 3.0)[0], stopped(v0, 0.0, 3.0 + more, 3.0 + more)[0]
    assert (hard <= soft + 1e-9).all()
