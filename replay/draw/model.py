"""The drawing model: what recordings, charts and reports show, each in its own way.

Axes; curves over time; S-T and S-L graphs, in their units; the agents that are drawn in full. The values are
columns of the trace, the scenario, the timings and the series of the metrics; nothing else is computed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, floor, log10
from typing import TYPE_CHECKING

import numpy as np

from logs.arrays import FloatArray, IntArray
from logs.memory import loaded
from logs.plan import Corridor, Decision, DecisionKind, Graph, GraphObstacle, GridCost, Plan
from logs.road import RoadSource
from logs.scenario import Scenario
from logs.states import Controls
from logs.trace import Mode, Trace
from metrics.comfort import LON_JERK_STATE
from replay.vehicle.tyres import tyre_use

if TYPE_CHECKING:
    from pandas import DataFrame

    from replay.drive import StageTime

ROUND = (1.0, 2.0, 5.0, 10.0)
"""Round steps are these factors times a power of ten."""


def nice_step(span: float, most: int, factors: tuple[float, ...] = ROUND) -> float:
    """The smallest round step that divides a span into at most `most` parts."""
    rough = max(span, 1e-9) / most
    unit = 10.0 ** floor(log10(rough))
    return float(next(unit * factor for factor in factors if unit * factor >= rough * (1.0 - 1e-9)))


def multiples(low: float, high: float, step: float) -> FloatArray:
    """The multiples of a step in a range."""
    return np.arange(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1) * step


def ticks(low: float, high: float, most: int) -> FloatArray:
    """Multiples of 1, 2, 2.5 or 5 times a power of ten in a range: at least two, about `most` at most."""
    for bins in range(max(most, 2), 40):
        found = multiples(low, high, nice_step(high - low, bins, (1.0, 2.0, 2.5, 5.0, 10.0)))
        if len(found) > 1:
            return found
    return np.array([low, high])


def widened(low: float, high: float, least: float, room: float = 0.06) -> tuple[float, float]:
    """A range with a margin, never shorter than `least`, so that a constant value looks constant."""
    half = max((0.5 + room) * (high - low), 0.5 * least)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half


JERK = LON_JERK_STATE.name
SPIKE = 99.5
"""Percentile of the absolute values of a spiky curve up to which the axis of a chart reaches."""
BLUE, YELLOW, RED, GREEN, VIOLET, TEAL, PINK, GREY = SERIES = (
    0x4AB8F5FF, 0xE8AC30FF, 0xFF6E64FF, 0x78DC82FF, 0xC896FFFF, 0x50D2C8FF, 0xFF96C8FF, 0x9E9E9EFF,
)  # fmt: skip
"""Colours of curves in recordings, 0xRRGGBBAA; charts tell curves apart by their order."""
DIM, PALE = 0xFFFFFF78, 0xFFFFFF96
"""Masks that make a colour more transparent: `RED & DIM`."""

Steps = Callable[[str], tuple[FloatArray, FloatArray]]
"""Maps the name of a metric to its times and values `(n,)`; both are empty if it was not measured."""


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve.

    Attributes:
        name: One word.
        legend: Its name in the legend.
        t: `(n,)` s.
        values: `(n,)`.
        colour: Colour in recordings.
        width: Width in recordings, pixels.
        steps: Whether a value holds until the next.
        spiky: Whether the axis may cut off its rarest values.
        asked: Whether it is what was planned or asked for, not what was done.
    """

    name: str
    legend: str
    t: FloatArray
    values: FloatArray
    colour: int = BLUE
    width: float = 1.5
    steps: bool = False
    spiky: bool = False
    asked: bool = False

    @property
    def known(self) -> FloatArray:
        """The finite values."""
        return self.values[np.isfinite(self.values)]


@dataclass(frozen=True)
class Marker:
    """A stretch of a log to look at.

    Attributes:
        begin: s since the log's start; `end` likewise.
        kind: The kind of event, one word.
        about: Who takes part, and more in words; may be empty.
    """

    begin: float
    end: float
    kind: str
    about: str

    @property
    def words(self) -> str:
        """What happens, in a line: "cut in: car 12 (gap 3.2 m)"."""
        return ": ".join(filter(None, (self.kind.replace("_", " "), self.about)))


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves that share an axis.

    Attributes:
        name: One word.
        title: The title, with the unit.
        curves: The curves with a finite value; at most three in a chart.
        least: The axis is never shorter than this, so that a constant curve looks constant.
        about: Prefixes of the names of metrics; charts shade the times at which their gates fail.
        floor: The axis does not go below this, in charts.
        most: The axis does not go above this, in charts.
    """

    name: str
    title: str
    curves: tuple[Curve, ...]
    least: float
    about: tuple[str, ...] = ()
    floor: float = -np.inf
    most: float = np.inf

    @property
    def values(self) -> FloatArray:
        """All finite values."""
        return np.concatenate([curve.known for curve in self.curves])

    @property
    def range(self) -> tuple[float, float]:
        """The axis of a chart."""
        values = self.values
        if any(curve.spiky for curve in self.curves):
            far = max(float(np.percentile(np.abs(values), SPIKE)), 0.5 * self.least)
            values = np.clip(values, -far, far)
        low, high = widened(float(values.min()), float(values.max()), self.least)
        return max(low, self.floor), min(high, self.most)


def _panels_with_values(*panels: Panel) -> list[Panel]:
    """The panels with only those curves that have a finite value; panels without such a curve are omitted."""
    kept = (replace(panel, curves=tuple(curve for curve in panel.curves if len(curve.known))) for panel in panels)
    return [panel for panel in kept if panel.curves]


def _columns(some: object | None, *curves: tuple[str, str, str, int, float]) -> tuple[Curve, ...]:
    """Curves of an object with columns, each as name, legend, column, colour and width; empty if the object is None."""
    if some is None:
        return ()
    t: FloatArray = some.t  # type: ignore[attr-defined]
    return tuple(
        Curve(name, legend, t, getattr(some, column), colour, width) for name, legend, column, colour, width in curves
    )


# recordings -------------------------------------------------------------------------------------------------------


def steps_of(table: DataFrame | None) -> Steps:
    """The steps of metrics in the rows of `metrics.series`; None: no metric was measured."""

    def steps(metric: str) -> tuple[FloatArray, FloatArray]:
        if table is None:
            return np.empty(0), np.empty(0)
        mine = table[table["metric"] == metric]
        return mine["t_s"].to_numpy(np.float64), mine["value"].to_numpy(np.float64)

    return steps


def motion_panels(trace: Trace, scenario: Scenario, times: FloatArray, steps: Steps) -> list[Panel]:
    """Speed, acceleration, jerk, pedals, steering, tracking errors and tyres, until the end of `times`."""
    ego, log = trace.ego, scenario.ego.between(-np.inf, float(times[-1]))
    compared = log if trace.mode is Mode.CLOSED and len(log) > 1 else None
    jerk = steps(JERK)
    limits = np.full(len(times), np.nan)  # speed limit of the lane under the ego
    if scenario.road.source is RoadSource.LANES:
        x, y = np.interp(times, ego.t, ego.x), np.interp(times, ego.t, ego.y)
        for i in range(len(times)):
            lanes = scenario.road.lanes_at(float(x[i]), float(y[i]))
            limits[i] = next((lane.speed_limit for lane in lanes if lane.drivable), np.nan)
    speeds = (
        Curve("limit", "limit", times, limits, RED, 1.0, steps=True),
        *_columns(compared, ("log", "log", "v", GREY, 1.0)),
        *_plan_curves(trace, "v"),
        Curve("ego", "ego", ego.t, ego.v, BLUE, 2.0),
    )
    accelerations = (
        Curve("jerk", "jerk", *jerk, RED & PALE, 1.0, spiky=True),
        *_columns(compared, ("log", "log", "a", GREY, 1.0)),
        *_plan_curves(trace, "a"),
        Curve("ego", "ego", ego.t, ego.a, BLUE, 2.0),
    )
    asked, done, logged = trace.commands, trace.actuation, scenario.controls
    if logged is not None:
        kept = logged.t <= float(ego.t[-1])
        logged = Controls(*(getattr(logged, name)[kept] for name in ("t", "steer", "throttle", "brake")))
    pedals = (
        *_columns(asked, ("throttle_command", "throttle asked", "throttle", GREEN & DIM, 1.0),
                  ("brake_command", "brake asked", "brake", RED & DIM, 1.0)),
        *_columns(done, ("throttle", "throttle", "throttle", GREEN, 2.0), ("brake", "brake", "brake", RED, 2.0)),
        *_columns(logged, ("throttle_log", "throttle log", "throttle", GREY, 1.0),
                  ("brake_log", "brake log", "brake", YELLOW, 1.0)),
    )  # fmt: skip
    steer = (
        *_columns(logged, ("log", "log", "steer", GREY, 1.0)),
        *_columns(asked, ("command", "asked", "steer", BLUE & DIM, 1.0)),
        *_columns(done, ("ego", "ego", "steer", BLUE, 2.0)),
    )
    errors = trace.tracking
    across = _columns(errors, ("lateral", "lateral [m]", "lateral", YELLOW, 1.5),
                      ("heading", "heading [rad]", "heading", TEAL, 1.5))  # fmt: skip
    along = _columns(errors, ("station", "station [m]", "station", VIOLET, 1.5),
                     ("speed", "speed [m/s]", "speed", GREEN, 1.5))  # fmt: skip
    slips, friction = list[Curve](), list[Curve]()
    if done is not None and len(ego) > 1:
        use = tyre_use(ego, done, scenario.vehicle)
        slips = [Curve("front", "front", ego.t, use.front), Curve("rear", "rear", ego.t, use.rear, YELLOW)]
        friction = [Curve("friction", "of the tyres", ego.t, use.friction, RED)]
    return _panels_with_values(
        Panel("speed", "Speed [m/s]", speeds, 2.0),
        Panel("acceleration", "Acceleration [m/s²], jerk [m/s³]", accelerations, 1.0),
        Panel("jerk", "Jerk in full", (Curve("ego", "jerk [m/s³]", *jerk, RED),), 2.0),
        Panel("pedals", "Throttle, brake [0..1]", pedals, 0.2),
        Panel("steer", "Steering [rad]", steer, 0.02),
        Panel("error_across", "Tracking error: across", across, 0.1),
        Panel("error_along", "Tracking error: along", along, 0.2),
        Panel("slip", "Tyre slip angles [rad]", tuple(slips), 0.02),
        Panel("friction", "Friction used [0..1]", tuple(friction), 0.2),
    )


def _plan_curves(trace: Trace, column: str) -> list[Curve]:
    """Closed loop: the plan in force. Open loop (each plan starts at the log): values that older plans predicted."""
    if not trace.frames:
        return []
    if trace.mode is Mode.CLOSED:
        t = trace.ego.t
        values = np.full(len(t), np.nan)
        starts = np.searchsorted(t, np.array([frame.t for frame in trace.frames]) - 1e-9)
        for frame, start, stop in zip(trace.frames, starts, np.r_[starts[1:], len(t)], strict=True):
            path = loaded(frame.plan.trajectory)
            values[start:stop] = np.interp(t[start:stop], path.t, getattr(path, column))
        return [Curve("plan", "plan", t, values, YELLOW)]
    end = trace.ego.t[-1]
    curves = []
    for lag, colour in ((1.0, YELLOW), (3.0, VIOLET)):
        plans = ((frame.t + lag, loaded(frame.plan.trajectory)) for frame in trace.frames)
        found = [(t, np.interp(t, p.t, getattr(p, column))) for t, p in plans if t <= min(p.t[-1], end) + 1e-9]
        older = np.array(found, dtype=np.float64).reshape(-1, 2)
        name = f"plan_{lag:.0f}s", f"plan {lag:.0f} s before"
        curves.append(Curve(*name, older[:, 0], older[:, 1], colour, 1.2))
    return curves


def stage_panel(timings: Sequence[StageTime], names: dict[str, str]) -> list[Panel]:
    """Milliseconds per stage; "total" is the whole plan. `names`: the entity name of each stage."""
    curves = []
    for k, (stage, name) in enumerate(sorted(names.items(), key=lambda item: item[0] != "total")):
        some = sorted((timing.t, timing.seconds) for timing in timings if timing.stage == stage)
        t, seconds = np.array(some).T
        colour, width = (GREY, 2.0) if stage == "total" else (SERIES[k % 7], 1.2)
        curves.append(Curve(name, stage, t, 1e3 * seconds, colour, width, spiky=True))
    return _panels_with_values(Panel("stages", "Stage times [ms]", tuple(curves), 0.2))


# charts -----------------------------------------------------------------------------------------------------------


def chart_panels(trace: Trace, steps: Steps) -> list[Panel]:
    """The panels of the charts of a drive.

    Open loop: each plan is one step. Closed loop: the speed of the plan in force is the ego's minus the tracking error.
    """
    ego = trace.ego

    def measured(legend: str, metric: str, *, gaps: bool = False, spiky: bool = False) -> Curve:
        """A metric per step, without missing values; `gaps` breaks the curve where values are missing for over 1 s."""
        t, values = steps(metric)
        known = np.isfinite(values)
        t, values = t[known], values[known]
        if gaps:
            far = np.flatnonzero(np.diff(t) > 1.0)
            t, values = np.insert(t, far + 1, t[far]), np.insert(values, far + 1, np.nan)
        return Curve(metric, legend, t, values, spiky=spiky)

    def named(some: object | None, *columns: str) -> tuple[Curve, ...]:
        return _columns(some, *((name, name, name, BLUE, 1.5) for name in columns))

    if trace.mode is Mode.OPEN:
        away = tuple(measured(f"within {part}", f"ade.{part}") for part in ("1s", "3s", "5s"))
        planned = measured("along", "plan_lon_accel"), measured("across", "plan_lat_accel")
        jerk = (measured("along", "plan_lon_jerk", spiky=True),)
        change = (measured("from plan to plan", "plan_change"),)
        return _panels_with_values(
            Panel("speed", "Speed of the log [m/s]", (Curve("log", "log", ego.t, ego.v),), 2.0, (), -0.5),
            Panel("displacement", "Mean distance of plan and log [m]", away, 0.5, ("ade", "fde"), 0.0),
            Panel("acceleration", "Largest acceleration of each plan [m/s²]", planned, 1.0, ("plan_l",), 0.0),
            Panel("jerk", "Largest jerk of each plan [m/s³]", jerk, 2.0, ("plan_lon_jerk",), 0.0),
            Panel("change", "Change from plan to plan [m]", change, 0.2, ("plan_change",), 0.0),
        )
    errors, done, asked = trace.tracking, trace.actuation, trace.commands
    wanted = (errors.t, np.interp(errors.t, ego.t, ego.v) - errors.speed) if errors else None
    plan = [Curve("plan", "plan", *wanted, asked=True)] if wanted else []
    accelerations = measured("along", "lon_accel"), measured("across", "lat_accel")
    jerks = measured("along", JERK, spiky=True), measured("across", "lat_jerk_state", spiky=True)
    gaps = measured("all", "gap", gaps=True), measured("pedestrians, riders", "gap_vulnerable", gaps=True)
    ttc = (measured("TTC", "ttc", gaps=True),)
    steers = (("done", done), ("asked", asked))
    steer = tuple(Curve(word, word, some.t, some.steer, asked=some is asked) for word, some in steers if some)
    return _panels_with_values(
        Panel("speed", "Speed [m/s]", (Curve("ego", "ego", ego.t, ego.v), *plan), 2.0, ("speed",), -0.5),
        Panel("progress", "Progress along the route [share of the log's]", (measured("ego", "route_progress"),), 0.2,
              ("route_progress",), 0.0),
        Panel("acceleration", "Acceleration [m/s²]", accelerations, 1.0, ("lon_accel", "lat_accel")),
        Panel("jerk", "Jerk [m/s³]", jerks, 2.0, ("lon_jerk", "lat_jerk", "jerk")),
        Panel("gap", "Distance to the nearest [m]", gaps, 2.0, ("gap", "collision"), 0.0),
        Panel("ttc", "Time to a collision [s]", ttc, 2.0, ("ttc",), 0.0),
        Panel("steer", "Steering [rad]", steer, 0.05, ("steer_rate",)),
        Panel("pedals", "Pedals [0 to 1]", named(done, "throttle", "brake"), 0.3,
              ("throttle", "brake", "pedals_together"), 0.0, 1.0),
        Panel("tracking", "Tracking error [m]", named(errors, "lateral", "station"), 0.1,
              ("tracking_lateral", "tracking_station")),
        Panel("tracking_speed", "Tracking error of the speed [m/s]", named(errors, "speed"), 0.2, ("tracking_speed",)),
        Panel("tracking_heading", "Tracking error of the heading [rad]", named(errors, "heading"), 0.02,
              ("tracking_heading",)),
    )  # fmt: skip


def compared_panels(drives: Mapping[str, Sequence[Panel]]) -> list[Panel]:
    """The panels of several drives by name, as one panel for each curve, with a curve of each drive that has it.

    What was planned or asked for is left out.
    """
    shown = [(name, panel) for name, some in drives.items() for panel in some]
    found = [(name, panel, one) for name, panel in shown for one in panel.curves if not one.asked]
    curves = Counter(title for title, _ in {(panel.title, one.name) for _, panel, one in found})
    panels: dict[tuple[str, str], Panel] = {}
    for name, panel, one in found:
        title, part = panel.title, panel.name
        if curves[title] > 1:
            what, bracket, unit = title.partition(" [")
            title, part = f"{what}, {one.legend}{bracket}{unit}", f"{part}_{one.name}"
        before = panels.get((panel.title, one.name), replace(panel, name=part, title=title, curves=()))
        mine = replace(one, name=name, legend=name)
        panels[panel.title, one.name] = replace(before, curves=(*before.curves, mine))
    return list(panels.values())


@dataclass(frozen=True, eq=False, slots=True)
class DrawnObstacle:
    """An obstacle with the finite points `(n, 2)`, n >= 1, of its outline."""

    of: GraphObstacle
    outline: FloatArray

    @property
    def is_ignored(self) -> bool:
        """Whether the plan ignores it."""
        return self.of.decision is DecisionKind.IGNORE


@dataclass(frozen=True, eq=False, slots=True)
class DrawnGraph:
    """A graph.

    Attributes:
        begin: The first x of the QP solution, otherwise of the DP solution, the grid or the corridor.
        qp: Finite points of the QP solution `(n, 2)`.
        dp: Finite points of the DP solution `(n, 2)`.
        knots: Points `(k, 2)` of the DP solution at the columns of its grid.
        grid: The nodes that the DP searched.
        corridor: The bounds of the QP; None if there are fewer than two stations or times.
        obstacles: The obstacles that have an outline.
    """

    begin: float
    qp: FloatArray
    dp: FloatArray
    knots: FloatArray
    grid: GridCost | None
    corridor: Corridor | None
    obstacles: tuple[DrawnObstacle, ...]

    @classmethod
    def of(cls, plan: Plan, kind: type[Graph]) -> DrawnGraph | None:
        """The first graph of a kind in a plan; None if there is none."""
        graph = next((artefact for artefact in plan.internals if isinstance(artefact, kind)), None)
        if graph is None:
            return None
        qp, dp, grid, corridor = finite(graph.qp), finite(graph.dp), graph.grid, graph.corridor
        firsts = (qp[:, 0], dp[:, 0], *(part.first for part in (grid, corridor) if part))
        knots = np.empty((0, 2))
        if grid is not None and len(dp):
            x = grid.first[(grid.first >= dp[0, 0]) & (grid.first <= dp[-1, 0])]
            knots = np.column_stack([x, np.interp(x, dp[:, 0], dp[:, 1])])
        outlines = ((each, finite(each.outline)) for each in graph.obstacles)
        return cls(
            next((float(x[0]) for x in firsts if len(x)), 0.0), qp, dp, knots, grid,
            corridor if corridor is not None and len(corridor.first) > 1 else None,
            tuple(DrawnObstacle(each, outline) for each, outline in outlines if len(outline)),
        )  # fmt: skip


def finite(points: FloatArray) -> FloatArray:
    """The finite points `(m, 2)` of a line; an empty array of any shape is an empty line."""
    shaped = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    return shaped[np.isfinite(shaped).all(axis=1)]


NEAREST = 6
NEAR_M = 40.0


def decided(plan: Plan) -> dict[str, Decision]:
    """The decision that is shown at each agent: the last one that is not "ignore"."""
    return {
        artefact.agent: artefact
        for artefact in plan.internals
        if isinstance(artefact, Decision) and artefact.kind is not DecisionKind.IGNORE
    }


def in_full(
    ids: Sequence[str], x: FloatArray, y: FloatArray, about: Container[str], ego: tuple[float, float]
) -> IntArray:
    """Rows of the agents drawn in full, increasing: the `NEAREST` within `NEAR_M`, and those with a decision.

    Args:
        ids: `(n,)`.
        x: World coordinate, m, `(n,)`.
        y: World coordinate, m, `(n,)`.
        about: The agents that the plan decides about.
        ego: Position of the ego.
    """
    if len(ids) <= NEAREST:
        return np.arange(len(ids))
    away = np.hypot(x - ego[0], y - ego[1])
    near = {int(i) for i in np.argsort(away, kind="stable")[:NEAREST] if away[i] <= NEAR_M}
    return np.array(sorted(near | {i for i, name in enumerate(ids) if name in about}), dtype=np.int64)


def plan_seconds(plan: Plan) -> FloatArray:
    """Positions `(n, 2)` of a plan at each full second after its start, m."""
    path = plan.trajectory
    t = np.arange(path.t[0] + 1.0, path.t[-1] + 1e-6, 1.0)
    return np.column_stack([np.interp(t, path.t, path.x), np.interp(t, path.t, path.y)])
