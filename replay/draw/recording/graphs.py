"""S-T and S-L graphs: what a stage searched and what it found, frame by frame.

The viewer has no x-y plot, but it has 2D views: the data stay in their units (s, m), and a transform above them scales
an axis range to a plot area of `WIDTH` x `HEIGHT` view units with y up. The determinant of that scale is kept at 1 in
size, so that line widths in view units are not scaled. All recordings share one plot area; the axes differ.

The S-L graph scrolls: its stations are those of the reference line, and the window begins where the graph begins.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np
import rerun as rr

from logs.kernel import FloatArray, IntArray
from logs.trace import DecisionKind, Graph, GraphObstacle, GridCost
from replay.draw.recording import colours
from replay.draw.recording.axes import LABEL_GAP, LETTER, Axes, begin, finite, nice_step, spread, ticks
from replay.draw.recording.columns import Instants, Tape, joined, pixels, strips
from replay.draw.recording.hatch import outline_segments, strokes
from replay.draw.recording.text import plain

STROKE = 0.8
"""Distance of the strokes that fill an obstacle, view units."""
MAX_LABELS = 8
FEW_LABELS = 3
"""Ignored obstacles are labelled in frames with at most so many obstacles."""
MAX_ROWS = 40
"""A grid with more rows than this is thinned for drawing."""


def draw_graph(tape: Tape, instants: Instants, graphs: Sequence[Graph | None], axes: Axes) -> None:
    """All that a kind of graph shows, one row per frame; a frame without it shows empty axes."""
    kx, ky = axes.scale
    scale = rr.Transform3D(translation=[-kx * axes.x[0], ky * axes.y[0], 0.0], scale=[kx, -ky, 1.0 / (kx * ky)])
    tape.static(axes.entity, scale)
    offsets = np.zeros(len(graphs))
    for i, graph in enumerate(graphs):
        offsets[i] = (begin(graph) if graph else offsets[max(i - 1, 0)]) if axes.scrolls else 0.0
    window = f"{axes.entity}/window"
    tape.rows(window, instants, rr.Transform3D.columns(translation=np.c_[-offsets, np.zeros((len(offsets), 2))]))
    _draw_axes(tape, instants, axes, offsets)
    _draw_lines(tape, instants, graphs, window)
    _draw_corridor(tape, instants, graphs, axes, offsets)
    _draw_grid(tape, instants, graphs, axes, offsets)
    _draw_obstacles(tape, instants, graphs, axes, offsets)


def _draw_axes(tape: Tape, instants: Instants, axes: Axes, offsets: FloatArray) -> None:
    (x0, x1), (y0, y1) = axes.x, axes.y
    kx, ky = axes.scale
    border = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
    line, thin = pixels(1.0), pixels(0.5)
    tape.static(f"{axes.entity}/border", rr.LineStrips2D([border], colors=colours.AXIS, radii=line, draw_order=-9.0))
    marks = ticks(y0, y1, nice_step(y1 - y0, 10))
    rows = np.array([[[x0, mark], [x1, mark]] for mark in marks])
    tape.static(f"{axes.entity}/rows", rr.LineStrips2D(rows, colors=colours.GRID, radii=thin, draw_order=-4.5))
    at = np.c_[np.full(len(marks), x0 - 6.0 / kx), marks + 2.2 / ky]
    _label(tape, f"{axes.entity}/y_ticks", at, [f"{mark:g}" for mark in marks])
    titles = np.array([[x0 - 6.0 / kx, y1 + 7.5 / ky], [x1 - 2.0 / kx, y0 - 6.8 / ky]])
    _label(tape, f"{axes.entity}/titles", titles, [axes.y_title, axes.x_title])

    step = nice_step(x1 - x0, 10)
    per_frame = [ticks(x0 + offset, x1 + offset, step) for offset in offsets] if axes.scrolls else [ticks(x0, x1, step)]
    x, counts = np.concatenate(per_frame), [len(marks) for marks in per_frame]
    ends = np.stack([np.c_[x, np.full(len(x), y0)], np.c_[x, np.full(len(x), y1)]], axis=1)
    when = instants if axes.scrolls else Instants(instants.t[:1], instants.frame[:1])
    entity = f"{axes.entity}/window/columns"
    tape.static(entity, rr.LineStrips2D.from_fields(colors=[colours.GRID], radii=[thin], draw_order=-4.5))
    lines = strips(ends.reshape(-1, 2), np.full(len(x), 2))
    tape.rows(entity, when, rr.LineStrips2D.columns(strips=lines), counts)
    entity = f"{axes.entity}/window/x_ticks"
    tape.static(entity, _label_style(colours.TICK))
    below = np.c_[x, np.full(len(x), y0 - 1.0 / ky)]
    shown = rr.Points2D.columns(positions=below, labels=[f"{mark:g}" for mark in x])
    tape.rows(entity, when, shown, counts)


def _label_style(colour: int | None) -> rr.Points2D:
    return rr.Points2D.from_fields(
        colors=None if colour is None else [colour],
        radii=[pixels(0.01)],
        show_labels=True,
        draw_order=30.0,
    )


def _label(tape: Tape, entity: str, at: FloatArray, words: Sequence[str]) -> None:
    tape.static(entity, _label_style(colours.TICK), rr.Points2D.from_fields(positions=at, labels=list(words)))


def _draw_lines(tape: Tape, instants: Instants, graphs: Sequence[Graph | None], window: str) -> None:
    for name, colour, width, order in (("dp", colours.DP, 1.5, 3.0), ("qp", colours.QP, 2.2, 4.0)):
        lines = [finite(getattr(graph, name)) if graph else np.empty((0, 2)) for graph in graphs]
        points, lengths = joined(lines, 2)
        drawn = [length for length in lengths if length]
        counts = [int(length > 0) for length in lengths]
        radius = pixels(width)
        tape.static(f"{window}/{name}", rr.LineStrips2D.from_fields(colors=[colour], radii=[radius], draw_order=order))
        tape.rows(f"{window}/{name}", instants, rr.LineStrips2D.columns(strips=strips(points, drawn)), counts)
    points, counts = joined([_passed(graph) if graph else np.empty((0, 2)) for graph in graphs], 2)
    style = rr.Points2D.from_fields(colors=[colours.DP], radii=[pixels(3.5)], draw_order=3.0)
    tape.static(f"{window}/dp_nodes", style)
    tape.rows(f"{window}/dp_nodes", instants, rr.Points2D.columns(positions=points), counts)


def _passed(graph: Graph) -> FloatArray:
    """Where the DP solution passes the columns of its grid `(n, 2)`."""
    line = finite(graph.dp)
    if graph.grid is None or not len(line):
        return np.empty((0, 2))
    x = graph.grid.first[(graph.grid.first >= line[0, 0]) & (graph.grid.first <= line[-1, 0])]
    return np.column_stack([x, np.interp(x, line[:, 0], line[:, 1])])


def _draw_corridor(
    tape: Tape, instants: Instants, graphs: Sequence[Graph | None], axes: Axes, offsets: FloatArray
) -> None:
    """Both bounds as lines and the room between them as a light fill; infinite bounds lie on the border."""
    lines: list[FloatArray] = []
    owner: list[int] = []
    for i, graph in enumerate(graphs):
        if graph is None or graph.corridor is None or len(graph.corridor.first) < 2:
            continue
        corridor = graph.corridor
        bounds = [np.clip(bound, *axes.y) for bound in (corridor.lower, corridor.upper)]
        inside = (corridor.first - offsets[i] <= axes.x[1] + 1e-9) & (bounds[0] == bounds[0]) & (bounds[1] == bounds[1])
        lines += [np.column_stack([corridor.first[inside], bound[inside]]) for bound in bounds]
        owner.append(i)
    counts = 2 * np.bincount(np.array(owner, dtype=np.int64), minlength=len(graphs))
    points, lengths = joined(lines, 2)
    entity = f"{axes.entity}/window/corridor"
    style = rr.LineStrips2D.from_fields(colors=[colours.FREE], radii=[pixels(1.2)], draw_order=1.0)
    tape.static(entity, style)
    tape.rows(entity, instants, rr.LineStrips2D.columns(strips=strips(points, lengths)), counts)
    rings = [np.vstack([lines[k], lines[k + 1][::-1]]) for k in range(0, len(lines), 2)]
    filled, ring = _fill(rings, offsets[owner], axes, 2.0 * STROKE)
    frame = np.array(owner, dtype=np.int64)[ring]
    light = np.full(len(filled), colours.with_alpha(colours.FREE, 14), dtype=np.uint32)
    _draw_fill(tape, f"{entity}/room", instants, filled, frame, light, wide=2.0)


def _fill(
    outlines: Sequence[FloatArray], offsets: FloatArray, axes: Axes, spacing: float
) -> tuple[FloatArray, IntArray]:
    """Strokes `(k, 2, 2)` that fill outlines in the units of the graph, and the outline of each."""
    points, lengths = joined([outline - [offset, 0.0] for outline, offset in zip(outlines, offsets, strict=True)], 2)
    filled, owner = strokes(points, np.array(lengths, dtype=np.int64), axes.window, spacing / axes.scale[0])
    filled[:, :, 0] += np.asarray(offsets)[owner][:, None]
    return filled, owner


def _draw_fill(
    tape: Tape,
    entity: str,
    instants: Instants,
    filled: FloatArray,
    frame: IntArray,
    colour: colours.PackedArray,
    *,
    wide: float = 1.0,
) -> None:
    """Strokes `(k, 2, 2)` in a colour each, half as wide again as their distance: their soft edges leave no gaps."""
    style = rr.LineStrips2D.from_fields(radii=[0.75 * wide * STROKE], draw_order=-5.0)
    tape.static(entity, style)
    lines = strips(filled.reshape(-1, 2), np.full(len(filled), 2))
    shown = rr.LineStrips2D.columns(strips=lines, colors=colour)
    tape.rows(entity, instants, shown, np.bincount(frame, minlength=len(instants)))


def _grid_nodes(grid: GridCost, axes: Axes, offset: float) -> tuple[FloatArray, FloatArray]:
    """The reached and visible nodes `(n, 2)` of a grid and how dear each is, 0 to 1.

    Dearness is the cost above the cheapest node of the same column, c / (c + median): a rank of alternatives, which
    a few huge costs do not flatten. Nodes that were not reached are not drawn.
    """
    stride = max(1, ceil(len(grid.second) / MAX_ROWS))
    second, cost = grid.second[::stride], grid.cost[:, ::stride]
    shown = np.isfinite(cost) & (second >= axes.y[0]) & (second <= axes.y[1])
    shown &= (grid.first - offset <= axes.x[1] + 1e-6)[:, None]
    least = np.min(np.where(shown, cost, np.inf), axis=1, keepdims=True, initial=np.inf)
    above = np.where(shown, cost, 0.0) - np.where(np.isfinite(least), least, 0.0)
    i, j = np.nonzero(shown)
    dear = above[i, j]
    middle = float(np.median(dear[dear > 0.0])) if (dear > 0.0).any() else 1.0
    return np.column_stack([grid.first[i], second[j]]), dear / (dear + middle)


def _draw_grid(tape: Tape, instants: Instants, graphs: Sequence[Graph | None], axes: Axes, offsets: FloatArray) -> None:
    nodes = [
        _grid_nodes(graph.grid, axes, offset) if graph and graph.grid else (np.empty((0, 2)), np.empty(0))
        for graph, offset in zip(graphs, offsets, strict=True)
    ]
    points, counts = joined([node[0] for node in nodes], 2)
    colour = colours.of_cost(np.concatenate([np.empty(0), *(node[1] for node in nodes)]))
    entity = f"{axes.entity}/window/grid"
    tape.static(entity, rr.Points2D.from_fields(radii=[pixels(2.0)], draw_order=0.0))
    tape.rows(entity, instants, rr.Points2D.columns(positions=points, colors=colour), counts)


def _draw_obstacles(
    tape: Tape, instants: Instants, graphs: Sequence[Graph | None], axes: Axes, offsets: FloatArray
) -> None:
    """Obstacles filled and outlined in the colour of the decision, labelled with agent and decision."""
    shown = [
        (i, obstacle, outline)
        for i, graph in enumerate(graphs)
        for obstacle in (graph.obstacles if graph else ())
        if len(outline := finite(obstacle.outline))
    ]
    frame = np.array([i for i, _, _ in shown], dtype=np.int64)
    outlines = [outline for _, _, outline in shown]
    colour = np.array([colours.DECISIONS[obstacle.decision] for _, obstacle, _ in shown], dtype=np.uint32)
    filled, owner = _fill(outlines, offsets[frame], axes, STROKE)
    entity = f"{axes.entity}/window/obstacles"
    _draw_fill(tape, f"{entity}/fill", instants, filled, frame[owner], colours.darker(colour)[owner])

    relative = [outline - [offset, 0.0] for outline, offset in zip(outlines, offsets[frame], strict=True)]
    points, lengths = joined(relative, 2)
    edges, edge_owner = outline_segments(points, np.array(lengths, dtype=np.int64), axes.window)
    edges[:, :, 0] += offsets[frame][edge_owner][:, None]
    lines = strips(edges.reshape(-1, 2), np.full(len(edges), 2))
    tape.static(entity, rr.LineStrips2D.from_fields(radii=[pixels(1.2)], draw_order=-4.0))
    drawn = rr.LineStrips2D.columns(strips=lines, colors=colour[edge_owner])
    tape.rows(entity, instants, drawn, np.bincount(frame[edge_owner], minlength=len(graphs)))
    _draw_labels(tape, instants, axes, offsets, [(i, obstacle) for i, obstacle, _ in shown], filled, owner)


def draw_happened(tape: Tape, instants: Instants, outlines: Sequence[Sequence[FloatArray]], axes: Axes) -> None:
    """Outlines of those in the S-T graphs as they then moved, a list per frame."""
    flat = [outline for some in outlines for outline in some]
    frame = np.repeat(np.arange(len(outlines)), [len(some) for some in outlines])
    points, lengths = joined(flat, 2)
    edges, owner = outline_segments(points, np.array(lengths, dtype=np.int64), axes.window)
    entity = f"{axes.entity}/window/happened"
    tape.static(entity, rr.LineStrips2D.from_fields(colors=[colours.HAPPENED], radii=[pixels(0.9)], draw_order=2.0))
    lines = rr.LineStrips2D.columns(strips=strips(edges.reshape(-1, 2), np.full(len(edges), 2)))
    tape.rows(entity, instants, lines, np.bincount(frame[owner], minlength=len(outlines)))


def _draw_labels(
    tape: Tape,
    instants: Instants,
    axes: Axes,
    offsets: FloatArray,
    shown: Sequence[tuple[int, GraphObstacle]],
    filled: FloatArray,
    owner: IntArray,
) -> None:
    """A label beside each visible obstacle, decided ones first, moved apart where they crowd."""
    begins = np.searchsorted(owner, np.arange(len(shown) + 1))
    rows: list[list[tuple[FloatArray, str, int]]] = [[] for _ in range(len(instants))]
    for k, (i, obstacle) in enumerate(shown):
        if begins[k + 1] > begins[k]:
            words = plain(f"{tape.short(obstacle.agent)}: {obstacle.decision.value}")
            visible = filled[begins[k] : begins[k + 1]] - [offsets[i], 0.0]
            at = beside(visible, len(words), axes) + np.array([offsets[i], 0.0])
            rows[i].append((at, words, colours.of_words(colours.DECISIONS[obstacle.decision])))
    kept = [_worth(row) for row in rows]
    placed = [
        spread(np.array([at for at, _, _ in row]).reshape(-1, 2), [len(words) for _, words, _ in row], axes)
        for row in kept
    ]
    points, counts = joined(placed, 2)
    entity = f"{axes.entity}/window/labels"
    tape.static(entity, _label_style(None))
    flat = [label for row in kept for label in row]
    colour = np.array([label[2] for label in flat], dtype=np.uint32)
    shown_labels = rr.Points2D.columns(positions=points, labels=[label[1] for label in flat], colors=colour)
    tape.rows(entity, instants, shown_labels, counts)


def beside(strokes: FloatArray, letters: int, axes: Axes) -> FloatArray:
    """Where the label of an obstacle goes, so that it hides none of it: over its left end, else under it.

    Args:
        strokes: `(k, 2, 2)` its visible part, from left to right, x from where the graph begins.
        letters: Of the label.
        axes: Of the graph.
    """
    kx, ky = axes.scale
    half, tall = 0.5 * LETTER * letters / kx, LABEL_GAP / ky
    covered = strokes[strokes[:, 0, 0] <= strokes[0, 0, 0] + 2.0 * half]
    x = min(float(strokes[0, 0, 0]) + half, axes.x[1] - half)
    over, under = float(covered[:, 1, 1].max()) + tall, float(covered[:, 0, 1].min()) - 0.2 * tall
    if over > axes.y[1] and under - tall < axes.y[0]:  # it fills the graph
        return np.array([x, axes.y[1]])
    return np.array([x, over if over <= axes.y[1] else under])


def _worth(labels: list[tuple[FloatArray, str, int]]) -> list[tuple[FloatArray, str, int]]:
    """The labels to be drawn in a frame: decided obstacles, and ignored ones where there are few of all."""
    ignored = colours.DECISIONS[DecisionKind.IGNORE]
    decided = [label for label in labels if label[2] != ignored]
    return (labels if len(labels) <= FEW_LABELS else decided)[:MAX_LABELS]
