"""The ego's box beside those of the others: what the kernels of several metrics ask of one pair of boxes."""

from __future__ import annotations

from math import cos, hypot, sin
from typing import NamedTuple

import numpy as np

from logs.kernel import FloatArray, inner_kernel
from logs.scenario import Scenario
from logs.shapes import overlap, time_to_contact
from logs.states import Trajectory
from metrics.others import Others

BEHIND = cos(150.0 / 180.0 * np.pi)
STANDING_MPS = 0.05  # nuPlan devkit e9241677: a road user that is not faster stands
NO_TTC_MPS = 0.005  # Likewise: an ego that is not faster has no time to collision


class Car(NamedTuple):
    """The ego's box, m: rear axle to centre, length, width, and rear axle to front bumper."""

    axle: float
    length: float
    width: float
    front: float


def car_of(scenario: Scenario) -> Car:
    """The ego's box."""
    car = scenario.vehicle
    return Car(float(car.axle_to_center), float(car.length), float(car.width), float(car.axle_to_front))


def ego_boxes(ego: Trajectory, scenario: Scenario) -> FloatArray:
    """The ego's box centre and its velocity vector `(5, k)`: x, y, yaw, vx, vy.

    The centre is l = `axle_to_center` ahead of the rear axle, and turns with it: it moves sideways at l kappa v.
    """
    ahead = scenario.vehicle.axle_to_center
    c, s, aside = np.cos(ego.yaw), np.sin(ego.yaw), ahead * ego.kappa * ego.v
    return np.stack([ego.x + ahead * c, ego.y + ahead * s, ego.yaw, ego.v * c - aside * s, ego.v * s + aside * c])


@inner_kernel
def apart(x: float, y: float, car: Car, others: Others, i: int, k: int) -> float:
    """A lower bound of the distance between box i at step k and the ego's box with the centre (x, y), m."""
    size, reach = others.size, 0.5 * hypot(car.length, car.width)
    return hypot(others.pose[0, i, k] - x, others.pose[1, i, k] - y) - reach - 0.5 * hypot(size[i, 0], size[i, 1])


@inner_kernel
def touches(x: float, y: float, yaw: float, car: Car, others: Others, i: int, k: int) -> bool:
    """Whether box i at step k and the ego's box with this centre and heading touch."""
    pose, size = others.pose, others.size
    return overlap(
        x, y, yaw, car.length, car.width, pose[0, i, k], pose[1, i, k], pose[2, i, k], size[i, 0], size[i, 1]
    )


@inner_kernel
def contact_time(ego: tuple[float, float, float, float, float], car: Car, others: Others, i: int, k: int) -> float:
    """`shapes.time_to_contact` of box i at step k and the ego's box (x, y, yaw, vx, vy), s."""
    pose, size = others.pose, others.size
    return time_to_contact(
        ego[0], ego[1], ego[2], car.length, car.width, ego[3], ego[4], pose[0, i, k], pose[1, i, k], pose[2, i, k],
        size[i, 0], size[i, 1], pose[3, i, k], pose[4, i, k],
    )  # fmt: skip


@inner_kernel
def is_behind(x: float, y: float, yaw: float, other_x: float, other_y: float) -> bool:
    """Whether a point is more than 150 degrees off the heading, seen from the rear axle (x, y)."""
    dx, dy = other_x - x, other_y - y
    return dx * cos(yaw) + dy * sin(yaw) < BEHIND * hypot(dx, dy)
