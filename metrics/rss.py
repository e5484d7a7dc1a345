"""Responsibility-sensitive safety (RSS), closed loop: the margin to a dangerous situation, and the
proper response.

Measured along and across the path of `lead`, every 0.1 s, for every agent within `LOOK_M` that is
not wholly behind the ego (agents behind must keep their own distance). v is the ego's speed, u the
other's along the path, w the other's across it towards the ego's side, d_lon and d_lat are the gaps
of the boxes (negative where they overlap), and stopping(v) = v RHO + A_MAX RHO^2 / 2 + (v + RHO
A_MAX)^2 / (2 B_MIN).

(1) d_lon,min = max(stopping(v) - u^2 / (2 B_MAX), 0) if both drive in the same direction;
        stopping(v) + stopping(|u|) if the other approaches (u < -0.05 m/s)
(2) d_lat,min = MU + max(aside(0) + aside(w), 0),
        aside(c) = (c + c') RHO / 2 + c' |c'| / (2 B_LAT),
    c' = c + RHO A_LAT: the ego keeps to its path (c = 0); signed, so that moving away reduces it;
        aside(w) is 0 if the other stands or is an object, which cannot swerve (an addition of
        replan)
(3) dangerous: d_lon < d_lon,min and d_lat < d_lat,min;
        margin = the greater of both differences, m; negative: dangerous
(4) proper response, from RHO after the danger to this agent began until it ends or the ego stands:
    if d_lat became unsafe last, the ego's speed towards the other, across the path that it was on
    when the danger began, is at most its value at RHO less B_LAT times the time since then, or 0;
    otherwise the ego brakes with at least B_MIN. At all times, also before RHO, it accelerates with
    at most A_MAX.

A standing ego has given its response and has no margin. The parameters are those of JRC-FSM (commit
01b05c29), since RSS leaves them to its user. With these, a car that follows at 15 m/s is in danger
within 18.1 m, 1.2 s. Source: Shalev-Shwartz, Shammah, Shashua, arXiv 1708.06374, definitions 1 to
10.
"""

from __future__ import annotations

from functools import partial
from math import cos, hypot, pi, sin

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.kernel import inner_kernel, kernel
from replan.core.once import once
from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.shapes import corners
from replan.logs.trace import Trace
from replan.metrics.boxes import (
    GRID_S,
    STANDING_MPS,
    EgoOutline,
    OtherBoxes,
    car_of,
    each,
    grid_of,
    name_of,
)
from replan.metrics.lead import LOOK_M, arc_point, extent, within_look
from replan.metrics.metric import Measured, Series, Unavailable, metric
from replan.metrics.reductions import MIN, share_while, time_below, time_outside

RHO_S = 0.75
A_MAX_MPS2, B_MIN_MPS2, B_MAX_MPS2 = 3.0, 6.0, 6.0
A_LAT_MPS2, B_LAT_MPS2 = 1.0, 1.0
MU_M = 0.3
_EPS = 1e-6  # Rounding tolerance when accelerations and times are compared


@kernel
def _stopping(v: float) -> float:
    faster = v + RHO_S * A_MAX_MPS2
    return v * RHO_S + 0.5 * A_MAX_MPS2 * RHO_S**2 + faster * faster / (2.0 * B_MIN_MPS2)


@kernel
def longitudinal_distance(v: float, u: float) -> float:
    """Return the minimum longitudinal distance (1), m."""
    if u < -STANDING_MPS:
        return _stopping(v) + _stopping(-u)
    return max(_stopping(v) - u * u / (2.0 * B_MAX_MPS2), 0.0)


@inner_kernel
def _lateral_way(c: float) -> float:
    then = c + RHO_S * A_LAT_MPS2
    return 0.5 * (c + then) * RHO_S + then * abs(then) / (2.0 * B_LAT_MPS2)


@kernel
def lateral_distance(w: float, swerves: bool) -> float:
    """Return the minimum lateral distance (2), m; `w` m/s towards the ego's path."""
    return MU_M + max(_lateral_way(0.0) + (_lateral_way(w) if swerves else 0.0), 0.0)


@kernel
def _margins(
    ego: FloatArray, car: EgoOutline, others: OtherBoxes, i: int, movable: bool
) -> FloatArray:
    """Return d_lon - d_lon,min, d_lat - d_lat,min, side (1 left, -1 right) of agent i, `(3, k)`;
    NaN: not judged.
    """
    present, pose, size = others.there[i], others.pose[:, i], others.size[i]
    steps, half = len(present), 0.5 * car.width
    front, rear = car.axle + 0.5 * car.length, car.axle - 0.5 * car.length
    margins = np.full((3, steps), np.nan)
    reach = 0.5 * hypot(size[0], size[1])
    for k in range(steps):
        x, y, yaw = ego[0, k], ego[1, k], ego[2, k]
        v, kappa = ego[3, k], ego[4, k]
        if (
            not present[k]
            or v <= STANDING_MPS
            or not within_look(x, y, yaw, kappa, pose[0, k], pose[1, k], reach)
        ):
            continue
        outline = corners(pose[0, k], pose[1, k], pose[2, k], size[0], size[1])
        _, s_low, s_high, l_low, l_high = extent(x, y, yaw, kappa, half, outline)
        if s_high < rear or abs(kappa * s_low) > 0.5 * pi:
            continue
        path, vx, vy = yaw + kappa * 0.5 * (s_low + s_high), pose[3, k], pose[4, k]
        u, left = vx * cos(path) + vy * sin(path), vy * cos(path) - vx * sin(path)
        side = 1.0 if l_low + l_high >= 0.0 else -1.0
        aside = l_low - half if side > 0.0 else -half - l_high
        margins[0, k] = s_low - front - longitudinal_distance(v, u)
        margins[1, k] = aside - lateral_distance(
            -side * left, movable and hypot(vx, vy) > STANDING_MPS
        )
        margins[2, k] = side
    return margins


@kernel
def _improper_response(
    t: FloatArray, ego: FloatArray, accel: FloatArray, margins: FloatArray
) -> BoolArray:
    """Return at which steps `(k,)` the response to one agent is not proper (4)."""
    improper = np.zeros(len(t), np.bool_)
    start, lateral, allowed = -1, False, np.nan
    for k in range(len(t)):
        if not (margins[0, k] < 0.0 and margins[1, k] < 0.0):
            start = -1
            continue
        if start < 0:
            start, lateral, allowed = (
                k,
                k > 0 and margins[0, k - 1] < 0.0 and margins[1, k - 1] >= 0.0,
                np.nan,
            )
        waited = t[k] - t[start] - RHO_S
        if accel[k] > A_MAX_MPS2 + _EPS:
            improper[k] = True
        elif waited >= -_EPS and lateral:
            c, s, kappa = cos(ego[2, start]), sin(ego[2, start]), ego[4, start]
            dx, dy = ego[0, k] - ego[0, start], ego[1, k] - ego[1, start]
            along, _ = arc_point(kappa, c * dx + s * dy, c * dy - s * dx)
            towards = ego[3, k] * sin(ego[2, k] - ego[2, start] - kappa * along) * margins[2, start]
            if not np.isfinite(allowed):
                allowed = max(towards, 0.0)
            improper[k] = towards > max(allowed - B_LAT_MPS2 * waited, 0.0) + STANDING_MPS
        elif waited >= -_EPS:
            improper[k] = accel[k] > -B_MIN_MPS2 + _EPS
    return improper


@once
def _rss(trace: Trace, scenario: Scenario) -> tuple[Series, Series]:
    """Return the least margin (NaN: no agent is judged), and 1 where any response is improper."""
    ego, car = grid_of(trace), car_of(scenario)
    states = np.stack([ego.x, ego.y, ego.yaw, ego.v, ego.kappa])
    margin, improper = np.full(len(ego.t), np.nan), np.zeros(len(ego.t))
    labels, blamed = [""] * len(ego.t), [""] * len(ego.t)
    for i, others, row in each(trace.agents, ego.t):
        movable = trace.agents.kinds[i] is not AgentKind.OBJECT and not bool(trace.agents.static[i])
        margins = _margins(states, car, others, row, movable)
        name, least = name_of(trace.agents, i), np.maximum(margins[0], margins[1])
        for k in np.flatnonzero(np.isfinite(least) & ~(margin <= least)):
            margin[k], labels[k] = least[k], name
        for k in np.flatnonzero(_improper_response(ego.t, states, ego.a, margins)):
            improper[k], blamed[k] = 1.0, name
    nothing = f"no other road user ahead or beside within {LOOK_M:g} m while the ego drove"
    return Series(ego.t, margin, tuple(labels), nothing), Series(ego.t, improper, tuple(blamed))


def _is_dangerous(margin: FloatArray) -> BoolArray:
    return margin < 0.0


def _is_improper(improper: FloatArray) -> BoolArray:
    return improper > 0.5


_rss_metric = partial(
    metric,
    source="Shalev-Shwartz et al., arXiv 1708.06374; parameters: JRC-FSM 01b05c29",
    parameters=(
        f"rho {RHO_S:g} s",
        f"a_max {A_MAX_MPS2:g} m/s2",
        f"b_min {B_MIN_MPS2:g} m/s2",
        f"b_max {B_MAX_MPS2:g} m/s2",
        f"a_lat {A_LAT_MPS2:g} m/s2",
        f"b_lat {B_LAT_MPS2:g} m/s2",
        f"mu {MU_M:g} m",
        f"along the arc of the ego's curvature, {LOOK_M:g} m ahead",
        f"every {GRID_S:g} s",
    ),
)


@_rss_metric(
    unit="m",
    better="higher",
    reductions=(
        MIN,
        time_below(0.0, "time_dangerous"),
        share_while(_is_dangerous, "share_dangerous"),
    ),
    needs="another ahead or beside, and an ego that drives",
)
def rss_margin(trace: Trace, scenario: Scenario) -> Measured:
    """Distance from a dangerous situation of RSS: the greater of the longitudinal and the lateral
    surplus, the least of all agents ahead or beside; negative: dangerous.

    Formula: min over agents of max(d_lon - d_lon,min, d_lat - d_lat,min)
    """
    return _rss(trace, scenario)[0]


@_rss_metric(
    unit="1",
    better="lower",
    reductions=(
        time_outside(-np.inf, 0.5, "time"),
        share_while(_is_improper, "share"),
    ),
    needs="a dangerous situation",
)
def rss_improper(trace: Trace, scenario: Scenario) -> Measured:
    """Where the ego does not give the proper response of RSS: rho after the danger began it brakes
    with less than b_min, or goes on nearing sideways, or it accelerates with more than a_max.

    Formula: dangerous, and after rho a > -b_min (lateral danger last: v_lat > max(v_lat(rho) -
    b_lat t, 0))
    """
    margin, improper = _rss(trace, scenario)
    if not (margin.value < 0.0).any():
        return Unavailable("no dangerous situation: no response was due")
    return improper
