"""How the other road users move while the ego is driven.

"give_way"        as in the log, except that a road user gives way where it would hit the ego from behind or where the
                  ego has the right of way (`reactive`, `right_of_way`)
"time"            each road user is where it was in the log at this time, whatever the ego does
"ego_position"    all are where they were in the log when the logged ego was where the ego is now (`phase_replay`)
"reactive"        vehicles follow their logged paths and keep behind every road user on them, the ego included
                  (`reactive`); late vehicles stop at red lights
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Protocol

from logs.extension import Kind
from logs.scenario import Scenario, Tracks
from logs.states import EgoState
from replay.traffic.phase_replay import ReplayedByEgoPosition
from replay.traffic.reactive import GIVE_WAY, Reactive

__all__ = ["TRAFFIC", "TRAFFIC_KIND", "TRAFFIC_NOTES", "Reactive", "ReplayedByEgoPosition", "ReplayedByTime", "Traffic"]


class Traffic(Protocol):
    """Moves the other road users; built once per drive as `factory(scenario, **settings)`."""

    @property
    def due(self) -> float:
        """The next time at which they react to the ego, s; until then `step` changes nothing. inf: they never react."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the drive so far, one sentence each; they go into the trace."""
        ...

    def step(self, ego: EgoState) -> Tracks:
        """The tracks of the others up to `ego.t`; they have seen the ego's states until then.

        The tracks may reach beyond `ego.t`; readers take only what is known by then (`Tracks.perceived`). They may
        hold only the road users around now (`logs.memory.Recent`); the drive keeps their `whole`.
        """
        ...


class ReplayedByTime:
    """The log's tracks, unmoved by what the ego does."""

    due = inf
    notes: tuple[str, ...] = ()

    def __init__(self, scenario: Scenario) -> None:
        self._tracks = scenario.tracks

    def step(self, ego: EgoState) -> Tracks:
        """The log's tracks."""
        return self._tracks


def give_way(scenario: Scenario) -> Traffic:
    """As in the log, except for road users that give way."""
    return Reactive(scenario, GIVE_WAY)


TRAFFIC: dict[str, Callable[..., Traffic]] = {
    "give_way": give_way,
    "time": ReplayedByTime,
    "ego_position": ReplayedByEgoPosition,
    "reactive": Reactive,
}

TRAFFIC_KIND: Kind[Callable[..., Traffic]] = Kind("traffic", "traffic", TRAFFIC)
"""Finds these and the user's own."""

TRAFFIC_NOTES: dict[str, tuple[str, ...]] = {
    "ego_position": (
        "the others are where they were when the logged ego was where the ego is; their time is its place",
    ),
    "reactive": (
        "the others react: vehicles keep to their logged paths, behind whoever is on them; late ones stop at red",
    ),
}
"""Notes on each kind of traffic that a reader of the results needs; empty where the traffic is as in the log."""
