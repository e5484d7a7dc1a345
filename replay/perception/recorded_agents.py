"""The agents as the recorded perception detected them, moved with the world."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from replan.core.arrays import IntArray, frozen
from replan.core.errors import LogError
from replan.logs.agents import NUMBERS, Agents
from replan.logs.nearby_tracks import NearbyTracks
from replan.logs.repair.detections import Owners
from replan.logs.scenario import Scenario
from replan.logs.states import wrapped
from replan.logs.tracks import Tracks
from replan.replay.world import World

MOVED = ("x", "y", "yaw", "vx", "vy")
"""The columns of an agent's motion."""


class Recorded:
    """Shows the agents of one drive as the recorded perception detected them.

    The tracker is causal (`replan.logs.repair.tracker`), and so are its names; a repaired track has
    the name that the tracker uses longest for it (`replan.logs.repair.detections`). The detections
    are those of the log, but in closed loop the traffic moves the others differently. Known road
    users are therefore shown at their positions in the world,

    (1) shown = tracked + (world - log),
            of x, y, yaw, vx, vy at the frame's time; both as `Tracks.perceived`

    - A track that belongs to no road user of the log is a false alarm of the recorded perception;
      it is shown unchanged.
    - An agent that is present now in the log but not in the world is not shown.
    - An agent that is present now in the world but not in the log (inserted, or later than
      recorded), and a static agent, is shown as in ground truth: it has no detections.

    Later data are used only to find the road user of a track: the log's tracks are smoothed.

    Args:
        scenario: Its `repair` has the detections.

    Raises:
        LogError: It has no detections.
    """

    def __init__(self, scenario: Scenario) -> None:
        if scenario.repair is None:
            remedy = "take perception auto or ground_truth, or read the log with repair on"
            raise LogError(
                "perception recorded needs a log whose road users are made of detections",
                remedy=remedy,
            )
        self._log, self._tracked = scenario.repair.tracks, scenario.repair.detections.tracked
        self._owners, self._around, self._around_log = Owners(), NearbyTracks(), NearbyTracks()

    def see(self, world: World) -> tuple[Agents, None]:
        """Return the agents; no ground is known to be hidden."""
        t = world.ego.t
        tracked = self._tracked.at(t)
        log = self._around_log.of(self._log, t, t).perceived(t)
        owners = self._owners.of(tracked, log)
        if world.tracks is self._log:
            return _with_undetected(tracked, log, log, world.tracks), None
        now = self._around.of(world.tracks, t, t).perceived(t)
        return _with_undetected(_moved(tracked, owners, log, now), now, log, world.tracks), None


def _moved(tracked: Agents, owners: Sequence[str], log: Agents, now: Agents) -> Agents:
    """Return the tracks at (1), without those of road users that are present in the log but not in
    the world.

    Args:
        tracked: The tracks.
        owners: For each track, the road user of the log to which it belongs.
        log: The road users of the log at this time.
        now: Those of the world.
    """
    log_row = {name: row for row, name in enumerate(log.ids)}
    world_row = {name: row for row, name in enumerate(now.ids)}
    tracks = [
        track for track, name in enumerate(owners) if name not in log_row or name in world_row
    ]
    shown, shown_owners = tracked.some(_rows(tracks)), [owners[track] for track in tracks]
    moved = [row for row, name in enumerate(shown_owners) if name in log_row]
    in_world = _rows(world_row[shown_owners[row]] for row in moved)
    in_log = _rows(log_row[shown_owners[row]] for row in moved)
    columns = np.array([getattr(shown, name) for name in NUMBERS])
    for name in MOVED:  # (1)
        change = getattr(now, name)[in_world] - getattr(log, name)[in_log]
        columns[NUMBERS.index(name), moved] += wrapped(change) if name == "yaw" else change
    return Agents.of_rows(shown.ids, shown.kinds, columns, shown.codes)


def _with_undetected(shown: Agents, now: Agents, log: Agents, tracks: Tracks) -> Agents:
    """Return the agents that are shown, and after them those of the world that have no detections:
    static ones, and those that the log does not have now.
    """
    static = {name for name, still in zip(tracks.ids, tracks.static, strict=True) if still}
    logged = set(log.ids)
    undetected = [row for row, name in enumerate(now.ids) if name in static or name not in logged]
    if not undetected:
        return shown
    added = now.some(_rows(undetected))
    names = set(added.ids)
    shown = shown.some(_rows(row for row, name in enumerate(shown.ids) if name not in names))
    columns = np.array([np.r_[getattr(shown, name), getattr(added, name)] for name in NUMBERS])
    codes = frozen(np.r_[shown.codes, added.codes], np.int64)
    return Agents.of_rows((*shown.ids, *added.ids), (*shown.kinds, *added.kinds), columns, codes)


def _rows(rows: Iterable[int]) -> IntArray:
    return np.array(list(rows), np.int64)
