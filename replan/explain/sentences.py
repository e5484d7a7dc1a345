"""The causes of a plan in words: each sentence is made of the numbers of one `Cause`, and of
nothing else.
"""

from __future__ import annotations

import re
from itertools import chain, repeat
from math import isfinite

from replan.explain.causes import SHARE, Account, Cause, CauseKind
from replan.explain.contradictions import describe_contradictions
from replan.explain.course import GAP_M, HEADWAY_S, STEP_S, PlanAction

MOST = 3
"""Largest number of causes in sentences; the number of further causes is given."""
NAMES = {
    CauseKind.LIMIT: "the speed limit",
    CauseKind.CURVE: "a curve",
    CauseKind.GOAL: "the goal",
    CauseKind.ROAD_END: "the end of the road",
    CauseKind.BEGUN: "braking that is under way",
}
"""Names of causes in sentences; any other cause is named by its `who`."""
OPENINGS = {
    PlanAction.STANDS: "Stands",
    PlanAction.CRAWLS: "Crawls",
    PlanAction.SLOWS: "Slows down",
}


def sentences(account: Account) -> list[str]:
    """Numbers that contradict each other, then the causes of slowing down, standing or crawling,
    the first one first.

    Empty if there is none of these and no fallback. An inferred cause that needs less than `SHARE`
    of the first one's deceleration is not named beside it.
    """
    lines = describe_contradictions(account.alarms)
    for cause in account.causes:
        if cause.kind is CauseKind.FALLBACK:
            lines.append(f"Fallback: {_join(cause.who, cause.reason)}.")
    causes = _worth_naming(conflicts(account))
    openings = chain([_opening(account)], repeat("Also"))
    for opening, cause in zip(openings, causes[:MOST], strict=False):
        lines.append(f"{opening}{_describe_cause(account, cause)}")
    if len(causes) > MOST:
        lines.append(f"And {len(causes) - MOST} more.")
    if account.not_passed:  # only if the first cause is a road user
        lines.append(f"{causes[0].who} is not passed: {'; '.join(account.not_passed)}.")
    return lines


def _worth_naming(causes: list[Cause]) -> list[Cause]:
    """The causes, without inferred ones that need much less deceleration than the first one."""
    if not causes or not isfinite(causes[0].need_mps2):
        return causes
    least_mps2 = SHARE * causes[0].need_mps2
    return [cause for cause in causes if not (cause.inferred and cause.need_mps2 < least_mps2)]


def _opening(account: Account) -> str:
    """What the plan does, and from when on if it only slows down later."""
    course = account.course
    if course.action in OPENINGS:
        return OPENINGS[course.action]
    if course.t_brakes >= STEP_S:
        return f"Slows down from t = {account.t + course.t_brakes:.1f} s on"
    return "Slows down at first"


def _describe_cause(account: Account, cause: Cause) -> str:
    """The rest of a sentence that begins with what the plan does."""
    if cause.kind is CauseKind.NONE:
        return f"; no cause found{_describe_unexplained(account, cause)}"
    mark = cause.decision
    if cause.inferred:
        mark = f"inferred; the planner decided: {mark}" if mark else "inferred"
    name = NAMES.get(cause.kind, cause.who)
    return f" for {name} ({mark}): {_join(cause.reason, _numbers(account, cause))}."


def _describe_unexplained(account: Account, cause: Cause) -> str:
    """What was looked for in vain, and the nearest road user on the way of the ego."""
    if isfinite(cause.value):
        return f" that requires its braking of {cause.value:.1f} m/s²."
    if not account.predicted:
        return ": the trace does not hold the predictions that the planner used."
    words = (
        f": {_describe_held_plan(account, cause)} it would meet no road user ahead of it within "
        f"{cause.time_s:.0f} s, and no limit, curve, stop line, goal or end of the road within "
        f"{cause.distance_m:.0f} m requires braking."
    )
    if not cause.who:
        return words
    return f"{words} {cause.who}, {cause.away_m:.1f} m away, is on its way, but would not be met."


def brief(account: Account) -> str:
    """The first cause in a few words: "for 12 (follow), which takes 1.7 m/s²"; "" if there is
    none.
    """
    if not account.causes:
        return ""
    cause = account.causes[0]
    if cause.kind is CauseKind.FALLBACK:
        return f"fallback: {_join(cause.who, cause.reason)}"
    if cause.kind is CauseKind.NONE:
        return "no cause found"
    mark = "inferred" if cause.inferred else cause.decision
    words = f"for {NAMES.get(cause.kind, cause.who)} ({mark})"
    if not isfinite(cause.need_mps2):
        return words
    return f"{words}, which takes {cause.need_mps2:.1f} m/s²"


def conflicts(account: Account) -> list[Cause]:
    """The causes except fallbacks, one for each conflict: an agent in the reason of an earlier stop
    is not repeated.
    """
    separate: list[Cause] = []
    named: set[str] = set()
    causes = [cause for cause in account.causes if cause.kind is not CauseKind.FALLBACK]
    agents = [cause.who for cause in causes if cause.kind in (CauseKind.AGENT, CauseKind.WORD)]
    for cause in causes:
        if cause.who not in named:
            separate.append(cause)
        if cause.kind is CauseKind.STOP:
            # if a reason names several agents, the last one is taken: the first may be a common
            # noun; many agents are called by a number, and a number with a fraction is a
            # measurement
            positions = {
                hit.start(): agent
                for agent in filter(None, agents)
                for hit in re.finditer(rf"(?<![\w.]){re.escape(agent)}(?!\w|\.\d)", cause.reason)
            }
            named |= {positions[max(positions)]} if positions else set()
    return separate


def _join(*parts: str) -> str:
    return "; ".join(part for part in parts if part)


def _describe_held_plan(account: Account, cause: Cause) -> str:
    if account.course.is_slow:
        return "driving off" if account.course.action is PlanAction.STANDS else "speeding up"
    return f"at {cause.hold_mps:.1f} m/s"


def _numbers(account: Account, cause: Cause) -> str:
    """The numbers of a cause, by its kind."""
    held, place = _describe_held_plan(account, cause), f"after {cause.distance_m:.1f} m"
    match cause.kind:
        case CauseKind.AGENT:
            if cause.is_met:
                would = f"it would come within {GAP_M:g} m of them in {cause.time_s:.1f} s, {place}"
            else:
                would = f"it would follow by less than {HEADWAY_S:g} s from {cause.time_s:.1f} s on"
            need = _describe_needed_braking("staying behind", cause)
            left = ""
            if isfinite(cause.left_m):
                left = f"the plan keeps {cause.left_m:.1f} m or more, the least in "
                left += f"{cause.left_at_s:.1f} s"
            return _join(f"{cause.away_m:.1f} m away", f"{held} {would}", need, left)
        case CauseKind.STOP:
            return _join(
                f"{place}, {held} in {cause.time_s:.1f} s",
                _describe_needed_braking("stopping there", cause),
            )
        case CauseKind.LIMIT:
            limit = f"{cause.value:.1f} m/s {place}, instead of {cause.hold_mps:.1f} m/s"
            return _join(limit, _describe_needed_braking("keeping it", cause))
        case CauseKind.CURVE:
            across = f"{held} the lateral acceleration would be {cause.value:.1f} m/s² {place}"
            return _join(across, _describe_needed_braking("slowing down for it", cause))
        case CauseKind.GOAL:
            goal = {
                "time": (
                    f"{held} it is passed in {cause.time_s:.1f} s, but its time begins at t = "
                    f"{cause.value:.1f} s"
                ),
                "speed": f"at most {cause.value:.1f} m/s, instead of {cause.hold_mps:.1f} m/s",
                "place": "the plan stops at it",
            }[cause.who]
            return _join(f"{place}, {goal}", _describe_needed_braking("that", cause))
        case CauseKind.BEGUN:
            return (
                f"the plan starts at {cause.value:.1f} m/s², as the ego moves, and releases it "
                f"in {cause.time_s:.1f} s"
            )
        case CauseKind.ROAD_END:
            return _join(
                f"the map ends {place}", _describe_needed_braking("stopping before it", cause)
            )
        case _:  # WORD: a decision of the planner without a need that is known
            if cause.inferred:
                return f"near its way, but not met {held}"
            away = f"{cause.away_m:.1f} m away" if isfinite(cause.away_m) else ""
            return _join(away, "a decision of the planner alone")


def _describe_needed_braking(purpose: str, cause: Cause) -> str:
    if not isfinite(cause.need_mps2):
        return ""
    if cause.need_mps2 < 0.05:
        return f"{purpose} takes less than 0.05 m/s²"
    return f"{purpose} takes {cause.need_mps2:.1f} m/s²"
