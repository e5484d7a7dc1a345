"""Hands the reference drivers their line, and writes their verdicts into a scenario's metadata.

The line is the reference line of the route that the planners drive, too, up to its first lane change: from there on the
driver keeps its lane, as that of UN R157 does. The entries, for each driver of
`metrics.reference_drivers.DRIVERS`, are those that `metrics.reference_drivers` reads and explains.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from logs.road import Goal, ReferenceLine, Road
from logs.route import find_route
from logs.scenario import FINDING, Scenario
from logs.states import EgoState
from metrics.metric import once
from metrics.reference_drivers import DRIVERS, DriverVerdict, metadata_of
from planners.frenet.reference_path import make_line


def reference_line(scenario: Scenario) -> ReferenceLine:
    """The line from the log's first state along its lane towards the goal; straight on where it has none."""
    return _line(scenario.road, scenario.ego.state(0), scenario.goal)


@once  # asked before the scenario has its entries, and again for the reference drives
def _line(road: Road, start: EgoState, goal: Goal | None) -> ReferenceLine:
    route = find_route(road, start, goal)
    kept = 1
    for before, now in pairwise(route.lanes):
        if now not in road.lanes[before].successors:
            break
        kept += 1
    return make_line(road, replace(route, lanes=route.lanes[:kept]), start)[1]


def verdicts(scenario: Scenario) -> tuple[DriverVerdict, ...]:
    """What each reference driver makes of a scenario, from the ego's first state on."""
    line = reference_line(scenario)
    return tuple(driver(scenario, line, None) for driver in DRIVERS.values())


def with_avoidability(scenario: Scenario) -> Scenario:
    """The scenario with the verdicts on it in its metadata, in place of those that it has."""
    said = {key: text for key, text in scenario.metadata.items() if not key.startswith(FINDING)}
    entries = {key: text for verdict in verdicts(scenario) for key, text in metadata_of(verdict).items()}
    return replace(scenario, metadata={**said, **entries})
