"""Reads a bag as a scenario: chooses topics, clock and part; reads lights, goal, steering and
on-board plans.

For a part between `begin` and `end` only the messages around it are read: from `DETECTED_S` before
it where the bag has detections that may be repaired, else from `HISTORY_S` before it, which show
who is present and how they move; and the first seconds of the log, which define t = 0 and the
origin. Where the log's clock is faster or slower than the senders' (a simulation slower than real
time), log times do not define a part, and all messages are read.

A bag in which the ego's clock restarts holds several drives, of which one is read: that to which
the part between `begin` and `end` belongs, which then are seconds of the bag's recording.

On-board plans whose points have no times (Autoware leaves `time_from_start` at 0) are timed by
their speeds:

(1) t_(i+1) = t_i + 2 d_i / (v_i + v_(i+1)),
        d_i the distance of two points; where both are below `CREEPS_MPS` the plan stands. The time
        of the point nearest to the ego is that of the message
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import cos, inf, sin
from pathlib import Path

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import LogError
from replan.logs.complete import derived_acceleration, derived_curvature, road_along
from replan.logs.edit.cut import DETECTED_S, HISTORY_S
from replan.logs.log_settings import LogSettings
from replan.logs.observed import Spans, of_stream
from replan.logs.readers.recorded import unit_or_identity
from replan.logs.readers.repaired import reason_to_repair
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.bag import Bag, opened
from replan.logs.readers.ros.ego import EgoLog, read_ego
from replan.logs.readers.ros.ego_motion import at_poses, begin_of, signal, states
from replan.logs.readers.ros.frames import (
    HELD,
    LASTS_S,
    LOG_CLOCK,
    OTHER_CLOCK_S,
    Clock,
    Poses,
    describe_timing,
    times_of,
)
from replan.logs.readers.ros.objects import read_messages, samples_of
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.schemas import POSITION, STAMP
from replan.logs.readers.ros.tracks import identified, tracks_of
from replan.logs.repair.detections import Detections
from replan.logs.road import GOAL_LENGTH_M, GOAL_WIDTH_M, Goal
from replan.logs.rules import Colour, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import Controls, OnboardPlan, Trajectory
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VEHICLE_ASSUMED, VehicleParameters

HEAD_S = 2.0
"""Time at the log's begin that is read to find t = 0 if only a later part is wanted, s."""
MARGIN_S = 1.0
"""Messages may be recorded this much later than they are stamped.

Read on both sides of the wanted part.
"""


def read_bag(path: Path, settings: LogSettings) -> Scenario:
    """The scenario in a bag, or its part around the settings' begin and end; LogError without an
    ego in it.
    """
    for key, roles in ROLES.items():
        wrong = sorted(set(getattr(settings, key)) - set(roles))
        if wrong:
            raise LogError(
                f"{key} has no {wrong[0]}", topic="[log]", remedy=f"its keys are {', '.join(roles)}"
            )
    with np.errstate(all="ignore"), opened(path) as bag:
        try:
            return _scenario(path, bag, settings)
        except ValueError as error:
            raise LogError(str(error)) from None


ROLES = {
    "topics": ("ego", "speed", "acceleration", "agents", "lights", "goal", "steering", "plan"),
    "frames": ("map", "base"),
}
"""Valid keys of the settings `topics` and `frames`."""


def _scenario(path: Path, bag: Bag, settings: LogSettings) -> Scenario:
    if not any(topic.count for topic in bag.topics):
        problem = ": ".join(["the bag holds no messages", *bag.notes]).rstrip(".")
        raise LogError(problem, remedy="record or copy it again")
    about_car = list(bag.notes)
    vehicle = settings.vehicle(about_car)
    if vehicle is None:
        vehicle = VehicleParameters()
        about_car.append(f"{VEHICLE_ASSUMED} (set log.car).")
    part, ego, start, origin = _part_to_read(bag, settings)
    notes = part.notes
    notes[:0] = about_car
    v, a = _logged_motion(part, ego)
    columns = states(ego, v, a, notes)
    if start is None:
        first = begin_of(ego, v)
        start, origin = int(ego.poses.t[first]), np.round(ego.poses.p[first, :2])
        if part.is_drive:
            asked = np.array([bag.start_ns + round(1e9 * settings.begin)])
            start = max(start, int(ego.clock(asked)[0])) - round(1e9 * settings.begin)
    else:
        first = 0
    if first:
        since = (ego.poses.t[first] - ego.poses.t[0]) / 1e9
        notes.append(f"The first {since:.2f} s, {first} poses, only serve to derive the speed.")
    t = (ego.poses.t[first:] - start) / 1e9
    x, y, yaw, speed, accel, kappa = (
        columns[name][first:] for name in ("x", "y", "yaw", "v", "a", "kappa")
    )
    trajectory = Trajectory(t, x - origin[0], y - origin[1], yaw, speed, accel, kappa)
    tracks, detections, traffic = _tracks(part, ego, start, origin)
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
        goal=goal(part, ego, begin_ns, origin, vehicle),
        vehicle=vehicle,
        controls=controls(part, ego, start),
        tags=("synthetic" if synthetic else "recorded", "ros"),
        source="ROS 2 bag" if bag.is_ros2 else "ROS 1 bag",
        origin=(float(origin[0]), float(origin[1])),
        start_ns=start,
        lights=lights(part, ego, start),
        onboard=onboard(part, ego, start, origin),
        traffic=traffic,
        detections=detections,
    )
    return replace(scenario, notes=tuple(dict.fromkeys(notes)))


def _part_to_read(
    bag: Bag, settings: LogSettings
) -> tuple[BagPart, EgoLog, int | None, FloatArray]:
    """What is read of a bag, its ego, and of a later part t = 0, ns, and origin; LogError for
    several drives.
    """
    whole = part = BagPart(bag, settings)
    start: int | None = None
    origin: FloatArray = np.zeros(2)
    clock = LOG_CLOCK
    if settings.begin > 0.0 or settings.end < inf:
        part, start, origin, clock = _part_by_log_time(whole)
    ego = read_ego(part)
    log, stamp = ego.clock.log[:1], ego.clock.stamp[:1]
    if part is not whole and (
        len(ego.restarts) or (np.abs(clock(log) - stamp) > 1e9 * OTHER_CLOCK_S).any()
    ):
        # The clock at the log's begin is not that of the part
        part, start, origin = whole, None, np.zeros(2)
        ego = read_ego(whole)
    if len(ego.restarts):
        part = _drive_to_read(whole, ego)
        ego = ego if part is whole else read_ego(part)
    return part, ego, start, origin


def _drive_to_read(whole: BagPart, ego: EgoLog) -> BagPart:
    """Of several drives in a bag, that between the settings' begin and end, or all by log time, or
    a LogError.
    """
    bag, settings = whole.bag, whole.settings
    restarts_s = ((ego.restarts - bag.start_ns) / 1e9).tolist()
    count = {2: "two", 3: "three", 4: "four"}.get(len(restarts_s) + 1, str(len(restarts_s) + 1))
    times = ", ".join(f"{t:.1f} s" for t in restarts_s)
    problem = f"clock of {ego.restarted} restarts at {times} of the bag: {count} drives"
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


def _part_by_log_time(whole: BagPart) -> tuple[BagPart, int | None, FloatArray, Clock]:
    """The messages around the settings' begin and end, the time of t = 0, the origin, and the log's
    first clock.
    """
    bag, settings, unknown = whole.bag, whole.settings, (whole, None, np.zeros(2), LOG_CLOCK)
    head = BagPart(bag, settings, None, bag.start_ns + round(1e9 * HEAD_S))
    try:
        ego = read_ego(head)
    except LogError:
        return unknown
    clock = ego.clock
    if len(clock.log) > 1:
        pace = float(clock.stamp[-1] - clock.stamp[0]) / float(clock.log[-1] - clock.log[0])
        if not 0.8 < pace < 1.25:
            return unknown  # a part cannot be found by log time
    first = begin_of(ego, _logged_motion(head, ego)[0])
    detected = settings.repair != "off" and whole.topics(schemas.OBJECTS, "agents")
    log0, around = bag.start_ns, (DETECTED_S if detected else HISTORY_S) + MARGIN_S
    end = None if settings.end == inf else log0 + round(1e9 * (settings.end + around))
    if settings.begin <= 0.0:
        return BagPart(bag, settings, None, end), None, np.zeros(2), clock
    begin = log0 + round(1e9 * (settings.begin - around))
    origin = np.round(ego.poses.p[first, :2])
    return BagPart(bag, settings, max(begin, log0), end), int(ego.poses.t[first]), origin, clock


def _logged_motion(part: BagPart, ego: EgoLog) -> tuple[FloatArray, FloatArray]:
    """Speed and acceleration at the poses `(n,)` as far as they are logged; else NaN."""
    v, notes = ego.v, part.notes
    if np.isfinite(v).all() and "speed" not in part.settings.topics:
        notes.append(f"The ego's speed is that of {ego.source}.")
    else:
        v = at_poses(signal(part, schemas.SPEEDS, "speed", ego), ego.poses.t, "speed", notes)
    measured = signal(part, schemas.ACCELERATIONS, "acceleration", ego)
    return v, at_poses(measured, ego.poses.t, "acceleration", notes)


def _tracks(
    part: BagPart, ego: EgoLog, start: int, origin: FloatArray
) -> tuple[Tracks, Detections | None, Spans]:
    """The others, or detections that are to be made into tracks, and when their topic had messages.

    The topic: tracked before predicted before detected, then most messages, then name.
    """
    notes = part.notes
    topics = sorted(
        part.topics(schemas.OBJECTS, "agents"),
        key=lambda each: (schemas.RANK.index(each.kind.rpartition("/")[2]), -each.count, each.name),
    )
    if not topics:
        held = sorted(
            {topic.kind for topic in part.bag.topics if topic.count and "bject" in topic.kind}
        )
        more = (
            f" (message types not read: {', '.join(held)})"
            if held and "agents" not in part.settings.topics
            else ""
        )
        notes.append(f"No other road users: the log has no topic of objects{more}.")
        return Tracks.empty(), None, ()
    topic = topics[0]
    if len(topics) > 1:
        notes.append(
            f"The others are those of {topic.name}, not of "
            f"{', '.join(topic.name for topic in topics[1:])}:"
            " tracked before predicted before detected, then most messages."
        )
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


UNSEEN_S = 2.0
"""A light is OFF (unknown) when it was not reported for this time, s."""
CREEPS_MPS = 0.1
PLAN_POINT = (
    "time_from_start.sec",
    "time_from_start.nanosec",
    *(f"pose.{name}" for name in POSITION),
    "longitudinal_velocity_mps",
    "acceleration_mps2",
)
"""The fields of a point of an on-board plan."""
LATE_GOAL_S = 1.0


def lights(part: BagPart, ego: EgoLog, t0: int) -> tuple[TrafficLight, ...]:
    """Read the traffic lights, with the ids of the log."""
    topics, notes = part.topics(schemas.LIGHTS, "lights"), part.notes
    if not topics:
        return ()
    topic = topics[0]
    schema = schemas.LIGHTS[topic.kind]
    stamp = STAMP if part.bag.has(topic, "header.stamp") else ("stamp.sec", "stamp.nanosec")
    lamp = ("lamps", (schema.lamps, (schema.colour,))) if schema.lamps else ("word", schema.words)
    fields = (*schema.ids, *((lamp[1],) if schema.lamps else (schema.colour, schema.words)))
    log, stamps, rows = part.read(topic, ((schema.items, fields),), stamp)
    t, keep = times_of(topic.name, log, stamps, ego.clock, notes)
    notes += describe_timing(topic.name, log, stamps, int(log[0])) if len(log) else []
    items = [rows[k][0] for k in keep]
    in_message = [row for message in items for row in message]
    place = next((i for i in range(len(schema.ids)) if any(row[i] for row in in_message)), 0)
    shown: dict[int, list[tuple[int, Colour]]] = {}
    seen: dict[int, int] = {}
    for time, message in zip(t.tolist(), items, strict=True):
        for light in [light for light, last in seen.items() if time - last > 1e9 * UNSEEN_S]:
            shown[light].append((seen.pop(light) + round(1e9 * UNSEEN_S), Colour.OFF))
        for light, colour in {row[place]: _colour(row, schema) for row in message}.items():
            seen[light] = time
            states = shown.setdefault(light, [])
            if not states or states[-1][1] is not colour:
                states.append((time, colour))
    traffic_lights = []
    for light, states in sorted(shown.items()):
        by_time = dict(sorted(states, key=lambda state: state[0]))
        t = np.array(list(by_time), dtype=np.int64)
        traffic_lights.append(TrafficLight(int(light), (t - t0) / 1e9, tuple(by_time.values())))
    if traffic_lights:
        notes.append(
            f"{len(traffic_lights)} traffic lights of {topic.name} are named by its "
            f"{schema.ids[place]}; which lane obeys which"
            " the log does not say: without a map that names them no stop line belongs to them."
        )
    return tuple(traffic_lights)


def _colour(item: tuple[object, ...], schema: schemas.LightSchema) -> Colour:
    if schema.lamps:
        lamps = item[-1]
        assert isinstance(lamps, list)
        lit = {schemas.LAMPS.get(lamp[0], Colour.OFF) for lamp in lamps} - {Colour.OFF}
        if {Colour.RED, Colour.YELLOW} <= lit:
            return Colour.RED_YELLOW
        return next(
            (colour for colour in (Colour.RED, Colour.YELLOW, Colour.GREEN) if colour in lit),
            Colour.OFF,
        )
    code, word = item[-2:]
    text = str(word).upper()
    if text.startswith(("RED/", "RED_")):
        return Colour.RED_YELLOW
    if text.startswith(("AMBER", "YELLOW")):
        return Colour.YELLOW
    return schemas.RESULTS.get(code, Colour.OFF) if isinstance(code, int) else Colour.OFF


def goal(
    part: BagPart, ego: EgoLog, begin_ns: int, origin: FloatArray, vehicle: VehicleParameters
) -> Goal | None:
    """The place around the log's goal pose: the newest at the begin (ns, log time), else the first
    one.
    """
    topics, notes = part.topics(schemas.GOALS, "goal"), part.notes
    if "goal" not in part.settings.topics:
        topics = [
            topic for topic in topics if topic.kind not in schemas.POSES or "goal" in topic.name
        ]
    if not topics:
        return None
    topic = topics[0]
    path = schemas.GOALS[topic.kind]
    fields = (*STAMP, "header.frame_id", *(f"{path}.{name}" for name in POSITION))
    log, rows = part.bag.read(topic, fields, *((part.begin, part.end) if part.is_drive else ()))
    good = [k for k, row in enumerate(rows) if np.isfinite(row[3:]).all()]
    if not good:
        return None
    known = [k for k in good if log[k] <= begin_ns]
    k = known[-1] if known else good[0]
    sec, nsec, frame, *logged = rows[k]
    p, q = np.hsplit(np.array([logged], dtype=np.float64), [3])
    pose = ego.in_map(Poses(ego.clock(log[k : k + 1]), p, unit_or_identity(q)), frame)
    x, y = pose.p[0, :2] - origin
    yaw, ahead = float(pose.yaw[0]), vehicle.axle_to_center
    others = f"; its {len(good) - 1} other goals are not used" if len(good) > 1 else ""
    notes.append(
        f"The goal is {GOAL_LENGTH_M:g} m by {GOAL_WIDTH_M:g} m around the pose of "
        f"{topic.name}{others}."
    )
    late = (sec * 1_000_000_000 + nsec - log[k]) / 1e9
    if sec and late > LATE_GOAL_S:
        notes.append(
            f"The goal's stamp is {late:.1f} s after its record: it was set when it was known "
            "where the drive led."
        )
    return Goal.around(x + ahead * cos(yaw), y + ahead * sin(yaw), yaw)


def controls(part: BagPart, ego: EgoLog, t0: int) -> Controls | None:
    """Read the front wheel angle: the measured one, else the commanded one."""
    angle = signal(part, schemas.STEERING, "steering", ego)
    word = "measured"
    if angle is None and "steering" not in part.settings.topics:
        angle = signal(part, schemas.COMMANDED_STEERING, "steering", ego)
        word = "commanded"
    if angle is None:
        return None
    part.notes.append(f"The front wheel angle is that of {angle.topic}, {word}.")
    nan = np.full(len(angle.t), np.nan)
    return Controls((angle.t - t0) / 1e9, angle.values, nan, nan)


def onboard(part: BagPart, ego: EgoLog, t0: int, origin: FloatArray) -> tuple[OnboardPlan, ...]:
    """Read the on-board plans, each known from the time of its message on."""
    topics, notes = part.topics(schemas.PLANS, "plan"), part.notes
    if not topics:
        return ()
    usual = [
        t
        for t in topics
        if t.name.endswith(("/scenario_planning/trajectory", "/planning/trajectory"))
    ]
    topic = usual[0] if usual and "plan" not in part.settings.topics else topics[0]
    log, stamps, rows = part.read(topic, ("header.frame_id", ("points", PLAN_POINT)))
    t, keep = times_of(topic.name, log, stamps, ego.clock, notes)
    known = np.maximum(ego.clock(log[keep]), t) if len(keep) else t
    plans: dict[int, OnboardPlan] = {}
    for time, when, k in zip(t.tolist(), known.tolist(), keep.tolist(), strict=True):
        planned = _plan(rows[k], time, t0, ego, origin)
        if planned is not None:
            plans[when] = OnboardPlan((when - t0) / 1e9, planned)
    notes += describe_timing(topic.name, log, stamps, int(log[0])) if len(log) else []
    if rows:
        several = f" (of {len(topics)} such topics)" if len(topics) > 1 else ""
        timed = (
            "by their speeds" if not any(p[0] or p[1] for p in rows[0][1]) else "by their own times"
        )
        notes.append(
            f"{len(plans)} on-board plans are those of {topic.name}{several}, timed {timed}."
        )
    return tuple(plans[when] for when in sorted(plans))


def _plan(
    row: tuple[object, ...], time: int, t0: int, ego: EgoLog, origin: FloatArray
) -> Trajectory | None:
    frame, points = row
    assert isinstance(points, list)
    values = np.array(points, dtype=np.float64).reshape(-1, len(PLAN_POINT))
    values = values[np.isfinite(values).all(axis=1)]
    if not len(values):
        return None
    after, p, q, motion = np.hsplit(values, [2, 5, 9])  # as in `PLAN_POINT`
    pose = ego.in_map(Poses(np.full(len(values), time), p, unit_or_identity(q)), str(frame))
    x, y = (pose.p[:, :2] - origin).T
    yaw, (v, a) = np.unwrap(pose.yaw), motion.T
    t: FloatArray = np.asarray(after[:, 0] + 1e-9 * after[:, 1])
    if not t.any():
        # (1); NaN from where the plan stands, but for the point at which it comes to its stand
        t = np.zeros(len(x))
        if len(x) > 1:
            mean, distance = 0.5 * np.abs(v[:-1] + v[1:]), np.hypot(np.diff(x), np.diff(y))
            step = np.divide(
                distance, mean, out=np.full(len(distance), np.nan), where=mean >= 0.5 * CREEPS_MPS
            )
            step[step <= 0.0] = np.nan
            t = np.r_[0.0, np.cumsum(step)]
        now = ego.frames.poses(ego.map, ego.base, np.array([time]), HELD).p[0, :2] - origin
        nearest = int(np.argmin(np.hypot(x - now[0], y - now[1])))
        t = t - t[nearest]
        keep = (np.arange(len(t)) >= nearest) & np.isfinite(t)
    else:
        keep = np.r_[True, np.diff(np.maximum.accumulate(t)) > 0.0]
    if not keep.any():
        return None
    t, x, y, yaw, v, a = (np.asarray(column[keep]) for column in (t, x, y, yaw, v, a))
    if not a.any() and len(t) > 1:
        a = derived_acceleration(t, v)
    return Trajectory(t + (time - t0) / 1e9, x, y, yaw, v, a, derived_curvature(x, y, yaw, v))
