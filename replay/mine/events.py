"""What is looked for in a log: an `EventKind` finds `Event`s in a `DrivenLog`.

A kind is one function (log) -> events, and one row of `KINDS`. One of your own is an `EventKind` in a module, named as
"module:NAME" (`replan mine --kind module:NAME`) or by an entry point of the group `replan.events`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from metrics.metric import Unavailable
from replay.mine.driven_log import DrivenLog


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened in a log.

    Attributes:
        begin: s since the log's start; `end` likewise, not before it.
        value: The number that the kind measures, in its unit; NaN: it measures none.
        agents: Ids of the road users that took part, the main one first; empty: none but the ego.
        what: More in words ("left", "crosswalk 7"); may be empty.
    """

    begin: float
    end: float
    value: float
    agents: tuple[str, ...] = ()
    what: str = ""


Find = Callable[[DrivenLog], Iterable[Event] | Unavailable]


@dataclass(frozen=True, slots=True)
class EventKind:
    """What is looked for.

    Attributes:
        name: One word, as in the column `kind` of events.parquet.
        find: The events of a log in any order; Unavailable where the log lacks what is needed to look.
        meaning: What it is and between which times it lasts, with its thresholds.
        measures: What `Event.value` is; empty: it is NaN.
        unit: Of the value: "m", "s", "m/s", "m/s2", "1".
        source: Where the definition comes from; empty: it is ours.

    Raises:
        ValueError: A field is not what it should be.
    """

    name: str
    find: Find
    meaning: str
    measures: str = ""
    unit: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or self.name.split() != [self.name]:
            raise ValueError(f"event kind {self.name!r}: its name has to be one word")
        if not callable(self.find):
            raise ValueError(f"event kind {self.name!r}: find has to be a function (log) -> events")
