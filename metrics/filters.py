"""Filtered comfort signals as others define them, beside the unfiltered ones of `comfort`.

SG(w, p) is the smoothing filter of Savitzky and Golay over w samples with polynomials of degree p, SG' and SG'' the
derivatives of its polynomials (`scipy.signal.savgol_filter`); a window longer than the drive is cut to it.

nuPlan (devkit e9241677, state_extractors.py), the drive sampled every 0.1 s:

(1) lon_accel = SG(8, 2) of a,  lat_accel = SG(8, 2) of v^2 kappa
(2) lon_jerk = SG'(15, 2) of SG(8, 2) of a,  jerk = SG'(15, 2) of SG(8, 2) of hypot(a, v^2 kappa)
(3) yaw_rate = SG'(5, 2) of yaw,  yaw_accel = SG''(5, 3) of yaw

The even window shifts the signal by half a sample; (2) is d|a|/dt and not |da/dt|. Both are nuPlan's.

UN R79 (lateral jerk of automated lane changes), the drive sampled every 0.01 s:

(4) B = v^2 kappa through a causal Butterworth low-pass of 4th order at 0.5 Hz, at rest on its first value
(5) lat_jerk = mean of dB/dt over 0.5 s = (B(t) - B(t - 0.5 s)) / 0.5 s
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from logs.kernel import FloatArray
from logs.states import Trajectory
from metrics.metric import changed

NUPLAN_STEP_S, NUPLAN_LEAST_S = 0.1, 0.4
"""Below 5 samples nuPlan's polynomials are not defined."""
R79_STEP_S, R79_MEAN_S, R79_CUT_HZ, R79_ORDER = 0.01, 0.5, 0.5, 4


def regular(drive: Trajectory, step: float) -> Trajectory:
    """The drive every `step` s from its start, linear between its samples."""
    count = int((float(drive.t[-1] - drive.t[0]) + 1e-9) / step) + 1
    return drive.resampled(drive.t[0] + step * np.arange(count))


def _smooth(value: FloatArray) -> FloatArray:
    from scipy.signal import savgol_filter  # here and below: its import takes longer than that of all metrics

    return np.asarray(savgol_filter(value, min(8, len(value)), 2))


def _derived(value: FloatArray, t: FloatArray, window: int, degree: int, order: int) -> FloatArray:
    """SG' or SG'' with the mean step as nuPlan takes it."""
    from scipy.signal import savgol_filter

    step = float(np.mean(np.diff(t)))
    return np.asarray(savgol_filter(value, min(window, len(value)), degree, deriv=order, delta=step))


def _lateral(drive: Trajectory) -> FloatArray:
    return np.asarray(drive.v**2 * drive.kappa)


NUPLAN: Mapping[str, Callable[[Trajectory], FloatArray]] = MappingProxyType({
    "lon_accel": lambda drive: _smooth(drive.a),  # (1)
    "lat_accel": lambda drive: _smooth(_lateral(drive)),
    "lon_jerk": lambda drive: _derived(_smooth(drive.a), drive.t, 15, 2, 1),  # (2)
    "jerk": lambda drive: _derived(_smooth(np.hypot(drive.a, _lateral(drive))), drive.t, 15, 2, 1),
    "yaw_rate": lambda drive: _derived(drive.yaw, drive.t, 5, 2, 1),  # (3)
    "yaw_accel": lambda drive: _derived(drive.yaw, drive.t, 5, 3, 2),
})  # fmt: skip
"""Signals of a drive with steps of `NUPLAN_STEP_S`."""

NUPLAN_FORMULAE = MappingProxyType({
    "lon_accel": "SG(8, 2) of a",
    "lat_accel": "SG(8, 2) of v^2 kappa",
    "lon_jerk": "SG'(15, 2) of SG(8, 2) of a",
    "jerk": "SG'(15, 2) of SG(8, 2) of hypot(a, v^2 kappa)",
    "yaw_rate": "SG'(5, 2) of yaw",
    "yaw_accel": "SG''(5, 3) of yaw",
})  # fmt: skip


def r79_jerk(drive: Trajectory) -> FloatArray:
    """(5) of a drive with steps of `R79_STEP_S`; NaN in the first 0.5 s."""
    from scipy.signal import butter, sosfilt, sosfilt_zi

    sections = butter(R79_ORDER, R79_CUT_HZ, fs=1.0 / R79_STEP_S, output="sos")
    lateral = _lateral(drive)
    low, _ = sosfilt(sections, lateral, zi=sosfilt_zi(sections) * lateral[0])  # (4)
    return changed(drive.t, np.asarray(low), R79_MEAN_S)  # (5)
