"""How far apart two plans of one frame are, by their trajectories and their graphs.

(1) distance = d(trajectories) + d(graphs), each of 0 .. 1
(2) d(trajectories) = r / (r + ROUGH_M), r the mean distance of their points, m
(3) d(graphs) = mean of r / (r + ROUGH_M) over the obstacles, r the mean distance of the corners of
        two outlines of one agent; 1 for an obstacle that only one of them has
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from replan.logs.plan import Graph, Plan

ROUGH_M = 1.0
"""The distance that counts half in (2) and (3)."""
COLUMNS = ("t", "x", "y", "yaw", "v", "a")


def same_plan(one: Plan | None, two: Plan) -> bool:
    """Whether two trajectories are equal to the bit; None is the plan of a planner that raised."""
    if one is None or len(one.trajectory.t) != len(two.trajectory.t):
        return False
    columns = [(getattr(one.trajectory, name), getattr(two.trajectory, name)) for name in COLUMNS]
    return all(np.array_equal(first, second) for first, second in columns)


def _near(distance_m: float) -> float:
    return distance_m / (distance_m + ROUGH_M)


def plan_distance(one: Plan | None, two: Plan) -> float:
    """The distance (1) of two plans of one frame; 2 if one planner raised."""
    if one is None:
        return 2.0
    t = two.trajectory.t
    samples = np.minimum(t, one.trajectory.t[-1])
    dx, dy = (
        np.interp(samples, one.trajectory.t, getattr(one.trajectory, name))
        - np.interp(samples, t, getattr(two.trajectory, name))
        for name in ("x", "y")
    )
    obstacles = [
        distance
        for first, second in _planes(one, two)
        for distance in _obstacle_distances(first, second)
    ]
    graphs = sum(obstacles) / len(obstacles) if obstacles else 0.0
    return _near(float(np.hypot(dx, dy).mean())) + graphs  # (1), (2)


def _planes(one: Plan, two: Plan) -> Iterator[tuple[Graph, Graph]]:
    """The graphs of the same kind of two plans."""
    graphs = [[item for item in plan.internals if isinstance(item, Graph)] for plan in (one, two)]
    for first in graphs[0]:
        second = next((graph for graph in graphs[1] if type(graph) is type(first)), None)
        if second is not None:
            yield first, second


def _obstacle_distances(one: Graph, two: Graph) -> Iterator[float]:
    """The terms of (3)."""
    outlines = [{item.agent: item.outline for item in graph.obstacles} for graph in (one, two)]
    for agent in {**outlines[0], **outlines[1]}:
        first, second = outlines[0].get(agent), outlines[1].get(agent)
        if first is None or second is None:
            yield 1.0
        elif first.shape == second.shape:
            yield _near(float(np.hypot(*(first - second).T).mean()))
        else:
            corners = [np.vstack([line.min(axis=0), line.max(axis=0)]) for line in (first, second)]
            yield _near(float(np.hypot(*(corners[0] - corners[1]).T).mean()))


def begins_alike(one: Plan, two: Plan) -> bool:
    """Whether two plans begin in the same state."""
    starts = [
        [float(getattr(plan.trajectory, name)[0]) for name in COLUMNS[:-1]] for plan in (one, two)
    ]
    return starts[0] == starts[1]


def same_obstacles(one: Plan, two: Plan) -> bool:
    """Whether both plans have graphs, and the same obstacles in them."""
    planes = list(_planes(one, two))
    return bool(planes) and not any(
        far for first, second in planes for far in _obstacle_distances(first, second)
    )
