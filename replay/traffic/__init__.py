"""Moves the other road users while the ego is driven: `replan list traffic` describes each way."""

from __future__ import annotations

from math import inf
from typing import Protocol

from replan.logs.scenario import Scenario
from replan.logs.states import EgoState
from replan.logs.tracks import Tracks
from replan.replay.traffic.phase_replay import ReplayedByEgoPosition
from replan.replay.traffic.reactive import GIVE_WAY, Reactive

__all__ = ["TRAFFIC_NOTES", "Reactive", "ReplayedByEgoPosition", "ReplayedByTime", "Traffic"]


class Traffic(Protocol):
    """Moves the other road users; built once per drive as `factory(scenario, **settings)`."""

    @property
    def due(self) -> float:
        """The next time at which they react to the ego, s; `step` changes nothing before.

        inf: they never react.
        """
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the drive so far, one sentence each; they go into the trace."""
        ...

    def step(self, ego: EgoState) -> Tracks:
        """Return the tracks of the others up to `ego.t`; they may react to the ego's states up to
        then.

        The tracks may reach beyond `ego.t`; readers use only what is known at that time
        (`Tracks.perceived`). They may contain only the road users around that time
        (`replan.logs.nearby_tracks.Recent`); the drive stores their `whole`.
        """
        ...


class ReplayedByTime:
    """Each road user is at its logged position of this time, independent of the ego."""

    due = inf
    notes: tuple[str, ...] = ()

    def __init__(self, scenario: Scenario) -> None:
        self._tracks = scenario.tracks

    def step(self, ego: EgoState) -> Tracks:
        """Return the log's tracks."""
        return self._tracks


def give_way(scenario: Scenario) -> Traffic:
    """As in the log, but road users give way to an ego that they would hit from behind or that has
    the right of way.
    """
    return Reactive(scenario, GIVE_WAY)


TRAFFIC_NOTES: dict[str, tuple[str, ...]] = {
    "ego_position": (
        "the others are where they were when the logged ego was where the ego is; their time is "
        "its place",
    ),
    "reactive": (
        "the others react: vehicles keep to their logged paths, behind whoever is on them; late "
        "ones stop at red",
    ),
}
"""Notes for readers of the results on kinds of traffic that differ from the log."""
