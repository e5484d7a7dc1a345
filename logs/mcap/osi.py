"""ASAM OSI ground truth -> Scenario, decoded with the protobuf descriptor in the file.

The ego is the moving object of `host_vehicle_id`. OSI poses are centres of boxes: the ego's is
moved to its rear axle by `bbcenter_to_rear`, else by the proportions of the default vehicle. With d
from rear axle to centre and w the yaw rate, the rear axle's speed and acceleration along the
heading h are

(1) v = v_center . h            (2) a = a_center . h + w^2 d            w = kappa v

Static obstacles are the stationary objects in the way; those above the road or flat on it are left
out. The origin is the ego's first position in whole metres.

The road has the logical lanes if they have both boundaries, else the classic lanes: from their
boundaries, else from their centre line. A lane without boundaries reaches half-way to the listed
adjacent centre line 2 to 6 m beside it, else `HALF_WIDTH`. Listed adjacent and paired lanes are
candidates that the geometry must confirm: an adjacent lane lies beside the middle of this one, a
successor begins where this one ends (`MAX_GAP`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from operator import itemgetter
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, message_factory
from google.protobuf.message import DecodeError

from replan.core.arrays import FloatArray, arc_lengths, foot_on, station_on
from replan.core.errors import LogError, reading
from replan.logs.agents import USUAL_SIZE_M, AgentKind
from replan.logs.complete import completed, derived_curvature, derived_speed, road_along, with_limit
from replan.logs.heights import on_the_way
from replan.logs.kind_words import kind_of_word
from replan.logs.mcap.container import COPY_AGAIN, Stream
from replan.logs.observed import of_stream
from replan.logs.polylines import paired
from replan.logs.road import Lane, Road
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters, assumed_car

SCHEMAS = ("osi3.GroundTruth", "osi3.SensorView")

VEHICLES = {"TYPE_DELIVERY_VAN": AgentKind.TRUCK, "TYPE_STANDUP_SCOOTER": AgentKind.BICYCLE}
"""Vehicles whose word means another kind in OSI than elsewhere; others are those of
`replan.logs.kind_words`.
"""
MOST_NAMED = 20
"""Greatest number of objects that an error message lists."""
NOT_IN_THE_WAY = {"TYPE_BRIDGE", "TYPE_OVERHEAD_STRUCTURE", "TYPE_SPEED_BUMP", "TYPE_CURBSTONE"}
REQUIRED = {
    "timestamp": ("seconds", "nanos"),
    "host_vehicle_id": ("value",),
    "moving_object": ("id.value", "type", "vehicle_classification.type"),
    "moving_object.vehicle_attributes": ("bbcenter_to_rear.x", "bbcenter_to_front.x"),
    "moving_object.base": (
        "dimension.length",
        "position.x",
        "orientation.yaw",
        "velocity.x",
        "acceleration.x",
    ),
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
"""The fields that the reader needs; logical lanes may be absent."""
HALF_WIDTH = 1.75
MAX_GAP = 3.0
BESIDE = (2.0, 6.0)
NOT_DRIVEN = {"unknown", "other", "sidewalk", "biking", "border", "curb", "median", "parking"}
CROSSABLE = {"TYPE_UNKNOWN", "TYPE_OTHER", "TYPE_NO_LINE", "TYPE_DASHED_LINE", "TYPE_BOTTS_DOTS"}


@dataclass
class _OsiMap:
    """Messages by id, from all frames; the first message of an id is kept.

    Older descriptors lack the logical lanes.
    """

    lane: dict[int, Any] = field(default_factory=dict)
    lane_boundary: dict[int, Any] = field(default_factory=dict)
    logical_lane: dict[int, Any] = field(default_factory=dict)
    logical_lane_boundary: dict[int, Any] = field(default_factory=dict)


@dataclass
class _Seen:
    """All frames by object: first message, and rows (frame, x, y, yaw, vx, vy, ax, ay, z)."""

    times: list[int] = field(default_factory=list)
    host: int | None = None
    moving: dict[int, Any] = field(default_factory=dict)
    standing: dict[int, Any] = field(default_factory=dict)
    rows: dict[int, list[tuple[float, ...]]] = field(default_factory=dict)
    road: _OsiMap = field(default_factory=_OsiMap)
    lights: int = 0


def scenario_of(stream: Stream, name: str, ego_id: str = "") -> Scenario:
    """The scenario in the messages of one topic; the ego is `ego_id`, or the log's host if that is
    "".

    Raises:
        LogError: A message cannot be decoded, the ego is missing, a pose is not finite, or time
            does not increase.
    """
    notes: list[str] = []
    seen = _decode_stream(stream)
    if ego_id:
        seen.host = next((key for key in seen.rows if str(key) == ego_id), None)
    if seen.host is None or seen.host not in seen.rows:
        problem = (
            "no host_vehicle_id"
            if seen.host is None
            else f"host vehicle {seen.host} is not among the objects"
        )
        problem = f"no moving object {ego_id}" if ego_id else problem
        held = ", ".join(map(str, list(seen.rows)[:MOST_NAMED])) or "none"
        remedy = f"name one of the moving objects ({held}) with --ego"
        raise LogError(f"the log has no ego: {problem}", topic=stream.topic, remedy=remedy)
    if ego_id:
        notes.append(f"The ego is object {ego_id}, as asked.")
    rows = {key: np.array(seen.rows[key]) for key in seen.rows}
    for key, values in rows.items():
        for k, column in np.argwhere(~np.isfinite(values[:, 1:4])).tolist():
            problem = (
                f"{('x', 'y', 'yaw')[column]} of moving object {key} is {values[k, 1 + column]}"
            )
            raise LogError(
                problem,
                topic=stream.topic,
                time_ns=stream.times[int(values[k, 0])],
                remedy=COPY_AGAIN,
            )
    origin = np.round(rows[seen.host][0, 1:3])
    for values in rows.values():
        values[:, 1:3] -= origin
    t = (np.array(seen.times, dtype=np.int64) - seen.times[0]) / 1e9
    with reading(topic=stream.topic):
        vehicle, rear = _vehicle(seen.moving[seen.host], notes)
        ego = _ego(rows[seen.host], t, rear, notes)
        tracks = _tracks(seen, rows, t, origin, notes)
        lanes, adjacent = _logical(seen.road, origin)
        if not lanes:
            lanes, adjacent = _classic(seen.road, origin, notes)
            unused = len(seen.road.lane) - len(lanes)
            if lanes and unused:
                notes.append(
                    f"{unused} of {len(seen.road.lane)} lanes have no centre line and are left out."
                )
        lanes, drives_on_right = _beside_each_other(lanes, adjacent)
        if lanes:
            road = Road(lanes, drives_on_right=drives_on_right)
            road = with_limit(road, ego, "The lanes have no speed limits", notes)
        else:
            road = road_along(ego, notes)
        if seen.lights:
            notes.append(f"The log's traffic lights (up to {seen.lights} at a time) are not read.")
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
            metadata={"host_vehicle_id": str(seen.moving[seen.host].id.value)},
            notes=tuple(notes),
            traffic=of_stream(t),
        )


def _message_class(stream: Stream) -> type[Any]:
    if stream.encoding != "protobuf" or stream.schema_encoding != "protobuf":
        raise LogError(
            f"{stream.schema} is encoded as {stream.encoding!r}, expected protobuf",
            topic=stream.topic,
        )
    try:
        files = descriptor_pb2.FileDescriptorSet.FromString(stream.schema_data).file
        kind: type[Any] = message_factory.GetMessages(files)[stream.schema]
    except (DecodeError, TypeError, KeyError, ValueError) as error:
        problem = f"the protobuf descriptor in the file cannot be used: {error}"
        raise LogError(problem, topic=stream.topic, remedy=COPY_AGAIN) from None
    above = ("global_ground_truth",) if stream.schema == "osi3.SensorView" else ()
    for path in (f"{parent}.{name}" for parent, names in REQUIRED.items() for name in names):
        descriptor: Any = kind.DESCRIPTOR
        for name in (*above, *path.split(".")):
            if descriptor is None or name not in descriptor.fields_by_name:
                problem = f"the protobuf descriptor in the file has no field {path}"
                raise LogError(
                    problem, topic=stream.topic, remedy="write the log with OSI 3.5 or newer"
                )
            descriptor = descriptor.fields_by_name[name].message_type
    return kind


def _decode_stream(stream: Stream) -> _Seen:
    kind, seen = _message_class(stream), _Seen()
    for log_time, payload in zip(stream.times, stream.payloads, strict=True):
        try:
            message = kind.FromString(payload)
        except DecodeError as error:
            problem = f"message cannot be decoded: {error}"
            raise LogError(
                problem, topic=stream.topic, time_ns=log_time, remedy=COPY_AGAIN
            ) from None
        truth = message.global_ground_truth if stream.schema == "osi3.SensorView" else message
        stamp = truth.timestamp
        time = (
            stamp.seconds * 1_000_000_000 + stamp.nanos if truth.HasField("timestamp") else log_time
        )
        if seen.times and time <= seen.times[-1]:
            problem = (
                f"time does not increase, from {seen.times[-1] / 1e9:.3f} s to {time / 1e9:.3f} s"
            )
            remedy = "write each frame once, in order of time"
            raise LogError(problem, topic=stream.topic, time_ns=log_time, remedy=remedy)
        if seen.host is None and truth.HasField("host_vehicle_id"):
            seen.host = truth.host_vehicle_id.value
        for item in truth.moving_object:
            base, key, missing = item.base, item.id.value, (np.nan, np.nan)
            v, a, p = base.velocity, base.acceleration, base.position
            velocity = (v.x, v.y) if base.HasField("velocity") else missing
            acceleration = (a.x, a.y) if base.HasField("acceleration") else missing
            row = (len(seen.times), p.x, p.y, base.orientation.yaw, *velocity, *acceleration, p.z)
            seen.moving.setdefault(key, item)
            seen.rows.setdefault(key, []).append(row)
        for item in truth.stationary_object:
            seen.standing.setdefault(item.id.value, item)
        seen.lights = max(seen.lights, len(getattr(truth, "traffic_light", ())))
        for part in fields(_OsiMap):
            known = getattr(seen.road, part.name)
            for item in getattr(truth, part.name, ()):
                known.setdefault(item.id.value, item)
        seen.times.append(time)
    return seen


def _vehicle(host: Any, notes: list[str]) -> tuple[VehicleParameters, FloatArray]:
    """The ego's parameters, and the vector from its centre to its rear axle, m."""
    default, size, known = VehicleParameters(), host.base.dimension, host.vehicle_attributes
    length, width = (
        (size.length, size.width)
        if min(size.length, size.width) > 0.0
        else (default.length, default.width)
    )
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


# (1), (2)
def _ego(rows: FloatArray, t: FloatArray, rear: FloatArray, notes: list[str]) -> Trajectory:
    yaw = np.unwrap(rows[:, 3])
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = rows[:, 1] + rear[0] * cos - rear[1] * sin, rows[:, 2] + rear[0] * sin + rear[1] * cos
    t = t[rows[:, 0].astype(np.int64)]
    v: FloatArray = rows[:, 4] * cos + rows[:, 5] * sin
    if not np.isfinite(v).all():
        v = derived_speed(t, x, y, yaw, notes)
    kappa = derived_curvature(x, y, yaw, v)
    a = rows[:, 6] * cos + rows[:, 7] * sin - (kappa * v) ** 2 * rear[0]
    if not rows[:, 6:8].any():
        a = np.full(len(t), np.nan)  # an acceleration that is always exactly 0 is not recorded
    columns = {"t": t, "x": x, "y": y, "yaw": yaw, "v": v, "a": a, "kappa": np.full(len(t), np.nan)}
    return completed(columns, notes)


def _tracks(
    seen: _Seen, rows: dict[int, FloatArray], t: FloatArray, origin: FloatArray, notes: list[str]
) -> Tracks:
    standing = {
        key: item
        for key, item in seen.standing.items()
        if key not in rows and _enum_name(item.classification, "type") not in NOT_IN_THE_WAY
    }
    if len(standing) < len(seen.standing):
        left_out = len(seen.standing) - len(standing)
        notes.append(
            f"{left_out} of {len(seen.standing)} stationary objects are not in the way (bridges, "
            "kerbs, ...)."
        )
    others = {key: values for key, values in rows.items() if key != seen.host}
    for key, item in standing.items():
        place, yaw = item.base.position, item.base.orientation.yaw
        x, y = place.x - origin[0], place.y - origin[1]
        others[key] = np.array([(0.0, x, y, yaw, 0.0, 0.0, 0.0, 0.0, place.z)])
    if seen.host is not None:
        half = 0.5 * seen.moving[seen.host].base.dimension.height
        places = rows[seen.host][:, [1, 2, 8]] - [0.0, 0.0, half]
        others = _on_level(seen, others, places, notes)
    if not others:
        return Tracks.empty()
    kinds = []
    for key in others:
        group = "" if key in standing else _enum_name(seen.moving[key], "type")
        kind = AgentKind.PEDESTRIAN if group == "TYPE_PEDESTRIAN" else AgentKind.OBJECT
        if group == "TYPE_VEHICLE":
            word = _enum_name(seen.moving[key].vehicle_classification, "type")
            kind = VEHICLES.get(word) or kind_of_word(word) or AgentKind.CAR
        kinds.append(kind)
    boxes = [
        (standing[key] if key in standing else seen.moving[key]).base.dimension for key in others
    ]
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


def _on_level(
    seen: _Seen, others: dict[int, FloatArray], places: FloatArray, notes: list[str]
) -> dict[int, FloatArray]:
    """Leave out objects above or below the host's `places` `(n, 3)`, with a note
    (`replan.logs.heights`).
    """
    if not others:
        return others
    messages = {key: seen.standing.get(key) or seen.moving[key] for key in others}
    high = {key: message.base.dimension.height for key, message in messages.items()}
    counts = [len(values) for values in others.values()]
    columns = np.vstack(list(others.values()))
    names = np.repeat([str(key) for key in others], counts)
    keep = on_the_way(
        places,
        columns[:, [1, 2, 8]],
        columns[:, 3],
        np.repeat(list(high.values()), counts),
        names.tolist(),
        notes,
    )
    stay = set(names[keep].tolist())
    return {key: values for key, values in others.items() if str(key) in stay}


def _enum_name(message: Any, name: str) -> str:
    kind = message.DESCRIPTOR.fields_by_name[name].enum_type
    value = kind.values_by_number.get(getattr(message, name))
    return value.name if value is not None else ""


def _points(messages: Iterable[Any], origin: FloatArray) -> FloatArray:
    """The finite points `(n, 2)`, without repetitions."""
    points = np.array([(p.x, p.y) for p in messages], dtype=np.float64).reshape(-1, 2) - origin
    points = points[np.isfinite(points).all(axis=1)]
    return (
        points[np.r_[True, np.hypot(*np.diff(points, axis=0).T) > 1e-6]] if len(points) else points
    )


def _logical(osi: _OsiMap, origin: FloatArray) -> tuple[dict[int, Lane], dict[int, list[int]]]:
    """Lanes, and the ids that each lists as adjacent."""
    lanes, adjacent = {}, {}
    for key, message in osi.logical_lane.items():
        sides = []
        for ids in (message.left_boundary_id, message.right_boundary_id):
            boundaries = [
                osi.logical_lane_boundary[i.value]
                for i in ids
                if i.value in osi.logical_lane_boundary
            ]
            parts = [_points((p.position for p in b.boundary_line), origin) for b in boundaries]
            sides.append(np.vstack([np.empty((0, 2)), *parts]))
        if min(map(len, sides)) < 2:
            continue
        backward = _enum_name(message, "move_direction") == "MOVE_DIRECTION_DECREASING_S"
        if backward:
            sides = [sides[1][::-1], sides[0][::-1]]
        left, right = paired(*sides)
        onward = message.predecessor_lane if backward else message.successor_lane
        kind = _enum_name(message, "type").removeprefix("TYPE_").lower()
        successors = tuple(dict.fromkeys(lane.other_lane_id.value for lane in onward))
        lanes[key] = Lane(key, left, right, successors, drivable=kind not in NOT_DRIVEN, kind=kind)
        beside = (*message.left_adjacent_lane, *message.right_adjacent_lane)
        adjacent[key] = [other.other_lane_id.value for other in beside]
    return lanes, adjacent


def _classic(
    osi: _OsiMap, origin: FloatArray, notes: list[str]
) -> tuple[dict[int, Lane], dict[int, list[int]]]:
    """Lanes, and the ids that each lists as adjacent."""
    centers = {}
    for key, message in osi.lane.items():
        known = message.classification
        center = _points(known.centerline, origin)
        turned = (
            known.HasField("centerline_is_driving_direction")
            and not known.centerline_is_driving_direction
        )
        if len(center) > 1:  # a line without a stated direction is not reversed
            centers[key] = center[::-1] if turned else center
    lanes, assumed = {}, 0
    for key, center in centers.items():
        lane = _lane_between_boundaries(key, osi, center, origin)
        if lane is None:
            lane, assumed = _lane_around_center(key, osi, centers), assumed + 1
        lanes[key] = lane
    if assumed:
        notes.append(
            f"{assumed} of {len(lanes)} lanes have a centre line only: their edges are assumed "
            f"half-way to the lane beside them, else {HALF_WIDTH} m from the centre."
        )
    paired_with: dict[int, list[int]] = {}  # by any pairing, in both directions
    for key, message in osi.lane.items():
        for pair in message.classification.lane_pairing:
            for name in ("successor_lane_id", "antecessor_lane_id"):
                if pair.HasField(name):
                    other = getattr(pair, name).value
                    paired_with.setdefault(key, []).append(other)
                    paired_with.setdefault(other, []).append(key)
    adjacent = {}
    for key, lane in lanes.items():
        known, onward = osi.lane[key].classification, []
        adjacent[key] = [
            i.value for i in (*known.left_adjacent_lane_id, *known.right_adjacent_lane_id)
        ]
        for i in dict.fromkeys(paired_with.get(key, ())):
            if i in lanes:
                begin, end = (
                    float(np.hypot(*(lanes[i].center[k] - lane.center[-1]))) for k in (0, -1)
                )
                onward += [i] if begin <= MAX_GAP and begin < end else []
        lanes[key] = replace(lane, successors=tuple(onward))
    return lanes, adjacent


def _facts(message: Any) -> dict[str, Any]:
    kind = _enum_name(message.classification, "type").removeprefix("TYPE_").lower()
    subtype = ""
    if "subtype" in message.classification.DESCRIPTOR.fields_by_name:
        subtype = _enum_name(message.classification, "subtype").removeprefix("SUBTYPE_").lower()
    word = subtype if subtype not in ("", "unknown", "other") else kind
    return {"drivable": kind in ("driving", "intersection"), "kind": word}


def _lane_between_boundaries(
    key: int, osi: _OsiMap, center: FloatArray, origin: FloatArray
) -> Lane | None:
    known = osi.lane[key].classification
    lines, crossable = [], []
    for ids in (known.left_lane_boundary_id, known.right_lane_boundary_id):
        boundaries = [osi.lane_boundary[i.value] for i in ids if i.value in osi.lane_boundary]
        placed = []  # the pieces in driving direction
        for part in (_points((p.position for p in b.boundary_line), origin) for b in boundaries):
            if len(part) > 1:
                first, last = station_on(center, part[0]), station_on(center, part[-1])
                placed.append((min(first, last), part[::-1] if last < first else part))
        if not placed:
            return None
        lines.append(np.vstack([part for _, part in sorted(placed, key=itemgetter(0))]))
        crossable.append(all(_enum_name(b.classification, "type") in CROSSABLE for b in boundaries))
    if _lateral_offset(center, lines[0])[0] < 0.0 < _lateral_offset(center, lines[1])[0]:
        lines, crossable = lines[::-1], crossable[::-1]
    left, right = paired(*lines)
    return Lane(
        key,
        left,
        right,
        left_crossable=crossable[0],
        right_crossable=crossable[1],
        **_facts(osi.lane[key]),
    )


def _lane_around_center(key: int, osi: _OsiMap, centers: dict[int, FloatArray]) -> Lane:
    center, known = centers[key], osi.lane[key].classification
    near: dict[bool, list[float]] = {True: [], False: []}
    for ids in (known.left_adjacent_lane_id, known.right_adjacent_lane_id):
        for other in (centers[i.value] for i in ids if i.value in centers):
            offset, _ = _lateral_offset(center, other)
            if BESIDE[0] <= abs(offset) <= BESIDE[1]:
                near[offset > 0.0].append(0.5 * abs(offset))
    half = [
        min(near[side], default=min(near[not side], default=HALF_WIDTH)) for side in (True, False)
    ]
    tangent = np.gradient(center, axis=0)
    normal = (
        np.column_stack([-tangent[:, 1], tangent[:, 0]])
        / np.maximum(np.hypot(*tangent.T), 1e-9)[:, None]
    )
    return Lane(key, center + half[0] * normal, center - half[1] * normal, **_facts(osi.lane[key]))


def _lateral_offset(line: FloatArray, other: FloatArray) -> tuple[float, bool]:
    """Lateral offset of `other` at the middle of `line`, positive to the left, and whether it runs
    the same way.

    NaN if the middle does not project onto `other`.
    """
    steps = np.diff(line, axis=0)
    stations = arc_lengths(*line.T)
    half = 0.5 * stations[-1]
    k = min(int(np.searchsorted(stations, half, side="right")) - 1, len(steps) - 1)
    tangent = steps[k] / np.hypot(*steps[k])
    point = line[k] + (half - stations[k]) * tangent
    i, foot = foot_on(other, point)
    away = foot - point
    if abs(away @ tangent) > 0.5:
        return float("nan"), True
    return float(tangent[0] * away[1] - tangent[1] * away[0]), bool(
        (other[i + 1] - other[i]) @ tangent > 0.0
    )


def _beside_each_other(
    lanes: dict[int, Lane], adjacent: dict[int, list[int]]
) -> tuple[dict[int, Lane], bool]:
    """The lanes with their neighbours, and whether traffic drives on the right: opposite lanes are
    mostly left.
    """
    linked, balance = {}, 0
    for key, lane in lanes.items():
        # left, right
        nearest: dict[bool, tuple[int | None, bool]] = {True: (None, False), False: (None, False)}
        distance = {True: BESIDE[1], False: BESIDE[1]}
        for other in (lanes[i] for i in adjacent[key] if i in lanes):
            offset, same = _lateral_offset(lane.center, other.center)
            if 0.5 * BESIDE[0] <= abs(offset) <= distance[offset > 0.0]:
                nearest[offset > 0.0], distance[offset > 0.0] = (other.id, same), abs(offset)
        (left, left_same), (right, right_same) = nearest[True], nearest[False]
        left_opposite, right_opposite = (
            left is not None and not left_same,
            right is not None and not right_same,
        )
        balance += left_opposite - right_opposite
        beside: dict[str, Any] = {
            "left_neighbour": left if left_same else None,
            "right_neighbour": right if right_same else None,
        }
        linked[key] = replace(
            lane, **beside, left_opposite=left_opposite, right_opposite=right_opposite
        )
    return linked, balance >= 0
