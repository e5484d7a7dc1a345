"""The scene: one frame in one lane, worked out once, which every stage reads.

For an agent whose centre has its foot at station s on the reference line, with the line's heading yaw_r there,

(1) v_s = vx cos yaw_r + vy sin yaw_r,  v_l = vy cos yaw_r - vx sin yaw_r             along and across the line
(2) turn = yaw - yaw_r, a principal value
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, pi, sin
from typing import NamedTuple

import numpy as np

from logs.agents import AgentKind, among
from logs.frame import Frame
from logs.kernel import BoolArray, FloatArray, interpolated, kernel
from logs.road import line_frame, line_project
from logs.states import EgoState, wrap
from logs.vehicle import VehicleParameters
from planners.frenet.path import frenet_start, out_of_frame
from planners.frenet.reference_path import ReferencePath

WINDOW_SHARE = 1.5
"""An agent's foot is looked for before and behind the ego's as far as this times their distance ..."""
WINDOW_M = (80.0, 370.0)
"""... and the first, m, more, not farther than the second, m: that keeps off other branches of a road that winds."""
FOOT_M = 30.0
"""The ego's foot is looked for so far from where it is expected, m."""
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
VULNERABLE = among(*(kind for kind in AgentKind if kind.is_vulnerable))
"""By their codes."""


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
        limit: The lane's speed limit at the start, m/s.
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
    limit: float
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

    def name(self, agent: int) -> str:
        """An agent as they are named to the user ("car 12")."""
        return f"{self.frame.agents.kinds[agent].value} {self.frame.agents.ids[agent]}"


def scene_of(
    frame: Frame, start: EgoState, reference: ReferencePath, vehicle: VehicleParameters, near: float | None = None
) -> Scene:
    """The scene of a frame for a plan from `start`, whose foot is looked for near a station (None: anywhere)."""
    line, agents = reference.line, frame.agents
    search = (0.5 * line.length, line.length) if near is None else (near, FOOT_M)
    s, l, limit, rows = placed(  # noqa: E741
        line.s, line.coef, reference.limit, agents.x, agents.y, agents.yaw, agents.vx, agents.vy, start.x, start.y,
        *search,
    )  # fmt: skip
    s_agents, l_agents, v_s, v_l, turn, speed = rows
    trouble = out_of_frame(line, start, s, l)
    frenet = (0.0, 0.0, 0.0) if trouble else frenet_start(line, start, s, l)
    return Scene(
        frame, start, reference, vehicle, s, l, trouble, frenet, limit,
        AgentsAlong(s_agents, l_agents, v_s, v_l, turn), speed, speed < STANDING_MPS, VULNERABLE[agents.codes],
    )  # fmt: skip


@kernel
def placed(
    knots: FloatArray, coef: FloatArray, limits: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray,
    vx: FloatArray, vy: FloatArray, x_ego: float, y_ego: float, near: float, within: float,
) -> tuple[float, float, float, FloatArray]:  # fmt: skip
    """Station and offset of the ego, the speed limit there, and rows `AgentsAlong`, speed `(6, n)` of the agents.

    The ego's foot is looked for up to `within` m from the station `near`.
    """
    s_ego, l_ego = line_project(knots, coef, x_ego, y_ego, near, within)
    out = np.empty((6, len(x)))
    for i in range(len(x)):
        window = min(WINDOW_M[0] + WINDOW_SHARE * hypot(x[i] - x_ego, y[i] - y_ego), WINDOW_M[1])
        s, l = line_project(knots, coef, x[i], y[i], s_ego, window)  # noqa: E741
        along = line_frame(knots, coef, s)[2]
        out[0, i], out[1, i] = s, l
        out[2, i] = vx[i] * cos(along) + vy[i] * sin(along)  # (1)
        out[3, i] = vy[i] * cos(along) - vx[i] * sin(along)
        out[4, i] = wrap(yaw[i] - along)  # (2)
        out[5, i] = hypot(vx[i], vy[i])
    return s_ego, l_ego, interpolated(s_ego, knots, limits), out


def behind(scene: Scene, *, keeps_track: bool) -> BoolArray:
    """Which agents `(n,)` follow behind the ego, so that it is they who must see it.

    Where the ego keeps its track these are all behind it in its direction; where it changes, those in its track.
    """
    agents, along = scene.frame.agents, scene.agents
    heading = np.where(scene.standing, agents.yaw, np.arctan2(agents.vy, agents.vx))
    return follow(
        along.s, along.l, heading, agents.length, agents.width, scene.rear, scene.l, scene.frame.ego.yaw,
        scene.vehicle.width, keeps_track,
    )  # fmt: skip


@kernel
def follow(
    s: FloatArray, l: FloatArray, yaw: FloatArray, length: FloatArray, width: FloatArray,  # noqa: E741
    rear: float, l_ego: float, yaw_ego: float, width_ego: float, keeps_track: bool,
) -> BoolArray:  # fmt: skip
    """`behind` of agents at these stations and offsets, with these headings of their motion, lengths, widths `(n,)`."""
    out = np.zeros(len(s), np.bool_)
    for i in range(len(s)):
        in_track = keeps_track or abs(l[i] - l_ego) < 0.5 * (width[i] + width_ego) + TRACK_ROOM_M
        turn = abs((yaw[i] - yaw_ego + pi) % (2.0 * pi) - pi)
        out[i] = s[i] + 0.5 * length[i] < rear + OVERLAP_M and in_track and turn < 0.5 * pi
    return out
