"""The log's tracks, each played at a log time of its own: what the kinds of traffic share.

Where and how an agent is at the phase tau (a log time, s) is what the log has there, interpolated; played at the rate r
(phase per time), its velocity is r times the logged one. What was played is sampled every `PERIOD_S`, one sample ahead
of the ego: the sample at t + PERIOD_S is made of what is known at t. Who is as in the log keeps its own samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray, kernel
from logs.scenario import Tracks

PERIOD_S = 0.1


@dataclass(frozen=True, eq=False, slots=True)
class ReplayedAgents:
    """The agents at their phases; rows x, y, yaw, vx, vy `(5, n)` as logged, and who is in the scene `(n,)`."""

    pose: FloatArray
    there: BoolArray


class PhaseReplay:
    """Plays a log's tracks and remembers what was played.

    Args:
        log: The tracks; those that never move stay as they are.
        led: The same, each led on beyond the end of its log: what is played. None: the log.
    """

    def __init__(self, log: Tracks, led: Tracks | None = None) -> None:
        self.log = led or log
        self._own = log
        self._times: list[float] = []
        self._played: list[tuple[FloatArray, BoolArray]] = []
        last = np.arange(len(self.log.t))
        vx, vy = self.log.velocity(_owners(self.log), last) if len(log) else (log.vx, log.vy)
        self._columns = np.ascontiguousarray(np.vstack([self.log.x, self.log.y, self.log.yaw, vx, vy]))

    def at(self, phase: FloatArray) -> ReplayedAgents:
        """The agents at their phases `(n,)`, s; who has no log there is not in the scene."""
        log = self.log
        pose, there = _play(log.offsets, log.static, log.t, log.gap_after, self._columns, phase)
        return ReplayedAgents(pose, there)

    def add(self, t: float, phase: FloatArray, rate: FloatArray, there: BoolArray) -> None:
        """At the time `t` they were at these phases `(n,)`, played at these rates, as far as they are `there`."""
        played = self.at(phase)
        moved = played.pose * np.vstack([np.ones((3, len(rate))), rate, rate])
        self._times.append(t)
        self._played.append((moved, played.there & there))

    def tracks(self, since: FloatArray) -> Tracks:
        """The log's own samples before `since` `(n,)`, s, and what was played from then on; inf: the log as it is."""
        log, since = self._own, np.where(self._own.static, np.inf, since)
        if not (since < np.inf).any():
            return log
        owner, times = _owners(log), np.array(self._times)
        logged = log.t < since[owner] - 1e-9
        here = np.array([there for _, there in self._played]) & (times[:, None] >= since - 1e-9)
        k, agent = np.nonzero(here)
        pose = np.array([pose for pose, _ in self._played])[k, :, agent]
        kept = np.vstack([log.t, log.x, log.y, log.yaw, log.vx, log.vy])[:, logged]
        rows, owner = np.hstack([kept, np.vstack([times[k], pose.T])]), np.r_[owner[logged], agent]
        members, sizes = np.unique(owner, return_counts=True)
        return Tracks(
            tuple(log.ids[i] for i in members),
            tuple(log.kinds[i] for i in members),
            log.length[members],
            log.width[members],
            log.static[members],
            np.r_[0, np.cumsum(sizes)],
            *rows[:, np.lexsort((rows[0], owner))],
        )


def _owners(log: Tracks) -> IntArray:
    """The track `(samples,)` of each sample."""
    return np.repeat(np.arange(len(log)), np.diff(log.offsets))


@kernel
def _play(
    offsets: IntArray, static: BoolArray, t: FloatArray, gap_after: BoolArray, columns: FloatArray, phase: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Rows x, y, yaw (interpolated), vx, vy (of the last sample) `(5, n)` at the phases, and who has a log there.

    In a gap of a track (`logs.presence`) its agent is not there.
    """
    n = len(phase)
    pose, there = np.zeros((5, n)), np.zeros(n, np.bool_)
    for i in range(n):
        first, end = offsets[i], offsets[i + 1]
        there[i] = static[i] or (t[first] <= phase[i] + 1e-9 and phase[i] <= t[end - 1] + 1e-9)
        k = first
        if not static[i]:
            k = max(first + np.searchsorted(t[first:end], phase[i] + 1e-9, side="right") - 1, first)
        u, j = 0.0, min(k + 1, end - 1)
        if j > k and not static[i]:
            there[i] = there[i] and not (gap_after[k] and t[k] + 1e-9 < phase[i] < t[j] - 1e-9)
            u = min(max((phase[i] - t[k]) / (t[j] - t[k]), 0.0), 1.0)
        for c in range(3):
            pose[c, i] = columns[c, k] + u * (columns[c, j] - columns[c, k])
        pose[3, i], pose[4, i] = columns[3, k], columns[4, k]
    return pose, there
