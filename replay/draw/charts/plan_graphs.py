"""S-T and S-L graph of a plan as charts: the corridor, the obstacles and the solutions."""

from __future__ import annotations

import numpy as np

from logs.names import ShortNames
from replay.draw.charts.axes import Plane
from replay.draw.charts.canvas import LETTER_PX, Chart, shortened, text
from replay.draw.charts.subject import SceneSubject, Subject
from replay.draw.model import SL, ST, DrawnGraph, GraphKind, graph_axes

WIDTH_PX, HEIGHT_PX = 440.0, 250.0
MAX_LABELS = 6
LABEL_PX = 12.0  # Smallest vertical distance between two labels


def st_graph(subject: Subject) -> Chart:
    """Station over time: obstacles with their decisions, DP and QP speed, corridor."""
    return _graph_of(subject, ST)


def sl_graph(subject: Subject) -> Chart:
    """Lateral offset over station: obstacles, DP and QP path, corridor."""
    return _graph_of(subject, SL)


def _graph_of(subject: Subject, kind: GraphKind) -> Chart:
    frame, why = subject.frame, f"{subject.drive.planner} reports no internals"
    if frame is None:
        why = "no plan yet at this time"
    elif frame.plan.internals or any(plan.internals for plan in subject.plans):
        why = f"this plan has no {kind.title}"
    elif subject.drive.result.run.internals == "none":
        why = "the internals of the plan were not kept (--set internals=none)"
    return plan_graph(subject, kind, why)


def plan_graph(subject: SceneSubject, kind: GraphKind, why: str) -> Chart:
    """A graph of the newest plan; `why`: the reason if it has none."""
    frame, short = subject.frame, subject.scenario.short_names
    title = f"{kind.title} of the plan at {subject.moment.t if frame is None else frame.t:.1f} s"
    graph = None if frame is None else DrawnGraph.of(frame.plan, kind)
    if graph is None:
        body = text(2.0, 13.0, title, "title") + text(WIDTH_PX / 2.0, 44.0, why, "says")
        return Chart(kind.name, title, f"{title}: {why}", WIDTH_PX, 64.0, body)
    x, y = graph_axes([graph], kind) or ((0.0, 1.0), (0.0, kind.least))
    plane, inside = Plane((x[0] + graph.begin, x[1] + graph.begin), y, WIDTH_PX, HEIGHT_PX), ""
    if graph.corridor is not None:
        margin = 0.1 * (plane.y[1] - plane.y[0])  # edges out there are clipped
        bounds = plane.y[0] - margin, plane.y[1] + margin
        low, high = (np.clip(bound, *bounds) for bound in (graph.corridor.lower, graph.corridor.upper))
        inside += plane.area(np.r_[graph.corridor.first, graph.corridor.first[::-1]], np.r_[low, high[::-1]], "room")
    for some in graph.obstacles:
        if len(some.outline) > 2:
            inside += plane.area(some.outline[:, 0], some.outline[:, 1], "ignored" if some.is_ignored else "thing")
    inside += "".join(
        plane.line(line[:, 0], line[:, 1], name) for line, name in ((graph.dp, "dp"), (graph.qp, "qp")) if len(line)
    )
    entries = (
        (len(graph.qp), ("line", "qp", "QP")), (len(graph.dp), ("line", "dp", "DP")),
        (graph.corridor, ("area", "room", "corridor")), (graph.obstacles, ("area", "thing", "obstacle")),
    )  # fmt: skip
    named = ", ".join(f"{some.of.agent}: {some.of.decision.value}" for some in graph.obstacles)
    return plane.chart(
        kind.name, title, inside, says=f"{title}: {short(named) or 'no agent in the way'}",
        entries=[entry for shown, entry in entries if shown], over=_labels(plane, graph, short),
        x_title=kind.x_title, y_title=kind.y_title,
    )  # fmt: skip


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
