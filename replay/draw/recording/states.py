"""Lanes of states over time: the plan's status, decisions, the choice of lane, the lane under the ego, the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle

import numpy as np
import rerun as rr

from logs.kernel import FloatArray
from logs.road import Road
from logs.trace import Decision, DecisionKind, Plan, PlanStatus, Trace
from replay.draw.recording import colours, lane_choice
from replay.draw.recording.columns import ROOM, Instants, Tape

LANES = (PLAN, ALONG, ACROSS, CHOICE, LANE, DRIVE) = (
    "Plan", "Decision-along", "Decision-across", "Choice-of-lane", "Lane", "Drive",
)  # fmt: skip
"""Entities of the lanes, at the root: the viewer calls a lane by the whole path of its entity."""

NAMED = (0x5A6478FF, 0x46505FFF)
"""Colours of states that are only names."""
OFF_LANES = "off the lanes"
LONGITUDINAL = (DecisionKind.STOP, DecisionKind.YIELD, DecisionKind.FOLLOW, DecisionKind.OVERTAKE)
FREE_DRIVE, KEEP, BOTH = "drive on", "keep", "nudge left and right"


def longitudinal(plan: Plan) -> str:
    """The strongest of a plan's decisions about speed."""
    kinds = {artefact.kind for artefact in plan.internals if isinstance(artefact, Decision)}
    return next((kind.value for kind in LONGITUDINAL if kind in kinds), FREE_DRIVE)


def lateral(plan: Plan) -> str:
    """A plan's decisions about the side."""
    kinds = {artefact.kind for artefact in plan.internals if isinstance(artefact, Decision)}
    left, right = DecisionKind.NUDGE_LEFT in kinds, DecisionKind.NUDGE_RIGHT in kinds
    if left and right:
        return BOTH
    return DecisionKind.NUDGE_LEFT.value if left else DecisionKind.NUDGE_RIGHT.value if right else KEEP


STATE_COLOURS = {
    **{kind.value: colours.DECISIONS[kind] for kind in DecisionKind},
    FREE_DRIVE: 0x3C6EAAFF,
    KEEP: 0x3C6EAAFF,
    BOTH: 0xC090FFFF,
    lane_choice.NOT_COMPARED: 0x3C6EAAFF,
    lane_choice.COMPARED: 0x5082BEFF,
    "change left": colours.DECISIONS[DecisionKind.NUDGE_LEFT],
    "change right": colours.DECISIONS[DecisionKind.NUDGE_RIGHT],
    OFF_LANES: 0xC83232FF,
}


@dataclass(frozen=True)
class Lane:
    """One lane of states: a value per change."""

    name: str
    t: tuple[float, ...]
    values: tuple[str, ...]


def changes(name: str, t: Sequence[float], values: Sequence[str]) -> Lane:
    """A lane of the values that differ from the one before."""
    kept = [i for i in range(len(values)) if i == 0 or values[i] != values[i - 1]]
    return Lane(name, tuple(t[i] for i in kept), tuple(values[i] for i in kept))


def state_lanes(trace: Trace, road: Road) -> list[Lane]:
    """Plan status, decisions and choice of lane (where the planner tells them), the lane under the ego, the end."""
    t = [frame.t for frame in trace.frames]
    plans = [frame.plan for frame in trace.frames]
    lanes = [changes(PLAN, t, [STATUS_WORDS[plan.status] for plan in plans])]
    if any(isinstance(artefact, Decision) for plan in plans for artefact in plan.internals):
        lanes.append(changes(ALONG, t, [longitudinal(plan) for plan in plans]))
        lanes.append(changes(ACROSS, t, [lateral(plan) for plan in plans]))
    driven = lane_choice.lanes_driven(trace, road)
    if any(lane_choice.options(plan) for plan in plans):
        lanes.append(changes(CHOICE, t, lane_choice.choices(trace.frames, driven)))
    if len(set(driven) - {None}) > 1:
        lanes.append(changes(LANE, t, [OFF_LANES if lane is None else f"lane {lane}" for lane in driven]))
    first, last = min([*t, float(trace.ego.t[0])]), float(trace.ego.t[-1])
    return [lane for lane in lanes if lane.t] + [changes(DRIVE, [first, last], ["driving", trace.end.value])]


STATUS_WORDS = {
    PlanStatus.PLANNED: "planned",
    PlanStatus.CORRECTED: "plan corrected",
    PlanStatus.PREVIOUS: "previous plan",
    PlanStatus.COMFORTABLE_STOP: "comfortable stop",
    PlanStatus.HARD_STOP: "hard stop",
    PlanStatus.REFUSED: "plan refused",
}
"""The statuses in two words, for lanes; the sentences are in the texts."""


LETTER, MARGIN = 0.0125, 0.015
"""Room that a letter of a state's label takes, and that around a label, as shares of the whole drive."""


def labelled(lane: Lane, end: float) -> list[str]:
    """The values of a lane, those too short for their label marked by a space: these are drawn without one."""
    lasts = np.diff([*lane.t, end]) / max(end - lane.t[0], 1e-9)
    return [
        value if last >= MARGIN + LETTER * len(value) else f"{value} "
        for value, last in zip(lane.values, lasts, strict=True)
    ]


def draw_lanes(tape: Tape, lanes: Sequence[Lane], frames: FloatArray) -> None:
    """Coloured lanes of states."""
    known = STATE_COLOURS | {STATUS_WORDS[status]: colour for status, colour in colours.STATUSES.items()}
    end = max((lane.t[-1] for lane in lanes), default=0.0)
    tape.static(ROOM, rr.TextDocument(" "))
    for lane in lanes:
        states = labelled(lane, end)
        values = sorted(set(states))
        others = [value for value in dict.fromkeys(lane.values) if value not in known]
        shade = {**dict(zip(others, cycle(NAMED), strict=False)), **known}
        shades = np.array([shade[value.rstrip()] for value in values], dtype=np.uint32)
        labels = [" " if value.endswith(" ") else value for value in values]
        tape.static(lane.name, rr.StateConfiguration(values=values, labels=labels, colors=shades))
        instants = Instants.among(np.array(lane.t), frames)
        tape.rows(lane.name, instants, rr.StateChange.columns(state=states))
