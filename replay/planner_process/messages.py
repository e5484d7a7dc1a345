"""The messages between replan and a planner in another process, version 1.

On the wire each is 4 bytes, the length of the rest (little-endian, unsigned), and a MessagePack map
of the fields below; "type" names the message. Replan sends the first message:

    replan   hello                 frame          frame         ...  closes the channel: the drive
             is over
    planner         ready | failed       plan           plan | failed

A column is a MessagePack binary of little-endian float64, or (from the planner) an array of
numbers; points are x, y after one another. Frames, units and signs are those of `logs`: world
frame, SI, the ego's reference point is its rear axle, an agent's the centre of its box. A reader
skips the fields that it does not know, and a planner should, too.

Lanes, stop lines, crosswalks, goals, the ego's state, the vehicle and the visibility are the nouns
themselves, with arrays as columns (`replan.logs.codec`). The other nouns have a message here,
because some of their fields are not sent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from replan.core.arrays import Points
from replan.logs import agents, frame, past, plan as nouns, states
from replan.logs.agents import AgentKind, ObjectClass
from replan.logs.codec import Column, array_as_bytes, array_of, message_of, noun_of, unpacked
from replan.logs.lane_route import RouteSource
from replan.logs.mcap import plan_messages
from replan.logs.mcap.trace_file import artefacts_of, inside_of
from replan.logs.past import PastSource
from replan.logs.road import Goal, Lane
from replan.logs.rules import Colour, Crosswalk, StopLine
from replan.logs.states import EgoState
from replan.logs.vehicle import VehicleParameters
from replan.replay.planner_process.coordinates import Coordinates

SCHEMA_VERSION = 1
LARGEST_BYTES = 67_108_864
"""The largest length of a planner's message: any four text characters, read as a length, exceed
it.
"""
MOST_POINTS = (
    # States of a trajectory: 100 s at 100 Hz. A longer plan is refused
    # (`replan.replay.loop.plan_check`).
    10_000
)
LONGEST_REASON = 1000  # Characters of a reason or an error message. A longer one is cut and marked.
MOST_STAGES = 100  # Stages of a plan; `dp_qp` has about 10
LARGEST_INSIDE_BYTES = 8_388_608
"""Largest size of the internals and timings of one plan, as MessagePack.

Those of `dp_qp` have about 10 KiB.
"""


class Road(msgspec.Struct, omit_defaults=True):
    """`replan.logs.road.Road`; `source` is "lanes" or "driven_path". Older planners do not read the
    fields with defaults.
    """

    lanes: list[Lane]
    source: str
    drives_on_right: bool
    default_speed_limit: float
    stop_lines: list[StopLine]
    crosswalks: list[Crosswalk]
    areas: list[Points] = []
    car_parks: list[Points] = []
    intersections: list[Points] = []
    assumed_limits: list[int] = []


class Route(msgspec.Struct):
    """`replan.logs.lane_route.LaneRoute`; `source` is "log", "goal" or "drive"."""

    lanes: list[int] = []
    source: RouteSource = RouteSource.GOAL


class Context(msgspec.Struct):
    """`replan.logs.frame.PlannerContext`: constant in a drive.

    Older planners do not read `goal.alternatives` and the fields with defaults.
    """

    road: Road
    goal: Goal | None
    vehicle: VehicleParameters
    period: float
    start: EgoState
    horizon: float
    origin: tuple[float, float] = (0.0, 0.0)
    route: Route = msgspec.field(default_factory=Route)
    light_lanes: dict[int, tuple[int, ...]] = {}
    start_ns: int = 0


class Hello(msgspec.Struct, tag="hello"):
    """The drive begins; answered by `Ready`.

    `config` is the planner's table; `keep_internals` asks for internals.
    """

    schema: int
    planner: str
    config: dict[str, Any]
    context: Context
    keep_internals: bool


class Describe(msgspec.Struct, tag="describe"):
    """Before any drive, to Python planners only: checks that it loads and can plan a batch.

    Asks for its settings.
    """

    planner: str
    config: dict[str, Any]
    batch: bool = False


class Agents(msgspec.Struct):
    """`replan.logs.agents.Agents`: columns `(n,)`; the last three are empty if they are unknown for
    all agents.

    Versions of replan before `age` did not send them, and planners of that time do not read them.
    """

    ids: tuple[str, ...]
    kinds: tuple[AgentKind, ...]
    length: bytes
    width: bytes
    x: bytes
    y: bytes
    yaw: bytes
    vx: bytes
    vy: bytes
    yaw_rate: bytes
    accel: bytes
    age: bytes = b""
    unseen: bytes = b""
    velocity_sigma: bytes = b""


class Predictions(msgspec.Struct):
    """`replan.logs.frame.Predictions`: x, y, yaw row by row `(n, k)`; `agent` are places in
    `Agents`.
    """

    t: bytes
    agent: list[int]
    probability: bytes
    x: bytes
    y: bytes
    yaw: bytes
    method: str


class Light(msgspec.Struct):
    """The colour of a traffic light."""

    id: int
    colour: Colour


class Trajectory(msgspec.Struct):
    """`replan.logs.states.Trajectory`: columns `(n,)`, n >= 1."""

    t: Column
    x: Column
    y: Column
    yaw: Column
    v: Column
    a: Column
    kappa: Column


class Inside(msgspec.Struct, omit_defaults=True):
    """The internals that a planner shows, in the form of replan's traces (docs/results.md)."""

    decisions: list[plan_messages.Decision] = []
    costs: list[plan_messages.CostTerms] = []
    solvers: list[plan_messages.SolverReport] = []
    graphs: list[plan_messages.Graph] = []
    candidates: list[plan_messages.Candidates] = []
    lanes: list[plan_messages.LaneOption] = []


class Alternative(msgspec.Struct, omit_defaults=True):
    """`replan.logs.states.Alternative`: a score that is null or left out is none."""

    trajectory: Trajectory
    score: float | None = None
    name: str = ""


class Plan(msgspec.Struct, tag="plan", omit_defaults=True):
    """`replan.logs.plan.Plan`: only the trajectory is required.

    Attributes:
        trajectory: The trajectory from the frame's time on.
        status: planned, previous, comfortable_stop, hard_stop or refused: all but the first need a
            reason.
        reason: The reason, in one sentence.
        start: ego or previous_plan.
        laps: Durations of stages by name, s.
        inside: The internals, for recordings.
        alternatives: The trajectories among which the planner chose.
    """

    trajectory: Trajectory
    status: str = "planned"
    reason: str = ""
    start: str = "ego"
    laps: dict[str, float] = {}
    inside: Inside | None = None
    alternatives: list[Alternative] = []


class Snapshot(msgspec.Struct):
    """`replan.logs.past.Snapshot`: what was known at an earlier time; `source` is "log" or "held"
    before the first frame of the drive.
    """

    t: float
    ego: EgoState
    agents: Agents
    lights: list[Light]
    source: PastSource


class Frame(msgspec.Struct, tag="frame", omit_defaults=True):
    """`replan.logs.frame.Frame`: answered by `Plan`; `previous` is the plan being driven, without
    its internals. `earlier`: snapshots of the past that were not sent yet, to planners that ask.
    """

    t: float
    ego: EgoState
    agents: Agents
    predictions: Predictions
    previous: Plan | None
    visibility: frame.Visibility | None
    lights: list[Light]
    earlier: list[Snapshot] = []
    object_classes: dict[str, ObjectClass] = {}


class Ready(msgspec.Struct, tag="ready"):
    """The planner is built.

    Attributes:
        schema: The version of the messages that it speaks.
        coordinates: Those of the frames that it gets from now on, and of its plans: "world" or
            "map".
        past_s: Length of the past that it asks for, s, at most 2.1: frames then have `earlier`.
    """

    schema: int = SCHEMA_VERSION
    coordinates: Coordinates = "world"
    past_s: float = 0.0


class Described(msgspec.Struct, tag="described"):
    """The planner's settings with all defaults."""

    config: dict[str, Any]


class Failed(msgspec.Struct, tag="failed"):
    """No plan: it ends the drive.

    Attributes:
        message: The reason, in one sentence.
        what: "raised", or "contract" for an invalid answer of the planner; before a drive
            also "config", "load" or "build".
    """

    message: str
    what: str = "raised"


class Hellos(msgspec.Struct, tag="hellos"):
    """To Python planners only: the drives of several logs begin.

    Answered by `Answers`, or `Failed` for all.
    """

    each: list[Hello]


class Frames(msgspec.Struct, tag="frames"):
    """To Python planners only: a step of these drives (`seats` are places in `Hellos`).

    Answered as `Hellos`.
    """

    seats: list[int]
    each: list[Frame]


class Answers(msgspec.Struct, tag="answers"):
    """The answers to each message, in order."""

    each: list[Ready | Plan | Failed]


Question = Hello | Describe | Frame | Hellos | Frames
Answer = Ready | Described | Plan | Failed | Answers


def encode(message: object) -> bytes:
    """Encode a message, or a struct with messages, as MessagePack; TypeError if a value cannot be
    sent.
    """
    return msgspec.msgpack.encode(message, enc_hook=array_as_bytes)


def decode(data: bytes, kind: Any) -> Any:
    """Decode a message of a type from MessagePack; msgspec.DecodeError if it is invalid."""
    return msgspec.msgpack.decode(data, type=kind, dec_hook=array_of)


def shortened(text: str) -> str:
    """The text, or its beginning and its original length: at most `LONGEST_REASON` characters."""
    if len(text) <= LONGEST_REASON:
        return text
    mark = f" ... (cut, {len(text)} characters)"
    return text[: LONGEST_REASON - len(mark)] + mark


def context_message(context: frame.PlannerContext) -> Context:
    """The message of a context."""
    return message_of(Context, context, light_lanes=dict(context.light_lanes))


def context_of(message: Context, lap: Callable[[str], None]) -> frame.PlannerContext:
    """The context of a message; `lap` is the planner's clock."""
    light_lanes = dict(message.light_lanes)  # ids, no nouns by id
    return noun_of(frame.PlannerContext, message, lap=lap, light_lanes=light_lanes)


def frame_message(now: frame.Frame) -> Frame:
    """The message of a frame."""
    return Frame(
        t=now.t,
        ego=now.ego,
        agents=message_of(Agents, now.agents),
        predictions=message_of(Predictions, now.predictions),
        previous=None if now.previous is None else plan_message(now.previous),
        visibility=now.visibility,
        lights=_light_messages(now.lights),
        object_classes=dict(now.object_classes),
    )


def _light_messages(lights: Mapping[int, Colour]) -> list[Light]:
    return [Light(light, colour) for light, colour in lights.items()]


def snapshot_message(snapshot: past.Snapshot) -> Snapshot:
    """The message of a snapshot."""
    agents_then, lights = message_of(Agents, snapshot.agents), _light_messages(snapshot.lights)
    return Snapshot(snapshot.t, snapshot.ego, agents_then, lights, snapshot.source)


def snapshot_of(message: Snapshot) -> past.Snapshot:
    """The snapshot of a message."""
    return past.Snapshot(
        message.t,
        message.ego,
        noun_of(agents.Agents, message.agents),
        {light.id: light.colour for light in message.lights},
        message.source,
    )


def frame_of(message: Frame) -> frame.Frame:
    """The frame of a message."""
    predictions = message.predictions
    shape = (len(predictions.agent), len(unpacked(predictions.t)))
    futures: dict[str, Any] = {
        name: unpacked(getattr(predictions, name)).reshape(shape) for name in ("x", "y", "yaw")
    }
    return frame.Frame(
        message.t,
        message.ego,
        noun_of(agents.Agents, message.agents),
        noun_of(frame.Predictions, predictions, **futures),
        None if message.previous is None else plan_of(message.previous),
        message.visibility,
        {light.id: light.colour for light in message.lights},
        object_classes=message.object_classes,
    )


def plan_message(
    plan: nouns.Plan, laps: dict[str, float] | None = None, *, inside: bool = False
) -> Plan:
    """The message of a plan, with or without its internals and alternatives."""
    shown = Inside(**inside_of(plan.internals)) if inside and len(plan.internals) else None
    alternatives = plan.alternatives if inside else ()
    return Plan(
        message_of(Trajectory, plan.trajectory),
        plan.status.name.lower(),
        shortened(plan.reason),
        plan.start.name.lower(),
        laps or {},
        shown,
        [message_of(Alternative, alternative) for alternative in alternatives],
    )


def plan_of(message: Plan) -> nouns.Plan:
    """The plan of a message.

    ValueError if `Trajectory` refuses it, its status or start is unknown, it has too many stages,
    or its inside does not fit or is too large.
    """
    more = (message.laps, message.inside, message.alternatives)
    size = len(msgspec.msgpack.encode(more)) if any(more) else 0
    if size > LARGEST_INSIDE_BYTES:
        raise ValueError(
            f"its inside and its alternatives have {size} bytes, more than "
            f"{LARGEST_INSIDE_BYTES}: keep less of them"
        )
    if len(message.laps) > MOST_STAGES:
        raise ValueError(f"it names {len(message.laps)} stages, more than {MOST_STAGES}")
    for name, known in (("status", nouns.PlanStatus), ("start", nouns.PlanStart)):
        if getattr(message, name).upper() not in known.__members__:
            raise ValueError(
                f"{name} '{getattr(message, name)}' is none of "
                f"{', '.join(known.__members__).lower()}"
            )
    return nouns.Plan(
        noun_of(states.Trajectory, message.trajectory),
        nouns.PlanStatus[message.status.upper()],
        message.reason,
        nouns.PlanStart[message.start.upper()],
        tuple(artefacts_of(message.inside)) if message.inside else (),
        tuple(noun_of(states.Alternative, alternative) for alternative in message.alternatives),
    )
