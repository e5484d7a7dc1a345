from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, moving, scenario
from hypothesis import given
from hypothesis import strategies as st

from logs import AgentKind, ConfigError, Mode, Scenario, Trace
from metrics import COLUMNS, METRICS, Metric, Series, Unavailable, evaluate, load_metric, series
from metrics.metric import (
    COUNT,
    FINAL,
    HAVING,
    MAX,
    MAX_ABS,
    MEAN,
    MIN,
    P95,
    P99,
    RATE,
    RMS,
    Measured,
    changed,
    time_above,
    time_below,
    time_outside,
)

values = st.lists(st.floats(-9.0, 9.0), min_size=1, max_size=30)


def steps(value: list[float], step: float = 0.1) -> Series:
    return Series(step * np.arange(len(value)), np.array(value, float))


MINE = Metric("mine", "m", "none", (Mode.CLOSED,), lambda trace, scenario: steps([1.0, 2.0]), (MEAN,), "For a test.")


@given(values)
def test_reductions_are_those_of_numpy_and_name_their_step(value: list[float]) -> None:
    s = steps(value)
    assert MEAN.reduce(s) == (np.mean(value), -1)
    assert RMS.reduce(s)[0] == pytest.approx(np.sqrt(np.mean(np.square(value))))
    for reduction, size in ((MIN, -s.value), (MAX, s.value), (MAX_ABS, np.abs(s.value))):
        found, step = reduction.reduce(s)
        assert size[step] == size.max()
        assert step == int(np.argmax(size))
        assert found == (abs(value[step]) if reduction is MAX_ABS else value[step])
    assert P95.reduce(s)[0] <= P99.reduce(s)[0] <= max(np.abs(value))
    assert FINAL.reduce(s) == (value[-1], len(value) - 1)


@given(values, st.data())
def test_steps_without_a_value_do_not_count(value: list[float], data: st.DataObject) -> None:
    holes = data.draw(st.lists(st.integers(0, len(value)), max_size=9))
    t, full = np.arange(len(value)) * 1.0, np.array(value)
    with_holes = Series(np.insert(t, holes, 0.0), np.insert(full, holes, np.nan))
    for reduction in (MEAN, RMS, MIN, MAX, MAX_ABS, P95, P99, FINAL, COUNT, RATE):
        assert reduction.reduce(with_holes)[0] == pytest.approx(reduction.reduce(Series(t, full))[0], abs=1e-12)


@given(values, st.integers(0, 29))
def test_times_add_up_where_a_drive_is_cut(value: list[float], cut: int) -> None:
    cut = min(cut, len(value) - 1)
    s = steps(value)
    first, second = Series(s.t[: cut + 1], s.value[: cut + 1]), Series(s.t[cut:], s.value[cut:])
    for reduction in (time_below(1.0, "a"), time_above(4.0, "b"), time_outside(-1.0, 3.0, "c")):
        whole = reduction.reduce(s)[0]
        assert whole == pytest.approx(reduction.reduce(first)[0] + reduction.reduce(second)[0], abs=1e-12)


def test_reductions_by_hand() -> None:
    s = steps([0.0, 2.0, np.nan, 3.0, 0.5])
    assert time_above(1.0, "x").reduce(s) == (pytest.approx(0.2), 1)
    assert time_below(1.0, "x").reduce(s) == (pytest.approx(0.05 + 0.05), 0)  # the first and the last step
    assert COUNT.reduce(s) == (5.5, 1)
    assert HAVING.reduce(s) == (0.8, 0)
    assert RATE.reduce(steps([0, 0, 1, 1])) == (0.5, 2)
    assert RATE.reduce(steps([0, 0])) == (0.0, -1)


@given(st.floats(-9.0, 9.0), st.floats(0.03, 0.3))
def test_a_ramp_keeps_its_slope(slope: float, step: float) -> None:
    t = step * np.arange(40)
    rate = changed(t, 1.0 + slope * t, 0.1)
    assert np.isnan(rate[t < 0.1 - 1e-9]).all()
    assert np.allclose(rate[t >= 0.1], slope, atol=1e-9)


@given(st.integers(1, 60))
def test_the_differentiator_is_causal(cut: int) -> None:
    t = 0.01 * np.arange(100)
    value = np.sin(7.0 * t)
    whole, part = changed(t, value, 0.1), changed(t[: cut + 1], value[: cut + 1], 0.1)
    assert whole[: cut + 1].tobytes() == part.tobytes()


def test_bad_series_are_refused() -> None:
    with pytest.raises(ValueError, match="infinite"):
        steps([1.0, np.inf])
    with pytest.raises(ValueError, match="shape"):
        Series(np.zeros(2), np.zeros(3))
    with pytest.raises(ValueError, match="shape"):
        steps([])
    with pytest.raises(ValueError, match="labels"):
        Series(np.zeros(1), np.zeros(1), ("a", "b"))


# the table --------------------------------------------------------------------------------------------------------


def test_the_table_has_the_columns_and_one_row_per_reduction() -> None:
    log = scenario(along(grid(3.0), 10.0))
    for mode in Mode:
        table = evaluate(drive(log, mode=mode), log)
        assert tuple(table.columns) == COLUMNS
        assert table["metric"].is_unique
        assert set(table["metric"].str.split(".").str[0]) == {m.name for m in METRICS.values() if mode in m.modes}
        assert set(table["direction"]) <= {"lower", "higher", "none"}
        assert not table["value"].isin([np.inf, -np.inf]).any()
        assert (table["value"].isna() == ~table["available"]).all()
        assert (table.loc[~table["available"], "reason"] != "").all()
        assert ((table["log"] == "test/log") & (table["mode"] == mode.value) & ~table["oracle"]).all()


def test_the_same_drive_gives_the_same_bits() -> None:
    log = scenario(along(grid(3.0), 10.0))
    one, two = (evaluate(drive(log), log) for _ in range(2))
    assert one.equals(two)
    assert one["value"].to_numpy().tobytes() == two["value"].to_numpy().tobytes()


def test_series_are_the_steps_behind_the_table() -> None:
    log = scenario(along(grid(3.0), 10.0))
    table, frames = evaluate(drive(log), log), series(drive(log), log)
    assert tuple(frames.columns) == ("t_s", "metric", "value")
    speed = frames[frames["metric"] == "speed"]
    assert speed["t_s"].to_numpy() == pytest.approx(log.ego.t)
    assert speed["value"].mean() == table.set_index("metric").loc["speed.mean", "value"]


def test_every_metric_can_be_read_about() -> None:
    for metric in METRICS.values():
        assert metric.meaning.endswith(".")
        assert metric.unit
        assert metric.modes
        assert len({reduction.name for reduction in metric.reductions}) == len(metric.reductions) > 0


def test_a_drive_of_one_sample_is_evaluated() -> None:
    log = scenario(along(np.zeros(1), 10.0), duration=5.0)
    for mode in Mode:
        table = evaluate(drive(log, mode=mode), log)
        assert len(table) > 20


def test_parts_keep_their_names_where_nothing_is_available() -> None:
    log = scenario(along(np.zeros(1), 10.0), duration=5.0)
    table = evaluate(drive(log, mode=Mode.OPEN), log).set_index("metric")
    assert "one ego state only" in table.loc["ade.3s.mean", "reason"]


def test_a_metric_of_ones_own() -> None:
    def nothing(trace: Trace, scenario: Scenario) -> Measured:
        return Unavailable("not today")

    other = Metric("other", "1", "lower", (Mode.CLOSED,), nothing, (MAX,), "For a test.")
    log = scenario(along(grid(1.0), 10.0))
    table = evaluate(drive(log), log, metrics={"mine": MINE, "other": other}).set_index("metric")
    assert table.loc["mine.mean", "value"] == 1.5
    assert table.loc["other.max", "reason"] == "not today"
    assert load_metric("metrics_of_mine:MINE").name == "mine"
    assert load_metric("gap") is METRICS["gap"]


@pytest.mark.parametrize("spec", ["gpa", "nowhere:METRIC", "metrics:NOTHING", "metrics:evaluate"])
def test_metrics_that_cannot_be_loaded(spec: str) -> None:
    with pytest.raises(ConfigError, match=spec):
        load_metric(spec)


def test_reasons_have_short_names_and_about_has_the_whole_id() -> None:
    """A log whose road users have UUIDs is measured as one whose road users have numbers."""
    whole = {"17": "23f7a1c8-0d5e-4b8e-9a53-6a3ef1f0c2b4", "18": "23f85a90-4d0e-4dbb-8f0c-1b6c5f4d7a11"}
    cars = [(name, AgentKind.CAR, (4.5, 1.8), moving(12.0, y, 6.0, 0.0)) for name, y in (("17", 0.0), ("18", 4.0))]
    log = scenario(along(grid(3.0), 10.0), cars)
    coded = replace(log, tracks=replace(log.tracks, ids=tuple(whole.values())))
    plain, found = (evaluate(drive(one), one) for one in (log, coded))
    same = [name for name in COLUMNS if name not in ("reason", "about")]
    pd.testing.assert_frame_equal(found[same], plain[same])
    assert found["about"].tolist() == [re.sub(r"\b1[78]\b", lambda hit: whole[hit[0]], each) for each in plain["about"]]
    assert {"car 23f7", "car 23f8"} & set(found["reason"]) and not found["reason"].str.contains("-4b8e-|-4dbb-").any()
