"""The scene: one frame in one lane, computed once for all stages; the start of a plan; what takes
parts of the lane.

For an agent whose centre projects to station s of the reference line, with the line's heading yaw_r
there,

(1) v_s = vx cos yaw_r + vy sin yaw_r,  v_l = vy cos yaw_r - vx sin yaw_r
        along and across the line
(2) turn = yaw - yaw_r, a principal value

A standing car, a cyclist or a red light takes a part of the lane for a time. It is an `Occupancy`:
a box of stations and offsets with the time until which it lasts. The path passes boxes or stops
before them; for the speed stage they are stations that the ego must not pass
(`StBoundaries.with_stops`). Moving agents take the path by their predicted footprints
(`st_boundaries`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import atan2, cos, hypot, inf, isfinite, pi, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import kernel
from replan.logs.agents import AgentKind, among
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Decision, DecisionKind, PlanStart
from replan.logs.reference_line import line_frame, line_project
from replan.logs.route import find_route
from replan.logs.states import EgoState, wrap
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.path import Path, frenet_start, interpolated, out_of_frame
from replan.planners.frenet.reference_path import (
    CrossSections,
    ReferencePath,
    make_reference_path,
    write_sections,
)

STITCH_M = 0.5  # A plan starts on the previous one where the ego is nearer to it than this, m ...
STITCH_MPS = 1.0  # ... and its speed nearer than this, m/s.
WINDOW_SHARE = 1.5
"""An agent's foot point is searched ahead of and behind the ego's within this times their distance
...
"""
WINDOW_M = (80.0, 370.0)
"""... plus the first, m, but at most the second, m, so that it is not on another branch of a
winding road.
"""
FOOT_M = 30.0  # The ego's foot point is searched within this distance of its expected station, m
STANDING_MPS = 0.5
"""An agent slower than this stands, m/s: the path passes it, or the ego stops.

The speed stage does not follow it.
"""
UNLIKELY = 0.2  # A predicted hypothesis that is not more probable than this is unlikely
TRACK_M = 1.0  # The ego keeps its track where its offset changes by less than this, m
TRACK_ROOM_M = 0.3  # An agent beside the ego's track by more than this is not in it, m
OVERLAP_M = 0.5  # An agent whose front is past the ego's rear by less than this follows the ego, m
VULNERABLE = among(*(kind for kind in AgentKind if kind.is_vulnerable))
"""The vulnerable kinds (on foot or riding), by code."""


class AgentsAlong(NamedTuple):
    """The agents along the reference path, `(n,)` each: station and offset of the centre, m, (1),
    m/s, and (2), rad.
    """

    s: FloatArray
    l: FloatArray
    v_s: FloatArray
    v_l: FloatArray
    turn: FloatArray


SPEED = len(AgentsAlong._fields)
"""The row of speeds in those of `place_agents`, after `AgentsAlong` and before `CrossSections`."""


class Bodies(NamedTuple):
    """The frame's agents in the form that kernels take, `(n,)` each, as in `Agents`."""

    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    vx: FloatArray
    vy: FloatArray
    length: FloatArray
    width: FloatArray


class Futures(NamedTuple):
    """The predictions in the form that kernels take, as in `Predictions`."""

    t: FloatArray
    agent: IntArray
    probability: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray


class StartPlace(NamedTuple):
    """The start of a plan: x, y and its station, m."""

    x: float
    y: float
    s: float


@dataclass(frozen=True, eq=False, slots=True)
class Scene:
    """A frame in a lane."""

    frame: Frame  # The planner's input now; `start` is the state at which the plan begins
    start: EgoState
    reference: ReferencePath
    vehicle: VehicleParameters
    s: float  # Station of the start, m; `l` its offset, m
    l: float
    trouble: str  # Why the start has no l', l'' in the Frenet frame; empty if it has
    frenet: tuple[float, float, float]  # l, l', l'' of the start; zeros where there is `trouble`
    limit: float  # The lane's speed limit at the start, m/s
    # The agents' boxes; `agents` these along the reference path; `across` the rows of `road`
    # `(8, n)`
    bodies: Bodies
    agents: AgentsAlong
    across: FloatArray
    # Speeds of the agents `(n,)`, m/s; which of them are `standing`, and which `vulnerable` (walk
    # or ride)
    speed: FloatArray
    standing: BoolArray
    vulnerable: BoolArray

    @property
    def place(self) -> StartPlace:
        """The place of the start."""
        return StartPlace(self.start.x, self.start.y, self.s)

    @property
    def front(self) -> float:
        """Station of the ego's front, m; `rear` of its rear."""
        return self.s + self.vehicle.axle_to_front

    @property
    def rear(self) -> float:
        """Station of the ego's rear, m."""
        return self.s - self.vehicle.rear_overhang

    @property
    def v(self) -> float:
        """Speed at the start, m/s, not negative."""
        return max(self.start.v, 0.0)

    @property
    def road(self) -> CrossSections:
        """The road across the agents' stations."""
        return CrossSections(*self.across)

    @property
    def futures(self) -> Futures:
        """The predictions."""
        predictions = self.frame.predictions
        return Futures(
            predictions.t,
            predictions.agent,
            predictions.probability,
            predictions.x,
            predictions.y,
            predictions.yaw,
        )

    def name(self, agent: int) -> str:
        """The name of an agent in messages ("car 12")."""
        return f"{self.frame.agents.kinds[agent].value} {self.frame.agents.ids[agent]}"


def scene_of(
    frame: Frame,
    start: EgoState,
    reference: ReferencePath,
    vehicle: VehicleParameters,
    last: StartPlace | None = None,
) -> Scene:
    """The scene of a frame for a plan from `start`.

    Its foot point is searched as far on from `last` as it moved.
    """
    line, agents = reference.line, frame.agents
    bodies = Bodies(
        agents.x, agents.y, agents.yaw, agents.vx, agents.vy, agents.length, agents.width
    )
    search = (0.5 * line.length, line.length)
    if last is not None:
        moved = hypot(start.x - last.x, start.y - last.y)
        search = last.s + moved, FOOT_M + moved
    s, l, limit, rows = place_agents(
        line.s, line.coef, reference.table, reference.limit, bodies, (start.x, start.y), *search
    )
    trouble = out_of_frame(line, start, s, l)
    frenet = (0.0, 0.0, 0.0) if trouble else frenet_start(line, start, s, l)
    speed = rows[SPEED]
    return Scene(
        frame,
        start,
        reference,
        vehicle,
        s,
        l,
        trouble,
        frenet,
        limit,
        bodies,
        AgentsAlong(*rows[:SPEED]),
        rows[SPEED + 1 :],
        speed,
        speed < STANDING_MPS,
        VULNERABLE[agents.codes],
    )


@kernel
def place_agents(
    knots: FloatArray,
    coef: FloatArray,
    table: FloatArray,
    limits: FloatArray,
    bodies: Bodies,
    ego: tuple[float, float],
    near: float,
    within: float,
) -> tuple[float, float, float, FloatArray]:
    """Station and offset of the ego, the speed limit there, and rows `AgentsAlong`, speed,
    `CrossSections` `(14, n)`.

    The ego's foot point is searched up to `within` m from the station `near`; `table` is that of a
    reference path.
    """
    s_ego, l_ego = line_project(knots, coef, ego[0], ego[1], near, within)
    x, y = bodies.x, bodies.y
    vx, vy = bodies.vx, bodies.vy
    columns = np.empty((14, len(x)))
    for i in range(len(x)):
        window = min(WINDOW_M[0] + WINDOW_SHARE * hypot(x[i] - ego[0], y[i] - ego[1]), WINDOW_M[1])
        s, l = line_project(knots, coef, x[i], y[i], s_ego, window)
        along = line_frame(knots, coef, s)[2]
        columns[0, i], columns[1, i] = s, l
        columns[2, i] = vx[i] * cos(along) + vy[i] * sin(along)  # (1)
        columns[3, i] = vy[i] * cos(along) - vx[i] * sin(along)
        columns[4, i] = wrap(bodies.yaw[i] - along)  # (2)
        columns[SPEED, i] = hypot(vx[i], vy[i])
    write_sections(knots, table, columns[0], columns[SPEED + 1 :])
    return s_ego, l_ego, interpolated(s_ego, knots, limits), columns


def behind(scene: Scene, *, keeps_track: bool) -> BoolArray:
    """Which agents `(n,)` follow the ego, so that they must react to it and not the ego to them.

    Where the ego keeps its track, all agents behind it in its direction follow; where it changes,
    those in its track.
    """
    agents, ego = scene.agents, (scene.rear, scene.l, scene.frame.ego.yaw, scene.vehicle.width)
    return _follow(agents.s, agents.l, scene.bodies, scene.standing, ego, keeps_track)


@kernel
def _follow(
    s: FloatArray,
    l: FloatArray,
    bodies: Bodies,
    standing: BoolArray,
    ego: tuple[float, float, float, float],
    keeps_track: bool,
) -> BoolArray:
    """`behind` of agents at these stations and offsets.

    The ego's station of the rear, offset, yaw and width.
    """
    follows = np.zeros(len(s), np.bool_)
    rear, l_ego, yaw_ego, width = ego
    for i in range(len(s)):
        heading = bodies.yaw[i] if standing[i] else atan2(bodies.vy[i], bodies.vx[i])
        in_track = keeps_track or abs(l[i] - l_ego) < 0.5 * (bodies.width[i] + width) + TRACK_ROOM_M
        turn = abs((heading - yaw_ego + pi) % (2.0 * pi) - pi)
        follows[i] = (
            s[i] + 0.5 * bodies.length[i] < rear + OVERLAP_M and in_track and turn < 0.5 * pi
        )
    return follows


def start_of(
    frame: Frame, stitch_m: float = STITCH_M, stitch_mps: float = STITCH_MPS
) -> tuple[EgoState, PlanStart]:
    """The state at which the plan of a frame begins: on the previous plan if the ego is near it,
    else at the ego.
    """
    if frame.previous is not None:
        old = frame.previous.trajectory.at(frame.t)
        is_near = hypot(old.x - frame.ego.x, old.y - frame.ego.y) <= stitch_m
        if is_near and abs(old.v - frame.ego.v) <= stitch_mps:
            return old, PlanStart.PREVIOUS_PLAN
    return frame.ego, PlanStart.EGO


class RouteTracker:
    """The reference path of one scenario's route, and the last start on it."""

    def __init__(self, context: PlannerContext) -> None:
        self._vehicle = context.vehicle
        route = find_route(context.road, context.start, context.goal)
        self.reference: ReferencePath = make_reference_path(context.road, route, context.start)
        self._last: StartPlace | None = None

    def scene(self, frame: Frame) -> tuple[Scene, PlanStart]:
        """The scene of a frame along the route, and the kind of start of its plan."""
        start, kind = start_of(frame)
        last = self._last if frame.previous is not None else None
        scene = scene_of(frame, start, self.reference, self._vehicle, last)
        self._last = scene.place
        return scene, kind


@dataclass(frozen=True, eq=False, slots=True)
class Occupancy:
    """A part of the lane that is taken for a time (module docstring)."""

    agent: str  # An agent's id, or the name of a stop ("stop line 7")
    s_from: float  # Station at which it begins, m; `s_to` at which it ends
    s_to: float = inf
    l_from: float = -inf  # Offset of its right side, m; `l_to` of its left side
    l_to: float = inf
    aside: float = 0.0  # Width of the box on either side that is space beside the agent, m
    until: float = inf  # Time until which it lasts, s from the frame; inf: not known to end
    # Station at which the ego's front should come to rest before it, m; inf: it is not a stop
    aim: float = inf
    kind: DecisionKind = DecisionKind.IGNORE  # The decision about it; IGNORE: none yet
    reason: str = ""  # The reason for the decision

    @property
    def s_middle(self) -> float:
        """Station in the middle between its ends, m."""
        return 0.5 * (self.s_from + self.s_to)

    @property
    def decision(self) -> Decision:
        """The decision about it, and its reason."""
        return Decision(self.agent, self.kind, "speed", self.reason)


def on_reference(
    stops: tuple[Occupancy, ...], s: float, vehicle: VehicleParameters
) -> tuple[Occupancy, ...]:
    """Stops as distances ahead of a rear axle at station `s` that keeps to the reference line, m,
    not negative.
    """
    front = s + vehicle.axle_to_front
    return tuple(
        replace(stop, s_from=max(stop.s_from - front, 0.0), aim=max(stop.aim - front, 0.0))
        for stop in stops
    )


def on_path(
    stops: tuple[Occupancy, ...], path: Path, vehicle: VehicleParameters
) -> tuple[Occupancy, ...]:
    """The stops that lie on a path, as arc lengths of the rear axle, m, not negative."""
    on_path_stops = []
    for stop in stops:
        bound, aim = (station - vehicle.axle_to_front for station in (stop.s_from, stop.aim))
        if bound < path.s[-1]:
            bound, aim = (
                max(float(np.interp(bound_or_aim, path.s, path.sigma)), 0.0)
                for bound_or_aim in (bound, aim)
            )
            on_path_stops.append(replace(stop, s_from=bound, aim=aim))
    return tuple(on_path_stops)


def open_end(stops: Sequence[Occupancy]) -> float:
    """Station at which the ego should come to rest for the first stop that is not known to end, m;
    inf without one.
    """
    return min((stop.aim for stop in stops if not isfinite(stop.until)), default=inf)


def upper_bound(stops: Sequence[Occupancy], times: FloatArray, length: float) -> FloatArray:
    """Greatest station `(n,)` that stops on a path allow at times `(n,)`, m; `length` where there
    is none.
    """
    upper = np.full(len(times), length)
    for stop in stops:
        upper = np.where(times < stop.until, np.minimum(upper, stop.s_from), upper)
    return upper
