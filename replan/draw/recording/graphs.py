"""S-T and S-L graphs, frame by frame: the space that a stage searched, and its solutions.

The viewer has no x-y plot, but it has 2D views: the data keep their units (s, m), and a transform
above them scales an axis range to a plot area of `WIDTH` x `HEIGHT` view units with y up. The
determinant of that scale has size 1, so that line widths in view units are not scaled. The axes are
fixed for a recording, so that its frames can be compared.

The S-L graph scrolls: its stations are those of the reference line, and the window begins where the
graph begins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from math import ceil
from typing import Any, NamedTuple

import numpy as np
import rerun as rr

from replan.core.arrays import FloatArray, IntArray
from replan.draw.plan_graphs import DrawnGraph, DrawnObstacle, GraphKind, graph_axes
from replan.draw.recording import colours
from replan.draw.recording.tape import (
    Instants,
    PlaneWindow,
    Tape,
    joined,
    outline_segments,
    pixels,
    plain,
    strokes,
)
from replan.draw.spans import Span, ticks
from replan.logs.plan import DecisionKind

WIDTH, HEIGHT = 160.0, 96.0
MARGIN_LEFT, MARGIN_RIGHT = 15.0, 7.0
MARGIN_BOTTOM, MARGIN_TOP = 14.0, 9.0
LABEL_GAP = 7.0  # Labels nearer to each other in height than this are moved apart, view units
LETTER = 1.9  # Width of a letter of a label in a window of usual size, view units
STROKE = 0.8  # Distance of the strokes that fill an obstacle, view units
MAX_LABELS = 8
MOST_TICKS = 10
FEW_LABELS = 3  # Ignored obstacles are labelled in frames with at most this many obstacles
MAX_ROWS = 40  # A grid with more rows than this is thinned for drawing
NO_POINTS = np.empty((0, 2))


@dataclass(frozen=True)
class Axes:
    """The axes of one graph over a whole recording."""

    kind: GraphKind
    x: Span  # Range, relative to the begin of the graph; `y` likewise
    y: Span

    @classmethod
    def of(cls, graphs: Sequence[DrawnGraph], kind: GraphKind) -> Axes | None:
        """Axes that fit all graphs of a drive; None if there is nothing in them."""
        spans = graph_axes(graphs, kind)
        return None if spans is None else cls(kind, *spans)

    @property
    def entity(self) -> str:
        """The entity of the graph."""
        return f"graphs/{self.kind.name}"

    @property
    def scale(self) -> tuple[float, float]:
        """View units per unit of x and of y."""
        return WIDTH / (self.x[1] - self.x[0]), HEIGHT / (self.y[1] - self.y[0])

    @property
    def window(self) -> PlaneWindow:
        """The visible part."""
        return PlaneWindow(self.x, self.y)


def draw_graph(
    tape: Tape, instants: Instants, graphs: Sequence[DrawnGraph | None], axes: Axes
) -> None:
    """Draw one kind of graph, one row per frame; a frame without it shows empty axes."""
    kx, ky = axes.scale
    scale = rr.Transform3D(
        translation=[-kx * axes.x[0], ky * axes.y[0], 0.0], scale=[kx, -ky, 1.0 / (kx * ky)]
    )
    tape.static(axes.entity, scale)
    offsets = np.zeros(len(graphs))
    for i, graph in enumerate(graphs):
        if axes.kind.scrolls:
            offsets[i] = graph.begin if graph else offsets[max(i - 1, 0)]
    sheet = _Sheet(tape, instants, graphs, axes, offsets, f"{axes.entity}/window")
    shift = np.c_[-offsets, np.zeros((len(offsets), 2))]
    tape.rows(sheet.window, instants, rr.Transform3D.columns(translation=shift))
    sheet.draw_axes()
    sheet.draw_solutions()
    sheet.draw_corridor()
    sheet.draw_grid()
    sheet.draw_obstacles()


class _Label(NamedTuple):
    position: FloatArray  # `(2,)`, in units of the graph
    words: str
    shade: int


@dataclass(frozen=True, eq=False)
class _Sheet:
    """The graphs of a recording while they are drawn; `offsets` `(frames,)`: the x at which each
    frame begins.
    """

    tape: Tape
    instants: Instants
    graphs: Sequence[DrawnGraph | None]
    axes: Axes
    offsets: FloatArray
    window: str

    def draw_axes(self) -> None:
        tape, axes, offsets = self.tape, self.axes, self.offsets
        (x0, x1), (y0, y1) = axes.x, axes.y
        kx, ky = axes.scale
        border = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
        line, thin = pixels(1.0), pixels(0.5)
        tape.static(
            f"{axes.entity}/border",
            rr.LineStrips2D([border], colors=colours.AXIS, radii=line, draw_order=-9.0),
        )
        marks = ticks(y0, y1, MOST_TICKS)
        rows = np.array([[[x0, mark], [x1, mark]] for mark in marks])
        tape.static(
            f"{axes.entity}/rows",
            rr.LineStrips2D(rows, colors=colours.GRID, radii=thin, draw_order=-4.5),
        )
        half = [0.5 * LETTER * len(words) for words in (axes.kind.y_title, axes.kind.x_title)]
        left = x0 + (half[0] - MARGIN_LEFT + 2.0) / kx
        right = x1 - (half[1] - MARGIN_RIGHT + 2.0) / kx
        ends = np.array([[left, y1 + 7.5 / ky], [right, y0 - 6.8 / ky]])
        beside = np.c_[np.full(len(marks), x0 - 6.0 / kx), marks + 2.2 / ky]
        for entity, positions, words in (
            ("y_ticks", beside, [f"{mark:g}" for mark in marks]),
            ("titles", ends, [axes.kind.y_title, axes.kind.x_title]),
        ):
            labels = rr.Points2D.from_fields(positions=positions, labels=words)
            tape.static(f"{axes.entity}/{entity}", _label_style(colours.TICK), labels)

        begins = offsets if axes.kind.scrolls else np.zeros(1)
        per_frame = [ticks(x0 + offset, x1 + offset, MOST_TICKS) for offset in begins]
        x, counts = np.concatenate(per_frame), [len(columns) for columns in per_frame]
        lines = np.stack([np.c_[x, np.full(len(x), y0)], np.c_[x, np.full(len(x), y1)]], axis=1)
        when = (
            self.instants
            if axes.kind.scrolls
            else Instants(self.instants.t[:1], self.instants.frame[:1])
        )
        entity = f"{self.window}/columns"
        style = dict[str, Any](colors=[colours.GRID], radii=[thin], draw_order=-4.5)
        tape.lines(entity, when, lines.reshape(-1, 2), np.full(len(x), 2), counts, **style)
        entity = f"{self.window}/x_ticks"
        tape.static(entity, _label_style(colours.TICK))
        below = np.c_[x, np.full(len(x), y0 - 1.0 / ky)]
        shown = rr.Points2D.columns(positions=below, labels=[f"{mark:g}" for mark in x])
        tape.rows(entity, when, shown, counts)

    def draw_solutions(self) -> None:
        for name, colour, width, order in (
            ("dp", colours.DP, 1.5, 3.0),
            ("qp", colours.QP, 2.2, 4.0),
        ):
            points, lengths = joined(
                [getattr(graph, name) if graph else NO_POINTS for graph in self.graphs], 2
            )
            drawn, counts = (
                [length for length in lengths if length],
                [int(length > 0) for length in lengths],
            )
            style = dict[str, Any](colors=[colour], radii=[pixels(width)], draw_order=order)
            self.tape.lines(f"{self.window}/{name}", self.instants, points, drawn, counts, **style)
        points, counts = joined([graph.knots if graph else NO_POINTS for graph in self.graphs], 2)
        dots = rr.Points2D.from_fields(colors=[colours.DP], radii=[pixels(3.5)], draw_order=3.0)
        self.tape.static(f"{self.window}/dp_nodes", dots)
        self.tape.rows(
            f"{self.window}/dp_nodes", self.instants, rr.Points2D.columns(positions=points), counts
        )

    def draw_corridor(self) -> None:
        """Both bounds as lines and the space between them as a light fill.

        Infinite bounds lie on the border.
        """
        lines: list[FloatArray] = []
        owner: list[int] = []
        for i, graph in enumerate(self.graphs):
            if graph is None or graph.corridor is None:
                continue
            x = graph.corridor.first
            low, high = (
                np.clip(bound, *self.axes.y)
                for bound in (graph.corridor.lower, graph.corridor.upper)
            )
            inside = (x - self.offsets[i] <= self.axes.x[1] + 1e-9) & (low == low) & (high == high)
            lines += [np.column_stack([x[inside], bound[inside]]) for bound in (low, high)]
            owner.append(i)
        counts = 2 * np.bincount(np.array(owner, dtype=np.int64), minlength=len(self.graphs))
        points, lengths = joined(lines, 2)
        entity = f"{self.window}/corridor"
        style = dict[str, Any](colors=[colours.FREE], radii=[pixels(1.2)], draw_order=1.0)
        self.tape.lines(entity, self.instants, points, lengths, counts, **style)
        rings = [np.vstack([lines[k], lines[k + 1][::-1]]) for k in range(0, len(lines), 2)]
        filled, ring = self._fill(rings, self.offsets[owner], 2.0 * STROKE)
        light = np.full(len(filled), colours.with_alpha(colours.FREE, 14), dtype=np.uint32)
        self._draw_fill(
            f"{entity}/room", filled, np.array(owner, dtype=np.int64)[ring], light, wide=2.0
        )

    def draw_grid(self) -> None:
        """The reached and visible nodes, coloured by relative cost, 0 to 1.

        The relative cost is c / (c + median), where c is the cost above that of the cheapest node
        of the same column: a ranking of alternatives, which a few huge costs do not flatten.
        """
        axes = self.axes
        nodes, costs = [NO_POINTS] * len(self.graphs), [np.empty(0)]
        for k, (graph, offset) in enumerate(zip(self.graphs, self.offsets, strict=True)):
            if graph is None or graph.grid is None:
                continue
            stride = max(1, ceil(len(graph.grid.second) / MAX_ROWS))
            first, second, cost = (
                graph.grid.first,
                graph.grid.second[::stride],
                graph.grid.cost[:, ::stride],
            )
            shown = np.isfinite(cost) & (second >= axes.y[0]) & (second <= axes.y[1])
            shown &= (first - offset <= axes.x[1] + 1e-6)[:, None]
            least = np.min(np.where(shown, cost, np.inf), axis=1, keepdims=True, initial=np.inf)
            above = np.where(shown, cost, 0.0) - np.where(np.isfinite(least), least, 0.0)
            i, j = np.nonzero(shown)
            dear = above[i, j]
            middle = float(np.median(dear[dear > 0.0])) if (dear > 0.0).any() else 1.0
            nodes[k] = np.column_stack([first[i], second[j]])
            costs.append(dear / (dear + middle))
        points, counts = joined(nodes, 2)
        colour = colours.of_cost(np.concatenate(costs))
        entity = f"{self.window}/grid"
        self.tape.static(entity, rr.Points2D.from_fields(radii=[pixels(2.0)], draw_order=0.0))
        self.tape.rows(
            entity, self.instants, rr.Points2D.columns(positions=points, colors=colour), counts
        )

    def draw_obstacles(self) -> None:
        """Obstacles filled and outlined in the colour of the decision, labelled with agent and
        decision.
        """
        shown = list[tuple[int, DrawnObstacle]]()
        for i, graph in enumerate(self.graphs):
            shown += [(i, obstacle) for obstacle in graph.obstacles] if graph else []
        frame = np.array([i for i, _ in shown], dtype=np.int64)
        outlines = [obstacle.outline for _, obstacle in shown]
        colour = np.array(
            [colours.DECISIONS[obstacle.of.decision] for _, obstacle in shown], dtype=np.uint32
        )
        filled, owner = self._fill(outlines, self.offsets[frame], STROKE)
        entity = f"{self.window}/obstacles"
        self._draw_fill(f"{entity}/fill", filled, frame[owner], colours.darker(colour)[owner])

        relative = [
            outline - [offset, 0.0]
            for outline, offset in zip(outlines, self.offsets[frame], strict=True)
        ]
        points, lengths = joined(relative, 2)
        edges, edge_owner = outline_segments(
            points, np.array(lengths, dtype=np.int64), self.axes.window
        )
        edges[:, :, 0] += self.offsets[frame][edge_owner][:, None]
        counts = np.bincount(frame[edge_owner], minlength=len(self.graphs))
        pairs = np.full(len(edges), 2)
        style, shades = dict[str, Any](radii=[pixels(1.2)], draw_order=-4.0), colour[edge_owner]
        self.tape.lines(entity, self.instants, edges.reshape(-1, 2), pairs, counts, shades, **style)
        self._draw_labels(shown, filled, owner)

    def _draw_labels(
        self, shown: Sequence[tuple[int, DrawnObstacle]], filled: FloatArray, owner: IntArray
    ) -> None:
        """Label each visible obstacle, ignored ones only as `FEW_LABELS` allows.

        Overlapping labels are moved apart.
        """
        begins = np.searchsorted(owner, np.arange(len(shown) + 1))
        rows: list[list[_Label]] = [[] for _ in range(len(self.instants))]
        for (i, obstacle), (begin, end) in zip(shown, pairwise(begins), strict=True):
            if end > begin:
                words = plain(f"{self.tape.short(obstacle.of.agent)}: {obstacle.of.decision.value}")
                offset = np.array([self.offsets[i], 0.0])
                position = label_position(filled[begin:end] - offset, len(words), self.axes)
                shade = colours.of_words(colours.DECISIONS[obstacle.of.decision])
                rows[i].append(_Label(position + offset, words, shade))
        ignored = colours.DECISIONS[DecisionKind.IGNORE]
        labels, placed = list[_Label](), []
        for row in rows:
            if len(row) > FEW_LABELS:
                row = [label for label in row if label.shade != ignored]
            row = row[:MAX_LABELS]
            positions = np.array([label.position for label in row]).reshape(-1, 2)
            placed.append(spread_labels(positions, [len(label.words) for label in row], self.axes))
            labels += row
        points, counts = joined(placed, 2)
        entity = f"{self.window}/labels"
        self.tape.static(entity, _label_style(None))
        colour = np.array([label.shade for label in labels], dtype=np.uint32)
        columns = rr.Points2D.columns(
            positions=points, labels=[label.words for label in labels], colors=colour
        )
        self.tape.rows(entity, self.instants, columns, counts)

    def _fill(
        self, outlines: Sequence[FloatArray], offsets: FloatArray, spacing: float
    ) -> tuple[FloatArray, IntArray]:
        """Strokes `(k, 2, 2)` that fill outlines in the units of the graph, and the outline of
        each.
        """
        relative = [
            outline - [offset, 0.0] for outline, offset in zip(outlines, offsets, strict=True)
        ]
        points, lengths = joined(relative, 2)
        step = spacing / self.axes.scale[0]
        filled, owner = strokes(points, np.array(lengths, dtype=np.int64), self.axes.window, step)
        filled[:, :, 0] += np.asarray(offsets)[owner][:, None]
        return filled, owner

    def _draw_fill(
        self,
        entity: str,
        filled: FloatArray,
        frame: IntArray,
        colour: colours.PackedArray,
        *,
        wide: float = 1.0,
    ) -> None:
        """Draw strokes `(k, 2, 2)`, each in its colour, 1.5 times as wide as their distance, so
        that no gaps show.
        """
        counts, pairs = np.bincount(frame, minlength=len(self.instants)), np.full(len(filled), 2)
        style = dict[str, Any](radii=[0.75 * wide * STROKE], draw_order=-5.0)
        self.tape.lines(
            entity, self.instants, filled.reshape(-1, 2), pairs, counts, colour, **style
        )


def draw_occupancy(
    tape: Tape, instants: Instants, outlines: Sequence[Sequence[FloatArray]], axes: Axes
) -> None:
    """Draw the outlines of the agents in the S-T graphs as they really drove; `outlines` has a list
    per frame.
    """
    frame = np.repeat(np.arange(len(outlines)), [len(of_frame) for of_frame in outlines])
    points, lengths = joined(list(chain.from_iterable(outlines)), 2)
    edges, owner = outline_segments(points, np.array(lengths, dtype=np.int64), axes.window)
    entity = f"{axes.entity}/window/happened"
    counts, pairs = np.bincount(frame[owner], minlength=len(outlines)), np.full(len(edges), 2)
    style = dict[str, Any](colors=[colours.HAPPENED], radii=[pixels(0.9)], draw_order=2.0)
    tape.lines(entity, instants, edges.reshape(-1, 2), pairs, counts, **style)


def _label_style(colour: int | None) -> rr.Points2D:
    return rr.Points2D.from_fields(
        colors=None if colour is None else [colour],
        radii=[pixels(0.01)],
        show_labels=True,
        draw_order=30.0,
    )


def label_position(strokes: FloatArray, letters: int, axes: Axes) -> FloatArray:
    """The position of a label that does not cover its obstacle: above its left end, otherwise below
    it.

    `strokes`: visible part `(k, 2, 2)` of the obstacle, from left to right, x relative to the begin
    of the graph.
    """
    kx, ky = axes.scale
    half, tall = 0.5 * LETTER * letters / kx, LABEL_GAP / ky
    covered = strokes[strokes[:, 0, 0] <= strokes[0, 0, 0] + 2.0 * half]
    x = min(float(strokes[0, 0, 0]) + half, axes.x[1] - half)
    over, under = float(covered[:, 1, 1].max()) + tall, float(covered[:, 0, 1].min()) - 0.2 * tall
    if over > axes.y[1] and under - tall < axes.y[0]:  # it fills the graph
        return np.array([x, axes.y[1]])
    return np.array([x, over if over <= axes.y[1] else under])


def spread_labels(points: FloatArray, lengths: Sequence[int], axes: Axes) -> FloatArray:
    """Label positions `(n, 2)` moved up, then down from the top, until no two labels cover each
    other.

    `points`: the preferred positions, in units of the graph. `lengths`: the numbers of characters
    of the labels. `axes`: the axes, which give the scale and the upper border.
    """
    kx, ky = axes.scale
    spread, order = points.copy(), np.argsort(points[:, 1], kind="stable")
    gap, top = LABEL_GAP / ky, axes.y[1] - 1.0 / ky

    def crowd(i: int, j: int) -> bool:
        return bool(
            abs(points[i, 0] - points[j, 0]) * kx < 0.5 * LETTER * (lengths[i] + lengths[j])
        )

    for n, i in enumerate(order):
        below = [j for j in order[:n] if crowd(j, i)]
        spread[i, 1] = max([spread[i, 1], *(spread[j, 1] + gap for j in below)])
    for n, i in reversed(list(enumerate(order))):
        above = [j for j in order[n + 1 :] if crowd(j, i)]
        spread[i, 1] = min([spread[i, 1], top, *(spread[j, 1] - gap for j in above)])
    return spread
