"""The axes of graphs: which ranges a recording shows, their ticks, and where labels go.

Ranges are fixed for a recording, so that the frames can be compared. A plot area of `WIDTH` x `HEIGHT` view units is
the same in all recordings; `Axes.scale` maps the units of a graph to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor, log10

import numpy as np

from logs.kernel import FloatArray
from logs.trace import DecisionKind, Graph
from replay.draw.recording.columns import joined
from replay.draw.recording.hatch import Window

WIDTH, HEIGHT = 160.0, 96.0
MARGIN_LEFT, MARGIN_BOTTOM, MARGIN_RIGHT, MARGIN_TOP = 15.0, 14.0, 7.0, 9.0
LABEL_GAP = 7.0
"""Labels nearer to each other in height than this are moved apart, view units."""
LETTER = 1.9
"""Width of a letter of a label in a window of usual size, view units."""


@dataclass(frozen=True)
class Axes:
    """The axes of one graph over a whole recording.

    Attributes:
        entity: Where it is drawn.
        x, y: Ranges; x is relative to where the graph begins.
        x_title, y_title: With units.
        scrolls: Whether the graph begins elsewhere in each frame (then x ticks move).
    """

    entity: str
    x: tuple[float, float]
    y: tuple[float, float]
    x_title: str
    y_title: str
    scrolls: bool

    @property
    def scale(self) -> tuple[float, float]:
        """View units per unit of x and of y."""
        return WIDTH / (self.x[1] - self.x[0]), HEIGHT / (self.y[1] - self.y[0])

    @property
    def window(self) -> Window:
        """The visible part."""
        return Window(self.x, self.y)


def nice_step(span: float, most: int) -> float:
    """The smallest of 1, 2, 5, 10, ... (and their decimal fractions) that divides a span into at most `most`."""
    rough = max(span, 1e-9) / most
    unit = 10.0 ** floor(log10(rough))
    return float(next(unit * factor for factor in (1.0, 2.0, 5.0, 10.0) if unit * factor >= rough * (1.0 - 1e-9)))


def ticks(low: float, high: float, step: float) -> FloatArray:
    """The multiples of a step in a range."""
    return np.arange(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1) * step


def finite(points: FloatArray) -> FloatArray:
    """The finite points `(m, 2)` of a line; an empty array of any shape is an empty line."""
    shaped = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    return shaped[np.isfinite(shaped).all(axis=1)]


def begin(graph: Graph) -> float:
    """The x at which a graph begins: of its QP, else of its DP, its grid, its corridor."""
    for x in (finite(graph.qp)[:, 0], finite(graph.dp)[:, 0], *(p.first for p in (graph.grid, graph.corridor) if p)):
        if len(x):
            return float(x[0])
    return 0.0


def _solutions(graphs: Sequence[Graph]) -> FloatArray:
    """All points of all solutions, x relative to where each graph begins."""
    points = [finite(line) - [begin(graph), 0.0] for graph in graphs for line in (graph.qp, graph.dp)]
    return joined(points, 2)[0]


def st_axes(graphs: Sequence[Graph]) -> Axes | None:
    """Axes on which every speed solution and the near end of every obstacle that matters is visible."""
    points = _solutions(graphs)
    if not len(points):
        return None
    near = [
        float(finite(obstacle.outline)[:, 1].min())
        for graph in graphs
        for obstacle in graph.obstacles
        if obstacle.decision is not DecisionKind.IGNORE and len(finite(obstacle.outline))
    ]
    solved = float(points[:, 1].max())
    top = max(1.12 * solved, min(1.1 * max([0.0, *near]), 1.25 * solved), 5.0)
    right = max(float(points[:, 0].max()), 0.1)
    step = nice_step(top, 10)
    low = min(0.0, -step * ceil(-float(points[:, 1].min()) / step))
    return Axes("graphs/st", (0.0, right), (low, step * ceil(top / step - 1e-9)), "t [s]", "s [m]", False)


def sl_axes(graphs: Sequence[Graph]) -> Axes | None:
    """Axes on which every path solution and every grid row is visible."""
    points = _solutions(graphs)
    if not len(points):
        return None
    rows = [graph.grid.second[[0, -1]] for graph in graphs if graph.grid and len(graph.grid.second)]
    lateral = np.concatenate([points[:, 1], *rows])
    low, high = float(lateral.min()) - 0.6, float(lateral.max()) + 0.6
    middle, half = 0.5 * (low + high), max(0.5 * (high - low), 1.5)
    length = max(float(points[:, 0].max()), 1.0)
    return Axes("graphs/sl", (0.0, length), (middle - half, middle + half), "s [m]", "l [m]", True)


def spread(points: FloatArray, lengths: Sequence[int], axes: Axes) -> FloatArray:
    """Label positions `(n, 2)` moved up, then down from the top, until no two labels cover each other.

    Args:
        points: Where the labels belong, in units of the graph.
        lengths: Their numbers of characters.
        axes: For the scale and the upper border.
    """
    kx, ky = axes.scale
    out, order = points.copy(), np.argsort(points[:, 1], kind="stable")
    gap, top = LABEL_GAP / ky, axes.y[1] - 1.0 / ky
    beside = [
        [
            i
            for i in order
            if i != j and abs(points[i, 0] - points[j, 0]) * kx < 0.5 * LETTER * (lengths[i] + lengths[j])
        ]
        for j in range(len(points))
    ]
    for n, i in enumerate(order):
        below = [out[j, 1] for j in order[:n] if j in beside[i]]
        out[i, 1] = max([out[i, 1], *(y + gap for y in below)])
    for n, i in reversed(list(enumerate(order))):
        above = [out[j, 1] for j in order[n + 1 :] if j in beside[i]]
        out[i, 1] = min([out[i, 1], top, *(y - gap for y in above)])
    return out
