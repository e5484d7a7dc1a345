"""Curves over time as charts: the panels of `replay.draw.curves`, with the times shaded at which gates fail."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from replay.draw.charts.axes import Plane
from replay.draw.charts.canvas import Chart, legend, line, polyline, rect, text
from replay.draw.charts.moment import Violation
from replay.draw.charts.subject import Subject
from replay.draw.curves import chart_panels

WIDTH_PX, HEIGHT_PX = 440.0, 168.0
KINDS = ("a", "b", "c")
"""Classes of the first, second and third curve of a panel: solid, long dashes, dots."""
LEAST_MARK_PX = 3.0
BOLD_PX = 6.8
"""Width of a letter of a warning."""


def curves(subject: Subject) -> list[Chart]:
    """All panels of a drive that have something to show."""
    charts = []
    for panel in chart_panels(subject.trace, subject.drive.steps):
        plane = Plane(subject.span, panel.range, WIDTH_PX, HEIGHT_PX)
        shown = list(zip(panel.curves, KINDS, strict=False))
        lines = "".join(polyline(plane.at_x(curve.t), plane.at_y(curve.values), kind) for curve, kind in shown)
        broken = [some for some in subject.violations if some.series.startswith(panel.about) and panel.about]
        shade, words = _shaded(plane, broken)
        inside = shade + lines + now_line(plane, subject.moment.t)
        title, largest = panel.title, float(np.abs(panel.values).max())
        if any(curve.spiky for curve in panel.curves) and largest > 1.2 * max(map(abs, panel.range)):
            title += f", up to {largest:.0f} in single steps"
        head = text(2.0, 13.0, title, "title")
        named = [("line", kind, curve.legend) for curve, kind in shown]
        head += legend(plane.left, 28.0, named, WIDTH_PX - plane.left - 10.0)
        drawn = plane.drawn(inside, x_title="time [s]", over=words)
        spans = [f"{c.legend} {c.known.min():.3g} to {c.known.max():.3g}" for c in panel.curves]
        failed = f"; breaks {', '.join(some.gate for some in broken)}" if broken else ""
        says = f"{panel.title} over time: {', '.join(spans)}{failed}"
        charts.append(Chart(panel.name, panel.title, says, WIDTH_PX, HEIGHT_PX, drawn + head))
    return charts


def _shaded(plane: Plane, broken: Sequence[Violation]) -> tuple[str, str]:
    """The intervals in which a gate is broken, and the names of their metrics above them."""
    wide, high = plane.inner
    boxes, words, until = [], [], -np.inf
    found = [(begin, end, some) for some in broken for begin, end in some.spans]
    for begin, end, some in sorted(found, key=lambda one: (one[0], one[1], one[2].gate)):
        left, right = plane.at_x(np.array([begin, end])).tolist()
        left = min(max(left, 0.0), wide - LEAST_MARK_PX)
        right = max(right, left + LEAST_MARK_PX)
        boxes.append(rect(left, 0.0, right - left, high, "broken", some.gate) + line(left, 0.0, left, high, "edge"))
        room = BOLD_PX * len(some.series) + 14.0
        at = min(left + 2.0, wide - room)
        if at > until:
            words.append(text(at, 9.0, f"\u26a0 {some.series}", "warn"))
            until = at + room
    return "".join(boxes), "".join(words)


def now_line(plane: Plane, t: float) -> str:
    """The moment of the subject."""
    x = min(max(float(plane.at_x(t)), 1.0), plane.inner[0] - 1.0)
    return line(x, 0.0, x, plane.inner[1], "now")
