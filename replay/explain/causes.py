"""Why a plan slows down or stands: what would be met, broken or missed if it did not.

Found from what is known to all: the plan, the frame, the predictions, the road. The plan is held
(`replay.explain.course`) along its way (`replay.explain.way`), and each cause says what would come of that, and the
least constant deceleration that avoids it. What a planner decided counts as its reason only where the numbers bear it
out; the rest is inferred.

(1) agent   met, or followed too near (`replay.explain.meetings`)
(2) stop    a line where a light or a sign demands it, or a thing of the S-T graph that the planner stops for
(3) limit   the speed limit along the way is lower than the speed that is held, by `OVER_MPS`
(4) curve   v^2 |kappa| > `CURVE_MPS2` somewhere along the way
(5) goal    reached before its time, too fast, or passed although the plan comes to rest at it
(6) end     the map ends on the way, and the plan comes to rest before it
(7) word    a planner's STOP or YIELD for who is near the way but not met, or for a thing without a place
(8) passed  nothing of these, but a planner's OVERTAKE of who is near the way: the plan brakes before it goes first
(9) begun   nothing of these, and the plan brakes hardest at its start and less before it stands: it lets go of the
            ego's own braking
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from math import isfinite, nan

import numpy as np

from logs.kernel import FloatArray
from logs.road import Goal
from logs.rules import RED, Colour, StopLine
from logs.scenario import Scenario
from logs.trace import Decision, DecisionKind, Plan, StGraph, Trace
from replay.config import LoopConfig
from replay.explain.alternatives import not_passed
from replay.explain.course import BRAKES_MPS2, LOOK_S, STANDING_MPS, STEP_S, Course, Held
from replay.explain.meetings import Meeting, meetings
from replay.explain.shown import Shown, shown
from replay.explain.way import Way, Ways

STAYS_BEHIND = (DecisionKind.STOP, DecisionKind.YIELD, DecisionKind.FOLLOW)
OVER_MPS = 0.3
CURVE_MPS2 = 2.5
"""Lateral acceleration above which a curve is a reason to be slower: below what planners allow themselves (3.0)."""
SOON_S = 1.0
"""What is nearer than this much time is taken to be so far: no driver brakes to a limit within no time."""
LEAST_MPS2 = 0.05
"""A limit, curve or goal that asks for less is none to brake for."""
MOST_MPS2 = 9.81
"""A line that asks for more cannot be kept."""
GOAL_ROOM_M = 10.0
"""Who comes to rest no farther than this before the end of the goal's region stops for the goal."""
SAME_M = 0.1
"""What takes the S-T graph from the same station on, within so much, stands there."""
NEAR_M = 3.0
"""Who is farther beside the way than this is not near it."""


class CauseKind(Enum):
    """What a plan slows down for; the value is the word in tables."""

    FALLBACK = "fallback"
    AGENT = "agent"
    STOP = "stop"
    LIMIT = "speed limit"
    CURVE = "curve"
    GOAL = "goal"
    ROAD_END = "end of the road"
    WORD = "decision"
    BEGUN = "braking begun before"
    NONE = "no cause found"


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause, with the numbers that its sentence says; NaN where there is none.

    Attributes:
        kind: What it is.
        who: The agent, stop line or thing.
        decision: What the planner decided about it ("follow"); empty: nothing.
        reason: In the planner's words.
        inferred: Whether the planner did not name it.
        hold_mps: The speed that is held; of an ego that stands the one that it would drive off to.
        away_m: AGENT: between the boxes now.
        time_s: When it would be met or reached, s from the frame.
        distance_m: How far the ego would have gone until then, m.
        need_mps2: The least constant deceleration that avoids it.
        value: LIMIT: the limit, m/s; CURVE: the lateral acceleration, m/s2; GOAL: its time, s, or speed, m/s; BEGUN:
            the acceleration that the plan starts with, m/s2.
        left_m: AGENT: the least that the plan leaves behind them, m; `left_at_s` when, s from the frame.
        left_at_s: See there.
        is_met: AGENT: whether they would be met; otherwise they would be followed too near, or are only in the way.
    """

    kind: CauseKind
    who: str = ""
    decision: str = ""
    reason: str = ""
    inferred: bool = True
    hold_mps: float = nan
    away_m: float = nan
    time_s: float = nan
    distance_m: float = nan
    need_mps2: float = nan
    value: float = nan
    left_m: float = nan
    left_at_s: float = nan
    is_met: bool = False


@dataclass(frozen=True, slots=True)
class Account:
    """What a plan does, and why: the causes, those that the planner named first, then by what they ask for.

    Attributes:
        t: Of the frame, s.
        course: What it does.
        predicted: Whether the others' predictions were there to look at.
        not_passed: Why who is in the way is not passed, as far as the planner says.
        causes: Of slowing down or standing; empty where it does neither. One is of kind NONE where nothing was found.
    """

    t: float
    course: Course
    predicted: bool
    causes: tuple[Cause, ...]
    not_passed: tuple[str, ...] = ()


def accounts(
    trace: Trace, scenario: Scenario, loop: LoopConfig | None = None, earlier: Iterable[float] = ()
) -> Iterator[Account]:
    """The account of each frame of a drive; arguments as `shown`."""
    explainer = Explainer(scenario)
    return (explainer.account(frame) for frame in shown(trace, scenario, loop, earlier))


@dataclass(frozen=True, eq=False, slots=True)
class _Case:
    """A plan that is held: what the producers of causes look at."""

    frame: Shown
    course: Course
    held: Held
    way: Way
    decided: dict[str, Decision]

    @property
    def plan(self) -> Plan:
        return self.frame.planned.plan

    def cause(self, kind: CauseKind, distance: float, need: float, who: str = "", value: float = nan) -> Cause:
        """A cause at a place on the way."""
        time = self.held.when(distance)
        return Cause(kind, who, hold_mps=self.held.v, time_s=time, distance_m=distance, need_mps2=need, value=value)


class Explainer:
    """Finds the causes of the plans of one drive."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario, self._ways = scenario, Ways(scenario)

    def account(self, frame: Shown) -> Account:
        """Why the plan of a frame slows down or stands."""
        plan = frame.planned.plan
        course = Course.of(plan)
        predicted = frame.predictions is not None
        failed = [
            Cause(CauseKind.FALLBACK, plan.status.value, reason=plan.reason, inferred=False)
        ] if plan.status.is_fallback else []  # fmt: skip
        if not course.is_asked:
            return Account(frame.planned.t, course, predicted, tuple(failed))
        held = Held.of(plan, course)
        way = self._ways.of(plan, held.reach)
        case = _Case(frame, course, held, way, _decided(plan))
        found = [*self._agents(case), *self._stops(case), *_limits(case), *_curves(case)]
        found += [*_goal(case, self._scenario), *_end(case)]
        found = _borne_out(case, found)
        found += _words(case, {cause.who for cause in found})
        found = sorted(found, key=_order)
        if not found and not failed:
            found = _passed(case) or [*_begun(case)] or [self._none(case)]
        why_not = not_passed(plan) if found and found[0].kind is CauseKind.AGENT else ()
        return Account(frame.planned.t, course, predicted, (*failed, *found), why_not)

    def _met(self, case: _Case) -> list[Meeting]:
        """Those in the way; who the planner passes (nudge, overtake) has no margin."""
        frame = case.frame
        if frame.predictions is None or not len(frame.predictions):
            return []
        named = {d.agent for d in case.plan.internals if isinstance(d, Decision)} - case.decided.keys()
        passed = np.array([name in named for name in frame.agents.ids], np.bool_)
        return meetings(case.held, case.way, frame.agents, frame.predictions, self._scenario.vehicle, passed)

    def _agents(self, case: _Case) -> Iterator[Cause]:
        """(1)."""
        for one in self._met(case):
            if isfinite(one.time_s):
                yield _of(one, case)

    def _none(self, case: _Case) -> Cause:
        """Nothing was found; who is in the way nearest all the same."""
        near = min(self._met(case), key=lambda one: one.away_m, default=None)
        one = Cause(CauseKind.AGENT, hold_mps=case.held.v) if near is None else _of(near, case)
        return replace(one, kind=CauseKind.NONE, time_s=float(case.held.t[-1]), distance_m=case.held.reach)

    def _stops(self, case: _Case) -> Iterator[Cause]:
        """(2): lines of the road, and what else the planner drew into its S-T graph and decided to stop for."""
        front, lanes = self._scenario.vehicle.axle_to_front, set(case.way.lanes)
        places = {
            f"stop line {line.id}": _crossed(line, case.way, front)
            for line in self._scenario.road.stop_lines
            if line.lane in lanes and (not line.towards or not lanes.isdisjoint(line.towards))
            and (f"stop line {line.id}" in case.decided or _demanded(line, case))
        }  # fmt: skip
        places |= _drawn(case)
        for name, place in places.items():
            need = case.held.need(place)
            if place <= case.held.reach and (case.held.stands or need <= MOST_MPS2):
                yield case.cause(CauseKind.STOP, place, need, name)


def _drawn(case: _Case) -> dict[str, float]:
    """Where the things lie that the planner drew into its S-T graph and stops for, m; not what is gone by then."""
    found: dict[str, float] = {}
    for graph in (each for each in case.plan.internals if isinstance(each, StGraph)):
        for thing in graph.obstacles:
            if thing.agent in case.frame.agents.ids or thing.agent not in case.decided or not len(thing.outline):
                continue
            t, s = thing.outline.T
            place, level = float(s.min()), {float(s[t == each].min()) for each in set(t.tolist())}
            stays = t.max() >= min(
                case.held.when(place), float(case.plan.trajectory.t[-1]) - case.frame.planned.t - STEP_S
            )
            if max(level) - place < SAME_M and stays:
                found[thing.agent] = place
    return found


def _decided(plan: Plan) -> dict[str, Decision]:
    """Those behind which the planner stays, the first word about each."""
    found: dict[str, Decision] = {}
    for each in plan.internals:
        if isinstance(each, Decision) and each.kind in STAYS_BEHIND:
            found.setdefault(each.agent, each)
    return found


def _of(one: Meeting, case: _Case) -> Cause:
    return Cause(
        CauseKind.AGENT, one.agent, hold_mps=case.held.v, away_m=one.away_m, time_s=one.time_s,
        distance_m=one.distance_m, need_mps2=one.need_mps2, left_m=one.left_m, left_at_s=one.left_at_s,
        is_met=one.is_met,
    )  # fmt: skip


def _demanded(line: StopLine, case: _Case) -> bool:
    """Whether a light or a sign demands a stop at a line."""
    if line.light is not None:
        return case.frame.lights.get(line.light, Colour.OFF) in (*RED, Colour.YELLOW)
    return line.must_stop


def _crossed(line: StopLine, way: Way, front: float) -> float:
    """The arc length at which the ego's front crosses a line, m; inf where it does not."""
    x, y = way.x + front * np.cos(way.yaw), way.y + front * np.sin(way.yaw)
    (ax, ay), (bx, by) = line.points
    side = (bx - ax) * (y - ay) - (by - ay) * (x - ax)  # of the line on which the front is
    i = np.flatnonzero((side[:-1] * side[1:] <= 0.0) & (side[:-1] != side[1:]))
    u = side[i] / (side[i] - side[i + 1])
    px, py = x[i] + u * (x[i + 1] - x[i]), y[i] + u * (y[i + 1] - y[i])
    within = ((px - ax) * (bx - ax) + (py - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)
    hits = way.s[i] + u * (way.s[i + 1] - way.s[i])
    return float(min(hits[(within >= 0.0) & (within <= 1.0)], default=np.inf))


def _asking(case: _Case, target: FloatArray) -> tuple[int, float]:
    """Of speeds `(m,)` along the way (NaN: free) the most demanding one: where, and its deceleration; -1: none asks."""
    held, s = case.held, case.way.s
    ahead = np.maximum(s - held.s_from, max(held.v * SOON_S, 1e-3))
    with np.errstate(invalid="ignore"):
        asks = (target < held.v) & (s >= held.s_from) & (s <= held.reach)
        need = np.where(asks, (held.v**2 - target**2) / (2.0 * ahead), 0.0)
    i = int(np.argmax(need))
    return (i, float(need[i])) if not held.stands and need[i] >= LEAST_MPS2 else (-1, 0.0)


def _limits(case: _Case) -> Iterator[Cause]:
    """(3)."""
    limit = case.way.limit
    with np.errstate(invalid="ignore"):
        i, need = _asking(case, np.where(limit < case.held.v - OVER_MPS, limit, np.nan))
    if i >= 0:
        yield case.cause(CauseKind.LIMIT, float(case.way.s[i]), need, value=float(limit[i]))


def _curves(case: _Case) -> Iterator[Cause]:
    """(4)."""
    bend = np.abs(case.way.kappa)
    i, need = _asking(case, np.sqrt(CURVE_MPS2 / np.maximum(bend, 1e-9)))
    if i >= 0:
        yield case.cause(CauseKind.CURVE, float(case.way.s[i]), need, value=float(case.held.v**2 * bend[i]))


def _goal(case: _Case, scenario: Scenario) -> Iterator[Cause]:
    """(5)."""
    goal, way, held, car = scenario.goal, case.way, case.held, scenario.vehicle
    if goal is None or not goal.regions or held.stands:
        return
    x, y = way.x + car.axle_to_center * np.cos(way.yaw), way.y + car.axle_to_center * np.sin(way.yaw)
    inside = [i for i in range(len(way.s)) if goal.holds_place(float(x[i]), float(y[i]))]
    if not inside or way.s[inside[0]] > held.reach:
        return
    first, last = float(way.s[inside[0]]), float(way.s[inside[-1]])
    ends = inside[-1] < len(way.s) - 1  # else the region goes on beyond what is looked at
    if ends:
        yield from _in_time(case, goal, last)
    if goal.v is not None and held.v > goal.v[1] + OVER_MPS:
        ahead = max(last - held.s_from, held.v * SOON_S)
        need = (held.v**2 - goal.v[1] ** 2) / (2.0 * ahead) if ends else nan
        yield case.cause(CauseKind.GOAL, first, need, "speed", goal.v[1])
    elif case.course.v_end < STANDING_MPS and last - GOAL_ROOM_M <= held.planned[-1] <= last:
        yield case.cause(CauseKind.GOAL, first, held.need(last), "place")


def _in_time(case: _Case, goal: Goal, last: float) -> Iterator[Cause]:
    """The end of the goal's region is passed before the goal's time."""
    t, held = case.frame.planned.t, case.held
    if goal.t is None or t + held.when(last) >= goal.t[0]:
        return
    left = goal.t[0] - t - held.t_from
    need = 2.0 * (held.v * left - (last - held.s_from)) / left**2 if left > 0.0 else nan
    if need >= LEAST_MPS2:
        yield case.cause(CauseKind.GOAL, last, need, "time", goal.t[0])


def _end(case: _Case) -> Iterator[Cause]:
    """(6)."""
    end, rests = case.way.end, case.course.v_end < STANDING_MPS
    if rests and case.held.planned[-1] <= end <= case.held.reach and not case.held.stands:
        yield case.cause(CauseKind.ROAD_END, end, case.held.need(end))


def _begun(case: _Case) -> Iterator[Cause]:
    """(9)."""
    path, course = case.plan.trajectory, case.course
    t, a = path.t - path.t[0], float(path.a[0])
    if a <= BRAKES_MPS2 and course.t_hardest == 0.0 and case.held.t_from == 0.0 and not case.held.stands:
        over = np.flatnonzero(path.a > BRAKES_MPS2)
        if len(over) and path.v[over[0]] > STANDING_MPS:
            yield Cause(CauseKind.BEGUN, hold_mps=case.held.v, time_s=float(t[over[0]]), value=a)


def _borne_out(case: _Case, found: list[Cause]) -> list[Cause]:
    """The causes with what the planner decided about them."""
    words = {each.agent: each for each in case.plan.internals if isinstance(each, Decision)} | case.decided
    return [
        replace(c, decision=words[c.who].kind.value, reason=words[c.who].reason, inferred=c.who not in case.decided)
        if c.who in words else c
        for c in found
    ]  # fmt: skip


def _words(case: _Case, said: set[str]) -> list[Cause]:
    """(7)."""
    out = []
    for name, decision in case.decided.items():
        if name in said or decision.kind is DecisionKind.FOLLOW:
            continue
        if name in case.frame.agents.ids and not _is_near(case, name):
            continue
        out.append(Cause(CauseKind.WORD, name, decision.kind.value, decision.reason, False, case.held.v))
    return out


def _passed(case: _Case) -> list[Cause]:
    """(8)."""
    return [
        Cause(CauseKind.WORD, each.agent, each.kind.value, each.reason, True, case.held.v)
        for each in case.plan.internals
        if isinstance(each, Decision) and each.kind is DecisionKind.OVERTAKE
        if each.agent in case.frame.agents.ids and _is_near(case, each.agent)
    ]


def _is_near(case: _Case, name: str) -> bool:
    """Whether an agent is, or is predicted to be, within `NEAR_M` of the way."""
    agents, futures, way = case.frame.agents, case.frame.predictions, case.way
    i = agents.ids.index(name)
    reach = NEAR_M + 0.5 * float(np.hypot(agents.length[i], agents.width[i]))
    x, y = agents.x[i : i + 1], agents.y[i : i + 1]
    if futures is not None:
        rows = futures.agent == i
        x, y = np.r_[x, futures.x[rows].ravel()], np.r_[y, futures.y[rows].ravel()]
    return bool(np.hypot(way.x[:, None] - x, way.y[:, None] - y).min() <= reach)


def _order(cause: Cause) -> tuple[bool, bool, float, float]:
    """Borne out and named by the planner, inferred, its mere word; of each the most demanding, then the soonest."""
    need = cause.need_mps2 if isfinite(cause.need_mps2) else MOST_MPS2 if cause.is_met else 0.0
    return cause.kind is CauseKind.WORD, cause.inferred, -need, cause.time_s if isfinite(cause.time_s) else LOOK_S
