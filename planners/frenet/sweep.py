"""The sweep behind the S-T boundaries: boxes of the ego along a path against predicted boxes.

Equations (1) to (3) are those of `st_boundaries`. Boxes are tested one by one only where envelopes touch: of `PART`
points of the path, and of `SAMPLES` samples of a prediction. Where no prediction comes near the path, no box is made.
"""

from __future__ import annotations

from math import cos, hypot, inf, isnan, sin
from typing import NamedTuple

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, inner_kernel, kernel
from logs.shapes import axis_gap
from logs.states import wrap

HALVINGS = 4
"""Of the path's spacing, about 0.4 m, towards the edge of an interval."""
JUMP = 0.999
"""Share of a gap that is jumped over, so that rounding does not jump over a touch."""
PART, SAMPLES = 16, 8
"""So many points of the path, and samples of a prediction, are looked at together first, in one envelope each."""
ROUNDING_M = 1e-6
"""Envelopes that are this near count as touching, m."""


class Swept(NamedTuple):
    """What a sweep takes of the ego and of the settings, for the kernel.

    Attributes:
        rear_to_center: From the rear axle to the box's centre, m; `length` and `width` of the box.
        margin: As in `StGraphConfig`, m; `vulnerable_margin` and `passed_margin` likewise.
        early: (2), s; `late` likewise.
    """

    rear_to_center: float
    length: float
    width: float
    margin: float
    vulnerable_margin: float
    passed_margin: float
    early: float
    late: float


@kernel
def sweep(
    sigma: FloatArray, path_x: FloatArray, path_y: FloatArray, path_yaw: FloatArray, times: FloatArray, now: float,
    stride: int, agent: IntArray, probability: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray,
    length: FloatArray, width: FloatArray, vx: FloatArray, vy: FloatArray, vulnerable: BoolArray, passed: BoolArray,
    skip: BoolArray, ego: Swept,
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """The fields of `StBoundaries`: of the predictions that take the path, at times `stride` samples apart.

    The path is `(points,)`, predictions are `(n, k)`; size, velocity, whether they are `vulnerable`, `passed` (empty:
    none is) or to `skip` are the agents'.
    """
    t = times[::stride] - now
    size = len(x)
    rows, speed = np.empty(size, np.int64), np.empty(size)
    lower, upper = np.full((size, len(t)), np.nan), np.full((size, len(t)), np.nan)
    low_x, high_x, low_y, high_y = path_x.min(), path_x.max(), path_y.min(), path_y.max()
    widest = ego.width + 2.0 * max(ego.margin, ego.vulnerable_margin, ego.passed_margin)
    boxes, moved = _ego_boxes(path_x[:0], path_y, path_yaw, 0.0, 0.0)
    parts, other = boxes, np.empty((4, len(t)))
    count = 0
    for i in range(size):
        who = agent[i]
        if skip[who]:
            continue
        margin = ego.vulnerable_margin if vulnerable[who] else ego.margin
        if len(passed) and passed[who]:
            margin = ego.passed_margin
        ego_size, other_size = (ego.length, ego.width + 2.0 * margin), (length[who], width[who])
        reach = abs(ego.rear_to_center) + 0.5 * (hypot(*ego_size) + hypot(*other_size))
        if not _comes_near(x[i], y[i], stride, low_x - reach, high_x + reach, low_y - reach, high_y + reach):
            continue
        if not boxes.shape[1]:
            boxes, moved = _ego_boxes(path_x, path_y, path_yaw, ego.rear_to_center, 0.5 * hypot(ego.length, widest))
            parts = _envelopes(boxes, PART, ego.length, widest)
        for k in range(len(t)):
            other[0, k], other[1, k] = x[i, k * stride], y[i, k * stride]
            other[2, k], other[3, k] = cos(yaw[i, k * stride]), sin(yaw[i, k * stride])
        if _takes(sigma, boxes, moved, parts, ego_size, other, other_size, lower[count], upper[count]):
            rows[count] = i
            entry = _drawn_out(t, lower[count], upper[count], ego.early, ego.late)  # (2)
            at = min(int(np.searchsorted(sigma, entry)), len(sigma) - 1)
            speed[count] = vx[who] * cos(path_yaw[at]) + vy[who] * sin(path_yaw[at])  # (3)
            count += 1
    found = rows[:count]
    return t, agent[found], lower[:count].copy(), upper[:count].copy(), speed[:count].copy(), probability[found]


@inner_kernel
def _comes_near(
    x: FloatArray, y: FloatArray, stride: int, low_x: float, high_x: float, low_y: float, high_y: float
) -> bool:
    """Whether a predicted position `(k,)` lies in a rectangle."""
    near = False
    for k in range(0, len(x), stride):
        near |= low_x <= x[k] <= high_x and low_y <= y[k] <= high_y
    return near


@inner_kernel
def _takes(
    sigma: FloatArray, boxes: FloatArray, moved: float, parts: FloatArray, ego_size: tuple[float, float],
    other: FloatArray, other_size: tuple[float, float], lower: FloatArray, upper: FloatArray,
) -> bool:  # fmt: skip
    """Write the intervals (1) `(k,)` of one prediction; whether there is any.

    Boxes are tested only on those parts of the path whose envelope meets that of some samples of the prediction; who
    stays where they are is tested once.
    """
    taken = False
    around = _envelopes(other, SAMPLES, other_size[0], other_size[1])
    for group in range(around.shape[1]):
        begin, end = _parts_met(parts, around, group)
        end = min(end, boxes.shape[1])
        for k in range(group * SAMPLES, min((group + 1) * SAMPLES, len(lower)) if begin < end else 0):
            if k > 0 and _stays(other, k):
                lower[k], upper[k] = lower[k - 1], upper[k - 1]
                continue
            box = other[0, k], other[1, k], other[2, k], other[3, k], other_size[0], other_size[1]
            met = _first_met(boxes, begin, end, 1, moved, ego_size, box)
            if met >= 0:
                leaves = _first_met(boxes, end - 1, met - 1, -1, moved, ego_size, box)
                lower[k] = _edge(sigma, boxes, met, -1, ego_size, box)  # (1)
                upper[k] = _edge(sigma, boxes, leaves, 1, ego_size, box)
                taken = True
    return taken


@inner_kernel
def _stays(other: FloatArray, k: int) -> bool:
    """Whether a box of a sequence `(4, k)` is where the one before it is."""
    here = other[0, k] == other[0, k - 1] and other[1, k] == other[1, k - 1]
    return bool(here and other[2, k] == other[2, k - 1] and other[3, k] == other[3, k - 1])


@inner_kernel
def _ego_boxes(
    x: FloatArray, y: FloatArray, yaw: FloatArray, rear_to_center: float, radius: float
) -> tuple[FloatArray, float]:
    """Rows x, y, cos yaw, sin yaw, yaw `(5, m)` of the ego's box along a path; how far its points move at most, m."""
    out = np.empty((5, len(x)))
    moved = 1e-6
    for j in range(len(x)):
        c, s = cos(yaw[j]), sin(yaw[j])
        out[0, j], out[1, j] = x[j] + rear_to_center * c, y[j] + rear_to_center * s
        out[2, j], out[3, j], out[4, j] = c, s, yaw[j]
        if j > 0:
            away = hypot(out[0, j] - out[0, j - 1], out[1, j] - out[1, j - 1])
            moved = max(moved, away + radius * abs(wrap(yaw[j] - yaw[j - 1])))
    return out, moved


@inner_kernel
def _envelopes(boxes: FloatArray, every: int, length: float, width: float) -> FloatArray:
    """Boxes around so many of a sequence each: rows x, y, cos yaw, sin yaw, half length, half width.

    The sequence has the rows x, y, cos yaw, sin yaw; all are of one size. An envelope heads as its middle one.
    """
    out = np.empty((6, (boxes.shape[1] + every - 1) // every))
    for e in range(out.shape[1]):
        begin, end = e * every, min((e + 1) * every, boxes.shape[1])
        m = (begin + end) // 2
        x, y, c, s = boxes[0, m], boxes[1, m], boxes[2, m], boxes[3, m]
        rear, front, right, left = inf, -inf, inf, -inf
        for j in range(begin, end):
            dx, dy = boxes[0, j] - x, boxes[1, j] - y
            along, aside = c * dx + s * dy, c * dy - s * dx
            straight, across = abs(c * boxes[2, j] + s * boxes[3, j]), abs(c * boxes[3, j] - s * boxes[2, j])
            half = 0.5 * (length * straight + width * across), 0.5 * (length * across + width * straight)
            rear, front = min(rear, along - half[0]), max(front, along + half[0])
            right, left = min(right, aside - half[1]), max(left, aside + half[1])
        along, aside = 0.5 * (rear + front), 0.5 * (right + left)
        out[0, e], out[1, e] = x + c * along - s * aside, y + s * along + c * aside
        out[2, e], out[3, e], out[4, e], out[5, e] = c, s, 0.5 * (front - rear), 0.5 * (left - right)
    return out


@inner_kernel
def _parts_met(parts: FloatArray, around: FloatArray, group: int) -> tuple[int, int]:
    """From which point of the path to which, exclusive, its parts' envelopes meet one of a prediction; 0, 0: none."""
    begin, end = 0, 0
    x, y, c, s = around[0, group], around[1, group], around[2, group], around[3, group]
    length, width = around[4, group] + ROUNDING_M, around[5, group] + ROUNDING_M
    for e in range(parts.shape[1]):
        part = parts[0, e], parts[1, e], parts[2, e], parts[3, e], parts[4, e], parts[5, e]
        if _touch(x, y, c, s, length, width, part):
            begin, end = (begin if end else e * PART), (e + 1) * PART
    return begin, end


@inner_kernel
def _touch(
    x: float, y: float, c: float, s: float, length: float, width: float,
    other: tuple[float, float, float, float, float, float],
) -> bool:  # fmt: skip
    """Whether boxes x, y, cos yaw, sin yaw, half length, half width touch (`logs.shapes`, (1))."""
    dx, dy = other[0] - x, other[1] - y
    straight, across = abs(c * other[2] + s * other[3]), abs(c * other[3] - s * other[2])
    return bool(
        abs(dx * s - dy * c) <= width + other[4] * across + other[5] * straight
        and abs(dx * c + dy * s) <= length + other[4] * straight + other[5] * across
        and abs(dx * other[3] - dy * other[2]) <= other[5] + length * across + width * straight
        and abs(dx * other[2] + dy * other[3]) <= other[4] + length * straight + width * across
    )


@inner_kernel
def _first_met(
    boxes: FloatArray, begin: int, end: int, step: int, moved: float, size: tuple[float, float],
    other: tuple[float, float, float, float, float, float],
) -> int:  # fmt: skip
    """The first point from `begin` to `end`, exclusive, in steps of +-1, at which the ego overlaps a box; -1: none.

    Points are jumped over at which the gap cannot have closed: from one to the next no point of the ego's box moves
    further than `moved` m. The `other` box is x, y, cos yaw, sin yaw, length, width.
    """
    j = begin
    while (end - j) * step > 0:
        gap = axis_gap(
            boxes[0, j], boxes[1, j], boxes[2, j], boxes[3, j], size[0], size[1],
            other[0], other[1], other[2], other[3], other[4], other[5],
        )  # fmt: skip
        if gap <= 0.0:
            return j
        j += step * (1 + int(JUMP * gap / moved))
    return -1


@inner_kernel
def _edge(
    sigma: FloatArray, boxes: FloatArray, met: int, step: int, size: tuple[float, float],
    other: tuple[float, float, float, float, float, float],
) -> float:  # fmt: skip
    """The station next to point `met`, which overlaps, towards `met + step`, at which the ego does not overlap."""
    free = met + step
    if free < 0 or free >= boxes.shape[1]:
        return sigma[met]
    low, high = 0.0, 1.0  # share of the way from `met` to `free`: overlaps at low, not at high
    around = other[0], other[1], other[2], other[3], 0.5 * other[4], 0.5 * other[5]
    bend = wrap(boxes[4, free] - boxes[4, met])
    for _ in range(HALVINGS):
        u = 0.5 * (low + high)
        x = boxes[0, met] + u * (boxes[0, free] - boxes[0, met])
        y = boxes[1, met] + u * (boxes[1, free] - boxes[1, met])
        yaw = boxes[4, met] + u * bend
        if _touch(x, y, cos(yaw), sin(yaw), 0.5 * size[0], 0.5 * size[1], around):
            low = u
        else:
            high = u
    return sigma[met] + high * (sigma[free] - sigma[met])


@inner_kernel
def _drawn_out(t: FloatArray, lower: FloatArray, upper: FloatArray, early: float, late: float) -> float:
    """Draw an interval `(k,)` out in time (2); returns the station at which the agent enters."""
    first, last = 0, len(t) - 1
    while isnan(lower[first]):
        first += 1
    while isnan(lower[last]):
        last -= 1
    begin = t[first] - min(early, t[first] / 3.0)
    end = t[last] + (min(late, 0.5 * t[last]) if last < len(t) - 1 else 0.0)
    for k in range(len(t)):
        if begin <= t[k] < t[first]:
            lower[k], upper[k] = lower[first], upper[first]
        elif t[last] < t[k] <= end:
            lower[k], upper[k] = lower[last], upper[last]
    return lower[first]
