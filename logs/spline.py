"""The cubic spline through points, without SciPy's, which takes longer to load than all else of `logs`; the same bits.

With h_i = x_{i+1} - x_i, d_i = (y_{i+1} - y_i) / h_i, m_i the slope at x_i, and u = x - x_i on piece i
(de Boor, A Practical Guide to Splines, 1978, chapter IV):

(1) y(x) = c_3 + c_2 u + c_1 u^2 + c_0 u^3,  c_3 = y_i,  c_2 = m_i,  c_1 = (d_i - m_i) / h_i - t,  c_0 = t / h_i,
    t = (m_i + m_{i+1} - 2 d_i) / h_i
(2) h_i m_{i-1} + 2 (h_{i-1} + h_i) m_i + h_{i-1} m_{i+1} = 3 (h_i d_{i-1} + h_{i-1} d_i)
(3) no knot at x_1: h_1 m_0 + (x_2 - x_0) m_1 = ((h_0 + 2 (x_2 - x_0)) h_1 d_0 + h_0^2 d_1) / (x_2 - x_0);
    likewise at the other end. Two points: the line through them; three: the parabola.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve, solve_banded

from logs.kernel import FloatArray


def spline_pieces(x: FloatArray, y: FloatArray) -> FloatArray:
    """Its c of (1), `(4, n-1, k)`, through `y` `(n, k)` at increasing `x` `(n,)`."""
    h = np.diff(x)[:, None]
    d = np.diff(y, axis=0) / h
    m = _slopes(x, h, d)
    t = (m[:-1] + m[1:] - 2 * d) / h
    return np.stack([t / h, (d - m[:-1]) / h - t, m[:-1], y[:-1]])  # (1)


def _slopes(x: FloatArray, h: FloatArray, d: FloatArray) -> FloatArray:
    """All m `(n, k)` of (2), (3)."""
    n = len(x)
    if n == 2:
        return np.repeat(d, 2, axis=0)
    right = np.empty((n, d.shape[1]))
    right[1:-1] = 3 * (h[1:] * d[:-1] + h[:-1] * d[1:])
    if n == 3:
        right[0], right[2] = 2 * d[0], 2 * d[1]
        h0, h1 = h[:, 0]
        return np.asarray(solve([[1.0, 1.0, 0.0], [h1, 2 * (h0 + h1), h0], [0.0, 1.0, 1.0]], right))
    band = np.zeros((3, n))
    band[1, 1:-1] = 2 * (h[:-1] + h[1:])[:, 0]  # (2)
    band[0, 2:], band[2, :-2] = h[:-1, 0], h[1:, 0]
    first, last = x[2] - x[0], x[-1] - x[-3]
    band[1, 0], band[0, 1], band[1, -1], band[2, -2] = h[1, 0], first, h[-2, 0], last
    right[0] = ((h[0] + 2 * first) * h[1] * d[0] + h[0] ** 2 * d[1]) / first  # (3)
    right[-1] = (h[-1] ** 2 * d[-2] + (2 * last + h[-1]) * h[-2] * d[-1]) / last
    return np.asarray(solve_banded((1, 1), band, right))


def spline_at(x: FloatArray, pieces: FloatArray, at: FloatArray) -> FloatArray:
    """(1) at `at` `(m,)`, `(m, k)`; beyond the ends the outer pieces go on."""
    c, u = _piece(x, pieces, at)
    return c[3] + c[2] * u + c[1] * (u * u) + c[0] * (u * u * u)


def spline_slope(x: FloatArray, pieces: FloatArray, at: FloatArray) -> FloatArray:
    """The derivative of (1) at `at` `(m,)`, `(m, k)`."""
    c, u = _piece(x, pieces, at)
    return c[2] + c[1] * u * 2 + c[0] * (u * u) * 3


def _piece(x: FloatArray, pieces: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The c of the piece of each `at` `(4, m, k)`, and its u `(m, 1)`."""
    i = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    return pieces[:, i], (at - x[i])[:, None]
