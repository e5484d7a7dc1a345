"""What a gate says of many logs together, made of what each log says (`metrics.judge`).

The logs are those that the gate asks for; judged is one that passes or fails; inconclusive one with no evidence (no
value, or excused); missing one that could not be evaluated, crashed or has no result. What must hold the bound:

    worst           every judged log
    mean, median    that of the judged logs
    sum             the sum over all values
    pass_share      each log by itself, in `min_share` of the logs: passed / (passed + failed + inconclusive + missing)

Missing logs count against. Over worst, mean, median and sum a verdict is

    FAIL            the bound is broken
    INCONCLUSIVE    else, where any log is missing, fewer than `min_logs` were judged, or more than `max_missing` of the
                    logs are inconclusive or missing
    PASS            else

and over a pass share, where a missing log counts like a failed one:

    FAIL            the share would be below `min_share` even if all inconclusive logs had passed
    INCONCLUSIVE    the share is below `min_share`; or with `confident` the lower end of its 95 % interval is
                    (`metrics.aggregate`, equation 1: too few logs to say); or `min_logs`, `max_missing` as above
    PASS            else

FAIL is INCONCLUSIVE where the gate says `broken = "inconclusive"`. Nothing judged is INCONCLUSIVE always.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite, nan
from types import MappingProxyType

import numpy as np

from metrics.aggregate import wilson
from metrics.gates import Gate, Outcome


@dataclass(frozen=True, slots=True)
class LogOutcome:
    """The outcome of a gate on one log: `why` it is inconclusive or not asked, else the road user that it is about."""

    log: str
    outcome: Outcome
    why: str
    value: float = nan
    unit: str = ""
    time_s: float = nan
    evaluated: bool = True


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a gate says of one planner in one mode, and why.

    Attributes:
        gate: The rule.
        outcome: Pass, fail, inconclusive or not asked.
        reason: One sentence that names planner, worst log, value and time.
        planner: "" where no planner was to be judged; `mode` likewise.
        value: The judged value (what `over` makes of the logs, or the worst log's); NaN where there is none.
        log: The worst log; "" where there is none.
        time_s: When its value occurred; NaN where it has no time.
        logs: The outcome of each log that the gate selects.
        group: "family everyday/cut_in" where the gate has a verdict per group; else "".
    """

    gate: Gate
    outcome: Outcome
    reason: str
    planner: str = ""
    mode: str = ""
    value: float = nan
    log: str = ""
    time_s: float = nan
    logs: tuple[LogOutcome, ...] = ()
    group: str = ""


_REDUCE: Mapping[str, Callable[[Sequence[float]], float]] = MappingProxyType(
    {"mean": lambda v: float(np.mean(v)), "median": lambda v: float(np.median(v)), "sum": lambda v: float(np.sum(v))}
)


def verdict_on(gate: Gate, drive: tuple[str, str], logs: tuple[LogOutcome, ...], group: str = "") -> Verdict:
    """The verdict on one planner and mode; NOT ASKED where no log was asked and the gate is optional.

    Args:
        gate: The rule.
        drive: Planner and mode.
        logs: The outcome of each log that the gate selects.
        group: Which logs these are; "": all that the gate selects.
    """
    planner, mode = drive
    who = f"{planner}, {mode} loop" + (f", {group}" if group else "")
    nothing = Verdict(gate, Outcome.INCONCLUSIVE, f"{who}: no log was asked", planner, mode, logs=logs, group=group)
    found = tuple(log for log in logs if log.outcome is not Outcome.NOT_ASKED)
    if not found:
        why = Counter(log.why for log in logs).most_common(1)
        reason = f"{who}: no log was asked" + (f" ({why[0][0]})" if why else "")
        return replace(nothing, outcome=Outcome.NOT_ASKED if gate.optional else Outcome.INCONCLUSIVE, reason=reason)
    judged = [log for log in found if isfinite(log.value) and log.outcome is not Outcome.INCONCLUSIVE]
    aside = _aside(found)
    if not judged:
        return replace(nothing, reason=f"{who}: nothing to judge{aside}")
    bad = min(judged, key=lambda log: gate.margin(log.value))
    few = f"; {_logs(len(judged))} judged, {gate.min_logs} must be" if len(judged) < gate.min_logs else ""
    value, outcome, what = (_shared if gate.over == "pass_share" else _held)(gate, judged, bad, found)
    reason = f"{who}: {what}{few}{aside}"
    return replace(nothing, outcome=outcome, reason=reason, value=value, log=bad.log, time_s=bad.time_s)


def _held(
    gate: Gate, judged: Sequence[LogOutcome], bad: LogOutcome, found: Sequence[LogOutcome]
) -> tuple[float, Outcome, str]:
    """Value, outcome and what was found, of one value that holds the bound or does not."""
    reduce = _REDUCE.get(gate.over)
    value = reduce([log.value for log in judged]) if reduce else bad.value
    broken = sum(gate.margin(log.value) < 0.0 for log in judged)
    share = f"; broken in {broken} of {_logs(len(judged))}" if gate.over == "worst" and broken else ""
    if gate.margin(value) < 0.0:
        outcome = Outcome(gate.broken)
    else:
        lost = any(not log.evaluated for log in found)
        outcome = Outcome.INCONCLUSIVE if lost or _lacking(gate, judged, found) else Outcome.PASS
    return value, outcome, f"{_found(gate, value, bad)}{share}"


def _shared(
    gate: Gate, judged: Sequence[LogOutcome], bad: LogOutcome, found: Sequence[LogOutcome]
) -> tuple[float, Outcome, str]:
    """The same of the share of logs that pass."""
    least, n = gate.min_share or 0.0, len(found)
    passed = sum(log.outcome is Outcome.PASS for log in found)
    unsure = sum(log.outcome is Outcome.INCONCLUSIVE and log.evaluated for log in found)
    low, high = wilson(passed, n)
    if (passed + unsure) / n < least:
        outcome, how = Outcome(gate.broken), f"below {100.0 * least:g} %"
    elif passed / n < least:
        outcome, how = Outcome.INCONCLUSIVE, f"below {100.0 * least:g} %, unless what is inconclusive passes"
    elif gate.confident and low < least:
        outcome, how = Outcome.INCONCLUSIVE, f"but not surely {100.0 * least:g} %"
    elif _lacking(gate, judged, found):
        outcome, how = Outcome.INCONCLUSIVE, f"at least {100.0 * least:g} %, but of too few that were judged"
    else:
        outcome, how = Outcome.PASS, f"at least {100.0 * least:g} %"
    interval = f"95 % interval {100.0 * low:.3g} to {100.0 * high:.3g} %"
    share = f"holds in {passed} of {_logs(n)} ({100.0 * passed / n:.3g} %, {interval}), {how}"
    worst = f"worst {bad.value:.4g}{unit_of(bad.unit)} {_place(bad)}"
    return passed / n, outcome, f"{gate.bound} {share}; {worst}"


def _lacking(gate: Gate, judged: Sequence[LogOutcome], found: Sequence[LogOutcome]) -> bool:
    """Whether too few logs were judged."""
    return len(judged) < gate.min_logs or len(found) - len(judged) > gate.max_missing * len(found) + 1e-9


def _found(gate: Gate, value: float, worst_log: LogOutcome) -> str:
    """What was found: "gap.min = 0.31 m, below 0.5, on log X at 3.20 s (car 7)"."""
    unit = unit_of(worst_log.unit)
    if gate.min is not None and value < gate.min:
        bound = f", below {gate.min:g},"
    elif gate.max is not None and value > gate.max:
        bound = f", above {gate.max:g},"
    else:
        bound = ", within bounds,"
    worst = f"worst {worst_log.value:.4g}{unit} " if gate.over in _REDUCE else ""
    return f"{gate.judged} = {value:.4g}{unit}{bound} {worst}{_place(worst_log)}"


def _place(log: LogOutcome) -> str:
    """Where a value is: "on log X at 3.20 s (car 7)"."""
    when = f" at {log.time_s:.2f} s" if isfinite(log.time_s) else ""
    return f"on {log.log}{when}" + (f" ({log.why})" if log.why else "")


def unit_of(unit: str) -> str:
    """A unit behind its number; nothing of ratios and counts."""
    return "" if unit in ("1", "count") else f" {unit}"


def _logs(count: int) -> str:
    return "1 log" if count == 1 else f"{count} logs"


def _aside(found: Sequence[LogOutcome]) -> str:
    """What could not be judged: logs without evidence (with the commonest reason), logs without a result."""
    without = [log for log in found if log.outcome is Outcome.INCONCLUSIVE and log.evaluated]
    missing = [log for log in found if not log.evaluated]
    out = ""
    if without:
        ran = len(found) - len(missing)
        common = Counter(log.why for log in without).most_common(1)[0][0]
        out = f"; no evidence in {len(without)} of {_logs(ran)} ({common})"
    if missing:
        out += f"; {_logs(len(missing))} could not be evaluated ({missing[0].log}: {missing[0].why})"
    return out
