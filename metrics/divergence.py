"""Divergence of a drive from its log, closed loop: how far, and from when on the replay is weak
evidence.

In the log, the others reacted to the logged ego. With the ego's position p(t), and the logged
position q(t), speed v(t) and heading h(t):

(1) d(t) = |p - q|, along(t) = (p - q) . h, across(t) = (p - q) x h
(2) the drive departs from the log if |along| > max(v AWAY_S, `LENGTH_M`) or |across| > `WIDTH_M`,
    or if a road user is farther than `OFF_M` from its logged position, or is present in only one of
    the two

The replay is weak evidence from the first such step to the end of the drive. `AWAY_S`: one second
of driving is about the least gap that drivers should keep; farther away, the ego may be where
another road user was. At low speed the bound is the length of a car, and sideways the width of a
lane. `OFF_M` is smaller than these bounds, and larger than the differences between resampled
tracks.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.metrics.boxes import each, name_of, some_at
from replan.metrics.metric import Measured, Reduction, Series, Unavailable, counted, metric
from replan.metrics.reductions import COUNT, MAX, share_known

AWAY_S, LENGTH_M, WIDTH_M = 1.0, 5.0, 3.5
OFF_M = 0.5
_NO_DRIVE = Unavailable("the log holds one ego state only: there is no drive to part from")


@metric(
    unit="m",
    better="none",
    reductions=(MAX,),
    needs="a log that holds the ego's drive",
)
def divergence(trace: Trace, scenario: Scenario) -> Measured:
    """Distance between the ego and where the log has it at the same time, while the log's ego
    lasts.

    Formula: |p - q|
    """
    if len(scenario.ego) < 2:
        return _NO_DRIVE
    return Series(trace.ego.t, _distances(trace, scenario)[0])


def _distances(trace: Trace, scenario: Scenario) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return d of (1), and along and across divided by their bounds (2), `(k,)` each; NaN after the
    logged ego ends.
    """
    drive, log = trace.ego, scenario.ego
    x, y, yaw, v = (np.interp(drive.t, log.t, column) for column in (log.x, log.y, log.yaw, log.v))
    dx, dy = drive.x - x, drive.y - y
    c, s = np.cos(yaw), np.sin(yaw)
    lasts = np.where(drive.t <= log.t[-1] + 1e-6, 1.0, np.nan)
    along = (c * dx + s * dy) / np.maximum(np.abs(v) * AWAY_S, LENGTH_M)
    return np.hypot(dx, dy) * lasts, along * lasts, (c * dy - s * dx) / WIDTH_M * lasts


def _first_value(series: Series) -> tuple[float, int]:
    step = int(np.argmax(series.known))
    return float(series.value[step]), step


@metric(
    unit="s",
    better="none",
    reductions=(
        Reduction("from", _first_value),
        Reduction("share", share_known, unit="1", direction="none", empty=0.0),
    ),
    parameters=(
        f"along {AWAY_S:g} s of way, at least {LENGTH_M:g} m",
        f"across {WIDTH_M:g} m",
        f"a road user {OFF_M:g} m",
    ),
    needs="a log that holds the ego's drive",
)
def divergence_weak(trace: Trace, scenario: Scenario) -> Measured:
    """From when on the drive has parted from its log, so that the replay is weak evidence, and the
    share after that.

    Formula: first t: |along| > max(1 s v, 5 m) or |across| > 3.5 m or a road user off
    """
    if len(scenario.ego) < 2:
        return _NO_DRIVE
    t, (_, along, across) = trace.ego.t, _distances(trace, scenario)
    departures = (
        ("the ego along its way", np.abs(along) > 1.0),
        ("the ego across its way", np.abs(across) > 1.0),
        *_displaced_agents(trace, scenario),
    )
    parted = {name: off for name, off in departures if off.any()}
    first = min((int(np.argmax(off)) for off in parted.values()), default=len(t))
    label = "; ".join(name for name, off in parted.items() if off[first])
    weak = np.where(np.arange(len(t)) >= first, t, np.nan)
    return Series(t, weak, (label,) * len(t), "the drive never parts from the log")


@metric(unit="count", better="none", reductions=(COUNT,), parameters=(f"{OFF_M:g} m",))
def displaced(trace: Trace, scenario: Scenario) -> Measured:
    """Road users who were not where the log has them, each once: who gave way, and who was held up
    by them.

    Formula: number of road users farther than this from where the log has them
    """
    agents = _displaced_agents(trace, scenario)
    return counted(trace.ego.t, ((int(np.argmax(off)), name) for name, off in agents))


def _displaced_agents(trace: Trace, scenario: Scenario) -> Iterator[tuple[str, BoolArray]]:
    """Yield the name of each agent that departs from its logged position (2), and at which steps
    `(k,)`.
    """
    log, agents, t = scenario.tracks, trace.agents, trace.ego.t
    index = {name: i for i, name in enumerate(agents.ids)}
    for i, logged, row in each(log, t) if agents is not log else ():
        agent = index.get(log.ids[i], -1)
        off = logged.there[row].copy()
        if agent >= 0:
            moved = some_at(agents, np.array([agent]), t)
            both = moved.there[0] & logged.there[row]
            off = moved.there[0] != logged.there[row]
            off[both] = np.hypot(*(moved.pose[:2, 0] - logged.pose[:2, row])[:, both]) > OFF_M
        if off.any():
            yield name_of(log, i), off
