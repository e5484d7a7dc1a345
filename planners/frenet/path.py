"""The planned path as a fine polyline in the world, from knots of the path QP; and the shape of
lateral moves.

Exact transform from the Frenet frame of the reference line (Werling et al., ICRA 2010), with D = 1
- kappa_r l and tan d = l' / D:

(1) p = r(s) + l n(s)              (2) yaw = yaw_r + d
(3) kappa = ((l'' + (kappa_r' l + kappa_r l') tan d) cos^2 d / D + kappa_r) cos d / D

The quintic between two states, the second at rest, is the shape of every lateral move:

(4) l(d) = l0 + l0' d + l0'' d^2 / 2 + c3 d^3 + c4 d^4 + c5 d^5
        with (l, l', l'')(length) = (l1, 0, 0)
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, ceil, cos, hypot, inf, pi, sin, tan

import numpy as np

from replan.core.arrays import FloatArray, arc_lengths
from replan.core.kernel import inner_kernel, kernel
from replan.logs.reference_line import ReferenceLine, line_curvature, line_frame
from replan.logs.states import EgoState, wrap

FINE_M = 0.5  # Greatest spacing of the points of a path, m
SHIFT_AHEAD_M = 60.0  # Distance ahead within which the shift of a path is measured, m
# Within this distance of its start, a path may bend more than the steering lock permits, m
AT_START_M = 5.0
# Heading off the reference line, rad, above which a path is no longer a function of its station
MAX_TURN = 1.2
# Least 1 - kappa l: nearer to the centre of the turn the Frenet frame is not defined
MIN_REGULAR = 0.1


@dataclass(frozen=True, eq=False, slots=True)
class Path:
    """A path of the rear axle; arrays `(m,)`."""

    sigma: FloatArray  # Arc length from the start, m
    x: FloatArray  # In the world frame, m; `y`, `yaw` (rad, unwrapped), `kappa` (1/m) likewise
    y: FloatArray
    yaw: FloatArray
    kappa: FloatArray
    s: FloatArray  # Station on the reference line, m

    @property
    def length(self) -> float:
        """Length of the path, m."""
        return float(self.sigma[-1])


@kernel
def _fine_path(
    knots: FloatArray,
    coef: FloatArray,
    s0: float,
    step: float,
    offsets: FloatArray,
    parts: int,
    sharpest: float,
    until: float,
) -> tuple[FloatArray, float]:
    """Rows sigma, x, y, yaw, kappa, s `(6, m)` of the path with knots `(3, n)` of l, l', l''.

    Its shift, m.
    """
    n, shift = offsets.shape[1], 0.0
    for i in range(n):
        if s0 + step * i < s0 + SHIFT_AHEAD_M:
            shift = max(shift, abs(offsets[0, i] - offsets[0, 0]))
    columns = np.empty((6, (n - 1) * parts + 1))
    for m in range(columns.shape[1]):
        i = min(m // parts, n - 2)
        d = step * (m - i * parts) / parts
        jerk = (offsets[2, i + 1] - offsets[2, i]) / step
        ddl = offsets[2, i] + d * jerk
        dl = offsets[1, i] + d * (offsets[2, i] + 0.5 * d * jerk)
        l = offsets[0, i] + d * (offsets[1, i] + d * (0.5 * offsets[2, i] + d * jerk / 6.0))
        s = s0 + step * i + d
        x, y, yaw_r, kappa_r = line_frame(knots, coef, s)
        dkappa_r = line_curvature(knots, coef, s + 0.25) - line_curvature(knots, coef, s - 0.25)
        regular = max(1.0 - kappa_r * l, MIN_REGULAR)
        turn = atan2(dl, regular)
        c = cos(turn)
        bend = ddl + (2.0 * dkappa_r * l + kappa_r * dl) * tan(turn)
        columns[1, m], columns[2, m] = x - l * sin(yaw_r), y + l * cos(yaw_r)  # (1)
        columns[3, m] = yaw_r + turn  # (2)
        columns[4, m] = (bend * c * c / regular + kappa_r) * c / regular  # (3)
        columns[5, m] = s
        columns[0, m] = 0.0
        if m > 0:
            columns[0, m] = columns[0, m - 1] + hypot(
                columns[1, m] - columns[1, m - 1], columns[2, m] - columns[2, m - 1]
            )
            columns[3, m] = columns[3, m - 1] + wrap(columns[3, m] - columns[3, m - 1])
        if s > until or (abs(columns[4, m]) > sharpest and columns[0, m] > AT_START_M):
            return columns[:, :m], shift
    return columns[:, :], shift


def drivable_path(
    line: ReferenceLine, s0: float, step: float, offsets: FloatArray, sharpest: float, until: float
) -> tuple[Path, float]:
    """The path through knots of (l, l', l'') `(3, n)`, `step` m apart from station `s0`, and its
    shift, m.

    It ends at station `until`, or where it bends more than `sharpest`, 1/m, farther than
    `AT_START_M` from its start. The shift is the largest change of the offset within
    `SHIFT_AHEAD_M`.
    """
    parts = max(1, ceil(step / FINE_M))
    rows, shift = _fine_path(
        line.s, line.coef, s0, step, np.ascontiguousarray(offsets), parts, sharpest, until
    )
    return Path(*rows), shift


def make_path(line: ReferenceLine, s0: float, step: float, offsets: FloatArray) -> Path:
    """The whole path through knots of (l, l', l'') `(3, n)`, `step` m apart from station `s0`."""
    return drivable_path(line, s0, step, offsets, inf, inf)[0]


def path_through(x: FloatArray, y: FloatArray, yaw: FloatArray, kappa: FloatArray) -> Path:
    """The path through points `(n,)`, without those nearer than a millimetre to the one before."""
    keep = np.r_[True, np.hypot(np.diff(x), np.diff(y)) > 1e-3]
    x, y, yaw, kappa = (column[keep] for column in (x, y, yaw, kappa))
    sigma = arc_lengths(x, y)
    return Path(sigma, x, y, yaw, kappa, sigma)


def out_of_frame(line: ReferenceLine, state: EgoState, s: float, l: float) -> str:
    """Why a state with foot point (s, l) has no l', l'' in the Frenet frame; empty if it has."""
    _, _, yaw_r, kappa_r = line.frame(s)
    turn = abs(wrap(state.yaw - yaw_r))
    if not turn <= MAX_TURN:
        return f"the heading is {turn * 180.0 / pi:.0f} degrees off the reference line"
    if not 1.0 - kappa_r * l >= MIN_REGULAR:
        return f"{abs(l):.1f} m beside the reference line is the centre of its turn"
    return ""


def curvature_slope(line: ReferenceLine, s: float) -> float:
    """Derivative of the line's curvature by the station, 1/m2."""
    _, _, _, kappa_ahead = line.frame(s + 0.25)
    _, _, _, kappa_behind = line.frame(s - 0.25)
    return 2.0 * (kappa_ahead - kappa_behind)


def frenet_start(
    line: ReferenceLine, state: EgoState, s: float, l: float
) -> tuple[float, float, float]:
    """l, l', l'' of a state whose foot point is (s, l): the inverse of (2) and (3).

    Only for states for which `out_of_frame` is empty.
    """
    _, _, yaw_r, kappa_r = line.frame(s)
    dkappa_r = curvature_slope(line, s)
    regular = 1.0 - kappa_r * l
    turn = wrap(state.yaw - yaw_r)
    dl = regular * tan(turn)  # (2)
    ddl = (state.kappa * regular / cos(turn) - kappa_r) * regular / cos(turn) ** 2
    ddl -= (dkappa_r * l + kappa_r * dl) * tan(turn)  # (3)
    return l, dl, ddl


@kernel
def states_on_path(
    sigma: FloatArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    kappa: FloatArray,
    stations: FloatArray,
) -> FloatArray:
    """Rows x, y, yaw, kappa `(4, n)` at arc lengths `(n,)`: cubic Hermite in the position, linear
    in yaw and kappa.

    Beyond the end the path continues straight.
    """
    states = np.empty((4, len(stations)))
    last = len(sigma) - 1
    i = 0
    for k in range(len(stations)):
        target = stations[k]
        while i < last - 1 and sigma[i + 1] < target:
            i += 1
        h = sigma[i + 1] - sigma[i]
        u = min(max((target - sigma[i]) / h, 0.0), 1.0)
        h00, h01 = (1.0 + 2.0 * u) * (1.0 - u) ** 2, u * u * (3.0 - 2.0 * u)
        h10, h11 = u * (1.0 - u) ** 2 * h, u * u * (u - 1.0) * h
        a, b = yaw[i], yaw[i + 1]
        beyond = target - sigma[last] if target > sigma[last] else 0.0
        states[2, k] = a + u * (b - a)
        states[0, k] = h00 * x[i] + h01 * x[i + 1] + h10 * cos(a) + h11 * cos(b) + beyond * cos(b)
        states[1, k] = h00 * y[i] + h01 * y[i + 1] + h10 * sin(a) + h11 * sin(b) + beyond * sin(b)
        states[3, k] = kappa[i] + u * (kappa[i + 1] - kappa[i]) if beyond == 0.0 else 0.0
    return states


@kernel
def quintic(
    l0: float, dl0: float, ddl0: float, l1: float, length: float
) -> tuple[float, float, float]:
    """Coefficients c3, c4, c5 of (4), over `length` m."""
    h = length
    delta = l1 - l0 - dl0 * h - 0.5 * ddl0 * h * h
    slope = -dl0 - ddl0 * h
    bend = -ddl0
    c3 = (10.0 * delta - 4.0 * slope * h + 0.5 * bend * h * h) / h**3
    c4 = (-15.0 * delta + 7.0 * slope * h - bend * h * h) / h**4
    c5 = (6.0 * delta - 3.0 * slope * h + 0.5 * bend * h * h) / h**5
    return c3, c4, c5


@inner_kernel
def interpolated(x: float, xp: FloatArray, fp: FloatArray) -> float:
    """Return `np.interp` of one number, to the bit: `fp` `(n,)` over increasing `xp`, constant
    outside.
    """
    last = len(xp) - 1
    if x >= xp[last]:
        return fp[last]
    if x < xp[0]:
        return fp[0]
    k = np.searchsorted(xp, x, side="right") - 1
    return (fp[k + 1] - fp[k]) / (xp[k + 1] - xp[k]) * (x - xp[k]) + fp[k]
