"""Candidate lanes: the ego's lane and its neighbours, each with its own reference path (paper,
section II-F).

A lane sequence is a lane with the lanes that continue it without a lane change, chosen so that the
goal stays near. Its value for the route follows from the cost to go of its lanes
(`route.costs_to_go`):

(1) changes(sequence)  = lane changes between it and the goal
(2) change_by(sequence) = station at which its last lane ends from which the first of these changes
        is possible
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replan.core.arrays import TIE
from replan.logs.frame import PlannerContext
from replan.logs.road import predecessors
from replan.logs.route import CostToGo, costs_to_go, start_lanes, straight_on
from replan.logs.states import EgoState
from replan.planners.frenet.reference_path import ReferencePath, make_reference_path
from replan.planners.frenet.route_line import BEYOND_M

# Length of a sequence behind the lane that it was made for, m, so that it contains agents that
# follow
BEHIND_M = 60.0


@dataclass(frozen=True, eq=False, slots=True)
class LaneSequence:
    """A candidate lane."""

    lanes: tuple[int, ...]  # Its lanes in driving order, including a stretch behind
    reference: ReferencePath
    # (1); 0 if it leads to the goal or there is no goal, None if the goal cannot be reached from it
    changes: int | None
    change_by: float  # (2), m; inf where no change is needed


class LaneSequences:
    """The lane sequences of one scenario, each made when it is first needed."""

    def __init__(self, context: PlannerContext) -> None:
        self._road = context.road
        self._to_go = costs_to_go(context.road, context.goal)
        self._before = predecessors(
            {i: lane for i, lane in context.road.lanes.items() if lane.drivable}
        )
        self._sequences: dict[int, LaneSequence] = {}
        self._start, self._car = context.start, context.vehicle

    def start(self, ego: EgoState) -> LaneSequence:
        """The first sequence: that of the lane nearest to the goal among the lanes under the
        ego.
        """
        under = start_lanes(self._road, ego)[: None if self._to_go else 1]
        best = min(under, key=lambda lane: (*_rank(self._to_go.get(lane)), under.index(lane)))
        return self.of(best)

    def of(self, lane: int) -> LaneSequence:
        """The sequence that a lane belongs to."""
        if lane not in self._sequences:
            sequence = self._make_sequence(lane)
            for ahead in sequence.lanes[sequence.lanes.index(lane) :]:
                self._sequences.setdefault(ahead, sequence)
        return self._sequences[lane]

    def beside(
        self, sequence: LaneSequence, station: float
    ) -> tuple[tuple[str, LaneSequence], ...]:
        """The neighbours ("left" or "right") of a sequence at a station whose marking may be
        crossed.
        """
        ends = np.cumsum([self._road.lanes[lane].length for lane in sequence.lanes])
        position = min(int(np.searchsorted(ends, station + TIE)), len(sequence.lanes) - 1)
        lane = self._road.lanes[sequence.lanes[position]]
        sides = (
            ("left", lane.left_neighbour, lane.left_crossable),
            ("right", lane.right_neighbour, lane.right_crossable),
        )
        ordered = sides if self._road.drives_on_right else sides[::-1]
        return tuple(
            (side, self.of(other))
            for side, other, crossable in ordered
            if other is not None
            and crossable
            and other in self._road.lanes
            and self._road.lanes[other].drivable
        )

    def _make_sequence(self, lane: int) -> LaneSequence:
        """The sequence of a lane: on towards the goal, straight on if no successor leads there, and
        back behind it.
        """
        onward, length = [lane], 0.0
        while length < BEYOND_M:
            leading = [i for i in self._road.lanes[onward[-1]].successors if i in self._to_go]
            nearest = min(leading, key=lambda i: (*_rank(self._to_go[i]), i), default=None)
            after = nearest if nearest is not None else straight_on(self._road, onward[-1])
            if after is None or after in onward:
                break
            onward.append(after)
            length += self._road.lanes[after].length
        behind: list[int] = []
        length = 0.0
        while length < BEHIND_M:
            first = (behind or onward)[0]
            before = min(
                (i for i in self._before.get(first, ()) if straight_on(self._road, i) == first),
                default=None,
            )
            if before is None or before in behind or before in onward:
                break
            behind.insert(0, before)
            length += self._road.lanes[before].length
        lanes = (*behind, *onward)
        reference = make_reference_path(self._road, lanes, self._start, self._car)
        if not self._to_go:
            return LaneSequence(lanes, reference, 0, np.inf)
        needs = [
            self._to_go[lane_id].changes if lane_id in self._to_go else None for lane_id in lanes
        ]
        known_needs = [
            (need, i) for i, need in enumerate(needs) if need is not None and i >= len(behind)
        ]
        fewest = min((need for need, _ in known_needs), default=None)
        if not fewest:
            return LaneSequence(lanes, reference, fewest, np.inf)
        ends = np.cumsum([self._road.lanes[lane_id].length for lane_id in lanes])
        due = float(ends[max(i for need, i in known_needs if need == fewest)])
        return LaneSequence(lanes, reference, fewest, due)  # (1), (2)


def _rank(to_go: CostToGo | None) -> tuple[float, float]:
    return (np.inf, np.inf) if to_go is None else (float(to_go.changes), to_go.cost)
