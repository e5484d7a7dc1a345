"""Tables of tracks without an ego: one of the road users becomes the ego, the others are the
agents.

`DATA_SETS` has one row per public data set that is published as such tables: names and units of its
columns, the point of a vehicle whose position it has, and where its frame rate is. Other tables
have replan's names of columns, or those of `[log.columns]`, and positions of box centres.

(1) upper left corner (highD: x right, y down): centre = (x + length / 2, -(y + width / 2))
(2) front centre (NGSIM, SUMO):                 centre = p - length / 2 (cos yaw, sin yaw)
(3) without headings: the direction of the way come over at least `HEADED_M`

The ego's rear axle is behind the centre of its box as in the default car, in proportion to its
length. Its acceleration, its curvature and, where the table has none, its speed come from parabolas
through its positions (`recorded.driven`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from replan.core.arrays import FloatArray
from replan.core.errors import LogError
from replan.core.files import beside
from replan.core.names import counted
from replan.logs.agents import USUAL_SIZE_M, AgentKind
from replan.logs.kind_words import kinds_of_tracks
from replan.logs.log_settings import LogSettings
from replan.logs.observed import Spans, of_stream
from replan.logs.readers.clocks import check_restart, continued
from replan.logs.readers.columns import NAMES, TIMES, NamedColumns, check_names, holds
from replan.logs.readers.csv_table import FCD_SUFFIX, SUFFIXES, header_of, load_table
from replan.logs.readers.recorded import driven
from replan.logs.vehicle import VehicleParameters, assumed_car


class DataSet(NamedTuple):
    """How a data set writes its tables of tracks."""

    name: str  # its name
    # its column, with the unit, by replan's name; all must be there for a table to be of this data
    # set
    columns: Mapping[str, str]
    point: str = "centre"  # point of the position: "centre", "front" (2) or "corner" (1)
    # part of the table's name, and what replaces it in that of a file beside it; `META`: frame rate
    # and kinds
    sides: tuple[tuple[str, str], ...] = ()
    recording: str = ""  # column that tells recordings apart if a table holds several
    ego: str = ""  # the road user that is the ego if no other is named
    # kinds by its words, where these are not known from elsewhere; "car" is assumed for ""
    kinds: Mapping[str, str] = {}
    optional: Mapping[str, str] = {}  # more of its columns, which a table may lack
    heading: str = ""  # convention of its headings, of `HEADINGS`


META = (("_tracks", "_recordingMeta"), ("_tracks", "_tracksMeta"))
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
        sides=META,
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
        sides=META,
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
        sides=(("vehicle_tracks", "pedestrian_tracks"),),
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
HEADED_M = 1.0
"""Constant of (3), m: positions from images are uncertain by 0.1 m, 6 degrees over it."""
BEFORE_S = 2.0
"""The others are read from this time before the ego's first row, s."""
_NO_DRIVERS = (AgentKind.PEDESTRIAN, AgentKind.OBJECT)
_SHOWN = 8


class TakenEgo(NamedTuple):
    """The ego that was taken from a table of tracks.

    Both tables have replan's names and units; the agents' has box centres.
    """

    ego: pd.DataFrame
    agents: pd.DataFrame
    vehicle: VehicleParameters | None
    notes: tuple[str, ...]
    traffic: Spans
    id: str
    data_set: str
    ego_point: str  # point of the ego whose positions its table has


def taken_ego(
    frame: pd.DataFrame | None,
    ego: str,
    settings: LogSettings,
    vehicle: VehicleParameters | None,
) -> TakenEgo:
    """Take a road user out of a table of tracks; LogError as in `from_frames`, or with those who
    drove farthest.

    `ego` is its id, or its word for the kind if only one road user has it; "": that of the data
    set. Columns, points and headings of the settings win over those of the data set. `vehicle`
    None: one of the road user's size.
    """
    if frame is None or not len(frame):
        raise LogError("the table has no rows", topic="agents", remedy="give a table of tracks")
    data = data_set_of(map(str, frame.columns)) or DataSet("", {})
    known = {
        column.partition(" [")[0].lower(): column.partition(" [")[0]
        for column in data.columns.values()
    }
    frame = frame.rename(
        columns={name: known.get(str(name).lower(), name) for name in frame.columns}
    )
    given = settings.columns
    check_names(given, {"agents": frame})
    if data.recording in frame and frame[data.recording].nunique() > 1:
        what = (
            f"the table holds {frame[data.recording].nunique()} recordings, whose ids differ "
            f"({data.recording})"
        )
        raise LogError(what, topic="agents", remedy=f"keep the rows of one {data.recording}")
    table = NamedColumns(
        frame,
        "agents",
        {
            **data.columns,
            **data.optional,
            **{key.rpartition(".")[2]: name for key, name in given.items()},
        },
        settings.agents_heading or data.heading,
    )
    names, notes = names_of(table), list[str]()
    ns, is_text = table.times(notes)
    ns, _ = continued(ns, np.empty(0, np.int64), is_text=is_text, notes=notes)
    check_restart(ns, table.numbers("x"), table.numbers("y"), "agents", names)
    order = np.lexsort((ns, names))
    names, ns = names[order], ns[order]
    first = np.flatnonzero(np.r_[True, names[1:] != names[:-1]])
    offsets = np.r_[first, len(names)]
    words = words_of(table)[order]
    kinds = list(kinds_of_tracks(words.tolist(), offsets, settings.kinds, data.kinds, notes))
    point = settings.agents_point or data.point
    state = _states(table, point, order, offsets, kinds, notes)
    ego = _id(ego or data.ego, names, words, first, kinds, state)
    its = np.flatnonzero(names == ego)
    t = (ns - ns[its[0]]) / 1e9
    if len(its) < 2 or (np.diff(t[its]) <= 0.0).any():
        what = f"agent {ego} has {'one row' if len(its) < 2 else 'two rows of one time'}"
        raise LogError(what, topic="agents", remedy="name another one with --ego")
    length, width = (float(np.median(state[name][its])) for name in ("length", "width"))
    if vehicle is None and np.isfinite(length + width):
        vehicle = assumed_car({"length": length, "width": width}, notes)
        notes.append(
            f"The ego is agent {ego}, {length:.2f} x {width:.2f} m. Its wheelbase of "
            f"{vehicle.wheelbase:.2f} m and its"
            " rear axle are assumed: as in the default car, in proportion to the length."
        )
    shown = (t >= -BEFORE_S) & (t <= t[its[-1]])
    if not shown.all():
        notes.append(
            f"The table lasts {np.ptp(t):.1f} s: the {t[its[-1]]:.1f} s of agent {ego} are read."
        )
    others = np.flatnonzero(shown & (names != ego))
    kind = np.array(kinds, dtype=object)[
        np.searchsorted(first, np.arange(len(names)), side="right") - 1
    ]
    agents = pd.DataFrame(
        {name: column[others] for name, column in state.items()}
        | {"t_ns": ns[others], "id": names[others], "kind": kind[others]}
    )
    return TakenEgo(
        _ego_states(
            table, ns[its], t[its], {name: column[its] for name, column in state.items()}, notes
        ),
        agents,
        vehicle,
        tuple(notes),
        of_stream(t[shown]),
        ego,
        data.name,
        "centre" if point in AHEAD else settings.ego_point or "centre",
    )


def _states(
    table: NamedColumns,
    point: str,
    order: Any,
    offsets: Any,
    kinds: list[AgentKind],
    notes: list[str],
) -> dict[str, FloatArray]:
    """Return position of the box centre, heading, velocity and size of each row, `(n,)`; NaN where
    unknown.
    """
    unknown = np.full(len(order), np.nan)
    names = ("x", "y", "vx", "vy", "length", "width")
    state = {
        name: table.numbers(name)[order] if table.has(name) else unknown.copy() for name in names
    }
    for name in ("length", "width"):
        state[name][state[name] == 0.0] = np.nan  # inD: people and riders
    usual = np.repeat([USUAL_SIZE_M[kind] for kind in kinds], np.diff(offsets), axis=0)
    length, width = (
        np.where(np.isfinite(state[k]), state[k], usual[:, i])
        for i, k in enumerate(("length", "width"))
    )
    if point == "corner":  # (1)
        state["x"] = state["x"] + 0.5 * length
        state["y"], state["vy"] = -(state["y"] + 0.5 * width), -state["vy"]
        notes.append(
            "Positions are the upper left corners of boxes in image axes: x stays, y is turned up."
        )
    yaw = table.yaw()
    state["yaw"] = unknown if yaw is None else yaw[order]
    lacking = ~np.isfinite(state["yaw"])
    if lacking.any():  # (3)
        notes.append(
            f"Headings that the table lacks are the direction of the last {HEADED_M:g} m of the "
            "way."
        )
        state["yaw"] = np.where(
            lacking, headings(offsets, state["x"], state["y"], HEADED_M), state["yaw"]
        )
    state["x"], state["y"] = centres(point, state["x"], state["y"], state["yaw"], length, notes)
    cos, sin = np.cos(state["yaw"]), np.sin(state["yaw"])
    if table.has("v") and not (table.has("vx") and table.has("vy")):
        v = table.numbers("v")[order]
        state["vx"], state["vy"] = v * cos, v * sin
    return state


AHEAD: Mapping[str, float] = {
    "front": 0.5,
    "rear": -0.5,
    "rear_axle": VehicleParameters().rear_overhang / VehicleParameters().length - 0.5,
}
"""Place of a point before the centre of the box, in lengths (2)."""
_POINT_WORDS = {"front": "middles of the front bumpers", "rear": "middles of the rear bumpers"}


def centres(
    point: str,
    x: FloatArray,
    y: FloatArray,
    yaw: FloatArray,
    length: FloatArray,
    notes: list[str],
) -> tuple[FloatArray, FloatArray]:
    """Return the centres of boxes whose positions `(n,)` are those of a point of `AHEAD`, with a
    note; other positions are centres.
    """
    if point not in AHEAD:
        return x, y
    notes.append(
        f"Positions are the {_POINT_WORDS.get(point, 'rear axles')}: they are moved to the centres "
        "of the boxes."
    )
    ahead = AHEAD[point] * length
    return x - ahead * np.cos(yaw), y - ahead * np.sin(yaw)


def _ego_states(
    table: NamedColumns, ns: Any, t: FloatArray, state: dict[str, FloatArray], notes: list[str]
) -> pd.DataFrame:
    """Return the table of the ego.

    What is not stated comes from parabolas through its positions.
    """
    if table.yaw() is None and np.hypot(np.ptp(state["x"]), np.ptp(state["y"])) < HEADED_M:
        what = f"the ego moves less than {HEADED_M:g} m and has no heading"
        raise LogError(what, topic="agents", remedy="name another agent with --ego")
    finite = [name for name in ("x", "y", "yaw") if not np.isfinite(state[name]).all()]
    if finite:
        what = f"{finite[0]} of the ego is not finite in every row"
        raise LogError(what, topic="agents", remedy="leave such rows out")
    fit = driven(t, state["x"], state["y"], state["yaw"], [])
    v = state["vx"] * np.cos(state["yaw"]) + state["vy"] * np.sin(state["yaw"])
    notes.append(
        f"The ego's {'' if np.isfinite(v).all() else 'speed, '}acceleration and curvature are "
        "derived: parabolas fitted"
        " to its positions before each state."
    )
    return pd.DataFrame(
        {
            "t_ns": ns,
            "x": state["x"],
            "y": state["y"],
            "yaw": state["yaw"],
            "v": np.where(np.isfinite(v), v, fit.v),
            "a": fit.a,
            "kappa": fit.kappa,
        }
    )


def _id(
    ego: str,
    names: Any,
    words: Any,
    first: Any,
    kinds: list[AgentKind],
    state: dict[str, FloatArray],
) -> str:
    """Return the id of the road user that `ego` names; LogError lists those who drove farthest."""
    ids, can = names[first], np.array([kind not in _NO_DRIVERS for kind in kinds])
    by_word = np.flatnonzero(words[first] == ego)
    if ego and len(by_word) == 1 and ego not in ids:
        ego = ids[by_word[0]]
    at = np.flatnonzero(ids == ego)
    if len(at) and can[at[0]]:
        return str(ego)
    step = np.hypot(np.diff(state["x"], append=np.nan), np.diff(state["y"], append=np.nan))
    step[np.r_[first[1:] - 1, len(step) - 1]] = 0.0
    way = np.add.reduceat(np.nan_to_num(step), first)
    best = [i for i in np.lexsort((ids, -way)) if can[i]][:_SHOWN]
    drove = ", ".join(f"{ids[i]} ({way[i]:.0f} m)" for i in best) or "no vehicle"
    what = (
        f"there is no agent {ego}"
        if ego
        else f"the table has no ego, but {counted(len(ids), 'road user')}"
    )
    if len(at):
        what = f"agent {ego} is a {kinds[at[0]].value}, and cannot be the ego"
    raise LogError(
        what, topic="agents", remedy=f"name the ego with --ego ID; these drove farthest: {drove}"
    )


def _texts(column: pd.Series[Any]) -> Any:
    """Return the values of a column as texts `(n,)`, whole numbers without a point."""
    if pd.api.types.is_float_dtype(column) and (column.dropna() % 1.0 == 0.0).all():
        column = column.astype("Int64")
    return np.array(
        [word.value if isinstance(word, AgentKind) else str(word) for word in column], dtype=str
    )


def words_of(table: NamedColumns) -> Any:
    """Return the word for the kind of each row `(n,)`; "" where it is empty."""
    if not table.has("kind"):
        return np.full(len(table.frame), "")
    column = table.column("kind")[0]
    return np.where(column.isna().to_numpy(), "", _texts(column))


def names_of(table: NamedColumns) -> Any:
    """Return the id of each row `(n,)`, as text; LogError if a row has none."""
    column = table.column("id")[0]
    if column.isna().any():
        what = f"row {int(column.isna().to_numpy().argmax())} has no id"
        raise LogError(what, topic=table.name, remedy="name every agent")
    return _texts(column)


def headings(offsets: Any, x: FloatArray, y: FloatArray, least: float) -> FloatArray:
    """Return each agent's direction of motion over at least `least` m.

    First samples get the first known direction.
    """
    yaw = np.zeros(len(x))
    for first, end in pairwise(offsets):
        at, known = first, False
        for k in range(first + 1, end):
            yaw[k] = yaw[k - 1]
            if np.hypot(x[k] - x[at], y[k] - y[at]) >= least:
                yaw[k] = np.arctan2(y[k] - y[at], x[k] - x[at])
                if not known:
                    yaw[first:k] = yaw[k]
                at, known = k, True
    return yaw


# Files


def data_set_of(header: Iterable[str]) -> DataSet | None:
    """Return the data set whose columns a table has; None if there is none."""
    held = {name.strip().lower() for name in header}
    needed = (
        (data, {column.partition(" [")[0].lower() for column in data.columns.values()})
        for data in DATA_SETS
    )
    return next((data for data, columns in needed if columns <= held), None)


def claims(path: Path, columns: Mapping[str, str] | None = None) -> bool:
    """Return whether a path is a table of tracks: a file with known columns, or a folder with only
    agents.
    """
    if path.is_dir():
        held = [any((path / f"{name}{suffix}").is_file() for suffix in SUFFIXES) for name in NAMES]
        return held == [False, True]
    if path.suffix not in (*SUFFIXES, FCD_SUFFIX) or not path.is_file():
        return False
    header = header_of(path)
    return data_set_of(header) is not None or (
        holds(header, ("id", "x", "y"), columns or {})
        and any(holds(header, (name,), columns or {}) for name in TIMES)
    )


def _side_file(path: Path, old: str, new: str) -> Path | None:
    """Return the file beside `path` whose name has `new` for `old`; None if there is none."""
    return beside(path.parent, [path.name.replace(old, new)]) if old in path.name else None


def files(path: Path) -> tuple[Path, ...]:
    """Return a table of tracks and the files beside it that are read with it."""
    data = data_set_of(header_of(path))
    sides = (_side_file(path, *pair) for pair in (data.sides if data else ()))
    return (path, *(file for file in sides if file is not None))


def load(path: Path, columns: Mapping[str, str]) -> tuple[pd.DataFrame, dict[str, str]]:
    """Load a table of tracks with the files beside it, and `columns` with the time of a frame;
    LogError without.
    """
    frame, columns = load_table(path), dict(columns)
    data = data_set_of(map(str, frame.columns))
    if data is None:
        return frame, columns
    sides = [
        load_table(file) if (file := _side_file(path, *pair)) else pd.DataFrame()
        for pair in data.sides
    ]
    if data.sides != META:
        return pd.concat([frame, *sides], ignore_index=True), columns
    rates, kinds = sides
    key = data.columns["id"] if data.columns["id"] in kinds else "id"
    if {key, "class"} <= {*kinds}:
        frame["class"] = frame[data.columns["id"]].map(
            kinds.drop_duplicates(key).set_index(key)["class"]
        )
        columns.setdefault("kind", "class")
    if not {"t", *(f"{name}.t" for name in NAMES)} & {*columns}:
        rate = (
            pd.to_numeric(rates["frameRate"], errors="coerce").iloc[0]
            if "frameRate" in rates
            else np.nan
        )
        if not rate > 0.0:
            what = (
                f"the frame rate of {data.name} is in ..._recordingMeta.csv beside the table, "
                "which does not have it"
            )
            remedy = 'copy that file there, or name the rate: [log.columns] t = "frame [25 Hz]"'
            raise LogError(what, topic=path.name, remedy=remedy)
        columns["t"] = f"frame [{rate} Hz]"
    return frame, columns
