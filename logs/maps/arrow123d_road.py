"""The road and the traffic lights of a 123D log.

Lights. A light has the id of the lane that it controls.

Route. nuPlan's logs name the groups of lanes (roadblocks) of their route in `custom.scenario`:
`Road.route`.

Maps. The log's own map is preferred to the map of its place in the data root,
`maps/<dataset>/<dataset>_<location>.arrow` in a folder above the log.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from replan.core.arrow_tables import Lists, ipc_table, reading, whole
from replan.core.errors import LogError
from replan.core.files import beside
from replan.logs.complete import road_along, with_limit
from replan.logs.maps.arrow123d_map import road_of_map
from replan.logs.maps.arrow123d_stop_lines import lines_of_lights
from replan.logs.road import Road
from replan.logs.rules import Colour, TrafficLight
from replan.logs.states import Trajectory

LIGHTS = "traffic_light_detections"
SCENARIO = "custom.scenario.arrow"
# Colours of a light; the index is the number of its status
COLOURS = (Colour.GREEN, Colour.YELLOW, Colour.RED, Colour.OFF)
UP = 6  # Number of folders above a log in which the maps of places are searched


def road_of(
    folder: Path,
    about: Mapping[Any, Any],
    ego: Trajectory,
    origin: tuple[float, float],
    start_us: int,
    notes: list[str],
) -> tuple[Road, tuple[TrafficLight, ...]]:
    """Read the road and the lights of a log, t = 0 at `start_us`.

    Without lanes, the road is the driven path.
    """
    lights = _observed_lights(folder, start_us, notes)
    path, road = map_of(folder, about), None
    if path is not None:
        try:
            near = np.column_stack([ego.x, ego.y]) + origin
            road = road_of_map(path, origin, near, notes, _route_of(folder))
        except LogError as error:
            if "lanes" not in error.what:
                raise
            notes.append(f"The map beside the log cannot be used: {error.what}.")
    if road is None:
        if lights:
            notes.append(
                f"The log's {len(lights)} traffic lights are left out, as there are no lanes that "
                "they are for."
            )
        return road_along(ego, notes), ()
    lacking = sum(
        lane.drivable and not np.isfinite(lane.speed_limit) for lane in road.lanes.values()
    )
    if lacking:
        road = with_limit(
            road, ego, f"{lacking} of {len(road.lanes)} lanes have no speed limit", notes
        )
    lost = sum(light.id not in road.lanes for light in lights)
    if lost:
        notes.append(
            f"{lost} of {len(lights)} traffic lights are for lanes that are not in the map and are "
            "left out."
        )
    if lights:
        notes.append(
            "A light stands where the lanes end that lead to its lane, or at the stop zone that "
            "lies on them."
        )
    lines = lines_of_lights(road, lights)
    used = {line.light for line in lines}
    return replace(road, stop_lines=lines), tuple(light for light in lights if light.id in used)


def map_of(folder: Path, about: Mapping[Any, Any]) -> Path | None:
    """Return the log's own map, else that of its place in the data root above it, or None; LogError
    as in `beside`.
    """
    own = beside(folder, ("map.arrow",))
    if own is not None:
        return own
    dataset, place = str(about.get("dataset") or ""), str(about.get("location") or "")
    if (
        not dataset
        or not place
        or {"/", "\\", "\0"} & set(dataset + place)
        or dataset.startswith(".")
    ):
        return None
    above = [
        parent / "maps" / dataset / f"{dataset}_{place}.arrow"
        for parent in folder.resolve().parents[:UP]
    ]
    return next((path for path in above if path.is_file()), None)


def _route_of(folder: Path) -> tuple[int, ...]:
    """Return the groups of lanes of the route that nuPlan's logs name.

    Empty where there is none.
    """
    path = folder / SCENARIO
    if not path.is_file():
        return ()
    table = ipc_table(path, (f"{path.stem}.data",))
    with reading(path):
        content = (
            msgspec.msgpack.decode(table[f"{path.stem}.data"][0].as_py()) if len(table) else {}
        )
        names = content.get("route_roadblock_ids") if isinstance(content, dict) else None
        return tuple(
            int(name) for name in map(str, names or ()) if name.isdecimal() and len(name) < 19
        )


def _observed_lights(folder: Path, start_us: int, notes: list[str]) -> tuple[TrafficLight, ...]:
    """Read the lights of the log; each has the id of the lane that it controls."""
    path = beside(folder, (f"{LIGHTS}.arrow",))
    if path is None:
        return ()
    columns = [f"{LIGHTS}.{name}" for name in ("timestamp_us", "lane_id", "status")]
    table = ipc_table(path, columns)
    with reading(path):
        lists = Lists(table, columns[1])
        lane, status = lists.numbers(columns[1]), lists.numbers(columns[2])
        t = (whole(table, columns[0]) - start_us)[lists.row] / 1e6
        unknown = status >= len(COLOURS)
        if unknown.any():
            notes.append(
                f"{unknown.sum()} of {len(status)} observations of traffic lights are of no "
                "colour: taken as off."
            )
        colours = [COLOURS[s] if 0 <= s < len(COLOURS) else Colour.OFF for s in status]
        lights = []
        for number in np.unique(lane):
            rows = np.flatnonzero(lane == number)
            _, first = np.unique(t[rows], return_index=True)
            rows = rows[first]
            changes = [
                row
                for previous, row in zip((None, *rows), rows, strict=False)
                if previous is None or colours[row] is not colours[previous]
            ]
            shown = tuple(colours[row] for row in changes)
            lights.append(TrafficLight(int(number), t[changes], shown))
        return tuple(lights)
