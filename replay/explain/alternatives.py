"""What else a planner had: why it does not pass, and which bounds its solution touches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from logs.kernel import FloatArray
from logs.trace import Candidates, Corridor, Graph, LaneOption, Plan, StGraph

KEEP, PASSING = "keep", "passing"
"""The lane option of the lane that is driven; the stage that weighs driving past who is slower."""
TOUCH_M = 0.1
"""A solution nearer to a bound than this touches it."""
NOISE = 1e-6
"""A cost of no more is what the tolerance of a solver leaves of none."""
SHOWS = 1e-3
"""A term of less than this share of all does not show in the three digits of their sum."""
BOUND_M = 6.0
"""An obstacle bounds a solution from no farther than this: gaps are kept to it."""


@dataclass(frozen=True, slots=True)
class Touch:
    """A bound that a solution touches.

    Attributes:
        plane: "S-T" or "S-L".
        bound: "upper" or "lower".
        agent: Whose outline lies beyond it, empty where none does.
        first: From where to where, s from the frame (S-T) or station, m (S-L).
        last: See there.
        at: The solution there, m.
    """

    plane: str
    bound: str
    agent: str
    first: float
    last: float
    at: float


def telling(terms: Sequence[tuple[str, float]]) -> list[tuple[str, float]]:
    """The terms of a cost that tell something: neither noise nor beyond the digits of their sum; what is no number."""
    least = max(NOISE, SHOWS * sum(abs(value) for _, value in terms if isfinite(value)))
    return [(name, value) for name, value in terms if abs(value) > least or not isfinite(value)]


def not_passed(plan: Plan) -> tuple[str, ...]:
    """Why no agent is passed, as far as the planner says: other lanes, and its own past who is slower."""
    lanes = [each for each in plan.internals if isinstance(each, LaneOption)]
    if any(not each.against and each.name != KEEP for each in lanes):
        return ()
    beside = [f"{each.name}: {each.against}" for each in lanes if each.against and each.name != KEEP]
    within = [
        reason.removeprefix("pass: ")
        for each in plan.internals
        if isinstance(each, Candidates) and each.stage == PASSING
        for reason, _ in each.rejected
        if reason.startswith("pass: ")
    ]
    return (*(f"in the lane: {reason}" for reason in within), *beside)


def touched(plan: Plan) -> Iterator[Touch]:
    """The bounds that the solutions of a plan's graphs touch."""
    for graph in plan.internals:
        if isinstance(graph, Graph) and graph.corridor is not None and len(graph.qp) > 1:
            for bound in ("upper", "lower"):
                yield from _touches(graph, graph.corridor, bound)


def _touches(graph: Graph, corridor: Corridor, bound: str) -> Iterator[Touch]:
    """The stretches in which the solution touches one side; its start, which is given, does not count."""
    at, x = graph.qp.T
    edge = np.interp(at, corridor.first, _finite(getattr(corridor, bound)))
    inside = (at >= corridor.first[0]) & (at <= corridor.first[-1]) & (np.arange(len(at)) > 0)
    marks = np.diff(np.r_[False, inside & (np.abs(x - edge) < TOUCH_M), False].astype(np.int64))
    plane = "S-T" if isinstance(graph, StGraph) else "S-L"
    for begin, end in zip(np.flatnonzero(marks > 0), np.flatnonzero(marks < 0) - 1, strict=True):
        middle = (begin + end) // 2
        who = _beyond(graph, float(at[middle]), float(edge[middle]), up=bound == "upper")
        if who or plane == "S-L" or x[end] > x[0] + TOUCH_M:
            yield Touch(plane, bound, who, float(at[begin]), float(at[end]), float(x[middle]))


def _finite(values: FloatArray) -> FloatArray:
    return np.clip(values, -1e6, 1e6)


def _beyond(graph: Graph, at: float, edge: float, *, up: bool) -> str:
    """The obstacle whose outline is nearest beyond an edge."""
    best, who = BOUND_M, ""
    for thing in graph.obstacles:
        points = thing.outline
        if not len(points) or not points[:, 0].min() - TOUCH_M <= at <= points[:, 0].max() + TOUCH_M:
            continue
        near = points[np.abs(points[:, 0] - at) <= np.abs(points[:, 0] - at).min() + TOUCH_M]
        away = float(near[:, 1].min() - edge if up else edge - near[:, 1].max())
        if -TOUCH_M <= away < best:
            best, who = away, thing.agent
    return who
