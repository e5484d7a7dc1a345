"""Reads who drives in a bag: Autoware's control mode and operation mode, Autoware Mini's vehicle
status, and the reports of drive-by-wire systems.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from replan.core.arrays import IntArray
from replan.logs.driving import DrivingMode, DrivingModes, modes_of_words
from replan.logs.log_settings import FIELD
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.bag import Topic
from replan.logs.readers.ros.ego import EgoLog
from replan.logs.readers.ros.frames import times_of
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.schemas import STAMP, ModeSchema

LOST_PERIODS = 3.0
"""Periods without a message after which the mode of a topic that repeats it is unknown."""


def read_driving(part: BagPart, ego: EgoLog, t0: int) -> DrivingModes | None:
    """Read who drives, from the topic that says most, or that of the settings; None if no topic
    does.

    Raises:
        LogError: The topic of the settings is not in the log, has no such field or a value that is
            not known.
    """
    topics = _topics(part)
    if not topics:
        return None
    topic = topics[0]
    schema = _schema(part, topic)
    stamps_of_types = (("stamp.sec", "stamp.nanosec"), STAMP)
    stamp = next((names for names in stamps_of_types if part.bag.has(topic, names[0])), ())
    log, rows = part.bag.read(topic, (*stamp, *schema.fields), part.begin, part.end)
    stamps = np.array([1_000_000_000 * row[0] + row[1] if stamp else 0 for row in rows], np.int64)
    t, keep = times_of(topic.name, log, stamps, ego.clock, part.notes)
    if not len(t):
        return None
    values = [rows[k][len(stamp) :] for k in keep.tolist()]
    if part.settings.driver:
        words = [str(value) for (value,) in values]
        modes = modes_of_words(words, _given(part))
    else:
        modes = list(map(schema.mode, values))
    period = 0.0 if schema.is_latched or len(t) < 2 else float(np.median(np.diff(t))) / 1e9
    end_ns = int(ego.poses.t[-1])
    times, known = (t, modes) if schema.is_latched else _with_gaps(t, modes, period, end_ns)
    others = f" (of {len(topics)} such topics)" if len(topics) > 1 else ""
    part.notes.append(f"Who drives is what {topic.name} says{others}.")
    return DrivingModes.of_samples((times - t0) / 1e9, known, topic.name, period)


def _topics(part: BagPart) -> list[Topic]:
    """The topics that say who drives, that which says most first."""
    name = part.settings.topics.get("driver", "")
    if name and FIELD in part.settings.driver:  # of any type
        kinds: Mapping[str, object] = {topic.kind: None for topic in part.bag.topics}
        return part.topics(kinds, "driver")
    rank = list(schemas.MODES)
    meant = [topic for topic in part.topics(schemas.MODES, "driver") if _is_meant(part, topic)]
    part.notes.extend(
        f"{topic.name} may say who drives, and is not read: the bag does not define its type."
        for topic in meant
        if not part.bag.knows(topic)
    )
    topics = [topic for topic in meant if part.bag.knows(topic)]
    return sorted(topics, key=lambda topic: rank.index(topic.kind))


def _schema(part: BagPart, topic: Topic) -> ModeSchema:
    """How a topic says who drives; with settings for it, by the field that they name."""
    known = schemas.MODES.get(topic.kind)
    fields = part.settings.driver.get(FIELD) or (known.fields[0] if known else "data")
    if not part.settings.driver and known is not None:
        return known
    return ModeSchema((fields,), {}, is_latched=known is not None and known.is_latched)


def _given(part: BagPart) -> dict[str, str]:
    """The modes by value, of the settings."""
    return {value: mode for value, mode in part.settings.driver.items() if value != FIELD}


def _is_meant(part: BagPart, topic: Topic) -> bool:
    """Whether a topic says who drives: a flag does by its name, or by the settings."""
    names = schemas.MODES[topic.kind].names
    return not names or "driver" in part.settings.topics or topic.name.endswith(names)


def _with_gaps(
    t: IntArray, modes: list[DrivingMode], period: float, end_ns: int
) -> tuple[IntArray, list[DrivingMode]]:
    """The samples, and unknown ones where the topic is silent for `LOST_PERIODS`, also before the
    end of the drive.
    """
    silent_ns = max(round(1e9 * LOST_PERIODS * period), 1)
    times, known = [], []
    following = [*t[1:].tolist(), end_ns]
    for time, mode, next_time in zip(t.tolist(), modes, following, strict=True):
        times.append(time)
        known.append(mode)
        if period > 0.0 and next_time - time > silent_ns:
            times.append(time + silent_ns)
            known.append(DrivingMode.UNKNOWN)
    return np.array(times, np.int64), known
