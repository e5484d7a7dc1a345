"""S-T and S-L graph of a plan: what its stages searched, what stood in the way, what was found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.kernel import FloatArray
from logs.short_names import ShortNames
from logs.trace import DecisionKind, Graph, GraphObstacle, SlGraph, StGraph
from replay.draw.charts.axes import Plane, spread
from replay.draw.charts.canvas import LETTER_PX, Chart, area, legend, polyline, shortened, text
from replay.draw.charts.subject import Subject

WIDTH_PX, HEIGHT_PX = 440.0, 250.0
MAX_LABELS = 6
LABEL_PX = 12.0
"""Labels are not nearer to each other than this."""


@dataclass(frozen=True)
class _Kind:
    """How a kind of graph is called and which axes it has."""

    name: str
    graph: type[Graph]
    title: str
    x_title: str
    y_title: str
    least: float


ST = _Kind("st", StGraph, "S-T graph", "time from the plan [s]", "station along the path [m]", 5.0)
SL = _Kind("sl", SlGraph, "S-L graph", "station of the reference line [m]", "lateral offset [m], left positive", 4.0)
_NONE_KEPT = "the plan's inside was not kept (--set internals=none)"
_NO_GRAPH = "this plan has no {title}"
_NO_PLAN = "no plan yet at this time"


def st_graph(subject: Subject) -> Chart:
    """Station over time: obstacles with what was decided about them, DP and QP speed, corridor."""
    return _graph(subject, ST)


def sl_graph(subject: Subject) -> Chart:
    """Lateral offset over station: obstacles, DP and QP path, corridor."""
    return _graph(subject, SL)


def _graph(subject: Subject, kind: _Kind) -> Chart:
    frame = subject.frame
    when = f"{frame.t:.1f} s" if frame is not None else f"{subject.moment.t:.1f} s"
    title = f"{kind.title} of the plan at {when}"
    inside = () if frame is None else frame.plan.internals
    graph = next((some for some in inside if isinstance(some, kind.graph)), None)
    if graph is None:
        why = _NO_PLAN if frame is None else _NO_GRAPH.format(title=kind.title) if inside else _absent(subject, kind)
        body = text(2.0, 13.0, title, "title") + text(WIDTH_PX / 2.0, 44.0, why, "says")
        return Chart(kind.name, title, f"{title}: {why}", WIDTH_PX, 64.0, body)
    plane, short = _plane(graph, kind), subject.scenario.short_names
    drawn = plane.drawn(
        _corridor(plane, graph) + _obstacles(plane, graph) + _lines(plane, graph),
        x_title=kind.x_title, y_title="", over=_labels(plane, graph, short),
    )  # fmt: skip
    head = text(2.0, 13.0, title, "title") + text(2.0, 27.0, kind.y_title, "tick")
    head += legend(178.0, 27.0, _entries(graph), WIDTH_PX - 190.0)
    return Chart(kind.name, title, f"{title}: {short(_said(graph))}", WIDTH_PX, HEIGHT_PX, drawn + head)


def _absent(subject: Subject, kind: _Kind) -> str:
    kept = any(said.internals for said in subject.said)
    return _NO_GRAPH.format(title=kind.title) if kept else _none_kept(subject)


def _none_kept(subject: Subject) -> str:
    asked = subject.drive.result.run.internals
    return _NONE_KEPT if asked == "none" else f"{subject.drive.planner} shows nothing of its inside"


def _said(graph: Graph) -> str:
    found = [f"{some.agent}: {some.decision.value}" for some in graph.obstacles]
    return ", ".join(found) if found else "no agent in the way"


def _entries(graph: Graph) -> list[tuple[str, str, str]]:
    there = [
        (len(_finite(graph.qp)) > 0, ("line", "qp", "QP")),
        (len(_finite(graph.dp)) > 0, ("line", "dp", "DP")),
        (graph.corridor is not None, ("area", "room", "corridor")),
        (bool(graph.obstacles), ("area", "thing", "obstacle")),
    ]
    return [entry for shown, entry in there if shown]


def _finite(points: FloatArray) -> FloatArray:
    shaped = np.asarray(points, np.float64).reshape(-1, 2)
    return shaped[np.isfinite(shaped).all(axis=1)]


def _plane(graph: Graph, kind: _Kind) -> Plane:
    """All of the solutions and the near ends of obstacles; far bounds of the corridor may be cut off."""
    points = np.vstack([_finite(graph.qp), _finite(graph.dp)])
    if not len(points):
        points = np.vstack([np.zeros((1, 2)), *(_finite(some.outline) for some in graph.obstacles)])
    x = float(points[:, 0].min()), max(float(points[:, 0].max()), float(points[:, 0].min()) + 1.0)
    low, high = float(points[:, 1].min()), float(points[:, 1].max())
    seen = [o[(o[:, 0] >= x[0]) & (o[:, 0] <= x[1])] for o in map(_finite, (some.outline for some in graph.obstacles))]
    if kind is SL:
        bounds = [o[:, 1] for o in seen if len(o)] + ([] if graph.corridor is None else _bounds(graph, x))
        low = max(min([low, *(float(some.min()) for some in bounds)]), low - 6.0)
        high = min(max([high, *(float(some.max()) for some in bounds)]), high + 6.0)
        return Plane(x, spread(low, high, kind.least), WIDTH_PX, HEIGHT_PX)
    near = [float(o[:, 1].min()) for o in seen if len(o)]
    top = max(high, min(max([high, *(end + 6.0 for end in near)]), 1.6 * high + 10.0), kind.least)
    return Plane(x, (min(low, 0.0), 1.05 * top), WIDTH_PX, HEIGHT_PX)


def _bounds(graph: Graph, x: tuple[float, float]) -> list[FloatArray]:
    if graph.corridor is None:
        return []
    inside = (graph.corridor.first >= x[0]) & (graph.corridor.first <= x[1])
    found = (bound[inside & np.isfinite(bound)] for bound in (graph.corridor.lower, graph.corridor.upper))
    return [bound for bound in found if len(bound)]


def _corridor(plane: Plane, graph: Graph) -> str:
    corridor = graph.corridor
    if corridor is None or len(corridor.first) < 2:
        return ""
    low, high = (np.clip(bound, *_beyond(plane)) for bound in (corridor.lower, corridor.upper))
    x = plane.at_x(np.r_[corridor.first, corridor.first[::-1]])
    return area(x, plane.at_y(np.r_[low, high[::-1]]), "room")


def _beyond(plane: Plane) -> tuple[float, float]:
    """The y range and a little more: edges that lie there are cut off."""
    margin = 0.1 * (plane.y[1] - plane.y[0])
    return plane.y[0] - margin, plane.y[1] + margin


def _lines(plane: Plane, graph: Graph) -> str:
    return "".join(
        polyline(plane.at_x(line[:, 0]), plane.at_y(line[:, 1]), kind)
        for line, kind in ((_finite(graph.dp), "dp"), (_finite(graph.qp), "qp"))
        if len(line)
    )


def _obstacles(plane: Plane, graph: Graph) -> str:
    return "".join(
        area(plane.at_x(outline[:, 0]), plane.at_y(outline[:, 1]), "ignored" if _ignored(some) else "thing")
        for some in graph.obstacles
        if len(outline := _finite(some.outline)) > 2
    )


def _ignored(some: GraphObstacle) -> bool:
    return some.decision is DecisionKind.IGNORE


def _labels(plane: Plane, graph: Graph, short: ShortNames) -> str:
    """Agent and decision at the visible part of each outline, the decided ones first, moved down where they crowd."""
    wide, high = plane.inner
    out, taken = [], list[float]()
    for some in sorted(graph.obstacles, key=_ignored)[:MAX_LABELS]:
        outline = _finite(some.outline)
        x, y = np.clip(plane.at_x(outline[:, 0]), 0.0, wide), np.clip(plane.at_y(outline[:, 1]), 0.0, high)
        seen = (outline[:, 0] >= plane.x[0]) & (outline[:, 0] <= plane.x[1])
        if not seen.any() or y[seen].min() >= high or y[seen].max() <= 0.0:
            continue
        words = shortened(f"{short(some.agent)}: {some.decision.value}", wide)
        at_y = 0.5 * (float(y[seen].min()) + float(y[seen].max())) + 4.0
        while any(abs(at_y - other) < LABEL_PX for other in taken):
            at_y += LABEL_PX
        taken.append(at_y)
        half = 0.5 * LETTER_PX * len(words)
        at_x = min(max(0.5 * (float(x[seen].min()) + float(x[seen].max())), half + 2.0), wide - half)
        out.append(text(at_x, min(max(at_y, 11.0), high - 3.0), words, "name mid"))
    return "".join(out)
