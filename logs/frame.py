"""The inputs of a planner: one Frame at a time, and a context that does not change.

A Frame holds the present, the past, and the predictions that replay makes; it gives no access to
the log's future.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import atan2, hypot

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray, frozen
from replan.core.kernel import kernel
from replan.logs.agents import Agents, ObjectClass
from replan.logs.lane_route import LaneRoute
from replan.logs.past import NOTHING_EARLIER, Earlier, Past, Snapshot
from replan.logs.plan import Plan
from replan.logs.polylines import inside
from replan.logs.road import Goal, Road
from replan.logs.rules import Colour
from replan.logs.states import EgoState, wrap
from replan.logs.vehicle import VehicleParameters


@dataclass(frozen=True, eq=False, slots=True)
class Predictions:
    """Predicted futures of the agents, all on one time grid.

    Attributes:
        t: `(k,)` s since the scenario's start; the first is the frame's time.
        agent: `(n,)` index into `Frame.agents`; an agent may have several hypotheses.
        probability: `(n,)`; sums to 1 over an agent's hypotheses.
        x: `(n, k)` box centre, world, m; `y` likewise; `yaw` rad.
        method: Name of the predictor; "oracle": the futures are taken from the log.
    """

    t: FloatArray
    agent: IntArray
    probability: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    method: str

    def __post_init__(self) -> None:
        for name in ("t", "probability", "x", "y", "yaw"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        shape = (len(self.agent), len(self.t))
        if {self.x.shape, self.y.shape, self.yaw.shape} != {shape}:
            raise ValueError(f"predictions must have shape {shape}")

    def __len__(self) -> int:
        return len(self.agent)


@dataclass(frozen=True, eq=False, slots=True)
class Visibility:
    """The ground that the sensor can see; `hides` tests points from which a pedestrian may step
    out.

    Attributes:
        x: Position of the sensor, world, m; `y` likewise.
        yaw: Middle of its field of view, rad.
        range: Range of the sensor, m.
        field_of_view: rad; with 2 pi or more the sensor sees all round.
        shadows: Areas that agents hide, one behind each agent: quadrilaterals `(n, 4, 2)`, world,
            m, counter-clockwise from the near right corner (as seen from the sensor); they reach
            beyond the range.
    """

    x: float
    y: float
    yaw: float
    range: float
    field_of_view: float
    shadows: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "shadows", frozen(np.reshape(self.shadows, (-1, 4, 2))))

    def hides(self, points: FloatArray) -> BoolArray:
        """Return which points `(k, 2)`, world, m, lie out of range, out of the field of view, or in
        a shadow.
        """
        sensor = np.array([self.x, self.y, self.yaw, self.range, self.field_of_view])
        return _hidden(np.asarray(points, dtype=np.float64), sensor, self.shadows)


@kernel
def _hidden(points: FloatArray, sensor: FloatArray, shadows: FloatArray) -> BoolArray:
    """Return which points the sensor (x, y, yaw, range, field of view) does not see."""
    sensor_x, sensor_y, yaw, reach, field_of_view = sensor
    hidden = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        dx, dy = x - sensor_x, y - sensor_y
        turn = abs(wrap(atan2(dy, dx) - yaw))
        hidden[i] = hypot(dx, dy) > reach or turn > 0.5 * field_of_view
        for k in range(len(shadows)):
            hidden[i] = hidden[i] or inside(x, y, shadows[k])
    return hidden


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """The situation at one instant.

    Attributes:
        t: s since the scenario's start.
        ego: State at the rear axle.
        agents: The agents as perceived, without any sample later than `t`.
        predictions: Predicted futures of the agents.
        previous: The plan that is being driven; None in open loop and at the start. A planner that
            gets None must not use state from earlier frames (solver warm starts included).
        visibility: The ground that the sensor can see; None: everything (perception by ground
            truth).
        lights: Current colour of each traffic light of the road, by its id.
        earlier: What `past` is made of.
        object_classes: What the objects among the agents are, by id, where the log says it.
    """

    t: float
    ego: EgoState
    agents: Agents
    predictions: Predictions
    previous: Plan | None = None
    visibility: Visibility | None = None
    lights: Mapping[int, Colour] = field(default_factory=dict)
    earlier: Earlier = NOTHING_EARLIER
    object_classes: Mapping[str, ObjectClass] = field(default_factory=dict)

    @property
    def snapshot(self) -> Snapshot:
        """Ego, agents and lights of the frame."""
        return Snapshot(self.t, self.ego, self.agents, self.lights)

    @property
    def past(self) -> Past:
        """The last 2.1 s before the frame, the same in both loops whatever the planner saw before.

        It is made at each call: read it once. A frame that is made by hand has a past that is held.
        """
        return self.earlier.past(self.snapshot)


PLAN_HORIZON_S = 3.0
"""Shortest horizon of a complete plan, s: nuPlan's and NAVSIM's shortest horizons are 3 and 4 s."""


def _no_clock(stage: str) -> None:
    """Ignore the end of a stage: stage times are not measured."""


@dataclass(frozen=True, eq=False, slots=True)
class PlannerContext:
    """The fixed inputs with which a planner is created; each scenario gets its own planner.

    Attributes:
        road: The road; it has at least one lane.
        goal: The goal of the drive; None if it is unknown: the planner then drives straight on.
        vehicle: The ego's parameters.
        period: Time between two frames, s.
        start: The ego's state at the first frame.
        lap: Function to call as `lap("stage")` at the end of a stage of planning: replay measures
            the time.
        horizon: Shortest horizon of a complete plan, s; a shorter plan is driven and evaluated, but
            is incomplete.
        origin: The point (0, 0) of the world in the coordinates of the log and its map, m: a point
            of a map of your own, minus this, is a point of the world
            (`replan.replay.planner_process.coordinates`).
        route: The lanes to the goal; empty for built-in planners, which find their own.
        light_lanes: The lanes that each light controls, by its id (`replan.logs.lane_groups`).
        start_ns: Log time of t = 0, ns.
    """

    road: Road
    goal: Goal | None
    vehicle: VehicleParameters
    period: float
    start: EgoState
    lap: Callable[[str], None] = _no_clock
    horizon: float = PLAN_HORIZON_S
    origin: tuple[float, float] = (0.0, 0.0)
    route: LaneRoute = field(default_factory=LaneRoute)
    light_lanes: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    start_ns: int = 0
