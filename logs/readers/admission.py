"""Checks every log after reading, whatever its format: clocks, magnitudes, names (`CHECKS`).

An error names the topic, the time and the remedy. The scenario's notes list left out or replaced
data. The limits are far beyond the motion of vehicles: they separate wrong data from rare data.
Data that are only implausible are evaluated and reported by `replan.metrics.health`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from math import inf, isfinite
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.errors import LogError
from replan.core.names import LONGEST_NAME, counted, listed, visible_name
from replan.logs.agents import USUAL_SIZE_M
from replan.logs.log_checks import CheckAction, LogCheck, Step, of_scenario
from replan.logs.log_settings import SIZES
from replan.logs.scenario import Scenario


class Limit(NamedTuple):
    """The largest valid magnitude of a column, and its unit."""

    most: float
    unit: str

    def __str__(self) -> str:
        return f"{self.most:g} {self.unit}".rstrip()


WORLD = Limit(1e6, "m")
"""Distance from the ego's first position along x and y: no map of a drive reaches 1000 km."""
ANY_MAP_M = 1e8
"""Positions beyond it are of no map projection, m: they are not taken for the zero of a log."""
SPEED = Limit(150.0, "m/s")
"""540 km/h: more than any road vehicle has reached in traffic or in a race."""
HEADING = Limit(1e4, "rad")
"""Unwrapped heading: 1600 turns."""
_POSE = {"x": WORLD, "y": WORLD, "yaw": HEADING}
_STATE = {
    **_POSE,
    "v": SPEED,
    "a": Limit(1e4, "m/s2"),  # above the spikes of speeds that are differenced at 100 Hz
    "kappa": Limit(1e3, "1/m"),  # above the spikes of headings at walking speed
}
_CONTROLS = {"steer": Limit(1e3, "rad"), "throttle": Limit(1e3, ""), "brake": Limit(1e3, "")}
LIMITS: Mapping[str, Mapping[str, Limit]] = MappingProxyType(
    {"ego": _STATE, "agents": _POSE, "controls": _CONTROLS, "onboard": _STATE}
)
STEP_M = 100.0
"""Largest displacement between two ego states beyond `SPEED` times the time, m: localisation jumps
less.
"""
GAP_S = 60.0
"""Longest gap between two ego states, s; the log lacks the drive within a longer one."""
SIZES_M = (1e-3, 1e3)
"""Least and greatest length and width of an agent, m."""
VEHICLE = Limit(1e9, "")
"""Limit of all parameters of the ego's vehicle; `VEHICLE_M` is that of its sizes."""
VEHICLE_M = Limit(100.0, "m")
SHOWN_BEFORE_S = 3600.0
"""A light's last change, or an on-board plan, may precede the ego's log by this time, s."""
OTHER_CLOCK_S = 60.0
"""A road user with no sample within this time of the ego's log is on another clock, s."""
NAMED = 5
"""Number of road users that a note names."""
ONE_CLOCK = (
    'give both times of one clock (a bag: clock = "log" or "header" in [log]; a table: a '
    "column with its unit)"
)
CORRECT_SAMPLE = "correct or remove that sample, or leave that part out with --from and --to"


# Clocks


def check_clocks(scenario: Scenario) -> Scenario:
    """Note road users on another clock than the ego; LogError if any times do not overlap those of
    the ego.
    """
    ego, tracks = scenario.ego, scenario.tracks
    first, last = float(ego.t[0]), float(ego.t[-1]) if len(ego) > 1 else scenario.duration
    for topic, begin, end in _spans(scenario):
        if end < first or begin > last:
            times, own = _log_times(scenario, begin, end), _log_times(scenario, first, last)
            problem = f"times from {times}, the ego's are from {own}: they do not overlap"
            raise LogError(problem, topic=topic, remedy=ONE_CLOCK)
    begins, ends = tracks.t[tracks.offsets[:-1]], tracks.t[tracks.offsets[1:] - 1]
    is_late = begins > max(last, scenario.duration) + OTHER_CLOCK_S
    is_apart = ~tracks.static & (is_late | (ends < first - OTHER_CLOCK_S))
    if not is_apart.any():
        return scenario
    note = (
        f"{_names_of(scenario, is_apart)} have no sample within {OTHER_CLOCK_S:.0f} s of the ego's "
        "log: never in the scene."
    )
    return replace(scenario, notes=(*scenario.notes, note))


def _spans(scenario: Scenario) -> Iterator[tuple[str, float, float]]:
    """Yield topics other than the ego, with the time from which to which each is valid, s."""
    tracks = scenario.tracks
    t = tracks.t[~tracks.static[tracks.owner]]
    if scenario.repair is not None:
        t = scenario.repair.detections.t
    if len(t):
        yield "agents", float(t.min()), float(t.max())
    if scenario.lights:
        t = np.concatenate([light.t for light in scenario.lights])
        yield "traffic lights", float(t.min()), float(t.max()) + SHOWN_BEFORE_S
    if scenario.controls is not None and len(scenario.controls):
        yield "controls", float(scenario.controls.t[0]), float(scenario.controls.t[-1])
    if scenario.onboard:
        first, last = scenario.onboard[0].known, scenario.onboard[-1].known
        yield "onboard plans", first, last + SHOWN_BEFORE_S


def _log_times(scenario: Scenario, begin: float, end: float) -> str:
    start = scenario.start_ns / 1e9
    return f"{start + begin:.3f} to {start + end:.3f} s"


# Magnitudes


def zero_of(scenario: Scenario, name: str) -> float:
    """Return the zero of a column: for positions the ego's first, unless it is beyond any map
    projection.
    """
    start = scenario.ego.state(0)
    zero = {"x": start.x, "y": start.y}.get(name, 0.0)
    return zero if abs(zero) < ANY_MAP_M else 0.0


def _refusal(scenario: Scenario, topic: str, problem: str, time: float) -> LogError:
    time_ns = scenario.start_ns + round(1e9 * time)
    return LogError(problem, topic=topic, time_ns=time_ns, remedy=CORRECT_SAMPLE)


def _check_columns(scenario: Scenario, topic: str, table: Any) -> None:
    """Raise LogError if a column of a table over `t` is beyond its limit; NaN (unknown) is
    accepted.
    """
    for name, limit in LIMITS[topic].items():
        column = np.asarray(getattr(table, name))
        magnitude = np.abs(column - zero_of(scenario, name))
        wrong = np.flatnonzero(~((magnitude <= limit.most) | np.isnan(column)))
        if len(wrong):
            value, time = float(column[wrong[0]]), float(table.t[wrong[0]])
            problem = f"{name} is {Limit(value, limit.unit)}, beyond {limit}"
            raise _refusal(scenario, topic, problem, time)


def _check_point(scenario: Scenario, topic: str, points: FloatArray) -> None:
    """Raise LogError if points `(n, 2)` are farther from the ego's start than `WORLD`."""
    distance = np.abs(points - [zero_of(scenario, "x"), zero_of(scenario, "y")])
    if distance.size and not distance.max() <= WORLD.most:
        problem = f"a point is {distance.max():g} m from the ego's start, beyond {WORLD}"
        remedy = "give the map and the ego in the same coordinates"
        raise LogError(problem, topic=topic, remedy=remedy)


def check_ego(scenario: Scenario) -> Scenario:
    """Return the scenario; LogError if states of the ego are beyond their limits."""
    _check_columns(scenario, "ego", scenario.ego)
    return scenario


def check_steps(scenario: Scenario) -> Scenario:
    """Return the scenario; LogError for a jump of the ego beyond `STEP_M`, or a gap beyond
    `GAP_S`.
    """
    ego = scenario.ego
    dt, d = np.diff(ego.t), np.hypot(np.diff(ego.x), np.diff(ego.y))
    for k in np.flatnonzero(~(d <= STEP_M + SPEED.most * dt))[:1]:
        problem = f"the position jumps by {d[k]:g} m within {dt[k]:g} s"
        raise _refusal(scenario, "ego", problem, float(ego.t[k + 1]))
    for k in np.flatnonzero(dt > GAP_S)[:1]:
        problem = f"no state for {dt[k]:g} s, longer than {GAP_S:g} s"
        raise _refusal(scenario, "ego", problem, float(ego.t[k]))
    return scenario


def check_actions(scenario: Scenario) -> Scenario:
    """Return the scenario; LogError if controls or on-board plans are beyond their limits."""
    if scenario.controls is not None:
        _check_columns(scenario, "controls", scenario.controls)
    for plan in scenario.onboard:
        _check_columns(scenario, "onboard", plan.trajectory)
        for alternative in plan.alternatives:
            _check_columns(scenario, "onboard", alternative.trajectory)
    return scenario


def check_vehicle(scenario: Scenario) -> Scenario:
    """Return the scenario; LogError if a parameter of the ego's vehicle is beyond its limit."""
    for field in fields(scenario.vehicle):
        limit = VEHICLE_M if field.name in SIZES else VEHICLE
        magnitude = np.abs(np.atleast_1d(getattr(scenario.vehicle, field.name)))
        if not (magnitude <= limit.most).all():
            problem = f"{field.name} is {np.max(magnitude):g}, beyond {limit}"
            remedy = "correct it, or name the vehicle with --car"
            raise LogError(problem, topic="vehicle", remedy=remedy)
    return scenario


def check_goal(scenario: Scenario) -> Scenario:
    """Return the scenario; LogError if a point of the goal is farther away than `WORLD`."""
    for region in scenario.goal.regions if scenario.goal else ():
        _check_point(scenario, "goal", np.asarray(region, dtype=np.float64))
    return scenario


def with_known_speeds(scenario: Scenario) -> Scenario:
    """Take velocities of road users beyond `SPEED` as not known, with a note."""
    tracks = scenario.tracks
    speed = np.hypot(np.nan_to_num(tracks.vx), np.nan_to_num(tracks.vy))  # NaN: not known
    is_fast = speed > SPEED.most
    if not is_fast.any():
        return scenario
    note = (
        f"The velocity of {_names_of(scenario, _any_sample(scenario, is_fast))} is up to "
        f"{speed.max():g} m/s, beyond {SPEED}, at"
        f" {counted(int(is_fast.sum()), 'sample')}: taken as not known there."
    )
    vx, vy = np.where(is_fast, np.nan, tracks.vx), np.where(is_fast, np.nan, tracks.vy)
    return replace(scenario, tracks=replace(tracks, vx=vx, vy=vy), notes=(*scenario.notes, note))


def with_usual_sizes(scenario: Scenario) -> Scenario:
    """Replace sizes of road users out of `SIZES_M` by those usual for the kind, with a note."""
    tracks, (least, greatest) = scenario.tracks, SIZES_M
    is_size = np.minimum(tracks.length, tracks.width) >= least
    is_odd = ~(is_size & (np.maximum(tracks.length, tracks.width) <= greatest))
    if not is_odd.any():
        return scenario
    note = (
        f"The size of {_names_of(scenario, is_odd)} is not between {least:g} and {greatest:g} m: "
        "usual for the kind, assumed."
    )
    usual_length, usual_width = np.array([USUAL_SIZE_M[kind] for kind in tracks.kinds]).T
    tracks = replace(
        tracks,
        length=np.where(is_odd, usual_length, tracks.length),
        width=np.where(is_odd, usual_width, tracks.width),
    )
    return replace(scenario, tracks=tracks, notes=(*scenario.notes, note))


def with_known_poses(scenario: Scenario) -> Scenario:
    """Leave out samples of road users with a pose beyond its limit, with a note; LogError if none
    is left.
    """
    tracks, limits = scenario.tracks, LIMITS["agents"]
    beyond = {
        name: ~(np.abs(getattr(tracks, name) - zero_of(scenario, name)) <= limit.most)
        for name, limit in limits.items()
    }
    is_wrong = np.logical_or.reduce(list(beyond.values()))
    if not is_wrong.any():
        return scenario
    k = int(np.argmax(is_wrong))
    name = next(name for name, mask in beyond.items() if mask[k])
    value = Limit(getattr(tracks, name)[k], limits[name].unit)
    problem = f"{name} is {value}, beyond {limits[name]}"
    if is_wrong.all():
        remedy = "give agents and ego in the same coordinates and units"
        raise LogError(f"no pose of an agent can be used: {problem}", topic="agents", remedy=remedy)
    time = (scenario.start_ns / 1e9) + float(tracks.t[k])
    names = _names_of(scenario, _any_sample(scenario, is_wrong))
    count = counted(int(is_wrong.sum()), "sample")
    note = f"{count} of {names} are left out: {problem}, {time:.3f} s."
    return replace(scenario, tracks=tracks.taken(~is_wrong), notes=(*scenario.notes, note))


def _any_sample(scenario: Scenario, mask: BoolArray) -> BoolArray:
    """Return the road users `(m,)` of which a sample is marked in the mask `(n,)`."""
    return np.asarray(np.add.reduceat(mask, scenario.tracks.offsets[:-1]) > 0)


def _names_of(scenario: Scenario, mask: BoolArray) -> str:
    names = [visible_name(scenario.tracks.ids[i]) for i in np.flatnonzero(mask)]
    return f"{counted(len(names), 'road user')} ({listed(names, NAMED)})"


def check_road(scenario: Scenario) -> Scenario:
    """Return the scenario; LogError if a lane is farther away than `WORLD`, or a speed limit is
    beyond `SPEED`.
    """
    road = scenario.road
    for lane in road.lanes.values():
        topic = f"road, lane {lane.id}"
        for side in (lane.left, lane.right):
            _check_point(scenario, topic, side)
        if isfinite(lane.speed_limit) and not 0.0 <= lane.speed_limit <= SPEED.most:
            raise _limit_refused(topic, lane.speed_limit)
    if not 0.0 < road.default_speed_limit <= SPEED.most:
        raise _limit_refused("road", road.default_speed_limit)
    return scenario


def _limit_refused(topic: str, value: float) -> LogError:
    problem = f"the speed limit is {value:g} m/s, beyond {SPEED}"
    return LogError(problem, topic=topic, remedy="correct the map, or leave the limit out")


# Names


def printable(scenario: Scenario) -> Scenario:
    """Make all names and texts printable in one line, with a note on changes."""
    tracks, road = scenario.tracks, scenario.road
    ids = _distinct([visible_name(name) for name in tracks.ids])
    changed: dict[str, Any] = {
        "name": visible_name(scenario.name),
        "tags": tuple(map(visible_name, scenario.tags)),
        "metadata": {
            visible_name(key): visible_name(text, inf) for key, text in scenario.metadata.items()
        },
        "notes": tuple(visible_name(note, inf) for note in scenario.notes),
        "source": visible_name(scenario.source, inf),
        "licence": visible_name(scenario.licence, inf),
    }
    changed = {key: value for key, value in changed.items() if value != getattr(scenario, key)}
    if ids != tracks.ids:
        changed["tracks"] = replace(tracks, ids=ids)
    lanes = {
        i: replace(lane, kind=visible_name(lane.kind))
        for i, lane in road.lanes.items()
        if visible_name(lane.kind) != lane.kind
    }
    if lanes:
        changed["road"] = replace(road, lanes={**road.lanes, **lanes})
    if not changed:
        return scenario
    count = sum(new != old for new, old in zip(ids, tracks.ids, strict=True))
    places = [counted(count, "name") + " of road users"] if count else []
    places += [f"the {key}" for key in changed if key != "tracks"]
    note = f"Control characters in {', '.join(places)} are replaced, and long names cut."
    return replace(scenario, **{**changed, "notes": (*changed.get("notes", scenario.notes), note)})


def _distinct(names: list[str]) -> tuple[str, ...]:
    """Return the names, of which repeated ones get a number."""
    counts, distinct = Counter[str](), list[str]()
    for name in names:
        counts[name] += 1
        distinct.append(name if counts[name] == 1 else f"{name}~{counts[name]}")
    if len(set(distinct)) < len(distinct):
        distinct = [f"{name}~{i}" for i, name in enumerate(names)]
    return tuple(distinct)


CLOCKS: tuple[LogCheck[Step], ...] = (
    LogCheck(
        "times of road users, lights, controls, plans",
        "times of the ego",
        f"no overlap; a road user {OTHER_CLOCK_S:g} s away",
        CheckAction.REFUSE,
        "refused; such a road user is noted",
        "clock",
        of_scenario(check_clocks),
    ),
)
"""Checks of a whole log, before a part is cut out."""
CHECKS: tuple[LogCheck[Step], ...] = (
    LogCheck(
        "states of the ego",
        "possible values",
        ", ".join(f"{name} {limit}" for name, limit in _STATE.items()),
        CheckAction.REFUSE,
        "refused",
        run=of_scenario(check_ego),
    ),
    LogCheck(
        "steps of the ego",
        "possible values",
        f"{STEP_M:g} m and {SPEED}; a gap of {GAP_S:g} s",
        CheckAction.REFUSE,
        "refused",
        run=of_scenario(check_steps),
    ),
    LogCheck(
        "controls and on-board plans",
        "possible values",
        ", ".join(f"{name} {limit}" for name, limit in _CONTROLS.items()),
        CheckAction.REFUSE,
        "refused",
        run=of_scenario(check_actions),
    ),
    LogCheck(
        "the ego's vehicle",
        "possible values",
        f"sizes of {VEHICLE_M}, parameters of {VEHICLE}",
        CheckAction.REFUSE,
        "refused",
        "car",
        of_scenario(check_vehicle),
    ),
    LogCheck(
        "goal",
        "possible values",
        f"{WORLD} from the ego's start",
        CheckAction.REFUSE,
        "refused",
        run=of_scenario(check_goal),
    ),
    LogCheck(
        "velocities of road users",
        "possible values",
        str(SPEED),
        CheckAction.REPAIR,
        "not known, with a note",
        run=of_scenario(with_known_speeds),
    ),
    LogCheck(
        "sizes of road users",
        "possible values",
        f"{SIZES_M[0]:g} to {SIZES_M[1]:g} m",
        CheckAction.REPAIR,
        "replaced by those usual for the kind, with a note",
        run=of_scenario(with_usual_sizes),
    ),
    LogCheck(
        "poses of road users",
        "possible values",
        f"{WORLD} from the ego's start, {HEADING}",
        CheckAction.REFUSE,
        "left out, with a note; refused if none is left",
        run=of_scenario(with_known_poses),
    ),
    LogCheck(
        "names and texts",
        "printable characters",
        f"{LONGEST_NAME} characters",
        CheckAction.REPAIR,
        "control characters are made visible and long names cut, with a note",
        run=of_scenario(printable),
    ),
)
"""Checks of the scenario that is driven, after the cut."""
ROAD_CHECKS: tuple[LogCheck[Step], ...] = (
    LogCheck(
        "lanes and speed limits",
        "possible values",
        f"{WORLD} from the ego's start, {SPEED}",
        CheckAction.REFUSE,
        "refused",
        "map",
        of_scenario(check_road),
    ),
)
"""Checks of the road, which may come from another file than the log."""
