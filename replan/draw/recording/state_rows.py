"""Rows of states over time: the plan's status, decisions, the choice of lane, the lane under the
ego, who drove the recorded car, and the end; and the markers of a log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, cycle
from operator import attrgetter

import numpy as np
import rerun as rr

from replan.core.arrays import FloatArray
from replan.draw.markers import Marker
from replan.draw.recording import colours
from replan.draw.recording.tape import SPACER, Instants, Tape
from replan.explain.causes import KEEP
from replan.explain.explanation import (
    BOTH,
    FREE_DRIVE,
    NO_NUDGE,
    STATUS_WORDS,
    describe_choice,
    lane_options,
    lateral,
    longitudinal,
    taken_option,
)
from replan.logs.driving import DrivingModes
from replan.logs.plan import Decision, DecisionKind
from replan.logs.road import Road, RoadSource
from replan.logs.trace import PlannedFrame, Trace

PLAN, LANE, DRIVE = "Plan", "Lane", "Drive"
ALONG, ACROSS, CHOICE = "Decision-along", "Decision-across", "Choice-of-lane"
DRIVER = "Driver-of-the-log"
LANES = (PLAN, ALONG, ACROSS, CHOICE, LANE, DRIVER, DRIVE)
"""Entities of the rows, at the root: the viewer labels a row with the whole path of its entity."""
NAMED = (0x5A6478FF, 0x46505FFF)  # Alternating colours of states that are not in `STATE_COLOURS`
OFF_LANES, NOTHING = "off the lanes", "none"
NOT_COMPARED, COMPARED = "keep", "keep: others compared"
LETTER, MARGIN = 0.0125, 0.015
"""Width of a letter of a state's label, and of the margin around a label, as shares of the whole
drive.
"""
STATE_COLOURS = {
    **{kind.value: colours.DECISIONS[kind] for kind in DecisionKind},
    FREE_DRIVE: 0x3C6EAAFF,
    NO_NUDGE: 0x3C6EAAFF,
    BOTH: 0xC090FFFF,
    COMPARED: 0x5082BEFF,
    "change left": colours.DECISIONS[DecisionKind.NUDGE_LEFT],
    "change right": colours.DECISIONS[DecisionKind.NUDGE_RIGHT],
    OFF_LANES: 0xC83232FF,
    NOTHING: 0x2A2E36FF,
    **{STATUS_WORDS[status]: colour for status, colour in colours.STATUSES.items()},
    **{mode.value: colour for mode, colour in colours.DRIVERS.items()},
}


@dataclass(frozen=True)
class StateRow:
    """One row of states: a value per change."""

    name: str
    t: tuple[float, ...]
    values: tuple[str, ...]

    @classmethod
    def of(cls, name: str, t: Sequence[float], values: Sequence[str]) -> StateRow:
        """A row with only the values that differ from the one before."""
        changes = [i for i in range(len(values)) if i == 0 or values[i] != values[i - 1]]
        return cls(name, tuple(t[i] for i in changes), tuple(values[i] for i in changes))


def state_lanes(trace: Trace, road: Road) -> list[StateRow]:
    """Plan status, decisions and choice of lane (if the planner reports them), the lane under the
    ego, the end.
    """
    t = [frame.t for frame in trace.frames]
    plans = [frame.plan for frame in trace.frames]
    lanes = [StateRow.of(PLAN, t, [STATUS_WORDS[plan.status] for plan in plans])]
    if any(isinstance(artefact, Decision) for plan in plans for artefact in plan.internals):
        lanes.append(StateRow.of(ALONG, t, [longitudinal(plan) for plan in plans]))
        lanes.append(StateRow.of(ACROSS, t, [lateral(plan) for plan in plans]))
    driven = lanes_driven(trace, road)
    if any(lane_options(plan) for plan in plans):
        lanes.append(StateRow.of(CHOICE, t, choices(trace.frames, driven)))
    if len(set(driven) - {None}) > 1:
        lanes.append(
            StateRow.of(LANE, t, [OFF_LANES if lane is None else f"lane {lane}" for lane in driven])
        )
    first, last = min([*t, float(trace.ego.t[0])]), float(trace.ego.t[-1])
    return [lane for lane in lanes if lane.t] + [
        StateRow.of(DRIVE, [first, last], ["driving", trace.end.value])
    ]


def driver_lanes(driving: DrivingModes | None, begin: float, end: float) -> list[StateRow]:
    """A row of who drove the recorded car between two times, s, if the log says it."""
    if driving is None or not begin < end:
        return []
    spans = driving.spans(begin, end)
    times, modes = [first for first, *_ in spans], [mode.value for *_, mode in spans]
    return [StateRow.of(DRIVER, [*times, end], [*modes, modes[-1]])]


def marker_lanes(markers: Sequence[Marker], end: float) -> list[StateRow]:
    """A row per kind of marker: what it is about while it lasts, else nothing; `end` of the
    log, s.
    """
    rows = []
    for kind in dict.fromkeys(marker.kind for marker in markers):
        of_kind = sorted(
            (marker for marker in markers if marker.kind == kind), key=attrgetter("begin")
        )
        bounds = chain.from_iterable((marker.begin, marker.end) for marker in of_kind)
        times = sorted({0.0, end, *(t for t in bounds if t < end)})
        lasting = [
            [marker.about or marker.words for marker in of_kind if marker.lasts_at(t)]
            for t in times
        ]
        rows.append(
            StateRow.of(
                kind.replace("_", "-"), times, ["; ".join(words) or NOTHING for words in lasting]
            )
        )
    return rows


def draw_lanes(tape: Tape, lanes: Sequence[StateRow], frames: FloatArray) -> None:
    """Draw coloured rows of states.

    A state too short for its label has no label, and a space after its value.
    """
    end = max((lane.t[-1] for lane in lanes), default=0.0)
    tape.static(SPACER, rr.TextDocument(" "))
    for lane in lanes:
        lasts = np.diff([*lane.t, end]) / max(end - lane.t[0], 1e-9)
        states = [
            value if last >= MARGIN + LETTER * len(value) else f"{value} "
            for value, last in zip(lane.values, lasts, strict=True)
        ]
        values = sorted(set(states))
        others = [value for value in dict.fromkeys(lane.values) if value not in STATE_COLOURS]
        shade = {**dict(zip(others, cycle(NAMED), strict=False)), **STATE_COLOURS}
        shades = np.array([shade[value.rstrip()] for value in values], dtype=np.uint32)
        labels = [" " if value.endswith(" ") else value for value in values]
        tape.static(lane.name, rr.StateConfiguration(values=values, labels=labels, colors=shades))
        instants = Instants.among(np.array(lane.t), frames)
        tape.rows(lane.name, instants, rr.StateChange.columns(state=states))


@dataclass(frozen=True)
class LaneChange:
    """A lane change that is under way: the option that was taken, its time, and the reason."""

    name: str
    t: float
    reason: str


def changes_under_way(
    frames: Sequence[PlannedFrame], lanes: Sequence[int | None]
) -> list[LaneChange | None]:
    """For each frame the lane change that is under way: from its decision until the ego has left
    its lane.
    """
    changes: list[LaneChange | None] = []
    change, left = None, None
    for frame, lane in zip(frames, lanes, strict=True):
        options = lane_options(frame.plan)
        if (option := taken_option(options)) != KEEP:
            change, left = LaneChange(option, frame.t, describe_choice(options)), lane
        elif lane != left:
            change = None
        changes.append(change)
    return changes


def choices(frames: Sequence[PlannedFrame], lanes: Sequence[int | None]) -> list[str]:
    """For the row of states: whether the lane is kept, compared with others, or a change is under
    way.
    """
    words = []
    for frame, change in zip(frames, changes_under_way(frames, lanes), strict=True):
        keep = COMPARED if lane_options(frame.plan) else NOT_COMPARED
        words.append(f"change {change.name}" if change else keep)
    return words


def lanes_driven(trace: Trace, road: Road) -> list[int | None]:
    """The drivable lane under the ego's reference point at each frame.

    If lanes overlap, its last or a successor.
    """
    if road.source is not RoadSource.LANES:
        return [None] * len(trace.frames)
    driven = list[int | None]()
    last: int | None = None
    for x, y in places(trace).tolist():
        under = [lane.id for lane in road.lanes_at(x, y) if lane.drivable]
        before = None if last is None else road.lanes.get(last)
        onward = (before.id, *before.successors) if before is not None else ()
        last = next((lane for lane in onward[:1] if lane in under), None)
        if last is None:
            last = next((lane for lane in under if lane in onward), under[0] if under else None)
        driven.append(last)
    return driven


def places(trace: Trace) -> FloatArray:
    """Positions of the ego at each frame `(f, 2)`, m."""
    ego, t = trace.ego, np.array([frame.t for frame in trace.frames])
    return np.column_stack([np.interp(t, ego.t, ego.x), np.interp(t, ego.t, ego.y)])
