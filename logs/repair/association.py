"""Assigns the detections of a frame to known tracks, for the offline repair and the tracker.

(1) m = e' S^-1 e with the detection's offset e from the predicted place of the track and its covariance S; a detection
    beyond `GATE`, or farther away than the `REACH` of the groups, is another object
(2) cost = m + ln det S + `OTHER_GROUP` if the group differs + `OTHER_SIZE` |ln of the sizes' ratio|: the frame's
    detections are assigned to the tracks with the least sum (Hungarian method)

Only frames up to the present one are used.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from logs.arrays import FloatArray, IntArray, frozen
from logs.kernel import kernel
from logs.repair.detected_boxes import DENSITY, VEHICLE, Boxes
from logs.repair.kalman import ACROSS, ALONG, COS, SIN, WIDTH, X, Y, predict_all, update_one

FIRST_ALONG, FIRST_ACROSS = frozen([10.0, 2.5, 3.0]), frozen([1.5, 2.5, 3.0])
"""Standard deviations of the speed at the first detection along and across the box, m/s: without
them, 29 % of the vehicle tracks began with a step above 2.5 m, 18 % sideways."""
REACH = frozen([4.0, 1.5, 1.5])
"""A detection farther from a track's predicted place is another object, m; Autoware's gates are 2 m."""
GATE = 13.8
"""The 99.9 % quantile of chi squared with 2 degrees of freedom."""
OTHER_GROUP, OTHER_SIZE, MOST_GROWTH, SIZE_MEMORY = 6.0, 2.0, 1.2, 0.8
"""A cluster may become a person and a person a cluster; a vehicle stays a vehicle.

Sizes may differ by a factor of up to e^`MOST_GROWTH`.
"""
AGE_S, YOUNG_AGE_S, YOUNG = 2.0, 0.35, 3
"""A track ends when it is not seen for `AGE_S`, or for `YOUNG_AGE_S` if it has at most `YOUNG` detections. A track that
was detected in the previous frame does not end."""
_NEVER = 1e6
_TRACK = np.dtype(
    [("state", np.float64, WIDTH), ("group", np.int64), ("size", np.float64, 2), ("name", np.int64),
     ("last", np.float64), ("hits", np.int64), ("missed", np.int64)]
)  # fmt: skip
"""Filter, group, size (shorter side first), number in order of birth, last time seen, detections, frames missed
since."""


@dataclass
class Association:
    """The state between two frames: the known `tracks` `(n,)`, the last frame's time, s, and the number of names."""

    tracks: NDArray[np.void] = field(default_factory=lambda: np.zeros(0, _TRACK))
    time: float = 0.0
    count: int = 0

    def steps(self, boxes: Boxes, frames: FloatArray) -> Iterator[tuple[float, slice, IntArray]]:
        """Yield for each frame its time, s, its detections among the boxes, and the names of their tracks."""
        ends = np.searchsorted(boxes.frame, np.arange(len(frames) + 1))
        for k, t in enumerate(frames.tolist()):
            rows = slice(int(ends[k]), int(ends[k + 1]))
            most = np.where(self.tracks["hits"] > YOUNG, AGE_S, YOUNG_AGE_S)
            tracks = self.tracks[(t - self.tracks["last"] <= most + 1e-9) | (self.tracks["missed"] < 1)]
            predict_all(tracks["state"], t - self.time, DENSITY[tracks["group"]])
            # each detection may begin a track
            found, group, variance = np.zeros(rows.stop - rows.start, _TRACK), boxes.group[rows], boxes.noise[rows] ** 2
            state = found["state"]
            place = state[:, :ALONG]
            state[:, X], state[:, Y] = boxes.x[rows], boxes.y[rows]
            state[:, COS], state[:, SIN] = np.cos(boxes.yaw[rows]), np.sin(boxes.yaw[rows])
            state[:, ALONG] = state[:, ACROSS] = variance
            state[:, ALONG + 2], state[:, ACROSS + 2] = FIRST_ALONG[group] ** 2, FIRST_ACROSS[group] ** 2
            found["size"] = np.sort(np.column_stack([boxes.length[rows], boxes.width[rows]]))
            found["group"], found["last"], found["hits"] = group, t, 1
            cost = _costs(tracks["state"], tracks["group"], tracks["size"], place, group, found["size"], variance)
            from scipy.optimize import linear_sum_assignment  # here: it takes long to load

            old, new = linear_sum_assignment(cost)
            good = cost[old, new] < _NEVER
            old, new = old[good], new[good]
            tracks["missed"] += 1
            for j, i in zip(old, new, strict=True):
                update_one(tracks["state"][j], place[i, X], place[i, Y], variance[i])
            tracks["size"][old] = SIZE_MEMORY * tracks["size"][old] + (1.0 - SIZE_MEMORY) * found["size"][new]
            tracks["missed"][old], tracks["last"][old] = 0, t
            tracks["hits"][old] += 1
            born = np.setdiff1d(np.arange(len(found)), new)
            found["name"][new], found["name"][born] = tracks["name"][old], self.count + np.arange(len(born))
            self.tracks, self.time, self.count = np.concatenate([tracks, found[born]]), t, self.count + len(born)
            yield t, rows, found["name"]


@kernel
def _costs(
    states: FloatArray, known: IntArray, sizes: FloatArray,
    place: FloatArray, seen: IntArray, seen_sizes: FloatArray, variance: FloatArray,
) -> FloatArray:  # fmt: skip
    """Return the cost (2) of each pair of track and detection `(n, k)`; `_NEVER` if they are different objects.

    Tracks: `states`, their groups `known`, `sizes`; detections: `place`, their groups `seen`, `seen_sizes`, `variance`.
    """
    out = np.full((len(states), len(place)), _NEVER)
    for i in range(len(states)):
        for j in range(len(place)):
            ex, ey = place[j, X] - states[i, X], place[j, Y] - states[i, Y]
            other = known[i] != seen[j]
            most = max(REACH[known[i]], REACH[seen[j]])
            if ex * ex + ey * ey > most * most or (other and (known[i] == VEHICLE or seen[j] == VEHICLE)):
                continue
            along, across = states[i, COS] * ex + states[i, SIN] * ey, states[i, COS] * ey - states[i, SIN] * ex
            sa, sc = states[i, ALONG] + variance[j], states[i, ACROSS] + variance[j]
            m = along * along / sa + across * across / sc
            growth = max(abs(np.log(sizes[i, 0] / seen_sizes[j, 0])), abs(np.log(sizes[i, 1] / seen_sizes[j, 1])))
            if m <= GATE and growth <= MOST_GROWTH:
                out[i, j] = m + np.log(sa * sc) + OTHER_GROUP * other + OTHER_SIZE * growth
    return out
