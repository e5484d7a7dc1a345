"""The stops that the rules demand at one frame, and the memory of them.

Lines, with the distance d(b, j) in which the ego stops with deceleration b and jerk j:

(1) red, red and yellow      stop, unless not even `HARD` stops before the line
(2) yellow                   stop where `COMFORT` stops before the line; else drive on
(3) stop sign                come to rest (`REST_MPS`) within `NEAR_M` before the line once, then go

Zones: the ego would be in a zone from t_in to t_out, driving freely behind the agent ahead of it;
it waits unless for each window (a, b) in which others take the zone

(4) t_out + c + x <= a    or    b + AFTER_S <= t_in    (lanes that merge: a + FOLLOW_S <= t_in)

c is the post-encroachment time, `CLEAR_S` before a vehicle: below 1.5 s an encounter is critical
(criticality metrics catalogue, Westhofen et al. 2023), and with the time to clear a lane from rest
it makes gaps between the critical ones of HCM 2010 (4.1 s for a left turn from the major road, 7.1
s from the minor one); `WALK_CLEAR_S` before a pedestrian. Where the lanes merge, the ego is out of
the way when its rear is in the zone, and x is what the one behind needs to brake to the ego's speed
at `YIELD_MPS2`: x = (v - v_ego)^2 / (2 v YIELD_MPS2). A gap that the ego has taken needs `KEPT_S`
less. The wait ends when (4) holds both for an ego that enters at speed and for one that leaves as
from rest; it has no end if that is not within the horizon. The ego does not enter a zone without
room for it behind. A stop that comes too late for `COMFORT` (priority lane) or `HARD` (crosswalk)
is not demanded: the S-T graph has the agents.

Memory (`RuleMemory`): the lines that the ego stops for, until it is `OVER_M` over them, and the
zones, while `HARD` can; the stop signs at which it came to rest; the zones whose gap it took; since
when it stands before a crosswalk.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import inf, isfinite

import numpy as np

from replan.core.arrays import TIE, FloatArray
from replan.core.settings import Config, NotNegative
from replan.logs.plan import DecisionKind
from replan.logs.road import Road
from replan.logs.rules import RED, Colour
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.profiles import HORIZON_KNOTS, STEP_S, braking, cruising, limit_profile
from replan.planners.frenet.reference_path import ReferencePath
from replan.planners.frenet.scene import Occupancy, Scene
from replan.planners.rules.zone_times import ASKEW_RAD, ZoneTime, windows
from replan.planners.rules.zones import (
    ROOM_M,
    Priority,
    StopLineAhead,
    Walk,
    Zone,
    lines_along,
    zones_along,
)

COMFORT = 2.8, 2.8
"""Deceleration (m/s2) and jerk (m/s3) with which the ego stops where it comfortably can.

Below ITE's 3.05 m/s2.
"""
HARD = 7.0, 12.0  # Deceleration (m/s2) and jerk (m/s3) with which the ego stops where it must
REST_MPS = 0.1  # The ego is at rest below this, m/s
# The ego has stopped at a stop sign if it came to rest within this distance before the line, m
NEAR_M = 3.0
SHORT_M = 0.8  # Distance from the front to a line where a comfortable stop can keep it, m
AIM_M = 0.5  # Distance before that point at which the ego aims to come to rest, m
OVER_M = 1.0  # An ego that stops for a line and is over it by less than this still waits, m
CLEAR_S = 1.5  # c of (4) before a vehicle, s; its sources are in the module docstring
WALK_CLEAR_S = 2.0  # c of (4) before a pedestrian, s
AFTER_S = 0.5  # Time after a vehicle has left a zone until the ego may enter it (4), s
# Where lanes merge: time after a vehicle has entered the zone until the ego may follow it (4), s
FOLLOW_S = 1.0
KEPT_S = 0.5  # A gap that the ego has taken is kept while (4) holds with this much less, s
# Deceleration that the ego may demand of an agent from behind, m/s2: comfortable (b of IDM)
YIELD_MPS2 = 2.0
GO_MPS2 = 1.5  # Acceleration with which the ego is assumed to go, m/s2 ...
GO_MPS3 = 2.0  # ... and its jerk, m/s3.
# Assumed lateral acceleration of the ego in curves, m/s2, for planners that do not set their own
CURVE_MPS2 = 3.0
EASE_MPS2 = 1.5  # Assumed deceleration towards a lower limit, m/s2, likewise
# Zones are considered from this distance before the place where gentle braking for them would
# begin, m
LOOK_M = 10.0
# A leader slower than this makes no room behind a zone, an ego slower has not left a crosswalk, m/s
ROLLING_MPS = 1.0


@dataclass(frozen=True)
class RulesConfig(Config):
    """Settings of the rules."""

    patience_s: NotNegative = 3.0
    """How long a standing ego waits for a pedestrian who stands at a crosswalk and does not begin
    to walk.
    """


@dataclass(frozen=True, slots=True)
class RuleMemory:
    """The memory of earlier frames; without a previous plan it is a new one."""

    stopping: frozenset[str] = frozenset()  # Lines and zones that the ego stops for
    rested: frozenset[int] = frozenset()  # Stop signs at which it came to rest
    taken: frozenset[str] = frozenset()
    # When it came to rest before crosswalks at which pedestrians stand, by zone
    since: Mapping[str, float] = field(default_factory=dict)


@dataclass
class _Visit:
    """The data of one frame: the scene, the agents that the path passes, the memory.

    `leader` is the agent ahead in the ego's way: station of its rear, m, speed, m/s, index; inf, 0,
    -1 without one.
    """

    scene: Scene
    passed: frozenset[str]
    stopping: frozenset[str]
    rested: set[int]
    taken: set[str]
    since: dict[str, float]
    leader: tuple[float, float, int] = (inf, 0.0, -1)

    @cached_property
    def soft(self) -> float:
        """Distance to a comfortable stop, m."""
        return self._stopping(*COMFORT)

    @cached_property
    def hard(self) -> float:
        """Distance to a hard stop, m."""
        return self._stopping(*HARD)

    def _stopping(self, decel: float, jerk: float) -> float:
        profile = braking(self.scene.v, self.scene.start.a, decel, jerk, STEP_S, 2 * HORIZON_KNOTS)
        return float(profile[0, -1])

    def remembered(self, stops: list[Occupancy]) -> RuleMemory:
        """The memory for the next frame."""
        names = frozenset(stop.agent for stop in stops)
        return RuleMemory(names, frozenset(self.rested), frozenset(self.taken), dict(self.since))


class Rulebook:
    """The rules along one reference path (module docstring), for an ego with the planner's
    accelerations in curves.
    """

    def __init__(
        self,
        road: Road,
        reference: ReferencePath,
        vehicle: VehicleParameters,
        *,
        curve_accel_mps2: float = CURVE_MPS2,
        ease_mps2: float = EASE_MPS2,
        config: RulesConfig | None = None,
    ) -> None:
        self._ease, self._config = ease_mps2, config or RulesConfig()
        self._road, self._reference, self._vehicle = road, reference, vehicle
        self._lines = lines_along(road, reference, vehicle.width)
        self._zones = zones_along(road, reference, vehicle)
        line = reference.line
        has_zones = bool(self._zones)
        self._limit = (
            limit_profile(line.s, line.kappa, reference.limit, curve_accel_mps2, ease_mps2)
            if has_zones
            else line.s
        )

    @property
    def places(self) -> tuple[float, ...]:
        """Stations at which the ego may have to wait or others cross, m: stop lines, begins and
        ends of zones.
        """
        zones = [station for zone in self._zones for station in (zone.s_in, zone.s_out)]
        return (*(line.s for line in self._lines), *zones)

    def stops(
        self, scene: Scene, memory: RuleMemory, passed: frozenset[str] = frozenset()
    ) -> tuple[tuple[Occupancy, ...], RuleMemory]:
        """The stops for a plan from the scene's start, in driving order, for the ego's front; and
        the new memory.

        Agents that the path passes (`passed`) do not take the room behind a zone.
        """
        if not self._lines and not self._zones:
            return (), memory
        visit = _Visit(
            scene,
            passed,
            memory.stopping,
            set(memory.rested),
            set(memory.taken),
            dict(memory.since),
        )
        demanded = [
            stop for line in self._lines if (stop := self._at_line(line, visit)) is not None
        ]
        demanded += self._at_zones(visit, min((stop.s_from for stop in demanded), default=inf))
        return tuple(sorted(demanded, key=lambda stop: stop.s_from)), visit.remembered(demanded)

    def _at_line(self, line: StopLineAhead, visit: _Visit) -> Occupancy | None:
        """The stop at a line, by (1) to (3)."""
        name = f"stop line {line.id}"
        held = name in visit.stopping
        ahead = line.s - visit.scene.front
        if ahead < (-OVER_M if held else 0.0):
            visit.rested.discard(line.id)
            return None
        if line.light is not None:
            colour = visit.scene.frame.lights.get(line.light, Colour.OFF)
            yellow = colour is Colour.YELLOW and (held or visit.soft <= ahead - SHORT_M)
            stops = held or visit.hard <= ahead if colour in RED else yellow  # (1), (2)
            reason = f"{colour.value} light {line.light}"
        else:
            if visit.scene.frame.ego.v < REST_MPS and ahead <= NEAR_M:
                visit.rested.add(line.id)
            # (3)
            stops, reason = (
                line.id not in visit.rested and (held or visit.hard <= ahead),
                "stop sign",
            )
        return _stop(line.s, visit, inf, name, DecisionKind.STOP, reason) if stops else None

    def _at_zones(self, visit: _Visit, barrier: float) -> Iterator[Occupancy]:
        """The stops before the zones that the ego reaches before `barrier`, the first stop at a
        line.
        """
        scene, front, v = visit.scene, visit.scene.front, visit.scene.start.v
        zones_ahead = []
        for zone in self._zones:
            if front < zone.s_in:
                ahead = next(hold for hold in zone.holds if hold >= front)
                if ahead < barrier and ahead - front < 0.5 * v**2 / self._ease + v + LOOK_M:
                    zones_ahead.append(zone)
        names = {zone.name for zone in zones_ahead}
        visit.taken &= names
        visit.since = {name: t for name, t in visit.since.items() if name in names}
        if not zones_ahead:
            return
        agents, along, accel = scene.frame.agents, scene.agents, scene.start.a
        rears = along.s - 0.5 * agents.length
        in_way = (np.abs(along.turn) < ASKEW_RAD) & (
            np.abs(along.l) < 0.5 * (agents.width + self._vehicle.width)
        )
        in_way &= np.array([name not in visit.passed for name in agents.ids], bool) & (
            rears > front - 1.0
        )
        if in_way.any():
            i = int(np.argmin(np.where(in_way, rears, inf)))
            visit.leader = float(rears[i]), float(scene.speed[i]), i
        rear, speed, _ = visit.leader
        sooner, later = (
            self._drive_profile(scene.s, scene.v, at_first) for at_first in (max(accel, 0.0), accel)
        )
        if isfinite(rear):  # the ego stays behind its leader
            behind = rear - front - ROOM_M + speed * STEP_S * np.arange(HORIZON_KNOTS)
            for motion in (sooner, later):
                motion[0] = np.minimum(motion[0], np.maximum(behind, 0.0))
        for zone in zones_ahead:
            stop = self._at_zone(zone, visit, sooner, later)
            if stop is not None:
                visit.taken.discard(zone.name)
                yield stop

    def _at_zone(
        self, zone: Zone, visit: _Visit, sooner: FloatArray, later: FloatArray
    ) -> Occupancy | None:
        """The stop before a zone (4).

        The ego enters as in the motion `sooner`, leaves as in `later` (rows s, v).
        """
        scene, front = visit.scene, visit.scene.front
        held, may_stop_late = zone.name in visit.stopping, isinstance(zone.by, Walk)
        t_in, t_out = self._passage(zone, front, sooner)[0], self._passage(zone, front, later)[1]
        until, why, (rear, speed, leader) = 0.0, "", visit.leader
        if speed < ROLLING_MPS and zone.s_in < rear < zone.s_out + self._vehicle.length + ROOM_M:
            until, why = inf, f"no room behind it: {scene.name(leader)} stands there"
        elif isfinite(t_in):
            stretches = windows(zone, self._reference.line, self._road, scene.frame)
            released_s = KEPT_S if zone.name in visit.taken else 0.0
            against = [
                stretch
                for stretch in stretches
                if not self._passes(zone, stretch, t_in, t_out, later, released_s)
            ]
            waits, has_waited, ego = (
                all(stretch.waits for stretch in against),
                False,
                scene.frame.ego,
            )
            may_stop_late = may_stop_late and not waits
            # Only standing pedestrians: the ego goes first after it has stood long enough
            if against and waits:
                if ego.v < REST_MPS:
                    visit.since.setdefault(zone.name, scene.frame.t)
                elif ego.v > ROLLING_MPS and zone.name not in visit.taken:
                    visit.since.pop(zone.name, None)
                since = visit.since.get(zone.name, inf)
                has_waited = scene.frame.t - since >= self._config.patience_s - TIE
            if not against or has_waited:
                visit.taken.add(zone.name)
                return None
            nearest, until = against[0], self._release(zone, visit, stretches, sooner)
            from_text, until_text = (
                f"to {t:.1f} s" if isfinite(t) else "on" for t in (nearest.end, t_out)
            )
            name = scene.name(nearest.agent)
            why = f"{name} goes first: takes it from {nearest.begin:.1f} s {from_text}, "
            why += f"the ego would from {t_in:.1f} s {until_text}"
        for hold in zone.holds if why else ():
            room = hold - front
            if room >= 0.0 and (visit.hard if held or may_stop_late else visit.soft) <= room:
                return _stop(hold, visit, until, zone.name, DecisionKind.YIELD, why)
        return None

    def _drive_profile(self, s: float, v: float, a: float) -> FloatArray:
        stations = self._reference.line.s
        first = max(int(np.searchsorted(stations, s)) - 1, 0)
        ahead = stations[first:] - s
        if len(ahead) < 2:
            ahead, limit = np.array([0.0, 1.0]), np.full(2, self._limit[-1])
        else:
            limit = self._limit[first:]
        return cruising(ahead, limit, v, a, GO_MPS2, COMFORT[0], GO_MPS3, STEP_S, HORIZON_KNOTS)

    def _passage(self, zone: Zone, front: float, motion: FloatArray) -> tuple[float, float]:
        """When the ego's front enters a zone and its rear is out of the way, s; inf: after the
        horizon.

        Where the lanes merge it is out of the way when its rear is in the zone: from then on it is
        the leader.
        """
        end = zone.s_in if _merges(zone) else zone.s_out
        return _when(motion, zone.s_in - front), _when(motion, end + self._vehicle.length - front)

    def _passes(
        self,
        zone: Zone,
        window: ZoneTime,
        t_in: float,
        t_out: float,
        motion: FloatArray,
        less: float,
    ) -> bool:
        """Whether (4) holds for one window, with the margin reduced by `less`, s."""
        extra, clear = 0.0, CLEAR_S if isinstance(zone.by, Priority) else WALK_CLEAR_S
        if _merges(zone) and isfinite(t_out) and window.speed > 0.0:
            own = float(np.interp(t_out, STEP_S * np.arange(HORIZON_KNOTS), motion[1]))
            extra = max(window.speed - own, 0.0) ** 2 / (2.0 * window.speed * YIELD_MPS2)
        # (4)
        return (
            t_out + clear - less + extra <= window.begin + TIE or _gone(zone, window) <= t_in + TIE
        )

    def _release(
        self, zone: Zone, visit: _Visit, taken: tuple[ZoneTime, ...], motion: FloatArray
    ) -> float:
        """When the ego may pass the place where it waits, s: (4) holds for all windows, at speed
        and from rest.

        inf if it does not within the horizon.
        """
        hold = next(place for place in zone.holds if place >= visit.scene.front)
        go = self._drive_profile(hold - self._vehicle.axle_to_front, 0.0, 0.0)
        fastest = float(np.interp(hold, self._reference.line.s, self._limit))
        enters, leaves = (zone.s_in - hold) / max(fastest, 1.0), self._passage(zone, hold, go)[1]
        arrives = _when(motion, hold - visit.scene.front)
        for wait in sorted(
            {arrives, *(max(_gone(zone, window) - enters, arrives) for window in taken)}
        ):
            if isfinite(wait) and all(
                self._passes(zone, w, wait + enters, wait + leaves, go, 0.0) for w in taken
            ):
                return wait
        return inf


def _merges(zone: Zone) -> bool:
    return isinstance(zone.by, Priority) and zone.by.merges


def _gone(zone: Zone, window: ZoneTime) -> float:
    """Time from which the ego may enter a zone after an agent, s.

    Where lanes merge, it follows the agent.
    """
    if _merges(zone):
        return window.begin + FOLLOW_S  # (4)
    return window.end + (AFTER_S if isinstance(zone.by, Priority) else 0.0)


def _stop(
    line: float, visit: _Visit, until: float, name: str, kind: DecisionKind, reason: str
) -> Occupancy:
    """The stop at a line: `SHORT_M` before it; nearer, or over it, only where braking needs it."""
    bound = max(
        line - SHORT_M, min(visit.scene.front + visit.soft, line), visit.scene.front + visit.hard
    )
    return Occupancy(name, bound, until=until, aim=bound - AIM_M, kind=kind, reason=reason)


def _when(motion: FloatArray, distance: float) -> float:
    """Time at which a motion, rows s, v, has covered a distance (m), s; 0 for none, inf if it is
    not covered.
    """
    if distance <= 0.0:
        return 0.0
    k = int(np.searchsorted(motion[0], distance))
    if k >= motion.shape[1]:
        return inf
    step = float(motion[0, k] - motion[0, k - 1])
    return STEP_S * (k - 1 + (distance - float(motion[0, k - 1])) / step)
