"""Run against run, as tables: what changed on which log, what flipped, by how much over the logs, and who moved first.

For a log i that both runs drove, and a metric of one version in both (planner and mode are the same everywhere):

(1) delta_i = candidate_i - baseline_i;  0 where |delta_i| <= NOISE_ABS + NOISE_REL max(|baseline_i|, |candidate_i|)
(2) worse_i = delta_i where lower is better, -delta_i where higher is; none where neither is
(3) relative_i = worse_i / max(mean over logs and runs of |value|, |bound| of a gate on it): by what a regression is
    ranked; the first collision comes before a little less distance, and that before a millimetre off the plan

Both tables are judged by the same gates, and with the same reference drives (the candidate's): a flip comes from the
drive, and not from another gate file or another careful driver. It is marginal, and no rule counts it, where the value
moved by no more than the noise of (1), or where the baseline had an ensemble that found the drive fragile: a candidate
does not excuse itself.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from logs.kernel import BoolArray
from metrics.aggregate import LogLabels
from metrics.compare_groups import group_deltas
from metrics.evidence import ENSEMBLE
from metrics.gates import Gates, Outcome
from metrics.judge import REFERENCE, judge, outcomes

NOISE_ABS, NOISE_REL = 1e-9, 1e-6
"""A difference below this is rounding: sums of another order, a solver's last iterations."""
NAMED = 5
"""More logs than these are counted and not named."""

DRIVE = ["log", "planner", "mode"]
KEYS = [*DRIVE, "metric"]
PAIR_COLUMNS = (
    *KEYS, "unit", "direction", "baseline", "candidate", "delta", "worse", "relative", "asked", "fragile",
    "time_s", "reason",
)  # fmt: skip
FLIP_COLUMNS = (
    *DRIVE, "gate", "metric", "before", "after", "value_before", "value_after", "time_s", "reason", "marginal",
)  # fmt: skip
PARTING_COLUMNS = (*DRIVE, "t_s", "stage", "what")
BY_LOG = ("worst", "pass_share")
"""What gates are `over` that each log passes or fails by itself."""
NOT_ASKED = "not asked"
"""Outcome of an optional gate on a log without the value."""


@dataclass(frozen=True, eq=False)
class Side:
    """One of two runs.

    Attributes:
        label: How it is named.
        table: Rows of `metrics.evaluate`, reference drives among them.
        logs: A row per log: log, sha256, family, dataset, tags (a list), vehicle (a hash, "" where it is not known).
        facts: What it was made with, as text: versions, every key of the configuration.
        failed: Logs that could not be evaluated, and why.
        crashed: Drives (log, planner, mode) in which the planner failed: what the table has of them is a beginning.
    """

    label: str
    table: pd.DataFrame
    logs: pd.DataFrame
    facts: Mapping[str, str]
    failed: Mapping[str, str]
    crashed: tuple[tuple[str, str, str], ...] = ()

    @property
    def tags(self) -> dict[str, tuple[str, ...]]:
        """Tags by log."""
        return {log: labels.tags for log, labels in self.labels.items()}

    @property
    def labels(self) -> dict[str, LogLabels]:
        """What each log belongs to."""
        columns = (self.logs[name] for name in ("log", "family", "dataset", "tags"))
        return {
            log: LogLabels(family, dataset, tuple(tags)) for log, family, dataset, tags in zip(*columns, strict=True)
        }


@dataclass(frozen=True, slots=True)
class RuleVerdict:
    """What a rule of comparison says; `reason` is one sentence with what was found."""

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
        pairs: `PAIR_COLUMNS`, the worst regression first: those of metrics that are asked of, by (3), then others.
            A value that one of the runs lacks is NaN, and `reason` says why; else what the candidate's value is about.
        flips: `FLIP_COLUMNS`: the outcome of a gate on a log is another one.
        groups: `metrics.compare_groups.GROUP_COLUMNS`: means over the suite, its families, tags and datasets.
        partings: `PARTING_COLUMNS`: where two drives part; empty where traces are not at hand.
        verdicts: One per rule.
        not_looked_at: In so many drives that differ it was not looked for where they part.
        other_logs: Logs of one name that have another content (SHA-256) in the two runs.
        not_compared: Metrics that a gate or a rule asks of, and that the baseline has in another version or alone.
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
        said = {verdict.outcome for verdict in self.verdicts}
        if Outcome.FAIL in said:
            return 1
        return 4 if self.pairs.empty or Outcome.INCONCLUSIVE in said else 0

    def regressions(self, most: int, each: int = 2) -> pd.DataFrame:
        """The worst pairs, at most `each` of one drive: one bad drive does not hide the others."""
        return _extremes(self.pairs[self.pairs["worse"] > 0.0], most, each)

    def improvements(self, most: int, each: int = 2) -> pd.DataFrame:
        """Likewise, the greatest improvement first."""
        better = self.pairs[self.pairs["worse"] < 0.0]
        order = better.sort_values(["asked", "relative"], ascending=[False, True], kind="stable")
        return _extremes(order, most, each)


def _extremes(pairs: pd.DataFrame, most: int, each: int) -> pd.DataFrame:
    return pairs[pairs.groupby(DRIVE).cumcount() < each].head(most)


def compare(baseline: Side, candidate: Side, gates: Gates, also: Collection[str] = ()) -> Comparison:
    """Two runs compared by their tables; `metrics.compare_rules.judged` adds what rules say.

    Args:
        baseline: What was.
        candidate: What is.
        gates: By which both are judged.
        also: Metrics that are asked of beside the gates: they come before others among the regressions.
    """
    drives = [_drives(side) for side in (baseline, candidate)]
    changed = _changed_versions(baseline.table, candidate.table)
    fragile = _fragile(baseline.table)
    asked = {**dict.fromkeys(also, 0.0), **_bounds(gates)}
    pairs = _pairs(baseline.table, candidate.table, changed, asked)
    pairs["fragile"] = _in(pairs, fragile)
    alone = _measured(baseline.table) ^ _measured(candidate.table)
    valued = _measured(baseline.table[baseline.table["available"].astype(bool)])
    flips = _flips(baseline, candidate, gates, changed.keys() | alone, drives[0].keys() & drives[1].keys())
    flips["marginal"] |= _in(flips, fragile)
    return Comparison(
        baseline.label,
        candidate.label,
        tuple(_differences(baseline, candidate, changed)),
        tuple(_alone(drives, baseline.crashed, candidate.crashed)),
        tuple(_alone(drives[::-1], candidate.crashed, baseline.crashed)),
        pairs,
        flips,
        group_deltas(pairs, candidate.logs),
        not_compared=tuple(sorted(asked.keys() & (changed.keys() | alone & valued))),
        other_logs=tuple(_other(baseline, candidate, "sha256")),
    )


def _driven(table: pd.DataFrame) -> pd.DataFrame:
    return table[table["mode"] != REFERENCE]


def _measured(table: pd.DataFrame) -> set[str]:
    return set(_driven(table)["metric"])


def _drives(side: Side) -> dict[tuple[str, str, str], str]:
    keys = _driven(side.table)[DRIVE].drop_duplicates().itertuples(index=False, name=None)
    return {(log, planner, mode): f"{log}, {planner}, {mode} loop" for log, planner, mode in keys}


def _alone(
    drives: Sequence[Mapping[tuple[str, str, str], str]], mine: Collection[object], theirs: Collection[object]
) -> Iterator[str]:
    """The drives that only the first run has, or that failed in the other only."""
    for drive, said in drives[0].items():
        if drive not in drives[1]:
            yield said
        elif drive in theirs and drive not in mine:
            yield f"{said} (failed)"


def _changed_versions(one: pd.DataFrame, two: pd.DataFrame) -> dict[str, str]:
    """Rows of the table whose metric has another version, and which."""
    before, now = (dict(zip(table["metric"], table["version"], strict=True)) for table in (one, two))
    return {name: f"{before[name]} -> {now[name]}" for name in before if name in now and before[name] != now[name]}


# pairs ------------------------------------------------------------------------------------------------------------


def _pairs(
    one: pd.DataFrame, two: pd.DataFrame, left_out: Collection[str], bounds: Mapping[str, float]
) -> pd.DataFrame:
    both = _driven(one).merge(_driven(two), on=KEYS, suffixes=("_b", "_c"))
    both = both[~both["metric"].isin(left_out) & (both["available_b"] | both["available_c"]).astype(bool)]
    before, now = (both[f"value_{side}"].to_numpy(float) for side in "bc")
    delta = np.where(noise(before, now), 0.0, now - before)  # (1)
    sign = both["direction_c"].map({"lower": 1.0, "higher": -1.0}).to_numpy(float)
    pairs = both[KEYS].assign(
        unit=both["unit_c"], direction=both["direction_c"], baseline=before, candidate=now, delta=delta,
        worse=sign * delta + 0.0,  # (2)
        asked=both["metric"].isin(list(bounds)), fragile=False,
        time_s=both["time_s_c"].fillna(both["time_s_b"]), reason=_reasons(both),
    )  # fmt: skip
    size = pairs[["baseline", "candidate"]].abs().mean(axis=1).groupby([pairs[key] for key in KEYS[1:]])
    scale = np.maximum(size.transform("mean").to_numpy(float), pairs["metric"].map(bounds).fillna(0.0).to_numpy(float))
    pairs["relative"] = pairs["worse"] / np.where(scale > 0.0, scale, np.nan)  # (3)
    order = pairs.assign(hurts=pairs["worse"] > 0.0).sort_values(
        ["hurts", "asked", "relative", *KEYS], ascending=[False, False, False, True, True, True, True], kind="stable"
    )
    return order[list(PAIR_COLUMNS)].reset_index(drop=True)


def _bounds(gates: Gates) -> dict[str, float]:
    """The greatest |bound| of the gates on each metric that a gate asks of."""
    found: dict[str, float] = {}
    for gate in gates.gates:
        values = [abs(bound) for bound in (gate.min, gate.max) if bound is not None]
        found[gate.metric] = max(found.get(gate.metric, 0.0), *values)
    return found


def noise(before: np.ndarray, now: np.ndarray) -> BoolArray:
    """Whether two values `(n,)` differ by rounding only (1); False where one is NaN."""
    with np.errstate(invalid="ignore"):
        bound = NOISE_ABS + NOISE_REL * np.maximum(np.abs(before), np.abs(now))
        return np.asarray(np.abs(now - before) <= bound)


def _reasons(both: pd.DataFrame) -> list[str]:
    columns = ("available_b", "available_c", "reason_b", "reason_c")
    return [
        _said(before=bool(b), now=bool(c), was=was, why=why)
        for b, c, was, why in zip(*(both[name] for name in columns), strict=True)
    ]


def _said(*, before: bool, now: bool, was: str, why: str) -> str:
    if before and now:
        return why
    return f"only in the candidate; baseline: {was}" if now else f"only in the baseline; candidate: {why}"


# flips ------------------------------------------------------------------------------------------------------------


def _flips(
    baseline: Side,
    candidate: Side,
    gates: Gates,
    left_out: Collection[str],
    drives: Collection[tuple[str, str, str]],
) -> pd.DataFrame:
    """Gates whose outcome on a drive of both runs is another one; what is only asked or no longer asked is none.

    Not of gates on a mean, median or sum: a log by itself breaks none of them.
    """
    asked = (gate for gate in gates.gates if gate.over in BY_LOG and gate.metric not in left_out)
    rules = Gates(tuple(asked), gates.source)
    said = [_outcomes(rules, side, candidate.table) for side in (baseline, candidate)]
    metric = {str(gate): gate.metric for gate in rules.gates}
    rows = []
    for key in dict.fromkeys([*said[0], *said[1]]):
        *drive, gate = key
        before, now = (outcome.get(key, _UNASKED) for outcome in said)
        if tuple(drive) in drives and before[0] != now[0] and {before[0], now[0]} != _NO_FLIP:
            same = bool(noise(np.array([before[1]]), np.array([now[1]]))[0])
            when = now[2] if np.isfinite(now[2]) else before[2]
            change = (before[0], now[0], before[1], now[1], when, now[3] or before[3], same)
            rows.append((*drive, gate, metric[gate], *change))
    kinds = {"value_before": float, "value_after": float, "time_s": float, "marginal": bool}
    return pd.DataFrame(rows, columns=list(FLIP_COLUMNS)).astype(kinds)


_Said = tuple[str, float, float, str]
"""Outcome, value, time, reason."""
_UNASKED: _Said = (NOT_ASKED, np.nan, np.nan, "")
_NO_FLIP = {NOT_ASKED, Outcome.PASS.value}


def _outcomes(gates: Gates, side: Side, references: pd.DataFrame) -> dict[tuple[str, str, str, str], _Said]:
    """What each log says of each gate, by log, planner, mode and gate; reference drives are those of `references`."""
    mine = references[(references["mode"] == REFERENCE) & references["log"].isin(side.logs["log"])]
    own = side.table[(side.table["mode"] != REFERENCE) | ~side.table["log"].isin(mine["log"])]
    found = outcomes(judge(gates, pd.concat([own, mine], ignore_index=True), side.labels, failed=side.failed))
    keys = found[[*DRIVE, "gate"]].itertuples(index=False, name=None)
    rows = found[["outcome", "value", "time_s", "reason"]].itertuples(index=False, name=None)
    return dict(zip(keys, rows, strict=True))


def _fragile(table: pd.DataFrame) -> set[tuple[str, ...]]:
    """Drives whose verdict does not hold in worlds that should not matter, where the run had an ensemble."""
    found = table[(table["metric"] == f"{ENSEMBLE.name}.fragile") & (table["value"] > 0.0)]
    return set(found[DRIVE].itertuples(index=False, name=None))


def _in(table: pd.DataFrame, drives: Collection[tuple[str, ...]]) -> BoolArray:
    """Which rows are of one of these drives."""
    return np.array([key in drives for key in table[DRIVE].itertuples(index=False, name=None)], bool)


# inputs -----------------------------------------------------------------------------------------------------------


def _differences(baseline: Side, candidate: Side, changed: Mapping[str, str]) -> Iterator[str]:
    old, new = baseline.facts, candidate.facts
    yield from (f"{key}: {old[key]} -> {new[key]}" for key in old if key in new and old[key] != new[key])
    for word, keys in (("baseline", [k for k in old if k not in new]), ("candidate", [k for k in new if k not in old])):
        if keys:
            yield f"settings of the {word} only: {_named(keys)}"
    for column, what in (("sha256", "another SHA-256"), ("vehicle", "another vehicle")):
        names = _other(baseline, candidate, column)
        if names:
            yield f"logs with {what}: {_named(names)}"
    if changed:
        yield f"metrics of another version, not compared: {_named([f'{k} ({v})' for k, v in changed.items()])}"
    before, now = (list(dict.fromkeys(_driven(side.table)["metric"])) for side in (baseline, candidate))
    for one, two, word in ((before, now, "baseline"), (now, before, "candidate")):
        alone = [name for name in one if name not in set(two)]
        if alone:
            yield f"metrics in the {word} only: {_named(alone)}"


def _other(baseline: Side, candidate: Side, column: str) -> list[str]:
    """Logs of both runs of which a column is known and not the same."""
    both = baseline.logs.merge(candidate.logs, on="log", suffixes=("_b", "_c"))
    known = (both[f"{column}_b"] != "") & (both[f"{column}_c"] != "")
    return list(both.loc[known & (both[f"{column}_b"] != both[f"{column}_c"]), "log"])


def _named(names: Sequence[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"{', '.join(names[:NAMED])}{more}"
