"""Corridor: which standing obstacles the path must pass, on which side, and what width that leaves.

Only what stands still is passed by the path; what moves is met in the S-T graph. The rear axle's station s and offset l
stand for the whole ego: an obstacle's box in the S-L plane is grown by the ego's length and half width.

(1) lower <= l <= upper,  lane (or, beside an obstacle, the reachable road) less half the ego's width,
    and 1 - kappa l >= MIN_REGULAR: short of the centre of a turn
(2) nudge left of an obstacle:   lower >= its left side + half width + clearance     over its stations
    nudge right:                 upper <= its right side - half width - clearance
(3) Where the ego is outside the lane, the room is widened to hold a quintic from its state back into it.
(4) A bound that steering cannot reach from the start any more is loosened to what it can; the S-T graph then sees the
    obstacle in the path, and the ego brakes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.frame import Frame
from logs.kernel import FloatArray
from logs.road import line_project_many
from logs.shapes import corners
from logs.trace import Decision, DecisionKind
from logs.vehicle import VehicleParameters
from planners.dp_qp.path import MIN_REGULAR
from planners.dp_qp.path_dp import quintic
from planners.dp_qp.reference_line import Course

STANDING_MPS = 0.5


@dataclass(frozen=True)
class CorridorConfig:
    """Distances that the path keeps.

    Attributes:
        clearance_m: To an obstacle that is passed.
        min_clearance_m: Where there is no more room; with less the ego stops.
        edge_m: To the lane's edge.
        gap_m: Ahead and behind an obstacle, added to its length.
        neighbour_behind_m: A neighbouring lane may be borrowed if nobody moves on it from this far behind ...
        neighbour_ahead_m: ... to this far ahead.
    """

    clearance_m: float = 0.6
    min_clearance_m: float = 0.25
    edge_m: float = 0.25
    gap_m: float = 1.0
    neighbour_behind_m: float = 40.0
    neighbour_ahead_m: float = 60.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_clearance_m <= self.clearance_m:
            raise ValueError("min_clearance_m must lie between 0 and clearance_m")


@dataclass(frozen=True, eq=False, slots=True)
class PathObstacle:
    """A standing agent near the path: its box in the S-L plane, not grown, m."""

    agent: str
    s_from: float
    s_to: float
    l_from: float
    l_to: float


@dataclass(frozen=True, eq=False, slots=True)
class Room:
    """The corridor without obstacles at stations `(n,)`: bounds of l for the rear axle, m."""

    s: FloatArray
    lower: FloatArray
    upper: FloatArray


def path_obstacles(
    course: Course, frame: Frame, s_ego: float, length: float, vehicle: VehicleParameters
) -> tuple[PathObstacle, ...]:
    """The standing agents beside or ahead of the ego, up to `length` m, that stand on the road or near its edge."""
    agents = frame.agents
    found = []
    reach = length + 30.0
    near = np.hypot(agents.x - frame.ego.x, agents.y - frame.ego.y) < reach
    for i in np.flatnonzero(near & (agents.speed < STANDING_MPS)):
        s, _ = course.line.project(float(agents.x[i]), float(agents.y[i]), s_ego, reach)
        outline = corners(agents.x[i], agents.y[i], agents.yaw[i], agents.length[i], agents.width[i])
        x, y = np.vstack([outline, 0.5 * (outline + np.roll(outline, 1, axis=0))]).T.copy()  # a curve bulges in between
        feet = line_project_many(course.line.s, course.line.coef, x, y, s, 10.0 + float(agents.length[i]))
        box = PathObstacle(agents.ids[i], *(float(v) for k in (0, 1) for v in (feet[:, k].min(), feet[:, k].max())))
        ahead = box.s_to > s_ego - vehicle.rear_overhang and box.s_from < s_ego + length + vehicle.axle_to_front
        left, right = (float(np.interp(s, course.line.s, edge)) for edge in (course.road_left, course.road_right))
        if ahead and box.l_from < left + 1.0 and box.l_to > right - 1.0:
            found.append(box)
    return tuple(sorted(found, key=lambda box: (box.s_from, box.agent)))


def grown(box: PathObstacle, vehicle: VehicleParameters, clearance: float, gap: float) -> tuple[float, ...]:
    """Stations and offsets (s from, s to, l from, l to) that the rear axle must avoid."""
    side = 0.5 * vehicle.width + clearance
    return (
        box.s_from - vehicle.axle_to_front - gap,
        box.s_to + vehicle.rear_overhang + gap,
        box.l_from - side,
        box.l_to + side,
    )


def room(
    course: Course,
    s: FloatArray,
    borrow: FloatArray,
    *,
    left_free: bool,
    right_free: bool,
    vehicle: VehicleParameters,
    config: CorridorConfig,
) -> Room:
    """The corridor (1) at stations `(n,)`; where `borrow` `(n,)` is 1 a free neighbouring lane belongs to it."""
    at = [
        np.interp(s, course.line.s, edge)
        for edge in (course.lane_right, course.road_right, course.lane_left, course.road_left)
    ]
    right = np.where((borrow > 0.0) & right_free, at[1], at[0])
    left = np.where((borrow > 0.0) & left_free, at[3], at[2])
    side = 0.5 * vehicle.width + config.edge_m
    lower, upper = right + side, left - side
    middle = 0.5 * (lower + upper)
    kappa = np.interp(s, course.line.s, course.line.kappa, left=0.0, right=0.0)
    center = (1.0 - MIN_REGULAR) / np.maximum(np.abs(kappa), 1e-6)
    lower, upper = (
        np.where(kappa < 0.0, np.maximum(lower, -center), lower),
        np.where(kappa > 0.0, np.minimum(upper, center), upper),
    )
    narrow = lower > upper - 0.1
    return Room(s, np.where(narrow, middle - 0.05, lower), np.where(narrow, middle + 0.05, upper))


def borrowed(
    obstacles: tuple[PathObstacle, ...], s: FloatArray, speed: float, vehicle: VehicleParameters
) -> FloatArray:
    """1.0 at the stations `(n,)` from which a lane may be borrowed to pass an obstacle, else 0.0."""
    out = np.zeros(len(s))
    swing = max(15.0, 2.5 * speed)
    for box in obstacles:
        out[(s > box.s_from - vehicle.axle_to_front - swing) & (s < box.s_to + vehicle.rear_overhang + swing)] = 1.0
    return out


def free_sides(course: Course, frame: Frame, s_ego: float, config: CorridorConfig) -> tuple[bool, bool]:
    """Whether nobody moves on the reachable road left and right of the own lane, near the ego."""
    agents = frame.agents
    left, right = True, True
    reach = config.neighbour_ahead_m + 20.0
    near = np.hypot(agents.x - frame.ego.x, agents.y - frame.ego.y) < reach
    for i in np.flatnonzero(near & (agents.speed >= STANDING_MPS)):
        s, offset = course.line.project(float(agents.x[i]), float(agents.y[i]), s_ego, reach)
        if not -config.neighbour_behind_m < s - s_ego < config.neighbour_ahead_m:
            continue
        edges = [
            float(np.interp(s, course.line.s, edge))
            for edge in (course.road_right, course.lane_right, course.lane_left, course.road_left)
        ]
        half = 0.5 * agents.width[i]
        left &= not edges[2] - half < offset < edges[3] + half
        right &= not edges[0] - half < offset < edges[1] + half
    return left, right


def decide_sides(
    obstacles: tuple[PathObstacle, ...], dp_offsets: FloatArray, space: Room, vehicle: VehicleParameters,
    config: CorridorConfig,
) -> tuple[Decision, ...]:  # fmt: skip
    """Nudge left or right as the DP path (its offset at each obstacle's middle `(b,)`) passes, if there is room."""
    decisions = []
    for box, offset in zip(obstacles, dp_offsets, strict=True):
        over = _over(space.s, grown(box, vehicle, 0.0, 0.0))
        if not over.any():
            decisions.append(Decision(box.agent, DecisionKind.IGNORE, "path", "beyond the path"))
            continue
        lower, upper = float(space.lower[over].max()), float(space.upper[over].min())
        side = 0.5 * vehicle.width
        left_gap, right_gap = upper - box.l_to - side, box.l_from - side - lower
        if lower > box.l_to + side + config.clearance_m or upper < box.l_from - side - config.clearance_m:
            decisions.append(Decision(box.agent, DecisionKind.IGNORE, "path", "stands beside the corridor"))
        elif max(left_gap, right_gap) < config.min_clearance_m:
            reason = f"no room: {max(left_gap, 0.0):.2f} m left, {max(right_gap, 0.0):.2f} m right"
            decisions.append(Decision(box.agent, DecisionKind.STOP, "path", reason))
        else:
            goes_left = offset > 0.5 * (box.l_from + box.l_to)
            if (left_gap if goes_left else right_gap) < config.min_clearance_m:
                goes_left = not goes_left
            kind = DecisionKind.NUDGE_LEFT if goes_left else DecisionKind.NUDGE_RIGHT
            gap = min(left_gap if goes_left else right_gap, config.clearance_m)
            decisions.append(Decision(box.agent, kind, "path", f"stands in the corridor: pass with {gap:.2f} m"))
    return tuple(decisions)


def narrowed(
    space: Room,
    obstacles: tuple[PathObstacle, ...],
    decisions: tuple[Decision, ...],
    vehicle: VehicleParameters,
    config: CorridorConfig,
) -> tuple[FloatArray, FloatArray, tuple[Decision, ...]]:
    """The corridor (2); an obstacle that would close it becomes a stop."""
    lower, upper = space.lower.copy(), space.upper.copy()
    gap = max(config.gap_m, float(space.s[1] - space.s[0]))  # so that a knot lies before and behind each box
    final = []
    for box, decision in zip(obstacles, decisions, strict=True):
        if decision.kind not in (DecisionKind.NUDGE_LEFT, DecisionKind.NUDGE_RIGHT):
            final.append(decision)
            continue
        over = _over(space.s, grown(box, vehicle, 0.0, gap))
        side = 0.5 * vehicle.width
        if decision.kind is DecisionKind.NUDGE_LEFT:
            free = float((upper[over] - box.l_to - side).min(initial=np.inf))
            edge = box.l_to + side + min(config.clearance_m, free - 0.02)
            tried = np.maximum(lower[over], edge), upper[over]
        else:
            free = float((box.l_from - side - lower[over]).min(initial=np.inf))
            edge = box.l_from - side - min(config.clearance_m, free - 0.02)
            tried = lower[over], np.minimum(upper[over], edge)
        if free < config.min_clearance_m or (tried[0] > tried[1]).any():
            reason = f"no room beside the other obstacles: {max(free, 0.0):.2f} m"
            final.append(Decision(box.agent, DecisionKind.STOP, "path", reason))
            continue
        lower[over], upper[over] = tried
        final.append(decision)
    return lower, upper, tuple(final)


def widened(space: Room, start: tuple[float, float, float], speed: float) -> Room:
    """The room (3): where the ego starts outside of it, it holds a quintic from its state back inside."""
    s, lower, upper = space.s, space.lower, space.upper
    l0, dl0, ddl0 = start
    ahead = l0 + dl0 * min(5.0, 0.5 * speed)
    if lower[0] <= l0 <= upper[0] and lower[0] <= ahead <= upper[0]:
        return space
    span = max(12.0, 2.5 * speed)
    d = np.minimum(s - s[0], span)
    target = float(np.clip(l0, np.interp(s[0] + span, s, lower), np.interp(s[0] + span, s, upper)))
    c3, c4, c5 = quintic(l0, dl0, ddl0, target, span)
    back = l0 + d * (dl0 + d * (0.5 * ddl0 + d * (c3 + d * (c4 + d * c5))))
    near = s - s[0] <= span
    return Room(
        s,
        np.where(near, np.minimum(lower, back - 0.05), lower),
        np.where(near, np.maximum(upper, back + 0.05), upper),
    )


def reachable(
    s: FloatArray, lower: FloatArray, upper: FloatArray, start: tuple[float, float, float], kappa: float
) -> tuple[FloatArray, FloatArray]:
    """Bounds (4) at knots `(n,)`: no bound asks for more than steering with `kappa` (1/m) from the start can do.

    The steering itself takes one knot.
    """
    d = s - s[0]
    along, steer = start[0] + start[1] * d, 0.5 * kappa * np.maximum(d - d[1], 0.0) ** 2
    return np.minimum(lower, along + steer), np.maximum(upper, along - steer)


def _over(s: FloatArray, box: tuple[float, ...]) -> np.ndarray:
    return (s >= box[0]) & (s <= box[1])
