"""Right of way, closed loop: how much time the ego leaves to road users with priority.

By lanes: the ego drives on a lane that yields (`Lane.yields_to`), another road user on a lane with
priority, and the ego is the first of the two at the places that both boxes occupy:

(1) priority_gap = least t_j - t_i >= 0 over the ego's boxes i and the other's boxes j that overlap:
        the time from when the ego leaves a place until the other reaches it (post-encroachment
        time)

Both drives are sampled every `GRID_S`, from `AROUND_S` before the lane is entered until `AROUND_S`
after it is left.

Without lanes: another road user that moves (at least `MOVES_MPS`) has a box j at a place that the
ego left at most `WITHIN_S` earlier:

(2) yielding = t_j - t_i - FINE_S,
        t_i < t_j the last time at which the ego's box overlapped box j. The ego leaves the place
        between t_i and the next time of the grid, and the other reaches it between the time before
        t_j and t_j, so the error is at most FINE_S

in two parts. "recorded" uses pedestrians and crossing traffic (`encounters.CROSSING_RAD`) as
logged, because a road user that gives way to the ego would hide the violation; its boxes j are
those that the recorded driver reached only after t_j. "pedestrian" uses pedestrians as they moved
in the drive, independent of the recorded driver. The order is decided for each box, because a track
may change its id. The others must be in the ego's way for at least `SEEN_S` in total; less is a
flickering detection. Objects without a kind (`AgentKind.OBJECT`) have no right of way.

In replayed traffic the others do not brake for the ego, so the gap is what the ego left. Below 1 s
a gap is serious, below 1.5 s critical (Westhofen et al., Arch. Comput. Methods Eng. 30, 2023, from
the literature).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.logs.agents import AgentKind
from replan.logs.route import on_lane
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Trace
from replan.logs.tracks import Tracks
from replan.metrics.boxes import (
    GRID_S,
    car_of,
    each,
    ego_boxes,
    name_of,
    phantoms,
    without_phantoms,
)
from replan.metrics.encounters import CROSSING_RAD, encroachment, may_meet
from replan.metrics.metric import Measured, Parts, Reduction, Series, Unavailable, metric
from replan.metrics.reductions import MIN

AROUND_S = 1.0
SERIOUS_S, CRITICAL_S = 1.0, 1.5
FINE_S = 0.05  # Grid of (2)
# A road user that arrives later has no encounter with the ego: twice the critical gap, s
WITHIN_S = 3.0
MOVES_MPS = 0.5
SEEN_S = 0.3
_SOURCE = (
    "PET below 1 s: serious; 1.5 s: critical (criticality metrics catalogue, Westhofen et al. 2023)"
)


def _fewer(bound: float, name: str) -> Reduction:
    """Return a reduction that counts the gaps below `bound`."""

    def reduce(series: Series) -> tuple[float, int]:
        failed = series.known & (series.value < bound - 1e-9)
        worst = int(np.argmin(np.where(failed, series.value, np.inf)))
        return float(failed.sum()), worst if failed.any() else -1

    return Reduction(name, reduce, "count", "lower", 0.0, (bound, np.inf))


_priority_metric = partial(
    metric,
    unit="s",
    better="higher",
    reductions=(MIN, _fewer(SERIOUS_S, "below_1s")),
    parameters=(f"grid {GRID_S} s", f"serious {SERIOUS_S:g} s"),
    source=_SOURCE,
)


@_priority_metric(needs="lanes that yield by a sign or a rule of the log, a drive of two states")
def priority_gap(trace: Trace, scenario: Scenario) -> Measured:
    """Time between the ego leaving a spot and a road user with priority reaching it
    (post-encroachment time).

    Formula: least t_j - t_i >= 0 over boxes i of the ego and j of the other that overlap
    """
    return _priority_gap(trace, scenario, assumed=False)


@_priority_metric(needs="lanes that yield by assumption, a drive of two states")
def priority_gap_assumed(trace: Trace, scenario: Scenario) -> Measured:
    """Time between the ego leaving a spot and a road user with assumed priority reaching it
    (post-encroachment time).

    Formula: least t_j - t_i >= 0 over boxes i of the ego and j of the other that overlap
    """
    return _priority_gap(trace, scenario, assumed=True)


def _priority_gap(trace: Trace, scenario: Scenario, *, assumed: bool) -> Measured:
    lanes, guessed = scenario.road.lanes, scenario.road.assumed_priority
    pairs = []
    for lane in lanes.values():
        if (lane.id in guessed) is assumed:
            pairs += [(lane, lanes[i]) for i in lane.yields_to if i in lanes]
    if not pairs:
        return Unavailable(
            "no right of way is assumed" if assumed else "the log names no right of way"
        )
    if len(trace.ego) < 2:
        return Unavailable("the drive holds one ego state only")
    t = np.arange(float(trace.ego.t[0]), float(trace.ego.t[-1]), GRID_S)
    ego = trace.ego.resampled(t)
    boxes, car = ego_boxes(ego, scenario), car_of(scenario)
    no_drivers = (AgentKind.PEDESTRIAN, AgentKind.OBJECT)
    gap, labels = np.full(len(t), np.nan), [""] * len(t)
    for lane, first in pairs:
        ego_steps = _steps_around(on_lane(lane, boxes[0], boxes[1], ego.yaw))
        for i, others, row in each(trace.agents, t) if ego_steps.any() else ():
            if trace.agents.kinds[i] in no_drivers:
                continue
            other_steps = _steps_around(on_lane(first, *others.pose[:3, row])) & others.there[row]
            sizes = np.array([(car.length, car.width), others.size[row]])
            after, _, ego_first, other_first = encroachment(
                boxes,
                np.flatnonzero(ego_steps),
                others.pose[:, row],
                np.flatnonzero(other_steps),
                sizes,
                0.0,
            )
            step = int(np.argmin(np.where(after >= 0, after, len(after))))
            gap_s = GRID_S * int(after[step])  # (1)
            if ego_first.sum() > other_first.sum() and not gap[step] <= gap_s:
                gap[step], labels[step] = gap_s, name_of(trace.agents, i)
    return Series(t, gap, tuple(labels), "the ego was never ahead of a road user that goes first")


def _steps_around(on: BoolArray) -> BoolArray:
    """Mark the steps `(k,)` from `AROUND_S` before the first marked one to `AROUND_S` after the
    last.
    """
    marked = np.flatnonzero(on)
    around, reach = np.zeros(len(on), np.bool_), round(AROUND_S / GRID_S)
    if len(marked):
        around[max(marked[0] - reach, 0) : marked[-1] + reach + 1] = True
    return around


@dataclass(frozen=True, eq=False, slots=True)
class _Meetings:
    """The boxes of one road user (index of its track) at places that a drive occupies, at m
    increasing grid steps.
    """

    agent: int
    step: IntArray
    # `(m,)` s since the drive last left the place of the box; NaN if it was not there before
    left: FloatArray
    # `(m,)` s until the drive reaches the place, 0 in a contact; NaN if it never does
    taken: FloatArray


def _meetings(
    drive: Trajectory, tracks: Tracks, scenario: Scenario, t: FloatArray
) -> Iterator[_Meetings]:
    """Yield the meetings with pedestrians, and with other kinds (not objects) that cross the drive,
    at `t` `(k,)`.
    """
    first, end = np.searchsorted(t, [drive.t[0] - 1e-9, drive.t[-1] + 1e-9])
    boxes = ego_boxes(drive.resampled(np.clip(t[first:end], drive.t[0], drive.t[-1])), scenario)
    car = car_of(scenario)
    for i, others, row in each(tracks, t):
        kind, pose = tracks.kinds[i], others.pose[:, row]
        if kind is AgentKind.OBJECT:
            continue
        ego_steps, other_steps = may_meet(boxes, car, others, row)
        other_steps = other_steps[np.hypot(pose[3, other_steps], pose[4, other_steps]) >= MOVES_MPS]
        after = np.ascontiguousarray(pose[:, first:])
        angle = 0.0 if kind is AgentKind.PEDESTRIAN else CROSSING_RAD
        sizes = np.array([others.size[row], (car.length, car.width)])
        steps = encroachment(
            after, other_steps[other_steps >= first] - first, boxes, ego_steps, sizes, angle
        )
        step = np.flatnonzero((steps[:2] >= 0).any(axis=0))
        if len(step):
            taken, left = np.where(steps[:2, step] >= 0, steps[:2, step] * FINE_S, np.nan)
            yield _Meetings(i, first + step, left - FINE_S, taken)


@metric(
    unit="s",
    better="higher",
    reductions=(MIN, _fewer(SERIOUS_S, "below_1s"), _fewer(CRITICAL_S, "below_1500ms")),
    parts=("recorded", "pedestrian"),
    parameters=(
        f"grid {FINE_S} s",
        f"at most {WITHIN_S:g} s",
        f"moves at {MOVES_MPS} m/s or more",
        "across: 30 degrees",
        f"on the ego's way for {SEEN_S} s",
        f"serious {SERIOUS_S:g} s",
        f"critical {CRITICAL_S:g} s",
    ),
    needs="a recorded driver that let another go first; a pedestrian",
    source=_SOURCE,
)
def yielding(trace: Trace, scenario: Scenario) -> Parts:
    """Time by which the ego crosses before a road user that comes to the same place: of those that
    the recorded driver let go first (as logged), and of pedestrians (as they moved). Needs no map.

    Formula: least t_j - t_i over boxes j of the other and the last box i of the ego that overlaps
    it before t_j
    """
    end = max(trace.ego.t[-1] + WITHIN_S, scenario.ego.t[-1])
    t = np.arange(trace.ego.t[0], end, FINE_S)
    return {
        "recorded": _yielding_as_recorded(trace, scenario, t),
        "pedestrian": _yielding_to_pedestrians(trace, scenario, t),
    }


def _yielding_as_recorded(trace: Trace, scenario: Scenario, t: FloatArray) -> Measured:
    if not scenario.is_recorded or len(scenario.ego) < 2:
        return Unavailable("the log has no recorded driver")
    tracks = without_phantoms(scenario.tracks, phantoms(scenario))
    # By agent: steps at which the recorded driver let it pass first, and the text with the time
    let_first = {}
    for meeting in _meetings(scenario.ego, tracks, scenario, t):
        second = (meeting.taken > 0.0) & np.isnan(meeting.left)
        if second.any():
            ahead_s = meeting.taken[second].min()
            reason = f", which the recorded driver let go first by {ahead_s:.1f} s"
            let_first[meeting.agent] = meeting.step[second], reason
    if not let_first:
        return Unavailable("the recorded driver let no road user with a kind go first")
    meetings = [
        (meeting, *let_first[meeting.agent])
        for meeting in _meetings(trace.ego, tracks, scenario, t)
        if meeting.agent in let_first
    ]
    return _least_gaps(t, meetings, tracks)


def _yielding_to_pedestrians(trace: Trace, scenario: Scenario, t: FloatArray) -> Measured:
    kinds = trace.agents.kinds
    if AgentKind.PEDESTRIAN not in kinds:
        return Unavailable("the log names no pedestrian")
    meetings = [
        (meeting, meeting.step, "")
        for meeting in _meetings(trace.ego, trace.agents, scenario, t)
        if kinds[meeting.agent] is AgentKind.PEDESTRIAN
    ]
    if not meetings:
        return Unavailable("the ego and the pedestrians took no place in common")
    return _least_gaps(t, meetings, trace.agents)


def _least_gaps(
    t: FloatArray, meetings: Sequence[tuple[_Meetings, IntArray, str]], tracks: Tracks
) -> Series:
    """Return the least (2) over the boxes at the given steps, at the time at which the ego left
    their place.
    """
    gap, labels = np.full(len(t), np.nan), [""] * len(t)
    flags = [
        (meeting.left <= WITHIN_S + 1e-9) & np.isin(meeting.step, steps)
        for meeting, steps, _ in meetings
    ]
    met_steps = [meeting.step[near] for (meeting, _, _), near in zip(meetings, flags, strict=True)]
    met_times = t[np.unique(np.concatenate([np.empty(0, np.int64), *met_steps]))]
    for (meeting, _, reason), near in zip(meetings, flags, strict=True):
        name = name_of(tracks, meeting.agent)
        for j, left in zip(meeting.step[near].tolist(), meeting.left[near].tolist(), strict=True):
            i = j - round(left / FINE_S) - 1
            lasts = np.sum(np.abs(met_times - t[j]) <= WITHIN_S) * FINE_S >= SEEN_S
            if lasts and not gap[i] <= left:
                gap[i] = left
                labels[i] = f"{name}: the ego goes first, {left:.1f} s before it{reason}"
    return Series(t, gap, tuple(labels), "the ego never went first")
