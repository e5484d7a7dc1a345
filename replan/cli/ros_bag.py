"""Writes a drive with raw detections as a ROS 2 bag: poses of the ego, detected objects, the goal.

    /localization/kinematic_state    nav_msgs/msg/Odometry, frames map and base_link, the ego's
                                     samples
    /detection/detected_objects      autoware_msgs/msg/DetectedObjectArray, in map: pose, size,
                                     label, score, id
    /planning/goal                   geometry_msgs/msg/PoseStamped: the pose at which the logged ego
                                     reaches the goal
    /clock                           rosgraph_msgs/msg/Clock: because the drive is simulated

Velocities and scores that a detector does not give are 0. Lanes are not in a bag.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from math import cos, isfinite, sin
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from replan.core.errors import ConfigError, writing
from replan.logs.agents import AgentKind
from replan.logs.repair.detections import Detections
from replan.logs.scenario import Scenario
from replan.results.tables import PARTIAL

# Start time of logs that begin at 0, because a bag's times are wall-clock times
START_NS = 1_700_000_000_000_000_000
LABELS = {
    AgentKind.CAR: "car",
    AgentKind.TRUCK: "truck",
    AgentKind.BUS: "bus",
    AgentKind.MOTORCYCLE: "motorcycle",
    AgentKind.BICYCLE: "bicycle",
    AgentKind.PEDESTRIAN: "pedestrian",
    AgentKind.OBJECT: "unknown",
}
HEIGHT_M = 1.6
DEFINITIONS = {
    "autoware_msgs/msg/DetectedObject": (
        "std_msgs/Header header\nuint32 id\nstring label\nfloat32 score\nbool "
        "valid\ngeometry_msgs/Pose pose\n"
        "geometry_msgs/Vector3 dimensions\ngeometry_msgs/Twist "
        "velocity\ngeometry_msgs/PolygonStamped convex_hull\n"
        "bool velocity_reliable\n"
    ),
    "autoware_msgs/msg/DetectedObjectArray": "std_msgs/Header header\nDetectedObject[] objects\n",
}
"""Fields of Autoware Mini's messages that replan writes and reads."""
Row = tuple[str, str, int, dict[str, Any]]  # Topic, type, log time ns, fields


def write_bag(path: Path, scenario: Scenario) -> None:
    """Write the folder of a bag, completely or not at all; only a bag that was written here is
    replaced.

    ConfigError if the scenario has no raw detections, or something else has this name; OutputError
    if the bag cannot be written.
    """
    if scenario.detections is None:
        raise ConfigError(
            f"{scenario.name} has tracks and no raw detections: a bag holds those (synth raw --as "
            "ros2)"
        )
    card = path / "metadata.yaml"
    if path.exists() and not (card.is_file() and b"replan synth" in card.read_bytes()):
        raise ConfigError(f"{path}: exists, and this command did not write it; name another folder")
    types = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        types.register(get_types_from_msg(text, name))
    partial = path.with_name(f"{PARTIAL}{path.name}")
    shutil.rmtree(partial, ignore_errors=True)  # of a command that was killed
    writer = Writer(partial / path.name, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    writer.set_custom_data("made by", "replan synth")
    rows = sorted(_rows(scenario, scenario.detections), key=lambda row: row[2])
    try:
        with writing(path):
            with writer:
                topics: dict[str, Any] = {}
                for topic, kind, time, values in rows:
                    if topic not in topics:
                        topics[topic] = writer.add_connection(topic, kind, typestore=types)
                    writer.write(
                        topics[topic],
                        time,
                        types.serialize_cdr(message(kind, types, **values), kind),
                    )
            if path.exists():
                shutil.rmtree(path)
            (partial / path.name).replace(path)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def message(kind: str, types: Any, **values: Any) -> Any:
    """A message with some fields set (nested messages as dicts, arrays as lists), all others
    zero.
    """
    fields = {
        name: _value(desc, values.pop(name, None), types) for name, desc in types.fielddefs[kind][1]
    }
    if values:
        raise ValueError(f"{kind} has no {', '.join(values)}")
    return types.types[kind](**fields)


def _value(desc: Any, value: Any, types: Any) -> Any:
    node, kind = desc
    if node == Nodetype.BASE:
        zero = {"string": "", "bool": False}.get(kind[0], 0)
        return zero if value is None else value
    if node == Nodetype.NAME:
        return message(kind, types, **(value or {}))
    inner, length = kind[0], kind[1] if node == Nodetype.ARRAY else 0
    if inner[0] == Nodetype.BASE and inner[1][0] != "string":
        dtype = {"byte": "uint8", "char": "uint8", "octet": "uint8"}.get(inner[1][0], inner[1][0])
        return np.asarray(np.zeros(length) if value is None else value, dtype=dtype)
    return [_value(inner, element, types) for element in value or []]


def pose(x: float, y: float, yaw: float) -> dict[str, Any]:
    """The fields of a geometry_msgs/Pose on the ground."""
    return {"position": {"x": x, "y": y}, "orientation": {"z": sin(0.5 * yaw), "w": cos(0.5 * yaw)}}


def _header(ns: int) -> dict[str, Any]:
    return {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": "map"}


def _ns(scenario: Scenario, t: float) -> int:
    return (scenario.start_ns or START_NS) + round(1e9 * t)


def _rows(scenario: Scenario, detections: Detections) -> Iterator[Row]:
    """The messages of the ego, of the detected objects, and of the goal if the drive reaches it."""
    for i in range(len(scenario.ego)):
        state, ns = scenario.ego.state(i), _ns(scenario, float(scenario.ego.t[i]))
        where = {
            "pose": {"pose": pose(state.x, state.y, state.yaw)},
            "twist": {"twist": {"linear": {"x": state.v}}},
        }
        named = {"header": _header(ns), "child_frame_id": "base_link", **where}
        yield "/localization/kinematic_state", "nav_msgs/msg/Odometry", ns, named
        yield "/clock", "rosgraph_msgs/msg/Clock", ns, {"clock": _header(ns)["stamp"]}
    kinds, ends = detections.kinds, np.searchsorted(detections.t, detections.frames, side="right")
    for k, t in enumerate(detections.frames.tolist()):
        ns, items = _ns(scenario, t), []
        for i in range(int(np.searchsorted(detections.t, t)), int(ends[k])):
            score = float(detections.score[i])
            items.append(
                {
                    "header": _header(ns),
                    "id": int(detections.ids[i]),
                    "label": LABELS[kinds[i]],
                    "valid": True,
                    "score": score if isfinite(score) else 0.0,
                    "pose": pose(detections.x[i], detections.y[i], detections.yaw[i]),
                    "dimensions": {
                        "x": detections.length[i],
                        "y": detections.width[i],
                        "z": HEIGHT_M,
                    },
                }
            )
        values = {"header": _header(ns), "objects": items}
        yield "/detection/detected_objects", "autoware_msgs/msg/DetectedObjectArray", ns, values
    goal, ahead = scenario.goal, scenario.vehicle.axle_to_center
    for i in range(len(scenario.ego) if goal is not None else 0):
        s = scenario.ego.state(i)
        if goal is not None and goal.holds_place(*s.ahead(ahead)):
            ns = _ns(scenario, 0.0)
            values = {"header": _header(ns), "pose": pose(s.x, s.y, s.yaw)}
            yield "/planning/goal", "geometry_msgs/msg/PoseStamped", ns, values
            break
