"""The messages between replan and a planner in another process, version 1.

On the wire each is 4 bytes, the length of what follows (little-endian, unsigned), and a MessagePack map of the fields
below; "type" says which message it is. Replan speaks first:

    replan   hello                 frame          frame         ...  closes the channel: the drive is over
    planner         ready | failed       plan           plan | failed

A column is a MessagePack binary of little-endian float64, or (from the planner) an array of numbers; points are x, y
after one another. Frames, units and signs are those of `logs`: world frame, SI, the ego's reference point is its rear
axle, an agent's the centre of its box. What replan does not know of a message it skips; a planner should, too.
"""

from __future__ import annotations

from typing import Any

import msgspec

from logs.agents import AgentKind
from logs.mcap import native
from logs.rules import Colour
from logs.states import EgoState
from logs.vehicle import VehicleParameters

SCHEMA_VERSION = 1
LARGEST_BYTES = 64 << 20
"""A planner's message is no longer: the first four characters of any text would be a greater length."""

Column = bytes | list[float]


class Lane(msgspec.Struct):
    """`logs.road.Lane`; `left` and `right` are points."""

    id: int
    left: bytes
    right: bytes
    successors: tuple[int, ...]
    left_neighbour: int | None
    right_neighbour: int | None
    left_opposite: bool
    speed_limit: float
    drivable: bool
    left_crossable: bool
    right_crossable: bool
    kind: str
    right_opposite: bool
    yields_to: tuple[int, ...]


class StopLine(msgspec.Struct):
    """`logs.rules.StopLine`; `points` are two."""

    id: int
    lane: int
    points: bytes
    light: int | None
    must_stop: bool
    towards: tuple[int, ...]


class Crosswalk(msgspec.Struct):
    """`logs.rules.Crosswalk`; `polygon` are points."""

    id: int
    polygon: bytes


class Road(msgspec.Struct):
    """`logs.road.Road`; `source` is "lanes" or "driven_path"."""

    lanes: list[Lane]
    source: str
    drives_on_right: bool
    default_speed_limit: float
    stop_lines: list[StopLine]
    crosswalks: list[Crosswalk]


class Goal(msgspec.Struct):
    """`logs.road.Goal`; each region are points. Planners of before `alternatives` do not read them."""

    regions: list[bytes]
    t: tuple[float, float] | None
    v: tuple[float, float] | None
    yaw: tuple[float, float] | None
    alternatives: list[Goal] = []


class Context(msgspec.Struct):
    """`logs.frame.PlannerContext`: what does not change in a drive."""

    road: Road
    goal: Goal | None
    vehicle: VehicleParameters
    period: float
    start: EgoState
    horizon: float


class Hello(msgspec.Struct, tag="hello"):
    """The drive begins; answered by `Ready`. `config` is the planner's table; its inside is wanted if so it says."""

    schema: int
    planner: str
    config: dict[str, Any]
    context: Context
    keep_internals: bool


class Describe(msgspec.Struct, tag="describe"):
    """Before any drive, asked of Python planners only: does it load, what are its settings, can it plan a batch?"""

    planner: str
    config: dict[str, Any]
    batch: bool = False


class Agents(msgspec.Struct):
    """`logs.agents.Agents`: columns `(n,)`; the last three are empty where they are not known of anybody.

    Replans of before `age` do not send those, planners of before it do not read them.
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
    """`logs.frame.Predictions`: x, y, yaw row by row `(n, k)`; `agent` are places in `Agents`."""

    t: bytes
    agent: list[int]
    probability: bytes
    x: bytes
    y: bytes
    yaw: bytes
    method: str


class Visibility(msgspec.Struct):
    """`logs.frame.Visibility`; shadows are four points each."""

    x: float
    y: float
    yaw: float
    range: float
    field_of_view: float
    shadows: bytes


class Light(msgspec.Struct):
    """What a traffic light shows."""

    id: int
    colour: Colour


class Trajectory(msgspec.Struct):
    """`logs.states.Trajectory`: columns `(n,)`, n >= 1."""

    t: Column
    x: Column
    y: Column
    yaw: Column
    v: Column
    a: Column
    kappa: Column


class Inside(msgspec.Struct, omit_defaults=True):
    """What a planner wants to be seen, as the traces of replan have it (docs/results.md)."""

    decisions: list[native.Decision] = []
    costs: list[native.CostTerms] = []
    solvers: list[native.SolverReport] = []
    graphs: list[native.Graph] = []
    candidates: list[native.Candidates] = []
    lanes: list[native.LaneOption] = []


class Plan(msgspec.Struct, tag="plan", omit_defaults=True):
    """`logs.trace.Plan`: only the trajectory must be there.

    Attributes:
        trajectory: From the frame's time on.
        status: planned, previous, comfortable_stop, hard_stop or refused: all but the first need a reason.
        reason: Why, in one sentence.
        start: ego or previous_plan.
        laps: How long stages took, s, by name.
        inside: For recordings.
    """

    trajectory: Trajectory
    status: str = "planned"
    reason: str = ""
    start: str = "ego"
    laps: dict[str, float] = {}
    inside: Inside | None = None


class Frame(msgspec.Struct, tag="frame"):
    """`logs.frame.Frame`: answered by `Plan`; `previous` is the plan being driven, without its inside."""

    t: float
    ego: EgoState
    agents: Agents
    predictions: Predictions
    previous: Plan | None
    visibility: Visibility | None
    lights: list[Light]


class Ready(msgspec.Struct, tag="ready"):
    """The planner is built."""

    schema: int = SCHEMA_VERSION


class Described(msgspec.Struct, tag="described"):
    """The planner's settings with all defaults."""

    config: dict[str, Any]


class Failed(msgspec.Struct, tag="failed"):
    """No plan: it ends the drive.

    Attributes:
        message: Why, in one sentence.
        what: "raised", or "contract": its own answer was none; before a drive also "config", "load" or "build".
    """

    message: str
    what: str = "raised"


class Hellos(msgspec.Struct, tag="hellos"):
    """To Python planners only: the drives of several logs begin; answered by `Answers`, or `Failed` for all."""

    each: list[Hello]


class Frames(msgspec.Struct, tag="frames"):
    """To Python planners only: a step of these drives (`seats` are places in `Hellos`); answered as `Hellos`."""

    seats: list[int]
    each: list[Frame]


class Answers(msgspec.Struct, tag="answers"):
    """To each, in their order."""

    each: list[Ready | Plan | Failed]


Question = Hello | Describe | Frame | Hellos | Frames
Answer = Ready | Described | Plan | Failed | Answers
