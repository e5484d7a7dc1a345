"""The paper's planner: route -> candidate lanes -> (path DP, path QP) -> (speed DP, speed QP) ->
choice -> trajectory.

    path      which side of each obstacle, the smoothest path; passing   stage, bounds, corridor,
              dp, qp, passing
    speed     the order of passing, the smoothest speed, the braking     stage, caps, problem, dp,
              qp, doubt
    lane      both stages in one lane, and their cost
    planner   keep the lane, pass within it, or change; the agents that this would endanger
    goal_window    arrival at the goal: time, speed and place

The speed DP gets obstacles from `frenet.st_boundaries` (when they take the path), `frenet.scene`
(stops), `speed.doubt` (how far a prediction binds) and `speed.caps` (limits of speed);
`speed.problem` joins these.

Cost to go, reference path, start, S-T boundaries and fallback are those of
`replan.planners.frenet`. docs/planner.md has the picture.

Source: Zhang, "DP and QP Based Decision-making and Planning for Autonomous Vehicle", section II-F.
"""

from replan.planners.dp_qp.lane import DpQpConfig
from replan.planners.dp_qp.planner import DpQp

__all__ = ["DpQp", "DpQpConfig"]
