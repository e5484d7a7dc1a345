"""Paths by curvature, and roads along them.

A path is a fine table of a curve by its arc length s, from piecewise linear curvature (straights,
arcs, clothoids):

(1) yaw' = kappa(s), exact on each piece (yaw is quadratic in s)
(2) x' = cos yaw, y' = sin yaw, by Simpson's rule on steps of 0.05 m (error below 1e-9 m per step)

Lateral motion on a straight road is a chain of quintic lane shifts (Werling et al., ICRA 2010, with
lateral speed and acceleration 0 at both ends): l(u) = 10 u^3 - 15 u^4 + 6 u^5.

A junction: two roads with one lane each way; the ego comes along x and has the main road across it.

       5 | 8           1 the ego's lane in, 2 out beside it; 3 straight on, 4 from there
    2 ---+--- 4        5 the main road from the left, 6 its end; 7 from the right, 8 its end
    1 ---+--- 3        inner lanes: 10 a + b leads from lane a to lane b
       6 | 7

Traffic keeps right. Drivers on the side road give way to the main road, and drivers who turn left
to oncoming traffic.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import copysign, pi

import numpy as np

from replan.core.arrays import FloatArray, frozen
from replan.logs.road import Lane, Road
from replan.logs.rules import StopLine

STEP_M = 0.05
LANE_WIDTH_M = 3.5
HALF_BOX_M = 9.0
"""Distance from the middle of the junction to the begin of its lanes, m."""
CLOTHOID_M = 3.5
WIDENING_M = 2.0
SPACING_M = 5.0
_HALF = 0.5 * LANE_WIDTH_M


@dataclass(frozen=True, eq=False)
class CurveSamples:
    """A curve by arc length: `(n,)` columns s, x, y (m), yaw (rad, unwrapped), kappa (1/m)."""

    s: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    kappa: FloatArray

    def __post_init__(self) -> None:
        for name in ("s", "x", "y", "yaw", "kappa"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def length(self) -> float:
        """Length of the path, m."""
        return float(self.s[-1])

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Columns x, y, yaw, kappa at stations `(k,)` within the path."""
        x, y, yaw, kappa = (
            np.asarray(np.interp(s, self.s, column))
            for column in (self.x, self.y, self.yaw, self.kappa)
        )
        return x, y, yaw, kappa

    def part(self, begin: float, end: float) -> CurveSamples:
        """The path between two of its stations; the new stations begin at 0."""
        s = np.linspace(begin, end, max(2, round((end - begin) / STEP_M) + 1))
        return CurveSamples(s - begin, *self.at(s))

    def beside(self, s: FloatArray, left: float | FloatArray) -> FloatArray:
        """Points `(k, 2)` at stations `(k,)`, `left` m to the left of the path."""
        x, y, yaw, _ = self.at(s)
        return np.column_stack([x - left * np.sin(yaw), y + left * np.cos(yaw)])


def curve(*pieces: tuple[float, float, float]) -> CurveSamples:
    """The path of pieces (length m, kappa at begin and end) from the origin along x; ValueError
    without lengths.
    """
    if not all(np.isfinite(length) and length >= 0.0 for length, *_ in pieces):
        raise ValueError(
            f"a piece of the road has no length: {[round(length, 2) for length, *_ in pieces]} m"
        )
    ends = np.cumsum([0.0, *(length for length, *_ in pieces)])
    count = round(ends[-1] / STEP_M)
    fine = np.linspace(0.0, ends[-1], 2 * count + 1)
    yaw, kappa, turned = np.zeros(len(fine)), np.zeros(len(fine)), 0.0
    for (length, first, last), begin in zip(pieces, ends, strict=False):
        u = fine - begin
        on = (u >= 0.0) & (length > 0.0)
        slope = (last - first) / length if length > 0.0 else 0.0
        kappa[on] = first + slope * u[on]
        yaw[on] = turned + (first + 0.5 * slope * u[on]) * u[on]
        turned += 0.5 * (first + last) * length
    columns = []
    for rate in (np.cos(yaw), np.sin(yaw)):  # `fine` holds each step's ends and its middle
        # (2)
        step = (fine[2::2] - fine[:-2:2]) * (rate[:-2:2] + 4.0 * rate[1::2] + rate[2::2]) / 6.0
        columns.append(np.r_[0.0, np.cumsum(step)])
    return CurveSamples(fine[::2], columns[0], columns[1], yaw[::2], kappa[::2])


Pieces = tuple[tuple[float, float, float], ...]
"""Pieces of `curve`: length, m, curvature at begin and end, 1/m."""


def left_turn(arc: float, kappa: float, clothoid: float) -> Pieces:
    """An arc of `arc` m with the curvature `kappa`, 1/m, between two clothoids, m."""
    return (clothoid, 0.0, kappa), (arc, kappa, kappa), (clothoid, kappa, 0.0)


def opposite(pieces: Pieces) -> Pieces:
    """The pieces mirrored: a left turn becomes a right turn."""
    return tuple((length, -begin, -end) for length, begin, end in pieces)


def weaving(length: float, shifts: Sequence[tuple[float, float, float]]) -> CurveSamples:
    """A path along the x axis with lane shifts `(begin m, end m, lateral offset after it m)`, in
    order.
    """
    x = np.linspace(0.0, length, round(length / STEP_M) + 1)
    y, slope, bend = np.zeros((3, len(x)))
    offset = 0.0
    for begin, end, target in shifts:
        run, rise = end - begin, target - offset
        u = np.clip((x - begin) / run, 0.0, 1.0)
        y += rise * (10.0 - 15.0 * u + 6.0 * u**2) * u**3
        slope += rise * 30.0 * (u * (1.0 - u)) ** 2 / run
        bend += rise * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / run**2
        offset = target
    speed = np.hypot(1.0, slope)
    s = np.r_[0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(x))]
    return CurveSamples(s, x, y, np.arctan(slope), bend / speed**3)


def lane_beside(
    path: CurveSamples,
    lane_id: int,
    *,
    speed_limit: float,
    left: float = 0.0,
    width: float = LANE_WIDTH_M,
    left_neighbour: int | None = None,
    right_neighbour: int | None = None,
) -> Lane:
    """A lane along the whole path, its middle `left` m to the left of it.

    Cross-sections about every 2 m.
    """
    stations = np.linspace(0.0, path.length, round(path.length / 2.0) + 1)
    return Lane(
        lane_id,
        path.beside(stations, left + 0.5 * width),
        path.beside(stations, left - 0.5 * width),
        left_neighbour=left_neighbour,
        right_neighbour=right_neighbour,
        left_crossable=left_neighbour is not None,
        right_crossable=right_neighbour is not None,
        speed_limit=speed_limit,
        kind="urban",
    )


def one_lane(path: CurveSamples, speed_limit: float, *, sidewalk: float = 0.0) -> Road:
    """One lane, with sidewalks of this width (m) on both sides where it is positive."""
    own = lane_beside(path, 1, speed_limit=speed_limit)
    walks = sidewalks(path, {2: _HALF, 3: -_HALF}, sidewalk, speed_limit)
    return Road({1: own, **walks}, default_speed_limit=speed_limit)


def sidewalks(
    path: CurveSamples, kerbs: Mapping[int, float], width: float, speed_limit: float
) -> dict[int, Lane]:
    """Sidewalks of this width, m, by id, beyond kerbs that are so far to the left of the path, m;
    none without a width.
    """
    lanes = {}
    for i, kerb in kerbs.items() if width > 0.0 else ():
        left = kerb + copysign(0.5 * width, kerb)
        walk = lane_beside(path, i, left=left, width=width, speed_limit=speed_limit)
        lanes[i] = replace(walk, drivable=False, kind="sidewalk")
    return lanes


def two_lanes(path: CurveSamples, speed_limit: float, *, ego_on_right: bool) -> Road:
    """Two lanes in one direction; the ego's is lane 1 and lies on the path, lane 2 beside it."""
    if ego_on_right:
        own = lane_beside(path, 1, speed_limit=speed_limit, left_neighbour=2)
        other = lane_beside(path, 2, left=LANE_WIDTH_M, speed_limit=speed_limit, right_neighbour=1)
    else:
        own = lane_beside(path, 1, speed_limit=speed_limit, right_neighbour=2)
        other = lane_beside(path, 2, left=-LANE_WIDTH_M, speed_limit=speed_limit, left_neighbour=1)
    return Road({1: own, 2: other}, default_speed_limit=speed_limit)


def two_way(path: CurveSamples, speed_limit: float, *, sidewalk: float = 0.0) -> Road:
    """The ego's lane 1 on the path, and lane 2 to its left, driven back; with sidewalks as
    `one_lane`.

    The marking between may be crossed.
    """
    own = lane_beside(path, 1, speed_limit=speed_limit)
    beside = lane_beside(path, 2, left=LANE_WIDTH_M, speed_limit=speed_limit)
    own = replace(own, left_opposite=True, left_crossable=True)
    back = replace(
        beside,
        left=beside.right[::-1],
        right=beside.left[::-1],
        left_opposite=True,
        left_crossable=True,
    )
    walks = sidewalks(path, {3: 3.0 * _HALF, 4: -_HALF}, sidewalk, speed_limit)
    return Road({1: own, 2: back, **walks}, default_speed_limit=speed_limit)


def lanes_to_stop_lines(
    path: CurveSamples, lights: Mapping[float, int | None], speed_limit: float
) -> Road:
    """One lane with stop lines, which part it: their stations on the path, m, each with its light;
    None: a stop sign.
    """
    ends = list(enumerate(pairwise((0.0, *lights, path.length)), start=1))
    lanes = {
        i: replace(
            lane_beside(path.part(*part), i, speed_limit=speed_limit),
            successors=(i + 1,) if i < len(ends) else (),
        )
        for i, part in ends
    }
    stop_lines = tuple(
        StopLine(i, i, np.vstack([lanes[i].right[-1], lanes[i].left[-1]]), light, light is None)
        for i, light in enumerate(lights.values(), start=1)
    )
    return Road(lanes, default_speed_limit=speed_limit, stop_lines=stop_lines)


def stretch(
    path: CurveSamples, begin: float, end: float, *, right: float, left: float
) -> FloatArray:
    """Outline `(k, 2)` of the strip from station `begin` to `end`, from `right` to `left` of the
    path (m, signed).
    """
    stations = np.linspace(begin, end, max(2, round((end - begin) / 2.0) + 1))
    return np.vstack([path.beside(stations, left), path.beside(stations, right)[::-1]])


@dataclass(frozen=True, eq=False)
class Junction:
    """The roads, the ego's path of the rear axle, and where on it the junction begins and ends
    (stations, m).
    """

    road: Road
    path: CurveSamples
    begin: float
    end: float
    center: tuple[float, float]  # centre of the junction `(x, y)`, m
    radius: float  # least radius of the path, m; inf if it goes straight on


def junction(
    begin: float, beyond: float, main: float, *, turn: float, speed_limit: float
) -> Junction:
    """The junction with the ego's path through it; `turn` is 1 (left), 0 (straight on) or -1
    (right), or a ValueError.

    `begin` is the length of the ego's lane to the stop line, `beyond` that of the side road and of
    the ego's path behind the junction, `main` that of the main road to each side, m; `speed_limit`
    that of all lanes, m/s.
    """
    if turn not in (-1, 0, 1):
        raise ValueError(f"turn is {turn:g}: 1 is left, 0 straight on, -1 right")
    x, y = begin + HALF_BOX_M, _HALF
    reach, kappa = HALF_BOX_M + turn * _HALF, 0.0
    bend: Pieces = ((2.0 * HALF_BOX_M, 0.0, 0.0),)
    if turn:  # a quarter turn that ends `reach` m ahead and `reach` m to the side
        low, high = 1.0 / reach, 2.0 / reach
        for _ in range(50):
            kappa = 0.5 * (low + high)
            low, high = (kappa, high) if curve(*_quarter(kappa)).y[-1] > reach else (low, kappa)
        bend = _quarter(kappa) if turn > 0.0 else opposite(_quarter(kappa))
    path = curve((begin, 0.0, 0.0), *bend, (beyond, 0.0, 0.0))
    end = begin + sum(length for length, *_ in bend)
    ends = {
        1: ((0.0, 0.0), (x - HALF_BOX_M, 0.0)),
        2: ((x - HALF_BOX_M, LANE_WIDTH_M), (0.0, LANE_WIDTH_M)),
        3: ((x + HALF_BOX_M, 0.0), (x + HALF_BOX_M + beyond, 0.0)),
        4: ((x + HALF_BOX_M + beyond, LANE_WIDTH_M), (x + HALF_BOX_M, LANE_WIDTH_M)),
        5: ((x - _HALF, y + main), (x - _HALF, y + HALF_BOX_M)),
        6: ((x - _HALF, y - HALF_BOX_M), (x - _HALF, y - main)),
        7: ((x + _HALF, y - main), (x + _HALF, y - HALF_BOX_M)),
        8: ((x + _HALF, y + HALF_BOX_M), (x + _HALF, y + main)),
    }
    own = {1.0: 18, 0.0: 13, -1.0: 16}[turn]
    inner = {13: (56, 78), 42: (56, 78), 56: (), 78: ()} | {
        own: {18: (42, 56, 78), 13: (56, 78), 16: (56,)}[own]
    }
    lanes = [
        _straight(
            i, *line, speed_limit, successors=tuple(k for k in inner if k // 10 == i), beside=True
        )
        for i, line in ends.items()
    ]
    for i, first in inner.items():
        if i == own and turn:
            turning = path.part(begin, end)
            s = np.linspace(0.0, turning.length, max(2, round(turning.length) + 1))
            # Wider in its middle, for the front
            half = _HALF + 0.5 * WIDENING_M * np.sin(pi * s / turning.length)
            lanes.append(
                Lane(
                    i,
                    turning.beside(s, half),
                    turning.beside(s, -half),
                    (i % 10,),
                    left_crossable=False,
                    right_crossable=False,
                    speed_limit=speed_limit,
                    kind="urban",
                    yields_to=first,
                )
            )
        else:
            lanes.append(
                _straight(i, ends[i // 10][1], ends[i % 10][0], speed_limit, (i % 10,), first)
            )
    by_id = {lane.id: lane for lane in lanes}
    stop_lines = tuple(
        StopLine(number, entry, np.vstack([by_id[entry].right[-1], by_id[entry].left[-1]]))
        for number, entry in enumerate((1, 4), start=1)
    )
    road = Road(by_id, default_speed_limit=speed_limit, stop_lines=stop_lines)
    return Junction(road, path, begin, end, (x, y), 1.0 / kappa if kappa else float("inf"))


def _quarter(kappa: float) -> Pieces:
    """A left turn by 90 degrees with the largest curvature `kappa`, 1/m, as pieces of `curve`."""
    return left_turn(0.5 * pi / kappa - CLOTHOID_M, kappa, CLOTHOID_M)


def _straight(
    i: int,
    begin: tuple[float, float],
    end: tuple[float, float],
    speed_limit: float,
    successors: tuple[int, ...] = (),
    yields_to: tuple[int, ...] = (),
    *,
    beside: bool = False,
) -> Lane:
    """A straight lane; `beside`: the opposite lane is to its left, beyond a solid line."""
    first, last = np.array(begin), np.array(end)
    length = float(np.hypot(*(last - first)))
    along = (last - first) / length
    u = np.linspace(0.0, length, max(2, round(length / SPACING_M) + 1))[:, None]
    line, left = first + u * along, _HALF * np.array([-along[1], along[0]])
    return Lane(
        i,
        line + left,
        line - left,
        successors,
        left_opposite=beside,
        left_crossable=False,
        right_crossable=False,
        speed_limit=speed_limit,
        kind="urban",
        yields_to=yields_to,
    )
