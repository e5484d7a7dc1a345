"""Rules of a comparison (`replan.metrics.judge.gates.GateRule`): how much worse than the baseline a
candidate may be.

Marginal flips and, with "worst", fragile drives break no rule; the reason states their number. A
rule, optional or not, is INCONCLUSIVE where the candidate lacks evidence that the baseline has: the
metric has another version, or only the baseline has it; gates that passed have no value now in more
than LOST_SHARE of the logs; or the change exceeds the limit, `significant` is set, and there are
too few logs for any change to be significant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isfinite

import numpy as np
import pandas as pd

from replan.metrics.comparison import Comparison, RuleVerdict
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.gates import GateRule, Outcome, count_logs, unit_of
from replan.metrics.resampling import MIN_SIGNIFICANT, by_recording, intervals, significant

SEVERITY = (Outcome.PASS, Outcome.INCONCLUSIVE, Outcome.FAIL)
# Share of the logs that passed a gate and may lose their value: as `Gate.max_missing`
LOST_SHARE = 0.1


def judge_rules(
    rules: tuple[GateRule, ...], comparison: Comparison, labels: Mapping[str, LogLabels]
) -> Comparison:
    """Add the verdicts of the rules to a comparison of logs with these labels.

    An optional rule may have none.
    """
    verdicts = []
    for rule in rules:
        result = _judge_rule(rule, comparison, labels)
        if result is not None:
            outcome, reason = result
            rule_reason = (
                f" (the rule: {rule.reason})" if outcome is Outcome.FAIL and rule.reason else ""
            )
            verdicts.append(RuleVerdict(str(rule), outcome, f"{reason}{rule_reason}"))
    return replace(comparison, verdicts=tuple(verdicts))


def _judge_rule(
    rule: GateRule, comparison: Comparison, labels: Mapping[str, LogLabels]
) -> tuple[Outcome, str] | None:
    """Return outcome and reason; None if an optional rule has nothing to judge."""
    if rule.max_missing is not None:
        gone, other = comparison.only_in_baseline, comparison.other_logs
        reason = f"missing in the candidate: {len(gone)} of the baseline's drives"
        reason += f": {_first_three(gone, '; ')}" if gone else ""
        if len(gone) <= rule.limit and other:
            reason += (
                f"; with another content (SHA-256), so no longer the same: {_first_three(other)}"
            )
            return Outcome.INCONCLUSIVE, reason
        return Outcome.FAIL if len(gone) > rule.limit else Outcome.PASS, reason
    tables = []
    for table in (comparison.pairs, comparison.flips):
        tags = table["log"].map(lambda log: labels.get(log, LogLabels()).tags)
        selected = tags.map(set(rule.tags).issubset).astype(bool)
        for column, value in (("mode", rule.mode), ("planner", rule.planner)):
            if value is not None:
                selected &= table[column] == value
        tables.append(table[selected])
    pairs, flips = tables
    names = [name for name in comparison.not_compared if (rule.metric or rule.gate) in ("", name)]
    incomparable = (
        f"of another version, or in the baseline only: {_first_three(names)}" if names else ""
    )
    if rule.max_flips is not None:
        if len(pairs):
            return _judge_flips(rule, flips, pairs, incomparable)
        nothing = "no drives to compare"
    elif incomparable:
        return Outcome.INCONCLUSIVE, f"nothing to judge: {incomparable}"
    else:
        measured = pairs[(pairs["metric"] == rule.metric) & pairs["baseline"].notna()].sort_values(
            "log"
        )
        if len(measured):  # sorted by log, as in the groups: the draws depend on the order
            by = measured.groupby(["planner", "mode"], sort=True)
            results = [
                _judge_change(rule, f"{planner}, {mode} loop", rows) for (planner, mode), rows in by
            ]
            return max(results, key=lambda result: (SEVERITY.index(result[1]), result[0]))[1:]
        nothing = f"{rule.metric} has a value in both runs on none of the selected logs"
    return None if rule.optional else (Outcome.INCONCLUSIVE, f"nothing to judge: {nothing}")


def _first_three(names: Sequence[str], between: str = ", ") -> str:
    return between.join([*names[:3], *(["..."] if len(names) > 3 else [])])


def _judge_flips(
    rule: GateRule, flips: pd.DataFrame, pairs: pd.DataFrame, incomparable: str
) -> tuple[Outcome, str]:
    flips = flips[flips["metric"] == rule.gate] if rule.gate else flips
    bad = flips[
        (flips["after"] == Outcome.FAIL.value)
        & flips["before"].isin([Outcome.PASS.value, Outcome.NOT_ASKED.value])
    ]
    clear, marginal = bad[~bad["marginal"]], int(bad["marginal"].sum())
    names = _first_three(
        [f"{row.log} ({row.mode} loop): {row.gate}" for row in clear.itertuples()], "; "
    )
    count = "1 flip" if len(clear) == 1 else f"{len(clear)} flips"
    reason = f"{count}{f': {names}' if names else ''}{f'; {marginal} marginal' if marginal else ''}"
    if len(clear) > rule.limit:
        return Outcome.FAIL, reason
    lost = []
    passed = flips[
        (flips["before"] == Outcome.PASS.value) & (flips["after"] == Outcome.INCONCLUSIVE.value)
    ]
    for (planner, mode, gate), rows in passed[passed["value_after"].isna()].groupby(
        ["planner", "mode", "gate"]
    ):
        logs = pairs.loc[(pairs["planner"] == planner) & (pairs["mode"] == mode), "log"].nunique()
        lost += [f"{gate} ({len(rows)} of {logs})"] if len(rows) > LOST_SHARE * logs else []
    missing = [f"gates not compared, {incomparable}"] if incomparable else []
    missing += (
        [f"gates that passed before have no value in too many logs: {_first_three(lost, '; ')}"]
        if lost
        else []
    )
    return Outcome.INCONCLUSIVE if missing else Outcome.PASS, "; ".join([reason, *missing])


def _judge_change(rule: GateRule, drives: str, rows: pd.DataFrame) -> tuple[float, Outcome, str]:
    """Return by how much one planner and loop exceeds the limit, the outcome, and the reason."""
    lost, rows = rows[rows["delta"].isna()], rows[rows["delta"].notna()]
    if rows.empty:
        reason = (
            f"{rule.metric} has a value in {count_logs(len(lost))} of the baseline, and in "
            "none of the candidate"
        )
        return -np.inf, Outcome.INCONCLUSIVE, f"{drives}: {reason}"
    unit = unit_of(str(rows["unit"].iloc[0]))
    if rule.over == "worst":
        held, fragile = rows[~rows["fragile"]], int(rows["fragile"].sum())
        left_out = f"; fragile and left out: {fragile}" if fragile else ""
        over, reason = -np.inf, f"no drive that is not fragile{left_out}"
        if len(held):
            row = held.iloc[int(np.argmax(rule.sign * held["delta"].to_numpy(float)))]
            where = f"on {row['log']}" + (
                f" at {row['time_s']:.2f} s" if isfinite(row["time_s"]) else ""
            )
            over = rule.sign * float(row["delta"]) - rule.limit
            reason = (
                f"{rule.metric} {row['baseline']:.4g} -> {row['candidate']:.4g}{unit} "
                f"{where}{left_out}"
            )
        outcome = Outcome.FAIL if over > 0.0 else Outcome.PASS
    else:  # the mean or median change over the logs that have both values
        delta = rows["delta"].to_numpy(float)
        value = float(np.median(delta) if rule.over == "median" else np.mean(delta))
        of = by_recording(pd.DataFrame([delta], columns=rows["log"])).to_numpy(float)
        low, high = intervals(of) if rule.over == "mean" else np.full((2, 1), np.nan)
        inside = f" [{low[0]:+.4g}, {high[0]:+.4g}]" if isfinite(low[0]) else ""
        means = " -> ".join(
            f"{rows[side].agg(rule.over):.4g}" for side in ("baseline", "candidate")
        )
        reason = (
            f"{rule.over} {rule.metric} {means}{unit}, {value:+.4g}{inside} over "
            f"{count_logs(len(delta))}"
        )
        over = rule.sign * value - rule.limit
        if over <= 0.0:
            outcome = Outcome.PASS
        elif not rule.significant or significant(low, high, np.array([of.shape[1]]))[0]:
            outcome = Outcome.FAIL
        elif of.shape[1] < MIN_SIGNIFICANT:
            outcome, reason = (
                Outcome.INCONCLUSIVE,
                f"{reason}: too few logs to decide whether this is chance",
            )
        else:
            outcome, reason = Outcome.PASS, f"{reason}: not significant"
    aside = f"; no value any more in {count_logs(len(lost))}" if len(lost) else ""
    return over, outcome, f"{drives}: {reason}{aside}"
