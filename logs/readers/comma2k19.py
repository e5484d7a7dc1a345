"""Reads comma2k19 segments: the poses of a camera in a car, without a map and other road users.

A segment is a folder with `global_pose/frame_positions` (NumPy arrays without a suffix). Positions
and velocities are ECEF, orientations quaternions that turn ECEF into the camera's forward, right,
down. The plane is east and north at the first position (WGS 84, Bowring's latitude), the heading
that of the camera's forward axis, the speed that of the velocity along it. The times are the
frames' GPS times.
"""

from __future__ import annotations

from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import LogError, reading
from replan.logs.complete import completed, road_along
from replan.logs.log_settings import LogSettings
from replan.logs.readers.base import LogContents, Reader, TopicSummary
from replan.logs.scenario import Scenario
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters

POSE = "global_pose"
NAMES = (
    "frame_positions",
    "frame_velocities",
    "frame_orientations",
    "frame_times",
    "frame_gps_times",
)
COLUMNS = (3, 3, 4, 1, 2)
SEMI_MAJOR_M, FLATTENING = 6378137.0, 1.0 / 298.257223563
"""WGS 84."""
GPS_EPOCH_S, WEEK_S = 315964800, 604800
"""Unix time of the GPS epoch; leap seconds are not subtracted."""
MOST_BYTES = 2**28


def _claims(path: Path) -> bool:
    try:
        return path.is_dir() and all((path / POSE / name).is_file() for name in NAMES[:3])
    except OSError:
        return False


def _files(path: Path) -> tuple[Path, ...]:
    return tuple(path / POSE / name for name in NAMES if (path / POSE / name).is_file())


def _array(path: Path, name: str, columns: int) -> FloatArray:
    file = path / POSE / name
    try:
        if file.stat().st_size > MOST_BYTES:
            problem = f"the array has {file.stat().st_size} bytes"
            raise LogError(problem, topic=name, remedy="a segment has poses of one minute")
        array: Any = np.load(file, allow_pickle=False)
    except (
        OSError,
        ValueError,
        EOFError,
        SyntaxError,
        MemoryError,
        OverflowError,
        TypeError,
        TokenError,
    ) as error:
        problem = f"the array cannot be read: {' '.join(str(error).split())[:120]}"
        raise LogError(problem, topic=name, remedy="download the segment again") from None
    array = np.asarray(array)
    array = array[:, None] if array.ndim == 1 else array
    if (
        array.ndim != 2
        or array.shape[1] != columns
        or array.dtype.kind not in "fi"
        or not len(array)
    ):
        raise LogError(
            f"the array is {array.shape} of {array.dtype}, expected (n, {columns}) numbers",
            topic=name,
        )
    return array.astype(np.float64)


def _read(path: Path, settings: LogSettings) -> Scenario:
    arrays = [_array(path, name, columns) for name, columns in zip(NAMES, COLUMNS, strict=True)]
    if len({len(array) for array in arrays}) > 1:
        raise LogError(
            f"the arrays have {', '.join(str(len(array)) for array in arrays)} rows", topic=POSE
        )
    for name, array in zip(NAMES, arrays, strict=True):
        if not np.isfinite(array).all():
            raise LogError("a value is not finite", topic=name)
    place, velocity, turn, frames, gps = arrays
    if not (np.hypot.reduce(place[0]) > 1.0 and (np.abs(turn).sum(axis=1) > 0.0).all()):
        raise LogError(
            "a position is not on the earth, or an orientation is not a quaternion", topic=POSE
        )
    t = frames[:, 0] - frames[0, 0]
    plane = _east_north(place[0])
    x, y = plane @ (place - place[0]).T
    # the camera's forward axis in ECEF: the first row of the transposed matrix of the quaternion
    # (scalar first)
    qw, qx, qy, qz = (turn / np.linalg.norm(turn, axis=1, keepdims=True)).T
    forward = np.column_stack(
        [1.0 - 2.0 * (qy * qy + qz * qz), 2.0 * (qx * qy + qw * qz), 2.0 * (qx * qz - qw * qy)]
    )
    yaw = np.unwrap(np.arctan2(forward @ plane[1], forward @ plane[0]))
    notes = [
        "The poses are the camera's: they are taken for the rear axle's, about 1.5 m behind it.",
        "Radar returns are not read: they have neither size nor class. The log holds no other road "
        "users.",
    ]
    columns = {"t": t, "x": x, "y": y, "yaw": yaw, "v": (velocity * forward).sum(axis=1)}
    columns |= {"a": np.full(len(t), np.nan), "kappa": np.full(len(t), np.nan)}
    with reading((ValueError, OverflowError), topic=POSE):
        ego = completed(columns, notes)
        start_ns = int(GPS_EPOCH_S + gps[0, 0] * WEEK_S) * 10**9 + round(float(gps[0, 1]) * 1e9)
        return Scenario(
            name=f"comma2k19 {path.name}",
            ego=ego,
            tracks=Tracks.empty(),
            road=road_along(ego, notes),
            duration=float(t[-1]),
            vehicle=settings.vehicle(notes) or VehicleParameters(),
            tags=("recorded", "comma2k19"),
            source="comma2k19",
            licence="MIT",
            start_ns=min(max(start_ns, 0), 2**62),
            notes=tuple(notes),
            traffic=(),
        )


def _east_north(place: FloatArray) -> FloatArray:
    """Return the unit vectors east and north `(2, 3)` at an ECEF position, m."""
    x, y, z = place
    e2 = FLATTENING * (2.0 - FLATTENING)
    minor, radius = SEMI_MAJOR_M * (1.0 - FLATTENING), np.hypot(x, y)
    theta = np.arctan2(z * SEMI_MAJOR_M, radius * minor)
    second = e2 / (1.0 - e2)
    above, aside = (
        z + second * minor * np.sin(theta) ** 3,
        radius - e2 * SEMI_MAJOR_M * np.cos(theta) ** 3,
    )
    latitude = np.arctan2(above, aside)  # Bowring
    longitude = np.arctan2(y, x)
    sin, cos = np.sin(latitude), np.cos(latitude)
    east = [-np.sin(longitude), np.cos(longitude), 0.0]
    return np.array([east, [-sin * np.cos(longitude), -sin * np.sin(longitude), cos]])


def _contents(path: Path) -> LogContents:
    topics = []
    for name, columns in zip(NAMES, COLUMNS, strict=True):
        try:
            rows = len(_array(path, name, columns))
        except LogError:
            continue
        topics.append(TopicSummary(name, f"{columns} columns", "npy", "", rows, None, None))
    return LogContents("", tuple(topics))


READER = Reader(
    "comma2k19",
    "comma2k19 segments: the driven poses",
    "folders with global_pose/frame_positions",
    (),
    _claims,
    _read,
    files=_files,
    contents=_contents,
    settings=("car",),
)
