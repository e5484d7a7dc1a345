"""How fast the ego passes who goes along the lane, whether it swings out for them or they are beside the lane.

(1) v <= max(2 b (d / w - T), `LEAST_MPS`) beside them and as far before as it takes to stop       (`occlusion`, (3))

d is the room that the path leaves them, w how fast they may come into the way (`CautionConfig`): then the ego either is
past them or stops before them wherever they do.
"""

from __future__ import annotations

import numpy as np

from logs.scenario import AgentKind
from planners.dp_qp.scene.caps import PathView, SpeedCap
from planners.dp_qp.scene.moving_obstacles import NEAR_M
from planners.dp_qp.scene.occlusion import REACTION_S, avoidable_speed


def caps(view: PathView) -> tuple[SpeedCap, ...]:
    """(1) beside each of the targets; who comes nearer to the path than the margin is followed, in the S-T graph."""
    if not view.targets:
        return ()
    path, agents, caution, found = view.path, view.scene.frame.agents, view.caution, []
    for one in view.targets:
        at = (path.s > one.begin - NEAR_M) & (path.s < one.end + NEAR_M)
        if not at.any():
            continue
        away = np.hypot(path.x[at, None] - one.places[:, 0], path.y[at, None] - one.places[:, 1])
        d = float(away.min()) - 0.5 * float(view.scene.vehicle.width + agents.width[one.agent])
        if d < view.margin_m:
            continue
        w = caution.ride_mps if agents.kinds[one.agent] is AgentKind.BICYCLE else caution.walk_mps
        v = avoidable_speed(d, w, view.hard_mps2)  # (1)
        stops = v * REACTION_S + v * v / (2.0 * view.hard_mps2)
        reason = f"goes along the lane: passed with {d:.1f} m and at {v:.1f} m/s, so that the ego could stop for them"
        found.append(
            SpeedCap(view.arc(one.begin - stops), view.arc(one.end + NEAR_M), v, agents.ids[one.agent], reason)
        )
    return tuple(found)
