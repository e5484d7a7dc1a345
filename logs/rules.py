"""Traffic rules of the map and the lights: where a car must stop, and why.

The road holds the static rules (stop lines, crosswalks, which lanes give way to which). The
scenario holds the traffic lights, whose colours change. A frame shows the current colours, and no
later ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from replan.core.arrays import FloatArray, Points, frozen


class Colour(Enum):
    """What a traffic light shows."""

    RED = "red"
    RED_YELLOW = "red and yellow"
    YELLOW = "yellow"
    GREEN = "green"
    OFF = "off"


RED = (Colour.RED, Colour.RED_YELLOW)
"""The colours that forbid crossing a stop line."""


@dataclass(frozen=True, eq=False)
class TrafficLight:
    """A traffic light over time.

    Attributes:
        id: Unique in its scenario.
        t: `(n,)` s since the scenario's start, increasing: from `t[i]` on the light shows
            `colours[i]`; before `t[0]` it is unknown.
        colours: `n` colours.
    """

    id: int
    t: FloatArray
    colours: tuple[Colour, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", frozen(self.t))
        if (
            self.t.shape != (len(self.colours),)
            or not len(self.t)
            or (np.diff(self.t) <= 0.0).any()
        ):
            raise ValueError(
                f"traffic light {self.id}: {len(self.colours)} colours need as many increasing "
                "times"
            )
        if not np.isfinite(self.t).all():
            raise ValueError(f"traffic light {self.id}: a time is not finite")

    def at(self, t: float) -> Colour:
        """Return the colour shown at `t`; OFF before the first time."""
        i = int(np.searchsorted(self.t, t + 1e-9, side="right")) - 1
        return self.colours[i] if i >= 0 else Colour.OFF


@dataclass(frozen=True, eq=False)
class StopLine:
    """A line across a lane; a car stops before it if a light or a sign demands it.

    Attributes:
        id: Unique in its road.
        lane: The lane that it lies across.
        points: Its ends `(2, 2)`, world, m.
        light: The light that it obeys; None: a sign.
        must_stop: Whether the sign is a stop sign; without light and stop sign, cars wait at the
            line only to give way.
        towards: Lanes after `lane` to which the line applies; empty: all.
    """

    id: int
    lane: int
    points: Points
    light: int | None = None
    must_stop: bool = False
    towards: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen(self.points))
        if self.points.shape != (2, 2) or not np.isfinite(self.points).all():
            raise ValueError(f"stop line {self.id}: it needs two finite ends")


@dataclass(frozen=True, eq=False)
class Crosswalk:
    """An area in which pedestrians have the right of way.

    Attributes:
        id: Unique in its road.
        polygon: Outline `(k, 2)`, world, m.
    """

    id: int
    polygon: Points

    def __post_init__(self) -> None:
        object.__setattr__(self, "polygon", frozen(self.polygon))
        if self.polygon.ndim != 2 or self.polygon.shape[1] != 2 or len(self.polygon) < 3:
            raise ValueError(f"crosswalk {self.id}: an outline needs three points")
        if not np.isfinite(self.polygon).all():
            raise ValueError(f"crosswalk {self.id}: a point is not finite")
