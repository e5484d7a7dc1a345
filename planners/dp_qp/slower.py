"""Who goes slowly along the lane on foot or on two wheels: where on the path the ego would pass him.

He is no obstacle at a place, but he is one while the ego passes him. With the gap g between the ego's front and his
rear, his speed u along the lane, the ego's v and lengths L,

(1) the ego is beside him from t_1 = max(g, 0) / (v - u) to t_2 = (g + L_ego + L) / (v - u)
(2) he is then somewhere from his rear at t_1 to his front at t_2: a box of the S-L plane, `ASIDE_M` wider on both sides

v is the speed that the ego has or `CLOSING_MPS` more than his, and what this frame's speed stage makes of the path is
the next frame's v: path and speed find each other from frame to frame. Whether nobody is met is asked of the real boxes
in the S-T graph; where the path cannot pass him he is followed there.
"""

from __future__ import annotations

import numpy as np

from logs.frame import Frame
from logs.shapes import corners
from logs.vehicle import VehicleParameters
from planners.dp_qp.corridor import STANDING_MPS, PathObstacle
from planners.dp_qp.reference_line import Course

SLOW_MPS = 7.0
"""Who is faster is followed."""
CLOSING_MPS = 2.5
ASIDE_M = 0.9
"""With the path's usual clearance 1.5 m, as German law asks in towns (StVO, 5 (4)); where there is less, 1.15 m."""
ALONG_RAD = 0.4
LONGEST_S = 8.0
"""What takes longer is not thought of."""


def slower(
    course: Course, frame: Frame, s_ego: float, speed: float, vehicle: VehicleParameters
) -> tuple[PathObstacle, ...]:
    """The boxes (2) of those who go along the lane ahead of or beside an ego with this speed, in order."""
    agents, line, found = frame.agents, course.line, []
    front, rear = s_ego + vehicle.axle_to_front, s_ego - vehicle.rear_overhang
    reach = LONGEST_S * max(speed, CLOSING_MPS) + 20.0
    near = np.hypot(agents.x - frame.ego.x, agents.y - frame.ego.y) < reach
    for i in np.flatnonzero(near & (agents.speed >= STANDING_MPS) & (agents.speed <= SLOW_MPS)):
        if not agents.kinds[i].is_vulnerable:
            continue
        s, _ = line.project(float(agents.x[i]), float(agents.y[i]), s_ego, reach)
        _, _, yaw, _ = line.frame(s)
        along = float(agents.vx[i] * np.cos(yaw) + agents.vy[i] * np.sin(yaw))
        across = float(agents.vy[i] * np.cos(yaw) - agents.vx[i] * np.sin(yaw))
        if np.arctan2(abs(across), along) > ALONG_RAD:
            continue
        outline = corners(agents.x[i], agents.y[i], agents.yaw[i], agents.length[i], agents.width[i])
        feet = np.array([line.project(float(x), float(y), s, 20.0) for x, y in outline])
        (s_from, l_from), (s_to, l_to) = feet.min(axis=0), feet.max(axis=0)
        gap, closing = s_from - front, max(speed - along, CLOSING_MPS)
        begin, end = max(gap, 0.0) / closing, (s_to - rear) / closing
        _, right, _, _, left, _, _, _ = course.at(np.array([s]))[:, 0]
        if s_to > rear and end < LONGEST_S and l_from < left and l_to > right:
            box = (s_from + along * begin, s_to + along * end, l_from - ASIDE_M, l_to + ASIDE_M)
            found.append(PathObstacle(agents.ids[i], *map(float, box)))
    return tuple(sorted(found, key=lambda box: (box.s_from, box.agent)))
