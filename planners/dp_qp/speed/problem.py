"""The speed QP's problem: the limit ahead, the speed DP where it decides, references and bounds.

(1) Limit: that of the path with its caps, 0 from `standstill_gap` before the first standing agent
    in the way, including curves and comfortable braking (`profiles.limit_profile`)
(2) References: driving at the limit (`profiles.cruising`), not ahead of the speed DP where an agent
    moves
(3) Bounds of s: `gap` below agents that the ego yields to, `gap` above those that it overtakes, and
    before the stops
(4) Bound of v: the limit at the reference plus `SPEED_ROOM_MPS`, but at least the braking that
    leads there

The speed DP is left out where it decides nothing: where all agents in the way stand and are there
at t = 0, ahead of the ego, and no stop is known to end.
"""

from __future__ import annotations

from math import inf, isnan
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import inner_kernel, kernel
from replan.planners.dp_qp.speed.dp import (
    DS_M,
    DT_S,
    LIKELY,
    SpeedDpWeights,
    cost_map,
    occupied_rows,
    speed_dp,
)
from replan.planners.dp_qp.speed.qp import SpeedProblem
from replan.planners.frenet.path import interpolated
from replan.planners.frenet.profiles import STEP_S, KnotLimits, braking, cruising, limit_profile
from replan.planners.frenet.scene import STANDING_MPS
from replan.planners.frenet.st_boundaries import OVERTAKE, YIELD, decide

SPEED_ROOM_MPS = 0.8
"""Excess of the bound of v over the limit, m/s, so that the profile is smooth.

A cap that is a bound has none.
"""
TILT_MPS2 = 4.0
"""Lateral acceleration above which the ego brakes for a curve with comfort's limits, not with
`ease_mps2`, m/s2.
"""
STAY_M = 0.05  # Least upper bound of s, so that standing still is always allowed, m


class PathLimits(NamedTuple):
    """A path and its speed limits `(m,)`."""

    sigma: FloatArray  # Arc lengths, m; `kappa` of the path, 1/m
    kappa: FloatArray
    own: FloatArray  # Speed limit on an empty road, m/s; `limit` is that with all road users
    limit: FloatArray
    is_bound: BoolArray  # Where the profile keeps `limit` exactly
    is_lowered: bool  # Whether `limit` may differ from `own`


class Taken(NamedTuple):
    """When agents take the path, and the stops of the ego."""

    # Times of the boundaries `(k,)`, s; `lower`, `upper` `(n, k)`, `speed` `(n,)` as in
    # `StBoundaries`
    t: FloatArray
    lower: FloatArray
    upper: FloatArray
    speed: FloatArray
    pace: FloatArray  # Speeds of their agents `(n,)`, m/s
    may_overtake: BoolArray  # `(n,)`; False: the ego yields to the agent instead of overtaking it
    stops: FloatArray  # Columns station, m, and end time, s, of the stops on the path `(stops, 2)`


class Settings(NamedTuple):
    """Settings of the speed stage for the kernel, as in `SpeedQpConfig` and `SpeedDpConfig`."""

    knots: int  # Number of knots of the profile; `curve_accel` and `ease`, m/s2
    curve_accel: float
    ease: float
    soft: KnotLimits
    # Columns of the speed DP; `weights`, `gap` m, `standstill_gap` m, `w_near` likewise
    columns: int
    weights: SpeedDpWeights
    gap: float
    standstill_gap: float
    w_near: float


class BuiltProblem(NamedTuple):
    """A problem and the data that it was built from."""

    problem: SpeedProblem
    kinds: IntArray  # Codes of the decisions about the boundaries `(n,)` (`st_boundaries`, (4))
    free_m: float  # Distance that the ego would drive with no road user in the way, m
    # Cost of the speed DP's grid `(columns + 1, rows)`, complete if `is_drawn`; empty where the DP
    # did not run
    cost: FloatArray
    chosen: IntArray  # The DP's rows `(columns + 1,)`
    # The DP's stations at the profile's knots `(knots,)`, m; zeros where it did not run
    s_dp: FloatArray


@kernel
def build_problem(
    path: PathLimits,
    taken: Taken,
    start: tuple[float, float],
    time_gap: float,
    is_drawn: bool,
    settings: Settings,
) -> BuiltProblem:
    """Build the problem on a path from `start` (speed, acceleration); `time_gap`: wanted gap per
    speed of an agent, s.

    `is_drawn`: whether the speed DP also runs where it decides nothing, with all of its costs.
    """
    sigma, kappa, ease = path.sigma, path.kappa, settings.ease
    lower, upper = taken.lower, taken.upper
    stops, n = taken.stops, len(taken.pace)
    # Station of the first standing agent; whether all are there at t = 0
    first, moves, waits = inf, False, True
    for i in range(n):
        stands = taken.pace[i] < STANDING_MPS
        moves |= not stands
        waits &= taken.t[0] <= 0.0 < lower[i, 0] + upper[i, 0]
        for k in range(lower.shape[1] if stands else 0):
            first = lower[i, k] if lower[i, k] < first else first
    for i in range(len(stops)):
        moves |= stops[i, 1] < inf
    stop_line, limit = max(first - settings.standstill_gap, 0.0), path.limit.copy()
    is_blocked = stop_line < sigma[-1]
    for j in range(len(sigma)):
        limit[j] = 0.0 if sigma[j] >= stop_line else limit[j]
    v_limit = limit_profile(sigma, kappa, limit, settings.curve_accel, ease)  # (1)
    free = _free(sigma, v_limit, start, settings)
    free_m = free[0, -1]
    if is_blocked or path.is_lowered:
        empty_road = limit_profile(sigma, kappa, path.own, settings.curve_accel, ease)
        free_m = _free(sigma, empty_road, start, settings)[0, -1]
    cost: FloatArray = np.empty((0, 0))
    chosen: IntArray = np.empty(0, np.int64)
    s_dp: FloatArray = np.zeros(settings.knots)
    times, indices = STEP_S * np.arange(settings.knots), np.empty(len(taken.t))
    if n + len(stops) > 0 and (is_drawn or moves or not waits):
        cost, chosen = _search(
            v_limit, sigma, taken, start, time_gap, settings, inf if is_drawn else LIKELY
        )
        s_dp = _resample(STEP_S, settings.knots, DT_S * np.arange(len(chosen)), DS_M * chosen)
    for k in range(len(indices)):
        indices[k] = interpolated(taken.t[k], times, s_dp)
    kinds = decide(lower, upper, taken.speed, taken.pace, indices)
    for i in range(n):
        if kinds[i] == OVERTAKE and not taken.may_overtake[i]:
            kinds[i] = YIELD
    s_ref, v_ref, last = free[0].copy(), free[1].copy(), settings.knots - 1  # (2)
    if moves:
        for i in range(last + 1):
            s_ref[i] = min(s_ref[i], s_dp[i])
        for i in range(last + 1):
            before, after = max(i - 1, 0), min(i + 1, last)
            v_ref[i] = min(v_ref[i], (s_ref[after] - s_ref[before]) / ((after - before) * STEP_S))
    bound = _speed_bound(path, v_limit, s_ref, start, settings)
    low, high = _station_bounds(taken, kinds, sigma[-1], settings)
    problem = SpeedProblem(start, low, high, bound, s_ref, v_ref, sigma[-1])
    return BuiltProblem(problem, kinds, free_m, cost, chosen, s_dp)


@inner_kernel
def _free(
    sigma: FloatArray, v_limit: FloatArray, start: tuple[float, float], settings: Settings
) -> FloatArray:
    """Rows s, v `(2, knots)` of driving at a limit on a free road."""
    soft = settings.soft
    return cruising(
        sigma,
        v_limit,
        start[0],
        start[1],
        soft.accel,
        soft.decel,
        soft.jerk,
        STEP_S,
        settings.knots,
    )


@inner_kernel
def _resample(step: float, n: int, xp: FloatArray, fp: FloatArray) -> FloatArray:
    """`fp` over `xp` at 0, step, 2 step ... `(n,)`."""
    resampled = np.empty(n)
    for i in range(n):
        resampled[i] = interpolated(step * i, xp, fp)
    return resampled


@inner_kernel
def _search(
    v_limit: FloatArray,
    sigma: FloatArray,
    taken: Taken,
    start: tuple[float, float],
    time_gap: float,
    settings: Settings,
    worth: float,
) -> tuple[FloatArray, IntArray]:
    """Cost of the speed DP's grid, and its solution; stops have no gap beyond their own."""
    t, lower = taken.t, taken.lower
    upper, speed = taken.upper, taken.speed
    stops = taken.stops
    rows = int(sigma[-1] / DS_M + 1e-6) + 1
    limit = _resample(DS_M, rows, sigma, v_limit)
    wanted, columns = (settings.standstill_gap, time_gap), settings.columns
    per_column = max(1, round(DT_S / (t[1] - t[0]))) if len(t) > 1 else 1
    occupancy = cost_map(rows, lower, upper, speed, settings.gap, wanted, settings.w_near)
    occupied = occupied_rows(rows, lower, upper, speed, wanted, per_column, columns)
    if len(stops):
        begin, end = np.full((len(stops), len(t)), np.nan), np.full((len(stops), len(t)), 1e6)
        for i in range(len(stops)):
            for k in range(len(t)):
                begin[i, k] = stops[i, 0] if t[k] < stops[i, 1] else np.nan
            for column in range(columns):
                occupied[column, 0], occupied[column, 1] = (
                    min(occupied[column, 0], int(stops[i, 0] / DS_M)),
                    rows - 1,
                )
        occupancy += cost_map(rows, begin, end, np.zeros(len(stops)), 0.0, (0.0, 0.0), 0.0)
    cost, chosen = speed_dp(occupancy, occupied, per_column, limit, start, settings.weights, worth)
    if not cost[columns, chosen[columns]] < worth - 1.0:
        cost, chosen = speed_dp(
            occupancy, occupied, per_column, limit, start, settings.weights, inf
        )
    return cost, chosen


@inner_kernel
def _speed_bound(
    path: PathLimits,
    v_limit: FloatArray,
    s_ref: FloatArray,
    start: tuple[float, float],
    settings: Settings,
) -> FloatArray:
    """Upper bound of v `(knots,)` (4)."""
    soft, knots, sigma = settings.soft, settings.knots, path.sigma
    eased, bound = (
        braking(start[0], start[1], settings.ease, soft.jerk, STEP_S, knots),
        np.empty(knots),
    )
    for i in range(knots):
        if eased[1, i] ** 2 * abs(interpolated(eased[0, i], sigma, path.kappa)) > TILT_MPS2:
            eased = braking(start[0], start[1], soft.decel, soft.jerk, STEP_S, knots)
            break
    for i in range(knots):
        point = min(np.searchsorted(sigma, s_ref[i]), len(sigma) - 1)
        room = 0.0 if path.is_bound[point] else SPEED_ROOM_MPS
        bound[i] = max(interpolated(s_ref[i], sigma, v_limit), eased[1, i]) + room
    return bound


@inner_kernel
def _station_bounds(
    taken: Taken, kinds: IntArray, length: float, settings: Settings
) -> tuple[FloatArray, FloatArray]:
    """Bounds of s `(knots,)` (3).

    Of two samples equally near to a knot it takes the stricter one.
    """
    t, lower = taken.t, taken.lower
    upper, stops = taken.upper, taken.stops
    low, high = np.zeros(settings.knots), np.full(settings.knots, length)
    reach = (0.5 * (t[1] - t[0]) if len(t) > 1 else inf) + 1e-9
    for knot in range(settings.knots):
        time = STEP_S * knot
        for i in range(len(stops)):
            if time < stops[i, 1]:
                high[knot] = min(high[knot], stops[i, 0])
        if not len(kinds):
            continue
        first = min(int(np.searchsorted(t, time - reach)), len(t) - 1)
        last = max(int(np.searchsorted(t, time + reach)) - 1, 0)
        for i in range(len(kinds)):
            for k in (first, last):
                if isnan(lower[i, k]):
                    continue
                if kinds[i] == OVERTAKE:
                    low[knot] = max(low[knot], upper[i, k] + settings.gap)
                else:
                    high[knot] = min(high[knot], lower[i, k] - settings.gap)
        high[knot] = max(high[knot], STAY_M)
        low[knot] = min(low[knot], high[knot])
    return low, high
