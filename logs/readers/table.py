"""Tables: pandas frames, CSV and Parquet files.

    ego      t, x, y, yaw    and, where known, v, a, kappa, steer, throttle, brake          one row per state
    agents   t, id, x, y     and, where known, yaw, vx, vy or v, length, width, kind      one row per agent and time

t is in seconds (any zero), or a date and time; it may be given as t_ns, t_us or t_ms. Positions are world coordinates
in metres, of the ego's rear axle and the agents' box centres; angles in rad, counter-clockwise from x; speeds in m/s.
`columns` maps these names to those of the table, with a unit in brackets if it differs: "heading [deg]",
"speed [km/h]" (`UNITS`). A unit in the table's header is used, too: "v [km/h]", "v (km/h)", "v_kmh". Missing columns
are derived and noted (`logs.mcap.complete`): the ego's v, the agents' yaw and velocity by backward
differences, sizes by kind.

A log on disk is a folder that holds `ego.csv` or `ego.parquet` and, beside it, `agents.csv` or `agents.parquet`. The
columns of a CSV file are separated by commas, semicolons or tabs; with the latter two numbers may have decimal commas.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from logs.agents import USUAL_SIZE_M
from logs.errors import LogError
from logs.kernel import FloatArray
from logs.mcap.complete import completed, road_along
from logs.observed import Spans
from logs.readers.base import Contents, LogSettings, Reader, TopicSummary, beside
from logs.road import Goal, Road
from logs.scenario import AgentKind, Scenario, Tracks
from logs.states import Controls
from logs.vehicle import VEHICLE_ASSUMED, VehicleParameters

NAMES = ("ego", "agents")
SUFFIXES = (".csv", ".parquet")
DIMENSIONS = {
    "length": {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "ft": 0.3048},
    "angle": {"rad": 1.0, "deg": np.pi / 180.0, "mrad": 1e-3},
    "speed": {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704, "kn": 1852.0 / 3600.0},
    "acceleration": {"m/s2": 1.0, "g": 9.80665},
    "curvature": {"1/m": 1.0},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "share": {"1": 1.0, "%": 0.01},
}
UNITS = {"": 1.0} | {unit: factor for units in DIMENSIONS.values() for unit, factor in units.items()}
"""Factor to replan's unit, by the unit in brackets after a column's name."""
SPELLINGS = {
    "mps": "m/s", "kmh": "km/h", "kph": "km/h", "km/hr": "km/h", "kmph": "km/h", "mps2": "m/s2", "m/s^2": "m/s2",
    "m/s\u00b2": "m/s2", "m/s/s": "m/s2", "ms2": "m/s2", "\u00b5s": "us", "\u03bcs": "us", "sec": "s", "msec": "ms",
    "usec": "us", "nsec": "ns", "degree": "deg", "degrees": "deg", "\u00b0": "deg", "radian": "rad", "radians": "rad",
    "meter": "m", "meters": "m", "metre": "m", "metres": "m", "seconds": "s", "m^-1": "1/m", "rad/m": "1/m",
    "per_m": "1/m", "knots": "kn", "percent": "%", "-": "1",
}  # fmt: skip
"""Other spellings of units."""
TIMES = {"t": "s", "t_ms": "ms", "t_us": "us", "t_ns": "ns"}
"""Replan's names of the time column, and their default units."""
ALIASES = {
    "vehicle": "car", "person": "pedestrian", "cyclist": "bicycle", "motorcyclist": "motorcycle", "van": "car",
    "bike": "bicycle", "motorbike": "motorcycle", "unknown": "object", "static": "object", "trailer": "truck",
}  # fmt: skip
"""Kinds by other common words."""
MOVED_M = 0.2
"""Way over which a heading is derived, m."""
_WITH_UNIT = re.compile(r"^(?P<name>.*?)\s*(?:\[(?P<unit>[^\]]*)\]|\((?P<unit2>[^)]*)\))\s*$", re.DOTALL)
SEPARATORS = (",", ";", "\t")
_NUMBER = r"\s*[-+]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][-+]?\d+)?\s*"
FIRST_LINE = 1 << 20
"""Number of characters of the first line that are searched for the separator."""


def from_frames(
    ego: pd.DataFrame,
    agents: pd.DataFrame | None = None,
    *,
    name: str = "table",
    columns: Mapping[str, str] | None = None,
    road: Road | None = None,
    goal: Goal | None = None,
    vehicle: VehicleParameters | None = None,
    tags: tuple[str, ...] = ("recorded",),
    source: str = "",
    licence: str = "",
    traffic: Spans | None = None,
) -> Scenario:
    """Make a scenario from tables of the ego and of the other road users (units and frames: docs/logs.md).

    Args:
        ego: One row per state, in any order: t, x, y, yaw; where known v, a, kappa, steer, throttle, brake.
        agents: One row per agent and time: t, id, x, y; where known yaw, vx, vy or v, length, width, kind. None: there
            are no other road users.
        name: Name of the scenario, short and unique within a run.
        columns: Column of the table, with its unit, by replan's name: for both tables ("v"), or for one ("ego.v",
            "agents.v"). Columns that are not listed must have replan's names.
        road: The road in the tables' coordinates; None: one lane along the driven path, with a note.
        goal: The goal in the tables' coordinates, or None.
        vehicle: The ego's vehicle; None: the default car, with a note.
        tags: Words by which gates and reports group; "recorded" or "synthetic" tells whether a person drove.
        source: Origin of the data.
        licence: Licence of the data.
        traffic: When the other agents were observed, s since the first ego row; None: inferred from their rows.

    Raises:
        LogError: A column is missing or not numeric, a unit or kind is unknown, a value is not finite, or two rows of
            an agent have the same time.
    """
    _check_names(columns or {}, {"ego": ego, "agents": agents})
    table, notes = _Table(ego, "ego", columns or {}), list[str]()
    start_ns, t = table.times()
    order = np.argsort(t, kind="stable")
    t = t[order]
    twice = np.flatnonzero(np.diff(t) <= 0.0)
    if len(twice):
        raise LogError(f"two rows have the time {t[twice[0]]:g} s", topic="ego", remedy="keep one of them")
    origin = np.zeros(2)
    if road is None and goal is None:
        origin = np.round([table.numbers("x")[order[0]], table.numbers("y")[order[0]]])
    state = {key: table.numbers(key)[order] for key in ("x", "y", "yaw")}
    state["x"], state["y"] = state["x"] - origin[0], state["y"] - origin[1]
    for key in ("v", "a", "kappa"):
        state[key] = table.numbers(key)[order] if table.has(key) else np.full(len(t), np.nan)
    if not table.has("v"):
        notes.append("The log has no ego speed: it is derived from the positions by backward differences.")
        state["v"] = np.zeros(len(t))
        if len(t) > 1:
            dx, dy, yaw = np.diff(state["x"]), np.diff(state["y"]), state["yaw"][1:]
            v = (dx * np.cos(yaw) + dy * np.sin(yaw)) / np.diff(t)
            state["v"] = np.r_[v[0], v]
    if vehicle is None:
        notes.append(f"{VEHICLE_ASSUMED}.")
    names = "steer", "throttle", "brake"
    try:
        with np.errstate(all="ignore"):  # absurd numbers are refused as such
            driven = completed({"t": t, **state}, notes)
        tracks = _tracks(agents, columns or {}, start_ns, origin, notes)
        pedals = (table.numbers(key)[order] if table.has(key) else np.full(len(t), np.nan) for key in names)
        start_ns -= min(0, start_ns + min(0, round(1e9 * float(tracks.t.min(initial=0.0)))))  # no log time before 0
        return Scenario(
            name=name,
            ego=driven,
            tracks=tracks,
            road=road_along(driven, notes) if road is None else road,
            duration=float(t[-1]),
            goal=goal,
            vehicle=vehicle or VehicleParameters(),
            controls=Controls(t, *pedals) if any(map(table.has, names)) else None,
            tags=tags,
            source=source,
            licence=licence,
            origin=(float(origin[0]), float(origin[1])),
            start_ns=start_ns,
            notes=tuple(notes),
            traffic=traffic,
        )
    except ValueError as error:
        raise LogError(str(error), topic="ego") from None


class _Table:
    """A data frame whose columns are found by replan's names."""

    def __init__(self, frame: pd.DataFrame, name: str, columns: Mapping[str, str]) -> None:
        self.frame, self.name = frame, name
        self._headers = [(str(header), header) for header in frame.columns]
        given = {ours: columns.get(f"{name}.{ours}", columns.get(ours, ours)) for ours in (*TIMES, *_COLUMNS)}
        self._columns = {ours: self._find_column(ours, theirs) for ours, theirs in given.items()}
        if not len(frame):
            raise LogError("the table has no rows", topic=name, remedy="give at least one")

    def _find_column(self, ours: str, given: str) -> tuple[Any, float] | None:
        """Return the table's header of a column and the factor of its unit; None if there is no such column.

        The header is `given`, or `given` without its unit, or followed by the header's own unit. If both have a unit,
        the units must be the same.
        """
        name, asked = _split_unit(given)
        exact = [header for text, header in self._headers if text == given]
        whole = [header for text, header in self._headers if text == name]
        parts = [(header, *_split_unit(text)) for text, header in self._headers]
        short = [header for header, base, unit in parts if unit and base == name]
        short += [header for header, base, unit in _with_suffix(self._headers, ours) if base == name]
        found = list(dict.fromkeys(exact or whole or short))
        if not found:
            return None
        if len(found) > 1:
            what = f"{name} may be {' or '.join(map(str, found))}"
            raise LogError(what, topic=self.name, remedy=f'name one: columns = {{{ours} = "{found[0]}"}}')
        held, header = "", str(found[0])
        if exact or not whole:  # the unit in the header itself
            held = _split_unit(header)[1] or "".join(unit for _, _, unit in _with_suffix([(header, header)], ours))
        units, known = [], DIMENSIONS.get(_DIMENSION.get(ours, ""), {})
        for unit in filter(None, (asked, held)):  # as `UNITS` spells it
            plain = SPELLINGS.get(unit, SPELLINGS.get(unit.lower(), unit if unit in UNITS else unit.lower()))
            if plain not in known:
                wrong = "is unknown" if plain not in UNITS else f"is none of {ours}"
                what, names = f"the unit [{unit}] of {header} {wrong}", ", ".join(known) or "none"
                remedy = f'known: {names}; another name is given as columns = {{{ours} = "NAME [unit]"}}'
                raise LogError(what, topic=self.name, remedy=remedy)
            units.append(plain)
        if len(set(units)) > 1:
            raise LogError(f"{found[0]} is asked for in [{asked}]", topic=self.name, remedy="leave that unit out")
        return found[0], UNITS[units[0] if units else TIMES.get(ours, "")]

    def has(self, ours: str) -> bool:
        """Return whether the table has this column."""
        return self._columns[ours] is not None

    def column(self, ours: str) -> tuple[pd.Series[Any], float]:
        """Return a column and the factor to replan's unit.

        Raises:
            LogError: The table has no such column.
        """
        found = self._columns[ours]
        if found is None:
            held = ", ".join(map(str, self.frame.columns[:12]))
            what = f"the table has no column {ours}; it has {held}"
            remedy = f'name it: columns = {{{ours} = "its name [unit]"}}'
            if len(self.frame.columns) == 1:
                remedy = "separate the columns of the file by commas, semicolons or tabs"
            raise LogError(what, topic=self.name, remedy=remedy)
        return self.frame[found[0]], found[1]

    def numbers(self, ours: str) -> FloatArray:
        """Return a column in replan's unit `(n,)`; NaN where it is empty."""
        column, factor = self.column(ours)
        try:
            return np.asarray(pd.to_numeric(column), dtype=np.float64) * factor
        except (ValueError, TypeError) as error:
            raise LogError(f"{column.name} is not a column of numbers: {error}", topic=self.name) from None

    def times(self, start_ns: int | None = None) -> tuple[int, FloatArray]:
        """Return the earliest time (or `start_ns`), ns, and the seconds of each row since then `(n,)`."""
        ours = next((name for name in TIMES if self.has(name)), "t")
        column, factor = self.column(ours)
        if pd.api.types.is_datetime64_any_dtype(column):
            ns = pd.DatetimeIndex(column).as_unit("ns").asi8
        elif pd.api.types.is_integer_dtype(column):
            ns = column.to_numpy().astype(np.int64) * round(factor * 1e9)
        else:
            seconds = self.numbers(ours)
            if not np.isfinite(seconds).all():
                raise LogError(f"{column.name} is not finite in every row", topic=self.name)
            if np.abs(seconds).max() > LAST_S:
                raise LogError(f"{column.name} is beyond any clock", topic=self.name, remedy="give its unit: [ns]")
            ns = np.round(seconds * 1e9).astype(np.int64)
        first = int(ns.min()) if start_ns is None else start_ns
        return first, (ns - first) / 1e9


LAST_S = 9e9
"""Greatest time, s: about the greatest that fits into 64 bits of nanoseconds."""
_COLUMNS = (
    "x", "y", "yaw", "v", "a", "kappa", "steer", "throttle", "brake", "id", "vx", "vy", "length", "width", "kind",
)  # fmt: skip


_DIMENSION = (
    dict.fromkeys(TIMES, "time")
    | dict.fromkeys(("x", "y", "length", "width"), "length")
    | dict.fromkeys(("yaw", "steer"), "angle")
    | dict.fromkeys(("v", "vx", "vy"), "speed")
    | dict.fromkeys(("throttle", "brake"), "share")
    | {"a": "acceleration", "kappa": "curvature"}
)
"""Dimension of each of replan's columns."""


def _split_unit(text: str) -> tuple[str, str]:
    """A header, and the unit in brackets behind it ("": none)."""
    match = _WITH_UNIT.match(text)
    return (match["name"], (match["unit"] or match["unit2"] or "").strip()) if match else (text, "")


def _with_suffix(headers: Sequence[tuple[str, Any]], ours: str) -> Iterator[tuple[Any, str, str]]:
    """Yield headers that end in a unit of the column ("speed_kmh"): header, text before the unit, unit."""
    known = DIMENSIONS.get(_DIMENSION.get(ours, ""), {})
    for text, header in headers:
        base, _, unit = text.rpartition("_")
        if base and SPELLINGS.get(unit.lower(), unit.lower()) in known:
            yield header, base, unit


def _check_names(columns: Mapping[str, str], frames: Mapping[str, pd.DataFrame | None]) -> None:
    """Raise LogError for unknown names, and for columns that no table has, which would silently be derived."""
    known = (*TIMES, *_COLUMNS)
    held = [_Table(frame, name, columns) for name, frame in frames.items() if frame is not None and len(frame)]
    for key, given in columns.items():
        of, _, ours = key.rpartition(".")
        if ours not in known or of not in ("", *NAMES):
            what = f"columns has {key}, which is not a known name"
            raise LogError(what, topic="[log]", remedy=f"known: {', '.join(known)}; of one table: ego.v, agents.v ...")
        if held and not any(table.has(ours) for table in held if of in ("", table.name)):
            raise LogError(f"no table has the column {given} that {key} is read from", topic="[log] columns")


def _tracks(
    frame: pd.DataFrame | None, columns: Mapping[str, str], start_ns: int, origin: FloatArray, notes: list[str]
) -> Tracks:
    if frame is None or not len(frame):
        return Tracks.empty()
    table = _Table(frame, "agents", columns)
    nameless = table.column("id")[0].isna()
    if nameless.any():
        raise LogError(f"row {int(nameless.argmax())} has no id", topic="agents", remedy="name every agent")
    for name in filter(table.has, ("x", "y", "yaw")):
        wrong = np.flatnonzero(~np.isfinite(table.numbers(name)))
        if len(wrong):
            raise LogError(f"{name} is not finite in row {wrong[0]}", topic="agents", remedy="leave such rows out")
    for name in ("length", "width"):
        if table.has(name) and (table.numbers(name) <= 0.0).any():
            raise LogError(f"a {name} is not positive", topic="agents", remedy="leave it empty where it is not known")
    names = table.column("id")[0].astype(str).to_numpy()
    _, t = table.times(start_ns)
    order = np.lexsort((t, names))
    names, t = names[order], t[order]
    first = np.flatnonzero(np.r_[True, names[1:] != names[:-1]])
    offsets = np.r_[first, len(names)]
    same = np.flatnonzero((np.diff(t) <= 0.0) & (names[1:] == names[:-1]))
    if len(same):
        what = f"agent {names[same[0]]} has two rows at {t[same[0]]:g} s"
        raise LogError(what, topic="agents", remedy="keep one of them")
    x, y = table.numbers("x")[order] - origin[0], table.numbers("y")[order] - origin[1]
    yaw = table.numbers("yaw")[order] if table.has("yaw") else _headings(offsets, x, y, notes)
    vx = vy = np.full(len(yaw), np.nan)  # `Tracks` derives them
    if table.has("vx") and table.has("vy"):
        vx, vy = table.numbers("vx")[order], table.numbers("vy")[order]
    elif table.has("v"):
        v = table.numbers("v")[order]
        vx, vy = v * np.cos(yaw), v * np.sin(yaw)
    kinds = tuple(_kind(word) for word in table.column("kind")[0].to_numpy()[order][first]) if table.has("kind") else ()
    if not kinds:
        notes.append("The log does not say what the agents are: they are taken for cars.")
        kinds = (AgentKind.CAR,) * len(first)
    sizes = []
    for column, name in enumerate(("length", "width")):  # median of the agent's rows, else usual size
        size = np.array([USUAL_SIZE_M[kind][column] for kind in kinds])
        if table.has(name):
            given = np.array([np.median(part) for part in np.split(table.numbers(name)[order], first[1:])])
            size = np.where(np.isfinite(given) & (given > 0.0), given, size)
        else:
            notes.append(f"The log has no {name} of the agents: it is assumed by their kind.")
        sizes.append(size)
    static = np.zeros(len(first), np.bool_)
    ids = tuple(map(str, names[first]))
    return Tracks(ids, kinds, sizes[0], sizes[1], static, offsets, t, x, y, yaw, vx, vy)


def _headings(offsets: Any, x: FloatArray, y: FloatArray, notes: list[str]) -> FloatArray:
    """Return each agent's direction of motion over at least `MOVED_M`; first samples get the first known direction."""
    notes.append(
        "The log has no headings of the agents: they are those of the way come, the first of the way that they then go."
    )
    yaw = np.zeros(len(x))
    for first, end in pairwise(offsets):
        at, known = first, False
        for k in range(first + 1, end):
            yaw[k] = yaw[k - 1]
            if np.hypot(x[k] - x[at], y[k] - y[at]) >= MOVED_M:
                yaw[k] = np.arctan2(y[k] - y[at], x[k] - x[at])
                if not known:
                    yaw[first:k] = yaw[k]
                at, known = k, True
    return yaw


def _kind(word: Any) -> AgentKind:
    if isinstance(word, AgentKind):
        return word
    name = str(word).strip().lower()
    try:
        return AgentKind(ALIASES.get(name, name))
    except ValueError:
        known = ", ".join(kind.value for kind in AgentKind)
        raise LogError(f"an agent is a {word!r}", topic="agents", remedy=f"known kinds: {known}") from None


def _file(folder: Path, name: str) -> Path | None:
    """Return the file of table `name` in a log's folder, or None; LogError as in `beside`.

    A file of that name with another suffix raises LogError, as its content would silently be left out.
    """
    path = beside(folder, [f"{name}{suffix}" for suffix in SUFFIXES])
    others = sorted(each.name for each in folder.iterdir() if each.name.casefold().partition(".")[0] == name)
    if path is None and others:
        what = f"{others[0]} is not read: a table is {' or '.join(f'{name}{suffix}' for suffix in SUFFIXES)}"
        raise LogError(what, topic=others[0], remedy="convert it, or remove it from the folder")
    return path


def _claims(path: Path) -> bool:
    try:
        return path.is_dir() and any((path / f"ego{suffix}").is_file() for suffix in SUFFIXES)
    except OSError:
        return False


def _files(path: Path) -> tuple[Path, ...]:
    return tuple(file for name in NAMES if (file := _file(path, name)) is not None)


def _load_table(path: Path) -> pd.DataFrame:
    """Load a table; the separator of CSV is the one that splits the first line into most fields, else the comma."""
    import pyarrow as pa

    try:
        if path.suffix == ".parquet":
            return pd.read_parquet(path)
        with path.open(encoding="utf-8-sig", newline="") as stream:
            first = stream.readline(FIRST_LINE)
        counts = {mark: len(next(csv.reader([first], delimiter=mark), [])) for mark in SEPARATORS}
        mark = max(SEPARATORS, key=lambda each: counts[each])
        table = pd.read_csv(path, sep=mark, encoding="utf-8-sig")
        for name in () if mark == "," else table.columns:
            words = table[name].dropna().astype(str)
            if words.str.fullmatch(_NUMBER).all() and words.str.contains(",", regex=False).any():
                table[name] = table[name].astype(str).str.replace(",", ".", regex=False)
        return table
    except UnicodeDecodeError as error:
        raise LogError(f"the table is no UTF-8: {error}", topic=path.name, remedy="write it as UTF-8") from None
    except (OSError, ValueError, LookupError, TypeError, csv.Error, pa.ArrowException, OverflowError) as error:
        what = " ".join(str(error).split())[:200]
        raise LogError(f"the table cannot be read: {what}", topic=path.name, remedy="write it again") from None


def _read(path: Path, settings: LogSettings) -> Scenario:
    ego = _file(path, "ego")
    if ego is None:
        raise LogError("there is no ego.csv or ego.parquet in it", remedy="a table of the ego is what a log needs")
    agents = _file(path, "agents")
    vehicle = settings.vehicle() if settings.car else None
    frames = _load_table(ego), None if agents is None else _load_table(agents)
    return from_frames(*frames, name=path.name, columns=settings.columns, vehicle=vehicle, tags=("recorded", "table"))


def _contents(path: Path) -> Contents:
    topics = []
    try:
        files = _files(path)
    except LogError:
        files = ()
    for file in files:
        try:
            frame = _load_table(file)
        except LogError:
            continue
        columns = ", ".join(map(str, frame.columns))
        topics.append(TopicSummary(file.name, columns, file.suffix[1:], "", len(frame), None, None))
    return Contents("", tuple(topics))


READER = Reader(
    "table", "tables of ego and agents, CSV or Parquet", "folders with ego.csv or ego.parquet", (), _claims, _read,
    files=_files, contents=_contents, settings=("columns", "car"),
)  # fmt: skip
