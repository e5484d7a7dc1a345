"""What scenes show of a plan and of the agents: decisions, the agents that are drawn in full, and
the positions at full seconds.

An agent in full has its name and its prediction; the others are boxes alone.
"""

from __future__ import annotations

from collections.abc import Container, Sequence

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.logs.plan import Decision, DecisionKind, Plan, PlanSummary
from replan.logs.states import Trajectory

NEAREST = 6
"""Number of agents nearest to the ego that are drawn in full."""
NEAR_M = 40.0
"""Agents farther from the ego are drawn in full only with a decision, m."""
PATH_POINTS = 40
"""Largest number of points of the path of an alternative."""


def decided(plan: Plan | PlanSummary) -> dict[str, Decision]:
    """The decision that is shown at each agent: the last one that is not "ignore"."""
    return {
        artefact.agent: artefact
        for artefact in plan.internals
        if isinstance(artefact, Decision) and artefact.kind is not DecisionKind.IGNORE
    }


def rows_in_full(
    ids: Sequence[str],
    x: FloatArray,
    y: FloatArray,
    decided_on: Container[str],
    ego: tuple[float, float],
) -> IntArray:
    """Rows of the agents drawn in full, increasing: the `NEAREST` within `NEAR_M`, and those with a
    decision.

    Args:
        ids: The agents `(n,)`.
        x: The first coordinate of each in the world, m, `(n,)`.
        y: The second coordinate of each, m, `(n,)`.
        decided_on: The agents with a decision.
        ego: The ego's position in the world, m.
    """
    if len(ids) <= NEAREST:
        return np.arange(len(ids))
    distances_m = np.hypot(x - ego[0], y - ego[1])
    nearest = np.argsort(distances_m, kind="stable")[:NEAREST]
    named = [row for row, name in enumerate(ids) if name in decided_on]
    return np.union1d(nearest[distances_m[nearest] <= NEAR_M], named).astype(np.int64)


def plan_seconds(plan: Plan) -> FloatArray:
    """Positions `(n, 2)` of a plan at each full second after its start, m."""
    path = plan.trajectory
    t = np.arange(path.t[0] + 1.0, path.t[-1] + 1e-6, 1.0)
    return np.column_stack([np.interp(t, path.t, path.x), np.interp(t, path.t, path.y)])


def path_of(path: Trajectory) -> FloatArray:
    """Positions `(n, 2)` of a trajectory, m, at most `PATH_POINTS`."""
    rows = np.linspace(0, len(path) - 1, min(len(path), PATH_POINTS)).round().astype(np.int64)
    return np.column_stack([path.x[rows], path.y[rows]])


def score_ranks(plan: Plan) -> list[float]:
    """The place of each alternative's score between the lowest (0) and the highest (1) of a plan;
    0.5 where they do not differ, 0 without a score.
    """
    scores = np.array([alternative.score for alternative in plan.alternatives])
    low, high = np.fmin.reduce(scores), np.fmax.reduce(scores)
    ranks = (scores - low) / (high - low) if high > low else np.full(len(scores), 0.5)
    return [float(rank) for rank in np.where(np.isfinite(scores), ranks, 0.0)]
