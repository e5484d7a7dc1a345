"""Records of a CommonRoad file, in its coordinates and time steps.

A light repeats its cycle for ever, its first element beginning at step `offset`
(commonroad-io, `TrafficLight.get_state_at_time_step`):

(1) it shows the element that holds the phase (step - offset) mod (sum of the durations),
        each from its begin to before its end
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

from replan.core.arrays import FloatArray
from replan.logs.rules import Colour

STOP_SIGNS = frozenset({"206", "R1-1"})
YIELD_SIGNS = frozenset({"205", "R1-2"})
PRIORITY_SIGNS = frozenset({"301", "306"})
"""Signs of Germany (and of the format's no-man's-land) and of the USA for priority."""


@dataclass(frozen=True)
class LightCycle:
    """A traffic light: its cycle of colours and durations (time steps), (1), and the turns that it
    is for.
    """

    id: int
    cycle: tuple[tuple[Colour, float], ...]  # colours with durations; empty if the file has none
    offset: float
    turns: frozenset[str]
    active: bool  # whether the light is in use; an inactive light is OFF

    def changes(self, first: float, last: float) -> list[tuple[float, Colour]]:
        """Steps and colours by (1), from `first` on: what it shows then, and each element that
        begins until `last`.
        """
        if not self.active or not self.cycle:
            return [(first, Colour.OFF)]
        ends = list(accumulate(duration for _, duration in self.cycle))
        phase = (first - self.offset) % ends[-1]
        index = next((i for i, end in enumerate(ends) if phase < end), 0)
        colour, _ = self.cycle[index]
        shown, step = [(first, colour)], first + ends[index] - phase
        while step <= last:
            index = (index + 1) % len(self.cycle)
            colour, duration = self.cycle[index]
            shown.append((step, colour))
            step += duration
        return shown


@dataclass(frozen=True, eq=False)
class Stop:
    """A lanelet's stop line: its ends `(2, 2)`, m, or None (at the lanelet's end), and its lights
    and signs.
    """

    ends: FloatArray | None
    lights: tuple[int, ...]
    signs: tuple[int, ...]


@dataclass(frozen=True)
class Incoming:
    """Lanelets that lead into an intersection from one side, and their successors in it by turn."""

    lanelets: tuple[int, ...]
    successors: tuple[tuple[int, str], ...]


@dataclass(frozen=True)
class Intersection:
    """An intersection; `crossings` are lanelets on which pedestrians cross.

    The references "isLeftOf" are not read: files use them in both senses, so sides follow from the
    geometry.
    """

    incomings: tuple[Incoming, ...]
    crossings: tuple[int, ...]


class OccupiedSet(NamedTuple):
    """Outlines `(k, 2)` that a road user may occupy from one time step to another (an instant:
    until the next set).
    """

    first: float
    last: float
    outlines: tuple[FloatArray, ...]


@dataclass(frozen=True, eq=False)
class Lanelet:
    """One lanelet: boundaries `(n, 2)` as in the file (counts may differ), references, `speed` m/s
    or NaN.
    """

    id: int
    left: FloatArray
    right: FloatArray
    successors: tuple[int, ...]
    beside: tuple[tuple[int, bool] | None, tuple[int, bool] | None]
    markings: tuple[str, str]
    types: tuple[str, ...]
    users: tuple[str, ...]
    speed: float
    stop: Stop | None  # its stop line, or None
    lights: tuple[int, ...]  # traffic lights that it names itself
    signs: tuple[int, ...]  # traffic signs that it names itself

    @property
    def lights_here(self) -> tuple[int, ...]:
        """Traffic lights that its stop line or the lanelet itself names."""
        at_stop = self.stop.lights if self.stop else ()
        return tuple(dict.fromkeys((*at_stop, *self.lights)))


@dataclass(frozen=True, eq=False)
class Obstacle:
    """One obstacle: its box and states `(n, 6)` of the box centre: step, x, y, yaw, v, a (NaN where
    not given).
    """

    id: int
    type: str
    static: bool
    length: float
    width: float
    states: FloatArray
    # where it may be, if the file gives no states but the first: its occupancy set, that state
    # first
    sets: tuple[OccupiedSet, ...] = ()


@dataclass(frozen=True, eq=False)
class GoalState:
    """One goal: regions `(k, 2)` or lanelets, and intervals or None; `step` in time steps."""

    regions: tuple[FloatArray, ...]
    lanelets: tuple[int, ...]
    step: tuple[float, float] | None
    v: tuple[float, float] | None
    yaw: tuple[float, float] | None


@dataclass(frozen=True, eq=False)
class PlanningProblem:
    """One planning problem: the initial state `(6,)` (columns as in `Obstacle`), its yaw rate, the
    goals.
    """

    id: int
    start: FloatArray
    yaw_rate: float
    goals: tuple[GoalState, ...]


@dataclass(frozen=True, eq=False)
class Document:
    """A whole file; `dt` is the time step, s; `notes` name what the file holds and a Scenario does
    not.
    """

    benchmark: str
    version: str
    dt: float
    source: str
    author: str
    affiliation: str
    tags: tuple[str, ...]
    lanelets: tuple[Lanelet, ...]
    obstacles: tuple[Obstacle, ...]
    problems: tuple[PlanningProblem, ...]
    notes: tuple[str, ...]
    lights: tuple[LightCycle, ...]
    # Kinds of the traffic signs ("206", "R1-1", ...) by the sign's id
    signs: Mapping[int, frozenset[str]]
    intersections: tuple[Intersection, ...]

    @property
    def country(self) -> str:
        """Three letters of the benchmark id ("C-DEU_..." -> "DEU"); "ZAM" is the format's
        no-man's-land.
        """
        return self.benchmark.removeprefix("C-")[:3]

    def sign_kinds(self, lanelet: Lanelet, without: Collection[int] = ()) -> set[str]:
        """Kinds of the signs that a lanelet or its stop line names, `without` some of them."""
        at_stop = lanelet.stop.signs if lanelet.stop else ()
        names = {*lanelet.signs, *at_stop}.difference(without)
        return {kind for name in names for kind in self.signs.get(name, ())}
