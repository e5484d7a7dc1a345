"""What is drawn of an S-T or S-L graph, in its units: recordings and charts draw it in their own ways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.kernel import FloatArray
from logs.trace import Corridor, DecisionKind, Graph, GraphObstacle, GridCost, Plan


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
    """A graph.

    Attributes:
        begin: The first x of the QP solution, otherwise of the DP solution, the grid or the corridor.
        qp: Finite points of the QP solution `(n, 2)`.
        dp: Finite points of the DP solution `(n, 2)`.
        knots: Points `(k, 2)` of the DP solution at the columns of its grid.
        grid: The nodes that the DP searched.
        corridor: The bounds of the QP; None if there are fewer than two stations or times.
        obstacles: The obstacles that have an outline.
    """

    begin: float
    qp: FloatArray
    dp: FloatArray
    knots: FloatArray
    grid: GridCost | None
    corridor: Corridor | None
    obstacles: tuple[DrawnObstacle, ...]

    @classmethod
    def of(cls, plan: Plan, kind: type[Graph]) -> DrawnGraph | None:
        """The first graph of a kind in a plan; None if there is none."""
        graph = next((artefact for artefact in plan.internals if isinstance(artefact, kind)), None)
        if graph is None:
            return None
        qp, dp, grid, corridor = finite(graph.qp), finite(graph.dp), graph.grid, graph.corridor
        firsts = (qp[:, 0], dp[:, 0], *(part.first for part in (grid, corridor) if part))
        knots = np.empty((0, 2))
        if grid is not None and len(dp):
            x = grid.first[(grid.first >= dp[0, 0]) & (grid.first <= dp[-1, 0])]
            knots = np.column_stack([x, np.interp(x, dp[:, 0], dp[:, 1])])
        outlines = ((each, finite(each.outline)) for each in graph.obstacles)
        return cls(
            next((float(x[0]) for x in firsts if len(x)), 0.0), qp, dp, knots, grid,
            corridor if corridor is not None and len(corridor.first) > 1 else None,
            tuple(DrawnObstacle(each, outline) for each, outline in outlines if len(outline)),
        )  # fmt: skip


def finite(points: FloatArray) -> FloatArray:
    """The finite points `(m, 2)` of a line; an empty array of any shape is an empty line."""
    shaped = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    return shaped[np.isfinite(shaped).all(axis=1)]
