"""Road users at one instant."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import Enum

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray, frozen

OLDEST_S = 10.0
"""The greatest age, s; older agents get this age."""
_UNKNOWN = frozen(np.empty(0))
_UNCODED = frozen(np.empty(0), np.int64)


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
        """Whether it is a pedestrian or a rider."""
        return self in (AgentKind.PEDESTRIAN, AgentKind.BICYCLE, AgentKind.MOTORCYCLE)


class ObjectClass(Enum):
    """What an object (`AgentKind.OBJECT`) is, where the log says it."""

    CONE = "cone"
    BARRIER = "barrier"
    SIGN = "sign"


USUAL_SIZE_M = {
    AgentKind.CAR: (4.5, 1.8),
    AgentKind.TRUCK: (8.0, 2.5),
    AgentKind.BUS: (12.0, 2.5),
    AgentKind.MOTORCYCLE: (2.2, 0.8),
    AgentKind.BICYCLE: (1.8, 0.7),
    AgentKind.PEDESTRIAN: (0.5, 0.5),
    AgentKind.OBJECT: (1.0, 1.0),
}
"""Length and width of agents whose log states none, m."""
_CODE = {kind: code for code, kind in enumerate(AgentKind)}


def codes_of(kinds: tuple[AgentKind, ...]) -> IntArray:
    """Return the codes of the kinds, `(n,)`: their positions in `AgentKind`.

    They index the result of `among`.
    """
    return frozen([_CODE[kind] for kind in kinds], np.int64)


def among(*kinds: AgentKind) -> BoolArray:
    """Return a mask over all codes that marks the kinds: `among(AgentKind.CAR)[agents.codes]` marks
    the cars.
    """
    return frozen([kind in kinds for kind in AgentKind], np.bool_)


@dataclass(frozen=True, eq=False, slots=True)
class Agents:
    """Road users at one instant: `(n,)` each, world frame, box centres, m, rad, m/s.

    Attributes:
        ids: Names of the agents.
        kinds: Kinds of the agents.
        length: Length of the box; `width` likewise.
        x: Centre of the box; `y` likewise; `yaw` is the heading of the box, counter-clockwise from
            x.
        vx: Velocity along the world's x axis; `vy` likewise.
        yaw_rate: rad/s; 0 if unknown, and for pedestrians, who turn on the spot. Default: all 0.
        accel: Rate of the speed, m/s2; 0 if unknown. Default: all 0.
        age: s since the agent was first seen, at most `OLDEST_S`; NaN where unknown: for agents
            that never move, and in the first `OLDEST_S` for agents that were present when the
            scenario began. Default: all NaN, like the next two columns.
        unseen: s since the agent's last sample, 0 at a sample; NaN for agents that never move.
        velocity_sigma: Standard deviation of vx and of vy, m/s; NaN if perception does not state
            it.
        codes: `kinds` as numbers; default: `codes_of(kinds)`.
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
    age: FloatArray = field(default_factory=lambda: _UNKNOWN)
    unseen: FloatArray = field(default_factory=lambda: _UNKNOWN)
    velocity_sigma: FloatArray = field(default_factory=lambda: _UNKNOWN)
    codes: IntArray = field(default_factory=lambda: _UNCODED)

    def __post_init__(self) -> None:
        for name in NUMBERS[NUMBERS.index("yaw_rate") :]:
            if not len(getattr(self, name)):
                unknown = np.nan if name in OPTIONAL else 0.0
                object.__setattr__(self, name, np.full(len(self.ids), unknown))
        if self.codes is _UNCODED:
            object.__setattr__(self, "codes", codes_of(self.kinds))
        for name in NUMBERS:
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @classmethod
    def of_rows(
        cls, ids: tuple[str, ...], kinds: tuple[AgentKind, ...], rows: FloatArray, codes: IntArray
    ) -> Agents:
        """Make agents whose columns `NUMBERS` are the rows `(12, n)`, which are copied once."""
        agents = object.__new__(cls)
        for name, value in zip(_COLUMNS, (ids, kinds, *frozen(rows), codes), strict=True):
            object.__setattr__(agents, name, value)
        return agents

    def __len__(self) -> int:
        return len(self.ids)

    def some(self, rows: IntArray) -> Agents:
        """The agents `rows` `(k,)`, in that order."""
        ids, kinds = tuple(self.ids[i] for i in rows), tuple(self.kinds[i] for i in rows)
        columns = np.stack([getattr(self, name)[rows] for name in NUMBERS])
        return Agents.of_rows(ids, kinds, columns, frozen(self.codes[rows], np.int64))

    @property
    def speed(self) -> FloatArray:
        """Length of the velocity vector `(n,)`, m/s."""
        return np.hypot(self.vx, self.vy)


_COLUMNS = tuple(column.name for column in fields(Agents))
NUMBERS = _COLUMNS[2:-1]
"""Names of the float columns, in order."""
OPTIONAL = ("age", "unseen", "velocity_sigma")
"""The optional columns whose default is NaN; `yaw_rate` and `accel` default to 0."""
