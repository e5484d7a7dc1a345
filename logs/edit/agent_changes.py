"""Changes of the road users in a log: time, speed, place and presence; and how varied tracks
continue beyond the recording.

(1) time     t' = t + dt
(2) speed    dt' = dt / k while the agents walk or drive, dt' = dt while they stand; v' = k v.
        All varied agents share this clock, which begins with the first sample of any of them, so
        that the pieces of a road user who was tracked in pieces still fit. Positions stay on the
        recorded path; samples are added if they would be rarer than in the recording.
(3) side     p' = p + d n
        n: left of the course at the point nearest to the ego, one for all varied agents

Agents who were present at the begin (end) of the recording are extended straight at their first
(last) velocity if the varied track would not cover that time. Agents who appeared or left during
the recording still do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import atan2, cos, hypot, pi, sin

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.errors import ConfigError, LogError
from replan.logs.agents import USUAL_SIZE_M, AgentKind
from replan.logs.observed import MAX_AGE_S
from replan.logs.polylines import thinned
from replan.logs.reference_line import ReferenceLine
from replan.logs.scenario import Scenario
from replan.logs.tracks import SAMPLE_COLUMNS, Tracks

STANDING_MPS = 0.2
"""Slower agents stand: above the noise that remains in smoothed speeds, m/s."""
GOING_MPS = 0.5
"""Faster agents move, m/s.

Between both, those faster than half of their top speed, as smoothing spreads a start.
"""
COURSE_S = 1.0
"""The course at a time is the direction from the place this long before it to the place this long
after it, s.
"""
COURSE_M = 0.3
"""A shorter way has no course, m: the heading of the box is used."""
BEFORE_S = 2.0
"""Varied tracks are kept this long before the log's begin and after its end, s (more than
`MAX_GAP_S`).
"""
RATE_S = 0.1
WALKER, STANDER = "inserted pedestrian", "inserted car"
WALK_MPS = 1.4
"""Speed of an adult at a crossing (Fitzpatrick et al., TCRP Report 112, 2006: mean 1.45 m/s)."""
KERB_M = 6.0
"""Distance from the ego's path at which the inserted pedestrian starts and stops, m: a lane and a
half.
"""
LEAST_MPS = 3.0
"""Least speed of the ego for the time at which it meets the pedestrian, m/s."""
AROUND_S = 60.0
"""The pedestrian's track extends this long beyond the log, s: more than time and speed can
remove.
"""
COPY = "copy of "


def driven_line(scenario: Scenario) -> ReferenceLine:
    """Return the ego's driven path from its first state on.

    Straight ahead if the ego drove less than 2 m.
    """
    ego, start = scenario.ego, scenario.ego.state(0)
    path = thinned(np.column_stack([ego.x, ego.y]), 1.0)
    if len(path) < 3:
        path = np.array([start.ahead(s) for s in (0.0, 1.0, 2.0)])
    return ReferenceLine.through(path)


def on_path(scenario: Scenario, s: float) -> tuple[float, float, float]:
    """Return the point and heading `s` m along the ego's driven path."""
    x, y, yaw, _ = driven_line(scenario).frame(s)
    return x, y, yaw


def places(tracks: Tracks, agents: Sequence[str]) -> list[int]:
    """Return the indices of agents among the tracks; ConfigError if an agent is unknown, or no
    agent is named.
    """
    missing = [agent for agent in agents if agent not in tracks.ids]
    if missing or not agents:
        reason = f"no agent is called '{missing[0]}'" if missing else "no agent is named"
        raise ConfigError(f"{reason}; `replan vary LOG --list-agents` lists them")
    return [tracks.ids.index(agent) for agent in agents]


def _samples_of(tracks: Tracks, agents: Sequence[str]) -> BoolArray:
    is_chosen = np.zeros(len(tracks.t), np.bool_)
    for i in places(tracks, agents):
        is_chosen[tracks.samples(i)] = True
    return is_chosen


def _with_samples(tracks: Tracks, samples: Mapping[int, FloatArray]) -> Tracks:
    """Replace the samples of some tracks by `(k, 6)`: columns t, x, y, yaw, vx, vy."""
    rows = np.column_stack([getattr(tracks, name) for name in SAMPLE_COLUMNS])
    parts = [samples.get(i, rows[tracks.samples(i)]) for i in range(len(tracks))]
    columns = dict(
        zip(SAMPLE_COLUMNS, np.vstack([np.empty((0, len(SAMPLE_COLUMNS))), *parts]).T, strict=True)
    )
    return replace(tracks, offsets=np.cumsum([0, *map(len, parts)]), **columns)


def with_agent(
    scenario: Scenario,
    name: str,
    kind: AgentKind,
    size: tuple[float, float],
    samples: FloatArray,
    *,
    static: bool,
) -> Scenario:
    """Add a road user to the scenario; LogError if the id is in use."""
    tracks = scenario.tracks
    if name in tracks.ids:
        raise LogError(f"there is a {name} already")
    length, width = np.array(size)[:, None]
    agent = Tracks(
        (name,), (kind,), length, width, np.array([static]), np.array([0, len(samples)]), *samples.T
    )
    return replace(scenario, tracks=tracks.with_more(agent))


def _samples(tracks: Tracks, i: int) -> FloatArray:
    return np.column_stack([getattr(tracks, name)[tracks.samples(i)] for name in SAMPLE_COLUMNS])


def in_time(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """The scenario with the agents shifted in time (1)."""
    tracks = scenario.tracks
    # (1)
    return replace(
        scenario, tracks=replace(tracks, t=tracks.t + value * _samples_of(tracks, agents))
    )


def in_speed(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """The scenario with the agents faster or slower (2)."""
    tracks, is_chosen = scenario.tracks, _samples_of(scenario.tracks, agents)
    speed = np.hypot(tracks.motion.vx, tracks.motion.vy)
    times, moment = np.unique(tracks.t[is_chosen], return_inverse=True)
    mean = np.bincount(moment, weights=speed[is_chosen]) / np.bincount(moment)
    slow = min(max(0.5 * float(mean.max()), STANDING_MPS), GOING_MPS)
    moves = 0.5 * (mean[1:] + mean[:-1]) >= slow
    # (2)
    clock = (
        times[0] + np.r_[0.0, np.cumsum(np.where(moves, np.diff(times) / value, np.diff(times)))]
    )
    changed = {}
    for i in places(tracks, agents):
        rows, gaps = _samples(tracks, i), tracks.gap_after[tracks.samples(i)]
        new_times = np.interp(rows[:, 0], times, clock)
        rows[:, 4:] *= np.where(speed[tracks.samples(i)] >= slow, value, 1.0)[:, None]
        spacing, rows = np.diff(rows[:, 0]), np.column_stack([new_times, rows[:, 1:]])
        # More samples between two that are further apart than before, but not in gaps
        if len(rows) > 1:
            parts = np.where(gaps[:-1], 1, np.ceil(np.diff(new_times) / spacing - 1e-9)).astype(
                np.int64
            )
            fine = [k + np.arange(n) / n for k, n in enumerate(np.maximum(parts, 1))]
            positions = np.concatenate([*fine, [len(rows) - 1.0]])
            rows = np.column_stack(
                [np.interp(positions, np.arange(len(rows)), column) for column in rows.T]
            )
        changed[i] = rows
    return replace(scenario, tracks=_with_samples(tracks, changed))


def sideways(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """The scenario with the agents shifted to the side (3)."""
    tracks, ego, is_chosen = scenario.tracks, scenario.ego, _samples_of(scenario.tracks, agents)
    # Per agent: least distance from the ego, m, and course there (heading if it stands), rad
    nearest = []
    for i in places(tracks, agents):
        rows = _samples(tracks, i)
        to_x = rows[:, 1] - np.interp(rows[:, 0], ego.t, ego.x)
        to_y = rows[:, 2] - np.interp(rows[:, 0], ego.t, ego.y)
        distances = np.hypot(to_x, to_y)
        closest = int(np.argmin(distances))
        near = np.flatnonzero(np.abs(rows[:, 0] - rows[closest, 0]) <= COURSE_S)
        _, dx, dy, *_ = (rows[near[-1]] - rows[near[0]]).tolist()
        heading = tracks.yaw[tracks.samples(i)][closest]
        course = atan2(dy, dx) if hypot(dx, dy) >= COURSE_M else float(heading)
        nearest.append((float(distances[closest]), course))
    _, course = min(nearest)
    x = tracks.x - value * sin(course) * is_chosen  # (3)
    y = tracks.y + value * cos(course) * is_chosen
    return replace(scenario, tracks=replace(tracks, x=x, y=y))


def removed(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """Return the scenario without the agents; the value is ignored."""
    return replace(scenario, tracks=scenario.tracks.taken(~_samples_of(scenario.tracks, agents)))


def copied(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """Return the scenario with a copy of each agent, `value` s later."""
    tracks = scenario.tracks
    for i in places(tracks, agents):
        rows = _samples(tracks, i)
        rows[:, 0] += value
        size = float(tracks.length[i]), float(tracks.width[i])
        name, static = f"{COPY}{tracks.ids[i]}", bool(tracks.static[i])
        scenario = with_agent(scenario, name, tracks.kinds[i], size, rows, static=static)
    return scenario


def pedestrian(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """Return the scenario with an adult who crosses the ego's path `value` m ahead."""
    x, y, yaw = on_path(scenario, value)
    start, car = scenario.ego.state(0), scenario.vehicle
    meet = start.t + max(value - car.axle_to_front, 0.0) / max(start.v, LEAST_MPS)
    t = np.arange(-AROUND_S, scenario.duration + AROUND_S, RATE_S)
    l = np.clip(WALK_MPS * (t - meet), -KERB_M, KERB_M)
    v = np.where(np.abs(l) < KERB_M, WALK_MPS, 0.0)
    rows = [
        t,
        x - l * sin(yaw),
        y + l * cos(yaw),
        np.full(len(t), yaw + 0.5 * pi),
        -v * sin(yaw),
        v * cos(yaw),
    ]
    kind = AgentKind.PEDESTRIAN
    return with_agent(
        scenario, WALKER, kind, USUAL_SIZE_M[kind], np.column_stack(rows), static=False
    )


def standing_car(scenario: Scenario, agents: Sequence[str], value: float) -> Scenario:
    """Return the scenario with a car that stands `value` m ahead."""
    kind = AgentKind.CAR
    size = USUAL_SIZE_M[kind]
    x, y, yaw = on_path(scenario, value + 0.5 * size[0])
    return with_agent(
        scenario, STANDER, kind, size, np.array([[0.0, x, y, yaw, 0.0, 0.0]]), static=True
    )


def continued(original: Scenario, changed_scenario: Scenario) -> Tracks:
    """Return the tracks of a changed scenario; tracks that are shifted in time are extended if the
    log's begin or end cut them in the original.

    `original` holds the inserted road users, too; a copy is compared with its original. Samples far
    outside the log are removed.
    """
    tracks, end, changed = changed_scenario.tracks, changed_scenario.duration, {}
    indices = {name: i for i, name in enumerate(original.tracks.ids)}
    for i in np.flatnonzero(~tracks.static).tolist():
        name = tracks.ids[i]
        before = indices[name if name in indices else name.removeprefix(COPY)]
        recorded = original.tracks.t[original.tracks.samples(before)]
        rows, samples = _samples(tracks, i), tracks.samples(i)
        if np.array_equal(recorded, rows[:, 0]):
            continue
        vx, vy = tracks.motion.vx[samples], tracks.motion.vy[samples]
        if recorded[0] <= MAX_AGE_S and rows[0, 0] > 0.0:
            times = np.arange(-BEFORE_S, rows[0, 0] - 1e-9, RATE_S)
            rows = np.vstack([_straight(rows[0], vx[0], vy[0], times), rows])
        if recorded[-1] >= end - MAX_AGE_S and rows[-1, 0] < end:
            times = rows[-1, 0] + RATE_S * np.arange(1, int((end - rows[-1, 0]) / RATE_S) + 3)
            rows = np.vstack([rows, _straight(rows[-1], vx[-1], vy[-1], times)])
        changed[i] = rows
    carried = _with_samples(tracks, changed)
    static = carried.static[carried.owner]
    return carried.taken(static | (carried.t >= -BEFORE_S) & (carried.t <= end + BEFORE_S))


def _straight(row: FloatArray, vx: float, vy: float, t: FloatArray) -> FloatArray:
    """Return samples at `t` `(k,)` of an agent that passes a sample (6,) at constant velocity, or
    stands.
    """
    vx, vy = (vx, vy) if hypot(vx, vy) >= STANDING_MPS else (0.0, 0.0)
    begin, x, y, yaw, _, _ = row
    fixed = (np.full(len(t), number) for number in (yaw, vx, vy))
    return np.column_stack([t, x + vx * (t - begin), y + vy * (t - begin), *fixed])
