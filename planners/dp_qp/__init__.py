"""The paper's planner: route -> candidate lanes -> (path DP, path QP) -> (speed DP, speed QP) -> choice -> trajectory.

    path      which side of each obstacle, the smoothest path            stage, bounds, dp, qp, steering, oncoming_lane
    speed     who goes first, the smoothest speed, how hard to brake     stage, dp, qp, braking
    scene     what asks to drive slower, one file each; who is passed    producers, caps; moving_obstacles, goal_window
    lane      both stages in one lane and what that costs; passing;      plan, passing, choice, memory
              keep the lane or change, and who would be endangered

Cost to go, reference path, start, S-T boundaries and fallback are those of `planners.frenet`. docs/planner.md has the
picture.

Source: Zhang, "DP and QP Based Decision-making and Planning for Autonomous Vehicle", section II-F.
"""

from planners.dp_qp.planner import DpQp, DpQpConfig

__all__ = ["DpQp", "DpQpConfig"]
