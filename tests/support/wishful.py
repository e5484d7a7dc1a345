"""A planner with a setting that matters, one that does not, and metrics of both, for searches of
settings.

`Wishful` drives straight on and changes to the speed `speed_mps`; `idle` does nothing. The metric
`wish` is how far the speed is from the best one, `noise` is a number of the log's name alone.
"""

from hashlib import sha256

import numpy as np

from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Plan
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Trace
from replan.metrics.metric import Series, metric
from replan.metrics.reductions import MEAN

BEST_MPS = 7.0
STEPS = 0.1 * np.arange(41)


class Wishful:
    def __init__(
        self, context: PlannerContext, *, speed_mps: float = 8.0, idle: float = 0.5
    ) -> None:
        if not 0.0 < speed_mps < 20.0:
            raise ValueError(f"speed_mps is {speed_mps}, not above 0 and below 20")
        self._wish = speed_mps

    def plan(self, frame: Frame) -> Plan:
        start = frame.ego
        change = np.clip(self._wish - start.v, -1.5 * STEPS, 1.5 * STEPS)
        v, a = (
            start.v + change,
            np.where(np.abs(change) < abs(self._wish - start.v), np.sign(change) * 1.5, 0.0),
        )
        s = np.r_[0.0, np.cumsum(0.05 * (v[1:] + v[:-1]))]
        x, y = start.x + s * np.cos(start.yaw), start.y + s * np.sin(start.yaw)
        same = np.full(len(v), start.yaw)
        return Plan(Trajectory(frame.t + STEPS, x, y, same, v, a, np.zeros(len(v))))


@metric(unit="m/s", better="lower", reductions=(MEAN,))
def wish(trace: Trace, scenario: Scenario) -> Series:
    """Distance of the speed from the best one."""
    return Series(trace.ego.t, np.abs(trace.ego.v - BEST_MPS))


@metric(unit="1", better="higher", reductions=(MEAN,))
def noise(trace: Trace, scenario: Scenario) -> Series:
    """A number that is drawn by the log's name."""
    seed = int(sha256(scenario.name.encode()).hexdigest()[:8], 16)
    drawn = np.random.default_rng(seed).normal(10.0, 1.0)
    return Series(trace.ego.t, np.full(len(trace.ego.t), drawn))
