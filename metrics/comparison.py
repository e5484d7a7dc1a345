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

from collections.abc import Collection, Mapping
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
    equal_drives: int = 0  # Number of drives with the same states, commands and plans, in bits
    unpaired: str = ""  # Command that pairs planners of other names
    # Metrics of gates or rules that the baseline has in another version, or that only the baseline
    # has
    not_compared: tuple[str, ...] = ()
    other_logs: tuple[str, ...] = ()  # Logs whose content (SHA-256) differs between the two runs

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
    old_facts, new_facts = baseline.facts, candidate.facts
    other_logs = _differing_logs(baseline, candidate, "sha256")
    differences = [
        f"{key}: {old_facts[key]} -> {new_facts[key]}"
        for key in old_facts
        if key in new_facts and old_facts[key] != new_facts[key]
    ]
    if other_logs:
        contents = [
            f"{log} ({old_digest[:8]} -> {new_digest[:8]})"
            for log, (old_digest, new_digest) in other_logs.items()
        ]
        title = "logs of one name with other content (SHA-256)"
        differences.insert(0, f"{title}: {listed(contents, NAMED)}")
    metrics = [list(dict.fromkeys(side.driven["metric"])) for side in (baseline, candidate)]
    for title, names in (
        ("settings of the baseline only", [key for key in old_facts if key not in new_facts]),
        ("settings of the candidate only", [key for key in new_facts if key not in old_facts]),
        ("logs with another vehicle", list(_differing_logs(baseline, candidate, "vehicle"))),
        (
            "metrics of another version, not compared",
            [f"{name} ({both})" for name, both in changed.items()],
        ),
        ("metrics in the baseline only", [name for name in metrics[0] if name not in metrics[1]]),
        ("metrics in the candidate only", [name for name in metrics[1] if name not in metrics[0]]),
    ):
        if names:
            differences.append(f"{title}: {listed(names, NAMED)}")
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


def _missing_drives(side: Side, other: Side) -> tuple[str, ...]:
    """Return the drives that only the first run has, or that failed only in the second."""
    driven, failed = set(other.drives), set(other.crashed) - set(side.crashed)
    return tuple(
        f"{drive[0]}, {drive[1]}, {drive[2]} loop{' (failed)' if drive in driven else ''}"
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
    available = [both[name].to_numpy(bool) for name in ("available_b", "available_c")]
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
        reason=np.select(
            [available[0] & available[1], available[1]], [both["reason_c"], new], lost
        ),
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
        references = candidate.table[
            (candidate.table["mode"] == REFERENCE) & candidate.table["log"].isin(side.logs["log"])
        ]
        own = side.table[
            (side.table["mode"] != REFERENCE) | ~side.table["log"].isin(references["log"])
        ]
        table = outcomes(
            judge(
                rules,
                pd.concat([own, references], ignore_index=True),
                side.labels,
                failed=side.failed,
            )
        )
        fields = table[[*DRIVE, "gate", *_LogOutcome._fields]].itertuples(index=False, name=None)
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
        *_, gate = key
        rows.append(
            (
                *key,
                metric[gate],
                before.outcome,
                now.outcome,
                before.value,
                now.value,
                when,
                now.reason or before.reason,
                marginal,
            )
        )
    kinds = {"value_before": float, "value_after": float, "time_s": float, "marginal": bool}
    return pd.DataFrame(rows, columns=list(FLIP_COLUMNS)).astype(kinds)


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
        groups = rows.assign(better=rows["worse"] < 0.0, worse=rows["worse"] > 0.0).groupby(
            SCORE, sort=True
        )
        table = groups.agg(
            unit=("unit", "first"),
            direction=("direction", "first"),
            logs=("log", "size"),
            baseline=("baseline", "mean"),
            candidate=("candidate", "mean"),
            delta=("delta", "mean"),
            better=("better", "sum"),
            worse=("worse", "sum"),
        )
        deltas = rows.pivot_table(index=SCORE, columns="log", values="delta", sort=True).loc[
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
