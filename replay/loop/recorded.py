"""Perception "recorded": at each time what a tracker knew by then of the detections that the log holds.

The tracker is causal (`logs.repair.tracker`), and so are its names; a repaired track has the name that the tracker
gives it for longest (`logs.repair.names`). Detections are of the log, but in closed loop the traffic moves the others
differently: a known road user is shown where the world has it now,

(1) shown = tracked + (world - log),   of x, y, yaw, vx, vy at the frame's time; world and log as `Tracks.perceived`

- A track that belongs to no road user of the log is a false alarm of the recorded perception, and shown as it is.
- An agent that the log has now and the world has not is not shown.
- An agent that the world has now and the log has not (inserted, or later than recorded), and one that never moves, is
  shown as by ground truth: no detection exists of it.

Nothing later than the frame goes in, except to find the road user that a track belongs to: the log's tracks are
smoothed.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from logs.agents import NUMBERS, Agents
from logs.errors import LogError
from logs.kernel import IntArray, frozen
from logs.memory import NearbyTracks
from logs.repair.names import Owners
from logs.scenario import Scenario
from logs.states import wrapped
from replay.world import World

MOVED = ("x", "y", "yaw", "vx", "vy")


class Recorded:
    """Shows the agents of one drive as the recorded perception knew them.

    Args:
        scenario: Of which `repair` has the detections.

    Raises:
        LogError: It has none.
    """

    def __init__(self, scenario: Scenario) -> None:
        if scenario.repair is None:
            remedy = "take perception auto or ground_truth, or read the log with repair on"
            raise LogError("perception recorded needs a log whose road users are made of detections", remedy=remedy)
        self._log, self._tracked = scenario.repair.tracks, scenario.repair.detections.tracked
        self._owners, self._around, self._around_log = Owners(), NearbyTracks(), NearbyTracks()

    def see(self, world: World) -> tuple[Agents, None]:
        """The agents, and that no ground is known to be hidden."""
        t = world.ego.t
        known = self._tracked.at(t)
        log = self._around_log.of(self._log, t, t).perceived(t)
        whose = self._owners.of(known, log)
        if world.tracks is self._log:
            now, shown = log, known
        else:
            now = self._around.of(world.tracks, t, t).perceived(t)
            shown = _displaced(known, whose, now, log)
        static = {name for name, still in zip(world.tracks.ids, world.tracks.static, strict=True) if still}
        logged = set(log.ids)
        others = [i for i, name in enumerate(now.ids) if name in static or name not in logged]
        if not others:
            return shown, None
        more = now.some(_rows(others))
        shown = shown.some(_rows(i for i, name in enumerate(shown.ids) if name not in more.ids))
        columns = np.array([np.r_[getattr(shown, name), getattr(more, name)] for name in NUMBERS])
        codes = frozen(np.r_[shown.codes, more.codes], np.int64)
        return Agents.of_rows((*shown.ids, *more.ids), (*shown.kinds, *more.kinds), columns, codes), None


def _rows(places: Iterable[int]) -> IntArray:
    return np.array(list(places), np.int64)


def _displaced(known: Agents, whose: list[str], now: Agents, log: Agents) -> Agents:
    """The known agents moved by (1), without those that only the log has."""
    there, then = ({name: i for i, name in enumerate(some.ids)} for some in (now, log))
    kept = [i for i, name in enumerate(whose) if name not in then or name in there]
    both = [row for row, i in enumerate(kept) if whose[i] in then]
    in_world, in_log = (_rows(places[whose[kept[row]]] for row in both) for places in (there, then))
    columns = np.array([getattr(known, name)[_rows(kept)] for name in NUMBERS])
    for name in MOVED:
        change = getattr(now, name)[in_world] - getattr(log, name)[in_log]
        columns[NUMBERS.index(name), both] += wrapped(change) if name == "yaw" else change
    some = known.some(_rows(kept))
    return Agents.of_rows(some.ids, some.kinds, columns, some.codes)
