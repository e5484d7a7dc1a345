"""Speed DP: the order of passing, by dynamic programming over the S-T graph (paper, section II-F,
Fig. 8).

Columns every second, rows every half metre; an edge has the speed v = ds / dt and, with the speed
and acceleration of the best way to its first node, an acceleration and a jerk (as in Apollo's EM
planner; with them the problem is not quite Markov). Cost of an edge:

(1) w_t max(dt - T(s_k) + T(s_j), 0) + w_v (v - v_limit)^2 above the limit + w_a a^2 + w_j jerk^2
        + mean over the
    edge of map(t, s), where T(s) = integral of ds / v_limit:
        w_t is the weight of the time that the edge loses
(2) map = COLLISION within `gap_m` of a blocked interval;
        w_near (1 - gap / wanted)^2 where the gap before or behind it
    is less than wanted = d_0 + tau v_agent
(3) cost[i, k] = min over j
        cost[i-1, j] + edge(j, k); ties (within `TIE`: time lost early or late costs the same) go to
        the smaller s

With the squared distance to the limit as a cost, the ego would linger before a faster road rather
than be slow on it; the total of the lost time does not depend on where it is lost. Row and column
spacing go together: a step of one row in one column is ds / dt^2 = 0.5 m/s2.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from replan.core.arrays import TIE, FloatArray, IntArray
from replan.core.kernel import inner_kernel, kernel
from replan.core.settings import Config, NotNegative, Positive

# Cost of a second inside a blocked interval (2): more than all other costs together
COLLISION = 1e5
LIKELY = 300.0
"""The best solution rarely costs more than this: dearer ones are searched only if there is no
cheaper one.
"""
DT_S = 1.0  # Distance between two columns, s
DS_M = 0.5  # Distance between two rows, m
SLOWEST_MPS = 0.5  # Least speed limit in the computation of lost time, m/s


class SpeedDpWeights(NamedTuple):
    """Weights of (1): lost time, speed over the limit, acceleration, jerk.

    And the limits of an edge, m/s2.
    """

    time: float
    over: float
    accel: float
    jerk: float
    max_accel: float
    max_decel: float


@dataclass(frozen=True)
class SpeedDpConfig(Config):
    """Weights and limits of the speed DP."""

    columns: Annotated[int, Meta(ge=2)] = 8
    """Columns of the grid, one second apart."""
    w_t: NotNegative = 30.0
    """Weight of the time lost against driving at the limit."""
    w_v: NotNegative = 3.0
    """Weight of the squared speed above the limit."""
    w_a: NotNegative = 1.0
    """Weight of the squared acceleration."""
    w_j: NotNegative = 0.5
    """Weight of the squared jerk."""
    w_near: NotNegative = 30.0
    """Weight of a gap that is smaller than the wanted one."""
    gap_m: NotNegative = 1.0
    """Smallest gap to a blocked interval."""
    standstill_gap_m: NotNegative = 3.0
    """Wanted gap to an agent that stands."""
    time_gap_s: NotNegative = 1.2
    """Wanted gap per speed of the agent."""
    max_accel_mps2: Positive = 2.0
    """Greatest acceleration between two columns."""
    max_decel_mps2: Positive = 7.0
    """Greatest deceleration between two columns, positive."""

    @property
    def weights(self) -> SpeedDpWeights:
        """The weights in the form that the kernel takes."""
        return SpeedDpWeights(
            self.w_t, self.w_v, self.w_a, self.w_j, self.max_accel_mps2, self.max_decel_mps2
        )


@kernel
def cost_map(
    rows: int,
    lower: FloatArray,
    upper: FloatArray,
    speed: FloatArray,
    gap: float,
    wanted: tuple[float, float],
    w_near: float,
) -> FloatArray:
    """The map (2) `(k, rows)` of blocked intervals `(n, k)`; `wanted` = (standstill gap, time
    gap).
    """
    cost = np.zeros((lower.shape[1], rows))
    for i in range(len(lower)):
        space = wanted[0] + wanted[1] * max(speed[i], 0.0)
        for k in range(lower.shape[1]):
            low, high = lower[i, k], upper[i, k]
            if np.isnan(low):
                continue
            first, last = _within_reach(low, high, space, rows)
            for row in range(first, last + 1):
                s = row * DS_M
                if low - gap + TIE < s < high + gap - TIE:
                    cost[k, row] += COLLISION  # (2)
                else:
                    free = low - s if s <= low else s - high
                    if free < space:
                        cost[k, row] += w_near * (1.0 - free / space) ** 2  # (2)
    return cost


@inner_kernel
def _within_reach(low: float, high: float, space: float, rows: int) -> tuple[int, int]:
    """The first and the last row that is at most `space` m before or behind an interval, or one
    more.
    """
    return max(0, int((low - space) / DS_M)), min(rows - 1, int((high + space) / DS_M) + 1)


@inner_kernel
def occupied_rows(
    rows: int,
    lower: FloatArray,
    upper: FloatArray,
    speed: FloatArray,
    wanted: tuple[float, float],
    per_column: int,
    columns: int,
) -> IntArray:
    """First and last row where the map (2) is not 0 during the edge to each next column
    `(columns, 2)`.
    """
    occupied = np.empty((columns, 2), np.int64)
    for column in range(columns):
        occupied[column, 0], occupied[column, 1] = rows, -1
        for n in range(column * per_column + 1, (column + 1) * per_column + 1):
            k = min(n, lower.shape[1] - 1)
            for i in range(len(lower)):
                if not np.isnan(lower[i, k]):
                    space = wanted[0] + wanted[1] * max(speed[i], 0.0)
                    first, last = _within_reach(lower[i, k], upper[i, k], space, rows)
                    occupied[column, 0], occupied[column, 1] = (
                        min(occupied[column, 0], first),
                        max(occupied[column, 1], last),
                    )
    return occupied


@kernel
def speed_dp(
    occupancy: FloatArray,
    occupied: IntArray,
    per_column: int,
    limit: FloatArray,
    start: tuple[float, float],
    weights: SpeedDpWeights,
    worth: float,
) -> tuple[FloatArray, IntArray]:
    """Solve (3): the cost to come `(columns + 1, rows)`, and the chosen row per column
    `(columns + 1,)`.

    Args:
        occupancy: The map (2) `(k, rows)`, `per_column` time samples to a column, the first at t =
            0.
        occupied: First and last row where it is not zero, for each column after the start
            `(columns, 2)`.
        per_column: Time samples of `occupancy` per column.
        limit: Speed limit at the rows `(rows,)`, m/s.
        start: Speed and acceleration of the ego.
        weights: Weights of (1), and the limits of an edge.
        worth: Nodes that cost this or more are not continued. Costs do not fall along a solution,
            so any value that exceeds the cost of the best one by more than the ties gives the same
            result.
    """
    rows, columns = len(limit), len(occupied)
    needed = np.zeros(rows)
    for k in range(1, rows):
        needed[k] = needed[k - 1] + DS_M / max(0.5 * (limit[k - 1] + limit[k]), SLOWEST_MPS)
    cost, totals = np.full((columns + 1, rows), inf), np.empty(rows)
    speed, accel = np.zeros((columns + 1, rows)), np.zeros((columns + 1, rows))
    parent = np.zeros((columns + 1, rows), np.int64)
    cost[0, 0], speed[0, 0], accel[0, 0] = 0.0, start[0], start[1]
    for i in range(columns):
        ahead = cost[i + 1]
        for j in range(rows):
            if cost[i, j] >= worth:
                continue
            v0 = speed[i, j]
            low = max(0, int(np.ceil((v0 - weights.max_decel * DT_S) * DT_S / DS_M - TIE)))
            high = min(
                max(low, int((v0 + weights.max_accel * DT_S) * DT_S / DS_M + TIE)), rows - 1 - j
            )
            for k in range(j + low, j + high + 1):  # without the map: no branch, which is fast
                v = (k - j) * DS_M / DT_S
                a = (v - v0) / DT_S
                lost, over = max(DT_S - needed[k] + needed[j], 0.0), max(v - limit[k], 0.0)
                # (1)
                total = cost[i, j] + weights.accel * a * a + weights.jerk * (a - accel[i, j]) ** 2
                totals[k - j] = total + (weights.time * lost + weights.over * over * over)
            for k in range(j + low, j + high + 1):
                total = totals[k - j]
                if total > ahead[k] - TIE:
                    continue
                if k >= occupied[i, 0] and j <= occupied[i, 1]:
                    for n in range(1, per_column + 1):
                        row = j + (k - j) * n / per_column
                        total += (
                            occupancy[min(i * per_column + n, len(occupancy) - 1), int(row + 0.5)]
                            / per_column
                        )
                        if total > ahead[k] - TIE:
                            break
                if total < ahead[k] - TIE:
                    ahead[k], parent[i + 1, k] = total, j  # (3)
                    speed[i + 1, k] = (k - j) * DS_M / DT_S
                    accel[i + 1, k] = (speed[i + 1, k] - v0) / DT_S
    chosen = np.zeros(columns + 1, np.int64)
    chosen[columns] = np.argmax(cost[columns] <= cost[columns].min() + TIE)
    for i in range(columns, 0, -1):
        chosen[i - 1] = parent[i, chosen[i]]
    return cost, chosen
