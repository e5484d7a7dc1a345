"""Models of reference drivers: how the drivers of UN R157 brake for the road users ahead.

u is another's speed along the driver's line (oncoming: 0), w its speed towards the band, v the
driver's speed, gap the free distance between the boxes along the line, and the band is the area
that the ego's box sweeps.

    "cc"    the competent and careful driver of UN R157, Annex 4, Appendix 3
    "fsm"   the fuzzy safety model: Mattas et al., Accid. Anal. Prev. 148 (2020) 105794; UN R157.01,
            Annex 3

A road user ahead is a hazard to "cc" while it
(1) cuts in: w > 0.05 m/s, and it is more than 0.375 m nearer to the band than at its farthest,
        by its smoothed motion:
    nearer' = max(nearer + w dt, 0), which is insensitive to noise of the positions;
(2) crosses: a pedestrian, a rider, or a road user that moves more across the line than along it,
    moves towards the band and will be in it while the ego passes, both at constant velocity (an
    addition of replan: R157 has no crossing traffic);
(3) is in the band and slower than the driver by more than 0.5 m/s; or (4) is in it and brakes with
    5 m/s2 or more.
"cc" evaluates a hazard for 0.4 s and reacts for 0.75 s, releasing the pedal (0.4 m/s2). Then it
brakes with 0.774 g, at 12.65 m/s3, as soon as gap / (v - u) < 2.0 s, in (4) as soon as gap / v <
2.0 s. It brakes until no agent is a hazard and no agent in the band is nearer than 2 m + 2 s v.

In the JRC's code (JRC-FSM 01b05c29) the 0.75 s begin only when the other is within the ego's width
and the time to collision is below 2.0 s. Here both times begin when the other leaves the wandering
zone, because the regulation does not define when evaluation ends. Therefore "cc" brakes in time in
41 to 57 of the 520 cut-ins of JRC's grid in which that code crashes.

"fsm" brakes for every road user in the band, and for those ahead that move towards the band with
(5) lateral gap / w < (gap + both lengths) / (v - u) + 0.1 s, and, if it crosses, not out of the
band before the ego arrives (an addition of replan). It first reacts for 0.75 s, then brakes at
12.65 m/s3. With a the driver's acceleration, it brakes with
(6) deceleration = 4 + 2 CFS m/s2 where CFS > 0, else 4 PFS
(7) PFS of gap - 2 m: 0 above safe = 0.75 v + v^2 / 8 - u^2 / 14 + 2 m,
        1 below unsafe = 0.75 v + v^2 / 12 - u^2 / 14
(8) CFS of the gap, with a' = max(a, -4), v' = v + 0.75 a': 0 where v <= u; where v' < u: 1 if gap <
    (v - u)^2 / (2 |a'|), else 0; else 0 above safe
        and 1 below unsafe = (v + 0.375 a' - u) 0.75 + (v' - u)^2 / 8, / 12
linear between safe and unsafe.
"""

from __future__ import annotations

from math import cos, hypot, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.reference_line import line_frame, line_project
from replan.metrics.boxes import EgoOutline, OtherBoxes

STEP_S = 0.02  # So short that one more step of braking changes less than noise does, s
CC_BRAKE_MPS2, CC_RELEASE_MPS2 = 0.774 * 9.81, 0.4
CC_EVALUATE_S, CC_REACT_S = 0.4, 0.75
CC_TTC_S, CC_THW_S = 2.0, 2.0
CC_WANDER_M, CC_TOWARDS_MPS = 0.375, 0.05
CC_LEAD_MPS2, CC_CLOSING_MPS = 5.0, 0.5
FSM_REACT_S, FSM_LEAD_MPS2 = 0.75, 7.0
FSM_COMFORT_MPS2, FSM_HARDEST_MPS2 = 4.0, 6.0
FSM_MARGIN_M, FSM_SAFE_M = 2.0, 2.0
FSM_AHEAD_S = 0.1
NEAR_M, ASIDE_M = 150.0, 20.0  # A driver does not look farther ahead or sideways


class SpeedLine(NamedTuple):
    """A reference line for kernels, and the speed at each knot that is slow enough for the curves
    ahead, m/s.
    """

    knots: FloatArray
    coef: FloatArray
    limits: FloatArray


class AgentView(NamedTuple):
    """What a driver sees of an agent."""

    gap: float  # m, along the line; NaN for agents that are absent, too far away, or not ahead
    u: float  # m/s, along the line
    aside: float  # m, lateral gap to the band; negative in it
    towards: float  # m/s, lateral speed towards the band
    length: float  # m, extent along the line
    crosses: float  # 1 or 0
    width: float  # m, extent across


@inner_kernel
def _view_of(views: FloatArray, i: int) -> AgentView:
    """Return row i of `observe`."""
    return AgentView(
        views[i, 0],
        views[i, 1],
        views[i, 2],
        views[i, 3],
        views[i, 4],
        views[i, 5],
        views[i, 6],
    )


@inner_kernel
def observe(
    line: SpeedLine,
    k: int,
    s: float,
    l_ego: float,
    car: EgoOutline,
    others: OtherBoxes,
    vulnerable: BoolArray,
    views: FloatArray,
) -> None:
    """Fill the driver's view of each agent at step k, `(n, 7)`: the fields of `AgentView`."""
    knots, coef = line.knots, line.coef
    pose, size = others.pose, others.size
    x, y = line_frame(knots, coef, s)[:2]
    for i in range(len(size)):
        views[i, 0] = np.nan
        if not others.there[i, k] or hypot(pose[0, i, k] - x, pose[1, i, k] - y) > NEAR_M:
            continue
        station, l = line_project(knots, coef, pose[0, i, k], pose[1, i, k], s, NEAR_M)
        yaw_r = line_frame(knots, coef, station)[2]
        turn, vx, vy = pose[2, i, k] - yaw_r, pose[3, i, k], pose[4, i, k]
        u, w = vx * cos(yaw_r) + vy * sin(yaw_r), vy * cos(yaw_r) - vx * sin(yaw_r)
        half = 0.5 * (size[i, 0] * abs(cos(turn)) + size[i, 1] * abs(sin(turn)))
        aside = 0.5 * (size[i, 0] * abs(sin(turn)) + size[i, 1] * abs(cos(turn)))
        side = l - l_ego
        ahead = station - s - car.axle
        if ahead <= 0.0 or abs(side) > ASIDE_M:
            continue
        views[i, 0], views[i, 1] = ahead - half - 0.5 * car.length, max(u, 0.0)
        views[i, 2] = abs(side) - aside - 0.5 * car.width
        views[i, 3], views[i, 4], views[i, 6] = -w if side > 0.0 else w, 2.0 * half, 2.0 * aside
        views[i, 5] = 1.0 if vulnerable[i] or abs(w) > abs(u) else 0.0


@inner_kernel
def _comes_in(view: AgentView, v: float, car: EgoOutline, slack: float, late: float) -> bool:
    """Return whether an agent beside the band enters it before the ego is past and, if it crosses,
    leaves late enough.

    `slack` s are added to the first time; `late` s are subtracted from the first and from the time
    of leaving.
    """
    if view.towards <= 0.0 or v <= view.u or view.gap < 0.0:
        return False
    enters = view.aside / view.towards
    passed = (view.gap + car.length + view.length) / (v - view.u) + slack - late
    leaves = (view.aside + car.width + view.width) / view.towards
    leaves_early = view.crosses > 0.0 and leaves - late < view.gap / (v - view.u)
    return enters < passed and not leaves_early


@inner_kernel
def cc_acceleration(
    views: FloatArray,
    accel: FloatArray,
    car: EgoOutline,
    v: float,
    clock: FloatArray,
    nearer: FloatArray,
    late: float,
    braking: bool,
) -> float:
    """Return the acceleration of "cc".

    Update `clock` (how long each agent has been a hazard) and `nearer` (1).
    """
    wish, held = 0.0, False
    for i in range(len(views)):
        view = _view_of(views, i)
        ahead = np.isfinite(view.gap)
        nearer[i] = max(nearer[i] + STEP_S * view.towards, 0.0) if ahead else 0.0
        brakes = accel[i] <= -CC_LEAD_MPS2
        in_band = view.aside < 0.0
        hazard = False  # (1) to (4)
        if ahead and in_band:
            hazard = brakes or v - view.u > CC_CLOSING_MPS
        elif ahead and view.crosses > 0.0:
            hazard = _comes_in(view, v, car, 0.0, late)
        elif ahead:
            cuts_in = view.towards > CC_TOWARDS_MPS and nearer[i] > CC_WANDER_M
            hazard = cuts_in and view.gap > 0.0
        clock[i] = clock[i] + STEP_S if hazard else 0.0
        near = in_band and view.gap < 2.0 + CC_THW_S * v
        held = held or hazard or near
        if not hazard:
            continue
        closing = v - view.u
        critical = closing > 0.0 and view.gap < CC_TTC_S * closing
        critical = critical or (brakes and in_band and view.gap < CC_THW_S * v)
        if critical and clock[i] > CC_EVALUATE_S + CC_REACT_S + late + 1e-9:
            wish = -CC_BRAKE_MPS2
        elif critical and clock[i] > CC_EVALUATE_S + 1e-9:
            wish = min(wish, -CC_RELEASE_MPS2)
    return -CC_BRAKE_MPS2 if braking and held else wish


@inner_kernel
def fsm_fuzzy(gap: float, safe: float, unsafe: float) -> float:
    """Return 0 from `safe` on, 1 up to `unsafe`, linear between; a step if both are equal."""
    if gap >= safe:
        return 0.0
    if gap <= unsafe or safe - unsafe < 1e-9:
        return 1.0
    return (safe - gap) / (safe - unsafe)


@kernel
def fsm_proactive(gap: float, v: float, u: float) -> float:
    """Return PFS (7)."""
    reach = v * FSM_REACT_S - u * u / (2.0 * FSM_LEAD_MPS2)
    safe = reach + v * v / (2.0 * FSM_COMFORT_MPS2) + FSM_SAFE_M
    return fsm_fuzzy(gap - FSM_MARGIN_M, safe, reach + v * v / (2.0 * FSM_HARDEST_MPS2))


@kernel
def fsm_critical(gap: float, v: float, u: float, a: float) -> float:
    """Return CFS (8)."""
    if v <= u:
        return 0.0
    a = max(a, -FSM_COMFORT_MPS2)
    v_then = v + FSM_REACT_S * a
    if v_then < u:  # so a < 0
        return 1.0 if gap < (v - u) ** 2 / (2.0 * abs(a)) else 0.0
    reach = (v + 0.5 * a * FSM_REACT_S - u) * FSM_REACT_S
    square = (v_then - u) ** 2
    return fsm_fuzzy(
        gap, reach + square / (2.0 * FSM_COMFORT_MPS2), reach + square / (2.0 * FSM_HARDEST_MPS2)
    )


@inner_kernel
def fsm_acceleration(views: FloatArray, car: EgoOutline, v: float, a: float, late: float) -> float:
    """Return the acceleration of "fsm" without its reaction time."""
    hardest = 0.0
    for i in range(len(views)):
        view = _view_of(views, i)
        if not np.isfinite(view.gap):
            continue
        if view.aside >= 0.0 and not _comes_in(view, v, car, FSM_AHEAD_S, late):
            continue
        deceleration = FSM_COMFORT_MPS2 * fsm_proactive(view.gap, v, view.u)
        critical = fsm_critical(view.gap, v, view.u, a)
        if critical > 0.0:
            deceleration = FSM_COMFORT_MPS2 + (FSM_HARDEST_MPS2 - FSM_COMFORT_MPS2) * critical
        hardest = max(hardest, deceleration)  # (6)
    return -hardest
