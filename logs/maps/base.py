"""The reader of a map format, what it reads, and the scenario on that map, refused where the drive is not on it.

The ego's path at every `STEP_M` (1), so that a car that stands weighs no more than one that drives: a point is on the
map where it lies on a lane on which cars may drive, and along where it drives along such a lane (`logs.route.on_lane`).
The map is refused where less than `LEAST_SHARE` of the path is on it, or less than that share of those points along.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path

import numpy as np

from logs.errors import LogError
from logs.kernel import BoolArray
from logs.mcap.complete import ASSUMED, NO_LANES, assumed_limit
from logs.road import Lane, Road, RoadSource
from logs.route import on_lane
from logs.scenario import Scenario
from logs.states import Trajectory
from logs.transform import placed_road

STEP_M = 1.0
LEAST_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class MapFile:
    """A map in its own world coordinates.

    Attributes:
        road: Its lanes, m; lanes without a speed limit have NaN, the road's default is not used.
        frame: How its coordinates came about, in words.
        notes: What was assumed or left out in reading, one sentence each.
        aliases: Other numbers under which logs may know a light of the road's stop lines, by its id.
        side_known: Whether the map says on which side traffic drives.
    """

    road: Road
    frame: str
    notes: tuple[str, ...] = ()
    aliases: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    side_known: bool = True


@dataclass(frozen=True)
class MapReader:
    """One format of maps.

    Attributes:
        name: In messages and notes ("Lanelet2").
        looks_for: Its files, in words ("*.osm").
        suffix: The end of their names.
        read: The map in a file, given what `settings` say; raises LogError, and nothing else, on any bytes.
        begin: Their first bytes, where those must be looked at.
        beside: Names of files in the same folder that belong to a map, where they are there.
        settings: The keys of `LogSettings` that it reads; they hold texts.
    """

    name: str
    looks_for: str
    suffix: str
    read: Callable[[Path, Mapping[str, str]], MapFile]
    begin: bytes = b""
    beside: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()

    def claims(self, path: Path) -> bool:
        """Whether a path is a map of this format; cheap, raises nothing on any bytes."""
        try:
            if path.suffix.lower() != self.suffix or not self.begin:
                return path.suffix.lower() == self.suffix
            with path.open("rb") as stream:
                return stream.read(len(self.begin)) == self.begin
        except OSError:
            return False

    def files(self, path: Path) -> tuple[Path, ...]:
        """The files that a map is read from: what its identity is hashed from."""
        return path, *(other for name in self.beside if (other := path.with_name(name)).is_file())


def on_map(scenario: Scenario, found: MapFile, path: Path, kind: str) -> Scenario:
    """The scenario with the map's road for its own.

    Lights that no stop line of the map names are left out; notes that the log has no lanes too.

    Raises:
        LogError: The map does not fit the drive.
    """
    origin = np.array(scenario.origin)
    road = placed_road(found.road, lambda points: points - origin)
    drivable = [lane for lane in road.lanes.values() if lane.drivable]
    on = _check_fit(found, path, drivable, scenario.ego)
    shown, called = {light.id for light in scenario.lights}, {}
    for light, others in found.aliases.items():  # stop lines call their lights as the log does
        known = [name for name in others if name in shown]
        called[light] = known[0] if light not in shown and len(known) == 1 else light
    lines = tuple(
        line if line.light is None else replace(line, light=called.get(line.light, line.light))
        for line in road.stop_lines
    )
    road, lights = replace(road, stop_lines=lines), {line.light for line in lines if line.light is not None} & shown
    own = scenario.road
    notes = [note for note in scenario.notes if not note.startswith(NO_LANES)]
    lanes = "the driven path" if own.source is RoadSource.DRIVEN_PATH else f"the log's own {len(own.lanes)} lanes"
    notes.append(f"The road is the {kind} map {path.name} ({len(road.lanes)} lanes, {found.frame}) instead of {lanes}.")
    notes += [f"{path.name}: {note}" for note in found.notes]
    if not on.all():
        notes.append(f"{path.name}: {100.0 * on.mean():.0f} % of the driven path lies on its drivable lanes.")
    if not found.side_known:
        kept = own.drives_on_right if own.source is RoadSource.LANES else True
        road = replace(road, drives_on_right=kept)
        side = "right" if kept else "left"
        notes.append(f"{path.name} does not show on which side traffic drives: the {side} is assumed.")
    missing = sum(not isfinite(lane.speed_limit) for lane in drivable)
    if missing:
        limit = assumed_limit(scenario.ego)
        which = f"{missing} of the {len(drivable)} drivable lanes of {path.name}"
        notes.append(f"{which} have no speed limit: {limit:.1f} m/s is assumed ({ASSUMED}).")
        road = replace(road, default_speed_limit=limit)
    lost = len(scenario.lights) - len(lights)
    if lost:
        notes.append(f"{lost} traffic lights of the log are left out: no stop line of {path.name} names them.")
    return replace(
        scenario,
        road=road,
        notes=tuple(notes),
        lights=tuple(light for light in scenario.lights if light.id in lights),
        metadata={**scenario.metadata, "map": path.name},
    )


def _check_fit(found: MapFile, path: Path, lanes: list[Lane], ego: Trajectory) -> BoolArray:
    """Which points of the path (1) lie on the lanes; a map that is elsewhere or the wrong way round is refused."""
    driven = np.r_[0.0, np.cumsum(np.hypot(np.diff(ego.x), np.diff(ego.y)))]
    at = np.unique(np.searchsorted(driven, np.arange(0.0, driven[-1] + 1e-9, STEP_M)))
    x, y, yaw = ego.x[at], ego.y[at], ego.yaw[at]
    on, along = np.zeros(len(x), np.bool_), np.zeros(len(x), np.bool_)
    road = Road({lane.id: lane for lane in lanes})
    for k in range(len(x)):
        there = road.lanes_at(float(x[k]), float(y[k]))
        on[k] = bool(there)
        along[k] = any(on_lane(lane, x[k : k + 1], y[k : k + 1], yaw[k : k + 1])[0] for lane in there)
    if on.mean() < LEAST_SHARE:
        from scipy.spatial import cKDTree  # here: it takes long to load

        tree = cKDTree(np.vstack([lane.polygon for lane in lanes]))
        away = np.asarray(tree.query(np.column_stack([x, y]))[0])
        raise LogError(
            f"the map {path} does not fit the drive: {100.0 * on.mean():.0f} % of the driven path lies on its drivable"
            f" lanes, at least {100.0 * LEAST_SHARE:.0f} % must; the nearest lane is {away.min():.0f} m away at the"
            f" nearest, {away.max():.0f} m at the farthest (coordinates: {found.frame})",
            remedy="give the map of that place, or name the origin of its coordinates as [log] map_origin",
        )
    share = float(along.sum() / on.sum())
    if share < LEAST_SHARE:
        raise LogError(
            f"the map {path} does not fit the drive: of the driven path on its lanes {100.0 * share:.0f} % goes along"
            f" them, at least {100.0 * LEAST_SHARE:.0f} % must: most of it is against or across their direction",
            remedy="correct the directions of its lanes, or the log's headings",
        )
    return on
