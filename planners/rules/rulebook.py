"""The stops that the rules demand at one frame, and what is remembered of them.

Lines, with the distance d(b, j) in which the ego stops with deceleration b and jerk j:

(1) red, red and yellow      stop, unless not even `HARD` stops before the line
(2) yellow                   stop where `COMFORT` stops before the line; else drive on
(3) stop sign                come to rest (`REST_MPS`) within `NEAR_M` before the line once, then go

Zones: the ego would be in a zone from t_in to t_out, driving freely but for whoever is ahead of it; it waits unless for
each window (a, b) in which others take the zone

(4) t_out + c + x <= a    or    b + AFTER_S <= t_in    (lanes that merge: a + FOLLOW_S <= t_in)

c is the post-encroachment time, `CLEAR_S` before a vehicle: below 1.5 s an encounter is critical (criticality metrics
catalogue, Westhofen et al. 2023), and with the time to clear a lane from rest it makes gaps between the critical ones
of HCM 2010 (4.1 s for a left turn from the major road, 7.1 s from the minor one); `WALK_CLEAR_S` before a pedestrian.
Where the lanes merge, the ego is out of the way when its rear is in the zone, and x is what the one behind needs to
brake to the ego's speed at `YIELD_MPS2`: x = (v - v_ego)^2 / (2 v YIELD_MPS2). A gap once taken is kept with `KEPT_S`
less. The wait ends when (4) holds for who comes by at speed and for who starts from rest; it is open while nothing says
when. A zone behind which there is no room for the ego is not entered either. A demand that comes too late for `COMFORT`
(priority lane) or `HARD` (crosswalk) is not made: whom the ego would meet is in the S-T graph anyway.

Memory, dropped where the frame is fresh: the lines and zones that it stops for, which are stopped for as long as `HARD`
can; the stop signs at which it came to rest; the zones whose gap it took; since when it stands before a crosswalk.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import inf, isfinite

import numpy as np

from logs.frame import Frame
from logs.kernel import TIE, FloatArray
from logs.road import Road
from logs.rules import Colour
from logs.states import EgoState, wrap
from logs.trace import DecisionKind
from logs.vehicle import VehicleParameters
from planners.frenet.path import Path
from planners.frenet.profiles import STEP_S, braking, cruising, limit_profile
from planners.frenet.reference_path import ReferencePath
from planners.frenet.st_boundaries import agents_frenet
from planners.rules.windows import RED, Window, windows
from planners.rules.zones import Line, Priority, Walk, Zone, lines_along, zones_along

COMFORT, HARD = (2.8, 2.8), (7.0, 12.0)
"""Deceleration m/s2 and jerk m/s3."""
REST_MPS, NEAR_M = 0.1, 3.0
SHORT_M = 0.8
"""The front stays this far before a line, where comfort can."""
AIM_M = 0.5
"""It comes to rest this far before that."""
OVER_M = 1.0
"""Who stops for a line and has come over it by less than this still waits."""
CLEAR_S, WALK_CLEAR_S, AFTER_S, FOLLOW_S, KEPT_S, YIELD_MPS2 = 1.5, 2.0, 0.5, 1.0, 0.5, 2.0
PATIENCE_S = 3.0
"""Who stands at a crosswalk and does not begin to walk is waited for so long, from a standstill."""
KNOTS = 81
GO_MPS2, GO_MPS3 = 1.5, 2.0
"""How the ego is assumed to accelerate."""
CURVE_MPS2, EASE_MPS2 = 3.0, 1.5
LOOK_M = 10.0
"""Zones are looked at from this before the place where gentle braking for them would begin."""
STANDING_MPS, ROOM_M = 1.0, 1.0
ASKEW_RAD = 1.0


@dataclass(frozen=True, slots=True)
class Stop:
    """Where the ego's front must wait.

    Attributes:
        bound: Station that the front must not pass, m; `aim` where it should come to rest.
        aim: m.
        until: How long, s from the frame; inf: nobody knows.
        name: What stands there ("stop line 7").
        kind: Stop or yield.
        reason: Why.
    """

    bound: float
    aim: float
    until: float
    name: str
    kind: DecisionKind
    reason: str


@dataclass(frozen=True, eq=False, slots=True)
class _Start:
    """The ego at the plan's start: station of its front, m; distances to a comfortable and a hard stop, m."""

    frame: Frame
    state: EgoState
    s: float
    front: float
    soft: float
    hard: float
    passed: frozenset[str]


@dataclass(slots=True)
class _Memory:
    """What is remembered of the frames before.

    Attributes:
        stopping: Lines and zones that the ego stops for.
        rested: Stop signs at which it came to rest.
        taken: Zones whose gap it took.
        since: When it came to rest before crosswalks at which somebody stands.
    """

    stopping: set[str] = field(default_factory=set)
    rested: set[int] = field(default_factory=set)
    taken: set[str] = field(default_factory=set)
    since: dict[str, float] = field(default_factory=dict)

    def forget(self, near: set[str]) -> None:
        """Forget the zones that are not near any more."""
        self.taken &= near
        self.since = {name: t for name, t in self.since.items() if name in near}


class Rulebook:
    """The rules along one course (module docstring)."""

    def __init__(self, road: Road, course: ReferencePath, vehicle: VehicleParameters) -> None:
        self._road, self._course, self._vehicle = road, course, vehicle
        self._lines = lines_along(road, course, vehicle.width)
        self._zones = zones_along(road, course, vehicle)
        line = course.line
        self._limit = limit_profile(line.s, line.kappa, course.limit, CURVE_MPS2, EASE_MPS2) if self._zones else line.s
        self._memory = _Memory()

    @property
    def places(self) -> tuple[float, ...]:
        """Stations at which the ego may have to wait or others cross, m: lines, where zones begin and end."""
        zones = [station for zone in self._zones for station in (zone.s_in, zone.s_out)]
        return (*(line.s for line in self._lines), *zones)

    def stops(
        self, frame: Frame, start: EgoState, s: float, passed: frozenset[str] = frozenset(), *, fresh: bool
    ) -> tuple[Stop, ...]:
        """The stops for a plan from `start` with its rear axle at station `s`, in driving order.

        Whom the path passes (`passed`) does not stand in the way behind a zone.
        """
        if not self._lines and not self._zones:
            return ()
        if fresh:
            self._memory = _Memory()
        v = max(start.v, 0.0)
        soft, hard = (float(braking(v, start.a, *limits, STEP_S, 2 * KNOTS)[0, -1]) for limits in (COMFORT, HARD))
        ego = _Start(frame, start, s, s + self._vehicle.axle_to_front, soft, hard, passed)
        found = [stop for line in self._lines if (stop := self._at_line(line, ego)) is not None]
        found += self._at_zones(ego, min((stop.bound for stop in found), default=inf))
        self._memory.stopping = {stop.name for stop in found}
        return tuple(sorted(found, key=lambda stop: stop.bound))

    def _at_line(self, line: Line, ego: _Start) -> Stop | None:
        """The stop at a line, by (1) to (3)."""
        name = f"stop line {line.id}"
        held = name in self._memory.stopping
        ahead = line.s - ego.front
        if ahead < (-OVER_M if held else 0.0):
            self._memory.rested.discard(line.id)
            return None
        hard = held or ego.hard <= ahead
        if line.light is not None:
            colour = ego.frame.lights.get(line.light, Colour.OFF)
            stops = hard if colour in RED else colour is Colour.YELLOW and (held or ego.soft <= ahead - SHORT_M)
            reason = f"{colour.value} light {line.light}"
        else:
            if ego.frame.ego.v < REST_MPS and ahead <= NEAR_M:
                self._memory.rested.add(line.id)
            stops, reason = hard and line.id not in self._memory.rested, "stop sign"
        return _stop(line.s, ego, inf, name, DecisionKind.STOP, reason) if stops else None

    def _at_zones(self, ego: _Start, barrier: float) -> Iterator[Stop]:
        """The stops before zones, as far as the stop lines let the ego come."""
        near = [zone for zone in self._zones if ego.front < zone.s_in and self._looks(zone, ego, barrier)]
        self._memory.forget({zone.name for zone in near})
        if not near:
            return
        leader = self._leader(ego)
        sooner, later = (self._motion(ego, accel, leader) for accel in (max(ego.state.a, 0.0), ego.state.a))
        for zone in near:
            stop = self._at_zone(zone, ego, sooner, later, leader)
            if stop is not None:
                self._memory.taken.discard(zone.name)
                yield stop

    def _looks(self, zone: Zone, ego: _Start, barrier: float) -> bool:
        ahead = next(hold for hold in zone.holds if hold >= ego.front)
        return ahead < barrier and ahead - ego.front < 0.5 * ego.state.v**2 / EASE_MPS2 + ego.state.v + LOOK_M

    def _at_zone(
        self, zone: Zone, ego: _Start, sooner: FloatArray, later: FloatArray, leader: tuple[float, float, int]
    ) -> Stop | None:
        """The stop before a zone, by (4); the ego enters as with one motion, rows s, v, and leaves as with another."""
        memory, held, late = self._memory, zone.name in self._memory.stopping, isinstance(zone.by, Walk)
        t_in, t_out = self._passage(zone, ego.front, sooner)[0], self._passage(zone, ego.front, later)[1]
        until, why = 0.0, self._no_room(zone, ego, leader)
        if why:
            until = inf
        elif isfinite(t_in):
            taken = windows(zone, self._course.line, self._road, ego.frame)
            less = KEPT_S if zone.name in memory.taken else 0.0
            against = [each for each in taken if not self._passes(zone, each, t_in, t_out, later, less)]
            late = late and not all(each.waits for each in against)
            if not against or (not late and self._has_waited(zone, against, ego.frame)):
                memory.taken.add(zone.name)
                return None
            until, why = self._release(zone, ego, taken, sooner), _told(against[0], ego.frame, t_in, t_out)
        for hold in zone.holds if why else ():
            room = hold - ego.front
            if room >= 0.0 and (ego.hard if held or late else ego.soft) <= room:
                return _stop(hold, ego, until, zone.name, DecisionKind.YIELD, why)
        return None

    def _has_waited(self, zone: Zone, against: list[Window], frame: Frame) -> bool:
        """Whether the ego has stood long enough for pedestrians who stand there too."""
        if not all(each.waits for each in against):
            return False
        since = self._memory.since
        if frame.ego.v < REST_MPS:
            since.setdefault(zone.name, frame.t)
        elif frame.ego.v > STANDING_MPS and zone.name not in self._memory.taken:
            since.pop(zone.name, None)
        return zone.name in since and frame.t - since[zone.name] >= PATIENCE_S - TIE

    def _leader(self, ego: _Start) -> tuple[float, float, int]:
        """Station of the rear of the one ahead in the ego's way, its speed, its index; inf, 0, -1: nobody."""
        agents, line = ego.frame.agents, self._course.line
        frenet = agents_frenet(line.s, line.coef, agents.x, agents.y, ego.s, 80.0)
        rear = frenet[:, 0] - 0.5 * agents.length
        aligned = np.array(
            [abs(wrap(yaw - line.frame(at)[2])) < ASKEW_RAD for yaw, at in zip(agents.yaw, frenet[:, 0], strict=True)],
            bool,
        )
        beside = np.abs(frenet[:, 1]) < 0.5 * (agents.width + self._vehicle.width)
        beside &= np.array([name not in ego.passed for name in agents.ids], bool)
        rear = np.where(aligned & beside & (rear > ego.front - 1.0), rear, inf)
        if not np.isfinite(rear).any():
            return inf, 0.0, -1
        i = int(np.argmin(rear))
        return float(rear[i]), float(agents.speed[i]), i

    def _motion(self, ego: _Start, accel: float, leader: tuple[float, float, int]) -> FloatArray:
        """Rows s, v `(2, KNOTS)` of driving freely with this acceleration at first, but not into the one ahead."""
        motion = self._driven(ego.s, max(ego.state.v, 0.0), accel)
        if isfinite(leader[0]):
            behind = leader[0] - ego.front - ROOM_M + leader[1] * STEP_S * np.arange(KNOTS)
            motion[0] = np.minimum(motion[0], np.maximum(behind, 0.0))
        return motion

    def _driven(self, s: float, v: float, a: float) -> FloatArray:
        stations = self._course.line.s
        first = max(int(np.searchsorted(stations, s)) - 1, 0)
        ahead = stations[first:] - s
        if len(ahead) < 2:
            ahead, limit = np.array([0.0, 1.0]), np.full(2, self._limit[-1])
        else:
            limit = self._limit[first:]
        return cruising(ahead, limit, v, a, GO_MPS2, COMFORT[0], GO_MPS3, STEP_S, KNOTS)

    def _passage(self, zone: Zone, front: float, motion: FloatArray) -> tuple[float, float]:
        """When the ego's front enters a zone and its rear is out of the way, s; inf: later than it is looked ahead.

        Where the lanes merge it is out of the way when its rear is in the zone: from there on it is ahead.
        """
        end = zone.s_in if _merges(zone) else zone.s_out
        return _when(motion, zone.s_in - front), _when(motion, end + self._vehicle.length - front)

    def _passes(self, zone: Zone, window: Window, t_in: float, t_out: float, motion: FloatArray, less: float) -> bool:
        """(4) for one window, with `less` of the margin."""
        extra, clear = 0.0, CLEAR_S if isinstance(zone.by, Priority) else WALK_CLEAR_S
        if _merges(zone) and isfinite(t_out) and window.speed > 0.0:
            own = float(np.interp(t_out, STEP_S * np.arange(KNOTS), motion[1]))
            extra = max(window.speed - own, 0.0) ** 2 / (2.0 * window.speed * YIELD_MPS2)
        return t_out + clear - less + extra <= window.begin + TIE or _gone(zone, window) <= t_in + TIE

    def _release(self, zone: Zone, ego: _Start, taken: tuple[Window, ...], motion: FloatArray) -> float:
        """When the ego may pass the place where it waits, s: (4) holds for all windows, at speed and from rest.

        inf where within the horizon it does not.
        """
        hold = next(each for each in zone.holds if each >= ego.front)
        go = self._driven(hold - self._vehicle.axle_to_front, 0.0, 0.0)
        fastest = float(np.interp(hold, self._course.line.s, self._limit))
        enters, leaves = (zone.s_in - hold) / max(fastest, 1.0), self._passage(zone, hold, go)[1]
        arrives = _when(motion, hold - ego.front)
        for wait in sorted({arrives, *(max(_gone(zone, window) - enters, arrives) for window in taken)}):
            if isfinite(wait) and all(self._passes(zone, w, wait + enters, wait + leaves, go, 0.0) for w in taken):
                return wait
        return inf

    def _no_room(self, zone: Zone, ego: _Start, leader: tuple[float, float, int]) -> str:
        """Why the ego would have to stop in a zone: somebody stands behind it; empty where nobody does."""
        rear, speed, i = leader
        if speed >= STANDING_MPS or not zone.s_in < rear < zone.s_out + self._vehicle.length + ROOM_M:
            return ""
        return f"no room behind it: {_name(ego.frame, i)} stands there"


def _merges(zone: Zone) -> bool:
    return isinstance(zone.by, Priority) and zone.by.merges


def _gone(zone: Zone, window: Window) -> float:
    """From when on the ego may enter a zone after somebody, s: into a lane that it then shares it follows."""
    if _merges(zone):
        return window.begin + FOLLOW_S
    return window.end + (AFTER_S if isinstance(zone.by, Priority) else 0.0)


def _stop(line: float, ego: _Start, until: float, name: str, kind: DecisionKind, reason: str) -> Stop:
    """The stop at a line: `SHORT_M` before it; nearer, or over it, only where braking asks for it."""
    bound = max(line - SHORT_M, min(ego.front + ego.soft, line), ego.front + ego.hard)
    return Stop(bound, bound - AIM_M, until, name, kind, reason)


def _when(motion: FloatArray, distance: float) -> float:
    """When a motion, rows s, v, has come a distance (m), s; 0 where it has at the start, inf where it never does."""
    if distance <= 0.0:
        return 0.0
    k = int(np.searchsorted(motion[0], distance))
    if k >= motion.shape[1]:
        return inf
    step = float(motion[0, k] - motion[0, k - 1])
    return STEP_S * (k - 1 + (distance - float(motion[0, k - 1])) / step)


def _name(frame: Frame, i: int) -> str:
    return f"{frame.agents.kinds[i].value} {frame.agents.ids[i]}"


def _told(window: Window, frame: Frame, t_in: float, t_out: float) -> str:
    """Whom the ego lets go first, and why."""
    end, out = (f"to {t:.1f} s" if isfinite(t) else "on" for t in (window.end, t_out))
    return (
        f"{_name(frame, window.agent)} goes first: takes it from {window.begin:.1f} s {end}, "
        f"the ego would from {t_in:.1f} s {out}"
    )


@dataclass(frozen=True, eq=False, slots=True)
class Wall:
    """A stop on a path, for the rear axle: arc lengths of `Stop.bound` and `Stop.aim`, m, not negative."""

    stop: Stop
    bound: float
    aim: float


def walls_ahead(stops: tuple[Stop, ...], s: float, vehicle: VehicleParameters) -> tuple[Wall, ...]:
    """The stops for a rear axle at station `s` that keeps to the reference line."""
    here = s + vehicle.axle_to_front
    return tuple(Wall(stop, max(stop.bound - here, 0.0), max(stop.aim - here, 0.0)) for stop in stops)


def walls_on(stops: tuple[Stop, ...], path: Path, vehicle: VehicleParameters) -> tuple[Wall, ...]:
    """The stops that lie on a path."""
    walls = []
    for stop in stops:
        bound, aim = (station - vehicle.axle_to_front for station in (stop.bound, stop.aim))
        if bound < path.s[-1]:
            walls.append(Wall(stop, *(max(float(np.interp(at, path.s, path.sigma)), 0.0) for at in (bound, aim))))
    return tuple(walls)
