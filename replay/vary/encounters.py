"""The agents of a log by how near they come to the ego, so that a user finds which to vary."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from logs.errors import ConfigError
from logs.names import ShortNames
from logs.scenario import Scenario
from logs.shapes import clearance
from logs.states import Trajectory
from metrics.boxes import ego_boxes
from metrics.others import others_at
from metrics.phantoms import phantoms, without_phantoms
from replay.loop.planning import goal_of
from replay.loop.reference_drives import reference_drives

GRID_S = 0.1
SEEN_S = 1.0
"""An agent that is tracked for a shorter time is not proposed: most often it is a flicker."""
GOING_M = 1.0
"""An agent that goes a shorter way stands: another time or speed changes nothing."""
SHOWN = 40


@dataclass(frozen=True, slots=True)
class Encounter:
    """One road user and the ego.

    Attributes:
        agent: Their id.
        kind: What they are.
        t_from: When they are first tracked, s; `t_to` last; of what is there at all times, the log's.
        way: From the first place to the last, m.
        least: Least distance between both boxes, m; negative where they overlap.
        at: When, s.
    """

    agent: str
    kind: str
    t_from: float
    t_to: float
    way: float
    least: float
    at: float


def prepared(scenario: Scenario) -> Scenario:
    """The scenario as it is varied: without phantoms, and with a goal where its drive ended if it names none.

    Both are known by the recorded drive, which a varied log holds no longer.
    """
    found = phantoms(scenario)
    goal, note = goal_of(scenario)
    names = ", ".join(dict.fromkeys(phantom.name for phantom in found))
    notes = [f"Left out where the recorded ego stood in them: {names}."] if found else []
    notes += [f"{note[:1].upper()}{note[1:]}."] if note else []
    tracks = without_phantoms(scenario.tracks, found)
    return replace(scenario, tracks=tracks, goal=goal, notes=(*scenario.notes, *notes))


def encounters(scenario: Scenario) -> tuple[Encounter, ...]:
    """All who are there while the ego drives as logged (the careful driver, where the log holds no drive).

    The nearest first.
    """
    ego, tracks = _drive(scenario), scenario.tracks
    t = np.arange(ego.t[0], ego.t[-1] + 1e-9, GRID_S)
    others, boxes, car = others_at(tracks, t), ego_boxes(ego.resampled(t), scenario), scenario.vehicle
    found = []
    for i in np.flatnonzero(others.there.any(axis=1)).tolist():
        there = np.flatnonzero(others.there[i])
        length, width = others.size[i].tolist()
        away = np.hypot(others.pose[0, i, there] - boxes[0, there], others.pose[1, i, there] - boxes[1, there])
        spread = 0.5 * (hypot(car.length, car.width) + hypot(length, width))
        near = there[away <= away.min() + spread]  # whoever is nearest by their boxes is among these
        pairs = zip(boxes[:3, near].T.tolist(), others.pose[:3, i, near].T.tolist(), strict=True)
        gaps = [
            clearance(x1, y1, yaw1, car.length, car.width, x2, y2, yaw2, length, width)
            for (x1, y1, yaw1), (x2, y2, yaw2) in pairs
        ]
        best, own = int(np.argmin(gaps)), tracks.samples(i)
        way = hypot(tracks.x[own][-1] - tracks.x[own][0], tracks.y[own][-1] - tracks.y[own][0])
        begin, end = (float(ego.t[0]), scenario.duration) if tracks.static[i] else tracks.t[own][[0, -1]].tolist()
        found.append(
            Encounter(tracks.ids[i], tracks.kinds[i].value, begin, end, way, float(gaps[best]), float(t[near[best]]))
        )
    return tuple(sorted(found, key=lambda one: (one.least, one.agent)))


def _drive(scenario: Scenario) -> Trajectory:
    return scenario.ego if len(scenario.ego) > 1 else next(reference_drives(scenario)).ego


def nearest_agent(scenario: Scenario) -> str:
    """The agent that comes nearest to the ego, of those that move; where none moves, of all.

    Raises:
        ConfigError: There is no agent.
    """
    seen = [one for one in encounters(scenario) if one.t_to - one.t_from >= SEEN_S]
    going = [one for one in seen if one.way >= GOING_M]
    if not seen:
        raise ConfigError(f"{scenario.name}: there is no agent to vary; vary the ego's start, or insert an agent")
    return (going or seen)[0].agent


def listing(found: tuple[Encounter, ...], short: ShortNames) -> list[str]:
    """A line per road user, the nearest `SHOWN` first."""
    width = max([len(short(one.agent)) for one in found[:SHOWN]], default=5)
    lines = [f"{'agent':{width}}  kind        from     to    way  nearest     at"]
    lines += [
        f"{short(one.agent):{width}}  {one.kind:10} {one.t_from:5.1f}  {one.t_to:5.1f}  {one.way:5.1f}"
        f"  {one.least:7.2f}  {one.at:5.1f}"
        for one in found[:SHOWN]
    ]
    lines[0] += "   [s, s, m, m, s]"
    more = len(found) - SHOWN
    return lines + ([f"and {more} that come less near"] if more > 0 else [])
