"""Fits lines and parabolas to positions that jitter, by least squares over a short backward window.

With u = t_i - t_k <= 0 the times of the samples in the window relative to its last one k, per
coordinate

(1) z(u) = z_k + z'_k u + z''_k u^2 / 2
        fitted to the samples with u >= -W: z'_k is the rate, z''_k its change

A parabola has no lag while the acceleration is constant; its end is noisier than that of a line.
With 1.5 cm of noise at 50 Hz and W = 0.6 s the standard deviation of the speed is 0.06 m/s
(difference of two samples: 1.1 m/s), of the acceleration 0.2 m/s2. Where the window holds fewer
than `PARABOLA` samples, a straight line is fitted. With sigma the noise of a position, the rate of
a straight line has the standard deviation

(2) sigma_z' = sigma / sqrt(sum (u_i - mean u)^2)
"""

from __future__ import annotations

import numpy as np

from replan.core.arrays import FloatArray, IntArray

PARABOLA = 5
"""Fewest samples to which a parabola is fitted."""


def spread(t: FloatArray, first: IntArray, window: FloatArray) -> FloatArray:
    """The root in (2) `(n,)`, s, of the windows of `rates`; 0 where a window has one sample."""
    begin = np.maximum(first, _begins(t, first, window))
    rows = np.arange(len(t))
    count = rows - begin + 1
    since = t - t[begin]
    sums = np.zeros((2, len(t)))
    for back in range(int(count.max(initial=0))):
        is_inside = back < count
        u = np.where(is_inside, t[np.maximum(rows - back, 0)] - t, 0.0) + since * is_inside
        sums += u, u**2
    total, squares = sums
    return np.sqrt(np.maximum(squares - total**2 / count, 0.0))


def rates(
    t: FloatArray, values: FloatArray, first: IntArray, window: FloatArray, *, parabola: bool
) -> tuple[FloatArray, FloatArray]:
    """Fit (1), or straight lines, at every sample: return rates and their changes of `values`, all
    `(c, n)`.

    `t` `(n,)`, s, rises where `first`, the first sample that may be in the window, is the same;
    `window` is W `(n,)`, s. A lone sample has NaN.
    """
    begin = np.maximum(first, _begins(t, first, window))
    rows = np.arange(len(t))
    span = t - t[begin]
    scale = np.where(span > 0.0, span, 1.0)
    powers, moments = np.zeros((5, len(t))), np.zeros((3, len(values), len(t)))
    # One after another: later samples change no bit
    for back in range(int((rows - begin).max(initial=0)) + 1):
        is_inside = rows - back >= begin
        sample = np.maximum(rows - back, 0)
        u = np.where(is_inside, (t[sample] - t) / scale, 0.0)
        weights = is_inside * np.array([u**0, u, u**2, u**3, u**4])
        powers += weights
        moments += weights[:3, None] * np.where(is_inside, values[:, sample] - values, 0.0)
    rate, change = np.full((2, *values.shape), np.nan)
    count, sum_u, sum_u2, *_ = powers
    is_curved = (count >= PARABOLA) & parabola
    determinant = count * sum_u2 - sum_u**2
    is_line = (count >= 2) & ~is_curved & (determinant > 0.0)
    slope = count * moments[1] - sum_u * moments[0]
    rate[:, is_line] = slope[:, is_line] / determinant[is_line] / scale[is_line]
    change[:, is_line] = 0.0
    if is_curved.any():
        curved = powers[:, is_curved]
        normal = np.array([curved[i : i + 3] for i in range(3)]).transpose(2, 0, 1)
        solution = np.linalg.solve(normal, moments[:, :, is_curved].transpose(2, 0, 1))
        _, linear, quadratic = solution.swapaxes(0, 1)
        rate[:, is_curved] = (linear / scale[is_curved, None]).T
        change[:, is_curved] = (2.0 * quadratic / scale[is_curved, None] ** 2).T
    return rate, change


def _begins(t: FloatArray, first: IntArray, window: FloatArray) -> IntArray:
    """Return the first sample within the window of each sample, among those of the same owner."""
    begins = np.empty(len(t), np.int64)
    bounds = np.flatnonzero(np.diff(first, prepend=-1))
    for begin, end in zip(bounds, np.append(bounds[1:], len(t)), strict=True):
        owned = t[begin:end]
        begins[begin:end] = begin + np.searchsorted(owned, owned - window[begin:end] - 1e-9)
    return begins
