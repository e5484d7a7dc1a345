"""Numbers of a plan that contradict what the planner was shown: an alarm before any sentence.

What was shown is made by perception with its settings, so that noise, latency and hidden agents are
no contradiction. Each check compares two numbers of one frame:

(1) ahead    the station from which an agent takes the path at t = 0 in the S-T graph, against the
             sweep of its shown box along the way; if it is beside the way, against the straight
             distance of the boxes, which is never more than the one along the way
(2) beside   the offset between a standing agent's outline and the solution of the S-L graph,
             against the offset of the shown box from the planned path

Planners grow boxes by margins: of space on both sides, and of time for agents that move. The
tolerances `AHEAD_M` + `AHEAD_S` v and `BESIDE_M` contain these margins. A plan that starts at
another speed than the ego's is refused by the loop.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from replan.core.arrays import frozen
from replan.core.names import counted
from replan.explain.course import Ways
from replan.explain.occupancy import bodies, occupied
from replan.explain.planner_input import SAME_TIME_S, PlannerInput
from replan.logs.agents import Agents
from replan.logs.plan import SlGraph, StGraph
from replan.logs.scenario import Scenario
from replan.logs.shapes import distance
from replan.logs.states import Trajectory
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.scene import Futures
from replan.planners.frenet.sweep import SweptPath

AHEAD_M, AHEAD_S, BESIDE_M = 2.0, 0.6, 0.75
"""Largest differences that the margins of planners explain."""
STANDS_MPS = 0.5
LEAST_FRAMES = 3
"""A contradiction of fewer frames of a drive is not reported."""
MOST = 3
"""Largest number of contradictions in sentences; the number of further ones is given."""


@dataclass(frozen=True, slots=True)
class Contradiction:
    """Two numbers of one frame that cannot both be true.

    Attributes:
        t: Time of the frame, s.
        agent: The agent that they are about.
        plane: The graph that has the first: "S-T" or "S-L".
        drawn_m: S-T: the station from which it takes the path; S-L: its offset to the left of it.
        shown_m: The same from the box that was shown to the planner.
        is_straight: Whether `shown_m` is the straight distance, because the box is beside the path.
        beyond: Their difference in shares of the tolerance.
    """

    t: float
    agent: str
    plane: str
    drawn_m: float
    shown_m: float
    is_straight: bool
    beyond: float


def contradictions(seen: PlannerInput, scenario: Scenario, ways: Ways) -> Iterator[Contradiction]:
    """The contradictions of one frame; none for a fallback."""
    if not seen.planned.plan.status.is_fallback:
        yield from _ahead(seen, scenario.vehicle, ways)
        yield from _beside(seen)


def describe_contradictions(contradicting: Iterable[Contradiction], *, least: int = 1) -> list[str]:
    """A sentence per agent and graph that contradict in `least` frames or more, the worst first:
    both numbers of the worst frame and their sources.
    """
    groups: dict[tuple[str, str], list[Contradiction]] = {}
    for contradiction in contradicting:
        key = contradiction.agent, contradiction.plane
        groups.setdefault(key, []).append(contradiction)
    worst = [
        (max(group, key=attrgetter("beyond")), len(group))
        for group in groups.values()
        if len(group) >= least
    ]
    worst.sort(key=_order)
    lines = []
    for worst_frame, frames in worst[:MOST]:
        count = f" (and in {counted(frames - 1, 'more frame')})" if frames > 1 else ""
        place, straight = "left of the planned path", ""
        if worst_frame.plane == "S-T":
            place = "ahead on the path now"
            straight = " or more" if worst_frame.is_straight else ""
        lines.append(
            f"ALARM: at {worst_frame.t:.2f} s{count} the {worst_frame.plane} graph has "
            f"{worst_frame.agent} {worst_frame.drawn_m:.2f} m {place}, but as it was "
            f"shown to the planner it is {worst_frame.shown_m:.2f} m{straight}."
        )
    left = len(worst) - MOST
    return [*lines, f"ALARM: likewise {counted(left, 'more agent')}."] if left > 0 else lines


def _order(group: tuple[Contradiction, int]) -> float:
    return -group[0].beyond


def _ahead(seen: PlannerInput, car: VehicleParameters, ways: Ways) -> Iterator[Contradiction]:
    """(1): the way is only made where the straight distance differs."""
    plan, agents = seen.planned.plan, seen.agents
    ego = plan.trajectory.state(0)
    ego_box = *ego.ahead(car.axle_to_center), ego.yaw, car.length, car.width
    for agent, drawn_m in _drawn_at_start(seen).items():
        row = agents.ids.index(agent)
        box = agents.x[row], agents.y[row], agents.yaw[row], agents.length[row], agents.width[row]
        shown_m = float(distance(*ego_box, *box))
        tolerance = AHEAD_M + AHEAD_S * float(np.hypot(agents.vx[row], agents.vy[row]))
        if abs(drawn_m - shown_m) <= tolerance:
            continue
        path = ways.of(plan, drawn_m + shown_m)
        along_m = _occupied_from(path.swept, agents, row, car)
        is_straight = bool(np.isnan(along_m))
        # beside the way, the straight distance is only a lower bound
        apart_m = shown_m - drawn_m if is_straight else abs(along_m - drawn_m)
        if apart_m > tolerance:
            yield Contradiction(
                seen.planned.t,
                agent,
                "S-T",
                drawn_m,
                shown_m if is_straight else along_m,
                is_straight,
                apart_m / tolerance,
            )


def _drawn_at_start(seen: PlannerInput) -> dict[str, float]:
    """The station from which each agent takes the path at t = 0 in the S-T graph, m."""
    drawn_m: dict[str, float] = {}
    for graph in seen.planned.plan.internals:
        for obstacle in graph.obstacles if isinstance(graph, StGraph) else ():
            t, s = np.reshape(obstacle.outline, (-1, 2)).T
            now = s[t <= SAME_TIME_S]
            if len(now) and obstacle.agent in seen.agents.ids:
                drawn_m[obstacle.agent] = min(float(now.min()), drawn_m.get(obstacle.agent, np.inf))
    return drawn_m


def _occupied_from(path: SweptPath, agents: Agents, row: int, car: VehicleParameters) -> float:
    """The station from which the shown box of an agent takes a path, m; NaN if it does not."""
    alone, times = agents.some(np.array([row])), frozen(np.arange(2.0))
    poses = (frozen(np.repeat(column[:, None], 2, 1)) for column in (alone.x, alone.y, alone.yaw))
    futures = Futures(times, np.zeros(1, np.int64), frozen(np.ones(1)), *poses)
    occupied_parts = occupied(path, futures, bodies(alone), car)
    return next((float(part.lower[0]) for part in occupied_parts), float("nan"))


def _beside(seen: PlannerInput) -> Iterator[Contradiction]:
    """(2): standing agents beside the planned path, within its length."""
    agents, plan = seen.agents, seen.planned.plan
    for graph in plan.internals:
        if not isinstance(graph, SlGraph) or len(graph.qp) < 2:
            continue
        for obstacle in graph.obstacles:
            row = agents.ids.index(obstacle.agent) if obstacle.agent in agents.ids else -1
            if row < 0 or np.hypot(agents.vx[row], agents.vy[row]) > STANDS_MPS:
                continue
            s, l = (0.5 * (column.min() + column.max()) for column in obstacle.outline.T)
            shown_m = _offset_of(plan.trajectory, float(agents.x[row]), float(agents.y[row]))
            if not graph.qp[0, 0] < s < graph.qp[-1, 0] or np.isnan(shown_m):
                continue
            drawn_m = float(l - np.interp(s, *graph.qp.T))
            if abs(drawn_m - shown_m) > BESIDE_M:
                beyond = abs(drawn_m - shown_m) / BESIDE_M
                yield Contradiction(
                    seen.planned.t, obstacle.agent, "S-L", drawn_m, shown_m, False, beyond
                )


def _offset_of(path: Trajectory, x: float, y: float) -> float:
    """The offset of a point from a path, positive to the left, m; NaN if it is before or behind
    it.
    """
    k = int(np.argmin(np.hypot(path.x - x, path.y - y)))
    dx, dy, yaw = x - path.x[k], y - path.y[k], path.yaw[k]
    along, left = dx * np.cos(yaw) + dy * np.sin(yaw), dy * np.cos(yaw) - dx * np.sin(yaw)
    return float(left) if 0 < k < len(path) - 1 or abs(along) <= BESIDE_M else float("nan")
