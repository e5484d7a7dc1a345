"""The cubic spline: SciPy's, to the bit, so that reference lines are what they were."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from logs.kernel import FloatArray
from logs.spline import spline_at, spline_pieces, spline_slope

COORDINATES = st.floats(-1e3, 1e3)


@st.composite
def lines(draw: st.DrawFn) -> tuple[FloatArray, FloatArray]:
    steps = draw(st.lists(st.floats(1e-3, 50.0), min_size=1, max_size=12))
    x = np.cumsum([0.0, *steps])
    return x, np.array([draw(st.tuples(COORDINATES, COORDINATES)) for _ in x])


@given(lines())
def test_pieces_values_and_slopes_are_those_of_scipy_to_the_bit(line: tuple[FloatArray, FloatArray]) -> None:
    x, y = line
    theirs, pieces = CubicSpline(x, y), spline_pieces(x, y)
    at = np.r_[x, np.linspace(x[0] - 1.0, x[-1] + 1.0, 17)]
    assert pieces.tobytes() == theirs.c.tobytes()
    assert np.array_equal(spline_at(x, pieces, at), theirs(at))
    assert np.array_equal(spline_slope(x, pieces, at), theirs(at, 1))


def test_a_cubic_is_met_exactly_and_goes_on_beyond_its_ends() -> None:
    x = np.array([0.0, 1.0, 3.0, 4.0, 7.0])
    pieces = spline_pieces(x, np.c_[x**3, 2.0 - x])
    at = np.array([-1.0, 0.5, 2.0, 8.0])
    assert np.allclose(spline_at(x, pieces, at), np.c_[at**3, 2.0 - at], atol=1e-9)
    assert np.allclose(spline_slope(x, pieces, at), np.c_[3 * at**2, np.full(4, -1.0)], atol=1e-9)
