"""Road users: what they are, and where they are at one instant."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from logs.kernel import FloatArray, frozen

_UNKNOWN = frozen(np.empty(0))


class AgentKind(Enum):
    """What a road user is."""

    CAR = "car"
    TRUCK = "truck"
    BUS = "bus"
    MOTORCYCLE = "motorcycle"
    BICYCLE = "bicycle"
    PEDESTRIAN = "pedestrian"
    OBJECT = "object"

    @property
    def is_vulnerable(self) -> bool:
        """Pedestrians and riders."""
        return self in (AgentKind.PEDESTRIAN, AgentKind.BICYCLE, AgentKind.MOTORCYCLE)


@dataclass(frozen=True, eq=False, slots=True)
class Agents:
    """Road users at one instant: `(n,)` each, world frame, box centres, m, rad, m/s.

    Attributes:
        yaw_rate: rad/s; 0 where it is not known, and of pedestrians, who turn on the spot. `accel` likewise: rate of
            the speed, m/s2. Left out: all 0.
    """

    ids: tuple[str, ...]
    kinds: tuple[AgentKind, ...]
    length: FloatArray
    width: FloatArray
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    vx: FloatArray
    vy: FloatArray
    yaw_rate: FloatArray = field(default_factory=lambda: _UNKNOWN)
    accel: FloatArray = field(default_factory=lambda: _UNKNOWN)

    def __post_init__(self) -> None:
        for name in ("yaw_rate", "accel"):
            if getattr(self, name) is _UNKNOWN:
                object.__setattr__(self, name, np.zeros(len(self.ids)))
        for name in ("length", "width", "x", "y", "yaw", "vx", "vy", "yaw_rate", "accel"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def speed(self) -> FloatArray:
        """Length of the velocity vector `(n,)`, m/s."""
        return np.hypot(self.vx, self.vy)
