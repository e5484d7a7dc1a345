"""An Argoverse 2 motion-forecasting scenario -> Scenario: 11 s of tracks at 10 Hz, with velocities, without sizes.

The ego is the track "AV" (`ego` of the settings: another vehicle). Places are taken as centres of boxes; sizes are
those usual for the kind. All 11 s are read: what the forecaster is asked for is past for a replay.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from logs.agents import AgentKind
from logs.errors import LogError
from logs.kernel import BoolArray, FloatArray, IntArray
from logs.mcap.complete import completed
from logs.observed import of_stream
from logs.readers.argoverse2 import scenario_id
from logs.readers.argoverse2.map import map_beside, road_for
from logs.readers.argoverse2.sensor import FORD_FUSION, LICENCE
from logs.readers.base import Contents, LogSettings, TopicSummary
from logs.readers.recorded.boxes import Boxes, car_of, ordered, tracks_of
from logs.readers.recorded.poses import driven
from logs.readers.recorded.tables import numbers, parquet_table, reading, whole, words
from logs.scenario import Scenario
from logs.states import Trajectory
from logs.vehicle import VehicleParameters

EGO = "AV"
RATE_HZ = 10.0
KINDS = {
    "vehicle": AgentKind.CAR, "bus": AgentKind.BUS, "pedestrian": AgentKind.PEDESTRIAN, "cyclist": AgentKind.BICYCLE,
    "motorcyclist": AgentKind.MOTORCYCLE, "riderless_bicycle": AgentKind.BICYCLE,
}  # fmt: skip
"""Others ("static", "background", "construction", "unknown") are objects."""
PLACE = ("position_x", "position_y", "heading", "velocity_x", "velocity_y")
COLUMNS = ("track_id", "object_type", "timestep", *PLACE)
MOST_STEPS = 1_000_000


def contents_of(path: Path) -> Contents:
    """How many tracks' samples there are."""
    try:
        steps = whole(parquet_table(path, ("timestep",)), "timestep")
    except (LogError, ValueError):
        return Contents("Argoverse 2 motion-forecasting scenario that cannot be read")
    topic = TopicSummary("tracks", "parquet", "parquet", "parquet", len(steps), None, None)
    return Contents("Argoverse 2 motion-forecasting scenario", (topic,))


def read_forecasting(path: Path, settings: LogSettings) -> Scenario:
    """Read a scenario's Parquet file and the map beside it; LogError where it cannot be used."""
    notes: list[str] = []
    table = parquet_table(path, COLUMNS)
    with reading(path):
        (owner, names), (kind, kinds) = words(table, "track_id"), words(table, "object_type")
        step = whole(table, "timestep")
        if (np.abs(step) > MOST_STEPS).any():
            raise LogError(f"a time step is beyond {MOST_STEPS}")
        state = np.column_stack([numbers(table, name) for name in PLACE])
        its = _ego_rows(owner, names, step, state, settings.ego or EGO)
        origin = np.round(state[its[0], :2])
        state[:, :2] -= origin
        t = (step - step[its[0]]) / RATE_HZ
        vehicle = car_of({**FORD_FUSION, **settings.car}, notes)
        ego = _ego(t[its], state[its], vehicle, notes)
        others = owner != owner[its[0]]
        boxes = _boxes(names, t, owner, state, others, _kinds(owner, kind, kinds, len(names)))
        tracks = tracks_of(ordered(boxes, notes), notes)
    notes.append("Places are taken as centres of boxes.")
    return Scenario(
        name=path.stem,
        ego=ego,
        tracks=tracks,
        road=road_for(map_beside(path.parent, scenario_id(path)), origin, ego, notes),
        duration=float(ego.t[-1]),
        vehicle=vehicle,
        tags=("argoverse2", "recorded"),
        source="Argoverse 2 motion-forecasting scenario",
        licence=LICENCE,
        origin=(float(origin[0]), float(origin[1])),
        start_ns=round(1e9 * int(step[its[0]] - step.min()) / RATE_HZ),
        metadata={"scenario_id": scenario_id(path), "ego": settings.ego or EGO},
        notes=tuple(notes),
        traffic=of_stream(t),
    )


def _ego_rows(owner: IntArray, names: list[str], step: IntArray, state: FloatArray, ego: str) -> IntArray:
    """The rows of the ego by time."""
    if ego not in names:
        some = ", ".join(names[:8]) or "none"
        raise LogError(f"there is no track '{ego}'", topic="track_id", remedy=f"name the ego; there are {some}")
    rows = np.flatnonzero(owner == names.index(ego))
    rows = rows[np.unique(step[rows], return_index=True)[1]]
    if not np.isfinite(state[rows, :3]).all():
        raise LogError(f"a pose of track '{ego}' is not finite")
    return rows


def _ego(t: FloatArray, state: FloatArray, vehicle: VehicleParameters, notes: list[str]) -> Trajectory:
    """The rear axle's states from those of the centre."""
    x, y, yaw, vx, vy = state.T
    cos, sin = np.cos(yaw), np.sin(yaw)
    x, y = x - vehicle.axle_to_center * cos, y - vehicle.axle_to_center * sin
    v, unknown = vx * cos + vy * sin, np.full(len(t), np.nan)
    if not np.isfinite(v).all():
        return driven(t, x, y, yaw, notes)
    return completed({"t": t, "x": x, "y": y, "yaw": yaw, "v": v, "a": unknown, "kappa": unknown}, notes)


def _boxes(
    names: list[str], t: FloatArray, owner: IntArray, state: FloatArray, others: BoolArray, kinds: tuple[AgentKind, ...]
) -> Boxes:
    unknown = np.full(len(t), np.nan)
    x, y, yaw, vx, vy = state.T
    return Boxes(tuple(names), kinds, t, owner, x, y, yaw, unknown, unknown, vx, vy).taken(others)


def _kinds(owner: IntArray, kind: IntArray, kinds: list[str], count: int) -> tuple[AgentKind, ...]:
    """The kind of each of `count` tracks, by their first row."""
    there, first = np.unique(owner, return_index=True)
    word = dict(zip(there.tolist(), (kinds[k] for k in kind[first]), strict=True))
    return tuple(KINDS.get(word.get(i, ""), AgentKind.OBJECT) for i in range(count))
