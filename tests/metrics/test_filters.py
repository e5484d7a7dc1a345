"""The filters of comfort: SciPy's, to the bit, whose import takes longer than a drive's metrics."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, savgol_filter, sosfilt, sosfilt_zi

from metrics.filters import R79_CUT_HZ, R79_ORDER, R79_REST, R79_SECTIONS, R79_STEP_S, filtered, savgol

SIGNALS = st.lists(st.floats(-50.0, 50.0), min_size=15, max_size=60).map(np.array)


@pytest.mark.parametrize(
    ("window", "degree", "order"), [(8, 2, 0), (15, 2, 1), (5, 2, 1), (5, 3, 2), (6, 2, 0), (7, 2, 1)]
)
@given(SIGNALS, st.floats(0.01, 0.2))
def test_smoothed_and_derived_signals_are_those_of_scipy_to_the_bit(
    window: int, degree: int, order: int, x: np.ndarray, step: float
) -> None:
    expected = savgol_filter(x, window, degree, deriv=order, delta=step)
    assert np.array_equal(savgol(x, window, degree, order, step), expected)


@given(SIGNALS)
def test_the_low_pass_of_r79_is_that_of_scipy_to_the_bit(x: np.ndarray) -> None:
    sections = butter(R79_ORDER, R79_CUT_HZ, fs=1.0 / R79_STEP_S, output="sos")
    assert np.array_equal(R79_SECTIONS, sections) and np.array_equal(R79_REST, sosfilt_zi(sections))
    expected, _ = sosfilt(sections, x, zi=sosfilt_zi(sections) * x[0])
    assert np.array_equal(filtered(R79_SECTIONS, R79_REST * x[0], x), expected)
