"""Reads the other road users of a bag: as tracks, or as detections that are to be repaired.

They are those of one topic: tracked before predicted before detected, then most messages, then
name.
"""

from __future__ import annotations

from dataclasses import replace

from replan.core.arrays import FloatArray
from replan.core.errors import LogError
from replan.logs.observed import Spans, of_stream
from replan.logs.readers.repaired import reason_to_repair
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.bag import Topic
from replan.logs.readers.ros.ego import EgoLog
from replan.logs.readers.ros.frames import describe_timing, times_of
from replan.logs.readers.ros.objects import read_messages, samples_of
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.tracks import identified, tracks_of
from replan.logs.repair.detections import Detections
from replan.logs.tracks import Tracks


def read_tracks(
    part: BagPart, ego: EgoLog, start: int, origin: FloatArray
) -> tuple[Tracks, Detections | None, Spans]:
    """Read the others, or detections that are to be made into tracks, and when their topic had
    messages.
    """
    notes, topic = part.notes, _topic(part)
    if topic is None:
        return Tracks.empty(), None, ()
    messages = read_messages(part, topic)
    if not len(messages.log):
        notes.append(f"{topic.name} has no messages in this part.")
        return Tracks.empty(), None, ()
    notes += describe_timing(topic.name, messages.log, messages.stamps, part.bag.start_ns)
    t, chosen = times_of(topic.name, messages.log, messages.stamps, ego.clock, notes)
    id_notes: list[str] = []
    try:
        samples = samples_of(
            messages,
            schemas.OBJECTS[topic.kind],
            chosen,
            t,
            ego.frames,
            ego.map,
            ego.poses.p,
            notes,
            id_notes,
        )
    except LogError as error:
        remedy = (
            "name the log's own frames under log.frames, or leave the objects out by "
            "log.topics.agents = '-'"
        )
        raise LogError(error.what, topic=topic.name, remedy=remedy) from None
    x, y, since = samples.x - origin[0], samples.y - origin[1], (t - start) / 1e9
    detections = replace(samples, x=x, y=y).detections(since)
    if reason_to_repair(part.settings.repair, detections):
        return Tracks.empty(), detections, of_stream(since)
    samples = identified(samples, t, id_notes)
    notes += id_notes
    return tracks_of(replace(samples, x=x, y=y), since, notes), None, of_stream(since)


def _topic(part: BagPart) -> Topic | None:
    """The topic of the others; None, with a note, if there is none."""
    topics = sorted(part.topics(schemas.OBJECTS, "agents"), key=_order)
    if not topics:
        unread = {topic.kind for topic in part.bag.topics if topic.count and "bject" in topic.kind}
        types = ""
        if unread and "agents" not in part.settings.topics:
            types = f" (message types not read: {', '.join(sorted(unread))})"
        part.notes.append(f"No other road users: the log has no topic of objects{types}.")
        return None
    topic, *others = topics
    if others:
        part.notes.append(
            f"The others are those of {topic.name}, not of "
            f"{', '.join(other.name for other in others)}:"
            " tracked before predicted before detected, then most messages."
        )
    return topic


def _order(topic: Topic) -> tuple[int, int, str]:
    _, _, kind = topic.kind.rpartition("/")
    return schemas.RANK.index(kind), -topic.count, topic.name
