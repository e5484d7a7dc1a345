"""Late plans, judged like the gates of metrics.

They depend on wall-clock time, so they are not in the table of metrics.
"""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.gates import Gate, Gates
from replan.metrics.judge.verdicts import DRIVE, Verdict, judge

LATE = "deadline.share"
MAX_LATE = 0.01  # The share of a drive's plans that may be late
MISS_COLUMNS = ("log", "planner", "mode", "plans", "misses", "share", "worst_s", "worst_t_s")


def deadline_misses(timings: pd.DataFrame, deadline_s: float) -> pd.DataFrame:
    """Count the plans of each drive that took longer than a deadline.

    `timings`: columns log, planner, mode, t_s, stage, seconds; the stage "total" is a whole plan.
    `deadline_s`: a plan that takes longer has missed it, s; ValueError unless above 0.

    Returns:
        `MISS_COLUMNS` of each log, planner and mode in the order of `timings`: plans made, misses,
        their share, the longest time of a plan, and the time of its frame.
    """
    if not deadline_s > 0.0:
        raise ValueError(f"a deadline of {deadline_s} s")
    rows = []
    for drive, plans in timings[timings["stage"] == "total"].groupby(
        DRIVE, sort=False, observed=True
    ):
        late, worst = plans["seconds"] > deadline_s, plans.iloc[int(plans["seconds"].argmax())]
        rows.append(
            (
                *drive,
                len(plans),
                int(late.sum()),
                float(late.mean()),
                worst["seconds"],
                worst["t_s"],
            )
        )
    return pd.DataFrame(rows, columns=list(MISS_COLUMNS))


def judge_deadline(
    timings: pd.DataFrame, deadline_s: float, labels: Mapping[str, LogLabels]
) -> tuple[Verdict, ...]:
    """The verdicts on the share of late plans, at most `MAX_LATE` in each drive.

    Arguments as of `deadline_misses`.
    """
    late = deadline_misses(timings, deadline_s)
    why = [
        (
            f"{row.misses} of {row.plans} plans took longer than {deadline_s:g} s, one "
            f"{row.worst_s:.3g} s"
        )
        for row in late.itertuples()
    ]
    table = late[DRIVE].assign(
        oracle=False,
        metric=LATE,
        value=late["share"],
        unit="1",
        available=True,
        reason=why,
        time_s=late["worst_t_s"],
    )
    gate = Gate(
        LATE, max=MAX_LATE, reason=f"plans are made within {deadline_s:g} s on this machine"
    )
    return judge(Gates((gate,), "deadline"), table, labels)
