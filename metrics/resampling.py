"""Differences of two runs that are more than noise: rounding, and intervals over logs.

With the differences delta_i of a metric over a group of n logs with a value in both runs:

(1) noise: |delta_i| <= NOISE_ABS + NOISE_REL max(|baseline_i|, |candidate_i|)
(2) [low, high] = 2.5th and 97.5th percentile of their mean over RESAMPLES draws of n logs
        with replacement; the two values of a log are drawn together (paired percentile bootstrap:
        Efron and Tibshirani, An Introduction to the Bootstrap, 1993, ch. 13)
(3) significant = 0 is outside of (2), and n >= MIN_SIGNIFICANT
(4) windows of a recording depend on each other: with windows, (2) and (3) are over the m recordings
    instead of n logs, with m/n sum_i delta_i of the windows of each, whose mean is that of all

The draws are seeded, so equal tables give equal intervals. Unlike BCa, the percentile method has
finite bounds where most differences are exactly 0.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from replan.core.arrays import BoolArray, FloatArray, IntArray

# Rounding: sums in another order, the last iterations of a solver
NOISE_ABS, NOISE_REL = 1e-9, 1e-6
MIN_PAIRS = 3  # Fewer logs cannot be resampled meaningfully
# Fewer logs all change in one direction by chance in more than 5 % (sign test: 2 / 2^5 = 6 %)
MIN_SIGNIFICANT = 6
CONFIDENCE, RESAMPLES, SEED = 0.95, 2000, 20260101
BATCH = 250  # Draws at a time: limits memory; the draws depend on it


def noise(before: np.ndarray, now: np.ndarray) -> BoolArray:
    """Return whether two values `(n,)` differ only by rounding (1); False where one is NaN."""
    with np.errstate(invalid="ignore"):
        bound = NOISE_ABS + NOISE_REL * np.maximum(np.abs(before), np.abs(now))
        return np.asarray(np.abs(now - before) <= bound)


def recording_of(log: str) -> str:
    """Return the log that a window was cut of ("drive@12" begins at 12 s of "drive").

    Else the log itself.
    """
    name, _, begin = log.rpartition("@")
    return name if name and begin.replace(".", "", 1).isdecimal() else log


def by_recording(deltas: pd.DataFrame) -> pd.DataFrame:
    """Return a column per recording for the columns of logs, with the same mean of each row: (4).

    The windows of a recording depend on each other, so that recordings are resampled.
    """
    summed = deltas.T.groupby(recording_of, sort=True).sum(min_count=1).T
    return summed.mul(summed.notna().sum(axis=1) / deltas.notna().sum(axis=1), axis=0)


def intervals(deltas: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the bounds (2), `(m,)` each, of m metrics over n logs `(m, n)`.

    A delta is NaN if the log has no value.
    """
    from scipy.stats import bootstrap  # imported here: it takes longer to load than all metrics

    known = np.isfinite(deltas)
    low = np.where(known.sum(axis=1) < MIN_PAIRS, np.nan, 0.0)
    high = low.copy()
    moved = np.isfinite(low) & (np.nan_to_num(deltas) != 0.0).any(axis=1)
    for pattern in np.unique(known[moved], axis=0):
        rows = moved & (known == pattern).all(axis=1)
        interval = bootstrap(
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
        low[rows], high[rows] = interval.low, interval.high
    return low, high


def significant(low: FloatArray, high: FloatArray, logs: IntArray) -> BoolArray:
    """Return whether changes with these intervals and numbers of logs are significant (3)."""
    return np.asarray(((low > 0.0) | (high < 0.0)) & (logs >= MIN_SIGNIFICANT))
