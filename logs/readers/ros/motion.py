"""Motion from jittering positions, causal: least squares over a short backward window.

With u = t_i - t_k <= 0 the times of the window's samples relative to its last one k, per coordinate

(1) z(u) = z_k + z'_k u + z''_k u^2 / 2   fitted to the samples with u >= -W: z'_k is the rate, z''_k its change

A parabola has no lag while the acceleration is constant; its end is noisier than a line's. With 1.5 cm of noise at
50 Hz and W = 0.6 s the speed's standard deviation is 0.06 m/s (difference of two samples: 1.1 m/s), the acceleration's
0.2 m/s2. Where the window holds fewer than `PARABOLA` samples a straight line is fitted. No later sample goes in.
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
_ROWS = 20_000


def window_of(t: FloatArray, wanted: float) -> float:
    """The window's length for samples at `t` `(n,)`, s."""
    return max(wanted, LEAST * float(np.median(np.diff(t)))) if len(t) > 1 else wanted


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
    n = len(t)
    begin = np.maximum(first, _begins(t, first, window))
    width = int((np.arange(n) - begin).max(initial=0)) + 1
    parts = [
        _rates(t, values, np.arange(k, min(k + _ROWS, n)), begin, width, parabola=parabola) for k in range(0, n, _ROWS)
    ]
    joined = np.concatenate(parts, axis=2) if parts else np.empty((2, len(values), 0))
    return joined[0], joined[1]


def _begins(t: FloatArray, first: IntArray, window: FloatArray) -> IntArray:
    """The first sample within the window of each, by a search within the samples of the same owner."""
    out = np.empty(len(t), np.int64)
    bounds = np.flatnonzero(np.diff(first, prepend=-1))
    for begin, end in zip(bounds, np.append(bounds[1:], len(t)), strict=True):
        out[begin:end] = begin + np.searchsorted(t[begin:end], t[begin:end] - window[begin:end] - 1e-9)
    return out


def _rates(
    t: FloatArray, values: FloatArray, rows: IntArray, begin: IntArray, width: int, *, parabola: bool
) -> FloatArray:
    at = rows[:, None] - np.arange(width)[::-1]
    inside = at >= begin[rows, None]
    at = np.maximum(at, 0)
    u = np.where(inside, t[at] - t[rows, None], 0.0)
    count = inside.sum(axis=1)
    span = -u.min(axis=1)
    scale = np.where(span > 0.0, span, 1.0)
    u = u / scale[:, None]
    z = np.where(inside, values[:, at] - values[:, rows, None], 0.0)
    powers = [inside.sum(axis=1), *((u**k).sum(axis=1) for k in range(1, 5))]
    moments = [z.sum(axis=2), (z * u).sum(axis=2), (z * u**2).sum(axis=2)]
    curved = (count >= PARABOLA) & parabola
    out = np.full((2, len(values), len(rows)), np.nan)
    det = powers[0] * powers[2] - powers[1] ** 2
    line = (count >= 2) & ~curved & (det > 0.0)
    out[0][:, line] = ((powers[0] * moments[1] - powers[1] * moments[0])[:, line]) / det[line] / scale[line]
    out[1][:, line] = 0.0
    if curved.any():
        normal = np.array([[powers[i + j][curved] for j in range(3)] for i in range(3)]).transpose(2, 0, 1)
        right = np.array([moment[:, curved] for moment in moments]).transpose(2, 0, 1)
        found = np.linalg.solve(normal, right)
        out[0][:, curved] = (found[:, 1] / scale[curved, None]).T
        out[1][:, curved] = (2.0 * found[:, 2] / scale[curved, None] ** 2).T
    return out


def curvature(yaw_rate: FloatArray, v: FloatArray) -> FloatArray:
    """Yaw rate over speed `(n,)`, 1/m; where the car is slow, the value before, at first 0."""
    moved = np.abs(v) >= SLOW_MPS
    kappa = np.divide(yaw_rate, v, out=np.zeros(len(v)), where=moved)
    held = np.maximum.accumulate(np.where(moved, np.arange(len(v)), -1))
    return np.where(held >= 0, kappa[held], 0.0)
