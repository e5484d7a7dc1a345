"""Geometric steering: pure pursuit, and Stanley. Neither has a model of the vehicle's dynamics.

Pure pursuit drives the circle through a point of the path ahead, and ignores curvature:

(1) ahead = clip(time v, shortest, longest)                    m
(2) alpha = bearing from the rear axle to the path's point at that distance, against the heading
(3) steer = atan(2 L sin(alpha) / ahead)

Stanley points the front wheels along the path and towards it. At the middle of the front axle, with
its foot point on the path:

(4) steer = (path's heading - yaw) - atan(gain e_lat / (softening + v))
        e_lat positive left of the path

Sources of (1)-(3): Coulter, Implementation of the Pure Pursuit Path Tracking Algorithm,
CMU-RI-TR-92-01; look-ahead by speed as in Snider, Automatic Steering Methods for Autonomous
Automobile Path Tracking, CMU-RI-TR-09-08. The distance is the shortest, in steps of 0.1 s of
driving, that keeps every manoeuvre of `replan.paper.manoeuvres` stable on the single-track vehicle.
Of (4): Thrun et al., Stanley: The Robot that Won the DARPA Grand Challenge, J. Field Robotics 23
(2006), eq. 5; the softening: Hoffmann et al., Autonomous Automobile Trajectory Tracking for
Off-Road Driving, ACC 2007. Of the gains 1, 1.5, 2 and 2.5, tried on the same manoeuvres, 2 is the
best (2.5 loses ISO 3888-2).
"""

from __future__ import annotations

from math import atan, atan2, cos, hypot, sin
from typing import NamedTuple

from replan.core.arrays import FloatArray
from replan.core.kernel import inner_kernel
from replan.logs.states import EgoState, wrap
from replan.replay.vehicle.plan_path import Deviation, path_foot, path_point


class PursuitLaw(NamedTuple):
    """The numbers of (1)-(3): wheelbase m, max_steer rad, time s, shortest and longest distance
    m.
    """

    wheelbase: float
    max_steer: float
    time: float = 0.5
    shortest: float = 3.0
    longest: float = 25.0


@inner_kernel
def steer_pursuing(law: PursuitLaw, now: EgoState, off: Deviation, knots: FloatArray) -> float:
    """Return the front wheel angle to command, rad."""
    wanted = min(max(law.time * now.v, law.shortest), law.longest)  # (1)
    s = off.foot + wanted
    for _ in range(3):  # station at which the distance is as wanted; exact on a straight
        x, y, _, _ = path_point(knots, s)
        s += wanted - hypot(x - now.x, y - now.y)
    x, y, _, _ = path_point(knots, s)
    ahead = max(hypot(x - now.x, y - now.y), 1e-3)
    alpha = atan2(y - now.y, x - now.x) - now.yaw  # (2)
    command = atan(2.0 * law.wheelbase * sin(alpha) / ahead)  # (3)
    return min(max(command, -law.max_steer), law.max_steer)


class StanleyLaw(NamedTuple):
    """The numbers of (4): wheelbase m, max_steer rad, gain 1/s, softening m/s."""

    wheelbase: float
    max_steer: float
    gain: float = 2.0
    softening: float = 1.0


@inner_kernel
def steer_at_front(law: StanleyLaw, now: EgoState, off: Deviation, knots: FloatArray) -> float:
    """Return the front wheel angle to command, rad."""
    x, y = now.x + law.wheelbase * cos(now.yaw), now.y + law.wheelbase * sin(now.yaw)
    rx, ry, yaw, _ = path_point(knots, path_foot(knots, x, y, off.foot + law.wheelbase))
    lateral = (y - ry) * cos(yaw) - (x - rx) * sin(yaw)
    towards = atan(law.gain * lateral / (law.softening + max(now.v, 0.0)))
    command = wrap(yaw - now.yaw) - towards  # (4)
    return min(max(command, -law.max_steer), law.max_steer)
