"""Reads published Argoverse 2 data: sensor logs (feather files) and motion-forecasting scenarios
(Parquet).

Sensor logs. city_SE3_egovehicle.feather has the pose of the ego's rear axle, some 170 times a
second. The annotations have boxes in the ego's frame, 10 times a second, each at the time of one of
these poses:

(1) box centre = p + q b q*,  heading of q q_box
        p, q the ego's pose at the time of the box

The logs have no velocities. Those of the ego are derived from the poses before each state, those of
the agents by backward differences, and the scenario begins at the second frame, so that every state
has earlier poses. The box of the category EGO_VEHICLE, which some logs have, is left out.

Motion-forecasting scenarios are 11 s of tracks at 10 Hz, with velocities and without sizes. The ego
is the track "AV" (`ego` of the settings: another vehicle). Positions are taken as centres of boxes,
and sizes are those usual for the kind. All 11 s are read, the part to be predicted included, as a
replay needs it.

Maps (log_map_archive_*.json) have lane segments with markings, and pedestrian crossings. They have
no speed limits, stop lines, traffic lights or right of way. Drivable areas are not read.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.arrow_tables import ipc_table, numbers, parquet_table, reading, whole, words
from replan.core.errors import LogError
from replan.core.files import beside
from replan.logs.agents import AgentKind
from replan.logs.complete import completed, road_along, with_limit
from replan.logs.kind_words import kind_of_word, most_common, object_classes
from replan.logs.log_settings import LogSettings
from replan.logs.maps.strips import LARGEST_M, LaneStrip, lanes_of
from replan.logs.observed import of_stream
from replan.logs.readers.arrow123d_boxes import AV2_CATEGORIES
from replan.logs.readers.base import LogContents, Reader, TopicSummary
from replan.logs.readers.recorded import (
    RecordedBoxes,
    driven,
    from_second,
    from_start,
    heading,
    is_unit,
    kept,
    nearest,
    on_level,
    ordered,
    product,
    rotated,
    tracks_of,
    unit_of_wxyz,
)
from replan.logs.road import IN_JUNCTION, Road
from replan.logs.rules import Crosswalk
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.vehicle import assumed_car

FORD_FUSION = {
    "length": 4.869,
    "width": 2.127,
    "wheelbase": 2.850,
    "rear_overhang": 0.5 * 4.869 - 1.339,
}
"""The recording car, m (py123d 0.7.0): the width is with mirrors, the centre 1.339 m ahead of the
rear axle.
"""
LICENCE = "CC BY-NC-SA 4.0 and the terms of Argoverse 2"
EGO_CATEGORY = "EGO_VEHICLE"
TURN, PLACE, SIZE = (
    ("qw", "qx", "qy", "qz"),
    ("tx_m", "ty_m", "tz_m"),
    ("length_m", "width_m"),
)
HEIGHT = "height_m"
POSE_APART_NS = 20_000_000
"""Largest time between a box and the ego pose that places it, ns."""
EGO, RATE_HZ, MOST_STEPS = "AV", 10.0, 1_000_000
STATE = ("position_x", "position_y", "heading", "velocity_x", "velocity_y")
LANE_TYPES = {"VEHICLE": "surface_street", "BIKE": "bike_lane", "BUS": "bus_lane"}
"""123D's names of lane types, by Argoverse's."""
POSES = "city_SE3_egovehicle.feather"
SCENARIO = "scenario_*.parquet"


# Sensor logs


def annotations_of(folder: Path) -> Path | None:
    """Return the file of the boxes: annotations.feather, else the first of annotations*.feather."""
    usual = folder / "annotations.feather"
    files = sorted(folder.glob("annotations*.feather"))
    return usual if usual in files else next(iter(files), None)


def poses_of(folder: Path) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the ego's times ns `(n,)`, increasing strictly, positions `(n, 3)` m and quaternions
    (x, y, z, w).
    """
    path = folder / POSES
    table = ipc_table(path, ("timestamp_ns", *TURN, *PLACE))
    with reading(path):
        times, rows = np.unique(whole(table, "timestamp_ns"), return_index=True)
        if not len(times):
            raise LogError("the log has no ego poses")
        place, turn = (
            np.column_stack([numbers(table, name)[rows] for name in names])
            for names in (PLACE, TURN)
        )
        if not (np.isfinite(place).all() and np.isfinite(turn).all()):
            k = int(np.argmin(np.isfinite(np.hstack([place, turn])).all(axis=1)))
            raise LogError("a pose of the ego is not finite", time_ns=int(times[k]))
        return times, place, unit_of_wxyz(turn)


def read_sensor_log(folder: Path, settings: LogSettings) -> Scenario:
    """Read the scenario in the folder of a sensor log; LogError if it is damaged or its boxes are
    on another clock.
    """
    notes: list[str] = []
    times, place, turn = poses_of(folder)
    boxes, frames = _boxes(folder, times, place, turn, notes)
    t = (times - times[0]) / 1e9
    with reading(folder / POSES):
        apart = np.r_[True, np.diff(t) > 1e-4] | np.isin(times, frames)
        drive = driven(t[apart], place[apart, 0], place[apart, 1], heading(turn[apart]), notes)
        relative = (frames - times[0]) / 1e9
        index = from_second(kept(drive.t, relative), drive.t, relative[:1], notes)
        if not settings.car:
            notes.append(
                "The ego is a Ford Fusion, 4.87 x 2.13 m with mirrors, as the log has no sizes of "
                "it."
            )
        vehicle = assumed_car({**FORD_FUSION, **settings.car}, notes)
        ego, before, boxes, origin = from_start(drive, index, boxes)
    tracks = tracks_of(ordered(boxes, notes), notes)
    return Scenario(
        name=folder.name,
        ego=ego,
        before=before,
        tracks=tracks,
        object_classes=boxes.object_classes,
        road=road_for(map_beside(folder), origin, ego, notes),
        duration=float(ego.t[-1]),
        vehicle=vehicle,
        tags=("argoverse2", "recorded"),
        source="Argoverse 2 sensor log",
        licence=LICENCE,
        origin=(float(origin[0]), float(origin[1])),
        start_ns=int(times[np.flatnonzero(apart)[index[0]]]),
        metadata={"log_id": folder.name},
        notes=tuple(notes),
        traffic=of_stream(relative - float(drive.t[index[0]])),
    )


def _boxes(
    folder: Path, times: IntArray, place: FloatArray, turn: FloatArray, notes: list[str]
) -> tuple[RecordedBoxes, IntArray]:
    """Return all boxes in the city's frame (1), timed in s since the first pose, and the times of
    the frames, ns.
    """
    path = beside(folder, ("annotations.feather",)) or annotations_of(folder)
    if path is None:
        notes.append("The log has no annotations: there are no other road users.")
        return RecordedBoxes.empty(), np.empty(0, np.int64)
    table = ipc_table(path, ("timestamp_ns", "track_uuid", "category", *SIZE, *TURN, *PLACE))
    with reading(path):
        (owner, names), (category, categories) = (
            words(table, "track_uuid"),
            words(table, "category"),
        )
        stamps = whole(table, "timestamp_ns")
        length, width = (numbers(table, name) for name in SIZE)
        has_height = HEIGHT in table.schema.names
        height = numbers(table, HEIGHT) if has_height else np.full(len(length), np.nan)
        local, part = (
            np.column_stack([numbers(table, name) for name in names]) for names in (PLACE, TURN)
        )
        rows = nearest(times, stamps)
        near = np.abs(times[rows] - stamps) <= POSE_APART_NS
        if len(stamps) and not near.any():
            spans = [
                f"{times_ns.min() / 1e9:.3f} to {times_ns.max() / 1e9:.3f} s"
                for times_ns in (stamps, times)
            ]
            problem = f"times from {spans[0]}, the ego's are from {spans[1]}: they do not overlap"
            raise LogError(
                problem, file=folder, topic=path.name, remedy="give both times of one clock"
            )
        usable = near & np.isfinite(local).all(axis=1) & is_unit(part)
        if not usable.all():
            notes.append(
                f"{(~usable).sum()} of {len(usable)} boxes have no ego pose or no pose of their "
                "own: left out."
            )
        foreign = sorted(
            name for name in categories if name not in AV2_CATEGORIES and name != EGO_CATEGORY
        )
        keep = (
            usable & (np.array([name != EGO_CATEGORY for name in categories], dtype=bool)[category])
        )
        rows = rows[keep]
        centre = place[rows] + rotated(turn[rows], local[keep])
        yaw = heading(product(turn[rows], unit_of_wxyz(part[keep])))
        t, unknown = (stamps[keep] - times[0]) / 1e9, np.full(len(rows), np.nan)
        if foreign:
            notes.append(
                f"Categories that are not known are taken as objects: {', '.join(foreign)[:200]}."
            )
        labels = _labels(owner, category, categories, len(names))
        kinds = _kinds(labels)
        boxes_read = (
            t,
            owner[keep],
            centre[:, 0],
            centre[:, 1],
            yaw,
            length[keep],
            width[keep],
            unknown,
            unknown,
            centre[:, 2],
            height[keep],
        )
        classes = object_classes(names, kinds, labels)
        boxes = on_level(RecordedBoxes(tuple(names), kinds, *boxes_read, classes), place, notes)
        return boxes, np.unique(stamps)


def _labels(owner: IntArray, label: IntArray, labels: list[str], count: int) -> list[str]:
    """Return the most frequent label of each of `count` road users, "" without one."""
    chosen = most_common(label, owner, count)
    return [labels[code] if code >= 0 else "" for code in chosen.tolist()]


def _kinds(labels: list[str]) -> tuple[AgentKind, ...]:
    return tuple(kind_of_word(label) or AgentKind.OBJECT for label in labels)


# Motion-forecasting scenarios


def read_forecasting(path: Path, settings: LogSettings) -> Scenario:
    """Read the scenario in a Parquet file and the map beside it; LogError if it has no finite poses
    of the ego.
    """
    notes: list[str] = []
    table = parquet_table(path, ("track_id", "object_type", "timestep", *STATE))
    with reading(path):
        (owner, names), (kind, kinds) = words(table, "track_id"), words(table, "object_type")
        step = whole(table, "timestep")
        if (np.abs(step) > MOST_STEPS).any():
            raise LogError(f"a time step is beyond {MOST_STEPS}")
        state = np.column_stack([numbers(table, name) for name in STATE])
        name = settings.ego or EGO
        if name not in names:
            examples = ", ".join(names[:8]) or "none"
            raise LogError(
                f"there is no track '{name}'",
                topic="track_id",
                remedy=f"name the ego; there are {examples}",
            )
        its = np.flatnonzero(owner == names.index(name))
        its = its[np.unique(step[its], return_index=True)[1]]
        if not np.isfinite(state[its, :3]).all():
            raise LogError(f"a pose of track '{name}' is not finite")
        origin = np.round(state[its[0], :2])
        state[:, :2] -= origin
        t = (step - step[its[0]]) / RATE_HZ
        vehicle = assumed_car({**FORD_FUSION, **settings.car}, notes)
        x, y, yaw, vx, vy = state[its].T
        cos, sin = np.cos(yaw), np.sin(yaw)
        x, y = x - vehicle.axle_to_center * cos, y - vehicle.axle_to_center * sin
        v, unknown = vx * cos + vy * sin, np.full(len(its), np.nan)
        if np.isfinite(v).all():
            columns = {
                "t": t[its],
                "x": x,
                "y": y,
                "yaw": yaw,
                "v": v,
                "a": unknown,
                "kappa": unknown,
            }
            ego = completed(columns, notes)
        else:
            ego = driven(t[its], x, y, yaw, notes)
        x, y, yaw, vx, vy = state.T
        unsized = np.full(len(t), np.nan)
        kinds_of = _kinds(_labels(owner, kind, kinds, len(names)))
        boxes = RecordedBoxes(
            tuple(names), kinds_of, t, owner, x, y, yaw, unsized, unsized, vx, vy, unsized, unsized
        )
        tracks = tracks_of(ordered(boxes.taken(owner != owner[its[0]]), notes), notes)
    notes.append("Places are taken as centres of boxes.")
    return Scenario(
        name=path.stem,
        ego=ego,
        tracks=tracks,
        road=road_for(map_beside(path.parent, scenario_id(path)), origin, ego, notes),
        duration=float(ego.t[-1]),
        vehicle=vehicle,
        tags=("argoverse2", "recorded"),
        source="Argoverse 2 motion-forecasting scenario",
        licence=LICENCE,
        origin=(float(origin[0]), float(origin[1])),
        start_ns=round(1e9 * int(step[its[0]] - step.min()) / RATE_HZ),
        metadata={"scenario_id": scenario_id(path), "ego": name},
        notes=tuple(notes),
        traffic=of_stream(t),
    )


# Maps


def scenario_id(table: Path) -> str:
    """Return the id of a motion-forecasting scenario from its file name."""
    return table.stem.removeprefix("scenario_")


def map_beside(folder: Path, name: str = "*") -> Path | None:
    """Return the map in a log's folder or in its subfolder `map`; None if there is none."""
    files = sorted(
        (
            *folder.glob(f"map/log_map_archive_{name}.json"),
            *folder.glob(f"log_map_archive_{name}.json"),
        )
    )
    return files[0] if files else None


def road_for(path: Path | None, origin: FloatArray, ego: Trajectory, notes: list[str]) -> Road:
    """Read the road of a map relative to `origin` `(2,)`, with an assumed limit.

    Without a map, the driven path.
    """
    if path is None:
        return road_along(ego, notes)
    with reading(path):
        content = msgspec.json.decode(path.read_bytes())
        strips, walks = [], []
        for lane in content["lane_segments"].values():
            kind = LANE_TYPES.get(lane["lane_type"], "undefined")
            strips.append(
                LaneStrip(
                    int(lane["id"]),
                    _points(lane["left_lane_boundary"]) - origin,
                    _points(lane["right_lane_boundary"]) - origin,
                    successors=tuple(dict.fromkeys(int(i) for i in lane["successors"])),
                    beside=(lane["left_neighbor_id"], lane["right_neighbor_id"]),
                    kind=f"{kind}+{IN_JUNCTION}" if lane.get("is_intersection") else kind,
                    marks=(str(lane["left_lane_mark_type"]), str(lane["right_lane_mark_type"])),
                    drivable=kind not in ("bike_lane", "bus_lane"),
                )
            )
        lanes, keeps_right = lanes_of(strips, notes)
        if not lanes:
            raise LogError("the map has no lanes that can be used")
        for walk in content.get("pedestrian_crossings", {}).values():  # the area between two edges
            left_edge, other = (_points(walk[name]) - origin for name in ("edge1", "edge2"))
            if (
                min(len(left_edge), len(other)) < 2
                or not (np.abs(np.vstack([left_edge, other])) < LARGEST_M).all()
            ):
                continue
            if (other[-1] - other[0]) @ (left_edge[-1] - left_edge[0]) > 0.0:
                other = other[::-1]
            walks.append(Crosswalk(int(walk["id"]), np.vstack([left_edge, other])))
        rings = [
            _points(area["area_boundary"]) - origin
            for area in content.get("drivable_areas", {}).values()
        ]
        areas = tuple(ring for ring in rings if len(ring) >= 3 and (np.abs(ring) < LARGEST_M).all())
        road = Road(lanes, drives_on_right=keeps_right, crosswalks=tuple(walks), areas=areas)
    notes.append(
        "The map has no right of way, stop lines or traffic lights: priority is not known."
    )
    return with_limit(road, ego, "The lanes have no speed limits", notes)


def _points(points: list[Mapping[str, float]]) -> FloatArray:
    return np.array([(p["x"], p["y"]) for p in points], dtype=np.float64).reshape(-1, 2)


# The reader


def _claims(path: Path) -> bool:
    try:
        if path.is_dir():
            return (path / POSES).is_file() or len(list(path.glob(SCENARIO))) == 1
        return path.name == POSES or (
            path.match(SCENARIO)
            and (path.parent / f"log_map_archive_{scenario_id(path)}.json").is_file()
        )
    except OSError:
        return False


def _locate_log(path: Path) -> tuple[Path, bool]:
    """Return the folder of a sensor log (True) or the table of a motion-forecasting scenario
    (False).
    """
    if path.name == POSES:
        return path.parent, True
    if (path / POSES).is_file():
        return path, True
    return (min(path.glob(SCENARIO)) if path.is_dir() else path), False


def _read(path: Path, settings: LogSettings) -> Scenario:
    with reading(path):
        log, is_sensor_log = _locate_log(path)
        if not is_sensor_log:
            return read_forecasting(log, settings)
        if settings.ego:
            raise LogError(
                f"ego {settings.ego} is asked for, but a sensor log has its ego",
                remedy="leave ego out",
            )
        return read_sensor_log(log, settings)


def _files(path: Path) -> tuple[Path, ...]:
    log, is_sensor_log = _locate_log(path)
    scenario = (log, map_beside(log.parent, scenario_id(log)))
    files = (log / POSES, annotations_of(log), map_beside(log)) if is_sensor_log else scenario
    return tuple(file for file in files if file is not None)


def _contents(path: Path) -> LogContents:
    log, is_sensor_log = _locate_log(path)
    topics = []
    if not is_sensor_log:
        try:
            count = len(whole(parquet_table(log, ("timestep",)), "timestep"))
        except (LogError, ValueError):
            return LogContents("Argoverse 2 motion-forecasting scenario that cannot be read")
        topics.append(TopicSummary("tracks", "parquet", "parquet", "parquet", count, None, None))
        return LogContents("Argoverse 2 motion-forecasting scenario", tuple(topics))
    for file in (log / POSES, annotations_of(log)):
        if file is None:
            continue
        try:
            times = whole(ipc_table(file, ("timestamp_ns",)), "timestamp_ns")
        except (LogError, ValueError):
            continue
        first, last = (int(times.min()), int(times.max())) if len(times) else (None, None)
        kind = "poses" if file.name == POSES else "boxes"
        topics.append(TopicSummary(file.name, kind, "arrow", "feather", len(times), first, last))
    return LogContents("Argoverse 2 sensor log", tuple(topics))


READER = Reader(
    "argoverse2",
    "Argoverse 2 sensor logs and motion-forecasting scenarios",
    f"folders with {POSES} or {SCENARIO}",
    (),
    _claims,
    _read,
    files=_files,
    contents=_contents,
    settings=("ego", "car"),
)
