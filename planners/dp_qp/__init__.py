"""The paper's planner: route -> reference line -> (path DP, path QP) -> (speed DP, speed QP) -> trajectory.

    route            lanes from the ego to the goal                        route.py
    course           the smoothed reference line and the width along it    reference_line.py
    path stage       which side of whom, the smoothest path                path_stage.py: corridor, path_dp, path_qp
    speed stage      who goes first, the smoothest speed                   speed_stage.py: st_graph, speed_dp, ...
    fallback         what is driven when a stage fails                     fallback.py

Source: Zhang, "DP and QP Based Decision-making and Planning for Autonomous Vehicle", section II-F.
"""

from planners.dp_qp.planner import DpQp, DpQpConfig

__all__ = ["DpQp", "DpQpConfig"]
