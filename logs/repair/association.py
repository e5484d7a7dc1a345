"""Which detection of a frame belongs to which track so far: one piece of code for the offline repair and the tracker.

(1) m = e' S^-1 e with the detection's offset e from where the track should be by now and its covariance S; a detection
    beyond `GATE`, or farther than its group reaches, is another object
(2) cost = m + ln det S + `OTHER_GROUP` if the group differs + `OTHER_SIZE` |ln of the sizes' ratio|: the frame's
    detections are assigned to the tracks with the least sum (Hungarian method)

Only frames up to the present one are used.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from logs.kernel import BoolArray, FloatArray, IntArray, kernel
from logs.repair.groups import DENSITY, FIRST_ACROSS, FIRST_ALONG, REACH, VEHICLE, Boxes
from logs.repair.kalman import ACROSS, ALONG, COS, SIN, VX, VY, WIDTH, absorb_one, carry_all
from logs.repair.kalman import X as PX
from logs.repair.kalman import Y as PY

GATE = 13.8
"""Chi squared with 2 degrees of freedom, 0.999."""
OTHER_GROUP, OTHER_SIZE, MOST_GROWTH = 6.0, 2.0, 1.2
"""Clusters may become persons and back; vehicles join only vehicles. Sizes within a factor of e^1.2."""
AGE_S, YOUNG_AGE_S, YOUNG = 2.0, 0.35, 3
"""A track ends when it was not seen for `AGE_S`, one of up to `YOUNG` detections for `YOUNG_AGE_S`; not before it
missed more than one frame."""
SIZE_MEMORY = 0.8
_NEVER = 1e6


@dataclass
class Association:
    """Tracks so far, `(n,)` each: the memory between two frames."""

    states: FloatArray = field(default_factory=lambda: np.empty((0, WIDTH)))
    group: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    size: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    name: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    last: FloatArray = field(default_factory=lambda: np.empty(0))
    hits: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    missed: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    time: float = 0.0
    count: int = 0

    def step(self, t: float, boxes: Boxes, rows: slice) -> IntArray:
        """The tracks' names, numbers of birth, of the detections `rows` of the frame at t."""
        carry_all(self.states, t - self.time, DENSITY[self.group])
        self.time = t
        self._keep((t - self.last <= np.where(self.hits > YOUNG, AGE_S, YOUNG_AGE_S) + 1e-9) | (self.missed < 1))
        size = np.sort(np.column_stack([boxes.length[rows], boxes.width[rows]]))
        columns = boxes.x[rows], boxes.y[rows], boxes.group[rows], boxes.noise[rows] ** 2
        cost = _costs(self.states, self.group, self.size, *columns, size, REACH)
        tracks, found = linear_sum_assignment(cost)
        good = cost[tracks, found] < _NEVER
        tracks, found = tracks[good], found[good]
        names = np.full(len(size), -1)
        for k, i in zip(tracks, found, strict=True):
            absorb_one(self.states[k], columns[0][i], columns[1][i], columns[3][i])
        self.size[tracks] = SIZE_MEMORY * self.size[tracks] + (1.0 - SIZE_MEMORY) * size[found]
        self.missed += 1
        self.missed[tracks], self.last[tracks] = 0, t
        self.hits[tracks] += 1
        names[found] = self.name[tracks]
        new = np.flatnonzero(names < 0)
        names[new] = self.count + np.arange(len(new))
        self._begin(t, boxes, rows.start + new, size[new])
        return names

    def _keep(self, stay: BoolArray) -> None:
        for name in ("states", "group", "size", "name", "last", "hits", "missed"):
            setattr(self, name, getattr(self, name)[stay])

    def _begin(self, t: float, boxes: Boxes, rows: IntArray, size: FloatArray) -> None:
        """Start a track with each of the detections `rows`."""
        n, group, variance = len(rows), boxes.group[rows], boxes.noise[rows] ** 2
        states = np.zeros((n, WIDTH))
        states[:, PX], states[:, PY] = boxes.x[rows], boxes.y[rows]
        states[:, COS], states[:, SIN] = np.cos(boxes.yaw[rows]), np.sin(boxes.yaw[rows])
        states[:, ALONG] = states[:, ACROSS] = variance
        states[:, ALONG + 2], states[:, ACROSS + 2] = FIRST_ALONG[group] ** 2, FIRST_ACROSS[group] ** 2
        self.states, self.size = np.vstack([self.states, states]), np.vstack([self.size, size])
        self.group = np.append(self.group, group)
        self.name = np.append(self.name, self.count + np.arange(n))
        self.last = np.append(self.last, np.full(n, t))
        self.hits = np.append(self.hits, np.ones(n, np.int64))
        self.missed = np.append(self.missed, np.zeros(n, np.int64))
        self.count += n

    def velocities(self) -> FloatArray:
        """vx, vy `(n, 2)`, m/s."""
        return self.states[:, [VX, VY]]


def joined(boxes: Boxes, frames: FloatArray) -> IntArray:
    """A track number for each box `(m,)`, from the frames up to its own."""
    names = np.empty(len(boxes), np.int64)
    tracks = Association()
    ends = np.searchsorted(boxes.frame, np.arange(len(frames)), side="right")
    for k, t in enumerate(frames.tolist()):
        rows = slice(int(ends[k - 1]) if k else 0, int(ends[k]))
        names[rows] = tracks.step(t, boxes, rows)
    return names


@kernel
def _costs(
    states: FloatArray, group: IntArray, size: FloatArray, x: FloatArray, y: FloatArray, groups: IntArray,
    variance: FloatArray, sizes: FloatArray, reach: FloatArray,
) -> FloatArray:  # fmt: skip
    """(2) of each track and detection `(n, k)`; `_NEVER` where they may not be one."""
    out = np.full((len(states), len(x)), _NEVER)
    for i in range(len(states)):
        for j in range(len(x)):
            ex, ey = x[j] - states[i, PX], y[j] - states[i, PY]
            other = group[i] != groups[j]
            most = max(reach[group[i]], reach[groups[j]])
            if ex * ex + ey * ey > most * most or (other and (group[i] == VEHICLE or groups[j] == VEHICLE)):
                continue
            along, across = states[i, COS] * ex + states[i, SIN] * ey, states[i, COS] * ey - states[i, SIN] * ex
            sa, sc = states[i, ALONG] + variance[j], states[i, ACROSS] + variance[j]
            m = along * along / sa + across * across / sc
            growth = max(abs(np.log(size[i, 0] / sizes[j, 0])), abs(np.log(size[i, 1] / sizes[j, 1])))
            if m <= GATE and growth <= MOST_GROWTH:
                out[i, j] = m + np.log(sa * sc) + OTHER_GROUP * other + OTHER_SIZE * growth
    return out
