"""Rules of comparison: what a candidate may not do worse than a baseline, as a file says it.

[[compare]]                         # in the same file as [[gate]]; without any, the packaged ones apply
metric = "ade.3s.mean"              # a name of the table's column `metric`, with max_increase or max_decrease
max_increase = 0.05                 # in the metric's unit; the candidate's value less the baseline's
max_decrease = 0.05                 # instead
over = "mean"                       # "mean" over the logs (default), "median", or "worst": no log by more
significant = true                  # breaks only where the interval of the mean excludes no change; default: false
max_flips = 0                       # instead: gates may turn to FAIL so many times, of a pass or of not being asked
gate = "gap.min"                    # with max_flips: only gates on this metric
max_missing = 0                     # instead: so many drives of the baseline may be missing in the candidate
mode = "closed"                     # optional: "open" or "closed"; planner = "dp_qp" and tags = ["pedestrian"] likewise
optional = true                     # no verdict where no log has the metric; default: false (INCONCLUSIVE)
reason = "why this rule"            # shown with the verdict

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
from typing import Any

import msgspec
import numpy as np
import pandas as pd

from logs.errors import ConfigError
from logs.trace import Mode
from metrics import METRICS, Metric
from metrics.aggregate import LogLabels
from metrics.compare import MIN_SIGNIFICANT, NOT_ASKED, Comparison, RuleVerdict, intervals, significant
from metrics.gates import Outcome, check_metric, gate_tables, known_only

OVER = ("mean", "median", "worst")
KINDS = ("max_increase", "max_decrease", "max_flips", "max_missing")
"""A rule has exactly one of these."""
SEVERITY = (Outcome.PASS, Outcome.INCONCLUSIVE, Outcome.FAIL)
LOST_SHARE = 0.1
"""So large a share of a gate's logs may lose the value that passed it: as many as a gate passes without by default."""


@dataclass(frozen=True)
class Rule:
    """One rule (module docstring)."""

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
        if not (isfinite(self.limit) and self.limit >= 0.0):
            raise ValueError(f"{kinds[0]} is {self.limit:g}, not a number of at least 0")
        if bool(self.metric) != (kinds[0] in KINDS[:2]):
            raise ValueError(f"{kinds[0]} {'has no' if self.metric else 'needs a'} metric")
        if self.gate and self.max_flips is None:
            raise ValueError("gate goes with max_flips")
        if self.max_missing is not None and (self.mode or self.planner or self.tags):
            raise ValueError("max_missing counts all drives: no mode, planner or tags")
        if self.over not in OVER:
            raise ValueError(f"over is {self.over!r}, not one of {', '.join(OVER)}")
        if self.significant and self.over != "mean":
            raise ValueError('significant goes with over = "mean"')
        if self.mode not in (None, *(mode.value for mode in Mode)):
            raise ValueError(f'mode is {self.mode!r}, not "open" or "closed"')

    @property
    def limit(self) -> float:
        """The number that must not be exceeded."""
        return float(next(value for kind in KINDS if (value := getattr(self, kind)) is not None))

    def __str__(self) -> str:
        """The rule: "mean ade.3s.mean rises by at most 0.05, where significant [open]"."""
        scope = "".join(f" [{word}]" for word in (self.mode, *self.tags, self.planner) if word)
        if self.max_missing is not None:
            return f"at most {self.max_missing} drives missing"
        if self.max_flips is not None:
            return f"at most {self.max_flips} flips to FAIL{f' of {self.gate}' if self.gate else ''}{scope}"
        word = "rises" if self.max_increase is not None else "falls"
        sure = ", where significant" if self.significant else ""
        return f"{self.over} {self.metric} {word} by at most {self.limit:g}{sure}{scope}"


def load_rules(path: Path | None, *, metrics: Mapping[str, Metric] = METRICS) -> tuple[Rule, ...]:
    """The rules of a TOML file; the packaged ones where it has none, or for None.

    Raises:
        ConfigError: Not readable, unknown key or metric, a rule that says nothing; names the file and the rule.
    """
    source, tables = gate_tables(path, "compare")
    if not tables:
        source, tables = gate_tables(None, "compare")
    return tuple(_rule(table, f"{source}: compare {i}", metrics) for i, table in enumerate(tables, 1))


def _rule(table: Mapping[str, Any], place: str, metrics: Mapping[str, Metric]) -> Rule:
    known_only(table, tuple(Rule.__dataclass_fields__), place)
    try:
        rule = msgspec.convert(dict(table), Rule)
    except msgspec.ValidationError as error:
        raise ConfigError(f"{place}: {error}") from None
    for name in filter(None, (rule.metric, rule.gate)):
        check_metric(name, f"{place} ({name})", metrics)
    return rule


def judged(rules: tuple[Rule, ...], comparison: Comparison, labels: Mapping[str, LogLabels]) -> Comparison:
    """The comparison with what the rules say of it, in their order; an optional one may say nothing.

    Args:
        rules: What may not get worse.
        comparison: Two runs.
        labels: What each log belongs to.
    """
    said = ((rule, _said(rule, comparison, labels)) for rule in rules)
    return replace(comparison, verdicts=tuple(_with_why(rule, found) for rule, found in said if found is not None))


def _with_why(rule: Rule, verdict: RuleVerdict) -> RuleVerdict:
    """The verdict; of a broken rule with its reason."""
    if verdict.outcome is not Outcome.FAIL or not rule.reason:
        return verdict
    return replace(verdict, reason=f"{verdict.reason} (the rule: {rule.reason})")


def _said(rule: Rule, comparison: Comparison, labels: Mapping[str, LogLabels]) -> RuleVerdict | None:
    if rule.max_missing is not None:
        return _missing(rule, comparison)
    if rule.max_flips is not None:
        gone = [name for name in comparison.not_compared if rule.gate in ("", name)]
        return _flipped(rule, _scope(rule, comparison.flips, labels), _scope(rule, comparison.pairs, labels), gone)
    if rule.metric in comparison.not_compared:
        return RuleVerdict(str(rule), Outcome.INCONCLUSIVE, f"nothing to judge: {_incomparable([rule.metric])}")
    mine = _scope(rule, comparison.pairs, labels)
    return _moved(rule, mine[mine["metric"] == rule.metric].sort_values("log"))  # draws as of the groups


def _scope(rule: Rule, table: pd.DataFrame, labels: Mapping[str, LogLabels]) -> pd.DataFrame:
    """The rows of the mode, the planner and the tags that a rule names."""
    asked = table["log"].map(lambda log: set(rule.tags) <= set(labels[log].tags if log in labels else ())).astype(bool)
    for column, value in (("mode", rule.mode), ("planner", rule.planner)):
        if value is not None:
            asked &= table[column] == value
    return table[asked]


def _missing(rule: Rule, comparison: Comparison) -> RuleVerdict:
    gone = comparison.only_in_baseline
    names = f": {_few(gone, '; ')}" if gone else ""
    reason = f"missing in the candidate: {len(gone)} of the baseline's drives{names}"
    if len(gone) > rule.limit:
        return RuleVerdict(str(rule), Outcome.FAIL, reason)
    other = comparison.other_logs
    if other:
        reason += f"; with another content (SHA-256), so no longer the same: {_few(other)}"
    return RuleVerdict(str(rule), Outcome.INCONCLUSIVE if other else Outcome.PASS, reason)


def _incomparable(metrics: Sequence[str]) -> str:
    return f"of another version, or in the baseline only: {_few(metrics)}"


def _few(names: Sequence[str], between: str = ", ") -> str:
    """The first three of names."""
    return between.join([*names[:3], *(["..."] if len(names) > 3 else [])])


def _flipped(rule: Rule, flips: pd.DataFrame, pairs: pd.DataFrame, gone: Sequence[str]) -> RuleVerdict | None:
    if pairs.empty:
        return _nothing(rule)
    bad = flips[(flips["after"] == Outcome.FAIL.value) & flips["before"].isin([Outcome.PASS.value, NOT_ASKED])]
    bad = bad[bad["metric"] == rule.gate] if rule.gate else bad
    clear, aside = bad[~bad["marginal"]], int(bad["marginal"].sum())
    names = "; ".join(f"{row.log} ({row.mode} loop): {row.gate}" for row in clear.head(3).itertuples())
    more = "; ..." if len(clear) > 3 else ""
    count = "1 flip" if len(clear) == 1 else f"{len(clear)} flips"
    reason = f"{count}{f': {names}{more}' if names else ''}{f'; {aside} marginal' if aside else ''}"
    if len(clear) > rule.limit:
        return RuleVerdict(str(rule), Outcome.FAIL, reason)
    lost = _lost(flips[flips["metric"] == rule.gate] if rule.gate else flips, pairs)
    missing = [f"gates not compared, {_incomparable(gone)}"] if gone else []
    missing += [f"passed before, and without a value now in too many logs: {lost}"] if lost else []
    outcome = Outcome.INCONCLUSIVE if missing else Outcome.PASS
    return RuleVerdict(str(rule), outcome, "; ".join([reason, *missing]))


def _lost(flips: pd.DataFrame, pairs: pd.DataFrame) -> str:
    """The gates that too many logs passed, and of which they have no value any more; "" where there are none."""
    mine = flips[(flips["before"] == Outcome.PASS.value) & (flips["after"] == Outcome.INCONCLUSIVE.value)]
    bad = []
    for (planner, mode, gate), rows in mine[mine["value_after"].isna()].groupby(["planner", "mode", "gate"]):
        of = pairs.loc[(pairs["planner"] == planner) & (pairs["mode"] == mode), "log"].nunique()
        bad += [f"{gate} ({len(rows)} of {of})"] if len(rows) > LOST_SHARE * of else []
    return "; ".join([*bad[:3], *(["..."] if len(bad) > 3 else [])])


def _nothing(rule: Rule) -> RuleVerdict | None:
    what = f"{rule.metric} was measured in both runs on no log that is asked" if rule.metric else "no drives to compare"
    return None if rule.optional else RuleVerdict(str(rule), Outcome.INCONCLUSIVE, f"nothing to judge: {what}")


def _moved(rule: Rule, pairs: pd.DataFrame) -> RuleVerdict | None:
    """What the rule says of the planner and loop that it is broken most by."""
    if not pairs["baseline"].notna().any():
        return _nothing(rule)
    by = pairs[pairs["baseline"].notna()].groupby(["planner", "mode"], sort=True)
    found = [_change(rule, f"{planner}, {mode} loop", rows) for (planner, mode), rows in by]
    _, outcome, reason = max(found, key=lambda one: (SEVERITY.index(one[1]), one[0]))
    return RuleVerdict(str(rule), outcome, reason)


def _change(rule: Rule, who: str, rows: pd.DataFrame) -> tuple[float, Outcome, str]:
    """By how much one planner and loop is over the limit, what that means, and what was found."""
    sign = 1.0 if rule.max_increase is not None else -1.0
    lost = rows[rows["delta"].isna()]
    rows = rows[rows["delta"].notna()]
    if rows.empty:
        what = f"{who}: {rule.metric} has a value in {_logs(len(lost))} of the baseline, and in none of the candidate"
        return -np.inf, Outcome.INCONCLUSIVE, what
    over, outcome, reason = _of_values(rule, who, rows, sign)
    aside = f"; no value any more in {_logs(len(lost))}" if len(lost) else ""
    return over, outcome, f"{reason}{aside}"


def _of_values(rule: Rule, who: str, rows: pd.DataFrame, sign: float) -> tuple[float, Outcome, str]:
    """`_change` of the logs that have both values."""
    delta, unit = rows["delta"].to_numpy(float), _unit(str(rows["unit"].iloc[0]))
    if rule.over == "worst":
        return _worst(rule, who, rows, sign, unit)
    value = float(np.median(delta) if rule.over == "median" else np.mean(delta))
    (low,), (high,) = intervals(delta[None, :]) if rule.over == "mean" else ([np.nan], [np.nan])
    logs = np.array([len(delta)])
    sure = not rule.significant or bool(significant(np.array([low]), np.array([high]), logs)[0])
    inside = f" [{low:+.4g}, {high:+.4g}]" if isfinite(low) else ""
    means = " -> ".join(f"{rows[side].agg(rule.over):.4g}" for side in ("baseline", "candidate"))
    reason = f"{who}: {rule.over} {rule.metric} {means}{unit}, {value:+.4g}{inside} over {_logs(len(delta))}"
    over = sign * value - rule.limit
    if over <= 0.0 or sure:
        return over, Outcome.FAIL if over > 0.0 else Outcome.PASS, reason
    if len(delta) < MIN_SIGNIFICANT:
        return over, Outcome.INCONCLUSIVE, f"{reason}: too few to say whether that is chance"
    return over, Outcome.PASS, f"{reason}: not significant"


def _worst(rule: Rule, who: str, rows: pd.DataFrame, sign: float, unit: str) -> tuple[float, Outcome, str]:
    held, aside = rows[~rows["fragile"]], int(rows["fragile"].sum())
    said = f"; fragile and left out: {aside}" if aside else ""
    if held.empty:
        return -np.inf, Outcome.PASS, f"{who}: no drive that is not fragile{said}"
    row = held.iloc[int(np.argmax(sign * held["delta"].to_numpy(float)))]
    where = f"on {row['log']}" + (f" at {row['time_s']:.2f} s" if isfinite(row["time_s"]) else "")
    reason = f"{who}: {rule.metric} {row['baseline']:.4g} -> {row['candidate']:.4g}{unit} {where}{said}"
    over = sign * float(row["delta"]) - rule.limit
    return over, Outcome.FAIL if over > 0.0 else Outcome.PASS, reason


def _logs(count: int) -> str:
    return "1 log" if count == 1 else f"{count} logs"


def _unit(unit: str) -> str:
    return "" if unit in ("1", "count") else f" {unit}"
