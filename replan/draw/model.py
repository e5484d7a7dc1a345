"""The drawing model: what recordings, charts and reports show, each in its own way.

Axes; curves over time; S-T and S-L graphs, in their units; the agents that are drawn in full. The
values are columns of the trace, the scenario, the timings and the series of the metrics; nothing
else is computed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, floor, log10
from typing import TYPE_CHECKING

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.logs.frame_store import loaded
from replan.logs.plan import (
    Corridor,
    Decision,
    DecisionKind,
    Graph,
    GraphObstacle,
    GridCost,
    Plan,
    SlGraph,
    StGraph,
)
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.states import Controls
from replan.logs.trace import Mode, Trace
from replan.metrics.comfort import lon_jerk_state
from replan.replay.vehicle.tyres import tyre_use

if TYPE_CHECKING:
    from pandas import DataFrame

    from replan.replay.drive import StageTime


def nice_step(span: float, most: int) -> float:
    """The smallest of 1, 2, 2.5, 5 times a power of ten that divides a span into at most `most`
    parts.
    """
    rough = max(span, 1e-9) / most
    unit = 10.0 ** floor(log10(rough))
    return float(
        next(
            unit * factor
            for factor in (1.0, 2.0, 2.5, 5.0, 10.0)
            if unit * factor >= rough * (1.0 - 1e-9)
        )
    )


def ticks(low: float, high: float, most: int) -> FloatArray:
    """Multiples of a round step in a range: at least two, about `most` at most."""
    for bins in range(max(most, 2), 40):
        step = nice_step(high - low, bins)
        found = np.arange(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1) * step
        if len(found) > 1:
            return found
    return np.array([low, high])


Span = tuple[float, float]


def widened(low: float, high: float, least: float, room: float = 0.06) -> Span:
    """A range with a margin, never shorter than `least`, so that a constant value looks
    constant.
    """
    half = max((0.5 + room) * (high - low), 0.5 * least)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half


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


@dataclass(frozen=True)
class Marker:
    """A stretch of a log to look at."""

    begin: float  # s since the log's start; `end` likewise
    end: float
    kind: str
    about: str  # Who takes part, and more in words; may be empty

    @property
    def words(self) -> str:
        """What happens, in a line: "cut in: car 12 (gap 3.2 m)"."""
        return ": ".join(filter(None, (self.kind.replace("_", " "), self.about)))


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
    kept = (
        replace(panel, curves=tuple(curve for curve in panel.curves if len(curve.known)))
        for panel in panels
    )
    return [panel for panel in kept if panel.curves]


def _columns(
    some: object | None, *curves: tuple[str, str, str, int], asked: bool = False
) -> tuple[Curve, ...]:
    """Curves of an object with columns, each as name, legend, column and colour.

    Empty if the object is None.
    """
    if some is None:
        return ()
    t: FloatArray = some.t  # type: ignore[attr-defined]
    width = 1.0 if asked else 2.0
    return tuple(
        Curve(name, legend, t, getattr(some, column), colour, width, asked=asked)
        for name, legend, column, colour in curves
    )


def steps_of(table: DataFrame | None) -> Steps:
    """The steps of metrics in the rows of `metrics.series`; None: no metric was measured."""

    def steps(metric: str) -> tuple[FloatArray, FloatArray]:
        if table is None:
            return np.empty(0), np.empty(0)
        mine = table[table["metric"] == metric]
        return mine["t_s"].to_numpy(np.float64), mine["value"].to_numpy(np.float64)

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


def panels(trace: Trace, scenario: Scenario, steps: Steps) -> list[Panel]:
    """The panels of a drive or a log: all that have a finite value.

    Open loop: each plan is one step. What plans asked for is drawn if the trace has all plans;
    otherwise the speed of the plan in force of a closed loop is the ego's minus the tracking error.
    The log is drawn unless its ego is that of the drive, as in the scenario of a trace file.
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

    ego, done, asked, errors, logged = (
        trace.ego,
        trace.actuation,
        trace.commands,
        trace.tracking,
        scenario.controls,
    )
    end, is_open = float(ego.t[-1]), trace.mode is Mode.OPEN
    log = None if is_open else scenario.ego.between(-np.inf, end)
    log = log if log is not None and len(log) > 1 and not np.array_equal(log.v, ego.v) else None
    if log is None and done is not None:
        logged = None
    if logged is not None:
        kept = logged.t <= end
        logged = Controls(
            *(getattr(logged, name)[kept] for name in ("t", "steer", "throttle", "brake"))
        )
    plan = _predicted(trace, "v")
    if not plan and errors is not None:
        planned = np.interp(errors.t, ego.t, ego.v) - errors.speed
        plan = [Curve("plan", "plan", errors.t, planned, YELLOW, asked=True)]
    along = replace(measured("along", "lon_accel"), name="ego")
    along = along if len(along.t) else Curve("ego", "along", ego.t, ego.a)
    slips, friction = list[Curve](), list[Curve]()
    if done is not None and len(ego) > 1:
        use = tyre_use(ego, done, scenario.vehicle)
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
                *_columns(done, ("done", "done", "steer", BLUE)),
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
                    done,
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
    """The speed limit of the lane under the ego."""
    ego = trace.ego
    t = np.arange(ego.t[0], ego.t[-1] + 1e-9, LIMIT_STEP_S)
    limits = np.full(len(t), np.nan)
    if scenario.road.source is RoadSource.LANES:
        for i, (x, y) in enumerate(
            zip(np.interp(t, ego.t, ego.x), np.interp(t, ego.t, ego.y), strict=True)
        ):
            lanes = scenario.road.lanes_at(float(x), float(y))
            limits[i] = next((lane.speed_limit for lane in lanes if lane.drivable), np.nan)
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
        found = [
            (t, np.interp(t, p.t, getattr(p, column)))
            for t, p in plans
            if t <= min(p.t[-1], end) + 1e-9
        ]
        older = np.array(found, dtype=np.float64).reshape(-1, 2)
        name = f"plan_{lag:.0f}s", f"plan {lag:.0f} s before"
        curves.append(Curve(*name, older[:, 0], older[:, 1], colour, 1.2, asked=True))
    return curves


def stage_panel(timings: Sequence[StageTime], names: dict[str, str]) -> list[Panel]:
    """Milliseconds per stage; "total" is the whole plan. `names`: the entity name of each stage."""
    curves = []
    for k, (stage, name) in enumerate(sorted(names.items(), key=lambda item: item[0] != "total")):
        some = sorted((timing.t, timing.seconds) for timing in timings if timing.stage == stage)
        t, seconds = np.array(some).T
        colour, width = (GREY, 2.0) if stage == "total" else (SERIES[k % 7], 1.2)
        curves.append(Curve(name, stage, t, 1e3 * seconds, colour, width, spiky=True))
    return _panels_with_values(
        Panel("stages", "Stage times [ms]", tuple(curves), 0.2, charted=False)
    )


def compared_panels(drives: Mapping[str, Sequence[Panel]]) -> list[Panel]:
    """The panels of several drives by name, as one panel for each curve, with a curve of each drive
    that has it.

    What was planned, asked for, allowed or logged is left out.
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
        before = panels.get(
            (panel.title, one.name), replace(panel, name=part, title=title, curves=())
        )
        mine = replace(one, name=name, legend=name)
        panels[panel.title, one.name] = replace(before, curves=(*before.curves, mine))
    return list(panels.values())


@dataclass(frozen=True)
class GraphKind:
    """A kind of graph: its names and axes."""

    name: str
    graph: type[Graph]
    title: str
    x_title: str  # Title of the axis, with the unit; `y_title` likewise
    y_title: str
    least: float  # The y axis is not shorter than this
    scrolls: bool  # Whether the graphs of a drive begin at different x


ST = GraphKind(
    "st", StGraph, "S-T graph", "time from the plan [s]", "station along the path [m]", 5.0, False
)
SL = GraphKind(
    "sl",
    SlGraph,
    "S-L graph",
    "station of the reference line [m]",
    "lateral offset [m], left positive",
    4.0,
    True,
)
FAR_M = 6.0  # Axes show obstacles and bounds up to this far beyond the solutions


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
    """A graph."""

    # The first x of the QP solution, otherwise of the DP solution, the grid or the corridor
    begin: float
    qp: FloatArray  # Finite points of the QP solution `(n, 2)`
    dp: FloatArray  # Finite points of the DP solution `(n, 2)`
    knots: FloatArray  # Points `(k, 2)` of the DP solution at the columns of its grid
    grid: GridCost | None  # The nodes that the DP searched
    # The bounds of the QP; None if there are fewer than two stations or times
    corridor: Corridor | None
    obstacles: tuple[DrawnObstacle, ...]  # The obstacles that have an outline

    @classmethod
    def of(cls, plan: Plan, kind: GraphKind) -> DrawnGraph | None:
        """The first graph of a kind in a plan; None if there is none."""
        graph = next(
            (artefact for artefact in plan.internals if isinstance(artefact, kind.graph)), None
        )
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
            next((float(x[0]) for x in firsts if len(x)), 0.0),
            qp,
            dp,
            knots,
            grid,
            corridor if corridor is not None and len(corridor.first) > 1 else None,
            tuple(DrawnObstacle(each, outline) for each, outline in outlines if len(outline)),
        )


def graph_axes(graphs: Sequence[DrawnGraph], kind: GraphKind) -> tuple[Span, Span] | None:
    """Axes for some graphs, x relative to the begin of each: with all solutions and the near ends
    of obstacles.

    They may cut off far obstacles and bounds of the corridor. None if there is neither solution nor
    obstacle.
    """
    solved = [
        line - [graph.begin, 0.0] for graph in graphs for line in (graph.qp, graph.dp) if len(line)
    ]
    around = [
        some.outline - [graph.begin, 0.0]
        for graph in graphs
        for some in graph.obstacles
        if not some.is_ignored
    ]
    if not solved and not around:
        return None
    points = np.concatenate(solved or around)
    x = 0.0, max(float(points[:, 0].max()), 1.0)
    low, high = float(points[:, 1].min()), float(points[:, 1].max())
    seen = (outline[(outline[:, 0] >= x[0]) & (outline[:, 0] <= x[1]), 1] for outline in around)
    near: list[FloatArray] = [some for some in seen if len(some)]
    if kind is ST:
        top = max(
            high,
            min(max([high, *(float(some.min()) + FAR_M for some in near)]), 1.6 * high + 10.0),
            kind.least,
        )
        return x, (min(low, 0.0), 1.05 * top)
    for graph in graphs:
        near += [graph.grid.second] if graph.grid else []
        if graph.corridor is not None:
            inside = graph.corridor.first <= graph.begin + x[1]
            sides = (
                side[inside & np.isfinite(side)]
                for side in (graph.corridor.lower, graph.corridor.upper)
            )
            near += [side for side in sides if len(side)]
    low = max(min([low, *(float(some.min()) for some in near if len(some))]), low - FAR_M)
    high = min(max([high, *(float(some.max()) for some in near if len(some))]), high + FAR_M)
    return x, widened(low, high, kind.least)


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
    ids: Sequence[str],
    x: FloatArray,
    y: FloatArray,
    about: Container[str],
    ego: tuple[float, float],
) -> IntArray:
    """Rows of the agents drawn in full, increasing: the `NEAREST` within `NEAR_M`, and those with a
    decision.

    `ids`: `(n,)`. `x`: world coordinate, m, `(n,)`. `y`: world coordinate, m, `(n,)`.
    """
    if len(ids) <= NEAREST:
        return np.arange(len(ids))
    away = np.hypot(x - ego[0], y - ego[1])
    near = {int(i) for i in np.argsort(away, kind="stable")[:NEAREST] if away[i] <= NEAR_M}
    return np.array(
        sorted(near | {i for i, name in enumerate(ids) if name in about}), dtype=np.int64
    )


def plan_seconds(plan: Plan) -> FloatArray:
    """Positions `(n, 2)` of a plan at each full second after its start, m."""
    path = plan.trajectory
    t = np.arange(path.t[0] + 1.0, path.t[-1] + 1e-6, 1.0)
    return np.column_stack([np.interp(t, path.t, path.x), np.interp(t, path.t, path.y)])
