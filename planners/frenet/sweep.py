"""The sweep of the ego's box along a path: the intervals (1) of `st_boundaries`.

Corners and the curvature of the path are exact, since the boxes themselves are tested: at the
path's points, and between two of them by bisection. Single boxes are tested only where envelopes of
`PART` points of the path and `SAMPLES` samples of a prediction touch. Where no prediction comes
near the path, no boxes are computed.
"""

from __future__ import annotations

from math import cos, hypot, inf, isnan, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.shapes import axis_gap
from replan.logs.states import wrap
from replan.planners.frenet.scene import Bodies, Futures

# Halvings of the path's spacing, about 0.4 m, in the search for the edge of an interval
HALVINGS = 4
JUMP = 0.999  # Share of a gap that the search skips, so that rounding does not skip a touch
PART, SAMPLES = 16, 8
"""Number of points of the path, and of samples of a prediction, in one envelope.

Envelopes are tested first.
"""
ROUNDING_M = 1e-6  # Envelopes nearer than this touch, m


class SweptPath(NamedTuple):
    """A path of the rear axle for the sweep `(points,)`, as in `Path`."""

    sigma: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray


class Roles(NamedTuple):
    """Which agents `(agents,)` the sweep skips, which walk or ride, which need the smallest
    margin.
    """

    skipped: BoolArray
    vulnerable: BoolArray
    passed: BoolArray


class Swept(NamedTuple):
    """The ego's box and the settings of a sweep, for the kernel."""

    # Distance from the rear axle to the box's centre, m; `length` and `width` of the box
    rear_to_center: float
    length: float
    width: float
    margin: float  # As in `StGraphConfig`, m; `vulnerable_margin` and `passed_margin` likewise
    vulnerable_margin: float
    passed_margin: float
    early: float  # (2), s; `late` likewise
    late: float


@kernel
def sweep(
    swept: SweptPath,
    futures: Futures,
    bodies: Bodies,
    roles: Roles,
    ego: Swept,
    now: float,
    stride: int,
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """The fields of `StBoundaries` for the predictions that take the path, at times `stride`
    samples apart.
    """
    t = futures.t[::stride] - now
    x, y = futures.x, futures.y
    yaw, size = futures.yaw, len(futures.agent)
    rows, speed = np.empty(size, np.int64), np.empty(size)
    lower, upper = np.full((size, len(t)), np.nan), np.full((size, len(t)), np.nan)
    low_x, high_x = swept.x.min(), swept.x.max()
    low_y, high_y = swept.y.min(), swept.y.max()
    widest = ego.width + 2.0 * max(ego.margin, ego.vulnerable_margin, ego.passed_margin)
    boxes, moved = _ego_boxes(swept, 0, 0.0, 0.0)
    parts, other = boxes, np.empty((4, len(t)))
    count = 0
    for i in range(size):
        agent = futures.agent[i]
        if roles.skipped[agent]:
            continue
        margin = ego.vulnerable_margin if roles.vulnerable[agent] else ego.margin
        if roles.passed[agent]:
            margin = ego.passed_margin
        ego_size, other_size = (
            (ego.length, ego.width + 2.0 * margin),
            (bodies.length[agent], bodies.width[agent]),
        )
        reach = abs(ego.rear_to_center) + 0.5 * (hypot(*ego_size) + hypot(*other_size))
        is_near = False
        for k in range(0, x.shape[1], stride):
            near_x = low_x - reach <= x[i, k] <= high_x + reach
            is_near |= near_x and low_y - reach <= y[i, k] <= high_y + reach
        if not is_near:
            continue
        if not boxes.shape[1]:
            radius = 0.5 * hypot(ego.length, widest)
            boxes, moved = _ego_boxes(swept, len(swept.x), ego.rear_to_center, radius)
            parts = _envelopes(boxes, np.int64(PART), ego.length, widest)
        for k in range(len(t)):
            other[0, k], other[1, k] = x[i, k * stride], y[i, k * stride]
            other[2, k], other[3, k] = cos(yaw[i, k * stride]), sin(yaw[i, k * stride])
        if _takes(
            swept.sigma,
            boxes,
            moved,
            parts,
            ego_size,
            other,
            other_size,
            lower[count],
            upper[count],
        ):
            rows[count] = i
            entry = _drawn_out(t, lower[count], upper[count], ego.early, ego.late)  # (2)
            entry_point = min(int(np.searchsorted(swept.sigma, entry)), len(swept.sigma) - 1)
            # (3)
            speed[count] = bodies.vx[agent] * cos(swept.yaw[entry_point]) + bodies.vy[agent] * sin(
                swept.yaw[entry_point]
            )
            count += 1
    taking = rows[:count]
    lower, upper = lower[:count].copy(), upper[:count].copy()
    return t, futures.agent[taking], lower, upper, speed[:count].copy(), futures.probability[taking]


@inner_kernel
def _takes(
    sigma: FloatArray,
    boxes: FloatArray,
    moved: float,
    parts: FloatArray,
    ego_size: tuple[float, float],
    other: FloatArray,
    other_size: tuple[float, float],
    lower: FloatArray,
    upper: FloatArray,
) -> bool:
    """Write the intervals (1) `(k,)` of one prediction; return whether there are any.

    Boxes are tested only on those parts of the path whose envelope meets that of some samples of
    the prediction; an agent that does not move is tested once.
    """
    taken = False
    around = _envelopes(other, np.int64(SAMPLES), other_size[0], other_size[1])
    for group in range(around.shape[1]):
        # The points of the parts whose envelopes meet that of these samples; 0, 0: none
        begin, end = 0, 0
        samples = _box_of(around, group)
        for e in range(parts.shape[1]):
            if _touch(samples, _box_of(parts, e), ROUNDING_M):
                begin, end = (begin if end else e * PART), (e + 1) * PART
        if begin == end:
            continue
        end = min(end, boxes.shape[1])
        for k in range(group * SAMPLES, min((group + 1) * SAMPLES, len(lower))):
            before = max(k - 1, 0)
            stays = k > 0 and other[0, k] == other[0, before] and other[1, k] == other[1, before]
            if stays and other[2, k] == other[2, before] and other[3, k] == other[3, before]:
                lower[k], upper[k] = lower[k - 1], upper[k - 1]
                continue
            length, width = other_size
            box = _SweptBox(other[0, k], other[1, k], other[2, k], other[3, k], length, width)
            met = _first_met(boxes, begin, end, moved, ego_size, box)
            if met >= 0:
                leaves = _first_met(boxes, end - 1, met - 1, moved, ego_size, box)
                lower[k] = _edge(sigma, boxes, met, met - 1, ego_size, box)  # (1)
                upper[k] = _edge(sigma, boxes, leaves, leaves + 1, ego_size, box)
                taken = True
    return taken


@inner_kernel
def _ego_boxes(
    swept: SweptPath, count: int, rear_to_center: float, radius: float
) -> tuple[FloatArray, float]:
    """Rows x, y, cos yaw, sin yaw, yaw `(5, count)` of the ego's box along a path.

    The greatest step of a point.
    """
    boxes = np.empty((5, count))
    moved = 1e-6
    for j in range(count):
        c, s = cos(swept.yaw[j]), sin(swept.yaw[j])
        boxes[0, j], boxes[1, j] = swept.x[j] + rear_to_center * c, swept.y[j] + rear_to_center * s
        boxes[2, j], boxes[3, j], boxes[4, j] = c, s, swept.yaw[j]
        if j > 0:
            away = hypot(boxes[0, j] - boxes[0, j - 1], boxes[1, j] - boxes[1, j - 1])
            moved = max(moved, away + radius * abs(wrap(swept.yaw[j] - swept.yaw[j - 1])))
    return boxes, moved


@inner_kernel
def _envelopes(boxes: FloatArray, every: np.int64, length: float, width: float) -> FloatArray:
    """Boxes around groups of a sequence: rows x, y, cos yaw, sin yaw, length, width.

    The sequence has the rows x, y, cos yaw, sin yaw; all boxes have one size. An envelope has the
    heading of its middle box. `every` is not a literal, since numba would compile the function for
    each value.
    """
    envelopes = np.empty((6, (boxes.shape[1] + every - 1) // every))
    for e in range(envelopes.shape[1]):
        begin, end = e * every, min((e + 1) * every, boxes.shape[1])
        m = (begin + end) // 2
        x, y = boxes[0, m], boxes[1, m]
        c, s = boxes[2, m], boxes[3, m]
        rear, front = inf, -inf
        right, left = inf, -inf
        for j in range(begin, end):
            dx, dy = boxes[0, j] - x, boxes[1, j] - y
            along, aside = c * dx + s * dy, c * dy - s * dx
            straight = abs(c * boxes[2, j] + s * boxes[3, j])
            across = abs(c * boxes[3, j] - s * boxes[2, j])
            half_length = 0.5 * (length * straight + width * across)
            half_width = 0.5 * (length * across + width * straight)
            rear, front = min(rear, along - half_length), max(front, along + half_length)
            right, left = min(right, aside - half_width), max(left, aside + half_width)
        along, aside = 0.5 * (rear + front), 0.5 * (right + left)
        envelopes[0, e], envelopes[1, e] = x + c * along - s * aside, y + s * along + c * aside
        envelopes[2, e], envelopes[3, e] = c, s
        envelopes[4, e], envelopes[5, e] = front - rear, left - right
    return envelopes


class _SweptBox(NamedTuple):
    """A box: its centre, m, the cosine and the sine of its heading, its length and width, m."""

    x: float
    y: float
    c: float
    s: float
    length: float
    width: float


@inner_kernel
def _box_of(envelopes: FloatArray, e: int) -> _SweptBox:
    """One of the `_envelopes`."""
    return _SweptBox(
        envelopes[0, e],
        envelopes[1, e],
        envelopes[2, e],
        envelopes[3, e],
        envelopes[4, e],
        envelopes[5, e],
    )


@inner_kernel
def _touch(box: _SweptBox, other: _SweptBox, slack: float) -> bool:
    """Whether two boxes touch, the first one wider by `slack`, m, on each side
    (`replan.logs.shapes`, (1)).
    """
    length, width = 0.5 * box.length + slack, 0.5 * box.width + slack
    other_length, other_width = 0.5 * other.length, 0.5 * other.width
    dx, dy = other.x - box.x, other.y - box.y
    straight = abs(box.c * other.c + box.s * other.s)
    across = abs(box.c * other.s - box.s * other.c)
    return bool(
        abs(dx * box.s - dy * box.c) <= width + other_length * across + other_width * straight
        and abs(dx * box.c + dy * box.s) <= length + other_length * straight + other_width * across
        and abs(dx * other.s - dy * other.c) <= other_width + length * across + width * straight
        and abs(dx * other.c + dy * other.s) <= other_length + length * straight + width * across
    )


@inner_kernel
def _first_met(
    boxes: FloatArray,
    begin: int,
    end: int,
    moved: float,
    size: tuple[float, float],
    other: _SweptBox,
) -> int:
    """The first point from `begin` to `end`, exclusive, forwards or backwards, at which the ego
    meets a box; -1: none.

    It skips points at which the gap cannot have closed: from one to the next no point of the ego's
    box moves farther than `moved` m.
    """
    j, step = begin, 1 if end > begin else -1
    length, width = size
    while (end - j) * step > 0:
        x, y = boxes[0, j], boxes[1, j]
        c, s = boxes[2, j], boxes[3, j]
        gap = axis_gap(
            x,
            y,
            c,
            s,
            length,
            width,
            other.x,
            other.y,
            other.c,
            other.s,
            other.length,
            other.width,
        )
        if gap <= 0.0:
            return j
        j += step * (1 + int(JUMP * gap / moved))
    return -1


@inner_kernel
def _edge(
    sigma: FloatArray,
    boxes: FloatArray,
    met: int,
    free: int,
    size: tuple[float, float],
    other: _SweptBox,
) -> float:
    """The station next to point `met`, which overlaps, towards point `free`, at which the ego does
    not overlap.
    """
    if free < 0 or free >= boxes.shape[1]:
        return sigma[met]
    low, high = 0.0, 1.0  # share of the way from `met` to `free`: overlaps at low, not at high
    length, width = size
    bend = wrap(boxes[4, free] - boxes[4, met])
    for _ in range(HALVINGS):
        u = 0.5 * (low + high)
        x = boxes[0, met] + u * (boxes[0, free] - boxes[0, met])
        y = boxes[1, met] + u * (boxes[1, free] - boxes[1, met])
        yaw = boxes[4, met] + u * bend
        if _touch(_SweptBox(x, y, cos(yaw), sin(yaw), length, width), other, 0.0):
            low = u
        else:
            high = u
    return sigma[met] + high * (sigma[free] - sigma[met])


@inner_kernel
def _drawn_out(
    t: FloatArray, lower: FloatArray, upper: FloatArray, early: float, late: float
) -> float:
    """Extend an interval `(k,)` in time (2); return the station at which the agent enters."""
    entry, leave = 0, len(t) - 1
    while isnan(lower[entry]):
        entry += 1
    while isnan(lower[leave]):
        leave -= 1
    begin = t[entry] - min(early, t[entry] / 3.0)
    end = t[leave] + (min(late, 0.5 * t[leave]) if leave < len(t) - 1 else 0.0)
    for k in range(len(t)):
        if begin <= t[k] < t[entry]:
            lower[k], upper[k] = lower[entry], upper[entry]
        elif t[leave] < t[k] <= end:
            lower[k], upper[k] = lower[leave], upper[leave]
    return lower[entry]
