"""What a planner may know: one Frame at a time, and a context that does not change.

A Frame holds present and past, and the predictions that replay put there; it has no way to the log's future.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from logs.kernel import FloatArray, IntArray, frozen
from logs.road import Goal, Road
from logs.scenario import Agents
from logs.states import EgoState
from logs.vehicle import VehicleParameters

if TYPE_CHECKING:
    from logs.trace import Plan


@dataclass(frozen=True, eq=False, slots=True)
class Predictions:
    """Futures of the agents as they may be assumed, all on one time grid.

    Attributes:
        t: `(k,)` s since the scenario's start; the first is the frame's time.
        agent: `(n,)` index into `Frame.agents`; several hypotheses may share an agent.
        probability: `(n,)`; sums to 1 over an agent's hypotheses.
        x: `(n, k)` box centre, world, m; `y` likewise; `yaw` rad.
        method: Name of the predictor; "oracle" marks one that knows the log.
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
class Frame:
    """The situation at one instant.

    Attributes:
        t: s since the scenario's start.
        ego: State at the rear axle.
        agents: As perceived: no sample later than `t` went into them.
        predictions: Their assumed futures.
        previous: The plan being driven now; None in open loop and at the start. A planner given None must not use
            anything it remembers (solver warm starts included).
    """

    t: float
    ego: EgoState
    agents: Agents
    predictions: Predictions
    previous: Plan | None = None


def _no_clock(stage: str) -> None:
    """Stage times are not measured."""


@dataclass(frozen=True, eq=False, slots=True)
class PlannerContext:
    """What a planner is built with; one planner serves one scenario.

    Attributes:
        road: The lanes; always at least one.
        goal: Where to go; None where nobody knows: then straight on.
        vehicle: The ego's parameters.
        period: Time between two frames, s.
        start: The ego's state at the first frame.
        lap: Call `lap("stage")` when a stage of the plan has ended: replay measures the time.
    """

    road: Road
    goal: Goal | None
    vehicle: VehicleParameters
    period: float
    start: EgoState
    lap: Callable[[str], None] = _no_clock
