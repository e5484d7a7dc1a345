"""The trace of a drive: the ego and the road users as they moved, the plans, and why it ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from replan.core.arrays import FloatArray, IntArray, frozen
from replan.logs.frame import Frame, Predictions, Visibility
from replan.logs.plan import Plan, PlanSummary
from replan.logs.states import Controls, Trajectory
from replan.logs.tracks import Tracks

KEPT_STEP_S = 0.5
"""Time step of the predictions in a trace, and of trajectories in a trace file without internals,
s.
"""


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
    """Deviation of the ego from its plan, `(n,)` each."""

    t: FloatArray  # s since the scenario's start
    lateral: FloatArray  # distance of the ego from the plan's path, positive to the left, m
    heading: FloatArray  # heading error, rad, principal value
    speed: FloatArray  # ego minus plan at this time, m/s
    station: FloatArray  # ego minus plan at this time, along the path, m


@dataclass(frozen=True, eq=False, slots=True)
class PlannedFrame:
    """One frame of a trace: its time, the plan, and the predictions of the agents."""

    t: float  # s since the scenario's start
    plan: Plan  # the planner's output
    agents: tuple[str, ...] = ()  # ids of the agents in the frame, in the same order
    # predictions that the planner got, at the step `KEPT_STEP_S`; None: not kept
    predictions: Predictions | None = None
    visibility: Visibility | None = None  # the ground that the sensor saw; None: everything

    @property
    def summary(self) -> PlanSummary:
        """The result of the plan without its trajectory and search data."""
        return PlanSummary(self.t, self.plan.status, self.plan.reason, self.plan.internals)

    @classmethod
    def of(cls, frame: Frame, plan: Plan) -> PlannedFrame:
        """Make the record of a frame from the plan as kept (`Plan.recorded`) and the frame's kept
        part.
        """
        predicted, samples = frame.predictions, kept_samples(frame.predictions.t)
        # Frozen once for all
        x, y, yaw = frozen(
            np.array([predicted.x[:, samples], predicted.y[:, samples], predicted.yaw[:, samples]])
        )
        thinned = type(predicted)(
            predicted.t[samples],
            predicted.agent,
            predicted.probability,
            x,
            y,
            yaw,
            predicted.method,
        )
        return cls(frame.t, plan, frame.agents.ids, thinned, frame.visibility)


def kept_samples(t: FloatArray, step: float = KEPT_STEP_S) -> slice | IntArray:
    """Return the samples `(n,)` to keep: one every `step` s, and the last."""
    stride = max(1, round(step / float(t[1] - t[0]))) if len(t) > 1 else 1
    if (len(t) - 1) % stride == 0:
        return slice(None, None, stride)
    return np.append(np.arange(0, len(t), stride), len(t) - 1)


@dataclass(frozen=True, eq=False)
class Trace:
    """One drive of one planner over one scenario. It contains no wall-clock times.

    Attributes:
        scenario: Name of the scenario.
        planner: Name of the planner as the user wrote it.
        mode: Open or closed loop.
        oracle: Whether the planner knew the log's future.
        ego: The driven states: at the control rate in closed loop, at the frames in open loop.
        agents: The true motion of the agents.
        frames: The plans, in order of time; a tuple, or a `replan.logs.frame_store.FrameStore` for
            a long drive.
        commands: Commands of the controller at `ego.t`; None in open loop.
        actuation: States of the actuators at `ego.t`; None in open loop.
        tracking: Tracking errors at `ego.t`; None in open loop.
        end: Reason for the end of the drive.
        detail: The agent or place that caused the end ("car 12").
        notes: Facts needed to read the results, one sentence each.
        perceived: The agents as the planner perceived them, one sample per frame in which it did;
            None: without a sensor (`agents.perceived`).
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
