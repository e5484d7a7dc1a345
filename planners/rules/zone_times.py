"""When other road users take the zones of a reference path.

Agents take a zone in time windows, which follow from their positions and predictions.

Crosswalk: a pedestrian who is on it, or within `EDGE_M` of it and walks towards it, takes it while
one of their hypotheses is in the ego's half, widened by `KEPT_M` on each side. A pedestrian who
stands there takes it for an unknown time: from when a hypothesis enters it, else as if they started
now with `START_MPS` in the direction that they face.

Priority lane: a vehicle on it or on a lane that leads to it, in its direction, takes the zone

(1) while the box of a hypothesis touches the zone, if all that do so have a probability of
    `UNLIKELY` together
(2) on the priority lane itself also from (p_in - front) / v to (p_out - rear) / v: it may be
    predicted to leave the lane, but stay on it; one that stands in the zone takes it until it has
    left

A vehicle that a red light holds on its way there takes no zone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.kernel import kernel
from replan.logs.agents import AgentKind
from replan.logs.frame import Frame
from replan.logs.polylines import inside
from replan.logs.reference_line import ReferenceLine, line_project_many
from replan.logs.road import Road
from replan.logs.rules import RED
from replan.logs.shapes import overlap
from replan.planners.frenet.scene import STANDING_MPS, UNLIKELY
from replan.planners.rules.zones import Priority, Walk, Zone, distances, turned

EDGE_M = 1.5  # A pedestrian who stands within this of a crosswalk may want to cross, m
# A pedestrian whose distance to it falls faster than this walks towards it; a slower one stands,
# m/s
TOWARDS_MPS = 0.3
KEPT_M = 0.3  # Width by which the ego's half of a crosswalk is extended on each side, m
# Speed with which a standing pedestrian sets off, m/s: that of the clearing times in RiLSA 2010
START_MPS = 1.2
ASKEW_RAD = 1.0  # A vehicle drives along a lane where its heading differs less than this, rad


@dataclass(frozen=True, slots=True)
class ZoneTime:
    """An agent takes a zone from `begin` to `end`, s after the frame's time.

    Inf: the end is not known.
    """

    begin: float
    end: float
    agent: int  # Index into the frame's agents; `speed` of it, m/s
    speed: float
    # Whether it is a pedestrian who stands at the crosswalk and may begin to cross
    waits: bool = False


def windows(zone: Zone, line: ReferenceLine, road: Road, frame: Frame) -> tuple[ZoneTime, ...]:
    """The windows in which agents take a zone, in order of their begin."""
    spans = (
        _walking(zone, zone.by, line, frame)
        if isinstance(zone.by, Walk)
        else _driving(zone.by, road, frame)
    )
    return tuple(sorted(spans, key=lambda window: (window.begin, window.end, window.agent)))


def _walking(zone: Zone, walk: Walk, line: ReferenceLine, frame: Frame) -> Iterator[ZoneTime]:
    """Windows of the pedestrians who are on a crosswalk, or near it and do not walk along or away
    from it.
    """
    futures, agents = frame.predictions, frame.agents
    polygon, ahead = walk.crosswalk.polygon, frame.predictions.t - frame.t
    low, high = polygon.min(axis=0) - EDGE_M, polygon.max(axis=0) + EDGE_M
    near = (agents.x > low[0]) & (agents.x < high[0]) & (agents.y > low[1]) & (agents.y < high[1])
    edge = np.vstack([polygon, polygon[:1]])
    for i in np.flatnonzero(near).tolist():
        if agents.kinds[i] is not AgentKind.PEDESTRIAN:
            continue
        x, y, stands = float(agents.x[i]), float(agents.y[i]), agents.speed[i] < TOWARDS_MPS
        now, soon = distances(
            np.array([[x, y], [x + 0.1 * agents.vx[i], y + 0.1 * agents.vy[i]]]), edge
        )
        comes = now - soon > 0.1 * TOWARDS_MPS or stands
        if not (inside(x, y, polygon) or (now < EDGE_M and comes)):
            continue
        rows, yaw, walked = np.flatnonzero(futures.agent == i), agents.yaw[i], START_MPS * ahead
        spans = [
            window
            for row in rows
            for window in _span(
                _on_half(zone, walk, line, futures.x[row], futures.y[row]), ahead, i, frame
            )
        ]
        if stands and not spans:
            taken = _on_half(
                zone,
                walk,
                line,
                agents.x[i] + walked * np.cos(yaw),
                agents.y[i] + walked * np.sin(yaw),
            )
            spans = list(_span(taken, ahead, i, frame))
        yield from (replace(window, end=inf, waits=True) if stands else window for window in spans)


def _on_half(
    zone: Zone, walk: Walk, line: ReferenceLine, x: FloatArray, y: FloatArray
) -> BoolArray:
    """Which points `(k,)` of a way lie on the ego's half of a crosswalk."""
    frenet = line_project_many(line.s, line.coef, x, y, zone.s_in, 30.0)
    s, l = frenet[:, 0], frenet[:, 1]
    along = (s > zone.s_in - EDGE_M) & (s < zone.s_out + EDGE_M)
    return np.asarray(along & (l > walk.right - KEPT_M) & (l < walk.left + KEPT_M))


def _driving(priority: Priority, road: Road, frame: Frame) -> Iterator[ZoneTime]:
    """Windows of the vehicles that may take the zone, by the lane that they are on.

    The priority lane comes first.
    """
    agents, futures = frame.agents, frame.predictions
    taken: set[int] = set()
    for lane_id, lights in priority.feeds.items():
        if any(frame.lights.get(light) in RED for light in lights):
            continue
        lane = road.lanes[lane_id]
        low, high = lane.polygon.min(axis=0), lane.polygon.max(axis=0)
        near_x = (agents.x >= low[0]) & (agents.x <= high[0])
        near = near_x & (agents.y >= low[1]) & (agents.y <= high[1])
        for i in np.flatnonzero(near).tolist():
            x, y = float(agents.x[i]), float(agents.y[i])
            drives = agents.kinds[i] not in (AgentKind.PEDESTRIAN, AgentKind.OBJECT)
            if i in taken or not drives or not inside(x, y, lane.polygon):
                continue
            if turned(lane, x, y, float(agents.yaw[i])) >= ASKEW_RAD:
                continue
            taken.add(i)
            if lane_id == priority.lane.id:
                yield from _passage(priority, i, frame)
            rows, size = futures.agent == i, np.array([agents.length[i], agents.width[i]])
            touches = _boxes_touched(
                priority.boxes, futures.x[rows], futures.y[rows], futures.yaw[rows], size
            )
            if futures.probability[rows][touches.any(axis=1)].sum() >= UNLIKELY:  # (1)
                for touched in touches:
                    yield from _span(touched, futures.t - frame.t, i, frame)


def _passage(priority: Priority, i: int, frame: Frame) -> Iterator[ZoneTime]:
    """The window (2) of a vehicle on the priority lane."""
    agents, center = frame.agents, priority.lane.center
    x, y, step = float(agents.x[i]), float(agents.y[i]), np.diff(center, axis=0)
    length = np.hypot(*step.T)
    along = (x - center[:-1, 0]) * step[:, 0] + (y - center[:-1, 1]) * step[:, 1]
    u = np.clip(along / np.maximum(length, 1e-9) ** 2, 0.0, 1.0)
    away = np.hypot(center[:-1, 0] + u * step[:, 0] - x, center[:-1, 1] + u * step[:, 1] - y)
    k = int(np.argmin(away))
    p = float(length[:k].sum() + u[k] * length[k])  # along the lane, to the point nearest to it
    v, half = float(agents.speed[i]), 0.5 * float(agents.length[i])
    if p - half > priority.p_out:
        return
    if v >= STANDING_MPS:  # (2)
        begin = max(priority.p_in - p - half, 0.0) / v
        yield ZoneTime(begin, (priority.p_out - p + half) / v, i, v)
    elif p + half > priority.p_in:
        yield ZoneTime(0.0, inf, i, v)


def _span(taken: BoolArray, ahead: FloatArray, i: int, frame: Frame) -> Iterator[ZoneTime]:
    """The window from the first to the last taken time.

    It has no end if that is the last time of the predictions.
    """
    samples = np.flatnonzero(taken)
    if len(samples):
        end = inf if samples[-1] == len(ahead) - 1 else float(ahead[samples[-1]])
        yield ZoneTime(float(ahead[samples[0]]), end, i, float(frame.agents.speed[i]))


@kernel
def _boxes_touched(
    boxes: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, size: FloatArray
) -> BoolArray:
    """Which boxes at `(n, k)` poses of one size (length, width) overlap any of the `boxes`
    `(m, 5)`.
    """
    touched = np.zeros(x.shape, np.bool_)
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            for j in range(len(boxes)):
                if overlap(
                    boxes[j, 0],
                    boxes[j, 1],
                    boxes[j, 2],
                    boxes[j, 3],
                    boxes[j, 4],
                    x[i, k],
                    y[i, k],
                    yaw[i, k],
                    size[0],
                    size[1],
                ):
                    touched[i, k] = True
                    break
    return touched
