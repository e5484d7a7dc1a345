"""Tables: pandas frames, CSV and Parquet files.

    ego      t, x, y, yaw    and, where known, v, a, kappa, steer, throttle, brake          one row
             per state
    agents   t, id, x, y     and, where known, yaw, vx, vy or v, length, width, kind      one row
             per agent and time
    both     z, and height of the agents, where known (`replan.logs.heights`)

t is in seconds (any zero), a date and time, or a time of day (`columns`); it may be given as t_ns,
t_us or t_ms. Positions are world coordinates in metres, of the ego's rear axle (or its box centre:
`ego_point`) and the agents' box centres; angles in rad, counter-clockwise from x; speeds in m/s. A
quaternion qx, qy, qz, qw may replace yaw. Names and units of columns: `columns`. Missing columns
are derived and noted (`replan.logs.complete`): the ego's v, the agents' yaw and velocity by
backward differences, sizes by kind.

A log on disk is a folder that holds `ego.csv` or `ego.parquet` and, beside it, `agents.csv` or
`agents.parquet` (`csv_table`). A table of tracks without an ego is a log, too: `track_table`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from replan.core.arrays import FloatArray
from replan.core.errors import LogError, reading
from replan.core.files import beside
from replan.logs.agents import USUAL_SIZE_M
from replan.logs.complete import completed, road_along
from replan.logs.driving import DrivingModes, modes_of_words
from replan.logs.heights import on_the_way
from replan.logs.kind_words import kinds_of_tracks
from replan.logs.log_settings import LogSettings
from replan.logs.observed import Spans
from replan.logs.readers import data_sets, track_table
from replan.logs.readers.base import LogContents, Reader, TopicSummary
from replan.logs.readers.clocks import check_distinct, check_restart, check_zones, continued
from replan.logs.readers.columns import NAMES, QUATERNION, NamedColumns, check_names, with_index
from replan.logs.readers.csv_table import SUFFIXES, load_table
from replan.logs.road import Goal, Road
from replan.logs.scenario import CENTRE, EGO_POSE, Scenario
from replan.logs.states import Controls
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VEHICLE_ASSUMED, VehicleParameters

MOVED_M = 0.2
"""Way over which a heading is derived, m."""


CONVENTIONS = ("ego_point", "agents_point", "ego_heading", "agents_heading")
"""The settings of points and headings."""


def from_frames(
    ego: pd.DataFrame | str | int,
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
    ego_point: str = "",
    agents_point: str = "",
    ego_heading: str = "",
    agents_heading: str = "",
    kinds: Mapping[str, str] | None = None,
    driver: Mapping[str, str] | None = None,
) -> Scenario:
    """Make a scenario from tables of the ego and of the other road users (units and frames:
    docs/logs.md).

    Args:
        ego: One row per state, in any order: t (a column, or the index), x, y, yaw; where known v,
            a, kappa, steer, throttle, brake, driver (who drives). Or the id of the agent that
            becomes the ego: it is taken out of `agents`, whose columns may be those of a data set.
        agents: One row per agent and time: t, id, x, y; where known yaw, vx, vy or v, length,
            width, kind. None: there are no other road users.
        name: Name of the scenario, short and unique within a run.
        columns: Column of the table, with its unit, by replan's name: for both tables ("v"), or for
            one ("ego.v", "agents.v"). Columns that are not listed must have replan's names.
        road: The road in the tables' coordinates; None: one lane along the driven path, with a
            note.
        goal: The goal in the tables' coordinates, or None.
        vehicle: The ego's vehicle; None: that of the agent's size or the default car, with a note.
        tags: Words by which gates and reports group; "recorded" or "synthetic" tells whether a
            person drove.
        source: Origin of the data.
        licence: Licence of the data.
        traffic: When the other agents were observed, s since the first ego row; None: inferred from
            their rows.
        ego_point: Point of the ego whose position the table has: "rear_axle", or "centre", "front"
            or "rear" of its box; "": "rear_axle", of an agent "centre".
        agents_point: The same of the agents; "": "centre".
        ego_heading: Convention of the ego's headings ("degrees clockwise from north" ...,
            `replan.logs.log_settings.HEADINGS`); "": rad, counter-clockwise from x.
        agents_heading: The same of the agents.
        kinds: replan's kind by the table's word for it, for words that replan does not know.
        driver: Who drives ("autonomous", "manual", "steering", "speed") by the words or numbers of
            the ego's column `driver`, for those that replan does not know.

    Raises:
        LogError: A column is missing or not numeric, a unit or kind is unknown, a value is not
            finite, two rows of an agent have the same time, the clock restarts within the rows,
            some dates have a time zone and some have none, or no agent has that id.
    """
    notes = list[str]()
    with reading(topic="[log]"):
        settings = LogSettings(
            columns=columns or {},
            ego_point=ego_point,
            agents_point=agents_point,
            ego_heading=ego_heading,
            agents_heading=agents_heading,
            kinds=kinds or {},
            driver=driver or {},
        )
    agents = None if agents is None else with_index(agents, "agents", settings.columns)
    if not isinstance(ego, pd.DataFrame):
        chosen = track_table.taken_ego(agents, str(ego), settings, vehicle)
        ego, agents = chosen.ego, chosen.agents
        vehicle, notes = chosen.vehicle, list(chosen.notes)
        settings, source = LogSettings(ego_point=chosen.ego_point), source or chosen.data_set
        traffic = chosen.traffic if traffic is None else traffic
    ego = with_index(ego, "ego", settings.columns)
    check_names(settings.columns, {"ego": ego, "agents": agents})
    table = NamedColumns(ego, "ego", settings.columns, settings.ego_heading)
    others = (
        NamedColumns(agents, "agents", settings.columns, settings.agents_heading)
        if agents is not None and len(agents)
        else None
    )
    check_zones({held.name: held.names_zone() for held in (table, others) if held is not None})
    ns, is_text = table.times(notes)
    agents_ns = others.times(notes)[0] if others is not None else np.empty(0, np.int64)
    ns, agents_ns = continued(ns, agents_ns, is_text=is_text, notes=notes)
    start_ns = int(ns.min())
    t = (ns - start_ns) / 1e9
    check_restart(ns, table.numbers("x"), table.numbers("y"), "ego")
    if others is not None:
        check_restart(
            agents_ns,
            others.numbers("x"),
            others.numbers("y"),
            "agents",
            track_table.names_of(others),
        )
    order = np.argsort(t, kind="stable")
    t = t[order]
    check_distinct(t, table.numbers("x")[order], table.numbers("y")[order], "ego")
    origin = np.zeros(2)
    if road is None and goal is None:
        origin = np.round([table.numbers("x")[order[0]], table.numbers("y")[order[0]]])
    state = {key: table.numbers(key)[order] for key in ("x", "y")}
    state["yaw"] = _ego_headings(table, order, state["x"], state["y"], notes)
    car = vehicle or VehicleParameters()
    ahead = _ahead_of_axle(car)[settings.ego_point]
    state["x"] = state["x"] - origin[0] - ahead * np.cos(state["yaw"])
    state["y"] = state["y"] - origin[1] - ahead * np.sin(state["yaw"])
    for key in ("v", "a", "kappa"):
        state[key] = table.numbers(key)[order] if table.has(key) else np.full(len(t), np.nan)
    if vehicle is None:
        notes.append(f"{VEHICLE_ASSUMED}.")
    names = "steer", "throttle", "brake"
    with reading(topic="ego"):
        with np.errstate(all="ignore"):  # absurd numbers are refused as such
            driven = completed({"t": t, **state}, notes)
        places = None
        if table.has("z"):
            places = np.column_stack([driven.x, driven.y, table.numbers("z")[order]])
        tracks = _tracks(others, (agents_ns - start_ns) / 1e9, origin, places, settings, notes)
        pedals = (
            table.numbers(key)[order] if table.has(key) else np.full(len(t), np.nan)
            for key in names
        )
        # No log time before 0
        start_ns -= min(0, start_ns + min(0, round(1e9 * float(tracks.t.min(initial=0.0)))))
        return Scenario(
            name=name,
            ego=driven,
            tracks=tracks,
            road=road_along(driven, notes) if road is None else road,
            duration=float(t[-1]),
            goal=goal,
            vehicle=car,
            controls=Controls(t, *pedals) if any(map(table.has, names)) else None,
            tags=tags,
            source=source,
            licence=licence,
            origin=(float(origin[0]), float(origin[1])),
            start_ns=start_ns,
            metadata={EGO_POSE: CENTRE} if settings.ego_point == "centre" else {},
            notes=tuple(notes),
            traffic=traffic,
            driving=_driving(table, t, order, settings),
        )


def _driving(
    table: NamedColumns, t: FloatArray, order: Any, settings: LogSettings
) -> DrivingModes | None:
    """Return who drives, of the column `driver` in the ego's table."""
    if not table.has("driver"):
        return None
    modes = modes_of_words(track_table.words_of(table, "driver")[order].tolist(), settings.driver)
    latency_s = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    source = f"the column {table.column('driver')[0].name}"
    return DrivingModes.of_samples(t, modes, source, latency_s)


def _ahead_of_axle(car: VehicleParameters) -> dict[str, float]:
    """Return the places of the points `POINTS` before the rear axle, m."""
    return {
        "": 0.0,
        "rear_axle": 0.0,
        "centre": car.axle_to_center,
        "front": car.axle_to_front,
        "rear": -car.rear_overhang,
    }


def _ego_headings(
    table: NamedColumns, order: Any, x: FloatArray, y: FloatArray, notes: list[str]
) -> FloatArray:
    """Return the headings `(n,)` of the ego's rows in the order of their times, rad.

    Without a column, they are the direction of the way, with a note; LogError for an ego that
    stands.
    """
    turns = table.yaw()
    if turns is not None:
        return turns[order]
    if np.hypot(np.ptp(x), np.ptp(y)) < track_table.HEADED_M:
        table.column("yaw")  # says that it is missing
    notes.append(
        f"The log has no headings of the ego: they are the direction of the last "
        f"{track_table.HEADED_M:g} m of its way."
    )
    return track_table.headings(np.array([0, len(x)]), x, y, track_table.HEADED_M)


def _tracks(
    table: NamedColumns | None,
    t: FloatArray,
    origin: FloatArray,
    places: FloatArray | None,
    settings: LogSettings,
    notes: list[str],
) -> Tracks:
    """Make the tracks of a table with the times `t` `(n,)`, s.

    `places` `(k, 3)` are the ego's, None without heights.
    """
    if table is None:
        return Tracks.empty()
    for name in filter(table.has, ("x", "y", "yaw", *QUATERNION)):
        wrong = np.flatnonzero(~np.isfinite(table.numbers(name)))
        if len(wrong):
            raise LogError(
                f"{name} is not finite in row {wrong[0]}",
                topic="agents",
                remedy="leave such rows out",
            )
    for name in ("length", "width"):
        if table.has(name) and (table.numbers(name) <= 0.0).any():
            raise LogError(
                f"a {name} is not positive",
                topic="agents",
                remedy="leave it empty where it is not known",
            )
    names = track_table.names_of(table)
    x, y = table.numbers("x") - origin[0], table.numbers("y") - origin[1]
    order = np.lexsort((t, names))
    names, t = names[order], t[order]
    x, y = x[order], y[order]
    first = np.flatnonzero(np.r_[True, names[1:] != names[:-1]])
    offsets = np.r_[first, len(names)]
    check_distinct(t, x, y, "agents", names)
    turns = table.yaw()
    if turns is None:
        notes.append(
            "The log has no headings of the agents: they are those of the way come, the first of "
            "the way that they then go."
        )
        turns = np.empty(len(x))
        turns[order] = track_table.headings(offsets, x, y, MOVED_M)
    yaw = turns[order]
    vx = vy = np.full(len(yaw), np.nan)  # `Tracks` derives them
    if table.has("vx") and table.has("vy"):
        vx, vy = table.numbers("vx")[order], table.numbers("vy")[order]
    elif table.has("v"):
        v = table.numbers("v")[order]
        vx, vy = v * np.cos(yaw), v * np.sin(yaw)
    words = track_table.words_of(table)[order].tolist()
    kinds = kinds_of_tracks(words, offsets, settings.kinds, {}, notes)
    sizes = []
    # Median of the agent's rows, else usual size
    for column, name in enumerate(("length", "width")):
        size = np.array([USUAL_SIZE_M[kind][column] for kind in kinds])
        if table.has(name):
            has_size = np.array(
                [np.median(part) for part in np.split(table.numbers(name)[order], first[1:])]
            )
            size = np.where(np.isfinite(has_size) & (has_size > 0.0), has_size, size)
        else:
            notes.append(f"The log has no {name} of the agents: it is assumed by their kind.")
        sizes.append(size)
    x, y = track_table.centres(
        settings.agents_point, x, y, yaw, np.repeat(sizes[0], np.diff(offsets)), notes
    )
    keep = np.ones(len(x), np.bool_)
    if table.has("z") and places is not None:
        boxes = np.column_stack([x, y, table.numbers("z")[order]])
        height = table.numbers("height")[order] if table.has("height") else np.full(len(x), np.nan)
        keep = on_the_way(places, boxes, yaw, height, names.tolist(), notes)
    static = np.zeros(len(first), np.bool_)
    ids = tuple(map(str, names[first]))
    tracks = Tracks(ids, kinds, sizes[0], sizes[1], static, offsets, t, x, y, yaw, vx, vy)
    return tracks if keep.all() else tracks.taken(keep)


def _file(folder: Path, name: str) -> Path | None:
    """Return the file of table `name` in a log's folder, or None; LogError as in `beside`.

    A file of that name with another suffix raises LogError, as its content would silently be left
    out.
    """
    path = beside(folder, [f"{name}{suffix}" for suffix in SUFFIXES])
    others = sorted(
        file.name for file in folder.iterdir() if file.name.casefold().partition(".")[0] == name
    )
    if path is None and others:
        problem = (
            f"{others[0]} is not read: a table is "
            f"{' or '.join(f'{name}{suffix}' for suffix in SUFFIXES)}"
        )
        raise LogError(problem, topic=others[0], remedy="convert it, or remove it from the folder")
    return path


def _claims(path: Path) -> bool:
    try:
        if path.is_dir() and any((path / f"ego{suffix}").is_file() for suffix in SUFFIXES):
            return True
        return data_sets.claims(path)
    except OSError:
        return False


def _files(path: Path) -> tuple[Path, ...]:
    if not path.is_dir():
        return data_sets.files(path)
    return tuple(file for name in NAMES if (file := _file(path, name)) is not None)


def _read(path: Path, settings: LogSettings) -> Scenario:
    ego, agents = (_file(path, name) for name in NAMES) if path.is_dir() else (None, path)
    notes = list[str]()
    vehicle = settings.vehicle(notes)
    conventions = {
        name: getattr(settings, name)
        for name in (
            "ego_point",
            "agents_point",
            "ego_heading",
            "agents_heading",
            "kinds",
            "driver",
        )
    }
    columns, name = settings.columns, path.name
    table: pd.DataFrame | str
    others: pd.DataFrame | None
    if ego is None and agents is not None:
        table = settings.ego
        others, columns = data_sets.load(agents, settings.columns)
        name = path.stem if agents == path else path.name
        name += f"_ego{settings.ego}" if settings.ego else ""
    elif ego is None:
        raise LogError(
            "there is no ego.csv or ego.parquet in it",
            remedy="a table of the ego is what a log needs",
        )
    elif settings.ego:
        problem = f"ego {settings.ego} is asked for, but {ego.name} has the ego"
        raise LogError(problem, topic="[log]", remedy="leave ego out, or move that file away")
    else:
        table, others = load_table(ego), None if agents is None else load_table(agents)
    scenario = from_frames(
        table,
        others,
        name=name,
        columns=columns,
        vehicle=vehicle,
        tags=("recorded", "table"),
        **conventions,
    )
    return replace(scenario, notes=(*notes, *scenario.notes))


def _contents(path: Path) -> LogContents:
    topics = []
    try:
        files = _files(path)
    except LogError:
        files = ()
    for file in files:
        try:
            frame = load_table(file)
        except LogError:
            continue
        columns = ", ".join(map(str, frame.columns))
        topics.append(TopicSummary(file.name, columns, file.suffix[1:], "", len(frame), None, None))
    return LogContents("", tuple(topics))


READER = Reader(
    "table",
    "tables of ego and agents, or of tracks (highD, inD, INTERACTION, NGSIM ...), CSV or Parquet",
    "folders with ego.csv or ego.parquet, tables of tracks",
    (),
    _claims,
    _read,
    files=_files,
    contents=_contents,
    settings=(
        "ego",
        *CONVENTIONS,
        "kinds",
        "driver",
        "columns",
        "car",
    ),
    claims_with=lambda path, settings: (
        bool(settings.columns) and not path.is_dir() and data_sets.claims(path, settings.columns)
    ),
)
