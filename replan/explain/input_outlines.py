"""Outlines of road users in the graphs of a plan: as the planner drew them, and as they would be.

S-T outlines are compared as slices: the interval of stations [lower(t), upper(t)] at times `SLICES`
from the frame. A planner grows boxes by margins: of space on both sides, of time before and after.
What follows is zero for each growth that is the same on both sides:

(1) c(t) = (lower(t) + upper(t)) / 2, the middle at each time that both outlines have
(2) the middle of the time for which the path is taken, times the speed of the agent

The S-L outline of an agent that stands gives the shift of its middle in the world. The reference
line of the graph is that of the ego's lane or of the route; `stations` of a planner may begin
elsewhere, and a graph whose solution is not the planned path along either line is not read.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replan.core.arrays import FloatArray
from replan.explain.course import PlanWay
from replan.explain.occupancy import bodies, occupied
from replan.logs.agents import Agents
from replan.logs.frame import Predictions
from replan.logs.plan import SlGraph
from replan.logs.reference_line import ReferenceLine
from replan.logs.shapes import corners
from replan.logs.states import Trajectory
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.scene import Futures

SLICE_S = 0.2
SLICES = SLICE_S * np.arange(41)
"""Times from the frame at which S-T outlines are compared, s."""
MISSED_M = 6.0
"""The difference of two outlines of which one is empty, or which share no time, at most, m."""
EARLY_S = 0.7
"""An outline that reaches to the end of the graph may begin earlier by this margin, s; likewise
one that begins with it may end later.
"""
SAME_LINE_M = 0.3
"""A path that is nearer than this to the solution of an S-L graph along a line is that solution."""


@dataclass(frozen=True, eq=False, slots=True)
class Slices:
    """The stations that an agent takes, `(k,)` at `SLICES`, m; NaN where it takes none."""

    lower: FloatArray
    upper: FloatArray

    @property
    def is_empty(self) -> bool:
        """Whether the path is free at all times."""
        return not bool(np.isfinite(self.lower).any())

    @classmethod
    def of(cls, outline: FloatArray) -> Slices:
        """The slices of a polygon `(n, 2)` of times, s, and stations, m."""
        (t_from, s_from), (t_to, s_to) = outline.T, np.roll(outline, -1, axis=0).T
        times = SLICES[:, None]
        early, late = np.minimum(t_from, t_to), np.maximum(t_from, t_to)
        covers = (times >= early - 1e-6) & (times <= late + 1e-6)
        span = np.where(t_to == t_from, 1.0, t_to - t_from)
        s = s_from + np.clip((times - t_from) / span, 0.0, 1.0) * (s_to - s_from)
        taken = covers.any(axis=1)
        lower = np.where(covers, s, np.inf).min(axis=1)
        upper = np.where(covers, s, -np.inf).max(axis=1)
        return cls(np.where(taken, lower, np.nan), np.where(taken, upper, np.nan))

    def motion(self, expected: Slices) -> dict[str, float]:
        """Against an outline without margins: `station_m` farther along the path at the first time
        that both have, as from `age_s` earlier, and displaced by `share`; for agents along it.
        """
        both = np.flatnonzero(np.isfinite(self.lower + expected.lower))
        if len(both) < 2:
            return {}
        taken, wanted = (0.5 * (part.lower + part.upper)[both] for part in (self, expected))
        station = float(taken[0] - wanted[0])
        moved, lasted = float(wanted[-1] - wanted[0]), SLICE_S * float(both[-1] - both[0])
        if abs(moved) < lasted:  # slower than 1 m/s along the path
            return {"station_m": station}
        share = float(taken[-1] - taken[0]) / moved
        return {"station_m": station, "age_s": -station * lasted / moved, "share": share}

    def difference(self, other: Slices, speed: float) -> float:
        """The difference from an outline that an agent at a speed, m/s, would have, m: (1), (2)."""
        taken = np.flatnonzero(np.isfinite(self.lower))
        top = self.upper[taken].max(initial=-np.inf)  # the path of the graph may end here
        wanted = np.flatnonzero(other.lower < top)
        if not len(taken) or not len(wanted):
            return 0.0 if len(taken) == len(wanted) else MISSED_M
        last = len(SLICES) - 1
        begin, end = SLICE_S * float(wanted[0] - taken[0]), SLICE_S * float(taken[-1] - wanted[-1])
        begins, ends = min(taken[0], wanted[0]) == 0, max(taken[-1], wanted[-1]) == last
        if begins and ends:
            begin, end = max(begin - EARLY_S, 0.0), max(end - EARLY_S, 0.0)
            late = max(begin, end)
        elif begins:
            late = max(-end, end - EARLY_S, 0.0)
        elif ends:
            late = max(-begin, begin - EARLY_S, 0.0)
        else:
            late = max(abs(end - begin) / 2.0 - SLICE_S, 0.0)
        both = np.intersect1d(taken, wanted)
        apart = MISSED_M
        if len(both):
            low, high = (self.lower - other.lower)[both], (self.upper - other.upper)[both]
            is_cut = high - low < -SLICE_S  # the path of the graph ends within the agent
            middle = np.abs(0.5 * (low + high))
            apart = float(np.where(is_cut, np.minimum(np.abs(low), np.abs(high)), middle).mean())
        return min(float(np.hypot(apart, late * max(speed, 1.0))), MISSED_M)


def expected_slices(
    way: PlanWay, agents: Agents, futures: Predictions, car: VehicleParameters, margin: float = 0.0
) -> list[tuple[int, Slices, float]]:
    """The agents of the predictions `rows` that take the way without any margin, by their rows in
    `agents`, and their slices.
    """
    later = futures.t - futures.t[0]
    x, y, yaw = (
        np.array([np.interp(SLICES, later, row) for row in column]).reshape(-1, len(SLICES))
        for column in (futures.x, futures.y, np.unwrap(futures.yaw, axis=1))
    )
    poses = Futures(SLICES, futures.agent, futures.probability, x, y, yaw)
    return [
        (
            taken.agent,
            Slices(taken.lower, taken.upper),
            float(futures.probability[taken.prediction]),
        )
        for taken in occupied(way.swept, poses, bodies(agents), car, (margin, margin, margin))
    ]


@dataclass(frozen=True, eq=False, slots=True)
class GraphLine:
    """The reference line of an S-L graph, whose stations are those of the line and `ahead`."""

    line: ReferenceLine
    ahead: float

    @classmethod
    def of(cls, graph: SlGraph, path: Trajectory, line: ReferenceLine) -> GraphLine | None:
        """The line, if the solution of the graph is the planned path along it."""
        if len(graph.qp) < 2:
            return None
        near = line.project(path.x[0], path.y[0])[0]
        ahead = float(graph.qp[0, 0]) - near
        for row in range(0, len(path), max(1, len(path) // 8)):
            s, l = line.project(path.x[row], path.y[row], near, 100.0)
            is_known = s + ahead <= graph.qp[-1, 0] + 1e-6
            if is_known and abs(np.interp(s + ahead, *graph.qp.T) - l) > SAME_LINE_M:
                return None
        return cls(line, ahead)

    def shift(self, outline: FloatArray, agents: Agents, row: int) -> FloatArray:
        """How far an outline's middle is from that of an agent's box `(2,)`, world, m."""
        box = corners(
            agents.x[row], agents.y[row], agents.yaw[row], agents.length[row], agents.width[row]
        )
        points = np.vstack([box, 0.5 * (box + np.roll(box, 1, axis=0))])
        near = self.line.project(agents.x[row], agents.y[row])[0]
        placed = np.array([self.line.project(x, y, near, 15.0) for x, y in points])
        s, l = (0.5 * (column.min() + column.max()) for column in placed.T)
        drawn_s, drawn_l = (0.5 * (column.min() + column.max()) for column in outline.T)
        yaw = self.line.frame(s)[2]
        along, across = drawn_s - self.ahead - s, drawn_l - l
        return np.array(
            [
                along * np.cos(yaw) - across * np.sin(yaw),
                along * np.sin(yaw) + across * np.cos(yaw),
            ]
        )
