"""Charts over time: panels of curves, in which the times of failed gates are shaded, and decisions as rows.

The rows are the plan's status, each road user with a decision, and each broken gate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from logs.plan import Decision, DecisionKind, PlanStatus, PlanSummary
from replay.draw.charts.axes import LEFT_PX, Plane, rows_plane
from replay.draw.charts.canvas import DRIVES, LETTER_PX, Chart, legend_words, line, rect, shortened, text
from replay.draw.charts.subject import Subject
from replay.draw.model import Panel, compared_panels, panels
from replay.explain.explanation import STATUS_WORDS

WIDTH_PX, HEIGHT_PX = 440.0, 168.0
KINDS = ("a", "b", "c", "d")  # Classes of the curves of a panel, in their order: solid, long dashes, dots, thin
LEAST_PX = 3.0
BOLD_PX = 6.8  # Width of a letter of a warning, pixels
NAME_PX = 90.0  # Largest width of a drive's name before a warning, pixels


def curves(subject: Subject) -> list[Chart]:
    """All panels of a drive that have something to show; of several drives, a panel for each of their curves."""
    charts, drives = [], subject.drives
    found = {  # the trace has one plan only
        name: [p for p in panels(replace(one.trace, frames=()), one.scenario, one.drive.steps) if p.charted]
        for name, one in drives.items()
    }
    several, (first, *_) = len(drives) > 1, found.values()
    kinds = dict(zip(drives, DRIVES, strict=False))
    begins, ends = zip(*(one.span for one in drives.values()), strict=True)
    for panel in compared_panels(found) if several else first:
        shaded = [
            Span(begin, end, f"\u26a0 {of}{some.series}", f"{of}{some.gate}")
            for name, one in drives.items()
            for of in [f"{shortened(name, NAME_PX)}: " if several else ""]
            for some in one.violations
            if some.series.startswith(panel.about) and panel.about
            for begin, end in some.spans
        ]
        classes = [kinds[curve.name] for curve in panel.curves] if several else KINDS
        charts.append(panel_chart(panel, (min(begins), max(ends)), shaded, now=subject.moment.t, kinds=classes))
    return charts


def panel_chart(
    panel: Panel, x: tuple[float, float], shaded: Sequence[Span] = (), *, now: float | None = None,
    kinds: Sequence[str] = KINDS, shade: str = "broken", x_title: str = "time [s]",
    size: tuple[float, float] = (WIDTH_PX, HEIGHT_PX),
) -> Chart:  # fmt: skip
    """The curves of a panel.

    `panel`: the panel; curves without a class are not drawn. `shaded`: intervals that are shaded, each with a word
    above, and in a tooltip why. `size`: pixels.
    """
    plane = Plane(x, panel.range, *size)
    shown = list(zip(panel.curves, kinds, strict=False))
    wide, high = plane.inner
    inside, words, until = "", "", -np.inf
    for span in sorted(shaded, key=lambda one: (one.begin, one.end, one.why)):
        left, right = plane.at_x(np.array([span.begin, span.end])).tolist()
        left = min(max(left, 0.0), wide - LEAST_PX)
        right = max(right, left + LEAST_PX)
        inside += rect(left, 0.0, right - left, high, shade, span.why)
        inside += line(left, 0.0, left, high, "edge") if span.word else ""
        room = BOLD_PX * len(span.word) + 2.0
        at = min(left + 2.0, wide - room)
        if at > until:
            words += text(at, 9.0, span.word, "warn")
            until = at + room
    inside += "".join(plane.line(curve.t, curve.values, kind) for curve, kind in shown[::-1])  # the first on top
    inside += "" if now is None else now_line(plane, now)
    head, largest = panel.title, float(np.abs(panel.values).max())
    if any(curve.spiky for curve in panel.curves) and largest > 1.2 * max(map(abs, panel.range)):
        head += f", up to {largest:.0f} in single steps"
    named = legend_words([curve.legend for curve, _ in shown], size[0] - LEFT_PX)
    entries = [("line", kind, word) for (_, kind), word in zip(shown, named, strict=True)]
    spans = [f"{c.legend} {c.known.min():.3g} to {c.known.max():.3g}" for c in panel.curves]
    failed = f"; breaks {', '.join(dict.fromkeys(span.why for span in shaded))}" if shade == "broken" and shaded else ""
    says = f"{panel.title} over time: {', '.join(spans)}{failed}"
    return plane.chart(
        panel.name, panel.title, inside, head=head, says=says, entries=entries, over=words, x_title=x_title
    )


def now_line(plane: Plane, t: float) -> str:
    """A vertical line at the moment of the subject."""
    x = min(max(float(plane.at_x(t)), 1.0), plane.inner[0] - 1.0)
    return line(x, 0.0, x, plane.inner[1], "now")


ROWS_PX, ROW_PX, TOP_PX = 900.0, 20.0, 22.0
LABEL_PX = 210.0
MAX_ROWS = 12  # Largest number of rows of road users; the list of events beside the picture has all of them
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
    kind: str = "bar"


def decided(plans: Sequence[PlanSummary], end: float, short: Callable[[str], str]) -> list[SpanRow]:
    """The decisions other than "ignore" about each agent, in the order of the first decision.

    A decision holds until the next frame; consecutive frames with the same decision are one span with the first reason.
    `short` shortens the names of agents.
    """
    rows: dict[str, list[Span]] = {}
    for plan, stop in _until(plans, end):
        now = [some for some in plan.internals if isinstance(some, Decision)]
        for one in {some.agent: some for some in now if some.kind is not DecisionKind.IGNORE}.values():
            _extend(rows.setdefault(one.agent, []), Span(plan.t, stop, one.kind.value, short(one.reason)))
    return [SpanRow(short(agent), tuple(spans)) for agent, spans in rows.items()]


def statuses(plans: Sequence[PlanSummary], end: float) -> SpanRow:
    """The statuses of the plans."""
    spans: list[Span] = []
    for plan, stop in _until(plans, end):
        _extend(spans, Span(plan.t, stop, STATUS_WORDS[plan.status], plan.reason))
    return SpanRow("plan", tuple(spans), "calm")


def _until(plans: Sequence[PlanSummary], end: float) -> Iterable[tuple[PlanSummary, float]]:
    """Each plan and the time until which it holds."""
    return zip(plans, [*(plan.t for plan in plans[1:]), max(end, plans[-1].t)] if plans else [], strict=True)


def _extend(spans: list[Span], one: Span) -> None:
    """Add a span, or extend the last one if it continues."""
    if spans and spans[-1].word == one.word and abs(spans[-1].end - one.begin) < 1e-6:
        spans[-1] = Span(spans[-1].begin, one.end, one.word, spans[-1].why)
    else:
        spans.append(one)


def decisions(subject: Subject, width: float = ROWS_PX) -> Chart:
    """Decisions, plan statuses and broken gates as rows over time; `width` in pixels."""
    plans, end = subject.plans, subject.span[1]
    agents = decided(plans, end, subject.scenario.short_names)
    longest = sorted(agents, key=lambda row: -sum(span.end - span.begin for span in row.spans))[:MAX_ROWS]
    broken: dict[str, SpanRow] = {}
    for some in subject.violations:  # gates of one series (episode and total time, say) are one row
        spans = tuple(Span(begin, stop, "fails", some.gate) for begin, stop in some.spans)
        before = broken[some.series].spans if some.series in broken else ()
        if spans:
            spans = tuple(dict.fromkeys((*before, *spans))) if before else spans
            broken[some.series] = SpanRow(some.series, spans, "alarm")
    status = [statuses(plans, end)] if plans else []
    rows = [*status, *(row for row in agents if row in longest), *broken.values()]
    title = "Decisions, plans and broken gates over time"
    if not rows:
        body = text(2.0, 13.0, title, "title") + text(0.5 * width, 40.0, "the drive has no plans", "says")
        return Chart("decisions", title, f"{title}: the drive has no plans", width, 56.0, body)
    plane, names = rows_plane([row.name for row in rows], subject.span, width, ROW_PX, top=TOP_PX, most=LABEL_PX)
    bars = "".join(_bars(plane, row, k) for k, row in enumerate(rows)) + now_line(plane, subject.moment.t)
    silent = not any(row.kind == "bar" for row in rows)
    says = "; ".join(
        f"{row.name}: " + ", ".join(f"{span.word} {span.begin:.1f} to {span.end:.1f} s" for span in row.spans[:6])
        for row in rows
    )
    head = title + (": the planner reports none" if silent else "")
    return plane.chart("decisions", title, bars, head=head, says=says, x_title="time [s]", y_ticks=names)


def _bars(plane: Plane, row: SpanRow, k: int) -> str:
    out, until = [], 0.0
    ends = plane.at_x(np.array([[span.begin, span.end] for span in row.spans]))
    for i, (span, (left, right)) in enumerate(zip(row.spans, ends.tolist(), strict=True)):
        left = min(left, plane.inner[0] - LEAST_PX)
        wide, y = max(right - left, LEAST_PX), ROW_PX * k
        why = f" ({span.why})" if span.why else ""
        about = f"{row.name}: {span.word}, {span.begin:.2f} to {span.end:.2f} s{why}"
        kind = "alarm" if row.kind == "calm" and span.word not in CALM else row.kind
        out.append(rect(left, y + 3.0, wide, ROW_PX - 6.0, kind, about))
        needed = LETTER_PX * len(span.word) + 6.0
        after = ends[i + 1, 0] if i + 1 < len(row.spans) else plane.inner[0]
        if wide >= needed or after - left - wide >= needed:
            at = left + 4.0 if wide >= needed else left + wide + 2.0
            out.append(text(at, y + 14.0, span.word))
            until = at + needed
        elif left - until >= needed:
            out.append(text(left - 3.0, y + 14.0, span.word, "end"))
        until = max(until, left + wide)
    return "".join(out)
