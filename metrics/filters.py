"""Filtered comfort signals as others define them, beside the unfiltered ones of `comfort`.

SG(w, p) is the smoothing filter of Savitzky and Golay over w samples with polynomials of degree p, SG' and SG'' the
derivatives of its polynomials; a window longer than the drive is cut to it. All are `scipy.signal`'s, to the bit,
whose import takes longer than that of all metrics. Of samples x_i:

(0) SG: y_i = p_i(0), where p_i is nearest to the w samples around x_i, a weighted sum of these; of the first and last
    w // 2 samples p is nearest to the first and last w. SG' and SG'': p' and p'' instead.

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
from math import factorial
from types import MappingProxyType

import numpy as np
from scipy.linalg import lstsq

from logs.kernel import FloatArray, kernel
from logs.states import Trajectory
from metrics.metric import changed

NUPLAN_STEP_S, NUPLAN_LEAST_S = 0.1, 0.4
"""Below 5 samples nuPlan's polynomials are not defined."""
EPSILON = float(np.finfo(np.float64).eps)
R79_STEP_S, R79_MEAN_S, R79_CUT_HZ, R79_ORDER = 0.01, 0.5, 0.5, 4
R79_SECTIONS = np.array([
    [5.845142433144487e-8, 1.1690284866288973e-7, 5.845142433144487e-8, 1.0, -1.9426382305401135, 0.9435972784703671],
    [1.0, 2.0, 1.0, 1.0, -1.975269634851873, 0.9762447923594398],
])  # fmt: skip
"""(4) as `scipy.signal.butter` designs it: second-order sections, each b0 b1 b2 a0 a1 a2."""
R79_REST = np.array([
    [0.00024373092546731712, -0.00022998054113061475],
    [0.9997562106230959, -0.9760010029825362],
])  # fmt: skip
"""What the sections hold at rest on 1 (`scipy.signal.sosfilt_zi`)."""


def regular(drive: Trajectory, step: float) -> Trajectory:
    """The drive every `step` s from its start, linear between its samples."""
    count = int((float(drive.t[-1] - drive.t[0]) + 1e-9) / step) + 1
    return drive.resampled(drive.t[0] + step * np.arange(count))


def savgol(x: FloatArray, window: int, degree: int, order: int = 0, step: float = 1.0) -> FloatArray:
    """(0) of `x` `(n,)`, of which n is at least `window`: SG, or of that `order` with samples `step` s apart."""
    scale, half = step**order, window // 2
    wanted = np.zeros(degree + 1)
    wanted[order] = factorial(order) / scale
    around = np.flip(np.arange(window) - (window - 1) / 2)
    weights = _nearest(around ** np.arange(degree + 1.0)[:, None], wanted)[::-1]
    y = np.empty(len(x))
    first = (window - 1) // 2
    y[first : len(x) - half] = _weighted(x, weights, half)
    y[:half] = _fitted(x[:window], degree, order, np.arange(0.0, half)) / scale
    y[-half:] = _fitted(x[-window:], degree, order, np.arange(window - half, float(window))) / scale
    return y


def _weighted(x: FloatArray, weights: FloatArray, half: int) -> FloatArray:
    """Sums of `x` `(n,)` weighted in all windows `(n-w+1,)`, added up as SciPy does: equal weights together."""
    last, count = len(weights) - 1, len(x) - len(weights) + 1
    at = [x[k : k + count] for k in range(last + 1)]
    for sign in (1.0, -1.0) if last % 2 == 0 else ():
        if (np.abs(weights - sign * weights[::-1])[:half] <= EPSILON).all():
            pairs = ((at[k] + sign * at[last - k]) * weights[k] for k in range(half))
            return np.asarray(sum(pairs, at[half] * weights[half]))
    return np.asarray(sum((at[k] * weights[k] for k in range(last)), at[last] * weights[last]))


def _fitted(x: FloatArray, degree: int, order: int, at: FloatArray) -> FloatArray:
    """The polynomial nearest to `x` `(w,)` at 0, 1 ...: its derivative at some of these."""
    powers = np.arange(len(x))[:, None] ** np.arange(degree, -1.0, -1.0)
    lengths = np.sqrt(np.sum(powers * powers, axis=0))
    c = _nearest(powers / lengths, x) / lengths
    for _ in range(order):
        c = c[:-1] * np.arange(len(c) - 1.0, 0.0, -1.0)
    y = np.zeros(len(at))
    for each in c:
        y = y * at + each
    return y


def _nearest(a: FloatArray, b: FloatArray) -> FloatArray:
    """The least squares x of a x = b."""
    return np.asarray(lstsq(a, b, cond=EPSILON * max(a.shape))[0])


def _smooth(value: FloatArray) -> FloatArray:
    return savgol(value, min(8, len(value)), 2)


def _derived(value: FloatArray, t: FloatArray, window: int, degree: int, order: int) -> FloatArray:
    """SG' or SG'' with the mean step as nuPlan takes it."""
    return savgol(value, min(window, len(value)), degree, order, float(np.mean(np.diff(t))))


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
    lateral = _lateral(drive)
    low = filtered(R79_SECTIONS, R79_REST * lateral[0], lateral)  # (4)
    return changed(drive.t, low, R79_MEAN_S)  # (5)


@kernel
def filtered(sections: FloatArray, held: FloatArray, x: FloatArray) -> FloatArray:
    """`x` `(n,)` through sections `(m, 6)` in a row, in direct form II, transposed; `held` `(m, 2)` is overwritten."""
    out = np.empty(len(x))
    for i in range(len(x)):
        y = x[i]
        for k in range(len(sections)):
            u, y = y, sections[k, 0] * y + held[k, 0]
            held[k, 0] = sections[k, 1] * u - sections[k, 4] * y + held[k, 1]
            held[k, 1] = sections[k, 2] * u - sections[k, 5] * y
        out[i] = y
    return out
