"""Which agents are drawn in full: in dense traffic, a picture that shows all alike shows nothing.

(1) in full = the agents that the plan decides about (not "ignore"), and the `NEAREST` nearest within `NEAR_M`
(2) few     = all agents, if there are no more than `NEAREST`

The others are faint boxes without a name, an arrow or a predicted path.
"""

from __future__ import annotations

from collections.abc import Container, Sequence

import numpy as np

from logs.kernel import FloatArray, IntArray
from logs.trace import Decision, DecisionKind, Plan

NEAREST = 6
NEAR_M = 40.0


def decided(plan: Plan) -> dict[str, Decision]:
    """The decision that is shown at each agent: the last one that is not "ignore"."""
    return {
        artefact.agent: artefact
        for artefact in plan.internals
        if isinstance(artefact, Decision) and artefact.kind is not DecisionKind.IGNORE
    }


def in_full(
    ids: Sequence[str], x: FloatArray, y: FloatArray, about: Container[str], ego: tuple[float, float]
) -> IntArray:
    """The rows, increasing, of the agents that are drawn in full: (1), (2).

    Args:
        ids: `(n,)`.
        x: World, m, `(n,)`; `y` likewise.
        y: See there.
        about: The agents that the plan decides about.
        ego: Position of the ego.
    """
    if len(ids) <= NEAREST:
        return np.arange(len(ids))
    away = np.hypot(x - ego[0], y - ego[1])
    near = {int(i) for i in np.argsort(away, kind="stable")[:NEAREST] if away[i] <= NEAR_M}
    return np.array(sorted(near | {i for i, name in enumerate(ids) if name in about}), dtype=np.int64)


def plan_seconds(plan: Plan) -> FloatArray:
    """Positions `(n, 2)` of a plan at each full second after its start, m."""
    path = plan.trajectory
    t = np.arange(path.t[0] + 1.0, path.t[-1] + 1e-6, 1.0)
    return np.column_stack([np.interp(t, path.t, path.x), np.interp(t, path.t, path.y)])
