"""Braking, standing and steering without a reason, and missing braking; closed loop, every 0.1 s.

With the reasons of `reasons`:

(1) needless_braking(t) = highest speed since the last reason - v(t)
(2) needless_standing(t) = 1 where v < 0.5 m/s and no reason is within 10 m of its front,
        and no stop line within `LINE_M`
(3) needless_steering: each change of the offset from the route by 0.5 m to 2 m between two turning
    points, if no road user and no curve is near in its first half

False braking is hard braking without a cause. A planner that avoids it may miss braking instead, so
both are measured:

(4) A hard episode: steps every `GRID_S` with a < -`HARD_MPS2`, less than `APART_S` apart.
(5) It had a cause if, within `CAUSE_S` of its begin, the box of any road user came within `CAUSE_M`
    of the strip that the ego sweeps from there: along its drive, straight beyond its end, for the
    distance that it would cover at its speed.
(6) missed(t) = max((v - u)^2 / (2 gap) - b, 0) for the lead in the path ahead (`lead`)
        with gap and u, v > u, and the ego's deceleration b: the deceleration of a steady approach
        that the ego does not apply.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from math import cos, sin

import numpy as np

from replan.core.arrays import FloatArray, arc_lengths
from replan.core.kernel import kernel
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Trace
from replan.metrics.boxes import (
    GRID_S,
    EgoOutline,
    OtherBoxes,
    car_of,
    grid_of,
    labels_of,
    others_at,
    touches,
)
from replan.metrics.lead import ahead_of
from replan.metrics.metric import Measured, Series, metric
from replan.metrics.reasons import (
    AFTER_S,
    COMING_S,
    EASE_MPS2,
    HEADWAY_S,
    NEAR_M,
    STANDS_MPS,
    reasons,
)
from replan.metrics.reductions import COUNT, MAX, RATE, worst_episode

SWING_M, CHANGE_M, FALL_MPS = 0.5, 2.0, 0.5
HARD_MPS2, APART_S = 3.5, 0.5
CAUSE_S, CAUSE_M = 5.0, 0.3
SPACING_M = 0.5  # Distance between the boxes of the ego whose union approximates the strip
TOUCHING_M = 0.5  # Least gap in (6): nearer road users are contacts
_needless_metric = partial(
    metric,
    better="lower",
    parameters=(
        f"look {NEAR_M:g} m + {HEADWAY_S:g} s v + (v - u)^2 / {2.0 * EASE_MPS2:g} m/s2",
        f"coming within {COMING_S:g} s",
        f"a reason lasts {AFTER_S:g} s longer",
    ),
)


@_needless_metric(unit="m/s", reductions=(MAX,), needs="a time without a reason to brake")
def needless_braking(trace: Trace, scenario: Scenario) -> Measured:
    """Speed that the ego lost while no road user, rule, limit, curve, goal or end of the route
    ahead called for it.

    Formula: highest speed since the last reason - v
    """
    ego = reasons(trace, scenario)
    lost, top = np.full(len(ego.t), np.nan), -np.inf
    for k in np.flatnonzero(~ego.slow):
        if k and ego.slow[k - 1]:
            top = -np.inf
        top = max(ego.v[k], top)
        lost[k] = top - ego.v[k]  # (1)
    return Series(ego.t, lost, missing="something called for it all the time")


@_needless_metric(unit="1", reductions=(worst_episode(-np.inf, 0.5),))
def needless_standing(trace: Trace, scenario: Scenario) -> Measured:
    """1 while the ego stands and no reason to stand is near.

    Formula: [v < 0.5 m/s and no reason within 10 m ahead, no stop line within 6 m]
    """
    ego = reasons(trace, scenario)
    return Series(ego.t, ((np.abs(ego.v) < STANDS_MPS) & ~ego.stand).astype(float))  # (2)


@_needless_metric(unit="count", reductions=(COUNT,))
def needless_steering(trace: Trace, scenario: Scenario) -> Measured:
    """Swings of the ego's offset from the route by 0.5 m to 2 m with no road user and no curve
    near.

    Formula: sum of the changes between two turning points
    """
    ego = reasons(trace, scenario)
    counts = np.zeros(len(ego.t))
    for first, last in pairwise(turning_points(ego.l, SWING_M)):
        half = (first + last) // 2
        small = abs(ego.l[last] - ego.l[first]) < CHANGE_M
        if small and not ego.steer[first : half + 1].any():
            counts[last] += 1.0  # (3)
    return Series(ego.t, counts)


def turning_points(value: FloatArray, least: float) -> list[int]:
    """Return the steps at which a value turns back by at least `least`, and the ends of the first
    and last change.
    """
    turns: list[int] = []
    rising, low, high = 0, 0, 0
    for k in range(len(value)):
        low = k if value[k] < value[low] else low
        high = k if value[k] > value[high] else high
        if rising >= 0 and value[high] - value[k] >= least:
            turns.append(high)
            rising, low, high = -1, k, k
        elif rising <= 0 and value[k] - value[low] >= least:
            turns.append(low)
            rising, low, high = 1, k, k
    if turns:
        turns.append(high if rising > 0 else low)
    return turns


def hard_episodes(ego: Trajectory) -> list[int]:
    """The steps at which the episodes (4) begin."""
    hard = np.flatnonzero(ego.a < -HARD_MPS2)
    return [
        int(k)
        for i, k in enumerate(hard)
        if i == 0 or ego.t[k] - ego.t[hard[i - 1]] > APART_S + 1e-9
    ]


@kernel
def _any_touches(way: FloatArray, car: EgoOutline, others: OtherBoxes) -> bool:
    """Return whether any of the boxes `(n, k)` overlaps the ego at any pose of its rear axle: x, y,
    yaw `(3, m)`.
    """
    for j in range(way.shape[1]):
        x, y, yaw = (
            way[0, j] + car.axle * cos(way[2, j]),
            way[1, j] + car.axle * sin(way[2, j]),
            way[2, j],
        )
        for i in range(others.there.shape[0]):
            for k in range(others.there.shape[1]):
                if others.there[i, k] and touches(x, y, yaw, car, others, i, k):
                    return True
    return False


@metric(
    unit="1",
    better="lower",
    reductions=(RATE, COUNT),
    parameters=(
        f"hard below -{HARD_MPS2:g} m/s2",
        f"apart {APART_S:g} s",
        f"near {CAUSE_M:g} m",
        f"within {CAUSE_S:g} s",
    ),
    needs="a hard braking",
)
def false_braking(trace: Trace, scenario: Scenario) -> Measured:
    """1 where a hard braking begins after which no road user comes near the ego's way, 0 where one
    does.

    Formula: [no road user within 0.3 m of the way ahead within 5 s]
    """
    ego, car = grid_of(trace), car_of(scenario)
    wider, false = car._replace(width=car.width + 2.0 * CAUSE_M), np.full(len(ego.t), np.nan)
    for k in hard_episodes(ego):
        begin = float(ego.t[k])
        drive = trace.ego.resampled(np.r_[begin, trace.ego.t[trace.ego.t > begin]])
        s = arc_lengths(drive.x, drive.y)
        stations = np.arange(0.0, max(float(drive.v[0]), 0.0) * CAUSE_S + SPACING_M, SPACING_M)
        beyond = np.maximum(stations - s[-1], 0.0)
        x, y, yaw = (np.interp(stations, s, column) for column in (drive.x, drive.y, drive.yaw))
        path = np.stack([x + beyond * np.cos(yaw), y + beyond * np.sin(yaw), yaw])
        t = begin + GRID_S * np.arange(round(CAUSE_S / GRID_S) + 1)
        false[k] = not _any_touches(path, wider, others_at(trace.agents, t))  # (5)
    return Series(ego.t, false, missing="the ego never brakes hard")


@metric(
    unit="m/s2",
    better="lower",
    reductions=(MAX,),
    parameters=(f"gap at least {TOUCHING_M:g} m",),
    needs="a road user ahead in the path",
)
def missed_braking(trace: Trace, scenario: Scenario) -> Measured:
    """Deceleration that a steady approach behind the one ahead in the path asks beyond the ego's.

    Formula: max((v - u)^2 / (2 gap) - b, 0)
    """
    ahead = ahead_of(trace, scenario)
    closing = np.maximum(ahead.v - ahead.u, 0.0)
    required = closing**2 / (2.0 * np.maximum(ahead.gap, TOUCHING_M))
    missed = np.maximum(required - np.maximum(-ahead.a, 0.0), 0.0)  # (6)
    return Series(ahead.t, missed, labels_of(trace, ahead.agent), "the path ahead was free")
