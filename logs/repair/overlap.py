"""How much two boxes share, and boxes of one frame that show the same object."""

from __future__ import annotations

from math import cos, hypot, sin

import numpy as np

from logs.kernel import FloatArray, IntArray, kernel
from logs.repair.groups import PERSON, Boxes
from logs.shapes import corners

TWIN_SHARE, TWIN_PART = 0.1, 0.5
"""Two boxes are one object if they share more of their union, or of the smaller one; SimpleTrack removes at 0.25.

Of persons, who walk close together, only the part counts."""
OTHER_PART = 0.7
"""A person's box so deep within a vehicle's is a part of the vehicle, or the other way round."""


@kernel
def shared_area(
    x1: float, y1: float, yaw1: float, length1: float, width1: float,
    x2: float, y2: float, yaw2: float, length2: float, width2: float,
) -> float:  # fmt: skip
    """The area that two boxes share, m2: the second is cut by each side of the first (Sutherland, Hodgman, 1974)."""
    if hypot(x2 - x1, y2 - y1) >= 0.5 * (hypot(length1, width1) + hypot(length2, width2)):
        return 0.0
    c, s = cos(yaw1), sin(yaw1)
    dx, dy = x2 - x1, y2 - y1
    inner, cut, n = np.empty((9, 2)), np.empty((9, 2)), 4
    inner[:4] = corners(c * dx + s * dy, c * dy - s * dx, yaw2 - yaw1, length2, width2)
    for side in range(4):
        axis, sign, reach = side % 2, 1.0 if side < 2 else -1.0, 0.5 * (length1 if side % 2 == 0 else width1)
        kept = 0
        for k in range(n):
            here, there = reach - sign * inner[k, axis], reach - sign * inner[(k + 1) % n, axis]
            if here >= 0.0:
                cut[kept] = inner[k]
                kept += 1
            if here * there < 0.0:
                cut[kept] = inner[k] + here / (here - there) * (inner[(k + 1) % n] - inner[k])
                kept += 1
        inner, cut, n = cut, inner, kept
    area = 0.0
    for k in range(n):
        following = (k + 1) % n
        area += inner[k, 0] * inner[following, 1] - inner[following, 0] * inner[k, 1]
    return max(0.5 * area, 0.0)


def stronger_twins(boxes: Boxes) -> IntArray:
    """For each box the one of its frame that shows the same object better `(m,)`; -1: there is none.

    A box is better by its score; without scores the larger one is, and clusters come last.
    """
    area = boxes.length * boxes.width
    strength = np.where(boxes.group < 2, 1.0, 0.0) + np.nan_to_num(boxes.score)
    order = np.lexsort((-area, -strength, boxes.frame))
    pose = np.column_stack([boxes.x, boxes.y, boxes.yaw, boxes.length, boxes.width])
    starts = np.append(np.unique(boxes.frame[order], return_index=True)[1], len(boxes))
    return _stronger(order, starts, pose, boxes.group)


@kernel
def _stronger(order: IntArray, starts: IntArray, pose: FloatArray, group: IntArray) -> IntArray:
    """`stronger_twins` of boxes `pose` `(m, 5)`, from the strongest of a frame on; `starts`: of frames in `order`."""
    out = np.full(len(pose), -1)
    for frame in range(len(starts) - 1):
        for i in range(starts[frame], starts[frame + 1]):
            a = order[i]
            if out[a] >= 0:
                continue
            for j in range(i + 1, starts[frame + 1]):
                b = order[j]
                if out[b] >= 0:
                    continue
                one, two = pose[a], pose[b]
                both = shared_area(
                    one[0], one[1], one[2], one[3], one[4], two[0], two[1], two[2], two[3], two[4]
                )  # fmt: skip
                areas = one[3] * one[4], two[3] * two[4]
                share, part = both / (areas[0] + areas[1] - both), both / min(areas)
                apart = group[a] != group[b] and group[a] + group[b] == PERSON
                close = group[a] == PERSON and group[b] == PERSON
                if part > (OTHER_PART if apart else TWIN_PART) or (share > TWIN_SHARE and not (apart or close)):
                    out[b] = a
    return out
