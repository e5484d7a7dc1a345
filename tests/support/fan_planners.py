"""Planners that show the trajectories among which they chose."""

from dataclasses import replace

import numpy as np

from replan.logs.frame import Frame
from replan.logs.plan import Plan
from replan.logs.states import Alternative, Trajectory
from replan.planners.idm import Idm

FAN = (("idm", 1.0, 0.0, 0.5), ("slow", 0.5, 0.0, 0.125), ("left", 1.0, 3.5, 0.25))
"""Name, share of the speed, offset after 4 s (m), probability; the rest is the log's."""


class Fan(Idm):
    """IDM's plan, among plans that are slower and farther left."""

    def plan(self, frame: Frame) -> Plan:
        plan = super().plan(frame)
        path = plan.trajectory
        fan = [Alternative(_changed(path, v, d), p, name) for name, v, d, p in FAN]
        return replace(plan, alternatives=(*fan, Alternative(path, 0.125)))


class FanInMap(Fan):
    """The same in the map's coordinates."""

    coordinates = "map"


def _changed(path: Trajectory, share: float, aside: float) -> Trajectory:
    bend = np.clip((path.t - path.t[0]) / 4.0, 0.0, 1.0)
    x = path.x[0] + share * (path.x - path.x[0]) - aside * bend * np.sin(path.yaw)
    y = path.y[0] + share * (path.y - path.y[0]) + aside * bend * np.cos(path.yaw)
    return replace(path, x=x, y=y, v=share * path.v, a=share * path.a)
