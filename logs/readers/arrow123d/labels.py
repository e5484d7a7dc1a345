"""What the numbers of 123D's label classes mean: agent kinds by number, of the classes of py123d 0.1.0 to 0.7.0.

The files store the number in the data set's own enumeration and the dotted path of its class, of which the last part
is the key here; the class is never imported. A class that is not known: kinds by size.
"""

from __future__ import annotations

import numpy as np

from logs.agents import AgentKind
from logs.kernel import FloatArray, IntArray

_CAR, _TRUCK, _BUS, _MOTORCYCLE = AgentKind.CAR, AgentKind.TRUCK, AgentKind.BUS, AgentKind.MOTORCYCLE
_BICYCLE, _PEDESTRIAN, _OBJECT = AgentKind.BICYCLE, AgentKind.PEDESTRIAN, AgentKind.OBJECT
LONG_M = 6.5
"""A vehicle of no nearer description that is longer is a lorry."""

AV2_CATEGORIES = {
    "ANIMAL": _OBJECT, "ARTICULATED_BUS": _BUS, "BICYCLE": _BICYCLE, "BICYCLIST": _BICYCLE, "BOLLARD": _OBJECT,
    "BOX_TRUCK": _TRUCK, "BUS": _BUS, "CONSTRUCTION_BARREL": _OBJECT, "CONSTRUCTION_CONE": _OBJECT, "DOG": _OBJECT,
    "LARGE_VEHICLE": _TRUCK, "MESSAGE_BOARD_TRAILER": _OBJECT, "MOBILE_PEDESTRIAN_CROSSING_SIGN": _OBJECT,
    "MOTORCYCLE": _MOTORCYCLE, "MOTORCYCLIST": _MOTORCYCLE, "OFFICIAL_SIGNALER": _PEDESTRIAN,
    "PEDESTRIAN": _PEDESTRIAN, "RAILED_VEHICLE": _BUS, "REGULAR_VEHICLE": _CAR, "SCHOOL_BUS": _BUS, "SIGN": _OBJECT,
    "STOP_SIGN": _OBJECT, "STROLLER": _PEDESTRIAN, "TRAFFIC_LIGHT_TRAILER": _OBJECT, "TRUCK": _TRUCK,
    "TRUCK_CAB": _TRUCK, "VEHICULAR_TRAILER": _TRUCK, "WHEELCHAIR": _PEDESTRIAN, "WHEELED_DEVICE": _BICYCLE,
    "WHEELED_RIDER": _BICYCLE,
}  # fmt: skip
"""Argoverse 2's categories; 123D numbers them in this order."""

KINDS: dict[str, dict[AgentKind, tuple[int, ...]]] = {
    "NuPlanBoxDetectionLabel": {_CAR: (0,), _BICYCLE: (1,), _PEDESTRIAN: (2,)},
    "NuScenesBoxDetectionLabel": {
        _CAR: (0, 6), _TRUCK: (1, 4, 5, 7), _BUS: (2, 3), _BICYCLE: (8,), _MOTORCYCLE: (9,),
        _PEDESTRIAN: (10, 11, 12, 13, 14, 15, 16),
    },
    "WODMotionBoxDetectionLabel": {_CAR: (1,), _PEDESTRIAN: (2,), _BICYCLE: (3,)},
    "WODPerceptionBoxDetectionLabel": {_CAR: (1,), _PEDESTRIAN: (2,), _BICYCLE: (4,)},
    "PandasetBoxDetectionLabel": {
        _CAR: (3, 4, 7, 8, 11, 12, 13, 17, 21, 24), _BUS: (25, 26), _BICYCLE: (2, 9, 10), _PEDESTRIAN: (14, 15),
    },
    "KITTI360BoxDetectionLabel": {_CAR: (2, 3, 4, 14, 17), _BUS: (15,), _BICYCLE: (0, 6), _PEDESTRIAN: (7, 9)},
    "PhysicalAIAVBoxDetectionLabel": {_CAR: (0, 2, 3, 4, 8, 11), _BUS: (10,), _BICYCLE: (6,), _PEDESTRIAN: (1,)},
    "NureasoningBoxDetectionLabel": {_CAR: (0, 7, 8), _BICYCLE: (1, 9, 10), _PEDESTRIAN: (2, 11)},
    "GriffinBoxDetectionLabel": {_CAR: (1, 2, 3), _BICYCLE: (4, 5), _PEDESTRIAN: (0,)},
    "TruckDriveBoxDetectionLabel": {_CAR: (1, 4, 5, 6, 8), _BICYCLE: (0,), _PEDESTRIAN: (2,)},
    "DefaultBoxDetectionLabel": {_CAR: (1,), _BUS: (2,), _BICYCLE: (3,), _PEDESTRIAN: (4,)},
}  # fmt: skip
"""Numbers that are not listed are objects."""
_AV2 = "AV2SensorBoxDetectionLabel"


def kinds_of(label_class: str, labels: IntArray, length: FloatArray, notes: list[str]) -> tuple[AgentKind, ...]:
    """The kinds of road users `(n,)` by their label and, where that says no more than "vehicle", length in m."""
    key = label_class.rsplit(".", 1)[-1]
    if key == _AV2:
        names = list(AV2_CATEGORIES.values())
        return tuple(names[i] if 0 <= i < len(names) else _OBJECT for i in labels)
    if key not in KINDS:
        notes.append(f"The labels '{key[:60]}' are not known: what the road users are is told from their lengths.")
        sized = [_OBJECT, _PEDESTRIAN, _BICYCLE, _CAR, _TRUCK]
        return tuple(sized[int(np.searchsorted([0.0, 1.2, 2.7, LONG_M], size))] for size in length)
    by_number = {number: kind for kind, numbers in KINDS[key].items() for number in numbers}
    kinds = [by_number.get(int(label), _OBJECT) for label in labels]
    long = [kind is _CAR and size > LONG_M for kind, size in zip(kinds, length, strict=True)]
    if any(long):
        notes.append(f"{sum(long)} vehicles are longer than {LONG_M} m and taken as lorries.")
    return tuple(_TRUCK if is_long else kind for kind, is_long in zip(kinds, long, strict=True))
