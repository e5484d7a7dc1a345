"""Reference drivers: would a careful driver, braking on the ego's line, have avoided the collisions
in a log?

A driver is a point mass with the ego's box on a reference line, among the tracks as logged. It
keeps its speed, slows down for curves (3 m/s2 lateral, at 1.5 m/s2), brakes by its model, never
accelerates and never steers; an initial offset from the line decays over `RETURN_S`. u is another's
speed along the line (oncoming: 0), w its speed towards the band, v the driver's speed, gap the free
distance between the boxes along the line, and the band is the area that the ego's box sweeps.

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
12.65 m/s3. A log reacts only to its own ego: a road user that hits the driver from behind or while
it stands is not counted and is ignored from then on, as is one that appears at the driver's place.

With a the driver's acceleration, "fsm" brakes with
(7) deceleration = 4 + 2 CFS m/s2 where CFS > 0, else 4 PFS
(8) PFS of gap - 2 m: 0 above safe = 0.75 v + v^2 / 8 - u^2 / 14 + 2 m,
        1 below unsafe = 0.75 v + v^2 / 12 - u^2 / 14
(9) CFS of the gap, with a' = max(a, -4), v' = v + 0.75 a': 0 where v <= u; where v' < u: 1 if gap <
    (v - u)^2 / (2 |a'|), else 0; else 0 above safe
        and 1 below unsafe = (v + 0.375 a' - u) 0.75 + (v' - u)^2 / 8, / 12
linear between safe and unsafe.

The margin of a verdict is the least distance between the driver's box and the agent's over the
whole drive:
(6) avoidable: the least gap to the agent that a driver without braking would touch, m, > 0
    unavoidable: minus the depth of the touch (the shortest shift that separates the boxes); the
    drive continues through it not applicable: the least gap of a driver without braking to any
    agent
A verdict is marginal where its margin, or that of the drive without braking, is within
`MARGINAL_M`, or if a driver that judges `JUDGED_S` earlier or later has another outcome; this
shifts (2), (5) and the reaction time.

`replan.replay.loop.reference_drives`, which knows the line, adds the verdicts to the scenario
(`Scenario.references`). Each driver has three rows: `reference_cc.applies` is 1 if an ego that does
not brake would touch an agent, else 0; if it is 1, `reference_cc.avoids` is 1 or 0, and
`reference_cc.margin` is the margin in metres (negative: not avoided).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import cos, hypot, nan, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.reference_line import ReferenceLine, line_frame, line_project
from replan.logs.scenario import Avoidability, DriverVerdict, Scenario
from replan.logs.shapes import clearance
from replan.logs.states import EgoState
from replan.logs.trace import Mode, Trace
from replan.logs.tracks import Tracks
from replan.metrics.boxes import (
    STANDING_MPS,
    EgoOutline,
    OtherBoxes,
    car_of,
    is_behind,
    name_of,
    others_at,
    present_between,
    touches,
)
from replan.metrics.metric import Measured, Metric, Reduction, Series, Unavailable

STEP_S = 0.02  # So short that one more step of braking changes less than noise does, s
# Effect of 5 cm of position noise on a margin at 10 Hz (benchmarks/verdicts.py), m
MARGINAL_M = 0.5
JUDGED_S = 0.15  # A fifth of both drivers' reaction time
LONGEST_S = 60.0  # Longest drive, s
RETURN_S = 3.0
CURVE_MPS2, EASE_MPS2 = 3.0, 1.5

JERK_MPS3 = 12.65
CC_BRAKE_MPS2, CC_RELEASE_MPS2 = 0.774 * 9.81, 0.4
CC_EVALUATE_S, CC_REACT_S, CC_TTC_S, CC_THW_S = 0.4, 0.75, 2.0, 2.0
CC_WANDER_M, CC_TOWARDS_MPS, CC_LEAD_MPS2, CC_CLOSING_MPS = 0.375, 0.05, 5.0, 0.5
FSM_REACT_S, FSM_COMFORT_MPS2, FSM_HARDEST_MPS2, FSM_LEAD_MPS2 = 0.75, 4.0, 6.0, 7.0
FSM_MARGIN_M, FSM_SAFE_M = 2.0, 2.0
FSM_AHEAD_S = 0.1
NEAR_M, ASIDE_M = 150.0, 20.0  # A driver does not look farther ahead or sideways

PASSIVE, CC, FSM = 0, 1, 2
ANY = -1  # Value of `about`: the least distance to any agent


class SpeedLine(NamedTuple):
    """A reference line for kernels, and the speed at each knot that is slow enough for the curves
    ahead, m/s.
    """

    knots: FloatArray
    coef: FloatArray
    limits: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class ReferenceCourse:
    """The input of a drive: a line, a start (s, l, v), the times t `(k,)`, and the tracks present
    during them.
    """

    line: SpeedLine
    start: FloatArray
    car: EgoOutline
    t: FloatArray
    tracks: Tracks
    others: OtherBoxes
    vulnerable: BoolArray

    @staticmethod
    def of(scenario: Scenario, line: ReferenceLine, start: EgoState) -> ReferenceCourse:
        """Return the course of an ego that starts at a state, at most `LONGEST_S` long."""
        t, tracks = (
            np.arange(start.t, min(scenario.duration, start.t + LONGEST_S) + 1e-9, STEP_S),
            scenario.tracks,
        )
        there = present_between(tracks, t[0], t[-1])
        if len(there) < len(tracks):
            tracks = tracks.taken(
                np.isin(np.repeat(np.arange(len(tracks)), np.diff(tracks.offsets)), there)
            )
        eased = SpeedLine(line.s, line.coef, curve_speeds(line.s, line.kappa))
        ego = np.array([*line.project(start.x, start.y), start.v])
        vulnerable = np.array([kind.is_vulnerable for kind in tracks.kinds], np.bool_)
        return ReferenceCourse(
            eased, ego, car_of(scenario), t, tracks, others_at(tracks, t), vulnerable
        )

    def drive(self, driver: int, about: int = ANY, late: float = 0.0) -> ReferenceDrive:
        """Drive to the first touch; `least` is the distance to the agent `about`; the driver judges
        `late` s later.
        """
        rows, *found = _drive(
            driver, self.line, self.start, self.car, self.others, self.vulnerable, about, late
        )
        return ReferenceDrive(*rows, *found)


def careful_drive(scenario: Scenario, line: ReferenceLine) -> ReferenceDrive:
    """Drive "cc" from the log's first state along `line` until its first touch, with a row every
    `STEP_S`.
    """
    return ReferenceCourse.of(scenario, line, scenario.ego.state(0)).drive(CC)


def _verdict(
    name: str, driver: int, scenario: Scenario, line: ReferenceLine, start: EgoState | None = None
) -> DriverVerdict:
    start = scenario.ego.state(0) if start is None else start
    if start.v <= STANDING_MPS:
        return DriverVerdict(
            name, Avoidability.NOT_APPLICABLE, "the ego does not drive at the start"
        )
    course = ReferenceCourse.of(scenario, line, start)
    t, passive = course.t, course.drive(PASSIVE)
    if passive.meets < 0:
        marginal = passive.least < MARGINAL_M
        by = f", by {passive.least:.1f} m, marginal" if marginal else ""
        reason = f"at constant speed the ego has no collision{by}"
        return DriverVerdict(
            name, Avoidability.NOT_APPLICABLE, reason, margin=passive.least, marginal=marginal
        )
    found = course.drive(driver, about=passive.agent)
    agent, margin, end = passive.agent if found.meets < 0 else found.agent, found.least, found.meets
    near = min(abs(margin), abs(passive.least)) < MARGINAL_M
    marginal = near or any(
        (course.drive(driver, late=late).meets < 0) != (end < 0) for late in (-JUDGED_S, JUDGED_S)
    )
    about, by = (
        name_of(course.tracks, agent),
        f"by {abs(margin):.1f} m{', marginal' if marginal else ''}",
    )
    if end < 0:
        met = f"which it would meet after {t[passive.meets] - t[0]:.1f} s"
        outcome, reason = Avoidability.AVOIDABLE, f"avoidable {by}: stays clear of {about}, {met}"
    else:
        met = f"meets {about} after {t[end] - t[0]:.1f} s at {found.v[end]:.1f} m/s"
        outcome, reason = Avoidability.UNAVOIDABLE, f"unavoidable {by}: {met}"
    braking = np.flatnonzero(found.a < -1.0)
    brakes, meets = (
        float(t[braking[0]]) if len(braking) else nan,
        float(t[end]) if end >= 0 else nan,
    )
    speed, who = float(found.v[end]), course.tracks.ids[agent]
    return DriverVerdict(
        name, outcome, reason, brakes, meets, speed, who, margin, marginal=marginal
    )


careful_driver = partial(_verdict, "cc", CC)
"""Returns the verdict of "cc" on a scenario along a line, for an ego that starts at a state (None:
the log's first).
"""
# Returns the verdict of "fsm"; arguments as `careful_driver`
fuzzy_driver = partial(_verdict, "fsm", FSM)
DRIVERS = {"cc": careful_driver, "fsm": fuzzy_driver}


@dataclass(frozen=True, eq=False, slots=True)
class ReferenceDrive:
    """The drive of a reference driver: stations, speeds and accelerations `(k,)` up to its end."""

    s: FloatArray
    v: FloatArray
    a: FloatArray
    meets: int  # Step of its first touch, -1: none; `agent` is the agent touched, -1: none
    agent: int
    least: float  # Least distance to the agent `about`, m (6); after a touch, minus its depth


@kernel
def curve_speeds(s: FloatArray, kappa: FloatArray) -> FloatArray:
    """Return the speed `(n,)` from which the driver can slow down for each curve ahead, m/s."""
    out = np.empty(len(s))
    for i in range(len(s) - 1, -1, -1):
        out[i] = (CURVE_MPS2 / max(abs(kappa[i]), 1e-9)) ** 0.5
        if i < len(s) - 1:
            out[i] = min(out[i], (out[i + 1] ** 2 + 2.0 * EASE_MPS2 * (s[i + 1] - s[i])) ** 0.5)
    return out


@inner_kernel
def _observe(
    line: SpeedLine,
    k: int,
    s: float,
    l_ego: float,
    car: EgoOutline,
    others: OtherBoxes,
    vulnerable: BoolArray,
    out: FloatArray,
) -> None:
    """Fill the driver's view of each agent at step k, `(n, 7)`.

    Gap, u, lateral gap, lateral speed towards the band, extent along the line, whether it crosses,
    extent across. The gap is NaN for agents that are absent, too far away, or not ahead. In the
    band the lateral gap is negative.
    """
    knots, coef, pose, size = line.knots, line.coef, others.pose, others.size
    x, y = line_frame(knots, coef, s)[:2]
    for i in range(len(size)):
        out[i, 0] = np.nan
        if not others.there[i, k] or hypot(pose[0, i, k] - x, pose[1, i, k] - y) > NEAR_M:
            continue
        at, l = line_project(knots, coef, pose[0, i, k], pose[1, i, k], s, NEAR_M)
        yaw_r = line_frame(knots, coef, at)[2]
        turn, vx, vy = pose[2, i, k] - yaw_r, pose[3, i, k], pose[4, i, k]
        u, w = vx * cos(yaw_r) + vy * sin(yaw_r), vy * cos(yaw_r) - vx * sin(yaw_r)
        half = 0.5 * (size[i, 0] * abs(cos(turn)) + size[i, 1] * abs(sin(turn)))
        aside = 0.5 * (size[i, 0] * abs(sin(turn)) + size[i, 1] * abs(cos(turn)))
        side = l - l_ego
        ahead = at - s - car.axle
        if ahead <= 0.0 or abs(side) > ASIDE_M:
            continue
        out[i, 0], out[i, 1] = ahead - half - 0.5 * car.length, max(u, 0.0)
        out[i, 2] = abs(side) - aside - 0.5 * car.width
        out[i, 3], out[i, 4], out[i, 6] = -w if side > 0.0 else w, 2.0 * half, 2.0 * aside
        out[i, 5] = 1.0 if vulnerable[i] or abs(w) > abs(u) else 0.0


@inner_kernel
def _comes_in(seen: FloatArray, v: float, car: EgoOutline, slack: float, late: float) -> bool:
    """Return whether an agent beside the band enters it before the ego is past and, if it crosses,
    leaves late enough.

    `slack` s are added to the first time; `late` s are subtracted from the first and from the time
    of leaving.
    """
    gap, u, aside, towards = seen[0], seen[1], seen[2], seen[3]
    if towards <= 0.0 or v <= u or gap < 0.0:
        return False
    enters = aside / towards
    passed = (gap + car.length + seen[4]) / (v - u) + slack - late
    leaves = (aside + car.width + seen[6]) / towards
    return enters < passed and not (seen[5] > 0.0 and leaves - late < gap / (v - u))


@inner_kernel
def _cc_acceleration(
    seen: FloatArray,
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
    for i in range(len(seen)):
        nearer[i] = max(nearer[i] + STEP_S * seen[i, 3], 0.0) if np.isfinite(seen[i, 0]) else 0.0
        brakes = accel[i] <= -CC_LEAD_MPS2
        hazard = False  # (1) to (4)
        if np.isfinite(seen[i, 0]) and seen[i, 2] < 0.0:
            hazard = brakes or v - seen[i, 1] > CC_CLOSING_MPS
        elif np.isfinite(seen[i, 0]) and seen[i, 5] > 0.0:
            hazard = _comes_in(seen[i], v, car, 0.0, late)
        elif np.isfinite(seen[i, 0]):
            hazard = seen[i, 3] > CC_TOWARDS_MPS and nearer[i] > CC_WANDER_M and seen[i, 0] > 0.0
        clock[i] = clock[i] + STEP_S if hazard else 0.0
        near = seen[i, 2] < 0.0 and seen[i, 0] < 2.0 + CC_THW_S * v
        held = held or hazard or near
        if not hazard:
            continue
        closing = v - seen[i, 1]
        critical = closing > 0.0 and seen[i, 0] < CC_TTC_S * closing
        critical = critical or (brakes and seen[i, 2] < 0.0 and seen[i, 0] < CC_THW_S * v)
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
    """Return PFS (8)."""
    reach = v * FSM_REACT_S - u * u / (2.0 * FSM_LEAD_MPS2)
    safe = reach + v * v / (2.0 * FSM_COMFORT_MPS2) + FSM_SAFE_M
    return fsm_fuzzy(gap - FSM_MARGIN_M, safe, reach + v * v / (2.0 * FSM_HARDEST_MPS2))


@kernel
def fsm_critical(gap: float, v: float, u: float, a: float) -> float:
    """Return CFS (9)."""
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
def _fsm_acceleration(seen: FloatArray, car: EgoOutline, v: float, a: float, late: float) -> float:
    """Return the acceleration of "fsm" without its reaction time."""
    hardest = 0.0
    for i in range(len(seen)):
        gap, u = seen[i, 0], seen[i, 1]
        if not np.isfinite(gap) or not (
            seen[i, 2] < 0.0 or _comes_in(seen[i], v, car, FSM_AHEAD_S, late)
        ):
            continue
        deceleration, critical = (
            FSM_COMFORT_MPS2 * fsm_proactive(gap, v, u),
            fsm_critical(gap, v, u, a),
        )
        if critical > 0.0:
            deceleration = FSM_COMFORT_MPS2 + (FSM_HARDEST_MPS2 - FSM_COMFORT_MPS2) * critical
        hardest = max(hardest, deceleration)  # (7)
    return -hardest


@inner_kernel
def _first_touch(
    rear: tuple[float, float, float, float],
    k: int,
    car: EgoOutline,
    others: OtherBoxes,
    left_out: BoolArray,
) -> int:
    """Return the first counted agent that touches the ego (rear axle x, y, yaw, v) at step k, -1;
    update `left_out`.
    """
    x, y, yaw, v = rear
    cx, cy = x + car.axle * cos(yaw), y + car.axle * sin(yaw)
    for i in range(len(left_out)):
        if left_out[i] or not others.there[i, k] or not touches(cx, cy, yaw, car, others, i, k):
            continue
        behind = is_behind(x, y, yaw, others.pose[0, i, k], others.pose[1, i, k])
        if behind or v <= STANDING_MPS or k == 0 or not others.there[i, k - 1]:
            left_out[i] = True
        else:
            return i
    return -1


@inner_kernel
def _least_clearance(
    least: float,
    x: float,
    y: float,
    yaw: float,
    car: EgoOutline,
    pose: FloatArray,
    size: FloatArray,
) -> float:
    """Return the lesser of `least` (NaN: none yet) and the distance (6) of the ego (rear axle x, y)
    to an agent.
    """
    cx, cy = x + car.axle * cos(yaw), y + car.axle * sin(yaw)
    reach = 0.5 * (hypot(car.length, car.width) + hypot(size[0], size[1]))
    if hypot(pose[0] - cx, pose[1] - cy) - reach >= least:
        return least
    found = clearance(
        cx, cy, yaw, car.length, car.width, pose[0], pose[1], pose[2], size[0], size[1]
    )
    return least if least <= found else found


@kernel
def _drive(
    driver: int,
    line: SpeedLine,
    start: FloatArray,
    car: EgoOutline,
    others: OtherBoxes,
    vulnerable: BoolArray,
    about: int,
    late: float,
) -> tuple[FloatArray, int, int, float]:
    """Return rows s, v, a from `start` (s, l, v) to the first touch or end, and the last 3 fields
    of `ReferenceDrive`.

    After the first touch the drive continues through the agent until both are apart, to measure the
    depth.
    """
    knots, coef, there, pose = line.knots, line.coef, others.there, others.pose
    n, steps = there.shape
    out, seen = np.zeros((3, steps)), np.full((n, 7), np.nan)
    clock, nearer, left_out = np.zeros(n), np.zeros(n), np.zeros(n, np.bool_)
    s, v, a, waited, braking, meets, least = start[0], start[2], 0.0, 0.0, False, -1, np.nan
    k = 0
    for k in range(steps):
        out[0, k], out[1, k], out[2, k] = s, v, a
        u = min((s - start[0]) / max(RETURN_S * start[2], 10.0), 1.0)
        l = start[1] * (1.0 - u * u * (3.0 - 2.0 * u))
        x, y, yaw, _ = line_frame(knots, coef, s)
        x, y = x - l * sin(yaw), y + l * cos(yaw)
        hit = _first_touch((x, y, yaw, v), k, car, others, left_out)
        if hit >= 0 and meets < 0:
            meets, about, least = k, hit, np.nan
        apart = np.nan
        for i in range(n):
            if (i == about or about == ANY) and there[i, k] and not left_out[i]:
                apart = _least_clearance(apart, x, y, yaw, car, pose[:, i, k], others.size[i])
        least = least if least <= apart or np.isnan(apart) else apart  # (6)
        if meets >= 0 and not apart <= 0.0:
            return out[:, : meets + 1], meets, about, least
        if s >= knots[-1]:
            break
        wish = 0.0
        if driver != PASSIVE:
            _observe(line, k, s, l, car, others, vulnerable, seen)
        if driver == CC:
            wish = _cc_acceleration(seen, others.accel[:, k], car, v, clock, nearer, late, braking)
            braking = v > 0.0 and wish <= -CC_BRAKE_MPS2
        elif driver == FSM:
            wish = _fsm_acceleration(seen, car, v, a, late)
            waited = waited + STEP_S if wish < 0.0 else 0.0
            wish = wish if waited > FSM_REACT_S + late + 1e-9 else 0.0
        at = min(max(int((s - knots[0]) / (knots[1] - knots[0])), 0), len(knots) - 1)
        if v > line.limits[at]:
            wish = min(wish, -EASE_MPS2)
        a_next = min(max(wish, a - JERK_MPS3 * STEP_S), a + JERK_MPS3 * STEP_S)
        v_next = max(v + 0.5 * STEP_S * (a + a_next), 0.0)
        s += 0.5 * STEP_S * (v + v_next)
        v, a = v_next, (a_next if v_next > 0.0 else 0.0)
    return out[:, : (k if meets < 0 else meets) + 1], meets, about if meets >= 0 else -1, least


AVOIDS = Reduction("avoids", lambda series: (float(series.value[0] > 0.0), -1), "1", "none")
APPLIES = Reduction("applies", lambda series: (1.0, -1), "1", "none", empty=0.0)
MARGIN = Reduction("margin", lambda series: (float(series.value[0]), -1), "m", "higher")


def _reference(trace: Trace, scenario: Scenario, *, driver: str) -> Measured:
    found = scenario.references.verdicts.get(driver)
    if found is None:
        return Unavailable("the reference drivers were not asked")
    applies = found.outcome is not Avoidability.NOT_APPLICABLE
    value = np.array([found.margin if applies else np.nan])
    return Series(trace.ego.t[:1], value, (found.reason,), f"not applicable: {found.reason}")


REFERENCE = tuple(
    Metric(
        f"reference_{driver}",
        "m",
        "higher",
        (Mode.CLOSED,),
        partial(_reference, driver=driver),
        (AVOIDS, APPLIES, MARGIN),
        meaning,
        source,
        2,
        formula="the reference driver, braking on the ego's line among the tracks as logged",
        needs="avoids and margin: an agent that the ego would meet at constant speed",
    )
    for driver, source, meaning in (
        (
            "cc",
            "UN R157, Annex 4, Appendix 3",
            "Least distance that the competent and careful driver leaves to the agent that one who "
            "does not brake would "
            "touch, negative where it touches it; it evaluates a cut-in from 0.375 m on, JRC's "
            "code from the ego's width "
            "on.",
        ),
        (
            "fsm",
            "Mattas et al., Accid. Anal. Prev. 148 (2020) 105794",
            "Least distance that the driver of the fuzzy safety model leaves to the agent that one "
            "who does not brake "
            "would touch, negative where it touches it.",
        ),
    )
)
