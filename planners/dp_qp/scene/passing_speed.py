"""How fast the ego passes others: who goes along the lane, whether it swings out for them or not, and who stands.

(1) v <= max(2 b (d / w - T), `LEAST_MPS`) beside them and as far before as it takes to stop       (`occlusion`, (3))

d is the room that the path leaves them, w how fast they may come into the way (`CautionConfig`): then the ego either is
past them or stops before them wherever they do.

(2) v <= v_limit max(d / `ROOM_M`, `NUDGE_SHARE`)     beside those who stand, where the path leaves less than `ROOM_M`

The share is Apollo's `static_obs_nudge_speed_ratio`.
"""

from __future__ import annotations

import numpy as np

from logs.scenario import AgentKind
from planners.dp_qp.scene.caps import PathView, SpeedCap
from planners.dp_qp.scene.moving_obstacles import NEAR_M
from planners.dp_qp.scene.occlusion import REACTION_S, avoidable_speed

ROOM_M = 0.5
"""Room beside those who stand with which the ego passes at the limit, m."""
NUDGE_SHARE = 0.6
"""Of the limit, where there is hardly any."""


def _beside_standing(view: PathView) -> list[SpeedCap]:
    """(2) beside each who stands and is passed."""
    scene, found = view.scene, []
    for name, d in view.passed.items():
        if d >= ROOM_M:
            continue
        i = scene.frame.agents.ids.index(name)
        s, half = float(scene.agents.s[i]), 0.5 * float(scene.frame.agents.length[i])
        begin, end = view.arc(s - half - scene.vehicle.axle_to_front), view.arc(s + half + scene.vehicle.rear_overhang)
        v = max(d / ROOM_M, NUDGE_SHARE) * float(np.interp(s, view.path.s, view.limit))  # (2)
        found.append(SpeedCap(begin, end, v, name, f"stands {d:.2f} m beside the path: passed at {v:.1f} m/s"))
    return found


def caps(view: PathView) -> tuple[SpeedCap, ...]:
    """(1) and (2); of the targets who comes nearer to the path than the margin is followed, in the S-T graph."""
    path, agents, caution, found = view.path, view.scene.frame.agents, view.caution, _beside_standing(view)
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
