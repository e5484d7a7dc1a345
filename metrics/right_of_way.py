"""Right of way, closed loop: how much time the ego leaves to those who go first.

By lanes: where the ego drives on a lane that yields (`Lane.yields_to`) and another on one that goes first, and the ego
is the first of the two at the places that both boxes take:

(1) priority_gap = least t_j - t_i >= 0 over the ego's boxes i and the other's boxes j that overlap: the time from the
    ego's leaving a spot to the other's taking it (post-encroachment time)

Both drives are looked at every `GRID_S`, from `AROUND_S` before the lane is entered to as long after it is left.

Without lanes: a box j of another that moves (`MOVES_MPS` or faster) on a place that the ego left less than `WITHIN_S`
before, with

(2) yielding = t_j - t_i - FINE_S,  t_i < t_j the last time at which the ego's box overlapped box j: it is left between
    t_i and the next time of the grid, and taken between the time before t_j and t_j, so the error is FINE_S at most

in two parts. "recorded": of pedestrians and of traffic across (`encounters.CROSSING_RAD`), as logged, the boxes j which
the recorded driver took only after t_j: the recorded driver let that road user go first, the ego does not. They are
taken as logged because a road user that gives way to the ego would hide what was taken from it. "pedestrian": of
pedestrians as they moved in the drive, whatever the recorded driver did. Order is decided box by box, so that a track
that changes its id counts as one that keeps it. Others are on the ego's way for at least `SEEN_S` in all, whatever
their ids: less is a flicker of the detection. What has no kind (`AgentKind.OBJECT`) has no right of way.

In replayed traffic the others do not brake for the ego, so that a gap shows what it took. Below 1 s a gap is serious,
below 1.5 s critical (Westhofen et al., Arch. Comput. Methods Eng. 30, 2023, from the literature). A pedestrian walks
2 m in 1.5 s: as the ego passes, the pedestrian is a stride from its side.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray
from logs.lanes import on_lane
from logs.road import Lane, Road
from logs.scenario import AgentKind, Scenario, Tracks
from logs.states import Trajectory
from logs.trace import Mode, Trace
from metrics.encounters import CROSSING_RAD, encroachment, may_meet
from metrics.metric import MIN, Measured, Metric, Reduction, Series, Unavailable
from metrics.others import each, ego_boxes, name_of
from metrics.phantoms import phantoms, without_phantoms

GRID_S = 0.1
AROUND_S = 1.0
SERIOUS_S, CRITICAL_S = 1.0, 1.5
FINE_S = 0.05
"""Grid of (2)."""
WITHIN_S = 3.0
"""A road user that comes later is not an encounter: twice the critical gap."""
MOVES_MPS = 0.5
SEEN_S = 0.3


def _priority_gap(trace: Trace, scenario: Scenario) -> Measured:
    pairs = _pairs(scenario.road)
    if not pairs:
        return Unavailable("the log names no right of way")
    if len(trace.ego) < 2:
        return Unavailable("the drive holds one ego state only")
    t = np.arange(float(trace.ego.t[0]), float(trace.ego.t[-1]), GRID_S)
    ego = trace.ego.resampled(t)
    boxes, drivers = ego_boxes(ego, scenario), _drivers(trace)
    size = np.array([scenario.vehicle.length, scenario.vehicle.width])
    gap, labels = np.full(len(t), np.nan), [""] * len(t)
    for lane, first in pairs:
        mine = _around(on_lane(lane, boxes[0], boxes[1], ego.yaw))
        for i, others, row in each(trace.agents, t) if mine.any() else ():
            if i not in drivers:
                continue
            theirs = _around(on_lane(first, *others.pose[:3, row])) & others.there[row]
            steps = np.flatnonzero(mine), np.flatnonzero(theirs)
            step, found = _left(boxes, steps[0], others.pose[:, row], steps[1], size, others.size[row])
            if step >= 0 and not gap[step] <= found * GRID_S:
                gap[step], labels[step] = found * GRID_S, name_of(trace.agents, i)
    return Series(t, gap, tuple(labels), "the ego was never before somebody who goes first")


def _pairs(road: Road) -> list[tuple[Lane, Lane]]:
    """Lanes that yield, each with one that goes first."""
    return [(lane, road.lanes[i]) for lane in road.lanes.values() for i in lane.yields_to if i in road.lanes]


def _drivers(trace: Trace) -> set[int]:
    """The agents that may have the right of way on a lane."""
    kinds = trace.agents.kinds
    return {i for i, kind in enumerate(kinds) if kind not in (AgentKind.PEDESTRIAN, AgentKind.OBJECT)}


def _around(on: BoolArray) -> BoolArray:
    """The steps `(k,)` that are marked, and `AROUND_S` before and after them."""
    at = np.flatnonzero(on)
    found, reach = np.zeros(len(on), np.bool_), round(AROUND_S / GRID_S)
    if len(at):
        found[max(at[0] - reach, 0) : at[-1] + reach + 1] = True
    return found


def _left(
    ego: FloatArray, mine: IntArray, other: FloatArray, theirs: IntArray, size: FloatArray, other_size: FloatArray
) -> tuple[int, int]:
    """(1) in steps, and the ego's step; -1 where the ego is not the first of the two."""
    after, _, ego_first, other_first = encroachment(ego, mine, other, theirs, size, other_size, 0.0)
    if ego_first.sum() <= other_first.sum():
        return -1, 0
    step = int(np.argmin(np.where(after >= 0, after, len(after))))
    return step, int(after[step])


@dataclass(frozen=True, eq=False, slots=True)
class _Meetings:
    """The boxes of one other on places that a drive takes, at steps of a grid.

    Attributes:
        agent: Index of its track.
        step: `(m,)` of the boxes, increasing.
        left: `(m,)` s since the drive last left the place of the box, NaN where it was not there before.
        taken: `(m,)` s until the drive takes it, 0 in a contact; NaN where it does not.
    """

    agent: int
    step: IntArray
    left: FloatArray
    taken: FloatArray


def _meetings(drive: Trajectory, tracks: Tracks, scenario: Scenario, t: FloatArray) -> Iterator[_Meetings]:
    """Of each pedestrian, and each other that has a kind and moves across the drive, on the times `t` `(k,)`."""
    first, end = np.searchsorted(t, [drive.t[0] - 1e-9, drive.t[-1] + 1e-9])
    boxes = ego_boxes(drive.resampled(np.clip(t[first:end], drive.t[0], drive.t[-1])), scenario)
    car = np.array([scenario.vehicle.axle_to_center, scenario.vehicle.length, scenario.vehicle.width])
    for i, others, row in each(tracks, t):
        kind, pose = tracks.kinds[i], others.pose[:, row]
        if kind is AgentKind.OBJECT:
            continue
        mine, theirs = may_meet(boxes, car, others, row)
        theirs = theirs[np.hypot(pose[3, theirs], pose[4, theirs]) >= MOVES_MPS]
        after = np.ascontiguousarray(pose[:, first:])
        angle = 0.0 if kind is AgentKind.PEDESTRIAN else CROSSING_RAD
        steps = encroachment(after, theirs[theirs >= first] - first, boxes, mine, others.size[row], car[1:], angle)
        step = np.flatnonzero((steps[:2] >= 0).any(axis=0))
        if len(step):
            taken, left = np.where(steps[:2, step] >= 0, steps[:2, step] * FINE_S, np.nan)
            yield _Meetings(i, first + step, left - FINE_S, taken)


def _yielding(trace: Trace, scenario: Scenario) -> Mapping[str, Measured]:
    end = float(trace.ego.t[-1]) + WITHIN_S
    t = np.arange(float(trace.ego.t[0]), max(end, float(scenario.ego.t[-1])), FINE_S)
    recorded: Measured = Unavailable("the log has no recorded driver")
    if scenario.is_recorded and len(scenario.ego) > 1:
        recorded = _before_the_recorded(trace, scenario, t)
    walkers = {i for i, kind in enumerate(trace.agents.kinds) if kind is AgentKind.PEDESTRIAN}
    if not walkers:
        return {"recorded": recorded, "pedestrian": Unavailable("the log names no pedestrian")}
    met = [(one, one.step, "") for one in _meetings(trace.ego, trace.agents, scenario, t) if one.agent in walkers]
    none = Unavailable("the ego and the pedestrians took no place in common")
    return {"recorded": recorded, "pedestrian": _gaps(t, met, trace.agents) if met else none}


def _before_the_recorded(trace: Trace, scenario: Scenario, t: FloatArray) -> Measured:
    """The part "recorded" of (2)."""
    tracks = without_phantoms(scenario.tracks, phantoms(scenario))
    let = {}
    for one in _meetings(scenario.ego, tracks, scenario, t):
        second = (one.taken > 0.0) & np.isnan(one.left)
        if second.any():
            let[one.agent] = (
                one.step[second],
                f", which the recorded driver let go first by {one.taken[second].min():.1f} s",
            )
    if not let:
        return Unavailable("the recorded driver let no road user with a kind go first")
    mine = _meetings(trace.ego, tracks, scenario, t)
    return _gaps(t, [(one, *let[one.agent]) for one in mine if one.agent in let], tracks)


def _gaps(t: FloatArray, met: Sequence[tuple[_Meetings, IntArray, str]], tracks: Tracks) -> Series:
    """The least (2) over the boxes at the steps that are asked, at the time at which the ego left their place."""
    gap, labels = np.full(len(t), np.nan), [""] * len(t)
    asked = [(one, (one.left <= WITHIN_S + 1e-9) & np.isin(one.step, steps), why) for one, steps, why in met]
    seen = t[np.unique(np.concatenate([np.empty(0, np.int64), *(one.step[at] for one, at, _ in asked)]))]
    for one, at, why in asked:
        who = name_of(tracks, one.agent)
        for j, left in zip(one.step[at].tolist(), one.left[at].tolist(), strict=True):
            i = j - round(left / FINE_S) - 1
            if np.sum(np.abs(seen - t[j]) <= WITHIN_S) * FINE_S >= SEEN_S and not gap[i] <= left:
                gap[i], labels[i] = left, f"{who}: the ego goes first, {left:.1f} s before it{why}"
    return Series(t, gap, tuple(labels), "the ego never went first")


def _fewer(bound: float, name: str) -> Reduction:
    """Number of the gaps below `bound`."""

    def reduce(series: Series) -> tuple[float, int]:
        failed = series.known & (series.value < bound - 1e-9)
        worst = int(np.argmin(np.where(failed, series.value, np.inf)))
        return float(failed.sum()), worst if failed.any() else -1

    return Reduction(name, reduce, "count", "lower", 0.0, (bound, np.inf))


PRIORITY_GAP = Metric(
    "priority_gap", "s", "higher", (Mode.CLOSED,), _priority_gap, (MIN, _fewer(SERIOUS_S, "below_1s")),
    "Time from the ego's leaving a spot to its being taken by one who goes first there (post-encroachment time).",
    "PET below 1 s: serious; 1.5 s: critical (criticality metrics catalogue, Westhofen et al. 2023)",
    formula="least t_j - t_i >= 0 over boxes i of the ego and j of the other that overlap",
    parameters=(f"grid {GRID_S} s", f"serious {SERIOUS_S:g} s"), needs="lanes that yield, a drive of two states",
)  # fmt: skip
YIELDING = Metric(
    "yielding", "s", "higher", (Mode.CLOSED,), _yielding,
    (MIN, _fewer(SERIOUS_S, "below_1s"), _fewer(CRITICAL_S, "below_1500ms")),
    "Time by which the ego crosses before a road user that comes to the same place: of those that the recorded driver "
    "let go first (as logged), and of pedestrians (as they moved). Needs no map.",
    "PET below 1 s: serious; 1.5 s: critical (criticality metrics catalogue, Westhofen et al. 2023)",
    formula="least t_j - t_i over boxes j of the other and the last box i of the ego that overlaps it before t_j",
    parameters=(
        f"grid {FINE_S} s", f"at most {WITHIN_S:g} s", f"moves at {MOVES_MPS} m/s or more", "across: 30 degrees",
        f"on the ego's way for {SEEN_S} s", f"serious {SERIOUS_S:g} s", f"critical {CRITICAL_S:g} s",
    ),
    parts=("recorded", "pedestrian"), needs="a recorded driver that let another go first; a pedestrian",
)  # fmt: skip
