"""What a CommonRoad XML file says of traffic rules, as plain records: lights, stop lines, signs, intersections.

Source: CommonRoad, "XML format documentation", version 2020a; commonroad-io, `TrafficLight.get_state_at_time_step`.
A light repeats its cycle for ever, its first element beginning at step `offset`:

(1) it shows the element that holds the phase (step - offset) mod (sum of the durations), each from its begin to before
    its end

What the records mean for a Scenario is decided by `rules.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from xml.etree.ElementTree import Element

from logs.errors import LogError
from logs.kernel import FloatArray
from logs.readers.commonroad.elements import integer, number, points_in, references
from logs.rules import Colour

COLOURS = {
    "red": Colour.RED,
    "redYellow": Colour.RED_YELLOW,
    "yellow": Colour.YELLOW,
    "green": Colour.GREEN,
    "inactive": Colour.OFF,
}
TURNS = ("left", "straight", "right")
DIRECTIONS = {
    "all": frozenset(TURNS),
    "left": frozenset({"left"}),
    "straight": frozenset({"straight"}),
    "right": frozenset({"right"}),
    "leftStraight": frozenset({"left", "straight"}),
    "straightRight": frozenset({"straight", "right"}),
    "leftRight": frozenset({"left", "right"}),
}
STOP_SIGNS = frozenset({"206", "R1-1"})
YIELD_SIGNS = frozenset({"205", "R1-2"})
PRIORITY_SIGNS = frozenset({"301", "306"})
READ_SIGNS = STOP_SIGNS | YIELD_SIGNS | PRIORITY_SIGNS
"""Signs of Germany (and of the format's no-man's-land) and of the USA that say who goes first."""


@dataclass(frozen=True)
class Light:
    """A traffic light: its cycle of colours and durations (time steps), (1), and the turns that it is for.

    Attributes:
        cycle: Empty where the file has none.
        active: A light that is not shows nothing.
    """

    id: int
    cycle: tuple[tuple[Colour, float], ...]
    offset: float
    turns: frozenset[str]
    active: bool

    def changes(self, first: float, last: float) -> list[tuple[float, Colour]]:
        """Steps and colours by (1), from `first` on: what it shows then, and each element that begins until `last`."""
        if not self.active or not self.cycle:
            return [(first, Colour.OFF)]
        ends = list(accumulate(duration for _, duration in self.cycle))
        phase = (first - self.offset) % ends[-1]
        index = next((i for i, end in enumerate(ends) if phase < end), 0)
        shown, step = [(first, self.cycle[index][0])], first + ends[index] - phase
        while step <= last:
            index = (index + 1) % len(self.cycle)
            colour, duration = self.cycle[index]
            shown.append((step, colour))
            step += duration
        return shown


@dataclass(frozen=True, eq=False)
class Stop:
    """A lanelet's stop line: its ends `(2, 2)`, m, or None (at the lanelet's end), and whom it obeys."""

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

    The references "isLeftOf" are not read: files use them in both senses, so sides are told by geometry.
    """

    id: int
    incomings: tuple[Incoming, ...]
    crossings: tuple[int, ...]


def light_of(element: Element) -> Light:
    """A <trafficLight>.

    Raises:
        LogError: An unknown colour or direction, or a duration below one step.
    """
    name = integer(element.get("id"), "trafficLight@id")
    place = f"trafficLight {name}"
    cycle = []
    for part in element.findall("cycle/cycleElement"):
        colour, steps = part.findtext("color", "").strip(), number(part.findtext("duration"), f"{place}/duration")
        if colour not in COLOURS:
            raise LogError(f"no colour {colour!r}", topic=place, remedy=f"known are {', '.join(COLOURS)}")
        if not steps >= 1.0:
            raise LogError(f"a duration of {steps:g} steps", topic=place, remedy="it lasts one step at least")
        cycle.append((COLOURS[colour], steps))
    direction = element.findtext("direction", "all").strip() or "all"
    if direction not in DIRECTIONS:
        raise LogError(f"no direction {direction!r}", topic=place, remedy=f"known are {', '.join(DIRECTIONS)}")
    offset = number(element.findtext("cycle/timeOffset", "0"), f"{place}/timeOffset")
    return Light(name, tuple(cycle), offset, DIRECTIONS[direction], element.findtext("active", "").strip() != "false")


def stop_of(lanelet: Element, place: str) -> Stop | None:
    """The <stopLine> of a lanelet.

    Raises:
        LogError: It has a single point.
    """
    element = lanelet.find("stopLine")
    if element is None:
        return None
    points = points_in(element, f"{place}/stopLine")
    if len(points) == 1:
        raise LogError("a stop line of one point", topic=f"{place}/stopLine", remedy="give its two ends, or none")
    ends = points[[0, -1]] if len(points) else None
    return Stop(ends, *(references(element, tag, f"{place}/stopLine") for tag in ("trafficLightRef", "trafficSignRef")))


def kinds_of(sign: Element) -> frozenset[str]:
    """The kinds in a <trafficSign>, by their numbers in the country's law."""
    kinds = (e.findtext("trafficSignID", "").strip() for e in sign.findall("trafficSignElement"))
    return frozenset(filter(None, kinds))


def intersection_of(element: Element) -> Intersection:
    """An <intersection>."""
    name = integer(element.get("id"), "intersection@id")
    place = f"intersection {name}"
    incomings = tuple(
        Incoming(
            references(e, "incomingLanelet", place),
            tuple((i, turn) for turn in TURNS for i in references(e, f"successors{turn.title()}", place)),
        )
        for e in element.findall("incoming")
    )
    crossings = tuple(i for e in element.findall("crossing") for i in references(e, "crossingLanelet", place))
    return Intersection(name, incomings, crossings)
