"""The paper's planner: route -> candidate lanes -> (path DP, path QP) -> (speed DP, speed QP) -> choice -> trajectory.

    path      which side of each obstacle, the smoothest path            stage, bounds, dp, qp, steering, oncoming_lane
    speed     the order of passing, the smoothest speed, the braking     stage, problem, dp, qp, doubt, braking
    scene     what asks to drive slower; the goal; who is passed         caps, goal_window, moving_obstacles
    lane      both stages in one lane and what that costs; passing;      plan, passing, choice
              keep the lane or change, and who would be endangered

What the speed DP sees of the obstacles: `frenet.st_boundaries` (when they take the path), `frenet.occupancy` (stops),
`speed.doubt` (how far a prediction binds), `scene.caps` (limits of speed), and `speed.problem`, which joins these.

Cost to go, reference path, start, S-T boundaries and fallback are those of `planners.frenet`. docs/planner.md has the
picture.

Source: Zhang, "DP and QP Based Decision-making and Planning for Autonomous Vehicle", section II-F.
"""

from planners.dp_qp.config import DpQpConfig
from planners.dp_qp.planner import DpQp

__all__ = ["DpQp", "DpQpConfig"]
