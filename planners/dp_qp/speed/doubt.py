"""How likely it is that a road user will take the path, and how the speed stage acts on unlikely
cases.

A row of the S-T boundaries has the weight p = p_said p_exist p_enter, with

(1) p_said = min(q / (2 UNLIKELY), 1)                     q: probability of the predicted hypothesis
(2) p_exist = min(age / `AGE_S`, 1) exp(-(unseen - u0) / `UNSEEN_S`)
        u0: that of the agent seen most recently
(3) p_enter = Phi((w m - d) / sqrt(`PLACE_M`^2 + (sigma t)^2) - 1),  m = u - u^2 / 2 t_b,
        u = min(t, t_b),  t_b = v / b

d is the distance between the agent's side and the strip of the path that it enters, w its velocity
towards the strip, t the time when it leaves it, sigma the standard deviation of the velocity, at
least `DRIFT_MPS`. An agent of speed v that brakes with b, as in (6), stands after t_b: who brakes
before the path lets the ego go. For an agent that walks towards the path, (3) and the factor of the
age in (2) are 1, so that being new or slow is no doubt. (3) is also 1 for an agent that walks away
or is in the strip; (2) and (3) are 1 for one that takes the path now.

(4) Rows of p >= `CERTAIN` bind. Other rows are safe where a stop with `SHARED_MPS2`,
        `SHARED_S` from now, stays behind them, or the planned profile clears them. The rest, above
        `NEGLIGIBLE`, binds only as far as comfortable braking can keep it.
(5) The same holds for vehicles from behind, from the side or from ahead that are not
        in the way now, where comfortable braking does not keep the bounds, and either p_turn <
        `SURE` or full braking would not avoid them. p_turn is p with
    (`TURN_MPS2` t^2 / 2)^2 more under the root of (3): until then they may turn,
        as roads bend and drivers yield.
(6) An agent that is followed and brakes is assumed to brake to a stop, with a deceleration less by
    `ERROR_MPS2`.
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, erf, exp, hypot, inf, isnan, sin, sqrt
from typing import NamedTuple

import numpy as np

from replan.core.arrays import TIE, BoolArray, FloatArray, IntArray
from replan.core.kernel import kernel
from replan.logs.agents import AgentKind, among
from replan.logs.reference_line import line_frame
from replan.planners.frenet.path import Path
from replan.planners.frenet.scene import STANDING_MPS, UNLIKELY, AgentsAlong, Bodies, Scene
from replan.planners.frenet.st_boundaries import ALONG, StBoundaries
from replan.planners.frenet.sweep import SweptPath

CERTAIN, NEGLIGIBLE, SURE = 0.5, 0.05, 0.8
AGE_S, UNSEEN_S = 0.8, 0.3
LEAST = 0.1  # p_exist of a road user that is seen for the first time: its weight is low, but not 0
PLACE_M, DRIFT_MPS, TURN_MPS2 = 0.3, 0.5, 1.5
# A pedestrian or object faster than this does not walk: it is a rider, or an error of the detector
WALK_MPS = 3.0
SHARED_MPS2, SHARED_S = 3.0, 0.5
# Error of a measured deceleration, and the greatest deceleration that is used, m/s2
ERROR_MPS2, MOST_MPS2 = 0.5, 8.0
WALKERS = among(AgentKind.PEDESTRIAN, AgentKind.OBJECT)
"""Kinds, by code, that walk when they are slow: an agent that a detector cannot classify may be on
foot.
"""


class Seen(NamedTuple):
    """Perception's data on the agents `(n,)`, as in `Agents`, and which of them walk."""

    age: FloatArray
    unseen: FloatArray
    velocity_sigma: FloatArray
    brakes: FloatArray
    walks: BoolArray


def weights(scene: Scene, path: Path, rows: StBoundaries) -> FloatArray:
    """The weights p and p_turn of the rows `(2, n)`."""
    agents, line, car = scene.frame.agents, scene.reference.line, scene.vehicle
    visibility = Seen(
        agents.age, agents.unseen, agents.velocity_sigma, _brakes(agents.accel), _walks(scene)
    )
    swept, ego = SweptPath(path.sigma, path.x, path.y, path.yaw), (car.axle_to_front, car.width)
    return _weights(
        rows.t,
        rows.agent,
        rows.lower,
        rows.probability,
        visibility,
        scene.agents,
        scene.bodies,
        line.s,
        line.coef,
        swept,
        path.s,
        ego,
    )


@kernel
def _weights(
    t: FloatArray,
    agent: IntArray,
    lower: FloatArray,
    probability: FloatArray,
    seen: Seen,
    along: AgentsAlong,
    bodies: Bodies,
    knots: FloatArray,
    coef: FloatArray,
    swept: SweptPath,
    stations: FloatArray,
    ego: tuple[float, float],
) -> FloatArray:
    """`weights`; `t` to `probability` belong to the rows, `knots` and `coef` to the reference;
    `ego`: front and width, m.
    """
    weights, least_since = np.empty((2, len(agent))), inf
    age, unseen = seen.age, seen.unseen
    walks, length = seen.walks, bodies.length
    width = bodies.width
    for since in unseen:
        least_since = min(least_since, inf if isnan(since) else since)
    for i in range(len(agent)):
        row = agent[i]
        weights[:, i] = min(probability[i] / (2.0 * UNLIKELY), 1.0)  # (1)
        taken = np.flatnonzero(np.isfinite(lower[i]))
        if taken[0] == 0:
            continue
        j = min(
            int(np.searchsorted(swept.sigma, lower[i, taken[0]] + ego[0])), len(swept.sigma) - 1
        )
        x_r, y_r, yaw_r = line_frame(knots, coef, stations[j])[:3]
        aside = along.l[row] - ((swept.y[j] - y_r) * cos(yaw_r) - (swept.x[j] - x_r) * sin(yaw_r))
        c, s = abs(cos(along.turn[row])), abs(sin(along.turn[row]))
        d = abs(aside) - 0.5 * (ego[1] + c * width[row] + s * length[row])
        w = -along.v_l[row] if aside > 0.0 else along.v_l[row]
        if not (walks[row] and w > 0.0):
            weights[:, i] *= (
                1.0 if isnan(age[row]) else min(max(age[row] / AGE_S, LEAST), 1.0)
            )  # (2)
        weights[:, i] *= 1.0 if isnan(unseen[row]) else exp((least_since - unseen[row]) / UNSEEN_S)
        if d > 0.0 and not walks[row]:
            leaves, v, b = t[taken[-1]], hypot(along.v_s[row], along.v_l[row]), seen.brakes[row]
            stands = max(v, TIE) / b if b > 0.0 else inf
            until = min(leaves, stands)
            moves = w * (until - 0.5 * until**2 / stands)
            sigma_v = seen.velocity_sigma[row]
            drift = sigma_v if sigma_v > DRIFT_MPS else DRIFT_MPS
            for k, turn in enumerate((0.0, 0.5 * TURN_MPS2 * leaves**2)):
                z = (moves - d) / sqrt(PLACE_M**2 + (drift * leaves) ** 2 + turn**2) - 1.0
                weights[k, i] *= 0.5 * (1.0 + erf(z / sqrt(2.0)))  # (3)
    return weights


def from_beside(scene: Scene, rows: StBoundaries) -> BoolArray:
    """Which rows `(n,)` are those of (5): of vehicles not in the way now, except those ahead in the
    ego's direction.
    """
    agents, along = scene.frame.agents, scene.agents
    aside = (along.s + 0.5 * agents.length < scene.front) | (along.v_s < np.abs(along.v_l))
    return (aside & ~_walks(scene))[rows.agent] & np.isnan(rows.lower[:, 0])


def _walks(scene: Scene) -> BoolArray:
    return np.asarray(WALKERS[scene.frame.agents.codes] & (scene.speed < WALK_MPS))


def _brakes(accel: FloatArray) -> FloatArray:
    """Decelerations that are relied on, 0 where an agent does not brake, m/s2."""
    return np.clip(-accel - ERROR_MPS2, 0.0, MOST_MPS2)


def extend_braking(scene: Scene, rows: StBoundaries) -> StBoundaries:
    """Apply (6): followed agents that brake come to a stop."""
    b = _brakes(scene.frame.agents.accel[rows.agent])
    if not b.any():
        return rows
    v, total = rows.speed, scene.speed[rows.agent]
    led = (b > 0.0) & (v > ALONG * total) & (total > STANDING_MPS) & np.isfinite(rows.lower[:, 0])
    until = np.minimum(rows.t, (v[led] / b[led])[:, None])
    stops = rows.lower[led, :1] + v[led, None] * until - 0.5 * b[led, None] * until**2
    lower = rows.lower.copy()
    lower[led] = np.minimum(lower[led], stops)
    return replace(rows, lower=lower)


def relax_rows(rows: StBoundaries, which: BoolArray, stop: FloatArray, gap: float) -> StBoundaries:
    """Apply (4), (5): rows `which` `(n,)` bind only as far as a comfortable stop `(k,)` can keep
    the gap.
    """
    lower = np.where(which[:, None], np.maximum(rows.lower, stop + gap), rows.lower)
    return replace(rows, lower=lower, upper=np.maximum(rows.upper, lower))
