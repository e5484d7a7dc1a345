"""Boxes by frame -> tracks, and the ego's vehicle from its sizes.

A track's size is the median of its boxes. Objects (cones, barriers, signs) whose boxes stay within `STAYS_M` of their
median for `SEEN_S` or longer are static: they stand at their median. Vehicles and people never are, however long they
stand: that a parked car will stay parked is not known while it is driven past.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from logs.agents import USUAL_SIZE_M, AgentKind
from logs.kernel import FloatArray, IntArray
from logs.scenario import Tracks
from logs.vehicle import VehicleParameters

STAYS_M = 0.5
SEEN_S = 1.0
SOONEST_S = 1e-3
"""A second sample of a track within this is the same one again."""


@dataclass(frozen=True, eq=False)
class Boxes:
    """All boxes of a log, `(m,)` each: s, whose (index into `names`), centre m, rad, m, m/s (NaN: not known)."""

    names: tuple[str, ...]
    kinds: tuple[AgentKind, ...]
    t: FloatArray
    owner: IntArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    length: FloatArray
    width: FloatArray
    vx: FloatArray
    vy: FloatArray

    def taken(self, rows: Any) -> Boxes:
        """Only these rows."""
        return replace(self, **{name: getattr(self, name)[rows] for name in _COLUMNS})


_COLUMNS = ("t", "owner", "x", "y", "yaw", "length", "width", "vx", "vy")
_POSE = ("t", "x", "y", "yaw")


def ordered(boxes: Boxes, notes: list[str]) -> Boxes:
    """By track and time, without what cannot be used, which is noted."""
    finite = np.logical_and.reduce([np.isfinite(getattr(boxes, name)) for name in _POSE])
    if not finite.all():
        notes.append(f"{(~finite).sum()} of {len(finite)} boxes have a pose that is not finite and are left out.")
    boxes = boxes.taken(finite)
    boxes = boxes.taken(np.lexsort((boxes.t, boxes.owner)))
    if not len(boxes.t):
        return boxes
    again = np.r_[False, (np.diff(boxes.owner) == 0) & (np.diff(boxes.t) < SOONEST_S)]
    if again.any():
        notes.append(f"{again.sum()} boxes have the id of another one at the same time and are left out.")
    return boxes.taken(~again)


def tracks_of(boxes: Boxes, notes: list[str]) -> Tracks:
    """The tracks of `ordered` boxes."""
    if not len(boxes.t):
        return Tracks.empty()
    there, first = np.unique(boxes.owner, return_index=True)
    ends = np.r_[first[1:], len(boxes.t)]
    sizes = np.array([_size(boxes, slice(*part)) for part in zip(first, ends, strict=True)])
    kinds = tuple(boxes.kinds[i] for i in there)
    static = np.array([_stays(boxes, kind, slice(*p)) for kind, *p in zip(kinds, first, ends, strict=True)])
    boxes, first, ends = _settled(boxes, static, first, ends)
    unsized = ~np.isfinite(sizes).all(axis=1)
    if unsized.any():
        notes.append(f"{unsized.sum()} of {len(there)} road users have no size: that usual for their kind is assumed.")
        sizes[unsized] = [USUAL_SIZE_M[kind] for kind, lacks in zip(kinds, unsized, strict=True) if lacks]
    if static.any():
        notes.append(
            f"{static.sum()} objects (cones, barriers, signs) stay within {STAYS_M} m and are taken as standing there."
        )
    pose = (boxes.t, boxes.x, boxes.y, boxes.yaw, boxes.vx, boxes.vy)
    offsets = np.r_[0, ends]
    return Tracks(tuple(boxes.names[i] for i in there), kinds, sizes[:, 0], sizes[:, 1], static, offsets, *pose)


def _size(boxes: Boxes, part: slice) -> tuple[float, float]:
    """Median length and width, m; NaN where none is positive."""
    length, width = boxes.length[part], boxes.width[part]
    good = np.isfinite(length) & np.isfinite(width) & (length > 0.0) & (width > 0.0)
    return (float(np.median(length[good])), float(np.median(width[good]))) if good.any() else (np.nan, np.nan)


def _stays(boxes: Boxes, kind: AgentKind, part: slice) -> bool:
    x, y, t = boxes.x[part], boxes.y[part], boxes.t[part]
    away = np.hypot(x - np.median(x), y - np.median(y))
    return kind is AgentKind.OBJECT and bool(t[-1] - t[0] >= SEEN_S and away.max() <= STAYS_M)


def _settled(boxes: Boxes, static: Any, first: IntArray, ends: IntArray) -> tuple[Boxes, IntArray, IntArray]:
    """Of static tracks the sample nearest to the median place, of the others all."""
    rows = []
    for fixed, a, b in zip(static, first, ends, strict=True):
        away = np.hypot(boxes.x[a:b] - np.median(boxes.x[a:b]), boxes.y[a:b] - np.median(boxes.y[a:b]))
        rows.append(np.array([a + int(np.argmin(away))]) if fixed else np.arange(a, b))
    counts = np.cumsum([len(part) for part in rows])
    boxes = boxes.taken(np.concatenate(rows))
    return boxes, np.r_[0, counts[:-1]], counts


def car_of(sizes: Mapping[str, float], notes: list[str]) -> VehicleParameters:
    """The ego's vehicle from "length", "width", "wheelbase" and "rear_overhang", m; what is missing is in proportion.

    Raises:
        ValueError: As `VehicleParameters`.
    """
    default = VehicleParameters()
    length = sizes.get("length", default.length)
    scale = length / default.length
    wheelbase = sizes.get("wheelbase", scale * default.wheelbase)
    overhang = sizes.get("rear_overhang", scale * default.rear_overhang)
    if not 0.0 < wheelbase < length:
        notes.append("The ego's wheelbase does not fit its length: it is that of the default car, in proportion.")
        wheelbase = scale * default.wheelbase
    if not 0.0 <= overhang <= length - wheelbase:
        notes.append("The log does not say where the ego's rear axle is in its box: as in the default car, assumed.")
        overhang = min(scale * default.rear_overhang, length - wheelbase)
    notes.append("Masses, tyres and limits of the ego's vehicle are those of the default car.")
    cog = default.cog_to_front * wheelbase / default.wheelbase
    found: dict[str, Any] = {
        "length": length, "width": sizes.get("width", default.width), "wheelbase": wheelbase, "rear_overhang": overhang,
        "cog_to_front": cog,
    }  # fmt: skip
    return replace(default, **found)
