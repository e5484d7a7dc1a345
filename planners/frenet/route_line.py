"""The reference line of a route.

The centre lines of the route are joined (a lane change is blended over its length) and smoothed by
a QP over points p_i, equally spaced on the raw line r_i:

(1) minimise  w sum |p_{i-1} - 2 p_i + p_{i+1}|^2 + sum |p_i - r_i|^2
        subject to |p_i - r_i| <= MAX_SHIFT_M
(2) p_i = r_i + l_i n_i + t_i m_i,   |l_i| <= ACROSS MAX_SHIFT_M,
        |t_i| <= sqrt(1 - ACROSS^2) MAX_SHIFT_M

(discrete bending energy: the FEM-position-deviation smoother of Apollo's reference lines) with the
normal n_i and the tangent m_i of the raw line: bounds (2) keep the norm in (1), and rotate and
mirror with the world, which bounds on x and y do not. The shift is larger where the line would
otherwise bend more than the car can steer.
"""

from __future__ import annotations

from math import floor, sqrt

import numpy as np
from scipy import sparse

from replan.core.arrays import TIE, FloatArray, arc_lengths
from replan.logs.polylines import nearest, thinned
from replan.logs.reference_line import ReferenceLine
from replan.logs.road import Lane, Road
from replan.logs.route import straight_on
from replan.logs.states import EgoState
from replan.logs.vehicle import VehicleParameters
from replan.planners.solver import QuadraticProgram

SPACING_M = 2.0  # Spacing of the points of (1), m
BENDING_WEIGHT = 50.0  # w of (1)
MAX_SHIFT_M = 0.3
"""Largest shift, m: about the mean over all headings that bounds of 0.25 m on x and y permit across
a line (0.32).
"""
BEND = np.array([1.0, -2.0, 1.0])  # Coefficients of three points in the bending term of (1)
# Share of the shift that a point may make across the line; the rest is along it, as a sharp corner
# needs
ACROSS = 0.97
HARDER = ((0.5, 200.0), (0.75, 1000.0), (1.0, 1000.0), (1.5, 3000.0))
"""Shift (m) and bending weight of further attempts, where the line bends more than a car can
steer.
"""
LOCK_SHARE = 0.9  # Share of the steering lock that a reference line may need
EDGE_M = 0.1  # Distance of the car to the lane's edge that a shift keeps, m
BEYOND_M = 300.0  # Length of the line after the route, m; a plan of 8 s at 130 km/h is shorter


def make_line(
    road: Road, route: tuple[int, ...], ego: EgoState, car: VehicleParameters | None = None
) -> tuple[tuple[int, ...], ReferenceLine]:
    """The lanes of a route, extended straight on for `BEYOND_M` or to the end of the map, and the
    line along them.

    The line is smoothed more where the car could not follow it and the lanes are wide enough.
    """
    lanes, beyond = list(route), 0.0
    while beyond < BEYOND_M:
        onward = straight_on(road, lanes[-1])
        if onward is None or onward in lanes[len(route) :]:
            break
        lanes.append(onward)
        beyond += road.lanes[onward].length
    groups: list[list[Lane]] = []  # each of lanes side by side
    for previous, now in zip((None, *lanes), lanes, strict=False):
        if previous is not None and now in (
            road.lanes[previous].left_neighbour,
            road.lanes[previous].right_neighbour,
        ):
            groups[-1].append(road.lanes[now])
        else:
            groups.append([road.lanes[now]])
    first, *later = groups
    centers = [_blend_centers(first, ego), *(_blend_centers(group, None) for group in later)]
    points = thinned(np.vstack(centers), 1.0)
    across = (road.lanes[lane].left - road.lanes[lane].right for lane in lanes)
    width = min(float(np.median(np.hypot(*edge.T))) for edge in across)
    line = ReferenceLine.through(smooth_points(points))
    room = 0.5 * (width - car.width) - EDGE_M if car is not None else 0.0
    for shift, weight in HARDER:
        if car is None or _sharpest(line) <= LOCK_SHARE * car.max_kappa or room <= MAX_SHIFT_M:
            break
        smoother = ReferenceLine.through(smooth_points(points, min(shift, room), weight))
        line = min(line, smoother, key=_sharpest)
    return tuple(lanes), line


def _sharpest(line: ReferenceLine) -> float:
    return float(np.abs(line.kappa).max())


def smooth_points(
    points: FloatArray, max_shift: float = MAX_SHIFT_M, weight: float = BENDING_WEIGHT
) -> FloatArray:
    """The polyline `(n, 2)`, equally spaced and smoothed by (1).

    Unchanged if it is too short or the QP fails.
    """
    chord = arc_lengths(*points.T)
    count = floor(chord[-1] / SPACING_M + 0.5 - TIE) + 1
    if count < 4:
        return points
    stations = np.linspace(0.0, chord[-1], count)
    raw = np.column_stack([np.interp(stations, chord, points[:, k]) for k in (0, 1)])
    tangent = np.gradient(raw, axis=0)
    tangent /= np.maximum(np.hypot(*tangent.T)[:, None], 1e-9)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    three = np.arange(count - 2)[:, None] + np.arange(3)
    places = np.hstack([three, three + count]).ravel(), np.arange(0, 6 * count - 11, 6)
    bends = [
        sparse.csr_matrix(
            (np.hstack([BEND * axis[three, k] for axis in (normal, tangent)]).ravel(), *places)
        )
        for k in (0, 1)
    ]
    # (1)
    P = (weight * (bends[0].T @ bends[0] + bends[1].T @ bends[1]) + sparse.eye(2 * count)).tocsc()
    solver = QuadraticProgram("reference line", P, sparse.eye(2 * count, format="csc"))
    shift = np.full(count, max_shift)
    shift[[0, -1]] = 0.0
    bent = raw[:-2] - 2.0 * raw[1:-1] + raw[2:]
    gradient = weight * (bends[0].T @ bent[:, 0] + bends[1].T @ bent[:, 1])
    most = np.r_[ACROSS * shift, sqrt(1.0 - ACROSS**2) * shift]  # (2)
    move = solver.solve(gradient, -most, most, fresh=True)
    if not move.report.solved:
        return raw
    across, along = move.x.reshape(2, count, 1)
    return raw + across * normal + along * tangent


def _blend_centers(group: list[Lane], ego: EgoState | None) -> FloatArray:
    """The centre line of lanes side by side: from the first to the last lane, over the rest of
    their length.
    """
    if len(group) == 1:
        return group[0].center
    u = np.linspace(0.0, 1.0, max(2, floor(group[0].length + TIE) + 1))
    resampled = []
    for points in (group[0].center, group[-1].center):
        chord = arc_lengths(*points.T)
        resampled.append(
            np.column_stack([np.interp(u * chord[-1], chord, points[:, k]) for k in (0, 1)])
        )
    first, last = resampled
    begin = 0.0
    if ego is not None:
        begin = float(u[nearest(first, ego.x, ego.y)])
    share = (3.0 * max(ego.v if ego else 0.0, 5.0) * (len(group) - 1) + 10.0) / group[0].length
    end = min(1.0, begin + max(share, 1e-3))
    w = np.clip((u - begin) / max(end - begin, 1e-9), 0.0, 1.0)
    w = w * w * w * (10.0 - 15.0 * w + 6.0 * w * w)
    return (1.0 - w)[:, None] * first + w[:, None] * last
