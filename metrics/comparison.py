"""Compares two runs as tables: what changed on which log, which gates flipped, and by how much over
many logs.

For a log i that both runs drove, and a metric of the same version in both (always with the same
planner and mode):

(1) delta_i = candidate_i - baseline_i;
        0 where |delta_i| <= NOISE_ABS + NOISE_REL max(|baseline_i|, |candidate_i|)
(2) worse_i = delta_i where lower is better, -delta_i where higher is better;
        NaN where neither is better
(3) relative_i = worse_i / max(mean over logs and runs of |value|, |bound| of a gate on the metric).
        It ranks regressions: a first collision comes before slightly less distance, and that before
        an error of a millimetre against the plan

Over a group of n logs with a value in both runs:

(4) delta = 1/n sum_i delta_i
(5) [low, high] = 2.5th and 97.5th percentile of (4) over RESAMPLES draws of n logs
        with replacement; the two values of a log are drawn together (paired percentile bootstrap:
        Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 13)
(6) significant = 0 is outside of (5), and n >= MIN_SIGNIFICANT
(7) windows of a recording depend on each other: with windows, (5) and (6) are over the m recordings
    instead of n logs, with m/n sum_i delta_i of the windows of each, whose mean is (4)

The draws are seeded, so equal tables give equal intervals. Unlike BCa, the percentile method has
finite bounds where most differences are exactly 0.

The same gates and the candidate's reference drives judge both tables. A flip is marginal if the
value changed by no more than the noise of (1), or if the baseline's ensemble found the drive
fragile. Rules do not count marginal flips.

Rules (`replan.metrics.judge.gates.GateRule`) limit how much worse than the baseline a candidate may
be. Marginal flips and, with "worst", fragile drives break no rule; the reason states their number.
A rule, optional or not, is INCONCLUSIVE where the candidate lacks evidence that the baseline has:
the metric has another version, or only the baseline has it; gates that passed have no value now in
more than LOST_SHARE of the logs; or the change exceeds the limit, `significant` is set, and there
are too few logs for any change to be significant.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import NamedTuple

import numpy as np
import pandas as pd

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.names import listed
from replan.metrics import evidence
from replan.metrics.judge.aggregate import SUITE, LogLabels, membership
from replan.metrics.judge.cases import REFERENCE
from replan.metrics.judge.gates import GateRule, Gates, Outcome, count_logs, unit_of
from replan.metrics.judge.verdicts import DRIVE, judge, outcomes

# Rounding: sums in another order, the last iterations of a solver
NOISE_ABS, NOISE_REL = 1e-9, 1e-6
NAMED = 5  # Messages name at most this many logs, and the number of the others
MIN_PAIRS = 3  # Fewer logs cannot be resampled meaningfully
# Fewer logs all change in one direction by chance in more than 5 % (sign test: 2 / 2^5 = 6 %)
MIN_SIGNIFICANT = 6
CONFIDENCE, RESAMPLES, SEED = 0.95, 2000, 20260101
BATCH = 250  # Draws at a time: limits memory; the draws depend on it

SCORE = ["planner", "mode", "metric"]
KEYS = [*DRIVE, "metric"]
PAIR_COLUMNS = (
    *KEYS,
    "unit",
    "direction",
    "baseline",
    "candidate",
    "delta",
    "worse",
    "relative",
    "asked",
    "fragile",
    "time_s",
    "reason",
)
FLIP_COLUMNS = (
    *DRIVE,
    "gate",
    "metric",
    "before",
    "after",
    "value_before",
    "value_after",
    "time_s",
    "reason",
    "marginal",
)
GROUP_COLUMNS = (
    "kind",
    "group",
    *SCORE,
    "unit",
    "direction",
    "logs",
    "baseline",
    "candidate",
    "delta",
    "low",
    "high",
    "better",
    "worse",
    "significant",
)
PARTING_COLUMNS = (*DRIVE, "t_s", "stage", "what")
BY_LOG = ("worst", "pass_share")  # `over` of the gates that each log passes or fails by itself
SEVERITY = (Outcome.PASS, Outcome.INCONCLUSIVE, Outcome.FAIL)
# Share of the logs that passed a gate and may lose their value: as `Gate.max_missing`
LOST_SHARE = 0.1


@dataclass(frozen=True, eq=False)
class Side:
    """One of two runs."""

    label: str
    table: pd.DataFrame  # Rows of `replan.metrics.evaluate`, reference drives among them
    # A row per log: log, sha256, family, dataset, tags (a list), vehicle (a hash; "" if unknown)
    logs: pd.DataFrame
    facts: Mapping[str, str]  # Versions and all keys of the configuration of the run, as text
    failed: Mapping[str, str]  # Reason by log, for logs that could not be evaluated
    # Drives (log, planner, mode) in which the planner failed; the table holds their beginning
    crashed: tuple[tuple[str, str, str], ...] = ()
    metrics: tuple[str, ...] = ()  # "module:NAME" of the user's metrics

    @property
    def labels(self) -> dict[str, LogLabels]:
        """The labels of each log."""
        rows = self.logs[["log", "family", "dataset", "tags"]].itertuples(index=False, name=None)
        return {log: LogLabels(family, dataset, tuple(tags)) for log, family, dataset, tags in rows}

    @property
    def driven(self) -> pd.DataFrame:
        """The rows of the table without those of reference drives."""
        return self.table[self.table["mode"] != REFERENCE]

    @property
    def drives(self) -> list[tuple[str, str, str]]:
        """Log, planner and mode of each drive."""
        return list(self.driven[DRIVE].drop_duplicates().itertuples(index=False, name=None))


@dataclass(frozen=True, slots=True)
class RuleVerdict:
    """Verdict of a rule of comparison; `reason` is one sentence with the values found."""

    rule: str
    outcome: Outcome
    reason: str


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two runs, compared."""

    baseline: str  # Label of the baseline; `candidate` likewise
    candidate: str
    differences: tuple[str, ...]  # Inputs that differ, one sentence each
    # Drives "log, planner, mode loop" that only the baseline has, or that failed only in the
    # candidate; `only_in_candidate` likewise
    only_in_baseline: tuple[str, ...]
    only_in_candidate: tuple[str, ...]
    # `PAIR_COLUMNS`, the worst regression first: metrics that a gate or rule names, by (3), then
    # the others. A value that one of the runs lacks is NaN, and `reason` says why; otherwise
    # `reason` is that of the candidate's value.
    pairs: pd.DataFrame
    flips: pd.DataFrame  # `FLIP_COLUMNS`: gates whose outcome on a log changed
    groups: pd.DataFrame  # `GROUP_COLUMNS`: means over the suite, its families, tags and datasets
    # `PARTING_COLUMNS`: first differences of two drives; empty without traces
    partings: pd.DataFrame = field(
        default_factory=lambda: pd.DataFrame(columns=list(PARTING_COLUMNS))
    )
    verdicts: tuple[RuleVerdict, ...] = ()
    not_looked_at: int = 0  # Number of differing drives whose first difference was not searched
    # Metrics of gates or rules that the baseline has in another version, or that only the baseline
    # has
    not_compared: tuple[str, ...] = ()
    other_logs: tuple[str, ...] = ()  # Logs whose content (SHA-256) differs between the two runs

    @property
    def exit_code(self) -> int:
        """0 pass, 1 a rule failed, 4 inconclusive: nothing to compare, or a rule had nothing to
        judge.
        """
        found = {verdict.outcome for verdict in self.verdicts}
        if Outcome.FAIL in found:
            return 1
        return 4 if self.pairs.empty or Outcome.INCONCLUSIVE in found else 0

    @property
    def by_loop(self) -> tuple[str, ...]:
        """One sentence per loop, closed first: numbers of drives with flips only to PASS, only to
        FAIL, and both.
        """
        sentences = []
        flips = self.flips[~self.flips["marginal"].astype(bool)]
        for mode in sorted(set(self.pairs["mode"])):
            mine = flips[flips["mode"] == mode]
            better, worse = (
                set(mine.loc[mine["after"] == word, DRIVE].itertuples(index=False, name=None))
                for word in (Outcome.PASS.value, Outcome.FAIL.value)
            )
            mixed = f", {len(better & worse)} both" if better & worse else ""
            drives = len(self.pairs.loc[self.pairs["mode"] == mode, DRIVE].drop_duplicates())
            counts = f"{len(better - worse)} better, {len(worse - better)} worse{mixed}"
            sentences.append(f"{mode.capitalize()} loop, by gates: {counts}, of {drives} drives.")
        return tuple(sentences)

    def regressions(self, most: int, each: int = 2) -> pd.DataFrame:
        """Return the worst pairs, at most `each` per drive, so that one bad drive does not hide the
        others.
        """
        worse = self.pairs[self.pairs["worse"] > 0.0]
        return worse[worse.groupby(DRIVE).cumcount() < each].head(most)

    def improvements(self, most: int) -> pd.DataFrame:
        """Return the greatest improvements, at most two per drive."""
        better = self.pairs[self.pairs["worse"] < 0.0]
        better = better.sort_values(["asked", "relative"], ascending=[False, True], kind="stable")
        return better[better.groupby(DRIVE).cumcount() < 2].head(most)


def compare(
    baseline: Side, candidate: Side, gates: Gates, also: Collection[str] = ()
) -> Comparison:
    """Compare the tables of two runs, judged by the same gates; `judge_rules` adds the verdicts of
    rules.

    `also` are the metrics of rules; like those of gates, they come first among the regressions.
    """
    tables = baseline.table, candidate.table
    before, now = (dict(zip(table["metric"], table["version"], strict=True)) for table in tables)
    changed = {
        name: f"{before[name]} -> {now[name]}"
        for name in before
        if name in now and before[name] != now[name]
    }
    alone = set(baseline.driven["metric"]) ^ set(candidate.driven["metric"])
    valued = set(baseline.driven.loc[baseline.driven["available"].astype(bool), "metric"])
    ensemble = baseline.table[baseline.table["metric"] == f"{evidence.ensemble.name}.fragile"]
    fragile = pd.MultiIndex.from_frame(ensemble.loc[ensemble["value"] > 0.0, DRIVE])
    bounds = dict.fromkeys(also, 0.0)
    for gate in gates.gates:
        bounds[gate.metric] = max(
            bounds.get(gate.metric, 0.0), abs(gate.min or 0.0), abs(gate.max or 0.0)
        )
    pairs = _pairs(baseline.driven, candidate.driven, changed, bounds)
    pairs["fragile"] = pd.MultiIndex.from_frame(pairs[DRIVE]).isin(fragile)
    flips = _flips(baseline, candidate, gates, changed.keys() | alone)
    flips["marginal"] |= pd.MultiIndex.from_frame(flips[DRIVE]).isin(fragile)
    old, new = baseline.facts, candidate.facts
    other_logs = _differing_logs(baseline, candidate, "sha256")
    differences = [
        f"{key}: {old[key]} -> {new[key]}" for key in old if key in new and old[key] != new[key]
    ]
    if other_logs:
        contents = [f"{log} ({one[:8]} -> {two[:8]})" for log, (one, two) in other_logs.items()]
        what = "logs of one name with other content (SHA-256)"
        differences.insert(0, f"{what}: {listed(contents, NAMED)}")
    metrics = [list(dict.fromkeys(side.driven["metric"])) for side in (baseline, candidate)]
    for what, names in (
        ("settings of the baseline only", [key for key in old if key not in new]),
        ("settings of the candidate only", [key for key in new if key not in old]),
        ("logs with another vehicle", list(_differing_logs(baseline, candidate, "vehicle"))),
        (
            "metrics of another version, not compared",
            [f"{name} ({both})" for name, both in changed.items()],
        ),
        ("metrics in the baseline only", [name for name in metrics[0] if name not in metrics[1]]),
        ("metrics in the candidate only", [name for name in metrics[1] if name not in metrics[0]]),
    ):
        if names:
            differences.append(f"{what}: {listed(names, NAMED)}")
    return Comparison(
        baseline.label,
        candidate.label,
        tuple(differences),
        _missing_drives(baseline, candidate),
        _missing_drives(candidate, baseline),
        pairs,
        flips,
        group_deltas(pairs, candidate.labels),
        not_compared=tuple(sorted(bounds.keys() & (changed.keys() | alone & valued))),
        other_logs=tuple(other_logs),
    )


def _missing_drives(one: Side, two: Side) -> tuple[str, ...]:
    """Return the drives that only the first run has, or that failed only in the second."""
    there, failed = set(two.drives), set(two.crashed) - set(one.crashed)
    return tuple(
        f"{drive[0]}, {drive[1]}, {drive[2]} loop{' (failed)' if drive in there else ''}"
        for drive in one.drives
        if drive not in there or drive in failed
    )


def _pairs(
    baseline: pd.DataFrame,
    candidate: pd.DataFrame,
    left_out: Collection[str],
    bounds: Mapping[str, float],
) -> pd.DataFrame:
    """Return `PAIR_COLUMNS` of the rows of both runs without the metrics `left_out`; `bounds` of
    gates by metric.
    """
    both = baseline.merge(candidate, on=KEYS, suffixes=("_b", "_c"))
    both = both[
        ~both["metric"].isin(left_out) & (both["available_b"] | both["available_c"]).astype(bool)
    ]
    before, now = both["value_b"].to_numpy(float), both["value_c"].to_numpy(float)
    delta = np.where(noise(before, now), 0.0, now - before)  # (1)
    sign = both["direction_c"].map({"lower": 1.0, "higher": -1.0}).to_numpy(float)
    there = [both[name].to_numpy(bool) for name in ("available_b", "available_c")]
    lost = "only in the baseline; candidate: " + both["reason_c"].astype(object)
    new = "only in the candidate; baseline: " + both["reason_b"].astype(object)
    pairs = both[KEYS].assign(
        unit=both["unit_c"],
        direction=both["direction_c"],
        baseline=before,
        candidate=now,
        delta=delta,
        worse=sign * delta + 0.0,  # (2)
        asked=both["metric"].isin(list(bounds)),
        fragile=False,
        time_s=both["time_s_c"].fillna(both["time_s_b"]),
        reason=np.select([there[0] & there[1], there[1]], [both["reason_c"], new], lost),
    )
    size = (
        pairs[["baseline", "candidate"]].abs().mean(axis=1).groupby([pairs[key] for key in SCORE])
    )
    scale = np.maximum(
        size.transform("mean").to_numpy(float),
        pairs["metric"].map(bounds).fillna(0.0).to_numpy(float),
    )
    pairs["relative"] = pairs["worse"] / np.where(scale > 0.0, scale, np.nan)  # (3)
    order = pairs.assign(hurts=pairs["worse"] > 0.0).sort_values(
        ["hurts", "asked", "relative", *KEYS],
        ascending=[False, False, False, True, True, True, True],
        kind="stable",
    )
    return order[list(PAIR_COLUMNS)].reset_index(drop=True)


def noise(before: np.ndarray, now: np.ndarray) -> BoolArray:
    """Return whether two values `(n,)` differ only by rounding (1); False where one is NaN."""
    with np.errstate(invalid="ignore"):
        bound = NOISE_ABS + NOISE_REL * np.maximum(np.abs(before), np.abs(now))
        return np.asarray(np.abs(now - before) <= bound)


class _LogOutcome(NamedTuple):
    """Outcome of a gate on a log.

    The default is that of an optional gate on a log without the value.
    """

    outcome: str = Outcome.NOT_ASKED.value
    value: float = np.nan
    time_s: float = np.nan
    reason: str = ""


def _flips(
    baseline: Side, candidate: Side, gates: Gates, left_out: Collection[str]
) -> pd.DataFrame:
    """Return `FLIP_COLUMNS` of drives of both runs.

    A change between PASS and NOT ASKED is no flip.
    """
    rules = Gates(
        tuple(g for g in gates.gates if g.over in BY_LOG and g.metric not in left_out), gates.source
    )
    metric = {str(gate): gate.metric for gate in rules.gates}
    judged = []  # by run: outcomes by log, planner, mode and gate
    for side in (baseline, candidate):  # uses the reference drives of the candidate, if it has any
        mine = candidate.table[
            (candidate.table["mode"] == REFERENCE) & candidate.table["log"].isin(side.logs["log"])
        ]
        own = side.table[(side.table["mode"] != REFERENCE) | ~side.table["log"].isin(mine["log"])]
        found = outcomes(
            judge(rules, pd.concat([own, mine], ignore_index=True), side.labels, failed=side.failed)
        )
        fields = found[[*DRIVE, "gate", *_LogOutcome._fields]].itertuples(index=False, name=None)
        judged.append({row[:4]: _LogOutcome(*row[4:]) for row in fields})
    old, new = judged
    both, rows = {*baseline.drives} & {*candidate.drives}, []
    for key in dict.fromkeys([*old, *new]):
        before, now = old.get(key, _LogOutcome()), new.get(key, _LogOutcome())
        change = {before.outcome, now.outcome}
        if (
            key[:3] not in both
            or len(change) == 1
            or change == {Outcome.NOT_ASKED.value, Outcome.PASS.value}
        ):
            continue
        marginal = bool(noise(np.array(before.value), np.array(now.value)))
        when = now.time_s if np.isfinite(now.time_s) else before.time_s
        values = (
            before.outcome,
            now.outcome,
            before.value,
            now.value,
            when,
            now.reason or before.reason,
            marginal,
        )
        rows.append((*key, metric[key[3]], *values))
    kinds = {"value_before": float, "value_after": float, "time_s": float, "marginal": bool}
    return pd.DataFrame(rows, columns=list(FLIP_COLUMNS)).astype(kinds)


def _differing_logs(baseline: Side, candidate: Side, column: str) -> dict[str, tuple[str, str]]:
    """Return the logs of both runs whose values in a column are known and differ, with both."""
    both = baseline.logs.merge(candidate.logs, on="log", suffixes=("_b", "_c"))
    one, two = both[f"{column}_b"], both[f"{column}_c"]
    other = (one != "") & (two != "") & (one != two)
    pairs = zip(one[other], two[other], strict=True)
    return dict(zip(both.loc[other, "log"], pairs, strict=True))


def group_deltas(pairs: pd.DataFrame, labels: Mapping[str, LogLabels]) -> pd.DataFrame:
    """Return `GROUP_COLUMNS` (4) to (6), by `SCORE` and group: the suite, and its parts with more
    than one log.
    """
    known, parts = pairs[pairs["delta"].notna()], []
    there = {log: labels[log] for log in labels if log in set(known["log"])}
    for (kind, name), logs in membership(there).items() if there else ():
        if not (kind == SUITE or 1 < len(logs) < len(there)):
            continue
        mine = known[known["log"].isin(logs)]
        by = mine.assign(better=mine["worse"] < 0.0, worse=mine["worse"] > 0.0).groupby(
            SCORE, sort=True
        )
        table = by.agg(
            unit=("unit", "first"),
            direction=("direction", "first"),
            logs=("log", "size"),
            baseline=("baseline", "mean"),
            candidate=("candidate", "mean"),
            delta=("delta", "mean"),
            better=("better", "sum"),
            worse=("worse", "sum"),
        )
        deltas = mine.pivot_table(index=SCORE, columns="log", values="delta", sort=True).loc[
            table.index
        ]
        deltas = by_recording(deltas)
        low, high = intervals(deltas.to_numpy(float))
        clear = significant(low, high, deltas.notna().sum(axis=1).to_numpy())
        table = table.assign(low=low, high=high, significant=clear).reset_index()
        parts.append(table.assign(kind=kind, group=name or "all"))
    numbers = dict.fromkeys(("baseline", "candidate", "delta", "low", "high"), float)
    empty = pd.DataFrame(columns=list(GROUP_COLUMNS)).astype({**numbers, "significant": bool})
    return pd.concat(parts, ignore_index=True)[list(GROUP_COLUMNS)] if parts else empty


def recording_of(log: str) -> str:
    """Return the log that a window was cut of ("drive@12" begins at 12 s of "drive").

    Else the log itself.
    """
    name, _, begin = log.rpartition("@")
    return name if name and begin.replace(".", "", 1).isdecimal() else log


def by_recording(deltas: pd.DataFrame) -> pd.DataFrame:
    """Return a column per recording for the columns of logs, with the same mean of each row: (7).

    The windows of a recording depend on each other, so that recordings are resampled.
    """
    summed = deltas.T.groupby(recording_of, sort=True).sum(min_count=1).T
    return summed.mul(summed.notna().sum(axis=1) / deltas.notna().sum(axis=1), axis=0)


def intervals(deltas: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the bounds (5), `(m,)` each, of m metrics over n logs `(m, n)`.

    A delta is NaN if the log has no value.
    """
    from scipy.stats import bootstrap  # imported here: it takes longer to load than all metrics

    there = np.isfinite(deltas)
    low = np.where(there.sum(axis=1) < MIN_PAIRS, np.nan, 0.0)
    high = low.copy()
    moved = np.isfinite(low) & (np.nan_to_num(deltas) != 0.0).any(axis=1)
    for pattern in np.unique(there[moved], axis=0):
        rows = moved & (there == pattern).all(axis=1)
        found = bootstrap(
            (deltas[rows][:, pattern],),
            np.mean,
            axis=-1,
            vectorized=True,
            confidence_level=CONFIDENCE,
            n_resamples=RESAMPLES,
            batch=BATCH,
            method="percentile",
            rng=np.random.default_rng(SEED),
        ).confidence_interval
        low[rows], high[rows] = found.low, found.high
    return low, high


def significant(low: FloatArray, high: FloatArray, logs: IntArray) -> BoolArray:
    """Return whether changes with these intervals and numbers of logs are significant (6)."""
    return np.asarray(((low > 0.0) | (high < 0.0)) & (logs >= MIN_SIGNIFICANT))


def judge_rules(
    rules: tuple[GateRule, ...], comparison: Comparison, labels: Mapping[str, LogLabels]
) -> Comparison:
    """Add the verdicts of the rules to a comparison of logs with these labels.

    An optional rule may have none.
    """
    verdicts = []
    for rule in rules:
        found = _judge_rule(rule, comparison, labels)
        if found is not None:
            outcome, reason = found
            why = f" (the rule: {rule.reason})" if outcome is Outcome.FAIL and rule.reason else ""
            verdicts.append(RuleVerdict(str(rule), outcome, f"{reason}{why}"))
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
        tags = table["log"].map(lambda log: set(labels[log].tags if log in labels else ()))
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
            found = [
                _judge_change(rule, f"{planner}, {mode} loop", rows) for (planner, mode), rows in by
            ]
            return max(found, key=lambda one: (SEVERITY.index(one[1]), one[0]))[1:]
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
        found = (
            f"{rule.metric} has a value in {count_logs(len(lost))} of the baseline, and in "
            "none of the candidate"
        )
        return -np.inf, Outcome.INCONCLUSIVE, f"{drives}: {found}"
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
