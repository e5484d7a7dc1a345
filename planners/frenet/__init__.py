"""The common base of all planners: reference path, lanes, path and profiles in the Frenet frame, S-T boundaries.

reference_path   the smoothed reference line of a lane sequence, and the width along it
lane_sequence    the lane that is driven and its neighbours, each with its reference path
path             a path in the world from (l, l', l'') over s, there and back
profiles         speed profiles: the limit with its curves, cruising, braking
scene            one frame in one lane; where a plan begins; what takes a part of the lane: who stands, and stops
st_boundaries    when which part of a path is taken, and by which agent
fallback         what is driven when a planner finds no plan
"""
