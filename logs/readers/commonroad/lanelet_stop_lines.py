"""Stop lines of CommonRoad lanelets, and the lights and signs at them.

A lanelet's stop line lies where its points say, else at the lanelet's end; one without the element
has a stop line there if a light or a sign to give way is named on it (and no more on the lanelet
after it). A light applies to the turns of its direction. If several lights of a lanelet apply to
one turn, the one with the fewest turns decides; while it is dark (a green arrow that is not lit),
the next one decides. Signs are ignored if a light is active.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.readers.commonroad.document_records import (
    STOP_SIGNS,
    YIELD_SIGNS,
    Document,
    Lanelet,
    LightCycle,
)
from replan.logs.readers.commonroad.lanelet_turns import Turns
from replan.logs.road import Lane
from replan.logs.rules import Colour, StopLine, TrafficLight

LightChains = Mapping[int, tuple[int, ...]]
"""Light of the scenario -> lights of the file, of which the first that is not dark decides."""


@dataclass(frozen=True, eq=False)
class PlacedStopLine:
    """A stop line before it has an id; `chain`: the file's lights that it obeys, in order of
    priority.
    """

    lane: int
    ends: FloatArray
    chain: tuple[int, ...] = ()
    must_stop: bool = False
    towards: tuple[int, ...] = ()


def stop_lines_at(
    document: Document, lanelet: Lanelet, lane: Lane, turns: Turns, origin: tuple[float, float]
) -> list[PlacedStopLine]:
    """The stop lines of a lanelet: one for each light, else one for its sign."""
    stop, names = lanelet.stop, lanelet.lights_here
    later = [
        other for other in document.lanelets if stop is None and other.id in lanelet.successors
    ]
    on_later = {i for other in later for i in (*other.lights_here, *other.signs)}
    lights = [light for light in document.lights if light.id in names and light.id not in on_later]
    kinds = document.sign_kinds(lanelet, without=on_later)
    if stop is None and not lights and not kinds & (STOP_SIGNS | YIELD_SIGNS):
        return []
    ends = np.vstack([lane.right[-1], lane.left[-1]])
    if stop is not None and stop.ends is not None:
        ends = stop.ends - origin
    successors = [(i, turns[lane.id, i]) for i in lane.successors if (lane.id, i) in turns]
    stop_lines = []
    for chain, governed in _governed(lights, successors).items():
        towards = () if len(governed) == len(successors) else tuple(governed)
        stop_lines.append(PlacedStopLine(lane.id, ends, chain, towards=towards))
    must_stop = bool(kinds & STOP_SIGNS) and not any(light.active for light in lights)
    if must_stop or not stop_lines:
        stop_lines.append(PlacedStopLine(lane.id, ends, must_stop=must_stop))
    return stop_lines


def _governed(
    lights: list[LightCycle], successors: list[tuple[int, str]]
) -> dict[tuple[int, ...], list[int]]:
    """The successors that each chain of lights governs; all of them where none is named.

    A chain is a light, and those that count while the ones before are dark. `successors` have
    their turns.
    """
    if not successors:
        return {(light.id,): [] for light in lights}
    governed: dict[tuple[int, ...], list[int]] = {}
    for successor, turn in successors:
        for_turn = sorted(
            (light for light in lights if turn in light.turns), key=lambda light: len(light.turns)
        )
        for first in (light for light in for_turn if len(light.turns) == len(for_turn[0].turns)):
            goes_dark = not first.active or any(colour is Colour.OFF for colour, _ in first.cycle)
            others = (
                light.id for light in for_turn if goes_dark and len(light.turns) > len(first.turns)
            )
            governed.setdefault((first.id, *others), []).append(successor)
    return governed


def numbered(
    stop_lines: list[PlacedStopLine], first_free: int
) -> tuple[tuple[StopLine, ...], LightChains]:
    """Number the stop lines from 1, and give each chain of lights a light of the scenario.

    It has the id of the chain's first light; where that is taken, the next one from `first_free`.
    """
    names: dict[tuple[int, ...], int] = {}
    for chain in dict.fromkeys(line.chain for line in stop_lines if line.chain):
        if chain[0] in names.values():
            names[chain] = first_free
            first_free += 1
        else:
            names[chain] = chain[0]
    lines = tuple(
        StopLine(number, line.lane, line.ends, names.get(line.chain), line.must_stop, line.towards)
        for number, line in enumerate(stop_lines, start=1)
    )
    return lines, {name: chain for chain, name in names.items()}


def lights_of(
    document: Document, chains: LightChains, start: float, duration: float
) -> tuple[TrafficLight, ...]:
    """The lights over the time of the log: t = 0 is step `start`; it lasts `duration` s."""
    last = start + duration / document.dt
    changes = {light.id: light.changes(start, last) for light in document.lights}
    lights = []
    for name, chain in chains.items():
        shown: list[tuple[float, Colour]] = []
        for step in sorted({step for i in chain for step, _ in changes[i]}):
            colours = [[colour for begin, colour in changes[i] if begin <= step][-1] for i in chain]
            colour = next((colour for colour in colours if colour is not Colour.OFF), Colour.OFF)
            if not shown or shown[-1][1] is not colour:
                shown.append((step, colour))
        t = np.round([(step - start) * document.dt for step, _ in shown], 9)
        lights.append(TrafficLight(name, t, tuple(colour for _, colour in shown)))
    return tuple(lights)
