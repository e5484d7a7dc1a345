"""Who took the way in the end: by hand, and what lies beside the way is not on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from handmade import drive, lanes_along, scenario, straight, track, tracks

from logs import DecisionKind, EndReason, GraphObstacle, Mode, Plan, PlannedFrame, StGraph, Trace
from logs.kernel import FloatArray
from replay.explain.planner_input import actual_occupancy

NONE = np.empty((0, 2))


def outlines(*agents: dict[str, object], end: float = 8.0) -> list[FloatArray]:
    """Of one frame at 0 s of an ego at 10 m/s along x, with all agents in its S-T graph."""
    ego = drive(straight, 10.0, 8.0)
    world = scenario(ego, agents=tracks(*agents), road=lanes_along(ego))
    things = tuple(GraphObstacle(str(agent["id"]), NONE, DecisionKind.FOLLOW) for agent in agents)
    frame = PlannedFrame(0.0, Plan(ego, internals=(StGraph(None, None, NONE, NONE, things),)))
    driven = ego.between(0.0, end)
    trace = Trace("handmade", "x", Mode.CLOSED, False, driven, world.tracks, (frame,), EndReason.GOAL)
    (found,) = actual_occupancy(trace, world)
    return found


def test_a_car_that_drives_ahead_takes_the_way_from_its_rear_to_its_front() -> None:
    t = np.arange(0.0, 8.01, 0.1)
    (found,) = outlines(track("a", list(t), list(30.0 + 5.0 * t), [0.0] * len(t), length=4.0, width=2.0))
    car = scenario(drive(straight, 10.0, 1.0)).vehicle
    low, high = np.split(found, 2)
    assert low[:, 0] == pytest.approx(np.arange(0.0, 8.01, 0.25))
    assert low[:, 1] == pytest.approx(30.0 + 5.0 * low[:, 0] - 2.0 - car.axle_to_front, abs=0.3)
    rear = car.length - car.axle_to_front
    assert high[::-1, 1] == pytest.approx(32.0 + 5.0 * low[:, 0] + rear, abs=0.3)


def test_nothing_is_drawn_beside_the_way_or_after_the_drive() -> None:
    assert outlines(track("beside", [0.0], [30.0], [6.0], static=True)) == []
    (found,) = outlines(track("wall", [0.0], [30.0], [0.0], static=True), end=2.0)
    assert found[:, 0].max() == pytest.approx(2.0)


def test_only_those_in_the_graph_are_drawn() -> None:
    ego = drive(straight, 10.0, 8.0)
    world = scenario(ego, agents=tracks(track("wall", [0.0], [30.0], [0.0], static=True)), road=lanes_along(ego))
    frame = PlannedFrame(0.0, Plan(ego))
    trace = Trace("handmade", "x", Mode.CLOSED, False, ego, world.tracks, (frame,), EndReason.GOAL)
    assert list(actual_occupancy(trace, world)) == [[]]
    stop = StGraph(None, None, NONE, NONE, (GraphObstacle("stop line 1", NONE, DecisionKind.STOP),))
    assert list(actual_occupancy(replace(trace, frames=(PlannedFrame(0.0, Plan(ego, internals=(stop,))),)), world)) == [
        []
    ]
