"""Who came to the path and stands beside it: he may set off again at any moment, and the ego passes him accordingly.

Somebody on foot or on two wheels wavers who took the path at most `WAVERS_S` ago as predicted, does not take it now,
and stands. With d from the ego's side to him, the front passes him first or the ego stops before him wherever it is if

(1) v <= 2 b (d / w - T)                                                                         (`sight`, (3))

when the front is beside him; before that, the limit is lowered so that this is reached comfortably, as far as it can.

Memory: when who took the path last; none of it where the frame is fresh.
"""

from __future__ import annotations

import numpy as np

from logs.frame import Frame
from logs.kernel import FloatArray
from logs.trace import Decision, DecisionKind
from logs.vehicle import VehicleParameters
from planners.dp_qp.scene.occlusion import LEAST_MPS, LOOK_M, REACTION_S, STEP_M, WALK_MPS
from planners.frenet.path import Path
from planners.frenet.st_boundaries import StBoundaries

WAVERS_S = 5.0
STANDS_MPS = 0.3


class HesitantPedestrians:
    """Remembers who came to the path (module docstring)."""

    def __init__(self) -> None:
        self._took: dict[str, float] = {}

    def limit(
        self, path: Path, limit: FloatArray, frame: Frame, vehicle: VehicleParameters, blocks: StBoundaries,
        decel: float, *, fresh: bool,
    ) -> tuple[FloatArray, tuple[Decision, ...]]:  # fmt: skip
        """The speed limit `(m,)` along a path with (1) in it, and for whom; b is `decel`, m/s2."""
        if fresh:
            self._took = {}
        agents, out, told = frame.agents, limit, []
        taking = set(blocks.agent.tolist())
        self._took.update((agents.ids[i], frame.t) for i in taking if agents.kinds[i].is_vulnerable)
        self._took = {name: t for name, t in self._took.items() if frame.t - t <= WAVERS_S}
        for i, name in enumerate(agents.ids):
            if name not in self._took or i in taking or agents.speed[i] >= STANDS_MPS:
                continue
            away = np.hypot(path.x - agents.x[i], path.y - agents.y[i])
            nearest = int(np.argmin(away))
            ahead = float(path.sigma[nearest]) - vehicle.axle_to_front
            if not 0.0 < ahead < LOOK_M:
                continue
            d = float(away[nearest]) - 0.5 * (vehicle.width + max(agents.length[i], agents.width[i]))
            v = max(2.0 * decel * (d / WALK_MPS - REACTION_S), LEAST_MPS)
            at = (path.sigma > ahead - STEP_M) & (path.sigma <= ahead)
            out = np.where(at, np.minimum(out, v), out)
            if v < float(limit[nearest]):
                where = f"stands {d:.1f} m beside it, {ahead:.0f} m ahead"
                reason = f"came to the path and {where}: could be avoided at {v:.1f} m/s"
                told.append(Decision(name, DecisionKind.YIELD, "speed", reason))
        return out, tuple(told)
