"""What is wrong with the map, and with lights and map together.

(1) off the map   more than `OFF_SHARE` of the ego's states lie on no drivable lane
(2) lane graph    a lane follows itself, or begins more than `APART_M` from the end of one that it follows; lanes that
                  end in lanes that are not in the map are its edge, unless they are most of it
(3) lights        a light that no stop line names; on a road without stop lines all of them are one finding
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from logs.road import RoadSource
from logs.scenario import Scenario
from metrics.health.finding import Finding, Kind

OFF_SHARE = 0.1
"""A turn cut, a car park: a tenth of a drive may be off the lanes."""
APART_M = 3.0
"""Less than a lane's width, m."""
EDGE = 0.5
"""Lanes of which more than this share end in lanes that are not there are no edge, but a hole."""
SAMPLES = 200


def off_map(scenario: Scenario) -> Iterator[Finding]:
    """(1)."""
    road, ego = scenario.road, scenario.ego
    if road.source is not RoadSource.LANES:
        return
    at = np.unique(np.linspace(0, len(ego) - 1, min(len(ego), SAMPLES)).round().astype(int))
    off = [k for k in at if not road.is_drivable(float(ego.x[k]), float(ego.y[k]))]
    share = len(off) / len(at)
    if share <= OFF_SHARE:
        return
    points = np.vstack([lane.center for lane in road.lanes.values() if lane.drivable] or [np.full((1, 2), np.inf)])
    away = max(float(np.hypot(points[:, 0] - ego.x[k], points[:, 1] - ego.y[k]).min()) for k in off)
    text = f"{share:.0%} of the ego's states are on no drivable lane, up to {away:.1f} m from the nearest centre line"
    yield Finding(Kind.OFF_MAP, "road", "", float(ego.t[off[0]]), float(ego.t[off[-1]]), share, "1", text)


def lane_graph(scenario: Scenario) -> Iterator[Finding]:
    """(2)."""
    lanes, end = scenario.road.lanes, scenario.duration
    if scenario.road.source is not RoadSource.LANES:
        return
    missing = [lane.id for lane in lanes.values() if lane.successors and not any(s in lanes for s in lane.successors)]
    if len(missing) > EDGE * len(lanes):
        text = f"{len(missing)} of {len(lanes)} lanes are followed only by lanes that are not in the map"
        yield Finding(Kind.LANE_GRAPH, "road", "", 0.0, end, float(len(missing)), "1", text)
    for lane in lanes.values():
        for name in lane.successors:
            if name == lane.id:
                text = f"lane {lane.id} follows itself"
                yield Finding(Kind.LANE_GRAPH, "road", str(lane.id), 0.0, end, 0.0, "m", text)
            elif name in lanes:
                gap = float(np.hypot(*(lanes[name].center[0] - lane.center[-1])))
                if gap > APART_M:
                    text = f"lane {name} follows lane {lane.id}, but begins {gap:.1f} m from its end"
                    yield Finding(Kind.LANE_GRAPH, "road", str(lane.id), 0.0, end, gap, "m", text)


def lights(scenario: Scenario) -> Iterator[Finding]:
    """(3)."""
    named = {line.light for line in scenario.road.stop_lines}
    if scenario.lights and not scenario.road.stop_lines:
        count, begin = len(scenario.lights), min(float(light.t[0]) for light in scenario.lights)
        text = f"{count} lights are shown, but the road has no stop lines"
        yield Finding(Kind.LIGHT, "lights", "", begin, scenario.duration, float(count), "1", text)
        return
    for light in scenario.lights:
        if light.id not in named:
            text = f"light {light.id} is shown, but no stop line of the map names it"
            span = float(light.t[0]), scenario.duration
            yield Finding(Kind.LIGHT, "lights", str(light.id), *span, 1.0, "1", text)
