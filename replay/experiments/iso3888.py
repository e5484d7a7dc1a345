"""The tracks of ISO 3888-1 (double lane change) and -2 (obstacle avoidance): cones, and a path between them.

Lengths and widths in m, with b the vehicle's width; x = 0 at the first cones, the offset lane is to the left:

    3888-1   entry 15, 1.1 b + 0.25  gap 30    offset lane 25, 1.2 b + 0.25, 3.5 left  gap 25    exit 30, 1.3 b + 0.25
    3888-2   entry 12, 1.1 b + 0.25  gap 13.5  offset lane 11, b + 1.0, 1.0 clear      gap 12.5  exit 12, at least 3.0

The 3.5 m are from middle to middle; the 1.0 m from the entry lane's left edge to the offset lane's right edge; the
exit's middle is the entry's. (Other readings are around; these are stated.)

The path y(x) of the rear axle minimises the integral of y''^2 + W y'''^2 with the body between the cones:

(1) lower(x + d) + b / 2 <= y(x) + d y'(x) <= upper(x + d) - b / 2        d from the rear to the front bumper
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from logs.errors import ConfigError
from logs.kernel import FloatArray
from logs.vehicle import VehicleParameters
from planners.qp import QPConfig, QuadraticProgram

STEP_M = 0.5
BEFORE_M, AFTER_M = 60.0, 60.0
JERK_WEIGHT = 100.0
SPARE_M = 0.1
"""Room that the path leaves beside the cones: the body does not point along the path where the tyres slip."""
CONE_SPACING_M = 3.0


@dataclass(frozen=True)
class Section:
    """A lane between cones: from `begin` to `end`, `width`, its middle `offset` to the left; m."""

    begin: float
    end: float
    width: float
    offset: float


def double_lane_change(width: float) -> tuple[Section, ...]:
    """ISO 3888-1 for a vehicle of this width, m."""
    return (
        Section(0.0, 15.0, 1.1 * width + 0.25, 0.0),
        Section(45.0, 70.0, 1.2 * width + 0.25, 3.5),
        Section(95.0, 125.0, 1.3 * width + 0.25, 0.0),
    )


def obstacle_avoidance(width: float) -> tuple[Section, ...]:
    """ISO 3888-2 for a vehicle of this width, m."""
    entry, offset = 1.1 * width + 0.25, width + 1.0
    return (
        Section(0.0, 12.0, entry, 0.0),
        Section(25.5, 36.5, offset, 0.5 * entry + 1.0 + 0.5 * offset),
        Section(49.0, 61.0, max(1.3 * width + 0.25, 3.0), 0.0),
    )


def cones(sections: tuple[Section, ...]) -> FloatArray:
    """Places `(n, 2)`, m: along both edges of each section."""
    rows: list[FloatArray] = []
    for section in sections:
        x = np.linspace(section.begin, section.end, round((section.end - section.begin) / CONE_SPACING_M) + 1)
        edges = [section.offset + side * section.width for side in (-0.5, 0.5)]
        rows.extend(np.column_stack([x, np.full(len(x), edge)]) for edge in edges)
    return np.vstack(rows)


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
