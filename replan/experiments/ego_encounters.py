"""The agents of a log by their least distance to the ego, and the one in conflict with it, to
choose which to vary.

(1) PET = |t_j - t_i|, the least over the ego's boxes i and an agent's boxes j
        that overlap (`replan.metrics.encounters`), of pedestrians, and of others whose headings
        differ by 30 degrees or more, because an agent that follows does not cross
(2) TTC = least time until the boxes touch at constant velocity vectors (`replan.logs.shapes`),
        within `SOON_S`; of agents ahead of an ego that drives
(3) conflict = min(PET, TTC), s; NaN if an agent neither overlaps the ego's path nor
        is on a course to it
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, inf, isnan, nan, sin

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError
from replan.core.names import ShortNames
from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.shapes import clearance, time_to_contact
from replan.metrics.boxes import NO_TTC_MPS, EgoOutline, OtherBoxes, car_of, ego_boxes, others_at
from replan.metrics.encounters import CROSSING_RAD, encroachment, may_meet
from replan.replay.loop.reference_drives import reference_drives

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


def encounters(scenario: Scenario) -> tuple[Encounter, ...]:
    """All road users that are present while the ego drives as logged (without a logged drive: the
    careful driver).

    The nearest first.
    """
    tracks = scenario.tracks
    ego = scenario.ego if len(scenario.ego) > 1 else next(reference_drives(scenario)).ego
    t = np.arange(ego.t[0], ego.t[-1] + 1e-9, GRID_S)
    others, car = others_at(tracks, t), car_of(scenario)
    boxes = ego_boxes(ego.resampled(t), scenario)
    rows: list[Encounter] = []
    for i in np.flatnonzero(others.there.any(axis=1)).tolist():
        samples, kind = tracks.samples(i), tracks.kinds[i]
        x, y, times = tracks.x[samples], tracks.y[samples], tracks.t[samples]
        begin, end = float(times[0]), float(times[-1])
        if tracks.static[i]:
            begin, end = float(ego.t[0]), scenario.duration
        step, gap = _nearest(boxes, car, others, i)
        crossing = 0.0 if kind is AgentKind.PEDESTRIAN else CROSSING_RAD
        rows.append(
            Encounter(
                tracks.ids[i],
                kind.value,
                begin,
                end,
                way=hypot(x[-1] - x[0], y[-1] - y[0]),
                least=gap,
                at=float(t[step]),
                conflict=_conflict(boxes, car, others, i, crossing),
            )
        )
    return tuple(sorted(rows, key=lambda row: (row.least, row.agent)))


def _nearest(boxes: FloatArray, car: EgoOutline, others: OtherBoxes, i: int) -> tuple[int, float]:
    """The step at which the box of agent i is nearest to the ego's, and their distance, m."""
    length, width = others.size[i].tolist()
    steps = np.flatnonzero(others.there[i])
    ego, other = boxes[:3, steps].T, others.pose[:3, i, steps].T
    away = np.hypot(other[:, 0] - ego[:, 0], other[:, 1] - ego[:, 1])
    spread = 0.5 * (hypot(car.length, car.width) + hypot(length, width))
    near = away <= away.min() + spread  # the nearest one by its box is among these
    pairs = zip(ego[near].tolist(), other[near].tolist(), strict=True)
    gaps = [
        clearance(x1, y1, yaw1, car.length, car.width, x2, y2, yaw2, length, width)
        for (x1, y1, yaw1), (x2, y2, yaw2) in pairs
    ]
    nearest = int(np.argmin(gaps))
    return int(steps[near][nearest]), float(gaps[nearest])


def _conflict(
    boxes: FloatArray, car: EgoOutline, others: OtherBoxes, i: int, angle: float
) -> float:
    """Conflict (3) of the ego's boxes and agent i, whose heading must differ by `angle` to
    cross.
    """
    least = _encroachment_time(boxes, car, others, i, angle)
    length, width = others.size[i].tolist()
    x, y, _, vx, vy = boxes
    other_x, other_y, _, other_vx, other_vy = others.pose[:, i]
    speed, other_speed = np.hypot(vx, vy), np.hypot(other_vx, other_vy)
    reach = 0.5 * (hypot(car.length, car.width) + hypot(length, width))
    away = np.hypot(other_x - x, other_y - y) - reach
    soon = away <= min(least, SOON_S) * (speed + other_speed)
    for k in np.flatnonzero(others.there[i] & (speed > NO_TTC_MPS) & soon).tolist():
        x1, y1, yaw1, vx1, vy1 = boxes[:, k].tolist()
        x2, y2, yaw2, vx2, vy2 = others.pose[:, i, k].tolist()
        if (x2 - x1) * cos(yaw1) + (y2 - y1) * sin(yaw1) + car.axle < 0.0:
            continue  # behind the rear axle
        ego_box, other_box = (x1, y1, yaw1, car.length, car.width), (x2, y2, yaw2, length, width)
        contact = time_to_contact(*ego_box, *other_box, vx2 - vx1, vy2 - vy1)
        least = min(least, contact) if contact <= SOON_S else least  # (2)
    return float(least) if least < inf else nan


def _encroachment_time(
    boxes: FloatArray, car: EgoOutline, others: OtherBoxes, i: int, angle: float
) -> float:
    """(1) of agent i; inf if it does not cross the ego's path."""
    pose = others.pose[:, i]
    ego_steps, steps = may_meet(boxes, car, others, i)
    if not len(ego_steps) or not len(steps):
        return inf
    if np.ptp(pose[0, steps]) + np.ptp(pose[1, steps]) == 0.0:
        return inf  # it stands
    sizes = np.array([(car.length, car.width), others.size[i]])
    after, before, *_ = encroachment(boxes, ego_steps, pose, steps, sizes, angle)
    counts = np.r_[after, before]
    return min((GRID_S * float(count) for count in counts[counts >= 0]), default=inf)


def conflicting_agent(scenario: Scenario) -> str:
    """The agent in conflict with the ego: the moving one with the least (3), of equal ones the
    nearest.

    If no moving agent has a conflict, the nearest moving one; if none moves, the same of all
    agents.

    Raises:
        ConfigError: There is no agent.
    """
    tracked = [row for row in encounters(scenario) if row.t_to - row.t_from >= SEEN_S]
    if not tracked:
        raise ConfigError(
            f"{scenario.name}: there is no agent to vary; vary the ego's start, or insert an agent"
        )
    moving = [row for row in tracked if row.way >= GOING_M]
    return min(moving or tracked, key=_conflict_time).agent


def _conflict_time(encounter: Encounter) -> float:
    return inf if isnan(encounter.conflict) else encounter.conflict


def lines(rows: tuple[Encounter, ...], short_names: ShortNames) -> list[str]:
    """A line per road user, the nearest `SHOWN` first."""
    names = [short_names(row.agent) for row in rows[:SHOWN]]
    width = max(map(len, names), default=5)
    text = [
        f"{'agent':{width}}  kind        from     to    way  nearest     at  conflict"
        "   [s, s, m, m, s, s]"
    ]
    for name, row in zip(names, rows, strict=False):
        conflict = "none" if isnan(row.conflict) else f"{row.conflict:.1f}"
        text.append(
            f"{name:{width}}  {row.kind:10} {row.t_from:5.1f}  {row.t_to:5.1f}  {row.way:5.1f}"
            f"  {row.least:7.2f}  {row.at:5.1f}  {conflict:>8}"
        )
    more = len(rows) - SHOWN
    return text + ([f"and {more} that come less near"] if more > 0 else [])
