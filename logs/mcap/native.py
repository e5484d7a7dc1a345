"""The native scenario log, version 2: one MCAP file is one scenario; JSON messages, their JSON Schema in the file.

    metadata  replan.scenario            format_version, name, source, licence, tags and notes (JSON arrays), start_ns
                                         (log time of t = 0), duration_s, origin_x_m and origin_y_m (what was subtracted
                                         from world coordinates: all coordinates are relative to it); where known
                                         traffic_s: when the others were observed, [[from, to], ...], s since start_ns
                                         (without it, a log with an empty message on /agents: while these come);
                                         driving_source and driving_latency_s: of the topic /driving;
                                         object_classes: {id: "cone", "barrier" or "sign"} of objects among the others
              replan.scenario.metadata   other facts about the log, free keys (generator, parameters, seed)
              replan.trace               only in a trace: planner, mode, oracle, end, detail

    /ego             Ego           one state a message: required, the rest is optional
    /ego/before      Ego           its states before start_ns, which planners see as its past
    /driving         Driving       who drives from then on, one message a change; its source is in the metadata
    /controls        Controls      logged steering and pedals, one sample a message
    /agents/table    AgentTable    once: who the others are
    /agents          AgentColumns  where they are: a message holds all those sampled at its log time
    /obstacles       AgentColumns  the same for those that never move; one sample is enough
    /road            Road          once        /goal   Goal   once        /vehicle   Vehicle   once
    /traffic_lights  LightColumns  what lights show from the log time on; those that do not change may be left out
    /onboard         OnboardPlan   a plan that the log's own planner made, at the log time from which it was known
    /detections      DetectionColumns  the boxes of a perception, a message a frame, also where it saw nothing; without
                                   /repair they are not yet tracks, and whoever reads the log makes some of them
    /repair          Repair        once: /agents are tracks made of /detections, with what was changed and why; they
                                   are RepairedColumns
    /removed, /removed/table       as /agents: tracks that were taken away then; no road users
    /plan, /command, /actuation, /tracking     only in a trace: what was planned, asked, done, missed
    /perceived       AgentColumns  only in a trace: the others as a sensor showed them to the planner, once a frame
    /perceived/table AgentTable    once, where some of those are not in /agents/table or of another kind or size there
    /predictions     Predictions   only in a trace with internals: their futures as the planner was shown them

A field is serialised as its name in code plus its unit (`UNITS`). Time is the message's log time, integer nanoseconds;
a topic's messages stand in order of time. Missing is null (NaN in memory); infinity is refused, except in the graphs of
a plan, where null stands for "not reached" and "free". A version may gain topics and optional fields; its readers skip
what they do not know.

Version 2 is version 1 and blocks: on /ego, /controls, /command, /actuation and /tracking a message may be an EgoBlock,
ControlsBlock or TrackingBlock instead, whose columns hold many samples, each with its log time; the message's own is
the first one's. Traces are written so (they have 100 samples a second). A log without blocks says that it is version 1.
"""  # noqa: E501

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import Any, Literal, get_type_hints

import msgspec

from replan.logs.agents import AgentKind
from replan.logs.driving import DrivingMode
from replan.logs.mcap.field_names import serialised
from replan.logs.mcap.plan_messages import Numbers, OnboardPlan, Plan, Predictions
from replan.logs.rules import Colour
from replan.logs.vehicle import VehicleParameters

FORMAT_VERSION = 2
WITHOUT_BLOCKS = 1
"""The version that is written where there are no blocks, so that an older replan reads it."""
SCENARIO_RECORD, FREE_RECORD, TRACE_RECORD = (
    "replan.scenario",
    "replan.scenario.metadata",
    "replan.trace",
)

Pair = tuple[float, float]


class Ego(msgspec.Struct, rename=serialised):
    """The ego at the log time; reference point is the rear axle."""

    x: float
    y: float
    yaw: float
    v: float
    a: float | None = None
    kappa: float | None = None


class Controls(msgspec.Struct, rename=serialised):
    """Front wheel angle (positive to the left) and pedals, 0 to 1."""

    steer: float | None = None
    throttle: float | None = None
    brake: float | None = None


class Driving(msgspec.Struct):
    """Who drives the recorded car from the log time on."""

    mode: DrivingMode


class AgentTable(msgspec.Struct, rename=serialised):
    """The other road users, as columns: who they are."""

    id: list[str]
    kind: list[AgentKind]
    length: list[float]
    width: list[float]
    static: list[bool]


class AgentColumns(msgspec.Struct, rename=serialised):
    """The other road users at the log time, as columns: centre of the box, velocity in the
    world.
    """

    id: list[str]
    x: list[float]
    y: list[float]
    yaw: list[float]
    vx: Numbers | None = None
    vy: Numbers | None = None


class RepairedColumns(AgentColumns, rename=serialised):
    """The same of repaired tracks; "extended": before the first or after the last detection of the
    track.
    """

    extended: list[bool] = []


class DetectionColumns(msgspec.Struct, rename=serialised):
    """The boxes of one frame, as columns.

    Ids are the perception's own and need not be identities; score 0 to 1.
    """

    id: list[str]
    kind: list[AgentKind]
    x: list[float]
    y: list[float]
    yaw: list[float]
    length: Numbers
    width: Numbers
    vx: Numbers
    vy: Numbers
    score: Numbers


class Repair(msgspec.Struct, rename=serialised):
    """What was done to make tracks of detections, as columns, a row a change.

    Begin and end since start_ns.
    """

    what: list[str] = []
    agent: list[str] = []
    begin: list[float] = []
    end: list[float] = []
    samples: list[int] = []
    why: list[str] = []
    sources: list[list[str]] = []


class LaneColumns(msgspec.Struct, rename=serialised):
    """One lane, driven from first to last point.

    Point i of the left boundary faces point i of the right one.
    """

    id: int
    left_x: list[float]
    left_y: list[float]
    right_x: list[float]
    right_y: list[float]
    successors: list[int] = []
    left_neighbour: int | None = None
    right_neighbour: int | None = None
    left_opposite: bool = False
    right_opposite: bool = False
    speed_limit: float | None = None
    drivable: bool = True
    left_crossable: bool = True
    right_crossable: bool = True
    kind: str = "lane"
    yields_to: list[int] = []
    group: int | None = None
    line_x: list[float] = []
    line_y: list[float] = []


class StopLine(msgspec.Struct, rename=serialised):
    """A line across a lane, by its two ends, for the lanes "towards" (empty: all).

    Light null: a sign.
    """

    id: int
    lane: int
    x: list[float]
    y: list[float]
    light: int | None = None
    must_stop: bool = False
    towards: list[int] = []


class Crosswalk(msgspec.Struct, rename=serialised):
    """Ground on which pedestrians go first: its outline."""

    id: int
    x: list[float]
    y: list[float]


class Road(msgspec.Struct, rename=serialised):
    """Lanes and rules; source "driven_path": made from the ego's path; "assumed_limits",
    "assumed_priority": lanes.

    "areas": more drivable ground, like "car_parks". "route": lanes of the route that the log names.
    """

    lanes: list[LaneColumns]
    source: Literal["lanes", "driven_path"] = "lanes"
    drives_on_right: bool = True
    default_speed_limit: float = 13.89
    stop_lines: list[StopLine] = []
    crosswalks: list[Crosswalk] = []
    assumed_limits: list[int] = []
    assumed_priority: list[int] = []
    areas: list[Region] = []
    car_parks: list[Region] = []
    intersections: list[Region] = []
    route: list[int] = []


class LightColumns(msgspec.Struct, rename=serialised):
    """Traffic lights, as columns: the colour that each shows from the log time on."""

    id: list[int]
    colour: list[Colour]


class Region(msgspec.Struct, rename=serialised):
    """A polygon."""

    x: list[float]
    y: list[float]


class GoalAlternative(msgspec.Struct, rename=serialised):
    """One of several goals, with its own bounds; fields as of Goal."""

    regions: list[Region] = []
    t: Pair | None = None
    v: Pair | None = None
    yaw: Pair | None = None


class Goal(msgspec.Struct, rename=serialised):
    """Where (any region), when, how fast, in which direction to arrive (null, empty: free); or one
    of alternatives.

    It counts from a gain along the route on (way).
    """

    regions: list[Region] = []
    t: Pair | None = None
    v: Pair | None = None
    yaw: Pair | None = None
    alternatives: list[GoalAlternative] = []
    way: float = 0.0


Vehicle = msgspec.defstruct(
    "Vehicle",
    [
        (f.name, get_type_hints(VehicleParameters)[f.name], f.default)
        for f in fields(VehicleParameters)
    ],
    rename=serialised,
    namespace={"__doc__": "Parameters of the ego's vehicle."},
    module=__name__,
)


class Tracking(msgspec.Struct, rename=serialised):
    """How far the ego was off its plan."""

    lateral: float | None
    heading: float | None
    speed: float | None
    station: float | None


def _block(kind: type[msgspec.Struct]) -> type[msgspec.Struct]:
    """The Struct of many samples of a kind: their log times, and a list of each of its fields."""
    hints = get_type_hints(kind)
    columns: list[tuple[str, Any]] = [(name, list[hints[name]]) for name in kind.__struct_fields__]  # type: ignore[valid-type]
    doc = {"__doc__": f"Many samples: {kind.__doc__}"}
    fields_ = [("log_time", list[int]), *columns]
    return msgspec.defstruct(
        f"{kind.__name__}Block", fields_, rename=serialised, namespace=doc, module=__name__
    )


BLOCKS: dict[type[msgspec.Struct], type[msgspec.Struct]] = {
    kind: _block(kind) for kind in (Ego, Controls, Tracking)
}
"""What a message of a kind may be instead."""


TOPICS: dict[str, type[msgspec.Struct]] = {
    "/vehicle": Vehicle,
    "/goal": Goal,
    "/road": Road,
    "/traffic_lights": LightColumns,
    "/agents/table": AgentTable,
    "/obstacles": AgentColumns,
    "/agents": AgentColumns,
    "/repair": Repair,
    "/detections": DetectionColumns,
    "/removed/table": AgentTable,
    "/removed": AgentColumns,
    "/ego": Ego,
    "/ego/before": Ego,
    "/driving": Driving,
    "/controls": Controls,
    "/onboard": OnboardPlan,
    "/perceived/table": AgentTable,
    "/perceived": AgentColumns,
    "/predictions": Predictions,
    "/plan": Plan,
    "/command": Controls,
    "/actuation": Controls,
    "/tracking": Tracking,
}
"""What is on which topic (or its block); messages of one time stand in the file in this order."""


def schema_name(kind: type[msgspec.Struct]) -> str:
    """The name of a message's schema in the file."""
    return f"replan.{kind.__name__}"


@cache
def json_schema(kind: type[msgspec.Struct]) -> dict[str, Any]:
    """The JSON Schema of a message, references written out: an object at its root, as viewers want
    it.

    Docstrings are left out: the bytes of a log do not depend on words.
    """
    (root,), components = msgspec.json.schema_components((kind,))
    schema: dict[str, Any] = _written_out(root, components)
    return schema


def _written_out(part: Any, components: dict[str, Any]) -> Any:
    if isinstance(part, list):
        return [_written_out(item, components) for item in part]
    if not isinstance(part, dict):
        return part
    if "$ref" in part:
        return _written_out(components[part["$ref"].rpartition("/")[2]], components)
    # A docstring; a field of this name has a schema
    worded = isinstance(part.get("description"), str)
    shown = {
        key: _written_out(value, components)
        for key, value in part.items()
        if key != "description" or not worded
    }
    return {**shown, "type": "string"} if "enum" in part else shown
