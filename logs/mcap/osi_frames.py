"""The frames of an OSI ground truth, decoded with the protobuf descriptor in the file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, message_factory
from google.protobuf.message import DecodeError

from replan.core.errors import LogError
from replan.logs.mcap.container import COPY_AGAIN, Stream

TRUTH, VIEW = "osi3.GroundTruth", "osi3.SensorView"
SCHEMAS = (TRUTH, VIEW)
"""The messages that are read; a sensor view contains the ground truth."""
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
FRAME, X, Y, YAW, VX, VY, AX, AY, Z = range(9)
"""Columns of the samples of a moving object: index of the frame, pose (m, rad), velocity (m/s) and
acceleration (m/s2) in the world, height of its centre (m).
"""


@dataclass
class OsiMap:
    """Messages by id, from all frames; the first message of an id is kept.

    Older descriptors lack the logical lanes.
    """

    lane: dict[int, Any] = field(default_factory=dict)
    lane_boundary: dict[int, Any] = field(default_factory=dict)
    logical_lane: dict[int, Any] = field(default_factory=dict)
    logical_lane_boundary: dict[int, Any] = field(default_factory=dict)


@dataclass
class OsiFrames:
    """All frames.

    Attributes:
        times: Time of each frame, ns.
        host: Id of the ego.
        moving: First message of each moving object.
        standing: First message of each stationary object.
        samples: Rows of each moving object, with the columns `FRAME` to `Z`.
        road: The road.
        lights: Largest number of traffic lights at a time.
    """

    times: list[int] = field(default_factory=list)
    host: int | None = None
    moving: dict[int, Any] = field(default_factory=dict)
    standing: dict[int, Any] = field(default_factory=dict)
    samples: dict[int, list[tuple[float, ...]]] = field(default_factory=dict)
    road: OsiMap = field(default_factory=OsiMap)
    lights: int = 0

    def add(self, frame: Any, time: int) -> None:
        """Add the message of a frame, ns."""
        if self.host is None and frame.HasField("host_vehicle_id"):
            self.host = frame.host_vehicle_id.value
        for item in frame.moving_object:
            self.moving.setdefault(item.id.value, item)
            row = (len(self.times), *_motion(item.base))
            self.samples.setdefault(item.id.value, []).append(row)
        for item in frame.stationary_object:
            self.standing.setdefault(item.id.value, item)
        self.lights = max(self.lights, len(getattr(frame, "traffic_light", ())))
        for part in fields(OsiMap):
            known = getattr(self.road, part.name)
            for item in getattr(frame, part.name, ()):
                known.setdefault(item.id.value, item)
        self.times.append(time)


def _motion(base: Any) -> Iterator[float]:
    """The columns `X` to `Z` of an object; velocity and acceleration NaN if they are not set."""
    position, missing = base.position, (np.nan, np.nan)
    yield from (position.x, position.y, base.orientation.yaw)
    yield from (base.velocity.x, base.velocity.y) if base.HasField("velocity") else missing
    acceleration = base.acceleration
    yield from (acceleration.x, acceleration.y) if base.HasField("acceleration") else missing
    yield position.z


def ground_truth_of(stream: Stream) -> OsiFrames:
    """Decode the messages of a topic.

    Raises:
        LogError: The descriptor or a message cannot be decoded, or time does not increase.
    """
    kind, truth = _message_class(stream), OsiFrames()
    for log_time, payload in zip(stream.times, stream.payloads, strict=True):
        try:
            message = kind.FromString(payload)
        except DecodeError as error:
            problem = f"message cannot be decoded: {error}"
            raise LogError(
                problem, topic=stream.topic, time_ns=log_time, remedy=COPY_AGAIN
            ) from None
        frame = message.global_ground_truth if stream.schema == VIEW else message
        time, stamp = log_time, frame.timestamp
        if frame.HasField("timestamp"):
            time = stamp.seconds * 1_000_000_000 + stamp.nanos
        if truth.times and time <= truth.times[-1]:
            before_s, now_s = truth.times[-1] / 1e9, time / 1e9
            problem = f"time does not increase, from {before_s:.3f} s to {now_s:.3f} s"
            remedy = "write each frame once, in order of time"
            raise LogError(problem, topic=stream.topic, time_ns=log_time, remedy=remedy)
        truth.add(frame, time)
    return truth


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
    above = ("global_ground_truth",) if stream.schema == VIEW else ()
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


def enum_name(message: Any, name: str) -> str:
    """The name of the value of an enum field; "" if the descriptor does not name it."""
    kind = message.DESCRIPTOR.fields_by_name[name].enum_type
    value = kind.values_by_number.get(getattr(message, name))
    return value.name if value is not None else ""
