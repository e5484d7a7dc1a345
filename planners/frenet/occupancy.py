"""Occupancy: what takes a part of the lane for a time, one row each: a standing car, a cyclist, a red light.

A row is a box of stations and offsets with the time until which it holds. The path passes boxes or stops before them;
the speed stage meets them as stations that must not be passed (`st_boundaries.with_stops`). Whoever moves is met where
they are predicted, by their footprints (`st_boundaries`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite

import numpy as np

from logs.kernel import FloatArray
from logs.trace import Decision, DecisionKind
from logs.vehicle import VehicleParameters
from planners.frenet.path import Path


@dataclass(frozen=True, eq=False, slots=True)
class Occupancy:
    """A row.

    Attributes:
        agent: Who or what it is: an agent's id, or a name ("stop line 7").
        s_from: Station at which it begins, m; `s_to` at which it ends.
        l_from: Offset of its right side, m; `l_to` of its left side.
        aside: How much of the box on either side is room for the agent, not the agent, m.
        until: How long it lasts, s from the frame; inf: not known to end.
        aim: Where the ego's front should come to rest before it, m; inf: it is no stop.
        kind: What is decided about it; IGNORE: nothing yet.
        reason: Why.
    """

    agent: str
    s_from: float
    s_to: float = inf
    l_from: float = -inf
    l_to: float = inf
    aside: float = 0.0
    until: float = inf
    aim: float = inf
    kind: DecisionKind = DecisionKind.IGNORE
    reason: str = ""

    @property
    def s_middle(self) -> float:
        """Between its ends, m."""
        return 0.5 * (self.s_from + self.s_to)

    @property
    def decision(self) -> Decision:
        """What is decided about it, and why."""
        return Decision(self.agent, self.kind, "speed", self.reason)


def on_reference(stops: tuple[Occupancy, ...], s: float, vehicle: VehicleParameters) -> tuple[Occupancy, ...]:
    """Stops as distances ahead of a rear axle at station `s` that keeps to the reference line, m, not negative."""
    here = s + vehicle.axle_to_front
    return tuple(replace(stop, s_from=max(stop.s_from - here, 0.0), aim=max(stop.aim - here, 0.0)) for stop in stops)


def on_path(stops: tuple[Occupancy, ...], path: Path, vehicle: VehicleParameters) -> tuple[Occupancy, ...]:
    """The stops that lie on a path, as arc lengths of the rear axle, m, not negative."""
    found = []
    for stop in stops:
        bound, aim = (station - vehicle.axle_to_front for station in (stop.s_from, stop.aim))
        if bound < path.s[-1]:
            bound, aim = (max(float(np.interp(at, path.s, path.sigma)), 0.0) for at in (bound, aim))
            found.append(replace(stop, s_from=bound, aim=aim))
    return tuple(found)


def open_end(stops: Sequence[Occupancy]) -> float:
    """Where the ego should come to rest before the first stop that is not known to end, m; inf: there is none."""
    return min((stop.aim for stop in stops if not isfinite(stop.until)), default=inf)


def upper_bound(stops: Sequence[Occupancy], times: FloatArray, length: float) -> FloatArray:
    """Greatest station `(n,)` that stops on a path allow at times `(n,)`, m; `length` where none stands."""
    upper = np.full(len(times), length)
    for stop in stops:
        upper = np.where(times < stop.until, np.minimum(upper, stop.s_from), upper)
    return upper
