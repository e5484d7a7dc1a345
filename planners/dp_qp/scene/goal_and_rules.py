"""The speed that the goal and the rules ask for: (1) and (2) of `goal_window`, and the first open stop, as caps."""

from __future__ import annotations

from math import inf

from logs.kernel import TIE
from planners.dp_qp.scene.caps import PathView, SpeedCap
from planners.frenet.occupancy import open_end


def caps(view: PathView) -> tuple[SpeedCap, ...]:
    """No sooner than the goal's time, not faster in its region than it says, not beyond an open stop."""
    target, found = view.target, []
    if target.cap < inf:
        found.append(SpeedCap(-inf, view.arc(target.until), target.cap, is_bound=False))
    if target.stop < inf:
        found.append(SpeedCap(view.arc(target.stop), inf, 0.0, is_bound=False))
    slow = view.goal.slow_zone
    if slow is not None:
        begin, end, v = slow
        found.append(SpeedCap(view.arc(begin), view.arc(end), v, is_bound=False))
    begin = open_end(view.stops) if view.stops else inf
    if begin < inf:
        found.append(SpeedCap(begin - TIE, inf, 0.0, is_bound=False))
    return tuple(found)
