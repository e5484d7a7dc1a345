"""Which lane is driven and why: the lanes that the plans compared (`logs.trace.LaneOption`) and the road."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from logs.kernel import FloatArray
from logs.road import Road, RoadSource
from logs.trace import LaneOption, Plan, PlannedFrame, Said, Trace

KEEP = "keep"
NOT_COMPARED, COMPARED = "keep", "keep: others compared"


def options(plan: Plan | Said) -> tuple[LaneOption, ...]:
    """The lanes that a plan compared; empty where it compared none."""
    return tuple(artefact for artefact in plan.internals if isinstance(artefact, LaneOption))


def taken(some: Sequence[LaneOption]) -> str:
    """The name of the option that was taken."""
    return next((option.name for option in some if not option.against), KEEP)


@dataclass(frozen=True)
class Change:
    """A change of lane under way: the option that was taken, when, and why."""

    name: str
    t: float
    reason: str


def changes_under_way(frames: Sequence[PlannedFrame], lanes: Sequence[int | None]) -> list[Change | None]:
    """For each frame the change that is under way: from where it is decided until the ego has left its lane.

    Args:
        frames: Of the trace.
        lanes: The lane under the ego at each of them.
    """
    out: list[Change | None] = []
    change, left = None, None
    for frame, lane in zip(frames, lanes, strict=True):
        some = options(frame.plan)
        if taken(some) != KEEP:
            change, left = Change(taken(some), frame.t, told(some)), lane
        elif lane != left:
            change = None
        out.append(change)
    return out


def choices(frames: Sequence[PlannedFrame], lanes: Sequence[int | None]) -> list[str]:
    """For the row of states: whether the lane is kept, compared with others, or a change is under way."""
    return [
        f"change {change.name}" if change else COMPARED if options(frame.plan) else NOT_COMPARED
        for frame, change in zip(frames, changes_under_way(frames, lanes), strict=True)
    ]


def lanes_driven(trace: Trace, road: Road) -> list[int | None]:
    """The drivable lane under the ego's reference point at each frame; where lanes overlap, the one it came along."""
    if road.source is not RoadSource.LANES:
        return [None] * len(trace.frames)
    out = list[int | None]()
    for x, y in places(trace).tolist():
        under = [lane.id for lane in road.lanes_at(x, y) if lane.drivable]
        before = road.lanes.get(out[-1]) if out and out[-1] is not None else None
        onward = [i for i in under if before is not None and (i == before.id or i in before.successors)]
        first = under[0] if under else None
        out.append(min(onward, key=lambda i: before is None or i != before.id) if onward else first)
    return out


def places(trace: Trace) -> FloatArray:
    """Where the ego is at each frame `(f, 2)`, m."""
    ego, t = trace.ego, np.array([frame.t for frame in trace.frames])
    return np.column_stack([np.interp(t, ego.t, ego.x), np.interp(t, ego.t, ego.y)])


def told(some: Sequence[LaneOption]) -> str:
    """Why an option was taken, against each of the others, in a sentence."""
    name = taken(some)
    chosen = next(option for option in some if option.name == name)
    others = "; ".join(f"{option.name} {_cost(option)}" for option in some if option is not chosen)
    return f"costs {_cost(chosen)} instead of {others}"


def listed(some: Sequence[LaneOption]) -> list[tuple[str, str, str]]:
    """Of each option its name, its cost in words, and why not; of the one that was taken, "taken"."""
    name = taken(some)
    return [(option.name, _cost(option), "taken" if option.name == name else option.against) for option in some]


def _cost(option: LaneOption) -> str:
    """The sum and the terms that matter."""
    terms = ", ".join(f"{name} {value:.1f}" for name, value in option.terms if abs(value) >= 0.05)
    return f"{option.cost:.1f} s" + (f" ({terms})" if terms else "")
