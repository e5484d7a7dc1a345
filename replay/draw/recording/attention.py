"""Who is drawn in full: in dense traffic a picture that shows all alike shows nothing.

(1) in full = those that the plan decides about (not "ignore"), and the `NEAREST` that are nearest, within `NEAR_M`
(2) few     = where no more than `NEAREST` are there, all of them

The others are faint boxes without a name, an arrow and a predicted path.
"""

from __future__ import annotations

from collections.abc import Container, Sequence

import numpy as np

from logs.kernel import FloatArray, IntArray
from logs.trace import Decision, DecisionKind, Plan

NEAREST = 6
NEAR_M = 40.0


def decided(plan: Plan) -> dict[str, Decision]:
    """The decision to be named at each agent: the last that is not "ignore"."""
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
        about: Those that the plan decides about.
        ego: Where the ego is.
    """
    if len(ids) <= NEAREST:
        return np.arange(len(ids))
    away = np.hypot(x - ego[0], y - ego[1])
    near = {int(i) for i in np.argsort(away, kind="stable")[:NEAREST] if away[i] <= NEAR_M}
    return np.array(sorted(near | {i for i, name in enumerate(ids) if name in about}), dtype=np.int64)
