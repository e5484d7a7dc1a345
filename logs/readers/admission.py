"""Checks every log after reading, whatever its format, and repairs raw detections.

    clocks       logs are refused if the times of agents, lights, controls or plans do not overlap
                 those of the ego
    magnitudes   logs are refused if the ego, the road or the goal are beyond `LIMITS`; agents'
                 samples with such a pose
                 are left out, such a velocity is unknown, and such a size is replaced by the usual
                 size of the kind
    names        control characters become visible characters, long names are cut

An error names the topic, the time and the remedy. The scenario's notes list left out or replaced
data. The limits are far beyond the motion of vehicles: they separate wrong data from rare data.
Data that are only implausible are evaluated and reported by `replan.metrics.health`.

Repair. `[log] repair` says whether raw detections become tracks:

    "auto"    if a log holds detections that are not tracks (`replan.logs.repair.needs_repair`)
    "on"      always; in a log of tracks, their samples are the detections, and static road users
              stay unchanged
    "off"     never: the reader makes the tracks

If the road is assumed along the driven path, the repaired tracks decide the width of its lane
(`passed_width`).

The repair precedes the cut of a part, so that a part has the same tracks as the whole log. A reader
that reads only a part reads `cut.DETECTED_S` more on both sides: the repair then lacks data from
farther away, and the names of tracks and the choice of "auto" may differ from those of the whole
log.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from math import inf, isfinite
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.errors import LogError
from replan.core.names import counted, listed, visible_name
from replan.logs.agents import USUAL_SIZE_M
from replan.logs.complete import passed_width
from replan.logs.edit.cut import framed
from replan.logs.repair.detections import Detections, named_as_tracked, needs_repair
from replan.logs.repair.offline import detections_of, repair
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.tracks import Tracks


class Limit(NamedTuple):
    """The largest valid magnitude of a column, and its unit."""

    most: float
    unit: str


WORLD = Limit(1e6, "m")
"""Distance from the ego's first position along x and y: no map of a drive reaches 1000 km."""
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


def check_clocks(scenario: Scenario) -> Scenario:
    """Note road users on another clock than the ego; LogError if any times do not overlap those of
    the ego.
    """
    ego, tracks = scenario.ego, scenario.tracks
    first, last = float(ego.t[0]), float(ego.t[-1]) if len(ego) > 1 else scenario.duration
    spans = list[tuple[str, float, float]]()
    moving = tracks.t[~tracks.static[tracks.owner]]
    if scenario.repair is not None:
        moving = scenario.repair.detections.t
    if len(moving):
        spans.append(("agents", float(moving.min()), float(moving.max())))
    if scenario.lights:
        shown = np.concatenate([light.t for light in scenario.lights])
        spans.append(("traffic lights", float(shown.min()), float(shown.max()) + SHOWN_BEFORE_S))
    if scenario.controls is not None and len(scenario.controls):
        spans.append(("controls", float(scenario.controls.t[0]), float(scenario.controls.t[-1])))
    if scenario.onboard:
        spans.append(
            (
                "onboard plans",
                scenario.onboard[0].known,
                scenario.onboard[-1].known + SHOWN_BEFORE_S,
            )
        )
    for topic, begin, end in spans:
        if end < first or begin > last:
            theirs, own = _log_times(scenario, begin, end), _log_times(scenario, first, last)
            what = f"times from {theirs}, the ego's are from {own}: they do not overlap"
            raise LogError(what, topic=topic, remedy=ONE_CLOCK)
    begins, ends = tracks.t[tracks.offsets[:-1]], tracks.t[tracks.offsets[1:] - 1]
    late = begins > max(last, scenario.duration) + OTHER_CLOCK_S
    apart = ~tracks.static & (late | (ends < first - OTHER_CLOCK_S))
    if not apart.any():
        return scenario
    note = (
        f"{_names_of(tracks, apart)} have no sample within {OTHER_CLOCK_S:.0f} s of the ego's "
        "log: never in the scene."
    )
    return replace(scenario, notes=(*scenario.notes, note))


def _log_times(scenario: Scenario, begin: float, end: float) -> str:
    start = scenario.start_ns / 1e9
    return f"{start + begin:.3f} to {start + end:.3f} s"


def admitted(scenario: Scenario) -> Scenario:
    """Apply `LIMITS`, and make names printable; LogError if ego, vehicle, goal, controls or a plan
    is beyond one.
    """
    ego = scenario.ego
    _check_columns(scenario, "ego", ego)
    dt, d = np.diff(ego.t), np.hypot(np.diff(ego.x), np.diff(ego.y))
    far = np.flatnonzero(~(d <= STEP_M + SPEED.most * dt))
    if len(far):
        k = int(far[0])
        what = f"the position jumps by {d[k]:g} m within {dt[k]:g} s"
        raise _refusal(scenario, "ego", what, float(ego.t[k + 1]))
    long = np.flatnonzero(dt > GAP_S)
    if len(long):
        k = int(long[0])
        raise _refusal(
            scenario, "ego", f"no state for {dt[k]:g} s, longer than {GAP_S:g} s", float(ego.t[k])
        )
    if scenario.controls is not None:
        _check_columns(scenario, "controls", scenario.controls)
    for plan in scenario.onboard:
        _check_columns(scenario, "onboard", plan.trajectory)
    for item in fields(scenario.vehicle):
        limit = (
            VEHICLE_M if item.name in ("length", "width", "wheelbase", "rear_overhang") else VEHICLE
        )
        values = np.atleast_1d(getattr(scenario.vehicle, item.name))
        if not (np.abs(values) <= limit.most).all():
            what = (
                f"{item.name} is {np.max(np.abs(values)):g}, beyond {limit.most:g} {limit.unit}"
            ).rstrip()
            raise LogError(
                what, topic="vehicle", remedy="correct it, or name the vehicle with --car"
            )
    for region in scenario.goal.regions if scenario.goal else ():
        _check_place(scenario, "goal", np.asarray(region, dtype=np.float64))
    notes: list[str] = []
    tracks = _tracks_within(scenario, notes)
    if notes:
        scenario = replace(scenario, tracks=tracks, notes=(*scenario.notes, *notes))
    return printable(scenario)


def _check_columns(scenario: Scenario, topic: str, table: Any) -> None:
    """Raise LogError if a column of a table over `t` is beyond its limit; NaN (unknown) is
    accepted.
    """
    for name, limit in LIMITS[topic].items():
        column = np.asarray(getattr(table, name))
        away = np.abs(column - _zero(scenario, name))
        wrong = np.flatnonzero(~((away <= limit.most) | np.isnan(column)))
        if len(wrong):
            value, time = float(column[wrong[0]]), float(table.t[wrong[0]])
            what = (
                f"{name} is {value:g} {limit.unit}".rstrip()
                + f", beyond {limit.most:g} {limit.unit}".rstrip()
            )
            raise _refusal(scenario, topic, what, time)


def _zero(scenario: Scenario, name: str) -> float:
    """Return the zero of a column: for positions the ego's first, unless it is beyond any map
    projection.
    """
    start = scenario.ego.state(0)
    at = {"x": start.x, "y": start.y}.get(name, 0.0)
    return at if abs(at) < 1e8 else 0.0


def _refusal(scenario: Scenario, topic: str, what: str, time: float) -> LogError:
    remedy = "correct or remove that sample, or leave that part out with --from and --to"
    return LogError(what, topic=topic, time_ns=scenario.start_ns + round(1e9 * time), remedy=remedy)


def check_road(scenario: Scenario) -> Scenario:
    """Return the scenario; LogError if a lane is farther away than `WORLD`, or a speed limit is
    beyond `SPEED`.
    """
    road = scenario.road
    for lane in road.lanes.values():
        for side in (lane.left, lane.right):
            _check_place(scenario, f"road, lane {lane.id}", side)
        if isfinite(lane.speed_limit) and not 0.0 <= lane.speed_limit <= SPEED.most:
            raise _limit_refused(f"road, lane {lane.id}", lane.speed_limit)
    if not 0.0 < road.default_speed_limit <= SPEED.most:
        raise _limit_refused("road", road.default_speed_limit)
    return scenario


def _limit_refused(topic: str, value: float) -> LogError:
    what = f"the speed limit is {value:g} m/s, beyond {SPEED.most:g} m/s"
    return LogError(what, topic=topic, remedy="correct the map, or leave the limit out")


def _check_place(scenario: Scenario, topic: str, points: FloatArray) -> None:
    """Raise LogError if points `(n, 2)` are farther from the ego's start than `WORLD`."""
    away = np.abs(points - [_zero(scenario, "x"), _zero(scenario, "y")])
    if away.size and not away.max() <= WORLD.most:
        what = f"a point is {away.max():g} m from the ego's start, beyond {WORLD.most:g} m"
        raise LogError(what, topic=topic, remedy="give the map and the ego in the same coordinates")


def _tracks_within(scenario: Scenario, notes: list[str]) -> Tracks:
    """Leave out or replace samples, velocities and sizes beyond a limit, with notes; LogError if
    none is left.
    """
    tracks = scenario.tracks
    speed = np.hypot(np.nan_to_num(tracks.vx), np.nan_to_num(tracks.vy))  # NaN: not known
    fast = speed > SPEED.most
    if fast.any():
        whose = np.add.reduceat(fast, tracks.offsets[:-1]) > 0
        notes.append(
            f"The velocity of {_names_of(tracks, whose)} is up to {speed.max():g} m/s, beyond "
            f"{SPEED.most:g} m/s, at"
            f" {counted(int(fast.sum()), 'sample')}: taken as not known there."
        )
        tracks = replace(
            tracks, vx=np.where(fast, np.nan, tracks.vx), vy=np.where(fast, np.nan, tracks.vy)
        )
    low, high = SIZES_M
    odd = ~(
        (np.minimum(tracks.length, tracks.width) >= low)
        & (np.maximum(tracks.length, tracks.width) <= high)
    )
    if odd.any():
        what = f"not between {low:g} and {high:g} m: usual for the kind, assumed"
        notes.append(f"The size of {_names_of(tracks, odd)} is {what}.")
        usual = np.array([USUAL_SIZE_M[kind] for kind in tracks.kinds])
        length, width = (
            np.where(odd, usual[:, 0], tracks.length),
            np.where(odd, usual[:, 1], tracks.width),
        )
        tracks = replace(tracks, length=length, width=width)
    columns = {name: getattr(tracks, name) - _zero(scenario, name) for name in LIMITS["agents"]}
    beyond = {
        name: ~(np.abs(column) <= LIMITS["agents"][name].most) for name, column in columns.items()
    }
    bad = np.logical_or.reduce(list(beyond.values()))
    if not bad.any():
        return tracks
    k = int(np.argmax(bad))
    name = next(name for name, mask in beyond.items() if mask[k])
    limit = LIMITS["agents"][name]
    value = (
        f"{name} is {getattr(tracks, name)[k]:g} {limit.unit}, beyond {limit.most:g} {limit.unit}"
    )
    if bad.all():
        remedy = "give agents and ego in the same coordinates and units"
        raise LogError(f"no pose of an agent can be used: {value}", topic="agents", remedy=remedy)
    whose = np.add.reduceat(bad, tracks.offsets[:-1]) > 0
    when = (scenario.start_ns / 1e9) + float(tracks.t[k])
    notes.append(
        f"{counted(int(bad.sum()), 'sample')} of {_names_of(tracks, whose)} are left out: {value}, "
        f"{when:.3f} s."
    )
    return tracks.taken(~bad)


def _detections_within(scenario: Scenario, found: Detections) -> tuple[Detections, tuple[str, ...]]:
    """Return the detections within the limits of agents, with printable names, and notes on those
    left out.
    """
    beyond = [
        ~(np.abs(getattr(found, name) - _zero(scenario, name)) <= limit.most)
        for name, limit in LIMITS["agents"].items()
    ]
    bad = np.logical_or.reduce(beyond)
    notes = (
        (f"{counted(int(bad.sum()), 'detection')} beyond the limits of poses are left out.",)
        if bad.any()
        else ()
    )
    found = found.taken(~bad) if bad.any() else found
    with np.errstate(all="ignore"):
        fast = np.hypot(np.nan_to_num(found.vx), np.nan_to_num(found.vy)) > SPEED.most
        odd = [
            ~((size >= SIZES_M[0]) & (size <= SIZES_M[1])) & ~np.isnan(size)
            for size in (found.length, found.width)
        ]
    vx, vy = np.where(fast, np.nan, found.vx), np.where(fast, np.nan, found.vy)
    length, width = np.where(odd[0], np.nan, found.length), np.where(odd[1], np.nan, found.width)
    printable_name = {name: visible_name(name) for name in set(found.ids)}
    ids = tuple(printable_name[name] for name in found.ids)
    return replace(found, ids=ids, length=length, width=width, vx=vx, vy=vy), notes


def _names_of(tracks: Tracks, whose: BoolArray) -> str:
    names = [visible_name(tracks.ids[i]) for i in np.flatnonzero(whose)]
    return f"{counted(len(names), 'road user')} ({listed(names, NAMED)})"


def printable(scenario: Scenario) -> Scenario:
    """Make all names and texts printable in one line, with a note on changes."""
    names, taken = [visible_name(name) for name in scenario.tracks.ids], dict[str, int]()
    distinct = []  # repeated names get a number
    for name in names:
        count = taken[name] = taken.get(name, 0) + 1
        distinct.append(name if count == 1 else f"{name}~{count}")
    if len(set(distinct)) < len(distinct):
        distinct = [f"{name}~{i}" for i, name in enumerate(names)]
    ids = tuple(distinct)
    texts = {key: visible_name(getattr(scenario, key), inf) for key in ("source", "licence")}
    changed: dict[str, Any] = {
        "name": visible_name(scenario.name),
        "tags": tuple(map(visible_name, scenario.tags)),
        "metadata": {
            visible_name(key): visible_name(text, inf) for key, text in scenario.metadata.items()
        },
        "notes": tuple(visible_name(note, inf) for note in scenario.notes),
        **texts,
    }
    changed = {key: value for key, value in changed.items() if value != getattr(scenario, key)}
    if ids != scenario.tracks.ids:
        changed["tracks"] = replace(scenario.tracks, ids=ids)
    road = scenario.road
    odd = {
        i: replace(lane, kind=visible_name(lane.kind))
        for i, lane in road.lanes.items()
        if visible_name(lane.kind) != lane.kind
    }
    if odd:
        changed["road"] = replace(road, lanes={**road.lanes, **odd})
    if not changed:
        return scenario
    count = sum(one != other for one, other in zip(ids, scenario.tracks.ids, strict=True))
    what = [counted(count, "name") + " of road users"] if count else []
    what += [f"the {key}" for key in changed if key != "tracks"]
    note = f"Control characters in {', '.join(what)} are replaced, and long names cut."
    return replace(scenario, **{**changed, "notes": (*changed.get("notes", scenario.notes), note)})


def reason_to_repair(choice: str, found: Detections | None) -> str | None:
    """Return the reason for a repair of the detections, in a sentence; None: they are not
    repaired.
    """
    if found is None or choice == "off":
        return None
    if choice == "on":
        return "It was asked for."
    return needs_repair(found)


def repaired(scenario: Scenario, choice: str) -> Scenario:
    """Make tracks from the scenario's detections as `choice` ("auto", "on", "off") says.

    The result has no `detections`; a repaired scenario has them in its `repair`.
    """
    found = scenario.detections
    if choice == "on" and found is None:
        if scenario.repair is not None:
            found = scenario.repair.detections
        else:
            tracks = scenario.tracks
            found = detections_of(tracks.taken(~tracks.static[tracks.owner]))
    reason = reason_to_repair(choice, found)
    if found is None or reason is None:
        return scenario if scenario.detections is None else replace(scenario, detections=None)
    found, left_out = _detections_within(scenario, framed(found))
    tracks, made = repair(found, scenario.ego, scenario.vehicle)
    if scenario.detections is None and scenario.repair is None:
        # static road users stay, under unused names
        was, taken = scenario.tracks, {*tracks.ids, *made.removed.ids}
        stay = was.taken(was.static[was.owner])
        names = tuple(f"{name}~static" if name in taken else name for name in stay.ids)
        tracks = tracks.with_more(replace(stay, ids=names))
        made = replace(
            made, tracks=tracks, extended=np.r_[made.extended, np.zeros(len(stay.t), np.bool_)]
        )
    road, notes = scenario.road, [*scenario.notes, *left_out]
    if road.source is RoadSource.DRIVEN_PATH and scenario.repair is None:
        road = passed_width(road, tracks, notes)
    notes.append(
        " ".join((f"The road users are made of {len(found)} detections. {reason}", *made.summary()))
    )
    return replace(
        scenario, tracks=tracks, road=road, detections=None, repair=made, notes=tuple(notes)
    )


def named(scenario: Scenario) -> Scenario:
    """Give the repaired tracks the names of the causal tracker's tracks
    (`replan.logs.repair.detections`).
    """
    made = scenario.repair
    assert made is not None and made.tracks is scenario.tracks
    made = named_as_tracked(made)
    return replace(scenario, tracks=made.tracks, repair=made)
