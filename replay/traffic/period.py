"""One period of the reacting traffic as one kernel: leaders, which agents become late, and how far
each one drives.

`replan.replay.traffic.reactive` explains the model. The kernels write the arrays of `Phases` in
place. `n` counts the agents that may be in the scene (`Coming`): in a long log, a step computes
these only.

(1) who = road users whose log has begun, and static ones, without those that have left for good:
        not in the scene, not waiting to enter, and past the end of their log

The other road users have no effect: they are neither present nor entering.
"""

from __future__ import annotations

from math import cos, inf, isfinite, isnan, sin, sqrt
from typing import Any, NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import inner_kernel, kernel
from replan.replay.traffic.leaders import (
    ACCEL_MPS2,
    DECEL_MPS2,
    LENGTH,
    STANDING_MPS,
    STANDSTILL_M,
    WIDTH,
    YAW,
    Leaders,
    Paths,
    TrafficScene,
    X,
    Y,
    covered,
    desired_gap,
    drives_into,
    ego_ahead,
    enhanced_idm,
    leaders,
    moved_on,
    taken,
)
from replan.replay.traffic.phase_replay import PERIOD_S, LoggedTracks, play, played

SAME_MPS = 1e-6
"""Tolerance when speeds are compared."""


class ReplayedAgents(NamedTuple):
    """The replayed agents: paths.

    Sizes, whether they react, when their paths and their logs end, `(n,)` each.
    """

    tracks: LoggedTracks
    length: FloatArray
    width: FloatArray
    reacts: BoolArray
    ends: FloatArray
    left: FloatArray

    def some(self, who: IntArray) -> ReplayedAgents:
        """The agents `who` `(k,)`."""
        length, width, reacts = self.length[who], self.width[who], self.reacts[who]
        return ReplayedAgents(
            self.tracks.some(who), length, width, reacts, self.ends[who], self.left[who]
        )


class Phases(NamedTuple):
    """The states of the agents, `(n,)` each.

    Attributes:
        phase: Their log time, s.
        speed: m/s.
        accel: m/s2.
        late: Whether they are off their log.
        present: Whether they are in the scene.
        ahead_since: Since when the ego has been ahead of them, s; inf: it is not.
        since: Since when they have been off their log, s; inf: they are on it.
        braked: Their hardest deceleration while late, m/s2.
    """

    phase: FloatArray
    speed: FloatArray
    accel: FloatArray
    late: BoolArray
    present: BoolArray
    ahead_since: FloatArray
    since: FloatArray
    braked: FloatArray

    def some(self, who: IntArray) -> Phases:
        """The states of the agents `who` `(k,)`."""
        columns: list[Any] = [column[who] for column in self]
        return Phases(*columns)


Ego = tuple[float, float, float, float, float, float, float, float, bool]
"""x, y, yaw of the ego's box, length, width, velocity x, y, acceleration, and whether it is where
the log has it.
"""


class Coming:
    """The road users of (1) and their states; a road user that has left keeps its last state.

    Args:
        every: All agents of the log.

    Attributes:
        who: Their tracks `(k,)`, increasing.
        agents: Their paths and sizes.
        now: Their states; `period` writes them.
    """

    def __init__(self, every: ReplayedAgents) -> None:
        n = len(every.reacts)
        late, present, never = np.zeros(n, np.bool_), np.zeros(n, np.bool_), np.full(n, inf)
        states = Phases(
            np.zeros(n), np.zeros(n), np.zeros(n), late, present, never, never.copy(), np.zeros(n)
        )
        self._every, self._states = every, states  # all on their logs and not in the scene yet
        begins = np.where(every.tracks.static, -np.inf, every.tracks.t[every.tracks.first])
        self._order = np.argsort(begins, kind="stable")
        self._begins, self._count = begins[self._order], 0
        self._take(np.empty(0, np.int64))

    @property
    def all(self) -> Phases:
        """The states of all agents `(n,)`.

        Those outside of `who` have their last or their first state.
        """
        for whole, part in zip(self._states, self.now, strict=True):
            whole[self.who] = part
        return self._states

    def until(self, t: float, end: float) -> None:
        """From time `t` on, take in all agents that may be in the scene by time `end`."""
        count = int(np.searchsorted(self._begins, end + 1e-9, side="right"))
        if count > self._count:
            new, self._count = self._order[self._count : count], count
            self.all.phase[new] = t
            now, tracks = self.now, self.agents.tracks
            waits = now.late & (now.phase <= tracks.t[tracks.first] + 1e-9)
            over = now.late | (self.agents.left < t - 1e-9)
            gone = ~(now.present | tracks.static | waits) & over  # for good
            self._take(np.sort(np.r_[self.who[~gone], new]))

    def _take(self, who: IntArray) -> None:
        self.who, self.now, self.agents = who, self._states.some(who), self._every.some(who)


@inner_kernel
def paths_of(agents: ReplayedAgents) -> Paths:
    """Their paths."""
    columns = agents.tracks.columns
    return Paths(
        agents.tracks.first, agents.tracks.end, agents.tracks.t, columns[0], columns[1], columns[2]
    )


@inner_kernel
def logged_speeds(agents: ReplayedAgents, now: Phases) -> FloatArray:
    """Their speeds in the log over the next period `(n,)`, m/s."""
    return covered(paths_of(agents), now.phase, PERIOD_S) / PERIOD_S


@inner_kernel
def scene_of(agents: ReplayedAgents, now: Phases, ego: Ego) -> TrafficScene:
    """Boxes and motion of all agents and of the ego."""
    n = len(now.phase)
    boxes, motion = np.empty((n + 1, 5)), np.empty((n + 1, 3))
    present, as_logged = np.ones(n + 1, np.bool_), np.ones(n + 1, np.bool_)
    for i in range(n):
        x, y, yaw, vx, vy, _ = played(agents.tracks, i, now.phase[i])
        boxes[i, X], boxes[i, Y], boxes[i, YAW] = x, y, yaw
        boxes[i, LENGTH], boxes[i, WIDTH] = agents.length[i], agents.width[i]
        if agents.reacts[i]:
            vx, vy = now.speed[i] * cos(yaw), now.speed[i] * sin(yaw)
        elif not now.present[i]:
            vx, vy = vx * 0.0, vy * 0.0
        motion[i, 0], motion[i, 1], motion[i, 2] = vx, vy, now.accel[i]
        present[i], as_logged[i] = now.present[i] or agents.tracks.static[i], not now.late[i]
    x, y, yaw, length, width, vx, vy, accel, as_logged[n] = ego
    boxes[n, X], boxes[n, Y], boxes[n, YAW] = x, y, yaw
    boxes[n, LENGTH], boxes[n, WIDTH] = length, width
    motion[n, 0], motion[n, 1], motion[n, 2] = vx, vy, accel
    return TrafficScene(boxes, motion, present, as_logged)


@inner_kernel
def leaders_of(
    agents: ReplayedAgents, now: Phases, ego: Ego, whose: BoolArray, t: float, longest: float
) -> Leaders:
    """The leaders of the agents `whose` `(n,)`; the ego leads an agent once it has been ahead of it
    for `longest` s.

    At t = -inf that time has passed already; with `longest` NaN the ego may lead every agent.
    """
    scene, paths = scene_of(agents, now, ego), paths_of(agents)
    heeds = np.ones(len(whose), np.bool_)
    if not isnan(longest):
        ahead = ego_ahead(paths, now.phase, now.speed, whose, scene)
        for i in range(len(whose)):
            if whose[i]:
                now.ahead_since[i] = min(now.ahead_since[i], t) if ahead[i] else inf
            heeds[i] = now.ahead_since[i] <= t - longest + 1e-9
    return leaders(paths, now.phase, now.speed, whose, heeds, scene)


@kernel
def advance(
    agents: ReplayedAgents,
    now: Phases,
    ego: Ego,
    held: FloatArray,
    room: FloatArray,
    t: float,
    longest: float,
    only_needed: bool,
    gone: float,
    pose: FloatArray,
    here: BoolArray,
) -> None:
    """Move all agents by one period from `t`, then let others in (`enter`).

    `held` `(n,)` are the greatest accelerations that lights allow, m/s2; `room` `(n,)` the
    distances to where agents must wait for the ego, m (inf: they need not). With `only_needed`, an
    agent on its log reacts only where it would drive into its leader.
    """
    n, until = len(now.phase), t + PERIOD_S
    logged = logged_speeds(agents, now)
    ahead = leaders_of(agents, now, ego, now.present & agents.reacts, t, longest)
    needed = (
        drives_into(paths_of(agents), now.phase, ahead) if only_needed else np.ones(n, np.bool_)
    )
    speed, distance = np.zeros(n), np.zeros(n)
    for i in range(n):
        wanted, slower = wanted_speed(
            now.speed[i], ahead, i, held[i], room[i], logged[i], needed[i]
        )
        if slower and now.present[i] and agents.reacts[i]:
            now.late[i], now.since[i] = True, min(now.since[i], t)
        speed[i] = min(max(wanted, 0.0), logged[i]) if now.late[i] else logged[i]
        speed[i] = speed[i] if now.present[i] else 0.0
        distance[i] = speed[i] * PERIOD_S
    phase = moved_on(paths_of(agents), now.phase, distance, until)
    for i in range(n):
        waits = now.late[i] and not now.present[i]
        if not waits:
            now.phase[i] = phase[i] if now.late[i] else until
        behind = now.phase[i] < until - 1e-9 or speed[i] < logged[i] - SAME_MPS
        now.late[i] = now.late[i] and (waits or behind)
        now.accel[i] = (speed[i] - now.speed[i]) / PERIOD_S if now.present[i] else 0.0
        now.braked[i] = max(now.braked[i], -now.accel[i] if now.late[i] else 0.0)
        now.speed[i] = speed[i]
        ends = agents.ends[i] if now.late[i] else agents.left[i]
        now.present[i] = (
            now.present[i]
            and now.phase[i] <= ends + 1e-9
            and (until <= gone + 1e-9 or not now.late[i])
        )
    enter(agents, now, ego, until, gone, longest, pose, here)


@kernel
def enter(
    agents: ReplayedAgents,
    now: Phases,
    ego: Ego,
    t: float,
    gone: float,
    longest: float,
    pose: FloatArray,
    here: BoolArray,
) -> None:
    """Let in the agents whose log begins by `t` and whose place is free, and sample all (`sample`).

    Late agents leave the scene at `gone`, s. `longest` is as in `leaders_of`, `pose` and `here` as
    in `sample`.
    """
    n, first, comes = len(now.phase), agents.tracks.first, False
    coming = np.zeros(n, np.bool_)
    for i in range(n):
        coming[i] = enters(agents, now, i, t)
        comes = comes or (coming[i] and (t <= gone + 1e-9 or not now.late[i]))
    if not comes:
        sample(agents, now, pose, here)
        return
    for i in range(n):
        if coming[i]:
            now.phase[i] = agents.tracks.t[first[i]] if waited(agents, now, i) else t
            coming[i] = t <= gone + 1e-9 or not now.late[i]
    scene = scene_of(agents, now, ego)
    # By an agent that is off its log
    occupied = taken(scene.boxes, coming, scene.present & ~scene.as_logged)
    free = coming & ~(agents.reacts & occupied)
    for i in range(n):
        if free[i]:
            now.present[i] = True
        elif coming[i]:
            begin = agents.tracks.t[first[i]]
            now.late[i], now.since[i], now.phase[i] = True, min(now.since[i], begin), begin
    logged = logged_speeds(agents, now)
    for i in range(n):
        now.speed[i] = logged[i] if free[i] else now.speed[i]
    ahead = leaders_of(agents, now, ego, free & agents.reacts, -inf, longest)
    for i in range(n):
        if free[i] and isfinite(ahead.gap[i]):
            safe = sqrt(
                ahead.speed[i] ** 2 + 2.0 * DECEL_MPS2 * max(ahead.gap[i] - STANDSTILL_M, 0.0)
            )
            if safe < logged[i]:
                now.late[i], now.since[i], now.speed[i] = True, min(now.since[i], t), safe
    sample(agents, now, pose, here)


@inner_kernel
def waited(agents: ReplayedAgents, now: Phases, i: int) -> bool:
    """Whether agent i waits outside of the scene because its place was taken."""
    return (
        now.late[i]
        and not now.present[i]
        and now.phase[i] <= agents.tracks.t[agents.tracks.first[i]] + 1e-9
    )


@inner_kernel
def enters(agents: ReplayedAgents, now: Phases, i: int, t: float) -> bool:
    """Whether agent i is outside of the scene and its log has begun by `t`."""
    if now.late[i] or now.present[i] or agents.tracks.static[i]:
        return waited(agents, now, i)
    return agents.tracks.t[agents.tracks.first[i]] <= t + 1e-9 and agents.left[i] >= t - 1e-9


@inner_kernel
def wanted_speed(
    v: float, leaders: Leaders, i: int, held: float, room: float, logged: float, needed: bool
) -> tuple[float, bool]:
    """The speed of agent i after a period by leader, lights and right of way, and whether this
    takes it off its log.
    """
    gap, pull, slower = leaders.gap[i], ACCEL_MPS2, False
    if isfinite(gap):
        pull = enhanced_idm(v, gap, leaders.speed[i], leaders.accel[i])
    wanted = v + PERIOD_S * min(pull, held)
    if isfinite(gap):
        slower = needed and wanted < logged - SAME_MPS and gap < desired_gap(v, leaders.speed[i])
    if isfinite(room):
        wanted = min(wanted, v + PERIOD_S * enhanced_idm(v, room, 0.0, 0.0))
        slower = slower or wanted < logged - SAME_MPS
    else:
        wanted = min(wanted, v + PERIOD_S * ACCEL_MPS2)
    return wanted, slower


@inner_kernel
def sample(agents: ReplayedAgents, now: Phases, pose: FloatArray, here: BoolArray) -> None:
    """Write poses and presence (`phase_replay.play`): the log at the phases, played at a rate of 1
    at most.
    """
    logged = logged_speeds(agents, now)
    rates = np.ones(len(logged))
    for i in range(len(logged)):
        if now.late[i] and logged[i] > STANDING_MPS:
            rates[i] = min(now.speed[i] / logged[i], 1.0)
    play(agents.tracks, now.phase, rates, now.present, pose, here)
