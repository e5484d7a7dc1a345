"""What is wrong with the ego's log.

Between samples k and k + 1, dt apart, d apart, the speeds v and v':

(1) gap     dt > `GAP_S` and > `RARE` medians of dt
(2) jump    d - max(|v|, |v'|) dt - b dt^2 / 2 > `JUMP_M`,   b = `HARDEST_MPS2`
(3) speed   sum d / sum (|v| + |v'|) dt / 2  off 1 by more than `SPEED_OFF`, over a way of `WAY_M` at least
(4) units   the same near a factor of `FACTORS`, within `NEAR`
(5) heading yaw off the direction of d (or its opposite, in reverse) by more than `TURNED_RAD` in the median, where d is
            at least `STEP_M`;  a step of the yaw of more than `FLIP_RAD` within `GAP_S`
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from logs.scenario import Scenario
from logs.states import wrapped
from metrics.health.finding import Finding, Kind

GAP_S = 0.5
"""As long as an agent that is sampled often may be unseen (`logs.presence`), s."""
RARE = 5.0
"""Intervals."""
JUMP_M = 0.5
"""More than a car's localisation is off from one sample to the next, m."""
HARDEST_MPS2 = 12.0
"""More than tyres give, m/s2."""
SPEED_OFF = 0.1
"""Wheel speeds are within a few per cent, also on worn tyres."""
WAY_M = 10.0
"""Way from which a factor can be told from noise, m."""
FACTORS = {
    3.6: "the speeds look like km/h",
    2.237: "the speeds look like mph",
    100.0: "the speeds look like cm/s",
    1000.0: "the speeds look like mm/s, the positions like km, or the times like ms",
    0.3048: "the positions look like feet",
    0.01: "the positions look like cm",
    0.001: "the positions look like mm",
}
"""Way by speed over way by positions, where one of them has another unit."""
NEAR = 0.04
"""How near to a factor, as a share."""
STEP_M = 0.3
"""Way over which a direction can be seen, m."""
TURNED_RAD = 0.5
"""About 30 degrees: more than the slip of a car that is driven, rad."""
FLIP_RAD = 1.0
"""More than any car turns between two samples, rad."""


def gaps(scenario: Scenario) -> Iterator[Finding]:
    """(1)."""
    t = scenario.ego.t
    dt = np.diff(t)
    if not len(dt):
        return
    for k in np.flatnonzero((dt > GAP_S) & (dt > RARE * np.median(dt))):
        text = f"no ego state for {dt[k]:.2f} s"
        yield Finding(Kind.EGO_GAP, "ego", "", float(t[k]), float(t[k + 1]), float(dt[k]), "s", text)


def jumps(scenario: Scenario) -> Iterator[Finding]:
    """(2)."""
    ego = scenario.ego
    dt, d = np.diff(ego.t), np.hypot(np.diff(ego.x), np.diff(ego.y))
    fastest = np.maximum(np.abs(ego.v[:-1]), np.abs(ego.v[1:]))
    excess = d - fastest * dt - 0.5 * HARDEST_MPS2 * dt**2
    for k in np.flatnonzero(excess > JUMP_M):
        text = f"the ego jumps {d[k]:.1f} m in {dt[k]:.2f} s, at {fastest[k]:.1f} m/s"
        yield Finding(Kind.EGO_JUMP, "ego", "", float(ego.t[k]), float(ego.t[k + 1]), float(d[k]), "m", text)


def speed(scenario: Scenario) -> Iterator[Finding]:
    """(3), (4)."""
    ego = scenario.ego
    way = float(np.hypot(np.diff(ego.x), np.diff(ego.y)).sum())
    told = float((0.5 * np.diff(ego.t) * (np.abs(ego.v[1:]) + np.abs(ego.v[:-1]))).sum())
    if max(way, told) < WAY_M or abs(way - told) <= SPEED_OFF * max(way, told):
        return
    span = float(ego.t[0]), float(ego.t[-1])
    factor = told / way if way > 0.0 else np.inf
    text = f"the ego's positions go {way:.1f} m, its speed {told:.1f} m: {factor:.3g} times as far"
    for known, said in FACTORS.items():
        if abs(factor / known - 1.0) < NEAR:
            yield Finding(Kind.UNITS, "ego", "", *span, factor, "x", f"{text}; {said}")
            return
    yield Finding(Kind.EGO_SPEED, "ego", "", *span, factor, "x", text)


def heading(scenario: Scenario) -> Iterator[Finding]:
    """(5)."""
    ego = scenario.ego
    dx, dy = np.diff(ego.x), np.diff(ego.y)
    moved = np.hypot(dx, dy) >= STEP_M
    if moved.any():
        way = np.arctan2(dy[moved], dx[moved]) + np.where(ego.v[1:][moved] < 0.0, np.pi, 0.0)
        off = float(np.median(np.abs(wrapped(ego.yaw[1:][moved] - way))))
        if off > TURNED_RAD:
            text = f"the ego's heading is {off:.2f} rad off the way it goes, in the median"
            yield Finding(Kind.EGO_HEADING, "ego", "", float(ego.t[0]), float(ego.t[-1]), off, "rad", text)
    turn, dt = np.abs(wrapped(np.diff(ego.yaw))), np.diff(ego.t)
    for k in np.flatnonzero((turn > FLIP_RAD) & (dt < GAP_S)):
        text = f"the ego's heading turns by {turn[k]:.2f} rad in {dt[k]:.2f} s"
        span = float(ego.t[k]), float(ego.t[k + 1])
        yield Finding(Kind.EGO_HEADING, "ego", "", *span, float(turn[k]), "rad", text)
