"""Reads who drives in a bag: Autoware's control mode and operation mode, Autoware Mini's vehicle
status, and the reports of drive-by-wire systems.
"""

from __future__ import annotations

import numpy as np

from replan.core.arrays import IntArray
from replan.logs.driving import DrivingMode, DrivingModes
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.bag import Topic
from replan.logs.readers.ros.ego import EgoLog
from replan.logs.readers.ros.frames import times_of
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.schemas import STAMP

LOST_PERIODS = 3.0
"""Of a topic that repeats its mode, the mode is unknown after so many periods without one."""


def read_driving(part: BagPart, ego: EgoLog, t0: int) -> DrivingModes | None:
    """Read who drives, from the topic that says most; None if no topic does."""
    topics = [topic for topic in part.topics(schemas.MODES, "driver") if _is_meant(part, topic)]
    rank = list(schemas.MODES)
    topics.sort(key=lambda topic: rank.index(topic.kind))
    if not topics:
        return None
    topic = topics[0]
    schema = schemas.MODES[topic.kind]
    stamps_of_types = (("stamp.sec", "stamp.nanosec"), STAMP)
    stamp = next((names for names in stamps_of_types if part.bag.has(topic, names[0])), ())
    log, rows = part.bag.read(topic, (*stamp, *schema.fields), part.begin, part.end)
    stamps = np.array([1_000_000_000 * row[0] + row[1] if stamp else 0 for row in rows], np.int64)
    t, keep = times_of(topic.name, log, stamps, ego.clock, part.notes)
    if not len(t):
        return None
    modes = [schema.mode(rows[k][len(stamp) :]) for k in keep.tolist()]
    period = 0.0 if schema.is_latched or len(t) < 2 else float(np.median(np.diff(t))) / 1e9
    times, known = (t, modes) if schema.is_latched else _with_gaps(t, modes, period)
    others = f" (of {len(topics)} such topics)" if len(topics) > 1 else ""
    part.notes.append(f"Who drives is what {topic.name} says{others}.")
    return DrivingModes.of_samples((times - t0) / 1e9, known, topic.name, period)


def _is_meant(part: BagPart, topic: Topic) -> bool:
    """Whether a topic says who drives: a flag does by its name, or by the settings."""
    names = schemas.MODES[topic.kind].names
    return not names or "driver" in part.settings.topics or topic.name.endswith(names)


def _with_gaps(
    t: IntArray, modes: list[DrivingMode], period: float
) -> tuple[IntArray, list[DrivingMode]]:
    """The samples, and unknown ones where the topic is silent for `LOST_PERIODS`."""
    silent_ns = round(1e9 * LOST_PERIODS * period)
    times, known = [], []
    for n, (time, mode) in enumerate(zip(t.tolist(), modes, strict=True)):
        times.append(time)
        known.append(mode)
        if n + 1 < len(t) and t[n + 1] - time > max(silent_ns, 1):
            times.append(time + silent_ns)
            known.append(DrivingMode.UNKNOWN)
    return np.array(times, np.int64), known
