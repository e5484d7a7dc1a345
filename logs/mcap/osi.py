"""ASAM OSI ground truth -> Scenario, decoded with the descriptor that the file itself carries.

The ego is the moving object of `host_vehicle_id`. OSI poses are centres of boxes: the ego's is moved to its rear axle
by `bbcenter_to_rear`, else by the proportions of the default vehicle. With d from rear axle to centre and w the yaw
rate, the rear axle's speed and acceleration along the heading h are

(1) v = v_center . h            (2) a = a_center . h + w^2 d            w = kappa v

Static obstacles are the stationary objects that stand in the way: those above or flat on the road are left out. The
origin is the ego's first position in whole metres.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from logs.agents import USUAL_SIZE_M
from logs.errors import LogError
from logs.kernel import FloatArray
from logs.mcap.complete import ASSUMED, assumed_limit, completed, derived_curvature, road_along
from logs.mcap.container import COPY_AGAIN, Stream
from logs.mcap.osi_lanes import OsiMap, enum_name, lanes_of
from logs.observed import of_stream
from logs.road import Road
from logs.scenario import AgentKind, Scenario, Tracks
from logs.states import Trajectory
from logs.vehicle import VehicleParameters

SCHEMAS = ("osi3.GroundTruth", "osi3.SensorView")

KINDS = {
    "TYPE_HEAVY_TRUCK": AgentKind.TRUCK, "TYPE_SEMITRAILER": AgentKind.TRUCK, "TYPE_TRAILER": AgentKind.TRUCK,
    "TYPE_SEMITRACTOR": AgentKind.TRUCK, "TYPE_DELIVERY_VAN": AgentKind.TRUCK, "TYPE_BUS": AgentKind.BUS,
    "TYPE_TRAM": AgentKind.BUS, "TYPE_TRAIN": AgentKind.BUS, "TYPE_MOTORBIKE": AgentKind.MOTORCYCLE,
    "TYPE_BICYCLE": AgentKind.BICYCLE, "TYPE_STANDUP_SCOOTER": AgentKind.BICYCLE,
    "TYPE_WHEELCHAIR": AgentKind.PEDESTRIAN,
}  # fmt: skip
MOST_NAMED = 20
"""Objects that a message lists."""
NOT_IN_THE_WAY = {"TYPE_BRIDGE", "TYPE_OVERHEAD_STRUCTURE", "TYPE_SPEED_BUMP", "TYPE_CURBSTONE"}
REQUIRED = {
    "timestamp": ("seconds", "nanos"),
    "host_vehicle_id": ("value",),
    "moving_object": ("id.value", "type", "vehicle_classification.type"),
    "moving_object.vehicle_attributes": ("bbcenter_to_rear.x", "bbcenter_to_front.x"),
    "moving_object.base": ("dimension.length", "position.x", "orientation.yaw", "velocity.x", "acceleration.x"),
    "stationary_object": ("id.value", "classification.type"),
    "stationary_object.base": ("dimension.length", "position.x", "orientation.yaw"),
    "lane.id": ("value",),
    "lane.classification": (
        "type",
        "centerline.x",
        "centerline_is_driving_direction",
        "left_adjacent_lane_id.value",
        "right_adjacent_lane_id.value",
        "left_lane_boundary_id.value",
        "right_lane_boundary_id.value",
        "lane_pairing.antecessor_lane_id.value",
        "lane_pairing.successor_lane_id.value",
    ),
    "lane_boundary": ("id.value", "boundary_line.position.x", "classification.type"),
}
"""The fields that are read; logical lanes may be absent."""


@dataclass
class _Seen:
    """All frames, by object: messages as first seen, and rows (frame, x, y, yaw, vx, vy, ax, ay)."""

    times: list[int] = field(default_factory=list)
    host: int | None = None
    moving: dict[int, Any] = field(default_factory=dict)
    standing: dict[int, Any] = field(default_factory=dict)
    rows: dict[int, list[tuple[float, ...]]] = field(default_factory=dict)
    road: OsiMap = field(default_factory=OsiMap)
    lights: int = 0


def scenario_of(stream: Stream, name: str, ego_id: str = "") -> Scenario:
    """The scenario in the messages of one topic; the ego is `ego_id`, "": the host that the log names.

    Raises:
        LogError: A message cannot be decoded, no ego is named, a pose is not finite, time does not increase.
    """
    notes: list[str] = []
    seen = _decoded(stream)
    if ego_id:
        seen.host = next((key for key in seen.rows if str(key) == ego_id), None)
    if seen.host is None or seen.host not in seen.rows:
        what = "no host_vehicle_id" if seen.host is None else f"host vehicle {seen.host} is not among the objects"
        what = f"no moving object {ego_id}" if ego_id else what
        held = ", ".join(map(str, list(seen.rows)[:MOST_NAMED])) or "none"
        remedy = f"name one of the moving objects ({held}) with --ego"
        raise LogError(f"the log has no ego: {what}", topic=stream.topic, remedy=remedy)
    if ego_id:
        notes.append(f"The ego is object {ego_id}, as asked.")
    rows = {key: np.array(seen.rows[key]) for key in seen.rows}
    for key, values in rows.items():
        for k, column in np.argwhere(~np.isfinite(values[:, 1:4])).tolist():
            what = f"{('x', 'y', 'yaw')[column]} of moving object {key} is {values[k, 1 + column]}"
            raise LogError(what, topic=stream.topic, time_ns=stream.times[int(values[k, 0])], remedy=COPY_AGAIN)
    origin = np.round(rows[seen.host][0, 1:3])
    for values in rows.values():
        values[:, 1:3] -= origin
    t = (np.array(seen.times, dtype=np.int64) - seen.times[0]) / 1e9
    try:
        vehicle, rear = _vehicle(seen.moving[seen.host], notes)
        ego = _ego(rows[seen.host], t, rear, notes)
        tracks = _tracks(seen, rows, t, origin, notes)
        road = _road(seen, origin, ego, notes)
        if seen.lights:
            notes.append(f"The log's traffic lights (up to {seen.lights} at a time) are not read.")
        first = seen.moving[seen.host]
        return Scenario(
            name=name,
            ego=ego,
            tracks=tracks,
            road=road,
            duration=float(t[-1]),
            vehicle=vehicle,
            tags=("osi",),
            source=f"ASAM OSI, {stream.schema}",
            origin=(float(origin[0]), float(origin[1])),
            start_ns=seen.times[0],
            metadata={"host_vehicle_id": str(first.id.value)},
            notes=tuple(notes),
            traffic=of_stream(t),
        )
    except ValueError as error:
        raise LogError(str(error), topic=stream.topic) from None


def _message_class(stream: Stream) -> type[Any]:
    """The class of the messages, from the descriptor in the file."""
    if stream.encoding != "protobuf" or stream.schema_encoding != "protobuf":
        raise LogError(f"{stream.schema} is encoded as {stream.encoding!r}, expected protobuf", topic=stream.topic)
    pool = descriptor_pool.DescriptorPool()
    try:
        files = {f.name: f for f in descriptor_pb2.FileDescriptorSet.FromString(stream.schema_data).file}
        for name in list(files):
            _add_file(name, files, pool, set())
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(stream.schema))
    except (DecodeError, TypeError, KeyError, ValueError) as error:
        what = f"the protobuf descriptor in the file cannot be used: {error}"
        raise LogError(what, topic=stream.topic, remedy=COPY_AGAIN) from None
    for parent, names in REQUIRED.items():
        for name in names:
            _check_field(f"{parent}.{name}", kind.DESCRIPTOR, stream)
    return kind


def _check_field(path: str, descriptor: Any, stream: Stream) -> None:
    """Refuse a descriptor without a field that is read here."""
    for name in (*(("global_ground_truth",) if stream.schema == "osi3.SensorView" else ()), *path.split(".")):
        if descriptor is None or name not in descriptor.fields_by_name:
            what = f"the protobuf descriptor in the file has no field {path}"
            raise LogError(what, topic=stream.topic, remedy="write the log with OSI 3.5 or newer")
        descriptor = descriptor.fields_by_name[name].message_type


def _add_file(name: str, files: dict[str, Any], pool: Any, open_files: set[str]) -> None:
    """Add a file to the pool after the files that it imports."""
    if name in open_files or name not in files:
        return
    open_files.add(name)
    for imported in files[name].dependency:
        _add_file(imported, files, pool, open_files)
    pool.Add(files.pop(name))


def _decoded(stream: Stream) -> _Seen:
    kind, seen = _message_class(stream), _Seen()
    for log_time, payload in zip(stream.times, stream.payloads, strict=True):
        try:
            message = kind.FromString(payload)
        except DecodeError as error:
            what = f"message cannot be decoded: {error}"
            raise LogError(what, topic=stream.topic, time_ns=log_time, remedy=COPY_AGAIN) from None
        truth = message.global_ground_truth if stream.schema == "osi3.SensorView" else message
        stamp = truth.timestamp
        time = stamp.seconds * 1_000_000_000 + stamp.nanos if truth.HasField("timestamp") else log_time
        if seen.times and time <= seen.times[-1]:
            what = f"time does not increase, from {seen.times[-1] / 1e9:.3f} s to {time / 1e9:.3f} s"
            remedy = "write each frame once, in order of time"
            raise LogError(what, topic=stream.topic, time_ns=log_time, remedy=remedy)
        if seen.host is None and truth.HasField("host_vehicle_id"):
            seen.host = truth.host_vehicle_id.value
        for item in truth.moving_object:
            base, key, missing = item.base, item.id.value, (np.nan, np.nan)
            v, a, p = base.velocity, base.acceleration, base.position
            velocity = (v.x, v.y) if base.HasField("velocity") else missing
            acceleration = (a.x, a.y) if base.HasField("acceleration") else missing
            row = (len(seen.times), p.x, p.y, base.orientation.yaw, *velocity, *acceleration)
            seen.moving.setdefault(key, item)
            seen.rows.setdefault(key, []).append(row)
        for item in truth.stationary_object:
            seen.standing.setdefault(item.id.value, item)
        seen.lights = max(seen.lights, len(getattr(truth, "traffic_light", ())))
        seen.road.add(truth)
        seen.times.append(time)
    return seen


def _vehicle(host: Any, notes: list[str]) -> tuple[VehicleParameters, FloatArray]:
    """The ego's parameters, and the vector from its centre to its rear axle, m."""
    default, size = VehicleParameters(), host.base.dimension
    length, width = (size.length, size.width) if min(size.length, size.width) > 0.0 else (default.length, default.width)
    scale = length / default.length
    wheelbase, overhang = scale * default.wheelbase, scale * default.rear_overhang
    rear = np.array([overhang - length / 2.0, 0.0])
    known = host.vehicle_attributes
    if known.HasField("bbcenter_to_rear") and -length / 2.0 < known.bbcenter_to_rear.x < 0.0:
        rear = np.array([known.bbcenter_to_rear.x, known.bbcenter_to_rear.y])
        overhang = length / 2.0 + rear[0]
        if known.HasField("bbcenter_to_front"):
            wheelbase = known.bbcenter_to_front.x - rear[0]
        wheelbase = min(wheelbase, length - overhang)
    else:
        notes.append("The log does not say where the ego's rear axle is: it is placed as in the default car.")
    notes.append("Masses, tyres and limits of the ego's vehicle are those of the default car.")
    cog = default.cog_to_front * wheelbase / default.wheelbase
    sizes: dict[str, Any] = {"length": length, "width": width, "wheelbase": wheelbase, "rear_overhang": overhang}
    return replace(default, **sizes, cog_to_front=cog), rear


def _ego(rows: FloatArray, t: FloatArray, rear: FloatArray, notes: list[str]) -> Trajectory:
    """The rear axle's states by (1) and (2)."""
    yaw = np.unwrap(rows[:, 3])
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = rows[:, 1] + rear[0] * cos - rear[1] * sin, rows[:, 2] + rear[0] * sin + rear[1] * cos
    t = t[rows[:, 0].astype(np.int64)]
    v = rows[:, 4] * cos + rows[:, 5] * sin
    if not np.isfinite(v).all():
        notes.append("The log has no ego speed: it is derived from the positions by backward differences.")
        step = (np.diff(x) * cos[1:] + np.diff(y) * sin[1:]) / np.diff(t)
        v = np.r_[step[0], step] if len(step) else np.zeros(1)
    kappa = derived_curvature(x, y, yaw, v)
    a = rows[:, 6] * cos + rows[:, 7] * sin - (kappa * v) ** 2 * rear[0]
    if not rows[:, 6:8].any():
        a = np.full(len(t), np.nan)  # a log whose acceleration is always exactly 0 has none
    columns = {"t": t, "x": x, "y": y, "yaw": yaw, "v": v, "a": a, "kappa": np.full(len(t), np.nan)}
    return completed(columns, notes)


def _kind(item: Any) -> AgentKind:
    group = enum_name(item, "type")
    if group == "TYPE_PEDESTRIAN":
        return AgentKind.PEDESTRIAN
    if group == "TYPE_VEHICLE":
        return KINDS.get(enum_name(item.vehicle_classification, "type"), AgentKind.CAR)
    return AgentKind.OBJECT


def _tracks(seen: _Seen, rows: dict[int, FloatArray], t: FloatArray, origin: FloatArray, notes: list[str]) -> Tracks:
    standing = {
        key: item
        for key, item in seen.standing.items()
        if key not in rows and enum_name(item.classification, "type") not in NOT_IN_THE_WAY
    }
    if len(standing) < len(seen.standing):
        left_out = len(seen.standing) - len(standing)
        notes.append(f"{left_out} of {len(seen.standing)} stationary objects are not in the way (bridges, kerbs, ...).")
    others = {key: values for key, values in rows.items() if key != seen.host}
    for key, item in standing.items():
        place, yaw = item.base.position, item.base.orientation.yaw
        others[key] = np.array([(0.0, place.x - origin[0], place.y - origin[1], yaw, 0.0, 0.0)])
    if not others:
        return Tracks.empty()
    kinds = [AgentKind.OBJECT if key in standing else _kind(seen.moving[key]) for key in others]
    boxes = [(standing[key] if key in standing else seen.moving[key]).base.dimension for key in others]
    sizes = [
        (box.length, box.width) if min(box.length, box.width) > 0.0 else USUAL_SIZE_M[kind]
        for box, kind in zip(boxes, kinds, strict=True)
    ]
    offsets = np.r_[0, np.cumsum([len(values) for values in others.values()])]
    columns = np.vstack([values[:, :6] for values in others.values()])
    length, width = np.array(sizes).T
    static, times = np.array([key in standing for key in others]), t[columns[:, 0].astype(np.int64)]
    ids = tuple(map(str, others))
    return Tracks(ids, tuple(kinds), length, width, static, offsets, times, *columns[:, 1:].T)


def _road(seen: _Seen, origin: FloatArray, ego: Trajectory, notes: list[str]) -> Road:
    lanes, drives_on_right = lanes_of(seen.road, origin, notes)
    if not lanes:
        return road_along(ego, notes)
    limit = assumed_limit(ego)
    notes.append(f"The lanes have no speed limits: {limit:.1f} m/s is assumed ({ASSUMED}).")
    return Road(lanes, drives_on_right=drives_on_right, default_speed_limit=limit)
