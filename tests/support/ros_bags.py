"""Bags written by rosbags: a drive on an arc among two cars and a pedestrian, as Autoware and
others would log it.
"""

from collections.abc import Callable, Iterable
from copy import deepcopy
from importlib.resources import files
from math import cos, sin
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from replan.cli import ros_bag

START_NS = 1_700_000_000_000_000_000
SPEED, RADIUS, CENTRE = 8.0, 100.0, (89_000.0, 43_100.0)
RATE_HZ, OBJECTS_HZ, DURATION_S = 50, 10, 6.0
Row = tuple[str, str, int, Any]
"""Topic, type, log time ns, message."""


def store(*, ros1: bool = False) -> Any:
    """A type store with all message types that the tests write."""
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    text = files("replan.logs.readers.ros").joinpath("definitions.msg").read_text()
    found: dict[str, Any] = {}
    for part in text.split("=" * 20 + "\n")[1:]:
        name, _, body = part.partition("\n")
        found |= get_types_from_msg(body, name.removeprefix("MSG: "))
    for name, body in ros_bag.DEFINITIONS.items():
        found |= get_types_from_msg(body, name)
    if ros1:
        found |= get_types_from_msg(
            "geometry_msgs/TransformStamped[] transforms\n", "tf2_msgs/msg/TFMessage"
        )
    types.register({name: each for name, each in found.items() if name not in types.fielddefs})
    return types


STORE = store()


def message(kind: str, types: Any = STORE, **values: Any) -> Any:
    return ros_bag.message(kind, types, **values)


def stamp(ns: int) -> dict[str, int]:
    return {"sec": ns // 1_000_000_000, "nanosec": ns % 1_000_000_000}


def header(ns: int, frame: str = "map") -> dict[str, Any]:
    return {"stamp": stamp(ns), "frame_id": frame}


def pose(x: float, y: float, yaw: float) -> dict[str, Any]:
    turn = {"z": sin(0.5 * yaw), "w": cos(0.5 * yaw)}
    return {"position": {"x": x, "y": y, "z": 30.0}, "orientation": turn}


def ego_pose(t: float) -> tuple[float, float, float]:
    """x, y, yaw on the arc."""
    turn = SPEED * t / RADIUS
    return CENTRE[0] + RADIUS * sin(turn), CENTRE[1] - RADIUS * cos(turn), turn


def objects_at(t: float) -> list[tuple[str, int, float, float, float, float, float, float]]:
    """Name, Autoware label, x, y, yaw, speed, length, width in the map: two cars and a
    pedestrian.
    """
    x, y, _ = ego_pose(0.0)
    return [
        ("ahead", 1, x + 30.0 + 6.0 * t, y + 4.0, 0.0, 6.0, 4.4, 1.8),
        ("parked", 1, x + 20.0, y - 6.0, 1.0, 0.0, 4.0, 1.7),
        ("walker", 7, x + 40.0, y + 10.0 - 1.2 * t, -0.5 * np.pi, 1.2, 0.6, 0.6),
    ]


def uuid(name: str) -> dict[str, Any]:
    return {"uuid": np.frombuffer(name.encode().ljust(16, b"\0"), dtype=np.uint8)}


def times(rate: float, duration: float = DURATION_S) -> list[int]:
    return [START_NS + round(k * 1e9 / rate) for k in range(int(duration * rate) + 1)]


def seconds(ns: int) -> float:
    return (ns - START_NS) / 1e9


def transforms(duration: float = DURATION_S) -> list[Row]:
    """map -> odom (5 Hz, constant), odom -> base_link (50 Hz), base_link -> lidar (static)."""
    kind, odom = "tf2_msgs/msg/TFMessage", (CENTRE[0] - 50.0, CENTRE[1] + 20.0)
    out: list[Row] = []

    def one(ns: int, parent: str, child: str, x: float, y: float, yaw: float) -> dict[str, Any]:
        moved = pose(x, y, yaw)
        transform = {"translation": moved["position"], "rotation": moved["orientation"]}
        return {"header": header(ns, parent), "child_frame_id": child, "transform": transform}

    out.append(
        (
            "/tf_static",
            kind,
            START_NS,
            message(kind, transforms=[one(START_NS, "base_link", "lidar", 1.0, 0.5, 0.3)]),
        )
    )
    out += [
        ("/tf", kind, ns, message(kind, transforms=[one(ns, "map", "odom", *odom, 0.0)]))
        for ns in times(5, duration)
    ]
    for ns in times(RATE_HZ, duration):
        x, y, yaw = ego_pose(seconds(ns))
        moved = one(ns, "odom", "base_link", x - odom[0], y - odom[1], yaw)
        out.append(("/tf", kind, ns + 3_000_000, message(kind, transforms=[moved])))
    return out


def odometry(
    topic: str = "/localization/kinematic_state", duration: float = DURATION_S
) -> list[Row]:
    kind, out = "nav_msgs/msg/Odometry", []
    for ns in times(RATE_HZ, duration):
        at = {
            "pose": {"pose": pose(*ego_pose(seconds(ns)))},
            "twist": {"twist": {"linear": {"x": SPEED}}},
        }
        out.append(
            (
                topic,
                kind,
                ns + 2_000_000,
                message(kind, header=header(ns), child_frame_id="base_link", **at),
            )
        )
    out[0][3].twist.twist.linear.x += 1e-3
    return out


def to_frame(
    x: float, y: float, yaw: float, origin: tuple[float, float, float]
) -> tuple[float, float, float]:
    c, s = cos(origin[2]), sin(origin[2])
    dx, dy = x - origin[0], y - origin[1]
    return c * dx + s * dy, c * dy - s * dx, yaw - origin[2]


def autoware_objects(
    kind: str, topic: str, frame: str = "map", shape: int = 0, late_ns: int = 80_000_000
) -> list[Row]:
    """TrackedObjects, PredictedObjects or DetectedObjects of either package, in the map or in
    base_link.
    """
    prefix = "initial_" if "Predicted" in kind else ""
    out = []
    for ns in times(OBJECTS_HZ):
        t, items = seconds(ns), []
        for name, label, x, y, yaw, speed, length, width in objects_at(t):
            placed = (x, y, yaw) if frame == "map" else to_frame(x, y, yaw, ego_pose(t))
            kinematics: dict[str, Any] = {
                f"{prefix}pose_with_covariance": {"pose": pose(*placed)},
                f"{prefix}twist_with_covariance": {"twist": {"linear": {"x": speed}}},
            }
            if prefix:
                paths = [{"path": [pose(x + k, y, yaw) for k in range(5)], "confidence": 0.5}]
                kinematics["predicted_paths"] = paths
            item: dict[str, Any] = {
                "classification": [
                    {"label": 0, "probability": 0.1},
                    {"label": label, "probability": 0.8},
                ]
            }
            item |= {"kinematics": kinematics, "shape": _shape(shape, length, width)}
            if "Detected" not in kind:
                item["object_id"] = uuid(name)
            items.append(item)
        out.append(
            (topic, kind, ns + late_ns, message(kind, header=header(ns, frame), objects=items))
        )
    return out


def _shape(shape: int, length: float, width: float) -> dict[str, Any]:
    if shape == 0:
        return {"type": 0, "dimensions": {"x": length, "y": width, "z": 1.5}}
    if shape == 1:
        return {"type": 1, "dimensions": {"x": length, "y": length, "z": 1.5}}
    corners = [(a * length / 2, b * width / 2) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    return {
        "type": 2,
        "footprint": {"points": [{"x": x, "y": y} for x, y in corners]},
        "dimensions": {"z": 1.5},
    }


def later(rows: Iterable[Row], log_s: float, stamp_s: float) -> list[Row]:
    """The messages recorded `log_s` later, with stamps `stamp_s` later (transforms: each its
    own).
    """
    out = []
    for topic, kind, time, each in rows:
        each = deepcopy(each)
        for one in getattr(each, "transforms", [each]):
            of = getattr(one, "header", one)
            told = of.clock if hasattr(of, "clock") else of.stamp
            ns = told.sec * 1_000_000_000 + told.nanosec + round(1e9 * stamp_s)
            told.sec, told.nanosec = divmod(ns, 1_000_000_000)
        out.append((topic, kind, time + round(1e9 * log_s), each))
    return out


def values_of(some: Any) -> dict[str, Any]:
    """A message as keywords of `message`."""
    out = {}
    for name in some.__dataclass_fields__:
        value = getattr(some, name)
        if name == "__msgtype__":
            continue
        if hasattr(value, "__dataclass_fields__"):
            value = values_of(value)
        elif isinstance(value, list):
            value = [
                values_of(each) if hasattr(each, "__dataclass_fields__") else each for each in value
            ]
        out[name] = value
    return out


def write_ros2(
    path: Path,
    rows: Iterable[Row],
    *,
    sqlite: bool = False,
    compressed: bool = True,
    types: Any = STORE,
) -> Path:
    """A rosbag2 folder."""
    plugin = StoragePlugin.SQLITE3 if sqlite else StoragePlugin.MCAP
    writer = Writer(path, version=9, storage_plugin=plugin)
    if compressed and not sqlite:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        write_rows(writer, rows, types, types.serialize_cdr)
    return path


def write_ros1(path: Path, rows: Iterable[Row], types: Any) -> Path:
    with Writer1(path) as writer:
        write_rows(writer, rows, types, types.serialize_ros1)
    return path


def write_rows(
    writer: Any, rows: Iterable[Row], types: Any, serialised: Callable[[Any, str], Any]
) -> None:
    """Write rows in the order of their times."""
    connections: dict[str, Any] = {}
    for topic, kind, time, each in sorted(rows, key=lambda row: row[2]):
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=types)
        writer.write(connections[topic], time, serialised(each, kind))
