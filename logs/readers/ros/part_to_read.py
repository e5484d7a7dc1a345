"""Chooses the part of a bag that is read, and with it clock, t = 0 and origin.

For a part between `begin` and `end` only the messages around it are read: from `DETECTED_S` before
it where the bag has detections that may be repaired, else from `HISTORY_S` before it, which show
who is present and how they move; and the first seconds of the log, which define t = 0 and the
origin. Where the log's clock is faster or slower than the senders' (a simulation slower than real
time), log times do not define a part, and all messages are read.

A bag in which the ego's clock restarts holds several drives, of which one is read: that to which
the part between `begin` and `end` belongs, which then are seconds of the bag's recording.
"""

from __future__ import annotations

from itertools import pairwise
from math import inf
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import LogError
from replan.logs.edit.cut import DETECTED_S, HISTORY_S
from replan.logs.log_settings import LogSettings
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.bag import Bag
from replan.logs.readers.ros.ego import EgoLog, read_ego
from replan.logs.readers.ros.ego_motion import begin_of, logged_motion
from replan.logs.readers.ros.frames import LASTS_S, OTHER_CLOCK_S, Clock
from replan.logs.readers.ros.part import BagPart

HEAD_S = 2.0
"""Time at the log's begin that is read to find t = 0 if only a later part is wanted, s."""
MARGIN_S = 1.0
"""Messages may be recorded this much later than they are stamped, s.

Read on both sides of the wanted part.
"""
LEAST_PACE = 0.8
"""Where the senders' clock is slower than this share of the log's, log times define no part."""
MOST_PACE = 1.25
"""Where the senders' clock is faster than this share of the log's, log times define no part."""


class Start(NamedTuple):
    """The time of t = 0 on the scenario's clock, ns, and the origin `(2,)`, m."""

    t0_ns: int
    origin: FloatArray


class PartToRead(NamedTuple):
    """What is read of a bag, its ego, and the start where the log's begin defines it."""

    part: BagPart
    ego: EgoLog
    start: Start | None


class _TimedPart(NamedTuple):
    """A part by log time, its start if it does not begin with the log, and the log's first
    clock.
    """

    part: BagPart
    start: Start | None
    clock: Clock


def part_to_read(bag: Bag, settings: LogSettings) -> PartToRead:
    """Choose what is read of a bag; LogError for several drives."""
    whole = BagPart(bag, settings)
    is_part = settings.begin > 0.0 or settings.end < inf
    timed = _part_by_log_time(whole) if is_part else None
    if timed is not None:
        ego = read_ego(timed.part)
        log, stamp = ego.clock.log[:1], ego.clock.stamp[:1]
        is_other_clock = (np.abs(timed.clock(log) - stamp) > 1e9 * OTHER_CLOCK_S).any()
        if not len(ego.restarts) and not is_other_clock:
            return PartToRead(timed.part, ego, timed.start)
    ego = read_ego(whole)
    if len(ego.restarts):
        part = _drive_to_read(whole, ego)
        return PartToRead(part, ego if part is whole else read_ego(part), None)
    return PartToRead(whole, ego, None)


def _drive_to_read(whole: BagPart, ego: EgoLog) -> BagPart:
    """Of several drives in a bag, that between the settings' begin and end, or all by log time, or
    a LogError.
    """
    bag, settings = whole.bag, whole.settings
    restarts_s = ((ego.restarts - bag.start_ns) / 1e9).tolist()
    times = ", ".join(f"{t:.1f} s" for t in restarts_s)
    problem = (
        f"clock of {ego.restarted} restarts at {times} of the bag: {len(restarts_s) + 1} drives"
    )
    if settings.clock == "log":
        whole.notes.append(f"The {problem}, which are joined, because clock = log is set.")
        return whole
    bounds = pairwise([0.0, *restarts_s, (bag.end_ns - bag.start_ns) / 1e9])
    shared = [min(end, settings.end) - max(begin, settings.begin) for begin, end in bounds]
    if sum(overlap_s > LASTS_S for overlap_s in shared) > 1:
        raise LogError(
            f"the {problem}", remedy="--from/--to chooses one, and clock = log in [log] joins them"
        )
    chosen = int(np.argmax(shared))
    begin, end = [bag.start_ns, *ego.restarts.tolist(), bag.end_ns + 1][chosen : chosen + 2]
    if settings.end < inf:
        end = min(end, bag.start_ns + round(1e9 * settings.end))
    note = (
        f"The {problem}; this is number {chosen + 1}, and --from and --to are seconds of the bag."
    )
    return BagPart(bag, settings, begin, end - 1, [note], is_drive=True)


def _part_by_log_time(whole: BagPart) -> _TimedPart | None:
    """The messages around the settings' begin and end; None where log times define no part."""
    bag, settings = whole.bag, whole.settings
    head = BagPart(bag, settings, None, bag.start_ns + round(1e9 * HEAD_S))
    try:
        ego = read_ego(head)
    except LogError:
        return None
    clock = ego.clock
    if len(clock.log) > 1:
        pace = float(clock.stamp[-1] - clock.stamp[0]) / float(clock.log[-1] - clock.log[0])
        if not LEAST_PACE < pace < MOST_PACE:
            return None
    first = begin_of(ego, logged_motion(head, ego)[0])
    detected = settings.repair != "off" and whole.topics(schemas.OBJECTS, "agents")
    log0, around = bag.start_ns, (DETECTED_S if detected else HISTORY_S) + MARGIN_S
    end = None if settings.end == inf else log0 + round(1e9 * (settings.end + around))
    if settings.begin <= 0.0:
        return _TimedPart(BagPart(bag, settings, None, end), None, clock)
    begin = log0 + round(1e9 * (settings.begin - around))
    start = Start(int(ego.poses.t[first]), np.round(ego.poses.p[first, :2]))
    return _TimedPart(BagPart(bag, settings, max(begin, log0), end), start, clock)
