"""ASAM OSI ground truth -> Scenario; its frames and lanes: osi_frames.py, osi_lanes.py.

The ego is the moving object of `host_vehicle_id`. OSI poses are centres of boxes: the ego's is
moved to its rear axle by `bbcenter_to_rear`, else by the proportions of the default vehicle. With d
from rear axle to centre and w the yaw rate, the rear axle's speed and acceleration along the
heading h are

(1) v = v_center . h            (2) a = a_center . h + w^2 d            w = kappa v

Static obstacles are the stationary objects in the way; those above the road or flat on it are left
out. The origin is the ego's first position in whole metres.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import LogError, reading
from replan.logs.agents import USUAL_SIZE_M, AgentKind, ObjectClass
from replan.logs.complete import completed, derived_curvature, derived_speed, road_along, with_limit
from replan.logs.heights import on_the_way
from replan.logs.kind_words import kind_of_word, object_classes
from replan.logs.mcap.container import COPY_AGAIN, Stream
from replan.logs.mcap.osi_frames import (
    AX,
    FRAME,
    YAW,
    OsiFrames,
    X,
    Y,
    Z,
    enum_name,
    ground_truth_of,
)
from replan.logs.mcap.osi_lanes import lanes_of
from replan.logs.observed import of_stream
from replan.logs.road import Road
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters, assumed_car

VEHICLES = {"TYPE_DELIVERY_VAN": AgentKind.TRUCK, "TYPE_STANDUP_SCOOTER": AgentKind.BICYCLE}
"""Vehicles whose word means another kind in OSI than elsewhere; others are those of
`replan.logs.kind_words`.
"""
MOST_NAMED = 20  # Greatest number of objects that an error message lists
POSITION = slice(X, YAW)
NOT_IN_THE_WAY = {"TYPE_BRIDGE", "TYPE_OVERHEAD_STRUCTURE", "TYPE_SPEED_BUMP", "TYPE_CURBSTONE"}


def scenario_of(stream: Stream, name: str, ego_id: str = "") -> Scenario:
    """The scenario in the messages of one topic; the ego is `ego_id`, or the log's host if that is
    "".

    Raises:
        LogError: A message cannot be decoded, the ego is missing, a pose is not finite, or time
            does not increase.
    """
    notes: list[str] = []
    truth = ground_truth_of(stream)
    host = _host(truth, stream, ego_id)
    if ego_id:
        notes.append(f"The ego is object {ego_id}, as asked.")
    samples = {key: np.array(rows) for key, rows in truth.samples.items()}
    for key, rows in samples.items():
        _check_poses(key, rows, stream)
    origin = np.round(samples[host][0, POSITION])
    for rows in samples.values():
        rows[:, POSITION] -= origin
    t = (np.array(truth.times, dtype=np.int64) - truth.times[0]) / 1e9
    with reading(topic=stream.topic):
        vehicle, rear = _vehicle(truth.moving[host], notes)
        ego = _ego(samples[host], t, rear, notes)
        tracks = _tracks(truth, host, samples, t, origin, notes)
        lanes, drives_on_right = lanes_of(truth.road, origin, notes)
        if lanes:
            road = Road(lanes, drives_on_right=drives_on_right)
            road = with_limit(road, ego, "The lanes have no speed limits", notes)
        else:
            road = road_along(ego, notes)
        if truth.lights:
            notes.append(f"The log's traffic lights (up to {truth.lights} at a time) are not read.")
        return Scenario(
            name=name,
            ego=ego,
            tracks=tracks,
            object_classes=_classes_of(truth),
            road=road,
            duration=float(t[-1]),
            vehicle=vehicle,
            tags=("osi",),
            source=f"ASAM OSI, {stream.schema}",
            origin=(float(origin[0]), float(origin[1])),
            start_ns=truth.times[0],
            metadata={"host_vehicle_id": str(host)},
            notes=tuple(notes),
            traffic=of_stream(t),
        )


def _host(truth: OsiFrames, stream: Stream, ego_id: str) -> int:
    """The id of the ego; LogError if there is none."""
    host = truth.host
    if ego_id:
        host = next((key for key in truth.samples if str(key) == ego_id), None)
    if host is not None and host in truth.samples:
        return host
    problem = f"host vehicle {host} is not among the objects"
    if ego_id:
        problem = f"no moving object {ego_id}"
    elif host is None:
        problem = "no host_vehicle_id"
    held = ", ".join(map(str, list(truth.samples)[:MOST_NAMED])) or "none"
    remedy = f"name one of the moving objects ({held}) with --ego"
    raise LogError(f"the log has no ego: {problem}", topic=stream.topic, remedy=remedy)


def _check_poses(key: int, rows: FloatArray, stream: Stream) -> None:
    """LogError if a pose of a moving object is not finite."""
    names = {X: "x", Y: "y", YAW: "yaw"}
    bad = np.argwhere(~np.isfinite(rows[:, list(names)]))
    for k, column in bad.tolist():
        name = list(names)[column]
        raise LogError(
            f"{names[name]} of moving object {key} is {rows[k, name]}",
            topic=stream.topic,
            time_ns=stream.times[int(rows[k, FRAME])],
            remedy=COPY_AGAIN,
        )


def _vehicle(host: Any, notes: list[str]) -> tuple[VehicleParameters, FloatArray]:
    """The ego's parameters, and the vector from its centre to its rear axle, m."""
    default, size, known = VehicleParameters(), host.base.dimension, host.vehicle_attributes
    length, width = _size_of(size) or (default.length, default.width)
    sizes = {"length": length, "width": width}
    if known.HasField("bbcenter_to_rear") and -length / 2.0 < known.bbcenter_to_rear.x < 0.0:
        rear = known.bbcenter_to_rear
        overhang, wheelbase = length / 2.0 + rear.x, length / default.length * default.wheelbase
        if known.HasField("bbcenter_to_front"):
            wheelbase = known.bbcenter_to_front.x - rear.x
        sizes |= {"rear_overhang": overhang, "wheelbase": min(wheelbase, length - overhang)}
        return assumed_car(sizes, notes), np.array([rear.x, rear.y])
    notes.append(
        "The log does not say where the ego's rear axle is: it is placed as in the default car."
    )
    vehicle = assumed_car(sizes, notes)
    return vehicle, np.array([-vehicle.axle_to_center, 0.0])


def _ego(rows: FloatArray, t: FloatArray, rear: FloatArray, notes: list[str]) -> Trajectory:
    """The states (1), (2) of the ego, from its samples and the vector to its rear axle, m."""
    frames, x, y, yaw, vx, vy, ax, ay, _ = rows.T
    t, yaw = t[frames.astype(np.int64)], np.unwrap(yaw)
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = x + rear[0] * cos - rear[1] * sin, y + rear[0] * sin + rear[1] * cos
    v: FloatArray = vx * cos + vy * sin
    if not np.isfinite(v).all():
        v = derived_speed(t, x, y, yaw, notes)
    kappa, unknown = derived_curvature(x, y, yaw, v), np.full(len(t), np.nan)
    a = ax * cos + ay * sin - (kappa * v) ** 2 * rear[0]
    if not ax.any() and not ay.any():
        a = unknown  # an acceleration that is always exactly 0 is not recorded
    columns = {"t": t, "x": x, "y": y, "yaw": yaw, "v": v, "a": a, "kappa": unknown}
    return completed(columns, notes)


def _tracks(
    truth: OsiFrames,
    host: int,
    samples: dict[int, FloatArray],
    t: FloatArray,
    origin: FloatArray,
    notes: list[str],
) -> Tracks:
    """The other objects on the level of the host."""
    standing = {
        key: item
        for key, item in truth.standing.items()
        if key not in samples and enum_name(item.classification, "type") not in NOT_IN_THE_WAY
    }
    if len(standing) < len(truth.standing):
        left_out = len(truth.standing) - len(standing)
        notes.append(
            f"{left_out} of {len(truth.standing)} stationary objects are not in the way (bridges, "
            "kerbs, ...)."
        )
    others = {key: rows for key, rows in samples.items() if key != host}
    for key, item in standing.items():
        place, yaw = item.base.position, item.base.orientation.yaw
        pose = place.x - origin[0], place.y - origin[1], yaw
        others[key] = np.array([(0.0, *pose, 0.0, 0.0, 0.0, 0.0, place.z)])
    messages = {key: standing[key] if key in standing else truth.moving[key] for key in others}
    half = 0.5 * truth.moving[host].base.dimension.height
    places = samples[host][:, [X, Y, Z]] - [0.0, 0.0, half]
    others = _on_level(messages, others, places, notes)
    if not others:
        return Tracks.empty()
    kinds = [AgentKind.OBJECT if key in standing else _kind_of(messages[key]) for key in others]
    sizes = [
        _size_of(messages[key].base.dimension) or USUAL_SIZE_M[kind]
        for key, kind in zip(others, kinds, strict=True)
    ]
    length, width = np.array(sizes).T
    frames, *columns = np.vstack(list(others.values())).T[:AX]
    return Tracks(
        tuple(map(str, others)),
        tuple(kinds),
        length,
        width,
        np.array([key in standing for key in others]),
        np.r_[0, np.cumsum([len(rows) for rows in others.values()])],
        t[frames.astype(np.int64)],
        *columns,
    )


def _classes_of(truth: OsiFrames) -> dict[str, ObjectClass]:
    """The classes of the stationary objects, by id."""
    ids = list(map(str, truth.standing))
    words = [enum_name(item.classification, "type") for item in truth.standing.values()]
    return object_classes(ids, [AgentKind.OBJECT] * len(ids), words)


def _kind_of(message: Any) -> AgentKind:
    """The kind of a moving object."""
    group = enum_name(message, "type")
    if group == "TYPE_VEHICLE":
        word = enum_name(message.vehicle_classification, "type")
        return VEHICLES.get(word) or kind_of_word(word) or AgentKind.CAR
    return AgentKind.PEDESTRIAN if group == "TYPE_PEDESTRIAN" else AgentKind.OBJECT


def _size_of(box: Any) -> tuple[float, float] | None:
    """Length and width, m; None if they are not set."""
    return (box.length, box.width) if min(box.length, box.width) > 0.0 else None


def _on_level(
    messages: dict[int, Any], others: dict[int, FloatArray], places: FloatArray, notes: list[str]
) -> dict[int, FloatArray]:
    """Leave out objects above or below the host's `places` `(n, 3)`, with a note
    (`replan.logs.heights`).
    """
    if not others:
        return others
    counts = [len(rows) for rows in others.values()]
    heights = [messages[key].base.dimension.height for key in others]
    columns = np.vstack(list(others.values()))
    names = np.repeat([str(key) for key in others], counts)
    keep = on_the_way(
        places,
        columns[:, [X, Y, Z]],
        columns[:, YAW],
        np.repeat(heights, counts),
        names.tolist(),
        notes,
    )
    stay = set(names[keep].tolist())
    return {key: rows for key, rows in others.items() if str(key) in stay}
