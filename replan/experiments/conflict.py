"""The agents of a log by their least distance to the ego, and the one in conflict with it, to
choose which to vary.

(1) PET = |t_j - t_i|, the least over the ego's boxes i and an agent's boxes j
        that overlap (`replan.metrics.encounters`), of pedestrians, and of others whose headings
        differ by 30 degrees or more, because an agent that follows does not cross
(2) TTC = least time until the boxes touch at constant velocity vectors (`replan.logs.shapes`),
        within `SOON_S`; of agents ahead of an ego that drives
(3) conflict = min(PET, TTC), s; NaN if an agent neither overlaps the ego's way nor
        is on a course to it
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import cos, hypot, inf, isnan, nan, sin

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError
from replan.core.files import here
from replan.core.names import ShortNames
from replan.experiments.question import SurfaceQuestion, question
from replan.logs.agents import AgentKind
from replan.logs.catalogue import FAMILY, families
from replan.logs.catalogue.family import Family
from replan.logs.readers import LogSettings
from replan.logs.scenario import Scenario
from replan.logs.shapes import clearance, time_to_contact
from replan.metrics.arrival import goal_of
from replan.metrics.boxes import (
    NO_TTC_MPS,
    EgoOutline,
    OtherBoxes,
    car_of,
    ego_boxes,
    others_at,
    phantoms,
    without_phantoms,
)
from replan.metrics.encounters import CROSSING_RAD, encroachment, may_meet
from replan.replay.loop.reference_drives import reference_drives
from replan.run.sources import LogSource

GRID_S = 0.1
SEEN_S = 1.0
"""An agent that is tracked for a shorter time is not proposed: it is usually a false detection."""
GOING_M = 1.0
"""An agent that moves less than this stands: another time or speed has no effect."""
SOON_S = 10.0
"""The horizon of `replan.metrics.time_to_collision.ttc`."""
SHOWN = 40


@dataclass(frozen=True, slots=True)
class Encounter:
    """One road user and the ego.

    Attributes:
        t_from: First time at which they are tracked, s; `t_to` the last; for static objects, those
            of the log.
        way: Distance from the first to the last position, m.
        least: Least distance between both boxes, m; negative if they overlap.
        at: Time of the least distance, s.
        conflict: The value of (3), s; NaN if there is none.
    """

    agent: str
    kind: str
    t_from: float
    t_to: float
    way: float
    least: float
    at: float
    conflict: float = nan


def prepared(scenario: Scenario) -> Scenario:
    """The scenario prepared for variation: without phantoms, and with a goal at the end of its
    drive if it has none.

    Both need the recorded drive, which a varied log no longer contains.
    """
    found = phantoms(scenario)
    goal, note = goal_of(scenario)
    names = ", ".join(dict.fromkeys(phantom.name for phantom in found))
    notes = [f"Left out where the recorded ego stood in them: {names}."] if found else []
    notes += [f"{note[:1].upper()}{note[1:]}."] if note else []
    tracks = without_phantoms(scenario.tracks, found)
    return replace(scenario, tracks=tracks, goal=goal, notes=(*scenario.notes, *notes))


def opened(name: str, settings: LogSettings) -> tuple[Scenario, Family | None]:
    """The scenario of a file, folder, URL or family, prepared for variation; and the family.

    Raises:
        ConfigError: There is no such file, folder or family.
        LogError: The log cannot be read.
    """
    with here(name) as path:
        if path.exists():
            return prepared(LogSource(name, path, settings).read()), None
    if ":" not in name and name not in families():
        raise ConfigError(
            f"{name}: no such file or folder, and no family of the catalogue (replan synth --list)"
        )
    family = FAMILY.find(name)
    return prepared(family.scenario()), family


def encounters(scenario: Scenario) -> tuple[Encounter, ...]:
    """All road users that are present while the ego drives as logged (without a logged drive: the
    careful driver).

    The nearest first.
    """
    tracks = scenario.tracks
    ego = scenario.ego if len(scenario.ego) > 1 else next(reference_drives(scenario)).ego
    t = np.arange(ego.t[0], ego.t[-1] + 1e-9, GRID_S)
    others, boxes, car = (
        others_at(tracks, t),
        ego_boxes(ego.resampled(t), scenario),
        scenario.vehicle,
    )
    found, own_box = [], car_of(scenario)
    for i in np.flatnonzero(others.there.any(axis=1)).tolist():
        there = np.flatnonzero(others.there[i])
        length, width = others.size[i].tolist()
        away = np.hypot(
            others.pose[0, i, there] - boxes[0, there], others.pose[1, i, there] - boxes[1, there]
        )
        spread = 0.5 * (hypot(car.length, car.width) + hypot(length, width))
        near = there[away <= away.min() + spread]  # the nearest one by its box is among these
        pairs = zip(boxes[:3, near].T.tolist(), others.pose[:3, i, near].T.tolist(), strict=True)
        gaps = [
            clearance(x1, y1, yaw1, car.length, car.width, x2, y2, yaw2, length, width)
            for (x1, y1, yaw1), (x2, y2, yaw2) in pairs
        ]
        best, own = int(np.argmin(gaps)), tracks.samples(i)
        way = hypot(tracks.x[own][-1] - tracks.x[own][0], tracks.y[own][-1] - tracks.y[own][0])
        begin, end = (
            (float(ego.t[0]), scenario.duration)
            if tracks.static[i]
            else tracks.t[own][[0, -1]].tolist()
        )
        walks = tracks.kinds[i] is AgentKind.PEDESTRIAN
        conflict = _conflict(boxes, t, own_box, others, i, 0.0 if walks else CROSSING_RAD)
        least, at = float(gaps[best]), float(t[near[best]])
        found.append(
            Encounter(tracks.ids[i], tracks.kinds[i].value, begin, end, way, least, at, conflict)
        )
    return tuple(sorted(found, key=lambda one: (one.least, one.agent)))


def _conflict(
    boxes: FloatArray, t: FloatArray, car: EgoOutline, others: OtherBoxes, i: int, angle: float
) -> float:
    """Conflict (3) of the ego's boxes at times t and agent i, whose heading must differ by `angle`
    to cross.
    """
    pose, (length, width), least = others.pose[:, i], others.size[i].tolist(), inf
    mine, theirs = may_meet(boxes, car, others, i)
    if len(mine) and len(theirs) and np.ptp(pose[0, theirs]) + np.ptp(pose[1, theirs]) > 0.0:
        steps = encroachment(
            boxes, mine, pose, theirs, np.array([car[1:3], others.size[i]]), angle
        )[:2]
        least = min((GRID_S * float(k) for k in steps[steps >= 0]), default=inf)  # (1)
    speed, reach = (
        np.hypot(boxes[3], boxes[4]),
        0.5 * (hypot(car.length, car.width) + hypot(length, width)),
    )
    away = np.hypot(pose[0] - boxes[0], pose[1] - boxes[1]) - reach
    soon = away <= min(least, SOON_S) * (speed + np.hypot(pose[3], pose[4]))
    for k in np.flatnonzero(others.there[i] & (speed > NO_TTC_MPS) & soon).tolist():
        x, y, yaw, vx, vy = boxes[:5, k].tolist()
        x2, y2, yaw2, vx2, vy2 = pose[:5, k].tolist()
        if (x2 - x) * cos(yaw) + (y2 - y) * sin(yaw) + car.axle < 0.0:
            continue  # behind the rear axle
        contact = time_to_contact(
            x, y, yaw, car.length, car.width, x2, y2, yaw2, length, width, vx2 - vx, vy2 - vy
        )
        least = min(least, contact) if contact <= SOON_S else least  # (2)
    return float(least) if least < inf else nan


def conflicting_agent(scenario: Scenario) -> str:
    """The agent in conflict with the ego: the moving one with the least (3), of equal ones the
    nearest.

    If no moving agent has a conflict, the nearest moving one; if none moves, the same of all
    agents.

    Raises:
        ConfigError: There is no agent.
    """
    seen = [one for one in encounters(scenario) if one.t_to - one.t_from >= SEEN_S]
    if not seen:
        raise ConfigError(
            f"{scenario.name}: there is no agent to vary; vary the ego's start, or insert an agent"
        )
    going = [one for one in seen if one.way >= GOING_M] or seen
    return min(going, key=lambda one: inf if isnan(one.conflict) else one.conflict).agent


def question_about(
    scenario: Scenario, words: Sequence[str], agents: Sequence[str], resolution: float | None
) -> SurfaceQuestion:
    """The question of `--vary` about agents, named by whole id or short name; by default the one in
    conflict.

    Raises:
        ConfigError: As `replan.experiments.question.question` and `conflicting_agent`.
    """
    found = question(words, [*map(scenario.short_names.whole, agents)], resolution)
    return (
        found
        if agents or not found.varies_agents
        else replace(found, agents=(conflicting_agent(scenario),))
    )


def lines(found: tuple[Encounter, ...], short: ShortNames) -> list[str]:
    """A line per road user, the nearest `SHOWN` first."""
    width = max([len(short(one.agent)) for one in found[:SHOWN]], default=5)
    rows = [f"{'agent':{width}}  kind        from     to    way  nearest     at  conflict"]
    rows += [
        (
            f"{short(one.agent):{width}}  {one.kind:10} {one.t_from:5.1f}  {one.t_to:5.1f}  "
            f"{one.way:5.1f}"
            f"  {one.least:7.2f}  {one.at:5.1f}  "
            f"{'none' if isnan(one.conflict) else f'{one.conflict:.1f}':>8}"
        )
        for one in found[:SHOWN]
    ]
    rows[0] += "   [s, s, m, m, s, s]"
    more = len(found) - SHOWN
    return rows + ([f"and {more} that come less near"] if more > 0 else [])
