"""The smallest planner, and the template to copy: it keeps the ego's speed and curvature.

Copy this file, rename the class, change `plan`, and run it without touching this package:

    replan evaluate LOGS --planner my_package.mine:MyPlanner
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from msgspec import Meta

from replan.core.arrays import FloatArray
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Plan
from replan.logs.states import EgoState, Trajectory


class ConstantSpeed:
    """Continues along a circular arc and ignores all road users.

    Args:
        context: The constant inputs: `context.road`, `context.goal`, `context.vehicle`,
            `context.period`.
        horizon_s: As annotated; `step_s` likewise.

    Every keyword after the context is a key of `[planner.NAME]` in a run's configuration: give it a
    default and a name with its unit. Range and description are optional: `replan list NAME` prints
    them, and values out of the range are refused.
    """

    def __init__(
        self,
        context: PlannerContext,
        *,
        horizon_s: Annotated[float, Meta(gt=0.0, description="How far the plan reaches.")] = 8.0,
        step_s: Annotated[float, Meta(gt=0.0, description="Time between two samples.")] = 0.1,
    ) -> None:
        # A planner is built once per scenario. Memory (warm starts, hysteresis) belongs in the
        # object; set it here.
        self.lap = context.lap
        self.ahead = step_s * np.arange(round(horizon_s / step_s) + 1)

    def plan(self, frame: Frame) -> Plan:
        """Return a plan from `frame.t` on.

        `frame.agents` are the road users now, `frame.predictions` their assumed futures,
        `frame.previous` the plan that the ego is driving. It is None in the open loop and at the
        first frame; then memory must not change the plan. A planner that fails returns its
        fallback, with a PlanStatus and a reason; it does not raise.
        """
        trajectory = arc(frame.ego, frame.t + self.ahead)
        # optional: the time since the last lap appears under this name in the timings
        self.lap("arc")
        return Plan(trajectory)


def arc(ego: EgoState, t: FloatArray) -> Trajectory:
    """Extrapolate the ego at constant speed and curvature to the times `t` `(n,)`, s; exact, also
    on a straight line.

    The chord of an arc of length s that turns by 2 h is s sin(h) / h, in the direction yaw + h.
    """
    s = ego.v * (t - ego.t)
    half_turn = 0.5 * ego.kappa * s
    chord = s * np.sinc(half_turn / np.pi)
    return Trajectory(
        t=t,  # s since the scenario's start; the first is the frame's time
        x=ego.x + chord * np.cos(ego.yaw + half_turn),  # the rear axle, world, m
        y=ego.y + chord * np.sin(ego.yaw + half_turn),
        yaw=ego.yaw + 2.0 * half_turn,  # rad
        v=np.full(len(t), ego.v),  # m/s
        a=np.zeros(len(t)),  # m/s2
        kappa=np.full(len(t), ego.kappa),  # 1/m, positive to the left
    )
