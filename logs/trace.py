"""What happened: plans with their reasons and internals, and the trace of a drive.

`Plan.internals` are generic artefacts: any planner may fill them; recording and metrics know no planner by name.
Graph coordinates: S-L graphs have (s, l) of the reference line, S-T graphs (t since the frame, s along the planned
path from the ego), m and s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, ClassVar, overload

import numpy as np

from logs.kernel import FloatArray, IntArray, Points, frozen
from logs.scenario import Tracks
from logs.states import Controls, Trajectory

if TYPE_CHECKING:
    from logs.frame import Frame, Predictions, Visibility

KEPT_STEP_S = 0.5
"""Predictions are kept in a trace at this step, and so are plans without internals."""


class PlanStatus(Enum):
    """How a plan came about; the value is the sentence that the user reads."""

    PLANNED = "planned"
    CORRECTED = "planned; columns that contradicted its positions were computed anew from them"
    PREVIOUS = "a stage failed: the previous plan goes on"
    COMFORTABLE_STOP = "a stage failed: comfortable stop along the last path"
    HARD_STOP = "a stage failed: hard stop along the last path"
    REFUSED = "the plan was refused: what was driven before goes on"

    @property
    def is_fallback(self) -> bool:
        """Whether the planner could not plan."""
        return self not in (PlanStatus.PLANNED, PlanStatus.CORRECTED)


class PlanStart(Enum):
    """Where a plan begins."""

    EGO = "at the ego"
    PREVIOUS_PLAN = "on the previous plan"


class DecisionKind(Enum):
    """What is to be done about an agent."""

    IGNORE = "ignore"
    NUDGE_LEFT = "nudge left"
    NUDGE_RIGHT = "nudge right"
    STOP = "stop"
    FOLLOW = "follow"
    YIELD = "yield"
    OVERTAKE = "overtake"


@dataclass(frozen=True, slots=True)
class Decision:
    """What was decided in a stage ("path", "speed") about an agent, a stop ("stop line 3") or hidden ground; why.

    Attributes:
        agent: Its name in `Agents.ids`, or that of the stop.
        kind: What is to be done.
        stage: "path" or "speed".
        reason: In one sentence or less.
    """

    agent: str
    kind: DecisionKind
    stage: str
    reason: str


@dataclass(frozen=True, slots=True)
class CostTerms:
    """The cost of what a stage chose, by term (weighted, so that they add up)."""

    stage: str
    terms: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class Candidates:
    """What a stage chose from, and why it took none of the others.

    Attributes:
        stage: Name of the stage.
        considered: How many candidates there were.
        rejected: Reason and number; each candidate is counted once, under the first reason that was found.
    """

    stage: str
    considered: int
    rejected: tuple[tuple[str, int], ...]


@dataclass(frozen=True, slots=True)
class LaneOption:
    """A lane that a plan was made for and compared with others.

    Attributes:
        name: "keep", "left" or "right".
        terms: What it costs, by term, s.
        against: Why it was not taken ("car 7 is beside"); empty: it was.
    """

    name: str
    terms: tuple[tuple[str, float], ...]
    against: str = ""

    @property
    def cost(self) -> float:
        """Sum of the terms, s."""
        return sum(value for _, value in self.terms)


@dataclass(frozen=True, slots=True)
class SolverReport:
    """One call of a solver; residuals are the solver's own, infinity norm."""

    stage: str
    solved: bool
    status: str
    iterations: int
    primal_residual: float
    dual_residual: float


@dataclass(frozen=True, eq=False, slots=True)
class GridCost:
    """A DP grid: `cost[i, j]` is the least cost to come to node `(first[i], second[j])`; inf = not reached.

    `chosen[i]` is the second index of the solution in column i, -1 where the solution does not reach.
    """

    first: FloatArray
    second: FloatArray
    cost: FloatArray
    chosen: IntArray

    def __post_init__(self) -> None:
        for name in ("first", "second"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "cost", frozen(np.reshape(self.cost, (len(self.first), len(self.second)))))


@dataclass(frozen=True, eq=False, slots=True)
class Corridor:
    """Bounds `(n,)` of a solution over `first`; infinite where free."""

    first: FloatArray
    lower: FloatArray
    upper: FloatArray

    def __post_init__(self) -> None:
        for name in ("first", "lower", "upper"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


@dataclass(frozen=True, eq=False, slots=True)
class GraphObstacle:
    """An agent in a graph: its outline `(k, 2)` in graph coordinates and what was decided about it."""

    agent: str
    outline: Points
    decision: DecisionKind

    def __post_init__(self) -> None:
        object.__setattr__(self, "outline", frozen(self.outline))


@dataclass(frozen=True, eq=False, slots=True)
class Graph:
    """A plane in which a stage searched: DP solution `(m, 2)`, QP solution `(n, 2)`, corridor, obstacles."""

    grid: GridCost | None
    corridor: Corridor | None
    dp: Points
    qp: Points
    obstacles: tuple[GraphObstacle, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "dp", frozen(self.dp))
        object.__setattr__(self, "qp", frozen(self.qp))


@dataclass(frozen=True, eq=False, slots=True)
class SlGraph(Graph):
    """Station (m) and lateral offset (m) of the reference line: where the path was chosen."""

    plane: ClassVar[str] = "sl"


@dataclass(frozen=True, eq=False, slots=True)
class StGraph(Graph):
    """Time (s from the frame) and station along the path (m from the ego): where the speed was chosen."""

    plane: ClassVar[str] = "st"


Artefact = SlGraph | StGraph | Decision | CostTerms | Candidates | LaneOption | SolverReport


class Internals(Sequence[Artefact]):
    """Artefacts that are built when they are first looked at.

    Args:
        reports: Of the solvers: there in any case.
        build: Makes all artefacts, the reports among them.
    """

    def __init__(self, reports: tuple[SolverReport, ...], build: Callable[[], tuple[Artefact, ...]]) -> None:
        self.reports = reports
        self._build = build
        self._all: tuple[Artefact, ...] | None = None

    def _build_internals(self) -> tuple[Artefact, ...]:
        if self._all is None:
            self._all = self._build()
        return self._all

    @overload
    def __getitem__(self, index: int) -> Artefact: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Artefact, ...]: ...

    def __getitem__(self, index: int | slice) -> Artefact | tuple[Artefact, ...]:
        return self._build_internals()[index]

    def __len__(self) -> int:
        return len(self._build_internals())


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """What a planner answers to a frame.

    Attributes:
        trajectory: From the frame's time on, at the rear axle.
        status: Whether it was planned or is a fallback.
        reason: Why, in one sentence; empty for a plan without trouble.
        start: Where it begins.
        internals: What the planner wants to be seen; `Internals` where that is built only for who looks at it.
    """

    trajectory: Trajectory
    status: PlanStatus = PlanStatus.PLANNED
    reason: str = ""
    start: PlanStart = PlanStart.EGO
    internals: Sequence[Artefact] = ()

    def recorded(self, *, keep: bool) -> Plan:
        """The plan as a trace keeps it: with its internals built, or with no more of them than is there anyway."""
        if isinstance(self.internals, tuple):
            return self
        kept = tuple(self.internals) if keep or not isinstance(self.internals, Internals) else self.internals.reports
        return replace(self, internals=kept)


@dataclass(frozen=True, slots=True)
class PlanSummary:
    """The result of a plan without its trajectory and search data: time, status, reason, decisions.

    Attributes:
        t: Time of its frame, s.
        status: The status of the plan.
        reason: The reason of the plan.
        internals: Its decisions and compared lanes, among others.
    """

    t: float
    status: PlanStatus
    reason: str
    internals: Sequence[Artefact]


class Mode(Enum):
    """Open loop: the ego is the log's. Closed loop: the ego is driven."""

    OPEN = "open"
    CLOSED = "closed"


class EndReason(Enum):
    """Why a drive ended; the value is the sentence that the user reads."""

    END_OF_LOG = "end of the log"
    GOAL = "goal reached"
    COLLISION = "collision"
    REPLAY_CONTACT = "the replay ran into the ego"
    OFF_ROAD = "left the road"
    PLANNER_FAILURE = "the planner failed"


@dataclass(frozen=True, eq=False, slots=True)
class TrackingErrors:
    """How far the ego was off its plan, `(n,)` each.

    Attributes:
        t: s.
        lateral: Ego to the plan's path, positive left of it, m.
        heading: rad, principal value.
        speed: Ego minus plan at this time, m/s.
        station: Ego minus plan at this time, along the path, m.
    """

    t: FloatArray
    lateral: FloatArray
    heading: FloatArray
    speed: FloatArray
    station: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class PlannedFrame:
    """One frame of a trace: when, what was planned, and what was assumed of the others.

    Attributes:
        t: s since the scenario's start.
        plan: The planner's answer.
        agents: Ids of the agents in the frame, in its order.
        predictions: Their futures as the planner was shown them, at `KEPT_STEP_S`; None: not kept.
        visibility: What the sensor saw of the ground; None: everything.
    """

    t: float
    plan: Plan
    agents: tuple[str, ...] = ()
    predictions: Predictions | None = None
    visibility: Visibility | None = None

    @property
    def summary(self) -> PlanSummary:
        """The result of the plan without its trajectory and search data."""
        return PlanSummary(self.t, self.plan.status, self.plan.reason, self.plan.internals)

    @classmethod
    def of(cls, frame: Frame, plan: Plan) -> PlannedFrame:
        """The plan for a frame, as it is kept (`Plan.recorded`), with what a trace keeps of the frame."""
        some, kept = frame.predictions, kept_samples(frame.predictions.t)
        x, y, yaw = frozen(np.array([some.x[:, kept], some.y[:, kept], some.yaw[:, kept]]))  # once: they are not copied
        thinned = type(some)(some.t[kept], some.agent, some.probability, x, y, yaw, some.method)
        return cls(frame.t, plan, frame.agents.ids, thinned, frame.visibility)


def kept_samples(t: FloatArray, step: float = KEPT_STEP_S) -> slice | IntArray:
    """Which of the samples `(n,)` are kept: each that is `step` (s) after the one before, and the last."""
    stride = max(1, round(step / float(t[1] - t[0]))) if len(t) > 1 else 1
    if (len(t) - 1) % stride == 0:
        return slice(None, None, stride)
    return np.append(np.arange(0, len(t), stride), len(t) - 1)


@dataclass(frozen=True, eq=False)
class Trace:
    """One drive of one planner over one scenario. No wall-clock time is in it.

    Attributes:
        scenario: Its name.
        planner: As the user named it.
        mode: Open or closed loop.
        oracle: Whether the planner knew the log's future.
        ego: As driven: at the control rate in closed loop, on the frame grid in open loop.
        agents: As they moved.
        frames: The plans, in order of time; a tuple, of a long drive a `logs.memory.FrameStore`.
        commands: What the controller asked for, on `ego.t`; None in open loop.
        actuation: What the actuators did, on `ego.t`; None in open loop.
        tracking: On `ego.t`; None in open loop.
        end: Why it ended.
        detail: With what, where ("car 12").
        notes: What the user must know to read the results, one sentence each.
        perceived: The agents as the planner was shown them, a sample per frame in which it was; None: as they are
            known without a sensor (`agents.perceived`).
    """

    scenario: str
    planner: str
    mode: Mode
    oracle: bool
    ego: Trajectory
    agents: Tracks
    frames: Sequence[PlannedFrame]
    end: EndReason
    detail: str = ""
    commands: Controls | None = None
    actuation: Controls | None = None
    tracking: TrackingErrors | None = None
    notes: tuple[str, ...] = ()
    perceived: Tracks | None = None
