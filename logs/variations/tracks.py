"""Tracks of a scenario in time, speed and place ((1) to (3) of the package), removed, copied and inserted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import atan2, cos, hypot, pi, sin

import numpy as np

from logs.agents import USUAL_SIZE_M, AgentKind
from logs.errors import ConfigError, LogError
from logs.kernel import BoolArray, FloatArray
from logs.observed import MAX_AGE_S
from logs.scenario import Scenario, Tracks
from logs.variations.ego import on_path

STANDING_MPS = 0.2
"""Slower is standing for sure: above what the noise of tracks leaves in smoothed speeds."""
GOING_MPS = 0.5
"""Faster is going for sure. Between them: faster than half of one's greatest speed, as smoothing spreads a start."""
COURSE_S = 1.0
"""The course at a time is that of the way from so long before to so long after it."""
COURSE_M = 0.3
"""A shorter way has no course: the heading of the box is taken."""
BEFORE_S = 2.0
"""So much of a varied log's tracks is kept before its begin and after its end: more than `logs.observed.MAX_GAP_S`."""
RATE_S = 0.1
WALKER, STANDER = "inserted pedestrian", "inserted car"
WALK_MPS = 1.4
"""Of an adult at a crossing (Fitzpatrick et al., TCRP Report 112, 2006: mean 1.45 m/s)."""
KERB_M = 6.0
"""How far beside the ego's path the inserted pedestrian begins and ends to walk: a lane and a half."""
LEAST_MPS = 3.0
"""An ego that stands at the start is taken to arrive at this speed."""
AROUND_S = 60.0
"""The walker stands at the kerbs so long before and after the log: more than time and speed can take away."""
COPY = "copy of "
_COLUMNS = ("t", "x", "y", "yaw", "vx", "vy")


def places(tracks: Tracks, agents: Sequence[str]) -> list[int]:
    """Places of agents among the tracks; ConfigError where one is not there, or none is named."""
    missing = [agent for agent in agents if agent not in tracks.ids]
    if missing or not agents:
        what = f"no agent is called '{missing[0]}'" if missing else "no agent is named"
        raise ConfigError(f"{what}; `replan vary LOG --list-agents` lists them")
    return [tracks.ids.index(agent) for agent in agents]


def _theirs(tracks: Tracks, agents: Sequence[str]) -> BoolArray:
    """Which samples `(m,)` are theirs."""
    mine = np.zeros(len(tracks.t), np.bool_)
    for i in places(tracks, agents):
        mine[tracks.samples(i)] = True
    return mine


def _with_samples(tracks: Tracks, samples: Mapping[int, FloatArray]) -> Tracks:
    """The tracks with other samples `(k, 6)` of some, columns t, x, y, yaw, vx, vy."""
    rows = np.column_stack([getattr(tracks, name) for name in _COLUMNS])
    parts = [samples.get(i, rows[tracks.samples(i)]) for i in range(len(tracks))]
    columns = dict(zip(_COLUMNS, np.vstack([np.empty((0, len(_COLUMNS))), *parts]).T, strict=True))
    return replace(tracks, offsets=np.cumsum([0, *map(len, parts)]), **columns)


def with_agent(
    scenario: Scenario, name: str, kind: AgentKind, size: tuple[float, float], samples: FloatArray, *, static: bool
) -> Scenario:
    """The scenario with one more road user; LogError where there is one of that id."""
    tracks = scenario.tracks
    if name in tracks.ids:
        raise LogError(f"there is a {name} already")
    columns = {column: np.r_[getattr(tracks, column), samples[:, i]] for i, column in enumerate(_COLUMNS)}
    more = replace(
        tracks, ids=(*tracks.ids, name), kinds=(*tracks.kinds, kind), length=np.r_[tracks.length, size[0]],
        width=np.r_[tracks.width, size[1]], static=np.r_[tracks.static, static],
        offsets=np.r_[tracks.offsets, len(tracks.t) + len(samples)], **columns,
    )  # fmt: skip
    return replace(scenario, tracks=more)


def _samples(tracks: Tracks, i: int) -> FloatArray:
    """Samples `(k, 6)` of one."""
    return np.column_stack([getattr(tracks, name)[tracks.samples(i)] for name in _COLUMNS])


def in_time(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """(1) of the package."""
    tracks = scenario.tracks
    return replace(scenario, tracks=replace(tracks, t=tracks.t + value * _theirs(tracks, agents)))  # (1)


def in_speed(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """(2) of the package."""
    tracks, mine = scenario.tracks, _theirs(scenario.tracks, agents)
    speed = np.hypot(tracks.motion.vx, tracks.motion.vy)
    times, which = np.unique(tracks.t[mine], return_inverse=True)
    mean = np.bincount(which, weights=speed[mine]) / np.bincount(which)
    slow = min(max(0.5 * float(mean.max()), STANDING_MPS), GOING_MPS)
    moves = 0.5 * (mean[1:] + mean[:-1]) >= slow
    clock = times[0] + np.r_[0.0, np.cumsum(np.where(moves, np.diff(times) / value, np.diff(times)))]  # (2)
    changed = {}
    for i in places(tracks, agents):
        rows, gaps = _samples(tracks, i), tracks.gap_after[tracks.samples(i)]
        own = np.interp(rows[:, 0], times, clock)
        rows[:, 4:] *= np.where(speed[tracks.samples(i)] >= slow, value, 1.0)[:, None]
        changed[i] = _filled(np.column_stack([own, rows[:, 1:]]), np.diff(rows[:, 0]), gaps[:-1])
    return replace(scenario, tracks=_with_samples(tracks, changed))


def _filled(rows: FloatArray, spacing: FloatArray, gap: BoolArray) -> FloatArray:
    """Rows `(k, 6)` with more between two that are further apart than `spacing` `(k - 1,)`, s, but not in gaps."""
    if len(rows) < 2:
        return rows
    parts = np.where(gap, 1, np.ceil(np.diff(rows[:, 0]) / spacing - 1e-9)).astype(np.int64)
    at = np.concatenate([k + np.arange(n) / n for k, n in enumerate(np.maximum(parts, 1))] + [[len(rows) - 1.0]])
    return np.column_stack([np.interp(at, np.arange(len(rows)), column) for column in rows.T])


def sideways(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """(3) of the package."""
    tracks, mine = scenario.tracks, _theirs(scenario.tracks, agents)
    _, course = min(_nearest(scenario, i) for i in places(tracks, agents))
    x, y = tracks.x - value * sin(course) * mine, tracks.y + value * cos(course) * mine  # (3)
    return replace(scenario, tracks=replace(tracks, x=x, y=y))


def _nearest(scenario: Scenario, i: int) -> tuple[float, float]:
    """How near an agent comes to the ego, m, and in which direction they go there, rad: the box's where they stand."""
    rows, ego = _samples(scenario.tracks, i), scenario.ego
    away = np.hypot(rows[:, 1] - np.interp(rows[:, 0], ego.t, ego.x), rows[:, 2] - np.interp(rows[:, 0], ego.t, ego.y))
    at = int(np.argmin(away))
    near = np.flatnonzero(np.abs(rows[:, 0] - rows[at, 0]) <= COURSE_S)
    dx, dy = (rows[near[-1], 1:3] - rows[near[0], 1:3]).tolist()
    return float(away[at]), atan2(dy, dx) if hypot(dx, dy) >= COURSE_M else float(rows[at, 3])


def removed(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """Without the agents, whatever the value."""
    return replace(scenario, tracks=scenario.tracks.taken(~_theirs(scenario.tracks, agents)))


def copied(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """With a second one of each agent, `value` s later."""
    tracks = scenario.tracks
    for i in places(tracks, agents):
        rows = _samples(tracks, i)
        rows[:, 0] += value
        size = float(tracks.length[i]), float(tracks.width[i])
        name, static = f"{COPY}{tracks.ids[i]}", bool(tracks.static[i])
        scenario = with_agent(scenario, name, tracks.kinds[i], size, rows, static=static)
    return scenario


def pedestrian(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """With an adult who crosses `value` m ahead."""
    x, y, yaw = on_path(scenario, value)
    start, car = scenario.ego.state(0), scenario.vehicle
    meet = start.t + max(value - car.axle_to_front, 0.0) / max(start.v, LEAST_MPS)
    t = np.arange(-AROUND_S, scenario.duration + AROUND_S, RATE_S)
    l = np.clip(WALK_MPS * (t - meet), -KERB_M, KERB_M)  # noqa: E741
    v = np.where(np.abs(l) < KERB_M, WALK_MPS, 0.0)
    rows = [t, x - l * sin(yaw), y + l * cos(yaw), np.full(len(t), yaw + 0.5 * pi), -v * sin(yaw), v * cos(yaw)]
    kind = AgentKind.PEDESTRIAN
    return with_agent(scenario, WALKER, kind, USUAL_SIZE_M[kind], np.column_stack(rows), static=False)


def standing_car(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """With a car that stands `value` m ahead."""
    kind = AgentKind.CAR
    size = USUAL_SIZE_M[kind]
    x, y, yaw = on_path(scenario, value + 0.5 * size[0])
    return with_agent(scenario, STANDER, kind, size, np.array([[0.0, x, y, yaw, 0.0, 0.0]]), static=True)


def continued(was: Scenario, now: Scenario) -> Tracks:
    """The tracks of `now`; those shifted in time since `was` are extended where the begin or end of the log cut them.

    `was` holds the inserted road users, too; a copy is compared with its original. Samples far outside of the log are
    cut.
    """
    tracks, end, changed = now.tracks, now.duration, {}
    known = {name: i for i, name in enumerate(was.tracks.ids)}
    for i in np.flatnonzero(~tracks.static).tolist():
        name = tracks.ids[i]
        recorded = was.tracks.t[was.tracks.samples(known[name if name in known else name.removeprefix(COPY)])]
        rows, mine = _samples(tracks, i), tracks.samples(i)
        if np.array_equal(recorded, rows[:, 0]):
            continue
        vx, vy = tracks.motion.vx[mine], tracks.motion.vy[mine]
        if recorded[0] <= MAX_AGE_S and rows[0, 0] > 0.0:
            before = np.arange(-BEFORE_S, rows[0, 0] - 1e-9, RATE_S)
            rows = np.vstack([_straight(rows[0], vx[0], vy[0], before), rows])
        if recorded[-1] >= end - MAX_AGE_S and rows[-1, 0] < end:
            after = rows[-1, 0] + RATE_S * np.arange(1, int((end - rows[-1, 0]) / RATE_S) + 3)
            rows = np.vstack([rows, _straight(rows[-1], vx[-1], vy[-1], after)])
        changed[i] = rows
    carried = _with_samples(tracks, changed)
    static = np.repeat(carried.static, np.diff(carried.offsets))
    return carried.taken(static | (carried.t >= -BEFORE_S) & (carried.t <= end + BEFORE_S))


def _straight(row: FloatArray, vx: float, vy: float, t: FloatArray) -> FloatArray:
    """Samples at `t` `(k,)` of an agent that goes straight through a sample (6,) at a constant velocity, or stands."""
    vx, vy = (vx, vy) if hypot(vx, vy) >= STANDING_MPS else (0.0, 0.0)
    one, late = np.ones(len(t)), t - row[0]
    return np.column_stack([t, row[1] + vx * late, row[2] + vy * late, row[3] * one, vx * one, vy * one])
