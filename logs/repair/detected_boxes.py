"""Detected boxes: constants by group, overlap of boxes, and boxes of a frame that show the same
object.

Most constants have one value each for vehicles, persons (on foot or riding) and clusters, whose
kind is unknown and whose parts split and merge. Constants without another source were measured on
13 city drives at 10 Hz (SFA and cluster detectors of Autoware Mini).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import cos, hypot, sin

import numpy as np

from replan.core.arrays import BoolArray, Columns, FloatArray, IntArray, frozen
from replan.core.kernel import kernel
from replan.logs.agents import USUAL_SIZE_M, AgentKind, among
from replan.logs.shapes import corners

VEHICLE, PERSON, CLUSTER = 0, 1, 2
NOISE, ACCEL = frozen([0.30, 0.20, 0.35]), frozen([3.0, 1.5, 1.5])
"""Standard deviations of a centre, m, of which most drifts slowly (rms 0.22 to 0.30 m of standing
cars), and of the acceleration over `STEP_S`, m/s2 (Autoware's tracker: 0.35 g along, 0.15 g across
cars, 0.3 g for pedestrians)."""
STILL, SLOW, FAST = frozen([1.2, 0.6, 2.0]), frozen([0.6, 0.3, 0.6]), frozen([1.5, 0.5, 1.0])
"""By group: a track that moves less between its first and last third never moves, m; a slower
object stands, m/s; a faster object has a known direction of motion, m/s."""
STEP_S = 0.1
"""The period over which `ACCEL` is constant."""
DENSITY = frozen(ACCEL**2 * STEP_S)
"""Spectral density of the acceleration, m2/s3."""
SLIDES = 0.75
"""A cluster stands unless it moves by more than this share of its length: the visible part of a
standing object changes."""
SURE, UNSURE_NOISE, LEAST_SIZE_M = 0.4, 1.5, 0.1
"""Boxes with a score below `SURE` have `UNSURE_NOISE` times the noise.

`LEAST_SIZE_M`: least side of a box, m.
"""
TWIN_SHARE, TWIN_PART, OTHER_PART = 0.1, 0.5, 0.7
"""Two boxes show one object if they share more than `TWIN_SHARE` of their union, or `TWIN_PART` of
the smaller box (SimpleTrack removes at 0.25). For two persons, who walk close together, only the
part of the smaller box decides; for a person and a vehicle, only `OTHER_PART`."""
_PERSONS, _CLUSTERS = (
    among(*(kind for kind in AgentKind if kind.is_vulnerable)),
    among(AgentKind.OBJECT),
)
_GROUP = frozen(np.where(_CLUSTERS, CLUSTER, np.where(_PERSONS, PERSON, VEHICLE)), np.int64)
_USUAL = frozen([USUAL_SIZE_M[kind] for kind in AgentKind])


@dataclass(frozen=True, eq=False)
class Boxes(Columns):
    """Detections in a defined order within each frame, with missing values filled in: columns of
    `Detections` `(m,)`.

    `source` are indices of the detections, `frame` indices of the frames, `group` is as above,
    `noise` is the standard deviation of the centre, m. The longer side of a cluster is its length;
    a score of 0 is NaN.
    """

    source: IntArray
    frame: IntArray
    t: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    length: FloatArray
    width: FloatArray
    score: FloatArray
    codes: IntArray
    group: IntArray
    noise: FloatArray

    def __len__(self) -> int:
        return len(self.t)

    @cached_property
    def weight(self) -> FloatArray:
        """Weight of each box in votes `(m,)`: its score, 0.05 at least; 0.5 if unknown."""
        return np.where(np.isfinite(self.score), np.maximum(self.score, 0.05), 0.5)

    @classmethod
    def of(
        cls,
        frames: FloatArray,
        t: FloatArray,
        codes: IntArray,
        x: FloatArray,
        y: FloatArray,
        yaw: FloatArray,
        length: FloatArray,
        width: FloatArray,
        score: FloatArray,
    ) -> Boxes:
        """Make the boxes of the columns of detections, in an order that does not depend on theirs
        within a frame.
        """
        order = np.lexsort((length, yaw, y, x, codes, t))
        t, x, y, yaw, score = (column[order] for column in (t, x, y, yaw, score))
        codes, sizes = codes[order], np.column_stack([length, width])[order]
        group = _GROUP[codes]
        sizes = np.maximum(np.where(np.isfinite(sizes), sizes, _USUAL[codes]), LEAST_SIZE_M)
        lying = (group == CLUSTER) & (sizes[:, 0] < sizes[:, 1])
        length, width = np.where(lying, sizes[:, ::-1].T, sizes.T)
        score = np.where(score > 0.0, score, np.nan)
        noise, yaw = (
            NOISE[group] * np.where(score < SURE, UNSURE_NOISE, 1.0),
            yaw + np.where(lying, 0.5 * np.pi, 0.0),
        )
        frame = np.searchsorted(frames, t)
        return cls(order, frame, t, x, y, yaw, length, width, score, codes, group, noise)


YAW, LENGTH, WIDTH = 2, 3, 4
"""Columns of a box (x, y, yaw, length, width)."""


@kernel
def shared_area(one: FloatArray, two: FloatArray) -> float:
    """Return the common area of two boxes `(5,)`, m2, by clipping one with the other (Sutherland,
    Hodgman, 1974).
    """
    dx, dy = two[0] - one[0], two[1] - one[1]
    reaches = hypot(one[LENGTH], one[WIDTH]) + hypot(two[LENGTH], two[WIDTH])
    if hypot(dx, dy) >= 0.5 * reaches:
        return 0.0
    c, s = cos(one[YAW]), sin(one[YAW])
    inner, cut, n = np.empty((9, 2)), np.empty((9, 2)), 4
    inner[:4] = corners(
        c * dx + s * dy, c * dy - s * dx, two[YAW] - one[YAW], two[LENGTH], two[WIDTH]
    )
    for side in range(4):
        axis, sign, count = side % 2, 1.0 if side < 2 else -1.0, 0
        reach = 0.5 * one[LENGTH + axis]
        for k in range(n):
            after = (k + 1) % n
            depth = reach - sign * inner[k, axis]
            next_depth = reach - sign * inner[after, axis]
            if depth >= 0.0:
                cut[count] = inner[k]
                count += 1
            if depth * next_depth < 0.0:
                cut[count] = inner[k] + depth / (depth - next_depth) * (inner[after] - inner[k])
                count += 1
        inner, cut, n = cut, inner, count
    area = 0.0
    for k in range(n):
        following = (k + 1) % n
        area += inner[k, 0] * inner[following, 1] - inner[following, 0] * inner[k, 1]
    return max(0.5 * area, 0.0)


@kernel
def shares(
    t: FloatArray, boxes: FloatArray, times: FloatArray, others: FloatArray, part: float
) -> BoolArray:
    """Return at which t `(k,)` the boxes in `boxes` `(k, 5)` and `others` share more than `part` of
    the smaller.
    """
    covered, j = np.zeros(len(t), np.bool_), 0
    for i in range(len(t)):
        while j < len(times) and times[j] < t[i]:
            j += 1
        if j < len(times) and times[j] == t[i]:
            a, b = boxes[i], others[j]
            smaller = min(a[LENGTH] * a[WIDTH], b[LENGTH] * b[WIDTH])
            covered[i] = shared_area(a, b) > part * smaller
    return covered


def stronger_twins(boxes: Boxes) -> IntArray:
    """Return for each box the better box of the same object in its frame `(m,)`; -1 if there is
    none.

    The higher score is better; if scores are equal or missing, the larger box. Scored or not,
    clusters rank lower by 1.
    """
    strength = np.where(boxes.group < CLUSTER, 1.0, 0.0) + np.nan_to_num(boxes.score)
    order = np.lexsort((-boxes.length * boxes.width, -strength, boxes.frame))
    pose = np.column_stack([boxes.x, boxes.y, boxes.yaw, boxes.length, boxes.width])
    return _stronger(order, boxes.frame, pose, boxes.group)


@kernel
def _stronger(order: IntArray, frame: IntArray, pose: FloatArray, group: IntArray) -> IntArray:
    """Compute `stronger_twins` of boxes `pose` `(m, 5)` in `frame` `(m,)`; `order`: by frame,
    strongest first.
    """
    by = np.full(len(pose), -1)
    for i in range(len(order)):
        a = order[i]
        for j in range(i + 1, len(order)):
            b = order[j]
            if by[a] >= 0 or frame[b] != frame[a]:
                break
            if by[b] >= 0:
                continue
            both, area, other_area = (
                shared_area(pose[a], pose[b]),
                pose[a, 3] * pose[a, 4],
                pose[b, 3] * pose[b, 4],
            )
            share, part = both / (area + other_area - both), both / min(area, other_area)
            apart = group[a] != group[b] and group[a] + group[b] == PERSON
            close = group[a] == PERSON and group[b] == PERSON
            if part > (OTHER_PART if apart else TWIN_PART) or (
                share > TWIN_SHARE and not (apart or close)
            ):
                by[b] = a
    return by
