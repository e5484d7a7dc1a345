"""Run against run, as tables: what changed on which log, which gates flipped, and by how much over many logs.

For a log i that both runs drove, and a metric of one version in both (planner and mode are the same everywhere):

(1) delta_i = candidate_i - baseline_i;  0 where |delta_i| <= NOISE_ABS + NOISE_REL max(|baseline_i|, |candidate_i|)
(2) worse_i = delta_i where lower is better, -delta_i where higher is better; none where neither is
(3) relative_i = worse_i / max(mean over logs and runs of |value|, |bound| of a gate on it). Regressions are ranked by
    it: the first collision comes before a little less distance, and that before a millimetre off the plan

Over a group of n logs with a value in both runs:

(4) delta = 1/n sum_i delta_i
(5) [low, high] = 2.5th and 97.5th percentile of (4) over RESAMPLES draws of n logs with replacement, a log's two values
    drawn together (paired percentile bootstrap: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 13)
(6) significant = 0 is outside of (5), and n >= MIN_SIGNIFICANT

The draws are seeded: equal tables give equal intervals. The percentile method, unlike BCa, has bounds where most
differences are exactly 0.

Both tables are judged by the same gates and the candidate's reference drives. A flip is marginal, and no rule
(`metrics.compare.rules`) counts it, where the value moved by no more than the noise of (1), or where the baseline's
ensemble found the drive fragile.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd

from logs.kernel import BoolArray, FloatArray, IntArray
from metrics.evidence import ENSEMBLE
from metrics.judge import REFERENCE, judge, outcomes
from metrics.judge.aggregate import SUITE, LogLabels, membership
from metrics.judge.gates import Gates, Outcome

NOISE_ABS, NOISE_REL = 1e-9, 1e-6  # Rounding: sums of another order, a solver's last iterations
NAMED = 5  # More logs than these are counted and not named
MIN_PAIRS = 3  # Resampling fewer logs says nothing
MIN_SIGNIFICANT = 6  # Fewer logs all move one way by chance more often than at 5 % (sign test: 2 / 2^5 = 6 %)
CONFIDENCE, RESAMPLES, SEED = 0.95, 2000, 20260101
BATCH = 250  # Draws at a time: bounds memory, and is part of what makes the draws the same

DRIVE = ["log", "planner", "mode"]
SCORE = ["planner", "mode", "metric"]
KEYS = [*DRIVE, "metric"]
PAIR_COLUMNS = (
    *KEYS, "unit", "direction", "baseline", "candidate", "delta", "worse", "relative", "asked", "fragile",
    "time_s", "reason",
)  # fmt: skip
FLIP_COLUMNS = (
    *DRIVE, "gate", "metric", "before", "after", "value_before", "value_after", "time_s", "reason", "marginal",
)  # fmt: skip
GROUP_COLUMNS = (
    "kind", "group", *SCORE, "unit", "direction", "logs", "baseline", "candidate", "delta", "low", "high", "better",
    "worse", "significant",
)  # fmt: skip
PARTING_COLUMNS = (*DRIVE, "t_s", "stage", "what")
BY_LOG = ("worst", "pass_share")  # `over` of the gates that each log passes or fails by itself
NOT_ASKED = "not asked"  # Outcome of an optional gate on a log without the value


@dataclass(frozen=True, eq=False)
class Side:
    """One of two runs.

    Attributes:
        table: Rows of `metrics.evaluate`, reference drives among them.
        logs: A row per log: log, sha256, family, dataset, tags (a list), vehicle (a hash, "" where it is not known).
        facts: What it was made with, as text: versions, every key of the configuration.
        failed: Logs that could not be evaluated, and why.
        crashed: Drives (log, planner, mode) in which the planner failed; the table holds their beginning.
        metrics: "module:NAME" of the metrics of the user's own.
    """

    label: str
    table: pd.DataFrame
    logs: pd.DataFrame
    facts: Mapping[str, str]
    failed: Mapping[str, str]
    crashed: tuple[tuple[str, str, str], ...] = ()
    metrics: tuple[str, ...] = ()

    @property
    def labels(self) -> dict[str, LogLabels]:
        """What each log belongs to."""
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
    """Verdict of a rule of comparison; `reason` is one sentence with what was found."""

    rule: str
    outcome: Outcome
    reason: str


@dataclass(frozen=True, eq=False)
class Comparison:
    """Two runs, compared.

    Attributes:
        baseline: Label; `candidate` likewise.
        differences: Inputs that are not the same, a sentence each.
        only_in_baseline: Drives, "log, planner, mode loop", and those that failed in the candidate only;
            `only_in_candidate` likewise.
        pairs: `PAIR_COLUMNS`, the worst regression first: metrics that a gate or rule names, by (3), then the others.
            A value that one of the runs lacks is NaN, and `reason` says why; else what the candidate's value is about.
        flips: `FLIP_COLUMNS`: gates whose outcome on a log changed.
        groups: `GROUP_COLUMNS`: means over the suite, its families, tags and datasets.
        partings: `PARTING_COLUMNS`: first differences of two drives; empty where traces are not at hand.
        not_looked_at: Number of drives that differ and whose first difference was not looked for.
        other_logs: Logs of one name that have another content (SHA-256) in the two runs.
        not_compared: Metrics that a gate or a rule names, and that the baseline has in another version or alone.
    """

    baseline: str
    candidate: str
    differences: tuple[str, ...]
    only_in_baseline: tuple[str, ...]
    only_in_candidate: tuple[str, ...]
    pairs: pd.DataFrame
    flips: pd.DataFrame
    groups: pd.DataFrame
    partings: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=list(PARTING_COLUMNS)))
    verdicts: tuple[RuleVerdict, ...] = ()
    not_looked_at: int = 0
    not_compared: tuple[str, ...] = ()
    other_logs: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """0 pass, 1 a rule failed, 4 inconclusive: nothing to compare, or a rule had nothing to judge."""
        found = {verdict.outcome for verdict in self.verdicts}
        if Outcome.FAIL in found:
            return 1
        return 4 if self.pairs.empty or Outcome.INCONCLUSIVE in found else 0

    @property
    def by_loop(self) -> tuple[str, ...]:
        """A sentence for each loop, the closed one first: drives with flips to PASS alone, to FAIL alone, and both."""
        said = []
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
            said.append(f"{mode.capitalize()} loop, by gates: {counts}, of {drives} drives.")
        return tuple(said)

    def regressions(self, most: int, each: int = 2) -> pd.DataFrame:
        """The worst pairs, at most `each` of one drive: one bad drive does not hide the others."""
        worse = self.pairs[self.pairs["worse"] > 0.0]
        return worse[worse.groupby(DRIVE).cumcount() < each].head(most)

    def improvements(self, most: int, each: int = 2) -> pd.DataFrame:
        """Likewise, the greatest improvement first."""
        better = self.pairs[self.pairs["worse"] < 0.0]
        better = better.sort_values(["asked", "relative"], ascending=[False, True], kind="stable")
        return better[better.groupby(DRIVE).cumcount() < each].head(most)


def compare(baseline: Side, candidate: Side, gates: Gates, also: Collection[str] = ()) -> Comparison:
    """Two runs compared by their tables, judged by the same gates; `metrics.compare.rules.judged` adds rules.

    `also` are metrics that rules name beside the gates: they come before others among the regressions.
    """
    tables = baseline.table, candidate.table
    before, now = (dict(zip(table["metric"], table["version"], strict=True)) for table in tables)
    changed = {name: f"{before[name]} -> {now[name]}" for name in before if name in now and before[name] != now[name]}
    alone = set(baseline.driven["metric"]) ^ set(candidate.driven["metric"])
    valued = set(baseline.driven.loc[baseline.driven["available"].astype(bool), "metric"])
    ensemble = baseline.table[baseline.table["metric"] == f"{ENSEMBLE.name}.fragile"]
    fragile = pd.MultiIndex.from_frame(ensemble.loc[ensemble["value"] > 0.0, DRIVE])
    bounds = dict.fromkeys(also, 0.0)
    for gate in gates.gates:
        bounds[gate.metric] = max(bounds.get(gate.metric, 0.0), abs(gate.min or 0.0), abs(gate.max or 0.0))
    pairs = _pairs(baseline.driven, candidate.driven, changed, bounds)
    pairs["fragile"] = pd.MultiIndex.from_frame(pairs[DRIVE]).isin(fragile)
    flips = _flips(baseline, candidate, gates, changed.keys() | alone)
    flips["marginal"] |= pd.MultiIndex.from_frame(flips[DRIVE]).isin(fragile)
    return Comparison(
        baseline.label, candidate.label, tuple(_differences(baseline, candidate, changed)),
        _missing(baseline, candidate), _missing(candidate, baseline), pairs, flips,
        group_deltas(pairs, candidate.labels),
        not_compared=tuple(sorted(bounds.keys() & (changed.keys() | alone & valued))),
        other_logs=tuple(_other(baseline, candidate, "sha256")),
    )  # fmt: skip


def _missing(one: Side, two: Side) -> tuple[str, ...]:
    """The drives that only the first run has, or that failed in the second only."""
    there, failed = set(two.drives), set(two.crashed) - set(one.crashed)
    return tuple(
        f"{drive[0]}, {drive[1]}, {drive[2]} loop{' (failed)' if drive in there else ''}"
        for drive in one.drives
        if drive not in there or drive in failed
    )


def _pairs(
    baseline: pd.DataFrame, candidate: pd.DataFrame, left_out: Collection[str], bounds: Mapping[str, float]
) -> pd.DataFrame:
    """`PAIR_COLUMNS` of the rows of both runs, the metrics `left_out` excepted; `bounds` of gates by metric."""
    both = baseline.merge(candidate, on=KEYS, suffixes=("_b", "_c"))
    both = both[~both["metric"].isin(left_out) & (both["available_b"] | both["available_c"]).astype(bool)]
    before, now = both["value_b"].to_numpy(float), both["value_c"].to_numpy(float)
    delta = np.where(noise(before, now), 0.0, now - before)  # (1)
    sign = both["direction_c"].map({"lower": 1.0, "higher": -1.0}).to_numpy(float)
    there = [both[name].to_numpy(bool) for name in ("available_b", "available_c")]
    lost = "only in the baseline; candidate: " + both["reason_c"].astype(object)
    new = "only in the candidate; baseline: " + both["reason_b"].astype(object)
    pairs = both[KEYS].assign(
        unit=both["unit_c"], direction=both["direction_c"], baseline=before, candidate=now, delta=delta,
        worse=sign * delta + 0.0,  # (2)
        asked=both["metric"].isin(list(bounds)), fragile=False, time_s=both["time_s_c"].fillna(both["time_s_b"]),
        reason=np.select([there[0] & there[1], there[1]], [both["reason_c"], new], lost),
    )  # fmt: skip
    size = pairs[["baseline", "candidate"]].abs().mean(axis=1).groupby([pairs[key] for key in SCORE])
    scale = np.maximum(size.transform("mean").to_numpy(float), pairs["metric"].map(bounds).fillna(0.0).to_numpy(float))
    pairs["relative"] = pairs["worse"] / np.where(scale > 0.0, scale, np.nan)  # (3)
    order = pairs.assign(hurts=pairs["worse"] > 0.0).sort_values(
        ["hurts", "asked", "relative", *KEYS], ascending=[False, False, False, True, True, True, True], kind="stable"
    )
    return order[list(PAIR_COLUMNS)].reset_index(drop=True)


def noise(before: np.ndarray, now: np.ndarray) -> BoolArray:
    """Whether two values `(n,)` differ by rounding only (1); False where one is NaN."""
    with np.errstate(invalid="ignore"):
        bound = NOISE_ABS + NOISE_REL * np.maximum(np.abs(before), np.abs(now))
        return np.asarray(np.abs(now - before) <= bound)


class _Judged(NamedTuple):
    """Outcome of a gate on a log; of an optional gate on a log without the value the default."""

    outcome: str = NOT_ASKED
    value: float = np.nan
    time_s: float = np.nan
    reason: str = ""


def _flips(baseline: Side, candidate: Side, gates: Gates, left_out: Collection[str]) -> pd.DataFrame:
    """`FLIP_COLUMNS` of drives of both runs. A change between a pass and not being asked is no flip."""
    rules = Gates(tuple(g for g in gates.gates if g.over in BY_LOG and g.metric not in left_out), gates.source)
    metric = {str(gate): gate.metric for gate in rules.gates}
    old, new = (_judged(rules, side, candidate.table) for side in (baseline, candidate))
    both, rows = {*baseline.drives} & {*candidate.drives}, []
    for key in dict.fromkeys([*old, *new]):
        before, now = old.get(key, _Judged()), new.get(key, _Judged())
        change = {before.outcome, now.outcome}
        if key[:3] not in both or len(change) == 1 or change == {NOT_ASKED, Outcome.PASS.value}:
            continue
        marginal = bool(noise(np.array(before.value), np.array(now.value)))
        when = now.time_s if np.isfinite(now.time_s) else before.time_s
        values = (before.outcome, now.outcome, before.value, now.value, when, now.reason or before.reason, marginal)
        rows.append((*key, metric[key[3]], *values))
    kinds = {"value_before": float, "value_after": float, "time_s": float, "marginal": bool}
    return pd.DataFrame(rows, columns=list(FLIP_COLUMNS)).astype(kinds)


def _judged(gates: Gates, side: Side, references: pd.DataFrame) -> dict[tuple[str, str, str, str], _Judged]:
    """Outcomes by log, planner, mode and gate; the reference drives are those of `references` where it has any."""
    mine = references[(references["mode"] == REFERENCE) & references["log"].isin(side.logs["log"])]
    own = side.table[(side.table["mode"] != REFERENCE) | ~side.table["log"].isin(mine["log"])]
    found = outcomes(judge(gates, pd.concat([own, mine], ignore_index=True), side.labels, failed=side.failed))
    rows = found[[*DRIVE, "gate", *_Judged._fields]].itertuples(index=False, name=None)
    return {row[:4]: _Judged(*row[4:]) for row in rows}


def _differences(baseline: Side, candidate: Side, changed: Mapping[str, str]) -> Iterator[str]:
    """Sentences on the settings, logs and metrics that are not the same."""
    old, new = baseline.facts, candidate.facts
    yield from (f"{key}: {old[key]} -> {new[key]}" for key in old if key in new and old[key] != new[key])
    metrics = [list(dict.fromkeys(side.driven["metric"])) for side in (baseline, candidate)]
    changes = [f"{name} ({versions})" for name, versions in changed.items()]
    for what, names in (
        ("settings of the baseline only", [key for key in old if key not in new]),
        ("settings of the candidate only", [key for key in new if key not in old]),
        ("logs with another SHA-256", _other(baseline, candidate, "sha256")),
        ("logs with another vehicle", _other(baseline, candidate, "vehicle")),
        ("metrics of another version, not compared", changes),
        ("metrics in the baseline only", [name for name in metrics[0] if name not in metrics[1]]),
        ("metrics in the candidate only", [name for name in metrics[1] if name not in metrics[0]]),
    ):
        if names:
            more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
            yield f"{what}: {', '.join(names[:NAMED])}{more}"


def _other(baseline: Side, candidate: Side, column: str) -> list[str]:
    """Logs of both runs of which a column is known and not the same."""
    both = baseline.logs.merge(candidate.logs, on="log", suffixes=("_b", "_c"))
    one, two = both[f"{column}_b"], both[f"{column}_c"]
    return list(both.loc[(one != "") & (two != "") & (one != two), "log"])


def group_deltas(pairs: pd.DataFrame, labels: Mapping[str, LogLabels]) -> pd.DataFrame:
    """`GROUP_COLUMNS` of `PAIR_COLUMNS`: rows by group of logs (the suite, parts with several logs) and score."""
    known, parts = pairs[pairs["delta"].notna()], []
    there = {log: labels[log] for log in labels if log in set(known["log"])}
    for (kind, name), logs in membership(there).items() if there else ():
        if kind == SUITE or 1 < len(logs) < len(there):
            parts.append(_group(known[known["log"].isin(logs)]).assign(kind=kind, group=name or "all"))
    numbers = dict.fromkeys(("baseline", "candidate", "delta", "low", "high"), float)
    empty = pd.DataFrame(columns=list(GROUP_COLUMNS)).astype({**numbers, "significant": bool})
    return pd.concat(parts, ignore_index=True)[list(GROUP_COLUMNS)] if parts else empty


def _group(pairs: pd.DataFrame) -> pd.DataFrame:
    """Means (4), intervals (5) and significance (6) of each planner, mode and metric."""
    by = pairs.assign(better=pairs["worse"] < 0.0, worse=pairs["worse"] > 0.0).groupby(SCORE, sort=True)
    table = by.agg(
        unit=("unit", "first"), direction=("direction", "first"), logs=("log", "size"), baseline=("baseline", "mean"),
        candidate=("candidate", "mean"), delta=("delta", "mean"), better=("better", "sum"), worse=("worse", "sum"),
    )  # fmt: skip
    deltas = pairs.pivot_table(index=SCORE, columns="log", values="delta", sort=True).loc[table.index]
    low, high = intervals(deltas.to_numpy(float))
    clear = significant(low, high, table["logs"].to_numpy())
    return table.assign(low=low, high=high, significant=clear).reset_index()


def intervals(deltas: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bounds (5), `(m,)` each, of m metrics over n logs `(m, n)`; NaN deltas are logs without the value."""
    from scipy.stats import bootstrap  # here: it takes longer to load than all metrics

    there = np.isfinite(deltas)
    low = np.where(there.sum(axis=1) < MIN_PAIRS, np.nan, 0.0)
    high = low.copy()
    moved = np.isfinite(low) & (np.nan_to_num(deltas) != 0.0).any(axis=1)
    for pattern in np.unique(there[moved], axis=0):
        rows = moved & (there == pattern).all(axis=1)
        found = bootstrap(
            (deltas[rows][:, pattern],), np.mean, axis=-1, vectorized=True, confidence_level=CONFIDENCE,
            n_resamples=RESAMPLES, batch=BATCH, method="percentile", rng=np.random.default_rng(SEED),
        ).confidence_interval  # fmt: skip
        low[rows], high[rows] = found.low, found.high
    return low, high


def significant(low: FloatArray, high: FloatArray, logs: IntArray) -> BoolArray:
    """Whether changes with these intervals, over these numbers of logs, are more than chance (6)."""
    return np.asarray(((low > 0.0) | (high < 0.0)) & (logs >= MIN_SIGNIFICANT))
