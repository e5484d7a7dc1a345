"""Where two planners part: the first time at which what they drive (in the open loop: plan) differs enough to matter.

(1) parted = the speeds differ by more than PARTED_MPS, or the places by more than PARTED_M across the first one's way

In the open loop the plans are compared AHEAD_S after each frame. Two planners differ in some number from the first
frame on, so that `first_difference` says nothing of them.
"""

from __future__ import annotations

import numpy as np

from logs.names import ShortNames
from logs.states import EgoState
from logs.trace import Decision, DecisionKind, Mode, Plan, PlannedFrame, Trace
from replay.explain.explanation import LONGITUDINAL
from replay.explain.first_difference import FirstDifference

PARTED_MPS, PARTED_M, AHEAD_S = 1.0, 0.5, 3.0
LATERAL = (DecisionKind.NUDGE_LEFT, DecisionKind.NUDGE_RIGHT)


def planners_part(one: Trace, two: Trace) -> FirstDifference | None:
    """Where the drives of two planners part (1), and what each of them decides then; None: nowhere."""
    for old, new in zip(one.frames, two.frames, strict=False):
        t, states = old.t, []
        for trace, frame in ((one, old), (two, new)):
            states.append(trace.ego.at(t) if trace.mode is Mode.CLOSED else _ahead(frame))
        first, second = states
        across = (second.y - first.y) * np.cos(first.yaw) - (second.x - first.x) * np.sin(first.yaw)
        if abs(first.v - second.v) > PARTED_MPS or abs(across) > PARTED_M:  # (1)
            when = f"t = {t:.2f} s" if one.mode is Mode.CLOSED else f"t = {t:.2f} s, in {AHEAD_S:g} s"
            side = f", {abs(across):.1f} m to the {'left' if across > 0.0 else 'right'}"
            before, now = (
                f"{state.v:.1f} m/s ({decided(f.plan)})" for state, f in zip(states, (old, new), strict=True)
            )
            what = f"{when}: {before} -> {now}{side if abs(across) > PARTED_M else ''}"
            return FirstDifference(t, "plan", ShortNames(one.agents.ids)(what))
    return None


def _ahead(frame: PlannedFrame) -> EgoState:
    """The planned state in `AHEAD_S`, or at the plan's end."""
    planned = frame.plan.trajectory
    return planned.at(min(frame.t + AHEAD_S, float(planned.t[-1])))


def decided(plan: Plan) -> str:
    """The strongest decision of a plan about the speed, else about the side, with its agent."""
    decisions = [item for item in plan.internals if isinstance(item, Decision)]
    for kind in (*LONGITUDINAL, *LATERAL):
        agents = list(dict.fromkeys(item.agent for item in decisions if item.kind is kind))
        if agents:
            return f"{kind.value} {agents[0]}{f' and {len(agents) - 1} more' if len(agents) > 1 else ''}"
    return plan.status.value if plan.status.is_fallback else "nothing decided"
