"""The scene: one frame in one lane, worked out once, which every stage reads.

For an agent whose centre has its foot at station s on the reference line, with the line's heading yaw_r there,

(1) v_s = vx cos yaw_r + vy sin yaw_r,  v_l = vy cos yaw_r - vx sin yaw_r             along and across the line
(2) turn = yaw - yaw_r, a principal value
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, sin
from typing import NamedTuple

import numpy as np

from logs.frame import Frame
from logs.kernel import BoolArray, FloatArray, kernel
from logs.road import line_frame, line_project
from logs.states import EgoState, wrap
from logs.vehicle import VehicleParameters
from planners.frenet.path import frenet_start, out_of_frame
from planners.frenet.reference_path import ReferencePath

WINDOW_SHARE = 1.5
"""An agent's foot is looked for before and behind the ego's as far as this times their distance ..."""
WINDOW_M = (80.0, 370.0)
"""... and the first, m, more, not farther than the second, m: that keeps off other branches of a road that winds."""
STANDING_MPS = 0.5
"""Who is slower stands, m/s: the path passes them or stops, the speed does not follow them."""
UNLIKELY = 0.2
"""A predicted hypothesis that is not more probable than this is unlikely."""
TRACK_M = 1.0
"""The ego keeps its track where its offset changes by less than this, m."""
TRACK_ROOM_M = 0.3
"""Who is beside the ego's track by more than this is not in it, m."""
OVERLAP_M = 0.5
"""Whose front is past the ego's rear by less than this follows it, m."""


class AgentsAlong(NamedTuple):
    """The frame's agents along the reference path, `(n,)` each.

    Attributes:
        s: Station of the centre, m; `l` its offset, m.
        v_s: (1), m/s; `v_l` likewise.
        turn: (2), rad.
    """

    s: FloatArray
    l: FloatArray  # noqa: E741
    v_s: FloatArray
    v_l: FloatArray
    turn: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class Scene:
    """A frame in a lane.

    Attributes:
        frame: What is known now.
        start: Where the plan begins.
        reference: The lane's reference path.
        vehicle: The ego.
        s: Station of the start, m; `l` its offset, m.
        trouble: Why the start has no l', l'' in the Frenet frame; empty where it has.
        frenet: l, l', l'' of the start; zeros where there is `trouble`.
        agents: The agents along the reference path.
        speed: Of the agents `(n,)`, m/s.
        standing: Which of them stand `(n,)`.
        vulnerable: Which of them walk or ride `(n,)`.
    """

    frame: Frame
    start: EgoState
    reference: ReferencePath
    vehicle: VehicleParameters
    s: float
    l: float  # noqa: E741
    trouble: str
    frenet: tuple[float, float, float]
    agents: AgentsAlong
    speed: FloatArray
    standing: BoolArray
    vulnerable: BoolArray

    @property
    def front(self) -> float:
        """Station of the ego's front, m; `rear` of its rear."""
        return self.s + self.vehicle.axle_to_front

    @property
    def rear(self) -> float:
        """Station of the ego's rear, m."""
        return self.s - self.vehicle.rear_overhang

    @property
    def v(self) -> float:
        """Speed at the start, m/s, not negative."""
        return max(self.start.v, 0.0)

    @property
    def limit(self) -> float:
        """The lane's speed limit at the start, m/s."""
        return float(np.interp(self.s, self.reference.line.s, self.reference.limit))

    def name(self, agent: int) -> str:
        """An agent as they are named to the user ("car 12")."""
        return f"{self.frame.agents.kinds[agent].value} {self.frame.agents.ids[agent]}"


def scene_of(
    frame: Frame, start: EgoState, reference: ReferencePath, vehicle: VehicleParameters, near: float | None = None
) -> Scene:
    """The scene of a frame for a plan from `start`, whose foot is looked for near a station (None: anywhere)."""
    line, agents = reference.line, frame.agents
    speed = agents.speed
    s, l = line.project(start.x, start.y, near)  # noqa: E741
    trouble = out_of_frame(line, start, s, l)
    along = agents_along(line.s, line.coef, agents.x, agents.y, agents.yaw, agents.vx, agents.vy, start.x, start.y, s)
    frenet = (0.0, 0.0, 0.0) if trouble else frenet_start(line, start, s, l)
    return Scene(
        frame, start, reference, vehicle, s, l, trouble, frenet,
        AgentsAlong(*along), speed, speed < STANDING_MPS, np.array([kind.is_vulnerable for kind in agents.kinds], bool),
    )  # fmt: skip


@kernel
def agents_along(
    knots: FloatArray, coef: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray, vx: FloatArray, vy: FloatArray,
    x_ego: float, y_ego: float, s_ego: float,
) -> FloatArray:  # fmt: skip
    """The columns of `AgentsAlong` `(5, n)`."""
    out = np.empty((5, len(x)))
    for i in range(len(x)):
        window = min(WINDOW_M[0] + WINDOW_SHARE * hypot(x[i] - x_ego, y[i] - y_ego), WINDOW_M[1])
        s, l = line_project(knots, coef, x[i], y[i], s_ego, window)  # noqa: E741
        along = line_frame(knots, coef, s)[2]
        out[0, i], out[1, i] = s, l
        out[2, i] = vx[i] * cos(along) + vy[i] * sin(along)  # (1)
        out[3, i] = vy[i] * cos(along) - vx[i] * sin(along)
        out[4, i] = wrap(yaw[i] - along)  # (2)
    return out


def behind(scene: Scene, *, keeps_track: bool) -> BoolArray:
    """Which agents `(n,)` follow behind the ego, so that it is they who must see it.

    Where the ego keeps its track these are all behind it in its direction; where it changes, those in its track.
    """
    agents, along = scene.frame.agents, scene.agents
    turn = np.abs(np.remainder(agents.yaw - scene.frame.ego.yaw + np.pi, 2.0 * np.pi) - np.pi)
    in_track = keeps_track | (np.abs(along.l - scene.l) < 0.5 * (agents.width + scene.vehicle.width) + TRACK_ROOM_M)
    passed = along.s + 0.5 * agents.length < scene.rear + OVERLAP_M
    return np.asarray(passed & in_track & (turn < 0.5 * np.pi))
