"""Distances between the ego's box and those of the others, closed loop: in the scene, along the
way, and when the ego passes pedestrians and riders.
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, hypot, inf, sin

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import kernel
from replan.logs.scenario import Scenario
from replan.logs.shapes import distance
from replan.logs.trace import Trace
from replan.metrics.boxes import (
    STANDING_MPS,
    EgoOutline,
    OtherBoxes,
    car_of,
    distance_bound,
    ego_boxes,
    indices_of,
    is_behind,
    labels_of,
    pieces,
)
from replan.metrics.metric import Measured, Series, Unavailable, metric
from replan.metrics.reductions import MIN, time_below

# Required distance when passing, by the ego's speed, linear between
PASSING_MPS, PASSING_M = (3.0, 5.0), (0.5, 1.0)
LEAVING_MPS = 0.5  # An agent that moves away sideways this fast has crossed and is not being passed


@kernel
def _gaps(
    ego: FloatArray,
    car: EgoOutline,
    others: OtherBoxes,
    counted: BoolArray,
    judged: BoolArray,
    recent: int,
) -> tuple[FloatArray, IntArray]:
    """Return for each step the least distance to a wanted agent that is `there` (NaN: none) and its
    index (-1).

    `recent` is the previous nearest agent, which is tried first.
    """
    pose, size, steps = others.pose, others.size, counted.shape[1]
    gap, nearest = np.full(steps, np.nan), np.full(steps, -1, np.int64)
    for k in range(steps):
        best = inf
        for turn in range(len(size)):
            i = (recent + turn) % len(size)
            x, y, yaw = ego[0, k], ego[1, k], ego[2, k]
            if not (judged[i] and counted[i, k]) or distance_bound(x, y, car, others, i, k) >= best:
                continue
            px, py, heading = pose[0, i, k], pose[1, i, k], pose[2, i, k]
            gap_m = distance(
                x, y, yaw, car.length, car.width, px, py, heading, size[i, 0], size[i, 1]
            )
            if gap_m < best or nearest[k] < 0:
                best, nearest[k], gap[k] = gap_m, i, gap_m
        recent = max(nearest[k], 0)
    return gap, nearest


@kernel
def _approachable(
    ego: FloatArray, car: EgoOutline, others: OtherBoxes, leaving: float
) -> BoolArray:
    """Return which agents a moving ego passes or approaches `(n, k)`: not behind, nor moving aside
    at `leaving` m/s.
    """
    present, pose = others.there, others.pose
    approachable = present.copy()
    for k in range(present.shape[1]):
        x, y, yaw = ego[0, k], ego[1, k], ego[2, k]
        stands = hypot(ego[3, k], ego[4, k]) <= STANDING_MPS
        for i in range(len(present)):
            behind = is_behind(
                x - car.axle * cos(yaw), y - car.axle * sin(yaw), yaw, pose[0, i, k], pose[1, i, k]
            )
            left = (pose[1, i, k] - y) * cos(yaw) - (pose[0, i, k] - x) * sin(yaw)
            away = (pose[4, i, k] * cos(yaw) - pose[3, i, k] * sin(yaw)) * (
                1.0 if left > 0.0 else -1.0
            )
            approachable[i, k] = present[i, k] and not stands and not behind and away < leaving
    return approachable


def judged_agents(trace: Trace, vulnerable_only: bool) -> BoolArray:
    """Return which agents are considered `(n,)`: all, or pedestrians and riders."""
    kinds = trace.agents.kinds
    return np.array([kind.is_vulnerable or not vulnerable_only for kind in kinds], np.bool_)


def no_agents(vulnerable_only: bool, where: str = "in the scene") -> Unavailable:
    """Return the reason of a drive without such agents."""
    agent = "pedestrian or rider" if vulnerable_only else "other road user"
    return Unavailable(f"no {agent} {where}")


def _least_gap(
    trace: Trace,
    scenario: Scenario,
    *,
    vulnerable_only: bool,
    kept: bool = False,
    leaving: float = inf,
) -> Measured:
    """Measure the least distance to agents; `kept`: only to those that `_approachable` names."""
    judged = judged_agents(trace, vulnerable_only)
    if not judged.any():
        return no_agents(vulnerable_only)
    ego, car = ego_boxes(trace.ego, scenario), car_of(scenario)
    gap, agents = np.full(len(trace.ego), np.nan), np.full(len(trace.ego), -1)
    recent = 0
    for steps, present, others in pieces(trace.agents, trace.ego.t):
        counted = others.there
        if kept:
            counted = _approachable(ego[:, steps], car, others, leaving)
        first = int(np.searchsorted(present, recent)) % max(len(present), 1)
        gap[steps], row = _gaps(ego[:, steps], car, others, counted, judged[present], first)
        agents[steps] = indices_of(present, row)
        recent = max(int(agents[steps.stop - 1]), 0)
    where = "beside or ahead of an ego that drives" if kept else "in the scene"
    missing = no_agents(vulnerable_only, where).reason
    return Series(trace.ego.t, gap, labels_of(trace, agents), missing)


_WITHIN_20_CM = (MIN, time_below(0.2, "time_below_20cm"))
_WITHIN_50_CM = (MIN, time_below(0.5, "time_below_50cm"))


@metric(unit="m", better="higher", reductions=_WITHIN_20_CM, needs="other road users")
def gap(trace: Trace, scenario: Scenario) -> Measured:
    """Least distance between the ego's box and another's, 0 where they touch.

    Formula: min over the others of the distance of the boxes
    """
    return _least_gap(trace, scenario, vulnerable_only=False)


@metric(unit="m", better="higher", reductions=_WITHIN_50_CM, needs="a pedestrian or rider")
def gap_vulnerable(trace: Trace, scenario: Scenario) -> Measured:
    """Least distance to a pedestrian or rider.

    Formula: as gap
    """
    return _least_gap(trace, scenario, vulnerable_only=True)


@metric(unit="m", better="higher", reductions=_WITHIN_20_CM, needs="another road user")
def gap_kept(trace: Trace, scenario: Scenario) -> Measured:
    """Least distance that the ego leaves to another as it drives: not to those behind, and none
    while it stands.

    Formula: as gap, while the ego moves (above 0.05 m/s) and of agents not more than 150 degrees
    off its heading
    """
    return _least_gap(trace, scenario, vulnerable_only=False, kept=True)


@metric(unit="m", better="higher", reductions=_WITHIN_50_CM, needs="a pedestrian or rider")
def gap_kept_vulnerable(trace: Trace, scenario: Scenario) -> Measured:
    """Least distance that the ego leaves to a pedestrian or rider as it drives.

    Formula: as gap, while the ego moves (above 0.05 m/s) and of agents not more than 150 degrees
    off its heading
    """
    return _least_gap(trace, scenario, vulnerable_only=True, kept=True)


@metric(
    unit="m",
    better="higher",
    reductions=(MIN, time_below(0.0, "time_too_near")),
    parameters=(f"going away: {LEAVING_MPS} m/s",),
    needs="a pedestrian or rider",
)
def passing_room(trace: Trace, scenario: Scenario) -> Measured:
    """Least distance to a pedestrian or rider who is passed, less what the ego's speed asks for.

    Formula: as gap, while the ego moves (above 0.05 m/s) and of agents not more than 150 degrees
    off its heading nor going away to the side; less 0.5 m up to 3 m/s, 1 m from 5 m/s on, linear
    between
    """
    series = _least_gap(trace, scenario, vulnerable_only=True, kept=True, leaving=LEAVING_MPS)
    if isinstance(series, Unavailable):
        return series
    required = np.interp(np.abs(trace.ego.v), PASSING_MPS, PASSING_M)
    return replace(series, value=series.value - required)
