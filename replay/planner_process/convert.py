"""Frames, contexts and plans as messages, and back: the same numbers to the bit, over immutable buffers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import msgspec
import numpy as np

from logs import frame as nouns
from logs import road, rules, trace
from logs.agents import NUMBERS, OPTIONAL, Agents
from logs.kernel import FloatArray
from logs.mcap import native
from logs.mcap.trace import plan_message
from logs.mcap.trace_reader import artefacts_of
from logs.states import TRAJECTORY_COLUMNS, Trajectory
from replay.planner_process import schema
from replay.planner_process.plan_limits import LARGEST_INSIDE_BYTES, shortened

PREDICTED = ("t", "probability", "x", "y", "yaw")
WIRE = np.dtype("<f8")


def packed(values: FloatArray) -> Any:
    """An array as the bytes of a column, row by row; no copy where it lies so already."""
    array: Any = np.ascontiguousarray(values, WIRE)
    return memoryview(array).cast("B") if array.size else b""


def unpacked(column: schema.Column) -> FloatArray:
    """The numbers of a column `(n,)`; ValueError where the bytes are no such."""
    return np.frombuffer(column, WIRE) if isinstance(column, bytes) else np.array(column, np.float64)


def _points(column: bytes) -> FloatArray:
    return unpacked(column).reshape(-1, 2)


def context_message(context: nouns.PlannerContext) -> schema.Context:
    """A context to be sent."""
    goal = context.goal
    return schema.Context(
        road=_road_message(context.road),
        goal=None if goal is None else _goal_message(goal),
        vehicle=context.vehicle,
        period=context.period,
        start=context.start,
        horizon=context.horizon,
    )


def context_of(message: schema.Context, lap: Any) -> nouns.PlannerContext:
    """The context that was sent; `lap` is the planner's clock."""
    goal = message.goal
    return nouns.PlannerContext(
        _road_of(message.road),
        None if goal is None else _goal_of(goal),
        message.vehicle,
        message.period,
        message.start,
        lap,
        message.horizon,
    )


def _goal_message(goal: road.Goal) -> schema.Goal:
    regions = [packed(each) for each in goal.regions]
    return schema.Goal(regions, goal.t, goal.v, goal.yaw, [_goal_message(one) for one in goal.alternatives])


def _goal_of(message: schema.Goal) -> road.Goal:
    regions, others = tuple(map(_points, message.regions)), tuple(map(_goal_of, message.alternatives))
    return road.Goal(regions, message.t, message.v, message.yaw, others)


def _road_message(made: road.Road) -> schema.Road:
    return schema.Road(
        lanes=[_message(schema.Lane, lane, "left", "right") for lane in made.lanes.values()],
        source=made.source.name.lower(),
        drives_on_right=made.drives_on_right,
        default_speed_limit=made.default_speed_limit,
        stop_lines=[_message(schema.StopLine, line, "points") for line in made.stop_lines],
        crosswalks=[_message(schema.Crosswalk, walk, "polygon") for walk in made.crosswalks],
    )


def _message(kind: Any, noun: Any, *arrays: str) -> Any:
    """A message with the fields of a dataclass, its arrays packed."""
    values = {item.name: getattr(noun, item.name) for item in fields(noun)}
    return kind(**{**values, **{name: packed(values[name]) for name in arrays}})


def _road_of(message: schema.Road) -> road.Road:
    lanes = [road.Lane(**_fields(lane, "left", "right")) for lane in message.lanes]
    return road.Road(
        {lane.id: lane for lane in lanes},
        road.RoadSource[message.source.upper()],
        message.drives_on_right,
        message.default_speed_limit,
        tuple(rules.StopLine(**_fields(line, "points")) for line in message.stop_lines),
        tuple(rules.Crosswalk(**_fields(walk, "polygon")) for walk in message.crosswalks),
    )


def _fields(message: msgspec.Struct, *arrays: str) -> dict[str, Any]:
    values = msgspec.structs.asdict(message)
    return {**values, **{name: _points(values[name]) for name in arrays}}


def frame_message(frame: nouns.Frame) -> schema.Frame:
    """A frame to be sent."""
    agents, some, seen = frame.agents, frame.predictions, frame.visibility
    now, futures = _columns(agents, NUMBERS), _columns(some, PREDICTED)
    return schema.Frame(
        t=frame.t,
        ego=frame.ego,
        agents=schema.Agents(agents.ids, agents.kinds, **now),
        predictions=schema.Predictions(agent=some.agent.tolist(), method=some.method, **futures),
        previous=None if frame.previous is None else plan_sent(frame.previous),
        visibility=None if seen is None else _message(schema.Visibility, seen, "shadows"),
        lights=[schema.Light(light, colour) for light, colour in frame.lights.items()],
    )


def _columns(noun: Any, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: packed(getattr(noun, name)) for name in names}


def frame_of(message: schema.Frame) -> nouns.Frame:
    """The frame that was sent."""
    now, some, seen = message.agents, message.predictions, message.visibility
    sent = (name for name in NUMBERS if name not in OPTIONAL or getattr(now, name))
    agents: dict[str, Any] = {name: unpacked(getattr(now, name)) for name in sent}
    futures: dict[str, Any] = {name: unpacked(getattr(some, name)) for name in PREDICTED}
    shape = (len(some.agent), len(futures["t"]))
    futures |= {name: futures[name].reshape(shape) for name in ("x", "y", "yaw")}
    return nouns.Frame(
        message.t,
        message.ego,
        Agents(now.ids, now.kinds, **agents),
        nouns.Predictions(agent=np.array(some.agent, np.int64), method=some.method, **futures),
        None if message.previous is None else plan_of(message.previous),
        None if seen is None else nouns.Visibility(**_fields(seen, "shadows")),
        {light.id: light.colour for light in message.lights},
    )


def plan_sent(plan: trace.Plan, laps: dict[str, float] | None = None, *, inside: bool = False) -> schema.Plan:
    """A plan to be sent, with its inside or without."""
    columns = (packed(getattr(plan.trajectory, name)) for name in TRAJECTORY_COLUMNS)
    return schema.Plan(
        schema.Trajectory(*columns),
        plan.status.name.lower(),
        shortened(plan.reason),
        plan.start.name.lower(),
        laps or {},
        _inside(plan) if inside and len(plan.internals) else None,
    )


def _inside(plan: trace.Plan) -> schema.Inside:
    message = plan_message(plan, "full")
    return schema.Inside(**{name: getattr(message, name) for name in schema.Inside.__struct_fields__})


def plan_of(message: schema.Plan) -> trace.Plan:
    """The plan that was sent.

    Raises:
        ValueError: It is none: what `Trajectory` refuses, an unknown status or start, an inside that does not fit or
            is too large.
    """
    size = len(msgspec.msgpack.encode((message.laps, message.inside))) if message.laps or message.inside else 0
    if size > LARGEST_INSIDE_BYTES:
        raise ValueError(f"its inside has {size} bytes, more than {LARGEST_INSIDE_BYTES}: keep less of it")
    for name, known in (("status", trace.PlanStatus), ("start", trace.PlanStart)):
        if getattr(message, name).upper() not in known.__members__:
            raise ValueError(f"{name} '{getattr(message, name)}' is none of {', '.join(known.__members__).lower()}")
    columns = (unpacked(getattr(message.trajectory, name)) for name in TRAJECTORY_COLUMNS)
    return trace.Plan(
        Trajectory(*columns),
        trace.PlanStatus[message.status.upper()],
        message.reason,
        trace.PlanStart[message.start.upper()],
        _artefacts(message.inside) if message.inside else (),
    )


def _artefacts(inside: schema.Inside) -> Sequence[trace.Artefact]:
    nothing: Any = None
    named = {name: getattr(inside, name) for name in schema.Inside.__struct_fields__}
    return tuple(artefacts_of(native.Plan("", "", "", nothing, **named)))
