"""Stop lines, closed loop: red and yellow lights, and stop signs.

Crossing: the middle of the ego's front bumper passes a stop line in the direction of its lane, at
most `ASIDE_M` beside its ends. The line must apply to the route that the ego takes behind it: the
successor of the lane on which the drive lies longest must be one of those to which the line
applies. A drive that begins beyond a line or ends before it does not cross it.

    red_light      crossings while the line's light shows red, or red and yellow
    yellow_light   crossings while it shows yellow, if the ego was farther from the line when the
                   yellow began than
                   (1) v `YELLOW_S` + v^2 / (2 `YELLOW_MPS2`): a reaction and a comfortable stop
    stop_sign      crossings of a stop sign's line without a speed below 0.1 m/s in the last 5 m
                   before it
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from math import hypot

import numpy as np

from replan.core.arrays import FloatArray, arc_lengths
from replan.logs.road import Road
from replan.logs.route import ASIDE_M, BEHIND_M, on_lane
from replan.logs.rules import RED, Colour, StopLine
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Trace
from replan.metrics.boxes import ego_boxes
from replan.metrics.metric import Measured, Unavailable, counted, metric
from replan.metrics.reductions import COUNT

REST_MPS, BEFORE_M = 0.1, 5.0
YELLOW_S, YELLOW_MPS2 = 1.0, 3.05

_light_metric = partial(
    metric,
    unit="count",
    better="lower",
    reductions=(COUNT,),
    needs="a traffic light with a stop line",
)


@_light_metric(
    parameters=(f"beside the line's ends {ASIDE_M} m",),
    source="as CARLA leaderboard 2.x counts red lights; nuPlan has none",
)
def red_light(trace: Trace, scenario: Scenario) -> Measured:
    """Stop lines that the front came over while their light showed red, or red and yellow.

    Formula: sum of crossings at red, or red and yellow
    """
    return _light(trace, scenario, yellow=False)


@_light_metric(
    parameters=(f"reaction {YELLOW_S:g} s", f"stop {YELLOW_MPS2} m/s2"),
    source="StVO 37; ITE, Determining Vehicle Signal Change and Clearance Intervals: 1 s and "
    "3.05 m/s2",
)
def yellow_light(trace: Trace, scenario: Scenario) -> Measured:
    """Stop lines that the front came over at a yellow for which the ego could have stopped
    comfortably.

    Formula: sum of crossings at yellow, if it began farther away than v * 1 s + v^2 / (2 * 3.05
    m/s2)
    """
    return _light(trace, scenario, yellow=True)


def _light(trace: Trace, scenario: Scenario, *, yellow: bool) -> Measured:
    lights = {light.id: light for light in scenario.lights}
    lines = [
        (line, lights[line.light]) for line in scenario.road.stop_lines if line.light in lights
    ]
    if not lines:
        return Unavailable("the log shows no traffic light with a stop line")
    ego, events = trace.ego, []
    for line, light in lines:
        for step in _crossings(line, trace, scenario):
            now = float(ego.t[step])
            since = light.t[max(int(np.searchsorted(light.t, now + 1e-9)) - 1, 0)]
            runs = light.at(now) in RED
            if yellow:
                k = min(int(np.searchsorted(ego.t, since - 1e-9)), step)
                needed = ego.v[k] * YELLOW_S + ego.v[k] ** 2 / (2.0 * YELLOW_MPS2)  # (1)
                runs = (
                    light.at(now) is Colour.YELLOW and -_ahead(line, ego, scenario)[0][k] >= needed
                )
            if runs:
                shown = f"light {light.id} {light.at(now).value} since {since:.1f} s"
                events.append((step, f"stop line {line.id}: {shown}"))
    return counted(ego.t, events)


@metric(
    unit="count",
    better="lower",
    reductions=(COUNT,),
    parameters=(f"at rest below {REST_MPS} m/s", f"before the line {BEFORE_M:g} m"),
    needs="a stop sign",
    source="bounds: nuPlan devkit e9241677, ego_stop_at_stop_line (5 m, 0.1 m/s)",
)
def stop_sign(trace: Trace, scenario: Scenario) -> Measured:
    """Stop signs passed without a speed below 0.1 m/s in the last 5 m before their line.

    Formula: sum of crossings with min |v| >= 0.1 m/s over the last 5 m
    """
    lines = [line for line in scenario.road.stop_lines if line.must_stop]
    if not lines:
        return Unavailable("the log has no stop sign")
    events = []
    for line in lines:
        ahead = _ahead(line, trace.ego, scenario)[0]
        for step in _crossings(line, trace, scenario):
            far = np.flatnonzero(ahead[:step] < -BEFORE_M)
            slowest = float(np.abs(trace.ego.v[far[-1] + 1 : step + 1]).min()) if len(far) else 0.0
            if slowest >= REST_MPS:
                events.append((step, f"stop line {line.id}: {slowest:.1f} m/s at the slowest"))
    return counted(trace.ego.t, events)


def _ahead(line: StopLine, ego: Trajectory, scenario: Scenario) -> tuple[FloatArray, FloatArray]:
    """Return how far the middle of the front is beyond a line and beside the line's middle, `(n,)`
    each, m.
    """
    reach = scenario.vehicle.axle_to_front
    x, y = ego.x + reach * np.cos(ego.yaw), ego.y + reach * np.sin(ego.yaw)
    across = line.points[1] - line.points[0]
    across = across / max(hypot(*across), 1e-9)
    normal = np.array([across[1], -across[0]])
    center = scenario.road.lanes[line.lane].center
    normal *= 1.0 if float((center[-1] - center[-2]) @ normal) > 0.0 else -1.0
    dx, dy = x - line.points[:, 0].mean(), y - line.points[:, 1].mean()
    return dx * normal[0] + dy * normal[1], dx * across[0] + dy * across[1]


def _crossings(line: StopLine, trace: Trace, scenario: Scenario) -> Iterator[int]:
    """Yield the steps at which the ego has crossed a line that applies to its route, or behind
    which the drive ends.
    """
    road, ego = scenario.road, trace.ego
    lanes_behind = [road.lanes[i] for i in road.lanes[line.lane].successors if i in road.lanes]
    ahead, beside = _ahead(line, ego, scenario)
    half = 0.5 * hypot(*(line.points[1] - line.points[0])) + ASIDE_M
    over = (ahead[:-1] < 0.0) & (ahead[1:] >= 0.0) & (np.abs(beside[1:]) <= half)
    for step in (np.flatnonzero(over) + 1).tolist():
        driven = arc_lengths(ego.x[step:], ego.y[step:])
        metres = np.arange(0.0, min(float(driven[-1]), BEHIND_M), 1.0)
        steps = step + np.unique(np.searchsorted(driven, metres))
        x, y = ego_boxes(ego, scenario)[:2, steps]
        yaw = ego.yaw[steps]
        steps_on = {lane.id: int(on_lane(lane, x, y, yaw).sum()) for lane in lanes_behind}
        if any(steps_on.values()):
            longest = max(steps_on, key=lambda lane: (steps_on[lane], -lane))
            applies = not line.towards or longest in line.towards
        else:
            applies = not lanes_behind or not _on_road(road, x[-1:], y[-1:], yaw[-1:])
            applies = applies or road.lanes[line.lane] in road.lanes_at(float(x[-1]), float(y[-1]))
        if applies:
            yield step


def _on_road(road: Road, x: FloatArray, y: FloatArray, yaw: FloatArray) -> bool:
    return any(on_lane(lane, x, y, yaw).any() for lane in road.lanes.values())
