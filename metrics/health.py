"""Checks a log before it is driven: kind of each fault, road user, time, size, and its effect on
metrics.

A log with findings is evaluated like any other; only phantoms change the metrics
(`replan.metrics.boxes`).

The ego, between samples k and k + 1, dt apart, d apart, with the speeds v and v':

(1) gap       dt > `EGO_GAP_S` and > `RARE` medians of dt
(2) jump      d - max(|v|, |v'|) dt - b dt^2 / 2 > `EGO_JUMP_M`,  b = `BRAKING_MPS2`
(3) speed     sum d / sum (|v| + |v'|) dt / 2  off 1 by more than `EGO_SPEED_OFF`, over a way of
              `EGO_WAY_M` at least
(4) units     the same near a factor of `FACTORS`, within `NEAR`
(5) heading   the chords of `replan.logs.chords`, about 1 m each, are more than `TURNED_RAD`
              off the axis of the car in the median, or over a way of `ASKEW_M`; or opposite to
              heading and speed over a way of `AGAINST_M`; a step of the yaw of more than
              `EGO_FLIP_RAD` within `EGO_GAP_S`

(23) point        the positions are explained by a point that is `POINT_M` or more before or behind
                  the rear axle (`replan.logs.ego_columns.place_ahead`)

The other road users, between samples of a track:

(6) flickering    a gap of the track (`replan.logs.observed`)
(7) id switch     a track ends before the log does, and within `SWITCH_S` a new track of its kind
                  begins within `SWITCH_M` of where the first would be by then
(8) teleport      d - u dt - `JUMP_M` > 0,
        u = `FASTEST_MPS`, or, with logged speeds, max(|v|, |v'|) + b dt / 2
(9) speed         (3) off 1 by more than `SPEED_OFF`, over a way of `WAY_M` at least
(10) heading flip a step of the yaw of more than `FLIP_RAD` within `FLIP_S`, for vehicles that are
     longer than wide
(11) twin boxes   two centres within `TWIN_M` for `TWIN_S` or longer
(12) size         vehicles beyond `LARGEST_M`, people wider than `PERSON_M`
(13) units        (9) by the same factor for most moving road users
(17) not recorded more than `replan.logs.observed.MAX_AGE_S` of the log without observed traffic
(18) across       a vehicle goes a step of more than `ACROSS_M` more than `ACROSS_RAD` off the axis
                  of its box
(20) heading      the chords of a vehicle are more than `TURNED_RAD` off the axis of its box in the
                  median, or opposite to its heading at more than `BACKWARD_MPS` over a way of
                  `WAY_M` at least
(21) velocity     the chords of a road user are more than `TURNED_RAD` off its velocity in the
                  median
(19) short tracks more than `SHORT_SHARE` of the tracks of vehicles have fewer than `SHORT` samples

The map, the lights and the goal:

(14) off the map  more than `OFF_SHARE` of the ego's states lie on no drivable lane
(15) lane graph   a lane follows itself, or begins more than `APART_M` from the end of one that it
                  follows; lanes whose successors are all missing in the map are its edge, unless
                  they are more than `EDGE` of all lanes
(16) lights       a light that no stop line names; on a road without stop lines, all lights are one
                  finding
(22) goal         it cannot be driven to (`replan.logs.route.GoalFault`), or the log's driver passes
                  it almost at once (`replan.metrics.arrival.passed_early`)
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise, starmap
from math import isfinite

import numpy as np
import pandas as pd

from replan.core.arrays import BoolArray, FloatArray
from replan.logs.agents import AgentKind, among
from replan.logs.chords import ENOUGH, ENOUGH_M, MOVES_MPS, Chords
from replan.logs.conventions import TURNED_RAD
from replan.logs.ego_columns import place_ahead
from replan.logs.observed import MAX_AGE_S, clipped
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.states import wrapped
from replan.logs.tracks import Tracks
from replan.metrics.arrival import fault_of, passed_early
from replan.metrics.boxes import name_of, phantoms, pieces

# As long as a frequently sampled agent may be unobserved (`replan.logs.observed`), s
EGO_GAP_S = 0.5
RARE = 5.0  # In medians of the sampling interval
EGO_JUMP_M = 0.5  # Errors of a car's localisation change by less between two samples, m
BRAKING_MPS2 = 12.0  # More than tyres can provide, m/s2
# Wheel speeds are within a few per cent; over a shorter way noise hides a factor
EGO_SPEED_OFF, EGO_WAY_M = 0.1, 10.0
FACTORS = {
    3.6: "the speeds look like km/h",
    2.237: "the speeds look like mph",
    100.0: "the speeds look like cm/s",
    1000.0: "the speeds look like mm/s, the positions like km, or the times like ms",
    0.3048: "the positions look like feet",
    0.01: "the positions look like cm",
    0.001: "the positions look like mm",
}
"""Distance by speed over distance by positions, if one of them has a wrong unit."""
NEAR = 0.04  # Tolerance of a factor, as a share
CLOSE_S = 0.09  # Speeds and positions are compared at 10 Hz at most
# Longer than a jump of a localisation; than a tight turn about another point, m
AGAINST_M, ASKEW_M = 2.0, 10.0
# Least distance of a point from the rear axle, share of the sideways motion that it explains, and
# distance from a known point
POINT_M, POINT_EXPLAINED, POINT_NEAR_M = 0.7, 0.8, 0.5
EGO_FLIP_RAD = 1.0  # No car turns by more between two samples, rad

# A tracker that loses an agent finds it again within this time, s, and this distance, m
SWITCH_S, SWITCH_M = 0.6, 2.0
FASTEST_MPS = 70.0  # No road user is faster, m/s
# Perceived boxes move by this between two samples when another part of the car is visible, m
JUMP_M = 1.5
BACKWARD_MPS = 5.0  # Vehicles reverse more slowly
# Largest error of estimated speeds, as a share, over a track of at least this length, m
SPEED_OFF, WAY_M = 0.25, 20.0
FLIP_RAD, FLIP_S = 2.0, 1.0  # A reversed box turns by about pi, rad
# Two centres cannot be so near for so long; tested every `GRID_S`
TWIN_M, TWIN_S, GRID_S = 0.4, 0.5, 0.25
# Longest and widest vehicle on public roads; wider than any person
LARGEST_M, PERSON_M = (30.0, 4.5), 2.5
MOST = 0.6  # Share of the moving tracks that must have the same factor
ACROSS_M, ACROSS_RAD = 2.5, 0.61  # No wheels slip so much: the boxes belong to two cars
# Passing road users are visible longer; some appear just before a log ends
SHORT, SHORT_SHARE = 3, 0.1
SMALL = (AgentKind.PEDESTRIAN, AgentKind.BICYCLE)
LONG = (AgentKind.CAR, AgentKind.TRUCK, AgentKind.BUS, AgentKind.MOTORCYCLE)

OFF_SHARE = 0.1  # A tenth of a drive may be off the lanes: cut corners, car parks
APART_M = 3.0  # Less than a lane's width, m
# If more than this share of the lanes ends in missing lanes, the map is incomplete, not only cut
EDGE = 0.5
SAMPLES = 200
SHOWN = 5  # Findings of one kind that a report lists
COLUMNS = ("log", "kind", "topic", "who", "t_from_s", "t_to_s", "value", "unit", "text", "effect")


class FaultKind(Enum):
    """The kinds of faults, and the `effect` of each on metrics."""

    effect: str

    PHANTOM = (
        "phantom",
        "left out of contacts, gaps and times to collision meanwhile; a drive that meets one is "
        "marked",
    )
    EGO_GAP = "ego gap", "plans are compared with an interpolated drive there"
    EGO_JUMP = (
        "ego jump",
        "open loop starts from states that were not driven; accuracy and comfort of the log are "
        "wrong there",
    )
    EGO_SPEED = (
        "ego speed",
        "speed errors, comfort and starts of plans use a speed that contradicts the positions",
    )
    EGO_HEADING = (
        "ego heading",
        "lateral errors, and every plan that starts there, rest on a wrong heading",
    )
    EGO_POINT = (
        "ego point",
        "lateral errors in bends, gaps and contacts are off by that distance",
    )
    AGENT_GAP = (
        "flickering",
        "they are not in the scene in between, neither for planners nor for metrics",
    )
    ID_SWITCH = (
        "id switch",
        "one road user counts as two, who appear and vanish; following and encounters are cut in "
        "two",
    )
    TELEPORT = "teleport", "time to collision, predictions and contacts are wrong around the jump"
    AGENT_SPEED = (
        "agent speed",
        "predictions, times to collision and RSS use a speed that contradicts the positions",
    )
    HEADING_FLIP = (
        "heading flip",
        "their box turns on the spot: contacts and predictions are wrong for a moment",
    )
    AGENT_HEADING = (
        "agent heading",
        "predictions, lanes, gaps and contacts of these boxes rest on a wrong heading",
    )
    VELOCITY = "velocity direction", "predictions and times to collision go where no road user went"
    ACROSS = "motion across the axis", "predictions cross the ego's way where no road user went"
    SHORT = (
        "short tracks",
        "the motion of briefly visible road users is unknown; many may be false detections",
    )
    TWIN = "twin boxes", "one road user is counted twice in gaps and in the number of road users"
    SIZE = "size", "contacts and gaps with them use a box that is probably wrong"
    UNITS = "units", "all that has metres or seconds in it is off by that factor"
    OFF_MAP = "off the map", "lanes, limits, off road and rules do not fit what was driven"
    LANE_GRAPH = "lane graph", "routes may end early or go in a circle"
    LIGHT = "light without a lane", "no car is asked to stop at it: red lights run are not counted"
    GOAL = (
        "goal",
        "a drive shows nothing about the way to it, or almost nothing: the verdict is inconclusive",
    )
    TRAFFIC = (
        "traffic not recorded",
        "gaps and contacts of what is driven then are no evidence of safety",
    )

    def __new__(cls, word: str, effect: str) -> FaultKind:
        """The word is the value."""
        kind = object.__new__(cls)
        kind._value_, kind.effect = word, effect
        return kind


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of a log, from `t_from` to `t_to`, s since the scenario's start."""

    kind: FaultKind
    topic: str  # The part of the scenario: "ego", "agents", "road", "lights", "goal"
    who: str  # The agent, lane or light, or ""
    t_from: float
    t_to: float
    value: float
    unit: str  # Unit of the value: "m", "s", "rad", "x" (a factor), "1" (a count or a share)
    text: str

    def __post_init__(self) -> None:
        for name in ("t_from", "t_to", "value"):
            object.__setattr__(self, name, float(getattr(self, name)))


def findings(scenario: Scenario) -> tuple[Finding, ...]:
    """Return all faults, in the order of `CHECKS`."""
    short = scenario.short_names
    return tuple(
        replace(found, text=short(found.text)) for check in CHECKS for found in check(scenario)
    )


def sentences(found: Iterable[Finding]) -> tuple[str, ...]:
    """Return one sentence for each kind: its first finding, the number of further ones, and the
    effect.
    """
    out = []
    for kind, (first, *more) in _by_kind(found).items():
        others = f" ({len(more)} more of this kind)" if more else ""
        when = f"{first.t_from:.2f} to {first.t_to:.2f} s"
        out.append(f"Health, {kind.value}: {first.text}, {when}{others}; {kind.effect}.")
    return tuple(out)


def report(scenario: Scenario, raw: Scenario | None = None) -> list[str]:
    """Return the findings as text for `replan inspect`: the first `SHOWN` of each kind, and the
    kind's effect.

    `raw` is the same log without the repair of its tracks, for comparison.
    """
    found = findings(scenario)
    out = [
        f"health: {len(found) or 'nothing'} {'findings' if found else 'found'} by {len(CHECKS)} "
        "checks"
    ]
    if raw is not None:
        was = Counter(one.kind.value for one in findings(raw))
        kinds = ", ".join(f"{count} {kind}" for kind, count in was.most_common())
        out += [
            f"repair: {len(raw.tracks)} tracks and {was.total()} findings before,"
            f" {len(scenario.tracks)} and {len(found)} after",
            f"    before: {kinds or 'nothing found'}",
        ]
    for kind, same in _by_kind(found).items():
        out.append(f"  {kind.value}: {kind.effect}")
        out += [
            f"    {one.t_from:.2f} to {one.t_to:.2f} s, {one.topic}: {one.text}"
            for one in same[:SHOWN]
        ]
        out += [f"    and {len(same) - SHOWN} more"] if len(same) > SHOWN else []
    return out


def table(log: str, found: Iterable[Finding]) -> pd.DataFrame:
    """Return the findings as a table with `COLUMNS`."""
    rows = [
        (
            log,
            one.kind.value,
            one.topic,
            one.who,
            one.t_from,
            one.t_to,
            one.value,
            one.unit,
            one.text,
            one.kind.effect,
        )
        for one in found
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype(
        {"t_from_s": float, "t_to_s": float, "value": float}
    )


def _by_kind(found: Iterable[Finding]) -> dict[FaultKind, list[Finding]]:
    """Group findings by kind, in the order of the first finding of each kind."""
    kinds: dict[FaultKind, list[Finding]] = {}
    for finding in found:
        kinds.setdefault(finding.kind, []).append(finding)
    return kinds


def ghosts(scenario: Scenario) -> Iterator[Finding]:
    """Find phantoms: boxes that overlap the recorded ego."""
    for phantom in phantoms(scenario):
        begin = phantom.t_from if isfinite(phantom.t_from) else 0.0
        end = phantom.t_to if isfinite(phantom.t_to) else scenario.duration
        text = f"the logged ego stands in {phantom.name}, which is left out for {end - begin:.1f} s"
        yield Finding(
            FaultKind.PHANTOM, "agents", phantom.agent, begin, end, end - begin, "s", text
        )


def ego_gaps(scenario: Scenario) -> Iterator[Finding]:
    """Gaps in the samples of the ego (1)."""
    t, dt = scenario.ego.t, np.diff(scenario.ego.t)
    for k in np.flatnonzero((dt > EGO_GAP_S) & (dt > RARE * np.median(dt))) if len(dt) else ():
        yield Finding(
            FaultKind.EGO_GAP,
            "ego",
            "",
            t[k],
            t[k + 1],
            dt[k],
            "s",
            f"no ego state for {dt[k]:.2f} s",
        )


def ego_jumps(scenario: Scenario) -> Iterator[Finding]:
    """Find jumps of the ego (2)."""
    ego = scenario.ego
    dt, d = np.diff(ego.t), np.hypot(np.diff(ego.x), np.diff(ego.y))
    fastest = np.maximum(np.abs(ego.v[:-1]), np.abs(ego.v[1:]))
    for k in np.flatnonzero(d - fastest * dt - 0.5 * BRAKING_MPS2 * dt**2 > EGO_JUMP_M):
        text = f"the ego jumps {d[k]:.1f} m in {dt[k]:.2f} s, at {fastest[k]:.1f} m/s"
        yield Finding(FaultKind.EGO_JUMP, "ego", "", ego.t[k], ego.t[k + 1], d[k], "m", text)


def ego_speed(scenario: Scenario) -> Iterator[Finding]:
    """Find speeds of the ego that do not match its positions, or match by a factor of units (3),
    (4).
    """
    ego = scenario.ego
    way, by_speed = _ways(ego.t, ego.x, ego.y, np.abs(ego.v), np.zeros(len(ego), np.bool_))
    if max(way, by_speed) < EGO_WAY_M or abs(way - by_speed) <= EGO_SPEED_OFF * max(way, by_speed):
        return
    factor = by_speed / way if way > 0.0 else np.inf
    text = (
        f"the ego's positions go {way:.1f} m, its speed {by_speed:.1f} m: {factor:.3g} times as far"
    )
    rate = round(factor)
    if rate > 1 and abs(factor / rate - 1.0) < NEAR and (np.diff(ego.t) == 1.0).all():
        text += f'; the times look like frames of {rate} Hz: columns = {{t = "t [{rate} Hz]"}}'
    unit = next(
        (meaning for known, meaning in FACTORS.items() if abs(factor / known - 1.0) < NEAR), ""
    )
    kind = FaultKind.UNITS if unit else FaultKind.EGO_SPEED
    yield Finding(
        kind, "ego", "", ego.t[0], ego.t[-1], factor, "x", f"{text}; {unit}" if unit else text
    )


def ego_heading(scenario: Scenario) -> Iterator[Finding]:
    """Find headings of the ego that do not match its motion (5)."""
    ego = scenario.ego
    chords = Chords.of_ego(ego)
    v = chords.mean(ego.v)
    off = np.abs(wrapped(chords.off(ego.yaw) + np.where(v < 0.0, np.pi, 0.0)))
    askew = np.minimum(off, np.pi - off)  # off the axis of the car
    runs = [(run, AGAINST_M) for run in _runs(off >= np.pi - TURNED_RAD)]
    runs += [(run, ASKEW_M) for run in _runs(askew > TURNED_RAD)]
    if chords.shows and np.median(askew) > TURNED_RAD:
        runs = [(slice(0, len(off)), ENOUGH_M)]
    for run, least in runs:
        if run.stop - run.start < 2 or chords.way[run].sum() < least:  # one chord may be a jump
            continue
        by = float(np.median(off[run]))
        begin, end = float(ego.t[chords.first[run][0]]), float(ego.t[chords.last[run][-1]])
        text = (
            f"the ego's heading is {by:.2f} rad off the way it goes, in the "
            f"median{_degrees(ego.yaw)}"
        )
        if least == AGAINST_M:
            sign = (
                "reverse gear without a signed speed?"
                if np.median(v[run]) >= 0.0
                else "is the speed's sign wrong?"
            )
            text = (
                "the ego's heading and speed point against the way it goes for "
                f"{end - begin:.1f} s: {sign}"
            )
        yield Finding(FaultKind.EGO_HEADING, "ego", "", begin, end, by, "rad", text)
    turn, dt = np.abs(wrapped(np.diff(ego.yaw))), np.diff(ego.t)
    for k in np.flatnonzero((turn > EGO_FLIP_RAD) & (dt < EGO_GAP_S)):
        text = f"the ego's heading turns by {turn[k]:.2f} rad in {dt[k]:.2f} s"
        yield Finding(
            FaultKind.EGO_HEADING, "ego", "", ego.t[k], ego.t[k + 1], turn[k], "rad", text
        )


def ego_point(scenario: Scenario) -> Iterator[Finding]:
    """Find positions of another point than the rear axle (23)."""
    ego, car = scenario.ego, scenario.vehicle
    ahead, explained = place_ahead(ego.t, ego.x, ego.y, ego.yaw)
    if abs(ahead) < POINT_M or explained < POINT_EXPLAINED:
        return
    points = {
        "the centre of its box": car.axle_to_center,
        "its front bumper": car.axle_to_front,
        "its front axle": car.wheelbase,
        "its rear bumper": -car.rear_overhang,
    }
    nearest = min(points, key=lambda name: abs(points[name] - ahead))
    is_near = abs(points[nearest] - ahead) < POINT_NEAR_M
    side = "before" if ahead > 0.0 else "behind"
    text = f"the ego's positions move like a point {abs(ahead):.1f} m {side} its rear axle"
    text += f": {nearest}? (ego_point in [log])" if is_near else ""
    yield Finding(FaultKind.EGO_POINT, "ego", "", ego.t[0], ego.t[-1], ahead, "m", text)


def _degrees(yaw: FloatArray) -> str:
    """Return a question for headings that contradict the motion: those beyond a turn may be
    degrees.
    """
    return "; in degrees?" if np.abs(yaw).max() > 2.0 * np.pi else ""


def _runs(mask: BoolArray) -> list[slice]:
    """Return the stretches in which a mask is true."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False)).tolist()
    return list(map(slice, edges[::2], edges[1::2]))


def _ways(
    t: FloatArray, x: FloatArray, y: FloatArray, v: FloatArray, gap_after: BoolArray
) -> tuple[float, float]:
    """Return the way by positions and by the speeds `v` `(n,)` >= 0, m, without the steps with a
    gap.

    Samples closer than `CLOSE_S` are left out: their steps are noise.
    """
    at = np.unique(np.append(np.unique((t - t[0]) // CLOSE_S, return_index=True)[1], len(t) - 1))
    seen = ~np.logical_or.reduceat(gap_after, at[:-1]) if len(at) > 1 else np.empty(0, np.bool_)
    t, x, y, v = t[at], x[at], y[at], v[at]
    way, by_speed = np.hypot(np.diff(x), np.diff(y)), 0.5 * np.diff(t) * (v[1:] + v[:-1])
    return float(way[seen].sum()), float(by_speed[seen].sum())


def _of_track(
    tracks: Tracks, i: int, kind: FaultKind, a: float, b: float, value: float, unit: str, text: str
) -> Finding:
    """Make a finding about a track from a to b, s; its text begins with the agent's name."""
    return Finding(kind, "agents", tracks.ids[i], a, b, value, unit, f"{name_of(tracks, i)} {text}")


def _moving(tracks: Tracks) -> Iterator[tuple[int, slice, FloatArray]]:
    """Yield index, samples and their times of each track that is not static."""
    found = ((i, tracks.samples(i)) for i in np.flatnonzero(~tracks.static).tolist())
    return ((i, mine, tracks.t[mine]) for i, mine in found)


def flickering(scenario: Scenario) -> Iterator[Finding]:
    """Find tracks with gaps (6), one finding for each."""
    tracks = scenario.tracks
    for i, mine, t in _moving(tracks):
        if len(holes := np.flatnonzero(tracks.gap_after[mine])):
            times = "once" if len(holes) == 1 else f"{len(holes)} times"
            text = f"is lost {times}, {float((t[holes + 1] - t[holes]).sum()):.1f} s together"
            yield _of_track(
                tracks, i, FaultKind.AGENT_GAP, t[holes[0]], t[holes[-1] + 1], len(holes), "1", text
            )


def id_switches(scenario: Scenario) -> Iterator[Finding]:
    """Find tracks that change their id (7)."""
    tracks = scenario.tracks
    first, last = tracks.offsets[:-1], tracks.offsets[1:] - 1
    begins, ends = tracks.t[first], tracks.t[last]
    ending, later = (
        np.flatnonzero(~tracks.static & some)
        for some in (ends < scenario.duration - SWITCH_S, True)
    )
    later = later[np.argsort(begins[later], kind="stable")]
    starts, until = begins[later], ends[ending] + SWITCH_S
    parts = (
        np.searchsorted(starts, ends[ending], side="right"),
        np.searchsorted(starts, until, side="right"),
    )
    for i, u, w, low, high in zip(
        ending, *tracks.velocity(ending, last[ending]), *parts, strict=True
    ):
        others, k = np.sort(later[low:high]), last[i]  # tracks that begin within `SWITCH_S`
        wait, at = begins[others] - ends[i], first[others]
        away = np.hypot(
            tracks.x[at] - tracks.x[k] - wait * u, tracks.y[at] - tracks.y[k] - wait * w
        )
        same = (away < SWITCH_M) & (tracks.codes[others] == tracks.codes[i])
        if same.any():
            j = int(np.argmin(np.where(same, away, np.inf)))
            text = f"goes on as {tracks.ids[others[j]]}, {away[j]:.1f} m from where it was expected"
            yield _of_track(
                tracks, int(i), FaultKind.ID_SWITCH, ends[i], begins[others[j]], away[j], "m", text
            )


def teleports(scenario: Scenario) -> Iterator[Finding]:
    """Find jumps of road users (8), the largest of each track."""
    tracks = scenario.tracks
    for i, mine, t in _moving(tracks):
        v = np.hypot(tracks.vx[mine], tracks.vy[mine])
        dt, d = np.diff(t), np.hypot(np.diff(tracks.x[mine]), np.diff(tracks.y[mine]))
        fastest = np.maximum(v[:-1], v[1:]) + 0.5 * BRAKING_MPS2 * dt
        excess = (
            d
            - np.where(np.isfinite(fastest), np.minimum(fastest, FASTEST_MPS), FASTEST_MPS) * dt
            - JUMP_M
        )
        if len(excess) and excess.max() > 0.0:
            k, count = int(np.argmax(excess)), int((excess > 0.0).sum())
            more = f", and {count - 1} more times" if count > 1 else ""
            text = f"jumps {d[k]:.1f} m in {dt[k]:.2f} s{more}"
            yield _of_track(tracks, i, FaultKind.TELEPORT, t[k], t[k + 1], d[k], "m", text)


def speeds(scenario: Scenario) -> Iterator[Finding]:
    """Find speeds of road users that do not match their positions, or match by a factor of units
    (9), (13).
    """
    tracks, found, ratios = scenario.tracks, [], []
    for i, mine, t in _moving(tracks):
        v = np.hypot(tracks.vx[mine], tracks.vy[mine])
        if len(v) < 2 or not np.isfinite(v).all():
            continue
        way, by_speed = _ways(t, tracks.x[mine], tracks.y[mine], v, tracks.gap_after[mine])
        if max(way, by_speed) < WAY_M:
            continue
        ratios.append(by_speed / way if way > 0.0 else np.inf)
        if abs(way - by_speed) > SPEED_OFF * max(way, by_speed):
            text = f"goes {way:.1f} m by positions, {by_speed:.1f} m by speed"
            found.append(
                _of_track(tracks, i, FaultKind.AGENT_SPEED, t[0], t[-1], ratios[-1], "x", text)
            )
    for known, meaning in FACTORS.items():
        near = [ratio for ratio in ratios if abs(ratio / known - 1.0) < NEAR]
        if len(near) > max(1.0, MOST * len(ratios)):
            text = (
                f"the speeds of {len(near)} of {len(ratios)} agents are {known:.3g} times those "
                "of their positions"
            )
            yield Finding(
                FaultKind.UNITS,
                "agents",
                "",
                0.0,
                scenario.duration,
                known,
                "x",
                f"{text}; {meaning}",
            )
            return
    yield from found


def heading_flips(scenario: Scenario) -> Iterator[Finding]:
    """Find reversed headings (10), the first of each track."""
    tracks = scenario.tracks
    for i, mine, t in _moving(tracks):
        turn = np.abs(wrapped(np.diff(tracks.yaw[mine])))
        flips = np.flatnonzero((turn > FLIP_RAD) & (np.diff(t) < FLIP_S))
        if len(flips) and tracks.kinds[i] in LONG:
            k, times = flips[0], "" if len(flips) == 1 else f", {len(flips)} times"
            text = f"turns by {turn[k]:.1f} rad in {t[k + 1] - t[k]:.2f} s{times}"
            yield _of_track(tracks, i, FaultKind.HEADING_FLIP, t[k], t[k + 1], turn[k], "rad", text)


def agent_headings(scenario: Scenario) -> Iterator[Finding]:
    """Find vehicles that do not go along the axis of their box, or fast against their heading
    (20).
    """
    tracks = scenario.tracks
    chords = Chords.of_tracks(tracks)
    chords = chords.taken(among(*LONG)[tracks.codes][chords.owner])
    off, speed = np.abs(chords.off(tracks.yaw)), chords.way / chords.dt

    def amount(mine: slice) -> float:
        by = float(np.median(off[mine]))
        backward = np.median(speed[mine]) > BACKWARD_MPS and chords.way[mine].sum() > WAY_M
        return by if backward else float(np.median(np.minimum(off[mine], np.pi - off[mine])))

    yield from _directions(scenario, FaultKind.AGENT_HEADING, "heading", chords, amount)


def velocity_directions(scenario: Scenario) -> Iterator[Finding]:
    """Find velocities of road users that point off the way they go (21)."""
    tracks = scenario.tracks
    chords = Chords.of_tracks(tracks)
    vx, vy = chords.mean(np.stack([tracks.vx, tracks.vy]))
    known = np.hypot(vx, vy) > MOVES_MPS
    chords = chords.taken(known)
    off = np.abs(wrapped(np.arctan2(vy, vx)[known] - chords.direction))
    yield from _directions(
        scenario, FaultKind.VELOCITY, "velocity", chords, lambda mine: float(np.median(off[mine]))
    )


def _directions(
    scenario: Scenario, kind: FaultKind, word: str, chords: Chords, amount: Callable[[slice], float]
) -> Iterator[Finding]:
    """Make a finding of each track whose chords are off by an `amount` above `TURNED_RAD`.

    One, if most tracks are.
    """
    tracks, found = scenario.tracks, []
    owners, first = np.unique(chords.owner, return_index=True)
    asked = 0
    for i, mine in zip(
        owners.tolist(), starmap(slice, pairwise([*first.tolist(), len(chords.owner)])), strict=True
    ):
        if mine.stop - mine.start < ENOUGH or chords.way[mine].sum() < ENOUGH_M:
            continue
        asked += 1
        if (by := amount(mine)) > TURNED_RAD:
            a, b = tracks.t[chords.first[mine][0]], tracks.t[chords.last[mine][-1]]
            text = (
                f"has a {word} {by:.2f} rad off the way it goes, {chords.way[mine].sum():.1f} "
                "m, in the median"
            )
            text += (
                _degrees(tracks.yaw[tracks.samples(i)]) if kind is FaultKind.AGENT_HEADING else ""
            )
            found.append(_of_track(tracks, i, kind, a, b, by, "rad", text))
    if len(found) > max(1.0, MOST * asked):
        by = float(np.median([one.value for one in found]))
        text = (
            f"{len(found)} of {asked} moving agents have a {word} off the way they go, by "
            f"{by:.2f} rad in the median"
        )
        found = [Finding(kind, "agents", "", 0.0, scenario.duration, by, "rad", text)]
    yield from found


def across(scenario: Scenario) -> Iterator[Finding]:
    """Find motion across a box's axis (18), the first of each track.

    The axis is the mean heading of both boxes.
    """
    tracks = scenario.tracks
    for i, mine, t in _moving(tracks):
        if tracks.kinds[i] not in LONG:
            continue
        yaw = tracks.yaw[mine]
        dx, dy = np.diff(tracks.x[mine]), np.diff(tracks.y[mine])
        # doubled: backward motion is fine
        turn = wrapped(2.0 * (np.arctan2(dy, dx) - yaw[:-1] - 0.5 * np.diff(yaw)))
        far = (
            (np.hypot(dx, dy) > ACROSS_M)
            & (np.abs(turn) > 2.0 * ACROSS_RAD)
            & ~tracks.gap_after[mine][:-1]
        )
        if far.any():
            k, count = int(np.argmax(far)), int(far.sum())
            more = f", and {count - 1} more times" if count > 1 else ""
            off = 0.5 * abs(float(turn[k]))
            text = (
                f"goes {np.hypot(dx[k], dy[k]):.1f} m at {off:.1f} rad to its axis in "
                f"{t[k + 1] - t[k]:.2f} s{more}"
            )
            yield _of_track(tracks, i, FaultKind.ACROSS, t[k], t[k + 1], off, "rad", text)


def short_tracks(scenario: Scenario) -> Iterator[Finding]:
    """Find too many short tracks (19)."""
    tracks = scenario.tracks
    vehicles = among(*LONG)[tracks.codes] & ~tracks.static
    short = int((np.diff(tracks.offsets)[vehicles] < SHORT).sum())
    if short > max(1.0, SHORT_SHARE * vehicles.sum()):
        text = (
            f"{short} of {int(vehicles.sum())} tracks of vehicles have fewer than {SHORT} samples"
        )
        yield Finding(FaultKind.SHORT, "agents", "", 0.0, scenario.duration, short, "1", text)


def twins(scenario: Scenario) -> Iterator[Finding]:
    """Find boxes that show one road user twice (11)."""
    tracks = scenario.tracks
    t = np.arange(0.0, scenario.duration + 1e-9, GRID_S)
    met: dict[tuple[int, int], list[int]] = defaultdict(list)
    for piece, seen, at in pieces(tracks, t) if len(tracks) > 1 else ():
        for k in range(at.there.shape[1]):
            here = np.flatnonzero(at.there[:, k])
            order = here[np.argsort(at.pose[0, here, k], kind="stable")]
            for one, other in _near_pairs(at.pose[:2, order, k]):
                i, j = sorted((int(seen[order[one]]), int(seen[order[other]])))
                met[i, j].append(piece.start + k)
    for (i, j), steps in sorted(met.items()):
        lasting = GRID_S * (len(steps) - 1)
        if lasting >= TWIN_S and not (tracks.static[i] and tracks.static[j]):
            text = f"and {name_of(tracks, j)} are in one place for {lasting:.1f} s"
            yield _of_track(
                tracks, i, FaultKind.TWIN, t[steps[0]], t[steps[-1]], lasting, "s", text
            )


def _near_pairs(places: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield pairs of positions `(2, n)`, sorted by x, that are within `TWIN_M`."""
    x, y = places
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            if x[j] - x[i] >= TWIN_M:
                break
            if np.hypot(x[j] - x[i], y[j] - y[i]) < TWIN_M:
                yield i, j


def unrecorded(scenario: Scenario) -> Iterator[Finding]:
    """Find times without observed traffic (17)."""
    spans = clipped(scenario.traffic_spans, 0.0, scenario.duration)
    edges = [0.0, *(edge for span in spans for edge in span), scenario.duration]
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end - begin > MAX_AGE_S:
            text = f"no traffic is recorded for {end - begin:.1f} s of {scenario.duration:.1f} s"
            yield Finding(FaultKind.TRAFFIC, "agents", "", begin, end, end - begin, "s", text)


def sizes(scenario: Scenario) -> Iterator[Finding]:
    """Find implausible sizes (12)."""
    tracks = scenario.tracks
    for i, kind in enumerate(tracks.kinds):
        length, width = float(tracks.length[i]), float(tracks.width[i])
        odd = kind in LONG and (length > LARGEST_M[0] or width > LARGEST_M[1])
        if odd or (kind in SMALL and min(length, width) > PERSON_M):
            t = tracks.t[tracks.samples(i)]
            yield _of_track(
                tracks,
                i,
                FaultKind.SIZE,
                t[0],
                t[-1],
                length,
                "m",
                f"is {length:.1f} m by {width:.1f} m",
            )


def off_map(scenario: Scenario) -> Iterator[Finding]:
    """Find states of the ego off the map (14)."""
    road, ego = scenario.road, scenario.ego
    if road.source is not RoadSource.LANES:
        return
    at = np.unique(np.linspace(0, len(ego) - 1, min(len(ego), SAMPLES)).round().astype(int))
    off = [k for k in at if not road.is_drivable(float(ego.x[k]), float(ego.y[k]))]
    share = len(off) / len(at)
    if share <= OFF_SHARE:
        return
    points = np.vstack(
        [lane.center for lane in road.lanes.values() if lane.drivable] or [np.full((1, 2), np.inf)]
    )
    away = max(float(np.hypot(points[:, 0] - ego.x[k], points[:, 1] - ego.y[k]).min()) for k in off)
    text = (
        f"{share:.0%} of the ego's states are on no drivable lane, up to {away:.1f} m from the "
        "nearest centre line"
    )
    yield Finding(FaultKind.OFF_MAP, "road", "", ego.t[off[0]], ego.t[off[-1]], share, "1", text)


def lane_graph(scenario: Scenario) -> Iterator[Finding]:
    """Find faults of the lane graph (15)."""
    lanes, end = scenario.road.lanes, scenario.duration
    if scenario.road.source is not RoadSource.LANES:
        return
    missing = [
        lane.id
        for lane in lanes.values()
        if lane.successors and lanes.keys().isdisjoint(lane.successors)
    ]
    if len(missing) > EDGE * len(lanes):
        text = (
            f"{len(missing)} of {len(lanes)} lanes are followed only by lanes that are not in "
            "the map"
        )
        yield Finding(FaultKind.LANE_GRAPH, "road", "", 0.0, end, len(missing), "1", text)
    for lane in lanes.values():
        for name in lane.successors:
            if name == lane.id:
                text = f"lane {lane.id} follows itself"
                yield Finding(FaultKind.LANE_GRAPH, "road", str(lane.id), 0.0, end, 0.0, "m", text)
            elif name in lanes:
                gap = float(np.hypot(*(lanes[name].center[0] - lane.center[-1])))
                if gap > APART_M:
                    text = (
                        f"lane {name} follows lane {lane.id}, but begins {gap:.1f} m from its end"
                    )
                    yield Finding(
                        FaultKind.LANE_GRAPH, "road", str(lane.id), 0.0, end, gap, "m", text
                    )


def lights(scenario: Scenario) -> Iterator[Finding]:
    """Find lights without a stop line (16)."""
    named, end = {line.light for line in scenario.road.stop_lines}, scenario.duration
    if scenario.lights and not named:
        begin = min(float(light.t[0]) for light in scenario.lights)
        text = f"{len(scenario.lights)} lights are shown, but the road has no stop lines"
        yield Finding(FaultKind.LIGHT, "lights", "", begin, end, len(scenario.lights), "1", text)
        return
    for light in scenario.lights:
        if light.id not in named:
            text = f"light {light.id} is shown, but no stop line of the map names it"
            yield Finding(FaultKind.LIGHT, "lights", str(light.id), light.t[0], end, 1.0, "1", text)


def goals(scenario: Scenario) -> Iterator[Finding]:
    """Find goals that no drive can show anything about (22)."""
    begin, end = float(scenario.ego.t[0]), scenario.duration
    if fault := fault_of(scenario):
        yield Finding(FaultKind.GOAL, "goal", "", begin, end, 0.0, "1", fault.value)
    elif early := passed_early(scenario):
        text = (
            f"the log's driver passes the goal after {early[0] - begin:.1f} s: {early[1]:.0%} "
            "of the log"
        )
        yield Finding(FaultKind.GOAL, "goal", "", early[0], end, early[1], "1", text)


CHECKS: tuple[Callable[[Scenario], Iterable[Finding]], ...] = (
    ghosts,
    ego_gaps,
    ego_jumps,
    ego_speed,
    ego_heading,
    ego_point,
    flickering,
    id_switches,
    teleports,
    speeds,
    heading_flips,
    agent_headings,
    velocity_directions,
    across,
    short_tracks,
    twins,
    sizes,
    unrecorded,
    off_map,
    lane_graph,
    lights,
    goals,
)
"""All checks, in the order of the report."""
