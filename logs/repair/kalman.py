"""A constant-velocity Kalman filter for joining detections, tracking and smoothing.

Per axis, with the covariance C = (pp, pv, vv) of position m and velocity m/s, white acceleration of density q, m2/s3:
(1) pp += 2 d pv + d^2 vv + q d^3/3,  pv += d vv + q d^2/2,  vv += q d;  d s between samples
(2) update by a position with variance r: gains kp = pp / (pp + r), kv = pv / (pp + r);  C -= k k' (pp + r)
(3) update by a stand: (2) for the velocity 0 with variance `STAND_MPS`^2, with vv and pp exchanged
(4) backward pass: G = C F' C-^-1,  x += G (x_next - x-_next)  (Rauch, Tung, Striebel, AIAA Journal 3, 1965)

The noise of positions and of acceleration is the same on both axes of a box; only the uncertainty of the first velocity
differs: a vehicle moves along its axis. Along the axes of the first box, the two coordinates are therefore independent,
with one covariance each, and no matrix is inverted.
"""

from __future__ import annotations

import numpy as np

from logs.arrays import BoolArray, FloatArray
from logs.kernel import inner_kernel, kernel

STAND_MPS, FIRST_MPS = 0.02, 10.0
"""Standard deviations of the velocity of a standing agent, and of the first sample of a smoothed track."""
X, Y, VX, VY, COS, SIN, ALONG, ACROSS, WIDTH = 0, 1, 2, 3, 4, 5, 6, 9, 12
"""Columns of states `(n, WIDTH)`; three each from `ALONG` and from `ACROSS` hold C."""


@inner_kernel
def _predict(cov: FloatArray, d: float, q: float) -> None:
    """Predict the covariance (1), in place."""
    cov[0] += d * (2.0 * cov[1] + d * cov[2]) + q * d**3 / 3.0
    cov[1] += d * cov[2] + 0.5 * q * d * d
    cov[2] += q * d


@inner_kernel
def _update(cov: FloatArray, r: float) -> tuple[float, float]:
    """Update the covariance (2) in place, and return the gains."""
    s = cov[0] + r
    kp, kv = cov[0] / s, cov[1] / s
    cov[2] -= kv * cov[1]
    cov[0] *= r / s
    cov[1] *= r / s
    return kp, kv


@kernel
def predict_all(states: FloatArray, d: float, q: FloatArray) -> None:
    """Predict each state `(n, WIDTH)` (1), in place; q `(n,)`."""
    for i in range(len(states)):
        states[i, X] += d * states[i, VX]
        states[i, Y] += d * states[i, VY]
        _predict(states[i, ALONG : ALONG + 3], d, q[i])
        _predict(states[i, ACROSS : ACROSS + 3], d, q[i])


@kernel
def update_one(state: FloatArray, x: float, y: float, r: float) -> None:
    """Update one state `(WIDTH,)` (2), in place, by a detection at x, y with variance r."""
    c, s = state[COS], state[SIN]
    ex, ey = x - state[X], y - state[Y]
    along, across = c * ex + s * ey, c * ey - s * ex
    pa, va = _update(state[ALONG : ALONG + 3], r)
    pc, vc = _update(state[ACROSS : ACROSS + 3], r)
    state[X] += c * pa * along - s * pc * across
    state[Y] += s * pa * along + c * pc * across
    state[VX] += c * va * along - s * vc * across
    state[VY] += s * va * along + c * vc * across


@kernel
def smoothed(t: FloatArray, z: FloatArray, r: FloatArray, q: float, stands: BoolArray) -> FloatArray:
    """Smooth positions z `(n, 2)` (NaN: not seen) with variances r `(n,)` at t `(n,)`; return x, y, vx, vy `(n, 4)`.

    `stands` `(n,)` marks times at which the velocity is 0. The first row of z must be a position.
    """
    n = len(t)
    after, before = np.empty((n, 4)), np.empty((n, 4))
    covs, carried = np.empty((n, 3)), np.empty((n, 3))
    state, cov = np.array([z[0, 0], z[0, 1], 0.0, 0.0]), np.array([r[0], 0.0, FIRST_MPS**2])
    for i in range(n):
        if i > 0:
            d = t[i] - t[i - 1]
            state[:2] += d * state[2:]
            _predict(cov, d, q)
        before[i], carried[i] = state, cov
        if np.isfinite(z[i, 0]):
            kp, kv = _update(cov, r[i])
            for axis in range(2):
                e = z[i, axis] - state[axis]
                state[axis] += kp * e
                state[2 + axis] += kv * e
        if stands[i]:
            kv, kp = _update(cov[::-1], STAND_MPS * STAND_MPS)  # (3)
            state[:2] -= kp * state[2:]
            state[2:] -= kv * state[2:]
        after[i], covs[i] = state, cov
    for i in range(n - 2, -1, -1):  # (4)
        d = t[i + 1] - t[i]
        pp, pv, vv = carried[i + 1]
        det = pp * vv - pv * pv
        fp0, fp1 = covs[i, 0] + d * covs[i, 1], covs[i, 1]
        fv0, fv1 = covs[i, 1] + d * covs[i, 2], covs[i, 2]
        g00, g01 = (fp0 * vv - fp1 * pv) / det, (fp1 * pp - fp0 * pv) / det
        g10, g11 = (fv0 * vv - fv1 * pv) / det, (fv1 * pp - fv0 * pv) / det
        for axis in range(2):
            ep, ev = after[i + 1, axis] - before[i + 1, axis], after[i + 1, 2 + axis] - before[i + 1, 2 + axis]
            after[i, axis] += g00 * ep + g01 * ev
            after[i, 2 + axis] += g10 * ep + g11 * ev
    return after
