"""Checks the plans of all planners except oracles: start at the ego, consistency, and drivability.

With p_i, v_i, yaw_i, kappa_i, a_i the samples of a plan, d_i = |p_(i+1) - p_i|, dt_i = t_(i+1) -
t_i, h_i the direction of p_(i+1) - p_i (reversed when driving backwards), and a bar for the mean of
a column over a step:

(0) size         n <= MOST_POINTS, dt_i >= LEAST_S
(1) start        p_0 and v_0 are those of the ego, or of the plan being driven where it is near the
                 ego, within START; v_0 may be 0 where the ego reverses by no more than SWING_MPS
(2) speed        | d_i / dt_i - |v|bar_i | <= SPEED_MPS
(3) heading      | wrap(h_i - yaw_bar_i) | <= YAW_RAD
        where d_i >= STEP_M
(4) curvature    | wrap(h_i - h_(i-1)) / (0.5 (d_i + d_(i-1))) - kappa_i | v_i^2 <= LATERAL_MPS2
        likewise
(5) acceleration | v(t + 0.5 s) - v(t) - integral of a | <= ACCEL_MPS
(6) possible
        d_i / dt_i and hypot(dv/dt, v^2 kappa) within POSSIBLE, with v and kappa of the positions

A plan that breaks (2) to (5) is driven and judged by its positions: the other columns are
recomputed from them, and its status is CORRECTED. A plan that breaks (0), (1) or (6) is refused:
the previous plan continues, which is a fallback. The bounds of (1) to (5) are two to ten times the
deviations of `dp_qp`, `idm` and `lattice` over the built-in suite and recorded logs. The bounds of
(6) are far beyond a road car, so that a plan that is merely too fast is driven and judged.
"""

from __future__ import annotations

from dataclasses import replace
from math import atan2, hypot, inf, pi
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import kernel
from replan.logs.frame import Frame
from replan.logs.plan import Plan, PlanStart, PlanStatus
from replan.logs.states import EgoState, Trajectory, wrap
from replan.replay.planner_process.messages import LONGEST_REASON, MOST_POINTS, shortened

START_M, START_MPS = 0.03, 0.05
LEAST_S = 1e-10
"""Shortest step: logs hold whole nanoseconds, and speeds over shorter ones overflow."""
SWING_MPS = 0.3
"""The recorded speed of a stopping ego can fall below 0 by this (filters, fits): a plan may start
at 0 then.
"""
NEAR_M = 1.0
"""A plan may start on the plan being driven if the ego is at most this far from it (built-in
planners: 0.5 m).
"""
NEARER = 4.0
"""A plan that starts this many times nearer to the ego in the map's coordinates than in the world's
is taken for one in the map's. Not infinitely: the way points of a planner that gets the ego in the
other coordinates begin somewhere.
"""
SPEED_MPS, YAW_RAD = 1.0, 0.1
LATERAL_MPS2, ACCEL_MPS = 2.5, 1.0
STEP_M = 0.1
"""Shorter steps have no direction."""
WINDOW_S = 0.5
POSSIBLE_MPS, POSSIBLE_MPS2 = 100.0, 20.0
"""Bounds of (6): 360 km/h; tyres of road cars allow about 10 m/s2."""
REST_S = 0.5
"""The plan being driven continues if it lasts at least this long.

Else the ego brakes on its arc by `BRAKE_MPS2`.
"""
BRAKE_MPS2 = 4.0


def checked(plan: Plan, frame: Frame, origin: tuple[float, float] = (0.0, 0.0)) -> Plan:
    """Return the plan as it is driven and judged (module docstring).

    `origin` is `PlannerContext.origin`, for the reason of a refusal.
    """
    trajectory = plan.trajectory
    if len(plan.reason) > LONGEST_REASON:
        plan = replace(plan, reason=shortened(plan.reason))
    fault = _start_fault(trajectory, frame, origin)
    if not fault and len(trajectory) > 1:
        off = _off(trajectory)
        lie = ""
        if off.fastest > POSSIBLE_MPS:  # (6), of the positions as they are
            fault = f"it asks for {off.fastest:.0f} m/s"
        elif off.speed > SPEED_MPS:
            lie = f"its speed is {off.speed:.1f} m/s off its positions"
        elif off.heading > YAW_RAD:
            lie = f"its heading is {off.heading:.2f} rad off its positions"
        elif off.lateral > LATERAL_MPS2:
            lie = (
                f"its curvature is off its positions by {off.lateral:.1f} m/s2 of lateral "
                "acceleration"
            )
        elif off.accel > ACCEL_MPS:
            lie = f"its acceleration is {off.accel:.1f} m/s off its speed over 0.5 s"
        if lie:
            trajectory = of_positions(trajectory)
            off = _off(trajectory)
            status = plan.status if plan.status.is_fallback else PlanStatus.CORRECTED
            reason = "; ".join(filter(None, [plan.reason, lie]))
            plan = replace(plan, trajectory=trajectory, status=status, reason=reason)
        if not fault and off.hardest > POSSIBLE_MPS2:  # (6)
            fault = f"it asks for an acceleration of {off.hardest:.0f} m/s2"
    if not fault:
        return plan
    start = PlanStart.PREVIOUS_PLAN
    if frame.previous is not None and frame.previous.trajectory.t[-1] >= frame.t + REST_S:
        old = frame.previous.trajectory
        instead = old.resampled(np.r_[frame.t, old.t[old.t > frame.t + 1e-9]])
    else:  # the ego's arc, braked to a standstill, for 3 s
        start, ego, after = PlanStart.EGO, frame.ego, 0.1 * np.arange(31)
        speed = np.maximum(abs(ego.v) - BRAKE_MPS2 * after, 0.0) * np.sign(ego.v)
        slowing = np.minimum(after, abs(ego.v) / BRAKE_MPS2)
        driven = np.sign(ego.v) * (abs(ego.v) * slowing - 0.5 * BRAKE_MPS2 * slowing**2)
        half_turn = 0.5 * ego.kappa * driven
        chord = driven * np.sinc(half_turn / np.pi)
        x, y = (
            ego.x + chord * np.cos(ego.yaw + half_turn),
            ego.y + chord * np.sin(ego.yaw + half_turn),
        )
        a = np.where(np.abs(speed) > 0.0, -BRAKE_MPS2 * np.sign(ego.v), 0.0)
        yaw, kappa = ego.yaw + 2.0 * half_turn, np.full(len(after), ego.kappa)
        instead = Trajectory(ego.t + after, x, y, yaw, speed, a, kappa)
    return replace(plan, trajectory=instead, status=PlanStatus.REFUSED, reason=fault, start=start)


def _start_fault(trajectory: Trajectory, frame: Frame, origin: tuple[float, float]) -> str:
    """Return how a plan breaks (0) or (1); empty if it does not."""
    if len(trajectory) > MOST_POINTS:
        return f"it has {len(trajectory)} states, more than {MOST_POINTS}"
    least_s = np.diff(trajectory.t).min(initial=inf)
    if least_s < LEAST_S:
        return f"its states are {least_s:.1e} s apart, less than {LEAST_S:g} s"
    first, starts = trajectory.state(0), [frame.ego]
    if _distance_between(frame.ego, first) <= START_M and abs(frame.ego.v - first.v) <= START_MPS:
        return ""
    if frame.previous is not None:
        old = frame.previous.trajectory.at(frame.t)
        starts += [old] if _distance_between(old, frame.ego) <= NEAR_M else []
    nearest = min(starts, key=lambda start: _distance_between(start, first))
    away_m = _distance_between(nearest, first)
    if away_m > START_M:
        fault = f"it starts {away_m:.2f} m from the ego and from the plan being driven"
        in_map = replace(nearest, x=nearest.x + origin[0], y=nearest.y + origin[1])
        in_map_m = _distance_between(in_map, first)
        if NEARER * in_map_m < away_m:
            place = "({:.12g}, {:.12g})".format(*origin)
            fault += (
                f"; in the coordinates of the log's map it starts {in_map_m:.2f} m from there: "
                f"subtract context.origin, {place} here, from the planner's map, or declare "
                'coordinates = "map" (docs/bring_planner.md)'
            )
        return fault
    speeds = [start.v for start in starts] + [
        0.0 for start in starts if -SWING_MPS <= start.v < 0.0
    ]
    if min(abs(speed - first.v) for speed in speeds) > START_MPS:
        return f"it starts at {first.v:.1f} m/s, the ego drives {frame.ego.v:.1f} m/s"
    return ""


def _distance_between(one: EgoState, two: EgoState) -> float:
    return hypot(one.x - two.x, one.y - two.y)


class Off(NamedTuple):
    """The greatest left side of each condition in the module docstring over a plan; 0 if no step is
    judged.

    Attributes:
        speed: Of (2), m/s.
        heading: Of (3), rad.
        lateral: Of (4), m/s2.
        accel: Of (5), m/s.
        fastest: Of (6), m/s.
        hardest: Of (6), m/s2.
    """

    speed: float
    heading: float
    lateral: float
    accel: float
    fastest: float
    hardest: float


def _off(plan: Trajectory) -> Off:
    return measured_off(plan.t, plan.x, plan.y, plan.yaw, plan.v, plan.a, plan.kappa)


@kernel
def measured_off(
    t: FloatArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    v: FloatArray,
    a: FloatArray,
    kappa: FloatArray,
) -> Off:
    """`Off` of a plan's columns `(n,)`, n >= 2."""
    n = len(t)
    speed = heading = lateral = 0.0
    accel = fastest = hardest = 0.0
    drift = np.empty(n)
    drift[0], gained = v[0], 0.0
    h_before, d_before = 0.0, 0.0
    for i in range(n - 1):
        dt, dx, dy = t[i + 1] - t[i], x[i + 1] - x[i], y[i + 1] - y[i]
        d, middle = hypot(dx, dy), 0.5 * (v[i + 1] + v[i])
        h = atan2(dy, dx) + (pi if middle < 0.0 else 0.0)
        speed = max(speed, abs(d / dt - 0.5 * (abs(v[i + 1]) + abs(v[i]))))  # (2)
        if d >= STEP_M:
            heading = max(heading, abs(wrap(h - 0.5 * (yaw[i + 1] + yaw[i]))))  # (3)
            if i > 0 and d_before >= STEP_M:
                bend = wrap(h - h_before) / (0.5 * (d + d_before) * (-1.0 if middle < 0.0 else 1.0))
                lateral = max(lateral, abs(bend - kappa[i]) * v[i] ** 2)  # (4)
        h_before, d_before = h, d
        gained += 0.5 * dt * (a[i + 1] + a[i])
        drift[i + 1] = v[i + 1] - gained
        fastest = max(fastest, d / dt)  # (6)
        hardest = max(hardest, hypot((v[i + 1] - v[i]) / dt, v[i + 1] ** 2 * kappa[i + 1]))  # (6)
    k = 0
    for i in range(n):
        later = min(t[i] + WINDOW_S, t[n - 1])
        while k < n - 2 and t[k + 1] < later:
            k += 1
        u = (later - t[k]) / (t[k + 1] - t[k])
        accel = max(accel, abs(drift[k] + u * (drift[k + 1] - drift[k]) - drift[i]))  # (5)
    return Off(speed, heading, lateral, accel, fastest, hardest)


def of_positions(plan: Trajectory) -> Trajectory:
    """Return the plan with heading, speed, acceleration and curvature from its positions; the first
    speed is kept.

    Each sample has the mean of its adjacent steps. A step below `STEP_M` has the direction of the
    previous step, or initially the plan's first heading. The sign of the plan's speed decides
    whether a step is driven in reverse.
    """
    dx, dy = np.diff(plan.x), np.diff(plan.y)
    d, course = np.hypot(dx, dy), np.arctan2(dy, dx)
    moved = d >= STEP_M
    sign = np.where(0.5 * (plan.v[1:] + plan.v[:-1]) < 0.0, -1.0, 1.0)
    heading = np.where(sign < 0.0, course + np.pi, course)
    last = np.maximum.accumulate(np.where(moved, np.arange(len(d)), -1))
    heading = np.unwrap(np.where(last >= 0, heading[np.maximum(last, 0)], plan.yaw[0]))
    speed = sign * d / np.diff(plan.t)
    yaw = np.r_[heading[0], heading[:-1] + 0.5 * np.diff(heading), heading[-1]]
    v = np.r_[plan.v[0], 0.5 * (speed[1:] + speed[:-1]), speed[-1]]
    turn, length = np.diff(heading), 0.5 * (d[1:] + d[:-1]) * sign[1:]
    bend = np.divide(turn, length, out=np.zeros(len(turn)), where=moved[1:] & moved[:-1])
    kappa = np.r_[bend[:1], bend, bend[-1:]] if len(bend) else np.zeros(len(plan))
    return Trajectory(plan.t, plan.x, plan.y, yaw, v, np.gradient(v, plan.t), kappa)
