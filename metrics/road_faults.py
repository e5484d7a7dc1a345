"""Finds faults in a log's map, lights, goal and recorded traffic.

(1) off the map   more than `OFF_SHARE` of the ego's states lie on no drivable lane
(2) lane graph    a lane follows itself, or begins more than `APART_M` from the end of one that it
                  follows; lanes whose successors are all missing in the map are its edge, unless
                  they are more than `EDGE` of all lanes
(3) lights        a light that no stop line names; on a road without stop lines, all lights are one
                  finding
(4) goal          it cannot be driven to (`replan.logs.route.GoalFault`), or the log's driver passes
                  it almost at once (`replan.metrics.arrival.passed_early`)
(5) not recorded  more than `replan.logs.observed.MAX_AGE_S` of the log without observed traffic
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from replan.logs.observed import MAX_AGE_S, clipped
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.metrics.arrival import fault_of, passed_early
from replan.metrics.log_faults import FaultKind, Finding

OFF_SHARE = 0.1
"""A tenth of a drive may be off the lanes: cut corners, car parks."""
APART_M = 3.0
"""Less than a lane's width, m."""
EDGE = 0.5
"""If more than this share of the lanes ends in missing lanes, the map is incomplete, not only
cut."""
SAMPLES = 200
"""Number of the ego's states that are looked up in the map."""


def off_map(scenario: Scenario) -> Iterator[Finding]:
    """Find states of the ego off the map (1)."""
    road, ego = scenario.road, scenario.ego
    if road.source is not RoadSource.LANES:
        return
    rows = np.unique(np.linspace(0, len(ego) - 1, min(len(ego), SAMPLES)).round().astype(int))
    off = [k for k in rows if not road.is_drivable(float(ego.x[k]), float(ego.y[k]))]
    share = len(off) / len(rows)
    if share <= OFF_SHARE:
        return
    centres = [lane.center for lane in road.lanes.values() if lane.drivable]
    x, y = np.vstack(centres or [np.full((1, 2), np.inf)]).T
    distance = max(float(np.hypot(x - ego.x[k], y - ego.y[k]).min()) for k in off)
    text = (
        f"{share:.0%} of the ego's states are on no drivable lane, up to {distance:.1f} m from the "
        "nearest centre line"
    )
    yield Finding(FaultKind.OFF_MAP, ego.t[off[0]], ego.t[off[-1]], share, text)


def lane_graph(scenario: Scenario) -> Iterator[Finding]:
    """Find faults of the lane graph (2)."""
    lanes, end = scenario.road.lanes, scenario.duration
    if scenario.road.source is not RoadSource.LANES:
        return
    missing = sum(
        bool(lane.successors) and lanes.keys().isdisjoint(lane.successors)
        for lane in lanes.values()
    )
    if missing > EDGE * len(lanes):
        text = f"{missing} of {len(lanes)} lanes are followed only by lanes that are not in the map"
        yield Finding(FaultKind.LANE_GRAPH, 0.0, end, missing, text, unit="1")
    for lane in lanes.values():
        for name in lane.successors:
            if name == lane.id:
                text = f"lane {lane.id} follows itself"
                yield Finding(FaultKind.LANE_GRAPH, 0.0, end, 0.0, text, str(lane.id))
            elif name in lanes:
                gap_m = float(np.hypot(*(lanes[name].center[0] - lane.center[-1])))
                text = f"lane {name} follows lane {lane.id}, but begins {gap_m:.1f} m from its end"
                if gap_m > APART_M:
                    yield Finding(FaultKind.LANE_GRAPH, 0.0, end, gap_m, text, str(lane.id))


def lights(scenario: Scenario) -> Iterator[Finding]:
    """Find lights without a stop line (3)."""
    named, end = {line.light for line in scenario.road.stop_lines}, scenario.duration
    if scenario.lights and not named:
        begin = min(float(light.t[0]) for light in scenario.lights)
        text = f"{len(scenario.lights)} lights are shown, but the road has no stop lines"
        yield Finding(FaultKind.LIGHT, begin, end, len(scenario.lights), text)
        return
    for light in scenario.lights:
        if light.id not in named:
            text = f"light {light.id} is shown, but no stop line of the map names it"
            yield Finding(FaultKind.LIGHT, light.t[0], end, 1.0, text, str(light.id))


def goal(scenario: Scenario) -> Iterator[Finding]:
    """Find a goal about which no drive can show anything (4)."""
    begin, end = float(scenario.ego.t[0]), scenario.duration
    if fault := fault_of(scenario):
        yield Finding(FaultKind.GOAL, begin, end, 0.0, fault.value)
    elif early := passed_early(scenario):
        passed_s, share = early
        text = (
            f"the log's driver passes the goal after {passed_s - begin:.1f} s: {share:.0%} "
            "of the log"
        )
        yield Finding(FaultKind.GOAL, passed_s, end, share, text)


def unrecorded(scenario: Scenario) -> Iterator[Finding]:
    """Find times without observed traffic (5)."""
    spans = clipped(scenario.traffic_spans, 0.0, scenario.duration)
    edges = [0.0, *(edge for span in spans for edge in span), scenario.duration]
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end - begin > MAX_AGE_S:
            text = f"no traffic is recorded for {end - begin:.1f} s of {scenario.duration:.1f} s"
            yield Finding(FaultKind.TRAFFIC, begin, end, end - begin, text)
