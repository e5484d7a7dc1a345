"""Traffic rules, closed loop: red lights, stop signs, crosswalks; right of way is in `right_of_way`.

Crossing: the middle of the ego's front bumper comes over a stop line in the direction of its lane, not further than
`ASIDE_M` beside its ends. A line counts for the way that the ego takes behind it: that of the lane's successors on
which the drive lies longest must be one of those that the line counts for. A drive that begins beyond a line, or ends
before it, says nothing of it.

    RED_LIGHT      crossings while the line's light shows red, or red and yellow
    STOP_SIGN      crossings of a stop sign's line without a speed below 0.1 m/s in the last 5 m before it
    CROSSWALK      times that the ego drives on a crosswalk, with a pedestrian at the same time on the ego's half of it:
                   inside of its outline and within `HALF_LANE_M` of the way that the ego's middle takes over it

Who is on the crosswalk is taken as it really moved, so that nothing has to be guessed of whom the ego should have seen
coming: in replayed traffic pedestrians do not wait for an ego that does not.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot

import numpy as np

from logs.kernel import BoolArray, FloatArray, kernel
from logs.lanes import ASIDE_M, BEHIND_M, on_lane
from logs.road import inside
from logs.rules import RED, Crosswalk, StopLine
from logs.scenario import AgentKind, Scenario
from logs.states import Trajectory
from logs.trace import Mode, Trace
from metrics.metric import COUNT, Measured, Metric, Unavailable, counted
from metrics.others import ego_boxes, name_of, some_at, there_between

REST_MPS, BEFORE_M = 0.1, 5.0
HALF_LANE_M = 1.75


# stop lines -------------------------------------------------------------------------------------------------------


def _red_light(trace: Trace, scenario: Scenario) -> Measured:
    lights = {light.id: light for light in scenario.lights}
    lines = [line for line in scenario.road.stop_lines if line.light in lights]
    if not lines:
        return Unavailable("the log shows no traffic light with a stop line")
    events = []
    for line in lines:
        light = lights[line.light] if line.light is not None else None
        for step in _crossings(line, trace, scenario):
            now = float(trace.ego.t[step])
            if light is not None and light.at(now) in RED:
                since = light.t[max(int(np.searchsorted(light.t, now + 1e-9)) - 1, 0)]
                events.append(
                    (step, f"stop line {line.id}: light {light.id} {light.at(now).value} since {since:.1f} s")
                )
    return counted(trace.ego.t, events)


def _stop_sign(trace: Trace, scenario: Scenario) -> Measured:
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
    """How far the front's middle is beyond a line and beside its middle `(n,)` each, m."""
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
    """The steps at which the ego has just come over a line that counts for its way."""
    ahead, beside = _ahead(line, trace.ego, scenario)
    half = 0.5 * hypot(*(line.points[1] - line.points[0])) + ASIDE_M
    over = (ahead[:-1] < 0.0) & (ahead[1:] >= 0.0) & (np.abs(beside[1:]) <= half)
    for step in (np.flatnonzero(over) + 1).tolist():
        if _counts(line, step, trace.ego, scenario):
            yield step


def _counts(line: StopLine, step: int, ego: Trajectory, scenario: Scenario) -> bool:
    """Whether the ego's way behind a line is one that the line counts for; a drive that ends there has taken it."""
    road = scenario.road
    ways = [road.lanes[i] for i in road.lanes[line.lane].successors if i in road.lanes]
    driven = np.r_[0.0, np.cumsum(np.hypot(np.diff(ego.x[step:]), np.diff(ego.y[step:])))]
    at = step + np.unique(np.searchsorted(driven, np.arange(0.0, min(float(driven[-1]), BEHIND_M), 1.0)))
    x, y = ego_boxes(ego, scenario)[:2, at]
    on = {way.id: int(on_lane(way, x, y, ego.yaw[at]).sum()) for way in ways}
    if not any(on.values()):
        beyond = any(on_lane(lane, x[-1:], y[-1:], ego.yaw[at[-1:]]).any() for lane in road.lanes.values())
        return not ways or not beyond or road.lanes[line.lane] in road.lanes_at(float(x[-1]), float(y[-1]))
    taken = max(on, key=lambda way: (on[way], -way))
    return not line.towards or taken in line.towards


# crosswalks -------------------------------------------------------------------------------------------------------


def _crosswalk(trace: Trace, scenario: Scenario) -> Measured:
    if not scenario.road.crosswalks:
        return Unavailable("the log has no crosswalk")
    events = []
    walkers = np.flatnonzero([kind is AgentKind.PEDESTRIAN for kind in trace.agents.kinds])
    ego, t = ego_boxes(trace.ego, scenario), trace.ego.t
    size = np.array([scenario.vehicle.length, scenario.vehicle.width])
    for crosswalk in scenario.road.crosswalks if len(walkers) else ():
        for first, last in _passages(crosswalk, ego, size):
            way = np.ascontiguousarray(ego[:2, first : last + 1])
            seen = np.intersect1d(walkers, there_between(trace.agents, t[first], t[last]))
            others = some_at(trace.agents, seen, t[first : last + 1])
            for row, i in enumerate(seen.tolist()):
                on = _on_half(others.pose[:2, row], way, crosswalk.polygon)
                on &= others.there[row] & (np.abs(trace.ego.v[first : last + 1]) > REST_MPS)
                if on.any():
                    events.append((first + int(np.argmax(on)), f"crosswalk {crosswalk.id}: {name_of(trace.agents, i)}"))
    return counted(trace.ego.t, events)


def _passages(crosswalk: Crosswalk, ego: FloatArray, size: FloatArray) -> Iterator[tuple[int, int]]:
    """First and last step of each passage over a crosswalk; one that is under way at the start is left out."""
    on = _over(ego, size, crosswalk.polygon)
    change = np.flatnonzero(np.diff(np.r_[False, on, False].astype(int)))
    for first, end in zip(change[::2], change[1::2], strict=True):
        if first > 0:
            yield int(first), int(end) - 1


@kernel
def _over(ego: FloatArray, size: FloatArray, polygon: FloatArray) -> BoolArray:
    """At which steps a box (rows x, y, yaw) lies over a polygon, on a raster of 9 by 5 points of it."""
    out = np.zeros(ego.shape[1], np.bool_)
    for k in range(ego.shape[1]):
        c, s = np.cos(ego[2, k]), np.sin(ego[2, k])
        for i in range(45):
            along, left = (i // 5 / 8.0 - 0.5) * size[0], (i % 5 / 4.0 - 0.5) * size[1]
            if inside(ego[0, k] + along * c - left * s, ego[1, k] + along * s + left * c, polygon):
                out[k] = True
                break
    return out


def _on_half(who: FloatArray, way: FloatArray, polygon: FloatArray) -> BoolArray:
    """At which steps `(k,)` somebody at `(2, k)` is on a crosswalk and near the way `(2, m)` over it."""
    found = np.zeros(who.shape[1], np.bool_)
    for k in np.flatnonzero(np.isfinite(who[0])):
        x, y = float(who[0, k]), float(who[1, k])
        found[k] = inside(x, y, polygon) and _beside(x, y, way) <= HALF_LANE_M
    return found


def _beside(x: float, y: float, way: FloatArray) -> float:
    """Distance of a point from the straight line through the ends of a way, m: the way over a crosswalk is short."""
    dx, dy = way[:, -1] - way[:, 0]
    length = hypot(dx, dy)
    if length < 1e-6:
        return hypot(x - way[0, 0], y - way[1, 0])
    return abs((x - way[0, 0]) * dy - (y - way[1, 0]) * dx) / length


_CLOSED = (Mode.CLOSED,)
RED_LIGHT = Metric(
    "red_light", "count", "lower", _CLOSED, _red_light, (COUNT,),
    "Stop lines that the front came over while their light showed red, or red and yellow.",
    "as CARLA leaderboard 2.x counts red lights; nuPlan has none",
    formula="sum of crossings at red, or red and yellow", parameters=(f"beside the line's ends {ASIDE_M} m",),
    needs="a traffic light with a stop line",
)  # fmt: skip
STOP_SIGN = Metric(
    "stop_sign", "count", "lower", _CLOSED, _stop_sign, (COUNT,),
    "Stop signs passed without a speed below 0.1 m/s in the last 5 m before their line.",
    "bounds: nuPlan devkit e9241677, ego_stop_at_stop_line (5 m, 0.1 m/s)",
    formula="sum of crossings with min |v| >= 0.1 m/s over the last 5 m",
    parameters=(f"at rest below {REST_MPS} m/s", f"before the line {BEFORE_M:g} m"), needs="a stop sign",
)  # fmt: skip
CROSSWALK = Metric(
    "crosswalk", "count", "lower", _CLOSED, _crosswalk, (COUNT,),
    "Pedestrians who were on the ego's half of a crosswalk while it drove over it.",
    "StVO 26 (1): who evidently wants to cross is let cross",
    formula="sum over passages of the pedestrians on the ego's half",
    parameters=(f"half a lane {HALF_LANE_M} m", f"drives above {REST_MPS} m/s"), needs="a crosswalk",
)  # fmt: skip
