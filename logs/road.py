"""Roads: lanes and their graph, and the goal on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from itertools import chain
from types import MappingProxyType

import numpy as np

from replan.core.arrays import TIE, FloatArray, Points, frozen
from replan.logs.polylines import bounds, inside, thinned
from replan.logs.rules import Crosswalk, StopLine
from replan.logs.shapes import corners

NO_LINE = frozen(np.empty((0, 2)))
IN_JUNCTION = "intersection"
"""The word of `Lane.kind` for a lane in an intersection."""


class RoadSource(Enum):
    """Where the road came from."""

    LANES = "lanes of the log"
    DRIVEN_PATH = "the log has no lanes: one lane along the driven path"


@dataclass(frozen=True, eq=False)
class Lane:
    """One lane: a strip between two boundaries; traffic drives from the first point to the last.

    Attributes:
        id: Unique in its road.
        left: Left boundary `(n, 2)`, world, m.
        right: Right boundary `(n, 2)`; point i faces point i of `left`.
        successors: Lanes that begin at its end.
        left_neighbour: Lane beside it in the same direction, or None; `right_neighbour` likewise.
        left_opposite: Whether traffic in the strip to the left drives in the opposite direction;
            `right_opposite` likewise (for traffic that drives on the left).
        speed_limit: m/s; NaN where the log has none.
        drivable: Whether a car may drive there (a sidewalk is a lane that is not drivable).
        left_crossable: Whether the left marking may be crossed; `right_crossable` likewise.
        kind: The log's words for the lane type ("urban", "crosswalk", ...), joined by +; with
            `IN_JUNCTION` the lane is in an intersection.
        yields_to: Lanes whose traffic has the right of way over this one (by sign or by side).
        group: The map's group of lanes beside each other (nuPlan: roadblock); None: it has none
            (`replan.logs.lane_groups`).
        line: The centre line that the map has `(k, 2)`, world, m; empty: it has none.
    """

    id: int
    left: Points
    right: Points
    successors: tuple[int, ...] = ()
    left_neighbour: int | None = None
    right_neighbour: int | None = None
    left_opposite: bool = False
    speed_limit: float = float("nan")
    drivable: bool = True
    left_crossable: bool = True
    right_crossable: bool = True
    kind: str = "lane"
    right_opposite: bool = False
    yields_to: tuple[int, ...] = ()
    group: int | None = None
    line: Points = field(default_factory=lambda: NO_LINE)

    def __post_init__(self) -> None:
        for name in ("left", "right", "line"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        if self.left.shape != self.right.shape or self.left.ndim != 2 or len(self.left) < 2:
            raise ValueError(
                f"lane {self.id}: boundaries have shapes {self.left.shape} and {self.right.shape}"
            )
        if not (np.isfinite(self.left).all() and np.isfinite(self.right).all()):
            raise ValueError(f"lane {self.id}: a boundary point is not finite")

    @cached_property
    def center(self) -> FloatArray:
        """Centre line `(n, 2)`: mean of the boundaries."""
        return frozen(0.5 * (self.left + self.right))

    @cached_property
    def polygon(self) -> FloatArray:
        """Outline `(2n, 2)`: the left boundary forwards, then the right boundary backwards."""
        return frozen(np.vstack([self.left, self.right[::-1]]))

    @cached_property
    def box(self) -> tuple[float, float, float, float]:
        """Bounds of the outline: least x, y, greatest x, y, m."""
        return bounds(self.polygon)

    @property
    def sideways(self) -> tuple[int, ...]:
        """The neighbours, left then right, to which the marking may be crossed."""
        sides = (
            (self.left_neighbour, self.left_crossable),
            (self.right_neighbour, self.right_crossable),
        )
        return tuple(lane for lane, crossable in sides if lane is not None and crossable)

    @cached_property
    def length(self) -> float:
        """Length of the centre line, m."""
        return float(np.hypot(*np.diff(self.center, axis=0).T).sum())


def predecessors(lanes: Mapping[int, Lane]) -> dict[int, list[int]]:
    """Return the ids of the lanes that lead into each lane."""
    leading: dict[int, list[int]] = {}
    for lane in lanes.values():
        for after in lane.successors:
            leading.setdefault(after, []).append(lane.id)
    return leading


@dataclass(frozen=True, eq=False)
class Road:
    """Lanes by id, stop lines, crosswalks, and speed limits.

    Attributes:
        lanes: Lane by id. Lanes and stop lines may name lanes (successors, neighbours, right of
            way, `towards`) that are not in it: those lie outside the log's map.
        source: Source of the lanes.
        drives_on_right: Whether traffic drives on the right, and so passes on the left.
        default_speed_limit: Speed limit of lanes that have none, m/s.
        stop_lines: Lines at which lights and signs make a car stop.
        crosswalks: Areas in which pedestrians have the right of way.
        areas: Other ground on which a car may drive, polygons `(k, 2)`; like `car_parks` only for
            the scores of `replan.metrics.nuplan_closed_loop` and `replan.score`, and for planners.
        car_parks: Car parks, polygons `(k, 2)`.
        intersections: Areas of intersections that the map has, polygons `(k, 2)`; planners only.
        route: Lanes of the route that the log names, in its order; empty: it names none.
        assumed_limits: Lanes whose speed limit is assumed, because the log states none.
        assumed_priority: Lanes that yield by assumption, because neither a sign nor a light gives
            the priority.

    Raises:
        ValueError: A stop line lies across a lane that is not in the road, or two stop lines or two
            crosswalks have the same id.
    """

    lanes: Mapping[int, Lane]
    source: RoadSource = RoadSource.LANES
    drives_on_right: bool = True
    default_speed_limit: float = 13.89
    stop_lines: tuple[StopLine, ...] = ()
    crosswalks: tuple[Crosswalk, ...] = ()
    areas: tuple[Points, ...] = ()
    car_parks: tuple[Points, ...] = ()
    intersections: tuple[Points, ...] = ()
    route: tuple[int, ...] = ()
    assumed_limits: frozenset[int] = frozenset()
    assumed_priority: frozenset[int] = frozenset()

    def __post_init__(self) -> None:
        object.__setattr__(self, "lanes", MappingProxyType(dict(self.lanes)))
        for name in ("areas", "car_parks", "intersections"):
            areas = tuple(frozen(area) for area in getattr(self, name))
            object.__setattr__(self, name, areas)
        for line in self.stop_lines:
            if line.lane not in self.lanes:
                raise ValueError(
                    f"stop line {line.id} lies across lane {line.lane}, which is not in the road"
                )
        for name, marks in (("stop lines", self.stop_lines), ("crosswalks", self.crosswalks)):
            if len({mark.id for mark in marks}) < len(marks):
                raise ValueError(f"two {name} have the same id")

    @property
    def open_ground(self) -> tuple[Points, ...]:
        """The ground beside the lanes on which a car may drive: car parks, then other areas."""
        return (*self.car_parks, *self.areas)

    @cached_property
    def _boxes(self) -> tuple[tuple[Lane, ...], FloatArray]:
        """The lanes, and their boxes as columns `(4, n)`."""
        lanes = tuple(self.lanes.values())
        return lanes, frozen(np.array([lane.box for lane in lanes]).reshape(-1, 4).T)

    def lanes_near(self, low: FloatArray, high: FloatArray) -> tuple[Lane, ...]:
        """Return the lanes whose bounding boxes meet the rectangle between two corners `(2,)`, in
        the order of `lanes`.
        """
        lanes, (x_lo, y_lo, x_hi, y_hi) = self._boxes
        meets = (x_lo <= high[0]) & (low[0] <= x_hi) & (y_lo <= high[1]) & (low[1] <= y_hi)
        return tuple(lanes[i] for i in np.flatnonzero(meets))

    def lanes_at(self, x: float, y: float) -> tuple[Lane, ...]:
        """Return the lanes that contain a point, in the order of `lanes`."""
        point = np.array([x, y])
        return tuple(lane for lane in self.lanes_near(point, point) if inside(x, y, lane.polygon))

    def is_drivable(self, x: float, y: float) -> bool:
        """Whether a point lies on a lane that a car may drive on."""
        return any(lane.drivable for lane in self.lanes_at(x, y))

    def limit(self, lane_id: int) -> float:
        """Return the speed limit of a lane, m/s: its own, else the road's default."""
        own = self.lanes[lane_id].speed_limit
        return own if np.isfinite(own) else self.default_speed_limit

    def stated_limit(self, lane_id: int) -> float:
        """Return the speed limit that the log states for a lane, m/s; NaN if it states none."""
        stated = self.source is RoadSource.LANES and lane_id not in self.assumed_limits
        return self.lanes[lane_id].speed_limit if stated else float("nan")

    @classmethod
    def along(
        cls, path: FloatArray, *, width: float = 3.5, speed_limit: float, beyond: float = 250.0
    ) -> Road:
        """A road of one lane along a driven path `(n, 2)`, straight for `beyond` m after its end.

        Raises:
            ValueError: The path is shorter than 1 m, so that it has no direction.
        """
        points = thinned(path, 1.0)
        if len(points) < 2:
            raise ValueError("the driven path is shorter than 1 m")
        heading = (points[-1] - points[-2]) / np.hypot(*(points[-1] - points[-2]))
        points = np.vstack([points, points[-1] + np.arange(2.0, beyond, 2.0)[:, None] * heading])
        tangent = np.gradient(points, axis=0)
        # The path reverses here: use the direction of the incoming piece
        turning = np.hypot(*tangent.T) < 1e-6
        tangent[1:][turning[1:]] = np.diff(points, axis=0)[turning[1:]]
        normal = np.column_stack([-tangent[:, 1], tangent[:, 0]]) / np.hypot(*tangent.T)[:, None]
        lane = Lane(
            0, points + 0.5 * width * normal, points - 0.5 * width * normal, speed_limit=speed_limit
        )
        return cls({0: lane}, RoadSource.DRIVEN_PATH, default_speed_limit=speed_limit)


GOAL_LENGTH_M, GOAL_WIDTH_M = 5.0, 4.0
"""The region around a goal that is a pose, along and across."""


@dataclass(frozen=True, eq=False)
class Goal:
    """Where, when and how the ego should arrive; None: no condition.

    Attributes:
        regions: Polygons `(k, 2)`; the ego's box centre must be in one of them. Empty: any place.
        t: Time interval, s since the scenario's start.
        v: Speed interval, m/s.
        yaw: Heading interval, rad; from `yaw[0]` counter-clockwise to `yaw[1]`.
        alternatives: Goals with bounds of their own; the ego has to reach one of them. The other
            fields are then derived from them: all their regions, and intervals from the least to
            the greatest bound.
        way: Gain along the route that a drive needs before the goal counts, m
            (`replan.metrics.arrival`); 0: none.
    """

    regions: tuple[Points, ...] = ()
    t: tuple[float, float] | None = None
    v: tuple[float, float] | None = None
    yaw: tuple[float, float] | None = None
    alternatives: tuple[Goal, ...] = ()
    way: float = 0.0

    def __post_init__(self) -> None:
        if self.alternatives:
            regions = [goal.regions for goal in self.alternatives]
            object.__setattr__(self, "regions", tuple(chain(*regions)) if all(regions) else ())
            for name in ("t", "v", "yaw"):
                intervals = [getattr(goal, name) for goal in self.alternatives]
                hull = None
                if None not in intervals:
                    lows, highs = zip(*intervals, strict=True)
                    hull = min(lows), max(highs)
                object.__setattr__(self, name, hull)
        object.__setattr__(self, "regions", tuple(frozen(region) for region in self.regions))

    @classmethod
    def around(cls, x: float, y: float, yaw: float) -> Goal:
        """Return the goal with a region of `GOAL_LENGTH_M` by `GOAL_WIDTH_M` around a pose of the
        ego's box.
        """
        return cls((np.asarray(corners(x, y, yaw, GOAL_LENGTH_M, GOAL_WIDTH_M)),))

    @classmethod
    def any_of(cls, goals: Sequence[Goal]) -> Goal:
        """Return a goal that is reached if one of the goals is.

        Goals with equal intervals are merged into one.
        """
        merged: dict[object, Goal] = {}
        for goal in chain(*(goal.alternatives or (goal,) for goal in goals)):
            intervals = goal.t, goal.v, goal.yaw
            before = merged.get(intervals, goal)
            if before is not goal:
                anywhere = not (before.regions and goal.regions)
                regions = () if anywhere else (*before.regions, *goal.regions)
                goal = replace(goal, regions=regions)
            merged[intervals] = goal
        alternatives = tuple(merged.values())
        return alternatives[0] if len(alternatives) == 1 else cls(alternatives=alternatives)

    def changed(self, change: Callable[[Goal], Goal]) -> Goal:
        """Return the goal with `change` applied to each alternative, or to itself if it has
        none.
        """
        if not self.alternatives:
            return change(self)
        return replace(self, alternatives=tuple(map(change, self.alternatives)))

    def after(self, driven: float) -> Goal:
        """Return the goal for a drive that begins after `driven` m of the way."""
        return replace(self, way=max(self.way - driven, 0.0)) if self.way > 0.0 else self

    def holds_place(self, x: float, y: float) -> bool:
        """Return whether the point lies in one of the regions; True if there is no region."""
        return not self.regions or any(inside(x, y, region) for region in self.regions)

    def nearest_place(self, x: float, y: float) -> tuple[float, float]:
        """Return the vector from the point to the nearest one of the regions, m; (0, 0) within
        them.
        """
        if self.holds_place(x, y):
            return 0.0, 0.0
        a = np.vstack(self.regions) - (x, y)
        sides = np.vstack([np.roll(region, -1, axis=0) - region for region in self.regions])
        share = -(a * sides).sum(axis=1) / np.maximum((sides**2).sum(axis=1), TIE)
        feet = a + np.clip(share, 0.0, 1.0)[:, None] * sides
        dx, dy = feet[int(np.argmin(np.hypot(*feet.T)))].tolist()
        return dx, dy

    def reached(self, t: float, x: float, y: float, yaw: float, v: float) -> bool:
        """Whether a state (box centre) satisfies the goal, or one of its alternatives.

        Its `way` is not tested.
        """
        return not self.unmet(t, x, y, yaw, v)

    def unmet(self, t: float, x: float, y: float, yaw: float, v: float) -> tuple[str, ...]:
        """Return which of "time", "speed", "heading", "place" a state misses.

        Of alternatives, the fewest.
        """
        if self.alternatives:
            return min((goal.unmet(t, x, y, yaw, v) for goal in self.alternatives), key=len)
        arc = np.inf if self.yaw is None else self.yaw[1] - self.yaw[0]
        turned = 0.0 if self.yaw is None else (yaw - self.yaw[0] + 1e-9) % (2.0 * np.pi)
        met = {
            "time": self.t is None or self.t[0] - 1e-9 <= t <= self.t[1] + 1e-9,
            "speed": self.v is None or self.v[0] <= v <= self.v[1],
            # 2 pi and more is any heading
            "heading": arc >= 2.0 * np.pi - 1e-9 or turned <= arc % (2.0 * np.pi) + 2.0 * 1e-9,
            "place": self.holds_place(x, y),
        }
        return tuple(name for name, holds in met.items() if not holds)
