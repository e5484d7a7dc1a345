"""Along the lane on which the drive begins, as fast as its limit, and slower behind whoever is
ahead on it.
"""

from __future__ import annotations

import numpy as np

from replan import Frame, Plan, PlannerContext, ReferenceLine, Trajectory

STEP_S, STEPS = 0.1, 51
HEADWAY_S, STANDSTILL_M, BESIDE_M = 1.5, 4.0, 1.8
GAIN_1PS, ACCEL_MPS2, BRAKE_MPS2 = 0.5, 1.0, 6.0


class MyPlanner:
    """The speed goes to that at which the gap ahead is a time headway."""

    def __init__(self, context: PlannerContext) -> None:
        start = context.start
        lane = next(
            iter(context.road.lanes_at(start.x, start.y)), next(iter(context.road.lanes.values()))
        )
        self.line, self.limit = ReferenceLine.through(lane.center), context.road.limit(lane.id)
        self.front = context.vehicle.axle_to_front

    def plan(self, frame: Frame) -> Plan:
        """Constant speed of the one ahead is assumed; the offset from the lane's middle is kept."""
        s, side = self.line.project(frame.ego.x, frame.ego.y)
        gap, lead = self.ahead(frame, s)
        v, rows = frame.ego.v, []
        for i in range(STEPS):
            wanted = min(self.limit, max(gap - STANDSTILL_M, 0.0) / HEADWAY_S)
            a = min(max(GAIN_1PS * (wanted - v), -BRAKE_MPS2, -v / STEP_S), ACCEL_MPS2)
            rows.append(
                (frame.t + i * STEP_S, *self.line.point(s, side), *self.line.frame(s)[2:], v, a)
            )
            way = v * STEP_S + 0.5 * a * STEP_S**2
            s, v, gap = s + way, max(v + a * STEP_S, 0.0), gap + lead * STEP_S - way
        t, x, y, yaw, kappa, speed, accel = np.array(rows).T
        return Plan(Trajectory(t, x, y, yaw, speed, accel, kappa))

    def ahead(self, frame: Frame, s: float) -> tuple[float, float]:
        """Gap to the nearest one on the lane, m, and their speed, m/s."""
        others = frame.agents
        found = [(1e3, self.limit)]
        for i in range(len(others)):
            there, side = self.line.project(others.x[i], others.y[i])
            if there > s and abs(side) < BESIDE_M:
                gap = there - s - self.front - 0.5 * others.length[i]
                found.append((gap, float(np.hypot(others.vx[i], others.vy[i]))))
        return min(found)
