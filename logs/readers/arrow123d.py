"""Reads 123D logs: folders of Arrow files that py123d converts from nuPlan, Waymo, nuScenes,
Argoverse 2 and others.

The scenario has the ego, boxes, lights over time, and the map of the log or of its place
(`arrow123d_road`).

Frames are the rows of sync.arrow. Data of each table are found by the table's own times, not by the
indices in sync.arrow: those are one frame late in logs of 0.2.0 and up to 3 ms late in asynchronous
ones. The poses in the log are those of the IMU:

(1) rear axle = p + q r q*,  r the axle in the IMU's frame;   v = v_imu - w r_y,
        a = a_imu - w^2 r_x

with w the yaw rate, rad/s, and stored velocities in the body's frame. If a data set has no
velocities, py123d fills them with differences between the frames before and after (0.1.0: with
zeros). These are not read, since they use a later frame: the ego's velocities are derived from the
poses before each state, the agents' by backward differences, and the scenario begins at the second
frame, so that every state has earlier poses.

`route_position.arrow` is the ego's future path, and `custom.*` are fields of single data sets:
neither is read, but for the route in nuPlan's (`arrow123d_road`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.arrow_tables import ipc_table, metadata_of, reading, vectors, whole
from replan.core.errors import LogError
from replan.logs.complete import completed
from replan.logs.log_settings import LogSettings
from replan.logs.maps.arrow123d_road import LIGHTS, map_of, road_of
from replan.logs.observed import of_stream
from replan.logs.readers.arrow123d_boxes import BOXES, is_differenced, read_boxes
from replan.logs.readers.base import LogContents, Reader, TopicSummary
from replan.logs.readers.recorded import (
    driven,
    from_second,
    from_start,
    heading,
    held_curvature,
    kept,
    rotated,
    tracks_of,
    unit_of_wxyz,
)
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.vehicle import assumed_car

SYNC, EGO = "sync.arrow", "ego_state_se3"
HEAD_BYTES = 65_536
"""Number of first bytes in which the schema of an old log is recognised."""
_RECORDED = (
    "av2",
    "nuplan",
    "nuscenes",
    "wod",
    "kitti360",
    "pandaset",
    "physical-ai-av",
    "ncore",
    "nureasoning",
    "truckdrive",
)
_ABOUT = ("dataset", "split", "log_name", "location", "version")
_SIMULATED = ("carla", "lead", "griffin", "opendrive")
_LICENCES = {
    "av2": "CC BY-NC-SA 4.0 and the terms of Argoverse 2",
    "nuplan": "CC BY-NC-SA 4.0 and the terms of nuPlan",
    "nuscenes": "CC BY-NC-SA 4.0 and the terms of nuScenes",
    "kitti360": "CC BY-NC-SA 3.0",
    "pandaset": "CC BY 4.0 and the terms of PandaSet",
    "wod": "Waymo's, non-commercial",
}


@dataclass(frozen=True, eq=False)
class EgoRows:
    """The ego's table: times us `(n,)`, poses of the IMU, its dynamic states `(n, 9)` (NaN if
    missing), metadata.
    """

    time_us: IntArray
    position: FloatArray
    q: FloatArray
    dynamic: FloatArray
    about: Mapping[Any, Any]

    def part(self, name: str) -> FloatArray:
        """Return the position `(3,)` of a part of the vehicle in the IMU's frame, m; ValueError if
        it is missing.
        """
        place = np.asarray(self.about.get(name, ()), dtype=np.float64)
        if place.shape != (7,) or not np.isfinite(place).all():
            raise ValueError(f"the vehicle has no {name}")
        return place[:3]

    def world(self, point: FloatArray) -> FloatArray:
        """Return the world positions `(n, 3)` of a point `(3,)` in the IMU's frame, m."""
        return self.position + rotated(self.q, np.broadcast_to(point, self.position.shape))


def read_123d(folder: Path) -> Scenario:
    """Read the log in a folder (module docstring); LogError if it cannot be used."""
    notes: list[str] = []
    frames_us, about = read_frames(folder)
    rows = read_ego(folder)
    with reading(folder / f"{EGO}.arrow"):
        drive, is_logged = _ego(rows, notes)
        names = {"length": "length", "width": "width", "wheelbase": "wheel_base"}
        sizes = {key: float(rows.about.get(name) or 0.0) for key, name in names.items()}
        sizes = {key: value for key, value in sizes.items() if 0.0 < value < 50.0}
        ahead = rows.part("center_to_imu_se3") - rows.part("rear_axle_to_imu_se3")
        if "length" in sizes and np.any(ahead):
            sizes["rear_overhang"] = 0.5 * sizes["length"] - float(ahead[0])
        elif "length" in sizes:
            notes.append(
                "The log has the ego's rear axle in the centre of its box: it is placed as in the "
                "default car."
            )
        if abs(ahead[1]) > 0.05:
            notes.append(
                f"The ego's box is {abs(ahead[1]):.2f} m beside its rear axle in the log: taken as "
                "centred on it."
            )
        vehicle = assumed_car(sizes, notes)
    places = rows.world(rows.part("rear_axle_to_imu_se3"))
    boxes, has_velocities, observed = read_boxes(folder, int(rows.time_us[0]), places, notes)
    frames = (frames_us - rows.time_us[0]) / 1e6
    index = kept(drive.t, frames)
    if not (is_logged and has_velocities):
        index = from_second(index, drive.t, frames[:1], notes)
    ego, before, boxes, origin = from_start(drive, index, boxes)
    start, start_us = float(drive.t[index[0]]), int(rows.time_us[index[0]])
    tracks = tracks_of(boxes, notes)
    road, lights = road_of(
        folder, about, ego, (float(origin[0]), float(origin[1])), start_us, notes
    )
    if (folder / "route_position.arrow").exists():
        notes.append("route_position is the ego's own later path: not read.")
    dataset = str(about.get("dataset") or "")
    tags = ["123d"]
    tags += ["recorded"] if dataset.startswith(_RECORDED) else []
    tags += ["synthetic"] if dataset.startswith(_SIMULATED) else []
    tags += [dataset] if dataset else []
    return Scenario(
        name=str(about.get("log_name") or folder.name),
        ego=ego,
        before=before,
        tracks=tracks,
        object_classes=boxes.object_classes,
        road=road,
        duration=float(ego.t[-1]),
        vehicle=vehicle,
        tags=tuple(tags),
        source=(
            f"123D log of {dataset or 'an unnamed data set'}, written by py123d "
            f"{about.get('version') or '?'}"
        ),
        licence=next(
            (words for key, words in _LICENCES.items() if dataset.startswith(key)),
            "that of the data set",
        ),
        origin=(float(origin[0]), float(origin[1])),
        start_ns=1000 * start_us,
        metadata={key: str(about[key]) for key in _ABOUT if about.get(key)},
        notes=tuple(notes),
        lights=lights,
        traffic=of_stream(observed - start),
    )


# Tables


def read_frames(folder: Path) -> tuple[IntArray, dict[Any, Any]]:
    """Read the times of the frames `(n,)`, us, and the log's metadata."""
    path = folder / SYNC
    table = ipc_table(path, ("sync.timestamp_us",))
    with reading(path):
        return whole(table, "sync.timestamp_us"), metadata_of(table)


def read_ego(folder: Path) -> EgoRows:
    """Read the ego's table in order of time, with at most one row per microsecond."""
    path = folder / f"{EGO}.arrow"
    if not path.is_file():
        raise LogError(
            "the log has no ego: ego_state_se3.arrow is missing",
            file=folder,
            remedy="convert it with its ego",
        )
    table = ipc_table(path, (f"{EGO}.timestamp_us", f"{EGO}.imu_se3"))
    with reading(path):
        times = whole(table, f"{EGO}.timestamp_us")
        if not len(times):
            raise LogError("the log has no ego states")
        times, rows = np.unique(times, return_index=True)
        poses = vectors(table[f"{EGO}.imu_se3"], 7)[rows]
        if not np.isfinite(poses).all():
            k = int(np.argmin(np.isfinite(poses).all(axis=1)))
            raise LogError(
                "a pose of the ego is missing or not finite", time_ns=1000 * int(times[k])
            )
        name = f"{EGO}.dynamic_state_se3"
        dynamic = np.full((len(rows), 9), np.nan)
        if name in table.schema.names:
            dynamic = vectors(table[name], 9)[rows]
        position, q = np.hsplit(poses, [3])
        return EgoRows(times, position, unit_of_wxyz(q), dynamic, metadata_of(table))


# Ego


def _ego(rows: EgoRows, notes: list[str]) -> tuple[Trajectory, bool]:
    """Return all states of the rear axle, s since the first, and whether the log has their
    velocities.
    """
    t = (rows.time_us - rows.time_us[0]) / 1e6
    axle = rows.part("rear_axle_to_imu_se3")
    x, y, _ = rows.world(axle).T
    yaw = np.unwrap(heading(rows.q))
    velocity, acceleration, turn_rate = np.hsplit(rows.dynamic, 3)
    vx, ax, yaw_rate = velocity[:, 0], acceleration[:, 0], turn_rate[:, 2]
    moves = np.isfinite(vx).all() and np.isfinite(yaw_rate).all() and velocity.any()
    owner = np.zeros(len(t), np.int64)
    if not moves or is_differenced(t, rows.position, rotated(rows.q, velocity), owner):
        return driven(t, x, y, yaw, notes), False
    v = vx - yaw_rate * axle[1]
    a = ax - yaw_rate**2 * axle[0]
    kappa = held_curvature(yaw_rate, v)
    columns = {"t": t, "x": x, "y": y, "yaw": yaw, "v": v, "a": a, "kappa": kappa}
    return completed(columns, notes), True


# The reader


def _claims(path: Path) -> bool:
    try:
        if path.is_dir():
            return (path / SYNC).is_file()
        if path.suffix.lower() != ".arrow" or not path.is_file():
            return False
        if path.name == SYNC:
            return True
        with path.open("rb") as stream:
            head = stream.read(HEAD_BYTES)
        # A log of py123d 0.0.8 or 0.0.9
        return head.startswith(b"ARROW1") and b"log_metadata" in head
    except OSError:
        return False


def folder_of(path: Path) -> Path:
    """Return the log's folder; `path` is the folder or its `sync.arrow`."""
    return path.parent if path.name == SYNC else path


def _read(path: Path, settings: LogSettings) -> Scenario:
    if path.is_file() and path.name != SYNC:
        problem = "a 123D log of py123d 0.0.8 or 0.0.9: one file with other tables"
        raise LogError(
            problem, file=path, remedy="convert the data set again with py123d 0.1.0 or newer"
        )
    with reading(folder_of(path)):
        return read_123d(folder_of(path))


def _files(path: Path) -> tuple[Path, ...]:
    """Return the files that are read; camera and lidar files are not among them."""
    if not (path.is_dir() or path.name == SYNC):
        return (path,)
    folder = folder_of(path)
    try:
        map_file = map_of(folder, read_frames(folder)[1]) or folder / "map.arrow"
    except LogError:
        map_file = folder / "map.arrow"
    names = ("sync", EGO, BOXES, LIGHTS)
    files = (*(folder / f"{name}.arrow" for name in names), map_file)
    return tuple(file for file in files if file.is_file())


def _span(path: Path) -> tuple[float, float] | None:
    try:
        times, _ = read_frames(folder_of(path))
    except LogError:
        return None
    return (0.0, float(times[-1] - times[0]) / 1e6) if len(times) else None


def _contents(path: Path) -> LogContents:
    """Return the modalities and their numbers of frames, from sync.arrow only."""
    try:
        table = ipc_table(folder_of(path) / SYNC, ("sync.timestamp_us",))
        times, about = whole(table, "sync.timestamp_us"), metadata_of(table)
        topics = []
        for key in table.schema.names:
            modality, _, _ = key.partition(".")
            if modality == "sync":
                continue
            own = (1000 * times[~np.asarray(table[key].is_null())]).tolist()
            first, last = (own[0], own[-1]) if own else (None, None)
            topics.append(TopicSummary(key, modality, "arrow", "arrow", len(own), first, last))
        title = f"123D log of {about.get('dataset')}, py123d {about.get('version')}"
        return LogContents(f"{title}, {len(times)} frames", tuple(topics))
    except (LogError, ValueError, TypeError, KeyError):
        return LogContents("123D log that cannot be read")


READER = Reader(
    "123d",
    "123D logs (py123d 0.1.0 and newer): nuPlan, Waymo, nuScenes, Argoverse 2 ...",
    "folders with sync.arrow",
    (),
    _claims,
    _read,
    files=_files,
    span=_span,
    contents=_contents,
)
