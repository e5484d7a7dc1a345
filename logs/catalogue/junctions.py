"""A junction of two roads with one lane each way, on which the ego comes along x and has the main road across it.

       5 | 8           1 the ego's lane in, 2 out beside it; 3 straight on, 4 from there
    2 ---+--- 4        5 the main road from the left, 6 its end; 7 from the right, 8 its end
    1 ---+--- 3        inner lanes: 10 a + b leads from lane a to lane b
       6 | 7

Traffic keeps right. Drivers on the side road give way to the main road, and drivers who turn left to oncoming traffic.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from logs.catalogue.roads import LANE_WIDTH_M, Path, curve
from logs.kernel import FloatArray
from logs.road import Lane, Road
from logs.rules import StopLine

HALF_BOX_M = 9.0
"""From the middle of the junction to where its lanes begin."""
CLOTHOID_M = 3.5
WIDENING_M = 2.0
SPACING_M = 5.0
_HALF = 0.5 * LANE_WIDTH_M


@dataclass(frozen=True, eq=False)
class Junction:
    """The roads, the ego's path of the rear axle, and where on it the junction begins and ends (stations, m).

    Attributes:
        center: Of the junction `(x, y)`, m.
        radius: Least radius of the path, m; inf if it goes straight on.
    """

    road: Road
    path: Path
    begin: float
    end: float
    center: tuple[float, float]
    radius: float


def junction(begin: float, beyond: float, main: float, *, turn: float, speed_limit: float) -> Junction:
    """The junction with the ego's path through it.

    Args:
        begin: Length of the ego's lane to the stop line, m.
        beyond: Length of the side road behind the junction, and of the ego's path there, m.
        main: Length of the main road to each side, m.
        turn: Of the ego: 1 left, 0 straight on, -1 right.
        speed_limit: Everywhere, m/s.

    Raises:
        ValueError: No such turn.
    """
    if turn not in (-1, 0, 1):
        raise ValueError(f"turn is {turn:g}: 1 is left, 0 straight on, -1 right")
    x, y = begin + HALF_BOX_M, _HALF
    bend, kappa = _bend(HALF_BOX_M + turn * _HALF, turn)
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
    inner = {13: (56, 78), 42: (56, 78), 56: (), 78: ()} | {own: {18: (42, 56, 78), 13: (56, 78), 16: (56,)}[own]}
    lanes = [
        _straight(i, *each, speed_limit, successors=tuple(k for k in inner if k // 10 == i), beside=True)
        for i, each in ends.items()
    ]
    for i, first in inner.items():
        if i == own and turn:
            lanes.append(_along(i, path.part(begin, end), speed_limit, (i % 10,), first))
        else:
            lanes.append(_straight(i, ends[i // 10][1], ends[i % 10][0], speed_limit, (i % 10,), first))
    stop_lines = tuple(
        StopLine(number, lane.id, np.vstack([lane.right[-1], lane.left[-1]]))
        for number, lane in enumerate((each for each in lanes if each.id in (1, 4)), start=1)
    )
    road = Road({lane.id: lane for lane in lanes}, default_speed_limit=speed_limit, stop_lines=stop_lines)
    return Junction(road, path, begin, end, (x, y), 1.0 / abs(kappa) if kappa else float("inf"))


def _bend(reach: float, turn: float) -> tuple[tuple[tuple[float, float, float], ...], float]:
    """Pieces of a quarter turn that ends `reach` m ahead and as much to the side; and its largest curvature, 1/m."""
    if not turn:
        return ((2.0 * HALF_BOX_M, 0.0, 0.0),), 0.0
    low, high = 1.0 / reach, 2.0 / reach
    for _ in range(50):
        kappa = 0.5 * (low + high)
        low, high = (kappa, high) if curve(*_quarter(kappa)).y[-1] > reach else (low, kappa)
    return tuple((length, turn * one, turn * two) for length, one, two in _quarter(kappa)), turn * kappa


def _quarter(kappa: float) -> tuple[tuple[float, float, float], ...]:
    arc = 0.5 * pi / kappa - CLOTHOID_M
    return (CLOTHOID_M, 0.0, kappa), (arc, kappa, kappa), (CLOTHOID_M, kappa, 0.0)


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
        i, line + left, line - left, successors, left_opposite=beside, left_crossable=False, right_crossable=False,
        speed_limit=speed_limit, kind="urban", yields_to=yields_to,
    )  # fmt: skip


def _along(i: int, path: Path, speed_limit: float, successors: tuple[int, ...], yields_to: tuple[int, ...]) -> Lane:
    """A turning lane along a path: wider in its middle, where a car's front swings out."""
    s: FloatArray = np.linspace(0.0, path.length, max(2, round(path.length) + 1))
    half = _HALF + 0.5 * WIDENING_M * np.sin(pi * s / path.length)
    return Lane(
        i, path.beside(s, half), path.beside(s, -half), successors, left_crossable=False, right_crossable=False,
        speed_limit=speed_limit, kind="urban", yields_to=yields_to,
    )  # fmt: skip
