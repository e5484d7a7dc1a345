"""Curves over time: speed, acceleration, jerk, steering, pedals, tracking errors, distances; broken gates are shaded.

Everything is a column of the trace or a series of the metrics; the speed of the plan in force is the ego's minus the
tracking error. A panel without a finite value is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from logs.kernel import FloatArray
from logs.trace import Mode
from replay.draw.charts.axes import Plane, spread
from replay.draw.charts.canvas import Chart, legend, line, polyline, rect, text
from replay.draw.charts.moment import Violation
from replay.draw.charts.subject import Subject

WIDTH_PX, HEIGHT_PX = 440.0, 168.0
KINDS = ("a", "b", "c")
"""Classes of the first, second and third curve of a panel: solid, long dashes, dots."""
SPIKE = 99.5
"""Jerk has spikes: the axis shows this percentile of its size, and the title the largest value if that is cut off."""
LEAST_MARK_PX = 3.0
BOLD_PX = 6.8
"""Width of a letter of a warning."""


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve: its word, times (s) and values `(n,)`."""

    word: str
    t: FloatArray
    values: FloatArray

    @property
    def known(self) -> FloatArray:
        """The finite values."""
        return self.values[np.isfinite(self.values)]


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves that share an axis.

    Attributes:
        name: One word.
        title: With the unit.
        curves: At most three.
        least: The axis is never shorter, in its unit.
        about: Metrics (first words) whose broken gates are shaded here.
        floor: The axis does not go below this.
        most: Nor above this.
        spiky: Whether the axis may cut off the rarest values.
    """

    name: str
    title: str
    curves: tuple[Curve, ...]
    least: float
    about: tuple[str, ...] = ()
    floor: float = -np.inf
    most: float = np.inf
    spiky: bool = False

    @property
    def range(self) -> tuple[float, float]:
        """Of the axis."""
        values = np.concatenate([curve.known for curve in self.curves])
        if self.spiky:
            far = max(float(np.percentile(np.abs(values), SPIKE)), 0.5 * self.least)
            values = np.clip(values, -far, far)
        low, high = spread(float(values.min()), float(values.max()), self.least)
        return max(low, self.floor), min(high, self.most)


def curves(subject: Subject) -> list[Chart]:
    """All panels of a drive that have something to show."""
    shown = _closed(subject) if subject.trace.mode is Mode.CLOSED else _open(subject)
    panels = [some for some in shown if any(len(curve.known) for curve in some.curves)]
    return [_drawn(subject, panel) for panel in panels]


def _measured(subject: Subject, word: str, metric: str) -> Curve:
    """A metric step by step; steps without a value are left out, so that rarer steps are a line too."""
    t, values = subject.drive.steps(metric)
    known = np.isfinite(values)
    return Curve(word, t[known], values[known])


def _apart(curve: Curve, longest: float = 1.0) -> Curve:
    """The curve with a gap where no value is known for longer than this, s."""
    far = np.flatnonzero(np.diff(curve.t) > longest)
    return Curve(curve.word, np.insert(curve.t, far + 1, curve.t[far]), np.insert(curve.values, far + 1, np.nan))


def _closed(subject: Subject) -> list[Panel]:
    ego, tracking, done, asked = (
        subject.trace.ego,
        subject.trace.tracking,
        subject.trace.actuation,
        subject.trace.commands,
    )
    none = Curve("", np.empty(0), np.empty(0))
    plan = Curve("plan", tracking.t, np.interp(tracking.t, ego.t, ego.v) - tracking.speed) if tracking else none
    errors = [Curve(name, tracking.t, getattr(tracking, name)) if tracking else none for name in ("lateral", "station")]
    speed_error, heading = (
        Curve(name, tracking.t, getattr(tracking, name)) if tracking else none for name in ("speed", "heading")
    )
    steers = [Curve(word, some.t, some.steer) if some else none for word, some in (("done", done), ("asked", asked))]
    pedals = [Curve(name, done.t, getattr(done, name)) if done else none for name in ("throttle", "brake")]
    gaps = [
        _apart(_measured(subject, "all", "gap")),
        _apart(_measured(subject, "pedestrians, riders", "gap_vulnerable")),
    ]
    return [
        Panel("speed", "Speed [m/s]", (Curve("ego", ego.t, ego.v), plan), 2.0, ("speed",), -0.5),
        *_comfort(subject),
        Panel("gap", "Distance to the nearest [m]", tuple(gaps), 2.0, ("gap", "collision"), 0.0),
        Panel("ttc", "Time to a collision [s]", (_apart(_measured(subject, "TTC", "ttc")),), 2.0, ("ttc",), 0.0),
        Panel("steer", "Steering [rad]", tuple(steers), 0.05, ("steer_rate",)),
        Panel("pedals", "Pedals [0 to 1]", tuple(pedals), 0.3, ("throttle", "brake", "pedals_together"), 0.0, 1.0),
        Panel("tracking", "Tracking error [m]", tuple(errors), 0.1, ("tracking_lateral", "tracking_station")),
        Panel("tracking_speed", "Tracking error of the speed [m/s]", (speed_error,), 0.2, ("tracking_speed",)),
        Panel("tracking_heading", "Tracking error of the heading [rad]", (heading,), 0.02, ("tracking_heading",)),
    ]  # fmt: skip


def _comfort(subject: Subject) -> list[Panel]:
    accel = _measured(subject, "along", "lon_accel"), _measured(subject, "across", "lat_accel")
    jerk = _measured(subject, "along", "lon_jerk_state"), _measured(subject, "across", "lat_jerk_state")
    return [
        Panel("acceleration", "Acceleration [m/s\u00b2]", accel, 1.0, ("lon_accel", "lat_accel")),
        Panel("jerk", "Jerk [m/s\u00b3]", jerk, 2.0, ("lon_jerk", "lat_jerk", "jerk"), spiky=True),
    ]


def _open(subject: Subject) -> list[Panel]:
    ego = subject.trace.ego
    off = tuple(_measured(subject, f"within {part}", f"ade.{part}") for part in ("1s", "3s", "5s"))
    planned = _measured(subject, "along", "plan_lon_accel"), _measured(subject, "across", "plan_lat_accel")
    jerk = (_measured(subject, "along", "plan_lon_jerk"),)
    change = _measured(subject, "from plan to plan", "plan_change")
    return [
        Panel("speed", "Speed of the log [m/s]", (Curve("log", ego.t, ego.v),), 2.0, (), -0.5),
        Panel("displacement", "Mean distance of plan and log [m]", off, 0.5, ("ade", "fde"), 0.0),
        Panel("acceleration", "Largest acceleration of each plan [m/s\u00b2]", planned, 1.0, ("plan_l",), 0.0),
        Panel("jerk", "Largest jerk of each plan [m/s\u00b3]", jerk, 2.0, ("plan_lon_jerk",), 0.0, spiky=True),
        Panel("change", "Change from plan to plan [m]", (change,), 0.2, ("plan_change",), 0.0),
    ]


def _drawn(subject: Subject, panel: Panel) -> Chart:
    plane = Plane(subject.span, panel.range, WIDTH_PX, HEIGHT_PX)
    there = [curve for curve in panel.curves if len(curve.known)]
    lines = "".join(
        polyline(plane.at_x(curve.t), plane.at_y(curve.values), kind) for curve, kind in zip(there, KINDS, strict=False)
    )
    broken = [some for some in subject.violations if some.series.startswith(panel.about) and panel.about]
    shade, words = _shaded(plane, broken)
    inside = shade + lines + now_line(plane, subject.moment.t)
    title = panel.title + _cut_off(panel)
    head = text(2.0, 13.0, title, "title")
    named = [("line", kind, curve.word) for curve, kind in zip(there, KINDS, strict=False)]
    head += legend(plane.left, 28.0, named, WIDTH_PX - plane.left - 10.0)
    drawn = plane.drawn(inside, x_title="time [s]", over=words)
    return Chart(panel.name, panel.title, _said(panel, there, broken), WIDTH_PX, HEIGHT_PX, drawn + head)


def _cut_off(panel: Panel) -> str:
    """What the axis does not show."""
    values = np.concatenate([curve.known for curve in panel.curves])
    largest = float(np.abs(values).max())
    return (
        f", up to {largest:.0f} in single steps" if panel.spiky and largest > 1.2 * max(map(abs, panel.range)) else ""
    )


def _shaded(plane: Plane, broken: Sequence[Violation]) -> tuple[str, str]:
    """Intervals in which a gate is broken, with its metric as a word above; and the words."""
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
    """The moment that is looked at."""
    x = min(max(float(plane.at_x(t)), 1.0), plane.inner[0] - 1.0)
    return line(x, 0.0, x, plane.inner[1], "now")


def _said(panel: Panel, there: Sequence[Curve], broken: Sequence[Violation]) -> str:
    spans = [f"{c.word} {c.known.min():.3g} to {c.known.max():.3g}" for c in there]
    failed = f"; breaks {', '.join(some.gate for some in broken)}" if broken else ""
    return f"{panel.title} over time: {', '.join(spans)}{failed}"
