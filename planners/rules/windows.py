"""When the others take a zone: time windows from where they are and how they are predicted.

Crosswalk: a pedestrian who is on it, or within `EDGE_M` of it and walks towards it, takes it while a hypothesis has it
in the ego's half, `KEPT_M` more on each side. Who stands there waits: takes it as if starting now with `START_MPS` the
way it faces, for an unknown time.

Priority lane: a vehicle on it or on a lane that leads to it, in its direction, takes the zone

(1) while the box of a hypothesis touches the zone, where its hypotheses that do weigh `UNLIKELY` together
(2) on the priority lane itself also from (p_in - front) / v to (p_out - rear) / v: it may be predicted to leave the
    lane, and does not; one that stands in the zone takes it until it has left

but not where a red light holds it on its way there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from logs.frame import Frame
from logs.kernel import BoolArray, FloatArray, kernel
from logs.road import ReferenceLine, Road, inside, line_project_many
from logs.rules import RED
from logs.scenario import AgentKind
from logs.shapes import overlap
from planners.frenet.scene import STANDING_MPS, UNLIKELY
from planners.rules.zones import Priority, Walk, Zone, distances, turned

EDGE_M = 1.5
"""Who stands within this of a crosswalk may want to cross, m."""
TOWARDS_MPS = 0.3
"""Who comes nearer to it faster than this walks towards it; who is slower stands, m/s."""
KEPT_M = 0.3
"""Room beside the ego's half of a crosswalk that pedestrians have, m."""
START_MPS = 1.2
"""With which who stands sets off, m/s: as RiLSA 2010 counts pedestrians' clearing times."""
ASKEW_RAD = 1.0
"""A vehicle drives along a lane where its heading differs less than this, rad."""


@dataclass(frozen=True, slots=True)
class Window:
    """An agent takes a zone from `begin` to `end`, s from the frame; inf: it is not known how long.

    Attributes:
        begin: s.
        end: s.
        agent: Index into the frame's agents.
        speed: Of the agent, m/s.
        waits: Whether it stands at a crosswalk: it may take it, but has not begun to.
    """

    begin: float
    end: float
    agent: int
    speed: float
    waits: bool = False


def windows(zone: Zone, line: ReferenceLine, road: Road, frame: Frame) -> tuple[Window, ...]:
    """The windows in which others take a zone, in order of their begin."""
    found = _walking(zone, zone.by, line, frame) if isinstance(zone.by, Walk) else _driving(zone.by, road, frame)
    return tuple(sorted(found, key=lambda window: (window.begin, window.end, window.agent)))


def _walking(zone: Zone, walk: Walk, line: ReferenceLine, frame: Frame) -> Iterator[Window]:
    futures, agents = frame.predictions, frame.agents
    ahead = futures.t - frame.t
    for i in _at_crosswalk(walk, frame):
        found = False
        for row in np.flatnonzero(futures.agent == i):
            for window in _span(_on_half(zone, walk, line, futures.x[row], futures.y[row]), ahead, i, frame):
                found = True
                yield replace(window, end=inf, waits=True) if agents.speed[i] < TOWARDS_MPS else window
        if not found and agents.speed[i] < TOWARDS_MPS:
            yaw, way = agents.yaw[i], START_MPS * ahead
            taken = _on_half(zone, walk, line, agents.x[i] + way * np.cos(yaw), agents.y[i] + way * np.sin(yaw))
            yield from (replace(window, end=inf, waits=True) for window in _span(taken, ahead, i, frame))


def _on_half(zone: Zone, walk: Walk, line: ReferenceLine, x: FloatArray, y: FloatArray) -> BoolArray:
    """Which points `(k,)` of a way lie on the ego's half of a crosswalk."""
    frenet = line_project_many(line.s, line.coef, x, y, zone.s_in, 30.0)
    s, l = frenet[:, 0], frenet[:, 1]  # noqa: E741
    along = (s > zone.s_in - EDGE_M) & (s < zone.s_out + EDGE_M)
    return np.asarray(along & (l > walk.right - KEPT_M) & (l < walk.left + KEPT_M))


def _at_crosswalk(walk: Walk, frame: Frame) -> Iterator[int]:
    """The pedestrians who are on a crosswalk, or near it and do not walk along or away from it."""
    agents, polygon = frame.agents, walk.crosswalk.polygon
    low, high = polygon.min(axis=0) - EDGE_M, polygon.max(axis=0) + EDGE_M
    near = (agents.x > low[0]) & (agents.x < high[0]) & (agents.y > low[1]) & (agents.y < high[1])
    edge = np.vstack([polygon, polygon[:1]])
    for i in np.flatnonzero(near).tolist():
        if agents.kinds[i] is not AgentKind.PEDESTRIAN:
            continue
        x, y = float(agents.x[i]), float(agents.y[i])
        now, soon = distances(np.array([[x, y], [x + 0.1 * agents.vx[i], y + 0.1 * agents.vy[i]]]), edge)
        comes = now - soon > 0.1 * TOWARDS_MPS or agents.speed[i] < TOWARDS_MPS
        if inside(x, y, polygon) or (now < EDGE_M and comes):
            yield i


def _driving(priority: Priority, road: Road, frame: Frame) -> Iterator[Window]:
    futures = frame.predictions
    for i, lane in _claimants(priority, road, frame):
        yield from _along(priority, i, lane, frame)
        rows = np.flatnonzero(futures.agent == i)
        size = np.array([frame.agents.length[i], frame.agents.width[i]])
        taken = _touched(priority.boxes, futures.x[rows], futures.y[rows], futures.yaw[rows], size)
        if futures.probability[rows][taken.any(axis=1)].sum() < UNLIKELY:  # (1)
            continue
        for mine in taken:
            yield from _span(mine, futures.t - frame.t, i, frame)


def _claimants(priority: Priority, road: Road, frame: Frame) -> Iterator[tuple[int, int]]:
    """The vehicles that may claim the zone, with the lane that they are on: the priority lane before all others."""
    agents = frame.agents
    taken: set[int] = set()
    for lane_id, lights in priority.feeds.items():
        if any(frame.lights.get(light) in RED for light in lights):
            continue
        lane = road.lanes[lane_id]
        low, high = lane.polygon.min(axis=0), lane.polygon.max(axis=0)
        near = (agents.x >= low[0]) & (agents.x <= high[0]) & (agents.y >= low[1]) & (agents.y <= high[1])
        for i in np.flatnonzero(near).tolist():
            x, y = float(agents.x[i]), float(agents.y[i])
            drives = agents.kinds[i] not in (AgentKind.PEDESTRIAN, AgentKind.OBJECT)
            if i in taken or not drives or not inside(x, y, lane.polygon):
                continue
            if turned(lane, x, y, float(agents.yaw[i])) < ASKEW_RAD:
                taken.add(i)
                yield i, lane_id


def _along(priority: Priority, i: int, lane: int, frame: Frame) -> Iterator[Window]:
    """(2), for a vehicle on the priority lane."""
    if lane != priority.lane.id:
        return
    agents, center = frame.agents, priority.lane.center
    p = _station(center, float(agents.x[i]), float(agents.y[i]))
    v, half = float(agents.speed[i]), 0.5 * float(agents.length[i])
    if p - half > priority.p_out:
        return
    if v >= STANDING_MPS:
        yield Window(max(priority.p_in - p - half, 0.0) / v, (priority.p_out - p + half) / v, i, v)  # (2)
    elif p + half > priority.p_in:
        yield Window(0.0, inf, i, v)


def _station(center: FloatArray, x: float, y: float) -> float:
    """Arc length of the centre point nearest to (x, y), m, along the polyline."""
    step = np.diff(center, axis=0)
    length = np.hypot(*step.T)
    u = ((x - center[:-1, 0]) * step[:, 0] + (y - center[:-1, 1]) * step[:, 1]) / np.maximum(length, 1e-9) ** 2
    u = np.clip(u, 0.0, 1.0)
    away = np.hypot(center[:-1, 0] + u * step[:, 0] - x, center[:-1, 1] + u * step[:, 1] - y)
    k = int(np.argmin(away))
    return float(length[:k].sum() + u[k] * length[k])


def _span(taken: BoolArray, ahead: FloatArray, i: int, frame: Frame) -> Iterator[Window]:
    """The window from the first to the last time that is taken; open where that is the last time at all."""
    at = np.flatnonzero(taken)
    if len(at):
        end = inf if at[-1] == len(ahead) - 1 else float(ahead[at[-1]])
        yield Window(float(ahead[at[0]]), end, i, float(frame.agents.speed[i]))


@kernel
def _touched(boxes: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, size: FloatArray) -> BoolArray:
    """Which boxes at `(n, k)` poses of one size (length, width) overlap any of the `boxes` `(m, 5)`."""
    out = np.zeros(x.shape, np.bool_)
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            for j in range(len(boxes)):
                if overlap(
                    boxes[j, 0], boxes[j, 1], boxes[j, 2], boxes[j, 3], boxes[j, 4],
                    x[i, k], y[i, k], yaw[i, k], size[0], size[1],
                ):  # fmt: skip
                    out[i, k] = True
                    break
    return out
