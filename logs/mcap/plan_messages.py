"""The messages of plans, of what the planner reports about them, and of predictions.

Infinity is null in the graphs of a plan: "not reached" and "free".
"""

from __future__ import annotations

from typing import Literal

import msgspec

from replan.logs.mcap.field_names import serialised
from replan.logs.plan import DecisionKind

Numbers = list[float | None]
Points = list[Numbers]


class TrajectoryColumns(msgspec.Struct, rename=serialised):
    """Planned states; t is the time since the scenario's start."""

    t: list[float]
    x: list[float]
    y: list[float]
    yaw: list[float]
    v: list[float]
    a: list[float]
    kappa: list[float]


class Alternative(msgspec.Struct, omit_defaults=True):
    """A trajectory among which a planner chose: its score (higher is better; null = none) and
    name.
    """

    trajectory: TrajectoryColumns
    score: float | None = None
    name: str = ""


class OnboardPlan(msgspec.Struct, omit_defaults=True):
    """A plan that the log's own planner made, and those among which it chose."""

    trajectory: TrajectoryColumns
    alternatives: list[Alternative] = []


class Decision(msgspec.Struct):
    """What was decided about an agent in a stage, and why."""

    agent: str
    kind: DecisionKind
    stage: str
    reason: str


class CostTerms(msgspec.Struct):
    """The weighted cost of what a stage chose, by term."""

    stage: str
    terms: dict[str, float | None]


class Candidates(msgspec.Struct, omit_defaults=True):
    """How many candidates a stage had, how many it rejected for which reason, and the name of the
    chosen one, if they have names.
    """

    stage: str
    considered: int
    rejected: dict[str, int]
    chosen: str = ""


class LaneOption(msgspec.Struct):
    """A lane that was compared: its cost by term, s, and why it was not taken (empty: it was)."""

    name: str
    terms: dict[str, float | None]
    against: str


class SolverReport(msgspec.Struct):
    """One call of a solver."""

    stage: str
    solved: bool
    status: str
    iterations: int
    primal_residual: float | None
    dual_residual: float | None


class Grid(msgspec.Struct):
    """DP grid: least cost to come to node (first[i], second[j]), null = not reached.

    Chosen -1 = none.
    """

    first: list[float]
    second: list[float]
    cost: Points
    chosen: list[int]


class Corridor(msgspec.Struct):
    """Bounds of the solution over first; null = free."""

    first: list[float]
    lower: Numbers
    upper: Numbers


class GraphObstacle(msgspec.Struct):
    """An agent in a graph: outline as points, and what was decided about it."""

    agent: str
    outline: Points
    decision: DecisionKind


class Graph(msgspec.Struct):
    """A plane in which a stage searched.

    "sl": (station m, offset m); "st": (time from the plan s, station m).
    """

    plane: Literal["sl", "st"]
    grid: Grid | None
    corridor: Corridor | None
    dp: Points
    qp: Points
    obstacles: list[GraphObstacle]


class Plan(msgspec.Struct):
    """A plan: how it came about, its trajectory, what the planner wanted to be seen, and the
    trajectories among which it chose.
    """

    status: str
    reason: str
    start: str
    trajectory: TrajectoryColumns
    decisions: list[Decision] = []
    costs: list[CostTerms] = []
    solvers: list[SolverReport] = []
    graphs: list[Graph] = []
    candidates: list[Candidates] = []
    lanes: list[LaneOption] = []
    alternatives: list[Alternative] = []


class PlanHead(msgspec.Struct):
    """The summary of a plan; it is decoded ten times faster than the whole plan."""

    status: str
    reason: str
    decisions: list[Decision] = []
    lanes: list[LaneOption] = []


class Predictions(msgspec.Struct, rename=serialised):
    """Assumed futures: row i of x and y are the box centres of agent id[i] at the times t.

    Ids may come repeatedly.
    """

    method: str
    t: list[float]
    id: list[str]
    probability: list[float]
    x: list[list[float]]
    y: list[list[float]]
