"""The other road users by the ego's position: the log's encounters are kept, whatever the ego's speed.

With the ego's station s on its logged path, all others are at the log time (phase) at which the logged ego was at s:

(1) target = tau(s) + delta        tau(s): the first log time at which the logged ego had come to s
(2) the phase follows the target, never back, and at most `FASTEST` times as fast as time
(3) where the logged path ends, the phase goes on with time

The ego itself is not changed. Once it has stood for `STUCK_S`, the phase goes on with time, so that the road user that
it waits for can leave (a world that stands still with the ego would wait forever). Then delta is the time by which the
phase exceeds the last log time at which the logged ego was within `NEAR_M` of s: later encounters are delayed by it.
"""

from __future__ import annotations

import numpy as np

from logs.errors import LogError
from logs.road import ReferenceLine, thinned
from logs.scenario import Scenario, Tracks
from logs.states import EgoState
from metrics.boxes import present_between
from replay.traffic.phase_replay import PERIOD_S, PhaseReplay

FASTEST = 2.0
STUCK_S, STANDING_MPS, NEAR_M = 2.0, 0.1, 1.5
SHORTEST_M = 1.0


class ReplayedByEgoPosition:
    """See the module docstring.

    Args:
        scenario: Its ego's log must lead somewhere.

    Raises:
        LogError: The logged ego does not move, so that its position tells no time.
    """

    notes: tuple[str, ...] = ()

    def __init__(self, scenario: Scenario) -> None:
        log = scenario.ego
        points = thinned(np.column_stack([log.x, log.y]), SHORTEST_M)
        if len(points) < 2:
            raise LogError(
                f"{scenario.name}: the logged ego does not move, so that its position tells no time",
                remedy="take traffic 'time' or 'reactive'",
            )
        self._line = ReferenceLine.through(points)
        stations = [0.0]
        for x, y in zip(log.x[1:], log.y[1:], strict=True):
            stations.append(self._line.project(x, y, stations[-1])[0])
        self._log_t, self._log_s = log.t, np.maximum.accumulate(np.maximum(stations, 0.0))  # not decreasing
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
            self._advance(ego)
            self._next += PERIOD_S
            self._add(self._next, (self._phase - before) / PERIOD_S)
            self._tracks = self._replay.tracks(np.full(len(self._replay.log), -np.inf))
        return self._tracks

    def _advance(self, ego: EgoState) -> None:
        """Advance the phase by one period."""
        self._station = self._line.project(ego.x, ego.y, self._station)[0]
        self._stood = self._stood + PERIOD_S if abs(ego.v) < STANDING_MPS else 0.0
        ahead = self._station + max(ego.v, 0.0) * PERIOD_S
        most = FASTEST * PERIOD_S
        if self._stood > STUCK_S + 1e-9 or ahead >= self._log_s[-1]:
            self._phase += PERIOD_S  # (3)
            k = int(np.searchsorted(self._log_s, self._station + NEAR_M, side="right")) - 1
            latest = float(self._log_t[max(k, 0)])  # at which the logged ego was no farther
            self._delay = max(self._delay, self._phase - latest)
        else:
            self._phase += min(max(self._earliest(ahead) + self._delay - self._phase, 0.0), most)  # (1), (2)

    def _earliest(self, s: float) -> float:
        """The first log time at which the logged ego had reached `s`, s."""
        k = int(np.searchsorted(self._log_s, s, side="left"))
        if k == 0:
            return float(self._log_t[0])
        k = min(k, len(self._log_s) - 1)
        span = self._log_s[k] - self._log_s[k - 1]
        u = min((s - self._log_s[k - 1]) / span, 1.0) if span > 0.0 else 1.0
        return float(self._log_t[k - 1] + u * (self._log_t[k] - self._log_t[k - 1]))

    def _add(self, t: float, rate: float) -> None:
        who = present_between(self._replay.log, self._phase, self._phase)
        self._replay.add(t, who, np.full(len(who), self._phase), np.full(len(who), rate))
