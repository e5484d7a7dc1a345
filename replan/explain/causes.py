"""The causes for which a plan slows down, stands or crawls: the conflicts and violations if it did
not.

The causes are found from public data: the plan, the frame, the predictions, the road. The plan is
"held": continued along its way at constant speed (`replan.explain.course`); each cause gives the
consequence, and the least constant deceleration that avoids it. A decision of the planner is its
cause only if the numbers confirm it; all other causes are inferred.

(1) agent   met, or followed too near (`replan.explain.course`)
(2) stop    a stop line with a light or sign that requires it, or another obstacle in the S-T graph
            that the planner
stops for
(3) limit   the speed limit along the way is lower than the speed that is held, by `OVER_MPS`
(4) curve   v^2 |kappa| > `CURVE_MPS2` somewhere along the way
(5) goal    the goal is reached before its time, too fast, or passed although the plan stops at it
(6) end     the map ends on the way, and the plan stops before it
(7) word    the planner's STOP or YIELD for an agent near the way that the ego would not meet, or
            for an object without a position
(8) beside  the planner's FOLLOW of an agent within `BESIDE_M` who would not be met, where none of
            these needs so much
(9) passed  none of these, but a planner's OVERTAKE of an agent near the way: the plan brakes before
            it overtakes
(10) begun  none of these, and the plan brakes hardest at its start and less before it stands: it
            eases a braking that began in an earlier plan

A cause accounts for the braking if the planner named it, or if it needs `SHARE` of the hardest
braking of the plan, or that braking is below `FELT_MPS2`. Causes that do not account for it come
last; if none does, (8), (9), (10), or that no cause was found, comes first.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from enum import Enum
from itertools import chain, repeat
from math import isfinite, nan
from operator import attrgetter

import numpy as np

from replan.explain.contradictions import Contradiction, contradictions
from replan.explain.course import (
    BRAKES_MPS2,
    LOOK_S,
    STANDING_MPS,
    STEP_S,
    Course,
    Held,
    Meeting,
    PlanWay,
    Ways,
    meetings,
)
from replan.explain.planner_input import PlannerInput, planner_inputs
from replan.logs.plan import Candidates, Decision, DecisionKind, LaneOption, Plan, StGraph
from replan.logs.rules import RED, Colour
from replan.logs.scenario import Scenario
from replan.logs.shapes import distance
from replan.logs.trace import Trace
from replan.replay.loop_config import LoopConfig

STAYS_BEHIND = (DecisionKind.STOP, DecisionKind.YIELD, DecisionKind.FOLLOW)
OVER_MPS = 0.3
CURVE_MPS2 = 2.5
"""Lateral acceleration above which a curve is a reason to be slower: below what planners allow
themselves (3.0).
"""
SOON_S = 1.0
"""A limit or curve nearer than this is treated as this far away, because no driver brakes
instantly.
"""
LEAST_MPS2 = 0.05
"""A limit, curve or goal that requires less deceleration is not a cause."""
MOST_MPS2 = 9.81
"""The ego cannot stop at a stop line that requires more deceleration."""
GOAL_ROOM_M = 10.0
"""A plan that stops at most this far before the end of the goal's region stops for the goal."""
SHARE = 1.0 / 3.0
"""A plan that keeps a constant deceleration with limited jerk brakes about twice as hard at its
peak.
"""
FELT_MPS2 = 1.5
"""Weaker braking is accounted for by any cause."""
SAME_M = 0.1
"""An obstacle of the S-T graph whose lower station changes by less than this is standing."""
BESIDE_M = 1.0
"""Largest distance between the boxes of the ego and an agent who may come into its way from beside
it.
"""
NEAR_M = 3.0
"""Largest distance from the way of an agent that is near it."""
KEEP = "keep"
"""The lane option of the current lane, and the candidate of `PASSING` that passes no agent."""
PASSING = "passing"
"""The stage that compares passing with following."""


class CauseKind(Enum):
    """The kinds of causes; the value is the name in tables."""

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
    """A cause, with the numbers of its sentence; NaN if a number does not apply.

    Attributes:
        who: The agent, stop line or obstacle; FALLBACK: the status; GOAL: "time", "speed" or
            "place".
        decision: The planner's decision about it ("follow"); empty if there is none.
        reason: The planner's reason for the decision.
        inferred: Whether the planner did not name it.
        hold_mps: The speed that is held; for a plan that stands or crawls, the speed that it would
            reach.
        away_m: AGENT, and WORD of an agent beside: distance between the boxes now.
        time_s: Time at which it would be met or reached, s from the frame.
        distance_m: Distance that the ego would have driven until then, m.
        need_mps2: The least constant deceleration that avoids it.
        value: LIMIT: the limit, m/s; CURVE: the lateral acceleration, m/s2; GOAL: its time, s, or
            speed, m/s; BEGUN: the acceleration that the plan starts with, m/s2; NONE: the hardest
            deceleration, m/s2, if others are too weak.
        left_m: AGENT: the least gap of the plan behind them, m.
        left_at_s: AGENT: time of the least gap, s from the frame.
        is_met: AGENT: whether they would be met; otherwise they would be followed too near, or are
            only in the way.
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

    @property
    def rank(self) -> tuple[bool, bool, float, float]:
        """Sort key: causes with numbers before decisions alone, named before inferred, by
        deceleration, by time.
        """
        need = MOST_MPS2 if self.is_met else 0.0
        if isfinite(self.need_mps2):
            need = self.need_mps2
        return (
            self.kind is CauseKind.WORD,
            self.inferred,
            -need,
            self.time_s if isfinite(self.time_s) else LOOK_S,
        )

    def accounts_for(self, a_least: float) -> bool:
        """Whether it is a reason to brake as hard as `a_least`, m/s2, which is negative."""
        named = not self.inferred or not isfinite(self.need_mps2)
        return named or -a_least < FELT_MPS2 or self.need_mps2 >= SHARE * -a_least


@dataclass(frozen=True, slots=True)
class Account:
    """The action of a plan and its causes: those that the planner named first, then by required
    deceleration.

    Attributes:
        course: The action of the plan.
        predicted: Whether the predictions of the other agents were available.
        causes: Causes of slowing down or standing; empty if it does neither. The kind is NONE if no
            cause was found.
        not_passed: The reasons that the planner reports for not passing the agent in the way.
        alarms: Numbers of the plan that contradict what the planner was shown.
    """

    t: float
    course: Course
    predicted: bool
    causes: tuple[Cause, ...]
    not_passed: tuple[str, ...] = ()
    alarms: tuple[Contradiction, ...] = ()


def accounts(
    trace: Trace,
    scenario: Scenario,
    loop: LoopConfig | None = None,
    earlier: Iterable[float] = (),
    wanted: Iterable[float] = (),
) -> Iterator[Account]:
    """The account of each frame of a drive; arguments as `planner_inputs`.

    `wanted` has a speed for each frame, m/s: why a plan is not that fast is then asked also where
    it does not brake; NaN, or none: it is not.
    """
    explainer, inputs = Explainer(scenario), planner_inputs(trace, scenario, loop, earlier)
    return (
        explainer.account(frame, speed)
        for frame, speed in zip(inputs, chain(wanted, repeat(nan)), strict=False)
    )


@dataclass(frozen=True, eq=False, slots=True)
class _Case:
    """A plan that is held: the input of the functions that find causes."""

    frame: PlannerInput
    course: Course
    held: Held
    way: PlanWay
    decided: dict[str, Decision]
    scenario: Scenario

    @property
    def plan(self) -> Plan:
        return self.frame.planned.plan

    def cause(
        self, kind: CauseKind, distance: float, need: float, who: str = "", value: float = nan
    ) -> Cause:
        """A cause at a place on the way."""
        time = self.held.when(distance)
        return Cause(
            kind,
            who,
            hold_mps=self.held.v,
            time_s=time,
            distance_m=distance,
            need_mps2=need,
            value=value,
        )

    def is_near(self, name: str) -> bool:
        """Whether an agent is, or is predicted to be, within `NEAR_M` of the way."""
        agents, futures, path = self.frame.agents, self.frame.predictions, self.way
        row = agents.ids.index(name)
        reach = NEAR_M + 0.5 * float(np.hypot(agents.length[row], agents.width[row]))
        x, y = agents.x[row : row + 1], agents.y[row : row + 1]
        if futures is not None:
            rows = futures.agent == row
            x, y = np.r_[x, futures.x[rows].ravel()], np.r_[y, futures.y[rows].ravel()]
        return bool(np.hypot(path.x[:, None] - x, path.y[:, None] - y).min() <= reach)


class Explainer:
    """Finds the causes of the plans of one drive."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario, self._ways = scenario, Ways(scenario)

    def account(self, frame: PlannerInput, wanted: float = nan) -> Account:
        """Why the plan of a frame slows down or stands, or is not as fast as a wanted speed,
        m/s.
        """
        plan = frame.planned.plan
        course = Course.of(plan)
        predicted = frame.predictions is not None
        alarms = tuple(contradictions(frame, self._scenario, self._ways))
        failed = (
            [Cause(CauseKind.FALLBACK, plan.status.value, reason=plan.reason, inferred=False)]
            if plan.status.is_fallback
            else []
        )
        if not course.is_asked and not isfinite(wanted):
            return Account(frame.planned.t, course, predicted, tuple(failed), alarms=alarms)
        decided: dict[str, Decision] = {}
        for decision in plan.internals:
            if isinstance(decision, Decision) and decision.kind in STAYS_BEHIND:
                decided.setdefault(decision.agent, decision)
        held = Held.of(plan, course, wanted)
        case = _Case(frame, course, held, self._ways.of(plan, held.reach), decided, self._scenario)
        met: list[Meeting] = []
        if frame.predictions is not None and len(frame.predictions):
            # an agent that the planner passes (nudge, overtake) has no margin
            named = {d.agent for d in plan.internals if isinstance(d, Decision)} - decided.keys()
            passed = np.array([name in named for name in frame.agents.ids], np.bool_)
            met = meetings(
                held, case.way, frame.agents, frame.predictions, self._scenario.vehicle, passed
            )
        causes = [_met_agent(meeting, case) for meeting in met if isfinite(meeting.time_s)]  # (1)
        causes += [*_stops(case), *_limit_and_curve(case), *_goal_and_end(case)]
        decisions = {
            decision.agent: decision
            for decision in plan.internals
            if isinstance(decision, Decision)
        } | decided
        for i, cause in enumerate(causes):
            if cause.who in decisions:
                decision, inferred = decisions[cause.who], cause.who not in decided
                word, reason = decision.kind.value, decision.reason
                causes[i] = replace(cause, decision=word, reason=reason, inferred=inferred)
        explained = {cause.who for cause in causes}
        for name, decision in decided.items():  # (7)
            named_only = name not in explained and decision.kind is not DecisionKind.FOLLOW
            if named_only and (name not in frame.agents.ids or case.is_near(name)):
                word, reason = decision.kind.value, decision.reason
                causes.append(Cause(CauseKind.WORD, name, word, reason, False, held.v))
        causes.sort(key=lambda cause: (not cause.accounts_for(course.a_least), cause.rank))
        enough = max(FELT_MPS2, SHARE * -course.a_least)
        is_enough = any(cause.need_mps2 >= enough for cause in causes)
        if not failed and -course.a_least >= enough and not is_enough:
            causes = [*(cause for cause in _beside(case) if cause.who not in explained), *causes]
        if not failed and not (causes and causes[0].accounts_for(course.a_least)):
            unexplained = Cause(CauseKind.NONE, hold_mps=held.v)
            if met and not causes:
                nearest = min(met, key=attrgetter("away_m"))
                unexplained = replace(_met_agent(nearest, case), kind=CauseKind.NONE)
            unexplained = replace(
                unexplained,
                time_s=float(held.t[-1]),
                distance_m=held.reach,
                value=-course.a_least if causes else nan,
            )
            causes = [*(_passed_or_begun(case) or [unexplained]), *causes]
        why_not = not_passed(plan) if causes and causes[0].kind is CauseKind.AGENT else ()
        return Account(frame.planned.t, course, predicted, (*failed, *causes), why_not, alarms)


def _met_agent(one: Meeting, case: _Case) -> Cause:
    """A meeting as a cause."""
    return Cause(
        CauseKind.AGENT,
        one.agent,
        hold_mps=case.held.v,
        away_m=one.away_m,
        time_s=one.time_s,
        distance_m=one.distance_m,
        need_mps2=one.need_mps2,
        left_m=one.left_m,
        left_at_s=one.left_at_s,
        is_met=one.is_met,
    )


def _stops(case: _Case) -> Iterator[Cause]:
    """(2): stop lines of the road, and other obstacles of the S-T graph that the planner decided to
    stop for.
    """
    front, lanes, lights = (
        case.scenario.vehicle.axle_to_front,
        set(case.way.lanes),
        case.frame.lights,
    )
    places: dict[str, float] = {}
    for line in case.scenario.road.stop_lines:
        name, demanded = f"stop line {line.id}", line.must_stop
        if line.light is not None:
            demanded = lights.get(line.light, Colour.OFF) in (*RED, Colour.YELLOW)
        on_way = line.lane in lanes and (not line.towards or not lanes.isdisjoint(line.towards))
        if on_way and (name in case.decided or demanded):
            places[name] = case.way.crossing(line.points, front)
    end = float(case.plan.trajectory.t[-1]) - case.frame.planned.t - STEP_S
    graphs = [item for item in case.plan.internals if isinstance(item, StGraph)]
    for obstacle in chain.from_iterable(graph.obstacles for graph in graphs):
        is_agent = obstacle.agent in case.frame.agents.ids
        if is_agent or obstacle.agent not in case.decided or not len(obstacle.outline):
            continue
        t, s = obstacle.outline.T
        nearest = float(s.min())
        highest = max(float(s[t == instant].min()) for instant in set(t.tolist()))
        # It stands, and is still predicted when the ego would arrive
        if highest - nearest < SAME_M and t.max() >= min(case.held.when(nearest), end):
            places[obstacle.agent] = nearest
    for name, place in places.items():
        need = case.held.need(place)
        if place <= case.held.reach and (case.held.drives_off or need <= MOST_MPS2):
            yield case.cause(CauseKind.STOP, place, need, name)


def _limit_and_curve(case: _Case) -> Iterator[Cause]:
    """(3) and (4): the speed limit and the curve along the way that require the hardest braking."""
    held, path = case.held, case.way
    if held.is_start:
        return
    limit, bend = path.limit, np.abs(path.kappa)
    ahead = np.maximum(path.s - held.s_from, max(held.v * SOON_S, 1e-3))
    with np.errstate(invalid="ignore"):
        limits = np.where(limit < held.v - OVER_MPS, limit, np.nan)
        allowed = (
            (CauseKind.LIMIT, limits, limit),
            (
                CauseKind.CURVE,
                np.sqrt(CURVE_MPS2 / np.maximum(bend, 1e-9)),
                held.v**2 * bend,
            ),
        )
        for kind, target, value in allowed:
            asks = (target < held.v) & (path.s >= held.s_from) & (path.s <= held.reach)
            need = np.where(asks, (held.v**2 - target**2) / (2.0 * ahead), 0.0)
            index = int(np.argmax(asks if held.drives_off else need))
            if need[index] >= LEAST_MPS2:
                needed = nan if held.drives_off else float(need[index])
                yield case.cause(kind, float(path.s[index]), needed, value=float(value[index]))


def _goal_and_end(case: _Case) -> Iterator[Cause]:
    """(5) and (6): the goal, and the end of the map on the way."""
    goal, car = case.scenario.goal, case.scenario.vehicle
    path, held = case.way, case.held
    if held.drives_off:
        return
    rests, inside = case.course.v_end < STANDING_MPS, list[int]()
    if goal is not None and goal.regions:
        x = path.x + car.axle_to_center * np.cos(path.yaw)
        y = path.y + car.axle_to_center * np.sin(path.yaw)
        inside = [i for i in range(len(path.s)) if goal.holds_place(float(x[i]), float(y[i]))]
    if goal is not None and inside and path.s[inside[0]] <= held.reach:
        first, last = float(path.s[inside[0]]), float(path.s[inside[-1]])
        ends = inside[-1] < len(path.s) - 1  # otherwise the region continues beyond the way
        t = case.frame.planned.t
        # The ego leaves it before its time
        if ends and goal.t is not None and t + held.when(last) < goal.t[0]:
            left = goal.t[0] - t - held.t_from
            need = 2.0 * (held.v * left - (last - held.s_from)) / left**2 if left > 0.0 else nan
            if need >= LEAST_MPS2:
                yield case.cause(CauseKind.GOAL, last, need, "time", goal.t[0])
        if goal.v is not None and held.v > goal.v[1] + OVER_MPS:
            ahead = max(last - held.s_from, held.v * SOON_S)
            need = (held.v**2 - goal.v[1] ** 2) / (2.0 * ahead) if ends else nan
            yield case.cause(CauseKind.GOAL, first, need, "speed", goal.v[1])
        elif rests and last - GOAL_ROOM_M <= held.planned[-1] <= last:
            yield case.cause(CauseKind.GOAL, first, held.need(last), "place")
    if rests and held.planned[-1] <= path.end <= held.reach:
        yield case.cause(CauseKind.ROAD_END, path.end, held.need(path.end))


def _beside(case: _Case) -> Iterator[Cause]:
    """(8): agents beside the ego that the planner follows, the nearest first."""
    car, agents, ego = case.scenario.vehicle, case.frame.agents, case.plan.trajectory.state(0)
    box = *ego.ahead(car.axle_to_center), ego.yaw
    distances_m: dict[str, float] = {}
    for name, decision in case.decided.items():
        if decision.kind is DecisionKind.FOLLOW and name in agents.ids:
            row = agents.ids.index(name)
            other = (
                agents.x[row],
                agents.y[row],
                agents.yaw[row],
                agents.length[row],
                agents.width[row],
            )
            distances_m[name] = float(distance(*box, car.length, car.width, *other))
    for name in sorted(
        (name for name in distances_m if distances_m[name] <= BESIDE_M), key=distances_m.__getitem__
    ):
        reason = case.decided[name].reason
        yield Cause(
            CauseKind.WORD,
            name,
            DecisionKind.FOLLOW.value,
            reason,
            False,
            case.held.v,
            away_m=distances_m[name],
        )


def _passed_or_begun(case: _Case) -> list[Cause]:
    """(9): agents that the plan overtakes.

    Otherwise (10): braking that began in an earlier plan.
    """
    passed = [
        Cause(
            CauseKind.WORD, decision.agent, decision.kind.value, decision.reason, True, case.held.v
        )
        for decision in case.plan.internals
        if isinstance(decision, Decision)
        and decision.kind is DecisionKind.OVERTAKE
        and decision.agent in case.frame.agents.ids
        and case.is_near(decision.agent)
    ]
    path, held = case.plan.trajectory, case.held
    t, a = path.t - path.t[0], float(path.a[0])
    if (
        not passed
        and a <= BRAKES_MPS2
        and case.course.t_hardest == 0.0
        and held.t_from == 0.0
        and not held.drives_off
    ):
        over = np.flatnonzero(path.a > BRAKES_MPS2)
        if len(over) and path.v[over[0]] > STANDING_MPS:
            return [Cause(CauseKind.BEGUN, hold_mps=held.v, time_s=float(t[over[0]]), value=a)]
    return passed


def not_passed(plan: Plan) -> tuple[str, ...]:
    """The reasons that the planner reports for passing no agent: within the lane, then by each
    other lane.
    """
    lanes = [item for item in plan.internals if isinstance(item, LaneOption)]
    if any(not item.against and item.name != KEEP for item in lanes):
        return ()
    stays = [
        item.rejected
        for item in plan.internals
        if isinstance(item, Candidates) and (item.stage, item.chosen) == (PASSING, KEEP)
    ]
    within = [f"in the lane: {reason}" for reason, _ in chain.from_iterable(stays)]
    beside = [
        f"{item.name}: {item.against}" for item in lanes if item.against and item.name != KEEP
    ]
    return (*within, *beside)
