"""A bag as a scenario: which topics, which clock, which part.

Of a part between `begin` and `end` only the messages around it are read: `REACH_S` before where the bag has detections
that may be repaired, else `HISTORY_S`, so that whoever was there is known and motion can be derived, and the first
second of the log, where t = 0 and the origin are. Where the log's clock runs unlike the senders' (a simulation slower
than time) log times do not say what is in a part: all is read.
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, inf, sin
from pathlib import Path

import numpy as np

from logs.detections import Detections
from logs.errors import LogError
from logs.kernel import FloatArray
from logs.mcap.complete import road_along
from logs.observed import Spans, of_stream
from logs.readers.base import LogSettings
from logs.readers.cut import HISTORY_S
from logs.readers.repaired import REACH_S, reason_to_repair
from logs.readers.ros import schemas
from logs.readers.ros.bag import Bag, Topic, opened
from logs.readers.ros.clocks import said, times_of
from logs.readers.ros.ego import EgoLog, at_poses, begin_of, read_ego, signal, states, topics_of
from logs.readers.ros.more import Window, controls, goal, lights, onboard, vehicle_of
from logs.readers.ros.objects import identified, read_messages, samples_of
from logs.readers.ros.tracks import tracks_of, without_ego
from logs.scenario import Scenario, Tracks
from logs.states import Trajectory
from logs.vehicle import VehicleParameters

HEAD_S = 2.0
"""Of the log's begin this is read to find t = 0, where only a later part is wanted."""
MARGIN_S = 1.0
"""Messages may be recorded so much later than they are stamped; on both sides of the wanted part."""


def read_bag(path: Path, settings: LogSettings) -> Scenario:
    """The scenario in a bag, or of it what lies around the part between `settings.begin` and `settings.end`.

    Raises:
        LogError: The bag is damaged or does not say where the ego is; the line says what it holds.
    """
    _check_roles(settings)
    with np.errstate(all="ignore"), opened(path) as bag:
        try:
            return _scenario(path, bag, settings)
        except ValueError as error:
            raise LogError(str(error)) from None


ROLES = {
    "topics": ("ego", "speed", "acceleration", "agents", "lights", "goal", "steering", "plan"),
    "frames": ("map", "base"),
}
"""What the settings can name."""


def _check_roles(settings: LogSettings) -> None:
    for key, roles in ROLES.items():
        wrong = sorted(set(getattr(settings, key)) - set(roles))
        if wrong:
            raise LogError(f"{key} has no {wrong[0]}", topic="[log]", remedy=f"its keys are {', '.join(roles)}")


def _scenario(path: Path, bag: Bag, settings: LogSettings) -> Scenario:
    notes: list[str] = []
    if not any(topic.count for topic in bag.topics):
        raise LogError("the bag holds no messages", remedy="record or copy it again")
    vehicle = vehicle_of(settings, notes)
    window, start, origin = _part(bag, settings)
    ego = read_ego(bag, settings, *window, notes)
    v, a = _measured(bag, settings, window, ego, notes)
    columns = states(ego, v, a, notes)
    if start is None:
        first = begin_of(ego, v)
        start, origin = int(ego.poses.t[first]), np.round(ego.poses.p[first, :2])
    else:
        first = 0
    if first:
        notes.append(
            f"The first {(start - ego.poses.t[0]) / 1e9:.2f} s, {first} poses, only serve to derive the speed."
        )
    t = (ego.poses.t[first:] - start) / 1e9
    x, y, yaw, speed, accel, kappa = (columns[name][first:] for name in ("x", "y", "yaw", "v", "a", "kappa"))
    trajectory = Trajectory(t, x - origin[0], y - origin[1], yaw, speed, accel, kappa)
    tracks, detections, traffic = _tracks(bag, settings, window, ego, start, origin, trajectory, vehicle, notes)
    synthetic = any(topic.kind == schemas.CLOCK and topic.count for topic in bag.topics)
    if synthetic:
        notes.append("The bag has a /clock: its drive is taken for a simulated one.")
    begin_ns = bag.start_ns + round(1e9 * settings.begin) if settings.begin > 0.0 else bag.start_ns
    scenario = Scenario(
        name=path.stem if path.is_file() else path.name,
        ego=trajectory,
        tracks=tracks,
        road=road_along(trajectory, notes),
        duration=float(t[-1]),
        goal=goal(bag, settings, ego, begin_ns, origin, vehicle, notes),
        vehicle=vehicle,
        controls=controls(bag, settings, window, ego, start, notes),
        tags=("synthetic" if synthetic else "recorded", "ros"),
        source="ROS 2 bag" if bag.is_ros2 else "ROS 1 bag",
        origin=(float(origin[0]), float(origin[1])),
        start_ns=start,
        lights=lights(bag, settings, window, ego, start, notes),
        onboard=onboard(bag, settings, window, ego, start, origin, notes),
        traffic=traffic,
        detections=detections,
    )
    return replace(scenario, notes=tuple(dict.fromkeys(notes)))


def _part(bag: Bag, settings: LogSettings) -> tuple[Window, int | None, FloatArray]:
    """Log times between which is read (None: no bound), and for a later part the time of t = 0, ns, and the origin."""
    nothing = np.zeros(2)
    if settings.begin <= 0.0 and settings.end == inf:
        return (None, None), None, nothing
    head = _head(bag, settings)
    if head is None:
        return (None, None), None, nothing
    ego, first = head
    detected = settings.repair != "off" and topics_of(bag, schemas.OBJECTS, settings, "agents")
    log0, around = bag.start_ns, (REACH_S if detected else HISTORY_S) + MARGIN_S
    end = None if settings.end == inf else log0 + round(1e9 * (settings.end + around))
    if settings.begin <= 0.0:
        return (None, end), None, nothing
    begin = log0 + round(1e9 * (settings.begin - around))
    return (max(begin, log0), end), int(ego.poses.t[first]), np.round(ego.poses.p[first, :2])


def _head(bag: Bag, settings: LogSettings) -> tuple[EgoLog, int] | None:
    """The ego at the log's begin and its first state; None where a part cannot be found by log time."""
    end = bag.start_ns + round(1e9 * HEAD_S)
    try:
        ego = read_ego(bag, settings, None, end, [])
    except LogError:
        return None
    clock = ego.clock
    if len(clock.log) > 1:
        pace = float(clock.stamp[-1] - clock.stamp[0]) / float(clock.log[-1] - clock.log[0])
        if not 0.8 < pace < 1.25:
            return None
    v, _ = _measured(bag, settings, (None, end), ego, [])
    return ego, begin_of(ego, v)


def _measured(
    bag: Bag, settings: LogSettings, window: Window, ego: EgoLog, notes: list[str]
) -> tuple[FloatArray, FloatArray]:
    """Speed and acceleration at the poses `(n,)` as far as they are logged; else NaN."""
    v = ego.v
    if np.isfinite(v).all() and "speed" not in settings.topics:
        notes.append(f"The ego's speed is that of {ego.source}.")
    else:
        v = at_poses(
            signal(bag, schemas.SPEEDS, settings, "speed", window, ego.clock, notes), ego.poses.t, "speed", notes
        )
    found = signal(bag, schemas.ACCELERATIONS, settings, "acceleration", window, ego.clock, notes)
    return v, at_poses(found, ego.poses.t, "acceleration", notes)


def _chosen(bag: Bag, settings: LogSettings, notes: list[str]) -> Topic | None:
    """The topic of the others: tracked before predicted before detected, then most messages, then name."""
    topics = topics_of(bag, schemas.OBJECTS, settings, "agents")
    if not topics:
        held = sorted({topic.kind for topic in bag.topics if topic.count and "bject" in topic.kind})
        more = f" (message types not read: {', '.join(held)})" if held and "agents" not in settings.topics else ""
        notes.append(f"No other road users: the log has no topic of objects{more}.")
        return None
    ordered = sorted(
        topics, key=lambda topic: (schemas.RANK.index(topic.kind.rpartition("/")[2]), -topic.count, topic.name)
    )
    if len(ordered) > 1:
        notes.append(
            f"The others are those of {ordered[0].name}, not of {', '.join(topic.name for topic in ordered[1:])}:"
            " tracked before predicted before detected, then most messages."
        )
    return ordered[0]


def _tracks(
    bag: Bag, settings: LogSettings, window: Window, ego: EgoLog, start: int, origin: FloatArray, driven: Trajectory,
    vehicle: VehicleParameters, notes: list[str],
) -> tuple[Tracks, Detections | None, Spans]:  # fmt: skip
    """The others, or detections that are to be made into tracks, and when their topic had messages."""
    topic = _chosen(bag, settings, notes)
    if topic is None:
        return Tracks.empty(), None, ()
    messages = read_messages(bag, topic, *window)
    if not len(messages.log):
        notes.append(f"{topic.name} has no messages in this part.")
        return Tracks.empty(), None, ()
    notes += said(topic.name, messages.log, messages.stamps, bag.start_ns)
    t, chosen = times_of(topic.name, messages.log, messages.stamps, ego.clock, notes)
    said_of_tracks: list[str] = []
    try:
        samples = samples_of(
            messages, schemas.OBJECTS[topic.kind], chosen, t, ego.frames, ego.map, notes, said_of_tracks
        )
    except LogError as error:
        remedy = "name the log's own frames under log.frames, or leave the objects out by log.topics.agents = '-'"
        raise LogError(error.what, topic=topic.name, remedy=remedy) from None
    x, y, since = samples.x - origin[0], samples.y - origin[1], (t - start) / 1e9
    found = replace(samples, x=x, y=y).detections(since)
    if reason_to_repair(settings.repair, found):
        return Tracks.empty(), found, of_stream(since)
    samples = identified(samples, t, said_of_tracks)
    notes += said_of_tracks
    tracks = tracks_of(replace(samples, x=x, y=y), since, notes)
    ahead = vehicle.axle_to_center
    x = driven.x + ahead * np.array([cos(yaw) for yaw in driven.yaw])
    y = driven.y + ahead * np.array([sin(yaw) for yaw in driven.yaw])
    return without_ego(tracks, driven.t, x, y, notes), None, of_stream(since)
