"""S-T and S-L graphs of a plan, in their units, with the axes that show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from replan.core.arrays import FloatArray
from replan.draw.spans import Span, widened
from replan.logs.plan import (
    Corridor,
    DecisionKind,
    Graph,
    GraphObstacle,
    GridCost,
    Plan,
    SlGraph,
    StGraph,
)


@dataclass(frozen=True)
class GraphKind:
    """A kind of graph: its names and axes."""

    name: str
    graph: type[Graph]
    title: str
    x_title: str  # Title of the axis, with the unit; `y_title` likewise
    y_title: str
    least: float  # The y axis is not shorter than this
    scrolls: bool  # Whether the graphs of a drive begin at different x


ST = GraphKind(
    "st", StGraph, "S-T graph", "time from the plan [s]", "station along the path [m]", 5.0, False
)
SL = GraphKind(
    "sl",
    SlGraph,
    "S-L graph",
    "station of the reference line [m]",
    "lateral offset [m], left positive",
    4.0,
    True,
)
FAR_M = 6.0  # Axes show obstacles and bounds up to this far beyond the solutions


@dataclass(frozen=True, eq=False, slots=True)
class DrawnObstacle:
    """An obstacle with the finite points `(n, 2)`, n >= 1, of its outline."""

    of: GraphObstacle
    outline: FloatArray

    @property
    def is_ignored(self) -> bool:
        """Whether the plan ignores it."""
        return self.of.decision is DecisionKind.IGNORE


@dataclass(frozen=True, eq=False, slots=True)
class DrawnGraph:
    """A graph."""

    # The first x of the QP solution, otherwise of the DP solution, the grid or the corridor
    begin: float
    qp: FloatArray  # Finite points of the QP solution `(n, 2)`
    dp: FloatArray  # Finite points of the DP solution `(n, 2)`
    knots: FloatArray  # Points `(k, 2)` of the DP solution at the columns of its grid
    grid: GridCost | None  # The nodes that the DP searched
    # The bounds of the QP; None if there are fewer than two stations or times
    corridor: Corridor | None
    obstacles: tuple[DrawnObstacle, ...]  # The obstacles that have an outline

    @classmethod
    def of(cls, plan: Plan, kind: GraphKind) -> DrawnGraph | None:
        """The first graph of a kind in a plan; None if there is none."""
        graph = next(
            (artefact for artefact in plan.internals if isinstance(artefact, kind.graph)), None
        )
        if graph is None:
            return None
        qp, dp = finite(graph.qp), finite(graph.dp)
        grid, corridor = graph.grid, graph.corridor
        firsts = (qp[:, 0], dp[:, 0], *(part.first for part in (grid, corridor) if part))
        knots = np.empty((0, 2))
        if grid is not None and len(dp):
            x = grid.first[(grid.first >= dp[0, 0]) & (grid.first <= dp[-1, 0])]
            knots = np.column_stack([x, np.interp(x, dp[:, 0], dp[:, 1])])
        obstacles = (
            DrawnObstacle(obstacle, finite(obstacle.outline)) for obstacle in graph.obstacles
        )
        return cls(
            next((float(x[0]) for x in firsts if len(x)), 0.0),
            qp,
            dp,
            knots,
            grid,
            corridor if corridor is not None and len(corridor.first) > 1 else None,
            tuple(obstacle for obstacle in obstacles if len(obstacle.outline)),
        )


def graph_axes(graphs: Sequence[DrawnGraph], kind: GraphKind) -> tuple[Span, Span] | None:
    """Axes for some graphs, x relative to the begin of each: with all solutions and the near ends
    of obstacles.

    They may cut off bounds of the corridor, and obstacles that are farther than the solutions are
    long. None if there is neither solution nor
    obstacle.
    """
    solutions, outlines = list[FloatArray](), list[FloatArray]()
    for graph in graphs:
        origin = np.array([graph.begin, 0.0])
        solutions += [line - origin for line in (graph.qp, graph.dp) if len(line)]
        outlines += [shape.outline - origin for shape in graph.obstacles if not shape.is_ignored]
    if not solutions and not outlines:
        return None
    points = np.concatenate(solutions or outlines)
    right = max(float(points[:, 0].max()), 1.0)
    if kind is SL:
        begins = [float(outline[:, 0].min()) + FAR_M for outline in outlines]
        right = max([right, *(x for x in begins if x < 2.0 * right)])
    low, high = float(points[:, 1].min()), float(points[:, 1].max())
    ordinates = [y[(x >= 0.0) & (x <= right)] for x, y in (outline.T for outline in outlines)]
    if kind is ST:
        highest = max([high, *(float(y.min()) + FAR_M for y in ordinates if len(y))])
        top = max(high, min(highest, 1.6 * high + 10.0), kind.least)
        return (0.0, right), (min(low, 0.0), 1.05 * top)
    for graph in graphs:
        ordinates += [graph.grid.second] if graph.grid else []
        if (corridor := graph.corridor) is not None:
            inside = corridor.first <= graph.begin + right
            ordinates += [corridor.lower[inside], corridor.upper[inside]]
    near = [y for y in (y[np.isfinite(y)] for y in ordinates) if len(y)]
    lowest = min([low, *(float(y.min()) for y in near)])
    highest = max([high, *(float(y.max()) for y in near)])
    y_span = widened(max(lowest, low - FAR_M), min(highest, high + FAR_M), kind.least)
    return (0.0, right), y_span


def finite(points: FloatArray) -> FloatArray:
    """The finite points `(m, 2)` of a line; an empty array of any shape is an empty line."""
    shaped = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    return shaped[np.isfinite(shaped).all(axis=1)]
