"""What is wrong with the other road users' tracks.

Between samples k and k + 1 of a track, dt apart, d apart:

(1) flickering    a gap of the track (`logs.presence`)
(2) id switch     a track ends before the log does, and within `SWITCH_S` another of its kind begins within `SWITCH_M`
                  of where the first would be by then, which was not there before
(3) teleport      d - u dt - `JUMP_M` > 0,  u = `FASTEST_MPS`, or, with logged speeds, max(|v|, |v'|) + b dt / 2
(4) speed         sum d / sum |v| dt  off 1 by more than `SPEED_OFF`, over a way of `WAY_M` at least
(5) heading flip  a step of the yaw of more than `FLIP_RAD` within `FLIP_S`, of those who are longer than wide
(6) twin boxes    two centres within `TWIN_M` for `TWIN_S` or longer
(7) size          vehicles beyond `LARGEST_M`, people wider than `PERSON_M`
(8) units         (4) by the same factor for most of those who move
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from logs.agents import AgentKind
from logs.kernel import FloatArray
from logs.scenario import Scenario, Tracks
from logs.states import wrapped
from metrics.health.ego import FACTORS, NEAR
from metrics.health.finding import Finding, Kind
from metrics.others import name_of, pieces

SWITCH_S = 0.6
"""A tracker that loses an agent has them again within this, s."""
SWITCH_M = 2.0
"""And about there, m."""
FASTEST_MPS = 70.0
"""Nobody on a road is faster, m/s."""
BRAKING_MPS2 = 12.0
"""Nor changes speed quicker, m/s2."""
JUMP_M = 1.5
"""Boxes of real perception move by this between two samples where it sees another part of the same car, m."""
SPEED_OFF = 0.25
"""Estimated speeds are this far off over a whole track, as a share, at most ..."""
WAY_M = 20.0
"""... if it goes this far, m."""
FLIP_RAD = 2.0
"""A box that is taken for the other way round turns by about pi, rad."""
FLIP_S = 1.0
TWIN_M = 0.4
"""Two bodies cannot be so near, centre to centre, m ..."""
TWIN_S = 0.5
"""... and for so long, s."""
GRID_S = 0.25
LARGEST_M = (30.0, 4.5)
"""Length and width of the largest vehicles on public roads, with room, m."""
PERSON_M = 2.5
"""Wider than any person or bicycle, m."""
MOST = 0.6
"""Share of the moving tracks that must be off by one factor."""
SMALL = (AgentKind.PEDESTRIAN, AgentKind.BICYCLE)
LONG = (AgentKind.CAR, AgentKind.TRUCK, AgentKind.BUS, AgentKind.MOTORCYCLE)


def flickering(scenario: Scenario) -> Iterator[Finding]:
    """(1), one for each track that has gaps."""
    tracks = scenario.tracks
    for i in range(len(tracks)):
        mine = tracks.samples(i)
        holes = np.flatnonzero(tracks.gap_after[mine])
        if not len(holes) or tracks.static[i]:
            continue
        t = tracks.t[mine]
        lost = float((t[holes + 1] - t[holes]).sum())
        times = "once" if len(holes) == 1 else f"{len(holes)} times"
        text = f"{name_of(tracks, i)} is lost {times}, {lost:.1f} s together"
        span = float(t[holes[0]]), float(t[holes[-1] + 1])
        yield Finding(Kind.AGENT_GAP, "agents", tracks.ids[i], *span, float(len(holes)), "1", text)


def id_switches(scenario: Scenario) -> Iterator[Finding]:
    """(2)."""
    tracks = scenario.tracks
    first, last = tracks.offsets[:-1], tracks.offsets[1:] - 1
    begins, ends = tracks.t[first], tracks.t[last]
    ending = np.flatnonzero(~tracks.static & (ends < scenario.duration - SWITCH_S))
    vx, vy = tracks.velocity(ending, last[ending])
    later = np.flatnonzero(~tracks.static)
    later = later[np.argsort(begins[later], kind="stable")]
    starts, until = begins[later], ends[ending] + SWITCH_S
    parts = np.searchsorted(starts, ends[ending], side="right"), np.searchsorted(starts, until, side="right")
    for i, k, u, w, low, high in zip(ending, last[ending], vx, vy, *parts, strict=True):
        others = np.sort(later[low:high])  # who begins within `SWITCH_S`
        wait, at = begins[others] - ends[i], first[others]
        away = np.hypot(tracks.x[at] - tracks.x[k] - wait * u, tracks.y[at] - tracks.y[k] - wait * w)
        same = (away < SWITCH_M) & (tracks.codes[others] == tracks.codes[i])
        if same.any():
            j = int(np.argmin(np.where(same, away, np.inf)))
            heir = tracks.ids[others[j]]
            text = f"{name_of(tracks, int(i))} goes on as {heir}, {away[j]:.1f} m from where it was expected"
            span = float(ends[i]), float(begins[others[j]])
            yield Finding(Kind.ID_SWITCH, "agents", tracks.ids[i], *span, float(away[j]), "m", text)


def teleports(scenario: Scenario) -> Iterator[Finding]:
    """(3), the largest of each track."""
    tracks = scenario.tracks
    for i in np.flatnonzero(~tracks.static):
        mine = tracks.samples(int(i))
        dt, d = np.diff(tracks.t[mine]), _steps(tracks, int(i))
        v = np.hypot(tracks.vx[mine], tracks.vy[mine])
        told = np.maximum(v[:-1], v[1:]) + 0.5 * BRAKING_MPS2 * dt
        excess = d - np.where(np.isfinite(told), np.minimum(told, FASTEST_MPS), FASTEST_MPS) * dt - JUMP_M
        if len(excess) and excess.max() > 0.0:
            k, count = int(np.argmax(excess)), int((excess > 0.0).sum())
            more = f", and {count - 1} more times" if count > 1 else ""
            text = f"{name_of(tracks, int(i))} jumps {d[k]:.1f} m in {dt[k]:.2f} s{more}"
            span = float(tracks.t[mine][k]), float(tracks.t[mine][k + 1])
            yield Finding(Kind.TELEPORT, "agents", tracks.ids[i], *span, float(d[k]), "m", text)


def speeds(scenario: Scenario) -> Iterator[Finding]:
    """(4), (8)."""
    tracks, found, ratios = scenario.tracks, [], []
    for i in np.flatnonzero(~tracks.static):
        mine = tracks.samples(int(i))
        v = np.hypot(tracks.vx[mine], tracks.vy[mine])
        if len(v) < 2 or not np.isfinite(v).all():
            continue
        t = tracks.t[mine]
        seen = ~tracks.gap_after[mine][:-1]
        way = float(_steps(tracks, int(i))[seen].sum())
        told = float((0.5 * np.diff(t) * (v[1:] + v[:-1]))[seen].sum())
        if max(way, told) < WAY_M:
            continue
        factor = told / way if way > 0.0 else np.inf
        ratios.append(factor)
        if abs(way - told) > SPEED_OFF * max(way, told):
            text = f"{name_of(tracks, int(i))} goes {way:.1f} m by positions, {told:.1f} m by speed"
            span = float(t[0]), float(t[-1])
            found.append(Finding(Kind.AGENT_SPEED, "agents", tracks.ids[i], *span, factor, "x", text))
    for known, said in FACTORS.items():
        near = [ratio for ratio in ratios if abs(ratio / known - 1.0) < NEAR]
        if len(near) > max(1.0, MOST * len(ratios)):
            text = f"the speeds of {len(near)} of {len(ratios)} agents are {known:.3g} times those of their positions"
            yield Finding(Kind.UNITS, "agents", "", 0.0, scenario.duration, known, "x", f"{text}; {said}")
            return
    yield from found


def heading_flips(scenario: Scenario) -> Iterator[Finding]:
    """(5), the first of each track."""
    tracks = scenario.tracks
    for i in np.flatnonzero(~tracks.static):
        if tracks.kinds[i] not in LONG:
            continue
        mine = tracks.samples(int(i))
        turn, dt = np.abs(wrapped(np.diff(tracks.yaw[mine]))), np.diff(tracks.t[mine])
        flips = np.flatnonzero((turn > FLIP_RAD) & (dt < FLIP_S))
        if len(flips):
            k, times = flips[0], "" if len(flips) == 1 else f", {len(flips)} times"
            text = f"{name_of(tracks, int(i))} turns by {turn[k]:.1f} rad in {dt[k]:.2f} s{times}"
            span = float(tracks.t[mine][k]), float(tracks.t[mine][k + 1])
            yield Finding(Kind.HEADING_FLIP, "agents", tracks.ids[i], *span, float(turn[k]), "rad", text)


def twins(scenario: Scenario) -> Iterator[Finding]:
    """(6)."""
    tracks = scenario.tracks
    if len(tracks) < 2:
        return
    t = np.arange(0.0, scenario.duration + 1e-9, GRID_S)
    met: dict[tuple[int, int], list[int]] = defaultdict(list)
    for piece, seen, at in pieces(tracks, t):
        for k in range(at.there.shape[1]):
            here = np.flatnonzero(at.there[:, k])
            order = here[np.argsort(at.pose[0, here, k], kind="stable")]
            for one, other in _near(at.pose[:2, order, k]):
                pair = sorted((int(seen[order[one]]), int(seen[order[other]])))
                met[tuple(pair)].append(piece.start + k)  # type: ignore[index]
    for (i, j), steps in sorted(met.items()):
        if GRID_S * (len(steps) - 1) >= TWIN_S and not (tracks.static[i] and tracks.static[j]):
            lasting = GRID_S * (len(steps) - 1)
            text = f"{name_of(tracks, i)} and {name_of(tracks, j)} are in one place for {lasting:.1f} s"
            span = float(t[steps[0]]), float(t[steps[-1]])
            yield Finding(Kind.TWIN, "agents", tracks.ids[i], *span, lasting, "s", text)


def _near(places: FloatArray) -> Iterator[tuple[int, int]]:
    """Pairs of places `(2, n)`, sorted by x, that are within `TWIN_M`."""
    x, y = places
    for i in range(len(x)):
        j = i + 1
        while j < len(x) and x[j] - x[i] < TWIN_M:
            if np.hypot(x[j] - x[i], y[j] - y[i]) < TWIN_M:
                yield i, j
            j += 1


def sizes(scenario: Scenario) -> Iterator[Finding]:
    """(7)."""
    tracks = scenario.tracks
    for i, kind in enumerate(tracks.kinds):
        length, width = float(tracks.length[i]), float(tracks.width[i])
        odd = kind in LONG and (length > LARGEST_M[0] or width > LARGEST_M[1])
        if odd or (kind in SMALL and min(length, width) > PERSON_M):
            text = f"{name_of(tracks, i)} is {length:.1f} m by {width:.1f} m"
            t = tracks.t[tracks.samples(i)]
            yield Finding(Kind.SIZE, "agents", tracks.ids[i], float(t[0]), float(t[-1]), length, "m", text)


def _steps(tracks: Tracks, i: int) -> FloatArray:
    """Way from each sample of a track to the next, m."""
    mine = tracks.samples(i)
    return np.asarray(np.hypot(np.diff(tracks.x[mine]), np.diff(tracks.y[mine])))
