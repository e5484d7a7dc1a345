"""The common base of all planners: reference path, lanes, path and profiles in the Frenet frame,
S-T boundaries.

reference_path   the ego's lane and its neighbours; the smoothed reference line of each, and the
                 width along it
path             a path in the world from (l, l', l'') over s, and the inverse
profiles         speed profiles: the limit with its curves, cruising, braking; the plan when a
                 planner finds none
scene            one frame in one lane; the start of a plan; parts of the lane that agents or stops
                 take
st_boundaries    when agents take which part of a path
"""
