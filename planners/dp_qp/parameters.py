"""Settings of `dp_qp`: of its stages, of the choice between lanes, and of the planner as a whole."""

from __future__ import annotations

from dataclasses import astuple, dataclass, field

from planners.dp_qp.path.stage import PathConfig
from planners.dp_qp.speed.stage import SpeedConfig
from planners.frenet.scene import STITCH_M, STITCH_MPS
from planners.piecewise_jerk.solvers import DEFAULT, check_solver
from planners.rules import RulesConfig


@dataclass(frozen=True)
class LaneConfig:
    """Settings of the lane choice; costs are in seconds of equivalent time.

    Attributes:
        hysteresis_s: Amount by which another lane, or passing, must be cheaper than keeping the lane.
        look_s: Time lost to other agents from which the neighbouring lanes are planned.
        dwell_s: No further change and no new attempt to pass within this time, unless the lane fails.
        route_s: Cost of a lane change that the route needs.
        urgency_s: Cost that is added to it as the change becomes due.
        due_s: Changes are urgent where less than this time per change is left until they are due.
        dead_end_s: Cost of a lane from which the goal cannot be reached.
        change_s: Cost of leaving the driven lane, so that only a clear gain leads to a change.
        hard_s: Cost where comfortable braking cannot keep the distance.
        failed_s: Cost where no braking can, or a stage failed: more than all others together.
    """

    hysteresis_s: float = 0.5
    look_s: float = 1.0
    dwell_s: float = 3.0
    route_s: float = 1.6
    urgency_s: float = 6.0
    due_s: float = 15.0
    dead_end_s: float = 25.0
    change_s: float = 1.0
    hard_s: float = 3.0
    failed_s: float = 50.0

    def __post_init__(self) -> None:
        if not min(astuple(self)) >= 0.0:
            raise ValueError("settings of the lane choice must not be negative")
        if not self.due_s > 0.0:
            raise ValueError("due_s must be positive")


@dataclass(frozen=True)
class DpQpConfig:
    """Settings of `dp_qp`.

    Attributes:
        path: The path stage.
        speed: The speed stage.
        lane: The choice between lanes, and of passing.
        rules: Settings of the traffic rules.
        solver: Solver of the path and speed QPs: "interior_point", "osqp" or "piqp".
        stitch_m: The plan starts on the previous one where the ego is nearer to it than this; else at the ego.
        stitch_mps: The plan starts on the previous one where the ego's speed is nearer to its speed than this.
    """

    path: PathConfig = field(default_factory=PathConfig)
    speed: SpeedConfig = field(default_factory=SpeedConfig)
    lane: LaneConfig = field(default_factory=LaneConfig)
    rules: RulesConfig = field(default_factory=RulesConfig)
    solver: str = DEFAULT
    stitch_m: float = STITCH_M
    stitch_mps: float = STITCH_MPS

    def __post_init__(self) -> None:
        check_solver(self.solver)
