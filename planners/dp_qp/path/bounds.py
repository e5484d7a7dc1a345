"""Path bounds: the room that the road gives, and what each obstacle that is passed leaves of it.

Only what stands still, or goes slowly along the lane (`scene.moving_obstacles`), is passed by the path; what else moves
is met in the S-T graph. The bounds hold for the ego's axis at points from the rear axle to the front bumper, each at
its own station: so its corners stay in the bounds widened by half its width. (The path DP, coarser, moves the rear axle
past boxes grown by the ego's length.) They are built in named steps:

(1) `within_lane`   lower <= l <= upper, the lane (or, beside an obstacle, the reachable road) less half the ego's
                    width, and 1 - kappa l >= MIN_REGULAR: short of the centre of a turn
(2) `road_ahead`    wider where the ego's nose needs it in a sharp turn
(3) `towards`       within the sides of the goal region, as near to them as it goes
(4) `widened`       where the ego is outside the lane: holding a quintic from its state back into it
(5) `narrowed`      nudge left of an obstacle:  lower >= its left side + half width + clearance     over its stations
                    nudge right:                upper <= its right side - half width - clearance

A bound that steering cannot reach from the start any more is loosened to what it can (`steering`); who is then not
cleared is a stop (`given_up`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot
from typing import NamedTuple

import numpy as np

from logs.kernel import TIE, BoolArray, FloatArray, IntArray, kernel
from logs.road import line_project
from logs.shapes import corners
from logs.trace import Decision, DecisionKind
from logs.vehicle import VehicleParameters
from planners.dp_qp.path.steering import AHEAD, swings_of
from planners.frenet.occupancy import Occupancy
from planners.frenet.path import MIN_REGULAR
from planners.frenet.quintic import quintic
from planners.frenet.reference_path import ReferencePath, Section, sections
from planners.frenet.scene import Scene

NUDGES = (DecisionKind.NUDGE_LEFT, DecisionKind.NUDGE_RIGHT)
"""The decisions to pass."""
TOLERANCE_M = 0.05
"""What a solution may lack of a clearance, m."""
BULGE = 0.03
"""Of a point ahead: half the curvature, 1/m, by which the way of the rear axle is not its own."""
NEARLY_M = 0.5
"""A goal farther out of the room than this is not this lane's, m."""
LEFT_M = 0.1
"""What is left of the room where the goal is outside of it, m."""
NEAR_PATH_M = 30.0
"""Who stands farther than this and the path's length from the ego is not looked at."""
NEAR_ROAD_M = 1.0
"""Who stands off the road by less than this still counts as an obstacle, m."""


@dataclass(frozen=True)
class CorridorConfig:
    """Distances that the path keeps.

    Attributes:
        clearance_m: To an obstacle that is passed.
        min_clearance_m: Where there is no more room; with less the ego stops.
        edge_m: To the lane's edge.
        gap_m: Ahead and behind an obstacle, added to its length.
        neighbour_behind_m: A neighbouring lane may be borrowed if no agent moves on it from this far behind ...
        neighbour_ahead_m: ... to this far ahead.
        facing_margin_s: The facing lane may be borrowed where no agent comes for so long after the ego has left it, s.
        patience_s: A vehicle that has stood for so long is passed by the facing lane.
    """

    clearance_m: float = 0.6
    min_clearance_m: float = 0.25
    edge_m: float = 0.25
    gap_m: float = 1.0
    neighbour_behind_m: float = 40.0
    neighbour_ahead_m: float = 60.0
    facing_margin_s: float = 1.0
    patience_s: float = 5.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_clearance_m <= self.clearance_m:
            raise ValueError("min_clearance_m must lie between 0 and clearance_m")


@dataclass(frozen=True, eq=False, slots=True)
class InTheWay:
    """Who stands in the way, and what of the road beside the lane may be used to pass them.

    Attributes:
        obstacles: In order of their stations.
        left: Whether the lane to the left is free; `right` likewise.
        facing: Agents who may be passed by the lane of the opposite direction.
        wait: Station at which to wait until that lane is free, m; inf: there is no need.
    """

    obstacles: tuple[Occupancy, ...] = ()
    left: bool = True
    right: bool = True
    facing: frozenset[str] = frozenset()
    wait: float = np.inf

    def and_moving(self, more: InTheWay) -> InTheWay:
        """With those who are passed while they go on; the lanes beside must be free for all."""
        if not more.obstacles:
            return self
        both = tuple(sorted((*self.obstacles, *more.obstacles), key=lambda box: (box.s_from, box.agent)))
        left, right = self.left and more.left, self.right and more.right
        return replace(self, obstacles=both, left=left, right=right, facing=self.facing | more.facing)


@dataclass(frozen=True, eq=False, slots=True)
class PathBounds:
    """Bounds of the offsets of the ego's points at stations `(points, n)`, m."""

    s: FloatArray
    lower: FloatArray
    upper: FloatArray

    def towards(self, low: FloatArray, high: FloatArray) -> PathBounds:
        """(3): within offsets of the shape of `s`, where they are finite and within reach."""
        there = np.isfinite(low) & (low <= self.upper + NEARLY_M) & (high >= self.lower - NEARLY_M)
        lower = np.clip(low, self.lower, np.maximum(self.upper - LEFT_M, self.lower))
        upper = np.clip(high, np.minimum(self.lower + LEFT_M, self.upper), self.upper)
        return PathBounds(self.s, np.where(there, lower, self.lower), np.where(there, upper, self.upper))

    def widened(self, start: tuple[float, float, float], speed: float) -> PathBounds:
        """(4), for a start (l, l', l'') at the first station."""
        return PathBounds(self.s, *_widened(self.s, self.lower, self.upper, start[0], start[1], start[2], speed))

    def beside(self, box: Occupancy, vehicle: VehicleParameters, config: CorridorConfig) -> BoolArray:
        """The stations `(points, n)` bool at which a point of the ego is beside an obstacle, or nearly.

        So far before and behind it that half the distance between two points of the ego, the rear overhang and a knot
        fit.
        """
        between = max(0.5 * vehicle.axle_to_front / max(len(self.s) - 1, 1), vehicle.rear_overhang)
        gap = between + max(config.gap_m, float(self.s[0, 1] - self.s[0, 0]))
        return np.asarray((self.s >= box.s_from - gap - TIE) & (self.s <= box.s_to + gap + TIE))

    def reported(self, lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
        """One corridor at the knots that holds bounds `(points, n)` of all points."""
        s = self.s[0]
        low, high = lower[0].copy(), upper[0].copy()
        for k in range(1, len(self.s)):
            low = np.minimum(low, np.interp(s, self.s[k], lower[k], left=np.inf))
            high = np.maximum(high, np.interp(s, self.s[k], upper[k], left=-np.inf))
        return low, high


def standing_obstacles(scene: Scene, length: float, *, facing: bool = False) -> tuple[Occupancy, ...]:
    """The standing agents beside or ahead of the ego, up to `length` m, that stand on the road or near its edge.

    With `facing` the facing lane counts as road.
    """
    if not scene.standing.any():
        return ()
    agents, line, ego = scene.frame.agents, scene.reference.line, scene.frame.ego
    rows, boxes = _standing_boxes(
        line.s, line.coef, agents.x, agents.y, agents.yaw, agents.length, agents.width, scene.standing, scene.agents.s,
        ego.x, ego.y, length + NEAR_PATH_M,
    )  # fmt: skip
    road = scene.reference.at(scene.agents.s[rows])
    left, right = (road.facing_left, road.facing_right) if facing else (road.road_left, road.road_right)
    found = [
        Occupancy(agents.ids[i], s_from, s_to, l_from, l_to)
        for i, (s_from, s_to, l_from, l_to), leftmost, rightmost in zip(rows, boxes.tolist(), left, right, strict=True)
        if s_to > scene.rear and s_from < scene.front + length
        and l_from < leftmost + NEAR_ROAD_M and l_to > rightmost - NEAR_ROAD_M
    ]  # fmt: skip
    return tuple(sorted(found, key=lambda box: (box.s_from, box.agent)))


@kernel
def _standing_boxes(
    knots: FloatArray, coef: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, length: FloatArray,
    width: FloatArray, standing: BoolArray, s: FloatArray, x_ego: float, y_ego: float, reach: float,
) -> tuple[IntArray, FloatArray]:  # fmt: skip
    """Who stands within `reach` m of the ego `(b,)`, and their stations and offsets, from and to `(b, 4)`, m.

    By the feet of their corners and of the middles of their sides, between which a curve bulges; `s` are their
    stations.
    """
    rows, boxes = np.empty(len(x), np.int64), np.empty((len(x), 4))
    count = 0
    for i in range(len(x)):
        if not standing[i] or hypot(x[i] - x_ego, y[i] - y_ego) >= reach:
            continue
        outline = corners(x[i], y[i], yaw[i], length[i], width[i])
        box, guess = boxes[count], s[i]
        box[0], box[1], box[2], box[3] = np.inf, -np.inf, np.inf, -np.inf
        for k in range(8):
            px, py = outline[k % 4, 0], outline[k % 4, 1]
            if k >= 4:
                px, py = 0.5 * (px + outline[(k - 5) % 4, 0]), 0.5 * (py + outline[(k - 5) % 4, 1])
            guess, l = line_project(knots, coef, px, py, guess, 10.0 + length[i])  # noqa: E741
            box[0], box[1] = min(box[0], guess), max(box[1], guess)
            box[2], box[3] = min(box[2], l), max(box[3], l)
        rows[count] = i
        count += 1
    return rows[:count].copy(), boxes[:count].copy()


def grown(box: Occupancy, vehicle: VehicleParameters, clearance: float, gap: float) -> tuple[float, ...]:
    """Stations and offsets (s from, s to, l from, l to) that the rear axle must avoid."""
    side = 0.5 * vehicle.width + clearance
    return (
        box.s_from - vehicle.axle_to_front - gap,
        box.s_to + vehicle.rear_overhang + gap,
        box.l_from - side,
        box.l_to + side,
    )


def borrowed_spans(way: InTheWay, speed: float, vehicle: VehicleParameters) -> FloatArray:
    """Where road beside the lane is used `(b, 3)`: station from, to, m; 1 the neighbouring lane, 2 the facing, too."""
    spans = [(*swing_span(box, speed, vehicle), 2.0 if box.agent in way.facing else 1.0) for box in way.obstacles]
    return np.array(spans).reshape(-1, 3)


def lane_bounds(
    reference: ReferencePath, s: FloatArray, way: InTheWay, speed: float, vehicle: VehicleParameters,
    config: CorridorConfig,
) -> PathBounds:  # fmt: skip
    """(1) at stations of any shape, for an ego that passes obstacles at this speed.

    A free neighbouring lane belongs to the room where an obstacle is passed, and the facing lane where it is one of
    those that may be passed by it.
    """
    road = sections(reference.line.s, reference.table, s.ravel())
    lower, upper = within_lane(
        road, s.ravel(), borrowed_spans(way, speed, vehicle), way.left, way.right, 0.5 * vehicle.width + config.edge_m
    )
    return PathBounds(s, lower.reshape(s.shape), upper.reshape(s.shape))


@kernel
def within_lane(
    road: Section, s: FloatArray, spans: FloatArray, left_free: bool, right_free: bool, side: float
) -> tuple[FloatArray, FloatArray]:
    """Lower and upper of (1) `(k,)` at stations `(k,)`; `spans` as of `borrowed_spans`, `side` m kept to each edge."""
    lower, upper = np.empty(len(s)), np.empty(len(s))
    for j in range(len(s)):
        borrowed = 0.0
        for b in range(len(spans)):
            if spans[b, 0] < s[j] < spans[b, 1]:
                borrowed = max(borrowed, spans[b, 2])
        low, high = road.lane_right[j], road.lane_left[j]
        if right_free and borrowed > 0.0:
            low = road.road_right[j] if borrowed < 2.0 else road.facing_right[j]
        if left_free and borrowed > 0.0:
            high = road.road_left[j] if borrowed < 2.0 else road.facing_left[j]
        low, high = low + side, high - side  # (1)
        middle, kappa = 0.5 * (low + high), road.kappa[j]
        center = (1.0 - MIN_REGULAR) / max(abs(kappa), 1e-6)
        if kappa < 0.0:
            low = max(low, -center)
        elif kappa > 0.0:
            high = min(high, center)
        if low > high - 0.1:
            low, high = middle - 0.05, middle + 0.05
        lower[j], upper[j] = low, high
    return lower, upper


class RoadAhead(NamedTuple):
    """The road at the knots of the path QP, for k points of the ego and n knots.

    Attributes:
        knots: Stations `(n,)`, m; `s` of the points `(k, n)`.
        swings: How far the points swing out `(k, n)`, m (`steering`, (4)).
        lower: Bounds (1), (2) `(k, n)`, m; `upper` likewise.
        limit: Speed limit `(n,)`, m/s; `kappa` curvature of the reference line, 1/m.
    """

    knots: FloatArray
    s: FloatArray
    swings: FloatArray
    lower: FloatArray
    upper: FloatArray
    limit: FloatArray
    kappa: FloatArray


@kernel
def road_ahead(
    line_s: FloatArray, table: FloatArray, s0: float, step: float, n: int, leads: FloatArray, spans: FloatArray,
    left_free: bool, right_free: bool, side: float,
) -> RoadAhead:  # fmt: skip
    """(1) and (2) for points that lead the rear axle by `leads` `(k,)`, m; other args as of `within_lane`."""
    count = len(leads)
    knots = s0 + step * np.arange(n)
    s, lower, upper, turned = np.empty((count, n)), np.empty((count, n)), np.empty((count, n)), np.empty((count, n))
    for k in range(count):
        s[k] = knots + leads[k]
        turned[k] = sections(line_s, table, knots + AHEAD * leads[k]).kappa
        road = sections(line_s, table, s[k])
        lower[k], upper[k] = within_lane(road, s[k], spans, left_free, right_free, side)
    swings = swings_of(turned, leads)
    for i in range(n):
        least, most = -np.inf, np.inf
        for k in range(count):
            least, most = max(least, lower[k, i] + swings[k, i]), min(most, upper[k, i] + swings[k, i])
        more = 0.5 * max(least - most + 0.1, 0.0)  # (2)
        lower[:, i] -= more
        upper[:, i] += more
    here = sections(line_s, table, knots)
    return RoadAhead(knots, s, swings, lower, upper, here.limit, here.kappa)


@kernel
def _widened(
    s: FloatArray, lower: FloatArray, upper: FloatArray, l0: float, dl0: float, ddl0: float, speed: float
) -> tuple[FloatArray, FloatArray]:
    """Lower and upper of (4) `(points, n)`."""
    ahead = l0 + dl0 * min(5.0, 0.5 * speed)
    low, high = lower.copy(), upper.copy()
    if lower[0, 0] <= l0 <= upper[0, 0] and lower[0, 0] <= ahead <= upper[0, 0]:
        return low, high
    span = max(12.0, 2.5 * speed)
    at = np.array([s[0, 0] + span])
    target = min(max(l0, np.interp(at, s[0], lower[0])[0]), np.interp(at, s[0], upper[0])[0])
    c3, c4, c5 = quintic(l0, dl0, ddl0, target, span)
    for p in range(s.shape[0]):
        for i in range(s.shape[1]):
            d = s[p, i] - s[0, 0]
            if d <= span:
                back = l0 + d * (dl0 + d * (0.5 * ddl0 + d * (c3 + d * (c4 + d * c5))))
                slack = 0.05 + BULGE * (s[p, i] - s[0, i]) ** 2
                low[p, i], high[p, i] = min(low[p, i], back - slack), max(high[p, i], back + slack)  # (4)
    return low, high


def swing_span(box: Occupancy, speed: float, vehicle: VehicleParameters) -> tuple[float, float]:
    """The stations, m, between which the ego leaves its lane to pass an obstacle and is back in it."""
    swing = max(15.0, 2.5 * speed)
    return box.s_from - vehicle.axle_to_front - swing, box.s_to + vehicle.rear_overhang + swing


def free_sides(scene: Scene, config: CorridorConfig) -> tuple[bool, bool]:
    """Whether no agent moves on the reachable road left and right of the own lane, near the ego."""
    ahead = scene.agents.s - scene.s
    near = ~scene.standing & (ahead > -config.neighbour_behind_m) & (ahead < config.neighbour_ahead_m)
    if not near.any():
        return True, True
    road, l = scene.reference.at(scene.agents.s[near]), scene.agents.l[near]  # noqa: E741
    half = 0.5 * scene.frame.agents.width[near]
    on_left = (road.lane_left - half < l) & (l < road.road_left + half)
    on_right = (road.road_right - half < l) & (l < road.lane_right + half)
    return not on_left.any(), not on_right.any()


def side_gaps(box: Occupancy, lower: float, upper: float, vehicle: VehicleParameters) -> tuple[float, float]:
    """What is left beside the ego that passes a box between two bounds of its axis, on the left and on the right, m."""
    side = 0.5 * vehicle.width
    return upper - box.l_to - side, box.l_from - side - lower


@dataclass(frozen=True, slots=True)
class SideChoice:
    """What can be done about one obstacle, before anything decides.

    Attributes:
        box: The obstacle.
        left: What is left beside the ego that passes it on its left, m; `right` on its right.
        settled: The decision where there is nothing to choose; None: the obstacle can be passed.
    """

    box: Occupancy
    left: float
    right: float
    settled: Decision | None

    def is_open(self, least: float) -> bool:
        """Whether it can be passed on either side with at least so much, m."""
        return self.settled is None and min(self.left, self.right) >= least

    def decided(self, goes_left: bool, costs: tuple[float, float] | None, config: CorridorConfig) -> Decision:
        """The decision for a side, or the other where there is no room; costs of left and right for the reason."""
        if self.settled is not None:
            return self.settled
        if (self.left if goes_left else self.right) < config.min_clearance_m:
            goes_left = not goes_left
        gap = min(self.left if goes_left else self.right, config.clearance_m) + self.box.aside
        only = f"there is no room on the {'right' if goes_left else 'left'}"
        why = f"left costs {costs[0]:.3g}, right {costs[1]:.3g}" if costs else only
        kind = DecisionKind.NUDGE_LEFT if goes_left else DecisionKind.NUDGE_RIGHT
        return Decision(self.box.agent, kind, "path", f"is in the corridor: pass with {gap:.2f} m; {why}")


def side_choice(box: Occupancy, space: PathBounds, vehicle: VehicleParameters, config: CorridorConfig) -> SideChoice:
    """What can be done about an obstacle within the bounds of the ego's points."""
    over = space.beside(box, vehicle, config)
    if not over.any():
        return SideChoice(box, 0.0, 0.0, Decision(box.agent, DecisionKind.IGNORE, "path", "beyond the path"))
    lower, upper = float(space.lower[over].max()), float(space.upper[over].min())
    left, right = side_gaps(box, lower, upper, vehicle)
    settled = None
    if max(left, right) > upper - lower + config.clearance_m:
        settled = Decision(box.agent, DecisionKind.IGNORE, "path", "is beside the corridor")
    elif max(left, right) < config.min_clearance_m:
        reason = f"no room: {max(left, 0.0):.2f} m left, {max(right, 0.0):.2f} m right"
        settled = Decision(box.agent, DecisionKind.STOP, "path", reason)
    return SideChoice(box, left, right, settled)


def narrowed(
    space: PathBounds,
    obstacles: tuple[Occupancy, ...],
    decisions: tuple[Decision, ...],
    vehicle: VehicleParameters,
    config: CorridorConfig,
) -> tuple[PathBounds, tuple[Decision, ...]]:
    """The bounds (5); an obstacle that would close them becomes a stop."""
    if not obstacles:
        return space, decisions
    lower, upper = space.lower.copy(), space.upper.copy()
    final = []
    for box, decision in zip(obstacles, decisions, strict=True):
        if decision.kind not in NUDGES:
            final.append(decision)
            continue
        over = space.beside(box, vehicle, config)
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
        lower[over], upper[over] = tried  # (5)
        final.append(decision)
    return PathBounds(space.s, lower, upper), tuple(final)


def given_up(
    offsets: FloatArray,
    space: PathBounds,
    obstacles: tuple[Occupancy, ...],
    decisions: tuple[Decision, ...],
    vehicle: VehicleParameters,
    config: CorridorConfig,
) -> tuple[Decision, ...]:
    """The decisions, with a stop for each agent that a path does not clear: `offsets` are its points' at `space.s`."""
    final = []
    for box, decision in zip(obstacles, decisions, strict=True):
        over = space.beside(box, vehicle, config)
        if decision.kind in NUDGES and over.any():
            left = decision.kind is DecisionKind.NUDGE_LEFT
            gap = float((offsets[over] - box.l_to if left else box.l_from - offsets[over]).min()) - 0.5 * vehicle.width
            if gap < config.min_clearance_m - TOLERANCE_M:
                reason = f"steering cannot keep clear of it: {gap:.2f} m"
                decision = Decision(box.agent, DecisionKind.STOP, "path", reason)
        final.append(decision)
    return tuple(final)
