"""Summarises many logs: mean, median, worst and total of every metric, and the share of logs that
pass, by group.

Groups are the suite (all logs), each family, each tag, and each dataset. `groups` returns a row per
group, planner, loop and metric, and per group and planner the row `PASS`: the share of its logs
that pass.

With passed = logs that the gates pass, n = logs of the group, p = passed / n, z = `Z`, the share's
interval is

(1)  (p + z^2 / 2n +- z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)

(Wilson, J. Am. Stat. Assoc. 22 (1927) 209; recommended for few trials by Brown, Cai, DasGupta,
Statistical Science 16 (2001) 101). It assumes that the logs are a random sample of those that the
group represents.

n counts every log of the run. A log that could not be evaluated counts against the planner like a
failed log; an inconclusive log is not a pass either, and is counted separately.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from math import sqrt
from typing import Any

import numpy as np
import pandas as pd

Z = 1.959963984540054  # 95 % of the normal distribution lie within +-Z
PASS = "pass"  # Name of the rows about the share of logs that pass; not a metric
SUITE = "suite"
BOTH = "both"  # Mode of the rows that combine open and closed loop of a log
# Of several loops, the first of these applies
STANDINGS = ("failed", "missing", "inconclusive", "passed")
_STANDS = {"fail": "failed", "inconclusive": "inconclusive", "pass": "passed"}

COLUMNS = (
    "kind",
    "group",
    "planner",
    "mode",
    "metric",
    "unit",
    "direction",
    "logs",
    "available",
    "missing",
    "mean",
    "median",
    "worst",
    "worst_log",
    "total",
    "low",
    "high",
    "passed",
    "failed",
    "inconclusive",
)
COUNTS = ("logs", "available", "missing")
NUMBERS = (
    "mean",
    "median",
    "worst",
    "total",
    "low",
    "high",
    "passed",
    "failed",
    "inconclusive",
)
_KEY = ["kind", "group", "planner", "mode", "metric"]


@dataclass(frozen=True, slots=True)
class LogLabels:
    """The family, dataset and tags of a log; "" and () if unknown."""

    family: str = ""
    dataset: str = ""
    tags: tuple[str, ...] = ()


def wilson(passed: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval (1) of a share; 0 to 1 without trials."""
    if n == 0:
        return 0.0, 1.0
    share, width = passed / n, 1.0 + Z * Z / n
    middle = share + Z * Z / (2 * n)
    half = Z * sqrt(share * (1.0 - share) / n + Z * Z / (4.0 * n * n))
    # (1), which is exactly 0 and 1 at the ends
    low = 0.0 if passed == 0 else (middle - half) / width
    return low, 1.0 if passed == n else (middle + half) / width


def membership(labels: Mapping[str, LogLabels]) -> dict[tuple[str, str], tuple[str, ...]]:
    """Return the logs of each (kind, group): suite, families, tags, datasets, by name.

    A log may have no family.
    """
    groups_of_logs: dict[tuple[str, str], list[str]] = {(SUITE, ""): list(labels)}
    for kind, words in (
        ("family", {log: (of.family,) for log, of in labels.items()}),
        ("tag", {log: of.tags for log, of in labels.items()}),
        ("dataset", {log: (of.dataset,) for log, of in labels.items()}),
    ):
        for word in sorted({*chain.from_iterable(words.values())} - {""}):
            groups_of_logs[kind, word] = [
                log for log, log_words in words.items() if word in log_words
            ]
    return {key: tuple(logs) for key, logs in groups_of_logs.items()}


def standings(
    verdicts: pd.DataFrame,
    drives: pd.DataFrame,
    logs: Collection[str],
    asked: Sequence[tuple[str, str]],
    crashed: Collection[tuple[str, str | None, str | None]] = (),
) -> pd.DataFrame:
    """Return the standing of each log with each planner: a row per log, planner and mode, with one
    of `STANDINGS`.

    Args:
        verdicts: Outcomes of gates: columns log, planner, mode, outcome.
        drives: The drives: columns log, planner, mode, oracle.
        logs: All logs of the run, including those that could not be read.
        asked: Planners and modes of the run; an oracle that no gate judges has no standing, nor a
            loop without gates.
        crashed: Log, planner and mode of drives that could not be evaluated; None: any.
    """
    outcomes: dict[tuple[str, str, str], set[str]] = {}
    for log, planner, mode, outcome in _rows(verdicts, "log", "planner", "mode", "outcome"):
        if outcome in _STANDS:
            outcomes.setdefault((log, planner, mode), set()).add(_STANDS[outcome])
    driven = set(_rows(drives, "log", "planner", "mode"))
    judged = {planner for _, planner, _ in outcomes}
    unjudged = {
        planner for planner, oracle in _rows(drives, "planner", "oracle") if oracle
    } - judged
    loops = {*verdicts["mode"], *(mode for *_, mode in crashed)}
    rows = []
    for planner in dict.fromkeys(planner for planner, _ in asked if planner not in unjudged):
        of_run = [mode for name, mode in asked if name == planner]
        modes = [mode for mode in of_run if not loops or None in loops or mode in loops] or of_run
        for log in logs:
            lost = [
                mode
                for other_log, name, mode in crashed
                if other_log == log and name in (None, planner)
            ]
            results = []
            for mode in modes:
                log_outcomes = outcomes.get((log, planner, mode)) or {"inconclusive"}
                whole = (log, planner, mode) in driven and mode not in lost and None not in lost
                results.append(
                    min(log_outcomes if whole else log_outcomes | {"missing"}, key=STANDINGS.index)
                )
            rows += [
                (log, planner, mode, standing)
                for mode, standing in zip(modes, results, strict=True)
            ]
            rows += (
                [(log, planner, BOTH, min(results, key=STANDINGS.index))] if len(modes) > 1 else []
            )
    return pd.DataFrame(rows, columns=["log", "planner", "mode", "standing"])


def pass_shares(stand: pd.DataFrame, labels: Mapping[str, LogLabels]) -> pd.DataFrame:
    """Return the rows `PASS` of `groups`, from the rows of `standings`."""
    by_log: dict[tuple[str, str], dict[str, str]] = {}
    for log, planner, mode, standing in _rows(stand, "log", "planner", "mode", "standing"):
        by_log.setdefault((planner, mode), {})[log] = standing
    rows = []
    for (kind, group), logs in membership(labels).items():
        for (planner, mode), standing_of in by_log.items():
            count = {word: sum(standing_of[log] == word for log in logs) for word in STANDINGS}
            low, high = wilson(count["passed"], len(logs))
            share = count["passed"] / len(logs) if logs else np.nan
            rows.append(
                {
                    "kind": kind,
                    "group": group,
                    "planner": planner,
                    "mode": mode,
                    "metric": PASS,
                    "unit": "1",
                    "direction": "higher",
                    "logs": len(logs),
                    "available": len(logs) - count["missing"],
                    "mean": share,
                    "worst_log": "",
                    "low": low,
                    "high": high,
                    **count,
                }
            )
    return _with_types(pd.DataFrame(rows, columns=list(COLUMNS)))


def groups(
    table: pd.DataFrame, stand: pd.DataFrame, labels: Mapping[str, LogLabels]
) -> pd.DataFrame:
    """Return `COLUMNS` per group, planner, mode and metric, and the shares that pass; sorted, suite
    first.

    `table` has rows of `replan.metrics.evaluate` (not of reference drives), `stand` of `standings`.
    `worst` follows the metric's direction, NaN if it has none; `missing` is the number of logs of
    the group without a value.
    """
    table = table[table["mode"].isin(["open", "closed"]) & table["log"].isin(list(labels))]
    row, logs = pd.factorize(table["log"], sort=True)
    by = table.groupby(["planner", "mode", "metric"], sort=True, observed=True)
    # A row per log, a column per planner, mode and metric
    value = np.full((len(logs), by.ngroups), np.nan)
    value[row, by.ngroup()] = table["value"].where(
        table["available"].astype(bool) & np.isfinite(table["value"])
    )
    columns = by[["unit", "direction"]].first().reset_index()
    sign = columns["direction"].map({"lower": 1.0, "higher": -1.0, "none": np.nan}).to_numpy(float)
    parts = [pass_shares(stand, labels)]
    for (kind, group), members in membership(labels).items() if len(table) else ():
        chosen = np.array([log in members for log in logs])
        chosen_values, named = value[chosen], logs.to_numpy(object)[chosen]
        finite = np.isfinite(chosen_values)
        count, total = finite.sum(axis=0), np.where(finite, chosen_values, 0.0).sum(axis=0)
        has_values = count > 0
        mean, median, worst = (np.full(len(has_values), np.nan) for _ in range(3))
        worst_log = np.full(len(has_values), "", dtype=object)
        if has_values.any():
            mean[has_values], median[has_values] = (
                total[has_values] / count[has_values],
                np.nanmedian(chosen_values[:, has_values], axis=0),
            )
        ranked = np.flatnonzero(has_values & np.isfinite(sign))
        if len(ranked):
            worst_rows = np.where(
                finite[:, ranked], chosen_values[:, ranked] * sign[ranked], -np.inf
            ).argmax(axis=0)
            worst[ranked], worst_log[ranked] = chosen_values[worst_rows, ranked], named[worst_rows]
        parts.append(
            columns.assign(
                kind=kind,
                group=group,
                logs=len(members),
                available=count,
                missing=len(members) - count,
                mean=mean,
                median=median,
                worst=worst,
                worst_log=worst_log,
                total=np.where(has_values, total, np.nan),
            )
        )
    table_of_groups = _with_types(
        pd.concat([part.reindex(columns=list(COLUMNS)) for part in parts], ignore_index=True)
    )
    return table_of_groups.sort_values(_KEY, key=_in_order, ignore_index=True)


def _in_order(column: pd.Series) -> pd.Series:
    """Return the sort keys of a column: kinds from the suite to the datasets."""
    order = {kind: i for i, kind in enumerate((SUITE, "family", "tag", "dataset"))}
    return column.map(order) if column.name == "kind" else column


def _with_types(rows: pd.DataFrame) -> pd.DataFrame:
    kinds = dict.fromkeys(COUNTS, "int64") | dict.fromkeys(NUMBERS, "float64")
    words: dict[str, Any] = {
        name: rows[name].fillna("").astype(str) for name in COLUMNS if name not in kinds
    }
    return rows.assign(**words).astype(kinds)


def _rows(table: pd.DataFrame, *columns: str) -> Iterator[tuple[Any, ...]]:
    return zip(*(table[name] for name in columns), strict=True)
