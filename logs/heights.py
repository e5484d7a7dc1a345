"""Finds boxes and lanes on another level than the ego's way: on bridges, in tunnels, on other
floors.

The ground is that under the ego's own places within `NEAR_M` of a box, at all times: on a hill, and
where the ego passes under its own way, the box is compared with each of them. A box is

(1) above the way  if its bottom is `ABOVE_M` or more above all that ground, but not `FAR_M`: boxes
                   of what stands on the ground end there
(2) below the way  if its top is `BELOW_M` or more below it, but not `FAR_M`
(3) on the way     otherwise

A road user is left out if `MOST` of its boxes near the way are above it, or below it. Heights of
single boxes of a detector scatter by a metre and more: boxes without a name stay.

Heights show this only if they have one zero. They are not used, and nothing changes, if

(4) the ego's places are steeper than `STEEPEST` in more than a tenth of the way, as heights of
    satellites are; or all boxes have one height, as if they had none
(5) no box near the way is on it, and most of those off it lie along the way: then the zeros differ,
    as a bridge crosses the way
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.names import counted, listed
from replan.logs.road import Lane, Road
from replan.logs.states import Trajectory, wrap, wrapped

NEAR_M = 15.0
ABOVE_M, BELOW_M, FAR_M = 2.5, 1.0, 25.0
MOST = 0.9
STEEPEST = 0.3
"""Steepest road, as a slope."""
SPACING_M = 1.0
"""Distance of the places of the ego that are looked at, m."""
HIGH_M = 1.5
"""Usual height of a box whose height is not known, m."""
ACROSS_RAD = 0.5
"""A box lies across the way if its axis is turned by more than this against it."""
NAMED = 5
_ROWS = 4096


def _thinned(places: FloatArray) -> FloatArray:
    """Return places `(n, 3)` that are at least `SPACING_M` apart along the way."""
    station = np.r_[0.0, np.cumsum(np.hypot(*np.diff(places[:, :2], axis=0).T))]
    return places[np.unique((station // SPACING_M).astype(np.int64), return_index=True)[1]]


def _clearance(
    path: FloatArray, boxes: FloatArray, bottom: FloatArray, top: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return how far boxes `(m, 2)` are above (negative: below) all ground near them, m; 0: they
    are on it, NaN: far from the way. And the direction of the nearest place, rad.
    """
    height, direction = np.full(len(boxes), np.nan), np.zeros(len(boxes))
    heading = np.arctan2(np.gradient(path[:, 1]), np.gradient(path[:, 0]))
    for begin in range(0, len(boxes), _ROWS):
        rows = slice(begin, begin + _ROWS)
        away = np.hypot(*(boxes[rows, None, axis] - path[None, :, axis] for axis in (0, 1)))
        near = away <= NEAR_M
        over = np.where(near, bottom[rows, None] - path[:, 2], np.inf).min(axis=1)
        under = np.where(near, top[rows, None] - path[:, 2], -np.inf).max(axis=1)
        level = np.where((over >= ABOVE_M) & (over <= FAR_M), over, 0.0)
        level = np.where((under <= -BELOW_M) & (under >= -FAR_M), under, level)
        height[rows] = np.where(near.any(axis=1), level, np.nan)
        direction[rows] = heading[away.argmin(axis=1)]
    return height, direction


def on_the_way(
    places: FloatArray,
    boxes: FloatArray,
    yaw: FloatArray,
    height: FloatArray,
    names: Sequence[str],
    notes: list[str],
) -> BoolArray:
    """Return which boxes `(m,)` are not above or below the ego's way, with a note on the others.

    `places` `(n, 3)` are those of the ego's base over time, `boxes` `(m, 3)` centres, in one world,
    m; `yaw` rad; `height` m, NaN where unknown; `names` those of the road users, "" where they have
    none.
    """
    keep = np.ones(len(boxes), np.bool_)
    has_height = np.isfinite(boxes).all(axis=1)
    if len(places) < 2 or not np.isfinite(places).all() or not has_height.any():
        return keep
    half = 0.5 * np.where(np.isfinite(height) & (height > 0.0), height, HIGH_M)
    bottom, top = boxes[:, 2] - half, boxes[:, 2] + half
    low, high = places[:, 2].min(), places[:, 2].max()
    if not (has_height & ((bottom >= low + ABOVE_M) | (top <= high - BELOW_M))).any():
        return keep
    path = _thinned(places)
    steps = np.diff(path, axis=0)
    steep = np.abs(steps[:, 2]) > STEEPEST * np.hypot(steps[:, 0], steps[:, 1])
    if len(path) < 2 or steep.mean() > 0.1 or np.ptp(boxes[has_height, 2]) == 0.0:  # (4)
        return keep
    level = np.full(len(boxes), np.nan)
    direction = np.zeros(len(boxes))
    level[has_height], direction[has_height] = _clearance(
        path, boxes[has_height, :2], bottom[has_height], top[has_height]
    )
    off = np.isfinite(level) & (level != 0.0)
    if not off.any():
        return keep
    across = np.abs(np.sin(wrapped(yaw - direction))) > np.sin(ACROSS_RAD)
    if not (level == 0.0).any() and across[off].mean() < 0.5:  # (5)
        notes.append(
            "The heights of the road users are not used: all of them near the way are "
            f"{np.median(level[off]):+.1f} m off its level."
        )
        return keep
    labels = np.asarray(names, dtype=object).astype(str)
    near = np.isfinite(level)
    users, owner = np.unique(labels, return_inverse=True)
    near_way, above_way, below_way = (
        np.bincount(owner[rows], minlength=len(users)) for rows in (near, level > 0, level < 0)
    )
    gone = (near_way > 0) & (np.maximum(above_way, below_way) >= MOST * near_way)
    gone &= users != ""
    if not gone.any():
        return keep
    keep = ~gone[owner]
    off &= ~keep
    notes.append(
        f"{counted(int(gone.sum()), 'road user')} ({listed(users[gone].tolist(), NAMED)}) above or "
        "below the ego's way: left out, as on bridges, in tunnels or on other floors "
        f"({level[off].min():+.1f} to {level[off].max():+.1f} m from its level)."
    )
    return keep


SPACING_LANE_M = 4.0
"""Distance of the points of a lane's boundary that are looked at, m."""
LANE_ALONG_RAD = 0.6
"""A lane on which the ego drives is turned by less than this against its heading, rad."""


def lanes_off_the_way(
    lanes: Mapping[int, Lane], points: Mapping[int, FloatArray], ego: Trajectory
) -> dict[int, float]:
    """Return the lanes above or below the ego's way, and how far, m.

    `points` `(k, 3)` are those of the boundaries of lanes, m. The ground is the height of the lanes
    that hold the ego's places and point along its heading; where these are on two levels, it is not
    known. A lane is off the way if it is `ABOVE_M` or more off all ground within `NEAR_M`.
    """
    held = {name: _filled(points[name]) for name in lanes if name in points}
    if not held or np.ptp(np.vstack(list(held.values()))[:, 2]) < ABOVE_M:
        return {}
    places = _thinned(np.column_stack([ego.x, ego.y, ego.yaw]))
    road = Road({name: lanes[name] for name in held})
    has_height, own = list[tuple[float, float, float]](), set[int]()
    for x, y, yaw in places.tolist():
        along = [
            lane.id
            for lane in road.lanes_at(x, y)
            if abs(wrap(_direction(lane, x, y) - yaw)) < LANE_ALONG_RAD
        ]
        heights = [_height_at(held[name], x, y) for name in along]
        if heights and max(heights) - min(heights) < ABOVE_M:
            has_height.append((x, y, float(np.median(heights))))
            own.update(along)
    if not has_height:
        return {}
    ground, off = np.array(has_height), dict[int, float]()
    for name, corners in held.items():
        away = np.hypot(*(corners[:, None, axis] - ground[None, :, axis] for axis in (0, 1)))
        near = away <= NEAR_M
        if name in own or not near.any():
            continue
        apart = (corners[:, None, 2] - ground[None, :, 2])[near]
        least = float(apart[np.abs(apart).argmin()])
        if abs(least) >= ABOVE_M and (np.sign(apart) == np.sign(least)).all():
            off[name] = least
    return off


def _filled(points: FloatArray) -> FloatArray:
    """Return points `(n, 3)` with more between those that are more than `SPACING_LANE_M` apart."""
    steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
    stations = np.r_[0.0, np.cumsum(np.maximum(steps, 1e-6))]
    fine = np.union1d(stations, np.arange(0.0, stations[-1], SPACING_LANE_M))
    return np.column_stack([np.interp(fine, stations, points[:, axis]) for axis in range(3)])


def _direction(lane: Lane, x: float, y: float) -> float:
    """Return the direction of a lane's centre line at its point nearest to a place, rad."""
    nearest = int(np.hypot(lane.center[:-1, 0] - x, lane.center[:-1, 1] - y).argmin())
    dx, dy = lane.center[nearest + 1] - lane.center[nearest]
    return float(np.arctan2(dy, dx))


def _height_at(points: FloatArray, x: float, y: float) -> float:
    """Return the height of the point `(k, 3)` nearest to a place, m."""
    return float(points[np.hypot(points[:, 0] - x, points[:, 1] - y).argmin(), 2])
