from __future__ import annotations

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metrics.judge.rows import MISS_COLUMNS, deadline_misses


def timings(seconds: list[float], log: str = "a", planner: str = "p") -> pd.DataFrame:
    rows = [(log, planner, "open", 0.1 * i, stage, s * part)
            for i, s in enumerate(seconds) for stage, part in (("path", 0.7), ("total", 1.0))]  # fmt: skip
    return pd.DataFrame(rows, columns=["log", "planner", "mode", "t_s", "stage", "seconds"])


def test_misses_by_hand() -> None:
    """0.1 s is met by 0.1 s; the stages of a plan count once, as its total."""
    table = deadline_misses(pd.concat([timings([0.02, 0.1, 0.3, 0.11]), timings([0.2], planner="q")]), 0.1)
    assert tuple(table.columns) == MISS_COLUMNS
    assert table.iloc[0].tolist() == ["a", "p", "open", 4, 2, 0.5, 0.3, pytest.approx(0.2)]
    assert table.iloc[1].tolist() == ["a", "q", "open", 1, 1, 1.0, 0.2, 0.0]
    assert deadline_misses(timings([]), 0.1).empty
    with pytest.raises(ValueError, match="deadline"):
        deadline_misses(timings([0.1]), 0.0)


@given(st.lists(st.floats(0.001, 1.0), min_size=1, max_size=20), st.floats(0.001, 1.0), st.floats(0.0, 1.0))
def test_a_longer_deadline_is_missed_less(seconds: list[float], deadline: float, more: float) -> None:
    table = timings(seconds)
    assert (deadline_misses(table, deadline + more)["misses"] <= deadline_misses(table, deadline)["misses"]).all()
