"""Stops that the rules demand and that are not known to end: the ego comes to rest where it should wait."""

from __future__ import annotations

from math import inf

from logs.kernel import TIE
from planners.dp_qp.scene.caps import PathView, SpeedCap
from planners.frenet.occupancy import open_end


def caps(view: PathView) -> tuple[SpeedCap, ...]:
    """Standstill from the first open stop on; the rules themselves tell why."""
    begin = open_end(view.stops) if view.stops else inf
    return (SpeedCap(begin - TIE, inf, 0.0, is_bound=False),) if begin < inf else ()
