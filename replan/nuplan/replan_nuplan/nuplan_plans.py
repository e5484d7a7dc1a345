"""A trajectory of the devkit as a plan of replan.

Only poses and times are taken: planners leave speeds and curvatures 0 or derive them with errors.
nuPlan's own tracker does the same: it fits speed and curvature to the poses, and aims at the speed
of 1 s ahead (`LQRTracker`, `tracking_horizon` 10), so that the first steps of a trajectory, which
planners do not smooth, are not driven. Here

(1) positions are smoothed by polynomials of degree `DEGREE` over `WINDOW` poses (Savitzky-Golay)
(2) the path may begin beside the ego (PDM projects it on its path), or in another direction. At
        station s it is moved by  h0(u) d + h1(u) L tan(psi) n,  u = s / L,  until u = 1, with
        h0 = (1 - u)^2 (1 + 2 u),  h1 = u (1 - u)^2,  d: from the first pose to the ego, psi: the
        ego's heading off that of the path's first `AIM_M`, n: the path's normal there. L is the
        distance of `BLEND_S`, or as much longer as keeps the curvature of this, 6 |d| / L^2 and
        4 |tan psi| / L, below `BLEND_KAPPA` and its lateral acceleration below `BLEND_MPS2`
(3) for t < `AHEAD_S` the speed goes linearly from the ego's to the trajectory's at `AHEAD_S`; the
        stations after it are moved by what this gains. Where the poses go backward (PDM-Closed
        brakes so in an emergency: hard at once, for nuPlan's tracker) the ego brakes to a stand
(4) heading, curvature and acceleration are those of the positions, as
        `replan.replay.loop.plan_check` asks for
(5) the plan ends before its first pose, later than `COMPLETE_S`, whose acceleration is above
        `HARDEST_MPS2`, with a reason: nuPlan never drives so far along a trajectory, and PDM-Closed
        does not slow down for bends
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from .nuplan_channel import Message

if TYPE_CHECKING:
    from .nuplan_states import Converter

WINDOW, DEGREE = 11, 3
BLEND_S, AHEAD_S = 1.5, 1.0
BLEND_KAPPA = 0.1
"""1/m; cars reach 0.2."""
BLEND_MPS2 = 2.0
AIM_M = 1.0
STEEPEST = 1.0
"""Largest tan psi."""
LEAST_STEP_S = 1e-3
BACKWARD, LEAST_BACK_M = 0.7, 0.001
"""A way goes backward if this share of its length, and a bit, leads against the heading."""
STEP_S = 0.1
"""Step of a plan."""
COMPLETE_S = 3.0
"""Duration of a complete plan."""
HARDEST_MPS2 = 15.0
"""More than a road car can do; replan refuses a plan at 20 m/s2."""
STANDS_M = 0.02
"""Steps shorter than this have the heading of the step before."""
BEYOND_M = 100.0
"""The path goes straight on for this length, where the stations (3) reach beyond its end."""
Floats = NDArray[np.float64]


def plan_message(trajectory: Any, frame: Message, converter: Converter) -> Message:
    """The message of a trajectory that starts at a frame; ValueError if it has no later pose."""
    states = trajectory.get_sampled_trajectory()
    places = np.array([[state.rear_axle.x, state.rear_axle.y] for state in states])
    times = np.array([converter.seconds(state.time_point) for state in states]) - frame["t"]
    rises = np.r_[True, np.diff(np.maximum.accumulate(times)) > LEAST_STEP_S]
    if times[rises][-1] < STEP_S:
        raise ValueError("the trajectory has no pose after the frame's time")
    t = np.arange(0.0, times[rises][-1] + 0.5 * STEP_S, STEP_S)
    x, y = (_smooth(np.interp(t, times[rises], column[rises])) for column in places.T)
    ego = frame["ego"]
    backward = _backward(t, x, y, states[0].rear_axle.heading)
    headings = np.unwrap([state.rear_axle.heading for state in states])[rises]
    last = _turning_point(x, y, np.interp(t, times[rises], headings))
    x, y = (column[np.minimum(np.arange(len(t)), last)] for column in (x, y))
    x, y = _from_ego(t, x, y, ego)
    x, y, v = _from_speed(t, x, y, ego, backward)
    yaw, kappa = _bends(x, y, ego["yaw"])
    a = np.gradient(v, t)
    end, reason = _drivable(t, np.hypot(a, v * v * kappa))
    columns = (frame["t"] + t, x, y, yaw, v, a, kappa)
    names = ("t", "x", "y", "yaw", "v", "a", "kappa")
    packed = {n: np.asarray(c[:end], "<f8").tobytes() for n, c in zip(names, columns)}
    return {"type": "plan", "trajectory": packed, "reason": reason}


def _drivable(t: Floats, hard: Floats) -> tuple[int, str]:
    """The number of poses of the plan (5), and its reason; `hard`: accelerations, m/s2."""
    beyond = np.flatnonzero((hard > HARDEST_MPS2) & (t > COMPLETE_S))
    if not len(beyond):
        return len(t), ""
    end = int(beyond[0])
    return end, f"ends after {t[end - 1]:.1f} s: the trajectory then asks for {hard[end]:.0f} m/s2"


def _smooth(column: Floats) -> Floats:
    """(1)."""
    return savgol_filter(column, WINDOW, DEGREE) if len(column) >= WINDOW else column


def _from_ego(t: Floats, x: Floats, y: Floats, ego: Message) -> tuple[Floats, Floats]:
    """The positions (2) of a path that begins at the ego, in its direction."""
    s = np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y)))]
    off_x, off_y = ego["x"] - x[0], ego["y"] - y[0]
    direction, slope = ego["yaw"], 0.0
    if s[-1] > AIM_M:
        aim = int(np.searchsorted(s, AIM_M))
        direction = np.arctan2(y[aim] - y[0], x[aim] - x[0])
        psi = (ego["yaw"] - direction + np.pi) % (2.0 * np.pi) - np.pi
        slope = np.clip(np.tan(np.clip(psi, -1.5, 1.5)), -STEEPEST, STEEPEST)
    speed = max(abs(ego["v"]), 1.0)
    kappa = min(BLEND_KAPPA, BLEND_MPS2 / speed**2)
    needed = max(np.sqrt(6.0 * np.hypot(off_x, off_y) / kappa), 4.0 * abs(slope) / kappa)
    length = max(float(np.interp(BLEND_S, t, s)), needed, AIM_M)
    u = np.clip(s / length, 0.0, 1.0)
    offset, turn = (1.0 - u) ** 2 * (1.0 + 2.0 * u), u * (1.0 - u) ** 2 * length * slope
    return (
        x + offset * off_x - turn * np.sin(direction),
        y + offset * off_y + turn * np.cos(direction),
    )


def _backward(t: Floats, x: Floats, y: Floats, heading: float) -> float:
    """The speed at which a trajectory goes backward from its first pose within `AHEAD_S`, m/s; 0 if
    it does not.
    """
    k = min(round(AHEAD_S / STEP_S), len(t) - 1)
    dx, dy = x[k] - x[0], y[k] - y[0]
    ahead = dx * np.cos(heading) + dy * np.sin(heading)
    is_backward = ahead < -BACKWARD * np.hypot(dx, dy) - LEAST_BACK_M
    return -float(ahead) / float(t[k]) if is_backward else 0.0


def _turning_point(x: Floats, y: Floats, headings: Floats) -> int:
    """The last pose before a trajectory goes backward for `AHEAD_S`; the last of all, if it does
    not.
    """
    count = round(AHEAD_S / STEP_S)
    for k in range(len(x) - 1):
        dx, dy = x[k : k + count + 1] - x[k], y[k : k + count + 1] - y[k]
        ahead = dx * np.cos(headings[k]) + dy * np.sin(headings[k])
        if ahead[-1] < -BACKWARD * np.hypot(dx[-1], dy[-1]) - LEAST_BACK_M:
            return k + int(np.argmax(ahead))
    return len(x) - 1


def _from_speed(
    t: Floats, x: Floats, y: Floats, ego: Message, backward: float
) -> tuple[Floats, Floats, Floats]:
    """The positions and speeds (3) of a path that begins at the ego; `backward`: the speed at which
    the trajectory goes backward, m/s.
    """
    s = np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y)))]
    v = np.gradient(s, t)
    k = min(round(AHEAD_S / STEP_S), len(t) - 1)
    begin = max(ego["v"], 0.0)
    aim = -backward if backward > 0.0 else v[k]
    change = aim - begin
    u = t[: k + 1] / t[k]
    moving = np.minimum(u, begin / -change) if aim < 0.0 else u
    gained = t[k] * (begin * moving + 0.5 * change * moving * moving)
    stations: Floats = np.append(gained, s[k + 1 :] + gained[-1] - s[k])
    speeds = np.r_[ego["v"], np.maximum(begin + change * u, 0.0)[1:], v[k + 1 :]]
    if backward > 0.0:
        stations[k + 1 :], speeds[k + 1 :] = gained[-1], 0.0
    dx, dy = _direction(x, y, ego["yaw"])
    beyond = s[-1] + BEYOND_M
    longer_x, longer_y = np.append(x, x[-1] + BEYOND_M * dx), np.append(y, y[-1] + BEYOND_M * dy)
    longer = np.append(s, beyond)
    return np.interp(stations, longer, longer_x), np.interp(stations, longer, longer_y), speeds


def _direction(x: Floats, y: Floats, yaw: float) -> tuple[float, float]:
    """The direction of the last step that moves; the ego's heading if none does."""
    dx, dy = np.diff(x), np.diff(y)
    length = np.hypot(dx, dy)
    moving = np.flatnonzero(length > 1e-6)
    if not len(moving):
        return float(np.cos(yaw)), float(np.sin(yaw))
    k = moving[-1]
    return float(dx[k] / length[k]), float(dy[k] / length[k])


def _bends(x: Floats, y: Floats, first: float) -> tuple[Floats, Floats]:
    """Heading, without jumps, and curvature of positions; `first`: the ego's heading, rad."""
    dx, dy = np.diff(x), np.diff(y)
    length = np.hypot(dx, dy)
    moves = length > STANDS_M
    last = np.maximum.accumulate(np.where(moves, np.arange(len(moves)), -1))
    steps = np.where(last < 0, first, np.arctan2(dy, dx)[np.maximum(last, 0)])
    steps = np.unwrap(np.r_[first, steps])[1:]
    turn, way = np.diff(steps), 0.5 * (length[1:] + length[:-1])
    kappa = np.where(way > STANDS_M, turn / np.maximum(way, STANDS_M), 0.0)
    yaw = np.r_[steps[0], 0.5 * (steps[1:] + steps[:-1]), steps[-1]]
    return yaw, np.r_[0.0, kappa, 0.0] if len(kappa) else np.zeros(len(yaw))
