"""Where two planners part, and what each decides then.

Two planners differ in some number from the first frame on. They part at the first time at which
their drives (in open loop: their plans, AHEAD_S after each frame) differ enough to matter:

(1) parted = the speeds differ by more than PARTED_MPS,
        or the places by more than PARTED_M across the first one's way
"""

from __future__ import annotations

import numpy as np

from replan.core.names import ShortNames
from replan.explain.explanation import LONGITUDINAL
from replan.explain.first_difference import FirstDifference
from replan.logs.plan import Decision, DecisionKind, Plan
from replan.logs.trace import Mode, Trace

PARTED_MPS, PARTED_M, AHEAD_S = 1.0, 0.5, 3.0
LATERAL = (DecisionKind.NUDGE_LEFT, DecisionKind.NUDGE_RIGHT)


def planners_part(one: Trace, two: Trace) -> FirstDifference | None:
    """The first time at which two planners part (1), with the decision of each; None if they never
    do.
    """
    for old, new in zip(one.frames, two.frames, strict=False):
        t, states = old.t, []
        for trace, frame in ((one, old), (two, new)):
            planned = frame.plan.trajectory
            t_ahead = min(frame.t + AHEAD_S, float(planned.t[-1]))
            states.append(trace.ego.at(t) if trace.mode is Mode.CLOSED else planned.at(t_ahead))
        first, second = states
        across = (second.y - first.y) * np.cos(first.yaw) - (second.x - first.x) * np.sin(first.yaw)
        if abs(first.v - second.v) > PARTED_MPS or abs(across) > PARTED_M:  # (1)
            instant = (
                f"t = {t:.2f} s" if one.mode is Mode.CLOSED else f"t = {t:.2f} s, in {AHEAD_S:g} s"
            )
            side = f", {abs(across):.1f} m to the {'left' if across > 0.0 else 'right'}"
            before, after = (
                f"{state.v:.1f} m/s ({decided(frame_of_side.plan)})"
                for state, frame_of_side in zip(states, (old, new), strict=True)
            )
            sentence = f"{instant}: {before} -> {after}{side if abs(across) > PARTED_M else ''}"
            return FirstDifference(t, "plan", ShortNames(one.agents.ids)(sentence))
    return None


def decided(plan: Plan) -> str:
    """The strongest decision of a plan about the speed, else about the side, with its agent."""
    decisions = [item for item in plan.internals if isinstance(item, Decision)]
    for kind in (*LONGITUDINAL, *LATERAL):
        agents = list(dict.fromkeys(item.agent for item in decisions if item.kind is kind))
        if agents:
            return (
                f"{kind.value} "
                f"{agents[0]}{f' and {len(agents) - 1} more' if len(agents) > 1 else ''}"
            )
    return plan.status.value if plan.status.is_fallback else "nothing decided"
