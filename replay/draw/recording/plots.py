"""The parts of a recording over time: panels of curves with their axes and legends, and rows of states.

The rows are the plan's status, decisions, the choice of lane, the lane under the ego, and the end.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any, Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from logs.arrays import FloatArray
from logs.plan import Decision, DecisionKind
from logs.road import Road, RoadSource
from logs.trace import PlannedFrame, Trace
from replay.draw.model import Marker, Panel
from replay.draw.recording import colours
from replay.draw.recording.tape import SPACER, Instants, Tape, plain
from replay.explain.causes import KEEP
from replay.explain.explanation import (
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

Corner = Literal["RightTop", "RightBottom", "LeftTop", "LeftBottom"]
CORNERS: tuple[Corner, ...] = ("RightTop", "RightBottom", "LeftTop", "LeftBottom")
LEGEND = 0.16, 0.14  # Width of a legend, and height of one of its rows, as shares of a panel of usual size
MOST_NUMBERS = 8.0  # Largest number of labels along an axis; the viewer writes multiples of a power of ten


def draw_panels(tape: Tape, panels: Iterable[Panel], frames: FloatArray) -> None:
    """Each curve is an entity of its own; values that are not finite are gaps."""
    for panel in panels:
        for curve in panel.curves:
            entity = f"plots/{panel.name}/{curve.name}"
            mode = rr.components.InterpolationMode.StepAfter if curve.steps else None
            style = rr.SeriesLines(
                colors=[curve.colour], names=[plain(curve.legend)], widths=[curve.width], interpolation_mode=mode
            )
            tape.static(entity, style)
            values = np.where(np.isfinite(curve.values), curve.values, np.nan)
            tape.rows(entity, Instants.among(curve.t, frames), rr.Scalars.columns(scalars=values))


def plot(panel: Panel, **more: Any) -> rrb.TimeSeriesView:
    """A panel as a view; `more` replaces arguments of the view if the curves are not below the panel's entity.

    The axis has at least two numbers. The legend is in the corner in which it hides the least of the curves; ties go to
    the first in `CORNERS`.
    """
    (low, high), wide, tall = with_two_numbers(*panel.range), *LEGEND
    begin, end = min(curve.t[0] for curve in panel.curves), max(curve.t[-1] for curve in panel.curves)
    hidden: dict[Corner, float] = dict.fromkeys(CORNERS, 0.0)
    for curve in panel.curves:
        x, y = (curve.t - begin) / max(end - begin, 1e-9), (curve.values - low) / (high - low)
        for corner in CORNERS:
            across = x > 1.0 - wide if "Right" in corner else x < wide
            room = tall * len(panel.curves) + 0.05
            hidden[corner] += float(np.mean(across & (y > 1.0 - room if "Top" in corner else y < room)))
    corner = min(CORNERS, key=hidden.__getitem__)
    return rrb.TimeSeriesView(
        **{"origin": f"/plots/{panel.name}", **more},
        name=panel.title,
        axis_x=time_axis(),
        axis_y=rrb.ScalarAxis(range=(low, high)),
        plot_legend=rrb.PlotLegend(corner=corner),
        interaction=rrb.PlotInteraction(tooltip_mode="All"),
    )


def time_axis() -> rrb.TimeAxis:
    """The time axis that all curves and rows of states share."""
    return rrb.TimeAxis(link="LinkToGlobal")


def with_two_numbers(low: float, high: float) -> tuple[float, float]:
    """A range, extended if the viewer would write fewer than two numbers along it."""
    step = 10.0 ** np.ceil(np.log10((high - low) / MOST_NUMBERS) - 1e-9)
    first, last = step * np.ceil(low / step - 1e-9), step * np.floor(high / step + 1e-9)
    if last > first:
        return low, high
    margin = 0.08 * step
    if last < first:  # no number in the range
        return float(last - margin), float(first + margin)
    above, below = first + step - high, low - (first - step)
    return (low, float(first + step + margin)) if above <= below else (float(first - step - margin), high)


LANES = (PLAN, ALONG, ACROSS, CHOICE, LANE, DRIVE) = (
    "Plan", "Decision-along", "Decision-across", "Choice-of-lane", "Lane", "Drive",
)  # fmt: skip
"""Entities of the rows, at the root: the viewer labels a row with the whole path of its entity."""
NAMED = (0x5A6478FF, 0x46505FFF)  # Alternating colours of states that are not in `STATE_COLOURS`
OFF_LANES, NOTHING = "off the lanes", "none"
NOT_COMPARED, COMPARED = "keep", "keep: others compared"
LETTER, MARGIN = 0.0125, 0.015
"""Width of a letter of a state's label, and of the margin around a label, as shares of the whole drive."""
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
        kept = [i for i in range(len(values)) if i == 0 or values[i] != values[i - 1]]
        return cls(name, tuple(t[i] for i in kept), tuple(values[i] for i in kept))


def state_lanes(trace: Trace, road: Road) -> list[StateRow]:
    """Plan status, decisions and choice of lane (if the planner reports them), the lane under the ego, the end."""
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
        lanes.append(StateRow.of(LANE, t, [OFF_LANES if lane is None else f"lane {lane}" for lane in driven]))
    first, last = min([*t, float(trace.ego.t[0])]), float(trace.ego.t[-1])
    return [lane for lane in lanes if lane.t] + [StateRow.of(DRIVE, [first, last], ["driving", trace.end.value])]


def marker_lanes(markers: Sequence[Marker], end: float) -> list[StateRow]:
    """A row per kind of marker: what it is about while it lasts, else nothing; `end` of the log, s."""
    rows = []
    for kind in dict.fromkeys(one.kind for one in markers):
        mine = sorted((one for one in markers if one.kind == kind), key=lambda one: one.begin)
        times = sorted({0.0, end, *(t for one in mine for t in (one.begin, one.end) if t < end)})
        now = [[one.about or one.words for one in mine if one.begin <= t + 1e-9 and t < one.end - 1e-9] for t in times]
        rows.append(StateRow.of(kind.replace("_", "-"), times, ["; ".join(words) or NOTHING for words in now]))
    return rows


def draw_lanes(tape: Tape, lanes: Sequence[StateRow], frames: FloatArray) -> None:
    """Draw coloured rows of states; a state too short for its label has no label, and a space after its value."""
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


def changes_under_way(frames: Sequence[PlannedFrame], lanes: Sequence[int | None]) -> list[LaneChange | None]:
    """For each frame the lane change that is under way: from its decision until the ego has left its lane."""
    out: list[LaneChange | None] = []
    change, left = None, None
    for frame, lane in zip(frames, lanes, strict=True):
        some = lane_options(frame.plan)
        if taken_option(some) != KEEP:
            change, left = LaneChange(taken_option(some), frame.t, describe_choice(some)), lane
        elif lane != left:
            change = None
        out.append(change)
    return out


def choices(frames: Sequence[PlannedFrame], lanes: Sequence[int | None]) -> list[str]:
    """For the row of states: whether the lane is kept, compared with others, or a change is under way."""
    return [
        f"change {change.name}" if change else COMPARED if lane_options(frame.plan) else NOT_COMPARED
        for frame, change in zip(frames, changes_under_way(frames, lanes), strict=True)
    ]


def lanes_driven(trace: Trace, road: Road) -> list[int | None]:
    """The drivable lane under the ego's reference point at each frame; if lanes overlap, its last or a successor."""
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
    """Positions of the ego at each frame `(f, 2)`, m."""
    ego, t = trace.ego, np.array([frame.t for frame in trace.frames])
    return np.column_stack([np.interp(t, ego.t, ego.x), np.interp(t, ego.t, ego.y)])
