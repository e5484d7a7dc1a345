"""Reads the trajectories among which a bag's on-board planner chose: Autoware's candidates, as its
generators propose them and its selector scores them.
"""

from __future__ import annotations

from math import nan
from typing import NamedTuple

from replan.core.arrays import FloatArray
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.bag import Topic
from replan.logs.readers.ros.ego import EgoLog
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.schemas import STAMP
from replan.logs.readers.ros.trajectories import PLAN_POINT, trajectory_of
from replan.logs.states import Alternative


class KnownAlternatives(NamedTuple):
    """The alternatives of one message."""

    known_ns: int  # time from which they were known, ns
    alternatives: tuple[Alternative, ...]


def read_alternatives(
    part: BagPart, ego: EgoLog, t0: int, origin: FloatArray
) -> tuple[KnownAlternatives, ...]:
    """Read the alternatives of all messages, in order of time; those with scores go before others.

    An alternative without a point that can be used is left out. The message types changed within
    Autoware's releases: a bag that does not define them is read without alternatives, with a note.
    """
    known = part.topics(schemas.ALTERNATIVES, "alternatives")
    topics = [topic for topic in known if part.bag.defines(topic)]
    topics.sort(key=lambda topic: not schemas.ALTERNATIVES[topic.kind].score)
    if known and not topics:
        part.notes.append(
            f"The alternatives of {known[0].name} are not read: the bag does not define their "
            "message type."
        )
    if not topics:
        return ()
    log, rows = part.bag.read(topics[0], _wanted(topics[0]), part.begin, part.end)
    messages = []
    for known_ns, (candidates, generators) in zip(ego.clock(log).tolist(), rows, strict=True):
        names = {bytes(generator): name for generator, name in generators}
        alternatives = []
        for seconds, nanoseconds, frame, generator, points, *scores in candidates:
            stamp = seconds * 1_000_000_000 + nanoseconds
            trajectory = trajectory_of(frame, points, stamp or known_ns, t0, ego, origin)
            if trajectory is not None:
                score, name = scores[0] if scores else nan, names.get(bytes(generator), "")
                alternatives.append(Alternative(trajectory, score, name))
        messages.append(KnownAlternatives(known_ns, tuple(alternatives)))
    several = f" (of {len(topics)} such topics)" if len(topics) > 1 else ""
    part.notes.append(f"The alternatives of on-board plans are those of {topics[0].name}{several}.")
    return tuple(sorted(messages, key=lambda message: message.known_ns))


def _wanted(topic: Topic) -> tuple[object, ...]:
    """The fields of a message: of its candidates, and the names of the generators by id."""
    schema = schemas.ALTERNATIVES[topic.kind]
    candidate = (
        *(f"{schema.candidate}{name}" for name in (*STAMP, "header.frame_id")),
        f"{schema.candidate}generator_id.uuid",
        (f"{schema.candidate}points", PLAN_POINT),
        *filter(None, [schema.score]),
    )
    generator = ("generator_id.uuid", "generator_name.data")
    return ((schema.items, candidate), ("generator_info", generator))
