"""Changes a scenario in ways that should not change results: turned, shifted, mirrored, other
clock, noise of 1e-9.

(1) p' = R(dyaw) p + d
        for every point of the log; velocities p_dot' = R(dyaw) p_dot, headings yaw' = yaw + dyaw
(2) (x, y)' = (x, -y)
        yaw' = -yaw, kappa' = -kappa, steer' = -steer; left and right change places

(3) p(u) = (1 + 2 u)(1 - u)^2 p_k + u (1 - u)^2 d v_k + u^2 (3 - 2 u) p_(k+1) - u^2 (1
        - u) d v_(k+1),  0 <= u <= 1
    between two samples of a track, d s apart, with the velocities v of `Tracks.motion`: the log at
    another rate

The points include the log's own coordinates, so `Scenario.origin` is turned and mirrored, but not
shifted by d. Tests of planners and metrics use these changes, and `studies.invariance` drives the
changed scenarios.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import cos, sin
from typing import Any, TypeVar

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.repair.detections import Detections
from replan.logs.road import Goal, Road
from replan.logs.scenario import Scenario
from replan.logs.states import OnboardPlan, Trajectory
from replan.logs.tracks import Tracks

MIRRORED = "~mirrored"
_FLIP = np.array([1.0, -1.0])
Boxes = TypeVar("Boxes", Tracks, Detections)
Placed = TypeVar("Placed", Tracks, Detections, Trajectory)
_Points = Callable[[FloatArray], FloatArray]


def moved(scenario: Scenario, dx: float, dy: float, dyaw: float) -> Scenario:
    """The scenario turned by `dyaw` (rad) about (0, 0), then shifted by (dx, dy) m: a rigid motion
    (1) of the world.
    """
    turn = _turn(dyaw)

    def turned_boxes(boxes: Boxes) -> Boxes:
        vx, vy = (np.column_stack([boxes.vx, boxes.vy]) @ turn).T
        return replace(boxes, yaw=boxes.yaw + dyaw, vx=vx, vy=vy)

    def turned_trajectory(trajectory: Trajectory) -> Trajectory:
        return replace(trajectory, yaw=trajectory.yaw + dyaw)

    def turned_goal(goal: Goal) -> Goal:
        return replace(goal, yaw=goal.yaw and (goal.yaw[0] + dyaw, goal.yaw[1] + dyaw))

    x, y = np.array(scenario.origin) @ turn
    turned = replace(
        scenario,
        ego=turned_trajectory(scenario.ego),
        before=scenario.before and turned_trajectory(scenario.before),
        onboard=_with_trajectories(scenario.onboard, turned_trajectory),
        **_with_boxes(scenario, turned_boxes),
        goal=None if scenario.goal is None else scenario.goal.changed(turned_goal),
        origin=(float(x), float(y)),
    )
    return _with_points(turned, lambda points: points @ turn + np.array([dx, dy]))


def rotated(scenario: Scenario, angle: float, about: tuple[float, float] = (0.0, 0.0)) -> Scenario:
    """The scenario turned counter-clockwise by `angle` (rad) about a point, m."""
    dx, dy = np.array(about) - np.array(about) @ _turn(angle)
    return moved(scenario, float(dx), float(dy), angle)


def shifted_clock(scenario: Scenario, ns: int) -> Scenario:
    """The scenario as if the clock of the log had been set forward by `ns` nanoseconds."""
    return replace(scenario, start_ns=scenario.start_ns + ns)


def sampled(scenario: Scenario, rate_hz: float) -> Scenario:
    """The scenario as if it had been recorded at `rate_hz`: ego and moving tracks at multiples of 1
    / `rate_hz` s.

    Positions between two samples follow (3); all else is linear. The ego keeps its first and last
    state. A track begins with its first multiple and ends with its last, and keeps its gaps; one
    that holds no multiple keeps its first sample.
    """
    tracks, ego, moved = scenario.tracks, scenario.ego, scenario.tracks.motion
    times, columns = [], []
    for i in range(len(tracks)):
        own = tracks.samples(i)
        recorded, t = tracks.t[own], tracks.t[own]
        if not tracks.static[i]:  # static tracks are not resampled
            t = _multiples(recorded, rate_hz)
            k = np.searchsorted(recorded, t + 1e-9, side="right") - 1
            outside_gaps = t[~(tracks.gap_after[own][k] & (t > recorded[k] + 1e-9))]
            t = outside_gaps if len(outside_gaps) else recorded[:1]
        k = np.clip(
            np.searchsorted(recorded, t + 1e-9, side="right") - 1, 0, max(len(recorded) - 2, 0)
        )
        after = np.minimum(k + 1, len(recorded) - 1)
        d = recorded[after] - recorded[k]
        u = np.clip(np.divide(t - recorded[k], d, out=np.zeros(len(t)), where=d > 0.0), 0.0, 1.0)
        curves = [
            (1.0 + 2.0 * u) * (1.0 - u) ** 2 * p[k]
            + u * (1.0 - u) ** 2 * d * v[k]
            + u * u * (3.0 - 2.0 * u) * p[after]
            - u * u * (1.0 - u) * d * v[after]
            for p, v in ((tracks.x[own], moved.vx[own]), (tracks.y[own], moved.vy[own]))
        ]  # (3)
        lines = [
            p[k] + u * (p[after] - p[k]) for p in (tracks.yaw[own], tracks.vx[own], tracks.vy[own])
        ]
        times.append(t)
        columns.append(np.stack([*curves, *lines]))
    x, y, yaw, vx, vy = np.hstack(columns) if columns else np.empty((5, 0))
    offsets = np.r_[0, np.cumsum([len(t) for t in times])].astype(np.int64)
    t = np.concatenate([np.empty(0), *times])
    kept_t = np.unique(np.r_[ego.t[0], _multiples(ego.t, rate_hz), ego.t[-1]])
    return replace(
        scenario,
        ego=ego.resampled(kept_t[np.r_[True, np.diff(kept_t) > 1e-6]]) if len(ego) > 1 else ego,
        tracks=replace(tracks, offsets=offsets, t=t, x=x, y=y, yaw=yaw, vx=vx, vy=vy),
    )


def _multiples(t: FloatArray, rate_hz: float) -> FloatArray:
    """The multiples of 1 / `rate_hz` within the span of the times `t`."""
    multiples = (
        np.arange(np.ceil(t[0] * rate_hz - 1e-6), np.floor(t[-1] * rate_hz + 1e-6) + 1.0) / rate_hz
    )
    return np.clip(multiples, t[0], t[-1])


def jittered(scenario: Scenario, size: float, seed: int = 0) -> Scenario:
    """Add independent errors, uniform in +-`size`, to all measured values.

    On each coordinate (m) of ego, others, lanes, stop lines, crosswalks and goal, and on speeds
    (m/s), accelerations (m/s2), headings (rad) and curvatures (1/m). No decision should depend on
    sizes like 1e-9. Lanes that share a boundary no longer share it exactly.
    """
    rng = np.random.default_rng(seed)

    def off(values: FloatArray) -> FloatArray:
        return np.asarray(values + rng.uniform(-size, size, np.shape(values)))

    ego = scenario.ego

    def noisy_boxes(boxes: Boxes) -> Boxes:
        return replace(boxes, yaw=off(boxes.yaw), vx=off(boxes.vx), vy=off(boxes.vy))

    noisy = replace(
        scenario,
        ego=replace(ego, yaw=off(ego.yaw), v=off(ego.v), a=off(ego.a), kappa=off(ego.kappa)),
        **_with_boxes(scenario, noisy_boxes),
    )
    return _with_points(noisy, off)


def mirrored(scenario: Scenario) -> Scenario:
    """The scenario reflected at the x axis (2), driving side included; mirroring twice gives the
    original.

    Left and right change places everywhere: yaw, curvature and steering change their signs;
    boundaries, neighbours, markings, the ends of stop lines, and the words "nudge left" and "nudge
    right" in the expected decisions swap. Sizes, times, speeds, right of way, lights, and the name
    except for its suffix do not change.
    """
    name, road = scenario.name, scenario.road
    goal, controls = scenario.goal, scenario.controls

    def flipped(goal: Goal) -> Goal:
        yaw = None if goal.yaw is None else (-goal.yaw[1], -goal.yaw[0])
        regions = tuple(region[::-1] * _FLIP for region in goal.regions)
        return replace(goal, regions=regions, yaw=yaw)

    def flipped_boxes(boxes: Boxes) -> Boxes:
        return replace(boxes, y=-boxes.y, yaw=-boxes.yaw, vy=-boxes.vy)

    lanes = {
        lane.id: replace(
            lane,
            left=lane.right * _FLIP,
            right=lane.left * _FLIP,
            line=lane.line * _FLIP,
            left_neighbour=lane.right_neighbour,
            right_neighbour=lane.left_neighbour,
            left_opposite=lane.right_opposite,
            right_opposite=lane.left_opposite,
            left_crossable=lane.right_crossable,
            right_crossable=lane.left_crossable,
        )
        for lane in road.lanes.values()
    }
    road = replace(
        road,
        lanes=lanes,
        drives_on_right=not road.drives_on_right,
        stop_lines=tuple(
            replace(line, points=line.points[::-1] * _FLIP) for line in road.stop_lines
        ),
        crosswalks=tuple(
            replace(walk, polygon=walk.polygon[::-1] * _FLIP) for walk in road.crosswalks
        ),
        areas=_flipped_areas(road.areas),
        car_parks=_flipped_areas(road.car_parks),
        intersections=_flipped_areas(road.intersections),
    )
    metadata = dict(scenario.metadata)
    if "expected_decisions" in metadata:
        text = (
            metadata["expected_decisions"]
            .replace("nudge left", "nudge\0")
            .replace("nudge right", "nudge left")
        )
        metadata["expected_decisions"] = text.replace("nudge\0", "nudge right")
    return replace(
        scenario,
        name=name.removesuffix(MIRRORED) if name.endswith(MIRRORED) else name + MIRRORED,
        ego=mirrored_trajectory(scenario.ego),
        before=scenario.before and mirrored_trajectory(scenario.before),
        onboard=_with_trajectories(scenario.onboard, mirrored_trajectory),
        **_with_boxes(scenario, flipped_boxes),
        road=road,
        goal=None if goal is None else goal.changed(flipped),
        controls=None if controls is None else replace(controls, steer=-controls.steer),
        origin=(scenario.origin[0], -scenario.origin[1]),
        metadata=metadata,
    )


def _flipped_areas(areas: tuple[FloatArray, ...]) -> tuple[FloatArray, ...]:
    return tuple(area[::-1] * _FLIP for area in areas)


def moved_trajectory(ego: Trajectory, dx: float, dy: float, dyaw: float) -> Trajectory:
    """Return the trajectory moved by (1)."""
    x, y = (np.column_stack([ego.x, ego.y]) @ _turn(dyaw) + np.array([dx, dy])).T
    return replace(ego, x=x, y=y, yaw=ego.yaw + dyaw)


def mirrored_trajectory(ego: Trajectory) -> Trajectory:
    """Return the trajectory mirrored by (2)."""
    return replace(ego, y=-ego.y, yaw=-ego.yaw, kappa=-ego.kappa)


def _turn(angle: float) -> FloatArray:
    """Return the matrix `(2, 2)` of R(angle), for row vectors: `points @ matrix`."""
    c, s = cos(angle), sin(angle)
    return np.array([[c, s], [-s, c]])


def _with_points(scenario: Scenario, points: _Points) -> Scenario:
    """Apply `points` to all points `(k, 2)` of the scenario, and change nothing else."""
    goal = scenario.goal

    def elsewhere(placed: Placed) -> Placed:
        x, y = points(np.column_stack([placed.x, placed.y])).T
        return replace(placed, x=x, y=y)

    def goal_elsewhere(goal: Goal) -> Goal:
        return replace(goal, regions=tuple(map(points, goal.regions)))

    # Before the ego: the order of the random numbers in `jittered`
    boxes = _with_boxes(scenario, elsewhere)
    return replace(
        scenario,
        ego=elsewhere(scenario.ego),
        before=scenario.before and elsewhere(scenario.before),
        onboard=_with_trajectories(scenario.onboard, elsewhere),
        **boxes,
        road=placed_road(scenario.road, points),
        goal=None if goal is None else goal.changed(goal_elsewhere),
    )


def _with_boxes(scenario: Scenario, change: Callable[[Any], Any]) -> dict[str, Any]:
    """Apply `changed` to all boxes of a scenario: tracks, detections and repair.

    Return them as fields.
    """
    tracks, detections, repair = change(scenario.tracks), scenario.detections, scenario.repair
    if repair is not None:
        repair = replace(
            repair,
            detections=change(repair.detections),
            removed=change(repair.removed),
            tracks=tracks if repair.tracks is scenario.tracks else change(repair.tracks),
        )
    return {
        "tracks": tracks,
        "detections": None if detections is None else change(detections),
        "repair": repair,
    }


def _with_trajectories(
    plans: tuple[OnboardPlan, ...], changed: Callable[[Trajectory], Trajectory]
) -> tuple[OnboardPlan, ...]:
    return tuple(plan.changed(changed) for plan in plans)


def placed_road(road: Road, points: _Points) -> Road:
    """Apply `points` to all points `(k, 2)` of the road, and change nothing else."""
    return replace(
        road,
        lanes={
            i: replace(
                lane,
                left=points(lane.left),
                right=points(lane.right),
                line=points(lane.line) if len(lane.line) else lane.line,
            )
            for i, lane in road.lanes.items()
        },
        stop_lines=tuple(replace(line, points=points(line.points)) for line in road.stop_lines),
        crosswalks=tuple(replace(walk, polygon=points(walk.polygon)) for walk in road.crosswalks),
        areas=tuple(map(points, road.areas)),
        car_parks=tuple(map(points, road.car_parks)),
        intersections=tuple(map(points, road.intersections)),
    )
