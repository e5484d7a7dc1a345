"""The causes of a plan in words: each sentence is made of the numbers of one `Cause`, and of nothing else."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from math import isfinite

from replay.explain.causes import Account, Cause, CauseKind
from replay.explain.course import STEP_S, Action
from replay.explain.meetings import GAP_M, HEADWAY_S

MOST = 3
"""More causes than these are counted."""


def sentences(account: Account) -> list[str]:
    """Why a plan slows down or stands, the first cause first; empty where it does neither and is no fallback."""
    failed = [cause for cause in account.causes if cause.kind is CauseKind.FALLBACK]
    rest = conflicts(account)
    lines = [f"Fallback: {_listed(cause.who, cause.reason)}." for cause in failed]
    for i, cause in enumerate(rest[:MOST]):
        opening = _opening(account) if i == 0 else "Also"
        lines.append(_none(account, cause) if cause.kind is CauseKind.NONE else f"{opening} {_said(account, cause)}.")
    if len(rest) > MOST:
        lines.append(f"And {len(rest) - MOST} more.")
    return [*lines, f"{rest[0].who} is not passed: {'; '.join(account.not_passed)}."] if account.not_passed else lines


def conflicts(account: Account) -> list[Cause]:
    """The causes but fallbacks, without who is in the reason of an earlier one ("car 3 goes first"): one conflict."""
    said: list[Cause] = []
    named: set[str] = set()
    causes = [cause for cause in account.causes if cause.kind is not CauseKind.FALLBACK]
    people = [cause.who for cause in causes if cause.kind in (CauseKind.AGENT, CauseKind.WORD)]
    for cause in causes:
        if cause.who not in named:
            said.append(cause)
        if cause.kind is CauseKind.STOP:
            named |= _named(cause.reason, people)
    return said


def _named(reason: str, people: Sequence[str]) -> set[str]:
    """Whose name is in a reason; of several that of the last: the first may be the word for what they are.

    Many are called by a number: those with a fraction are measured.
    """
    found = {
        hit.start(): who
        for who in people
        for hit in re.finditer(rf"(?<![\w.]){re.escape(who)}(?!\w|\.\d)", reason)
        if who
    }
    return {found[max(found)]} if found else set()


def _opening(account: Account) -> str:
    """What it does, by its course."""
    course = account.course
    if course.action is Action.STANDS:
        return "Stands"
    if course.action is Action.SLOWS:
        return "Slows down"
    return "Slows down " + (
        f"from t = {account.t + course.t_brakes:.1f} s on" if course.t_brakes >= STEP_S else "at first"
    )


def _said(account: Account, cause: Cause) -> str:
    """Who or what it is for, and its numbers."""
    name, words = _WORDS[cause.kind]
    mark = cause.decision if not cause.inferred else "inferred"
    if cause.inferred and cause.decision:
        mark = f"inferred; the planner decided: {cause.decision}"
    return f"for {name or cause.who} ({mark}): {_listed(cause.reason, words(account, cause))}"


def _listed(*parts: str) -> str:
    return "; ".join(part for part in parts if part)


def _none(account: Account, cause: Cause) -> str:
    """What was looked for."""
    if not account.predicted:
        return f"{_opening(account)}; no cause found: what the planner expected of the others was not kept."
    near = f" {cause.who}, {cause.away_m:.1f} m away, is on its way, but would not be met." if cause.who else ""
    return (
        f"{_opening(account)}; no cause found: {_held(account, cause)} it would meet no one ahead of it within"
        f" {cause.time_s:.0f} s, and no limit, curve, line, goal or end of the road within {cause.distance_m:.0f} m"
        f" asks for it.{near}"
    )


def _held(account: Account, cause: Cause) -> str:
    return "driving off" if account.course.action is Action.STANDS else f"at {cause.hold_mps:.1f} m/s"


def _agent(account: Account, cause: Cause) -> str:
    if cause.is_met:
        would = f"it would come within {GAP_M:g} m of them in {cause.time_s:.1f} s, after {cause.distance_m:.1f} m"
    else:
        would = f"it would follow by less than {HEADWAY_S:g} s from {cause.time_s:.1f} s on"
    left = ""
    if isfinite(cause.left_m):
        left = f"the plan comes as near as {cause.left_m:.1f} m, in {cause.left_at_s:.1f} s"
    need = _need("staying behind", cause)
    return _listed(f"{cause.away_m:.1f} m away", f"{_held(account, cause)} {would}", need, left)


def _need(what: str, cause: Cause) -> str:
    if not isfinite(cause.need_mps2):
        return ""
    return f"{what} takes " + (f"{cause.need_mps2:.1f} m/s²" if cause.need_mps2 >= 0.05 else "less than 0.05 m/s²")


def _stop(account: Account, cause: Cause) -> str:
    when = f"{cause.distance_m:.1f} m on, {_held(account, cause)} in {cause.time_s:.1f} s"
    return _listed(when, _need("stopping there", cause))


def _limit(account: Account, cause: Cause) -> str:
    return _listed(
        f"{cause.value:.1f} m/s from {cause.distance_m:.1f} m on, instead of {cause.hold_mps:.1f} m/s",
        _need("keeping it", cause),
    )


def _curve(account: Account, cause: Cause) -> str:
    across = f"{_held(account, cause)} it would be {cause.value:.1f} m/s² across, {cause.distance_m:.1f} m on"
    return _listed(across, _need("being slower there", cause))


def _goal(account: Account, cause: Cause) -> str:
    at = f"{cause.distance_m:.1f} m on"
    said = {
        "time": f"{at}, {_held(account, cause)} in {cause.time_s:.1f} s, but not to be reached before"
        f" t = {cause.value:.1f} s",
        "speed": f"{at}, at no more than {cause.value:.1f} m/s, instead of {cause.hold_mps:.1f} m/s",
        "place": f"{at}, the plan comes to rest at it",
    }[cause.who]
    return _listed(said, _need("that", cause))


def _begun(account: Account, cause: Cause) -> str:
    return f"the plan starts with {cause.value:.1f} m/s², as the ego moves, and lets go of it in {cause.time_s:.1f} s"


def _end(account: Account, cause: Cause) -> str:
    return _listed(f"the map ends {cause.distance_m:.1f} m on", _need("stopping before it", cause))


def _word(account: Account, cause: Cause) -> str:
    return f"near its way, but {_held(account, cause)} not met" if cause.inferred else "so the planner says"


_WORDS: dict[CauseKind, tuple[str, Callable[[Account, Cause], str]]] = {
    CauseKind.AGENT: ("", _agent),
    CauseKind.STOP: ("", _stop),
    CauseKind.LIMIT: ("the speed limit", _limit),
    CauseKind.CURVE: ("a curve", _curve),
    CauseKind.GOAL: ("the goal", _goal),
    CauseKind.ROAD_END: ("the end of the road", _end),
    CauseKind.BEGUN: ("braking that has begun before", _begun),
    CauseKind.WORD: ("", _word),
}
"""Name (empty: the cause's own) and numbers by kind."""
