"""What scenes show besides the road: decisions, agents in full, positions of a plan, and stretches
of a log to look at.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.logs.plan import Decision, DecisionKind, Plan, PlanSummary

NEAREST = 6
NEAR_M = 40.0


@dataclass(frozen=True)
class Marker:
    """A stretch of a log to look at."""

    begin: float  # s since the log's start; `end` likewise
    end: float
    kind: str
    about: str  # Who takes part, and more in words; may be empty

    @property
    def words(self) -> str:
        """What happens, in a line: "cut in: car 12 (gap 3.2 m)"."""
        return ": ".join(filter(None, (self.kind.replace("_", " "), self.about)))

    def lasts_at(self, t: float) -> bool:
        """Whether a time, s, is in the stretch."""
        return self.begin <= t + 1e-9 and t < self.end - 1e-9


def decided(plan: Plan | PlanSummary) -> dict[str, Decision]:
    """The decision that is shown at each agent: the last one that is not "ignore"."""
    return {
        artefact.agent: artefact
        for artefact in plan.internals
        if isinstance(artefact, Decision) and artefact.kind is not DecisionKind.IGNORE
    }


def in_full(
    ids: Sequence[str],
    x: FloatArray,
    y: FloatArray,
    about: Container[str],
    ego: tuple[float, float],
) -> IntArray:
    """Rows of the agents drawn in full, increasing: the `NEAREST` within `NEAR_M`, and those with a
    decision.

    `ids`: `(n,)`. `x`: world coordinate, m, `(n,)`. `y`: world coordinate, m, `(n,)`.
    """
    if len(ids) <= NEAREST:
        return np.arange(len(ids))
    distances_m = np.hypot(x - ego[0], y - ego[1])
    nearest = np.argsort(distances_m, kind="stable")[:NEAREST]
    named = [row for row, name in enumerate(ids) if name in about]
    return np.union1d(nearest[distances_m[nearest] <= NEAR_M], named).astype(np.int64)


def plan_seconds(plan: Plan) -> FloatArray:
    """Positions `(n, 2)` of a plan at each full second after its start, m."""
    path = plan.trajectory
    t = np.arange(path.t[0] + 1.0, path.t[-1] + 1e-6, 1.0)
    return np.column_stack([np.interp(t, path.t, path.x), np.interp(t, path.t, path.y)])
