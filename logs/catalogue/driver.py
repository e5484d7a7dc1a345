"""The careful driver of the ego logs of the catalogue: simple, smooth, and none of the planners.

Its acceleration is the least of these at each step, with bounded acceleration and jerk, so that log and poses agree:

(1) cruise    a = 0.8 (v_cruise - v)
(2) follow    a = 0.15 (gap - thw v) + 0.7 (v_lead - v)          gap bumper to bumper
(3) stop      a = -v^2 / (2 distance)                            constant braking to the stopping point

(4) |a| is eased out in time: a standstill or the cruising speed is reached with a = 0, since braking is at most
    sqrt(2 jerk v) and accelerating at most sqrt(2 jerk (v_cruise - v)), with 0.7 of the bound on jerk. A
    stopping point is met within 1 m.

The path is given; the rear axle drives on it, so that yaw rate = v kappa.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np

from logs.catalogue.roads import CurveSamples
from logs.states import Trajectory

STEP_S = 0.02
SAMPLE_S = 0.1
MAX_ACCEL, MAX_BRAKE, MAX_JERK = 1.5, 3.0, 2.0
_EASE = 0.7 * MAX_JERK


@dataclass(frozen=True, slots=True)
class Ahead:
    """The object that the driver reacts to: `gap` from the front bumper, m, its `speed`, whether to `stop` for it."""

    gap: float
    speed: float = 0.0
    stop: bool = False


Reaction = Callable[[float, float], Ahead | None]
"""Returns the object that a driver reacts to at time t, s, with the rear axle at station s, m; None without one."""


def waiting(line: float, short: float, begin: float, end: float, front: float) -> Reaction:
    """The reaction of a driver who waits `short` m before station `line`, m, from time `begin` to `end`, s.

    `front` is the distance from the rear axle to the front bumper, m; a driver who is past the line does not wait.
    """

    def ahead(t: float, s: float) -> Ahead | None:
        gap = line - short - (s + front)
        return Ahead(gap, stop=True) if begin <= t < end and gap > -short else None

    return ahead


def drive(
    path: CurveSamples,
    *,
    start: float,
    speed: float,
    cruise: float | Callable[[float], float],
    duration: float,
    ahead: Reaction = lambda t, s: None,
    thw: float = 1.6,
) -> Trajectory:
    """The ego log, sampled at 10 Hz.

    Args:
        path: Path of the rear axle.
        start: Station of the rear axle at t = 0, m.
        speed: Speed at t = 0, m/s.
        cruise: Wanted speed, m/s; or a function of the rear axle's station.
        duration: Duration, s; a multiple of 0.1.
        ahead: Returns the object that the driver reacts to.
        thw: Wanted time headway, s.

    Raises:
        ValueError: The path is too short.
    """
    t, s, v, a, rows = 0.0, start, speed, 0.0, []
    every = round(SAMPLE_S / STEP_S)
    for k in range(round(duration / STEP_S) + 1):
        if k % every == 0:
            rows.append((k * STEP_S, s, v, a))
        wanted, seen = cruise(s) if callable(cruise) else cruise, ahead(t, s)
        wish = 0.8 * (wanted - v)  # (1)
        if seen is not None and seen.stop:
            wish = min(wish, -v * v / (2.0 * max(seen.gap, 0.1)))  # (3)
        elif seen is not None:
            wish = min(wish, 0.15 * (seen.gap - thw * v) + 0.7 * (seen.speed - v))  # (2)
        low = max(-MAX_BRAKE, -sqrt(2.0 * _EASE * max(v, 0.0)))  # (4)
        high = min(MAX_ACCEL, sqrt(2.0 * _EASE * max(wanted - v, 0.0)))
        jerk = min(max((min(max(wish, low), high) - a) / STEP_S, -MAX_JERK), MAX_JERK)
        s += (v + (0.5 * a + jerk * STEP_S / 6.0) * STEP_S) * STEP_S
        v += (a + 0.5 * jerk * STEP_S) * STEP_S
        a += jerk * STEP_S
        if v <= 0.0:
            v, a = 0.0, max(a, 0.0)
        t = (k + 1) * STEP_S
    times, stations, speeds, accelerations = np.array(rows).T
    if stations[-1] > path.length:
        raise ValueError(f"the drive of {stations[-1] - start:.0f} m leaves its path of {path.length:.0f} m")
    x, y, yaw, kappa = path.at(stations)
    return Trajectory(np.round(times, 9), x, y, yaw, speeds, accelerations, kappa)
