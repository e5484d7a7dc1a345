"""Tables of tracks of public data sets, and the files beside them.

`DATA_SETS` has one row per data set that is published as such tables: names and units of its
columns, the point of a vehicle whose position it has, and where its frame rate is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from replan.core.errors import LogError
from replan.core.files import beside
from replan.logs.readers.columns import NAMES, TIMES, holds
from replan.logs.readers.csv_table import FCD_SUFFIX, SUFFIXES, header_of, load_table


class DataSet(NamedTuple):
    """How a data set writes its tables of tracks."""

    name: str  # its name
    # its column, with the unit, by replan's name; all must be there for a table to be of this data
    # set
    columns: Mapping[str, str]
    point: str = "centre"  # point of the position: "centre", "front" (2) or "corner" (1)
    # part of the table's name, and what replaces it in that of a file beside it: with more rows,
    # with the frame rate, with the kinds
    more_rows: tuple[str, str] | None = None
    frame_rate: tuple[str, str] | None = None
    kinds_file: tuple[str, str] | None = None
    recording: str = ""  # column that tells recordings apart if a table holds several
    ego: str = ""  # the road user that is the ego if no other is named
    # kinds by its words, where these are not known from elsewhere; "car" is assumed for ""
    kinds: Mapping[str, str] = {}
    optional: Mapping[str, str] = {}  # more of its columns, which a table may lack
    heading: str = ""  # convention of its headings, of `HEADINGS`


RATES, KINDS = ("_tracks", "_recordingMeta"), ("_tracks", "_tracksMeta")
_OURS = {"x": "x", "y": "y", "vx": "vx", "vy": "vy", "length": "length", "width": "width"}
DATA_SETS = (
    DataSet(
        "highD",
        {
            "t": "frame",
            "id": "id",
            "x": "x",
            "y": "y",
            "length": "width",
            "width": "height",
            "vx": "xVelocity",
            "vy": "yVelocity",
        },
        point="corner",
        frame_rate=RATES,
        kinds_file=KINDS,
    ),
    DataSet(
        "inD, rounD, exiD or uniD",
        {
            "t": "frame",
            "id": "trackId",
            "x": "xCenter",
            "y": "yCenter",
            "yaw": "heading [deg]",
            "length": "length",
            "width": "width",
            "vx": "xVelocity",
            "vy": "yVelocity",
        },
        frame_rate=RATES,
        kinds_file=KINDS,
        recording="recordingId",
    ),
    DataSet(
        "INTERACTION",
        {
            **_OURS,
            "t": "timestamp_ms [ms]",
            "id": "track_id",
            "kind": "agent_type",
            "yaw": "psi_rad [rad]",
        },
        more_rows=("vehicle_tracks", "pedestrian_tracks"),
        recording="case_id",
    ),
    DataSet(
        "NGSIM",
        {
            "t": "Global_Time [ms]",
            "id": "Vehicle_ID",
            "x": "Local_X [ft]",
            "y": "Local_Y [ft]",
            "v": "v_Vel [ft/s]",
            "length": "v_Length [ft]",
            "width": "v_Width [ft]",
            "kind": "v_Class",
        },
        point="front",
        recording="Location",
        kinds={"1": "motorcycle", "2": "car", "3": "truck"},
    ),
    DataSet(
        "Argoverse 1",
        {"t": "TIMESTAMP [s]", "id": "TRACK_ID", "x": "X [m]", "y": "Y [m]", "kind": "OBJECT_TYPE"},
        ego="AV",
        kinds=dict.fromkeys(("av", "agent", "others"), "car"),
    ),
    DataSet(
        "SUMO",
        {
            "t": "timestep_time [s]",
            "id": "vehicle_id",
            "x": "vehicle_x",
            "y": "vehicle_y",
            "yaw": "vehicle_angle [deg]",
            "v": "vehicle_speed",
        },
        optional={"kind": "vehicle_type"},
        point="front",
        heading="rad clockwise from north",
    ),
)
"""The data sets: NGSIM's positions are of the front centre, in feet (FHWA-HRT-06-137); Argoverse
1's have no sizes.
"""


def data_set_of(header: Iterable[str]) -> DataSet | None:
    """Return the data set whose columns a table has; None if there is none."""
    columns = {name.strip().lower() for name in header}
    for data in DATA_SETS:
        if {column.partition(" [")[0].lower() for column in data.columns.values()} <= columns:
            return data
    return None


def claims(path: Path, columns: Mapping[str, str] | None = None) -> bool:
    """Return whether a path is a table of tracks: a file with known columns, or a folder with only
    agents.
    """
    if path.is_dir():
        has_file = [
            any((path / f"{name}{suffix}").is_file() for suffix in SUFFIXES) for name in NAMES
        ]
        return has_file == [False, True]
    if path.suffix not in (*SUFFIXES, FCD_SUFFIX) or not path.is_file():
        return False
    header = header_of(path)
    return data_set_of(header) is not None or (
        holds(header, ("id", "x", "y"), columns or {})
        and any(holds(header, (name,), columns or {}) for name in TIMES)
    )


def _side_file(path: Path, change: tuple[str, str] | None) -> Path | None:
    """Return the file beside `path` in whose name a part is replaced; None if there is none."""
    if change is None or change[0] not in path.name:
        return None
    return beside(path.parent, [path.name.replace(*change)])


def files(path: Path) -> tuple[Path, ...]:
    """Return a table of tracks and the files beside it that are read with it."""
    data = data_set_of(header_of(path)) or DataSet("", {})
    sides = (
        _side_file(path, change) for change in (data.more_rows, data.frame_rate, data.kinds_file)
    )
    return (path, *(file for file in sides if file is not None))


def load(path: Path, columns: Mapping[str, str]) -> tuple[pd.DataFrame, dict[str, str]]:
    """Load a table of tracks with the files beside it, and `columns` with the time of a frame;
    LogError without.
    """
    frame, columns = load_table(path), dict(columns)
    data = data_set_of(map(str, frame.columns)) or DataSet("", {})
    if file := _side_file(path, data.more_rows):
        frame = pd.concat([frame, load_table(file)], ignore_index=True)
    if file := _side_file(path, data.kinds_file):
        kinds = load_table(file)
        key = data.columns["id"] if data.columns["id"] in kinds else "id"
        if {key, "class"} <= {*kinds}:
            kind_of_id = kinds.drop_duplicates(key).set_index(key)["class"]
            frame["class"] = frame[data.columns["id"]].map(kind_of_id)
            columns.setdefault("kind", "class")
    is_time_set = any(name in columns for name in ("t", *(f"{name}.t" for name in NAMES)))
    if data.frame_rate is not None and not is_time_set:
        columns["t"] = f"frame [{_frame_rate(path, data)} Hz]"
    return frame, columns


def _frame_rate(path: Path, data: DataSet) -> float:
    """Return the frame rate in the file beside a table, Hz; LogError without."""
    file = _side_file(path, data.frame_rate)
    rates = pd.DataFrame() if file is None else load_table(file)
    rate = np.nan
    if "frameRate" in rates:
        rate = pd.to_numeric(rates["frameRate"], errors="coerce").iloc[0]
    if not rate > 0.0:
        problem = (
            f"the frame rate of {data.name} is in ..._recordingMeta.csv beside the table, "
            "which does not have it"
        )
        remedy = 'copy that file there, or name the rate: [log.columns] t = "frame [25 Hz]"'
        raise LogError(problem, topic=path.name, remedy=remedy)
    return rate
