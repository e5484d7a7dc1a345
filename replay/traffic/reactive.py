"""The others react: along their logged paths, each at a log time of its own, by one of two rules (`Rule`).

An agent is at the log time (phase) tau_i of its own; its place is the log's at tau_i, so that it never leaves its
path. Where its log ends, the most probable lane leads it on for `BEYOND_M` if it is late; in time, it leaves the scene
as it did in the log. Its speed never exceeds the logged one at its place, and it is never ahead of its log.

Undisturbed, tau_i = t: the log's own samples, to the bit. An agent is disturbed from when the leader below would have
it drive slower than it did in the log. Pairs that both are as they were in the log do not count (real drivers keep
other gaps than a model does); the ego counts as in the log while it is within `EGO_M` of it. While its log stands, a
late agent makes up for lost time. Leader and acceleration: `replay.traffic.following`. Who is late stops at closed
lights too (`red_lights`); who is as in the log passes them as it did, red ones too. Who enters the scene waits while
somebody who is not as in the log is in its place, and enters no faster than it can brake for its leader.

"reactive": vehicles drive behind whoever is on their path, the ego included, wherever it comes from.

"give_way": vehicles and riders drive as in the log unless they would then run into the ego, or into an agent that is
late because of it, and only where the ego may expect it:

(1) the ego has been ahead (`following` (5)) for `CC_REACT_S` without a break, the reaction time of the careful driver
    of UN R157; who begins or enters the scene behind it knows it already
(2) going on as in the log, the agent would drive into it (`following` (6))
(3) or the agent comes from a lane that yields to the ego's (`yielding`)
(4) it brakes as the leader demands, with 0.774 g at most (the same driver)

So who cuts in with less room than a careful driver needs, comes from the side without the right of way, or is in the
way of oncoming traffic is hit as in the log. Pedestrians and objects are replayed by time; where "reactive", bicycles
too.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, inf, sin

import numpy as np

from logs.kernel import BoolArray, FloatArray
from logs.scenario import AgentKind, Agents, Scenario, Tracks
from logs.states import EgoState
from metrics.others import name_of
from metrics.reference_drivers import CC_REACT_S
from planners.prediction import LaneMap
from planners.prediction.lane_following import FOLLOWING, followers
from replay.traffic.following import (
    DECEL_MPS2,
    STANDING_MPS,
    STANDSTILL_M,
    Leaders,
    Paths,
    Scene,
    accelerations,
    covered,
    desired_gaps,
    drives_into,
    ego_ahead,
    leaders,
    moved_on,
    taken,
)
from replay.traffic.phase_replay import PERIOD_S, PhaseReplay
from replay.traffic.red_lights import RedLights
from replay.traffic.yielding import Yielding
from replay.world import box_center

EGO_M, SAME_MPS = 1.0, 1e-6
BEYOND_M = 100.0
NAMED = 5
"""So many are named in the notes."""


@dataclass(frozen=True, slots=True)
class Rule:
    """Who reacts to what.

    Attributes:
        kinds: Who reacts.
        only_ahead: The ego counts for those only that have had it ahead for this long, s; None: for all.
        only_needed: An agent as in the log reacts only where it would drive into its leader.
        yields: Lanes that yield to the ego's wait for it.
    """

    kinds: tuple[AgentKind, ...]
    only_ahead: float | None
    only_needed: bool
    yields: bool


REACTIVE = Rule(FOLLOWING, only_ahead=None, only_needed=False, yields=False)
GIVE_WAY = Rule((*FOLLOWING, AgentKind.BICYCLE), only_ahead=CC_REACT_S, only_needed=True, yields=True)


class Reactive:
    """See the module docstring.

    Args:
        scenario: Its tracks, road, lights and ego.
        rule: Who reacts to what.
    """

    def __init__(self, scenario: Scenario, rule: Rule = REACTIVE) -> None:
        log, self._log_ego, self._vehicle = scenario.tracks, scenario.ego, scenario.vehicle
        self._rule = rule
        self._left = log.t[log.offsets[1:] - 1].copy() if len(log) else np.empty(0)
        self._replay = PhaseReplay(log, led_on(log, LaneMap.of(scenario.road)))
        led = self._replay.log
        self._paths = Paths(led.offsets, led.t, led.x, led.y, led.yaw)
        self._enters = log.t[log.offsets[:-1]] if len(log) else np.empty(0)
        self._reacts = np.array([kind in rule.kinds for kind in log.kinds], bool) & ~log.static
        self._lights = RedLights(scenario, led, self._reacts)
        self._yielding = Yielding(scenario, led, self._reacts & rule.yields)
        n = len(log)
        self._phase, self._speed, self._accel = np.zeros(n), np.zeros(n), np.zeros(n)
        self._late, self._there = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
        self._ahead_since = np.full(n, inf)
        self._since, self._braked = np.full(n, inf), np.zeros(n)
        self._next, self._tracks = -inf, Tracks.empty()

    @property
    def due(self) -> float:
        """The next time at which the ego is looked at, s."""
        return self._next

    def step(self, ego: EgoState) -> Tracks:
        """The others as they moved up to `ego.t`, and one sample beyond."""
        if self._next == -inf:
            self._next = ego.t
            self._enter(ego.t, ego)
            self._sample(ego.t)
        while self._next <= ego.t + 1e-9:
            self._advance(self._next, ego)
            self._next += PERIOD_S
            self._enter(self._next, ego)
            self._sample(self._next)
            self._tracks = self._replay.tracks(self._since)
        return self._tracks

    @property
    def notes(self) -> tuple[str, ...]:
        """Who has been disturbed so far, since when, and how hard they braked."""
        who = np.argsort(self._since, kind="stable")[: int(np.isfinite(self._since).sum())]
        log = self._replay.log
        named = [f"{name_of(log, i)} from {self._since[i]:.1f} s, {self._braked[i]:.1f} m/s2" for i in who[:NAMED]]
        if not named:
            return ()
        more = [f"{len(who) - NAMED} more"] if len(who) > NAMED else []
        return (f"not as in the log because of the ego (since when, hardest braking): {'; '.join(named + more)}",)

    def _sample(self, t: float) -> None:
        logged = self._logged_speeds(self._phase)
        slowed = self._late & (logged > STANDING_MPS)
        rate = np.where(slowed, np.divide(self._speed, logged, out=np.ones(len(logged)), where=slowed), 1.0)
        self._replay.add(t, self._phase, np.minimum(rate, 1.0), self._there)

    def _logged_speeds(self, phase: FloatArray) -> FloatArray:
        return covered(self._paths, phase, PERIOD_S) / PERIOD_S

    def _advance(self, t: float, ego: EgoState) -> None:
        """Lead everybody on from `t` by one period."""
        logged = self._logged_speeds(self._phase)
        found = self._leaders(ego, self._there & self._reacts, t)
        held = self._lights.accelerations(t, self._phase, self._speed, self._late & self._there & self._reacts)
        wanted = self._speed + PERIOD_S * np.minimum(accelerations(self._speed, found), held)
        slower = np.isfinite(found.gap) & (wanted < logged - SAME_MPS) & (found.gap < desired_gaps(self._speed, found))
        if self._rule.only_needed:
            slower &= drives_into(self._paths, self._phase, found)
        ahead = self._yielding.gaps(ego, self._phase, self._speed, self._there & (not self._as_logged(ego)))
        waits = accelerations(self._speed, Leaders(ahead, np.zeros(len(ahead)), np.zeros(len(ahead))))
        wanted = np.minimum(wanted, self._speed + PERIOD_S * waits)
        slower |= np.isfinite(ahead) & (wanted < logged - SAME_MPS)
        self._delay(self._there & self._reacts & slower, t)
        speed = np.where(self._late, np.clip(wanted, 0.0, logged), logged) * self._there
        log = self._replay.log
        phase = moved_on(self._paths, self._phase, speed * PERIOD_S, t + PERIOD_S)
        waiting = self._late & ~self._there
        self._phase = np.where(waiting, self._phase, np.where(self._late, phase, t + PERIOD_S))
        self._late &= waiting | (self._phase < t + PERIOD_S - 1e-9) | (speed < logged - SAME_MPS)
        self._accel = np.where(self._there, (speed - self._speed) / PERIOD_S, 0.0)
        self._braked = np.maximum(self._braked, np.where(self._late, -self._accel, 0.0))
        self._speed = speed
        ends = np.where(self._late, log.t[log.offsets[1:] - 1], self._left) if len(log) else self._left
        self._there &= self._phase <= ends + 1e-9

    def _enter(self, t: float, ego: EgoState) -> None:
        """Let in whose log begins by `t`."""
        coming = ~self._there & (self._enters <= t + 1e-9) & (self._left >= t - 1e-9) & ~self._replay.log.static
        waited = self._late & ~self._there & (self._phase <= self._enters + 1e-9)
        coming = (coming & ~self._late) | waited
        if not coming.any():
            return
        self._phase = np.where(coming, np.where(waited, self._enters, t), self._phase)
        blocked = coming & self._reacts & self._in_place(ego, coming)
        self._delay(blocked, self._enters)
        self._phase = np.where(blocked, self._enters, self._phase)
        entering = coming & ~blocked
        self._there |= entering
        logged = self._logged_speeds(self._phase)
        self._speed = np.where(entering, logged, self._speed)
        found = self._leaders(ego, entering & self._reacts, -inf)
        safe = np.sqrt(found.speed**2 + 2.0 * DECEL_MPS2 * np.maximum(found.gap - STANDSTILL_M, 0.0))
        slowed = entering & np.isfinite(found.gap) & (safe < logged)
        self._delay(slowed, t)
        self._speed = np.where(slowed, safe, self._speed)

    def _delay(self, who: BoolArray, since: FloatArray | float) -> None:
        """From `since` on they are not as in the log."""
        self._late |= who
        self._since = np.where(who, np.minimum(self._since, since), self._since)

    def _boxes(self, ego: EgoState) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Boxes `(n + 1, 5)`, velocities and accelerations `(n + 1, 3)`, who is as logged; the ego is the last."""
        played = self._replay.at(self._phase)
        log = self._replay.log
        x, y = box_center(ego, self._vehicle)
        c, s = cos(ego.yaw), sin(ego.yaw)
        boxes = np.column_stack([*played.pose[:3], log.length, log.width])
        own = np.array([[x, y, ego.yaw, self._vehicle.length, self._vehicle.width]])
        heading = np.vstack([np.cos(played.pose[2]), np.sin(played.pose[2])])
        velocity = np.where(self._reacts, self._speed * heading, played.pose[3:] * self._there)
        motion = np.column_stack([*velocity, self._accel])
        return (
            np.vstack([boxes, own]),
            np.vstack([motion, [[ego.v * c, ego.v * s, ego.a]]]),
            np.r_[~self._late, self._as_logged(ego)],
        )

    def _as_logged(self, ego: EgoState) -> bool:
        """Whether the ego is where the log has it."""
        log, was = self._log_ego, self._log_ego.at(ego.t)
        lasts = log.t[0] - 1e-6 <= ego.t <= log.t[-1] + 1e-6
        return bool(lasts) and hypot(was.x - ego.x, was.y - ego.y) <= EGO_M

    def _in_place(self, ego: EgoState, coming: BoolArray) -> BoolArray:
        """Whose place is taken by somebody who is not as in the log."""
        boxes, _, as_logged = self._boxes(ego)
        present = np.r_[self._there | self._replay.log.static, True]
        return taken(boxes, coming, present & ~as_logged)

    def _leaders(self, ego: EgoState, whose: BoolArray, t: float) -> Leaders:
        boxes, motion, as_logged = self._boxes(ego)
        scene = Scene(boxes, motion, np.r_[self._there | self._replay.log.static, True], as_logged)
        heeds, longest = np.ones(len(whose), np.bool_), self._rule.only_ahead
        if longest is not None:
            ahead = ego_ahead(self._paths, self._phase, self._speed, whose, scene)
            since = np.where(ahead, np.minimum(self._ahead_since, t), inf)
            self._ahead_since = np.where(whose, since, self._ahead_since)
            heeds = self._ahead_since <= t - longest + 1e-9
        return leaders(self._paths, self._phase, self._speed, whose, heeds, scene)


def led_on(log: Tracks, lanes: LaneMap) -> Tracks:
    """The tracks, and after the end of each vehicle's log where its lane most probably leads it, `BEYOND_M` far."""
    last = log.offsets[1:] - 1
    if not len(log) or not len(lanes):
        return log
    vx, vy = log.velocity(np.arange(len(log)), last)
    ends = Agents(log.ids, log.kinds, log.length, log.width, log.x[last], log.y[last], log.yaw[last], vx, vy)
    ahead = np.arange(0.0, 30.0, 0.5)
    way = followers(ends, ahead, lanes)
    rows = [np.vstack([getattr(log, c)[log.samples(i)] for c in _COLUMNS]) for i in range(len(log))]
    for i in np.unique(way.agent):
        mine = np.flatnonzero(way.agent == i)
        best = mine[np.argmax(way.probability[mine])]
        x, y = way.x[best], way.y[best]
        gone = np.r_[0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y)))]
        keep = (gone <= BEYOND_M) & (np.diff(gone, prepend=-1.0) > 0.05) & (ahead > 0.0)
        v = np.gradient(gone, ahead)
        yaw = way.yaw[best]
        more = np.vstack([log.t[last[i]] + ahead, x, y, yaw, v * np.cos(yaw), v * np.sin(yaw)])
        if not log.static[i]:
            rows[i] = np.hstack([rows[i], more[:, keep]])
    sizes = [row.shape[1] for row in rows]
    offsets = np.r_[0, np.cumsum(sizes)]
    return Tracks(log.ids, log.kinds, log.length, log.width, log.static, offsets, *np.hstack(rows))


_COLUMNS = ("t", "x", "y", "yaw", "vx", "vy")
