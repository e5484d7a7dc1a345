"""Corridor: which obstacles the path must pass, on which side, and what width that leaves.

Only what stands still, or goes slowly along the lane (`slower`), is passed by the path; what else moves is met in the
S-T graph. The corridor holds for the ego's axis from the rear axle to the front bumper, at three points, each at its
own station: so its corners stay in the corridor widened by half its width. (The path DP, coarser, moves the rear axle
past boxes grown by the ego's length.)

(1) lower <= l <= upper,  lane (or, beside an obstacle, the reachable road) less half the ego's width,
    and 1 - kappa l >= MIN_REGULAR: short of the centre of a turn; wider where the ego's nose needs it in a sharp turn
(2) nudge left of an obstacle:   lower >= its left side + half width + clearance     over its stations
    nudge right:                 upper <= its right side - half width - clearance
(3) Where the ego is outside the lane, the room is widened to hold a quintic from its state back into it.
(4) A bound that steering cannot reach from the start any more is loosened to what it can (`steering`); who is then not
    cleared is a stop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.frame import Frame
from logs.kernel import TIE, BoolArray, FloatArray, kernel
from logs.road import line_project_many
from logs.shapes import corners
from logs.trace import Decision, DecisionKind
from logs.vehicle import VehicleParameters
from planners.frenet.path import MIN_REGULAR
from planners.frenet.quintic import quintic
from planners.frenet.reference_path import ReferencePath

STANDING_MPS = 0.5
NUDGES = (DecisionKind.NUDGE_LEFT, DecisionKind.NUDGE_RIGHT)
TOLERANCE_M = 0.05
"""What a solution may lack of a clearance."""
BULGE = 0.03
"""Of a point ahead: half the curvature, 1/m, by which the way of the rear axle is not its own."""


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
        facing_margin_s: The facing lane may be borrowed where nobody comes for so long after the ego has left it, s.
    """

    clearance_m: float = 0.6
    min_clearance_m: float = 0.25
    edge_m: float = 0.25
    gap_m: float = 1.0
    neighbour_behind_m: float = 40.0
    neighbour_ahead_m: float = 60.0
    facing_margin_s: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_clearance_m <= self.clearance_m:
            raise ValueError("min_clearance_m must lie between 0 and clearance_m")


@dataclass(frozen=True, eq=False, slots=True)
class PathObstacle:
    """Somebody whom the path may have to pass: a box in the S-L plane, not grown, m.

    Attributes:
        agent: Name.
        s_from: Station at which the box begins; `s_to` at which it ends.
        l_from: Offset of its right side; `l_to` of its left side.
        aside: How much of the box on either side is room for him, not he.
    """

    agent: str
    s_from: float
    s_to: float
    l_from: float
    l_to: float
    aside: float = 0.0


@dataclass(frozen=True, eq=False, slots=True)
class PathBounds:
    """The corridor at stations `(n,)` or, for several points of the ego, `(points, n)`: bounds of their offsets, m."""

    s: FloatArray
    lower: FloatArray
    upper: FloatArray


def path_obstacles(
    course: ReferencePath,
    frame: Frame,
    s_ego: float,
    length: float,
    vehicle: VehicleParameters,
    *,
    facing: bool = False,
) -> tuple[PathObstacle, ...]:
    """The standing agents beside or ahead of the ego, up to `length` m, that stand on the road or near its edge.

    With `facing` the facing lane counts as road.
    """
    columns = [5, 2] if facing else [4, 1]
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
        left, right = course.at(np.array([s]))[columns, 0]
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
    course: ReferencePath,
    s: FloatArray,
    borrow: FloatArray,
    *,
    left_free: bool,
    right_free: bool,
    vehicle: VehicleParameters,
    config: CorridorConfig,
) -> PathBounds:
    """The corridor (1) at stations of any shape.

    A free neighbouring lane belongs to it where `borrow` is 1, and the facing lane too where it is 2.
    """
    table = course.at(s.ravel())
    side = 0.5 * vehicle.width + config.edge_m
    lower, upper = _room(table, borrow.ravel(), left_free, right_free, side)
    return PathBounds(s, lower.reshape(s.shape), upper.reshape(s.shape))


@kernel
def _room(table: FloatArray, borrow: FloatArray, left_free: bool, right_free: bool, side: float) -> FloatArray:
    """Rows lower, upper `(2, k)` of (1) from columns of `ReferencePath.table` `(8, k)`."""
    out = np.empty((2, table.shape[1]))
    for j in range(table.shape[1]):
        further = int(borrow[j])
        low = table[further if right_free else 0, j] + side
        high = table[3 + (further if left_free else 0), j] - side
        middle, kappa = 0.5 * (low + high), table[7, j]
        center = (1.0 - MIN_REGULAR) / max(abs(kappa), 1e-6)
        if kappa < 0.0:
            low = max(low, -center)
        elif kappa > 0.0:
            high = min(high, center)
        if low > high - 0.1:
            low, high = middle - 0.05, middle + 0.05
        out[0, j], out[1, j] = low, high
    return out


def borrowed(
    obstacles: tuple[PathObstacle, ...], s: FloatArray, speed: float, vehicle: VehicleParameters,
    facing: frozenset[str] = frozenset(),
) -> FloatArray:  # fmt: skip
    """1 at the stations, of any shape, from which a lane may be borrowed to pass an obstacle, else 0.

    2 where the obstacle is one of those that may be passed by the `facing` lane.
    """
    out = np.zeros(s.shape)
    for box in obstacles:
        begin, end = swing_span(box, speed, vehicle)
        out[(s > begin) & (s < end)] = np.maximum(out[(s > begin) & (s < end)], 2.0 if box.agent in facing else 1.0)
    return out


def swing_span(box: PathObstacle, speed: float, vehicle: VehicleParameters) -> tuple[float, float]:
    """The stations, m, between which the ego leaves its lane to pass an obstacle and is back in it."""
    swing = max(15.0, 2.5 * speed)
    return box.s_from - vehicle.axle_to_front - swing, box.s_to + vehicle.rear_overhang + swing


def free_sides(course: ReferencePath, frame: Frame, s_ego: float, config: CorridorConfig) -> tuple[bool, bool]:
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
    obstacles: tuple[PathObstacle, ...], dp_offsets: FloatArray, costs: FloatArray, space: PathBounds,
    vehicle: VehicleParameters, config: CorridorConfig,
) -> tuple[Decision, ...]:  # fmt: skip
    """Nudge left or right as the DP path passes, if there is room.

    Args:
        obstacles: Of whom to decide.
        dp_offsets: Of the DP path at each obstacle's middle `(b,)`, m.
        costs: Of passing on the left and on the right `(b, 2)`, for the reason.
        space: Of the ego's points.
        vehicle: The ego.
        config: Distances.
    """
    decisions = []
    for box, offset, cost in zip(obstacles, dp_offsets, costs, strict=True):
        over = beside(space, box, vehicle, config)
        if not over.any():
            decisions.append(Decision(box.agent, DecisionKind.IGNORE, "path", "beyond the path"))
            continue
        lower, upper = float(space.lower[over].max()), float(space.upper[over].min())
        side = 0.5 * vehicle.width
        left_gap, right_gap = upper - box.l_to - side, box.l_from - side - lower
        if lower > box.l_to + side + config.clearance_m or upper < box.l_from - side - config.clearance_m:
            decisions.append(Decision(box.agent, DecisionKind.IGNORE, "path", "is beside the corridor"))
        elif max(left_gap, right_gap) < config.min_clearance_m:
            reason = f"no room: {max(left_gap, 0.0):.2f} m left, {max(right_gap, 0.0):.2f} m right"
            decisions.append(Decision(box.agent, DecisionKind.STOP, "path", reason))
        else:
            goes_left = offset > 0.5 * (box.l_from + box.l_to)
            if (left_gap if goes_left else right_gap) < config.min_clearance_m:
                goes_left = not goes_left
            kind = DecisionKind.NUDGE_LEFT if goes_left else DecisionKind.NUDGE_RIGHT
            gap = min(left_gap if goes_left else right_gap, config.clearance_m)
            reason = (
                f"is in the corridor: pass with {gap + box.aside:.2f} m; left costs {cost[0]:.3g}, right {cost[1]:.3g}"
            )
            decisions.append(Decision(box.agent, kind, "path", reason))
    return tuple(decisions)


def narrowed(
    space: PathBounds,
    obstacles: tuple[PathObstacle, ...],
    decisions: tuple[Decision, ...],
    vehicle: VehicleParameters,
    config: CorridorConfig,
) -> tuple[PathBounds, tuple[Decision, ...]]:
    """The corridor (2); an obstacle that would close it becomes a stop."""
    lower, upper = space.lower.copy(), space.upper.copy()
    final = []
    for box, decision in zip(obstacles, decisions, strict=True):
        if decision.kind not in NUDGES:
            final.append(decision)
            continue
        over = beside(space, box, vehicle, config)
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
    return PathBounds(space.s, lower, upper), tuple(final)


def given_up(
    offsets: FloatArray,
    space: PathBounds,
    obstacles: tuple[PathObstacle, ...],
    decisions: tuple[Decision, ...],
    vehicle: VehicleParameters,
    config: CorridorConfig,
) -> tuple[Decision, ...]:
    """The decisions, with a stop for whomever a path does not clear: `offsets` are its points' at `space.s`."""
    final = []
    for box, decision in zip(obstacles, decisions, strict=True):
        over = beside(space, box, vehicle, config)
        if decision.kind in NUDGES and over.any():
            left = decision.kind is DecisionKind.NUDGE_LEFT
            gap = float((offsets[over] - box.l_to if left else box.l_from - offsets[over]).min()) - 0.5 * vehicle.width
            if gap < config.min_clearance_m - TOLERANCE_M:
                reason = f"steering cannot keep clear of it: {gap:.2f} m"
                decision = Decision(box.agent, DecisionKind.STOP, "path", reason)
        final.append(decision)
    return tuple(final)


def widened(space: PathBounds, start: tuple[float, float, float], speed: float) -> PathBounds:
    """The room (3): where the ego starts outside of it, it holds a quintic from its state back inside."""
    s, lower, upper = space.s, space.lower, space.upper
    l0, dl0, ddl0 = start
    ahead = l0 + dl0 * min(5.0, 0.5 * speed)
    if lower[0, 0] <= l0 <= upper[0, 0] and lower[0, 0] <= ahead <= upper[0, 0]:
        return space
    span = max(12.0, 2.5 * speed)
    d = np.minimum(s - s[0, 0], span)
    target = float(np.clip(l0, *(np.interp(s[0, 0] + span, s[0], edge[0]) for edge in (lower, upper))))
    c3, c4, c5 = quintic(l0, dl0, ddl0, target, span)
    back = l0 + d * (dl0 + d * (0.5 * ddl0 + d * (c3 + d * (c4 + d * c5))))
    near = s - s[0, 0] <= span
    slack = 0.05 + BULGE * (s - s[0]) ** 2
    return PathBounds(
        s,
        np.where(near, np.minimum(lower, back - slack), lower),
        np.where(near, np.maximum(upper, back + slack), upper),
    )


def eased(space: PathBounds, swings: FloatArray) -> PathBounds:
    """The room widened to both sides where the ego's points `(points, n)` swing out by more than it holds."""
    short = (space.lower + swings).max(axis=0) - (space.upper + swings).min(axis=0) + 0.1
    more = 0.5 * np.maximum(short, 0.0)
    return PathBounds(space.s, space.lower - more, space.upper + more)


def reported(space: PathBounds, lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
    """One corridor at the knots that holds those of all points, loosened ones included."""
    s = space.s[0]
    low, high = lower[0].copy(), upper[0].copy()
    for k in range(1, len(space.s)):
        low = np.minimum(low, np.interp(s, space.s[k], lower[k], left=np.inf))
        high = np.maximum(high, np.interp(s, space.s[k], upper[k], left=-np.inf))
    return low, high


def beside(space: PathBounds, box: PathObstacle, vehicle: VehicleParameters, config: CorridorConfig) -> BoolArray:
    """The stations `(points, n)` bool at which a point of the ego is beside an obstacle, or nearly.

    So far before and behind it that half the distance between two points of the ego, the rear overhang and a knot fit.
    """
    between = max(0.5 * vehicle.axle_to_front / max(len(space.s) - 1, 1), vehicle.rear_overhang)
    gap = between + max(config.gap_m, float(space.s[0, 1] - space.s[0, 0]))
    return np.asarray((space.s >= box.s_from - gap - TIE) & (space.s <= box.s_to + gap + TIE))
