"""Charts over time, and the graphs of a plan.

Over time: panels of curves, in which the times of failed gates are shaded, and rows of the plan's
status, each road user with a decision, and each broken gate. S-T and S-L graph: the corridor, the
obstacles and the solutions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.names import ShortNames
from replan.draw.charts.axes import LEFT_PX, Plane, rows_plane
from replan.draw.charts.chart import Chart
from replan.draw.charts.legend import legend_words
from replan.draw.charts.style import DRIVES
from replan.draw.charts.subject import SceneSubject, Subject
from replan.draw.charts.svg import LETTER_PX, line, rect, shortened, text
from replan.draw.drawn_scene import decided as plan_decisions
from replan.draw.panels import Panel, compared_panels, panels
from replan.draw.plan_graphs import SL, ST, DrawnGraph, GraphKind, graph_axes
from replan.explain.explanation import STATUS_WORDS
from replan.explain.planner_input import actual_occupancy, true_boxes
from replan.logs.plan import PlanStatus, PlanSummary

WIDTH_PX, HEIGHT_PX = 440.0, 168.0
# Classes of the curves of a panel, in their order: solid, long dashes, dots, thin
KINDS = ("curve1", "curve2", "curve3", "curve4")
LEAST_PX = 3.0
BOLD_PX = 6.8  # Width of a letter of a warning, pixels
NAME_PX = 90.0  # Largest width of a drive's name before a warning, pixels


def curves(subject: Subject) -> list[Chart]:
    """All panels of a drive that have something to show.

    Of several drives, a panel for each of their curves.
    """
    drives = subject.drives
    of_drives = {name: _charted_panels(drive) for name, drive in drives.items()}
    several = len(drives) > 1
    classes = dict(zip(drives, DRIVES, strict=False))
    begins, ends = zip(*(drive.span for drive in drives.values()), strict=True)
    x = min(begins), max(ends)
    charts = []
    for panel in compared_panels(of_drives) if several else of_drives[next(iter(drives))]:
        shaded = [
            span
            for name, drive in drives.items()
            for span in _broken_spans(drive, panel, f"{shortened(name, NAME_PX)}: " * several)
        ]
        kinds = [classes[curve.name] for curve in panel.curves] if several else KINDS
        charts.append(panel_chart(panel, x, shaded, now=subject.moment.t, kinds=kinds))
    return charts


def _charted_panels(drive: Subject) -> list[Panel]:
    # The trace has one plan only
    trace = replace(drive.trace, frames=())
    of_drive = panels(trace, drive.scenario, drive.drive.steps, drive.logged)
    return [panel for panel in of_drive if panel.charted]


def _broken_spans(drive: Subject, panel: Panel, prefix: str) -> Iterator[Span]:
    """The times at which gates about a panel are broken."""
    for violation in drive.violations:
        if panel.about and violation.series.startswith(panel.about):
            word, why = f"\u26a0 {prefix}{violation.series}", f"{prefix}{violation.gate}"
            for begin, end in violation.spans:
                yield Span(begin, end, word, why)


def panel_chart(
    panel: Panel,
    x: tuple[float, float],
    shaded: Sequence[Span] = (),
    *,
    now: float | None = None,
    kinds: Sequence[str] = KINDS,
    shade: str = "broken",
    x_title: str = "time [s]",
    size: tuple[float, float] = (WIDTH_PX, HEIGHT_PX),
) -> Chart:
    """The curves of a panel.

    `panel`: the panel; curves without a class are not drawn. `shaded`: intervals that are shaded,
    each with a word above, and in a tooltip why. `size`: pixels.
    """
    plane = Plane(x, panel.range, *size)
    shown = list(zip(panel.curves, kinds, strict=False))
    wide, high = plane.inner
    inside, words, until = "", "", -np.inf
    for span in sorted(shaded, key=attrgetter("begin", "end", "why")):
        left, right = plane.at_x(np.array([span.begin, span.end])).tolist()
        left = min(max(left, 0.0), wide - LEAST_PX)
        right = max(right, left + LEAST_PX)
        inside += rect(left, 0.0, right - left, high, shade, span.why)
        inside += line(left, 0.0, left, high, "onset") if span.word else ""
        room = BOLD_PX * len(span.word) + 2.0
        word_x = min(left + 2.0, wide - room)
        if word_x > until:
            words += text(word_x, 9.0, span.word, "warning")
            until = word_x + room
    # The first on top
    inside += "".join(plane.line(curve.t, curve.values, kind) for curve, kind in shown[::-1])
    inside += "" if now is None else now_line(plane, now)
    head, largest = panel.title, float(np.abs(panel.values).max())
    if any(curve.spiky for curve in panel.curves) and largest > 1.2 * max(map(abs, panel.range)):
        head += f", up to {largest:.0f} in single steps"
    named = legend_words([curve.legend for curve, _ in shown], size[0] - LEFT_PX)
    entries = [("line", kind, word) for (_, kind), word in zip(shown, named, strict=True)]
    spans = [
        f"{curve.legend} {curve.known.min():.3g} to {curve.known.max():.3g}"
        for curve in panel.curves
    ]
    failed = (
        f"; breaks {', '.join(dict.fromkeys(span.why for span in shaded))}"
        if shade == "broken" and shaded
        else ""
    )
    says = f"{panel.title} over time: {', '.join(spans)}{failed}"
    return plane.chart(
        panel.name,
        panel.title,
        inside,
        head=head,
        says=says,
        entries=entries,
        over=words,
        x_title=x_title,
    )


def now_line(plane: Plane, t: float) -> str:
    """A vertical line at the moment of the subject."""
    x = min(max(float(plane.at_x(t)), 1.0), plane.inner[0] - 1.0)
    return line(x, 0.0, x, plane.inner[1], "reference")


ROWS_PX, ROW_PX, TOP_PX = 900.0, 20.0, 22.0
LABEL_PX = 210.0
# Largest number of rows of road users; the list of events beside the picture has all of them
MAX_ROWS = 12
CALM = tuple(STATUS_WORDS[status] for status in (PlanStatus.PLANNED, PlanStatus.CORRECTED))
"""Statuses that are not drawn as alarms."""


@dataclass(frozen=True)
class Span:
    """A state from one time to another, s."""

    begin: float
    end: float
    word: str
    why: str = ""


@dataclass(frozen=True)
class SpanRow:
    """The spans of one road user, one gate, or the plan."""

    name: str
    spans: tuple[Span, ...]
    kind: str = "decision"

    @property
    def duration_s(self) -> float:
        """The time of all spans together."""
        return sum(span.end - span.begin for span in self.spans)


def decided(plans: Sequence[PlanSummary], end: float, short: Callable[[str], str]) -> list[SpanRow]:
    """The decisions other than "ignore" about each agent, in the order of the first decision.

    A decision holds until the next frame; consecutive frames with the same decision are one span
    with the first reason. `short` shortens the names of agents.
    """
    rows: dict[str, list[Span]] = {}
    for plan, stop in _until(plans, end):
        for agent, decision in plan_decisions(plan).items():
            span = Span(plan.t, stop, decision.kind.value, short(decision.reason))
            _extend(rows.setdefault(agent, []), span)
    return [SpanRow(short(agent), tuple(spans)) for agent, spans in rows.items()]


def statuses(plans: Sequence[PlanSummary], end: float) -> SpanRow:
    """The statuses of the plans."""
    spans: list[Span] = []
    for plan, stop in _until(plans, end):
        _extend(spans, Span(plan.t, stop, STATUS_WORDS[plan.status], plan.reason))
    return SpanRow("plan", tuple(spans), "normal")


def _until(plans: Sequence[PlanSummary], end: float) -> Iterable[tuple[PlanSummary, float]]:
    """Each plan and the time until which it holds."""
    return zip(
        plans,
        [*(plan.t for plan in plans[1:]), max(end, plans[-1].t)] if plans else [],
        strict=True,
    )


def _extend(spans: list[Span], span: Span) -> None:
    """Add a span, or extend the last one if it continues."""
    last = spans[-1] if spans else None
    if last and last.word == span.word and abs(last.end - span.begin) < 1e-6:
        spans[-1] = replace(last, end=span.end)
    else:
        spans.append(span)


def decisions(subject: Subject, width: float = ROWS_PX) -> Chart:
    """Decisions, plan statuses and broken gates as rows over time; `width` in pixels."""
    plans, end = subject.plans, subject.span[1]
    agents = decided(plans, end, subject.scenario.short_names)
    longest = sorted(agents, key=attrgetter("duration_s"), reverse=True)[:MAX_ROWS]
    # Gates of one series (episode and total time, say) are one row
    broken: dict[str, dict[Span, None]] = {}
    for violation in subject.violations:
        for begin, stop in violation.spans:
            span = Span(begin, stop, "fails", violation.gate)
            broken.setdefault(violation.series, {})[span] = None
    rows = [statuses(plans, end)] if plans else []
    rows += [row for row in agents if row in longest]
    rows += [SpanRow(series, tuple(spans), "alarm") for series, spans in broken.items()]
    title = "Decisions, plans and broken gates over time"
    if not rows:
        body = text(2.0, 13.0, title, "title") + text(
            0.5 * width, 40.0, "the drive has no plans", "empty"
        )
        return Chart("decisions", title, f"{title}: the drive has no plans", width, 56.0, body)
    plane, names = rows_plane(
        [row.name for row in rows], subject.span, width, ROW_PX, top=TOP_PX, most=LABEL_PX
    )
    bars = "".join(_bars(plane, row, k) for k, row in enumerate(rows)) + now_line(
        plane, subject.moment.t
    )
    silent = not any(row.kind == "decision" for row in rows)
    says = "; ".join(
        f"{row.name}: "
        + ", ".join(f"{span.word} {span.begin:.1f} to {span.end:.1f} s" for span in row.spans[:6])
        for row in rows
    )
    head = title + (": the planner reports none" if silent else "")
    return plane.chart(
        "decisions", title, bars, head=head, says=says, x_title="time [s]", y_ticks=names
    )


def _bars(plane: Plane, row: SpanRow, k: int) -> str:
    elements, until = [], 0.0
    ends = plane.at_x(np.array([[span.begin, span.end] for span in row.spans]))
    for i, (span, (left, right)) in enumerate(zip(row.spans, ends.tolist(), strict=True)):
        left = min(left, plane.inner[0] - LEAST_PX)
        wide, y = max(right - left, LEAST_PX), ROW_PX * k
        why = f" ({span.why})" if span.why else ""
        about = f"{row.name}: {span.word}, {span.begin:.2f} to {span.end:.2f} s{why}"
        kind = "alarm" if row.kind == "normal" and span.word not in CALM else row.kind
        elements.append(rect(left, y + 3.0, wide, ROW_PX - 6.0, kind, about))
        needed = LETTER_PX * len(span.word) + 6.0
        after = ends[i + 1, 0] if i + 1 < len(row.spans) else plane.inner[0]
        if wide >= needed or after - left - wide >= needed:
            word_x = left + 4.0 if wide >= needed else left + wide + 2.0
            elements.append(text(word_x, y + 14.0, span.word))
            until = word_x + needed
        elif left - until >= needed:
            elements.append(text(left - 3.0, y + 14.0, span.word, "end"))
        until = max(until, left + wide)
    return "".join(elements)


GRAPH_PX = 440.0, 250.0
MAX_LABELS = 6
NAME_APART_PX = 12.0  # Smallest vertical distance between two labels


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
        body = text(2.0, 13.0, title, "title") + text(GRAPH_PX[0] / 2.0, 44.0, why, "empty")
        return Chart(kind.name, title, f"{title}: {why}", GRAPH_PX[0], 64.0, body)
    x, y = graph_axes([graph], kind) or ((0.0, 1.0), (0.0, kind.least))
    plane, inside = Plane((x[0] + graph.begin, x[1] + graph.begin), y, GRAPH_PX[0], GRAPH_PX[1]), ""
    if graph.corridor is not None:
        margin = 0.1 * (plane.y[1] - plane.y[0])  # edges out there are clipped
        bounds = plane.y[0] - margin, plane.y[1] + margin
        low, high = (
            np.clip(bound, *bounds) for bound in (graph.corridor.lower, graph.corridor.upper)
        )
        inside += plane.area(
            np.r_[graph.corridor.first, graph.corridor.first[::-1]],
            np.r_[low, high[::-1]],
            "corridor",
        )
    for obstacle in graph.obstacles:
        if len(obstacle.outline) > 2:
            abscissas, ordinates = obstacle.outline.T
            inside += plane.area(
                abscissas, ordinates, "ignored" if obstacle.is_ignored else "obstacle"
            )
    boxes = list[FloatArray]()
    if frame is not None and kind is SL and len(graph.qp) > 1:
        boxes = list(true_boxes(subject.trace, frame, graph.qp))
    elif frame is not None and kind is ST:
        boxes = next(iter(actual_occupancy(subject.trace, subject.scenario)))
    for box in boxes:
        ring = np.vstack([box, box[:1]])
        inside += plane.line(ring[:, 0], ring[:, 1], "true_box")
    for points, name in ((graph.dp, "dp"), (graph.qp, "qp")):
        inside += plane.line(points[:, 0], points[:, 1], name) if len(points) else ""
    entries = (
        (len(graph.qp), ("line", "qp", "QP")),
        (len(graph.dp), ("line", "dp", "DP")),
        (graph.corridor, ("area", "corridor", "corridor")),
        (graph.obstacles, ("area", "obstacle", "obstacle")),
        (boxes, ("line", "true_box", "true box")),
    )
    named = ", ".join(
        f"{obstacle.of.agent}: {obstacle.of.decision.value}" for obstacle in graph.obstacles
    )
    return plane.chart(
        kind.name,
        title,
        inside,
        says=f"{title}: {short(named) or 'no agent in the way'}",
        entries=[entry for shown, entry in entries if shown],
        over=_labels(plane, graph, short),
        x_title=kind.x_title,
        y_title=kind.y_title,
    )


def _labels(plane: Plane, graph: DrawnGraph, short: ShortNames) -> str:
    """Labels with agent and decision at the visible part of each outline, ignored agents last.

    Overlaps move down.
    """
    wide, high = plane.inner
    labels, taken = "", list[float]()
    for obstacle in sorted(graph.obstacles, key=attrgetter("is_ignored"))[:MAX_LABELS]:
        first, second = obstacle.outline.T
        in_view = (first >= plane.x[0]) & (first <= plane.x[1])
        x = np.clip(plane.at_x(first), 0.0, wide)[in_view]
        y = np.clip(plane.at_y(second), 0.0, high)[in_view]
        if not len(y) or y.min() >= high or y.max() <= 0.0:
            continue
        words = shortened(f"{short(obstacle.of.agent)}: {obstacle.of.decision.value}", wide)
        label_y = 0.5 * (float(y.min()) + float(y.max())) + 4.0
        while any(abs(label_y - other) < NAME_APART_PX for other in taken):
            label_y += NAME_APART_PX
        taken.append(label_y)
        half = 0.5 * LETTER_PX * len(words)
        label_x = min(max(0.5 * (float(x.min()) + float(x.max())), half + 2.0), wide - half)
        labels += text(label_x, min(max(label_y, 11.0), high - 3.0), words, "label middle")
    return labels
