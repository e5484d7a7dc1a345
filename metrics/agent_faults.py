"""Finds faults in a log's road users, between samples of a track and between tracks.

With the speeds v and v' at both ends of a step of dt and d:

(1) flickering    a gap of the track (`replan.logs.observed`)
(2) id switch     a track ends before the log does, and within `SWITCH_S` a new track of its kind
                  begins within `SWITCH_M` of where the first would be by then
(3) teleport      d - u dt - `JUMP_M` > 0,
        u = `FASTEST_MPS`, or, with logged speeds, max(|v|, |v'|) + b dt / 2
(4) speed         sum d / sum (|v| + |v'|) dt / 2  off 1 by more than `SPEED_OFF`, over a distance
                  of `DISTANCE_M` at least
(5) units         (4) by the same factor of `FACTORS` for most moving road users
(6) heading flip  a step of the yaw of more than `FLIP_RAD` within `FLIP_S`, for vehicles that are
                  longer than wide
(7) heading       the chords of a vehicle are more than `TURNED_RAD` off the axis of its box in the
                  median, or opposite to its heading at more than `BACKWARD_MPS` over a distance of
                  `DISTANCE_M` at least
(8) velocity      the chords of a road user are more than `TURNED_RAD` off its velocity in the
                  median
(9) across        a vehicle goes a step of more than `ACROSS_M` more than `ACROSS_RAD` off the axis
                  of its box
(10) short tracks more than `SHORT_SHARE` of the tracks of vehicles have fewer than `SHORT` samples
(11) twin boxes   two centres within `TWIN_M` for `TWIN_S` or longer
(12) size         vehicles beyond `LONGEST_M` or `WIDEST_M`, people wider than `PERSON_M`
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from itertools import pairwise, starmap
from math import isfinite

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind, among
from replan.logs.chords import ENOUGH, ENOUGH_M, MOVES_MPS, Chords
from replan.logs.conventions import TURNED_RAD
from replan.logs.scenario import Scenario
from replan.logs.states import wrapped
from replan.logs.tracks import Tracks
from replan.metrics.boxes import name_of, phantoms, pieces
from replan.metrics.log_faults import (
    BRAKING_MPS2,
    FACTORS,
    NEAR,
    FaultKind,
    Finding,
    degrees_question,
    distances,
)

SWITCH_S, SWITCH_M = 0.6, 2.0
"""A tracker that loses an agent finds it again within this time, s, and this distance, m."""
FASTEST_MPS = 70.0
"""No road user is faster, m/s."""
JUMP_M = 1.5
"""Perceived boxes move by this between two samples when another part of the car is visible, m."""
BACKWARD_MPS = 5.0
"""Vehicles reverse more slowly, m/s."""
SPEED_OFF, DISTANCE_M = 0.25, 20.0
"""Largest error of estimated speeds, as a share, over a track of at least this length, m."""
FLIP_RAD, FLIP_S = 2.0, 1.0
"""A reversed box turns by about pi, rad."""
TWIN_M, TWIN_S, GRID_S = 0.4, 0.5, 0.25
"""Two centres cannot be so near for so long; tested every `GRID_S`."""
LONGEST_M, WIDEST_M = 30.0, 4.5
"""Longest and widest vehicle on public roads, m."""
PERSON_M = 2.5
"""Wider than any person, m."""
MOST = 0.6
"""Share of the moving tracks that must have the same factor."""
ACROSS_M, ACROSS_RAD = 2.5, 0.61
"""No wheels slip so much: the boxes belong to two cars."""
SHORT, SHORT_SHARE = 3, 0.1
"""Passing road users are visible longer; some appear just before a log ends."""
SMALL = (AgentKind.PEDESTRIAN, AgentKind.BICYCLE)
LONG = (AgentKind.CAR, AgentKind.TRUCK, AgentKind.BUS, AgentKind.MOTORCYCLE)


def _of_track(
    tracks: Tracks, i: int, kind: FaultKind, begin: float, end: float, value: float, text: str
) -> Finding:
    """Make a finding about a track from `begin` to `end`, s; its text begins with the agent's
    name.
    """
    return Finding(kind, begin, end, value, f"{name_of(tracks, i)} {text}", tracks.ids[i])


def _moving(tracks: Tracks) -> Iterator[tuple[int, slice, FloatArray]]:
    """Yield index, samples and their times of each track that is not static."""
    for i in np.flatnonzero(~tracks.static).tolist():
        samples = tracks.samples(i)
        yield i, samples, tracks.t[samples]


def _repeated(count: int) -> str:
    return f", and {count - 1} more times" if count > 1 else ""


def ghosts(scenario: Scenario) -> Iterator[Finding]:
    """Find phantoms: boxes that overlap the recorded ego."""
    for phantom in phantoms(scenario):
        begin = phantom.t_from if isfinite(phantom.t_from) else 0.0
        end = phantom.t_to if isfinite(phantom.t_to) else scenario.duration
        text = f"the logged ego stands in {phantom.name}, which is left out for {end - begin:.1f} s"
        yield Finding(FaultKind.PHANTOM, begin, end, end - begin, text, phantom.agent)


def flickering(scenario: Scenario) -> Iterator[Finding]:
    """Find tracks with gaps (1), one finding for each."""
    tracks = scenario.tracks
    for i, samples, t in _moving(tracks):
        gaps = np.flatnonzero(tracks.gap_after[samples])
        if len(gaps):
            times = "once" if len(gaps) == 1 else f"{len(gaps)} times"
            text = f"is lost {times}, {float((t[gaps + 1] - t[gaps]).sum()):.1f} s together"
            begin, end = t[gaps[0]], t[gaps[-1] + 1]
            yield _of_track(tracks, i, FaultKind.AGENT_GAP, begin, end, len(gaps), text)


def id_switches(scenario: Scenario) -> Iterator[Finding]:
    """Find tracks that change their id (2)."""
    tracks = scenario.tracks
    firsts, lasts = tracks.offsets[:-1], tracks.offsets[1:] - 1
    begins, ends = tracks.t[firsts], tracks.t[lasts]
    ending = np.flatnonzero(~tracks.static & (ends < scenario.duration - SWITCH_S))
    starting = np.flatnonzero(~tracks.static)
    starting = starting[np.argsort(begins[starting], kind="stable")]
    starts = begins[starting]
    low = np.searchsorted(starts, ends[ending], side="right")
    high = np.searchsorted(starts, ends[ending] + SWITCH_S, side="right")
    velocities = tracks.velocity(ending, lasts[ending])
    for i, vx, vy, begin, end in zip(ending, *velocities, low, high, strict=True):
        others, last = np.sort(starting[begin:end]), lasts[i]  # that begin within `SWITCH_S`
        wait_s, first = begins[others] - ends[i], firsts[others]
        distance = np.hypot(
            tracks.x[first] - tracks.x[last] - wait_s * vx,
            tracks.y[first] - tracks.y[last] - wait_s * vy,
        )
        fits = (distance < SWITCH_M) & (tracks.codes[others] == tracks.codes[i])
        if fits.any():
            k = int(np.argmin(np.where(fits, distance, np.inf)))
            name, away = tracks.ids[others[k]], distance[k]
            text = f"goes on as {name}, {away:.1f} m from where it was expected"
            begin_s = begins[others[k]]
            yield _of_track(tracks, int(i), FaultKind.ID_SWITCH, ends[i], begin_s, away, text)


def teleports(scenario: Scenario) -> Iterator[Finding]:
    """Find jumps of road users (3), the largest of each track."""
    tracks = scenario.tracks
    for i, samples, t in _moving(tracks):
        v = np.hypot(tracks.vx[samples], tracks.vy[samples])
        dt, d = np.diff(t), np.hypot(np.diff(tracks.x[samples]), np.diff(tracks.y[samples]))
        fastest = np.fmin(np.maximum(v[:-1], v[1:]) + 0.5 * BRAKING_MPS2 * dt, FASTEST_MPS)
        excess = d - fastest * dt - JUMP_M
        if len(excess) and excess.max() > 0.0:
            k = int(np.argmax(excess))
            repeated = _repeated(int((excess > 0.0).sum()))
            text = f"jumps {d[k]:.1f} m in {dt[k]:.2f} s{repeated}"
            yield _of_track(tracks, i, FaultKind.TELEPORT, t[k], t[k + 1], d[k], text)


def speeds(scenario: Scenario) -> Iterator[Finding]:
    """Find speeds of road users that do not match their positions (4), or match by a factor of
    units (5).
    """
    tracks, findings, ratios = scenario.tracks, list[Finding](), list[float]()
    for i, samples, t in _moving(tracks):
        v = np.hypot(tracks.vx[samples], tracks.vy[samples])
        if len(v) < 2 or not np.isfinite(v).all():
            continue
        x, y, gap_after = tracks.x[samples], tracks.y[samples], tracks.gap_after[samples]
        driven, by_speed = distances(t, x, y, v, gap_after)
        longest = max(driven, by_speed)
        if longest < DISTANCE_M:
            continue
        ratios.append(by_speed / driven if driven > 0.0 else np.inf)
        if abs(driven - by_speed) > SPEED_OFF * longest:
            text = f"goes {driven:.1f} m by positions, {by_speed:.1f} m by speed"
            findings.append(
                _of_track(tracks, i, FaultKind.AGENT_SPEED, t[0], t[-1], ratios[-1], text)
            )
    for factor, meaning in FACTORS.items():
        near = sum(abs(ratio / factor - 1.0) < NEAR for ratio in ratios)
        if near > max(1.0, MOST * len(ratios)):
            text = (
                f"the speeds of {near} of {len(ratios)} agents are {factor:.3g} times those of "
                f"their positions; {meaning}"
            )
            yield Finding(FaultKind.UNITS, 0.0, scenario.duration, factor, text)
            return
    yield from findings


def heading_flips(scenario: Scenario) -> Iterator[Finding]:
    """Find reversed headings (6), the first of each track."""
    tracks = scenario.tracks
    for i, samples, t in _moving(tracks):
        turn = np.abs(wrapped(np.diff(tracks.yaw[samples])))
        flips = np.flatnonzero((turn > FLIP_RAD) & (np.diff(t) < FLIP_S))
        if len(flips) and tracks.kinds[i] in LONG:
            k, times = flips[0], "" if len(flips) == 1 else f", {len(flips)} times"
            text = f"turns by {turn[k]:.1f} rad in {t[k + 1] - t[k]:.2f} s{times}"
            yield _of_track(tracks, i, FaultKind.HEADING_FLIP, t[k], t[k + 1], turn[k], text)


def headings(scenario: Scenario) -> Iterator[Finding]:
    """Find vehicles that do not go along the axis of their box, or fast against their heading
    (7).
    """
    tracks = scenario.tracks
    chords = Chords.of_tracks(tracks)
    chords = chords.taken(among(*LONG)[tracks.codes][chords.owner])
    off, speed = np.abs(chords.off(tracks.yaw)), chords.way / chords.dt

    def angle_off(part: slice) -> float:
        if np.median(speed[part]) > BACKWARD_MPS and chords.way[part].sum() > DISTANCE_M:
            return float(np.median(off[part]))
        return float(np.median(np.minimum(off[part], np.pi - off[part])))

    yield from _directions(scenario, FaultKind.AGENT_HEADING, "heading", chords, angle_off)


def velocity_directions(scenario: Scenario) -> Iterator[Finding]:
    """Find velocities of road users that point off the way they go (8)."""
    tracks = scenario.tracks
    chords = Chords.of_tracks(tracks)
    vx, vy = chords.mean(np.stack([tracks.vx, tracks.vy]))
    is_known = np.hypot(vx, vy) > MOVES_MPS
    chords = chords.taken(is_known)
    off = np.abs(wrapped(np.arctan2(vy, vx)[is_known] - chords.direction))

    def angle_off(part: slice) -> float:
        return float(np.median(off[part]))

    yield from _directions(scenario, FaultKind.VELOCITY, "velocity", chords, angle_off)


def _directions(
    scenario: Scenario,
    kind: FaultKind,
    word: str,
    chords: Chords,
    angle_off: Callable[[slice], float],
) -> Iterator[Finding]:
    """Make a finding of each track whose chords are off by more than `TURNED_RAD`; a single one, if
    most tracks are.
    """
    tracks, findings, count = scenario.tracks, list[Finding](), 0
    owners, first = np.unique(chords.owner, return_index=True)
    parts = starmap(slice, pairwise([*first.tolist(), len(chords.owner)]))
    for i, part in zip(owners.tolist(), parts, strict=True):
        driven = chords.way[part].sum()
        if part.stop - part.start < ENOUGH or driven < ENOUGH_M:
            continue
        count += 1
        angle = angle_off(part)
        if angle > TURNED_RAD:
            begin, end = tracks.t[chords.first[part][0]], tracks.t[chords.last[part][-1]]
            text = (
                f"has a {word} {angle:.2f} rad off the way it goes, {driven:.1f} m, in the median"
            )
            if kind is FaultKind.AGENT_HEADING:
                text += degrees_question(tracks.yaw[tracks.samples(i)])
            findings.append(_of_track(tracks, i, kind, begin, end, angle, text))
    if len(findings) > max(1.0, MOST * count):
        angle = float(np.median([finding.value for finding in findings]))
        text = (
            f"{len(findings)} of {count} moving agents have a {word} off the way they go, by "
            f"{angle:.2f} rad in the median"
        )
        findings = [Finding(kind, 0.0, scenario.duration, angle, text)]
    yield from findings


def across(scenario: Scenario) -> Iterator[Finding]:
    """Find motion across a box's axis (9), the first of each track.

    The axis is the mean heading of both boxes.
    """
    tracks = scenario.tracks
    for i, samples, t in _moving(tracks):
        if tracks.kinds[i] not in LONG:
            continue
        yaw = tracks.yaw[samples]
        dx, dy = np.diff(tracks.x[samples]), np.diff(tracks.y[samples])
        distance = np.hypot(dx, dy)
        # doubled: backward motion is fine
        turn = wrapped(2.0 * (np.arctan2(dy, dx) - yaw[:-1] - 0.5 * np.diff(yaw)))
        is_across = (distance > ACROSS_M) & (np.abs(turn) > 2.0 * ACROSS_RAD)
        is_across &= ~tracks.gap_after[samples][:-1]
        if is_across.any():
            k = int(np.argmax(is_across))
            off = 0.5 * abs(float(turn[k]))
            text = (
                f"goes {distance[k]:.1f} m at {off:.1f} rad to its axis in "
                f"{t[k + 1] - t[k]:.2f} s{_repeated(int(is_across.sum()))}"
            )
            yield _of_track(tracks, i, FaultKind.ACROSS, t[k], t[k + 1], off, text)


def short_tracks(scenario: Scenario) -> Iterator[Finding]:
    """Find too many short tracks (10)."""
    tracks = scenario.tracks
    is_vehicle = among(*LONG)[tracks.codes] & ~tracks.static
    vehicles = int(is_vehicle.sum())
    short = int((np.diff(tracks.offsets)[is_vehicle] < SHORT).sum())
    if short > max(1.0, SHORT_SHARE * vehicles):
        text = f"{short} of {vehicles} tracks of vehicles have fewer than {SHORT} samples"
        yield Finding(FaultKind.SHORT, 0.0, scenario.duration, short, text)


def twins(scenario: Scenario) -> Iterator[Finding]:
    """Find boxes that show one road user twice (11)."""
    tracks = scenario.tracks
    t = np.arange(0.0, scenario.duration + 1e-9, GRID_S)
    steps_together: dict[tuple[int, int], list[int]] = defaultdict(list)
    for piece, agents, boxes in pieces(tracks, t) if len(tracks) > 1 else ():
        for k in range(boxes.there.shape[1]):
            present = np.flatnonzero(boxes.there[:, k])
            order = present[np.argsort(boxes.pose[0, present, k], kind="stable")]
            for pair in _near_pairs(boxes.pose[:2, order, k]):
                i, j = sorted(agents[order[list(pair)]].tolist())
                steps_together[i, j].append(piece.start + k)
    for (i, j), steps in sorted(steps_together.items()):
        lasting = GRID_S * (len(steps) - 1)
        if lasting >= TWIN_S and not (tracks.static[i] and tracks.static[j]):
            text = f"and {name_of(tracks, j)} are in one place for {lasting:.1f} s"
            yield _of_track(tracks, i, FaultKind.TWIN, t[steps[0]], t[steps[-1]], lasting, text)


def _near_pairs(places: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield pairs of positions `(2, n)`, sorted by x, that are within `TWIN_M`."""
    x, y = places
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            if x[j] - x[i] >= TWIN_M:
                break
            if np.hypot(x[j] - x[i], y[j] - y[i]) < TWIN_M:
                yield i, j


def sizes(scenario: Scenario) -> Iterator[Finding]:
    """Find implausible sizes (12)."""
    tracks = scenario.tracks
    for i, kind in enumerate(tracks.kinds):
        length, width = float(tracks.length[i]), float(tracks.width[i])
        is_large = kind in LONG and (length > LONGEST_M or width > WIDEST_M)
        if is_large or (kind in SMALL and min(length, width) > PERSON_M):
            t = tracks.t[tracks.samples(i)]
            text = f"is {length:.1f} m by {width:.1f} m"
            yield _of_track(tracks, i, FaultKind.SIZE, t[0], t[-1], length, text)
