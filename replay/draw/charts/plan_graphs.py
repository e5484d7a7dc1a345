"""S-T and S-L graph of a plan as charts: the corridor, the obstacles and the solutions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.arrays import FloatArray
from logs.names import ShortNames
from logs.plan import Graph, SlGraph, StGraph
from replay.draw.charts.axes import Plane
from replay.draw.charts.canvas import LETTER_PX, Chart, area, legend, polyline, shortened, text
from replay.draw.charts.subject import Subject
from replay.draw.model import DrawnGraph, widened

WIDTH_PX, HEIGHT_PX = 440.0, 250.0
MAX_LABELS = 6
LABEL_PX = 12.0
"""Smallest vertical distance between two labels."""


@dataclass(frozen=True)
class _Kind:
    """The name and the axes of a kind of graph."""

    name: str
    graph: type[Graph]
    title: str
    x_title: str
    y_title: str
    least: float


ST = _Kind("st", StGraph, "S-T graph", "time from the plan [s]", "station along the path [m]", 5.0)
SL = _Kind("sl", SlGraph, "S-L graph", "station of the reference line [m]", "lateral offset [m], left positive", 4.0)


def st_graph(subject: Subject) -> Chart:
    """Station over time: obstacles with their decisions, DP and QP speed, corridor."""
    return _graph(subject, ST)


def sl_graph(subject: Subject) -> Chart:
    """Lateral offset over station: obstacles, DP and QP path, corridor."""
    return _graph(subject, SL)


def _graph(subject: Subject, kind: _Kind) -> Chart:
    frame = subject.frame
    title = f"{kind.title} of the plan at {subject.moment.t if frame is None else frame.t:.1f} s"
    graph = None if frame is None else DrawnGraph.of(frame.plan, kind.graph)
    if graph is None:
        why = f"{subject.drive.planner} reports no internals"
        if frame is None:
            why = "no plan yet at this time"
        elif frame.plan.internals or any(plan.internals for plan in subject.plans):
            why = f"this plan has no {kind.title}"
        elif subject.drive.result.run.internals == "none":
            why = "the internals of the plan were not kept (--set internals=none)"
        body = text(2.0, 13.0, title, "title") + text(WIDTH_PX / 2.0, 44.0, why, "says")
        return Chart(kind.name, title, f"{title}: {why}", WIDTH_PX, 64.0, body)
    plane, short = _plane(graph, kind), subject.scenario.short_names
    inside = ""
    if graph.corridor is not None:
        margin = 0.1 * (plane.y[1] - plane.y[0])  # edges out there are clipped
        bounds = plane.y[0] - margin, plane.y[1] + margin
        low, high = (np.clip(bound, *bounds) for bound in (graph.corridor.lower, graph.corridor.upper))
        x = plane.at_x(np.r_[graph.corridor.first, graph.corridor.first[::-1]])
        inside += area(x, plane.at_y(np.r_[low, high[::-1]]), "room")
    for some in graph.obstacles:
        if len(some.outline) > 2:
            x, y = plane.at_x(some.outline[:, 0]), plane.at_y(some.outline[:, 1])
            inside += area(x, y, "ignored" if some.is_ignored else "thing")
    for line, name in ((graph.dp, "dp"), (graph.qp, "qp")):
        inside += polyline(plane.at_x(line[:, 0]), plane.at_y(line[:, 1]), name) if len(line) else ""
    drawn = plane.drawn(inside, x_title=kind.x_title, over=_labels(plane, graph, short))
    entries = (
        (len(graph.qp), ("line", "qp", "QP")), (len(graph.dp), ("line", "dp", "DP")),
        (graph.corridor, ("area", "room", "corridor")), (graph.obstacles, ("area", "thing", "obstacle")),
    )  # fmt: skip
    head = text(2.0, 13.0, title, "title") + text(2.0, 27.0, kind.y_title, "tick")
    head += legend(178.0, 27.0, [entry for shown, entry in entries if shown], WIDTH_PX - 190.0)
    named = ", ".join(f"{some.of.agent}: {some.of.decision.value}" for some in graph.obstacles)
    says = f"{title}: {short(named) or 'no agent in the way'}"
    return Chart(kind.name, title, says, WIDTH_PX, HEIGHT_PX, drawn + head)


def _plane(graph: DrawnGraph, kind: _Kind) -> Plane:
    """A plot area with all solutions and the near ends of obstacles; it may cut off far bounds of the corridor."""
    outlines = [some.outline for some in graph.obstacles]
    points = np.vstack([graph.qp, graph.dp])
    if not len(points):
        points = np.vstack([np.zeros((1, 2)), *outlines])
    x = float(points[:, 0].min()), max(float(points[:, 0].max()), float(points[:, 0].min()) + 1.0)
    low, high = float(points[:, 1].min()), float(points[:, 1].max())
    seen = [o[(o[:, 0] >= x[0]) & (o[:, 0] <= x[1]), 1] for o in outlines]
    bounds: list[FloatArray] = [o for o in seen if len(o)]
    if kind is SL:
        if graph.corridor is not None:
            inside = (graph.corridor.first >= x[0]) & (graph.corridor.first <= x[1])
            sides = (side[inside & np.isfinite(side)] for side in (graph.corridor.lower, graph.corridor.upper))
            bounds += [side for side in sides if len(side)]
        low = max(min([low, *(float(some.min()) for some in bounds)]), low - 6.0)
        high = min(max([high, *(float(some.max()) for some in bounds)]), high + 6.0)
        return Plane(x, widened(low, high, kind.least), WIDTH_PX, HEIGHT_PX)
    near = [float(some.min()) for some in bounds]
    top = max(high, min(max([high, *(end + 6.0 for end in near)]), 1.6 * high + 10.0), kind.least)
    return Plane(x, (min(low, 0.0), 1.05 * top), WIDTH_PX, HEIGHT_PX)


def _labels(plane: Plane, graph: DrawnGraph, short: ShortNames) -> str:
    """Labels with agent and decision at the visible part of each outline, ignored agents last; overlaps move down."""
    wide, high = plane.inner
    out, taken = [], list[float]()
    for some in sorted(graph.obstacles, key=lambda one: one.is_ignored)[:MAX_LABELS]:
        outline = some.outline
        x, y = np.clip(plane.at_x(outline[:, 0]), 0.0, wide), np.clip(plane.at_y(outline[:, 1]), 0.0, high)
        seen = (outline[:, 0] >= plane.x[0]) & (outline[:, 0] <= plane.x[1])
        if not seen.any() or y[seen].min() >= high or y[seen].max() <= 0.0:
            continue
        words = shortened(f"{short(some.of.agent)}: {some.of.decision.value}", wide)
        at_y = 0.5 * (float(y[seen].min()) + float(y[seen].max())) + 4.0
        while any(abs(at_y - other) < LABEL_PX for other in taken):
            at_y += LABEL_PX
        taken.append(at_y)
        half = 0.5 * LETTER_PX * len(words)
        at_x = min(max(0.5 * (float(x[seen].min()) + float(x[seen].max())), half + 2.0), wide - half)
        out.append(text(at_x, min(max(at_y, 11.0), high - 3.0), words, "name mid"))
    return "".join(out)
