"""Rows of a table of metrics as gates judge them, made by hand."""

import numpy as np
import pandas as pd

from replan.metrics import COLUMNS


def row(log: str, value: float, **changes: object) -> dict[str, object]:
    """A row of `dp_qp` in closed loop about car 7 at 3.2 s; without a value where that is NaN."""
    known = not np.isnan(value)
    return {
        "log": log,
        "planner": "dp_qp",
        "mode": "closed",
        "oracle": False,
        "metric": "gap.min",
        "value": value,
        "unit": "m",
        "direction": "higher",
        "available": known,
        "reason": "car 7" if known else "no agent there",
        "time_s": 3.2 if known else np.nan,
        "version": 1,
        "source": "",
    } | changes


def table(*rows: dict[str, object]) -> pd.DataFrame:
    return pd.DataFrame(list(rows), columns=list(COLUMNS))
