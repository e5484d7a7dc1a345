"""The paper's planner: route -> candidate lanes -> (path DP, path QP) -> (speed DP, speed QP) -> choice -> trajectory.

    route            cost to go of every lane to the goal                  route.py
    lanes            the lane that is driven and its neighbours            lanes.py
    reference           the smoothed reference line and the width along it    reference_line.py
    path stage       which side of whom, the smoothest path                path_stage.py: steering, corridor, facing,
                                                                           path_dp, path_qp
    speed stage      who goes first, the smoothest speed, how hard to      speed_stage.py: st_graph, walls, sight,
                     brake                                                 waverers, speed_dp, speed_qp, speed_solve
    lane plan        both stages in one lane, and what that costs          lane_plan.py: appointment
    passing          the driven lane past who is slower: both in turns     passing.py: slower
    choice           keep the lane or change, and who would be endangered  decide.py
    fallback         what is driven when a stage fails                     fallback.py

Source: Zhang, "DP and QP Based Decision-making and Planning for Autonomous Vehicle", section II-F.
"""

from planners.dp_qp.planner import DpQp, DpQpConfig

__all__ = ["DpQp", "DpQpConfig"]
