"""The form of features: sizes, columns, and the arrays of one frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from replan.core.arrays import frozen
from replan.core.settings import Config, Positive
from replan.logs.agents import AgentKind
from replan.logs.past import PAST_STEPS
from replan.logs.rules import Colour

VERSION = 1
"""Version of the form: it changes with the meaning of an array."""
STEPS = PAST_STEPS + 1
"""Steps of a history: the past of a frame, oldest first, and the frame."""

EGO_COLUMNS = (
    "x",
    "y",
    "cos_yaw",
    "sin_yaw",
    "vx",
    "vy",
    "accel",
    "lateral_accel",
    "steer",
    "yaw_rate",
)
SIZE_COLUMNS = ("length", "width", "wheelbase", "axle_to_center")
AGENT_COLUMNS = ("x", "y", "cos_yaw", "sin_yaw", "vx", "vy")
OBJECT_COLUMNS = ("x", "y", "cos_yaw", "sin_yaw", "length", "width")
LANE_COLUMNS = ("x", "y", "dx", "dy", "left_x", "left_y", "right_x", "right_y")
ROUTE_COLUMNS = (
    "x",
    "y",
    "cos_yaw",
    "sin_yaw",
    "kappa",
    "limit",
    "left",
    "right",
    "red",
    "yellow",
    "must_stop",
    "crosswalk",
    "yields",
)
AGENT_KINDS = tuple(kind for kind in AgentKind if kind is not AgentKind.OBJECT)
"""The kinds of `Features.agents_kind`, by code; all else is an object."""
LIGHT_CODES: Mapping[Colour, int] = {
    Colour.OFF: 0,
    Colour.GREEN: 1,
    Colour.YELLOW: 2,
    Colour.RED_YELLOW: 3,
    Colour.RED: 3,
}
"""The codes of `Features.lanes_light`; 0: off, unknown, or without a light."""


Count = Annotated[int, Meta(ge=1)]
Points = Annotated[int, Meta(ge=2)]


@dataclass(frozen=True)
class FeatureSizes(Config):
    """How much of a scene features have; what is nearest is kept.

    Raises:
        ConfigError: A size is out of its range.
    """

    agents: Count = 32
    """Number N of agents."""
    objects: Count = 16
    """Number K of static objects."""
    lanes: Count = 70
    """Number M of pieces of lanes."""
    lane_points: Points = 20
    """Points P of a piece."""
    piece_m: Positive = 40.0
    """Greatest length of a piece, m: a longer lane is cut into equal pieces."""
    crosswalks: Count = 8
    """Number C of crosswalks."""
    crosswalk_points: Count = 8
    """Points Q of the outline of a crosswalk."""
    route_points: Points = 80
    """Points R of the line of the route."""
    route_step_m: Positive = 2.0
    """Distance between two of them, m."""
    radius_m: Positive = 120.0
    """What is farther from the rear axle of the ego is left out, m."""


@dataclass(frozen=True, eq=False, slots=True)
class Features:
    """A frame for a network: arrays, float32 where nothing else is said, read-only.

    Positions and directions are in the frame of the ego now: origin at the rear axle, x forward, y
    left; m, rad, m/s. Velocities are of the ground, seen in this frame. Agents, objects, pieces of
    lanes and crosswalks are sorted by their distance from the origin. Rows beyond the last one are
    0 (codes: -1), and their mask is False. Histories have `STEPS` = 22 steps of 0.1 s, oldest
    first, the last one now; nothing later than the frame is used.

    Attributes:
        ego: `(22, 10)`, `EGO_COLUMNS`: pose of the rear axle, its velocity, acceleration along the
            body and across it (v^2 kappa), m/s2, front wheel angle, rad, yaw rate, rad/s.
        ego_known: `(22,)` bool: the step was driven or recorded; False: it is extrapolated.
        ego_size: `(4,)`, `SIZE_COLUMNS`, m.
        agents: `(N, 22, 6)`, `AGENT_COLUMNS`: centre, heading and velocity of agents that are there
            now; a step at which an agent was not seen is extrapolated.
        agents_seen: `(N, 22)` bool.
        agents_size: `(N, 2)` length and width, m.
        agents_kind: `(N,)` int64: place in `AGENT_KINDS` (car 0, truck 1, bus 2, motorcycle 3,
            bicycle 4, pedestrian 5).
        agents_mask: `(N,)` bool.
        agents_row: `(N,)` int64: place of the agent in `Frame.agents`.
        objects: `(K, 6)`, `OBJECT_COLUMNS`: static objects (`AgentKind.OBJECT`).
        objects_class: `(K,)` int64: place in `ObjectClass` (cone 0, barrier 1, sign 2); -1: the log
            does not say it.
        objects_mask: `(K,)` bool.
        lanes: `(M, P, 8)`, `LANE_COLUMNS`: points of the middle of a drivable lane in driving
            direction, unit vector along it, and the vectors from the middle to both boundaries.
        lanes_mask: `(M,)` bool.
        lanes_id: `(M,)` int64: the lane of the piece.
        lanes_route: `(M,)` int64: place of the lane in the route; -1: not on it.
        lanes_limit: `(M,)` speed limit, m/s.
        lanes_limit_stated: `(M,)` bool: the log states the limit; False: it is assumed.
        lanes_light: `(M,)` int64: colour of the light that controls the lane, by `LIGHT_CODES`.
        lanes_junction: `(M,)` bool: the lane is in a junction.
        crosswalks: `(C, Q, 2)` points along the outline.
        crosswalks_mask: `(C,)` bool.
        route: `(R, 13)`, `ROUTE_COLUMNS`: the route as one line from beside the ego on, a point
            every `route_step_m`: pose, curvature, 1/m, speed limit, m/s, and the distance to the
            lane's left and right boundary, m; stop lines with a red light, a yellow one, or a
            stop sign, whose weight of 1 is shared by the two points beside the line as in linear
            interpolation; 1 on a crosswalk, and on a lane that gives way to another. Where the
            route changes lanes, the line is that of the lane after the change.
        route_mask: `(R,)` bool.
    """

    ego: NDArray[np.float32]
    ego_known: NDArray[np.bool_]
    ego_size: NDArray[np.float32]
    agents: NDArray[np.float32]
    agents_seen: NDArray[np.bool_]
    agents_size: NDArray[np.float32]
    agents_kind: NDArray[np.int64]
    agents_mask: NDArray[np.bool_]
    agents_row: NDArray[np.int64]
    objects: NDArray[np.float32]
    objects_class: NDArray[np.int64]
    objects_mask: NDArray[np.bool_]
    lanes: NDArray[np.float32]
    lanes_mask: NDArray[np.bool_]
    lanes_id: NDArray[np.int64]
    lanes_route: NDArray[np.int64]
    lanes_limit: NDArray[np.float32]
    lanes_limit_stated: NDArray[np.bool_]
    lanes_light: NDArray[np.int64]
    lanes_junction: NDArray[np.bool_]
    crosswalks: NDArray[np.float32]
    crosswalks_mask: NDArray[np.bool_]
    route: NDArray[np.float32]
    route_mask: NDArray[np.bool_]

    def __post_init__(self) -> None:
        for name, array in self.arrays().items():
            kind = np.float32 if array.dtype.kind == "f" else array.dtype
            object.__setattr__(self, name, frozen(array, kind))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays by name, in the order of the attributes."""
        return {array.name: getattr(self, array.name) for array in fields(self)}


def padded(rows: NDArray[Any], count: int, fill: float = 0.0) -> NDArray[Any]:
    """Return the first `count` rows `(n, ...)`, and rows of `fill` where there are fewer."""
    whole: NDArray[Any] = np.full((count, *rows.shape[1:]), fill, rows.dtype)
    whole[: len(rows)] = rows[:count]
    return whole


def mask(rows: int, count: int) -> NDArray[np.bool_]:
    """Return which of `count` rows are used where there are `rows`."""
    return np.arange(count) < rows
