"""Compares two runs as tables: what changed on which log, which gates flipped, and by how much over
many logs.

For a log i that both runs drove, and a metric of the same version in both (always with the same
planner and mode):

(1) delta_i = candidate_i - baseline_i; 0 where it is noise (`resampling`, (1))
(2) worse_i = delta_i where lower is better, -delta_i where higher is better;
        NaN where neither is better
(3) relative_i = worse_i / max(mean over logs and runs of |value|, |bound| of a gate on the metric).
        It ranks regressions: a first collision comes before slightly less distance, and that before
        an error of a millimetre against the plan

Over a group of n logs with a value in both runs:

(4) delta = 1/n sum_i delta_i, with the interval and the significance of `resampling`

The same gates and the candidate's reference drives judge both tables. A flip is marginal if the
value changed by no more than noise, or if the baseline's ensemble found the drive fragile. Rules
(`comparison_rules`) do not count marginal flips.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import pandas as pd

from replan.core.names import listed
from replan.metrics import evidence
from replan.metrics.judge.aggregate import SUITE, LogLabels, membership
from replan.metrics.judge.cases import REFERENCE
from replan.metrics.judge.gates import Gates, Outcome
from replan.metrics.judge.verdicts import DRIVE, judge, outcomes
from replan.metrics.resampling import by_recording, intervals, noise, significant

NAMED = 5  # Messages name at most this many logs, and the number of the others

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
BY_LOG = ("worst", "pass_share")  # `over` of the gates that each log passes or fails by itself
PARTING_NUMBERS = ("t_s", "ahead_m", "left_m")
PARTING_COLUMNS = (*DRIVE, "t_s", "stage", "what", "agent", "kind", "ahead_m", "left_m", "lights")
"""Of a first difference: also the agent that it is about, its kind and its place in the ego's
frame, and the colours of the lights, as text.
"""


@dataclass(frozen=True, eq=False)
class Side:
    """One of two runs.

    Attributes:
        label: Its name for the user.
        table: Rows of `replan.metrics.evaluate`, reference drives among them.
        logs: A row per log: log, sha256, family, dataset, tags (a list), vehicle (a hash; "" if
            unknown).
        facts: Versions and all keys of the configuration of the run, as text.
        failed: Reason by log, for logs that could not be evaluated.
        crashed: Drives (log, planner, mode) in which the planner failed; the table holds their
            beginning.
        metrics: "module:NAME" of the user's metrics.
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
    """Two runs, compared.

    Attributes:
        baseline: Label of the baseline; `candidate` likewise.
        differences: Inputs that differ, one sentence each.
        only_in_baseline: Drives "log, planner, mode loop" that only the baseline has, or that
            failed only in the candidate; `only_in_candidate` likewise.
        pairs: `PAIR_COLUMNS`, the worst regression first: metrics that a gate or rule names, by
            (3), then the others. A value that one of the runs lacks is NaN, and `reason` says why;
            otherwise `reason` is that of the candidate's value.
        flips: `FLIP_COLUMNS`: gates whose outcome on a log changed.
        groups: `GROUP_COLUMNS`: means over the suite, its families, tags and datasets.
        partings: `PARTING_COLUMNS`: first differences of two drives; empty without traces.
        verdicts: The verdicts of the rules.
        not_looked_at: Number of differing drives whose first difference was not searched.
        equal_drives: Number of drives with the same states, commands and plans, in bits.
        unpaired: Command that pairs planners of other names.
        not_compared: Metrics of gates or rules that the baseline has in another version, or that
            only the baseline has.
        other_logs: Logs whose content (SHA-256) differs between the two runs.
    """

    baseline: str
    candidate: str
    differences: tuple[str, ...]
    only_in_baseline: tuple[str, ...]
    only_in_candidate: tuple[str, ...]
    pairs: pd.DataFrame
    flips: pd.DataFrame
    groups: pd.DataFrame
    partings: pd.DataFrame = field(
        default_factory=lambda: pd.DataFrame(columns=list(PARTING_COLUMNS))
    )
    verdicts: tuple[RuleVerdict, ...] = ()
    not_looked_at: int = 0
    equal_drives: int = 0
    unpaired: str = ""
    not_compared: tuple[str, ...] = ()
    other_logs: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """0 pass, 1 a rule failed, 4 inconclusive: nothing to compare, or a rule had nothing to
        judge.
        """
        outcomes = {verdict.outcome for verdict in self.verdicts}
        if Outcome.FAIL in outcomes:
            return 1
        return 4 if self.pairs.empty or Outcome.INCONCLUSIVE in outcomes else 0

    @property
    def by_loop(self) -> tuple[str, ...]:
        """One sentence per loop, closed first: numbers of drives with flips only to PASS, only to
        FAIL, and both.
        """
        sentences = []
        flips = self.flips[~self.flips["marginal"].astype(bool)]
        for mode in sorted(set(self.pairs["mode"])):
            of_loop = flips[flips["mode"] == mode]
            better, worse = (
                set(of_loop.loc[of_loop["after"] == word, DRIVE].itertuples(index=False, name=None))
                for word in (Outcome.PASS.value, Outcome.FAIL.value)
            )
            mixed = f", to both in {len(better & worse)}" if better & worse else ""
            drives = len(self.pairs.loc[self.pairs["mode"] == mode, DRIVE].drop_duplicates())
            counts = f"to FAIL in {len(worse - better)}, to pass in {len(better - worse)}{mixed}"
            sentences.append(f"{mode.capitalize()} loop: gates flip {counts}, of {drives} drives.")
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
    before, now = (
        dict(zip(side.table["metric"], side.table["version"], strict=True))
        for side in (baseline, candidate)
    )
    changed = {
        name: f"{version} -> {now[name]}"
        for name, version in before.items()
        if name in now and version != now[name]
    }
    alone = set(baseline.driven["metric"]) ^ set(candidate.driven["metric"])
    valued = set(baseline.driven.loc[baseline.driven["available"].astype(bool), "metric"])
    ensemble = baseline.table[baseline.table["metric"] == f"{evidence.ensemble.name}.fragile"]
    fragile = pd.MultiIndex.from_frame(ensemble.loc[ensemble["value"] > 0.0, DRIVE])
    bounds = dict.fromkeys(also, 0.0)
    for gate in gates.gates:
        known = bounds.get(gate.metric, 0.0)
        bounds[gate.metric] = max(known, abs(gate.min or 0.0), abs(gate.max or 0.0))
    pairs = _pairs(baseline.driven, candidate.driven, changed, bounds)
    pairs["fragile"] = pd.MultiIndex.from_frame(pairs[DRIVE]).isin(fragile)
    flips = _flips(baseline, candidate, gates, changed.keys() | alone)
    flips["marginal"] |= pd.MultiIndex.from_frame(flips[DRIVE]).isin(fragile)
    return Comparison(
        baseline.label,
        candidate.label,
        tuple(_differences(baseline, candidate, changed)),
        _missing_drives(baseline, candidate),
        _missing_drives(candidate, baseline),
        pairs,
        flips,
        group_deltas(pairs, candidate.labels),
        not_compared=tuple(sorted(bounds.keys() & (changed.keys() | alone & valued))),
        other_logs=tuple(_differing_logs(baseline, candidate, "sha256")),
    )


def _differences(baseline: Side, candidate: Side, changed: Mapping[str, str]) -> Iterator[str]:
    """Yield the inputs that differ, one sentence each; `changed`: versions of metrics, by name."""
    old, new = baseline.facts, candidate.facts
    contents = [
        f"{log} ({before[:8]} -> {now[:8]})"
        for log, (before, now) in _differing_logs(baseline, candidate, "sha256").items()
    ]
    if contents:
        yield f"logs of one name with other content (SHA-256): {listed(contents, NAMED)}"
    for key, fact in old.items():
        if key in new and fact != new[key]:
            yield f"{key}: {fact} -> {new[key]}"
    metrics, metrics_now = (dict.fromkeys(side.driven["metric"]) for side in (baseline, candidate))
    for title, names in {
        "settings of the baseline only": [key for key in old if key not in new],
        "settings of the candidate only": [key for key in new if key not in old],
        "logs with another vehicle": list(_differing_logs(baseline, candidate, "vehicle")),
        "metrics of another version, not compared": [
            f"{name} ({versions})" for name, versions in changed.items()
        ],
        "metrics in the baseline only": [name for name in metrics if name not in metrics_now],
        "metrics in the candidate only": [name for name in metrics_now if name not in metrics],
    }.items():
        if names:
            yield f"{title}: {listed(names, NAMED)}"


def _missing_drives(side: Side, other: Side) -> tuple[str, ...]:
    """Return the drives that only the first run has, or that failed only in the second."""
    driven, failed = set(other.drives), set(other.crashed) - set(side.crashed)
    return tuple(
        f"{', '.join(drive)} loop{' (failed)' if drive in driven else ''}"
        for drive in side.drives
        if drive not in driven or drive in failed
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
    had, has = (both[name].to_numpy(bool) for name in ("available_b", "available_c"))
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
        reason=np.select([had & has, has], [both["reason_c"], new], lost),
    )
    size = pairs[["baseline", "candidate"]].abs().mean(axis=1)
    mean_size = size.groupby([pairs[key] for key in SCORE]).transform("mean").to_numpy(float)
    scale = np.maximum(mean_size, pairs["metric"].map(bounds).fillna(0.0).to_numpy(float))
    pairs["relative"] = pairs["worse"] / np.where(scale > 0.0, scale, np.nan)  # (3)
    order = pairs.assign(hurts=pairs["worse"] > 0.0).sort_values(
        ["hurts", "asked", "relative", *KEYS],
        ascending=[False, False, False, True, True, True, True],
        kind="stable",
    )
    return order[list(PAIR_COLUMNS)].reset_index(drop=True)


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
    old, new = (_outcomes(side, candidate, rules) for side in (baseline, candidate))
    both, rows = {*baseline.drives} & {*candidate.drives}, []
    for key in dict.fromkeys([*old, *new]):
        *drive, gate = key
        before, now = old.get(key, _LogOutcome()), new.get(key, _LogOutcome())
        change = {before.outcome, now.outcome}
        is_flip = len(change) == 2 and change != {Outcome.NOT_ASKED.value, Outcome.PASS.value}
        if not is_flip or tuple(drive) not in both:
            continue
        marginal = bool(noise(np.array(before.value), np.array(now.value)))
        when = now.time_s if np.isfinite(now.time_s) else before.time_s
        values = before.outcome, now.outcome, before.value, now.value
        reason = now.reason or before.reason
        rows.append((*key, metric[gate], *values, when, reason, marginal))
    kinds = {"value_before": float, "value_after": float, "time_s": float, "marginal": bool}
    return pd.DataFrame(rows, columns=list(FLIP_COLUMNS)).astype(kinds)


def _outcomes(
    side: Side, candidate: Side, rules: Gates
) -> dict[tuple[str, str, str, str], _LogOutcome]:
    """Return the outcomes of a run by log, planner, mode and gate.

    The reference drives are those of the candidate, if it has any.
    """
    of_candidate, is_reference = candidate.table, side.table["mode"] == REFERENCE
    references = of_candidate[
        (of_candidate["mode"] == REFERENCE) & of_candidate["log"].isin(side.logs["log"])
    ]
    own = side.table[~is_reference | ~side.table["log"].isin(references["log"])]
    rows = pd.concat([own, references], ignore_index=True)
    table = outcomes(judge(rules, rows, side.labels, failed=side.failed))
    keys = table[[*DRIVE, "gate"]].itertuples(index=False, name=None)
    values = table[[*_LogOutcome._fields]].itertuples(index=False, name=None)
    return {key: _LogOutcome(*row) for key, row in zip(keys, values, strict=True)}


def _differing_logs(baseline: Side, candidate: Side, column: str) -> dict[str, tuple[str, str]]:
    """Return the logs of both runs whose values in a column are known and differ, with both."""
    both = baseline.logs.merge(candidate.logs, on="log", suffixes=("_b", "_c"))
    old, new = both[f"{column}_b"], both[f"{column}_c"]
    differs = (old != "") & (new != "") & (old != new)
    pairs = zip(old[differs], new[differs], strict=True)
    return dict(zip(both.loc[differs, "log"], pairs, strict=True))


def group_deltas(pairs: pd.DataFrame, labels: Mapping[str, LogLabels]) -> pd.DataFrame:
    """Return `GROUP_COLUMNS` (4), by `SCORE` and group: the suite, and its parts with more
    than one log.
    """
    known, parts = pairs[pairs["delta"].notna()], []
    labels_of_logs = {log: labels[log] for log in labels if log in set(known["log"])}
    for (kind, name), logs in membership(labels_of_logs).items() if labels_of_logs else ():
        if not (kind == SUITE or 1 < len(logs) < len(labels_of_logs)):
            continue
        rows = known[known["log"].isin(logs)]
        counted = rows.assign(better=rows["worse"] < 0.0, worse=rows["worse"] > 0.0)
        table = counted.groupby(SCORE, sort=True).agg(
            unit=("unit", "first"),
            direction=("direction", "first"),
            logs=("log", "size"),
            baseline=("baseline", "mean"),
            candidate=("candidate", "mean"),
            delta=("delta", "mean"),
            better=("better", "sum"),
            worse=("worse", "sum"),
        )
        by_log = rows.pivot_table(index=SCORE, columns="log", values="delta", sort=True)
        deltas = by_recording(by_log.loc[table.index])
        low, high = intervals(deltas.to_numpy(float))
        clear = significant(low, high, deltas.notna().sum(axis=1).to_numpy())
        table = table.assign(low=low, high=high, significant=clear).reset_index()
        parts.append(table.assign(kind=kind, group=name or "all"))
    numbers = dict.fromkeys(("baseline", "candidate", "delta", "low", "high"), float)
    empty = pd.DataFrame(columns=list(GROUP_COLUMNS)).astype({**numbers, "significant": bool})
    return pd.concat(parts, ignore_index=True)[list(GROUP_COLUMNS)] if parts else empty
