"""Deadline misses: plans that took longer than they may. Wall clock, so not in the table of metrics."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from metrics.judge.aggregate import LogLabels
from metrics.judge.gates import Gate, Gates
from metrics.judge.verdicts import Verdict, judge

SHARE = "deadline.share"
MAX_SHARE = 0.01  # So many of a drive's plans may be late
_DRIVE = ["log", "planner", "mode"]
COLUMNS = ("log", "planner", "mode", "plans", "misses", "share", "worst_s", "worst_t_s")


def deadline_misses(timings: pd.DataFrame, deadline_s: float) -> pd.DataFrame:
    """How many plans of each drive took longer than a deadline.

    Args:
        timings: Columns log, planner, mode, t_s, stage, seconds; the stage "total" is a whole plan.
        deadline_s: A plan that takes longer has missed it, s; ValueError unless above 0.

    Returns:
        `COLUMNS` of each log, planner and mode in the order of `timings`: plans made, misses, their share, the longest
        time of a plan, and when that plan was asked for.
    """
    if not deadline_s > 0.0:
        raise ValueError(f"a deadline of {deadline_s} s")
    rows = []
    for drive, plans in timings[timings["stage"] == "total"].groupby(_DRIVE, sort=False, observed=True):
        late, worst = plans["seconds"] > deadline_s, plans.iloc[int(plans["seconds"].argmax())]
        rows.append((*drive, len(plans), int(late.sum()), float(late.mean()), worst["seconds"], worst["t_s"]))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def judge_deadline(timings: pd.DataFrame, deadline_s: float, labels: Mapping[str, LogLabels]) -> tuple[Verdict, ...]:
    """The verdicts on the share of late plans, at most `MAX_SHARE` in each drive; arguments as of `deadline_misses`."""
    late = deadline_misses(timings, deadline_s)
    why = [
        f"{row.misses} of {row.plans} plans took longer than {deadline_s:g} s, one {row.worst_s:.3g} s"
        for row in late.itertuples()
    ]
    table = late[_DRIVE].assign(
        oracle=False, metric=SHARE, value=late["share"], unit="1", available=True, reason=why, time_s=late["worst_t_s"]
    )
    gate = Gate(SHARE, max=MAX_SHARE, reason=f"plans are made within {deadline_s:g} s on this machine")
    return judge(Gates((gate,), "deadline"), table, labels)
