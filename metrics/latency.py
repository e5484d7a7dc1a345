"""Deadline misses: plans that took longer than they may. Wall clock, so not in the table of metrics.

`metrics.parquet` is the same byte for byte for the same input; how long a plan takes is not, and is in
`timings.parquet`. What is counted here is for a table of its own.
"""

from __future__ import annotations

import pandas as pd

_DRIVE = ["log", "planner", "mode"]
COLUMNS = ("log", "planner", "mode", "plans", "misses", "share", "worst_s", "worst_t_s")


def deadline_misses(timings: pd.DataFrame, deadline_s: float) -> pd.DataFrame:
    """How many plans of each drive took longer than a deadline.

    Args:
        timings: Columns log, planner, mode, t_s, stage, seconds; the stage "total" is a whole plan.
        deadline_s: A plan that takes longer has missed it, s; above 0.

    Returns:
        One row per log, planner and mode, in the order of `timings`, columns `COLUMNS`: plans made, misses, their
        share, the longest time of a plan, and when that plan was asked for. Empty where nothing was planned.

    Raises:
        ValueError: The deadline is not above 0.
    """
    if not deadline_s > 0.0:
        raise ValueError(f"a deadline of {deadline_s} s")
    total = timings[timings["stage"] == "total"]
    rows = [(*drive, *_counted(plans, deadline_s)) for drive, plans in total.groupby(_DRIVE, sort=False)]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _counted(plans: pd.DataFrame, deadline_s: float) -> tuple[int, int, float, float, float]:
    seconds = plans["seconds"].to_numpy()
    late, longest = seconds > deadline_s, int(seconds.argmax())
    return len(seconds), int(late.sum()), float(late.mean()), float(seconds[longest]), float(plans["t_s"].iloc[longest])
