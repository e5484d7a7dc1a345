"""Braking, standing and steering without a reason, and missing braking; closed loop, every 0.1 s.

Reasons for the ego to slow down or to stand are searched along the route (`progress`), ahead of its
front, up to the distance (v: its speed)

(1) look = 10 m + 1.5 s v + max(v - u, 0)^2 / (2 EASE_MPS2)
        u: speed of the road user ahead, along the route

The reasons are those that a careful driver could have:

    road users   ahead or beside, whose box is within 1 m (pedestrians and riders: 2 m) of the strip
                 that the ego sweeps here or on the route, or comes so near within `COMING_S` at its
                 velocity, and who do not drive away: those that were present, phantoms included,
                 and those that the planner perceived
    rules        a stop line with a sign, or a light that is not green; a crosswalk with a
                 pedestrian or rider within 10 m of it; a lane that yields; the far end of the goal,
                 its near end where it asks for a speed; a goal's time, where the ego would leave
                 the goal before it; the end of the route
    caps         v exceeds the limit, the speed with 2 m/s2 of lateral acceleration in a curve, or
                 the speed of the recorded driver at that place

Reasons other than caps last `AFTER_S` longer. An ego more than `ASIDE_M` beside the route is not
judged.

(2) needless_braking(t) = highest speed since the last reason - v(t)
(3) needless_standing(t) = 1 where v < 0.5 m/s and no reason is within 10 m of its front,
        and no stop line within `LINE_M`
(4) needless_steering: each change of the offset from the route by 0.5 m to 2 m between two turning
    points, if no road user and no curve is near in its first half

False braking is hard braking without a cause. A planner that avoids it may miss braking instead, so
both are measured:

(5) A hard episode: steps every `GRID_S` with a < -`HARD_MPS2`, less than `APART_S` apart.
(6) It had a cause if, within `CAUSE_S` of its begin, the box of any road user came within `CAUSE_M`
    of the strip that the ego sweeps from there: along its drive, straight beyond its end, for the
    distance that it would cover at its speed.
(7) missed(t) = max((v - u)^2 / (2 gap) - b, 0) for the lead in the path ahead (`following`)
        with gap and u, v > u, and the ego's deceleration b: the deceleration of a steady approach
        that the ego does not apply.

Faults that no single event shows, closed loop, every 0.1 s: a driver who is off the middle,
restless, or too fast.

Each of these measures leaves out the steps at which there is a reason.

(8) lane_offset(t) = distance l of the ego's centre from the middle of its lane,
        positive to the left; not judged in a curve, at rest, while a road user beside or ahead is
        to be passed and `KEPT_S` after that, and at first for `SETTLES_S` and |l_0| / `RETURN_MPS`,
        in which an offset of the start goes.
    kept: the largest d so that |l| >= d on one side in three quarters of the judged time
(9) swing(t) = 1 where a fall of the speed by `FALL_MPS` or more ends, between two turning points;
        "needless": where it had no reason to slow down all the time. per_minute: of the time of the
        drive, or of that without a reason; at least `LEAST_S`
(10) needless_lane_change(t) = 1 where the ego's centre crosses from a lane into the one beside it,
         if in the last `CALLED_S` no road user was in its way ahead, and the route neither lies on
         that side nor crosses to it further on
(11) braked_behind(t) = least deceleration that keeps a vehicle behind the ego from hitting it
         (`cut_in`, (2)) from the begin of a fall (9) on, less what it would be if the ego kept its
         speed
(12) curve_accel(t) = |mean of v^2 kappa over (t - 1 s, t]|: a curve, and no swerve
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import cos, sin

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, arc_lengths
from replan.core.kernel import kernel
from replan.core.once import once
from replan.logs.reference_line import ReferenceLine, line_project_many
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Mode, Trace
from replan.logs.tracks import Tracks
from replan.metrics.boxes import (
    GRID_S,
    EgoOutline,
    OtherBoxes,
    car_of,
    each,
    ego_boxes,
    grid_of,
    labels_of,
    others_at,
    phantoms,
    touches,
)
from replan.metrics.comfort import lat_accel
from replan.metrics.cut_in import (
    HORIZON_S,
    IN_M,
    MOST_MPS2,
    REACT_S,
    CutInStay,
    followers,
    needed_deceleration,
    worst_forced,
)
from replan.metrics.following import ahead_of
from replan.metrics.lanes import (
    NO_LANES,
    LaneArrays,
    drivable_lanes,
    limits_at,
    mapped_lanes,
    points_inside,
    under,
)
from replan.metrics.metric import (
    COUNT,
    MAX,
    MAX_ABS,
    RATE,
    Measured,
    Metric,
    Reduction,
    Series,
    Unavailable,
    durations,
    first_of,
    worst_episode,
)
from replan.metrics.progress import WINDOW_M, gain_along, route_of

NEAR_M, HEADWAY_S, EASE_MPS2, FARTHEST_M = 10.0, 1.5, 1.5, 150.0
LINE_M = 6.0
COMING_S, AFTER_S = 6.0, 2.0
SIDE_M, SIDE_VULNERABLE_M, DRIFT_MPS = 1.0, 2.0, 0.3
ASIDE_M, ACROSS_M = 5.0, 2.0
CURVE_MPS2, CURVE_RADIUS_M = 2.0, 50.0
SLACK_MPS, STANDS_MPS = 0.3, 0.5
SWING_M, CHANGE_M, FALL_MPS = 0.5, 2.0, 0.5
HARD_MPS2, APART_S, CAUSE_S, CAUSE_M = 3.5, 0.5, 5.0, 0.3
SPACING_M = 0.5  # Distance between the boxes of the ego whose union approximates the strip
TOUCHING_M = 0.5  # Least gap in (7): nearer road users are contacts


@dataclass(frozen=True, eq=False, slots=True)
class Reasons:
    """The ego's speed v, m/s, its offset l from the route, m, and its reasons, at k times t, s."""

    t: FloatArray
    v: FloatArray
    l: FloatArray
    slow: BoolArray  # Whether it has a reason to be slower
    stand: BoolArray  # Whether it has a reason to stand
    # Whether it has a reason to change its offset; `beside`: a road user is one; `change`: its lane
    steer: BoolArray
    beside: BoolArray
    change: BoolArray


@once
def reasons(trace: Trace, scenario: Scenario) -> Reasons:
    """Find the reasons of the ego at each step."""
    ego, line = grid_of(trace), route_of(scenario).line
    s, l = line_project_many(line.s, line.coef, ego.x, ego.y, 0.0, WINDOW_M).T
    front = s + scenario.vehicle.axle_to_front
    slow, stand, steer, change = np.zeros((4, len(s)), np.bool_)
    for begin, end, active, near in _places_to_stop(trace, scenario, ego.t, line):
        ahead = (s <= end) & active
        slow |= ahead & (begin - front <= _look_ahead(ego.v, 0.0))
        stand |= ahead & (begin - front <= near)
    ghosts = {phantom.agent for phantom in phantoms(scenario)}
    shown = (trace.agents, trace.perceived, scenario.tracks.only(ghosts) if ghosts else None)
    for tracks in filter(None, shown):
        for brakes, stands, beside, far in _agents_as_reasons(
            tracks, ego.t, s, l, ego.v, line, scenario
        ):
            slow, stand, steer, change = slow | brakes, stand | stands, steer | beside, change | far
    goal, early = scenario.goal, np.zeros(len(s), np.bool_)
    # At its speed it would leave the goal before the goal's time
    if goal is not None and goal.t is not None:
        early = s + np.maximum(ego.v, STANDS_MPS) * (goal.t[0] - ego.t) > route_of(scenario).far
    flags = np.stack([slow | early, stand | early, steer, change])
    since = np.maximum.accumulate(np.where(flags, ego.t, -np.inf), axis=1)
    slow, stand, steer, change = ego.t - since <= AFTER_S + 1e-9
    off = np.abs(l) > ASIDE_M
    lanes, default = drivable_lanes(scenario.road), scenario.road.default_speed_limit
    x, y = np.ascontiguousarray(line.xy[:, 0]), np.ascontiguousarray(line.xy[:, 1])
    limit = (
        np.nan_to_num(limits_at(lanes, x, y), nan=default)
        if lanes is not None
        else np.full(len(x), default)
    )
    caps = np.minimum(limit, np.sqrt(CURVE_MPS2 / np.maximum(np.abs(line.kappa), 1e-9)))
    if scenario.is_recorded and len(scenario.ego) > 1:
        logged = scenario.ego
        passed = line_project_many(line.s, line.coef, logged.x, logged.y, 0.0, WINDOW_M)[:, 0]
        np.minimum.at(
            caps, np.clip(np.searchsorted(line.s, passed), 0, len(caps) - 1), np.abs(logged.v)
        )
    ease = NEAR_M + HEADWAY_S * ego.v  # and the distance to slow down to a cap with `EASE_MPS2`
    first, end = np.searchsorted(line.s, [s, s + FARTHEST_M + NEAR_M])
    for k, v in enumerate(ego.v.tolist()):
        some = slice(max(int(first[k]) - 1, 0), int(end[k]))
        far = (
            line.s[some]
            - s[k]
            - ease[k]
            - np.maximum(v**2 - caps[some] ** 2, 0.0) / (2.0 * EASE_MPS2)
        )
        slow[k] |= off[k] or bool(((v > caps[some] + SLACK_MPS) & (far <= 0.0)).any())
    curved = np.interp(s, line.s, np.abs(line.kappa)) > 1.0 / CURVE_RADIUS_M
    return Reasons(ego.t, ego.v, l, slow, stand | off, steer | curved, steer, change | off)


def _look_ahead(v: FloatArray, u: FloatArray | float) -> FloatArray:
    """Return (1), at most `FARTHEST_M`."""
    return np.minimum(
        NEAR_M + HEADWAY_S * v + np.maximum(v - u, 0.0) ** 2 / (2.0 * EASE_MPS2), FARTHEST_M
    )


def _agents_as_reasons(
    tracks: Tracks,
    t: FloatArray,
    s: FloatArray,
    l: FloatArray,
    v: FloatArray,
    line: ReferenceLine,
    scenario: Scenario,
) -> Iterator[BoolArray]:
    """Yield for each road user the steps at which it is a reason to brake, to stand, to steer, to
    change lanes.
    """
    car, place = scenario.vehicle, np.stack([np.interp(s, line.s, column) for column in line.xy.T])
    for i, others, row in each(tracks, t):
        x, y, yaw, vx, vy = np.nan_to_num(others.pose[:, row])
        length, width = others.size[row]
        there = others.there[row] & (np.hypot(*(others.pose[:2, row] - place)) < FARTHEST_M)
        steps = np.flatnonzero(there)
        flags = np.zeros((4, len(t)), np.bool_)
        if len(steps):
            guess = float(s[steps[0]])
            at, aside = line_project_many(
                line.s, line.coef, x[steps], y[steps], guess, FARTHEST_M
            ).T
            road = np.interp(at, line.s, line.yaw)
            turn = yaw[steps] - road
            u = vx[steps] * np.cos(road) + vy[steps] * np.sin(road)
            w = vy[steps] * np.cos(road) - vx[steps] * np.sin(road)
            along = 0.5 * (length * np.abs(np.cos(turn)) + width * np.abs(np.sin(turn)))
            across = 0.5 * (length * np.abs(np.sin(turn)) + width * np.abs(np.cos(turn)))
            gap = at - along - s[steps] - car.axle_to_front
            side = aside - l[steps]
            room = np.minimum(np.abs(side), np.abs(aside)) - across - 0.5 * car.width
            coming = -w * np.sign(side)
            room -= COMING_S * np.where(coming > DRIFT_MPS, coming, 0.0)
            near = room <= (SIDE_VULNERABLE_M if tracks.kinds[i].is_vulnerable else SIDE_M)
            ahead = gap + 2.0 * along + car.length > 0.0
            leaves = (u > v[steps] + 1.0) & (gap > 2.0 + 0.5 * v[steps])
            look = _look_ahead(v[steps], u)
            flags[0, steps] = near & ahead & ~leaves & (gap <= look)
            flags[1, steps] = near & ahead & (gap <= NEAR_M)
            beside = near & (gap + 2.0 * along + car.length > -NEAR_M)
            flags[2, steps], flags[3, steps] = beside & (gap <= look), beside & ~leaves
        yield flags


def _places_to_stop(
    trace: Trace, scenario: Scenario, t: FloatArray, line: ReferenceLine
) -> Iterator[tuple[float, float, BoolArray, float]]:
    """Yield places where rules stop the ego: first and last station, when `(k,)`, and how near it
    may stand, m.
    """
    always, route, goal = np.ones(len(t), np.bool_), route_of(scenario), scenario.goal
    lights = {light.id: light for light in scenario.lights}
    for mark in scenario.road.stop_lines:
        at, aside = line.project(*mark.points.mean(axis=0).tolist())
        if abs(aside) < 0.5 * float(np.hypot(*np.diff(mark.points, axis=0)[0])) + ACROSS_M:
            light = lights.get(mark.light) if mark.light is not None else None
            shut = (
                always
                if light is None
                else np.array([light.at(now) is not Colour.GREEN for now in t])
            )
            yield at, at + ACROSS_M, shut, LINE_M
    zones = []
    # Active while a pedestrian or rider is within `NEAR_M` of its bounding box
    for walk in scenario.road.crosswalks:
        low, high = walk.polygon.min(axis=0) - NEAR_M, walk.polygon.max(axis=0) + NEAR_M
        walked = np.zeros(len(t), np.bool_)
        for i, others, row in each(trace.agents, t):
            if trace.agents.kinds[i].is_vulnerable:
                x, y = others.pose[:2, row]
                walked |= (
                    others.there[row] & (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
                )
        zones.append((walk.polygon, walked))
    zones += [(lane.polygon, always) for lane in scenario.road.lanes.values() if lane.yields_to]
    for polygon, active in zones:
        on = line.s[points_inside(polygon, *line.xy.T)]
        if len(on):
            yield float(on[0]), float(on[-1]), active, NEAR_M
    yield line.length, np.inf, always, NEAR_M
    # A goal that asks for no speed is driven through
    if goal is not None and np.isfinite(route.length):
        yield (route.far if goal.v is None else route.length), np.inf, always, NEAR_M
    elif scenario.is_recorded:
        yield (
            float(line.project(scenario.ego.x[-1], scenario.ego.y[-1], route.length)[0]),
            np.inf,
            always,
            NEAR_M,
        )


def _braking(trace: Trace, scenario: Scenario) -> Measured:
    found, top = reasons(trace, scenario), -np.inf
    lost = np.full(len(found.t), np.nan)
    for k in np.flatnonzero(~found.slow):
        top = max(found.v[k], -np.inf if k and found.slow[k - 1] else top)
        lost[k] = top - found.v[k]
    return Series(found.t, lost, missing=_ALWAYS)  # (2)


def _standing(trace: Trace, scenario: Scenario) -> Measured:
    found = reasons(trace, scenario)
    return Series(found.t, ((np.abs(found.v) < STANDS_MPS) & ~found.stand).astype(float))  # (3)


def _steering(trace: Trace, scenario: Scenario) -> Measured:
    found, counts = reasons(trace, scenario), np.zeros(len(reasons(trace, scenario).t))
    for a, b in pairwise(turning_points(found.l, SWING_M)):
        # (4)
        if abs(found.l[b] - found.l[a]) < CHANGE_M and not found.steer[a : (a + b) // 2 + 1].any():
            counts[b] += 1.0
    return Series(found.t, counts)


@once
def falls(trace: Trace, scenario: Scenario) -> tuple[tuple[float, float], ...]:
    """Return the falls of the speed by `FALL_MPS` or more without a reason, between two turning
    points: s from, to.
    """
    found, out = reasons(trace, scenario), []
    for steps in np.split(np.arange(len(found.t)), np.flatnonzero(np.diff(found.slow)) + 1):
        v = found.v[steps]
        for a, b in pairwise(turning_points(v, FALL_MPS)) if not found.slow[steps[0]] else ():
            if v[b] < v[a]:
                begin = a + np.flatnonzero(v[a : b + 1] >= v[a] - SLACK_MPS)[-1]
                out.append((float(found.t[steps[begin]]), float(found.t[steps[b]])))
    return tuple(out)


def turning_points(value: FloatArray, least: float) -> list[int]:
    """Return the steps at which a value turns back by at least `least`, and the ends of the first
    and last change.
    """
    turns: list[int] = []
    rising, low, high = 0, 0, 0
    for k in range(len(value)):
        low = k if value[k] < value[low] else low
        high = k if value[k] > value[high] else high
        if rising >= 0 and value[high] - value[k] >= least:
            turns, rising, low, high = [*turns, high], -1, k, k
        elif rising <= 0 and value[k] - value[low] >= least:
            turns, rising, low, high = [*turns, low], 1, k, k
    return [*turns, high if rising > 0 else low] if turns else []


_ALWAYS = "something called for it all the time"
_SHARED = (
    f"look {NEAR_M:g} m + {HEADWAY_S:g} s v + (v - u)^2 / {2.0 * EASE_MPS2:g} m/s2",
    f"coming within {COMING_S:g} s",
    f"a reason lasts {AFTER_S:g} s longer",
)
NEEDLESS_BRAKING = Metric(
    "needless_braking",
    "m/s",
    "lower",
    (Mode.CLOSED,),
    _braking,
    (MAX,),
    "Speed that the ego lost while no road user, rule, limit, curve, goal or end of the route "
    "ahead called for it.",
    formula="highest speed since the last reason - v",
    parameters=_SHARED,
    needs="a time without a reason to brake",
)
NEEDLESS_STANDING = Metric(
    "needless_standing",
    "1",
    "lower",
    (Mode.CLOSED,),
    _standing,
    (worst_episode(-np.inf, 0.5),),
    "1 while the ego stands and no reason to stand is near.",
    formula="[v < 0.5 m/s and no reason within 10 m ahead, no stop line within 6 m]",
    parameters=_SHARED,
)
NEEDLESS_STEERING = Metric(
    "needless_steering",
    "count",
    "lower",
    (Mode.CLOSED,),
    _steering,
    (COUNT,),
    "Swings of the ego's offset from the route by 0.5 m to 2 m with no road user and no curve "
    "near.",
    formula="sum of the changes between two turning points",
    parameters=_SHARED,
)


def hard_episodes(ego: Trajectory) -> list[int]:
    """The steps at which the episodes (5) begin."""
    hard = np.flatnonzero(ego.a < -HARD_MPS2)
    return [
        int(k)
        for i, k in enumerate(hard)
        if i == 0 or ego.t[k] - ego.t[hard[i - 1]] > APART_S + 1e-9
    ]


@kernel
def _any_touches(way: FloatArray, car: EgoOutline, others: OtherBoxes) -> bool:
    """Return whether any of the boxes `(n, k)` overlaps the ego at any pose of its rear axle: x, y,
    yaw `(3, m)`.
    """
    for j in range(way.shape[1]):
        x, y, yaw = (
            way[0, j] + car.axle * cos(way[2, j]),
            way[1, j] + car.axle * sin(way[2, j]),
            way[2, j],
        )
        for i in range(others.there.shape[0]):
            for k in range(others.there.shape[1]):
                if others.there[i, k] and touches(x, y, yaw, car, others, i, k):
                    return True
    return False


def _false_braking(trace: Trace, scenario: Scenario) -> Measured:
    ego, car = grid_of(trace), car_of(scenario)
    wider, value = car._replace(width=car.width + 2.0 * CAUSE_M), np.full(len(ego.t), np.nan)
    for k in hard_episodes(ego):
        begin = float(ego.t[k])
        drive = trace.ego.resampled(np.r_[begin, trace.ego.t[trace.ego.t > begin]])
        s = arc_lengths(drive.x, drive.y)
        at = np.arange(0.0, max(float(drive.v[0]), 0.0) * CAUSE_S + SPACING_M, SPACING_M)
        beyond = np.maximum(at - s[-1], 0.0)
        x, y, yaw = (np.interp(at, s, column) for column in (drive.x, drive.y, drive.yaw))
        way = np.stack([x + beyond * np.cos(yaw), y + beyond * np.sin(yaw), yaw])
        t = begin + GRID_S * np.arange(round(CAUSE_S / GRID_S) + 1)
        value[k] = not _any_touches(way, wider, others_at(trace.agents, t))  # (6)
    return Series(ego.t, value, missing="the ego never brakes hard")


def _missed_braking(trace: Trace, scenario: Scenario) -> Measured:
    found = ahead_of(trace, scenario)
    closing = np.maximum(found.v - found.u, 0.0)
    required = closing**2 / (2.0 * np.maximum(found.gap, TOUCHING_M))
    value = np.maximum(required - np.maximum(-found.a, 0.0), 0.0)
    return Series(found.t, value, labels_of(trace, found.agent), missing="the path ahead was free")


FALSE_BRAKING = Metric(
    "false_braking",
    "1",
    "lower",
    (Mode.CLOSED,),
    _false_braking,
    (RATE, COUNT),
    "1 where a hard braking begins after which no road user comes near the ego's way, 0 where one "
    "does.",
    formula="[no road user within 0.3 m of the way ahead within 5 s]",
    parameters=(
        f"hard below -{HARD_MPS2:g} m/s2",
        f"apart {APART_S:g} s",
        f"near {CAUSE_M:g} m",
        f"within {CAUSE_S:g} s",
    ),
    needs="a hard braking",
)
MISSED_BRAKING = Metric(
    "missed_braking",
    "m/s2",
    "lower",
    (Mode.CLOSED,),
    _missed_braking,
    (MAX,),
    "Deceleration that a steady approach behind the one ahead in the path asks beyond the ego's.",
    formula="max((v - u)^2 / (2 gap) - b, 0)",
    parameters=(f"gap at least {TOUCHING_M:g} m",),
    needs="a road user ahead in the path",
)


SETTLES_S, KEPT_S, JUDGED_S, RETURN_MPS = 4.0, 10.0, 8.0, 0.1
LEAST_S = 20.0
CALLED_S, CROSSED = 6.0, 0.7
MEAN_S = 1.0


def _lane_offset(trace: Trace, scenario: Scenario) -> Measured:
    if (lanes := mapped_lanes(scenario.road)) is None:
        return NO_LANES
    ego, found = grid_of(trace), reasons(trace, scenario)
    left = under(lanes, *ego_boxes(ego, scenario)[:3]).left
    settled = ego.t - ego.t[0] >= max(SETTLES_S, np.nan_to_num(abs(left[0])) / RETURN_MPS)
    passed = ego.t - np.maximum.accumulate(np.where(found.beside, ego.t, -np.inf)) > KEPT_S
    judged = settled & passed & ~found.steer & (np.abs(ego.v) >= STANDS_MPS) & np.isfinite(left)
    if judged.sum() * GRID_S < JUDGED_S:
        return Unavailable(
            f"less than {JUDGED_S:g} s on a lane without a reason to leave its middle"
        )
    return Series(ego.t, np.where(judged, left, np.nan))


def _kept(series: Series) -> tuple[float, int]:
    """Return the offset that is kept for three quarters of the time, on one side; 0 if there is
    none.
    """
    low, high = np.quantile(series.value[series.known], [0.25, 0.75]).tolist()
    return max(low, -high, 0.0), -1


def _swing(trace: Trace, scenario: Scenario) -> Mapping[str, Measured]:
    found = reasons(trace, scenario)
    free, every = np.where(found.slow, np.nan, 0.0), np.zeros(len(found.t))
    for a, b in pairwise(turning_points(found.v, FALL_MPS)):
        every[b] = found.v[b] < found.v[a]
    for _, end in falls(trace, scenario):
        free[np.searchsorted(found.t, end - 1e-9)] = 1.0
    missing = "something called for slowing down all the time"
    return {"all": Series(found.t, every), "needless": Series(found.t, free, missing=missing)}


def _per_minute(series: Series) -> tuple[float, int]:
    free = float(durations(series.t)[series.known].sum())
    return 60.0 * float(np.nansum(series.value)) / max(free, LEAST_S), first_of(series.value > 0.0)


def _lane_change(trace: Trace, scenario: Scenario) -> Measured:
    if (lanes := mapped_lanes(scenario.road)) is None:
        return NO_LANES
    ego, found, line = grid_of(trace), reasons(trace, scenario), route_of(scenario).line
    s, counts = gain_along(route_of(scenario), ego).metres, np.zeros(len(ego.t))
    route = [
        (line.s[k], side) for k, side in _crossings(lanes, line.xy[:, 0], line.xy[:, 1], line.yaw)
    ]
    x, y, yaw = ego_boxes(ego, scenario)[:3]
    for k, side in _crossings(lanes, x, y, yaw):
        called = found.change[(ego.t >= ego.t[k] - CALLED_S) & (ego.t <= ego.t[k])].any()
        towards = found.l[k] * side < 0.0 or any(one == side and at > s[k] for at, one in route)
        counts[k] = not called and not towards
    return Series(ego.t, counts)


def _crossings(
    lanes: LaneArrays, x: FloatArray, y: FloatArray, yaw: FloatArray
) -> list[tuple[int, float]]:
    """Return where a drive crosses into the lane beside: the first step in it, and the side, 1
    left, -1 right.
    """
    found = under(
        lanes, np.ascontiguousarray(x), np.ascontiguousarray(y), np.ascontiguousarray(yaw)
    )
    share = np.nan_to_num(found.left / found.half)
    steps = np.flatnonzero(
        (share[:-1] * share[1:] < 0.0) & (np.minimum(abs(share[:-1]), abs(share[1:])) > CROSSED)
    )
    return [(k + 1, float(np.sign(share[k]))) for k in steps.tolist()]


def _braked_behind(trace: Trace, scenario: Scenario) -> Measured:
    if len(trace.ego) < 2:
        return Unavailable("the drive holds one ego state only")
    stays, spans = [], falls(trace, scenario)
    for seen in followers(trace.ego, trace.agents, scenario) if spans else ():
        for begin, end in spans:
            first, last = np.searchsorted(seen.ego.t, [begin - 1e-6, end + HORIZON_S]).tolist()
            if first < len(seen.ego) and seen.ahead[first] and seen.deep[first] >= IN_M:
                forced, t = (
                    seen.needed(first, min(last, len(seen.ego)) - 1),
                    np.arange(0.0, HORIZON_S, GRID_S),
                )
                kept = seen.rear[first] - seen.front[first] + float(seen.ego.v[first]) * t
                anyway = needed_deceleration(t, kept, float(seen.u[first]))
                stays.append(CutInStay(begin, end + AFTER_S, seen.agent, max(forced - anyway, 0.0)))
    missing = "the ego never slowed down without a reason before a follower"
    return worst_forced(
        trace, stays, scenario, "the ego slowed down before it without a reason", missing
    )


def _curve_accel(trace: Trace, scenario: Scenario) -> Measured:
    t, accel = trace.ego.t, lat_accel(trace.ego)
    total = np.r_[0.0, np.cumsum(0.5 * np.diff(t) * (accel[1:] + accel[:-1]))]
    mean = (total - np.interp(t - MEAN_S, t, total)) / MEAN_S
    return Series(
        t,
        np.where(t - MEAN_S >= t[0] - 1e-9, np.abs(mean), np.nan),
        missing="the drive is shorter than 1 s",
    )


_CLOSED, _LANES = (Mode.CLOSED,), "lanes in the log"
LANE_OFFSET = Metric(
    "lane_offset",
    "m",
    "lower",
    _CLOSED,
    _lane_offset,
    (Reduction("kept", _kept), MAX_ABS),
    "Offset from the middle of the lane that the ego keeps while nothing calls for it.",
    "NAVSIM's lane keeping (EPDMS): 0.5 m for 2 s",
    formula="the largest d with |l| >= d on one side in three quarters of the judged time",
    needs=_LANES,
    parameters=(f"judged for {JUDGED_S:g} s", f"an offset of the start goes with {RETURN_MPS} m/s"),
)
SPEED_SWING = Metric(
    "speed_swing",
    "count",
    "lower",
    _CLOSED,
    _swing,
    (Reduction("per_minute", _per_minute, "1/min", empty=0.0), COUNT),
    "Falls of the ego's speed by 0.5 m/s or more: all of them, and those while nothing called for "
    "slowing down.",
    formula="sum of the falls; per minute, of the time without a reason for the needless ones",
    parameters=(f"fall {FALL_MPS} m/s", f"at least {LEAST_S:g} s"),
    parts=("all", "needless"),
)
NEEDLESS_LANE_CHANGE = Metric(
    "needless_lane_change",
    "count",
    "lower",
    _CLOSED,
    _lane_change,
    (COUNT,),
    "Lane changes of the ego away from its route while no road user was in its way.",
    formula="sum of the crossings of a line between lanes that nothing called for",
    parameters=(f"a road user in the way in the last {CALLED_S:g} s",),
    needs=_LANES,
)
BRAKED_BEHIND = Metric(
    "braked_behind",
    "m/s2",
    "lower",
    _CLOSED,
    _braked_behind,
    (MAX,),
    "Deceleration that the ego forces on a follower by slowing down without a reason.",
    "UN R79, 5.6.4.7: 3 m/s2; UN R157, 5.2.5.2 for the reaction time",
    formula="as forced_braking, from the begin of each needless fall of speed_swing",
    parameters=(f"reaction {REACT_S} s", f"horizon {HORIZON_S:g} s", f"at most {MOST_MPS2} m/s2"),
    needs="a fall of the speed by 0.5 m/s without a reason, and a follower",
)
CURVE_ACCEL = Metric(
    "curve_accel",
    "m/s2",
    "lower",
    _CLOSED,
    _curve_accel,
    (MAX,),
    "Lateral acceleration that lasts: its mean over 1 s.",
    "UN R79, 5.6.2.1.3 and ISO 11270: 3 m/s2",
    formula="|mean of v^2 kappa over 1 s|",
    parameters=(f"mean over {MEAN_S:g} s",),
    needs="a drive of 1 s",
)
STEADINESS = (LANE_OFFSET, SPEED_SWING, NEEDLESS_LANE_CHANGE, BRAKED_BEHIND, CURVE_ACCEL)
