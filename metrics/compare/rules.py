"""Rules of comparison: what a candidate may not do worse than a baseline, the tables [[compare]] of a file of gates.

Marginal flips and, with "worst", fragile drives (`metrics.compare`) break no rule; the reason counts them.

A rule is INCONCLUSIVE, optional or not, where evidence that the baseline had is gone: its metric is of another version,
or in the baseline only; gates that passed have no value now, in more than LOST_SHARE of the logs; or the change is
beyond the limit, `significant` is asked, and there are fewer logs than any change can be significant on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path

import numpy as np
import pandas as pd

from logs.trace import Mode
from metrics import METRICS, Metric
from metrics.compare.tables import MIN_SIGNIFICANT, NOT_ASKED, Comparison, RuleVerdict, intervals, significant
from metrics.judge.aggregate import LogLabels
from metrics.judge.gates import Outcome, count_logs, read_tables, unit_of

OVER = ("mean", "median", "worst")
KINDS = ("max_increase", "max_decrease", "max_flips", "max_missing")  # A rule has exactly one of these
SEVERITY = (Outcome.PASS, Outcome.INCONCLUSIVE, Outcome.FAIL)
LOST_SHARE = 0.1  # Of a gate's logs that may lose the value that passed it: as `Gate.max_missing`


@dataclass(frozen=True)
class Rule:
    """One rule: exactly one of `KINDS`.

    Attributes:
        metric: A name of the table's column `metric`, which may not rise by more than `max_increase` or fall by more
            than `max_decrease`, in its unit; over the logs its "mean" or "median", or no log ("worst").
        significant: Breaks only where the interval of the mean excludes no change.
        max_flips: The number of gates that may turn to FAIL from a pass or from not asked; `gate`: on this metric.
        max_missing: The number of drives of the baseline that may be missing in the candidate.
        mode: Only this mode; `planner`, `tags` likewise.
        optional: No verdict where no log has the metric; else that is INCONCLUSIVE.
        reason: Shown with the verdict.
    """

    metric: str = ""
    max_increase: float | None = None
    max_decrease: float | None = None
    over: str = "mean"
    significant: bool = False
    max_flips: int | None = None
    gate: str = ""
    max_missing: int | None = None
    mode: str | None = None
    planner: str | None = None
    tags: tuple[str, ...] = ()
    optional: bool = False
    reason: str = ""

    def __post_init__(self) -> None:
        kinds = [kind for kind in KINDS if getattr(self, kind) is not None]
        if len(kinds) != 1:
            raise ValueError(f"needs one of {', '.join(KINDS)}, has {' and '.join(kinds) or 'none'}")
        scoped, kind = self.mode or self.planner or self.tags, kinds[0]
        rules = {
            f"{kind} is {self.limit:g}, not a number of at least 0": isfinite(self.limit) and self.limit >= 0.0,
            f"{kind} {'has no' if self.metric else 'needs a'} metric": bool(self.metric) == (kind in KINDS[:2]),
            "gate goes with max_flips": not self.gate or self.max_flips is not None,
            "max_missing counts all drives: no mode, planner or tags": self.max_missing is None or not scoped,
            f"over is {self.over!r}, not one of {', '.join(OVER)}": self.over in OVER,
            'significant goes with over = "mean"': not self.significant or self.over == "mean",
            f'mode is {self.mode!r}, not "open" or "closed"': self.mode in (None, *(mode.value for mode in Mode)),
        }
        for complaint, holds in rules.items():
            if not holds:
                raise ValueError(complaint)

    @property
    def limit(self) -> float:
        """The number that must not be exceeded."""
        return float(next(value for kind in KINDS if (value := getattr(self, kind)) is not None))

    @property
    def sign(self) -> float:
        """1 where the metric may not rise, -1 where it may not fall."""
        return 1.0 if self.max_increase is not None else -1.0

    def __str__(self) -> str:
        """The rule: "mean ade.3s.mean rises by at most 0.05, where significant [open]"."""
        scope = "".join(f" [{word}]" for word in (self.mode, *self.tags, self.planner) if word)
        if self.max_missing is not None:
            return f"at most {self.max_missing} drives missing"
        if self.max_flips is not None:
            return f"at most {self.max_flips} flips to FAIL{f' of {self.gate}' if self.gate else ''}{scope}"
        word = "rises" if self.sign > 0.0 else "falls"
        sure = ", where significant" if self.significant else ""
        return f"{self.over} {self.metric} {word} by at most {self.limit:g}{sure}{scope}"


def load_rules(path: Path | None, *, metrics: Mapping[str, Metric] = METRICS) -> tuple[Rule, ...]:
    """The rules of a TOML file; the packaged ones where it has none, or for None.

    Raises:
        ConfigError: Not readable, unknown key or metric, or a contradictory rule; names the file and the rule.
    """
    return read_tables(path, "compare", Rule, metrics)[1] or read_tables(None, "compare", Rule, metrics)[1]


def judged(rules: tuple[Rule, ...], comparison: Comparison, labels: Mapping[str, LogLabels]) -> Comparison:
    """The comparison of logs with these labels, with the verdicts of the rules; an optional rule may have none."""
    verdicts = []
    for rule in rules:
        found = _judged(rule, comparison, labels)
        if found is not None:
            outcome, reason = found
            why = f" (the rule: {rule.reason})" if outcome is Outcome.FAIL and rule.reason else ""
            verdicts.append(RuleVerdict(str(rule), outcome, f"{reason}{why}"))
    return replace(comparison, verdicts=tuple(verdicts))


def _judged(rule: Rule, comparison: Comparison, labels: Mapping[str, LogLabels]) -> tuple[Outcome, str] | None:
    """Outcome and reason; None where an optional rule has nothing to judge."""
    if rule.max_missing is not None:
        gone, other = comparison.only_in_baseline, comparison.other_logs
        reason = f"missing in the candidate: {len(gone)} of the baseline's drives"
        reason += f": {_few(gone, '; ')}" if gone else ""
        if len(gone) <= rule.limit and other:
            reason += f"; with another content (SHA-256), so no longer the same: {_few(other)}"
            return Outcome.INCONCLUSIVE, reason
        return Outcome.FAIL if len(gone) > rule.limit else Outcome.PASS, reason
    pairs, flips = (_scope(rule, table, labels) for table in (comparison.pairs, comparison.flips))
    names = [name for name in comparison.not_compared if (rule.metric or rule.gate) in ("", name)]
    incomparable = f"of another version, or in the baseline only: {_few(names)}" if names else ""
    if rule.max_flips is not None:
        if len(pairs):
            return _flipped(rule, flips, pairs, incomparable)
        nothing = "no drives to compare"
    elif incomparable:
        return Outcome.INCONCLUSIVE, f"nothing to judge: {incomparable}"
    else:
        measured = pairs[(pairs["metric"] == rule.metric) & pairs["baseline"].notna()].sort_values("log")
        if len(measured):  # in the order of the logs, as in the groups: it decides the draws
            by = measured.groupby(["planner", "mode"], sort=True)
            found = [_change(rule, f"{planner}, {mode} loop", rows) for (planner, mode), rows in by]
            return max(found, key=lambda one: (SEVERITY.index(one[1]), one[0]))[1:]
        nothing = f"{rule.metric} was measured in both runs on no log that is asked"
    return None if rule.optional else (Outcome.INCONCLUSIVE, f"nothing to judge: {nothing}")


def _scope(rule: Rule, table: pd.DataFrame, labels: Mapping[str, LogLabels]) -> pd.DataFrame:
    """The rows of the mode, the planner and the tags that a rule names."""
    asked = table["log"].map(lambda log: set(rule.tags) <= set(labels[log].tags if log in labels else ())).astype(bool)
    for column, value in (("mode", rule.mode), ("planner", rule.planner)):
        if value is not None:
            asked &= table[column] == value
    return table[asked]


def _few(names: Sequence[str], between: str = ", ") -> str:
    """The first three names."""
    return between.join([*names[:3], *(["..."] if len(names) > 3 else [])])


def _flipped(rule: Rule, flips: pd.DataFrame, pairs: pd.DataFrame, incomparable: str) -> tuple[Outcome, str]:
    flips = flips[flips["metric"] == rule.gate] if rule.gate else flips
    bad = flips[(flips["after"] == Outcome.FAIL.value) & flips["before"].isin([Outcome.PASS.value, NOT_ASKED])]
    clear, marginal = bad[~bad["marginal"]], int(bad["marginal"].sum())
    names = _few([f"{row.log} ({row.mode} loop): {row.gate}" for row in clear.itertuples()], "; ")
    count = "1 flip" if len(clear) == 1 else f"{len(clear)} flips"
    reason = f"{count}{f': {names}' if names else ''}{f'; {marginal} marginal' if marginal else ''}"
    if len(clear) > rule.limit:
        return Outcome.FAIL, reason
    lost = []
    passed = flips[(flips["before"] == Outcome.PASS.value) & (flips["after"] == Outcome.INCONCLUSIVE.value)]
    for (planner, mode, gate), rows in passed[passed["value_after"].isna()].groupby(["planner", "mode", "gate"]):
        logs = pairs.loc[(pairs["planner"] == planner) & (pairs["mode"] == mode), "log"].nunique()
        lost += [f"{gate} ({len(rows)} of {logs})"] if len(rows) > LOST_SHARE * logs else []
    missing = [f"gates not compared, {incomparable}"] if incomparable else []
    missing += [f"passed before, and without a value now in too many logs: {_few(lost, '; ')}"] if lost else []
    return Outcome.INCONCLUSIVE if missing else Outcome.PASS, "; ".join([reason, *missing])


def _change(rule: Rule, drives: str, rows: pd.DataFrame) -> tuple[float, Outcome, str]:
    """By how much one planner and loop is over the limit, its outcome, and what was found."""
    lost, rows = rows[rows["delta"].isna()], rows[rows["delta"].notna()]
    if rows.empty:
        found = f"{rule.metric} has a value in {count_logs(len(lost))} of the baseline, and in none of the candidate"
        return -np.inf, Outcome.INCONCLUSIVE, f"{drives}: {found}"
    unit = unit_of(str(rows["unit"].iloc[0]))
    over, outcome, reason = (_worst if rule.over == "worst" else _together)(rule, rows, unit)
    aside = f"; no value any more in {count_logs(len(lost))}" if len(lost) else ""
    return over, outcome, f"{drives}: {reason}{aside}"


def _together(rule: Rule, rows: pd.DataFrame, unit: str) -> tuple[float, Outcome, str]:
    """The mean or median change over logs that have both values."""
    delta = rows["delta"].to_numpy(float)
    value = float(np.median(delta) if rule.over == "median" else np.mean(delta))
    low, high = intervals(delta[None, :]) if rule.over == "mean" else np.full((2, 1), np.nan)
    inside = f" [{low[0]:+.4g}, {high[0]:+.4g}]" if isfinite(low[0]) else ""
    means = " -> ".join(f"{rows[side].agg(rule.over):.4g}" for side in ("baseline", "candidate"))
    reason = f"{rule.over} {rule.metric} {means}{unit}, {value:+.4g}{inside} over {count_logs(len(delta))}"
    over = rule.sign * value - rule.limit
    if over <= 0.0:
        return over, Outcome.PASS, reason
    if not rule.significant or significant(low, high, np.array([len(delta)]))[0]:
        return over, Outcome.FAIL, reason
    if len(delta) < MIN_SIGNIFICANT:
        return over, Outcome.INCONCLUSIVE, f"{reason}: too few to say whether that is chance"
    return over, Outcome.PASS, f"{reason}: not significant"


def _worst(rule: Rule, rows: pd.DataFrame, unit: str) -> tuple[float, Outcome, str]:
    """The worst change of a drive that is not fragile."""
    held, fragile = rows[~rows["fragile"]], int(rows["fragile"].sum())
    left_out = f"; fragile and left out: {fragile}" if fragile else ""
    if held.empty:
        return -np.inf, Outcome.PASS, f"no drive that is not fragile{left_out}"
    row = held.iloc[int(np.argmax(rule.sign * held["delta"].to_numpy(float)))]
    where = f"on {row['log']}" + (f" at {row['time_s']:.2f} s" if isfinite(row["time_s"]) else "")
    over = rule.sign * float(row["delta"]) - rule.limit
    reason = f"{rule.metric} {row['baseline']:.4g} -> {row['candidate']:.4g}{unit} {where}{left_out}"
    return over, Outcome.FAIL if over > 0.0 else Outcome.PASS, reason
