"""Estimates velocity and acceleration of every track for metrics. It uses later samples: not for
planners.

Per axis of the world, with the state (p, v, a) of position m, velocity m/s and acceleration m/s2,
white jerk (Li and Jilkov, Survey of Maneuvering Target Tracking I, IEEE Trans. AES 39, 2003):
(1) p' = p + d v + d^2 a / 2,  v' = v + d a,  a' = a + noise;  d the time between samples, s
(2) Q = q [d^5/20 d^4/8 d^3/6; d^4/8 d^3/3 d^2/2; d^3/6 d^2/2 d],
        q the jerk's spectral density, m2/s5
(3) a sample measures v where the log has a velocity, else p, with the variance R, the same on both
    axes

(4) R is estimated per track: of four samples in a row, the combination that uniform acceleration
    does not change, with weights of unit length, is noise; squared and summed over both axes, its
    median is 2 ln 2 R. Four equal samples are ignored. sqrt(R) is at least `*_FLOOR`, and
    `*_UNKNOWN` for tracks with too few samples
(5) q is unknown, too: most drivers drive calmly, some abruptly. The models q = c q_kind are tried,
        c of `CALM` and q_kind of `JERK`, and their estimates are averaged with their likelihoods as
        weights, so that nothing is decided by a narrow margin
(6) forward: a Kalman filter; backward: lambda of Bryson and Frazier (1963; Bierman 1977),
        which inverts no matrix:
    lambda^_{k-1} = F' lambda~_k,  lambda~_k = (I - K H)' lambda^_k - H' nu / S,
        x_k = x-_k - P-_k lambda~_k

A track without noise is followed exactly, without differences. With 5 cm of noise, at 5 to 100 Hz,
the speed error of a car at constant speed is at most 0.1 m/s; of a car that brakes with 8 m/s2, 0.5
m/s in the second around each change and at the track's ends. A pedestrian's stop within 0.4 s is
spread over 0.9 s (tests/logs/test_motion.py). Smoothers in libraries (SciPy's smoothing splines) do
not use measured velocities, and take a millisecond for each track and axis. Both sides of a gap
(`replan.logs.observed`) are estimated separately.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import log

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.logs.agents import AgentKind

JERK = {
    AgentKind.CAR: 64.0,
    AgentKind.TRUCK: 25.0,
    AgentKind.BUS: 25.0,
    AgentKind.MOTORCYCLE: 64.0,
    AgentKind.BICYCLE: 16.0,
    AgentKind.PEDESTRIAN: 16.0,
    AgentKind.OBJECT: 1.0,
}
"""q of abrupt motion by kind, m2/s5: the square of the change of acceleration within 1 s, m/s2.

Cars and motorcycles brake with 8 m/s2 at most, lorries and buses with 5. Within 0.4 s, a pedestrian
stops from 1.6 m/s, and a rider reaches 4 m/s2. Objects that move are pushed or blown."""
CALM = np.array([1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5])
"""Factors of q from abrupt to almost no change: a car's acceleration changes by 8 to 0.025 m/s2 in
1 s.
"""
ACCEL_MPS2 = 3.0
"""Standard deviation of the acceleration before the first sample."""
POSITION_FLOOR_M, VELOCITY_FLOOR_MPS = 1e-4, 1e-3
"""Least noise: far below the resolution of logs, far above rounding."""
POSITION_UNKNOWN_M, VELOCITY_UNKNOWN_MPS = 0.05, 0.2
"""Noise of tracks with too few samples for an estimate: that of a good tracker."""
TIGHTEST_M = 5.0
"""Radius of the tightest curve that cars drive. Slow road users seem to turn faster: a small error
of the velocity's direction is a large one of its rate."""
_DIFFUSE = np.array([1e6, 1e3])
"""Variances of the first position (relative to the first sample), m2, and velocity, m2/s2: both are
unknown.
"""
_NEGLIGIBLE = 1e-9
"""Models with less weight are left out of the average."""


@dataclass(frozen=True, eq=False)
class Motion:
    """Velocity m/s and acceleration m/s2 at each sample of some tracks, `(m,)` each, world."""

    vx: FloatArray
    vy: FloatArray
    ax: FloatArray
    ay: FloatArray

    @cached_property
    def accel(self) -> FloatArray:
        """Rate of the speed `(m,)`, m/s2."""
        speed = np.hypot(self.vx, self.vy)
        along = self.ax * self.vx + self.ay * self.vy
        return np.divide(along, speed, out=np.zeros(len(speed)), where=speed > 0.0)

    @cached_property
    def turn(self) -> FloatArray:
        """Rate of the velocity's direction `(m,)`, rad/s, at most that of a circle of `TIGHTEST_M`;
        0 at a stand.
        """
        square = self.vx**2 + self.vy**2
        across = self.vx * self.ay - self.vy * self.ax
        most = np.sqrt(square) / TIGHTEST_M
        return np.clip(
            np.divide(across, square, out=np.zeros(len(square)), where=square > 0.0), -most, most
        )


def estimated(
    kinds: tuple[AgentKind, ...],
    moves: BoolArray,
    parts: IntArray,
    owner: IntArray,
    columns: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
) -> Motion:
    """Estimate the motion of parts without gaps: part i has the samples `parts[i] : parts[i + 1]`
    of agent `owner[i]`.

    `kinds` and `moves` `(n,)` are per agent: those that never move have velocity 0. `owner` `(p,)`
    increases. `columns` are t, x, y, vx, vy `(m,)`, NaN where the log has no velocity.
    """
    jerk = np.array([JERK[kind] for kind in kinds]) * moves
    smoothed = np.zeros((4, len(columns[0])))
    _smooth_all(parts, owner, jerk, *columns, smoothed)
    return Motion(*map(frozen, smoothed))


@kernel
def _smooth_all(
    parts: IntArray,
    owner: IntArray,
    jerk: FloatArray,
    t: FloatArray,
    x: FloatArray,
    y: FloatArray,
    vx: FloatArray,
    vy: FloatArray,
    smoothed: FloatArray,
) -> None:
    """Fill `out` `(4, m)`: vx, vy, ax, ay."""
    i = 0
    while i < len(owner):
        begin, j = parts[i], i
        while j < len(owner) and owner[j] == owner[i]:
            j += 1
        end, q = parts[j], jerk[owner[i]]
        if q > 0.0:
            logged = np.isfinite(vx[begin:end]) & np.isfinite(vy[begin:end])
            # the measured columns; positions relative to the first sample, so that the world's
            # offset costs no digits
            zx = np.where(logged, vx[begin:end], x[begin:end] - x[begin])
            zy = np.where(logged, vy[begin:end], y[begin:end] - y[begin])
            floors = POSITION_FLOOR_M, VELOCITY_FLOOR_MPS
            unknown = POSITION_UNKNOWN_M, VELOCITY_UNKNOWN_MPS
            noise = np.empty(2)
            for c in range(2):
                noise[c] = (
                    _noise(t[begin:end], zx, zy, logged == (c == 1), floors[c], unknown[c]) ** 2
                )
            for part in range(i, j):
                a, b = parts[part] - begin, parts[part + 1] - begin
                _smooth(
                    t[begin + a : begin + b],
                    zx[a:b],
                    zy[a:b],
                    logged[a:b],
                    noise,
                    q,
                    smoothed[:, begin + a : begin + b],
                )
        i = j


@inner_kernel
def _noise(
    t: FloatArray,
    zx: FloatArray,
    zy: FloatArray,
    is_measured: BoolArray,
    floor: float,
    unknown: float,
) -> float:
    """Return the standard deviation of the noise (4) of the samples that `is_measured` marks."""
    squares = np.empty(max(len(t) - 3, 0))
    count = 0
    for k in range(len(squares)):
        if not is_measured[k : k + 4].all():
            continue
        square, length, still = np.zeros(2), 0.0, True
        for i in range(4):
            weight = 1.0
            for j in range(4):
                if j != i:
                    weight *= (t[k + 3] - t[k]) / (t[k + i] - t[k + j])
            square[0] += weight * (zx[k + i] - zx[k])
            square[1] += weight * (zy[k + i] - zy[k])
            length += weight * weight
            still = still and zx[k + i] == zx[k] and zy[k + i] == zy[k]
        if not still:
            squares[count] = (square[0] ** 2 + square[1] ** 2) / length
            count += 1
    if count > 0:
        return max((np.median(squares[:count]) / (2.0 * log(2.0))) ** 0.5, floor)
    return floor if len(squares) > 0 else unknown


@inner_kernel
def _smooth(
    t: FloatArray,
    zx: FloatArray,
    zy: FloatArray,
    logged: BoolArray,
    noise: FloatArray,
    q: float,
    smoothed: FloatArray,
) -> None:
    """Fill `smoothed` `(4, n)`: vx, vy, ax, ay of one part of a track."""
    n = len(t)
    if n == 1:
        if logged[0]:
            smoothed[0, 0], smoothed[1, 0] = zx[0], zy[0]
        return
    means, covs, gains = np.empty((n, 6)), np.empty((n, 6)), np.empty((n, 3))
    off, spread = np.empty((n, 2)), np.empty(n)
    scores = np.empty(len(CALM))
    for i in range(len(CALM)):
        scores[i] = _forward(t, zx, zy, logged, noise, CALM[i] * q, means, covs, gains, off, spread)
    weights = np.exp(scores - scores.max())  # (5)
    weights /= weights.sum()
    for i in range(len(CALM)):
        if weights[i] > _NEGLIGIBLE:
            _forward(t, zx, zy, logged, noise, CALM[i] * q, means, covs, gains, off, spread)
            _backward(t, logged, means, covs, gains, off, spread, weights[i], smoothed)


@kernel
def _forward(
    t: FloatArray,
    zx: FloatArray,
    zy: FloatArray,
    logged: BoolArray,
    noise: FloatArray,
    q: float,
    means: FloatArray,
    covs: FloatArray,
    gains: FloatArray,
    off: FloatArray,
    spread: FloatArray,
) -> float:
    """Run the filter (1) to (3) and return the logarithm of its likelihood.

    Fills the predictions per sample: `means` (p, v, a of x, then of y), `covs` (pp, pv, pa, vv, va,
    aa: the same for both axes); `gains` K, `off` the innovations and `spread` their variance S.
    """
    px, py = zx[0], zy[0]
    vx, vy = (zx[1] - zx[0]) / (t[1] - t[0]), (zy[1] - zy[0]) / (t[1] - t[0])
    ax, ay = 0.0, 0.0
    if logged[0] or logged[1]:
        row = 0 if logged[0] else 1
        px, py = 0.0, 0.0
        vx, vy = zx[row], zy[row]
    pp, vv, aa = _DIFFUSE[0], _DIFFUSE[1], ACCEL_MPS2**2
    pv, pa, va = 0.0, 0.0, 0.0
    score = 0.0
    for k in range(len(t)):
        if k > 0:
            d = t[k] - t[k - 1]
            h = 0.5 * d * d
            # (1)
            px, vx = px + d * vx + h * ax, vx + d * ax
            py, vy = py + d * vy + h * ay, vy + d * ay
            # (2)
            pp += (
                2.0 * d * pv
                + 2.0 * h * pa
                + d * d * vv
                + 2.0 * d * h * va
                + h * h * aa
                + q * d**5 / 20.0
            )
            pv += d * pa + d * vv + (d * d + h) * va + d * h * aa + q * d**4 / 8.0
            pa += d * va + h * aa + q * d**3 / 6.0
            vv += 2.0 * d * va + d * d * aa + q * d**3 / 3.0
            va += d * aa + q * d * d / 2.0
            aa += q * d
        means[k, 0], means[k, 1], means[k, 2] = px, vx, ax
        means[k, 3], means[k, 4], means[k, 5] = py, vy, ay
        covs[k, 0], covs[k, 1], covs[k, 2] = pp, pv, pa
        covs[k, 3], covs[k, 4], covs[k, 5] = vv, va, aa
        if logged[k]:  # (3)
            hp, hv, ha = pv, vv, va
            ex, ey = zx[k] - vx, zy[k] - vy
            r = noise[1]
            s = vv + r
        else:
            hp, hv, ha = pp, pv, pa
            ex, ey = zx[k] - px, zy[k] - py
            r = noise[0]
            s = pp + r
        kp, kv, ka = hp / s, hv / s, ha / s
        px, vx, ax = px + kp * ex, vx + kv * ex, ax + ka * ex
        py, vy, ay = py + kp * ey, vy + kv * ey, ay + ka * ey
        if logged[k]:  # the measured row, computed without cancellation
            pp, pa, aa = pp - kp * hp, pa - kp * ha, aa - ka * ha
            pv, vv, va = pv * r / s, vv * r / s, va * r / s
        else:
            vv, va, aa = vv - kv * hv, va - kv * ha, aa - ka * ha
            pp, pv, pa = pp * r / s, pv * r / s, pa * r / s
        gains[k, 0], gains[k, 1], gains[k, 2] = kp, kv, ka
        off[k, 0], off[k, 1], spread[k] = ex, ey, s
        score -= log(s) + 0.5 * (ex * ex + ey * ey) / s
    return score


@inner_kernel
def _backward(
    t: FloatArray,
    logged: BoolArray,
    means: FloatArray,
    covs: FloatArray,
    gains: FloatArray,
    off: FloatArray,
    spread: FloatArray,
    weight: float,
    smoothed: FloatArray,
) -> None:
    """(6): add `weight` times the smoothed velocity and acceleration to `smoothed` `(4, n)`."""
    back = np.zeros((2, 3))
    for k in range(len(t) - 1, -1, -1):
        d = t[k + 1] - t[k] if k + 1 < len(t) else 0.0
        measured = 1 if logged[k] else 0
        for c in range(2):
            p, v, a = back[c, 0], back[c, 1], back[c, 2]
            v, a = v + d * p, a + d * v + 0.5 * d * d * p
            change = gains[k, 0] * p + gains[k, 1] * v + gains[k, 2] * a + off[k, c] / spread[k]
            p, v = (p, v - change) if measured == 1 else (p - change, v)
            back[c, 0], back[c, 1], back[c, 2] = p, v, a
            smoothed[c, k] += weight * (
                means[k, 3 * c + 1] - covs[k, 1] * p - covs[k, 3] * v - covs[k, 4] * a
            )
            smoothed[2 + c, k] += weight * (
                means[k, 3 * c + 2] - covs[k, 2] * p - covs[k, 4] * v - covs[k, 5] * a
            )
