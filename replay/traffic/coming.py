"""Who may be in the scene: of a long log with many who come and go, a step looks at these alone.

(1) who = those whose log has begun, and those that never move, less those who are gone for good: not in the scene, and
    neither waiting to enter nor within the log's time of theirs

The others change nothing and nothing changes them: in `period` they would be neither present nor entering.
"""

from __future__ import annotations

import numpy as np

from logs.kernel import BoolArray, IntArray
from replay.traffic.period import Agents, Phases, nobody_late


class Coming:
    """Those of (1), and how they are; who has left is kept as they were then.

    Args:
        every: All agents of the log.

    Attributes:
        who: Their tracks `(k,)`, increasing.
        agents: They alone.
        now: How they are; written by `period`.
    """

    def __init__(self, every: Agents) -> None:
        self._every, self._states = every, nobody_late(len(every.reacts))
        begins = np.where(every.tracks.static, -np.inf, every.tracks.t[every.tracks.first])
        self._order = np.argsort(begins, kind="stable")
        self._begins, self._count = begins[self._order], 0
        self._take(np.empty(0, np.int64))

    @property
    def all(self) -> Phases:
        """How all are, `(n,)`: who is not among them as they left, or as at first."""
        for whole, part in zip(self._states, self.now, strict=True):
            whole[self.who] = part
        return self._states

    def until(self, t: float, end: float) -> None:
        """From the time `t` on they are all who may be in the scene by the time `end`."""
        count = int(np.searchsorted(self._begins, end + 1e-9, side="right"))
        if count > self._count:
            new, self._count = self._order[self._count : count], count
            self.all.phase[new] = t
            self._take(np.sort(np.r_[self.who[~self._gone(t)], new]))

    def _gone(self, t: float) -> BoolArray:
        """Who is gone for good at `t` `(k,)`."""
        now, tracks = self.now, self.agents.tracks
        waits = now.late & (now.phase <= tracks.t[tracks.first] + 1e-9)
        over = now.late | (self.agents.left < t - 1e-9)
        return np.asarray(~(now.there | tracks.static | waits) & over)

    def _take(self, who: IntArray) -> None:
        self.who, self.now, self.agents = who, self._states.some(who), self._every.some(who)
