"""Checks the units and frames of what a log holds, at any rate: headings, velocities, positions,
the ego among agents.

The displacement between two samples shows a direction only if it is larger than the noise of
positions: at 100 Hz, a car at 10 m/s goes 0.1 m in a step. A chord joins two samples of a track
that are about a metre apart:

(1) from an anchor to the first later sample that is at least `WAY_M` away, which is the next
    anchor; an anchor moves on if that takes more than `LONGEST_S`, and no chord spans a step of
    more than `STEP_S`
(2) the heading of a chord is the mean of those at its ends: on an arc, the chord has that direction
(3) the misfit of a velocity is |v - d / dt| / |v|, d the displacement of the chord, v the mean of
    those at its ends

All readers pass through `checked`. It changes data only on clear evidence, and each change is a
note:

    positions  refused if they are degrees of latitude and longitude: in metres the ego hardly
               moves, in degrees it goes as fast as its speed says, or where its heading points
    headings   refused if the direction of motion contradicts them in rad, and agrees with one of
               `READINGS`
    ego        an agent that stays in the ego's box (4) is the ego, and left out
    velocity   agents' velocities in their own axes (forward, left) are rotated into the world if
               they fit the
               displacement there only

(4) at least `MOST` of its samples lie in the ego's box, which is longer by `LATE_S` of driving at
    both ends, while the ego goes `RIDES_M`; without that way, if it has a name of `EGO_NAMES`, or
    lies within `SAME_M` of the ego's rear axle or box centre for the ego's whole log

What only looks wrong is reported by `replan.metrics.health`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.errors import LogError
from replan.core.kernel import kernel
from replan.logs.agents import AgentKind, among
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory, wrapped
from replan.logs.tracks import Tracks

WAY_M = 1.0
"""Least length of a chord, m: more than the noise of positions."""
LONGEST_S = 5.0
"""Longest duration of a chord, s: slower motion is the drift of a standing localisation or box."""
STEP_S = 2.0
"""Longest step within a chord, s: the way within a longer one is not known."""
SLIPS_RAD, TURNED_RAD = 0.1, 0.5
"""A heading contradicts the motion where it is off by more than the spread of the directions,
within these: a mirrored one is off by twice that spread on average; a car slips by less, rad."""
MOVES_MPS = 1.0
"""Slower agents do not show the frame of their velocities, m/s."""
DIFFER = 0.2
"""Velocities in two frames differ by more than this share of the speed."""
ENOUGH, ENOUGH_M = 3, 5.0
"""Fewer chords, or a shorter way, show nothing."""


@kernel
def _chords(offsets: IntArray, t: FloatArray, x: FloatArray, y: FloatArray) -> IntArray:
    """Return owner, first and last sample of each chord `(3, k)` by (1)."""
    out, count = np.empty((3, len(t)), np.int64), 0
    for i in range(len(offsets) - 1):
        a = offsets[i]
        for k in range(a + 1, offsets[i + 1]):
            if t[k] - t[k - 1] > STEP_S:
                a = k
            while t[k] - t[a] > LONGEST_S:
                a += 1
            if np.hypot(x[k] - x[a], y[k] - y[a]) >= WAY_M:
                out[0, count], out[1, count], out[2, count] = i, a, k
                count, a = count + 1, k
    return out[:, :count].copy()


@dataclass(frozen=True, eq=False)
class Chords:
    """Chords (1) of paths, `(k,)` each: owner, first and last sample, displacement `d` `(2, k)`, m,
    within `dt`, s.
    """

    owner: IntArray
    first: IntArray
    last: IntArray
    d: FloatArray
    dt: FloatArray

    @classmethod
    def of(cls, offsets: IntArray, t: FloatArray, x: FloatArray, y: FloatArray) -> Chords:
        """Return the chords of paths with the samples `offsets[i] : offsets[i + 1]`.

        Their times do not decrease.
        """
        # writable: compiled once
        owner, a, b = _chords(np.array(offsets), np.array(t), np.array(x), np.array(y))
        return cls(owner, a, b, np.stack([x[b] - x[a], y[b] - y[a]]), t[b] - t[a])

    @classmethod
    def of_ego(cls, ego: Trajectory) -> Chords:
        """Return the chords of the ego's drive."""
        return cls.of(np.array([0, len(ego)]), ego.t, ego.x, ego.y)

    @classmethod
    def of_tracks(cls, tracks: Tracks) -> Chords:
        """Return the chords of all road users."""
        return cls.of(tracks.offsets, tracks.t, tracks.x, tracks.y)

    def taken(self, keep: BoolArray) -> Chords:
        """Return some of the chords."""
        return Chords(
            self.owner[keep], self.first[keep], self.last[keep], self.d[:, keep], self.dt[keep]
        )

    @cached_property
    def way(self) -> FloatArray:
        """Length `(k,)`, m."""
        return np.asarray(np.hypot(*self.d))

    @cached_property
    def direction(self) -> FloatArray:
        """Direction of motion `(k,)`, rad."""
        return np.asarray(np.arctan2(self.d[1], self.d[0]))

    @property
    def shows(self) -> bool:
        """Whether these are enough to judge."""
        return len(self.way) >= ENOUGH and float(self.way.sum()) >= ENOUGH_M

    def mean(self, values: FloatArray) -> FloatArray:
        """Return the means of `values` `(..., n)` of samples at both ends of each chord
        `(..., k)`.
        """
        return np.asarray(0.5 * (values[..., self.first] + values[..., self.last]))

    def off(self, yaw: FloatArray) -> FloatArray:
        """Return by how much the headings (2) of samples `(n,)` are off the direction of each chord
        `(k,)`, rad.
        """
        return wrapped(
            yaw[self.first] + 0.5 * wrapped(yaw[self.last] - yaw[self.first]) - self.direction
        )

    def misfits(self, velocities: Mapping[str, FloatArray]) -> dict[str, float] | None:
        """Return the median misfit (3) of velocities `(2, n)` by frame; None if too few chords show
        it.

        If enough chords show a difference of the frames, the others do not count.
        """
        v = self.mean(np.stack(list(velocities.values())).swapaxes(0, 1))  # (2, frames, k)
        speed = np.hypot(*v)
        asked = (speed.min(axis=0) > MOVES_MPS) & (self.dt > 0.0)
        differ = asked & (np.hypot(*(v - v[:, :1])).max(axis=0) > DIFFER * speed[0])
        if self.taken(differ).shows:
            asked = differ
        if not self.taken(asked).shows:
            return None
        off = np.hypot(*(v - (self.d / self.dt)[:, None])[..., asked]) / speed[:, asked]
        return dict(zip(velocities, np.median(off, axis=1).tolist(), strict=True))


# Headings

_SHOWS_HEADING = among(*(kind for kind in AgentKind if kind is not AgentKind.OBJECT))
READINGS: Mapping[str, tuple[float, float]] = {
    "degrees": (np.pi / 180.0, 0.0),
    "degrees clockwise from north": (-np.pi / 180.0, 0.5 * np.pi),
    "rad clockwise from north": (-1.0, 0.5 * np.pi),
    "rad clockwise from x": (-1.0, 0.0),
}
"""Other conventions of headings: factor and offset, rad, to rad counter-clockwise from x."""
FITS_RAD, CLOSE = 0.2, 0.25
"""A reading fits where it is off by less than both: an angle, and a share of the spread of the
directions.
"""
DENIED, AGREED = 0.3, 0.5
"""Least shares: of the chords that contradict the heading in rad, and of those that fit a reading
instead.
"""
SPREAD_RAD = 0.02
"""With less spread of the directions, a reading cannot be distinguished from a constant error."""


def reading_of(yaw: FloatArray, chords: Chords, reverse: BoolArray) -> str:
    """Return which of `READINGS` the headings `(n,)` have; "" if they fit in rad, or the motion
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
    for name, (factor, offset) in READINGS.items():
        sure = beyond and abs(factor) != 1.0
        if sure or spread >= SPREAD_RAD:
            off = np.abs(wrapped(chords.off(offset + factor * yaw) + turned))
            if (
                np.mean(off[against] < (FITS_RAD if sure else min(FITS_RAD, CLOSE * spread)))
                > AGREED
            ):
                return name
    return ""


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
        way = float(chords.way.sum())
        if way / SAME_WAY < by_speed < way * SAME_WAY:
            return True
        headings = [
            paths.yaw,
            *(offset + factor * paths.yaw for factor, offset in READINGS.values()),
        ]
        along = max(float(np.mean(np.abs(chords.off(each)) < FITS_RAD)) for each in headings)
        if (
            along >= MOST and by_speed != 0.0 and not by_speed > SAME_WAY * in_metres
        ):  # the speed is derived, or unknown
            return True
    return False


# The ego among the agents

MOST = 0.9
LATE_S = 0.1
"""Boxes of perception are late by up to this, s."""
RIDES_M, RIDES_S, SAME_M = 5.0, 1.0, 0.1
EGO_NAMES = frozenset(("ego", "egovehicle", "egocar", "hero", "host", "hostvehicle", "av", "self"))
"""Usual names of the ego, in lower case and without other characters than letters."""


def without_ego(scenario: Scenario) -> Scenario:
    """Leave out agents that are the ego (4), with a note; the spans of observed traffic stay."""
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

    def extent(values: FloatArray, some: BoolArray) -> FloatArray:
        most = np.maximum.reduceat(np.where(some, values, -np.inf), starts)
        return np.asarray(most - np.minimum.reduceat(np.where(some, values, np.inf), starts))

    count, lasts = np.add.reduceat(asked, starts, dtype=np.int64), extent(t, asked)
    mostly = (count > 0) & (np.add.reduceat(inside, starts, dtype=np.int64) >= MOST * count)
    rides = mostly & (extent(x, inside) + extent(y, inside) >= RIDES_M) & (lasts >= RIDES_S)
    stays = mostly & (np.add.reduceat(same, starts, dtype=np.int64) >= MOST * count)
    stays &= tracks.static | (lasts >= MOST * float(np.ptp(ego.t)))
    named = np.array(
        ["".join(filter(str.isalpha, name.lower())) in EGO_NAMES for name in tracks.ids], np.bool_
    )
    found = np.flatnonzero(rides | stays | (mostly & named))
    if not len(found):
        return scenario
    keep = np.ones(len(tracks), np.bool_)
    keep[found] = False
    names = ", ".join(tracks.ids[i] for i in found)
    note = (
        f"{names} among the road users {'is' if len(found) == 1 else 'are'} the ego itself: "
        "left out."
    )
    spans, left = scenario.traffic_spans, tracks.taken(keep[tracks.owner])
    return replace(scenario, tracks=left, traffic=spans, notes=(*scenario.notes, note))


# The frame of velocities

FITS_ALONE = 0.5
"""Velocities in another frame fit if their misfit is below this share of that in the world, and by
`CLEARLY` less.
"""
CLEARLY = 0.1


def in_world_axes(scenario: Scenario) -> Scenario:
    """Rotate the agents' velocities from their own axes into the world, with a note, if they fit
    there only.
    """
    tracks = scenario.tracks
    if not np.isfinite(tracks.vx).any():
        return scenario
    c, s = np.cos(tracks.yaw), np.sin(tracks.yaw)
    rotated = np.stack([c * tracks.vx - s * tracks.vy, s * tracks.vx + c * tracks.vy])
    fits = Chords.of_tracks(tracks).misfits(
        {"world": np.stack([tracks.vx, tracks.vy]), "own": rotated}
    )
    if fits is None or not fits["own"] < min(
        FITS_ALONE * fits["world"], fits["world"] - CLEARLY, FITS_ALONE
    ):
        return scenario
    note = (
        "The velocities of the road users are in their own axes (forward, left) and are rotated "
        "into the world: they"
        f" fit the displacement within {fits['own']:.0%}, in world axes {fits['world']:.0%}."
    )
    tracks = replace(tracks, vx=rotated[0], vy=rotated[1])
    return replace(scenario, tracks=tracks, notes=(*scenario.notes, note))


def checked(scenario: Scenario) -> Scenario:
    """Check units and frames of a log as a reader made it; LogError for degrees, or headings of
    `READINGS`.
    """
    ego, tracks = scenario.ego, scenario.tracks
    mine, theirs = Chords.of_ego(ego), Chords.of_tracks(tracks)
    theirs = theirs.taken(_SHOWS_HEADING[tracks.codes][theirs.owner])
    for topic, some, chords, offsets, v in (
        ("ego", ego, mine, np.array([0, len(ego)]), ego.v),
        ("agents", tracks, theirs, tracks.offsets, np.hypot(tracks.vx, tracks.vy)),
    ):
        if are_degrees(some, offsets, np.abs(v), scenario.origin):
            remedy = "project them to metres (UTM, or a plane at the start)"
            raise LogError(
                "the positions are degrees of latitude and longitude", topic=topic, remedy=remedy
            )
        reading = reading_of(some.yaw, chords, chords.mean(v) < 0.0)
        if reading:
            what = (
                f"the headings look like {reading}: they fit the direction of motion so, and "
                "not in rad"
            )
            remedy = "give them in rad, counter-clockwise from x"
            if reading == "degrees":
                remedy = f'name the unit (of a table: columns = {{"{topic}.yaw" = "yaw [deg]"}})'
            raise LogError(what, topic=topic, remedy=remedy)
    return in_world_axes(without_ego(scenario))
