"""Planners that are given the Scenario, future included: they calibrate the metrics, and every table marks them.

"logged"    what was driven, as a plan: no error in open loop; in closed loop the car has to follow the log
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from logs.frame import Frame, PlannerContext
from logs.scenario import Scenario
from logs.states import TRAJECTORY_COLUMNS, EgoState, Trajectory
from logs.trace import Plan, PlanStart
from planners.base import Planner
from planners.constant_speed import arc


class Logged:
    """The log's future.

    Where the log ends within the horizon, so does the plan. Where nothing of the log lies ahead (a log that holds
    only the start; a closed loop that outlasts its ego), the last logged state is carried on at its speed and
    curvature, and the plan's reason says so.

    Args:
        context: As every planner's.
        scenario: The whole log.
        horizon_s: How far the plan reaches, s.
    """

    def __init__(self, context: PlannerContext, scenario: Scenario, *, horizon_s: float = 8.0) -> None:
        self._log = scenario.ego
        self._horizon = horizon_s

    def plan(self, frame: Frame) -> Plan:
        """The log from `frame.t` on, its own samples, so that both interpolate to the same."""
        start = PlanStart.EGO if frame.previous is None else PlanStart.PREVIOUS_PLAN
        if frame.t >= self._log.t[-1] - 1e-6:
            return Plan(self._beyond(frame.t), reason="nothing of the log lies ahead: carried on", start=start)
        end = min(frame.t + self._horizon, float(self._log.t[-1]))
        within = self._log.t[(self._log.t > frame.t) & (self._log.t < end)]
        return Plan(self._log.resampled(np.r_[frame.t, within, end]), start=start)

    def _beyond(self, t: float) -> Trajectory:
        """One state: the last of the log, carried on to `t`."""
        last = self._log.state(len(self._log) - 1)
        return _single(last, t) if t <= last.t + 1e-6 else arc(last, np.array([t]))


def _single(state: EgoState, t: float) -> Trajectory:
    """A trajectory of one state, at the time `t`."""
    return Trajectory(*(np.array([t if name == "t" else getattr(state, name)]) for name in TRAJECTORY_COLUMNS))


ORACLES: dict[str, Callable[..., Planner]] = {
    "logged": Logged,
}
"""Each is built as `Class(context, scenario, **config)`."""
