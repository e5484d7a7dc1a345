"""Reads a bag, or a part of it, as a scenario."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.errors import LogError
from replan.logs.complete import road_along
from replan.logs.log_settings import LogSettings
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.bag import Bag, opened
from replan.logs.readers.ros.bag_driving import read_driving
from replan.logs.readers.ros.bag_goal import read_goal
from replan.logs.readers.ros.bag_lights import read_lights
from replan.logs.readers.ros.bag_tracks import read_tracks
from replan.logs.readers.ros.ego import EgoLog
from replan.logs.readers.ros.ego_motion import Signal, begin_of, logged_motion, signal, states
from replan.logs.readers.ros.onboard_plans import read_onboard_plans
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.part_to_read import Start, part_to_read
from replan.logs.scenario import Scenario
from replan.logs.states import Controls, Trajectory
from replan.logs.vehicle import VEHICLE_ASSUMED, VehicleParameters

ROLES = {
    "topics": (
        "ego",
        "speed",
        "acceleration",
        "agents",
        "lights",
        "goal",
        "steering",
        "plan",
        "alternatives",
        "driver",
        "pedals",
    ),
    "frames": ("map", "base"),
}
"""Valid keys of the settings `topics` and `frames`."""


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


def _scenario(path: Path, bag: Bag, settings: LogSettings) -> Scenario:
    if not any(topic.count for topic in bag.topics):
        problem = ": ".join(["the bag holds no messages", *bag.notes]).rstrip(".")
        raise LogError(problem, remedy="record or copy it again")
    about_car = list(bag.notes)
    vehicle = settings.vehicle(about_car)
    if vehicle is None:
        vehicle = VehicleParameters()
        about_car.append(f"{VEHICLE_ASSUMED} (set log.car).")
    part, ego, start = part_to_read(bag, settings)
    notes = part.notes
    v, a = logged_motion(part, ego)
    columns = states(ego, v, a, notes)
    first = 0
    if start is None:
        first = begin_of(ego, v)
        start = _start_at(part, ego, first)
    t0, origin = start
    if first:
        since = (ego.poses.t[first] - ego.poses.t[0]) / 1e9
        notes.append(f"The first {since:.2f} s, {first} poses, only serve to derive the speed.")
    trajectory = Trajectory(
        t=(ego.poses.t[first:] - t0) / 1e9,
        x=columns["x"][first:] - origin[0],
        y=columns["y"][first:] - origin[1],
        **{name: columns[name][first:] for name in ("yaw", "v", "a", "kappa")},
    )
    tracks, detections, traffic = read_tracks(part, ego, t0, origin)
    synthetic = any(topic.kind == schemas.CLOCK and topic.count for topic in bag.topics)
    if synthetic:
        notes.append("The bag has a /clock: its drive is taken for a simulated one.")
    road = road_along(trajectory, notes)
    begin_ns = bag.start_ns + round(1e9 * settings.begin) if settings.begin > 0.0 else bag.start_ns
    goal = read_goal(part, ego, begin_ns, origin, vehicle)
    controls = _controls(part, ego, t0)
    lights = read_lights(part, ego, t0)
    onboard = read_onboard_plans(part, ego, t0, origin)
    driving = read_driving(part, ego, t0)
    return Scenario(
        name=path.stem if path.is_file() else path.name,
        ego=trajectory,
        tracks=tracks,
        road=road,
        duration=float(trajectory.t[-1]),
        goal=goal,
        vehicle=vehicle,
        controls=controls,
        tags=("synthetic" if synthetic else "recorded", "ros"),
        source="ROS 2 bag" if bag.is_ros2 else "ROS 1 bag",
        origin=(float(origin[0]), float(origin[1])),
        start_ns=t0,
        notes=tuple(dict.fromkeys([*about_car, *notes])),
        lights=lights,
        onboard=onboard,
        driving=driving,
        traffic=traffic,
        detections=detections,
    )


def _start_at(part: BagPart, ego: EgoLog, first: int) -> Start:
    """The start at the first pose that becomes a state; of one of several drives at the settings'
    begin, if that is later.
    """
    t0_ns = int(ego.poses.t[first])
    if part.is_drive:
        begin_ns = round(1e9 * part.settings.begin)
        asked = np.array([part.bag.start_ns + begin_ns])
        t0_ns = max(t0_ns, int(ego.clock(asked)[0])) - begin_ns
    return Start(t0_ns, np.round(ego.poses.p[first, :2]))


def _controls(part: BagPart, ego: EgoLog, t0: int) -> Controls | None:
    """Read the front wheel angle, the measured one, else the commanded one, and the pedals."""
    angle = signal(part, schemas.STEERING, "steering", ego)
    word = "measured"
    if angle is None and "steering" not in part.settings.topics:
        angle = signal(part, schemas.COMMANDED_STEERING, "steering", ego)
        word = "commanded"
    pedals = [
        signal(part, {kind: names[n] for kind, names in schemas.PEDALS.items()}, "pedals", ego)
        for n in range(2)
    ]
    first = next((source for source in (angle, *pedals) if source is not None), None)
    if first is None:
        return None
    if angle is not None:
        part.notes.append(f"The front wheel angle is that of {angle.topic}, {word}.")
    if pedals[0] is not None:
        part.notes.append(f"The pedals are those of {pedals[0].topic}.")
    columns = (_held(source, first.t) for source in (angle, *pedals))
    return Controls((first.t - t0) / 1e9, *columns)


def _held(source: Signal | None, t: IntArray) -> FloatArray:
    """The last value of a signal at times `(n,)`, ns; NaN before the first, and without one."""
    if source is None:
        return np.full(len(t), np.nan)
    last = np.searchsorted(source.t, t, side="right") - 1
    return np.where(last >= 0, source.values[np.maximum(last, 0)], np.nan)
