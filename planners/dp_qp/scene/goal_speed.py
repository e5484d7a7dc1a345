"""The speed that the goal asks for: (1) and (2) of `goal_window` as caps."""

from __future__ import annotations

from math import inf

from planners.dp_qp.scene.caps import PathView, SpeedCap


def caps(view: PathView) -> tuple[SpeedCap, ...]:
    """No sooner than the goal's time, and not faster in its region than it says."""
    target, found = view.target, []
    if target.cap < inf:
        found.append(SpeedCap(-inf, view.arc(target.until), target.cap, is_bound=False))
    if target.stop < inf:
        found.append(SpeedCap(view.arc(target.stop), inf, 0.0, is_bound=False))
    slow = view.goal.slow_zone
    if slow is not None:
        begin, end, v = slow
        found.append(SpeedCap(view.arc(begin), view.arc(end), v, is_bound=False))
    return tuple(found)
