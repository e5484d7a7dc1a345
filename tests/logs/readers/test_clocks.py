"""Times of rows: dates and times of day, clocks that start again, and rows that are merely
unsorted.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from replan.core.errors import LogError
from replan.logs.readers import read_log
from replan.logs.readers.table import from_frames

T = np.arange(120) / 10
START = pd.Timestamp("2024-05-03T23:59:55")


def ego(**more: Any) -> pd.DataFrame:
    return pd.DataFrame({"t": T, "x": 10.0 * T, "y": 0.0, "yaw": 0.0, "v": 10.0, **more})


def agents(**more: Any) -> pd.DataFrame:
    rows = [
        pd.DataFrame({"t": T, "id": name, "x": 30.0 + 9.0 * T, "y": y, **more})
        for name, y in (("7", 0.0), ("8", 4.0))
    ]
    return pd.concat(rows, ignore_index=True)


TEXTS = {
    "iso": [moment.isoformat() for moment in START + pd.to_timedelta(T, unit="s")],
    "zone": [
        f"{moment.isoformat(sep=' ')}+02:00" for moment in START + pd.to_timedelta(T, unit="s")
    ],
    "slashes": [
        f"{moment:%Y/%m/%d %H:%M:%S.%f}" for moment in START + pd.to_timedelta(T, unit="s")
    ],
    "of day": [f"{moment:%H:%M:%S.%f}"[:-3] for moment in START + pd.to_timedelta(T, unit="s")],
    "seconds of the day": (86395.0 + T) % 86400.0,
    "seconds of the week": (604795.0 + T) % 604800.0,
}


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("order", ["time", "shuffled"])
def test_dates_and_times_of_day_run_on_over_midnight(tmp_path: Path, kind: str, order: str) -> None:
    mine, theirs = ego(t=TEXTS[kind]), agents(t=TEXTS[kind])
    if order == "shuffled":
        mine, theirs = (
            mine.sample(frac=1.0, random_state=1),
            theirs.sample(frac=1.0, random_state=2),
        )
    mine.to_csv(tmp_path / "ego.csv", index=False)
    theirs.to_csv(tmp_path / "agents.csv", index=False)
    scenario = read_log(tmp_path)
    np.testing.assert_allclose(scenario.ego.t, T, atol=1e-9)
    np.testing.assert_allclose(scenario.ego.x, 10.0 * T, atol=1e-9)
    np.testing.assert_allclose(scenario.tracks.t, np.tile(T, 2), atol=1e-9)
    assert any("starts again" in note for note in scenario.notes) is (
        kind not in ("iso", "zone", "slashes")
    )
    assert kind != "iso" or scenario.start_ns == START.value
    assert kind != "zone" or scenario.start_ns == START.value - 7200 * 10**9


def test_times_that_only_others_have_after_midnight_run_on_too() -> None:
    scenario = from_frames(ego(t=86387.0 + T), agents(t=(86389.0 + T) % 86400.0))
    assert scenario.tracks.t.max() == pytest.approx(2.0 + T[-1], abs=1e-6)


def test_rows_in_order_are_never_moved_to_another_day() -> None:
    with pytest.raises(LogError, match="no state for"):
        from replan.logs.log_checks import passed
        from replan.logs.readers.admission import CHECKS

        passed(from_frames(ego(t=np.where(T < 6.0, T, 86380.0 + T))), CHECKS)


@pytest.mark.parametrize("word", ["03.05.2024 10:00:00", "10:00:00 PM", "noon"])
def test_other_texts_are_refused(word: str) -> None:
    with pytest.raises(LogError) as error:
        from_frames(ego(t=[word] * len(T)))
    assert "t is neither a number nor a date" in str(error.value) and word in str(error.value)


RESTARTS = {
    "in the middle": ego(t=np.where(T < 6.0, T, T - 6.0 + 0.03)),
    "a step": ego(t=np.where(T < 6.0, T, T - 0.25)),
    "to before the start": ego(t=np.where(T < 6.0, T + 6.0, T - 6.0)),
    "while it stands": ego(x=0.0, v=0.0, t=np.where(T < 6.0, T, T - 6.0 + 0.03)),
    "while it stands, with noise": ego(
        x=np.random.default_rng(1).normal(0.0, 0.01, 120), t=np.where(T < 6.0, T, T - 5.97)
    ),
    "two drives": pd.concat([ego(), ego(t=T + 0.04, y=40.0)], ignore_index=True),
    "the same lap again": pd.concat([ego(), ego(t=T + 0.04)], ignore_index=True),
    "three drives": pd.concat(
        [ego(t=T + 0.01 * k, x=10.0 * T + 120.0 * k) for k in range(3)], ignore_index=True
    ),
}


@pytest.mark.parametrize("kind", RESTARTS)
def test_a_clock_that_restarts_is_refused_with_row_and_times(kind: str) -> None:
    table = RESTARTS[kind]
    row = int(np.flatnonzero(np.diff(table.t) < 0.0)[0]) + 1
    with pytest.raises(LogError) as error:
        from_frames(table)
    assert f"t goes back at row {row} ({table.t[row - 1]:g} to {table.t[row]:g} s)" in str(
        error.value
    )
    assert error.value.topic == "ego" and "split" in (error.value.remedy or "")


def test_a_clock_of_the_others_that_restarts_is_refused() -> None:
    with pytest.raises(
        LogError, match=r"t goes back at row 60 of agent 7 \(5\.9 to 0 s\)"
    ) as error:
        from_frames(ego(), agents(t=np.where(T < 6.0, T, T - 6.0)))
    assert error.value.topic == "agents"


ORDERS = {
    "reversed": lambda table: table[::-1],
    "another column": lambda table: (
        table.assign(gear=(table.t // 2.0) % 2).sort_values(["gear", "t"]).drop(columns="gear")
    ),
    "parts in the wrong order": lambda table: pd.concat(
        [table[table.t >= 6.0], table[table.t < 6.0]]
    ),
    "one row late": lambda table: pd.concat([table[:50], table[51:52], table[50:51], table[52:]]),
    "by time": lambda table: table.sort_values("t", kind="stable"),
}


@pytest.mark.parametrize("kind", ORDERS)
def test_rows_that_are_merely_unsorted_are_sorted(kind: str) -> None:
    plain, other = (
        from_frames(ego(), agents()),
        from_frames(ORDERS[kind](ego()), ORDERS[kind](agents())),
    )
    assert (
        other.ego.x.tolist() == plain.ego.x.tolist()
        and other.tracks.x.tolist() == plain.tracks.x.tolist()
    )


@given(st.permutations(range(120)), st.floats(0.0, 0.05), st.integers(0, 9))
@settings(max_examples=30, deadline=None)
def test_any_order_of_rows_gives_the_same_drive(order: list[int], noise: float, seed: int) -> None:
    table = ego(y=np.random.default_rng(seed).normal(0.0, noise, 120))
    assert from_frames(table.iloc[order]).ego.y.tolist() == from_frames(table).ego.y.tolist()
