"""Plans with their reasons and internals.

`Plan.internals` are generic artefacts: any planner may fill them; recording and metrics depend on
no planner's name. Graph coordinates: S-L graphs have (s, l) of the reference line, S-T graphs (t
since the frame, s along the planned path from the ego), m and s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import ClassVar, overload

import numpy as np

from replan.core.arrays import FloatArray, IntArray, Points, frozen
from replan.logs.states import Alternative, Trajectory


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
        """Whether the plan is a fallback, because the planner failed or its plan was refused."""
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
    """A stage's decision about an agent, a stop ("stop line 3") or a hidden area, with its reason.

    Attributes:
        agent: Name of the agent in `Agents.ids`, or of the stop.
        kind: The decision.
        stage: "path", "speed", or a name of the planner's own.
        reason: The reason, at most one sentence.
    """

    agent: str
    kind: DecisionKind
    stage: str
    reason: str


@dataclass(frozen=True, slots=True)
class CostTerms:
    """The cost of a stage's solution by term.

    The terms are weighted, so that their sum is the total cost.
    """

    stage: str
    terms: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class Candidates:
    """The number of candidates of a stage, and why it rejected candidates.

    Attributes:
        stage: Name of the stage.
        considered: Number of candidates.
        rejected: Reasons, each with a number of candidates; a candidate is counted once, under the
            first reason found.
        chosen: Name of the chosen candidate; empty: candidates have no names.
    """

    stage: str
    considered: int
    rejected: tuple[tuple[str, int], ...]
    chosen: str = ""


@dataclass(frozen=True, slots=True)
class LaneOption:
    """A lane for which a plan was made and compared with plans for other lanes.

    Attributes:
        name: "keep", "left" or "right".
        terms: Its cost by term, s.
        against: Why it was not chosen ("car 7 is beside"); empty: it was chosen.
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
    """The result of one solver call.

    The residuals are those that the solver reports, in the infinity norm.
    """

    stage: str
    solved: bool
    status: str
    iterations: int
    primal_residual: float
    dual_residual: float


@dataclass(frozen=True, eq=False, slots=True)
class GridCost:
    """A DP grid: `cost[i, j]` is the least cost to reach node `(first[i], second[j])`; inf: not
    reached.

    `chosen[i]` is the index j of the solution at `first[i]`, -1 if the solution ends before it.
    """

    first: FloatArray
    second: FloatArray
    cost: FloatArray
    chosen: IntArray

    def __post_init__(self) -> None:
        for name in ("first", "second"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(
            self, "cost", frozen(np.reshape(self.cost, (len(self.first), len(self.second))))
        )


@dataclass(frozen=True, eq=False, slots=True)
class Corridor:
    """Bounds `(n,)` of a solution over `first`; infinite where there is no bound."""

    first: FloatArray
    lower: FloatArray
    upper: FloatArray

    def __post_init__(self) -> None:
        for name in ("first", "lower", "upper"):
            object.__setattr__(self, name, frozen(getattr(self, name)))


@dataclass(frozen=True, eq=False, slots=True)
class GraphObstacle:
    """An agent in a graph: its outline `(k, 2)` in graph coordinates and the decision about it."""

    agent: str
    outline: Points
    decision: DecisionKind

    def __post_init__(self) -> None:
        object.__setattr__(self, "outline", frozen(self.outline))


@dataclass(frozen=True, eq=False, slots=True)
class Graph:
    """The plane of a stage's search: cost grid, corridor, DP solution `(m, 2)`, QP solution
    `(n, 2)`, obstacles.
    """

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
    """The plane in which the path was chosen: station (m) and lateral offset (m) of the reference
    line.
    """

    plane: ClassVar[str] = "sl"


@dataclass(frozen=True, eq=False, slots=True)
class StGraph(Graph):
    """The plane in which the speed was chosen: time (s from the frame) and station on the path (m
    from the ego).
    """

    plane: ClassVar[str] = "st"


Artefact = SlGraph | StGraph | Decision | CostTerms | Candidates | LaneOption | SolverReport


class Internals(Sequence[Artefact]):
    """Artefacts that `build` makes on first access, the solvers' `reports` included, which are
    always there.
    """

    def __init__(
        self, reports: tuple[SolverReport, ...], build: Callable[[], tuple[Artefact, ...]]
    ) -> None:
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
    """The output of a planner for a frame.

    Attributes:
        trajectory: States of the rear axle from the frame's time on.
        status: Whether it was planned or is a fallback.
        reason: Reason of the status, in one sentence; empty for a plan without trouble.
        start: The state at which it begins.
        internals: Artefacts that the planner exposes; `Internals` if they are built only on access.
        alternatives: The trajectories among which the planner chose, with scores, if it shows them:
            the modes of a network, the candidates of a selector. They are judged and drawn.
    """

    trajectory: Trajectory
    status: PlanStatus = PlanStatus.PLANNED
    reason: str = ""
    start: PlanStart = PlanStart.EGO
    internals: Sequence[Artefact] = ()
    alternatives: tuple[Alternative, ...] = ()

    def changed(self, change: Callable[[Trajectory], Trajectory]) -> Plan:
        """Return the plan with all its trajectories changed."""
        others = tuple(alternative.changed(change) for alternative in self.alternatives)
        return replace(self, trajectory=change(self.trajectory), alternatives=others)

    def recorded(self, *, keep: bool) -> Plan:
        """Return the plan as a trace keeps it: with all internals if `keep`, else only with those
        already built.
        """
        if isinstance(self.internals, tuple):
            return self
        internals = (
            tuple(self.internals)
            if keep or not isinstance(self.internals, Internals)
            else self.internals.reports
        )
        return replace(self, internals=internals)


@dataclass(frozen=True, slots=True)
class PlanSummary:
    """The result of a plan without its trajectory and search data: time, status, reason,
    decisions.
    """

    t: float  # time of the frame, s
    status: PlanStatus  # the status of the plan
    reason: str  # the reason of the plan
    internals: Sequence[Artefact]  # its decisions and compared lanes, among others
