"""Planners that see the whole Scenario, including its future. They calibrate the metrics; every
table marks them.

"logged"    the logged drive as a plan: no error in open loop; in closed loop the car has to follow
            the log
"onboard"   the plans of the log's own planner up to that time (`Scenario.onboard`), for comparison
            with others. It did not know the future, but planned for the logged position of the car,
            and so cannot react to another drive
"""

from __future__ import annotations

from functools import partial
from typing import Annotated

import numpy as np
from msgspec import Meta

from replan.core.errors import PlannerError
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Plan, PlanStart, PlanStatus
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS, Trajectory
from replan.planners.constant_speed import arc

Horizon = Annotated[float, Meta(gt=0.0, description="How far the plan reaches.")]
Age = Annotated[
    float,
    Meta(
        ge=0.0,
        description="Greatest age of a plan; with an older one, speed and curvature are kept.",
    ),
]


class Logged:
    """Plans the log's future.

    If the log ends within the horizon, so does the plan. After the end of the logged ego (a log
    with only the start, or a closed loop that lasts longer), the last logged state is extrapolated
    at its speed and curvature, and the plan's reason says so.

    Args:
        context: As every planner's.
        scenario: The whole log.
        horizon_s: As annotated, s.
    """

    def __init__(
        self, context: PlannerContext, scenario: Scenario, *, horizon_s: Horizon = 8.0
    ) -> None:
        self._log = scenario.ego
        self._horizon = horizon_s

    def plan(self, frame: Frame) -> Plan:
        """The log from `frame.t` on, at the log's samples, so that plan and log interpolate to the
        same states.
        """
        start = PlanStart.EGO if frame.previous is None else PlanStart.PREVIOUS_PLAN
        if frame.t >= self._log.t[-1] - 1e-6:
            last = self._log.state(len(self._log) - 1)
            state = [
                np.array([frame.t if name == "t" else getattr(last, name)])
                for name in TRAJECTORY_COLUMNS
            ]
            rest = (
                Trajectory(*state) if frame.t <= last.t + 1e-6 else arc(last, np.array([frame.t]))
            )
            return Plan(
                rest, reason="the log has ended: its last state is extrapolated", start=start
            )
        end = min(frame.t + self._horizon, float(self._log.t[-1]))
        within = self._log.t[(self._log.t > frame.t) & (self._log.t < end)]
        return Plan(self._log.resampled(np.r_[frame.t, within, end]), start=start)


class Onboard:
    """Returns the newest plan that the log's own planner had made by the frame's time; after
    `oldest_s`, a fallback.

    Args:
        context: As every planner's.
        scenario: The whole log; plans made after a frame are not used in it.
        oldest_s: As annotated, s.

    Raises:
        PlannerError: The log has no on-board plans.
    """

    def __init__(self, context: PlannerContext, scenario: Scenario, *, oldest_s: Age = 1.0) -> None:
        if not scenario.onboard:
            raise PlannerError(
                f"{scenario.name} has no on-board plans: 'onboard' needs a log that holds them"
            )
        self._plans = scenario.onboard
        self._known = np.array([plan.known for plan in scenario.onboard])
        self._oldest = oldest_s

    def plan(self, frame: Frame) -> Plan:
        """The rest of that plan and of its alternatives from `frame.t` on, at their samples."""
        newest = int(np.searchsorted(self._known, frame.t + 1e-9, side="right")) - 1
        if newest < 0:
            return self._none(frame, "no on-board plan was made so far")
        age = frame.t - float(self._known[newest])
        if age > self._oldest:
            return self._none(frame, f"the last on-board plan is {age:.1f} s old")
        rest = self._plans[newest].changed(partial(_rest, now=frame.t))
        return Plan(rest.trajectory, alternatives=rest.alternatives)

    @staticmethod
    def _none(frame: Frame, why: str) -> Plan:
        rest = arc(frame.ego, frame.t + np.arange(0.0, 2.0, 0.1))
        return Plan(rest, status=PlanStatus.REFUSED, reason=f"{why}: speed and curvature are kept")


def _rest(planned: Trajectory, now: float) -> Trajectory:
    """Return what is left of a plan at a time, s, from then on."""
    t = np.r_[now, planned.t[planned.t > now + 1e-6]]
    columns = [np.interp(t, planned.t, getattr(planned, name)) for name in TRAJECTORY_COLUMNS[1:]]
    return Trajectory(t, *columns)
