"""A scenario in another world: reflected, or moved as a whole. Laws of planners and metrics are tested with them."""

from __future__ import annotations

from dataclasses import replace
from math import cos, sin

import numpy as np

from logs.kernel import FloatArray
from logs.road import Goal, Lane, Road
from logs.scenario import Scenario, Tracks
from logs.states import Controls, Trajectory

MIRRORED = "~mirrored"
_FLIP = np.array([1.0, -1.0])


def mirrored(scenario: Scenario) -> Scenario:
    """The scenario reflected at the x axis (y -> -y), driving side included; twice is the scenario itself.

    Left and right change places everywhere: yaw, curvature and steering change their signs, boundaries, neighbours and
    markings swap, so do the ends of stop lines, and the words "nudge left" and "nudge right" in the expected decisions.
    Sizes, times, speeds, who yields to whom, lights, and the name but for its ending stay.
    """
    ego, goal, controls, name = scenario.ego, scenario.goal, scenario.controls, scenario.name
    metadata = dict(scenario.metadata)
    if "expected_decisions" in metadata:
        metadata["expected_decisions"] = _swapped(metadata["expected_decisions"])
    return replace(
        scenario,
        name=name.removesuffix(MIRRORED) if name.endswith(MIRRORED) else name + MIRRORED,
        ego=Trajectory(ego.t, ego.x, -ego.y, -ego.yaw, ego.v, ego.a, -ego.kappa),
        tracks=_mirrored_tracks(scenario.tracks),
        road=_mirrored_road(scenario.road),
        goal=None if goal is None else _mirrored_goal(goal),
        controls=None if controls is None else Controls(controls.t, -controls.steer, controls.throttle, controls.brake),
        origin=(scenario.origin[0], -scenario.origin[1]),
        metadata=metadata,
    )


def _swapped(text: str) -> str:
    return text.replace("nudge left", "nudge\0").replace("nudge right", "nudge left").replace("nudge\0", "nudge right")


def _mirrored_tracks(tracks: Tracks) -> Tracks:
    return replace(tracks, y=-tracks.y, yaw=-tracks.yaw, vy=-tracks.vy)


def _mirrored_road(road: Road) -> Road:
    return replace(
        road,
        lanes={lane.id: _mirrored_lane(lane) for lane in road.lanes.values()},
        drives_on_right=not road.drives_on_right,
        stop_lines=tuple(replace(line, points=line.points[::-1] * _FLIP) for line in road.stop_lines),
        crosswalks=tuple(replace(each, polygon=each.polygon[::-1] * _FLIP) for each in road.crosswalks),
    )


def _mirrored_lane(lane: Lane) -> Lane:
    return replace(
        lane,
        left=lane.right * _FLIP,
        right=lane.left * _FLIP,
        left_neighbour=lane.right_neighbour,
        right_neighbour=lane.left_neighbour,
        left_opposite=lane.right_opposite,
        right_opposite=lane.left_opposite,
        left_crossable=lane.right_crossable,
        right_crossable=lane.left_crossable,
    )


def _mirrored_goal(goal: Goal) -> Goal:
    yaw = None if goal.yaw is None else (-goal.yaw[1], -goal.yaw[0])
    return replace(goal, regions=tuple(region[::-1] * _FLIP for region in goal.regions), yaw=yaw)


def moved(scenario: Scenario, dx: float, dy: float, dyaw: float) -> Scenario:
    """The scenario turned by `dyaw` (rad) about the origin, then shifted by (dx, dy) m: a rigid motion of the world."""
    c, s = cos(dyaw), sin(dyaw)
    turn = np.array([[c, s], [-s, c]])

    def points(xy: FloatArray) -> FloatArray:
        return xy @ turn + np.array([dx, dy])

    ego, tracks, goal = scenario.ego, scenario.tracks, scenario.goal
    x, y = points(np.column_stack([ego.x, ego.y])).T
    others = points(np.column_stack([tracks.x, tracks.y]))
    velocity = np.column_stack([tracks.vx, tracks.vy]) @ turn
    road = scenario.road
    lanes = {i: replace(lane, left=points(lane.left), right=points(lane.right)) for i, lane in road.lanes.items()}
    stop_lines = tuple(replace(line, points=points(line.points)) for line in road.stop_lines)
    crosswalks = tuple(replace(each, polygon=points(each.polygon)) for each in road.crosswalks)
    if goal is not None:
        yaw = None if goal.yaw is None else (goal.yaw[0] + dyaw, goal.yaw[1] + dyaw)
        goal = replace(goal, regions=tuple(points(region) for region in goal.regions), yaw=yaw)
    return replace(
        scenario,
        ego=Trajectory(ego.t, x, y, ego.yaw + dyaw, ego.v, ego.a, ego.kappa),
        tracks=replace(
            tracks, x=others[:, 0], y=others[:, 1], yaw=tracks.yaw + dyaw, vx=velocity[:, 0], vy=velocity[:, 1]
        ),
        road=replace(road, lanes=lanes, stop_lines=stop_lines, crosswalks=crosswalks),
        goal=goal,
    )
