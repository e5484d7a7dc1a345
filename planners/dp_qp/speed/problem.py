"""What is asked of the speed QP: the limit ahead, the speed DP where it decides, references and bounds.

(1) Limit: that of the path with its caps, 0 from `standstill_gap` before the first that stands in the way on, with
    curves and comfortable braking in it (`profiles.limit_profile`)
(2) References: driving at the limit (`profiles.cruising`), not ahead of the speed DP where an agent moves
(3) Bounds of s: `gap` below those that the ego yields to, `gap` above those that it overtakes, before the stops
(4) Bound of v: the limit at the reference with some room, but at least the braking that leads there

The speed DP is left out where it decides nothing: where all who are in the way stand there from now on, so that the ego
cannot be past them at t = 0, and no stop is known to end.
"""

from __future__ import annotations

from math import inf, isnan
from typing import NamedTuple

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, inner_kernel, kernel
from planners.dp_qp.speed.dp import DS_M, DT_S, LIKELY, SpeedDpWeights, cost_map, occupied_rows, speed_dp
from planners.dp_qp.speed.qp import SpeedProblem
from planners.frenet.profiles import STEP_S, KnotLimits, braking, cruising, limit_profile
from planners.frenet.scene import STANDING_MPS
from planners.frenet.st_boundaries import ALONG

SPEED_ROOM_MPS = 0.8
"""Room above the limit, m/s, but not above a cap that is a bound: it makes the profile smooth."""
TILT_MPS2 = 4.0
"""Lateral acceleration for which a curve is braked for as hard as comfort allows, instead of with `ease_mps2`, m/s2."""
STAY_M = 0.05
"""Least upper bound of s: to stand still is always allowed, m."""
OVERTAKE, STOP, FOLLOW, YIELD = 0, 1, 2, 3
"""Codes of the decisions."""


class Settings(NamedTuple):
    """Of the speed stage, for the kernel: as in `SpeedQpConfig` and `SpeedDpConfig`.

    Attributes:
        knots: Of the profile; `curve_accel` m/s2, `ease` m/s2.
        soft: Limits of comfort.
        columns: Of the speed DP; `weights`, `gap` m, `standstill_gap` m, `w_near` likewise.
    """

    knots: int
    curve_accel: float
    ease: float
    soft: KnotLimits
    columns: int
    weights: SpeedDpWeights
    gap: float
    standstill_gap: float
    w_near: float


class Posed(NamedTuple):
    """A problem and what it came from.

    Attributes:
        problem: For the ladder.
        kinds: Codes of the decisions about the boundaries `(n,)`.
        free_m: How far the ego would come with no other road user in the way, m.
        cost: Of the speed DP's grid `(columns + 1, rows)`, whole where it `is_drawn`; empty where it was not run.
        chosen: Its rows `(columns + 1,)`.
        s_dp: Its stations at the profile's knots `(knots,)`, zeros where it was not run, m.
    """

    problem: SpeedProblem
    kinds: IntArray
    free_m: float
    cost: FloatArray
    chosen: IntArray
    s_dp: FloatArray


@kernel
def pose(
    sigma: FloatArray, kappa: FloatArray, own: FloatArray, limit: FloatArray, is_bound: BoolArray, t: FloatArray,
    agent: IntArray, lower: FloatArray, upper: FloatArray, speed: FloatArray, pace: FloatArray, stops: FloatArray,
    start: tuple[float, float], time_gap: float, is_lowered: bool, may_overtake: BoolArray, is_drawn: bool,
    settings: Settings,
) -> Posed:  # fmt: skip
    """The problem on a path `(m,)`.

    Args:
        sigma: Arc lengths, m; `kappa` of the path, 1/m.
        kappa: See there.
        own: Speed limit on an empty road, m/s; `limit` for the sake of others, too.
        limit: See there.
        is_bound: Where that is kept exactly.
        t: Times of the boundaries `(k,)`, s; `agent` `(n,)`, `lower`, `upper` `(n, k)`, `speed` `(n,)` as in
            `StBoundaries`.
        agent: See there.
        lower: See there.
        upper: See there.
        speed: See there.
        pace: Speeds of the agents, m/s.
        stops: Columns station, time until which it holds, of the stops on the path `(stops, 2)`, m, s.
        start: v, a.
        time_gap: Wanted gap per speed of the one ahead, s.
        is_lowered: Whether `limit` may differ from `own`.
        may_overtake: `(n,)`, False: who would be overtaken is yielded to.
        is_drawn: Whether the speed DP is wanted even where it decides nothing, and all of its costs.
        settings: Of the stage.
    """
    v_limit, stop_line = limit, _stop_line(agent, lower, pace, settings.standstill_gap)
    stands = stop_line < sigma[-1]
    if stands:
        v_limit = np.where(sigma >= stop_line, 0.0, limit)
    v_limit = limit_profile(sigma, kappa, v_limit, settings.curve_accel, settings.ease)  # (1)
    free = _free(sigma, v_limit, start, settings)
    free_m = free[0, -1]
    if stands or is_lowered:
        empty_road = limit_profile(sigma, kappa, own, settings.curve_accel, settings.ease)
        free_m = _free(sigma, empty_road, start, settings)[0, -1]
    moves = _moves(agent, pace, stops)
    cost: FloatArray = np.empty((0, 0))
    chosen: IntArray = np.empty(0, np.int64)
    s_dp = np.zeros(settings.knots)
    if len(agent) + len(stops) > 0 and (is_drawn or moves or not _stands_from_now(t, lower, upper)):
        worth = inf if is_drawn else LIKELY
        cost, chosen = _grid(v_limit, sigma, t, lower, upper, speed, stops, start, time_gap, settings, worth)
        s_dp = np.interp(STEP_S * np.arange(settings.knots), DT_S * np.arange(len(chosen)), DS_M * chosen)
    kinds = _decided(t, lower, upper, speed, pace[agent], s_dp)
    kinds[(kinds == OVERTAKE) & ~may_overtake] = YIELD
    s_ref, v_ref = _references(free, s_dp, moves)
    bound = _speed_bound(sigma, kappa, v_limit, is_bound, s_ref, start, settings)
    low, high = _station_bounds(t, lower, upper, kinds, stops, sigma[-1], settings)
    problem = SpeedProblem(start, low, high, bound, s_ref, v_ref, sigma[-1])
    return Posed(problem, kinds, free_m, cost, chosen, s_dp)


@inner_kernel
def _stop_line(agent: IntArray, lower: FloatArray, pace: FloatArray, gap: float) -> float:
    """Station before the first that stands in the path, m; inf where none does."""
    first = inf
    for i in range(len(agent)):
        if pace[agent[i]] < STANDING_MPS:
            for k in range(lower.shape[1]):
                if lower[i, k] < first:
                    first = lower[i, k]
    return max(first - gap, 0.0)


@inner_kernel
def _free(sigma: FloatArray, v_limit: FloatArray, start: tuple[float, float], settings: Settings) -> FloatArray:
    """Rows s, v `(2, knots)` of driving at a limit."""
    soft = settings.soft
    return cruising(
        sigma, v_limit, start[0], start[1], soft.accel, soft.decel, soft.jerk, STEP_S, settings.knots
    )  # fmt: skip


@inner_kernel
def _moves(agent: IntArray, pace: FloatArray, stops: FloatArray) -> bool:
    """Whether any of those in the way moves, or a stop is known to end."""
    moves = False
    for i in range(len(agent)):
        moves |= not pace[agent[i]] < STANDING_MPS
    for i in range(len(stops)):
        moves |= stops[i, 1] < inf
    return moves


@inner_kernel
def _stands_from_now(t: FloatArray, lower: FloatArray, upper: FloatArray) -> bool:
    """Whether all boundaries are there at t = 0, so that the ego is past none of them."""
    stands = True
    for i in range(len(lower)):
        stands &= t[0] <= 0.0 < lower[i, 0] + upper[i, 0]
    return stands


@inner_kernel
def _grid(
    v_limit: FloatArray, sigma: FloatArray, t: FloatArray, lower: FloatArray, upper: FloatArray, speed: FloatArray,
    stops: FloatArray, start: tuple[float, float], time_gap: float, settings: Settings, worth: float,
) -> tuple[FloatArray, IntArray]:  # fmt: skip
    """Cost of the speed DP's grid and its solution: no gap is wanted beyond that of the stops."""
    rows = int(sigma[-1] / DS_M + 1e-6) + 1
    limit = np.interp(DS_M * np.arange(rows), sigma, v_limit)
    wanted, columns = (settings.standstill_gap, time_gap), settings.columns
    per_column = max(1, round(DT_S / (t[1] - t[0]))) if len(t) > 1 else 1
    occupancy = cost_map(rows, lower, upper, speed, settings.gap, wanted, settings.w_near)
    occupied = occupied_rows(rows, lower, upper, speed, wanted, per_column, columns)
    if len(stops):
        begin, end = np.full((len(stops), len(t)), np.nan), np.full((len(stops), len(t)), 1e6)
        for i in range(len(stops)):
            begin[i, t < stops[i, 1]] = stops[i, 0]
        occupancy += cost_map(rows, begin, end, np.zeros(len(stops)), 0.0, (0.0, 0.0), 0.0)
        occupied[:, 0] = np.minimum(occupied[:, 0], int(stops[:, 0].min() / DS_M))
        occupied[:, 1] = rows - 1
    cost, chosen = speed_dp(occupancy, occupied, per_column, limit, start, settings.weights, worth)
    if not cost[-1].min() < worth - 1.0:
        cost, chosen = speed_dp(occupancy, occupied, per_column, limit, start, settings.weights, inf)
    return cost, chosen


@inner_kernel
def _decided(
    t: FloatArray, lower: FloatArray, upper: FloatArray, speed: FloatArray, pace: FloatArray, s_dp: FloatArray
) -> IntArray:
    """Codes of `st_boundaries.decide_speed` for all boundaries `(n,)`."""
    kinds = np.empty(len(lower), np.int64)
    at = np.interp(t, STEP_S * np.arange(len(s_dp)), s_dp)
    for i in range(len(lower)):
        is_past = True
        for k in range(len(t)):
            is_past &= isnan(lower[i, k]) or at[k] >= 0.5 * (lower[i, k] + upper[i, k])
        stands, along = pace[i] < STANDING_MPS, speed[i] > ALONG * pace[i]
        kinds[i] = OVERTAKE if is_past else STOP if stands else FOLLOW if along else YIELD
    return kinds


@inner_kernel
def _references(free: FloatArray, s_dp: FloatArray, moves: bool) -> tuple[FloatArray, FloatArray]:
    """References of s and v `(knots,)` (2)."""
    s_ref, v_ref = free[0].copy(), free[1].copy()
    if moves:
        s_ref = np.minimum(s_ref, s_dp)
        last = len(s_ref) - 1
        for i in range(last + 1):
            low, high = max(i - 1, 0), min(i + 1, last)
            v_ref[i] = min(v_ref[i], (s_ref[high] - s_ref[low]) / ((high - low) * STEP_S))
    return s_ref, v_ref


@inner_kernel
def _speed_bound(
    sigma: FloatArray, kappa: FloatArray, v_limit: FloatArray, is_bound: BoolArray, s_ref: FloatArray,
    start: tuple[float, float], settings: Settings,
) -> FloatArray:  # fmt: skip
    """Upper bound of v `(knots,)` (4)."""
    soft, knots = settings.soft, settings.knots
    eased = braking(start[0], start[1], settings.ease, soft.jerk, STEP_S, knots)
    if (eased[1] ** 2 * np.abs(np.interp(eased[0], sigma, kappa)) > TILT_MPS2).any():
        eased = braking(start[0], start[1], soft.decel, soft.jerk, STEP_S, knots)
    ahead, at = np.interp(s_ref, sigma, v_limit), np.searchsorted(sigma, s_ref)
    bound = np.empty(knots)
    for i in range(knots):
        room = 0.0 if is_bound[min(at[i], len(sigma) - 1)] else SPEED_ROOM_MPS
        bound[i] = max(ahead[i], eased[1, i]) + room
    return bound


@inner_kernel
def _station_bounds(
    t: FloatArray, lower: FloatArray, upper: FloatArray, kinds: IntArray, stops: FloatArray, length: float,
    settings: Settings,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Bounds of s `(knots,)` (3); of two samples that are as near to a knot, the stricter one counts."""
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
