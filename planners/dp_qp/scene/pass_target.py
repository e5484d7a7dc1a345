"""Who goes along the lane slower than the ego: where the path passes them."""

from __future__ import annotations

from dataclasses import dataclass

from logs.kernel import FloatArray
from planners.frenet.occupancy import Occupancy


@dataclass(frozen=True, eq=False, slots=True)
class PassTarget:
    """A road user to be passed.

    Attributes:
        agent: Index into the frame's agents.
        box: The stations and offsets at which they are while the ego is beside them.
        begin: Station of the ego's rear axle at which it comes beside them, m; `end` at which it is past them.
        places: Where they are predicted meanwhile `(n, 2)`, m.
    """

    agent: int
    box: Occupancy
    begin: float
    end: float
    places: FloatArray
