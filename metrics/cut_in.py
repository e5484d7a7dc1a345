"""Lane entries of the ego ahead of a follower, closed loop: the braking that they force, and fault
for a hit.

The path of a follower (a vehicle or a rider) is a smooth line through its positions, straight
beyond its ends. The strip is the area that its box sweeps along this line. The ego is outside while
it is `OUT_M` or more beside the strip. It is inside once its box reaches `IN_M` into the strip,
ahead of the follower's front and within `NEAR_M`. A change from outside to inside is an entry if
both head in the same direction (within 45 degrees) and the ego is the one that crosses over:

(1) angle(ego, ref) > angle(path at the ego, ref); ref: the best aligned of the lanes under the ego,
    for each of the two angles; without lanes in the log, the direction of the follower at that time

So there is no entry if the ego is ahead from the start, if it keeps its lane, or if another road
user changes lanes behind it. With the follower's speed u at the entry and the distance g(t) from
its front at the entry to the ego's rear at t:

(2) forced = the least b >= 0 such that a follower that drives on for `REACT_S` and then brakes
        with b until it stands does not pass g(t) within `HORIZON_S`; where the drive ends earlier,
        the ego keeps its speed, or keeps braking. If the follower deviates from the log, it reacts:
        then forced is at least how much harder it brakes (4) after the entry than in the log, or
        than at constant speed where the log does not have it
(3) a hit from behind is the ego's fault where the entry before it has forced > `BRAKE_MPS2`

Of two drives of one log, a failing and a passing one, up to the time t_x at which the first fails:

(4) made way = how much harder a road user brakes in the passing one:
        the greatest fall of their speed within `WAY_S`, per second, less that in the failing one,
        or less 0 where they accelerate there
(5) unseen = a reaction that the passing one cannot show:
        the ego is within `SAME_PLACE_M` of where it is in the failing one up to t_x, and the road
        user within `AS_LOGGED_M` of the log for `HORIZON_S` after it, whatever the ego does

For an ego at constant speed, (3) is the bound of UN R157, 5.2.5.2: TTC <= v_rel / (2 * 6 m/s2) +
0.35 s.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import atan2, cos, inf, pi

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.logs.agents import AgentKind
from replan.logs.polylines import nearest, thinned
from replan.logs.reference_line import ReferenceLine, line_project_many
from replan.logs.road import Road, RoadSource
from replan.logs.scenario import Scenario
from replan.logs.shapes import corners
from replan.logs.states import Trajectory, wrap
from replan.logs.trace import Trace
from replan.logs.tracks import Tracks
from replan.metrics.boxes import GRID_S, OtherBoxes, each, ego_boxes, name_of, some_at
from replan.metrics.metric import Measured, Series, Unavailable, metric
from replan.metrics.reductions import MAX

SPACING_M, CHORD_M, BEYOND_M = 2.0, 4.0, 10.0
NEAR_M = 60.0
OUT_M, IN_M = 0.3, 0.1
SAME_WAY = cos(0.25 * pi)
REACT_S, BRAKE_MPS2, HORIZON_S = 0.35, 6.0, 5.0
# Time before a hit that is searched for an entry: from 50 m/s, (3) gives a follower 9 s
LOOK_BACK_S = 15.0
MOST_MPS2 = 9.81  # Forced braking is computed up to this
AS_LOGGED_M, SAME_PLACE_M, WAY_S = 0.5, 0.3, 0.5
# A road user whose centre is farther ahead of the ego's centre does not follow the ego, m
ALONGSIDE_M = 10.0


@dataclass(frozen=True, slots=True)
class CutInStay:
    """A stay of the ego in the path of a follower (index of its track) from `t` to `until`, s;
    `forced`: (2), m/s2.
    """

    t: float
    until: float
    agent: int
    forced: float


def forces_hit(drive: Trajectory, agents: Tracks, agent: int, scenario: Scenario) -> bool:
    """Return (3) for an agent that touches the ego from behind at the last state of a drive."""
    t = float(drive.t[-1])
    recent = drive.between(t - LOOK_BACK_S, t)
    stays = entries(recent, agents.only({agents.ids[agent]}), scenario) if len(recent) > 1 else []
    return bool(stays) and stays[-1].until >= t - GRID_S and stays[-1].forced > BRAKE_MPS2


def entries(drive: Trajectory, agents: Tracks, scenario: Scenario) -> list[CutInStay]:
    """Return the entries of a drive of two or more states, by follower, in order of time."""
    return [
        entry for seen in followers(drive, agents, scenario) for entry in _entries(seen, scenario)
    ]


@dataclass(frozen=True, eq=False, slots=True)
class Follower:
    """The ego on the path of a follower (index of its track), at the k steps at which the follower
    is present.
    """

    agent: int
    # The ego's drive and its boxes at these steps; `goes_on`: they end with the drive
    ego: Trajectory
    boxes: FloatArray
    goes_on: bool
    path: ReferenceLine
    length: float
    u: FloatArray  # The follower's speed, m/s; `front`, m, the station of its front
    front: FloatArray
    # Station of the ego's rear, m; `deep`, m, how far its box is inside the strip; `ahead` whether
    # it is ahead of the front and near
    rear: FloatArray
    deep: FloatArray
    ahead: BoolArray

    def needed(self, first: int, last: int) -> float:
        """Return (2) for a stay from step `first` to `last`."""
        t, g = (
            self.ego.t[first : last + 1] - self.ego.t[first],
            self.rear[first : last + 1] - self.front[first],
        )
        if self.goes_on and last == len(self.ego) - 1:
            more, end = np.arange(GRID_S, HORIZON_S - t[-1], GRID_S), self.ego.state(last)
            brake = max(-end.a, 0.0)
            braked = np.minimum(more, end.v / brake) if brake > 0.0 else more
            t, g = (
                np.r_[t, t[-1] + more],
                np.r_[g, g[-1] + (end.v * braked - 0.5 * brake * braked**2)],
            )
        return needed_deceleration(t, g, float(self.u[first]))


def followers(drive: Trajectory, agents: Tracks, scenario: Scenario) -> Iterator[Follower]:
    """Yield the road users that may follow the ego, with the ego on their paths."""
    first, last = float(drive.t[0]), float(drive.t[-1])
    ego = drive.resampled(np.append(np.arange(first, last - 1e-6, GRID_S), last))
    boxes, car = ego_boxes(ego, scenario), scenario.vehicle
    outline = np.stack(
        [corners(x, y, yaw, car.length, car.width) for x, y, yaw in boxes[:3].T], axis=-1
    )
    c, s = np.cos(boxes[2]), np.sin(boxes[2])
    for i, others, row in each(agents, ego.t):
        pose, steps = others.pose[:, row], np.flatnonzero(others.there[row])
        if (
            not len(steps)
            or agents.static[i]
            or agents.kinds[i] in (AgentKind.PEDESTRIAN, AgentKind.OBJECT)
        ):
            continue
        dx, dy = pose[:2] - boxes[:2]
        _, _, _, vx, vy = pose
        oncoming = vx * c + vy * s <= -0.2 * np.hypot(vx, vy)
        points = thinned(pose[:2, steps].T, SPACING_M)
        behind = (np.hypot(dx, dy) < NEAR_M) & (dx * c + dy * s < ALONGSIDE_M) & ~oncoming
        if len(points) > 1 and behind.any():
            yield _follow(i, ego, boxes, outline, steps, points, pose, others.size[row])


def _follow(
    agent: int,
    ego: Trajectory,
    boxes: FloatArray,
    outline: FloatArray,
    steps: IntArray,
    points: FloatArray,
    pose: FloatArray,
    size: FloatArray,
) -> Follower:
    path, (length, width) = ReferenceLine.through(points, SPACING_M), size
    front = _on_path(path, *pose[:2, steps])[0] + 0.5 * length
    s, l = np.stack([_on_path(path, *xy) for xy in outline[:, :, steps]], axis=1)
    deep = 0.5 * width - np.maximum(l.min(axis=0), -l.max(axis=0))
    ahead = (s.max(axis=0) > front) & (
        s.min(axis=0) < np.minimum(front + NEAR_M, path.length + BEYOND_M)
    )
    # Of the part inside the strip; else of the box
    rear = np.where(np.abs(l) <= 0.5 * width, s, inf)
    next_s, next_l = np.roll(s, 1, axis=0), np.roll(l, 1, axis=0)
    for edge in (-0.5 * width, 0.5 * width):
        with np.errstate(divide="ignore", invalid="ignore"):
            share = (edge - l) / (next_l - l)
            rear = np.minimum(
                rear, np.where((share >= 0.0) & (share <= 1.0), s + share * (next_s - s), inf)
            )
    least, u = rear.min(axis=0), np.hypot(*pose[3:, steps])
    rear = np.where(np.isfinite(least), least, s.min(axis=0))
    goes_on = bool(steps[-1] == len(ego) - 1)
    return Follower(
        agent,
        ego.resampled(ego.t[steps]),
        boxes[:, steps],
        goes_on,
        path,
        length,
        u,
        front,
        rear,
        deep,
        ahead,
    )


def _entries(seen: Follower, scenario: Scenario) -> Iterator[CutInStay]:
    """Yield the entries ahead of one follower."""
    for first, last in _stays_in_strip(seen.deep, seen.ahead):
        heading = (
            _direction(seen.path, seen.rear[first]),
            _direction(seen.path, seen.front[first] - 0.5 * seen.length),
        )
        if _crosses_over(scenario.road, seen.boxes[:3, first], *heading):
            t, until = float(seen.ego.t[first]), float(seen.ego.t[last])
            yield CutInStay(t, until, seen.agent, seen.needed(first, last))


def _on_path(path: ReferenceLine, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return stations and offsets `(2, k)` of points along a path."""
    near, _ = path.project(float(x[0]), float(y[0]))
    x, y = np.ascontiguousarray(x), np.ascontiguousarray(y)
    return line_project_many(path.s, path.coef, x, y, near, NEAR_M).T


def _stays_in_strip(deep: FloatArray, ahead: BoolArray) -> Iterator[tuple[int, int]]:
    """Yield the first and last step of each stay in the strip that begins with a change from
    outside to inside.
    """
    was_outside, since = False, -1
    for k in range(len(deep)):
        if since >= 0 and deep[k] <= -OUT_M:
            yield since, k - 1
            since = -1
        if was_outside and ahead[k] and deep[k] >= IN_M:
            since = k
        was_outside = ahead[k] and deep[k] < IN_M and (was_outside or deep[k] <= -OUT_M)
    if since >= 0:
        yield since, len(deep) - 1


def _direction(path: ReferenceLine, s: float) -> float:
    """Return the direction of a path at a station, rad: of the chord from `CHORD_M` before to
    `CHORD_M` after it.
    """
    (x0, y0), (x1, y1) = (path.frame(station)[:2] for station in (s - CHORD_M, s + CHORD_M))
    return atan2(y1 - y0, x1 - x0)


def _crosses_over(road: Road, box: FloatArray, path: float, follower: float) -> bool:
    """Evaluate (1) for the ego's box (x, y, yaw) and the directions of the path at the ego and of
    the follower.
    """
    x, y, yaw = box.tolist()
    if cos(yaw - path) < SAME_WAY:
        return False
    refs = []
    for lane in road.lanes_at(x, y) if road.source is RoadSource.LANES else ():
        if lane.drivable:
            step = min(nearest(lane.center, x, y), len(lane.center) - 2)
            dx, dy = lane.center[step + 1] - lane.center[step]
            refs.append(atan2(dy, dx))
    ego_angle, path_angle = (
        min(abs(wrap(yaw - ref)) for ref in refs or [follower]) for yaw in (yaw, path)
    )
    return ego_angle > path_angle


def needed_deceleration(t: FloatArray, g: FloatArray, u: float) -> float:
    """Return (2), m/s2, for the ego's rear at the distances g `(k,)`, m, at the times t `(k,)`, s,
    after the entry.
    """
    t, g = t[t <= HORIZON_S], g[t <= HORIZON_S]
    braked, room = t - REACT_S, g - u * REACT_S
    late = (braked > 0.0) & (u * braked > room)
    if (u * t > g)[braked <= 0.0].any() or (room[late] <= 0.0).any():
        return MOST_MPS2
    braked, room = braked[late], room[late]
    needed = np.where(
        2.0 * room <= u * braked, u**2 / (2.0 * room), 2.0 * (u * braked - room) / braked**2
    )
    return min(float(needed.max(initial=0.0)), MOST_MPS2)


def worst_forced(
    trace: Trace, stays: Iterable[CutInStay], scenario: Scenario, why: str, missing: str
) -> Series:
    """Return the braking that stays ahead of followers force, at their begins.

    At least how a follower reacted.
    """
    t, value, labels = trace.ego.t, np.full(len(trace.ego), np.nan), [""] * len(trace.ego)
    logged = scenario.tracks
    for stay in stays:
        after = np.arange(stay.t, min(stay.until, stay.t + HORIZON_S) + 1e-9, GRID_S)
        now, name = (
            some_at(trace.agents, np.array([stay.agent]), after),
            trace.agents.ids[stay.agent],
        )
        harder = _falls(now)
        if name in logged.ids:
            then = some_at(logged, np.array([logged.ids.index(name)]), after)
            harder -= np.maximum(_falls(then), 0.0)
            harder[~(np.hypot(*(now.pose[:2, 0] - then.pose[:2, 0])) > AS_LOGGED_M)] = np.nan
        reacted = min(_greatest(harder), MOST_MPS2)
        k, forced = int(np.searchsorted(t, stay.t - 1e-9)), max(stay.forced, reacted)
        if not value[k] >= forced:
            value[k], labels[k] = forced, f"{name_of(trace.agents, stay.agent)}: {why}"
    return Series(t, value, tuple(labels), missing)


def made_way(failing: Trace, passing: Trace, road_user: str, until: float) -> float:
    """Return the braking (4) of a road user, m/s2; 0 if one of the drives does not have them."""
    if road_user not in failing.agents.ids or road_user not in passing.agents.ids:
        return 0.0
    t = np.arange(
        0.0, min(until, float(failing.ego.t[-1]), float(passing.ego.t[-1])) + 1e-9, GRID_S
    )
    then, now = (
        some_at(trace.agents, np.array([trace.agents.ids.index(road_user)]), t)
        for trace in (failing, passing)
    )
    return _greatest(_falls(now) - np.maximum(_falls(then), 0.0))


def _falls(boxes: OtherBoxes) -> FloatArray:
    """Return the fall of one road user's speed within `WAY_S`, per second, at each step `(k,)`; NaN
    where unknown.
    """
    v, steps = (
        np.where(boxes.there[0], np.hypot(*boxes.pose[3:5, 0]), np.nan),
        round(WAY_S / GRID_S),
    )
    falls = np.full(len(v), np.nan)
    falls[steps:] = (v[:-steps] - v[steps:]) / WAY_S
    return falls


def _greatest(falls: FloatArray) -> float:
    return float(np.max(falls, initial=0.0, where=np.isfinite(falls)))


def unseen(failing: Trace, passing: Trace, logged: Tracks, road_user: str, until: float) -> bool:
    """Return whether a reaction of a road user cannot be seen in a drive (5)."""
    if (
        road_user not in passing.agents.ids
        or road_user not in logged.ids
        or passing.ego.t[-1] < until
    ):
        return False
    t = np.arange(0.0, until + 1e-9, GRID_S)
    x, passing_x = (np.interp(t, ego.t, ego.x) for ego in (failing.ego, passing.ego))
    y, passing_y = (np.interp(t, ego.t, ego.y) for ego in (failing.ego, passing.ego))
    if np.hypot(x - passing_x, y - passing_y).max() > SAME_PLACE_M:
        return False
    t = np.arange(until, min(until + HORIZON_S, float(passing.ego.t[-1])) + 1e-9, GRID_S)
    now, then = (
        some_at(agents, np.array([agents.ids.index(road_user)]), t)
        for agents in (passing.agents, logged)
    )
    both = now.there[0] & then.there[0]
    return bool((np.hypot(*(now.pose[:2, 0] - then.pose[:2, 0]))[both] <= AS_LOGGED_M).all())


@metric(
    unit="m/s2",
    better="lower",
    reductions=(MAX,),
    parameters=(f"reaction {REACT_S} s", f"horizon {HORIZON_S:g} s", f"at most {MOST_MPS2} m/s2"),
    needs="a follower whose path the ego enters",
    source="UN R79, 5.6.4.7: above 3 m/s2 a lane change is critical; UN R157, 5.2.5.2 for the "
    "reaction time",
)
def forced_braking(trace: Trace, scenario: Scenario) -> Measured:
    """Deceleration that the ego forces on a follower into whose path it comes: what the follower
    needs to stay behind it, and where the traffic reacts at least how much harder than in the log
    the follower brakes.

    Formula: least b that keeps a follower, which brakes with b 0.35 s after the entry, behind the
    ego for 5 s
    """
    if len(trace.ego) < 2:
        return Unavailable("the drive holds one ego state only")
    stays = entries(trace.ego, trace.agents, scenario)
    missing = "the ego entered no follower's path"
    return worst_forced(trace, stays, scenario, "the ego entered its path", missing)
