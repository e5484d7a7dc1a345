"""The part of a bag that is read, with the settings and the notes of the reading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from replan.core.arrays import IntArray
from replan.core.errors import LogError
from replan.logs.log_settings import LogSettings
from replan.logs.readers.ros.bag import Bag, Topic
from replan.logs.readers.ros.fields import Wanted
from replan.logs.readers.ros.schemas import STAMP

NO_TOPIC = "-"
"""Name of a topic in the settings that means: use no topic."""


@dataclass(frozen=True, eq=False)
class BagPart:
    """The messages of a bag that are read: those from `begin` to `end`, log times in ns (None: no
    bound).
    """

    bag: Bag
    settings: LogSettings
    begin: int | None = None
    end: int | None = None
    # list to which assumptions and omissions are added, one sentence each
    notes: list[str] = field(default_factory=list)
    is_drive: bool = False  # whether the bounds are those of one of several drives in the bag

    def topics(self, kinds: Mapping[str, object] | tuple[str, ...], role: str) -> list[Topic]:
        """Return the topics of these types with messages, most first; or that of the settings.

        Raises:
            LogError: The topic of the settings is not in the log, or has another type.
        """
        name = self.settings.topics.get(role, "")
        if name == NO_TOPIC:
            return []
        fitting = [topic for topic in self.bag.topics if topic.kind in kinds and topic.count]
        if not name:
            return sorted(fitting, key=lambda topic: (-topic.count, topic.name))
        named = [topic for topic in fitting if topic.name == name]
        if not named:
            kind = next((topic.kind for topic in self.bag.topics if topic.name == name), None)
            state = "is not in the log" if kind is None else f"has the type {kind}"
            names = ", ".join(topic.name for topic in fitting) or "none"
            remedy = f"for this role the log has {names}; '-' takes none"
            raise LogError(f"the topic for {role!r} {state}", topic=name, remedy=remedy)
        return named

    def read(
        self, topic: Topic, wanted: Wanted, stamp: Wanted = STAMP
    ) -> tuple[IntArray, IntArray, list[Any]]:
        """Return log times and stamps `(n,)`, ns, of a topic's messages, and rows of `wanted`."""
        log, rows = self.bag.read(topic, (*stamp, *wanted), self.begin, self.end)
        stamps = [seconds * 1_000_000_000 + nanoseconds for seconds, nanoseconds, *_ in rows]
        return log, np.array(stamps, dtype=np.int64), [row[len(stamp) :] for row in rows]
