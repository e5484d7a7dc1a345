"""Chords: the direction of motion of sampled paths, at any rate.

The displacement between two samples shows a direction only if it is larger than the noise of
positions: at 100 Hz, a car at 10 m/s goes 0.1 m in a step. A chord joins two samples of a track
that are about a metre apart:

(1) from an anchor to the first later sample that is at least `WAY_M` away, which is the next
    anchor; an anchor moves on if that takes more than `LONGEST_S`, and no chord spans a step of
    more than `STEP_S`
(2) the heading of a chord is the mean of those at its ends: on an arc, the chord has that direction
(3) the misfit of a velocity is |v - d / dt| / |v|, d the displacement of the chord, v the mean of
    those at its ends
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import kernel
from replan.logs.states import Trajectory, wrapped
from replan.logs.tracks import Tracks

WAY_M = 1.0
"""Least length of a chord, m: more than the noise of positions."""
LONGEST_S = 5.0
"""Longest duration of a chord, s: slower motion is the drift of a standing localisation or box."""
STEP_S = 2.0
"""Longest step within a chord, s: the way within a longer one is not known."""
MOVES_MPS = 1.0
"""Slower agents do not show the frame of their velocities, m/s."""
DIFFER = 0.2
"""Velocities in two frames differ by more than this share of the speed."""
ENOUGH, ENOUGH_M = 3, 5.0
"""Fewer chords, or a shorter way, show nothing."""


@kernel
def _chords(offsets: IntArray, t: FloatArray, x: FloatArray, y: FloatArray) -> IntArray:
    """Return owner, first and last sample of each chord `(3, k)` by (1)."""
    rows, count = np.empty((3, len(t)), np.int64), 0
    for i in range(len(offsets) - 1):
        first = offsets[i]
        for k in range(first + 1, offsets[i + 1]):
            if t[k] - t[k - 1] > STEP_S:
                first = k
            while t[k] - t[first] > LONGEST_S:
                first += 1
            if np.hypot(x[k] - x[first], y[k] - y[first]) >= WAY_M:
                rows[0, count], rows[1, count], rows[2, count] = i, first, k
                count, first = count + 1, k
    return rows[:, :count].copy()


@dataclass(frozen=True, eq=False)
class Chords:
    """Chords (1) of paths, `(k,)` each: owner, first and last sample, displacement `d` `(2, k)`, m,
    within `dt`, s.
    """

    owner: IntArray
    first: IntArray
    last: IntArray
    d: FloatArray
    dt: FloatArray

    @classmethod
    def of(cls, offsets: IntArray, t: FloatArray, x: FloatArray, y: FloatArray) -> Chords:
        """Return the chords of paths with the samples `offsets[i] : offsets[i + 1]`.

        Their times do not decrease.
        """
        # writable: compiled once
        owner, a, b = _chords(np.array(offsets), np.array(t), np.array(x), np.array(y))
        return cls(owner, a, b, np.stack([x[b] - x[a], y[b] - y[a]]), t[b] - t[a])

    @classmethod
    def of_ego(cls, ego: Trajectory) -> Chords:
        """Return the chords of the ego's drive."""
        return cls.of(np.array([0, len(ego)]), ego.t, ego.x, ego.y)

    @classmethod
    def of_tracks(cls, tracks: Tracks) -> Chords:
        """Return the chords of all road users."""
        return cls.of(tracks.offsets, tracks.t, tracks.x, tracks.y)

    def taken(self, keep: BoolArray) -> Chords:
        """Return some of the chords."""
        return Chords(
            self.owner[keep], self.first[keep], self.last[keep], self.d[:, keep], self.dt[keep]
        )

    @cached_property
    def way(self) -> FloatArray:
        """Length `(k,)`, m."""
        return np.asarray(np.hypot(*self.d))

    @cached_property
    def direction(self) -> FloatArray:
        """Direction of motion `(k,)`, rad."""
        return np.asarray(np.arctan2(self.d[1], self.d[0]))

    @property
    def shows(self) -> bool:
        """Whether these are enough to judge."""
        return len(self.way) >= ENOUGH and float(self.way.sum()) >= ENOUGH_M

    def mean(self, values: FloatArray) -> FloatArray:
        """Return the means of `values` `(..., n)` of samples at both ends of each chord
        `(..., k)`.
        """
        return np.asarray(0.5 * (values[..., self.first] + values[..., self.last]))

    def off(self, yaw: FloatArray) -> FloatArray:
        """Return by how much the headings (2) of samples `(n,)` are off the direction of each chord
        `(k,)`, rad.
        """
        return wrapped(
            yaw[self.first] + 0.5 * wrapped(yaw[self.last] - yaw[self.first]) - self.direction
        )

    def misfits(self, velocities: Mapping[str, FloatArray]) -> dict[str, float] | None:
        """Return the median misfit (3) of velocities `(2, n)` by frame; None if too few chords show
        it.

        If enough chords show a difference of the frames, the others do not count.
        """
        v = self.mean(np.stack(list(velocities.values())).swapaxes(0, 1))  # (2, frames, k)
        speed = np.hypot(*v)
        asked = (speed.min(axis=0) > MOVES_MPS) & (self.dt > 0.0)
        differ = asked & (np.hypot(*(v - v[:, :1])).max(axis=0) > DIFFER * speed[0])
        if self.taken(differ).shows:
            asked = differ
        if not self.taken(asked).shows:
            return None
        off = np.hypot(*(v - (self.d / self.dt)[:, None])[..., asked]) / speed[:, asked]
        return dict(zip(velocities, np.median(off, axis=1).tolist(), strict=True))
