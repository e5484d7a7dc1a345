"""Path DP: the side of each obstacle, by dynamic programming over sampled points of the S-L plane.

Columns at stations S_i, rows at offsets L_k; nodes have l' = l'' = 0, so an edge between columns is
the quintic

(1) l(u) = l_j + (l_k - l_j) (10 u^3 - 15 u^4 + 6 u^5),   u = (s - S_i) / (S_{i+1} - S_i)

and only the first edge, from the ego's (l, l', l''), is a general quintic. Cost of an edge, sampled
at equal steps:

(2) sum over samples  w_ref l^2 + w_dl l'^2 + w_ddl l''^2 + obstacle(s, l) + corridor(s, l)
(3) obstacle = COLLISION inside a box grown by the ego's half width,
        w_near (1 - gap / reach)^2 within `reach` of it, and w_switch beside it on the other side
        than in the previous plan, so that the side changes only for a gain

(4) cost[i, k] = min over j  cost[i-1, j] + edge(j, k)

(paper, section II-F, Fig. 6). Backwards likewise; the sum of both is the least cost of a path
through a node, and so of passing an obstacle on one side. Ties (within `TIE`) go to the first row:
rows are ordered from the passing side.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from msgspec import Meta

from replan.core.arrays import TIE, FloatArray, IntArray
from replan.core.errors import ConfigError
from replan.core.kernel import inner_kernel, kernel
from replan.core.settings import Config, NotNegative, Positive
from replan.planners.frenet.path import quintic

COLLISION = 1e4  # Cost of a metre of way inside a box (3): more than any detour
# Cost of a metre of way a metre outside of the corridor (2): less than a collision, more than any
# detour
OUTSIDE = 1e3
SAMPLES = 10  # Samples of an edge (2)
# An edge that costs this much more than going straight on is neither the cheapest nor a tie
BESIDES = 3.0 * TIE


class PathDpWeights(NamedTuple):
    """Weights of (2) and (3); `reach` m."""

    ref: float
    dl: float
    ddl: float
    near: float
    reach: float
    switch: float


@dataclass(frozen=True)
class PathDpConfig(Config):
    """Grid and weights of the path DP."""

    columns: Annotated[int, Meta(ge=2)] = 10
    """Stations of the grid."""
    rows: Annotated[int, Meta(ge=3)] = 21
    """Offsets of the grid, odd, so that one is the reference line."""
    row_spacing_m: Positive = 0.5
    """Distance between two offsets."""
    w_ref: NotNegative = 0.05
    """Weight of the squared offset from the reference line."""
    w_dl: NotNegative = 20.0
    """Weight of the squared slope of the path, l'."""
    w_ddl: NotNegative = 500.0
    """Weight of the squared second derivative of the path, l''."""
    w_near: NotNegative = 2.0
    """Weight of coming near an obstacle."""
    reach_m: NotNegative = 1.0
    """Distance from which an obstacle has no cost."""
    w_switch: NotNegative = 2.0
    """Cost per m of passing an obstacle on the other side than before."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.rows % 2 == 0:
            raise ConfigError(f"rows: path DP needs an odd number, got {self.rows}")

    @property
    def weights(self) -> PathDpWeights:
        """The weights in the form that the kernels take."""
        return PathDpWeights(
            self.w_ref, self.w_dl, self.w_ddl, self.w_near, self.reach_m, self.w_switch
        )

    def offsets(self, *, passes_left: bool) -> FloatArray:
        """The rows `(rows,)`, m, from the passing side to the other."""
        half = self.rows // 2
        rows = self.row_spacing_m * np.arange(half, -half - 1, -1)
        return rows if passes_left else -rows


@dataclass(frozen=True, eq=False, slots=True)
class SlGrid:
    """The solved grid: stations of the columns `(n,)`, m, offsets of the rows `(k,)`, m; s, l, l',
    l'' of the start.

    `cost` to come `(n, k)`, the chosen row per column, and the least cost of passing each obstacle
    left and right `(b, 2)`.
    """

    stations: FloatArray
    rows: FloatArray
    start: FloatArray
    cost: FloatArray
    chosen: IntArray
    sides: FloatArray

    def offset(self, s: float) -> float:
        """The DP path's l at a station, m."""
        return path_dp_offset(self.stations, self.rows, self.chosen, self.start, s)

    def offsets(self, s: FloatArray) -> FloatArray:
        """The DP path's l at stations `(n,)`, m."""
        return np.array([self.offset(float(station)) for station in s])


def solve_path_dp(
    stations: FloatArray,
    rows: FloatArray,
    start: FloatArray,
    boxes: FloatArray,
    room: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    config: PathDpConfig,
) -> SlGrid:
    """Solve the grid over stations `(n,)` and offsets `(k,)`, from `start` (s, l, l', l''), past
    `boxes` `(b, 5)`.

    `room` returns the bounds of the offsets at stations; see `path_dp`.
    """
    step, shape = stations[1] - stations[0], (len(stations), SAMPLES)
    samples = (stations[:, None] - step + step / SAMPLES * np.arange(1, SAMPLES + 1)).ravel()
    lower, upper = (edge.reshape(shape) for edge in room(samples))
    weights = config.weights
    cost, chosen = path_dp(stations, rows, start, boxes, lower, upper, weights)
    sides: FloatArray = np.empty((0, 2))
    if len(boxes):
        through = cost + path_dp_to_go(stations, rows, boxes, lower, upper, weights)
        sides = side_costs(stations, rows, through, boxes)
    return SlGrid(stations, rows, start, cost, chosen, sides)


class _PathNode(NamedTuple):
    """A point of a path: station, offset, m, and the offset's derivatives by the station."""

    s: float
    l: float
    dl: float
    ddl: float


class _EdgeSurroundings(NamedTuple):
    """What an edge costs: obstacles `(b, 5)` and bounds `(columns, SAMPLES)` as in `path_dp`,
    weights.
    """

    boxes: FloatArray
    lower: FloatArray
    upper: FloatArray
    weights: PathDpWeights


@inner_kernel
def _edge(
    begin: _PathNode, s: float, l: float, corridor: _EdgeSurroundings, column: int, best: float
) -> float:
    """Cost (2) of the edge from a node into a column, at (s, l); it stops once this exceeds
    `best`.
    """
    boxes, weights = corridor.boxes, corridor.weights
    lower, upper = corridor.lower[column], corridor.upper[column]
    s0, l0, dl0, ddl0 = begin
    length = s - s0
    c3, c4, c5 = quintic(l0, dl0, ddl0, l, length)
    step = length / SAMPLES
    total = 0.0
    for i in range(SAMPLES):
        d = step * (i + 1)
        offset = l0 + d * (dl0 + d * (0.5 * ddl0 + d * (c3 + d * (c4 + d * c5))))  # (1)
        slope = dl0 + d * (ddl0 + d * (3.0 * c3 + d * (4.0 * c4 + d * 5.0 * c5)))
        bend = ddl0 + d * (6.0 * c3 + d * (12.0 * c4 + d * 20.0 * c5))
        # (2)
        cost = (
            weights.ref * offset * offset + weights.dl * slope * slope + weights.ddl * bend * bend
        )
        outside = max(lower[i] - offset, offset - upper[i], 0.0)
        if outside > 0.0:
            cost += OUTSIDE * (0.1 + outside)
        for b in range(len(boxes)):
            if boxes[b, 0] - TIE <= s0 + d <= boxes[b, 1] + TIE:
                gap = max(boxes[b, 2] - offset, offset - boxes[b, 3])
                if gap < -TIE:
                    cost += COLLISION  # (3)
                elif gap < weights.reach:
                    cost += weights.near * (1.0 - gap / weights.reach) ** 2  # (3)
                if boxes[b, 4] * (2.0 * offset - boxes[b, 2] - boxes[b, 3]) < 0.0:
                    cost += weights.switch  # (3)
        total += cost * step
        if total >= best:
            return total
    return total


@kernel
def path_dp(
    stations: FloatArray,
    offsets: FloatArray,
    start: FloatArray,
    boxes: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    weights: PathDpWeights,
) -> tuple[FloatArray, IntArray]:
    """Solve (4).

    Args:
        stations: `(n,)` m, ahead of the start.
        offsets: `(k,)` m.
        start: s, l, l', l'' of the ego.
        boxes: `(b, 5)` obstacles: s from, s to, l from, l to, grown by the ego; last side: 1 left,
            -1 right.
        lower: `(n, SAMPLES)` corridor at the samples of the edge into each column.
        upper: `(n, SAMPLES)`.
        weights: Weights of (2) and (3).

    Returns:
        Cost to come `(n, k)`, and the chosen row per column `(n,)`.
    """
    n, k = len(stations), len(offsets)
    corridor = _EdgeSurroundings(boxes, lower, upper, weights)
    s0, l0, dl0, ddl0 = start
    begin = _PathNode(s0, l0, dl0, ddl0)
    cost = np.full((n, k), np.inf)
    parent = np.zeros((n, k), np.int64)
    for row in range(k):
        cost[0, row] = _edge(begin, stations[0], offsets[row], corridor, 0, np.inf)
    for i in range(1, n):
        for row in range(k):
            node = _PathNode(stations[i - 1], offsets[row], 0.0, 0.0)
            straight = cost[i - 1, row] + _edge(
                node, stations[i], offsets[row], corridor, i, np.inf
            )
            for before in range(k):
                most = min(cost[i, row], straight + BESIDES)
                if cost[i - 1, before] >= most:
                    continue
                node = _PathNode(stations[i - 1], offsets[before], 0.0, 0.0)
                total = cost[i - 1, before] + _edge(
                    node, stations[i], offsets[row], corridor, i, most - cost[i - 1, before]
                )
                if total < min(cost[i, row] - TIE, straight + BESIDES):
                    cost[i, row], parent[i, row] = total, before  # (4)
    chosen = np.zeros(n, np.int64)
    chosen[n - 1] = np.argmax(cost[n - 1] <= cost[n - 1].min() + TIE)
    for i in range(n - 1, 0, -1):
        chosen[i - 1] = parent[i, chosen[i]]
    return cost, chosen


@kernel
def path_dp_to_go(
    stations: FloatArray,
    offsets: FloatArray,
    boxes: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    weights: PathDpWeights,
) -> FloatArray:
    """Least cost `(n, k)` from a node to the grid's end: (4) backwards.

    Arguments as in `path_dp`.
    """
    n, k = len(stations), len(offsets)
    corridor = _EdgeSurroundings(boxes, lower, upper, weights)
    cost = np.zeros((n, k))
    for i in range(n - 1, 0, -1):
        for row in range(k):
            node = _PathNode(stations[i - 1], offsets[row], 0.0, 0.0)
            best = np.inf
            # Straight on first: it is near the best, so that the other edges stop early
            for turn in range(k):
                after = row if turn == 0 else turn - (turn <= row)
                if cost[i, after] < best:
                    rest = best - cost[i, after]
                    edge = _edge(node, stations[i], offsets[after], corridor, i, rest)
                    best = min(best, cost[i, after] + edge)  # (4)
            cost[i - 1, row] = best
    return cost


@kernel
def side_costs(
    stations: FloatArray, offsets: FloatArray, through: FloatArray, boxes: FloatArray
) -> FloatArray:
    """Least cost `(b, 2)` of passing each box on its left and on its right, at the column next to
    its middle.

    `through` `(n, k)` is the least cost of a path through each node; inf where no row is on that
    side.
    """
    costs = np.full((len(boxes), 2), np.inf)
    for b in range(len(boxes)):
        away = np.abs(stations - 0.5 * (boxes[b, 0] + boxes[b, 1]))
        i = int(np.argmax(away <= away.min() + TIE))
        for row in range(len(offsets)):
            side = 0 if 2.0 * offsets[row] > boxes[b, 2] + boxes[b, 3] else 1
            costs[b, side] = min(costs[b, side], through[i, row])
    return costs


@kernel
def path_dp_offset(
    stations: FloatArray, offsets: FloatArray, chosen: IntArray, start: FloatArray, s: float
) -> float:
    """The DP path's l at station `s` (1); beyond the grid it stays at its last row."""
    s0, l0, dl0, ddl0 = start
    if s <= s0:
        return l0
    for i in range(len(stations)):
        l1 = offsets[chosen[i]]
        if s <= stations[i]:
            c3, c4, c5 = quintic(l0, dl0, ddl0, l1, stations[i] - s0)
            d = s - s0
            return l0 + d * (dl0 + d * (0.5 * ddl0 + d * (c3 + d * (c4 + d * c5))))
        s0, l0 = stations[i], l1
        dl0, ddl0 = 0.0, 0.0
    return l0
