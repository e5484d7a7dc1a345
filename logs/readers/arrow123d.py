"""Reads 123D logs: folders of Arrow files that py123d converts from nuPlan, Waymo, nuScenes,
Argoverse 2 and others.

The scenario has the ego, boxes, lights over time, and the map of the log or of its place
(`arrow123d_map`).

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
neither is read, but for the route in nuPlan's (`arrow123d_map`).

Labels. The files store a number of the data set's enumeration, and the dotted path of its class
(`KINDS` has the classes of py123d 0.1.0 to 0.7.0, by the last part of that path). The class is
never imported. For an unknown class, the kinds are derived from the lengths.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.arrow_tables import Lists, ipc_table, metadata_of, reading, vectors, whole
from replan.core.errors import LogError
from replan.core.files import beside
from replan.logs.agents import AgentKind
from replan.logs.complete import completed
from replan.logs.kind_words import kind_of_word, most_common
from replan.logs.log_settings import LogSettings
from replan.logs.maps.arrow123d_map import LIGHTS, map_of, road_of
from replan.logs.observed import of_stream
from replan.logs.readers.base import LogContents, Reader, TopicSummary
from replan.logs.readers.recorded import (
    RecordedBoxes,
    driven,
    from_second,
    from_start,
    heading,
    held_curvature,
    is_unit,
    kept,
    on_level,
    ordered,
    rotated,
    tracks_of,
    unit_of_wxyz,
)
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.vehicle import assumed_car

SYNC, EGO, BOXES = "sync.arrow", "ego_state_se3", "box_detections_se3"
HEAD_BYTES = 65_536
"""Number of first bytes in which the schema of an old log is recognised."""
SAME_MPS = 1e-5
"""Tolerance of equal velocities, m/s: with whole microseconds, differences at 10 m/s are exact
within 2e-6 m/s.
"""
TELLING_MPS = 1e-4
"""Differences to both sides that are closer than this do not show how a velocity was computed,
m/s.
"""
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
_CAR, _TRUCK, _BUS, _MOTORCYCLE, _BICYCLE, _PEDESTRIAN, _OBJECT = AgentKind
LONG_M = 6.5
"""A vehicle of unspecified type that is longer is a truck, m."""

AV2_CATEGORIES = (
    "ANIMAL",
    "ARTICULATED_BUS",
    "BICYCLE",
    "BICYCLIST",
    "BOLLARD",
    "BOX_TRUCK",
    "BUS",
    "CONSTRUCTION_BARREL",
    "CONSTRUCTION_CONE",
    "DOG",
    "LARGE_VEHICLE",
    "MESSAGE_BOARD_TRAILER",
    "MOBILE_PEDESTRIAN_CROSSING_SIGN",
    "MOTORCYCLE",
    "MOTORCYCLIST",
    "OFFICIAL_SIGNALER",
    "PEDESTRIAN",
    "RAILED_VEHICLE",
    "REGULAR_VEHICLE",
    "SCHOOL_BUS",
    "SIGN",
    "STOP_SIGN",
    "STROLLER",
    "TRAFFIC_LIGHT_TRAILER",
    "TRUCK",
    "TRUCK_CAB",
    "VEHICULAR_TRAILER",
    "WHEELCHAIR",
    "WHEELED_DEVICE",
    "WHEELED_RIDER",
)
"""Argoverse 2's categories; 123D numbers them in this order."""

KINDS: dict[str, dict[AgentKind, tuple[int, ...]]] = {
    "NuPlanBoxDetectionLabel": {_CAR: (0,), _BICYCLE: (1,), _PEDESTRIAN: (2,)},
    "NuScenesBoxDetectionLabel": {
        _CAR: (0, 6),
        _TRUCK: (1, 4, 5, 7),
        _BUS: (2, 3),
        _BICYCLE: (8,),
        _MOTORCYCLE: (9,),
        _PEDESTRIAN: (10, 11, 12, 13, 14, 15, 16),
    },
    "WODMotionBoxDetectionLabel": {_CAR: (1,), _PEDESTRIAN: (2,), _BICYCLE: (3,)},
    "WODPerceptionBoxDetectionLabel": {_CAR: (1,), _PEDESTRIAN: (2,), _BICYCLE: (4,)},
    "PandasetBoxDetectionLabel": {
        _CAR: (3, 4, 7, 8, 11, 12, 13, 17, 21, 24),
        _BUS: (25, 26),
        _BICYCLE: (2, 9, 10),
        _PEDESTRIAN: (14, 15),
    },
    "KITTI360BoxDetectionLabel": {
        _CAR: (2, 3, 4, 14, 17),
        _BUS: (15,),
        _BICYCLE: (0, 6),
        _PEDESTRIAN: (7, 9),
    },
    "PhysicalAIAVBoxDetectionLabel": {
        _CAR: (0, 2, 3, 4, 8, 11),
        _BUS: (10,),
        _BICYCLE: (6,),
        _PEDESTRIAN: (1,),
    },
    "NureasoningBoxDetectionLabel": {_CAR: (0, 7, 8), _BICYCLE: (1, 9, 10), _PEDESTRIAN: (2, 11)},
    "GriffinBoxDetectionLabel": {_CAR: (1, 2, 3), _BICYCLE: (4, 5), _PEDESTRIAN: (0,)},
    "TruckDriveBoxDetectionLabel": {_CAR: (1, 4, 5, 6, 8), _BICYCLE: (0,), _PEDESTRIAN: (2,)},
    "DefaultBoxDetectionLabel": {_CAR: (1,), _BUS: (2,), _BICYCLE: (3,), _PEDESTRIAN: (4,)},
}
"""Label numbers by kind and label class; numbers that are not listed are objects."""
_AV2 = "AV2SensorBoxDetectionLabel"


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
        drive, given = _ego(rows, notes)
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
    boxes, own, seen = _boxes(folder, int(rows.time_us[0]), places, notes)
    frames = (frames_us - rows.time_us[0]) / 1e6
    index = kept(drive.t, frames)
    if not (given and own):
        index = from_second(index, drive.t, frames[:1], notes)
    ego, boxes, origin = from_start(drive, index, boxes)
    start, start_us = float(drive.t[index[0]]), int(rows.time_us[index[0]])
    tracks = tracks_of(boxes, notes)
    road, lights = road_of(
        folder, about, ego, (float(origin[0]), float(origin[1])), start_us, notes
    )
    if (folder / "route_position.arrow").exists():
        notes.append("route_position is the ego's own later path: not read.")
    dataset = str(about.get("dataset") or "")
    how = (
        ("recorded",)
        if dataset.startswith(_RECORDED)
        else ("synthetic",)
        if dataset.startswith(_SIMULATED)
        else ()
    )
    return Scenario(
        name=str(about.get("log_name") or folder.name),
        ego=ego,
        tracks=tracks,
        road=road,
        duration=float(ego.t[-1]),
        vehicle=vehicle,
        tags=("123d", *how, *((dataset,) if dataset else ())),
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
        traffic=of_stream(seen - start),
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
        times, at = np.unique(times, return_index=True)
        poses = vectors(table[f"{EGO}.imu_se3"], 7)[at]
        if not np.isfinite(poses).all():
            k = int(np.argmin(np.isfinite(poses).all(axis=1)))
            raise LogError(
                "a pose of the ego is missing or not finite", time_ns=1000 * int(times[k])
            )
        name = f"{EGO}.dynamic_state_se3"
        there = name in table.schema.names
        dynamic = vectors(table[name], 9)[at] if there else np.full((len(at), 9), np.nan)
        return EgoRows(times, poses[:, :3], unit_of_wxyz(poses[:, 3:]), dynamic, metadata_of(table))


# Ego


def _ego(rows: EgoRows, notes: list[str]) -> tuple[Trajectory, bool]:
    """Return all states of the rear axle, s since the first, and whether the log has their
    velocities.
    """
    t = (rows.time_us - rows.time_us[0]) / 1e6
    axle = rows.part("rear_axle_to_imu_se3")
    place, yaw = rows.world(axle)[:, :2], np.unwrap(heading(rows.q))
    stored, moving = (
        rows.dynamic[:, :3],
        np.isfinite(rows.dynamic[:, [0, 8]]).all() and rows.dynamic[:, :3].any(),
    )
    owner = np.zeros(len(t), np.int64)
    if not moving or _is_differenced(t, rows.position, rotated(rows.q, stored), owner):
        return driven(t, place[:, 0], place[:, 1], yaw, notes), False
    rate = rows.dynamic[:, 8]
    v = rows.dynamic[:, 0] - rate * axle[1]
    a = rows.dynamic[:, 3] - rate**2 * axle[0]
    columns = {
        "t": t,
        "x": place[:, 0],
        "y": place[:, 1],
        "yaw": yaw,
        "v": v,
        "a": a,
        "kappa": held_curvature(rate, v),
    }
    return completed(columns, notes), True


def _is_differenced(
    t: FloatArray, place: FloatArray, velocity: FloatArray, owner: IntArray
) -> bool:
    """Return whether most world velocities are central differences of the places `(m, 3)`, and
    first ones forward.

    Samples are ordered by owner and time.
    """
    alike = np.r_[False, owner[1:] == owner[:-1], False]
    inner, first = np.flatnonzero(alike[:-1] & alike[1:]), np.flatnonzero(~alike[:-1] & alike[1:])
    if not len(inner):
        return False
    central, backward = (_differences(t, place, at, inner - 1) for at in (inner + 1, inner))
    telling = inner[np.abs(central - backward).max(axis=1) > TELLING_MPS]
    known = np.asarray(np.isfinite(velocity).all(axis=1))
    telling, first = telling[known[telling]], first[known[first]]
    if not len(telling) or not len(first):
        return False
    away = np.abs(_differences(t, place, telling + 1, telling - 1) - velocity[telling]).max(axis=1)
    begin = np.abs(_differences(t, place, first + 1, first) - velocity[first]).max(axis=1)
    return bool(np.median(away) < SAME_MPS and np.median(begin) < SAME_MPS)


def _differences(
    t: FloatArray, place: FloatArray, after: IntArray, earlier: IntArray
) -> FloatArray:
    span = np.maximum(t[after] - t[earlier], 1e-6)
    return np.asarray((place[after] - place[earlier]) / span[:, None])


# Agents


def _boxes(
    folder: Path, first_us: int, places: FloatArray, notes: list[str]
) -> tuple[RecordedBoxes, bool, FloatArray]:
    """Return all boxes, s since `first_us`, whether the log has their velocities, and the times of
    their frames.

    Boxes above or below the ego's `places` `(n, 3)` are left out.
    """
    path = beside(folder, (f"{BOXES}.arrow",))
    if path is None:
        notes.append("The log has no boxes: there are no other road users.")
        return RecordedBoxes.empty(), True, np.empty(0)
    columns = [
        f"{BOXES}.{name}" for name in ("timestamp_us", "bounding_box_se3", "track_token", "label")
    ]
    table = ipc_table(path, columns)
    with reading(path):
        lists = Lists(table, columns[1])
        box, labels = vectors(lists.items(columns[1]), 10), lists.numbers(columns[3])
        owner, names = lists.words(columns[2])
        frames = (whole(table, columns[0]) - first_us) / 1e6
        t = frames[lists.row]
        stored = f"{BOXES}.velocity_3d"
        has_velocity = stored in table.schema.names
        velocity: FloatArray = (
            vectors(lists.items(stored), 3) if has_velocity else np.full((len(t), 3), np.nan)
        )
        known, order = np.asarray(np.isfinite(velocity).all(axis=1)), np.lexsort((t, owner))
        own = False
        if not np.isfinite(velocity).any() or not velocity[np.isfinite(velocity)].any():
            notes.append(
                "The log has no velocities of the other road users: backward differences of their "
                "places."
            )
        elif _is_differenced(t[order], box[order, :3], velocity[order], owner[order]):
            notes.append(
                "The velocities of the other road users are differences to the frame after: "
                "backward ones are taken."
            )
        else:
            own = True
        velocity[~known | (not own)] = np.nan
        usable = np.isfinite(box).all(axis=1) & is_unit(box[:, 3:7])
        box[~usable, :3], box[~usable, 3:7] = np.nan, (1.0, 0.0, 0.0, 0.0)
        # The most frequent label and the median length of each
        label, size = most_common(labels, owner, len(names)), np.zeros(len(names))
        there = np.unique(owner)
        order = np.argsort(owner, kind="stable")
        parts = np.split(box[order, 7], np.unique(owner[order], return_index=True)[1][1:])
        size[there] = [np.median(lengths) for lengths in parts]
        kinds = kinds_of(
            str(metadata_of(table).get("box_detection_label_class") or ""), label, size, notes
        )
        place, yaw = box[:, :2], heading(unit_of_wxyz(box[:, 3:7]))
        x, y, length, width, vx, vy = *place.T, *box[:, 7:9].T, *velocity[:, :2].T
        z, height = box[:, 2], box[:, 9]
        found = RecordedBoxes(
            tuple(names), kinds, t, owner, x, y, yaw, length, width, vx, vy, z, height
        )
        return ordered(on_level(found, places, notes), notes), own, frames


def kinds_of(
    label_class: str, labels: IntArray, length: FloatArray, notes: list[str]
) -> tuple[AgentKind, ...]:
    """Return the kinds of road users `(n,)` by label and, if the label is only "vehicle", by length
    in m.
    """
    key = label_class.rsplit(".", 1)[-1]
    if key == _AV2:
        names = [kind_of_word(name) or _OBJECT for name in AV2_CATEGORIES]
        return tuple(names[i] if 0 <= i < len(names) else _OBJECT for i in labels)
    if key not in KINDS:
        notes.append(
            f"The labels '{key[:60]}' are not known: the kinds of road users are derived from "
            "their lengths."
        )
        sized = [_OBJECT, _PEDESTRIAN, _BICYCLE, _CAR, _TRUCK]
        return tuple(sized[int(np.searchsorted([0.0, 1.2, 2.7, LONG_M], size))] for size in length)
    by_number = {number: kind for kind, numbers in KINDS[key].items() for number in numbers}
    kinds = [by_number.get(int(label), _OBJECT) for label in labels]
    long = [kind is _CAR and size > LONG_M for kind, size in zip(kinds, length, strict=True)]
    if any(long):
        notes.append(f"{sum(long)} vehicles are longer than {LONG_M} m and taken as lorries.")
    return tuple(_TRUCK if is_long else kind for kind, is_long in zip(kinds, long, strict=True))


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
        what = "a 123D log of py123d 0.0.8 or 0.0.9: one file with other tables"
        raise LogError(
            what, file=path, remedy="convert the data set again with py123d 0.1.0 or newer"
        )
    with reading(folder_of(path)):
        return read_123d(folder_of(path))


def _files(path: Path) -> tuple[Path, ...]:
    """Return the files that are read; camera and lidar files are not among them."""
    if not (path.is_dir() or path.name == SYNC):
        return (path,)
    folder = folder_of(path)
    found = [folder / f"{name}.arrow" for name in ("sync", EGO, BOXES, LIGHTS)]
    try:
        found.append(map_of(folder, read_frames(folder)[1]) or folder / "map.arrow")
    except LogError:
        found.append(folder / "map.arrow")
    return tuple(file for file in found if file.is_file())


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
        for key in (name for name in table.schema.names if not name.startswith("sync.")):
            own = times[~np.asarray(table[key].is_null())]
            first, last = (1000 * int(own[0]), 1000 * int(own[-1])) if len(own) else (None, None)
            topics.append(
                TopicSummary(
                    key, key.split(".", maxsplit=1)[0], "arrow", "arrow", len(own), first, last
                )
            )
        what = (
            f"123D log of {about.get('dataset')}, py123d {about.get('version')}, {len(times)} "
            "frames"
        )
        return LogContents(what, tuple(topics))
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
