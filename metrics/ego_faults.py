"""Finds faults in the log's ego: gaps, jumps, and speeds, headings and positions that contradict
one another.

Between samples k and k + 1, dt apart, d apart, with the speeds v and v':

(1) gap       dt > `GAP_S` and > `RARE` medians of dt
(2) jump      d - max(|v|, |v'|) dt - b dt^2 / 2 > `JUMP_M`,  b = `BRAKING_MPS2`
(3) speed     sum d / sum (|v| + |v'|) dt / 2  off 1 by more than `SPEED_OFF`, over a distance of
              `DISTANCE_M` at least
(4) units     the same near a factor of `FACTORS`, within `NEAR`
(5) heading   the chords of `replan.logs.chords`, about 1 m each, are more than `TURNED_RAD` off the
              axis of the car in the median, or over a distance of `ASKEW_M`; or opposite to heading
              and speed over a distance of `AGAINST_M`; a step of the yaw of more than `FLIP_RAD`
              within `GAP_S`
(6) point     the positions are explained by a point that is `POINT_M` or more before or behind the
              rear axle (`replan.logs.reference_point`)
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from replan.core.arrays import BoolArray
from replan.logs.chords import ENOUGH_M, Chords
from replan.logs.conventions import TURNED_RAD
from replan.logs.reference_point import place_ahead
from replan.logs.scenario import Scenario
from replan.logs.states import wrapped
from replan.metrics.log_faults import (
    BRAKING_MPS2,
    NEAR,
    FaultKind,
    Finding,
    degrees_question,
    distances,
    unit_meaning,
)

GAP_S = 0.5
"""As long as a frequently sampled agent may be unobserved (`replan.logs.observed`), s."""
RARE = 5.0
"""In medians of the sampling interval."""
JUMP_M = 0.5
"""Errors of a car's localisation change by less between two samples, m."""
SPEED_OFF, DISTANCE_M = 0.1, 10.0
"""Wheel speeds are within a few per cent; over a shorter distance noise hides a factor."""
AGAINST_M, ASKEW_M = 2.0, 10.0
"""Longer than a jump of a localisation; than a tight turn about another point, m."""
FLIP_RAD = 1.0
"""No car turns by more between two samples, rad."""
POINT_M, POINT_EXPLAINED, POINT_NEAR_M = 0.7, 0.8, 0.5
"""Least distance of a point from the rear axle, share of the sideways motion that it explains, and
distance from a known point."""


def gaps(scenario: Scenario) -> Iterator[Finding]:
    """Gaps in the samples of the ego (1)."""
    t, dt = scenario.ego.t, np.diff(scenario.ego.t)
    for k in np.flatnonzero((dt > GAP_S) & (dt > RARE * np.median(dt))) if len(dt) else ():
        text = f"no ego state for {dt[k]:.2f} s"
        yield Finding(FaultKind.EGO_GAP, t[k], t[k + 1], dt[k], text)


def jumps(scenario: Scenario) -> Iterator[Finding]:
    """Find jumps of the ego (2)."""
    ego = scenario.ego
    dt, d = np.diff(ego.t), np.hypot(np.diff(ego.x), np.diff(ego.y))
    fastest = np.maximum(np.abs(ego.v[:-1]), np.abs(ego.v[1:]))
    for k in np.flatnonzero(d - fastest * dt - 0.5 * BRAKING_MPS2 * dt**2 > JUMP_M):
        text = f"the ego jumps {d[k]:.1f} m in {dt[k]:.2f} s, at {fastest[k]:.1f} m/s"
        yield Finding(FaultKind.EGO_JUMP, ego.t[k], ego.t[k + 1], d[k], text)


def speeds(scenario: Scenario) -> Iterator[Finding]:
    """Find speeds of the ego that do not match its positions (3), or match by a factor of units
    (4).
    """
    ego = scenario.ego
    no_gaps = np.zeros(len(ego), np.bool_)
    driven, by_speed = distances(ego.t, ego.x, ego.y, np.abs(ego.v), no_gaps)
    longest = max(driven, by_speed)
    if longest < DISTANCE_M or abs(driven - by_speed) <= SPEED_OFF * longest:
        return
    factor = by_speed / driven if driven > 0.0 else np.inf
    text = (
        f"the ego's positions go {driven:.1f} m, its speed {by_speed:.1f} m: {factor:.3g} times as "
        "far"
    )
    rate = round(factor)
    if rate > 1 and abs(factor / rate - 1.0) < NEAR and (np.diff(ego.t) == 1.0).all():
        text += f'; the times look like frames of {rate} Hz: columns = {{t = "t [{rate} Hz]"}}'
    kind = FaultKind.EGO_SPEED
    if meaning := unit_meaning(factor):
        kind, text = FaultKind.UNITS, f"{text}; {meaning}"
    yield Finding(kind, ego.t[0], ego.t[-1], factor, text, topic="ego")


def headings(scenario: Scenario) -> Iterator[Finding]:
    """Find headings of the ego that do not match its motion (5)."""
    ego = scenario.ego
    chords = Chords.of_ego(ego)
    v = chords.mean(ego.v)
    off = np.abs(wrapped(chords.off(ego.yaw) + np.where(v < 0.0, np.pi, 0.0)))
    askew = np.minimum(off, np.pi - off)  # off the axis of the car
    stretches = [(run, AGAINST_M) for run in _stretches(off >= np.pi - TURNED_RAD)]
    stretches += [(run, ASKEW_M) for run in _stretches(askew > TURNED_RAD)]
    if chords.shows and np.median(askew) > TURNED_RAD:
        stretches = [(slice(0, len(off)), ENOUGH_M)]
    for run, least_m in stretches:
        if run.stop - run.start < 2 or chords.way[run].sum() < least_m:  # one chord may be a jump
            continue
        angle = float(np.median(off[run]))
        begin, end = float(ego.t[chords.first[run][0]]), float(ego.t[chords.last[run][-1]])
        text = (
            f"the ego's heading is {angle:.2f} rad off the way it goes, in the "
            f"median{degrees_question(ego.yaw)}"
        )
        if least_m == AGAINST_M:
            question = "is the speed's sign wrong?"
            if np.median(v[run]) >= 0.0:
                question = "reverse gear without a signed speed?"
            text = (
                "the ego's heading and speed point against the way it goes for "
                f"{end - begin:.1f} s: {question}"
            )
        yield Finding(FaultKind.EGO_HEADING, begin, end, angle, text)
    turn, dt = np.abs(wrapped(np.diff(ego.yaw))), np.diff(ego.t)
    for k in np.flatnonzero((turn > FLIP_RAD) & (dt < GAP_S)):
        text = f"the ego's heading turns by {turn[k]:.2f} rad in {dt[k]:.2f} s"
        yield Finding(FaultKind.EGO_HEADING, ego.t[k], ego.t[k + 1], turn[k], text)


def _stretches(mask: BoolArray) -> list[slice]:
    """Return the stretches in which a mask is true."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False)).tolist()
    return list(map(slice, edges[::2], edges[1::2]))


def point(scenario: Scenario) -> Iterator[Finding]:
    """Find positions of another point than the rear axle (6)."""
    ego, car = scenario.ego, scenario.vehicle
    ahead, explained = place_ahead(ego.t, ego.x, ego.y, ego.yaw)
    if abs(ahead) < POINT_M or explained < POINT_EXPLAINED:
        return
    points = {
        "the centre of its box": car.axle_to_center,
        "its front bumper": car.axle_to_front,
        "its front axle": car.wheelbase,
        "its rear bumper": -car.rear_overhang,
    }
    nearest = min(points, key=lambda name: abs(points[name] - ahead))
    is_near = abs(points[nearest] - ahead) < POINT_NEAR_M
    side = "before" if ahead > 0.0 else "behind"
    text = f"the ego's positions move like a point {abs(ahead):.1f} m {side} its rear axle"
    text += f": {nearest}? (ego_point in [log])" if is_near else ""
    yield Finding(FaultKind.EGO_POINT, ego.t[0], ego.t[-1], ahead, text)
