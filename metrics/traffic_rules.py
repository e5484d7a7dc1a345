"""Traffic rules, closed loop: red lights, stop signs, crosswalks, right of way, driving on the
correct side.

Crossing: the middle of the ego's front bumper passes a stop line in the direction of its lane, at
most `ASIDE_M` beside its ends. The line must apply to the route that the ego takes behind it: the
successor of the lane on which the drive lies longest must be one of those to which the line
applies. A drive that begins beyond a line or ends before it does not cross it.

    RED_LIGHT      crossings while the line's light shows red, or red and yellow
    YELLOW_LIGHT   crossings while it shows yellow, if the ego was farther from the line when the
                   yellow began than
                   (0) v `YELLOW_S` + v^2 / (2 `YELLOW_MPS2`): a reaction and a comfortable stop
    STOP_SIGN      crossings of a stop sign's line without a speed below 0.1 m/s in the last 5 m
                   before it
    CROSSWALK      pedestrians on the ego's half of a crosswalk while the ego drives on it, for each
                   passage: inside its
                   outline, and within `HALF_LANE_M` of the path of the ego's centre; a passage that
                   is under way when the drive begins is left out

The pedestrians are those of the drive: replayed pedestrians do not wait for an ego that does not
wait.

Right of way, closed loop: how much time the ego leaves to road users with priority.

By lanes: the ego drives on a lane that yields (`Lane.yields_to`), another road user on a lane with
priority, and the ego is the first of the two at the places that both boxes occupy:

(1) priority_gap = least t_j - t_i >= 0 over the ego's boxes i and the other's boxes j that overlap:
        the time from when the ego leaves a place until the other reaches it (post-encroachment
        time)

Both drives are sampled every `GRID_S`, from `AROUND_S` before the lane is entered until `AROUND_S`
after it is left.

Without lanes: another road user that moves (at least `MOVES_MPS`) has a box j at a place that the
ego left at most `WITHIN_S` earlier:

(2) yielding = t_j - t_i - FINE_S,
        t_i < t_j the last time at which the ego's box overlapped box j. The ego leaves the place
        between t_i and the next time of the grid, and the other reaches it between the time before
        t_j and t_j, so the error is at most FINE_S

in two parts. "recorded" uses pedestrians and crossing traffic (`encounters.CROSSING_RAD`) as
logged, because a road user that gives way to the ego would hide the violation; its boxes j are
those that the recorded driver reached only after t_j. "pedestrian" uses pedestrians as they moved
in the drive, independent of the recorded driver. The order is decided for each box, because a track
may change its id. The others must be in the ego's way for at least `SEEN_S` in total; less is a
flickering detection. Objects without a kind (`AgentKind.OBJECT`) have no right of way.

In replayed traffic the others do not brake for the ego, so the gap is what the ego left. Below 1 s
a gap is serious, below 1.5 s critical (Westhofen et al., Arch. Comput. Methods Eng. 30, 2023, from
the literature).

Side of the road, closed loop: driving against the direction of a lane, and off its centre line. The
lanes are those under the centre of the ego's box (`lanes.under`); where lanes cross, and beside the
road, nothing is judged. With the angle between the velocity vector and the best aligned lane there:

(3) wrong_way(t) = max(-v cos(angle), 0)                        speed against the lane, m/s
(4) worst_1s = max over t of the integral of (3) over (t - 1 s, t]
(5) lane_keeping(t) = distance from the nearest centre line, positive left of it, m
(6) lane_line(t) = |(5)| + half of the ego's width - half of the lane's width there:
        distance of its box beyond the lane's line, m; measured every 0.1 s while no road user and
        no curve is a reason to leave the centre line (`needless`)

nuPlan and NAVSIM judge (4): below 2 m is compliant, below 6 m half. Lanes that lie over each other
and lead both ways (a single-track road) may be driven either way.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import hypot

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray, arc_lengths
from replan.core.kernel import kernel
from replan.core.once import once
from replan.logs.agents import AgentKind
from replan.logs.road import inside
from replan.logs.route import ASIDE_M, BEHIND_M, on_lane
from replan.logs.rules import RED, Colour, StopLine
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Mode, Trace
from replan.logs.tracks import Tracks
from replan.metrics import metric
from replan.metrics.boxes import (
    GRID_S,
    EgoOutline,
    car_of,
    each,
    ego_boxes,
    grid_of,
    name_of,
    phantoms,
    present_between,
    some_at,
    without_phantoms,
)
from replan.metrics.encounters import CROSSING_RAD, encroachment, may_meet
from replan.metrics.lanes import NO_LANES, Under, mapped_lanes, under
from replan.metrics.metric import (
    COUNT,
    MIN,
    Measured,
    Metric,
    Reduction,
    Series,
    Unavailable,
    counted,
)
from replan.metrics.needless import reasons

REST_MPS, BEFORE_M = 0.1, 5.0
YELLOW_S, YELLOW_MPS2 = 1.0, 3.05
HALF_LANE_M = 1.75
AROUND_S = 1.0
SERIOUS_S, CRITICAL_S = 1.0, 1.5
FINE_S = 0.05  # Grid of (2)
# A road user that arrives later has no encounter with the ego: twice the critical gap, s
WITHIN_S = 3.0
MOVES_MPS = 0.5
SEEN_S = 0.3
WRONG_WAY_S = 1.0
AGAINST_MPS = 0.1  # Slower motion is not driving against a lane: equal to the speed of a stop
KEEPING_M, OVER_M = 0.5, 0.3
_NEVER = "the ego is never on a lane, or only where lanes cross"


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
                needed = ego.v[k] * YELLOW_S + ego.v[k] ** 2 / (2.0 * YELLOW_MPS2)  # (0)
                runs = (
                    light.at(now) is Colour.YELLOW and -_ahead(line, ego, scenario)[0][k] >= needed
                )
            if runs:
                shown = f"light {light.id} {light.at(now).value} since {since:.1f} s"
                events.append((step, f"stop line {line.id}: {shown}"))
    return counted(ego.t, events)


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
    ways = [road.lanes[i] for i in road.lanes[line.lane].successors if i in road.lanes]
    ahead, beside = _ahead(line, ego, scenario)
    half = 0.5 * hypot(*(line.points[1] - line.points[0])) + ASIDE_M
    over = (ahead[:-1] < 0.0) & (ahead[1:] >= 0.0) & (np.abs(beside[1:]) <= half)
    for step in (np.flatnonzero(over) + 1).tolist():
        driven = arc_lengths(ego.x[step:], ego.y[step:])
        at = step + np.unique(
            np.searchsorted(driven, np.arange(0.0, min(float(driven[-1]), BEHIND_M), 1.0))
        )
        x, y = ego_boxes(ego, scenario)[:2, at]
        on = {way.id: int(on_lane(way, x, y, ego.yaw[at]).sum()) for way in ways}
        if any(on.values()):
            counts = not line.towards or max(on, key=lambda way: (on[way], -way)) in line.towards
        else:
            beyond = any(
                on_lane(lane, x[-1:], y[-1:], ego.yaw[at[-1:]]).any()
                for lane in road.lanes.values()
            )
            counts = (
                not ways
                or not beyond
                or road.lanes[line.lane] in road.lanes_at(float(x[-1]), float(y[-1]))
            )
        if counts:
            yield step


def _crosswalk(trace: Trace, scenario: Scenario) -> Measured:
    if not scenario.road.crosswalks:
        return Unavailable("the log has no crosswalk")
    events = []
    walkers = np.flatnonzero([kind is AgentKind.PEDESTRIAN for kind in trace.agents.kinds])
    ego, t = ego_boxes(trace.ego, scenario), trace.ego.t
    for crosswalk in scenario.road.crosswalks if len(walkers) else ():
        over = _over(ego, car_of(scenario), crosswalk.polygon)
        change = np.flatnonzero(np.diff(np.r_[False, over, False].astype(int))).tolist()
        for first, end in zip(change[::2], change[1::2], strict=True):
            if first == 0:  # under way when the drive begins
                continue
            way = np.ascontiguousarray(ego[:2, first:end])
            # As a straight line: the path over a crosswalk is short
            dx, dy = way[:, -1] - way[:, 0]
            length = hypot(dx, dy)
            seen = np.intersect1d(walkers, present_between(trace.agents, t[first], t[end - 1]))
            others = some_at(trace.agents, seen, t[first:end])
            for row, i in enumerate(seen.tolist()):
                who, on = others.pose[:2, row], np.zeros(end - first, np.bool_)
                # On the crosswalk and near the ego's path
                for k in np.flatnonzero(np.isfinite(who[0])):
                    x, y = float(who[0, k]), float(who[1, k])
                    ahead, aside = x - way[0, 0], y - way[1, 0]
                    beside = (
                        hypot(ahead, aside)
                        if length < 1e-6
                        else abs(ahead * dy - aside * dx) / length
                    )
                    on[k] = inside(x, y, crosswalk.polygon) and beside <= HALF_LANE_M
                on &= others.there[row] & (np.abs(trace.ego.v[first:end]) > REST_MPS)
                if on.any():
                    events.append(
                        (
                            first + int(np.argmax(on)),
                            f"crosswalk {crosswalk.id}: {name_of(trace.agents, i)}",
                        )
                    )
    return counted(trace.ego.t, events)


@kernel
def _over(ego: FloatArray, car: EgoOutline, polygon: FloatArray) -> BoolArray:
    """Return the steps at which a box (rows x, y, yaw) overlaps a polygon, tested at 9 by 5 points
    of the box.
    """
    out = np.zeros(ego.shape[1], np.bool_)
    for k in range(ego.shape[1]):
        c, s = np.cos(ego[2, k]), np.sin(ego[2, k])
        for i in range(45):
            along, left = (i // 5 / 8.0 - 0.5) * car.length, (i % 5 / 4.0 - 0.5) * car.width
            if inside(ego[0, k] + along * c - left * s, ego[1, k] + along * s + left * c, polygon):
                out[k] = True
                break
    return out


def _priority_gap(trace: Trace, scenario: Scenario, *, assumed: bool) -> Measured:
    lanes, guessed = scenario.road.lanes, scenario.road.assumed_priority
    yields = (lane for lane in lanes.values() if (lane.id in guessed) is assumed)
    pairs = [(lane, lanes[i]) for lane in yields for i in lane.yields_to if i in lanes]
    if not pairs:
        return Unavailable(
            "no right of way is assumed" if assumed else "the log names no right of way"
        )
    if len(trace.ego) < 2:
        return Unavailable("the drive holds one ego state only")
    t = np.arange(float(trace.ego.t[0]), float(trace.ego.t[-1]), GRID_S)
    ego = trace.ego.resampled(t)
    boxes, car, no_drivers = (
        ego_boxes(ego, scenario),
        car_of(scenario),
        (AgentKind.PEDESTRIAN, AgentKind.OBJECT),
    )
    gap, labels = np.full(len(t), np.nan), [""] * len(t)
    for lane, first in pairs:
        mine = _steps_around(on_lane(lane, boxes[0], boxes[1], ego.yaw))
        for i, others, row in each(trace.agents, t) if mine.any() else ():
            if trace.agents.kinds[i] in no_drivers:
                continue
            theirs = _steps_around(on_lane(first, *others.pose[:3, row])) & others.there[row]
            sizes = np.array([car[1:3], others.size[row]])
            after, _, ego_first, other_first = encroachment(
                boxes, np.flatnonzero(mine), others.pose[:, row], np.flatnonzero(theirs), sizes, 0.0
            )
            step = int(np.argmin(np.where(after >= 0, after, len(after))))
            found = GRID_S * int(after[step])  # (1)
            if ego_first.sum() > other_first.sum() and not gap[step] <= found:
                gap[step], labels[step] = found, name_of(trace.agents, i)
    return Series(t, gap, tuple(labels), "the ego was never ahead of a road user that goes first")


def _steps_around(on: BoolArray) -> BoolArray:
    """Mark the steps `(k,)` from `AROUND_S` before the first marked one to `AROUND_S` after the
    last.
    """
    at = np.flatnonzero(on)
    found, reach = np.zeros(len(on), np.bool_), round(AROUND_S / GRID_S)
    if len(at):
        found[max(at[0] - reach, 0) : at[-1] + reach + 1] = True
    return found


@dataclass(frozen=True, eq=False, slots=True)
class _Meetings:
    """The boxes of one road user (index of its track) at places that a drive occupies, at m
    increasing grid steps.
    """

    agent: int
    step: IntArray
    # `(m,)` s since the drive last left the place of the box; NaN if it was not there before
    left: FloatArray
    # `(m,)` s until the drive reaches the place, 0 in a contact; NaN if it never does
    taken: FloatArray


def _meetings(
    drive: Trajectory, tracks: Tracks, scenario: Scenario, t: FloatArray
) -> Iterator[_Meetings]:
    """Yield the meetings with pedestrians, and with other kinds (not objects) that cross the drive,
    at `t` `(k,)`.
    """
    first, end = np.searchsorted(t, [drive.t[0] - 1e-9, drive.t[-1] + 1e-9])
    boxes = ego_boxes(drive.resampled(np.clip(t[first:end], drive.t[0], drive.t[-1])), scenario)
    car = car_of(scenario)
    for i, others, row in each(tracks, t):
        kind, pose = tracks.kinds[i], others.pose[:, row]
        if kind is AgentKind.OBJECT:
            continue
        mine, theirs = may_meet(boxes, car, others, row)
        theirs = theirs[np.hypot(pose[3, theirs], pose[4, theirs]) >= MOVES_MPS]
        after = np.ascontiguousarray(pose[:, first:])
        angle = 0.0 if kind is AgentKind.PEDESTRIAN else CROSSING_RAD
        sizes = np.array([others.size[row], car[1:3]])
        steps = encroachment(after, theirs[theirs >= first] - first, boxes, mine, sizes, angle)
        step = np.flatnonzero((steps[:2] >= 0).any(axis=0))
        if len(step):
            taken, left = np.where(steps[:2, step] >= 0, steps[:2, step] * FINE_S, np.nan)
            yield _Meetings(i, first + step, left - FINE_S, taken)


def _yielding(trace: Trace, scenario: Scenario) -> Mapping[str, Measured]:
    t = np.arange(trace.ego.t[0], max(trace.ego.t[-1] + WITHIN_S, scenario.ego.t[-1]), FINE_S)
    recorded: Measured = Unavailable("the log has no recorded driver")
    if scenario.is_recorded and len(scenario.ego) > 1:
        tracks = without_phantoms(scenario.tracks, phantoms(scenario))
        # By agent: steps at which the recorded driver let it pass first, and the text with the time
        let = {}
        for one in _meetings(scenario.ego, tracks, scenario, t):
            second = (one.taken > 0.0) & np.isnan(one.left)
            if second.any():
                why = f", which the recorded driver let go first by {one.taken[second].min():.1f} s"
                let[one.agent] = one.step[second], why
        recorded = Unavailable("the recorded driver let no road user with a kind go first")
        if let:
            mine = _meetings(trace.ego, tracks, scenario, t)
            recorded = _gaps(
                t, [(one, *let[one.agent]) for one in mine if one.agent in let], tracks
            )
    walkers = {i for i, kind in enumerate(trace.agents.kinds) if kind is AgentKind.PEDESTRIAN}
    if not walkers:
        return {"recorded": recorded, "pedestrian": Unavailable("the log names no pedestrian")}
    met = [
        (one, one.step, "")
        for one in _meetings(trace.ego, trace.agents, scenario, t)
        if one.agent in walkers
    ]
    none = Unavailable("the ego and the pedestrians took no place in common")
    return {"recorded": recorded, "pedestrian": _gaps(t, met, trace.agents) if met else none}


def _gaps(t: FloatArray, met: Sequence[tuple[_Meetings, IntArray, str]], tracks: Tracks) -> Series:
    """Return the least (2) over the boxes at the given steps, at the time at which the ego left
    their place.
    """
    gap, labels = np.full(len(t), np.nan), [""] * len(t)
    within = [
        (one, (one.left <= WITHIN_S + 1e-9) & np.isin(one.step, steps), why)
        for one, steps, why in met
    ]
    seen = t[
        np.unique(np.concatenate([np.empty(0, np.int64), *(one.step[at] for one, at, _ in within)]))
    ]
    for one, at, why in within:
        who = name_of(tracks, one.agent)
        for j, left in zip(one.step[at].tolist(), one.left[at].tolist(), strict=True):
            i = j - round(left / FINE_S) - 1
            if np.sum(np.abs(seen - t[j]) <= WITHIN_S) * FINE_S >= SEEN_S and not gap[i] <= left:
                gap[i], labels[i] = left, f"{who}: the ego goes first, {left:.1f} s before it{why}"
    return Series(t, gap, tuple(labels), "the ego never went first")


def _fewer(bound: float, name: str) -> Reduction:
    """Return a reduction that counts the gaps below `bound`."""

    def reduce(series: Series) -> tuple[float, int]:
        failed = series.known & (series.value < bound - 1e-9)
        worst = int(np.argmin(np.where(failed, series.value, np.inf)))
        return float(failed.sum()), worst if failed.any() else -1

    return Reduction(name, reduce, "count", "lower", 0.0, (bound, np.inf))


@once
def _under(trace: Trace, scenario: Scenario) -> Under | None:
    lanes = mapped_lanes(scenario.road)
    return None if lanes is None else under(lanes, *ego_boxes(trace.ego, scenario)[:3])


def _wrong_way(trace: Trace, scenario: Scenario) -> Measured:
    if (found := _under(trace, scenario)) is None:
        return NO_LANES
    # (3); the reference point moves along the ego's heading
    against = np.maximum(-trace.ego.v * found.along, 0.0)
    return Series(trace.ego.t, against, missing=_NEVER)


def _lane_keeping(trace: Trace, scenario: Scenario) -> Measured:
    found = _under(trace, scenario)
    return NO_LANES if found is None else Series(trace.ego.t, found.left, missing=_NEVER)


def _lane_line(trace: Trace, scenario: Scenario) -> Measured:
    if (lanes := mapped_lanes(scenario.road)) is None:
        return NO_LANES
    ego, steer = grid_of(trace), reasons(trace, scenario).steer
    found = under(lanes, *ego_boxes(ego, scenario)[:3])
    over = np.abs(found.left) + 0.5 * scenario.vehicle.width - found.half  # (6)
    return Series(
        ego.t,
        np.where(steer, np.nan, over),
        missing=f"{_NEVER}, or something called for leaving the middle",
    )


def _metres(series: Series) -> FloatArray:
    """Return the metres driven against the lanes in each step `(n,)`."""
    return np.where(series.known, series.value, 0.0) * metric.durations(series.t)


def worst_metres(series: Series) -> tuple[float, int]:
    """Return (4) and the step at which its window ends."""
    total = np.r_[0.0, np.cumsum(_metres(series))]
    start = np.searchsorted(series.t, series.t - WRONG_WAY_S + 1e-9)
    within = total[1:] - total[start]
    step = int(np.argmax(within))
    return float(within[step]), step


_CLOSED = (Mode.CLOSED,)
RED_LIGHT = Metric(
    "red_light",
    "count",
    "lower",
    _CLOSED,
    partial(_light, yellow=False),
    (COUNT,),
    "Stop lines that the front came over while their light showed red, or red and yellow.",
    "as CARLA leaderboard 2.x counts red lights; nuPlan has none",
    formula="sum of crossings at red, or red and yellow",
    parameters=(f"beside the line's ends {ASIDE_M} m",),
    needs="a traffic light with a stop line",
)
YELLOW_LIGHT = Metric(
    "yellow_light",
    "count",
    "lower",
    _CLOSED,
    partial(_light, yellow=True),
    (COUNT,),
    "Stop lines that the front came over at a yellow for which the ego could have stopped "
    "comfortably.",
    "StVO 37; ITE, Determining Vehicle Signal Change and Clearance Intervals: 1 s and 3.05 m/s2",
    formula=(
        "sum of crossings at yellow, if it began farther away than v * 1 s + v^2 / (2 * 3.05 m/s2)"
    ),
    parameters=(f"reaction {YELLOW_S:g} s", f"stop {YELLOW_MPS2} m/s2"),
    needs="a traffic light with a stop line",
)
STOP_SIGN = Metric(
    "stop_sign",
    "count",
    "lower",
    _CLOSED,
    _stop_sign,
    (COUNT,),
    "Stop signs passed without a speed below 0.1 m/s in the last 5 m before their line.",
    "bounds: nuPlan devkit e9241677, ego_stop_at_stop_line (5 m, 0.1 m/s)",
    formula="sum of crossings with min |v| >= 0.1 m/s over the last 5 m",
    parameters=(f"at rest below {REST_MPS} m/s", f"before the line {BEFORE_M:g} m"),
    needs="a stop sign",
)
CROSSWALK = Metric(
    "crosswalk",
    "count",
    "lower",
    _CLOSED,
    _crosswalk,
    (COUNT,),
    "Pedestrians who were on the ego's half of a crosswalk while it drove over it.",
    "StVO 26 (1): who evidently wants to cross is let cross",
    formula="sum over passages of the pedestrians on the ego's half",
    parameters=(f"half a lane {HALF_LANE_M} m", f"drives above {REST_MPS} m/s"),
    needs="a crosswalk",
)
PRIORITY_GAP, PRIORITY_GAP_ASSUMED = (
    Metric(
        name,
        "s",
        "higher",
        _CLOSED,
        partial(_priority_gap, assumed=assumed),
        (MIN, _fewer(SERIOUS_S, "below_1s")),
        f"Time between the ego leaving a spot and a road user with {priority} reaching it "
        "(post-encroachment time).",
        "PET below 1 s: serious; 1.5 s: critical (criticality metrics catalogue, Westhofen et al. "
        "2023)",
        formula="least t_j - t_i >= 0 over boxes i of the ego and j of the other that overlap",
        parameters=(f"grid {GRID_S} s", f"serious {SERIOUS_S:g} s"),
        needs=f"lanes that {yields}, a drive of two states",
    )
    for name, assumed, priority, yields in (
        ("priority_gap", False, "priority", "yield by a sign or a rule of the log"),
        ("priority_gap_assumed", True, "assumed priority", "yield by assumption"),
    )
)
YIELDING = Metric(
    "yielding",
    "s",
    "higher",
    _CLOSED,
    _yielding,
    (MIN, _fewer(SERIOUS_S, "below_1s"), _fewer(CRITICAL_S, "below_1500ms")),
    "Time by which the ego crosses before a road user that comes to the same place: of those that "
    "the recorded driver "
    "let go first (as logged), and of pedestrians (as they moved). Needs no map.",
    "PET below 1 s: serious; 1.5 s: critical (criticality metrics catalogue, Westhofen et al. "
    "2023)",
    formula=(
        "least t_j - t_i over boxes j of the other and the last box i of the ego that overlaps "
        "it before t_j"
    ),
    parameters=(
        f"grid {FINE_S} s",
        f"at most {WITHIN_S:g} s",
        f"moves at {MOVES_MPS} m/s or more",
        "across: 30 degrees",
        f"on the ego's way for {SEEN_S} s",
        f"serious {SERIOUS_S:g} s",
        f"critical {CRITICAL_S:g} s",
    ),
    parts=("recorded", "pedestrian"),
    needs="a recorded driver that let another go first; a pedestrian",
)
_NEEDS = "lanes in the log"
WRONG_WAY = Metric(
    "wrong_way",
    "m/s",
    "lower",
    _CLOSED,
    _wrong_way,
    (
        Reduction("worst_1s", worst_metres, unit="m", empty=0.0),
        Reduction(
            "distance", lambda series: (float(_metres(series).sum()), -1), unit="m", empty=0.0
        ),
        metric.time_above(AGAINST_MPS, "time"),
        metric.worst_episode(-AGAINST_MPS, AGAINST_MPS),
    ),
    "Speed against the direction of the lane under the ego's centre; worst_1s are the most metres "
    "within 1 s.",
    "nuPlan devkit e9241677, driving_direction_compliance (below 2 m: 1, below 6 m: 0.5); there "
    "along the route",
    formula=(
        "max(-v cos(angle to the best aligned lane), 0); worst_1s = max over t of its integral "
        "over (t - 1 s, t]"
    ),
    parameters=(
        f"window {WRONG_WAY_S:g} s",
        f"against above {AGAINST_MPS} m/s",
        "lanes cross above 30 degrees",
    ),
    needs=_NEEDS,
)
LANE_KEEPING = Metric(
    "lane_keeping",
    "m",
    "lower",
    _CLOSED,
    _lane_keeping,
    (
        metric.MAX_ABS,
        metric.time_above(KEEPING_M, "time_beyond_50cm"),
        metric.worst_episode(-KEEPING_M, KEEPING_M),
    ),
    "Distance of the ego's centre from the nearest centre line of a lane under it; changing lanes "
    "counts too.",
    "NAVSIM 0a380a90, lane keeping of EPDMS: an episode of 2 s is a failure",
    formula="signed distance from the centre line; worst_episode: the longest stretch beyond 0.5 m",
    parameters=(f"beyond {KEEPING_M} m", "lanes cross above 30 degrees"),
    needs=_NEEDS,
)
LANE_LINE = Metric(
    "lane_line",
    "m",
    "lower",
    _CLOSED,
    _lane_line,
    (metric.MAX, metric.worst_episode(-np.inf, OVER_M)),
    "How far the ego's box is over the line of its lane while nothing calls for it.",
    formula="|distance from the centre line| + half of the ego's width - half of the lane's width",
    parameters=(f"over by {OVER_M} m",),
    needs=_NEEDS,
)
