"""Reads the boxes of road users in 123D logs.

If a data set has no velocities, py123d fills them with differences between the frames before and
after: those are not read.

Labels. The files store a number of the data set's enumeration, and the dotted path of its class
(`KINDS` has the classes of py123d 0.1.0 to 0.7.0, by the last part of that path). The class is
never imported. For an unknown class, the kinds are derived from the lengths.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.arrow_tables import Lists, ipc_table, metadata_of, reading, vectors, whole
from replan.core.files import beside
from replan.logs.agents import AgentKind, ObjectClass
from replan.logs.kind_words import kind_of_word, most_common
from replan.logs.readers.recorded import (
    RecordedBoxes,
    heading,
    is_unit,
    on_level,
    ordered,
    unit_of_wxyz,
)

BOXES = "box_detections_se3"
SAME_MPS = 1e-5
"""Tolerance of equal velocities, m/s: with whole microseconds, differences at 10 m/s are exact
within 2e-6 m/s.
"""
TELLING_MPS = 1e-4
"""Differences to both sides that are closer than this do not show how a velocity was computed,
m/s.
"""
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
CLASSES: dict[str, dict[ObjectClass, tuple[int, ...]]] = {
    "AV2SensorBoxDetectionLabel": {
        ObjectClass.CONE: (7, 8),
        ObjectClass.SIGN: (11, 12, 20, 21),
    },
    "NuPlanBoxDetectionLabel": {
        ObjectClass.CONE: (3,),
        ObjectClass.BARRIER: (4,),
        ObjectClass.SIGN: (5,),
    },
    "NuScenesBoxDetectionLabel": {ObjectClass.CONE: (17,), ObjectClass.BARRIER: (18,)},
    "WODPerceptionBoxDetectionLabel": {ObjectClass.SIGN: (3,)},
    "PandasetBoxDetectionLabel": {
        ObjectClass.CONE: (5, 18),
        ObjectClass.BARRIER: (19, 23),
        ObjectClass.SIGN: (6, 22),
    },
    "KITTI360BoxDetectionLabel": {ObjectClass.SIGN: (11, 13)},
    "NureasoningBoxDetectionLabel": {ObjectClass.CONE: (3, 12), ObjectClass.SIGN: (4,)},
    "TruckDriveBoxDetectionLabel": {ObjectClass.BARRIER: (3,), ObjectClass.SIGN: (7,)},
}
"""Label numbers by class of object and label class."""
_AV2 = "AV2SensorBoxDetectionLabel"
BOX_COLUMNS = np.cumsum([3, 4])
"""Where the quaternion and the size of a box begin, behind its centre."""


def read_boxes(
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
    times, box, token, label = (
        f"{BOXES}.{name}" for name in ("timestamp_us", "bounding_box_se3", "track_token", "label")
    )
    table = ipc_table(path, [times, box, token, label])
    with reading(path):
        lists = Lists(table, box)
        boxes, labels = vectors(lists.items(box), 10), lists.numbers(label)
        owner, ids = lists.words(token)
        frames = (whole(table, times) - first_us) / 1e6
        t = frames[lists.row]
        centre, q, size = np.hsplit(boxes, BOX_COLUMNS)
        velocity, has_velocities = _velocities(table, lists, t, centre, owner, notes)
        is_usable = np.isfinite(boxes).all(axis=1) & is_unit(q)
        centre[~is_usable], q[~is_usable] = np.nan, (1.0, 0.0, 0.0, 0.0)
        (x, y, z), (length, width, height) = centre.T, size.T
        vx, vy, _ = velocity.T
        label_class = str(metadata_of(table).get("box_detection_label_class") or "")
        most_labels = most_common(labels, owner, len(ids))
        kinds = kinds_of(label_class, most_labels, _median(length, owner, len(ids)), notes)
        recorded = RecordedBoxes(
            tuple(ids),
            kinds,
            t,
            owner,
            x,
            y,
            heading(unit_of_wxyz(q)),
            length,
            width,
            vx,
            vy,
            z,
            height,
            _classes_of(label_class, ids, most_labels),
        )
        return ordered(on_level(recorded, places, notes), notes), has_velocities, frames


def _velocities(
    table: Any, lists: Lists, t: FloatArray, centre: FloatArray, owner: IntArray, notes: list[str]
) -> tuple[FloatArray, bool]:
    """Return the velocities `(m, 3)` of boxes, NaN where they are unknown, and whether the log has
    them.
    """
    name = f"{BOXES}.velocity_3d"
    unknown = np.full((len(t), 3), np.nan)
    velocity: FloatArray = vectors(lists.items(name), 3) if name in table.schema.names else unknown
    is_finite = np.isfinite(velocity)
    order = np.lexsort((t, owner))
    if not velocity[is_finite].any():
        notes.append(
            "The log has no velocities of the other road users: backward differences of their "
            "places."
        )
        return unknown, False
    if is_differenced(t[order], centre[order], velocity[order], owner[order]):
        notes.append(
            "The velocities of the other road users are differences to the frame after: "
            "backward ones are taken."
        )
        return unknown, False
    return np.where(is_finite.all(axis=1, keepdims=True), velocity, np.nan), True


def _median(values: FloatArray, owner: IntArray, count: int) -> FloatArray:
    """Return the median of the values `(m,)` of each owner `(count,)`; 0 of one without values."""
    medians = np.zeros(count)
    order = np.argsort(owner, kind="stable")
    owners, firsts = np.unique(owner[order], return_index=True)
    medians[owners] = [np.median(part) for part in np.split(values[order], firsts[1:])]
    return medians


def is_differenced(t: FloatArray, place: FloatArray, velocity: FloatArray, owner: IntArray) -> bool:
    """Return whether most world velocities are central differences of the places `(m, 3)`, and
    first ones forward.

    Samples are ordered by owner and time.
    """
    is_same_owner = np.r_[False, owner[1:] == owner[:-1], False]
    has_earlier, has_later = is_same_owner[:-1], is_same_owner[1:]
    inner, first = np.flatnonzero(has_earlier & has_later), np.flatnonzero(~has_earlier & has_later)
    if not len(inner):
        return False
    central = _differences(t, place, inner + 1, inner - 1)
    backward = _differences(t, place, inner, inner - 1)
    inner = inner[np.abs(central - backward).max(axis=1) > TELLING_MPS]
    is_known = np.asarray(np.isfinite(velocity).all(axis=1))
    inner, first = inner[is_known[inner]], first[is_known[first]]
    if not len(inner) or not len(first):
        return False
    central = _differences(t, place, inner + 1, inner - 1)
    forward = _differences(t, place, first + 1, first)
    inner_error = np.abs(central - velocity[inner]).max(axis=1)
    first_error = np.abs(forward - velocity[first]).max(axis=1)
    return bool(np.median(inner_error) < SAME_MPS and np.median(first_error) < SAME_MPS)


def _differences(
    t: FloatArray, place: FloatArray, after: IntArray, earlier: IntArray
) -> FloatArray:
    span = np.maximum(t[after] - t[earlier], 1e-6)
    return np.asarray((place[after] - place[earlier]) / span[:, None])


def _classes_of(label_class: str, ids: Sequence[str], labels: IntArray) -> dict[str, ObjectClass]:
    """Return the classes of the objects among road users by id, of those whose label names one."""
    of_labels = CLASSES.get(label_class.rsplit(".", 1)[-1], {})
    by_number = {number: named for named, numbers in of_labels.items() for number in numbers}
    labelled = zip(ids, labels.tolist(), strict=True)
    return {name: by_number[label] for name, label in labelled if label in by_number}


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
    long = [i for i, kind in enumerate(kinds) if kind is _CAR and length[i] > LONG_M]
    for i in long:
        kinds[i] = _TRUCK
    if long:
        notes.append(f"{len(long)} vehicles are longer than {LONG_M} m and taken as lorries.")
    return tuple(kinds)
