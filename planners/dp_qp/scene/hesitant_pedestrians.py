"""Who came to the path and stands beside it: they may set off again at any moment, and are passed accordingly.

A pedestrian or rider hesitates who took the path at most `hesitates_s` ago as predicted, does not take it
now, and stands. With d from the ego's side to them, the front passes them first or the ego stops before them wherever
it is if

(1) v <= 2 b (d / w - T)                                                                     (`occlusion`, (3))

when the front is beside them; before that, the limit is lowered so that this is reached comfortably, as far as it can.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planners.dp_qp.scene.caps import PathView, SpeedCap
from planners.dp_qp.scene.occlusion import LOOK_M, STEP_M, avoidable_speed
from planners.frenet.scene import Scene
from planners.frenet.st_boundaries import StBoundaries
from planners.rules.windows import TOWARDS_MPS


def came_to_path(
    scene: Scene, taken: StBoundaries, came: Mapping[str, float], hesitates_s: float
) -> Mapping[str, float]:
    """Who took the path last when, s, for the frames to come; `came` is that of the frames before."""
    if not (came or len(taken)):
        return came
    t, agents = scene.frame.t, scene.frame.agents
    now = {agents.ids[i]: t for i in taken.agent if scene.vulnerable[i]}
    return {name: since for name, since in {**came, **now}.items() if t - since <= hesitates_s}


def caps(view: PathView) -> tuple[SpeedCap, ...]:
    """(1) beside each who hesitates."""
    if not view.came:
        return ()
    scene, path, agents, found = view.scene, view.path, view.scene.frame.agents, []
    taking = set(view.taken.agent.tolist())
    for i, name in enumerate(agents.ids):
        if name not in view.came or i in taking or scene.speed[i] >= TOWARDS_MPS:
            continue
        away = np.hypot(path.x - agents.x[i], path.y - agents.y[i])
        nearest = int(np.argmin(away))
        ahead = float(path.sigma[nearest]) - scene.vehicle.axle_to_front
        if not 0.0 < ahead < LOOK_M:
            continue
        d = float(away[nearest]) - 0.5 * (scene.vehicle.width + max(agents.length[i], agents.width[i]))
        v = avoidable_speed(d, view.caution.walk_mps, view.hard_mps2)  # (1)
        where = f"stands {d:.1f} m beside it, {ahead:.0f} m ahead"
        reason = f"came to the path and {where}: could be avoided at {v:.1f} m/s"
        found.append(SpeedCap(ahead - STEP_M, ahead, v, name, reason))
    return tuple(found)
