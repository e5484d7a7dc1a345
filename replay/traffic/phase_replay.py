"""The log's tracks, each replayed at its own log time; the kinds of traffic share this.

At phase tau (a log time, s), an agent has the log's pose at tau, interpolated. Replayed at rate r
(phase per time), its velocity is r times the logged one. The replay is sampled every `PERIOD_S`,
one sample ahead of the ego: the sample at t + PERIOD_S depends on what is known at t. An agent on
its log keeps the log's samples; of the others, only samples in which they are present are kept, so
that memory grows with what is in the scene and not with the length of the log.

By the ego's position (`ReplayedByEgoPosition`), the log's encounters are kept, whatever the ego's
speed. With the ego's station s on its logged path, all others are at the log time (phase) at which
the logged ego was at s:

(1) target = tau(s) + delta        tau(s): the first log time at which the logged ego had come to s
(2) the phase follows the target, never back, and at most `FASTEST` times as fast as time
(3) where the logged path ends, the phase goes on with time

The ego itself is not changed. Once it has stood for `STUCK_S`, the phase goes on with time, so that
the road user that it waits for can leave (otherwise ego and world would wait forever). Then delta
is the time by which the phase exceeds the last log time at which the logged ego was within `NEAR_M`
of s: later encounters are delayed by it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray, frozen
from replan.core.errors import LogError
from replan.core.kernel import kernel
from replan.core.once import once
from replan.logs.nearby_tracks import BACK_S, Recent, Spans, heads
from replan.logs.polylines import thinned
from replan.logs.reference_line import ReferenceLine
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState
from replan.logs.tracks import Tracks
from replan.metrics.boxes import present_between

PERIOD_S = 0.1
ROOM = 1024
"""Initial capacity for samples of agents; doubled when full."""
FASTEST = 2.0
STUCK_S, STANDING_MPS, NEAR_M = 2.0, 0.1, 1.5
SHORTEST_M = 1.0
VX, VY = 3, 4
"""Rows of `LoggedTracks.columns` and of poses."""


class LoggedTracks(NamedTuple):
    """`Tracks` as kernels take them, or some of them: `(k,)` per track, `(m,)` per sample of the
    whole.

    A track has the samples `first` to before `end`; columns: x, y, yaw, vx, vy `(5, m)`; the rest
    is as in `Tracks`.
    """

    first: IntArray
    end: IntArray
    static: BoolArray
    t: FloatArray
    gap_after: BoolArray
    columns: FloatArray

    def some(self, who: IntArray) -> LoggedTracks:
        """The tracks `who` `(k,)`."""
        return self._replace(first=self.first[who], end=self.end[who], static=self.static[who])


def logged_tracks(log: Tracks, vx: FloatArray, vy: FloatArray) -> LoggedTracks:
    """The tracks with these velocities `(samples,)`."""
    columns = frozen(np.vstack([log.x, log.y, log.yaw, vx, vy]))
    return LoggedTracks(
        log.offsets[:-1], log.offsets[1:], log.static, log.t, log.gap_after, columns
    )


class ReplaySample(NamedTuple):
    """One sample: time, s, tracks `(k,)`, increasing, x, y, yaw, vx, vy `(5, k)`, and which are
    present `(k,)`.
    """

    t: float
    agents: IntArray
    pose: FloatArray
    present: BoolArray


class PhaseReplay:
    """Replays a log's tracks and keeps the samples.

    Args:
        log: The tracks; those that never move stay as they are.
        extended: The tracks to replay, each extended beyond the end of its log; None: the log.

    Attributes:
        log: The replayed tracks with their velocities.
        logged: The same for kernels.
    """

    def __init__(self, log: Tracks, extended: Tracks | None = None) -> None:
        self._own = log
        self.logged, self.log = _with_velocities(extended or log)
        self._rows, self._seen = list[ReplaySample](), 0
        self._taken, self._count = np.zeros(len(log), np.bool_), 0
        self._who, self._played = np.empty(ROOM, np.int64), np.empty((ROOM, 6))
        self._spans = Spans(log)

    def add(self, t: float, who: IntArray, phase: FloatArray, rate: FloatArray) -> None:
        """Sample the tracks `who` `(k,)` at time `t`, at these phases and rates."""
        present = np.ones(len(who), np.bool_)
        play(self.logged.some(who), phase, rate, present, *self.row(t, who))

    def row(self, t: float, who: IntArray) -> tuple[FloatArray, BoolArray]:
        """Room for a sample of the tracks `who` at the time `t`, as `play` writes it."""
        self._rows.append(
            ReplaySample(t, who, np.empty((5, len(who))), np.empty(len(who), np.bool_))
        )
        return self._rows[-1].pose, self._rows[-1].present

    def tracks(self, since: FloatArray) -> Tracks:
        """The log's samples before `since` `(n,)`, s, and the replayed ones from then on; inf: the
        log as it is.

        If `since` of a track was inf at the last call, it may not be before the last row of that
        call. If any agent is off its log, the result holds the tracks around the last row; its
        `whole` has all tracks.
        """
        since = np.where(self._own.static, np.inf, since)
        wanted = since < np.inf
        # Keep them of agents off their log; one sample more of those newly off it
        for k, row in enumerate(self._rows):
            is_replayed = wanted[row.agents] & row.present & (row.t >= since[row.agents] - 1e-9)
            selected = np.flatnonzero(
                is_replayed & ~self._taken[row.agents] if k < self._seen else is_replayed
            )
            begin, self._count = self._count, self._count + len(selected)
            while self._count > len(self._who):
                twice = (
                    np.concatenate([old, np.empty_like(old)]) for old in (self._who, self._played)
                )
                self._who, self._played = twice
            self._who[begin : self._count] = row.agents[selected]
            self._played[begin : self._count, 0] = row.t
            self._played[begin : self._count, 1:] = row.pose[:, selected].T
        self._rows, self._seen, self._taken = self._rows[-1:], 1, wanted
        if not self._taken.any():
            return self._own
        now, count = self._rows[-1].t, self._count
        recent = int(np.searchsorted(self._played[:count, 0], now - BACK_S))
        near, low, high = self._spans.within(now, now)
        members = np.union1d(near, self._who[recent:count])
        first = self._own.offsets[members]
        end, slots = first.copy(), np.searchsorted(members, near)
        first[slots], end[slots] = low, high
        columns = self._columns(since, members, first, end, slice(recent, count))
        return Recent(*columns, all_of_them=partial(self._all_samples, since, count))

    def _all_samples(self, since: FloatArray, count: int) -> Tracks:
        """All samples of all tracks, with the first `count` replayed ones."""
        own = self._own.offsets
        return Tracks(
            *self._columns(
                since, np.arange(len(self._own)), own[:-1].copy(), own[1:].copy(), slice(count)
            )
        )

    def _columns(
        self, since: FloatArray, who: IntArray, first: IntArray, end: IntArray, some: slice
    ) -> tuple[Any, ...]:
        """The columns of `Tracks`: the log's samples `first` to before `end` of `who`, and `some`
        replayed ones.
        """
        played = np.searchsorted(who, self._who[some])
        rows, sizes = _merge_samples(
            self._logged_own, since[who], first, end, played, self._played[some]
        )
        left = np.flatnonzero(sizes)
        return *heads(self._own, who[left]), np.r_[0, np.cumsum(sizes[left])], *rows

    @cached_property
    def _logged_own(self) -> LoggedTracks:
        return logged_tracks(self._own, self._own.vx, self._own.vy)


@once
def _with_velocities(path: Tracks) -> tuple[LoggedTracks, Tracks]:
    """The tracks for kernels, with the velocities of their motion, and as tracks of the same
    memory.
    """
    owner, last = np.repeat(np.arange(len(path)), np.diff(path.offsets)), np.arange(len(path.t))
    vx, vy = path.velocity(owner, last) if len(path) else (path.vx, path.vy)
    logged = logged_tracks(path, vx, vy)
    x, y, yaw, vx, vy = logged.columns
    return logged, replace(path, x=x, y=y, yaw=yaw, vx=vx, vy=vy)


@kernel
def played(
    log: LoggedTracks, i: int, phase: float
) -> tuple[float, float, float, float, float, bool]:
    """x, y, yaw (interpolated), vx, vy (of the last sample) of a track at a phase, and whether it
    has a log there.

    In a gap of a track (`replan.logs.observed`) its agent is not present.
    """
    t, columns = log.t, log.columns
    first, end = log.first[i], log.end[i]
    present = log.static[i] or (t[first] <= phase + 1e-9 and phase <= t[end - 1] + 1e-9)
    k = first
    if not log.static[i]:
        k = max(first + np.searchsorted(t[first:end], phase + 1e-9, side="right") - 1, first)
    u, j = 0.0, min(k + 1, end - 1)
    if j > k and not log.static[i]:
        present = present and not (log.gap_after[k] and t[k] + 1e-9 < phase < t[j] - 1e-9)
        u = min(max((phase - t[k]) / (t[j] - t[k]), 0.0), 1.0)
    x = columns[0, k] + u * (columns[0, j] - columns[0, k])
    y = columns[1, k] + u * (columns[1, j] - columns[1, k])
    yaw = columns[2, k] + u * (columns[2, j] - columns[2, k])
    return x, y, yaw, columns[VX, k], columns[VY, k], present


@kernel
def play(
    log: LoggedTracks,
    phase: FloatArray,
    rate: FloatArray,
    present: BoolArray,
    pose: FloatArray,
    here: BoolArray,
) -> None:
    """Write the agents at their phases, velocities times the rates, into `pose` `(5, n)` and `here`
    `(n,)`.
    """
    for i in range(len(phase)):
        x, y, yaw, vx, vy, has_log = played(log, i, phase[i])
        pose[0, i], pose[1, i], pose[2, i] = x, y, yaw
        pose[VX, i], pose[VY, i] = vx * rate[i], vy * rate[i]
        here[i] = has_log and present[i]


@kernel
def _merge_samples(
    log: LoggedTracks,
    since: FloatArray,
    first: IntArray,
    end: IntArray,
    owners: IntArray,
    played: FloatArray,
) -> tuple[FloatArray, IntArray]:
    """Rows t, x, y, yaw, vx, vy `(6, samples)` of some tracks one after the other, and how many
    samples each has.

    First the log's samples from `first` to before `end` `(k,)` that are before `since` `(k,)`, s;
    then the replayed rows `played` `(m, 6)` of the tracks `who` `(m,)`, in the order of time.
    """
    n = len(since)
    begin, before = np.zeros(n, np.int64), np.zeros(n, np.int64)
    for i in range(n):
        before[i] = np.searchsorted(log.t[first[i] : end[i]], since[i] - 1e-9, side="left")
    sizes = before.copy()
    for i in owners:
        sizes[i] += 1
    rows, row = np.empty((6, sizes.sum())), 0
    for i in range(n):
        low, high = first[i], first[i] + before[i]
        rows[0, row : row + before[i]] = log.t[low:high]
        rows[1:, row : row + before[i]] = log.columns[:, low:high]
        begin[i], row = row + before[i], row + sizes[i]
    for k in range(len(owners)):
        rows[:, begin[owners[k]]] = played[k]
        begin[owners[k]] += 1
    return rows, sizes


class ReplayedByEgoPosition:
    """All are at their logged positions of when the logged ego was where the ego is now.

    Args:
        scenario: Its ego's log must lead somewhere.

    Raises:
        LogError: The logged ego does not move, so its position does not determine a time.
    """

    notes: tuple[str, ...] = ()

    def __init__(self, scenario: Scenario) -> None:
        log = scenario.ego
        points = thinned(np.column_stack([log.x, log.y]), SHORTEST_M)
        if len(points) < 2:
            raise LogError(
                f"{scenario.name}: the logged ego does not move, so that its position tells no "
                "time",
                remedy="take traffic 'time' or 'reactive'",
            )
        self._line = ReferenceLine.through(points)
        stations = [0.0]
        for x, y in zip(log.x[1:], log.y[1:], strict=True):
            stations.append(self._line.project(x, y, stations[-1])[0])
        # Not decreasing
        self._log_t, self._log_s = log.t, np.maximum.accumulate(np.maximum(stations, 0.0))
        self._replay = PhaseReplay(scenario.tracks)
        self._phase, self._delay, self._stood = float(log.t[0]), 0.0, 0.0
        self._station, self._next, self._tracks = 0.0, float("-inf"), Tracks.empty()

    @property
    def due(self) -> float:
        """The next time at which the agents react to the ego, s."""
        return self._next

    def step(self, ego: EgoState) -> Tracks:
        """The tracks up to `ego.t` and one sample beyond."""
        if self._next == float("-inf"):
            self._station = self._line.project(ego.x, ego.y, 0.0)[0]
            self._add(ego.t, 1.0)
            self._next = ego.t
        while self._next <= ego.t + 1e-9:
            before = self._phase
            self._station = self._line.project(ego.x, ego.y, self._station)[0]
            self._stood = self._stood + PERIOD_S if abs(ego.v) < STANDING_MPS else 0.0
            ahead, t, s = self._station + max(ego.v, 0.0) * PERIOD_S, self._log_t, self._log_s
            if self._stood > STUCK_S + 1e-9 or ahead >= s[-1]:
                self._phase += PERIOD_S  # (3)
                k = int(np.searchsorted(s, self._station + NEAR_M, side="right")) - 1
                latest = float(t[max(k, 0)])  # at which the logged ego was no farther
                self._delay = max(self._delay, self._phase - latest)
            else:
                k = min(int(np.searchsorted(s, ahead, side="left")), len(s) - 1)
                earliest = float(t[0])  # the log time at which the logged ego had come `ahead`
                if k > 0:
                    u = min((ahead - s[k - 1]) / (s[k] - s[k - 1]), 1.0) if s[k] > s[k - 1] else 1.0
                    earliest = float(t[k - 1] + u * (t[k] - t[k - 1]))
                # (1), (2)
                self._phase += min(
                    max(earliest + self._delay - self._phase, 0.0), FASTEST * PERIOD_S
                )
            self._next += PERIOD_S
            self._add(self._next, (self._phase - before) / PERIOD_S)
            self._tracks = self._replay.tracks(np.full(len(self._replay.log), -np.inf))
        return self._tracks

    def _add(self, t: float, rate: float) -> None:
        agents = present_between(self._replay.log, self._phase, self._phase)
        self._replay.add(t, agents, np.full(len(agents), self._phase), np.full(len(agents), rate))
