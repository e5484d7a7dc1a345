"""Right of way, closed loop: how much time the ego leaves to those who go first.

Where the ego drives on a lane that yields (`Lane.yields_to`) and somebody on one that goes first, and the ego is the
first of the two at the places that both boxes take:

(1) gap = least t_j - t_i >= 0 over the ego's boxes i and the other's boxes j that overlap: the time from the ego's
    leaving a spot to the other's taking it (post-encroachment time)

Both drives are looked at every `GRID_S`, from `AROUND_S` before the lane is entered to as long after it is left. The
others are taken as they moved: in replayed traffic they do not brake for the ego, so that the gap shows what it took.
Below 1 s a gap is a failure ("serious": Westhofen et al., Arch. Comput. Methods Eng. 30, 2023, from the literature).
"""

from __future__ import annotations

import numpy as np

from logs.kernel import BoolArray, FloatArray, IntArray
from logs.lanes import on_lane
from logs.road import Lane, Road
from logs.scenario import AgentKind, Scenario
from logs.trace import Mode, Trace
from metrics.encounters import encroachment
from metrics.metric import MIN, Measured, Metric, Reduction, Series, Unavailable
from metrics.others import each, ego_boxes, name_of

GRID_S = 0.1
AROUND_S = 1.0
SERIOUS_S = 1.0


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


def _failed(series: Series) -> tuple[float, int]:
    failed = series.known & (series.value < SERIOUS_S)
    return float(failed.sum()), int(np.argmax(failed)) if failed.any() else -1


FAILED = Reduction("below_1s", _failed, unit="count", direction="lower", empty=0.0)
PRIORITY_GAP = Metric(
    "priority_gap", "s", "higher", (Mode.CLOSED,), _priority_gap, (MIN, FAILED),
    "Time from the ego's leaving a spot to its being taken by one who goes first there (post-encroachment time).",
    "PET below 1 s: serious; 1.5 s: critical (criticality metrics catalogue, Westhofen et al. 2023)",
    formula="least t_j - t_i >= 0 over boxes i of the ego and j of the other that overlap",
    parameters=(f"grid {GRID_S} s", f"serious {SERIOUS_S:g} s"), needs="lanes that yield, a drive of two states",
)  # fmt: skip
