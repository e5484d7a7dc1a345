"""Motion from jittering positions, causal: least squares over a short backward window.

With u = t_i - t_k <= 0 the times of the window's samples relative to its last one k, per coordinate

(1) z(u) = z_k + z'_k u + z''_k u^2 / 2   fitted to the samples with u >= -W: z'_k is the rate, z''_k its change

A parabola has no lag while the acceleration is constant; its end is noisier than a line's. With 1.5 cm of noise at
50 Hz and W = 0.6 s the speed's standard deviation is 0.06 m/s (difference of two samples: 1.1 m/s), the acceleration's
0.2 m/s2. Where the window holds fewer than `PARABOLA` samples a straight line is fitted. No later sample goes in.

A straight line's rate has the standard deviation, with sigma the noise of a position

(2) sigma_z' = sigma / sqrt(sum (u_i - mean u)^2)
"""

from __future__ import annotations

import numpy as np

from logs.kernel import FloatArray, IntArray

EGO_WINDOW_S = 0.6
LEAST = 3.0
"""A window is at least so many usual intervals long."""
PARABOLA = 5
STANDS_MPS = 0.05
"""Speeds below are a stand: what a standing car's localisation moves."""
SLOW_MPS = 0.5
"""Below, the heading says nothing of the curvature: the last one holds."""
AGENT_WINDOW_S, OBJECT_WINDOW_S = 0.5, 1.0
"""For the boxes of others (10 Hz): outlines of clusters jump by decimetres, and what is no road user hardly moves."""


def window_of(t: FloatArray, wanted: float) -> float:
    """The window's length for samples at `t` `(n,)`, s."""
    return max(wanted, LEAST * float(np.median(np.diff(t)))) if len(t) > 1 else wanted


def spread(t: FloatArray, first: IntArray, window: FloatArray) -> FloatArray:
    """The root in (2) `(n,)`, s, of the windows of `rates`; 0 where a window has one sample."""
    begin = np.maximum(first, _begins(t, first, window))
    count = np.arange(len(t)) - begin + 1
    since = t - t[begin]
    sums = np.zeros((2, len(t)))
    for back in range(int(count.max(initial=0))):
        u = np.where(back < count, t[np.maximum(np.arange(len(t)) - back, 0)] - t, 0.0) + since * (back < count)
        sums += u, u**2
    return np.sqrt(np.maximum(sums[1] - sums[0] ** 2 / count, 0.0))


def rates(
    t: FloatArray, values: FloatArray, first: IntArray, window: FloatArray, *, parabola: bool
) -> tuple[FloatArray, FloatArray]:
    """(1) at every sample: rates and their changes `(c, n)` of `values` `(c, n)`; NaN where a window has one sample.

    Args:
        t: `(n,)` s, rising where `first` is the same.
        values: Coordinates.
        first: `(n,)` first sample that may be in the window.
        window: `(n,)` W, s.
        parabola: Else straight lines only.
    """
    begin = np.maximum(first, _begins(t, first, window))
    rows = np.arange(len(t))
    span = t - t[begin]
    scale = np.where(span > 0.0, span, 1.0)
    powers, moments = np.zeros((5, len(t))), np.zeros((3, len(values), len(t)))
    for back in range(int((rows - begin).max(initial=0)) + 1):  # one after another: later samples change no bit
        inside = rows - back >= begin
        at = np.maximum(rows - back, 0)
        u = np.where(inside, (t[at] - t) / scale, 0.0)
        weights = inside * np.array([u**0, u, u**2, u**3, u**4])
        powers += weights
        moments += weights[:3, None] * np.where(inside, values[:, at] - values, 0.0)
    return _solved(powers, moments, scale, parabola=parabola)


def _solved(
    powers: FloatArray, moments: FloatArray, scale: FloatArray, *, parabola: bool
) -> tuple[FloatArray, FloatArray]:
    """Rates and changes `(c, n)` from sums of powers of u `(5, n)` and of the values times them `(3, c, n)`."""
    rate, change = np.full((2, *moments.shape[1:]), np.nan)
    curved = (powers[0] >= PARABOLA) & parabola
    det = powers[0] * powers[2] - powers[1] ** 2
    line = (powers[0] >= 2) & ~curved & (det > 0.0)
    rate[:, line] = (powers[0] * moments[1] - powers[1] * moments[0])[:, line] / det[line] / scale[line]
    change[:, line] = 0.0
    if curved.any():
        normal = np.array([[powers[i + j][curved] for j in range(3)] for i in range(3)]).transpose(2, 0, 1)
        found = np.linalg.solve(normal, moments[:, :, curved].transpose(2, 0, 1))
        rate[:, curved] = (found[:, 1] / scale[curved, None]).T
        change[:, curved] = (2.0 * found[:, 2] / scale[curved, None] ** 2).T
    return rate, change


def _begins(t: FloatArray, first: IntArray, window: FloatArray) -> IntArray:
    """The first sample within the window of each, by a search within the samples of the same owner."""
    out = np.empty(len(t), np.int64)
    bounds = np.flatnonzero(np.diff(first, prepend=-1))
    for begin, end in zip(bounds, np.append(bounds[1:], len(t)), strict=True):
        out[begin:end] = begin + np.searchsorted(t[begin:end], t[begin:end] - window[begin:end] - 1e-9)
    return out


def curvature(yaw_rate: FloatArray, v: FloatArray) -> FloatArray:
    """Yaw rate over speed `(n,)`, 1/m; where the car is slow, the value before, at first 0."""
    moved = np.abs(v) >= SLOW_MPS
    kappa = np.divide(yaw_rate, v, out=np.zeros(len(v)), where=moved)
    held = np.maximum.accumulate(np.where(moved, np.arange(len(v)), -1))
    return np.where(held >= 0, kappa[held], 0.0)
