"""Panels: curves over time that share an axis, in recordings and charts.

The values are columns of the trace, the scenario, the timings and the series of the metrics;
only the speed limit is looked up in the map.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from replan.core.arrays import FloatArray
from replan.draw.spans import Span, widened
from replan.logs.frame_store import loaded
from replan.logs.scenario import Scenario
from replan.logs.states import Controls, Trajectory
from replan.logs.trace import Mode, Trace
from replan.metrics.boxes import ego_boxes
from replan.metrics.comfort import lon_jerk_state
from replan.metrics.lanes import limits_at, mapped_lanes, stated_lanes
from replan.replay.vehicle.tyres import tyre_use

if TYPE_CHECKING:
    from pandas import DataFrame

    from replan.replay.drive import StageTime

JERK = lon_jerk_state.name
SPIKE = 99.5  # Percentile of the absolute values of a spiky curve up to which the axis reaches
BLUE, YELLOW, RED, GREEN, VIOLET, TEAL, PINK, GREY = SERIES = (
    0x4AB8F5FF,
    0xE8AC30FF,
    0xFF6E64FF,
    0x78DC82FF,
    0xC896FFFF,
    0x50D2C8FF,
    0xFF96C8FF,
    0x9E9E9EFF,
)
"""Colours of curves in recordings, 0xRRGGBBAA; charts tell curves apart by their order."""
DIM = 0xFFFFFF78  # Mask that makes a colour more transparent: `RED & DIM`

Steps = Callable[[str], tuple[FloatArray, FloatArray]]
"""Maps the name of a metric to its times and values `(n,)`.

Both are empty if it was not measured.
"""


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve."""

    name: str
    legend: str
    t: FloatArray  # `(n,)` s
    values: FloatArray  # `(n,)`
    colour: int = BLUE
    width: float = 2.0  # Width in recordings, pixels
    steps: bool = False  # Whether a value holds until the next
    spiky: bool = False  # Whether the axis may cut off its rarest values
    # Whether it is what was planned, asked for, allowed or logged, not what was done
    asked: bool = False

    @property
    def known(self) -> FloatArray:
        """The finite values."""
        return self.values[np.isfinite(self.values)]


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves that share an axis."""

    name: str
    title: str
    # The curves with a finite value, the most important first: a chart shows at most four
    curves: tuple[Curve, ...]
    least: float  # The axis is never shorter than this, so that a constant curve looks constant
    # Prefixes of the names of metrics; charts shade the times at which their gates fail
    about: tuple[str, ...] = ()
    floor: float = -np.inf  # The axis does not go below this
    most: float = np.inf  # The axis does not go above this
    charted: bool = True  # Whether charts show it, too; recordings show all

    @property
    def values(self) -> FloatArray:
        """All finite values."""
        return np.concatenate([curve.known for curve in self.curves])

    @property
    def range(self) -> Span:
        """The axis."""
        values = self.values
        if any(curve.spiky for curve in self.curves):
            far = max(float(np.percentile(np.abs(values), SPIKE)), 0.5 * self.least)
            values = np.clip(values, -far, far)
        low, high = widened(float(values.min()), float(values.max()), self.least)
        return max(low, self.floor), min(high, self.most)


def _panels_with_values(*panels: Panel) -> list[Panel]:
    """The panels with only those curves that have a finite value.

    Panels without such a curve are omitted.
    """
    shown = (
        replace(panel, curves=tuple(curve for curve in panel.curves if len(curve.known)))
        for panel in panels
    )
    return [panel for panel in shown if panel.curves]


def _columns(
    series: object | None, *curves: tuple[str, str, str, int], asked: bool = False
) -> tuple[Curve, ...]:
    """Curves of an object with columns, each as name, legend, column and colour.

    Empty if the object is None.
    """
    if series is None:
        return ()
    t: FloatArray = series.t  # type: ignore[attr-defined]
    width = 1.0 if asked else 2.0
    return tuple(
        Curve(name, legend, t, getattr(series, column), colour, width, asked=asked)
        for name, legend, column, colour in curves
    )


def steps_of(table: DataFrame | None) -> Steps:
    """The steps of metrics in the rows of `metrics.series`; None: no metric was measured."""

    def steps(metric: str) -> tuple[FloatArray, FloatArray]:
        if table is None:
            return np.empty(0), np.empty(0)
        rows = table[table["metric"] == metric]
        return rows["t_s"].to_numpy(np.float64), rows["value"].to_numpy(np.float64)

    return steps


MEASURED = (
    "route_progress",
    "lon_accel",
    "lat_accel",
    JERK,
    "lat_jerk_state",
    "gap",
    "gap_vulnerable",
    "ttc",
    "ade.1s",
    "ade.3s",
    "ade.5s",
    "plan_lon_accel",
    "plan_lat_accel",
    "plan_lon_jerk",
    "plan_change",
)
"""The metrics of which panels show the steps; a run hands a recording the steps of these alone."""


def panels(
    trace: Trace, scenario: Scenario, steps: Steps, log: Trajectory | None = None
) -> list[Panel]:
    """The panels of a drive or a log: all that have a finite value.

    Open loop: each plan is one step. What plans asked for is drawn if the trace has all plans;
    otherwise the speed of the plan in force of a closed loop is the ego's minus the tracking error.
    `log` is the log's drive, by default the scenario's: it is drawn unless it is the drive, as in
    the scenario of a trace file.
    """

    def measured(
        legend: str, metric: str, colour: int = BLUE, *, gaps: bool = False, spiky: bool = False
    ) -> Curve:
        """A metric per step, without missing values; `gaps` breaks the curve where values are
        missing for over 1 s.
        """
        t, values = steps(metric)
        known = np.isfinite(values)
        t, values = t[known], values[known]
        if gaps:
            far = np.flatnonzero(np.diff(t) > 1.0)
            t, values = np.insert(t, far + 1, t[far]), np.insert(values, far + 1, np.nan)
        return Curve(metric, legend, t, values, colour, spiky=spiky)

    ego, actuation, asked = trace.ego, trace.actuation, trace.commands
    errors, logged = trace.tracking, scenario.controls
    end, is_open = float(ego.t[-1]), trace.mode is Mode.OPEN
    log = None if is_open else (log or scenario.ego).between(-np.inf, end)
    log = log if log is not None and len(log) > 1 and not np.array_equal(log.v, ego.v) else None
    if log is None and actuation is not None:
        logged = None
    if logged is not None:
        driven = logged.t <= end
        columns = (logged.t, logged.steer, logged.throttle, logged.brake)
        logged = Controls(*(column[driven] for column in columns))
    plan = _predicted(trace, "v")
    if not plan and errors is not None:
        planned = np.interp(errors.t, ego.t, ego.v) - errors.speed
        plan = [Curve("plan", "plan", errors.t, planned, YELLOW, asked=True)]
    along = replace(measured("along", "lon_accel"), name="ego")
    along = along if len(along.t) else Curve("ego", "along", ego.t, ego.a)
    slips, friction = list[Curve](), list[Curve]()
    if actuation is not None and len(ego) > 1:
        use = tyre_use(ego, actuation, scenario.vehicle)
        slips = [
            Curve("front", "front", ego.t, use.front),
            Curve("rear", "rear", ego.t, use.rear, YELLOW),
        ]
        friction = [Curve("friction", "of the tyres", ego.t, use.friction, RED)]
    of_plans = (
        Panel(
            "displacement",
            "Mean distance of plan and log [m]",
            (
                measured("within 1s", "ade.1s"),
                measured("within 3s", "ade.3s", YELLOW),
                measured("within 5s", "ade.5s", VIOLET),
            ),
            0.5,
            ("ade", "fde"),
            0.0,
        ),
        Panel(
            "plan_acceleration",
            "Largest acceleration of each plan [m/s²]",
            (measured("along", "plan_lon_accel"), measured("across", "plan_lat_accel", TEAL)),
            1.0,
            ("plan_l",),
            0.0,
        ),
        Panel(
            "plan_jerk",
            "Largest jerk of each plan [m/s³]",
            (measured("along", "plan_lon_jerk", RED, spiky=True),),
            2.0,
            ("plan_lon_jerk",),
            0.0,
        ),
        Panel(
            "change",
            "Change from plan to plan [m]",
            (measured("from plan to plan", "plan_change"),),
            0.2,
            ("plan_change",),
            0.0,
        ),
    )
    table = (
        Panel(
            "speed",
            "Speed [m/s]",
            (
                Curve("ego", "ego", ego.t, ego.v),
                *plan,
                *_columns(log, ("log", "log", "v", GREY), asked=True),
                _limit(trace, scenario),
            ),
            2.0,
            ("speed",),
            -0.5,
        ),
        Panel(
            "progress",
            "Progress along the route [share of the log's]",
            (measured("ego", "route_progress"),),
            0.2,
            ("route_progress",),
            0.0,
        ),
        Panel(
            "acceleration",
            "Acceleration [m/s²]",
            (
                along,
                measured("across", "lat_accel", TEAL),
                *_predicted(trace, "a"),
                *_columns(log, ("log", "log", "a", GREY), asked=True),
            ),
            1.0,
            ("lon_accel", "lat_accel"),
        ),
        Panel(
            "jerk",
            "Jerk [m/s³]",
            (
                measured("along", JERK, RED, spiky=True),
                measured("across", "lat_jerk_state", PINK, spiky=True),
            ),
            2.0,
            ("lon_jerk", "lat_jerk", "jerk"),
        ),
        Panel(
            "gap",
            "Distance to the nearest [m]",
            (
                measured("all", "gap", gaps=True),
                measured("pedestrians, riders", "gap_vulnerable", PINK, gaps=True),
            ),
            2.0,
            ("gap", "collision"),
            0.0,
        ),
        Panel(
            "ttc",
            "Time to a collision [s]",
            (measured("TTC", "ttc", RED, gaps=True),),
            2.0,
            ("ttc",),
            0.0,
        ),
        *(of_plans if is_open else ()),
        Panel(
            "steer",
            "Steering [rad]",
            (
                *_columns(actuation, ("done", "done", "steer", BLUE)),
                *_columns(asked, ("asked", "asked", "steer", YELLOW), asked=True),
                *_columns(logged, ("log", "log", "steer", GREY), asked=True),
            ),
            0.05,
            ("steer_rate",),
        ),
        Panel(
            "pedals",
            "Pedals [0 to 1]",
            (
                *_columns(
                    actuation,
                    ("throttle", "throttle", "throttle", GREEN),
                    ("brake", "brake", "brake", RED),
                ),
                *_columns(
                    asked,
                    ("throttle_asked", "throttle asked", "throttle", GREEN & DIM),
                    ("brake_asked", "brake asked", "brake", RED & DIM),
                    asked=True,
                ),
                *_columns(
                    logged,
                    ("throttle_log", "throttle log", "throttle", GREY),
                    ("brake_log", "brake log", "brake", YELLOW),
                    asked=True,
                ),
            ),
            0.3,
            ("throttle", "brake", "pedals_together"),
            0.0,
            1.0,
        ),
        Panel(
            "tracking",
            "Tracking error [m]",
            _columns(
                errors,
                ("lateral", "lateral", "lateral", YELLOW),
                ("station", "station", "station", VIOLET),
            ),
            0.1,
            ("tracking_lateral", "tracking_station"),
        ),
        Panel(
            "tracking_speed",
            "Tracking error of the speed [m/s]",
            _columns(errors, ("speed", "speed", "speed", GREEN)),
            0.2,
            ("tracking_speed",),
        ),
        Panel(
            "tracking_heading",
            "Tracking error of the heading [rad]",
            _columns(errors, ("heading", "heading", "heading", TEAL)),
            0.02,
            ("tracking_heading",),
        ),
        Panel("slip", "Tyre slip angles [rad]", tuple(slips), 0.02, charted=False),
        Panel("friction", "Friction used [0..1]", tuple(friction), 0.2, charted=False),
    )
    return _panels_with_values(*table)


LIMIT_STEP_S = 0.1


def _limit(trace: Trace, scenario: Scenario) -> Curve:
    """The speed limit under the ego's centre as `speed_excess` judges it.

    Where the log states none: the assumed one.
    """
    ego = trace.ego
    t = np.arange(ego.t[0], ego.t[-1] + 1e-9, LIMIT_STEP_S)
    limits = np.full(len(t), np.nan)
    lanes, stated = mapped_lanes(scenario.road), stated_lanes(scenario.road)
    if lanes is not None and stated is not None:
        centre = ego_boxes(ego, scenario)[:2]
        x, y = (np.interp(t, ego.t, column) for column in centre)
        limits = limits_at(stated, x, y)
        limits = np.where(np.isfinite(limits), limits, limits_at(lanes, x, y))
    return Curve("limit", "limit", t, limits, RED, 1.0, steps=True, asked=True)


def _predicted(trace: Trace, column: str) -> list[Curve]:
    """Closed loop: the plan in force.

    Open loop (each plan starts at the log): values that older plans predicted.
    """
    if not trace.frames:
        return []
    if trace.mode is Mode.CLOSED:
        t = trace.ego.t
        values = np.full(len(t), np.nan)
        starts = np.searchsorted(t, np.array([frame.t for frame in trace.frames]) - 1e-9)
        for frame, start, stop in zip(trace.frames, starts, np.r_[starts[1:], len(t)], strict=True):
            path = loaded(frame.plan.trajectory)
            values[start:stop] = np.interp(t[start:stop], path.t, getattr(path, column))
        return [Curve("plan", "plan", t, values, YELLOW, asked=True)]
    end = trace.ego.t[-1]
    curves = []
    for lag, colour in ((1.0, YELLOW), (3.0, VIOLET)):
        plans = ((frame.t + lag, loaded(frame.plan.trajectory)) for frame in trace.frames)
        points = [
            (t, np.interp(t, path.t, getattr(path, column)))
            for t, path in plans
            if t <= min(path.t[-1], end) + 1e-9
        ]
        times, values = np.array(points, dtype=np.float64).reshape(-1, 2).T
        name, legend = f"plan_{lag:.0f}s", f"plan {lag:.0f} s before"
        curves.append(Curve(name, legend, times, values, colour, 1.2, asked=True))
    return curves


def stage_panel(timings: Sequence[StageTime], names: dict[str, str]) -> list[Panel]:
    """Milliseconds per stage; "total" is the whole plan. `names`: the entity name of each stage."""
    curves = []
    for k, stage in enumerate(sorted(names, key="total".__ne__)):
        points = sorted((timing.t, timing.seconds) for timing in timings if timing.stage == stage)
        t, seconds = np.array(points).T
        colour, width = (GREY, 2.0) if stage == "total" else (SERIES[k % 7], 1.2)
        curves.append(Curve(names[stage], stage, t, 1e3 * seconds, colour, width, spiky=True))
    return _panels_with_values(
        Panel("stages", "Stage times [ms]", tuple(curves), 0.2, charted=False)
    )


def compared_panels(drives: Mapping[str, Sequence[Panel]]) -> list[Panel]:
    """The panels of several drives by name, as one panel for each curve, with a curve of each drive
    that has it.

    What was planned, asked for, allowed or logged is left out.
    """
    shown: dict[tuple[str, str], list[tuple[str, Panel, Curve]]] = {}
    for drive, of_drive in drives.items():
        for panel in of_drive:
            for curve in panel.curves:
                if not curve.asked:
                    entries = shown.setdefault((panel.title, curve.name), [])
                    entries.append((drive, panel, curve))
    curves_of = Counter(title for title, _ in shown)
    compared = []
    for (title, name), entries in shown.items():
        _, panel, first = entries[0]
        if curves_of[title] > 1:
            quantity, bracket, unit = title.partition(" [")
            title = f"{quantity}, {first.legend}{bracket}{unit}"
            panel = replace(panel, name=f"{panel.name}_{name}")
        curves = tuple(replace(curve, name=drive, legend=drive) for drive, _, curve in entries)
        compared.append(replace(panel, title=title, curves=curves))
    return compared
