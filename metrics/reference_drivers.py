"""Reference drivers: would a careful driver, braking on the ego's line, have avoided the collisions
in a log?

A driver is a point mass with the ego's box on a reference line, among the tracks as logged. It
keeps its speed, slows down for curves (3 m/s2 lateral, at 1.5 m/s2), brakes by its model
(`driver_models`), never accelerates and never steers; an initial offset from the line decays over
`RETURN_S`. A log reacts only to its own ego: a road user that hits the driver from behind or while
it stands is not counted and is ignored from then on, as is one that appears at the driver's place.

The margin of a verdict is the least distance between the driver's box and the agent's over the
whole drive:
(1) avoidable: the least gap to the agent that a driver without braking would touch, m, > 0
    unavoidable: minus the depth of the touch (the shortest shift that separates the boxes); the
    drive continues through it not applicable: the least gap of a driver without braking to any
    agent
A verdict is marginal where its margin, or that of the drive without braking, is within
`MARGINAL_M`, or if a driver that judges `JUDGED_S` earlier or later has another outcome; this
shifts the tests of crossing and of moving towards the band, and the reaction time.

`replan.replay.loop.reference_drives`, which knows the line, adds the verdicts to the scenario
(`Scenario.references`). Each driver has three rows: `reference_cc.applies` is 1 if an ego that does
not brake would touch an agent, else 0; if it is 1, `reference_cc.avoids` is 1 or 0, and
`reference_cc.margin` is the margin in metres (negative: not avoided).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import cos, hypot, nan, sin

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.reference_line import ReferenceLine, line_frame
from replan.logs.scenario import Avoidability, DriverVerdict, Scenario
from replan.logs.shapes import clearance
from replan.logs.states import EgoState
from replan.logs.trace import Trace
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
from replan.metrics.driver_models import (
    CC_BRAKE_MPS2,
    FSM_REACT_S,
    STEP_S,
    SpeedLine,
    cc_acceleration,
    fsm_acceleration,
    observe,
)
from replan.metrics.metric import Measured, Reduction, Series, Unavailable, metric

# Effect of 5 cm of position noise on a margin at 10 Hz (benchmarks/verdicts.py), m
MARGINAL_M = 0.5
JUDGED_S = 0.15  # A fifth of both drivers' reaction time
LONGEST_S = 60.0  # Longest drive, s
RETURN_S = 3.0
CURVE_MPS2, EASE_MPS2 = 3.0, 1.5
JERK_MPS3 = 12.65
PASSIVE, CC, FSM = 0, 1, 2
ANY = -1  # Value of `about`: the least distance to any agent


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
        present = present_between(tracks, t[0], t[-1])
        if len(present) < len(tracks):
            tracks = tracks.taken(
                np.isin(np.repeat(np.arange(len(tracks)), np.diff(tracks.offsets)), present)
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
        rows, *outcome = _drive(
            driver, self.line, self.start, self.car, self.others, self.vulnerable, about, late
        )
        return ReferenceDrive(*rows, *outcome)


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
    drive = course.drive(driver, about=passive.agent)
    agent, margin, end = passive.agent if drive.meets < 0 else drive.agent, drive.least, drive.meets
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
        met = f"meets {about} after {t[end] - t[0]:.1f} s at {drive.v[end]:.1f} m/s"
        outcome, reason = Avoidability.UNAVOIDABLE, f"unavoidable {by}: {met}"
    braking = np.flatnonzero(drive.a < -1.0)
    brakes, meets = (
        float(t[braking[0]]) if len(braking) else nan,
        float(t[end]) if end >= 0 else nan,
    )
    speed, agent_id = float(drive.v[end]), course.tracks.ids[agent]
    return DriverVerdict(
        name, outcome, reason, brakes, meets, speed, agent_id, margin, marginal=marginal
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
    least: float  # Least distance to the agent `about`, m (1); after a touch, minus its depth


@kernel
def curve_speeds(s: FloatArray, kappa: FloatArray) -> FloatArray:
    """Return the speed `(n,)` from which the driver can slow down for each curve ahead, m/s."""
    speeds = np.empty(len(s))
    for i in range(len(s) - 1, -1, -1):
        speeds[i] = (CURVE_MPS2 / max(abs(kappa[i]), 1e-9)) ** 0.5
        if i < len(s) - 1:
            speeds[i] = min(
                speeds[i], (speeds[i + 1] ** 2 + 2.0 * EASE_MPS2 * (s[i + 1] - s[i])) ** 0.5
            )
    return speeds


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
    """Return the lesser of `least` (NaN: none yet) and the distance (1) of the ego (rear axle x, y)
    to an agent.
    """
    cx, cy = x + car.axle * cos(yaw), y + car.axle * sin(yaw)
    reach = 0.5 * (hypot(car.length, car.width) + hypot(size[0], size[1]))
    if hypot(pose[0] - cx, pose[1] - cy) - reach >= least:
        return least
    distance = clearance(
        cx, cy, yaw, car.length, car.width, pose[0], pose[1], pose[2], size[0], size[1]
    )
    return least if least <= distance else distance


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
    knots, coef = line.knots, line.coef
    present, pose = others.there, others.pose
    n, steps = present.shape
    rows, views = np.zeros((3, steps)), np.full((n, 7), np.nan)
    clock, nearer, left_out = np.zeros(n), np.zeros(n), np.zeros(n, np.bool_)
    s, v, a = start[0], start[2], 0.0
    waited, braking = 0.0, False
    meets, least = -1, np.nan
    k = 0
    for k in range(steps):
        rows[0, k], rows[1, k], rows[2, k] = s, v, a
        u = min((s - start[0]) / max(RETURN_S * start[2], 10.0), 1.0)
        l = start[1] * (1.0 - u * u * (3.0 - 2.0 * u))
        x, y, yaw, _ = line_frame(knots, coef, s)
        x, y = x - l * sin(yaw), y + l * cos(yaw)
        hit = _first_touch((x, y, yaw, v), k, car, others, left_out)
        if hit >= 0 and meets < 0:
            meets, about, least = k, hit, np.nan
        apart = np.nan
        for i in range(n):
            if (i == about or about == ANY) and present[i, k] and not left_out[i]:
                apart = _least_clearance(apart, x, y, yaw, car, pose[:, i, k], others.size[i])
        least = least if least <= apart or np.isnan(apart) else apart  # (1)
        if meets >= 0 and not apart <= 0.0:
            return rows[:, : meets + 1], meets, about, least
        if s >= knots[-1]:
            break
        wish = 0.0
        if driver != PASSIVE:
            observe(line, k, s, l, car, others, vulnerable, views)
        if driver == CC:
            wish = cc_acceleration(views, others.accel[:, k], car, v, clock, nearer, late, braking)
            braking = v > 0.0 and wish <= -CC_BRAKE_MPS2
        elif driver == FSM:
            wish = fsm_acceleration(views, car, v, a, late)
            waited = waited + STEP_S if wish < 0.0 else 0.0
            wish = wish if waited > FSM_REACT_S + late + 1e-9 else 0.0
        knot = min(max(int((s - knots[0]) / (knots[1] - knots[0])), 0), len(knots) - 1)
        if v > line.limits[knot]:
            wish = min(wish, -EASE_MPS2)
        a_next = min(max(wish, a - JERK_MPS3 * STEP_S), a + JERK_MPS3 * STEP_S)
        v_next = max(v + 0.5 * STEP_S * (a + a_next), 0.0)
        s += 0.5 * STEP_S * (v + v_next)
        v, a = v_next, (a_next if v_next > 0.0 else 0.0)
    return rows[:, : (k if meets < 0 else meets) + 1], meets, about if meets >= 0 else -1, least


def _avoids(series: Series) -> tuple[float, int]:
    return float(series.value[0] > 0.0), -1


AVOIDS = Reduction("avoids", _avoids, "1", "none")
APPLIES = Reduction("applies", lambda series: (1.0, -1), "1", "none", empty=0.0)
MARGIN = Reduction("margin", lambda series: (float(series.value[0]), -1), "m", "higher")

_reference_metric = partial(
    metric,
    unit="m",
    better="higher",
    reductions=(AVOIDS, APPLIES, MARGIN),
    needs="avoids and margin: an agent that the ego would meet at constant speed",
    version=2,
)


@_reference_metric(source="UN R157, Annex 4, Appendix 3")
def reference_cc(trace: Trace, scenario: Scenario) -> Measured:
    """Least distance that the competent and careful driver leaves to the agent that one who does
    not brake would touch, negative where it touches it; it evaluates a cut-in from 0.375 m on,
    JRC's code from the ego's width on.

    Formula: the reference driver, braking on the ego's line among the tracks as logged
    """
    return _margin_of("cc", trace, scenario)


@_reference_metric(source="Mattas et al., Accid. Anal. Prev. 148 (2020) 105794")
def reference_fsm(trace: Trace, scenario: Scenario) -> Measured:
    """Least distance that the driver of the fuzzy safety model leaves to the agent that one who
    does not brake would touch, negative where it touches it.

    Formula: the reference driver, braking on the ego's line among the tracks as logged
    """
    return _margin_of("fsm", trace, scenario)


def _margin_of(driver: str, trace: Trace, scenario: Scenario) -> Measured:
    verdict = scenario.references.verdicts.get(driver)
    if verdict is None:
        return Unavailable("the reference drivers were not asked")
    applies = verdict.outcome is not Avoidability.NOT_APPLICABLE
    margin = np.array([verdict.margin if applies else np.nan])
    return Series(trace.ego.t[:1], margin, (verdict.reason,), f"not applicable: {verdict.reason}")
