"""Checks the units and frames of what a log holds, at any rate: headings, velocities, positions,
the ego among agents.

The direction of motion is that of chords (`replan.logs.chords`). `replan.logs.comparisons` calls
these checks:

    positions  refused if they are degrees of latitude and longitude: in metres the ego hardly
               moves, in degrees it goes as fast as its speed says, or where its heading points
    headings   refused if the direction of motion contradicts them in rad, and agrees with one of
               `HEADINGS`; or if they point across the direction of motion all the time
    steering   converted, or left out, if it contradicts the ego's headings
               (`replan.logs.ego_columns`)
    ego        an agent that stays in the ego's box (1) is the ego, and left out
    boxes      length and width of vehicles are exchanged if most that move along their heading are
               wider than long
    velocity   agents' velocities are read in those of `AXES` in which they fit the displacement,
               and left out if they fit in none

(1) at least `MOST` of its samples lie in the ego's box, which is longer by `LATE_S` of driving at
    both ends, while the ego goes `RIDES_M`; without that way, if it has a name of `EGO_NAMES`, or
    lies within `SAME_M` of the ego's rear axle or box centre for the ego's whole log
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.errors import LogError
from replan.logs.agents import AgentKind, among
from replan.logs.chords import ENOUGH, ENOUGH_M, Chords
from replan.logs.ego_columns import agreed_steering
from replan.logs.log_settings import AXES, HEADINGS
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory, wrapped
from replan.logs.tracks import Tracks

SLIPS_RAD, TURNED_RAD = 0.1, 0.5
"""A heading contradicts the motion where it is off by more than the spread of the directions,
within these: a mirrored one is off by twice that spread on average; a car slips by less, rad."""
# Headings

_VEHICLES = among(AgentKind.CAR, AgentKind.TRUCK, AgentKind.BUS, AgentKind.MOTORCYCLE)
_SHOWS_HEADING = among(*(kind for kind in AgentKind if kind is not AgentKind.OBJECT))
FITS_RAD, CLOSE = 0.2, 0.25
"""A reading fits where it is off by less than both: an angle, and a share of the spread of the
directions.
"""
DENIED, AGREED = 0.3, 0.5
"""Least shares: of the chords that contradict the heading in rad, and of those that fit a reading
instead.
"""
ACROSS_RAD, ACROSS_M = 0.8, 10.0
"""Headings point across the motion if all but `1 - MOST` of the chords are that far off the axis of
the car, over a way of at least this length: no car slips so.
"""
SPREAD_RAD = 0.02
"""With less spread of the directions, a reading cannot be distinguished from a constant error."""


def reading_of(yaw: FloatArray, chords: Chords, reverse: BoolArray) -> str:
    """Return which of `HEADINGS` the headings `(n,)` have; "" if they fit in rad, or the motion
    does not show it.

    `reverse` `(k,)` marks chords that were driven backward. Headings beyond a turn, 2 pi, that fit
    in degrees are degrees; other readings must follow the directions as these change.
    """
    turned = np.where(reverse, np.pi, 0.0)
    if not chords.shows:
        return ""
    middle = np.arctan2(np.sin(chords.direction).sum(), np.cos(chords.direction).sum())
    spread = float(np.sqrt(np.mean(wrapped(chords.direction - middle) ** 2)))
    against = np.abs(wrapped(chords.off(yaw) + turned)) > np.clip(spread, SLIPS_RAD, TURNED_RAD)
    if against.mean() < DENIED:
        return ""
    beyond = float(np.median(np.abs(yaw[chords.first]))) > 2.0 * np.pi
    for name, (factor, offset) in HEADINGS.items():
        sure = beyond and abs(factor) != 1.0
        if sure or spread >= SPREAD_RAD:
            off = np.abs(wrapped(chords.off(offset + factor * yaw) + turned))
            if (
                np.mean(off[against] < (FITS_RAD if sure else min(FITS_RAD, CLOSE * spread)))
                > AGREED
            ):
                return name
    return ""


def check_headings(scenario: Scenario, *, is_table: bool) -> Scenario:
    """Return the scenario; LogError for headings of `HEADINGS`, or across the direction of motion.

    `is_table`: [log] can state their convention.
    """
    ego, tracks = scenario.ego, scenario.tracks
    driven = Chords.of_ego(ego)
    _check_reading("ego", ego.yaw, driven, driven.mean(ego.v) < 0.0, is_table)
    _check_across("ego", ego.yaw, driven, is_table)
    chords = Chords.of_tracks(tracks)
    chords = chords.taken(_SHOWS_HEADING[tracks.codes][chords.owner])
    none_reverse = np.zeros(len(chords.owner), np.bool_)
    _check_reading("agents", tracks.yaw, chords, none_reverse, is_table)
    vehicles = chords.taken(_VEHICLES[tracks.codes][chords.owner])
    if len(np.unique(vehicles.owner)) > 1:  # one may have a wrong label
        _check_across("agents", tracks.yaw, vehicles, is_table)
    return scenario


def _check_reading(
    topic: str, yaw: FloatArray, chords: Chords, reverse: BoolArray, is_table: bool
) -> None:
    """Raise LogError for headings of `HEADINGS`; arguments as in `reading_of`."""
    reading = reading_of(yaw, chords, reverse)
    if reading:
        sentence = (
            f"the headings look like {reading}: they fit the direction of motion so, and not in rad"
        )
        raise LogError(sentence, topic=topic, remedy=_heading_remedy(topic, (reading,), is_table))


def _check_across(topic: str, yaw: FloatArray, chords: Chords, is_table: bool) -> None:
    """Raise LogError for headings `(n,)` across the direction of motion all the time."""
    off = np.abs(chords.off(yaw))
    across = np.minimum(off, np.pi - off) > ACROSS_RAD
    if len(off) < ENOUGH or across.mean() < MOST or chords.way[across].sum() < ACROSS_M:
        return
    fitting = tuple(
        name
        for name, (factor, offset) in HEADINGS.items()
        if np.median(np.abs(chords.off(offset + factor * yaw))) < FITS_RAD
    )
    sentence = (
        f"the headings are {np.median(off):.2f} rad off the direction of motion all the time: no "
        "car drives so"
    )
    raise LogError(sentence, topic=topic, remedy=_heading_remedy(topic, fitting, is_table))


def _heading_remedy(topic: str, fitting: tuple[str, ...], is_table: bool) -> str:
    """Return the remedy for headings that fit in these readings."""
    if not is_table:
        return "give them in rad, counter-clockwise from x"
    stated = " or ".join(f'{topic}_heading = "{name}"' for name in fitting)
    leave_out = f'leave them out (a table: columns = {{"{topic}.yaw" = "-"}} in [log])'
    if not stated:
        return f"correct them, or {leave_out}"
    return f"state it in [log]: {stated}; or {leave_out}"


# Positions

DEGREE_M = 111_320.0
"""Length of a degree of latitude, m (WGS 84, within 0.6 %)."""
HARDLY = 0.5
"""Positions in degrees change by less than this within a log."""
FASTEST_MPS = 150.0
"""Positions in metres would be faster than this if they were degrees, m/s."""
SAME_WAY = 2.0
"""Two ways are the same within this factor."""


def are_degrees(
    paths: Trajectory | Tracks, offsets: IntArray, v: FloatArray, origin: tuple[float, float]
) -> bool:
    """Return whether positions are degrees of longitude and latitude, in any order.

    Path i has the samples `offsets[i] : offsets[i + 1]`; the speeds `v` `(n,)` are not negative, or
    NaN; positions are relative to `origin`.
    """
    t, x, y = paths.t, paths.x, paths.y
    first = np.repeat(offsets[:-1], np.diff(offsets))
    dx, dy = x - x[first], y - y[first]
    if not len(x) or not max(np.abs(dx).max(), np.abs(dy).max()) < HARDLY:
        return False
    within = np.diff(first) == 0
    by_speed = float((0.5 * np.diff(t) * (v[1:] + v[:-1]))[within].sum())
    in_metres = float(np.hypot(np.diff(x), np.diff(y))[within].sum())
    places = (x + origin[0], dx), (y + origin[1], dy)
    for (east, to_east), (north, to_north) in (places, places[::-1]):
        if not (np.abs(north).max() <= 90.0 and np.abs(east).max() <= 180.0):
            continue
        chords = Chords.of(
            offsets, t, DEGREE_M * np.cos(np.radians(north)) * to_east, DEGREE_M * to_north
        )
        if not chords.shows or not (chords.way <= FASTEST_MPS * chords.dt).all():
            continue
        by_chords = float(chords.way.sum())
        if by_chords / SAME_WAY < by_speed < by_chords * SAME_WAY:
            return True
        headings = [
            paths.yaw,
            *(offset + factor * paths.yaw for factor, offset in HEADINGS.values()),
        ]
        along = max(float(np.mean(np.abs(chords.off(yaw)) < FITS_RAD)) for yaw in headings)
        if (
            along >= MOST and by_speed != 0.0 and not by_speed > SAME_WAY * in_metres
        ):  # the speed is derived, or unknown
            return True
    return False


def check_positions(scenario: Scenario) -> Scenario:
    """Return the scenario; LogError if positions of ego or agents are degrees."""
    ego, tracks = scenario.ego, scenario.tracks
    speeds = np.hypot(tracks.vx, tracks.vy)
    for topic, paths, offsets, v in (
        ("ego", ego, np.array([0, len(ego)]), np.abs(ego.v)),
        ("agents", tracks, tracks.offsets, speeds),
    ):
        if are_degrees(paths, offsets, v, scenario.origin):
            remedy = "project them to metres (UTM, or a plane at the start)"
            raise LogError(
                "the positions are degrees of latitude and longitude", topic=topic, remedy=remedy
            )
    return scenario


# The ego among the agents

MOST = 0.9
LATE_S = 0.1
"""Boxes of perception are late by up to this, s."""
RIDES_M, RIDES_S, SAME_M = 5.0, 1.0, 0.1
EGO_NAMES = frozenset(("ego", "egovehicle", "egocar", "hero", "host", "hostvehicle", "av", "self"))
"""Usual names of the ego, in lower case and without other characters than letters."""


def without_ego(scenario: Scenario) -> Scenario:
    """Leave out agents that are the ego (1), with a note; the spans of observed traffic stay."""
    ego, tracks, car = scenario.ego, scenario.tracks, scenario.vehicle
    if len(ego) < 2 or not len(tracks):
        return scenario
    t, starts = np.where(tracks.static[tracks.owner], ego.t[0], tracks.t), tracks.offsets[:-1]
    x, y, yaw, v = (
        np.interp(t, ego.t, column) for column in (ego.x, ego.y, ego.yaw, np.abs(ego.v))
    )
    c, s = np.cos(yaw), np.sin(yaw)
    dx, dy = tracks.x - x, tracks.y - y
    along, aside = c * dx + s * dy - car.axle_to_center, c * dy - s * dx
    asked = (t >= ego.t[0]) & (t <= ego.t[-1])
    inside = (
        asked
        & (np.abs(along) <= 0.5 * car.length + LATE_S * v)
        & (np.abs(aside) <= 0.5 * car.width)
    )
    near = np.minimum(np.hypot(dx, dy), np.hypot(along, aside))
    same = asked & (near <= SAME_M)

    def extent(values: FloatArray, rows: BoolArray) -> FloatArray:
        greatest = np.maximum.reduceat(np.where(rows, values, -np.inf), starts)
        return np.asarray(greatest - np.minimum.reduceat(np.where(rows, values, np.inf), starts))

    count, lasts = np.add.reduceat(asked, starts, dtype=np.int64), extent(t, asked)
    mostly = (count > 0) & (np.add.reduceat(inside, starts, dtype=np.int64) >= MOST * count)
    rides = mostly & (extent(x, inside) + extent(y, inside) >= RIDES_M) & (lasts >= RIDES_S)
    stays = mostly & (np.add.reduceat(same, starts, dtype=np.int64) >= MOST * count)
    stays &= tracks.static | (lasts >= MOST * float(np.ptp(ego.t)))
    named = np.array(
        ["".join(filter(str.isalpha, name.lower())) in EGO_NAMES for name in tracks.ids], np.bool_
    )
    ego_tracks = np.flatnonzero(rides | stays | (mostly & named))
    if not len(ego_tracks):
        return scenario
    keep = np.ones(len(tracks), np.bool_)
    keep[ego_tracks] = False
    names = ", ".join(tracks.ids[i] for i in ego_tracks)
    note = (
        f"{names} among the road users {'is' if len(ego_tracks) == 1 else 'are'} the ego itself: "
        "left out."
    )
    spans, left = scenario.traffic_spans, tracks.taken(keep[tracks.owner])
    return replace(scenario, tracks=left, traffic=spans, notes=(*scenario.notes, note))


# Boxes

WIDER = 1.2
"""A box's sides are exchanged if it is wider than long by this factor: all but boxes of detectors
that are nearly square.
"""


def with_sides(scenario: Scenario) -> Scenario:
    """Exchange length and width of the vehicles, with a note, if most of those that move along
    their heading are wider than long.
    """
    tracks = scenario.tracks
    chords = Chords.of_tracks(tracks)
    chords = chords.taken(_VEHICLES[tracks.codes][chords.owner])
    off = np.abs(chords.off(tracks.yaw))
    along = chords.taken(np.minimum(off, np.pi - off) < TURNED_RAD)
    ways = np.bincount(along.owner, along.way, len(tracks))
    moved = ways >= ENOUGH_M
    wider = tracks.width > WIDER * tracks.length
    if not moved.any() or wider[moved].mean() < MOST:
        return scenario
    vehicles = _VEHICLES[tracks.codes]
    note = (
        f"Length and width of the vehicles are exchanged: {np.count_nonzero(wider & moved)} of "
        f"{np.count_nonzero(moved)} that move along their heading are wider than long."
    )
    length = np.where(vehicles, tracks.width, tracks.length)
    width = np.where(vehicles, tracks.length, tracks.width)
    return replace(
        scenario,
        tracks=replace(tracks, length=length, width=width),
        notes=(*scenario.notes, note),
    )


# The axes of velocities

FITS_ALONE = 0.5
"""Velocities in other axes fit if their misfit is below this share of that in the usual ones, and
by `CLEARLY` less; with a greater misfit than it in all axes, velocities are not used.
"""
CLEARLY = 0.1
KEEP_AXES = 'agents_axes = "world" in [log] takes them as they are'


def in_axes(name: str, vx: FloatArray, vy: FloatArray, yaw: FloatArray) -> FloatArray:
    """Return velocities `(n,)` in axes of `AXES` as velocities in the world, `(2, n)`."""
    is_own, forward, left = AXES[name]
    if not is_own:
        return np.stack([forward * vx, left * vy])
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * forward * vx - s * left * vy, s * forward * vx + c * left * vy])


def axes_of(
    chords: Chords, vx: FloatArray, vy: FloatArray, yaw: FloatArray, usual: str
) -> tuple[str, float, float] | None:
    """Return the axes of `AXES` in which velocities `(n,)` fit the displacement, the misfit in
    them, and in the `usual` ones.

    "" if they fit in none; None if too few chords show it.
    """
    known = {name: in_axes(name, vx, vy, yaw) for name in AXES}
    alone = chords.misfits({usual: known[usual]})
    if alone is None:
        return None
    best, misfit, in_usual = "", alone[usual], alone[usual]
    for name in AXES:
        fits = chords.misfits({usual: known[usual], name: known[name]})  # where the two differ
        fit_alone = (
            min(FITS_ALONE, FITS_ALONE * fits[usual], fits[usual] - CLEARLY) if fits else 0.0
        )
        if not fits or not fits[name] < fit_alone:
            continue
        beside = chords.misfits({best: known[best], name: known[name]}) if best else None
        if not best or (beside and beside[name] < beside[best] - CLEARLY):
            best, misfit, in_usual = name, fits[name], fits[usual]
    if best:
        return best, misfit, in_usual
    return (usual if alone[usual] <= FITS_ALONE else ""), alone[usual], alone[usual]


def in_world_axes(scenario: Scenario, axes: str = "") -> Scenario:
    """Give the agents' velocities in the world, with a note, if they are in other `AXES`: those
    that are named, else those in which alone they fit. Velocities that fit in none are left out.
    """
    tracks = scenario.tracks
    if not np.isfinite(tracks.vx).any() or axes == "world":
        return scenario
    note = f"The velocities of the road users are read in {axes} axes, as set."
    if not axes:
        shown = axes_of(Chords.of_tracks(tracks), tracks.vx, tracks.vy, tracks.yaw, "world")
        if shown is None or shown[0] == "world":
            return scenario
        axes, misfit, in_world = shown
        note = (
            f"The velocities of the road users are in {axes} axes and are rotated into the world: "
            f"they fit the displacement within {misfit:.0%}, in world axes {in_world:.0%}"
            f" ({KEEP_AXES})."
        )
    if axes:
        vx, vy = in_axes(axes, tracks.vx, tracks.vy, tracks.yaw)
    else:
        vx = vy = np.full(len(tracks.t), np.nan)
        note = (
            "The velocities of the road users do not fit their displacement (median difference "
            f"{misfit:.0%} of the speed) and are derived from their positions ({KEEP_AXES})."
        )
    return replace(scenario, tracks=replace(tracks, vx=vx, vy=vy), notes=(*scenario.notes, note))


def with_steering(scenario: Scenario) -> Scenario:
    """Convert steering angles that contradict the ego's headings, or leave them out, with a
    note.
    """
    controls, ego = scenario.controls, scenario.ego
    if controls is None or len(ego) < 2 or not np.isfinite(controls.steer).any():
        return scenario
    motion = np.interp(controls.t, ego.t, ego.v), np.interp(controls.t, ego.t, ego.yaw)
    notes = list[str]()
    steer = agreed_steering(controls.t, controls.steer, motion, scenario.vehicle.wheelbase, notes)
    if not notes:
        return scenario
    return replace(
        scenario, controls=replace(controls, steer=steer), notes=(*scenario.notes, *notes)
    )
