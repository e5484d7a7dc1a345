"""The classes of map readers and maps; puts a scenario on a map, and refuses maps that do not fit
the drive.

(1) The ego's path is sampled every `STEP_M`, so that a standing car has no more weight than a
    moving one. A point is on the map if it lies on a drivable lane, and along it if the ego drives
    along such a lane (`replan.logs.route.on_lane`).

The map is refused if less than `LEAST_SHARE` of the points are on it, or less than that share of
those are along it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, arc_lengths
from replan.core.errors import LogError
from replan.core.names import counted, listed
from replan.logs.complete import NO_LANES, with_limit
from replan.logs.edit.transform import placed_road
from replan.logs.heights import lanes_off_the_way
from replan.logs.road import Lane, Road, RoadSource
from replan.logs.route import on_lane
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory

STEP_M = 1.0
LEAST_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class MapFile:
    """A map in its own world coordinates."""

    # Its road, m; lanes without a speed limit have NaN, and the road's default is not used
    road: Road
    frame: str  # origin of its coordinates, in words
    notes: tuple[str, ...] = ()  # what was assumed or left out in reading, one sentence each
    # other ids of the lights of its stop lines that logs may use, by the light's id
    aliases: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    # points of the boundaries of lanes with heights `(k, 3)`, m, by the lane's id
    points: Mapping[int, FloatArray] = field(default_factory=dict)
    side_known: bool = True  # whether the map shows on which side traffic drives


@dataclass(frozen=True)
class MapReader:
    """The reader of one map format."""

    name: str  # its name in messages and notes ("Lanelet2")
    looks_for: str  # its files, in words ("*.osm")
    suffix: str  # suffix of its files
    # reads the map in a file with the settings; raises only LogError on any bytes
    read: Callable[[Path, Mapping[str, str]], MapFile]
    begin: bytes = b""  # first bytes of its files; empty: the suffix suffices
    beside: tuple[str, ...] = ()  # names of optional files in the same folder that belong to a map
    # The keys of `LogSettings` that it reads; their values are texts
    settings: tuple[str, ...] = ()

    def claims(self, path: Path) -> bool:
        """Return whether a path is a map of this format; fast, and raises nothing on any bytes."""
        try:
            if path.suffix.lower() != self.suffix or not self.begin:
                return path.suffix.lower() == self.suffix
            with path.open("rb") as stream:
                return stream.read(len(self.begin)) == self.begin
        except OSError:
            return False

    def files(self, path: Path) -> tuple[Path, ...]:
        """Return the files of a map; the map's identity is their hash."""
        return path, *(other for name in self.beside if (other := path.with_name(name)).is_file())


def on_map(scenario: Scenario, found: MapFile, path: Path, kind: str) -> Scenario:
    """Replace the scenario's road by that of the map; LogError if it does not fit the drive.

    Lights that no stop line of the map names are left out, and so are notes that the log has no
    lanes.
    """
    origin = np.array(scenario.origin)
    road = placed_road(found.road, lambda points: points - origin)
    drivable = [lane for lane in road.lanes.values() if lane.drivable]
    on = _check_fit(found, path, drivable, scenario.ego)
    shown, called = {light.id for light in scenario.lights}, {}
    for light, others in found.aliases.items():  # stop lines get the log's ids of their lights
        known = [name for name in others if name in shown]
        called[light] = known[0] if light not in shown and len(known) == 1 else light
    lines = tuple(
        line if line.light is None else replace(line, light=called.get(line.light, line.light))
        for line in road.stop_lines
    )
    road, lights = (
        replace(road, stop_lines=lines),
        {line.light for line in lines if line.light is not None} & shown,
    )
    own = scenario.road
    notes = [note for note in scenario.notes if not note.startswith(NO_LANES)]
    lanes = (
        "the driven path"
        if own.source is RoadSource.DRIVEN_PATH
        else f"the log's own {len(own.lanes)} lanes"
    )
    notes.append(
        f"The road is the {kind} map {path.name} ({len(road.lanes)} lanes, {found.frame}) instead "
        f"of {lanes}."
    )
    notes += [f"{path.name}: {note}" for note in found.notes]
    if not on.all():
        notes.append(
            f"{path.name}: {100.0 * on.mean():.0f} % of the driven path lies on its drivable lanes."
        )
    if not found.side_known:
        on_right = own.drives_on_right if own.source is RoadSource.LANES else True
        road = replace(road, drives_on_right=on_right)
        side = "right" if on_right else "left"
        notes.append(
            f"{path.name} does not show on which side traffic drives: the {side} is assumed."
        )
    road = _on_level(road, found, scenario, notes)
    drivable = [lane for lane in road.lanes.values() if lane.drivable]
    missing = sum(not isfinite(lane.speed_limit) for lane in drivable)
    if missing:
        which = (
            f"{missing} of the {len(drivable)} drivable lanes of {path.name} have no speed limit"
        )
        road = with_limit(road, scenario.ego, which, notes)
    lost = len(scenario.lights) - len(lights)
    if lost:
        notes.append(
            f"{lost} traffic lights of the log are left out: no stop line of {path.name} names "
            "them."
        )
    return replace(
        scenario,
        road=road,
        notes=tuple(notes),
        lights=tuple(light for light in scenario.lights if light.id in lights),
        metadata={**scenario.metadata, "map": path.name},
    )


def _on_level(road: Road, found: MapFile, scenario: Scenario, notes: list[str]) -> Road:
    """Leave out lanes above or below the ego's way, and their stop lines, with a note
    (`replan.logs.heights`).
    """
    shift = np.array([*scenario.origin, 0.0])
    points = {name: corners - shift for name, corners in found.points.items()}
    off = lanes_off_the_way(road.lanes, points, scenario.ego)
    if not off:
        return road
    names = listed([str(name) for name in sorted(off)], 5)
    notes.append(
        f"{counted(len(off), 'lane')} ({names}) above or below the ego's way: left out, as on "
        f"bridges or in tunnels ({min(off.values()):+.1f} to {max(off.values()):+.1f} m)."
    )
    lanes = {name: lane for name, lane in road.lanes.items() if name not in off}
    return replace(
        road, lanes=lanes, stop_lines=tuple(line for line in road.stop_lines if line.lane in lanes)
    )


def _check_fit(found: MapFile, path: Path, lanes: list[Lane], ego: Trajectory) -> BoolArray:
    """Return which points of the path (1) lie on lanes; LogError if the map lies elsewhere or
    points the other way.
    """
    driven = arc_lengths(ego.x, ego.y)
    samples = np.unique(np.searchsorted(driven, np.arange(0.0, driven[-1] + 1e-9, STEP_M)))
    x, y, yaw = ego.x[samples], ego.y[samples], ego.yaw[samples]
    on, along = np.zeros(len(x), np.bool_), np.zeros(len(x), np.bool_)
    road = Road({lane.id: lane for lane in lanes})
    for k in range(len(x)):
        lanes_here = road.lanes_at(float(x[k]), float(y[k]))
        on[k] = bool(lanes_here)
        along[k] = any(
            on_lane(lane, x[k : k + 1], y[k : k + 1], yaw[k : k + 1])[0] for lane in lanes_here
        )
    if on.mean() < LEAST_SHARE:
        from scipy.spatial import cKDTree  # imported late: slow to load

        tree = cKDTree(np.vstack([lane.polygon for lane in lanes]))
        away = np.asarray(tree.query(np.column_stack([x, y]))[0])
        raise LogError(
            f"the map {path} does not fit the drive: {100.0 * on.mean():.0f} % of the driven path "
            f"lies on its drivable lanes, at least {100.0 * LEAST_SHARE:.0f} % must; the nearest "
            f"lane is {away.min():.0f} m away at the nearest, {away.max():.0f} m at the farthest "
            f"(coordinates: {found.frame})",
            remedy=(
                "give the map of that place, or name the origin of its coordinates as [log] "
                "map_origin"
            ),
        )
    share = float(along.sum() / on.sum())
    if share < LEAST_SHARE:
        raise LogError(
            f"the map {path} does not fit the drive: of the driven path on its lanes "
            f"{100.0 * share:.0f} % goes along them, at least {100.0 * LEAST_SHARE:.0f} % must: "
            "most of it is against or across their direction",
            remedy="correct the directions of its lanes, or the log's headings",
        )
    return on
