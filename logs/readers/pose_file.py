"""Reads files of poses, one a line, as logs of an ego alone: of the TUM RGB-D benchmark and of
KITTI's odometry.

    TUM     t x y z qx qy qz qw            t in s, quaternion of the body in the world
    KITTI   the first three rows of the matrix of the body in the world, 12 numbers

The times of a KITTI file are in times.txt beside it, or in ../sequences/NAME/times.txt as the data
set has them; without one, it is at KITTI's rate.

The world may be one of a map (z up) or of a first camera (x right, y down, z forward), and the body
a car's (x forward) or a camera's (z forward). A note says which was chosen:

(1) up is z, or -y if the path extends less along y than along z
(2) forward is the axis of the body that fits the direction of motion better
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from replan.core.arrays import FloatArray
from replan.core.errors import LogError
from replan.logs.chords import Chords
from replan.logs.log_settings import LogSettings
from replan.logs.readers.base import LogContents, Reader, TopicSummary
from replan.logs.readers.recorded import is_unit, rotated
from replan.logs.readers.table import from_frames
from replan.logs.scenario import Scenario
from replan.logs.states import wrapped

TUM, KITTI = 8, 12
"""Numbers of a line."""
SUFFIXES = (".txt", ".tum")
KITTI_S = 0.1
"""Interval of KITTI's odometry, s."""
ROUNDED = 0.01
"""Tolerance of a rotation's matrix."""
FIRST_LINES = 20
"""Number of lines that are looked at to claim a file."""


def _rows(path: Path) -> Iterator[tuple[int, list[float]]]:
    """Yield number (from 1) and values of each line that is no comment; ValueError for other
    texts.
    """
    with path.open(encoding="utf-8-sig") as stream:
        for number, line in enumerate(stream, 1):
            if line.strip() and not line.lstrip().startswith("#"):
                yield number, [float(word) for word in line.replace(",", " ").split()]


def _is_pose(row: list[float]) -> bool:
    if len(row) == TUM:
        return bool(is_unit(np.array([row[4:]]))[0])
    if len(row) != KITTI:
        return False
    turn = np.array(row).reshape(3, 4)[:, :3]
    return bool(np.abs(turn @ turn.T - np.eye(3)).max() < ROUNDED)


def _claims(path: Path) -> bool:
    try:
        if path.suffix.lower() not in SUFFIXES or not path.is_file():
            return False
        rows = [row for (_, row), _ in zip(_rows(path), range(FIRST_LINES), strict=False)]
    except (OSError, ValueError):
        return False
    return bool(rows) and len({len(row) for row in rows}) == 1 and all(map(_is_pose, rows))


def _times_file(path: Path) -> Path | None:
    """Return the file with the times of a KITTI file; None if there is none."""
    places = (path.with_name("times.txt"), path.parents[1] / "sequences" / path.stem / "times.txt")
    return next((place for place in places if place.is_file()), None)


def _load(path: Path) -> FloatArray:
    """Return the numbers of a file `(n, k)`; LogError for a line that does not fit."""
    rows = list[list[float]]()
    try:
        for number, row in _rows(path):
            if rows and len(row) != len(rows[0]):
                problem = f"line {number} has {len(row)} numbers, the first {len(rows[0])}"
                raise LogError(problem, topic=path.name, remedy="write each pose in one line")
            rows.append(row)
    except (OSError, ValueError) as error:
        raise LogError(f"cannot be read: {error}", topic=path.name) from None
    return np.array(rows, dtype=np.float64)


def _times(path: Path, count: int, notes: list[str]) -> FloatArray:
    """Return the times of the poses of a KITTI file, s."""
    file = _times_file(path)
    if file is None:
        notes.append(f"The poses have no times: they are {KITTI_S:g} s apart, as KITTI's.")
        return KITTI_S * np.arange(count)
    t = _load(file)[:, 0]
    if len(t) != count:
        problem = f"{file.name} has {len(t)} times, {path.name} {count} poses"
        raise LogError(problem, topic=file.name, remedy="take both of one sequence")
    return t


def _bodies(path: Path) -> tuple[FloatArray, FloatArray, dict[str, FloatArray], list[str]]:
    """Return the times `(n,)`, s, the places `(n, 3)`, the axes of the body by name `(n, 3)`, and
    notes.
    """
    values, notes = _load(path), list[str]()
    if values.shape[1] == TUM:
        x_axis, z_axis = (
            rotated(values[:, 4:], np.tile(axis, (len(values), 1)))
            for axis in (np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
        )
        return values[:, 0], values[:, 1:4], {"x": x_axis, "z": z_axis}, notes
    matrices = values.reshape(-1, 3, 4)
    axes = {"x": matrices[:, :, 0], "z": matrices[:, :, 2]}
    return _times(path, len(values), notes), matrices[:, :, 3], axes, notes


def _read(path: Path, settings: LogSettings) -> Scenario:
    t, place, axes, notes = _bodies(path)
    if len(t) < 2:
        raise LogError("it has fewer than two poses", topic=path.name)
    is_camera_world = np.ptp(place[:, 1]) < np.ptp(place[:, 2])  # (1)
    if is_camera_world:  # x right, y down, z forward: forward is x, left is y
        flat = {name: np.stack([axis[:, 2], -axis[:, 0]]) for name, axis in axes.items()}
        x, y = place[:, 2], -place[:, 0]
    else:
        flat = {name: axis[:, :2].T for name, axis in axes.items()}
        x, y = place[:, 0], place[:, 1]
    order = np.argsort(t, kind="stable")
    chords = Chords.of(np.array([0, len(t)]), t[order], x[order], y[order])
    yaws = {name: np.arctan2(axis[1], axis[0]) for name, axis in flat.items()}

    def misfit(name: str) -> float:  # (2)
        off = np.abs(wrapped(chords.off(yaws[name][order])))
        return float(np.median(off)) if len(off) else 0.0

    forward = min(yaws, key=misfit)
    world = "a camera's (y down)" if is_camera_world else "a map's (z up)"
    notes.append(f"The world is taken as {world}, and the body's {forward} axis as forward.")
    frame = pd.DataFrame({"t": t, "x": x, "y": y, "yaw": yaws[forward]})
    scenario = from_frames(
        frame,
        name=path.stem,
        vehicle=settings.vehicle(notes),
        tags=("recorded", "poses"),
        ego_point=settings.ego_point,
    )
    return replace(scenario, notes=(*notes, *scenario.notes))


def _files(path: Path) -> tuple[Path, ...]:
    times = _times_file(path)
    return (path,) if times is None else (path, times)


def _contents(path: Path) -> LogContents:
    try:
        values = _load(path)
    except LogError:
        return LogContents()
    schema = "TUM" if values.shape[1:] == (TUM,) else "KITTI"
    return LogContents("", (TopicSummary(path.name, schema, "txt", "", len(values), None, None),))


READER = Reader(
    "poses",
    "files of poses of TUM (t x y z qx qy qz qw) and KITTI odometry, ego alone",
    "*.txt and *.tum of poses",
    (".tum",),
    _claims,
    _read,
    files=_files,
    contents=_contents,
    settings=("ego_point", "car"),
)
