"""Tables of tracks without an ego: one of the road users becomes the ego, the others are the
agents.

Those of public data sets are known (`replan.logs.readers.data_sets`). Other tables have replan's
names of columns, or those of `[log.columns]`, and positions of box centres.

(1) upper left corner (highD: x right, y down): centre = (x + length / 2, -(y + width / 2))
(2) front centre (NGSIM, SUMO):                 centre = p - length / 2 (cos yaw, sin yaw)
(3) without headings: the direction of the way come over at least `HEADED_M`

The ego's rear axle is behind the centre of its box as in the default car, in proportion to its
length. Its acceleration, its curvature and, where the table has none, its speed come from parabolas
through its positions (`recorded.driven`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.errors import LogError
from replan.core.names import counted
from replan.logs.agents import USUAL_SIZE_M, AgentKind
from replan.logs.kind_words import kinds_of_tracks
from replan.logs.log_settings import LogSettings
from replan.logs.observed import Spans, of_stream
from replan.logs.readers.clocks import check_restart, continued
from replan.logs.readers.columns import NamedColumns, check_names
from replan.logs.readers.data_sets import DataSet, data_set_of
from replan.logs.readers.recorded import driven
from replan.logs.vehicle import VehicleParameters, assumed_car

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


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows of a table of tracks `(n,)`, by road user and time: id, time in ns, word of the
    kind, and `state` by replan's name of the column; first row and kind of each road user `(m,)`.
    """

    ids: Any
    ns: IntArray
    words: Any
    state: Mapping[str, FloatArray]
    firsts: IntArray
    kinds: list[AgentKind]

    def columns(self, rows: IntArray) -> dict[str, FloatArray]:
        """Return the columns of some rows."""
        return {name: column[rows] for name, column in self.state.items()}


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
    notes = list[str]()
    table = _named_columns(frame, data, settings)
    point = settings.agents_point or data.point
    rows = _sorted_rows(table, point, data, settings, notes)
    ego = _id(ego or data.ego, rows)
    own = np.flatnonzero(rows.ids == ego)
    t = (rows.ns - rows.ns[own[0]]) / 1e9
    if len(own) < 2 or (np.diff(t[own]) <= 0.0).any():
        problem = f"agent {ego} has {'one row' if len(own) < 2 else 'two rows of one time'}"
        raise LogError(problem, topic="agents", remedy="name another one with --ego")
    state = rows.columns(own)
    length, width = (float(np.median(state[name])) for name in ("length", "width"))
    if vehicle is None and np.isfinite(length + width):
        vehicle = assumed_car({"length": length, "width": width}, notes)
        notes.append(
            f"The ego is agent {ego}, {length:.2f} x {width:.2f} m. Its wheelbase of "
            f"{vehicle.wheelbase:.2f} m and its"
            " rear axle are assumed: as in the default car, in proportion to the length."
        )
    end = t[own[-1]]
    is_read = (t >= -BEFORE_S) & (t <= end)
    if not is_read.all():
        notes.append(f"The table lasts {np.ptp(t):.1f} s: the {end:.1f} s of agent {ego} are read.")
    agents = _agents(rows, is_read & (rows.ids != ego))
    ego_states = _ego_states(table, rows.ns[own], t[own], state, notes)
    ego_point = "centre" if point in AHEAD else settings.ego_point or "centre"
    traffic = of_stream(t[is_read])
    return TakenEgo(ego_states, agents, vehicle, tuple(notes), traffic, ego, data.name, ego_point)


def _named_columns(frame: pd.DataFrame, data: DataSet, settings: LogSettings) -> NamedColumns:
    """Return the table with the names of columns that the data set and the settings state; LogError
    if it has several recordings.
    """
    spellings = [column.partition(" [")[0] for column in data.columns.values()]
    by_lower = {name.lower(): name for name in spellings}
    frame = frame.rename(
        columns={name: by_lower.get(str(name).lower(), name) for name in frame.columns}
    )
    check_names(settings.columns, {"agents": frame})
    recording = data.recording
    if recording in frame and frame[recording].nunique() > 1:
        count = frame[recording].nunique()
        problem = f"the table holds {count} recordings, whose ids differ ({recording})"
        raise LogError(problem, topic="agents", remedy=f"keep the rows of one {recording}")
    own = {key.rpartition(".")[2]: name for key, name in settings.columns.items()}
    columns = {**data.columns, **data.optional, **own}
    return NamedColumns(frame, "agents", columns, settings.agents_heading or data.heading)


def _sorted_rows(
    table: NamedColumns, point: str, data: DataSet, settings: LogSettings, notes: list[str]
) -> _Rows:
    """Return the rows by road user and time; `point` is that of the positions."""
    ids = names_of(table)
    ns, is_text = table.times(notes)
    ns, _ = continued(ns, np.empty(0, np.int64), is_text=is_text, notes=notes)
    check_restart(ns, table.numbers("x"), table.numbers("y"), "agents", ids)
    order = np.lexsort((ns, ids))
    ids, ns = ids[order], ns[order]
    firsts = np.flatnonzero(np.r_[True, ids[1:] != ids[:-1]])
    offsets = np.r_[firsts, len(ids)]
    words = words_of(table)[order]
    kinds = list(kinds_of_tracks(words.tolist(), offsets, settings.kinds, data.kinds, notes))
    state = _states(table, point, order, offsets, kinds, notes)
    return _Rows(ids, ns, words, state, firsts, kinds)


def _agents(rows: _Rows, is_read: BoolArray) -> pd.DataFrame:
    """Return the table of the agents in the rows that are read."""
    others = np.flatnonzero(is_read)
    owner = np.searchsorted(rows.firsts, others, side="right") - 1
    kind = np.array(rows.kinds, dtype=object)[owner]
    names = {"t_ns": rows.ns[others], "id": rows.ids[others], "kind": kind}
    return pd.DataFrame(rows.columns(others) | names)


def _states(
    table: NamedColumns,
    point: str,
    order: IntArray,
    offsets: IntArray,
    kinds: list[AgentKind],
    notes: list[str],
) -> dict[str, FloatArray]:
    """Return position of the box centre, heading, velocity and size of each row, `(n,)`; NaN where
    unknown.
    """
    unknown = np.full(len(order), np.nan)

    def column(name: str) -> FloatArray:
        return table.numbers(name)[order] if table.has(name) else unknown.copy()

    x, y, vx, vy = map(column, ("x", "y", "vx", "vy"))
    length, width = column("length"), column("width")
    length[length == 0.0] = width[width == 0.0] = np.nan  # inD: people and riders
    usual = np.repeat([USUAL_SIZE_M[kind] for kind in kinds], np.diff(offsets), axis=0)
    usual_length, usual_width = usual.T
    full_length = np.where(np.isfinite(length), length, usual_length)
    full_width = np.where(np.isfinite(width), width, usual_width)
    if point == "corner":  # (1)
        x = x + 0.5 * full_length
        y, vy = -(y + 0.5 * full_width), -vy
        notes.append(
            "Positions are the upper left corners of boxes in image axes: x stays, y is turned up."
        )
    logged_yaw = table.yaw()
    yaw = unknown if logged_yaw is None else logged_yaw[order]
    is_lacking = ~np.isfinite(yaw)
    if is_lacking.any():  # (3)
        notes.append(
            f"Headings that the table lacks are the direction of the last {HEADED_M:g} m of the "
            "way."
        )
        yaw = np.where(is_lacking, headings(offsets, x, y, HEADED_M), yaw)
    x, y = centres(point, x, y, yaw, full_length, notes)
    if table.has("v") and not (table.has("vx") and table.has("vy")):
        v = table.numbers("v")[order]
        vx, vy = v * np.cos(yaw), v * np.sin(yaw)
    return {
        "x": x,
        "y": y,
        "vx": vx,
        "vy": vy,
        "length": length,
        "width": width,
        "yaw": yaw,
    }


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
    table: NamedColumns,
    ns: IntArray,
    t: FloatArray,
    state: Mapping[str, FloatArray],
    notes: list[str],
) -> pd.DataFrame:
    """Return the table of the ego.

    What is not stated comes from parabolas through its positions.
    """
    x, y, yaw = state["x"], state["y"], state["yaw"]
    if table.yaw() is None and np.hypot(np.ptp(x), np.ptp(y)) < HEADED_M:
        problem = f"the ego moves less than {HEADED_M:g} m and has no heading"
        raise LogError(problem, topic="agents", remedy="name another agent with --ego")
    for name in ("x", "y", "yaw"):
        if not np.isfinite(state[name]).all():
            problem = f"{name} of the ego is not finite in every row"
            raise LogError(problem, topic="agents", remedy="leave such rows out")
    fit = driven(t, x, y, yaw, [])
    v = state["vx"] * np.cos(yaw) + state["vy"] * np.sin(yaw)
    notes.append(
        f"The ego's {'' if np.isfinite(v).all() else 'speed, '}acceleration and curvature are "
        "derived: parabolas fitted to its positions before each state."
    )
    v = np.where(np.isfinite(v), v, fit.v)
    return pd.DataFrame(
        {"t_ns": ns, "x": x, "y": y, "yaw": yaw, "v": v, "a": fit.a, "kappa": fit.kappa}
    )


def _id(ego: str, rows: _Rows) -> str:
    """Return the id of the road user that `ego` names; LogError lists those who drove farthest."""
    ids = rows.ids[rows.firsts]
    can_drive = np.array([kind not in _NO_DRIVERS for kind in rows.kinds])
    by_word = np.flatnonzero(rows.words[rows.firsts] == ego)
    if ego and len(by_word) == 1 and ego not in ids:
        ego = ids[by_word[0]]
    named = np.flatnonzero(ids == ego)
    if len(named) and can_drive[named[0]]:
        return str(ego)
    problem = f"the table has no ego, but {counted(len(ids), 'road user')}"
    if ego:
        problem = f"there is no agent {ego}"
    if len(named):
        problem = f"agent {ego} is a {rows.kinds[named[0]].value}, and cannot be the ego"
    x, y = rows.state["x"], rows.state["y"]
    step = np.hypot(np.diff(x, append=np.nan), np.diff(y, append=np.nan))
    step[np.r_[rows.firsts[1:] - 1, len(step) - 1]] = 0.0
    distance = np.add.reduceat(np.nan_to_num(step), rows.firsts)
    farthest = [i for i in np.lexsort((ids, -distance)) if can_drive[i]][:_SHOWN]
    drove = ", ".join(f"{ids[i]} ({distance[i]:.0f} m)" for i in farthest) or "no vehicle"
    remedy = f"name the ego with --ego ID; these drove farthest: {drove}"
    raise LogError(problem, topic="agents", remedy=remedy)


def _texts(column: pd.Series[Any]) -> Any:
    """Return the values of a column as texts `(n,)`, whole numbers without a point."""
    if pd.api.types.is_float_dtype(column) and (column.dropna() % 1.0 == 0.0).all():
        column = column.astype("Int64")
    return np.array(
        [word.value if isinstance(word, AgentKind) else str(word) for word in column], dtype=str
    )


def words_of(table: NamedColumns, name: str = "kind") -> Any:
    """Return the word of each row `(n,)` in a column of words; "" where it is empty."""
    if not table.has(name):
        return np.full(len(table.frame), "")
    column = table.column(name)[0]
    return np.where(column.isna().to_numpy(), "", _texts(column))


def names_of(table: NamedColumns) -> Any:
    """Return the id of each row `(n,)`, as text; LogError if a row has none."""
    column = table.column("id")[0]
    if column.isna().any():
        problem = f"row {int(column.isna().to_numpy().argmax())} has no id"
        raise LogError(problem, topic=table.name, remedy="name every agent")
    return _texts(column)


def headings(offsets: Any, x: FloatArray, y: FloatArray, least: float) -> FloatArray:
    """Return each agent's direction of motion over at least `least` m.

    First samples get the first known direction.
    """
    yaw = np.zeros(len(x))
    for first, end in pairwise(offsets):
        start, is_known = first, False
        for k in range(first + 1, end):
            yaw[k] = yaw[k - 1]
            dx, dy = x[k] - x[start], y[k] - y[start]
            if np.hypot(dx, dy) >= least:
                yaw[k] = np.arctan2(dy, dx)
                if not is_known:
                    yaw[first:k] = yaw[k]
                start, is_known = k, True
    return yaw
