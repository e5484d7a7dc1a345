"""NAVSIM's scores of a plan of 4 s: PDMS (v1) and EPDMS (v2), part by part as navsim 0a380a90 and
its branch v1.1 do.

A window begins at a state of the log's ego. The plan, linear between its eight poses, is driven by
`simulated`; so is the plan of PDM-Closed (`yardstick`). The 41 states at 10 Hz are judged beside
the others as logged (`scene`):

    NC   1, 1/2, 0: at-fault contact with an object, with another agent. Kinds and fault as in
         `replan.metrics.nuplan_closed_loop`, but what stands is what stood when first seen, and
         astray is: off the road, or the corners in several lanes and all four in none. A
         contact without fault ends the agent; one at the start does in v2
    DAC  0 where a corner is on no lane, intersection or other drivable area
    DDC  1, 1/2, 0: in a span of 1 s the centre drives less than 2 m, 6 m, more off the route's
         lanes and intersections
    TLC  0 where the ego touches a lane of the route behind a red light
    TTC  0 if the ego, moved on along its heading for 0, .3, .6, .9 s, touches an agent where that
         then is, seen as in
         `replan.metrics.nuplan_closed_loop`; the first contact with another agent ends that
    LK   0 where the centre is above 0.5 m off PDM-Closed's centre line in 20 states in a row,
         intersections left out
    EP   own way along that line over the greater of the own and PDM-Closed's, both times their
         multipliers; 1 up to 5 m
    HC   1 where nuPlan's six signals keep their bounds, with 1.5 s of recorded past before (v2)
    EC   1 where acceleration, jerk, yaw rate and its rate of this and the plan 0.5 s earlier differ
         by at most
         `EC_BOUNDS` (root mean squares); without such a plan the weight leaves

The boxes that are judged have the size of nuPlan's car (`NUPLAN_CAR`), as in the original, whatever
the log's car is. Human filter: a part in which the log's driver, tracked alike, has 0 is 1; their
EP, HC and EC are never 0. Before 2025-09-29 the filter changed the columns but not the score ("old
filter").

NAVSIM drives a plan by nuPlan's two-stage LQR and a kinematic bicycle with lags, at 10 Hz. The
tracker knows a plan's poses alone. It fits speeds v_k and curvatures kappa_k to the displacements
d_k and turns theta_k between them, h = `STEP_S`:

(1) d_k = h v_k (cos yaw_k, sin yaw_k),   v_k = v_0 + h (a_0 + ... + a_(k-1))
    least squares + `JERK_PENALTY` (a_0^2 + ... + a_(n-4)^2 + (a_(n-2) - a_(n-3))^2):
        meant are the differences of all, but the original's -1 overwrite its +1 except in the last
        row
(2) theta_k = h v_k kappa_k,   kappa_k = kappa_0 + h (c_0 + ...)
    least squares + `CURVATURE_PENALTY` sum of c_k^2 + 1e-10 kappa_0^2

Then, as in `replan.planners.pdm.lqr_tracker` (1), (2) with those v and kappa, and its (3) with the
Euler rule: positions, heading and steering move with the speed, heading and steering before the
step. NAVSIM's tracker has the wheelbase of nuPlan's car (`NUPLAN_WHEELBASE_M`) whatever the car is.

Source: autonomousvision/navsim 0a380a90, planner/pdm_planner/simulation (Apache-2.0; formulae
only).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import atan2, cos, hypot, pi, prod, sin, tan
from types import MappingProxyType

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.errors import ConfigError
from replan.core.kernel import kernel
from replan.logs.polylines import along_line
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.shapes import overlap
from replan.logs.states import wrapped
from replan.metrics.boxes import BEHIND, NO_TTC_MPS, STANDING_MPS, EgoOutline
from replan.metrics.comfort import savgol
from replan.metrics.devkit_lanes import DevkitLanes, devkit_lanes
from replan.metrics.nuplan_closed_loop import AHEAD, comfort_signals, comfortable, corners_of
from replan.planners.pdm.lqr_tracker import (
    ACCEL_LAG_S,
    AHEAD as STEPS_AHEAD,
    Q_HEADING,
    Q_OFFSET,
    Q_SPEED,
    STEER_LAG_S,
    STOPPING_GAIN,
    STOPPING_MPS,
)
from replan.score.window import (
    Polyline,
    RoadblockRoute,
    WindowAgents,
    box_on_polygon,
    center_line,
    red_lanes,
    route_of,
)

HORIZON_S, PAST_S = 4.0, 1.5
STEP_S, POSE_S, POSES = 0.1, 0.5, 8
LEAST_WAY_M = 5.0
STEPS = round(HORIZON_S / STEP_S) + 1
NUPLAN_CAR = EgoOutline(1.461, 5.176, 2.297, 1.461 + 0.5 * 5.176)
"""The Pacifica of nuPlan: rear axle to centre, length, width, rear axle to front, m."""
CARRIED = (0, 3, 6, 9)
KEEPING_M, KEEPING_STEPS, AGAINST_M = 0.5, 20, (2.0, 6.0)
EC_BOUNDS = (0.7, 0.5, 0.1, 0.1)
NO_LANES = "the log has no lanes: the scores of nuPlan and NAVSIM need them"


@dataclass(frozen=True)
class Version:
    """What a version of NAVSIM does."""

    columns: Mapping[str, str]  # The original's column of each part, in its order
    multipliers: tuple[str, ...]  # Parts that multiply the weighted mean; `weights` by part
    weights: Mapping[str, float]
    # Whether the human filter changes the columns; `scores_filtered` whether it changes the score,
    # too
    filters: bool
    scores_filtered: bool
    masks: bool  # Whether EP is that after the own multipliers
    drops: bool  # Whether agents that touch the ego at the start are left out
    # For how long others are seen, s; `ttc_steps` is the number of states that TTC looks at
    seen_s: float
    ttc_steps: int
    past: bool  # Whether comfort begins with the recorded past, and is that of the centre
    # Filters of acceleration and jerk (`replan.metrics.nuplan_closed_loop.comfort_signals`)
    windows: tuple[int, int]


_V1 = Version(
    columns={
        "NC": "no_at_fault_collisions",
        "DAC": "drivable_area_compliance",
        "EP": "ego_progress",
        "TTC": "time_to_collision_within_bound",
        "HC": "comfort",
        "DDC": "driving_direction_compliance",
    },
    multipliers=("NC", "DAC"),
    weights={"EP": 5.0, "TTC": 5.0, "HC": 2.0},
    filters=False,
    scores_filtered=False,
    masks=True,
    drops=False,
    seen_s=5.0,
    ttc_steps=STEPS,
    past=False,
    windows=(STEPS, STEPS),
)
_V2 = Version(
    columns={
        "NC": "no_at_fault_collisions",
        "DAC": "drivable_area_compliance",
        "DDC": "driving_direction_compliance",
        "TLC": "traffic_light_compliance",
        "EP": "ego_progress",
        "TTC": "time_to_collision_within_bound",
        "LK": "lane_keeping",
        "HC": "history_comfort",
        "EC": "two_frame_extended_comfort",
    },
    multipliers=("NC", "DAC", "DDC", "TLC"),
    weights={"EP": 5.0, "TTC": 5.0, "LK": 2.0, "HC": 2.0, "EC": 2.0},
    filters=True,
    scores_filtered=True,
    masks=False,
    drops=True,
    seen_s=4.0,
    ttc_steps=STEPS - CARRIED[-1],
    past=True,
    windows=(8, 15),
)
VERSIONS: Mapping[str, Version] = MappingProxyType(
    {
        "navsim-v1": _V1,
        "navsim-v2": _V2,
        "navsim-v2-old-filter": replace(_V2, scores_filtered=False),
    }
)
"""The versions by the name of `--as`."""


@dataclass(frozen=True, eq=False)
class Ground:
    """The map of a window: lanes, route, PDM-Closed's first lane and centre line, the red lanes at
    each step.
    """

    lanes: DevkitLanes
    route: RoadblockRoute
    first: int
    center: Polyline
    red: tuple[frozenset[int], ...]


@dataclass(frozen=True, eq=False)
class ScoredWindow:
    """The begin of a window: time, the tracker's first state `(9,)`, the log and its map.

    `states` are the tracked states of the plan `(41, 9)`.
    """

    t: float
    start: FloatArray
    scenario: Scenario
    ground: Ground
    states: FloatArray = field(default_factory=lambda: np.empty((0, 9)))

    @property
    def box(self) -> tuple[float, float, float, float, float]:
        """The ego's box at the begin: centre x, y and yaw in the world, length and width."""
        (x, y, yaw), car = self.start[[X, Y, YAW]].tolist(), self.scenario.vehicle
        return (
            x + car.axle_to_center * cos(yaw),
            y + car.axle_to_center * sin(yaw),
            yaw,
            car.length,
            car.width,
        )


def window_at(scenario: Scenario, t: float) -> ScoredWindow:
    """Return the window of a log that begins at `t`, s.

    ConfigError if the log has no lanes, its driver is on none of them, or it does not last for 4 s
    more.
    """
    lanes = None if scenario.road.source is RoadSource.DRIVEN_PATH else devkit_lanes(scenario.road)
    if lanes is None:
        raise ConfigError(f"{scenario.name}: {NO_LANES}")
    first, last = float(scenario.ego.t[0]), float(scenario.ego.t[-1])
    if not first - 1e-6 <= t <= last - HORIZON_S + 1e-2:
        raise ConfigError(
            f"{scenario.name}: no window of {HORIZON_S:g} s begins at {t:.3f} s: the log's drive "
            f"lasts from {first:.1f} to {last:.1f} s; choose times up to {last - HORIZON_S:.1f} s"
        )
    route = route_of(scenario, lanes)
    ego = scenario.ego.resampled(np.array([max(t, first)])).state(0)
    if not route.blocks:
        raise ConfigError(f"{scenario.name}: the log's driver is on no lane: there is no route")
    begin, center = center_line(lanes, route, ego.x, ego.y, ego.yaw)
    shown = [red_lanes(scenario, lanes, route, t + POSE_S * k) for k in range(POSES + 1)]
    red = tuple(shown[int(STEP_S * k / POSE_S + 1e-6)] for k in range(STEPS))
    start = np.array([ego.x, ego.y, ego.yaw, ego.v, ego.a, ego.v**2 * ego.kappa, 0.0, 0.0, 0.0])
    return ScoredWindow(t, start, scenario, Ground(lanes, route, begin, center, red))


def driven(window: ScoredWindow, poses: FloatArray) -> FloatArray:
    """Return the tracked states `(41, 9)` of a plan: eight poses x, y, yaw `(8, 3)`."""
    whole = np.vstack([window.start[[X, Y, YAW]], poses])
    whole[:, 2] = np.unwrap(whole[:, 2])
    times, fine = POSE_S * np.arange(POSES + 1), STEP_S * np.arange(STEPS)
    dense = np.column_stack([np.interp(fine, times, column) for column in whole.T])
    return simulated(dense, window.start, window.scenario.vehicle.wheelbase)


def human_poses(window: ScoredWindow) -> FloatArray:
    """Return the poses `(8, 3)` of the log's driver in a window."""
    log = window.scenario.ego
    states = log.resampled(np.minimum(window.t + POSE_S * np.arange(1, POSES + 1), log.t[-1]))
    return np.column_stack([states.x, states.y, states.yaw])


def judged(
    states: FloatArray, others: WindowAgents, ground: Ground, version: Version
) -> tuple[dict[str, float], float]:
    """Return the parts of tracked states `(41, 9)` except EP, HC, EC, and the way along the centre
    line, m.
    """
    car, lanes, n = NUPLAN_CAR, ground.lanes, len(states)
    yaw = np.ascontiguousarray(states[:, YAW])
    x, y = states[:, X] + car.axle * np.cos(yaw), states[:, Y] + car.axle * np.sin(yaw)
    corner_x, corner_y = corners_of(x, y, yaw, car)
    under = np.array([lanes.under(*corner) for corner in zip(corner_x, corner_y, strict=True)])
    on_road = np.array(
        [lanes.in_area(*corner) for corner in zip(corner_x, corner_y, strict=True)]
    ) | under.any(axis=1)
    off, corners = ~on_road.all(axis=0), under.sum(axis=0)
    astray = off | (((corners > 0).sum(axis=0) > 1) & (corners != 4).all(axis=0))
    center, crossing = lanes.under(x, y), lanes.in_intersection(x, y)
    wide = astray | lanes.in_intersection(
        np.ascontiguousarray(states[:, X]), np.ascontiguousarray(states[:, Y])
    )
    collided, close = _meetings(
        np.ascontiguousarray(states), np.stack([x, y]), others, astray, wide, version.ttc_steps
    )
    lost = ~center[sorted(ground.route.lanes)].any(axis=0) & ~crossing
    moved = np.r_[0.0, np.hypot(np.diff(x), np.diff(y))] * lost
    worst = max(moved[max(0, k - 10) : k + 1].sum() for k in range(n))
    touched = any(
        box_on_polygon(x[k], y[k], yaw[k], car.length, car.width, lanes.lanes[i].polygon) == 0.0
        for k in range(n)
        for i in ground.red[min(k, len(ground.red) - 1)]
    )
    away, run, longest = along_line(ground.center.points, x, y)[1], 0, 0
    for k in np.flatnonzero(~crossing).tolist():
        run = run + 1 if away[k] > KEEPING_M else 0
        longest = max(longest, run)
    direction = 0.5 if worst < AGAINST_M[1] else 0.0
    parts = {
        "NC": collided,
        "DAC": float(not off.any()),
        "DDC": 1.0 if worst < AGAINST_M[0] else direction,
        "TLC": float(not touched),
        "TTC": float(not close),
        "LK": float(longest < KEEPING_STEPS),
    }
    return parts, max(ground.center.station(x[-1], y[-1]) - ground.center.station(x[0], y[0]), 0.0)


@kernel
def _meetings(
    states: FloatArray,
    box: FloatArray,
    others: WindowAgents,
    astray: BoolArray,
    wide: BoolArray,
    ttc_steps: int,
) -> tuple[float, bool]:
    """Return NC, and whether the ego comes too close in time to an agent; `box` is its centre
    `(2, k)`.
    """
    car, score, close = NUPLAN_CAR, 1.0, False
    for i in range(len(others.size)):
        length, width = others.size[i, 0], others.size[i, 1]
        reach = 0.5 * (hypot(car.length, car.width) + hypot(length, width))
        stands = not others.agent[i] or others.speed[i] <= STANDING_MPS
        for k in range(len(states)):
            px, py, heading = others.pose[0, i, k], others.pose[1, i, k], others.pose[2, i, k]
            yaw, x, y = states[k, YAW], box[0, k], box[1, k]
            if not others.there[i, k] or hypot(px - x, py - y) > reach:
                continue
            if not overlap(x, y, yaw, car.length, car.width, px, py, heading, length, width):
                continue
            dx, dy = px - states[k, X], py - states[k, Y]
            behind = dx * cos(yaw) + dy * sin(yaw) < BEHIND * hypot(dx, dy)
            nose_x, nose_y = (
                states[k, X] + car.front * cos(yaw),
                states[k, Y] + car.front * sin(yaw),
            )
            at_fault = abs(states[k, V]) > STANDING_MPS and (
                stands
                or (
                    not behind
                    and (
                        overlap(nose_x, nose_y, yaw, 0.0, car.width, px, py, heading, length, width)
                        or astray[k]
                    )
                )
            )
            if not at_fault:
                break
            score = min(score, 0.0 if others.agent[i] else 0.5)
        has_met = close
        for k in range(ttc_steps):
            yaw, v = states[k, YAW], abs(states[k, V])
            if has_met or v < NO_TTC_MPS:
                continue
            for after in CARRIED:
                px, py = others.pose[0, i, k + after], others.pose[1, i, k + after]
                heading = others.pose[2, i, k + after]
                x = box[0, k] + STEP_S * after * v * cos(yaw)
                y = box[1, k] + STEP_S * after * v * sin(yaw)
                if has_met or not others.there[i, k + after] or hypot(px - x, py - y) > reach:
                    continue
                if overlap(x, y, yaw, car.length, car.width, px, py, heading, length, width):
                    dx, dy = px - states[k, X], py - states[k, Y]
                    ahead, away = dx * cos(yaw) + dy * sin(yaw), hypot(dx, dy)
                    close = close or ahead > AHEAD * away or (wide[k] and ahead >= BEHIND * away)
                    has_met = True
    return score, close


def multiplied(parts: Mapping[str, float], version: Version) -> float:
    """Return the product of the multipliers."""
    return prod(parts[name] for name in version.multipliers)


def progress(own: float, best: float, *, multiplier: float, masks: bool) -> float:
    """Return EP of a way, m, where the greatest way times its multipliers is `best`."""
    if best <= LEAST_WAY_M:
        return float(multiplier > 0.0) if masks else 1.0
    return float(np.clip(own * (multiplier if masks else 1.0) / best, 0.0, 1.0))


def history_comfort(window: ScoredWindow, states: FloatArray, version: Version) -> float:
    """Return HC of tracked states."""
    if version.past:
        states = np.vstack([_past(window), states])
    turn, ahead = states[:, TURN], NUPLAN_CAR.axle if version.past else 0.0
    lon = states[:, A] + ahead * (turn**2 + states[:, TURN_RATE])
    whole, yaw = np.hypot(states[:, A], states[:, LATERAL]), np.unwrap(states[:, YAW])
    return float(
        comfortable(comfort_signals(lon, states[:, LATERAL], whole, yaw, STEP_S, version.windows))
    )


def _past(window: ScoredWindow) -> FloatArray:
    """Return the recorded states `(n, 9)` from 1.5 to 0.2 s before: the original leaves out the
    last one.
    """
    log = window.scenario.ego
    sampled = window.t + POSE_S * np.arange(-3, 1)
    sampled = np.unique(np.clip(sampled, log.t[0], log.t[-1]))
    times = window.t + STEP_S * np.arange(-15, -1)
    times, logged = times[times >= log.t[0] - 1e-6], log.resampled(sampled)
    states = np.zeros((len(times), 9))
    columns = {
        X: logged.x,
        Y: logged.y,
        YAW: logged.yaw,
        V: logged.v,
        A: logged.a,
        LATERAL: logged.v**2 * logged.kappa,
    }
    for column, values in columns.items():
        states[:, column] = np.interp(times, sampled, values)
    return states


def extended_comfort(now: FloatArray, before: FloatArray, steps: int) -> float:
    """Return EC of tracked states and those of the plan `steps` steps earlier."""

    def features(states: FloatArray) -> tuple[FloatArray, ...]:
        size = savgol(np.hypot(states[:, A], states[:, LATERAL]), 8, 2)
        yaw = np.unwrap(states[:, YAW])
        turns = (savgol(yaw, 5, 2, order, STEP_S) for order in (1, 2))
        return size, savgol(size, 15, 2, 1, STEP_S), *turns

    differences = zip(features(now[:-steps]), features(before[steps:]), strict=True)
    rms = [np.sqrt(np.mean((current - previous) ** 2)) for current, previous in differences]
    return float(all(size <= bound for size, bound in zip(rms, EC_BOUNDS, strict=True)))


JERK_PENALTY, CURVATURE_PENALTY, FIRST_PENALTY = 1e-4, 1e-2, 1e-10
MAX_STEER, NUPLAN_WHEELBASE_M = pi / 3.0, 3.089
X, Y, YAW, V, A, LATERAL, STEER, TURN, TURN_RATE = range(9)
"""Columns of a state: rear axle, speed, acceleration, lateral acceleration, steering angle, yaw
rate and its rate.
"""


def fitted(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the speeds (1) and curvatures (2) `(n - 1,)` of poses x, y, yaw `(n, 3)`."""
    moved, turned = np.diff(poses[:, :2], axis=0), wrapped(np.diff(poses[:, 2]))
    m, h = len(moved), STEP_S
    ahead = np.column_stack([np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])]).reshape(-1, 1)
    lower = np.repeat(np.tri(m), 2, axis=0)
    design = ahead * lower * np.r_[h, np.full(m - 1, h * h)]
    penalty = np.zeros((m - 2, m))
    penalty[:, 2:] = np.eye(m - 2)
    penalty[:, 1:-1] = -np.eye(m - 2)  # over the ones of the line above, as in the devkit
    normal = np.linalg.pinv(design.T @ design + JERK_PENALTY * penalty.T @ penalty)
    solution = normal @ design.T @ moved.reshape(-1)
    speed = solution[0] + np.r_[0.0, np.cumsum(solution[1:] * h)]
    design = np.tri(m)
    design[:, 0] = speed * h
    design[1:, 1:] *= (speed * h * h)[1:, None]
    weights = np.full(m, CURVATURE_PENALTY)
    weights[0] = FIRST_PENALTY
    solution = np.linalg.pinv(design.T @ design + np.diag(weights)) @ design.T @ turned
    return speed, solution[0] + np.r_[0.0, np.cumsum(solution[1:] * h)]


def simulated(poses: FloatArray, start: FloatArray, wheelbase: float) -> FloatArray:
    """Return the states `(n, 9)` of the car that follows poses `(n, 3)` from the state `start`
    `(9,)`.
    """
    speed, kappa = fitted(poses)
    return _follow(np.ascontiguousarray(poses), speed, kappa, start, wheelbase)


@kernel
def _follow(
    poses: FloatArray, speed: FloatArray, kappa: FloatArray, start: FloatArray, wheelbase: float
) -> FloatArray:
    states, last, h = np.zeros((len(poses), 9)), len(speed) - 1, STEP_S
    states[0] = start
    for k in range(len(poses) - 1):
        x, y, yaw = states[k, X], states[k, Y], states[k, YAW]
        v, a, steer = states[k, V], states[k, A], states[k, STEER]
        ahead = min(k + STEPS_AHEAD, last)
        if speed[ahead] <= STOPPING_MPS and v <= STOPPING_MPS:
            accel, rate = STOPPING_GAIN * (speed[ahead] - v), 0.0
        else:
            span = h * STEPS_AHEAD
            accel = span * Q_SPEED * (speed[ahead] - v) / (span * span * Q_SPEED + 1.0)
            e = (y - poses[k, 1]) * cos(poses[k, 2]) - (x - poses[k, 0]) * sin(poses[k, 2])
            psi = atan2(sin(yaw - poses[k, 2]), cos(yaw - poses[k, 2]))
            e1, psi1, steer1 = 0.0, 0.0, 0.0
            for i in range(STEPS_AHEAD):
                moved = h * (v + i * h * accel)
                e, psi = (
                    e + moved * psi,
                    psi + moved * (steer / NUPLAN_WHEELBASE_M - kappa[min(k + i, ahead)]),
                )
                e1, psi1, steer1 = (
                    e1 + moved * psi1,
                    psi1 + moved * steer1 / NUPLAN_WHEELBASE_M,
                    steer1 + h,
                )
            psi = atan2(sin(psi), cos(psi))
            rate = -(Q_OFFSET * e1 * e + Q_HEADING * psi1 * psi) / (
                Q_OFFSET * e1**2 + Q_HEADING * psi1**2 + 1.0
            )
        states[k + 1, X], states[k + 1, Y] = x + h * v * cos(yaw), y + h * v * sin(yaw)
        states[k + 1, YAW] = yaw + h * v * tan(steer) / wheelbase
        states[k + 1, A] = a + h / (h + ACCEL_LAG_S) * (accel - a)
        states[k + 1, V] = v + h * states[k + 1, A]
        states[k + 1, STEER] = min(
            max(steer + h / (h + STEER_LAG_S) * h * rate, -MAX_STEER), MAX_STEER
        )
        states[k + 1, TURN] = states[k + 1, V] * tan(states[k + 1, STEER]) / wheelbase
        states[k + 1, TURN_RATE] = (states[k + 1, TURN] - states[k, TURN]) / h
    return states
