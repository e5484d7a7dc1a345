"""The cubic spline through points of the plane, bit by bit that of `scipy.interpolate.CubicSpline` ("not-a-knot").

Scipy's takes ten times as long for the few dozen points of a road's line, and as long to import as all else of `logs`.
With the slopes m of the pieces of lengths h, the derivatives d at the points solve the tridiagonal system

(1) h_i d_(i-1) + 2 (h_(i-1) + h_i) d_i + h_(i-1) d_(i+1) = 3 (h_i m_(i-1) + h_(i-1) m_i)
    h_1 d_0 + (h_0 + h_1) d_1 = ((3 h_0 + 2 h_1) h_1 m_0 + h_0^2 m_1) / (h_0 + h_1), and likewise at the end

by elimination with exchange of neighbouring rows (LAPACK's dgtsv). Three points, a parabola, are left to scipy.
"""

from __future__ import annotations

import numpy as np

from logs.kernel import FloatArray, inner_kernel, kernel


def spline_through(t: FloatArray, points: FloatArray) -> FloatArray:
    """Coefficients `(n-1, 8)` of the spline through `points` `(n, 2)` at increasing `t` `(n,)`, n >= 2.

    Cubics in the distance from the piece's begin, of x then of y, highest power first.

    Raises:
        ValueError: `t` does not increase.
    """
    if not (np.diff(t) > 0.0).all():
        raise ValueError("the parameter of a spline must increase")
    if len(t) != 3:
        return _through(t, points)
    from scipy.interpolate import CubicSpline

    both = CubicSpline(t, points).c
    return np.hstack([both[:, :, 0].T, both[:, :, 1].T])


@kernel
def _through(t: FloatArray, points: FloatArray) -> FloatArray:
    n = len(t)
    h = t[1:] - t[:-1]
    low, diagonal, up, rates = np.empty(n - 1), np.empty(n), np.empty(n - 1), np.empty((n, 2))
    slopes = np.empty((n - 1, 2))
    for i in range(n - 1):
        for c in range(2):
            slopes[i, c] = (points[i + 1, c] - points[i, c]) / h[i]
    if n == 2:
        rates[0], rates[1] = slopes[0], slopes[0]
    else:
        first, last = t[2] - t[0], t[n - 1] - t[n - 3]
        diagonal[0], up[0], low[n - 2], diagonal[n - 1] = h[1], first, last, h[n - 3]
        for i in range(1, n - 1):
            low[i - 1], diagonal[i], up[i] = h[i], 2.0 * (h[i - 1] + h[i]), h[i - 1]
        for c in range(2):
            m = slopes[:, c]
            for i in range(1, n - 1):
                rates[i, c] = 3.0 * (h[i] * m[i - 1] + h[i - 1] * m[i])
            rates[0, c] = ((h[0] + 2.0 * first) * h[1] * m[0] + h[0] * h[0] * m[1]) / first
            end, before = h[n - 2], h[n - 3]
            rates[n - 1, c] = (end * end * m[n - 3] + (2.0 * last + end) * before * m[n - 2]) / last
        _solve(low, diagonal, up, rates)
    out = np.empty((n - 1, 8))
    for i in range(n - 1):
        for c in range(2):
            m, d = slopes[i, c], rates[i, c]
            bend = (d + rates[i + 1, c] - 2.0 * m) / h[i]
            out[i, 4 * c], out[i, 4 * c + 1] = bend / h[i], (m - d) / h[i] - bend
            out[i, 4 * c + 2], out[i, 4 * c + 3] = d, points[i, c]
    return out


@inner_kernel
def _solve(low: FloatArray, diagonal: FloatArray, up: FloatArray, b: FloatArray) -> None:
    """Solve (1) in place of its right sides `b` `(n, 2)`; the diagonals are used up."""
    n = len(diagonal)
    for i in range(n - 1):
        if abs(diagonal[i]) >= abs(low[i]):
            share = low[i] / diagonal[i]
            diagonal[i + 1] -= share * up[i]
            for c in range(2):
                b[i + 1, c] -= share * b[i, c]
            low[i] = 0.0
            continue
        share = diagonal[i] / low[i]
        diagonal[i], diagonal[i + 1], up[i], beyond = low[i], up[i] - share * diagonal[i + 1], diagonal[i + 1], 0.0
        if i < n - 2:
            beyond = up[i + 1]
            up[i + 1] = -share * beyond
        low[i] = beyond
        for c in range(2):
            b[i, c], b[i + 1, c] = b[i + 1, c], b[i, c] - share * b[i + 1, c]
    for c in range(2):
        b[n - 1, c] /= diagonal[n - 1]
        b[n - 2, c] = (b[n - 2, c] - up[n - 2] * b[n - 1, c]) / diagonal[n - 2]
        for i in range(n - 3, -1, -1):
            b[i, c] = (b[i, c] - up[i] * b[i + 1, c] - low[i] * b[i + 2, c]) / diagonal[i]


@kernel
def spline_at(t: FloatArray, coef: FloatArray, at: FloatArray, order: int) -> FloatArray:
    """Points `(m, 2)` of a spline at increasing `at` `(m,)` (`order` 0), or its derivatives there (1)."""
    out, i = np.empty((len(at), 2)), 0
    for j in range(len(at)):
        while i < len(coef) - 1 and at[j] >= t[i + 1]:
            i += 1
        u = at[j] - t[i]
        for k in range(2):
            a, b, c, d = coef[i, 4 * k : 4 * k + 4]
            if order == 0:
                out[j, k] = d + c * u + b * (u * u) + a * (u * u * u)
            else:
                out[j, k] = c + b * u * 2.0 + a * (u * u) * 3.0
    return out
