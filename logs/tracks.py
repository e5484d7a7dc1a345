"""Road users over time, as ragged tracks: as perceived at a time, without later samples, and in
truth.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from replan.core.arrays import BoolArray, FloatArray, IntArray, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.logs.agents import OLDEST_S, AgentKind, Agents, among, codes_of
from replan.logs.motion import Motion, estimated
from replan.logs.observed import MAX_AGE_S, MAX_GAP_S, patience
from replan.logs.states import MOST_RAD

TREND_S = 1.0
"""Longest span of the backward differences for yaw rate and acceleration, s.

Rarer samples use one step back.
"""
BEGIN_S = 0.1
"""A road user with a sample by this time was present at the scenario's start: one interval at 10
Hz, s.
"""
TRACK_COLUMNS, SAMPLE_COLUMNS = ("length", "width", "static"), ("t", "x", "y", "yaw", "vx", "vy")
"""The arrays of `Tracks` with an entry per track, and per sample."""
_TURNING = among(*(kind for kind in AgentKind if kind is not AgentKind.PEDESTRIAN))
_NOT_ASKED = frozen(np.empty(0))


@kernel
def _last_samples(offsets: IntArray, t: FloatArray, time: float) -> IntArray:
    """Return per track the index of its last sample not later than `time`; -1 if there is none."""
    samples = np.empty(len(offsets) - 1, np.int64)
    for i in range(len(samples)):
        k = np.searchsorted(t[offsets[i] : offsets[i + 1]], time + 1e-9, side="right")
        samples[i] = offsets[i] + k - 1 if k > 0 else -1
    return samples


@kernel
def _trends(
    rows: IntArray,
    samples: IntArray,
    offsets: IntArray,
    t: FloatArray,
    yaw: FloatArray,
    x: FloatArray,
    y: FloatArray,
    vx: FloatArray,
    vy: FloatArray,
    speed: FloatArray,
) -> FloatArray:
    """`_trend` of tracks `rows` at `samples`, `(2, n)`; `speed` `(n,)` is the speed at those
    samples.
    """
    trends = np.empty((2, len(rows)))
    for i in range(len(rows)):
        trends[0, i], trends[1, i] = _trend(
            offsets[rows[i]], samples[i], t, yaw, x, y, vx, vy, speed[i]
        )
    return trends


@inner_kernel
def _trend(
    first: int,
    last: int,
    t: FloatArray,
    yaw: FloatArray,
    x: FloatArray,
    y: FloatArray,
    vx: FloatArray,
    vy: FloatArray,
    speed: float,
) -> tuple[float, float]:
    """Return yaw rate and acceleration over the last `TREND_S` before sample `last`; 0 if unknown.

    The earlier speed is the logged one, else a backward difference.
    """
    k = last
    while k > first and t[last] - t[k - 1] <= TREND_S + 1e-9:
        k -= 1
    if k == last and k > first and t[last] - t[k - 1] <= 2.0 * TREND_S:
        k -= 1
    if k == last:
        return 0.0, 0.0
    span = t[last] - t[k]
    was_x, was_y = vx[k], vy[k]
    if not np.isfinite(was_x + was_y) and k > first:
        was_x, was_y = (x[k] - x[k - 1]) / (t[k] - t[k - 1]), (y[k] - y[k - 1]) / (t[k] - t[k - 1])
    accel = (speed - np.hypot(was_x, was_y)) / span if np.isfinite(was_x + was_y) else 0.0
    return (yaw[last] - yaw[k]) / span, accel


@kernel
def _perceived_rows(
    offsets: IntArray,
    static: BoolArray,
    turns: BoolArray,
    size: tuple[FloatArray, FloatArray],
    t: FloatArray,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    vx: FloatArray,
    vy: FloatArray,
    patience: FloatArray,
    time: float,
) -> tuple[IntArray, FloatArray, bool]:
    """Compute `Tracks.perceived`: tracks seen `(k,)`, rows as in `Agents.of_rows`, whether
    `patience` is needed.

    `patience` `(m,)` may be empty: it is needed only if an agent's last sample is older than
    `MAX_AGE_S`.
    """
    seen, rows = np.empty(len(static), np.int64), np.empty((12, len(static)))
    count, lacking = 0, False
    for i in range(len(static)):
        first = offsets[i]
        last = first + np.searchsorted(t[first : offsets[i + 1]], time + 1e-9, side="right") - 1
        age = 0.0 if static[i] else time - t[max(last, first)]
        if not static[i]:
            old = age > MAX_AGE_S and age <= MAX_GAP_S
            lacking = lacking or (last >= first and old and not len(patience))
            if last < first or age > (patience[last] if old and len(patience) else MAX_AGE_S):
                continue
        last = max(last, first)
        mx, my, before = vx[last], vy[last], max(last - 1, first)
        span = t[last] - t[before]
        if not np.isfinite(mx):
            mx = (x[last] - x[before]) / span if span > 0.0 else 0.0
        if not np.isfinite(my):
            my = (y[last] - y[before]) / span if span > 0.0 else 0.0
        if static[i]:
            mx, my = 0.0 * mx, 0.0 * my
        rate, accel = _trend(first, last, t, yaw, x, y, vx, vy, np.hypot(mx, my))
        seen[count] = i
        rows[0, count], rows[1, count] = size[0][i], size[1][i]
        rows[2, count], rows[3, count], rows[4, count] = (
            x[last] + age * mx,
            y[last] + age * my,
            yaw[last],
        )
        rows[5, count], rows[6, count] = mx, my
        rows[7, count] = rate if turns[i] else 0.0 * rate
        rows[8, count] = 0.0 if static[i] else accel
        rows[9, count] = min(time - t[first], OLDEST_S)
        if static[i] or (rows[9, count] < OLDEST_S and t[first] <= BEGIN_S + 1e-9):
            rows[9, count] = np.nan
        rows[10, count] = np.nan if static[i] else max(age, 0.0)
        rows[11, count] = np.nan
        count += 1
    return seen[:count], rows[:, :count], lacking


def _continuous(yaw: FloatArray, offsets: IntArray) -> FloatArray:
    """Remove jumps of 2 pi within each track.

    Its first heading, and headings beyond `MOST_RAD`, stay.
    """
    wild = np.abs(yaw) > MOST_RAD
    if wild.any():
        return np.where(wild, yaw, _continuous(np.where(wild, 0.0, yaw), offsets))
    turns = np.round(np.diff(yaw) / (2.0 * np.pi))
    turns[offsets[1:-1] - 1] = 0.0
    if not turns.any():
        return yaw
    sums = np.r_[0.0, np.cumsum(turns)]
    return np.asarray(yaw - 2.0 * np.pi * (sums - np.repeat(sums[offsets[:-1]], np.diff(offsets))))


@dataclass(frozen=True, eq=False)
class Tracks:
    """Road users over time, ragged: track i owns the samples `offsets[i] : offsets[i + 1]`.

    Attributes:
        ids: `n` unique names.
        kinds: `n` kinds.
        length: `(n,)` length of the box, m; `width` likewise.
        static: `(n,)` bool: an obstacle that never moves, present at all times (one sample is
            enough).
        offsets: `(n + 1,)` first sample of each track, and the number of samples.
        t: `(m,)` s since the scenario's start, increasing strictly within a track.
        x: `(m,)` box centre, world, m; `y` likewise; `yaw` rad, continuous within a track
            (unwrapped here).
        vx: `(m,)` velocity, world, m/s; `vy` likewise; NaN where the log has none.

    Raises:
        ValueError: Shapes disagree, a pose is not finite, a velocity is infinite, times do not
            increase or are not finite, a size is not positive.
    """

    ids: tuple[str, ...]
    kinds: tuple[AgentKind, ...]
    length: FloatArray
    width: FloatArray
    static: BoolArray
    offsets: IntArray
    t: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    vx: FloatArray
    vy: FloatArray

    def __post_init__(self) -> None:
        for name in ("length", "width", "t", "x", "y", "yaw", "vx", "vy"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "static", frozen(self.static, np.bool_))
        object.__setattr__(self, "offsets", frozen(self.offsets, np.int64))
        n, m = len(self.ids), len(self.t)
        shapes = {
            len(self.kinds),
            len(self.length),
            len(self.width),
            len(self.static),
            len(self.offsets) - 1,
        }
        if (
            shapes != {n}
            or self.offsets[0] != 0
            or self.offsets[-1] != m
            or (np.diff(self.offsets) < 1).any()
        ):
            raise ValueError("tracks: per-agent columns or offsets disagree")
        if len(set(self.ids)) != n:
            raise ValueError("tracks: two agents have the same id")
        for name in ("t", "x", "y", "yaw"):
            if getattr(self, name).shape != (m,) or not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"tracks: {name} has a wrong length or is not finite")
        for name in ("vx", "vy"):
            if getattr(self, name).shape != (m,) or np.isinf(getattr(self, name)).any():
                raise ValueError(f"tracks: {name} has a wrong length or is infinite")
        if (
            n
            and not (
                np.isfinite(self.length)
                & (self.length > 0)
                & np.isfinite(self.width)
                & (self.width > 0)
            ).all()
        ):
            raise ValueError("tracks: length and width must be positive")
        rising = np.diff(self.t) > 0.0
        rising[self.offsets[1:-1] - 1] = True
        if not rising.all():
            raise ValueError("tracks: time does not increase")
        object.__setattr__(self, "yaw", frozen(_continuous(self.yaw, self.offsets)))

    def __len__(self) -> int:
        return len(self.ids)

    @classmethod
    def empty(cls) -> Tracks:
        """No road users."""
        none = np.empty(0)
        return cls((), (), none, none, np.empty(0, np.bool_), np.zeros(1, np.int64), *[none] * 6)

    @property
    def whole(self) -> Tracks:
        """The whole tracks, if these are a part of them (`replan.logs.nearby_tracks.Recent`).

        Here the tracks themselves.
        """
        return self

    def samples(self, index: int) -> slice:
        """The samples of track `index`."""
        return slice(int(self.offsets[index]), int(self.offsets[index + 1]))

    @cached_property
    def owner(self) -> IntArray:
        """The track of each sample `(m,)`."""
        return np.repeat(np.arange(len(self)), np.diff(self.offsets))

    def taken(self, keep: BoolArray) -> Tracks:
        """Return the tracks with only the samples `keep` `(m,)`.

        Tracks without a sample are left out.
        """
        sizes = np.bincount(self.owner[keep], minlength=len(self))
        left = np.flatnonzero(sizes)
        ids, kinds = tuple(self.ids[i] for i in left), tuple(self.kinds[i] for i in left)
        columns = (getattr(self, name)[keep] for name in SAMPLE_COLUMNS)
        offsets = np.r_[0, np.cumsum(sizes[left])]
        return Tracks(
            ids, kinds, self.length[left], self.width[left], self.static[left], offsets, *columns
        )

    def only(self, ids: Collection[str]) -> Tracks:
        """Return the tracks of these road users, with all their samples."""
        return self.taken(np.array([name in ids for name in self.ids], np.bool_)[self.owner])

    def with_more(self, more: Tracks) -> Tracks:
        """Return these tracks and then `more`, whose ids are others."""
        columns = {
            name: np.r_[getattr(self, name), getattr(more, name)]
            for name in (*TRACK_COLUMNS, *SAMPLE_COLUMNS)
        }
        offsets = np.r_[self.offsets, self.offsets[-1] + more.offsets[1:]]
        return Tracks(
            (*self.ids, *more.ids), (*self.kinds, *more.kinds), offsets=offsets, **columns
        )

    def shifted(self, seconds: float) -> Tracks:
        """The same tracks, `seconds` later."""
        return replace(self, t=self.t + seconds)

    @cached_property
    def patience(self) -> FloatArray:
        """Time for which each sample is valid `(m,)`, s (`replan.logs.observed`)."""
        return frozen(patience(self.offsets, self.static, self.t))

    @cached_property
    def gap_after(self) -> BoolArray:
        """Whether a gap lies between a sample and the next one of its track `(m,)`; False for the
        last.
        """
        has_gap = np.diff(self.t, append=np.inf) > self.patience + 1e-9
        has_gap[self.offsets[1:] - 1] = False
        return frozen(has_gap, np.bool_)

    @cached_property
    def motion(self) -> Motion:
        """Velocity and acceleration at each sample, estimated from the whole track: for metrics,
        never for planners.
        """
        parts = np.union1d(self.offsets, np.flatnonzero(self.gap_after) + 1)
        owner = np.searchsorted(self.offsets, parts[:-1], side="right") - 1
        return estimated(
            self.kinds, ~self.static, parts, owner, (self.t, self.x, self.y, self.vx, self.vy)
        )

    @cached_property
    def codes(self) -> IntArray:
        """`kinds` as numbers `(n,)` (`replan.logs.agents.among`)."""
        return codes_of(self.kinds)

    @cached_property
    def _turns(self) -> BoolArray:
        """Whether a track has a yaw rate `(n,)`: it moves and is not a pedestrian."""
        return frozen(_TURNING[self.codes] & ~self.static, np.bool_)

    @cached_property
    def _names(self) -> NDArray[np.object_]:
        """Ids and kinds as rows `(2, n)`, so that one index selects both."""
        names = np.empty((2, len(self)), object)
        names[0], names[1] = self.ids, self.kinds
        return names

    def perceived(self, time: float) -> Agents:
        """Return the agents as known at `time`, without any later sample.

        An agent's last sample, if it is not older than its `patience`, is extrapolated with its
        velocity: the logged one, else the backward difference to the sample before (0 for a first
        sample).
        """
        columns = self.t, self.x, self.y, self.yaw, self.vx, self.vy
        fixed = self.offsets, self.static, self._turns, (self.length, self.width)
        seen, rows, lacking = _perceived_rows(*fixed, *columns, _NOT_ASKED, time)
        if lacking:
            seen, rows, _ = _perceived_rows(*fixed, *columns, self.patience, time)
        if len(seen) == len(self):
            return Agents.of_rows(self.ids, self.kinds, rows, self.codes)
        ids, kinds = self._names[:, seen].tolist()
        return Agents.of_rows(tuple(ids), tuple(kinds), rows, frozen(self.codes[seen], np.int64))

    def truth(self, time: float) -> Agents:
        """Return the true agents at `time`, interpolated: for metrics and drawing, never for a
        planner.

        Velocity and acceleration are those of `motion`, which uses later samples.
        """
        seen, before = self._present_at(time)
        last = self.offsets[1:] - 1
        sample = np.where(self.static[seen], self.offsets[seen], before[seen])
        after = np.where(
            self.static[seen] | self.gap_after[sample], sample, np.minimum(sample + 1, last[seen])
        )
        span = self.t[after] - self.t[sample]
        u = np.clip(
            np.divide(time - self.t[sample], span, out=np.zeros(len(sample)), where=span > 0.0),
            0.0,
            1.0,
        )
        moved = self.motion
        columns = (self.x, self.y, self.yaw, moved.vx, moved.vy, moved.accel)
        x, y, yaw, vx, vy, accel = (
            values[sample] + u * (values[after] - values[sample]) for values in columns
        )
        speed = np.hypot(vx, vy)
        trends = _trends(
            seen, sample, self.offsets, self.t, self.yaw, self.x, self.y, self.vx, self.vy, speed
        )
        return Agents(
            tuple(self.ids[i] for i in seen),
            tuple(self.kinds[i] for i in seen),
            self.length[seen],
            self.width[seen],
            x,
            y,
            yaw,
            vx,
            vy,
            yaw_rate=self._turns[seen] * trends[0],
            accel=np.where(self.static[seen], 0.0, accel),
        )

    def ids_at(self, time: float) -> tuple[str, ...]:
        """Return the ids of the agents in `truth(time)`."""
        return tuple(self.ids[i] for i in self._present_at(time)[0])

    def _present_at(self, time: float) -> tuple[IntArray, IntArray]:
        """Return the tracks present at `time` `(k,)`, and each track's last sample until then
        `(n,)`; -1: none.
        """
        before = _last_samples(self.offsets, self.t, time)
        last = self.offsets[1:] - 1
        gone = self.gap_after[before] & (time > self.t[before] + 1e-9)
        return np.flatnonzero(
            self.static | ((before >= 0) & (self.t[last] >= time - 1e-9) & ~gone)
        ), before

    def velocity(self, seen: IntArray, samples: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return vx and vy `(k,)` of the tracks `seen` at their samples `at`: logged, else backward
        differences.
        """
        before = np.maximum(samples - 1, self.offsets[seen])
        span = self.t[samples] - self.t[before]
        velocities = []
        for values, logged in ((self.x, self.vx[samples]), (self.y, self.vy[samples])):
            moved = values[samples] - values[before]
            derived = np.divide(moved, span, out=np.zeros(len(samples)), where=span > 0.0)
            known = np.where(np.isfinite(logged), logged, derived)
            velocities.append(known * ~self.static[seen])
        vx, vy = velocities
        return vx, vy
