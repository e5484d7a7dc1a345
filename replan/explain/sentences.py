"""The causes of a plan in words: each sentence is made of the numbers of one `Cause`, and of
nothing else.
"""

from __future__ import annotations

import re
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
    failed = [cause for cause in account.causes if cause.kind is CauseKind.FALLBACK]
    rest = conflicts(account)
    if rest and isfinite(rest[0].need_mps2):
        least = SHARE * rest[0].need_mps2
        rest = [cause for cause in rest if not (cause.inferred and cause.need_mps2 < least)]
    lines = describe_contradictions(account.alarms)
    lines += [f"Fallback: {_join(cause.who, cause.reason)}." for cause in failed]
    course = account.course
    late = (
        f"from t = {account.t + course.t_brakes:.1f} s on"
        if course.t_brakes >= STEP_S
        else "at first"
    )
    opening = OPENINGS.get(course.action, f"Slows down {late}")
    for cause in rest[:MOST]:
        if cause.kind is CauseKind.NONE:
            if isfinite(cause.value):
                lines.append(
                    f"{opening}; no cause found that takes its braking of {cause.value:.1f} m/s²."
                )
                opening = "Also"
                continue
            near = (
                f" {cause.who}, {cause.away_m:.1f} m away, is on its way, but would not be met."
                if cause.who
                else ""
            )
            nothing = "the trace does not hold the predictions that the planner used."
            if account.predicted:
                nothing = (
                    f"{_describe_held_plan(account, cause)} it would meet no road user ahead of it "
                    f"within {cause.time_s:.0f} s, and no limit, curve, stop line, goal or end of "
                    f"the road within {cause.distance_m:.0f} m requires braking.{near}"
                )
            lines.append(f"{opening}; no cause found: {nothing}")
            opening = "Also"
            continue
        mark = cause.decision if not cause.inferred else "inferred"
        if cause.inferred and cause.decision:
            mark = f"inferred; the planner decided: {cause.decision}"
        name = NAMES.get(cause.kind, cause.who)
        lines.append(
            f"{opening} for {name} ({mark}): {_join(cause.reason, _numbers(account, cause))}."
        )
        opening = "Also"
    if len(rest) > MOST:
        lines.append(f"And {len(rest) - MOST} more.")
    return (
        [*lines, f"{rest[0].who} is not passed: {'; '.join(account.not_passed)}."]
        if account.not_passed
        else lines
    )


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
    takes = f", which takes {cause.need_mps2:.1f} m/s²" if isfinite(cause.need_mps2) else ""
    return (
        f"for {NAMES.get(cause.kind, cause.who)} "
        f"({'inferred' if cause.inferred else cause.decision}){takes}"
    )


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
            left = (
                f"the plan keeps {cause.left_m:.1f} m or more, the least in {cause.left_at_s:.1f} s"
            )
            need = _describe_needed_braking("staying behind", cause)
            return _join(
                f"{cause.away_m:.1f} m away",
                f"{held} {would}",
                need,
                left if isfinite(cause.left_m) else "",
            )
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
    away = f"{cause.away_m:.1f} m away" if isfinite(cause.away_m) else ""
    return (
        f"near its way, but not met {held}"
        if cause.inferred
        else _join(away, "a decision of the planner alone")
    )


def _describe_needed_braking(what: str, cause: Cause) -> str:
    if not isfinite(cause.need_mps2):
        return ""
    return f"{what} takes " + (
        f"{cause.need_mps2:.1f} m/s²" if cause.need_mps2 >= 0.05 else "less than 0.05 m/s²"
    )
