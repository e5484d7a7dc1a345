"""The other road users react along their logged paths, each at its own log time, by one of two
rules (`ReactionRule`).

Agent i has a log time (phase) tau_i of its own. Its place is the log's at tau_i, so that it never
leaves its path. Where its log ends, a late agent follows the most probable lane for `BEYOND_M`; an
agent on time leaves the scene as in the log. Where the recording of the traffic ends
(`Scenario.traffic_spans`), late agents leave the scene too: else one that gave way would drive on
alone after all others have vanished. An agent is never faster than the log at its place, and never
ahead of its log.

Undisturbed, tau_i = t: the log's own samples, to the bit. An agent is disturbed once its leader
requires a lower speed than the log's. Pairs of agents that are both on their logs are ignored,
because real drivers keep other gaps than a model does; the ego is on its log while it is within
`EGO_M` of it. A late agent makes up time while its log stands. `replan.replay.traffic.leaders`
defines leader and acceleration. Late agents also stop at closed lights (`right_of_way`); agents on
their logs pass them as they did, red ones included. An agent that enters the scene waits while an
agent that is off its log is in its place, and enters no faster than it can brake for its leader.

"reactive": vehicles drive behind every road user on their path, the ego included, wherever it comes
from.

"give_way": vehicles and riders drive as in the log unless they would then hit the ego, or an agent
that is late because of the ego, and only where the ego may expect them to react:

(1) the ego has been ahead (`leaders` (5)) for `CC_REACT_S` without a break, the reaction time of
    the careful driver of UN R157; for an agent that starts or enters behind the ego, this time has
    passed already
(2) the agent would drive into it if it went on as in the log (`leaders` (6))
(3) or the agent comes from a lane that yields to the ego's (`right_of_way`)
(4) it brakes as its leader requires, with 0.774 g at most (the same driver)

So an ego that cuts in more closely than a careful driver would, crosses without the right of way,
or blocks oncoming traffic is hit as in the log. Pedestrians and objects are replayed by time; with
"reactive", bicycles too.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, inf, nan, sin

import numpy as np

from replan.core.arrays import arc_lengths
from replan.core.once import once
from replan.logs.agents import AgentKind, Agents
from replan.logs.road import Road
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState
from replan.logs.tracks import Tracks
from replan.metrics.boxes import name_of
from replan.metrics.driver_models import CC_REACT_S
from replan.replay.prediction import LaneMap
from replan.replay.prediction.lane_following import FOLLOWING, followers
from replan.replay.traffic.period import Coming, Ego, ReplayedAgents, advance, enter
from replan.replay.traffic.phase_replay import PERIOD_S, PhaseReplay
from replan.replay.traffic.right_of_way import RedLights, Yielding
from replan.replay.world import box_center

EGO_M = 1.0
"""The ego is as in the log where it is no farther than this from where the log has it."""
BEYOND_M = 100.0
"""A late agent drives on this far beyond the end of its log."""
_COLUMNS = ("t", "x", "y", "yaw", "vx", "vy")
NAMED = 5
"""The greatest number of agents that the notes name."""


@dataclass(frozen=True, slots=True)
class ReactionRule:
    """Which agents react to what.

    Attributes:
        kinds: The kinds that react.
        only_ahead: Agents react to the ego only after it has been ahead for this time, s; None:
            always.
        only_needed: An agent on its log reacts only where it would drive into its leader.
        yields: Whether agents on lanes that yield to the ego's wait for it.
    """

    kinds: tuple[AgentKind, ...]
    only_ahead: float | None
    only_needed: bool
    yields: bool


REACTIVE = ReactionRule(FOLLOWING, only_ahead=None, only_needed=False, yields=False)
GIVE_WAY = ReactionRule(
    (*FOLLOWING, AgentKind.BICYCLE), only_ahead=CC_REACT_S, only_needed=True, yields=True
)


class Reactive:
    """Road users that react along their logged paths, as `rule` says; those that are late stop at
    red lights.

    Args:
        scenario: Its tracks, road, lights and ego.
        rule: Which agents react to what.
    """

    def __init__(self, scenario: Scenario, rule: ReactionRule = REACTIVE) -> None:
        log, self._log_ego, self._vehicle = scenario.tracks, scenario.ego, scenario.vehicle
        self._rule = rule
        n = len(log)
        left = log.t[log.offsets[1:] - 1].copy() if n else np.empty(0)
        self._replay = PhaseReplay(log, extended(log, scenario.road))
        paths = self._replay.log
        reacts = np.array([kind in rule.kinds for kind in log.kinds], bool) & ~log.static
        ends = paths.t[paths.offsets[1:] - 1].copy() if n else left
        self._coming = Coming(
            ReplayedAgents(self._replay.logged, paths.length, paths.width, reacts, ends, left)
        )
        self._longest = nan if rule.only_ahead is None else rule.only_ahead
        self._gone = scenario.traffic_spans[-1][1] if scenario.traffic_spans else inf
        self._lights = RedLights(scenario, paths, reacts)
        self._yielding = Yielding(scenario, paths, reacts & rule.yields)
        self._next, self._tracks = -inf, Tracks.empty()

    @property
    def due(self) -> float:
        """The next time at which the agents react to the ego, s."""
        return self._next

    def step(self, ego: EgoState) -> Tracks:
        """The tracks up to `ego.t` and one sample beyond."""
        if ego.t < self._next - 1e-9:
            return self._tracks
        as_logged = False
        if self._log_ego.t[0] - 1e-6 <= ego.t <= self._log_ego.t[-1] + 1e-6:
            then = self._log_ego.at(ego.t)
            as_logged = hypot(then.x - ego.x, then.y - ego.y) <= EGO_M
        size = float(self._vehicle.length), float(self._vehicle.width)
        velocity = ego.v * cos(ego.yaw), ego.v * sin(ego.yaw)
        box: Ego = (*box_center(ego, self._vehicle), ego.yaw, *size, *velocity, ego.a, as_logged)
        if self._next == -inf:
            self._next = ego.t
            self._coming.until(ego.t, ego.t)
            coming, sampled = self._coming, self._replay.row(ego.t, self._coming.who)
            enter(coming.agents, coming.now, box, ego.t, self._gone, self._longest, *sampled)
        while self._next <= ego.t + 1e-9:
            now, self._next = self._next, self._next + PERIOD_S
            self._coming.until(now, self._next)
            sampled = self._replay.row(self._next, self._coming.who)
            tracks, agents, states = self._coming.who, self._coming.agents, self._coming.now
            late = states.late & states.present & agents.reacts
            held = self._lights.accelerations(now, tracks, states.phase, states.speed, late)
            room = self._yielding.gaps(
                ego, tracks, states.phase, states.speed, states.present & (not as_logged)
            )
            needed, gone = self._rule.only_needed, self._gone
            advance(agents, states, box, held, room, now, self._longest, needed, gone, *sampled)
        self._tracks = self._replay.tracks(self._coming.all.since)
        return self._tracks

    @property
    def notes(self) -> tuple[str, ...]:
        """The agents disturbed so far, since when, and how hard they braked."""
        since, braked = self._coming.all.since, self._coming.all.braked
        disturbed = np.argsort(since, kind="stable")[: int(np.isfinite(since).sum())]
        log = self._replay.log
        named = [
            f"{name_of(log, i)} from {since[i]:.1f} s, {braked[i]:.1f} m/s2"
            for i in disturbed[:NAMED]
        ]
        if not named:
            return ()
        more = [f"{len(disturbed) - NAMED} more"] if len(disturbed) > NAMED else []
        return (
            "not as in the log because of the ego (since when, hardest braking): "
            f"{'; '.join(named + more)}",
        )


def extended(log: Tracks, road: Road) -> Tracks:
    """The tracks, and after the end of each vehicle's log where its lane most probably leads it,
    `BEYOND_M` far.
    """
    return _extended(log, road) if len(log) and len(LaneMap.of(road)) else log


@once
def _extended(log: Tracks, road: Road) -> Tracks:
    last = log.offsets[1:] - 1
    vx, vy = log.velocity(np.arange(len(log)), last)
    ends = Agents(
        log.ids, log.kinds, log.length, log.width, log.x[last], log.y[last], log.yaw[last], vx, vy
    )
    ahead = np.arange(0.0, 30.0, 0.5)
    onward = followers(ends, ahead, LaneMap.of(road))
    rows = [np.vstack([getattr(log, c)[log.samples(i)] for c in _COLUMNS]) for i in range(len(log))]
    for i in np.unique(onward.agent):
        ways = np.flatnonzero(onward.agent == i)
        best = ways[np.argmax(onward.probability[ways])]
        x, y = onward.x[best], onward.y[best]
        gone = arc_lengths(x, y)
        keep = (gone <= BEYOND_M) & (np.diff(gone, prepend=-1.0) > 0.05) & (ahead > 0.0)
        v = np.gradient(gone, ahead)
        yaw = onward.yaw[best]
        more = np.vstack([log.t[last[i]] + ahead, x, y, yaw, v * np.cos(yaw), v * np.sin(yaw)])
        if not log.static[i]:
            rows[i] = np.hstack([rows[i], more[:, keep]])
    sizes = [row.shape[1] for row in rows]
    offsets = np.r_[0, np.cumsum(sizes)]
    return Tracks(log.ids, log.kinds, log.length, log.width, log.static, offsets, *np.hstack(rows))
