"""Small 123D and Argoverse 2 logs as their tools write them, by plain pyarrow: a straight street of
two lanes.
"""

import json
import struct
from collections.abc import Mapping, Sequence
from math import cos, sin
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet

NUPLAN = "py123d.parser.registry.NuPlanBoxDetectionLabel"
START_US = 1_600_000_000_000_000
CAR = {
    "vehicle_name": "made up", "length": 5.0, "width": 2.0, "height": 1.6, "wheel_base": 3.0,
    "center_to_imu_se3": [1.2, 0.1, 0.4, 1.0, 0.0, 0.0, 0.0],
    "rear_axle_to_imu_se3": [-0.2, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0],
}  # fmt: skip


def turn(yaw: float) -> list[float]:
    return [cos(yaw / 2.0), 0.0, 0.0, sin(yaw / 2.0)]


def write_ipc(path: Path, columns: Mapping[str, Any], metadata: Mapping[str, Any]) -> None:
    table = pa.table(dict(columns)).replace_schema_metadata(
        {b"metadata": msgspec.msgpack.encode(metadata)}
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with pa.OSFile(str(path), "wb") as sink, pa.ipc.new_file(sink, table.schema) as writer:
        writer.write_table(table, max_chunksize=20)


def packed(points: Any) -> dict[Any, Any]:
    array = np.ascontiguousarray(points, dtype="<f8")
    return {
        b"__ndarray__": True,
        b"dtype": "<f8",
        b"shape": list(array.shape),
        b"data": array.tobytes(),
    }


def wkb(points: Sequence[Sequence[float]]) -> bytes:
    return struct.pack("<BII", 1, 2, len(points)) + np.asarray(points, "<f8").tobytes()


def write_map(
    path: Path, objects: Sequence[tuple[int, int, Mapping[str, Any], bytes]], **about: Any
) -> None:
    """Objects as (id, layer, features, geometry)."""
    ids, layers, features, geometry = zip(*objects, strict=True)
    columns = {
        "object_id": pa.array(ids, pa.int64()),
        "map_layer": pa.array(layers, pa.int8()),
        "features": pa.array([msgspec.msgpack.encode(f) for f in features], pa.binary()),
        "wkb": pa.array(geometry, pa.binary()),
    }
    write_ipc(path, columns, {"dataset": "nuplan", "location": "here", "version": "0.7.0", **about})


def lane(x: tuple[float, float], y: float, **features: Any) -> dict[str, Any]:
    """Features of a lane 3.5 m wide along x (backwards where x decreases), its middle at y."""
    half = 1.75 if x[1] > x[0] else -1.75
    sides = {
        f"{side}_boundary": packed([[x[0], y + d], [x[1], y + d]])
        for side, d in (("left", half), ("right", -half))
    }
    known: dict[str, Any] = {
        "lane_type": 2,
        "successor_ids": [],
        "predecessor_ids": [],
        "left_lane_id": None,
        "right_lane_id": None,
        "speed_limit_mps": None,
    }
    return {**known, **sides, **features}


def street(**inner: Any) -> list[tuple[int, int, dict[str, Any], bytes]]:
    """Lane 1 to 2 (inside a crossing) to 3 eastwards, 9 beside 1 westwards, a stop zone before 2, a
    solid line.
    """
    zone = packed(
        [
            [58.0, -1.75, 0.0],
            [59.0, -1.75, 0.0],
            [59.0, 1.75, 0.0],
            [58.0, 1.75, 0.0],
            [58.0, -1.75, 0.0],
        ]
    )
    return [
        (
            1,
            0,
            lane((-20.0, 60.0), 0.0, successor_ids=[2], left_lane_id=9, speed_limit_mps=10.0),
            b"",
        ),
        (
            2,
            0,
            lane(
                (60.0, 80.0),
                0.0,
                lane_type=0,
                **{"successor_ids": [3], "predecessor_ids": [1], **inner},
            ),
            b"",
        ),
        (3, 0, lane((80.0, 160.0), 0.0, predecessor_ids=[2]), b""),
        (9, 0, lane((60.0, -20.0), 3.5, left_lane_id=1), b""),
        (4, 7, {"outline": zone, "stop_zone_type": 1, "lane_ids": [2]}, b""),
        (5, 9, {"road_line_type": 10}, wkb([[-20.0, 1.8], [60.0, 1.8]])),
        (6, 3, {"outline": zone}, b""),
    ]


def write_123d(
    folder: Path, n: int = 30, *, velocities: bool = True, camera: bool = True, **about: Any
) -> Path:
    """A log at 10 Hz: the ego at 8 m/s on lane 1, a car ahead at 5 + t m/s, a cone that is seen
    from 1 s on.
    """
    t = 0.1 * np.arange(n)
    times = pa.array(START_US + (1e6 * t).round().astype(np.int64))
    key, boxes = "ego_state_se3", "box_detections_se3"
    metadata = {
        "dataset": "nuplan",
        "split": "nuplan_val",
        "log_name": folder.name,
        "location": "here",
        "version": "0.7.0",
    }
    index = pa.array(np.arange(n))
    write_ipc(
        folder / "sync.arrow",
        {"sync.timestamp_us": times, key: index, boxes: index},
        {**metadata, **about},
    )
    pose = [[8.0 * at + 0.2, -0.1, 0.0, *turn(0.0)] for at in t]
    own = [
        [8.0 + 1e-3 * sin(9.0 * at), 0.0, 0.0, 0.5, *[0.0] * 5] if velocities else None for at in t
    ]
    ego = {
        f"{key}.timestamp_us": times,
        f"{key}.imu_se3": pa.array(pose, pa.list_(pa.float64(), 7)),
        f"{key}.dynamic_state_se3": pa.array(own, pa.list_(pa.float64(), 9)),
    }
    write_ipc(folder / f"{key}.arrow", ego, CAR)
    car = [
        [30.0 + 5.0 * at + 0.5 * at**2, 0.5, 0.7, *turn(0.01), 4.5 + 0.1 * (i % 3), 1.8, 1.5]
        for i, at in enumerate(t)
    ]
    cone = [40.0, 2.5, 0.3, *turn(0.0), 0.4, 0.4, 0.8]
    seen = [[box, cone] if i >= 10 else [box] for i, box in enumerate(car)]
    speeds = [
        [[5.0 + at, 0.0, 0.0], None][: len(row)] if velocities else [None] * len(row)
        for at, row in zip(t, seen, strict=True)
    ]
    detections = {
        f"{boxes}.timestamp_us": times,
        f"{boxes}.bounding_box_se3": pa.array(seen, pa.list_(pa.list_(pa.float64(), 10))),
        f"{boxes}.track_token": pa.array([["car", "cone"][: len(row)] for row in seen]),
        f"{boxes}.label": pa.array([[0, 3][: len(row)] for row in seen], pa.list_(pa.uint16())),
        f"{boxes}.velocity_3d": pa.array(speeds, pa.list_(pa.list_(pa.float64(), 3))),
    }
    write_ipc(folder / f"{boxes}.arrow", detections, {"box_detection_label_class": NUPLAN})
    lights = {
        "traffic_light_detections.timestamp_us": times,
        "traffic_light_detections.lane_id": pa.array([[2, 77]] * n, pa.list_(pa.int32())),
        "traffic_light_detections.status": pa.array(
            [[2 if i < 15 else 0, 4] for i in range(n)], pa.list_(pa.uint8())
        ),
    }
    write_ipc(folder / "traffic_light_detections.arrow", lights, {})
    if camera:
        (folder / "camera.pcam_f0.arrow").write_bytes(b"never read")
    return folder


def write_av2(folder: Path, n: int = 30) -> Path:
    """A sensor log: poses at 100 Hz of an ego at 8 m/s to the north, a car beside it, a stray box
    of the ego itself.
    """
    folder.mkdir(parents=True, exist_ok=True)
    stamps = 10**17 + 10_000_000 * np.arange(10 * n)
    north = 200.0 + 8.0 * 0.01 * np.arange(10 * n)
    poses = {
        "timestamp_ns": stamps,
        **dict(zip(("qw", "qx", "qy", "qz"), np.tile(turn(np.pi / 2), (10 * n, 1)).T, strict=True)),
    }
    poses |= {"tx_m": np.full(10 * n, 50.0), "ty_m": north, "tz_m": np.zeros(10 * n)}
    pa.feather.write_feather(pa.table(poses), str(folder / "city_SE3_egovehicle.feather"))
    frames = stamps[5::10]
    rows = [
        (at, who, kind, x, y)
        for at in frames
        for who, kind, x, y in (("a", "BUS", 20.0, 3.5), ("e", "EGO_VEHICLE", 0.0, 0.0))
    ]
    columns: dict[str, Any] = dict(
        zip(
            ("timestamp_ns", "track_uuid", "category", "tx_m", "ty_m"),
            zip(*rows, strict=True),
            strict=True,
        )
    )
    columns |= {
        name: [value] * len(rows)
        for name, value in (("tz_m", 0.0), ("length_m", 11.0), ("width_m", 2.5))
    }
    columns |= dict(
        zip(("qw", "qx", "qy", "qz"), ([value] * len(rows) for value in turn(0.0)), strict=True)
    )
    pa.feather.write_feather(pa.table(columns), str(folder / "annotations.feather"))
    write_av2_map(folder / "map" / "log_map_archive_x.json")
    return folder


def write_av2_map(path: Path) -> None:
    def line(x: float, *y: float) -> list[dict[str, float]]:
        return [{"x": x, "y": each, "z": 0.0} for each in y]

    segment = {
        "is_intersection": False,
        "lane_type": "VEHICLE",
        "left_lane_mark_type": "SOLID_YELLOW",
        "predecessors": [],
    }
    ahead = {
        **segment,
        "id": 1,
        "left_lane_boundary": line(48.0, 150.0, 300.0),
        "right_lane_boundary": line(52.0, 150.0, 200.0, 300.0),
        "right_lane_mark_type": "DASHED_WHITE",
        "successors": [7],
        "left_neighbor_id": 2,
        "right_neighbor_id": None,
    }
    oncoming = {
        **segment,
        "id": 2,
        "left_lane_boundary": line(48.0, 300.0, 150.0),
        "right_lane_boundary": line(44.0, 300.0, 150.0),
        "right_lane_mark_type": "NONE",
        "successors": [],
        "left_neighbor_id": 1,
        "right_neighbor_id": None,
    }
    crossing = {
        "id": 5,
        "edge1": line(44.0, 240.0) + line(52.0, 240.0),
        "edge2": line(44.0, 243.0) + line(52.0, 243.0),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    areas = {"6": {"id": 6, "area_boundary": line(0.0, 0.0, 1.0)}}
    lanes = {"1": ahead, "2": oncoming}
    path.write_text(
        json.dumps(
            {
                "lane_segments": lanes,
                "pedestrian_crossings": {"5": crossing},
                "drivable_areas": areas,
            }
        )
    )


def write_forecasting(folder: Path, n: int = 110) -> Path:
    """A motion-forecasting scenario: the recording car at 8 m/s to the north, a bus ahead of it, a
    bollard.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for step in range(n):
        rows.append(("AV", "vehicle", step, 50.0, 200.0 + 0.8 * step, np.pi / 2, 0.0, 8.0))
        rows.append(("17", "bus", step, 50.0, 240.0 + 0.6 * step, np.pi / 2, 0.0, 6.0))
        rows.append(("b", "static", step, 54.0, 230.0, 0.0, 0.0, 0.0))
    names = (
        "track_id",
        "object_type",
        "timestep",
        "position_x",
        "position_y",
        "heading",
        "velocity_x",
        "velocity_y",
    )
    columns = dict(zip(names, zip(*rows, strict=True), strict=True))
    pa.parquet.write_table(
        pa.table({**columns, "observed": [True] * len(rows)}),
        str(folder / f"scenario_{folder.name}.parquet"),
    )
    write_av2_map(folder / f"log_map_archive_{folder.name}.json")
    return folder
