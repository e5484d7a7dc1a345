"""How much a metric changed over many logs: the mean of the paired differences, with an interval.

(1) delta = 1/n sum_i delta_i, over the n logs of which both runs have a value
(2) [low, high] = 2.5th and 97.5th percentile of (1) over RESAMPLES draws of n logs with replacement, a log's two values
    drawn together (paired percentile bootstrap: Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 13)
(3) significant = 0 is outside of (2), and n >= MIN_SIGNIFICANT

The draws are seeded, so that equal tables give equal intervals. With fewer logs than MIN_PAIRS there is no interval.
The percentile method, and not BCa: its bounds are always there, where most differences are exactly 0 too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from logs.kernel import BoolArray, FloatArray, IntArray

MIN_PAIRS = 3
"""Of fewer logs, resampling says nothing."""
MIN_SIGNIFICANT = 6
"""Of fewer logs, all may move one way by chance more often than at 5 % (sign test: 2 / 2^5 = 6 %)."""
CONFIDENCE, RESAMPLES, SEED = 0.95, 2000, 20260101
BATCH = 250
"""Draws at a time: bounds memory; part of what makes the draws the same."""

KEYS = ["planner", "mode", "metric"]
GROUP_COLUMNS = (
    "kind", "group", *KEYS, "unit", "direction", "logs", "baseline", "candidate", "delta", "low", "high", "better",
    "worse", "significant",
)  # fmt: skip


def group_deltas(pairs: pd.DataFrame, logs: pd.DataFrame) -> pd.DataFrame:
    """`GROUP_COLUMNS`: rows by group of logs (the suite, parts of it with several logs), planner, mode and metric.

    Args:
        pairs: Rows of `metrics.compare.PAIR_COLUMNS`.
        logs: A row per log: log, family, dataset, tags.
    """
    known = pairs[pairs["delta"].notna()]
    parts = [_group(known, kind, name, members) for kind, name, members in _members(known, logs)]
    numbers = dict.fromkeys(("baseline", "candidate", "delta", "low", "high"), float)
    empty = pd.DataFrame(columns=list(GROUP_COLUMNS)).astype({**numbers, "significant": bool})
    return pd.concat(parts, ignore_index=True) if parts else empty


def _members(pairs: pd.DataFrame, logs: pd.DataFrame) -> Iterator[tuple[str, str, list[str]]]:
    """Kind and name of each group, and its logs."""
    there = logs[logs["log"].isin(set(pairs["log"]))]
    if there.empty:
        return
    yield "suite", "all", list(there["log"])
    for kind in ("family", "tags", "dataset"):
        one = there[["log", kind]].explode(kind).dropna()
        for name, members in one.groupby(kind, sort=True)["log"]:
            if name and 1 < len(members) < len(there):
                yield kind.removesuffix("s"), str(name), list(members)


def _group(known: pd.DataFrame, kind: str, name: str, members: Sequence[str]) -> pd.DataFrame:
    mine = known[known["log"].isin(members)]
    by = mine.assign(better=mine["worse"] < 0.0, worse=mine["worse"] > 0.0).groupby(KEYS, sort=True)
    table = by.agg(
        unit=("unit", "first"), direction=("direction", "first"), logs=("log", "size"), baseline=("baseline", "mean"),
        candidate=("candidate", "mean"), delta=("delta", "mean"), better=("better", "sum"), worse=("worse", "sum"),
    )  # fmt: skip
    deltas = mine.pivot_table(index=KEYS, columns="log", values="delta", sort=True).loc[table.index].to_numpy(float)
    low, high = intervals(deltas)
    clear = significant(low, high, table["logs"].to_numpy())
    table = table.assign(kind=kind, group=name, low=low, high=high, significant=clear).reset_index()
    return table[list(GROUP_COLUMNS)]


def intervals(deltas: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bounds (2), `(m,)` each, of m metrics over n logs `(m, n)`; NaN deltas are logs without the value."""
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
    """Whether changes with these intervals, of so many logs, are more than chance (3)."""
    return np.asarray(((low > 0.0) | (high < 0.0)) & (logs >= MIN_SIGNIFICANT))
