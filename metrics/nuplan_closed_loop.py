"""The parts of nuPlan's closed-loop score (CLS), as the devkit e9241677 computes them.

(1) collisions x drivable x direction x making_progress x (5 progress + 5 ttc + 4 speed_limit + 2
    comfort) / 16

The drive is sampled at 10 Hz if it has smaller steps. The route of the ego's centre, and the lanes
of its corners, are those of `devkit_lanes`. The ego is astray while its corners are neither in one
lane nor in joined lanes. v is the ego's speed at its centre, u an agent's (of objects: 0):

    collisions    product over {pedestrians and riders, vehicles, objects} of max(0, 1 - n / (1, 1,
                  2)), n at fault. Each agent counts at its first contact, also if it appears there.
                  The kinds are those of `collisions`, without its additions. At fault: into what
                  stands, with the front, with the side while astray
    ttc           0 with a contact at fault, or if both boxes, moved along their headings for 0.1,
        ... 0.9 s, touch.
                  v <= 0.005 m/s: 1. Agents count until their first contact:
                      those less than 30 degrees off the heading seen from the rear axle; while the
                      ego is astray or its rear axle is in an intersection, up to 150
    drivable      0 where a corner is on no lane and at least 0.3 m off lanes and areas
    direction     1, 0.5, 0: the centre's way along the first lane of its route in the last 11
                  samples is at worst
                  above -2 m, -6 m, below
    progress      (2) of the drive over that of the log's driver, each at least 2 m, at most 1; 0
                  below -2 m
    making_progress   1 where progress is at least 0.2
    speed_limit   max(0, 1 - mean step x sum of max(v - limit, 0) / (2.23 m/s x duration));
        the limit of a connector
                  is the greatest of the lanes before and behind it; without a limit nothing is
                  exceeded
    comfort       1 where the six signals of `comfort.NUPLAN_BOUNDS` are within them,
        filtered as there. Along the
                  body: a + d (w^2 + dw/dt), w the yaw rate, d from the rear axle to the centre,
                      the devkit's own formula. Its simulator writes a lateral acceleration of 0, so
                      that this bound never acts

(2) gain = sum over the steps of the change of the station on the centre line
        of the route's roadblock under the centre. Roadblocks follow one another; the way over one
        that was skipped counts. Off them nothing is gained.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import cos, hypot, prod, sin

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.kernel import kernel
from replan.core.once import once
from replan.logs.agents import AgentKind
from replan.logs.polylines import along_line
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.shapes import overlap
from replan.logs.states import Trajectory
from replan.logs.trace import Trace
from replan.metrics.boxes import (
    NO_TTC_MPS,
    STANDING_MPS,
    EgoOutline,
    OtherBoxes,
    car_of,
    ego_boxes,
    is_behind,
    pieces,
    touches,
)
from replan.metrics.comfort import NUPLAN_BOUNDS, savgol
from replan.metrics.devkit_lanes import DevkitLanes, Route, devkit_lanes
from replan.metrics.metric import Unavailable

AHEAD = cos(30.0 / 180.0 * np.pi)
CORNERS = 0.5 * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
"""Front left, rear left, rear right, front right: shares of length and width from the centre."""
OFF_M, LEAST_M = 0.3, 2.0
LEAST_SHARE, EXCESS_MPS = 0.2, 2.23
COMPLIANT_M, HALF_M, DIRECTION_S = 2.0, 6.0, 1.0
NO_LANES = Unavailable("the log has no lanes: the scores of nuPlan and NAVSIM need them")
LEAST_STATES, STEP_S = 6, 0.1
SHORT = Unavailable(f"the drive or the log's has fewer than {LEAST_STATES} states at 10 Hz")


def corners_of(
    x: FloatArray, y: FloatArray, yaw: FloatArray, car: EgoOutline
) -> tuple[FloatArray, FloatArray]:
    """Return the corners `(4, k)` of boxes with these centres."""
    ahead, left = CORNERS[:, :1] * car.length, CORNERS[:, 1:] * car.width
    return x + ahead * np.cos(yaw) - left * np.sin(yaw), y + ahead * np.sin(yaw) + left * np.cos(
        yaw
    )


@once
def closed_loop_parts(trace: Trace, scenario: Scenario) -> Mapping[str, float] | Unavailable:
    """Return the parts of `NUPLAN_CLOSED` of a drive."""
    lanes = None if scenario.road.source is RoadSource.DRIVEN_PATH else devkit_lanes(scenario.road)
    if lanes is None:
        return NO_LANES
    ego, car = _at_10_hz(trace.ego), car_of(scenario)
    if min(len(scenario.ego), len(ego)) < LEAST_STATES:
        return SHORT
    boxes = ego_boxes(ego, scenario)
    x, y, yaw, vx, vy = boxes
    speed, corners = np.hypot(vx, vy), corners_of(x, y, yaw, car)
    route, lanes_of_corners = lanes.route(x, y), lanes.corner_routes(*corners)
    astray = np.array([not lanes.in_one(four) for four in lanes_of_corners])
    wide = astray | lanes.in_intersection(ego.x, ego.y)
    kinds = trace.agents.kinds
    objects = np.array([kind is AgentKind.OBJECT for kind in kinds], np.bool_)
    rear = np.stack([ego.x, ego.y, yaw, speed])
    fault, met, close = np.zeros(len(kinds), np.bool_), np.zeros(len(kinds), np.bool_), False
    for steps, present, others in pieces(trace.agents, ego.t):
        fault[present], met[present], near = _meetings(
            rear[:, steps],
            boxes[:, steps],
            car,
            others,
            objects[present],
            astray[steps],
            wide[steps],
            met[present],
        )
        close |= near
    hit = [kinds[i] for i in np.flatnonzero(fault)]
    progress = _progress(lanes, ego_boxes(scenario.ego, scenario), x, y)
    return {
        "collisions": collision_score(hit),
        "drivable": float(not _leaves_road(lanes, lanes_of_corners, *corners)),
        "direction": _direction(lanes, route, x, y, ego.t),
        "making_progress": float(progress >= LEAST_SHARE),
        "progress": progress,
        "ttc": float(not hit and not close),
        "speed_limit": _speed_limit(lanes, scenario, route, speed, ego.t),
        "comfort": float(comfortable(_signals(ego, scenario.vehicle.axle_to_center))),
    }


def _at_10_hz(ego: Trajectory) -> Trajectory:
    """Return a drive as nuPlan's loop steps.

    A drive with steps of more than half of 0.1 s as it is.
    """
    steps = int((ego.t[-1] - ego.t[0]) / STEP_S + 1e-6) + 1
    fine = len(ego) > 1 and float(np.mean(np.diff(ego.t))) < 0.5 * STEP_S
    return (
        ego.resampled(np.minimum(ego.t[0] + STEP_S * np.arange(steps), ego.t[-1])) if fine else ego
    )


def collision_score(hit: Sequence[AgentKind]) -> float:
    """Return `collisions` from the kinds of those hit at fault."""
    vulnerable, objects = sum(kind.is_vulnerable for kind in hit), list(hit).count(AgentKind.OBJECT)
    counts = (vulnerable, 1), (len(hit) - vulnerable - objects, 1), (objects, 2)
    return prod(max(0.0, 1.0 - n / allowed) for n, allowed in counts)


@kernel
def _meetings(
    rear: FloatArray,
    box: FloatArray,
    car: EgoOutline,
    others: OtherBoxes,
    objects: BoolArray,
    astray: BoolArray,
    wide: BoolArray,
    met: BoolArray,
) -> tuple[BoolArray, BoolArray, bool]:
    """Return which agents the ego hits at fault and has met `(n,)`, and whether it comes too close
    in time to one.

    `rear` is x, y, yaw of the rear axle and the speed `(4, k)`; `wide`: where agents up to 150
    degrees count for ttc; `met`: agents that it has met before.
    """
    present, pose, size = others.there, others.pose, others.size
    fault, close = np.zeros(len(present), np.bool_), False
    for i in range(len(present)):
        for k in range(present.shape[1]):
            if met[i] or not present[i, k]:
                continue
            x, y = rear[0, k], rear[1, k]
            yaw, v = rear[2, k], rear[3, k]
            px, py, heading = pose[0, i, k], pose[1, i, k], pose[2, i, k]
            u = 0.0 if objects[i] else hypot(pose[3, i, k], pose[4, i, k])
            if touches(box[0, k], box[1, k], yaw, car, others, i, k):
                met[i] = True
                if v > STANDING_MPS:
                    nose_x, nose_y = x + car.front * cos(yaw), y + car.front * sin(yaw)
                    fault[i] = u <= STANDING_MPS or (
                        not is_behind(x, y, yaw, px, py)
                        and (
                            overlap(
                                nose_x,
                                nose_y,
                                yaw,
                                0.0,
                                car.width,
                                px,
                                py,
                                heading,
                                size[i, 0],
                                size[i, 1],
                            )
                            or astray[k]
                        )
                    )
                break
            ahead, away = (px - x) * cos(yaw) + (py - y) * sin(yaw), hypot(px - x, py - y)
            if close or v <= NO_TTC_MPS or (v + u) < away - 20.0 - size[i, 0]:
                continue
            if ahead <= AHEAD * away and (not wide[k] or is_behind(x, y, yaw, px, py)):
                continue
            for step in range(1, 10):
                ego_way, other_way = 0.1 * step * v, 0.1 * step * u
                if overlap(
                    box[0, k] + ego_way * cos(yaw),
                    box[1, k] + ego_way * sin(yaw),
                    yaw,
                    car.length,
                    car.width,
                    px + other_way * cos(heading),
                    py + other_way * sin(heading),
                    heading,
                    size[i, 0],
                    size[i, 1],
                ):
                    close = True
                    break
    return fault, met, close


def _leaves_road(
    lanes: DevkitLanes,
    lanes_of_corners: Sequence[Sequence[tuple[int, ...]]],
    x: FloatArray,
    y: FloatArray,
) -> bool:
    """Return whether a corner `(4, k)` that is on no lane is `OFF_M` off the road."""
    for corner in range(4):
        lost = np.array([not four[corner] for four in lanes_of_corners])
        if (
            lost.any()
            and not np.isfinite(lanes.off_road(x[corner, lost], y[corner, lost], OFF_M)).all()
        ):
            return True
    return False


def _station(line: FloatArray, x: float, y: float) -> float:
    return float(along_line(line, np.array([x]), np.array([y]))[0][0])


def _direction(
    lanes: DevkitLanes, route: Route, x: FloatArray, y: FloatArray, t: FloatArray
) -> float:
    gained, lane, before = np.zeros(len(x)), route[0][:1], np.nan
    for k, lane_ids in enumerate(route):
        if not lane_ids:
            continue
        if lane_ids[:1] == lane:
            station = _station(lanes.lanes[lane_ids[0]].center, x[k], y[k])
            gained[k] = station - before if np.isfinite(before) and station else 0.0
            before = station
        else:
            lane, before = lane_ids[:1], np.nan
    total, n = np.r_[0.0, np.cumsum(gained)], np.arange(1, len(x) + 1)
    samples = int(DIRECTION_S / np.mean(np.diff(t)) + 1e-9) + 1
    worst = abs(float((total[n] - total[np.maximum(n - samples, 0)]).min()))
    if worst < COMPLIANT_M:
        return 1.0
    return 0.5 if worst < HALF_M else 0.0


def route_lanes(lanes: DevkitLanes, x: FloatArray, y: FloatArray) -> list[int]:
    """Return the first lane of each roadblock that a drive of the centre comes through, in
    order.
    """
    simple: list[tuple[int, ...]] = []
    for lane_ids in lanes.route(x, y):
        if lane_ids and not (simple and set(lane_ids) & set(simple[-1])):
            simple.append(lane_ids)
    return [
        ids[0]
        for k, ids in enumerate(simple)
        if not k or lanes.block[ids[0]] != lanes.block[simple[k - 1][0]]
    ]


def _progress(lanes: DevkitLanes, log: FloatArray, x: FloatArray, y: FloatArray) -> float:
    first = route_lanes(lanes, log[0], log[1])
    if not first:
        return 1.0
    own, driven = _gain(lanes, first, x, y), _gain(lanes, first, log[0], log[1])
    return 0.0 if own < -LEAST_M else min(1.0, max(own, LEAST_M) / max(driven, LEAST_M))


def _gain(lanes: DevkitLanes, first: Sequence[int], x: FloatArray, y: FloatArray) -> float:
    """Return (2) along the roadblocks of the lanes `first`, m."""
    under, blocks = lanes.under(x, y), np.array(lanes.block)
    inside = [under[blocks == lanes.block[i]].any(axis=0) for i in first]
    lines = [lanes.lanes[i].center for i in first]
    now, total, last = 0, 0.0, _station(lines[0], x[0], y[0])
    for k in range(1, len(x)):
        if inside[now][k]:
            station = _station(lines[now], x[k], y[k])
            total, last = total + station - last, station
            continue
        skipped = 0.0
        for then in range(now + 1, len(first)):
            if inside[then][k]:
                station = _station(lines[then], x[k], y[k])
                total += (
                    lanes.lanes[first[now]].length
                    - last
                    + skipped
                    + station
                    - _station(lines[then], *lines[now][-1])
                )
                now, last = then, station
                break
            if then + 1 < len(first):
                skipped += _station(lines[then], *lines[then + 1][0]) - _station(
                    lines[then], *lines[then - 1][-1]
                )
    return total


def _speed_limit(
    lanes: DevkitLanes, scenario: Scenario, route: Route, speed: FloatArray, t: FloatArray
) -> float:
    over = np.zeros(len(t))
    for k, lane_ids in enumerate(route):
        joined = [j for i in lane_ids for j in (*lanes.after[i], *lanes.before[i])]
        asked = joined if lane_ids and lanes.connector[lane_ids[0]] else lane_ids
        limits = [scenario.road.stated_limit(lanes.lanes[i].id) for i in asked]
        if limits and np.isfinite(limits).all():
            over[k] = max(0.0, speed[k] - max(limits))
    return float(max(0.0, 1.0 - over.sum() * np.mean(np.diff(t)) / (EXCESS_MPS * (t[-1] - t[0]))))


def _signals(ego: Trajectory, ahead: float) -> Mapping[str, FloatArray]:
    turn = ego.v * ego.kappa
    lon = ego.a + ahead * (turn**2 + np.gradient(turn, ego.t))
    return comfort_signals(
        lon, np.zeros(len(ego)), np.abs(ego.a), ego.yaw, float(np.mean(np.diff(ego.t)))
    )


def comfort_signals(
    lon: FloatArray,
    lat: FloatArray,
    size: FloatArray,
    yaw: FloatArray,
    step: float,
    windows: tuple[int, int] = (8, 15),
) -> Mapping[str, FloatArray]:
    """Return the six signals of nuPlan's comfort from accelerations along, across and as a whole,
    and the yaw.

    `windows` are those of the filters of accelerations and of jerks.
    """
    accel, jerk = windows
    return {
        "lon_accel": savgol(lon, accel, 2),
        "lat_accel": savgol(lat, accel, 2),
        "jerk": savgol(savgol(size, 8, 2), jerk, 2, 1, step),
        "lon_jerk": savgol(savgol(lon, 8, 2), jerk, 2, 1, step),
        "yaw_rate": savgol(yaw, 5, 2, 1, step),
        "yaw_accel": savgol(yaw, 5, 3, 2, step),
    }


def comfortable(signals: Mapping[str, FloatArray]) -> bool:
    """Return whether all signals are within nuPlan's bounds."""
    bounds = ((signals[name], low, high) for name, (_, low, high) in NUPLAN_BOUNDS.items())
    return all(((value > low) & (value < high)).all() for value, low, high in bounds)
