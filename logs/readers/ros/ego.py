"""Reads the ego's poses and speed from their topics.

Poses, in this order: nav_msgs/Odometry in the map frame; the chain of transforms from the map to
the car; Odometry in another frame; PoseStamped with or without covariance. Of several topics of a
kind, the one with most messages is used, then the first by name. Speed: that of the odometry; else
of a topic of velocities; else derived from the poses (`replan.logs.readers.ros.ego_motion`).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.errors import LogError
from replan.logs.chords import Chords
from replan.logs.conventions import axes_of, in_axes
from replan.logs.log_settings import LogSettings
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.bag import Bag, Topic
from replan.logs.readers.ros.frames import (
    HELD,
    Clock,
    FrameTree,
    Poses,
    clock_of,
    composed,
    describe_timing,
    inverse,
    restarts,
    times_of,
)
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.schemas import POSITION, twist_fields
from replan.logs.readers.ros.transforms import (
    BASE_NAMES,
    MAP_NAMES,
    Edge,
    Edges,
    base_of,
    edge_of,
    frames_of,
    map_frame_of,
    moved,
    own_frames,
    read_edges,
)

LEAST_POSES = 2
"""Fewer poses show no drive."""


@dataclass(frozen=True, eq=False)
class EgoLog:
    """The logged ego: source, clock, frames, poses and speed `(n,)`; the speed is NaN where it must
    be derived.

    `restarts` are the log times, ns, at which another drive begins, because the clock of the topic
    `restarted` does.
    """

    source: str
    clock: Clock
    map: str
    base: str
    frames: FrameTree
    poses: Poses
    v: FloatArray
    restarts: IntArray
    restarted: str

    def in_map(self, poses: Poses, frame: str) -> Poses:
        """Return poses in a frame, as a message names it, as poses in the frame `map`; "" is that
        frame.
        """
        name = frame.lstrip("/")
        if name in (self.map, ""):
            return poses
        return composed(self.frames.poses(self.map, name, poses.t, HELD), poses)


@dataclass(frozen=True, eq=False)
class PoseTopic:
    """A topic of the ego's poses: the names of their frame and of the frame that they place, and
    the twists `(n, 6)` in the latter; NaN: the topic has none.
    """

    topic: Topic
    frame: str
    child: str
    edge: Edge
    twist: FloatArray


def read_ego(part: BagPart) -> EgoLog:
    """Read the ego's poses; LogError if the log has none."""
    edges = read_edges(part)
    name = part.settings.topics.get("ego", "")
    is_by_transforms = any(
        topic.name == name and topic.kind in schemas.TRANSFORMS for topic in part.bag.topics
    )
    source = None if is_by_transforms else _pose_topic(part, edges)
    return _by_transforms(part, edges) if source is None else _by_topic(part, source, edges)


def _by_transforms(part: BagPart, edges: Edges) -> EgoLog:
    """Return the ego as the base in the map; LogError if no chain of transforms leads there."""
    settings, notes = part.settings, part.notes
    map_frame = map_frame_of(edges, "", settings)
    base, reason = _moving_base(edges, map_frame, settings)
    if not base:
        raise _no_ego(part.bag)
    tree = FrameTree(
        (parent, child, Poses(edge.log, edge.p, edge.q)) for (parent, child), edge in edges.items()
    )
    chain = tree.chain(map_frame, base)
    in_chain = (edges[parent, child] for parent, child, _ in chain)
    fastest = max(in_chain, key=lambda edge: len(edge.log), default=None)
    if fastest is None or len(fastest.log) < LEAST_POSES:
        raise _no_ego(part.bag)
    clock = clock_of(fastest.log, fastest.stamps, settings.clock)
    source = "/tf"
    steps = (child if is_down else parent for parent, child, is_down in chain)
    path = " -> ".join([map_frame, *steps])
    notes.append(f"The ego is frame '{base}' ({reason}), its pose by transforms: {path}.")
    notes += describe_timing(source, fastest.log, fastest.stamps, int(fastest.log[0]))
    frames = frames_of(edges, clock, notes)
    t = frames.times(map_frame, base)
    if len(t) < LEAST_POSES:
        raise _no_ego(part.bag)
    poses, v = frames.poses(map_frame, base, t, HELD), np.full(len(t), np.nan)
    restarted = _restarts(part, source, fastest)
    return EgoLog(source, clock, map_frame, base, frames, poses, v, *restarted)


def _moving_base(edges: Edges, map_frame: str, settings: LogSettings) -> tuple[str, str]:
    """Return the car's frame among the transforms, and why it is taken; "": there is none."""
    if "base" in settings.frames:
        return settings.frames["base"], "as set"
    children = {child for _, child in edges}
    for name in BASE_NAMES:
        if name in children:
            return name, "by its name"
    counts = {
        child: len(edge.log)
        for (_, child), edge in edges.items()
        if not edge.is_static and len(edge.log) > 1
    }
    counts.pop(map_frame, None)
    if len(counts) == 1:
        return next(iter(counts)), "the only frame that moves"
    most = min(counts, key=lambda name: (-counts[name], name), default="")
    return most, "of the frames that move the one with most transforms"


def _restarts(part: BagPart, source: str, edge: Edge) -> tuple[IntArray, str]:
    """Return when another drive begins in the bag, log times in ns: by the ego's stamps, else by
    /clock; the topic.
    """
    times = {source: restarts(edge.log, edge.stamps)}
    for topic in part.bag.topics:
        if topic.kind == schemas.CLOCK and topic.count and not len(times[source]):
            log, stamps, _ = part.read(topic, (), ("clock.sec", "clock.nanosec"))
            times[topic.name] = restarts(log[stamps > 0], stamps[stamps > 0])  # 0: not yet known
    topic_name = max(times, key=lambda name: len(times[name]))
    return times[topic_name], topic_name


def _pose_topic(part: BagPart, edges: Edges) -> PoseTopic | None:
    """Return the topic of odometry or poses of the ego; None: transforms are better, or there is no
    such topic.
    """
    kinds = {**dict.fromkeys(schemas.ODOMETRY, "pose.pose"), **schemas.POSES}
    is_set = "ego" in part.settings.topics
    topics = [topic for topic in part.topics(kinds, "ego") if topic.count >= LEAST_POSES]
    if not is_set:
        topics = [topic for topic in topics if not re.search("goal|initialpose", topic.name)]
    has_transforms = any(
        not edge.is_static and len(edge.log) >= LEAST_POSES for edge in edges.values()
    )
    odometry = [topic for topic in topics if topic.kind in schemas.ODOMETRY]
    for topic in (*odometry, *(topic for topic in topics if topic not in odometry)):
        source = _read_poses(part, topic, kinds[topic.kind])
        is_in_map = topic.kind in schemas.ODOMETRY and (
            source.frame == map_frame_of(edges, source.frame, part.settings)
        )
        if len(source.edge.log) >= LEAST_POSES and (is_set or is_in_map or not has_transforms):
            return source
    return None


def _read_poses(part: BagPart, topic: Topic, path: str) -> PoseTopic:
    """Read the poses of a topic, which are at `path` in its messages, and its twists; LogError
    without a message in the part.
    """
    is_odometry = topic.kind in schemas.ODOMETRY
    names = ("header.frame_id", "child_frame_id") if is_odometry else ("header.frame_id",)
    twist_names = twist_fields("twist.twist.") if is_odometry else ()
    fields = (*names, *(f"{path}.{name}" for name in POSITION), *twist_names)
    log, stamps, rows = part.read(topic, fields)
    if not rows:
        remedy = "choose begin and end within the log"
        raise LogError("no poses in this part of the log", topic=topic.name, remedy=remedy)
    values = np.array([row[len(names) :] for row in rows])
    pose, twist = np.hsplit(values, [len(POSITION)])
    if not is_odometry:
        twist = np.full((len(rows), len(twist_fields(""))), np.nan)
    twist = twist[np.isfinite(pose).all(axis=1)]
    frame, *children = (name.lstrip("/") for name in rows[0][: len(names)])
    edge = edge_of(log, stamps, pose, is_static=False)
    return PoseTopic(topic, frame, children[0] if children else "", edge, twist)


def _by_topic(part: BagPart, source: PoseTopic, edges: Edges) -> EgoLog:
    """Return the ego of a topic of poses, moved to the car's base where transforms lead there."""
    topic, edge, notes = source.topic, source.edge, part.notes
    count = sum(1 for other in part.bag.topics if other.kind == topic.kind and other.count)
    several = f" (of {count} such topics the one with most messages)" if count > 1 else ""
    notes.append(f"The ego's pose is that of {topic.name}{several}, frame '{source.frame}'.")
    clock = clock_of(edge.log, edge.stamps, part.settings.clock)
    notes += describe_timing(topic.name, edge.log, edge.stamps, int(edge.log[0]))
    t, keep = times_of(topic.name, edge.log, edge.stamps, clock, notes)
    poses, twist = Poses(t, edge.p[keep], edge.q[keep]), source.twist[keep]
    map_frame = map_frame_of(edges, source.frame, part.settings)
    own = own_frames(frames_of(edges, clock, []), {source.frame, map_frame, *MAP_NAMES})
    base = base_of(topic.name, source.child, own, part.settings, notes)
    if base != source.child and own.connects(source.child, base):
        place = own.poses(source.child, base, t, HELD)
        poses, twist = composed(poses, place), moved(twist, place)
    above = own.path(base)  # the car's own frames hang below its base
    turned = {pair: inverse(own.edges[pair[::-1]]) for pair in pairwise(above)}
    below = {pair: transforms for pair, transforms in edges.items() if pair[1] not in above}
    placed = frames_of(below, clock, notes).edges | turned | {(source.frame, base): poses}
    speed = _speed_along(twist, poses, part.settings, topic.name, notes)
    frames = FrameTree((*pair, transforms) for pair, transforms in placed.items())
    if map_frame != source.frame and map_frame in frames.path(source.frame):
        poses = frames.poses(map_frame, base, t, HELD)
    else:
        map_frame = source.frame
    if np.ptp(np.nan_to_num(speed)) == 0.0:
        speed = np.full(len(t), np.nan)  # a constant speed is not a measurement
    restarted = _restarts(part, topic.name, edge)
    return EgoLog(topic.name, clock, map_frame, base, frames, poses, speed, *restarted)


def _speed_along(
    twist: FloatArray, poses: Poses, settings: LogSettings, topic: str, notes: list[str]
) -> FloatArray:
    """Return the speed along the heading `(n,)` of velocities `(n, 6)`, in the axes in which they
    fit the poses.
    """
    vx, vy, *_ = twist.T
    yaw, axes = poses.yaw, settings.ego_axes
    if not axes:
        seconds = (poses.t - poses.t[0]) / 1e9
        chords = Chords.of(np.array([0, len(seconds)]), seconds, poses.p[:, 0], poses.p[:, 1])
        axes, misfit, usual = axes_of(chords, vx, vy, yaw, "own") or ("", np.nan, np.nan)
        if axes in ("own", ""):
            return vx
        notes.append(
            f"The velocity of {topic} is in {axes} axes: it fits the poses within {misfit:.0%}, in "
            f'its own axes {usual:.0%} (ego_axes = "own" in [log] takes it as it is).'
        )
    in_world = in_axes(axes, vx, vy, yaw)
    return in_world[0] * np.cos(yaw) + in_world[1] * np.sin(yaw)


def _no_ego(bag: Bag) -> LogError:
    kinds = sorted({topic.kind.replace("/msg/", "/") for topic in bag.topics if topic.count})
    held = ", ".join(kinds) or "no messages"
    remedy = (
        "needed are /tf from map to base_link, nav_msgs/Odometry or geometry_msgs/PoseStamped "
        "(log.topics.ego)"
    )
    return LogError(f"nothing in the bag says where the ego is; it holds {held}", remedy=remedy)
