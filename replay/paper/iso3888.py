"""The path of a vehicle through the tracks of ISO 3888 (`logs.catalogue.iso3888`), between their cones.

The path y(x) of the rear axle minimises the integral of y''^2 + W y'''^2 with the body between the cones:

(1) lower(x + d) + b / 2 <= y(x) + d y'(x) <= upper(x + d) - b / 2        d from the rear to the front bumper
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from logs.catalogue.iso3888 import Section, cones, double_lane_change, obstacle_avoidance
from logs.errors import ConfigError
from logs.kernel import FloatArray
from logs.vehicle import VehicleParameters
from planners.qp import QPConfig, QuadraticProgram

__all__ = ["Section", "cones", "double_lane_change", "hit", "obstacle_avoidance", "path"]
STEP_M = 0.5
BEFORE_M, AFTER_M = 60.0, 60.0
JERK_WEIGHT = 100.0
SPARE_M = 0.1
"""Room that the path leaves beside the cones: the body does not point along the path where the tyres slip."""


def hit(places: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, car: VehicleParameters) -> int:
    """How many of the cones the vehicle's box touched, by the states of its rear axle `(m,)`."""
    dx, dy = places[:, 0, None] - x, places[:, 1, None] - y
    along, left = dx * np.cos(yaw) + dy * np.sin(yaw), dy * np.cos(yaw) - dx * np.sin(yaw)
    inside = (along >= -car.rear_overhang) & (along <= car.axle_to_front) & (np.abs(left) <= 0.5 * car.width)
    return int(inside.any(axis=1).sum())


def path(sections: tuple[Section, ...], car: VehicleParameters) -> FloatArray:
    """The path (1) `(n, 2)` of the rear axle, STEP_M apart in x.

    Raises:
        ConfigError: The vehicle does not fit.
    """
    x = np.arange(-BEFORE_M, sections[-1].end + AFTER_M + 0.5 * STEP_M, STEP_M)
    n = len(x)
    second, third = _differences(n, 2), _differences(n, 3)
    P = sparse.csc_matrix(second.T @ second) + sparse.csc_matrix(JERK_WEIGHT * (third.T @ third))
    slope = sparse.csc_matrix(np.gradient(np.eye(n), STEP_M, axis=0))
    rows, lower, upper = [], [], []
    for d in np.linspace(-car.rear_overhang, car.axle_to_front, 6):
        for section in sections:
            for i in np.flatnonzero((x + d >= section.begin - STEP_M) & (x + d <= section.end + STEP_M)):
                rows.append((i, d))
                room = 0.5 * (section.width - car.width) - SPARE_M
                lower.append(section.offset - room)
                upper.append(section.offset + room)
    index, ahead = (np.array(column) for column in zip(*rows, strict=True))
    eye = sparse.identity(n, format="csr")
    ends = sparse.vstack([eye[:4], eye[-4:]])
    A = sparse.vstack([ends, eye[index] + sparse.diags(ahead) @ slope.tocsr()[index]]).tocsc()
    zero = np.zeros(8)
    program = QuadraticProgram("iso3888", sparse.csc_matrix(P), A, equalities=8, config=QPConfig(tolerance=1e-3))
    result = program.solve(np.zeros(n), np.r_[zero, lower], np.r_[zero, upper], fresh=True)
    if not result.report.solved:
        raise ConfigError(f"no path between the cones for a vehicle {car.width} m wide: {result.report.status}")
    return np.column_stack([x, result.x])


def _differences(n: int, order: int) -> FloatArray:
    """Derivatives of an order by differences, `(n - order, n)`."""
    return np.diff(np.eye(n), order, axis=0) / STEP_M**order
