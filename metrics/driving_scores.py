"""The scores of nuPlan and CARLA, computed from drives.

(1) score = product of the multipliers x (sum of weight x part) / (sum of weights)

Every part is in 0 .. 1, and the table shows it beside its score. A multiplier that cannot be
measured makes the score unavailable, unless it is optional (no traffic lights, no stop signs); the
row of the score then names it ("without: red lights").

The scores of NAVSIM judge plans of 4 s: `replan.score`.
nuPlan, open loop, over the horizons 3, 5 and 8 s that the log allows (devkit e9241677):
(2) miss x (ade + fde + 2 ahe + 2 fhe) / 6
CARLA leaderboard 2.x, in 0 .. 1:
(3) completion x penalties x red_lights x stop_signs x inside_lanes

    miss              1 where at most 0.3 of the plans miss at each horizon; a plan that does not
                      reach it misses
    ade, fde; ahe, fhe   1 where the mean over frames and horizons is at most 8 m; 0.8 rad
    penalties         0.5 per pedestrian touched, 0.6 per vehicle, 0.65 per object, regardless of
                      fault
    red_lights, stop_signs   0.7 and 0.8 per crossing
    inside_lanes      share of the distance that was driven neither off the lanes nor against them

nuPlan's closed-loop score (CLS), part by part as the devkit e9241677 computes it:

(4) collisions x drivable x direction x making_progress x (5 progress + 5 ttc + 4 speed_limit + 2
    comfort) / 16

The drive is sampled at 10 Hz if it has smaller steps. The route of the ego's centre, and the lanes
of its corners, are those of `lane_map`. The ego is astray while its corners are neither in one lane
nor in joined lanes. v is the ego's speed at its centre, u an agent's (of objects: 0):

    collisions    product over {pedestrians and riders, vehicles, objects} of max(0, 1 - n / (1, 1,
                  2)), n at fault. Each agent counts at its first contact, also if it appears there.
                  The kinds are those of `safety`, without its additions. At fault: into what
                  stands, with the front, with the side while astray
    ttc           0 with a contact at fault, or if both boxes, moved along their headings for 0.1,
        ... 0.9 s, touch.
                  v <= 0.005 m/s: 1. Agents count until their first contact:
                      those less than 30 degrees off the heading seen from the rear axle; while the
                      ego is astray or its rear axle is in an intersection, up to 150
    drivable      0 where a corner is on no lane and at least 0.3 m off lanes and areas
    direction     1, 0.5, 0: the centre's way along the first lane of its route in the last 11
                  samples is at worst
                  above -2 m, -6 m, below
    progress      (5) of the drive over that of the log's driver, each at least 2 m, at most 1; 0
                  below -2 m
    making_progress   1 where progress is at least 0.2
    speed_limit   max(0, 1 - mean step x sum of max(v - limit, 0) / (2.23 m/s x duration));
        the limit of a connector
                  is the greatest of the lanes before and behind it; without a limit nothing is
                  exceeded
    comfort       1 where the six signals of `comfort.NUPLAN_BOUNDS` are within them,
        filtered as there. Along the
                  body: a + d (w^2 + dw/dt), w the yaw rate, d from the rear axle to the centre,
                      the devkit's own formula. Its simulator writes a lateral acceleration of 0, so
                      that this bound never acts

(5) gain = sum over the steps of the change of the station on the centre line
        of the route's roadblock under the centre. Roadblocks follow one another; the way over one
        that was skipped counts. Off them nothing is gained.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import cos, hypot, prod, sin
from types import MappingProxyType

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.kernel import kernel
from replan.core.once import once
from replan.logs.agents import AgentKind
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.shapes import overlap
from replan.logs.states import Trajectory
from replan.logs.trace import Mode, Trace
from replan.metrics import plans, progress, safety, traffic_rules
from replan.metrics.boxes import (
    NO_TTC_MPS,
    STANDING_MPS,
    EgoOutline,
    OtherBoxes,
    car_of,
    ego_boxes,
    is_behind,
    pieces,
    touches,
)
from replan.metrics.comfort import NUPLAN_BOUNDS, savgol
from replan.metrics.lanes import DrivableLanes, Route, along_line, lane_map
from replan.metrics.metric import FINAL, Measured, Metric, Series, Unavailable

MISS_SHARE, NEAR_M, NEAR_RAD = 0.3, 8.0, 0.8
OPEN_HORIZONS_S = (3, 5, 8)
CARLA_HITS = MappingProxyType({AgentKind.PEDESTRIAN: 0.5, AgentKind.OBJECT: 0.65})
CARLA_VEHICLE, CARLA_RED, CARLA_STOP = 0.6, 0.7, 0.8
Value = float | Unavailable
Part = Callable[[Trace, Scenario], Value]


@dataclass(frozen=True, slots=True)
class Formula:
    """How a score is computed from its parts (1)."""

    multipliers: tuple[str, ...]  # Names in `PARTS`
    weights: Mapping[str, float]  # Weight by name in `PARTS`; empty: the score is the product
    # Multipliers that are left out where they cannot be measured
    optional: frozenset[str] = frozenset()

    @property
    def names(self) -> tuple[str, ...]:
        """All parts."""
        return (*self.multipliers, *self.weights)


def _penalties(trace: Trace, scenario: Scenario) -> Value:
    met = [
        c for c in safety.contacts(trace, scenario) if c.kind is not safety.ContactKind.FROM_START
    ]
    return prod(
        (CARLA_HITS.get(trace.agents.kinds[c.agent], CARLA_VEHICLE) for c in met), start=1.0
    )


def _inside_lanes(trace: Trace, scenario: Scenario) -> Value:
    off, against = (
        metric.found(trace, scenario) for metric in (safety.OFF_ROAD, traffic_rules.WRONG_WAY)
    )
    if not isinstance(off, Series) or not isinstance(against, Series):
        return next(found for found in (off, against) if isinstance(found, Unavailable))
    wrong = (off.value > safety.OFF_ROAD_M) | (against.value > traffic_rules.AGAINST_MPS)
    metres = np.hypot(np.diff(trace.ego.x), np.diff(trace.ego.y))
    return 1.0 - float(metres[wrong[1:]].sum() / metres.sum()) if metres.sum() > 0.0 else 1.0


def _part_of(metric: Metric, judge: Callable[[list[Series]], float]) -> Part:
    """Return a part that is computed from a metric's series, or from those at nuPlan's horizons
    that the log covers.
    """

    def part(trace: Trace, scenario: Scenario) -> Value:
        found = metric.found(trace, scenario)
        if not isinstance(found, Mapping):
            return found if isinstance(found, Unavailable) else float(judge([found]))
        allowed = [
            one for one in (found[f"{h}s"] for h in OPEN_HORIZONS_S) if isinstance(one, Series)
        ]
        nothing = Unavailable(f"the log ends less than {OPEN_HORIZONS_S[0]} s after every frame")
        return float(judge(allowed)) if allowed else nothing

    return part


def _mean_within(bound: float, found: list[Series]) -> bool:
    values = np.concatenate([series.value[series.known] for series in found])
    return len(values) > 0 and float(values.mean()) <= bound


PARTS: Mapping[str, Part] = MappingProxyType(
    {
        "completion": _part_of(progress.COMPLETION, lambda found: found[0].value[-1]),
        "penalties": _penalties,
        "red_lights": _part_of(
            traffic_rules.RED_LIGHT, lambda found: CARLA_RED ** float(np.nansum(found[0].value))
        ),
        "stop_signs": _part_of(
            traffic_rules.STOP_SIGN, lambda found: CARLA_STOP ** float(np.nansum(found[0].value))
        ),
        "inside_lanes": _inside_lanes,
        "miss": _part_of(
            plans.MISS,
            lambda found: all(np.mean(~(one.value == 0.0)) <= MISS_SHARE for one in found),
        ),
        "ade": _part_of(plans.ADE, partial(_mean_within, NEAR_M)),
        "fde": _part_of(plans.FDE, partial(_mean_within, NEAR_M)),
        "ahe": _part_of(plans.AHE, partial(_mean_within, NEAR_RAD)),
        "fhe": _part_of(plans.FHE, partial(_mean_within, NEAR_RAD)),
    }
)

NUPLAN_CLOSED = Formula(
    ("collisions", "drivable", "direction", "making_progress"),
    {"progress": 5.0, "ttc": 5.0, "speed_limit": 4.0, "comfort": 2.0},
)
NUPLAN_OPEN = Formula(("miss",), {"ade": 1.0, "fde": 1.0, "ahe": 2.0, "fhe": 2.0})
CARLA = Formula(
    ("completion", "penalties", "red_lights", "stop_signs", "inside_lanes"),
    {},
    frozenset({"red_lights", "stop_signs"}),
)


def combined(formula: Formula, parts: Mapping[str, Value]) -> tuple[Value, str]:
    """Return (1), and the label that names the parts left out."""
    for name in formula.multipliers:
        if isinstance(value := parts[name], Unavailable) and name not in formula.optional:
            return Unavailable(f"{name.replace('_', ' ')}: {value.reason}"), ""
    known = {name: value for name, value in parts.items() if not isinstance(value, Unavailable)}
    weight = sum(weight for name, weight in formula.weights.items() if name in known)
    if formula.weights and not weight:
        return Unavailable("no part of the weighted mean can be measured"), ""
    mean = sum(
        weight * known[name] for name, weight in formula.weights.items() if name in known
    ) / (weight or 1.0)
    product = prod((known[name] for name in formula.multipliers if name in known), start=1.0)
    left_out = ", ".join(name.replace("_", " ") for name in formula.names if name not in known)
    return product * (mean if formula.weights else 1.0), f"without: {left_out}" if left_out else ""


def _scores(formula: Formula, trace: Trace, scenario: Scenario) -> Mapping[str, Measured]:
    if formula is NUPLAN_CLOSED:
        found = closed_loop_parts(trace, scenario)
        parts = {
            name: found if isinstance(found, Unavailable) else found[name] for name in formula.names
        }
    else:
        parts = {name: PARTS[name](trace, scenario) for name in formula.names}
    total, label = combined(formula, parts)
    rows = {"score": (total, label), **{name: (value, "") for name, value in parts.items()}}
    return {
        name: value
        if isinstance(value, Unavailable)
        else Series(trace.ego.t[-1:], np.array([value]), (words,))
        for name, (value, words) in rows.items()
    }


def _score_metric(
    name: str,
    formula: Formula,
    mode: Mode,
    meaning: str,
    source: str,
    text: str,
    needs: str,
    version: int = 1,
) -> Metric:
    return Metric(
        name,
        "1",
        "higher",
        (mode,),
        partial(_scores, formula),
        (FINAL,),
        meaning,
        source,
        version,
        parts=("score", *formula.names),
        formula=text,
        needs=needs,
        parameters=tuple(
            f"weight of {part} {weight:g}" for part, weight in formula.weights.items()
        ),
    )


NUPLAN_CLOSED_SCORE = _score_metric(
    "nuplan_closed",
    NUPLAN_CLOSED,
    Mode.CLOSED,
    "nuPlan's closed-loop score, as its devkit computes it for the same drive. A drive that ends "
    "early is judged until"
    " then, and by the progress of the whole log.",
    "nuPlan devkit e9241677, closed_loop_nonreactive_agents_weighted_average",
    "collisions x drivable x direction x making_progress x (5 progress + 5 ttc + 4 speed_limit + 2 "
    "comfort) / 16",
    "lanes, a logged drive",
    version=2,
)
NUPLAN_OPEN_SCORE = _score_metric(
    "nuplan_open",
    NUPLAN_OPEN,
    Mode.OPEN,
    "nuPlan's open-loop score. It differs: plans are compared at 10 Hz and at the rear axle, a "
    "plan that does not reach"
    " a horizon misses there, horizons beyond the log are left out.",
    "nuPlan devkit e9241677, open_loop_boxes_weighted_average",
    "miss x (ade + fde + 2 ahe + 2 fhe) / 6",
    "a logged drive of 3 s after some frame",
)
CARLA_SCORE = _score_metric(
    "carla",
    CARLA,
    Mode.CLOSED,
    "CARLA's driving score, in 0 .. 1. It differs: the drive ends at a collision; no penalties for "
    "a time-out, for"
    " yielding to emergency vehicles and for too little speed; outside are the lanes' edge and "
    "oncoming lanes.",
    "CARLA leaderboard 2.x aec81319, statistics_manager.py",
    "completion x 0.5^pedestrians x 0.6^vehicles x 0.65^objects x 0.7^red lights x 0.8^stop signs "
    "x inside_lanes",
    "lanes, a route with a goal or a logged drive of 10 m",
)


AHEAD = cos(30.0 / 180.0 * np.pi)
CORNERS = 0.5 * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
"""Front left, rear left, rear right, front right: shares of length and width from the centre."""
OFF_M, LEAST_M, LEAST_SHARE, EXCESS_MPS = 0.3, 2.0, 0.2, 2.23
COMPLIANT_M, HALF_M, DIRECTION_S = 2.0, 6.0, 1.0
NO_LANES = Unavailable("the log has no lanes: the scores of nuPlan and NAVSIM need them")
LEAST_STATES, STEP_S = 6, 0.1
SHORT = Unavailable(f"the drive or the log's has fewer than {LEAST_STATES} states at 10 Hz")


def corners_of(
    x: FloatArray, y: FloatArray, yaw: FloatArray, car: EgoOutline
) -> tuple[FloatArray, FloatArray]:
    """Return the corners `(4, k)` of boxes with these centres."""
    ahead, left = CORNERS[:, :1] * car.length, CORNERS[:, 1:] * car.width
    return x + ahead * np.cos(yaw) - left * np.sin(yaw), y + ahead * np.sin(yaw) + left * np.cos(
        yaw
    )


@once
def closed_loop_parts(trace: Trace, scenario: Scenario) -> Mapping[str, float] | Unavailable:
    """Return the parts of `NUPLAN_CLOSED` of a drive."""
    lanes = None if scenario.road.source is RoadSource.DRIVEN_PATH else lane_map(scenario.road)
    if lanes is None:
        return NO_LANES
    ego, car = _at_10_hz(trace.ego), car_of(scenario)
    if min(len(scenario.ego), len(ego)) < LEAST_STATES:
        return SHORT
    boxes = ego_boxes(ego, scenario)
    x, y, yaw = boxes[:3]
    speed, corners = np.hypot(boxes[3], boxes[4]), corners_of(x, y, yaw, car)
    route, lanes_of_corners = lanes.route(x, y), lanes.corner_routes(*corners)
    astray = np.array([not lanes.in_one(four) for four in lanes_of_corners])
    wide = astray | lanes.in_intersection(ego.x, ego.y)
    kinds = trace.agents.kinds
    objects = np.array([kind is AgentKind.OBJECT for kind in kinds], np.bool_)
    rear = np.stack([ego.x, ego.y, yaw, speed])
    fault, met, close = np.zeros(len(kinds), np.bool_), np.zeros(len(kinds), np.bool_), False
    for k, seen, others in pieces(trace.agents, ego.t):
        some = objects[seen], astray[k], wide[k], met[seen]
        fault[seen], met[seen], near = _meetings(rear[:, k], boxes[:, k], car, others, *some)
        close |= near
    hit = [kinds[i] for i in np.flatnonzero(fault)]
    progress = _progress(lanes, ego_boxes(scenario.ego, scenario), x, y)
    return {
        "collisions": collision_score(hit),
        "drivable": float(not _leaves_road(lanes, lanes_of_corners, *corners)),
        "direction": _direction(lanes, route, x, y, ego.t),
        "making_progress": float(progress >= LEAST_SHARE),
        "progress": progress,
        "ttc": float(not hit and not close),
        "speed_limit": _speed_limit(lanes, scenario, route, speed, ego.t),
        "comfort": float(comfortable(_signals(ego, scenario.vehicle.axle_to_center))),
    }


def _at_10_hz(ego: Trajectory) -> Trajectory:
    """Return a drive as nuPlan's loop steps.

    A drive with steps of more than half of 0.1 s as it is.
    """
    steps = int((ego.t[-1] - ego.t[0]) / STEP_S + 1e-6) + 1
    fine = len(ego) > 1 and float(np.mean(np.diff(ego.t))) < 0.5 * STEP_S
    return (
        ego.resampled(np.minimum(ego.t[0] + STEP_S * np.arange(steps), ego.t[-1])) if fine else ego
    )


def collision_score(hit: Sequence[AgentKind]) -> float:
    """Return `collisions` from the kinds of those hit at fault."""
    vulnerable, objects = sum(kind.is_vulnerable for kind in hit), list(hit).count(AgentKind.OBJECT)
    counts = (vulnerable, 1), (len(hit) - vulnerable - objects, 1), (objects, 2)
    return prod(max(0.0, 1.0 - n / allowed) for n, allowed in counts)


@kernel
def _meetings(
    rear: FloatArray,
    box: FloatArray,
    car: EgoOutline,
    others: OtherBoxes,
    objects: BoolArray,
    astray: BoolArray,
    wide: BoolArray,
    met: BoolArray,
) -> tuple[BoolArray, BoolArray, bool]:
    """Return which agents the ego hits at fault and has met `(n,)`, and whether it comes too close
    in time to one.

    `rear` is x, y, yaw of the rear axle and the speed `(4, k)`; `wide`: where agents up to 150
    degrees count for ttc; `met`: agents that it has met before.
    """
    there, pose, size = others.there, others.pose, others.size
    fault, close = np.zeros(len(there), np.bool_), False
    for i in range(len(there)):
        for k in range(there.shape[1]):
            if met[i] or not there[i, k]:
                continue
            x, y, yaw, v = rear[0, k], rear[1, k], rear[2, k], rear[3, k]
            px, py, heading = pose[0, i, k], pose[1, i, k], pose[2, i, k]
            u = 0.0 if objects[i] else hypot(pose[3, i, k], pose[4, i, k])
            if touches(box[0, k], box[1, k], yaw, car, others, i, k):
                met[i] = True
                if v > STANDING_MPS:
                    nose_x, nose_y = x + car.front * cos(yaw), y + car.front * sin(yaw)
                    fault[i] = u <= STANDING_MPS or (
                        not is_behind(x, y, yaw, px, py)
                        and (
                            overlap(
                                nose_x,
                                nose_y,
                                yaw,
                                0.0,
                                car.width,
                                px,
                                py,
                                heading,
                                size[i, 0],
                                size[i, 1],
                            )
                            or astray[k]
                        )
                    )
                break
            ahead, away = (px - x) * cos(yaw) + (py - y) * sin(yaw), hypot(px - x, py - y)
            if close or v <= NO_TTC_MPS or (v + u) < away - 20.0 - size[i, 0]:
                continue
            if ahead <= AHEAD * away and (not wide[k] or is_behind(x, y, yaw, px, py)):
                continue
            for step in range(1, 10):
                mine, theirs = 0.1 * step * v, 0.1 * step * u
                if overlap(
                    box[0, k] + mine * cos(yaw),
                    box[1, k] + mine * sin(yaw),
                    yaw,
                    car.length,
                    car.width,
                    px + theirs * cos(heading),
                    py + theirs * sin(heading),
                    heading,
                    size[i, 0],
                    size[i, 1],
                ):
                    close = True
                    break
    return fault, met, close


def _leaves_road(
    lanes: DrivableLanes, found: Sequence[Sequence[tuple[int, ...]]], x: FloatArray, y: FloatArray
) -> bool:
    """Return whether a corner `(4, k)` that is on no lane is `OFF_M` off the road."""
    for corner in range(4):
        lost = np.array([not four[corner] for four in found])
        if (
            lost.any()
            and not np.isfinite(lanes.off_road(x[corner, lost], y[corner, lost], OFF_M)).all()
        ):
            return True
    return False


def _station(line: FloatArray, x: float, y: float) -> float:
    return float(along_line(line, np.array([x]), np.array([y]))[0][0])


def _direction(
    lanes: DrivableLanes, route: Route, x: FloatArray, y: FloatArray, t: FloatArray
) -> float:
    gained, lane, before = np.zeros(len(x)), route[0][:1], np.nan
    for k, here in enumerate(route):
        if not here:
            continue
        if here[:1] == lane:
            station = _station(lanes.lanes[here[0]].center, x[k], y[k])
            gained[k] = station - before if np.isfinite(before) and station else 0.0
            before = station
        else:
            lane, before = here[:1], np.nan
    total, n = np.r_[0.0, np.cumsum(gained)], np.arange(1, len(x) + 1)
    samples = int(DIRECTION_S / np.mean(np.diff(t)) + 1e-9) + 1
    worst = abs(float((total[n] - total[np.maximum(n - samples, 0)]).min()))
    return 1.0 if worst < COMPLIANT_M else 0.5 if worst < HALF_M else 0.0


def route_lanes(lanes: DrivableLanes, x: FloatArray, y: FloatArray) -> list[int]:
    """Return the first lane of each roadblock that a drive of the centre comes through, in
    order.
    """
    simple: list[tuple[int, ...]] = []
    for here in lanes.route(x, y):
        if here and not (simple and set(here) & set(simple[-1])):
            simple.append(here)
    return [
        one[0]
        for k, one in enumerate(simple)
        if not k or lanes.block[one[0]] != lanes.block[simple[k - 1][0]]
    ]


def _progress(lanes: DrivableLanes, log: FloatArray, x: FloatArray, y: FloatArray) -> float:
    first = route_lanes(lanes, log[0], log[1])
    if not first:
        return 1.0
    own, driven = _gain(lanes, first, x, y), _gain(lanes, first, log[0], log[1])
    return 0.0 if own < -LEAST_M else min(1.0, max(own, LEAST_M) / max(driven, LEAST_M))


def _gain(lanes: DrivableLanes, first: Sequence[int], x: FloatArray, y: FloatArray) -> float:
    """Return (5) along the roadblocks of the lanes `first`, m."""
    under, blocks = lanes.under(x, y), np.array(lanes.block)
    inside = [under[blocks == lanes.block[i]].any(axis=0) for i in first]
    lines = [lanes.lanes[i].center for i in first]
    now, total, last = 0, 0.0, _station(lines[0], x[0], y[0])
    for k in range(1, len(x)):
        if inside[now][k]:
            here = _station(lines[now], x[k], y[k])
            total, last = total + here - last, here
            continue
        skipped = 0.0
        for then in range(now + 1, len(first)):
            if inside[then][k]:
                here = _station(lines[then], x[k], y[k])
                total += (
                    lanes.lanes[first[now]].length
                    - last
                    + skipped
                    + here
                    - _station(lines[then], *lines[now][-1])
                )
                now, last = then, here
                break
            if then + 1 < len(first):
                skipped += _station(lines[then], *lines[then + 1][0]) - _station(
                    lines[then], *lines[then - 1][-1]
                )
    return total


def _speed_limit(
    lanes: DrivableLanes, scenario: Scenario, route: Route, speed: FloatArray, t: FloatArray
) -> float:
    over = np.zeros(len(t))
    for k, here in enumerate(route):
        joined = [j for i in here for j in (*lanes.after[i], *lanes.before[i])]
        asked = joined if here and lanes.connector[here[0]] else here
        limits = [scenario.road.stated_limit(lanes.lanes[i].id) for i in asked]
        if limits and np.isfinite(limits).all():
            over[k] = max(0.0, speed[k] - max(limits))
    return float(max(0.0, 1.0 - over.sum() * np.mean(np.diff(t)) / (EXCESS_MPS * (t[-1] - t[0]))))


def _signals(ego: Trajectory, ahead: float) -> Mapping[str, FloatArray]:
    turn = ego.v * ego.kappa
    lon = ego.a + ahead * (turn**2 + np.gradient(turn, ego.t))
    return comfort_signals(
        lon, np.zeros(len(ego)), np.abs(ego.a), ego.yaw, float(np.mean(np.diff(ego.t)))
    )


def comfort_signals(
    lon: FloatArray,
    lat: FloatArray,
    size: FloatArray,
    yaw: FloatArray,
    step: float,
    windows: tuple[int, int] = (8, 15),
) -> Mapping[str, FloatArray]:
    """Return the six signals of nuPlan's comfort from accelerations along, across and as a whole,
    and the yaw.

    `windows` are those of the filters of accelerations and of jerks.
    """
    accel, jerk = windows
    return {
        "lon_accel": savgol(lon, accel, 2),
        "lat_accel": savgol(lat, accel, 2),
        "jerk": savgol(savgol(size, 8, 2), jerk, 2, 1, step),
        "lon_jerk": savgol(savgol(lon, 8, 2), jerk, 2, 1, step),
        "yaw_rate": savgol(yaw, 5, 2, 1, step),
        "yaw_accel": savgol(yaw, 5, 3, 2, step),
    }


def comfortable(signals: Mapping[str, FloatArray]) -> bool:
    """Return whether all signals are within nuPlan's bounds."""
    bounds = ((signals[name], low, high) for name, (_, low, high) in NUPLAN_BOUNDS.items())
    return all(((value > low) & (value < high)).all() for value, low, high in bounds)
