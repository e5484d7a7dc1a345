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
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import cos, hypot, prod, sin
from types import MappingProxyType

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.errors import ConfigError
from replan.core.kernel import kernel
from replan.logs.polylines import along_line
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.shapes import overlap
from replan.metrics.boxes import BEHIND, NO_TTC_MPS, STANDING_MPS, EgoOutline
from replan.metrics.comfort import savgol
from replan.metrics.devkit_lanes import DevkitLanes, devkit_lanes
from replan.metrics.nuplan_closed_loop import AHEAD, comfort_signals, comfortable, corners_of
from replan.score.navsim_tracker import LATERAL, STEP_S, TURN, TURN_RATE, YAW, A, V, X, Y, simulated
from replan.score.window import (
    Polyline,
    RoadblockRoute,
    WindowAgents,
    box_on_polygon,
    center_line,
    red_lanes,
    route_of,
)

HORIZON_S = 4.0  # Length of a plan, s
PAST_S = 1.5  # Length of the recorded past, s
POSE_S = 0.5  # Time between the poses of a plan, s
POSES = 8  # Number of poses of a plan
LEAST_WAY_M = 5.0  # EP is 1 where no way is longer than this, m
STEPS = round(HORIZON_S / STEP_S) + 1
NUPLAN_CAR = EgoOutline(1.461, 5.176, 2.297, 1.461 + 0.5 * 5.176)
"""The Pacifica of nuPlan: rear axle to centre, length, width, rear axle to front, m."""
CARRIED = (0, 3, 6, 9)  # Steps for which TTC moves the ego on
KEEPING_M = 0.5  # Largest offset of LK, m
KEEPING_STEPS = 20  # States in a row beyond it that LK permits, less one
AGAINST_STEPS = 10  # Steps of the span of DDC
AGAINST_M = (2.0, 6.0)  # Ways off the route in it with which DDC is 1/2, and 0, m
EC_BOUNDS = (0.7, 0.5, 0.1, 0.1)  # m/s2, m/s3, rad/s, rad/s2
NO_LANES = "the log has no lanes: the scores of nuPlan and NAVSIM need them"


@dataclass(frozen=True)
class Version:
    """What a version of NAVSIM does.

    Attributes:
        columns: The original's column of each part, in its order.
        multipliers: Parts that multiply the weighted mean.
        weights: Weights in the mean, by part.
        filters: Whether the human filter changes the columns.
        scores_filtered: Whether it changes the score, too.
        masks: Whether EP is that after the own multipliers.
        drops: Whether agents that touch the ego at the start are left out.
        seen_s: For how long others are seen, s.
        ttc_steps: Number of states that TTC looks at.
        past: Whether comfort begins with the recorded past, and is that of the centre.
        windows: Filters of acceleration and jerk
            (`replan.metrics.nuplan_closed_loop.comfort_signals`).
    """

    columns: Mapping[str, str]
    multipliers: tuple[str, ...]
    weights: Mapping[str, float]
    filters: bool
    scores_filtered: bool
    masks: bool
    drops: bool
    seen_s: float
    ttc_steps: int
    past: bool
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
    worst = max(moved[max(0, k - AGAINST_STEPS) : k + 1].sum() for k in range(n))
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
