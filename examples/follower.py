"""A planner that sees others: along the middle of its lanes, behind whoever is ahead on them.

    PYTHONPATH=examples replan evaluate --planner follower:Follower

Speed by the Intelligent Driver Model (Treiber, Hennecke, Helbing, Phys. Rev. E 62, 2000):

(1) dv/dt = a (1 - (v / v0)^4 - (s* / gap)^2)
(2) s*    = s0 + max(0, v T + v (v - v_lead) / (2 sqrt(a b)))

v0 is the speed limit of the lane and of its bends, v0^2 |kappa| <= `bend_mps2`. It knows no lights,
no right of way, and no one who is not on its lanes yet: compare it with `idm`, which does.
"""

from __future__ import annotations

import numpy as np

from replan import Frame, Lane, Plan, PlannerContext, ReferenceLine, Trajectory

STEP_S, STEPS = 0.1, 51
SIGHT_M = 300.0
"""So far ahead lanes are joined, and others are seen."""
RETURN_M = 25.0
"""Way on which an offset from the middle of the lane is given up."""


class Follower:
    """Follows the lane that it begins in, and who drives there.

    Args:
        context: What does not change.
        gap_m: Distance in a queue, s0.
        headway_s: Time to the one ahead, T.
        accel_mps2: Comfortable acceleration, a; `brake_mps2` braking, b; `bend_mps2` to the side in
            bends.
        brake_mps2: See there.
        bend_mps2: See there.
    """

    def __init__(
        self,
        context: PlannerContext,
        *,
        gap_m: float = 3.0,
        headway_s: float = 1.5,
        accel_mps2: float = 1.2,
        brake_mps2: float = 2.0,
        bend_mps2: float = 2.0,
    ) -> None:
        self.gap, self.headway, self.accel, self.brake = gap_m, headway_s, accel_mps2, brake_mps2
        self.bend, self.car = bend_mps2, context.vehicle
        lanes = self.lanes_ahead(context)
        self.line = ReferenceLine.through(np.concatenate([lane.center for lane in lanes]))
        self.limit = min(context.road.limit(lane.id) for lane in lanes)
        self.bends = np.array([self.line.frame(s)[3] for s in np.arange(0.0, self.line.length)])

    @staticmethod
    def lanes_ahead(context: PlannerContext) -> list[Lane]:
        """The lane under the ego and what follows it, always by the first successor."""
        road, start = context.road, context.start
        here = [lane for lane in road.lanes_at(start.x, start.y) if lane.drivable] or list(
            road.lanes.values()
        )
        lanes = [min(here, key=lambda lane: abs(off(lane, start.x, start.y, start.yaw)))]
        while sum(lane.length for lane in lanes) < SIGHT_M and lanes[-1].successors:
            follower = road.lanes[lanes[-1].successors[0]]
            if follower in lanes:
                break
            lanes.append(follower)
        return lanes

    def plan(self, frame: Frame) -> Plan:
        """Roll the model out over the horizon; who is ahead goes on at their speed."""
        s, side = self.line.project(frame.ego.x, frame.ego.y)
        gap, v_lead = self.lead(frame, s)
        v, rows = max(frame.ego.v, 0.0), []
        for i in range(STEPS):
            wanted = min(self.limit, self.bend_limit(s, v))
            pull = self.gap + max(
                0.0, v * self.headway + v * (v - v_lead) / (2.0 * (self.accel * self.brake) ** 0.5)
            )
            a = self.accel * (1.0 - (v / wanted) ** 4 - (pull / max(gap, 0.1)) ** 2)  # (1), (2)
            a = max(a, -self.car.max_decel, -v / STEP_S)
            rows.append((frame.t + i * STEP_S, s, v, a))
            travelled = v * STEP_S + 0.5 * a * STEP_S**2
            s, v, gap = s + travelled, max(v + a * STEP_S, 0.0), gap + v_lead * STEP_S - travelled
        return Plan(self.along(np.array(rows), frame.ego.yaw, side))

    def bend_limit(self, s: float, v: float) -> float:
        """The speed for the sharpest bend within the way that braking takes."""
        ahead = self.bends[int(max(s, 0.0)) : int(max(s, 0.0) + 5.0 + 0.5 * v * v / self.brake) + 1]
        return float((self.bend / max(np.abs(ahead).max(initial=0.0), 1e-4)) ** 0.5)

    def lead(self, frame: Frame, s: float) -> tuple[float, float]:
        """Free way to the nearest agent on the line, m, and their speed along it, m/s.

        Else SIGHT_M and the limit.
        """
        nearest, speed, agents = SIGHT_M, self.limit, frame.agents
        for i in range(len(agents)):
            there, side = self.line.project(agents.x[i], agents.y[i])
            free = there - s - self.car.axle_to_front - 0.5 * agents.length[i]
            beside = 0.5 * (self.car.width + agents.width[i]) + 0.3
            if there > s and free < nearest and abs(side) < beside:
                _, _, yaw, _ = self.line.frame(there)
                nearest = free
                speed = max(0.0, agents.vx[i] * np.cos(yaw) + agents.vy[i] * np.sin(yaw))
        return nearest, speed

    def along(self, rows: np.ndarray, yaw: float, side: float) -> Trajectory:
        """The rows (t, s, v, a) in the world, with the offset from the line given up over
        RETURN_M.
        """
        t, s, v, a = rows.T
        fade = np.clip(1.0 - (s - s[0]) / RETURN_M, 0.0, 1.0)
        x, y = np.array(
            [
                self.line.point(si, side * f * f * (3.0 - 2.0 * f))
                for si, f in zip(s, fade, strict=True)
            ]
        ).T
        frames = np.array([self.line.frame(si) for si in s])
        return Trajectory(t, x, y, frames[:, 2], v, a, frames[:, 3])


def off(lane: Lane, x: float, y: float, yaw: float) -> float:
    """How far the lane's direction where it is nearest to the ego is off the ego's yaw, rad."""
    center = lane.center
    i = min(int(np.argmin(np.hypot(*(center - (x, y)).T))), len(center) - 2)
    dx, dy = center[i + 1] - center[i]
    return float(np.angle(np.exp(1j * (np.arctan2(dy, dx) - yaw))))
