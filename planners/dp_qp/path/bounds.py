"""Path bounds: the agents in the way, the sides on which they are passed, and the corridor that
remains.

The path passes only agents that stand, or move slowly along the lane (`passing`); the S-T graph has
the other moving agents. (The path DP, coarser than `corridor`, moves the rear axle past boxes grown
by the ego's length.)

(1) nudge left of an obstacle:  lower >= its left side + half width + clearance
        over its stations
    nudge right:                upper <= its right side - half width - clearance

A bound that steering cannot keep from the start is loosened to what steering can keep (`corridor`);
where the path then does not clear an agent, the ego stops before it (`check_clearance`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.errors import ConfigError
from replan.core.kernel import kernel
from replan.core.settings import Config, NotNegative
from replan.logs.plan import Decision, DecisionKind
from replan.logs.reference_line import line_project
from replan.logs.shapes import corners
from replan.logs.vehicle import VehicleParameters
from replan.planners.dp_qp.path.corridor import Borrowed, lane_edges, narrowed_beside, room_beside
from replan.planners.frenet.reference_path import ReferencePath
from replan.planners.frenet.scene import Bodies, Occupancy, Scene

SIDES = {DecisionKind.NUDGE_LEFT: 1.0, DecisionKind.NUDGE_RIGHT: -1.0}
"""The decisions to pass, and the side in the form that kernels take."""
TOLERANCE_M = 0.05  # Shortfall of a clearance that a solution may have, m
# Standing agents farther from the ego than this plus the path's length are ignored, m
NEAR_PATH_M = 30.0
NEAR_ROAD_M = 1.0  # An agent that stands off the road by less than this is still an obstacle, m
NOTHING = Borrowed(np.empty((0, 3)), left=True, right=True)  # No road beside the lane is used


@dataclass(frozen=True)
class CorridorConfig(Config):
    """Distances that the path keeps."""

    clearance_m: NotNegative = 0.6
    """Distance to an obstacle that the path passes."""
    min_clearance_m: NotNegative = 0.25
    """Least such distance, where there is no more space; with less the ego stops."""
    edge_m: NotNegative = 0.25
    """Distance to the lane's edge."""
    gap_m: NotNegative = 1.0
    """Distance ahead of and behind an obstacle, added to its length."""
    neighbour_behind_m: NotNegative = 40.0
    """A neighbouring lane may be borrowed if no agent moves on it up to this far behind the ego."""
    neighbour_ahead_m: NotNegative = 60.0
    """A neighbouring lane may be borrowed if no agent moves on it up to this far ahead of the ego.
    """
    facing_margin_s: NotNegative = 1.0
    """The facing lane may be borrowed if no agent comes within this time after the ego has left it.
    """
    patience_s: NotNegative = 5.0
    """The facing lane may be used to pass a vehicle that has stood for this long."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.min_clearance_m <= self.clearance_m:
            raise ConfigError(
                f"min_clearance_m ({self.min_clearance_m}) must not exceed clearance_m "
                f"({self.clearance_m})"
            )


@dataclass(frozen=True, eq=False, slots=True)
class InTheWay:
    """The agents in the way, and the road beside the lane that may be used to pass them."""

    obstacles: tuple[Occupancy, ...] = ()  # The agents in the order of their stations
    left: bool = True  # Whether the lane to the left is free; `right` likewise
    right: bool = True
    # Agents that the ego may pass on the lane of the opposite direction
    facing: frozenset[str] = frozenset()
    # Station at which to wait until that lane is free, m; inf if there is no need
    wait: float = np.inf

    def and_moving(self, moving: InTheWay) -> InTheWay:
        """Add moving agents to pass; the lanes beside must be free for all."""
        if not moving.obstacles:
            return self
        obstacles = tuple(
            sorted((*self.obstacles, *moving.obstacles), key=lambda box: (box.s_from, box.agent))
        )
        left, right = self.left and moving.left, self.right and moving.right
        return replace(
            self, obstacles=obstacles, left=left, right=right, facing=self.facing | moving.facing
        )


@dataclass(frozen=True, eq=False, slots=True)
class PathBounds:
    """Bounds of the offsets of the ego's points at stations `(points, n)`, m."""

    s: FloatArray
    lower: FloatArray
    upper: FloatArray

    def room(
        self, obstacles: Sequence[Occupancy], vehicle: VehicleParameters, config: CorridorConfig
    ) -> list[list[float]]:
        """Greatest lower and least upper bound where a point of the ego is beside each obstacle,
        else -inf, inf.
        """
        return room_beside(
            self.s, self.lower, self.upper, _boxes(obstacles), self.gap(vehicle, config)
        ).tolist()

    def gap(self, vehicle: VehicleParameters, config: CorridorConfig) -> float:
        """Distance before and behind an obstacle at which the ego still counts as beside it, m.

        Half the distance between two points of the ego, or the rear overhang, plus `gap_m` or the
        knots' spacing.
        """
        between = max(0.5 * vehicle.axle_to_front / max(len(self.s) - 1, 1), vehicle.rear_overhang)
        return between + max(config.gap_m, float(self.s[0, 1] - self.s[0, 0]))


def standing_obstacles(
    scene: Scene, length: float, *, facing: bool = False
) -> tuple[Occupancy, ...]:
    """The standing agents beside or ahead of the ego, up to `length` m, that stand on the road or
    near its edge.

    With `facing`, the facing lane is part of the road.
    """
    if not scene.standing.any():
        return ()
    ids, line = scene.frame.agents.ids, scene.reference.line
    ego, road = scene.frame.ego, scene.road
    left, right = (
        (road.facing_left, road.facing_right) if facing else (road.road_left, road.road_right)
    )
    circle = ego.x, ego.y, length + NEAR_PATH_M
    rows, boxes = _standing_boxes(
        line.s, line.coef, scene.bodies, scene.standing, scene.agents.s, left, right, circle
    )
    begin, end = scene.rear, scene.front + length
    boxes_ahead = [
        Occupancy(ids[i], *box)
        for i, box in zip(rows.tolist(), boxes.tolist(), strict=True)
        if box[1] > begin and box[0] < end
    ]
    return tuple(sorted(boxes_ahead, key=lambda box: (box.s_from, box.agent)))


@kernel
def _standing_boxes(
    knots: FloatArray,
    coef: FloatArray,
    bodies: Bodies,
    standing: BoolArray,
    s: FloatArray,
    left: FloatArray,
    right: FloatArray,
    circle: tuple[float, float, float],
) -> tuple[IntArray, FloatArray]:
    """The agents that stand on the road or near its edge `(b,)`; their stations and offsets, from
    and to `(b, 4)`, m.

    The extents come from the projections of the corners and of the middles of the sides, since a
    curve bulges between corners. `s` are the stations of all agents `(n,)`, `left` and `right` the
    road's edges there, `circle` a point x, y and the radius around it in which agents are
    considered, m.
    """
    x, y, length = bodies.x, bodies.y, bodies.length
    rows, boxes = np.empty(len(x), np.int64), np.empty((len(x), 4))
    count = 0
    for i in range(len(x)):
        if not standing[i] or hypot(x[i] - circle[0], y[i] - circle[1]) >= circle[2]:
            continue
        outline = corners(x[i], y[i], bodies.yaw[i], length[i], bodies.width[i])
        guess = s[i]
        s_from, s_to = np.inf, -np.inf
        l_from, l_to = np.inf, -np.inf
        for k in range(8):
            px, py = outline[k % 4, 0], outline[k % 4, 1]
            if k >= 4:
                px, py = 0.5 * (px + outline[(k - 5) % 4, 0]), 0.5 * (py + outline[(k - 5) % 4, 1])
            guess, l = line_project(knots, coef, px, py, guess, 10.0 + length[i])
            s_from, s_to = min(s_from, guess), max(s_to, guess)
            l_from, l_to = min(l_from, l), max(l_to, l)
        if l_from < left[i] + NEAR_ROAD_M and l_to > right[i] - NEAR_ROAD_M:
            rows[count] = i
            boxes[count, 0], boxes[count, 1] = s_from, s_to
            boxes[count, 2], boxes[count, 3] = l_from, l_to
            count += 1
    return rows[:count].copy(), boxes[:count].copy()


def borrowed_road(in_the_way: InTheWay, speed: float, vehicle: VehicleParameters) -> Borrowed:
    """The road beside the lane that the ego uses to pass obstacles at this speed: a free
    neighbouring lane.

    It uses the facing lane, too, for obstacles that it may pass there.
    """
    if not in_the_way.obstacles:
        return NOTHING
    spans = [
        (*swing_span(box, speed, vehicle), 2.0 if box.agent in in_the_way.facing else 1.0)
        for box in in_the_way.obstacles
    ]
    return Borrowed(np.array(spans), in_the_way.left, in_the_way.right)


def lane_bounds(
    reference: ReferencePath,
    s: FloatArray,
    in_the_way: InTheWay,
    speed: float,
    vehicle: VehicleParameters,
    config: CorridorConfig,
) -> PathBounds:
    """(1) of `corridor` at stations of any shape, for an ego that passes obstacles at this
    speed.
    """
    side = 0.5 * vehicle.width + config.edge_m
    edges = lane_edges(
        reference.line.s,
        reference.table,
        s.ravel(),
        borrowed_road(in_the_way, speed, vehicle),
        side,
    )
    return PathBounds(s, *edges.reshape(2, *s.shape))


def swing_span(box: Occupancy, speed: float, vehicle: VehicleParameters) -> tuple[float, float]:
    """The stations, m, between which the ego leaves its lane to pass an obstacle and is back in
    it.
    """
    swing = max(15.0, 2.5 * speed)
    return box.s_from - vehicle.axle_to_front - swing, box.s_to + vehicle.rear_overhang + swing


def free_sides(scene: Scene, config: CorridorConfig) -> tuple[bool, bool]:
    """Whether the reachable road left and right of the own lane is free of moving agents near the
    ego.
    """
    ahead = scene.agents.s - scene.s
    is_near = (
        ~scene.standing & (ahead > -config.neighbour_behind_m) & (ahead < config.neighbour_ahead_m)
    )
    if not is_near.any():
        return True, True
    road, l, half = scene.road, scene.agents.l, 0.5 * scene.bodies.width
    on_left = is_near & (road.lane_left - half < l) & (l < road.road_left + half)
    on_right = is_near & (road.road_right - half < l) & (l < road.lane_right + half)
    return not on_left.any(), not on_right.any()


def side_gaps(
    box: Occupancy, lower: float, upper: float, vehicle: VehicleParameters
) -> tuple[float, float]:
    """The space beside an ego that passes a box between two bounds of its axis, on the left and
    right, m.
    """
    side = 0.5 * vehicle.width
    return upper - box.l_to - side, box.l_from - side - lower


@dataclass(frozen=True, slots=True)
class SideChoice:
    """The options for one obstacle, before a decision is made.

    `left` is the space beside an ego that passes it on its left, m, `right` that on its right;
    `settled` is the decision where there is no choice; None if the obstacle can be passed.
    """

    box: Occupancy
    left: float
    right: float
    settled: Decision | None

    def is_open(self, least: float) -> bool:
        """Whether it can be passed on either side with at least this much space, m."""
        return self.settled is None and min(self.left, self.right) >= least

    def decided(
        self, goes_left: bool, costs: tuple[float, float] | None, config: CorridorConfig
    ) -> Decision:
        """The decision for a side, or for the other if there is no space.

        Costs of left and right for the reason.
        """
        if self.settled is not None:
            return self.settled
        if (self.left if goes_left else self.right) < config.min_clearance_m:
            goes_left = not goes_left
        gap = min(self.left if goes_left else self.right, config.clearance_m) + self.box.aside
        only = f"there is no room on the {'right' if goes_left else 'left'}"
        why = f"left costs {costs[0]:.3g}, right {costs[1]:.3g}" if costs else only
        kind = DecisionKind.NUDGE_LEFT if goes_left else DecisionKind.NUDGE_RIGHT
        return Decision(
            self.box.agent, kind, "path", f"is in the corridor: pass with {gap:.2f} m; {why}"
        )


def side_choices(
    obstacles: tuple[Occupancy, ...],
    space: PathBounds,
    vehicle: VehicleParameters,
    config: CorridorConfig,
) -> list[SideChoice]:
    """The options for obstacles within the bounds of the ego's points."""
    if not obstacles:
        return []
    choices = []
    for box, (lower, upper) in zip(obstacles, space.room(obstacles, vehicle, config), strict=True):
        left, right = side_gaps(box, lower, upper, vehicle)
        settled, most = None, max(left, right)
        if lower == -np.inf:
            settled = Decision(box.agent, DecisionKind.IGNORE, "path", "beyond the path")
        elif most > upper - lower + config.clearance_m:
            settled = Decision(box.agent, DecisionKind.IGNORE, "path", "is beside the corridor")
        elif most < config.min_clearance_m:
            reason = f"no room: {max(left, 0.0):.2f} m left, {max(right, 0.0):.2f} m right"
            settled = Decision(box.agent, DecisionKind.STOP, "path", reason)
        choices.append(SideChoice(box, left, right, settled))
    return choices


def narrow_bounds(
    space: PathBounds,
    obstacles: tuple[Occupancy, ...],
    decisions: tuple[Decision, ...],
    vehicle: VehicleParameters,
    config: CorridorConfig,
) -> tuple[PathBounds, tuple[Decision, ...]]:
    """The bounds (1); an obstacle that would close them becomes a stop.

    Without obstacles to pass they stay.
    """
    if not any(decision.kind in SIDES for decision in decisions):
        return space, decisions
    (lower, upper), room, closed = narrowed_beside(
        space.s,
        space.lower,
        space.upper,
        _boxes(obstacles, decisions),
        space.gap(vehicle, config),
        0.5 * vehicle.width,
        config.clearance_m,
        config.min_clearance_m,
    )
    final = list(decisions)
    for b in np.flatnonzero(closed):
        reason = f"no room beside the other obstacles: {max(room[b], 0.0):.2f} m"
        final[b] = Decision(obstacles[b].agent, DecisionKind.STOP, "path", reason)
    return PathBounds(space.s, lower, upper), tuple(final)


def check_clearance(
    path: PathBounds,
    obstacles: tuple[Occupancy, ...],
    decisions: tuple[Decision, ...],
    vehicle: VehicleParameters,
    config: CorridorConfig,
) -> tuple[dict[str, float], tuple[Decision, ...]]:
    """The space between a path and each agent that it passes, m; `path` has the offsets of its
    points as both bounds.

    Also the decisions, with a stop for each agent that it does not clear.
    """
    if not any(decision.kind in SIDES for decision in decisions):
        return {}, decisions
    rooms, final = dict[str, float](), []
    for box, planned, (most, least) in zip(
        obstacles, decisions, path.room(obstacles, vehicle, config), strict=True
    ):
        decision = planned
        if planned.kind in SIDES:
            beside = (
                least - box.l_to if planned.kind is DecisionKind.NUDGE_LEFT else box.l_from - most
            )
            room = rooms[box.agent] = beside - 0.5 * vehicle.width
            if room < config.min_clearance_m - TOLERANCE_M:
                reason = f"steering cannot keep clear of it: {room:.2f} m"
                decision = Decision(planned.agent, DecisionKind.STOP, "path", reason)
        final.append(decision)
    return rooms, tuple(final)


def _boxes(obstacles: Sequence[Occupancy], decisions: Sequence[Decision] = ()) -> FloatArray:
    """Obstacles in the form that kernels take (`corridor.narrowed_beside`).

    Without decisions the side is 0.
    """
    sides = [SIDES.get(decision.kind, 0.0) for decision in decisions] or [0.0] * len(obstacles)
    pairs = zip(obstacles, sides, strict=True)
    return np.array([(box.s_from, box.s_to, box.l_from, box.l_to, side) for box, side in pairs])
