"""Two drivers that a log should fail: `blind` looks at nothing but the road, `parked` does not
drive.

A log that a parked driver passes cannot tell drivers apart. In a log that a blind driver passes,
nothing was in the way. `replan.replay.loop.reference_drives` drives both in every log, and
`replan.metrics.judge.discrimination` judges them.

`blind` is the Intelligent Driver Model (`replan.planners.idm`) on the same route, within the limits
and curves of its lanes, without road users, lights, stop lines, crosswalks, and right of way.
`parked` follows the same path: with its speed v, the desired speed u and t from the frame on,

(1) v(t) = u + the comfortable braking profile of v - u       where v > u
(2) v(t) = min(u, v + `GAIN_MPS2` t)                          else
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from msgspec import Meta

from replan.core.once import once
from replan.logs.frame import Frame, PlannerContext, Predictions
from replan.logs.plan import Plan
from replan.logs.road import Road
from replan.planners.frenet.path import path_through
from replan.planners.frenet.profiles import (
    COMFORT,
    HORIZON_KNOTS,
    STEP_S,
    braking,
    trajectory_along,
)
from replan.planners.frenet.scene import start_of
from replan.planners.idm import Idm, IdmConfig

GAIN_MPS2 = 1.0  # Acceleration of `parked` up to its desired speed
NO_AGENTS = np.zeros(0, np.int64)


@once
def _without_rules(road: Road) -> Road:
    lanes = {name: replace(lane, yields_to=()) for name, lane in road.lanes.items()}
    return replace(road, lanes=lanes, stop_lines=(), crosswalks=())


class Blind:
    """Drives the route as if the road were empty: (1) to (3) of `replan.planners.idm` without a
    leader.
    """

    def __init__(self, context: PlannerContext, config: IdmConfig | None = None) -> None:
        self._idm = Idm(replace(context, road=_without_rules(context.road)), config)

    def plan(self, frame: Frame) -> Plan:
        """Return the plan of `idm` for the frame without road users and lights."""
        seen, t = frame.predictions, frame.predictions.t
        empty = np.empty((0, len(t)))
        nothing = Predictions(t, NO_AGENTS, np.empty(0), empty, empty, empty, seen.method)
        return self._idm.plan(
            replace(frame, agents=frame.agents.some(NO_AGENTS), predictions=nothing, lights={})
        )


class Parked:
    """Brakes to a stop and stays, or with `speed_mps` creeps along, on the path of `blind`.

    Args:
        context: As every planner's.
        speed_mps: As annotated, m/s.
    """

    def __init__(
        self,
        context: PlannerContext,
        *,
        speed_mps: Annotated[float, Meta(ge=0.0, description="The desired speed.")] = 0.0,
    ) -> None:
        if not speed_mps >= 0.0:
            raise ValueError(f"speed_mps is {speed_mps:g}, below 0")
        self._blind, self._desired = Blind(context), speed_mps

    def plan(self, frame: Frame) -> Plan:
        """Return the path of `blind` at the speeds (1), (2), in its frame."""
        plan = self._blind.plan(frame)
        trajectory, t = plan.trajectory, STEP_S * np.arange(HORIZON_KNOTS)
        path = path_through(trajectory.x, trajectory.y, trajectory.yaw, trajectory.kappa)
        if len(path.sigma) < 2:  # `blind` stands: so does the parked driver
            return plan
        start = start_of(frame)[0]  # `blind` begins with an acceleration of its own
        excess = start.v - self._desired
        if excess > 0.0:
            slower = braking(
                excess, start.a, COMFORT.decel_mps2, COMFORT.jerk_mps3, STEP_S, HORIZON_KNOTS
            )
            # (1)
            profile = slower + np.stack(
                [self._desired * t, np.full(len(t), self._desired), np.zeros(len(t))]
            )
        else:
            v = np.minimum(self._desired, max(start.v, 0.0) + GAIN_MPS2 * t)  # (2)
            s = np.r_[0.0, np.cumsum(0.5 * STEP_S * (v[1:] + v[:-1]))]
            profile = np.stack([s, v, np.where(v < self._desired, GAIN_MPS2, 0.0)])
        return replace(plan, trajectory=trajectory_along(path, profile, frame.t))
