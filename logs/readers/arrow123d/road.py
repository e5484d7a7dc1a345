"""The road of a 123D log, and its traffic lights over time.

The log's own map wins, else that of its place in the data root: `maps/<dataset>/<dataset>_<location>.arrow`, looked for
in the folders above the log. A light has the id of the lane that it is for; where no stop zone names it, it stands at
the ends of the lanes before that lane.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from logs.errors import LogError
from logs.kernel import BoolArray, FloatArray
from logs.mcap.complete import ASSUMED, assumed_limit, road_along
from logs.readers.arrow123d.map import before, ends_at, road_of_map
from logs.readers.base import beside
from logs.readers.recorded.tables import Lists, ipc_table, reading, whole
from logs.road import Road
from logs.rules import Colour, StopLine, TrafficLight
from logs.states import Trajectory

LIGHTS = "traffic_light_detections"
COLOURS = (Colour.GREEN, Colour.YELLOW, Colour.RED, Colour.OFF)
UNKNOWN = 4
UP = 6
"""Folders above a log in which the maps of places are looked for."""


def map_of(folder: Path, about: Mapping[Any, Any]) -> Path | None:
    """The log's own map, else that of its place in the data root above it; None: none. LogError as `beside`."""
    own = beside(folder, ("map.arrow",))
    if own is not None:
        return own
    dataset, place = str(about.get("dataset") or ""), str(about.get("location") or "")
    if not dataset or not place or {"/", "\\", "\0"} & set(dataset + place) or dataset.startswith("."):
        return None
    above = [parent / "maps" / dataset / f"{dataset}_{place}.arrow" for parent in folder.resolve().parents[:UP]]
    return next((path for path in above if path.is_file()), None)


def road_of(
    folder: Path,
    about: Mapping[Any, Any],
    ego: Trajectory,
    origin: tuple[float, float],
    start_us: int,
    notes: list[str],
) -> tuple[Road, tuple[TrafficLight, ...]]:
    """The road and the lights of the log in a folder, t = 0 at `start_us`; without lanes: along the driven path."""
    lights = _lights(folder, start_us, notes)
    path, road = map_of(folder, about), None
    if path is not None:
        try:
            road = road_of_map(path, origin, np.column_stack([ego.x, ego.y]) + origin, notes)
        except LogError as error:
            if "lanes" not in error.what:
                raise
            notes.append(f"The map beside the log cannot be used: {error.what}.")
    if road is None:
        if lights:
            notes.append(
                f"The log's {len(lights)} traffic lights are left out, as there are no lanes that they are for."
            )
        return road_along(ego, notes), ()
    lacking = sum(lane.drivable and not np.isfinite(lane.speed_limit) for lane in road.lanes.values())
    if lacking:
        road = replace(road, default_speed_limit=assumed_limit(ego))
        limit = f"{road.default_speed_limit:.1f} m/s"
        notes.append(f"{lacking} of {len(road.lanes)} lanes have no speed limit: {limit} is assumed ({ASSUMED}).")
    return _lit(road, lights, notes)


def _lights(folder: Path, start_us: int, notes: list[str]) -> tuple[TrafficLight, ...]:
    """The lights of the log; each has the id of the lane that it is for."""
    path = beside(folder, (f"{LIGHTS}.arrow",))
    if path is None:
        return ()
    columns = [f"{LIGHTS}.{name}" for name in ("timestamp_us", "lane_id", "status")]
    table = ipc_table(path, columns)
    with reading(path):
        lists = Lists(table, columns[1])
        lane, status = lists.numbers(columns[1]), lists.numbers(columns[2])
        t = (whole(table, columns[0]) - start_us)[lists.row] / 1e6
        unknown = status >= UNKNOWN
        if unknown.any():
            notes.append(
                f"{unknown.sum()} of {len(status)} observations of traffic lights are of no colour: taken as off."
            )
        colours = [COLOURS[s] if 0 <= s < len(COLOURS) else Colour.OFF for s in status]
        return tuple(_light(int(i), t, lane == i, colours) for i in np.unique(lane))


def _light(i: int, t: FloatArray, its: BoolArray, colours: list[Colour]) -> TrafficLight:
    """A light over time, from one change to the next."""
    at = np.flatnonzero(its)
    at = at[np.unique(t[at], return_index=True)[1]]
    changes = [k for n, k in enumerate(at) if n == 0 or colours[k] is not colours[at[n - 1]]]
    return TrafficLight(i, t[changes], tuple(colours[k] for k in changes))


def _lit(road: Road, lights: tuple[TrafficLight, ...], notes: list[str]) -> tuple[Road, tuple[TrafficLight, ...]]:
    """The road with a stop line for each light that no stop zone names: at the ends of the lanes before its lane."""
    named, feeding = {line.light for line in road.stop_lines}, before(road.lanes)
    lines, lost = list(road.stop_lines), 0
    number = max((line.id for line in lines), default=-1) + 1
    for light in lights:
        if light.id in named or light.id not in road.lanes:
            lost += light.id not in road.lanes
            continue
        own = [line for line in road.stop_lines if line.lane == light.id]
        places: list[tuple[int, FloatArray, tuple[int, ...]]] = [(line.lane, line.points, ()) for line in own[:1]]
        places = places or [(i, ends_at(road.lanes[i], 1.0), (light.id,)) for i in feeding.get(light.id, ())]
        places = places or [(light.id, ends_at(road.lanes[light.id], 0.0), ())]
        for across, ends, towards in places:
            lines.append(StopLine(number, across, ends, light.id, towards=towards))
            number += 1
    if lost:
        notes.append(f"{lost} of {len(lights)} traffic lights are for lanes that are not in the map and are left out.")
    if lights:
        notes.append("A light stands where the lanes end that lead to its lane, or at the stop zone that lies on them.")
    wanted = {line.light for line in lines}
    return replace(road, stop_lines=tuple(lines)), tuple(light for light in lights if light.id in wanted)
