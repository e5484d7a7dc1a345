"""An Argoverse 2 sensor log -> Scenario.

city_SE3_egovehicle.feather has the ego's pose, which is that of its rear axle, some 170 times a second; the
annotations have boxes in the ego's frame, 10 times a second, each time at one of these poses:

(1) box centre = p + q b q*,  heading of q q_box             p, q the ego's pose at the box's time

There are no velocities: the ego's are derived from the poses before each state, the agents' are left to be differenced
backwards, and the scenario begins at the second frame, so that there is something before it. The box of the category
EGO_VEHICLE, which some logs have, is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from logs.agents import AgentKind
from logs.errors import LogError
from logs.kernel import FloatArray, IntArray
from logs.observed import of_stream
from logs.readers.argoverse2 import POSES
from logs.readers.argoverse2.map import map_beside, road_for
from logs.readers.arrow123d.labels import AV2_CATEGORIES
from logs.readers.base import Contents, LogSettings, TopicSummary, beside
from logs.readers.recorded.boxes import Boxes, car_of, ordered, tracks_of
from logs.readers.recorded.poses import (
    composed,
    driven,
    from_second,
    is_unit,
    kept,
    rotated,
    since,
    states_at,
    unit,
    yaw_of,
)
from logs.readers.recorded.tables import ipc_table, numbers, reading, whole, words
from logs.scenario import Scenario
from logs.vehicle import VehicleParameters

FORD_FUSION = {"length": 4.869, "width": 2.127, "wheelbase": 2.850, "rear_overhang": 0.5 * 4.869 - 1.339}
"""The recording car, m (py123d 0.7.0): the width is with mirrors, the centre 1.339 m ahead of the rear axle."""
EGO_CATEGORY = "EGO_VEHICLE"
TURN, PLACE, SIZE = ("qw", "qx", "qy", "qz"), ("tx_m", "ty_m", "tz_m"), ("length_m", "width_m")
POSE_APART_NS = 20_000_000
"""A box is placed by a pose not farther from it in time than this."""
LICENCE = "CC BY-NC-SA 4.0 and the terms of Argoverse 2"


def annotations_of(folder: Path) -> Path | None:
    """The file of the boxes: annotations.feather, else the first of annotations*.feather."""
    found = sorted(
        folder.glob("annotations*.feather"), key=lambda path: (path.name != "annotations.feather", path.name)
    )
    return found[0] if found else None


def files_of(folder: Path) -> tuple[Path, ...]:
    """The files of a log that are read."""
    found = (folder / POSES, annotations_of(folder), map_beside(folder))
    return tuple(path for path in found if path is not None)


def contents_of(folder: Path) -> Contents:
    """Poses and boxes with their times."""
    topics = []
    for path in (folder / POSES, annotations_of(folder)):
        if path is None:
            continue
        try:
            times = whole(ipc_table(path, ("timestamp_ns",)), "timestamp_ns")
        except (LogError, ValueError):
            continue
        first, last = (int(times.min()), int(times.max())) if len(times) else (None, None)
        what = "poses" if path.name == POSES else "boxes"
        topics.append(TopicSummary(path.name, what, "arrow", "feather", len(times), first, last))
    return Contents("Argoverse 2 sensor log", tuple(topics))


def poses_of(folder: Path) -> tuple[IntArray, FloatArray, FloatArray]:
    """Times ns `(n,)`, increasing strictly, places `(n, 3)` and unit quaternions `(n, 4)` of the ego."""
    path = folder / POSES
    table = ipc_table(path, ("timestamp_ns", *TURN, *PLACE))
    with reading(path):
        times, at = np.unique(whole(table, "timestamp_ns"), return_index=True)
        if not len(times):
            raise LogError("the log has no ego poses")
        place, turn = (np.column_stack([numbers(table, name)[at] for name in names]) for names in (PLACE, TURN))
        if not (np.isfinite(place).all() and np.isfinite(turn).all()):
            k = int(np.argmin(np.isfinite(np.hstack([place, turn])).all(axis=1)))
            raise LogError("a pose of the ego is not finite", time_ns=int(times[k]))
        return times, place, unit(turn)


def read_sensor_log(folder: Path, settings: LogSettings) -> Scenario:
    """Read the log in a folder (module docstring); LogError where it cannot be used."""
    notes: list[str] = []
    times, place, turn = poses_of(folder)
    boxes, frames = _boxes(folder, times, place, turn, notes)
    t = (times - times[0]) / 1e9
    with reading(folder / POSES):
        apart = np.r_[True, np.diff(t) > 1e-4] | np.isin(times, frames)
        drive = driven(t[apart], place[apart, 0], place[apart, 1], yaw_of(turn[apart]), notes)
        relative = (frames - times[0]) / 1e9
        index = from_second(kept(drive.t, relative), drive.t, relative[:1], notes)
        ego, vehicle = states_at(drive, index), _vehicle(settings.car, notes)
    start, origin = float(ego.t[0]), np.round([ego.x[0], ego.y[0]])
    ego = replace(ego, t=since(start, ego.t), x=ego.x - origin[0], y=ego.y - origin[1])
    boxes = replace(boxes, t=since(start, boxes.t), x=boxes.x - origin[0], y=boxes.y - origin[1])
    tracks = tracks_of(ordered(boxes, notes), notes)
    return Scenario(
        name=folder.name,
        ego=ego,
        tracks=tracks,
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
        traffic=of_stream((frames - times[0]) / 1e9 - start),
    )


def _vehicle(car: Mapping[str, float], notes: list[str]) -> VehicleParameters:
    if not car:
        notes.append("The ego is a Ford Fusion, 4.87 x 2.13 m with mirrors, as the log has no sizes of it.")
    return car_of({**FORD_FUSION, **car}, notes)


def _boxes(
    folder: Path, times: IntArray, place: FloatArray, turn: FloatArray, notes: list[str]
) -> tuple[Boxes, IntArray]:
    """All boxes in the city's frame (1), s since the first pose, and the times of the frames, ns."""
    path, none = beside(folder, ("annotations.feather",)) or annotations_of(folder), np.empty(0)
    if path is None:
        notes.append("The log has no annotations: there are no other road users.")
        return Boxes((), (), none, none.astype(np.int64), *(none,) * 7), none.astype(np.int64)
    table = ipc_table(path, ("timestamp_ns", "track_uuid", "category", *SIZE, *TURN, *PLACE))
    with reading(path):
        (owner, names), (category, categories) = words(table, "track_uuid"), words(table, "category")
        stamps = whole(table, "timestamp_ns")
        local, length, width = (numbers(table, name) for name in ("tx_m", *SIZE))
        local = np.column_stack([local, numbers(table, "ty_m"), numbers(table, "tz_m")])
        part = np.column_stack([numbers(table, name) for name in TURN])
        at, apart = _nearest(times, stamps)
        if len(stamps) and not (apart <= POSE_APART_NS).any():
            spans = [f"{some.min() / 1e9:.3f} to {some.max() / 1e9:.3f} s" for some in (stamps, times)]
            what = f"times from {spans[0]}, the ego's are from {spans[1]}: they do not overlap"
            raise LogError(what, file=folder, topic=path.name, remedy="give both times of one clock")
        usable = (apart <= POSE_APART_NS) & np.isfinite(local).all(axis=1)
        usable &= is_unit(part)
        if not usable.all():
            notes.append(
                f"{(~usable).sum()} of {len(usable)} boxes have no ego pose or no pose of their own: left out."
            )
        keep = usable & (np.array([name != EGO_CATEGORY for name in categories], dtype=bool)[category])
        at = at[keep]
        centre = place[at] + rotated(turn[at], local[keep])
        yaw = yaw_of(composed(turn[at], unit(part[keep])))
        t, unknown = (stamps[keep] - times[0]) / 1e9, np.full(len(at), np.nan)
        kinds = _kinds(len(names), owner, category, categories, notes)
        found = (t, owner[keep], centre[:, 0], centre[:, 1], yaw, length[keep], width[keep], unknown, unknown)
        return Boxes(tuple(names), kinds, *found), np.unique(stamps)


def _nearest(times: IntArray, stamps: IntArray) -> tuple[IntArray, IntArray]:
    """The nearest of the sorted `times` to each stamp, and how far away it is."""
    after = np.clip(np.searchsorted(times, stamps), 0, len(times) - 1)
    earlier = np.maximum(after - 1, 0)
    at = np.where(np.abs(times[earlier] - stamps) < np.abs(times[after] - stamps), earlier, after)
    return at, np.abs(times[at] - stamps)


def _kinds(
    count: int, owner: IntArray, category: IntArray, categories: list[str], notes: list[str]
) -> tuple[AgentKind, ...]:
    """The kind of each of `count` road users, by their first category."""
    foreign = sorted(name for name in categories if name not in AV2_CATEGORIES and name != EGO_CATEGORY)
    if foreign:
        notes.append(f"Categories that are not known are taken as objects: {', '.join(foreign)[:200]}.")
    first: dict[int, Any] = {}
    for i, word in zip(owner.tolist(), category.tolist(), strict=True):
        first.setdefault(i, categories[word])
    return tuple(AV2_CATEGORIES.get(first.get(i, ""), AgentKind.OBJECT) for i in range(count))
