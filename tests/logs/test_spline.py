"""The spline of a road's line is that of scipy, to the bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from logs.spline import spline_at, spline_through


@given(st.integers(2, 60), st.integers(0, 2**32 - 1), st.booleans())
def test_it_is_scipys_bit_by_bit(n: int, seed: int, even: bool) -> None:
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, rng.uniform(1.0, 300.0), n) if even else np.r_[0.0, np.cumsum(rng.uniform(1e-3, 5.0, n - 1))]
    points = np.cumsum(rng.normal(0.0, 10.0 ** rng.uniform(-2.0, 3.0), (n, 2)), axis=0)
    theirs, ours = CubicSpline(t, points), spline_through(t, points)
    np.testing.assert_array_equal(ours, np.hstack([theirs.c[:, :, 0].T, theirs.c[:, :, 1].T]))
    at = np.linspace(0.0, t[-1], 8 * n)
    for order in (0, 1):
        np.testing.assert_array_equal(spline_at(t, ours, at, order), theirs(at, order))


def test_a_parameter_that_stands_still_is_refused() -> None:
    with pytest.raises(ValueError, match="must increase"):
        spline_through(np.array([0.0, 1.0, 1.0, 2.0]), np.zeros((4, 2)))
