"""The others: how they move while the ego is driven.

"give_way"        as in the log; who would drive into the ego from behind, or goes second by right, gives way to it
                  (`reactive`, `yielding`)
"time"            each is where it was in the log at this time, whatever the ego does
"ego_position"    all are where they were when the logged ego was where the ego is (`ego_position`)
"reactive"        vehicles keep to their logged path and behind whoever is on it, the ego included (`reactive`); who
                  is late stops at red lights
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import Protocol

from logs.extension import Kind
from logs.scenario import Scenario, Tracks
from logs.states import EgoState
from replay.traffic.ego_position import ReplayedByEgoPosition
from replay.traffic.reactive import GIVE_WAY, Reactive

__all__ = ["TRAFFIC", "TRAFFIC_KIND", "TRAFFIC_NOTES", "Reactive", "ReplayedByEgoPosition", "ReplayedByTime", "Traffic"]


class Traffic(Protocol):
    """Moves the others; built once per drive as `factory(scenario, **settings)`."""

    @property
    def due(self) -> float:
        """The next time at which they look at the ego, s: until then `step` changes nothing; inf: they never do."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user must know of the drive so far, one sentence each; goes into the trace."""
        ...

    def step(self, ego: EgoState) -> Tracks:
        """The others as they have moved up to `ego.t`, seeing the ego's states until then.

        The tracks may reach beyond `ego.t`; who looks at them takes care not to (`Tracks.perceived`). They may be
        those around now alone (`logs.nearby.Recent`); what is kept of the drive is their `whole`.
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
    """As in the log, but for those who give way."""
    return Reactive(scenario, GIVE_WAY)


TRAFFIC: dict[str, Callable[..., Traffic]] = {
    "give_way": give_way,
    "time": ReplayedByTime,
    "ego_position": ReplayedByEgoPosition,
    "reactive": Reactive,
}

TRAFFIC_KIND: Kind[Callable[..., Traffic]] = Kind("traffic", "traffic", TRAFFIC)
"""Finds those, and users' own."""

TRAFFIC_NOTES: dict[str, tuple[str, ...]] = {
    "ego_position": (
        "the others are where they were when the logged ego was where the ego is; their time is its place",
    ),
    "reactive": (
        "the others react: vehicles keep to their logged paths, behind whoever is on them; late ones stop at red",
    ),
}
"""What the user must know of the traffic to read the results; nothing of what is as in the log."""
