"""The vocabulary of metrics, their table and pages, and all metrics of drives that hardly are
any.
"""

import gc
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import replan
from drives import along, drive, grid, moving, plans, scenario, straight_road
from hypothesis import given, strategies as st

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError
from replan.core.once import last, once
from replan.logs.agents import AgentKind
from replan.logs.road import Goal, RoadSource
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Mode, Trace
from replan.metrics import COLUMNS, METRICS, evaluate, evaluate_with_series, load_metric, series
from replan.metrics.metric import Measured, Metric, Series, Unavailable, rate_of_change
from replan.metrics.reductions import (
    COUNT,
    FINAL,
    MAX,
    MAX_ABS,
    MEAN,
    MIN,
    P95,
    P99,
    RATE,
    RMS,
    time_above,
    time_below,
    time_outside,
)

values = st.lists(st.floats(-9.0, 9.0), min_size=1, max_size=30)


def steps(value: list[float], step: float = 0.1) -> Series:
    return Series(step * np.arange(len(value)), np.array(value, float))


MINE = Metric(
    "mine",
    "m",
    "none",
    (Mode.CLOSED,),
    lambda trace, scenario: steps([1.0, 2.0]),
    (MEAN,),
    "For a test.",
)


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
        assert reduction.reduce(with_holes)[0] == pytest.approx(
            reduction.reduce(Series(t, full))[0], abs=1e-12
        )


@given(values, st.integers(0, 29))
def test_times_add_up_where_a_drive_is_cut(value: list[float], cut: int) -> None:
    cut = min(cut, len(value) - 1)
    s = steps(value)
    first, second = Series(s.t[: cut + 1], s.value[: cut + 1]), Series(s.t[cut:], s.value[cut:])
    for reduction in (time_below(1.0, "a"), time_above(4.0, "b"), time_outside(-1.0, 3.0, "c")):
        whole = reduction.reduce(s)[0]
        assert whole == pytest.approx(
            reduction.reduce(first)[0] + reduction.reduce(second)[0], abs=1e-12
        )


@given(st.floats(-9.0, 9.0), st.floats(0.03, 0.3))
def test_a_ramp_keeps_its_slope(slope: float, step: float) -> None:
    t = step * np.arange(40)
    rate = rate_of_change(t, 1.0 + slope * t, 0.1)
    assert np.isnan(rate[t < 0.1 - 1e-9]).all()
    assert np.allclose(rate[t >= 0.1], slope, atol=1e-9)


@given(st.integers(1, 60))
def test_the_differentiator_is_causal(cut: int) -> None:
    t = 0.01 * np.arange(100)
    value = np.sin(7.0 * t)
    whole, part = rate_of_change(t, value, 0.1), rate_of_change(t[: cut + 1], value[: cut + 1], 0.1)
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


# the table ----------------------------------------------------------------------------------------


def test_the_table_has_the_columns_and_one_row_per_reduction() -> None:
    log = scenario(along(grid(3.0), 10.0))
    for mode in Mode:
        table = evaluate(drive(log, mode=mode), log)
        assert tuple(table.columns) == COLUMNS
        assert table["metric"].is_unique
        assert set(table["metric"].str.split(".").str[0]) == {
            m.name for m in METRICS.values() if mode in m.modes
        }
        assert set(table["direction"]) <= {"lower", "higher", "none"}
        assert not table["value"].isin([np.inf, -np.inf]).any()
        assert (table["value"].isna() == ~table["available"]).all()
        assert (table.loc[~table["available"], "reason"] != "").all()
        assert (
            (table["log"] == "test/log") & (table["mode"] == mode.value) & ~table["oracle"]
        ).all()


def test_series_are_the_steps_behind_the_table() -> None:
    log = scenario(along(grid(3.0), 10.0))
    table, frames = evaluate(drive(log), log), series(drive(log), log)
    assert tuple(frames.columns) == ("t_s", "metric", "value")
    speed = frames[frames["metric"] == "speed"]
    assert speed["t_s"].to_numpy() == pytest.approx(log.ego.t)
    assert speed["value"].mean() == table.set_index("metric").loc["speed.mean", "value"]


def test_a_metric_of_a_user_has_rows_and_reasons() -> None:
    def nothing(trace: Trace, scenario: Scenario) -> Measured:
        return Unavailable("not today")

    other = Metric("other", "1", "lower", (Mode.CLOSED,), nothing, (MAX,), "For a test.")
    log = scenario(along(grid(1.0), 10.0))
    table = evaluate(drive(log), log, metrics={"mine": MINE, "other": other}).set_index("metric")
    assert table.loc["mine.mean", "value"] == 1.5
    assert table.loc["other.max", "reason"] == "not today"
    assert load_metric("metrics_of_mine:mine").name == "mine"
    assert load_metric("gap") is METRICS["gap"]


@pytest.mark.parametrize("spec", ["gpa", "nowhere:METRIC", "metrics:NOTHING", "metrics:evaluate"])
def test_metrics_that_cannot_be_loaded(spec: str) -> None:
    with pytest.raises(ConfigError, match=spec):
        load_metric(spec)


class Drive:
    """Something that can be held weakly."""


def test_the_same_question_is_answered_once_and_another_anew() -> None:
    asked: list[tuple[object, ...]] = []

    @once
    def found(drive: Drive, bound: float, *, kept: bool = False) -> object:
        asked.append((drive, bound, kept))
        return object()

    one, two = Drive(), Drive()
    assert found(one, 1.0) is found(one, 1.0)
    assert found(one, 2.0) is not found(one, 1.0) and found(one, 1.0, kept=True) is not found(
        one, 1.0
    )
    assert found(two, 1.0) is not found(one, 1.0)
    assert len(asked) == 4


def test_only_the_newest_large_results_are_kept() -> None:
    asked: list[int] = []

    @last(2)
    def found(drive: Drive, number: int) -> int:
        asked.append(number)
        return number

    drive = Drive()
    for number in (1, 2, 1, 3, 2, 1):
        assert found(drive, number) == number
    assert asked == [1, 2, 3, 1], "3 put 1 out, and nothing else was asked for anew but 1"


def test_a_deleted_drive_frees_its_cached_results() -> None:
    @once
    def found(drive: Drive) -> list[int]:
        return held

    held = [1]
    drive = Drive()
    gone = weakref.ref(drive)
    assert found(drive) is held
    before = len(gc.get_referrers(held))
    del drive
    gc.collect()
    assert gone() is None and len(gc.get_referrers(held)) == before - 1


PAGE = Path(__file__).parents[2] / "docs" / "metrics.md"


def said(*words: str) -> str:
    result = replan("metrics", *words)
    assert result.exit_code == 0, result.output
    return result.output


def test_the_page_equals_the_output_of_the_command() -> None:
    assert PAGE.read_text() == said("--markdown"), "replan metrics --markdown > docs/metrics.md"


@pytest.mark.parametrize("metric", METRICS.values(), ids=METRICS.keys())
def test_a_metrics_page_says_all_about_it(metric: Metric) -> None:
    text = said(metric.name)
    assert metric.formula and metric.meaning.endswith(".") and metric.unit
    for detail in (
        metric.formula,
        metric.meaning,
        metric.unit,
        metric.source,
        *metric.parameters,
        metric.needs,
    ):
        assert detail in text
    for reduction in metric.reductions:
        assert reduction.name in text
    assert not any(mark in metric.formula for mark in "`\n")


def test_metrics_without_needs_are_always_available() -> None:
    log = scenario(along(np.zeros(1), 10.0), duration=5.0)
    free = {metric.name: metric for metric in METRICS.values() if not metric.needs}
    assert {"collision", "completed", "distance"} <= free.keys()
    for mode in Mode:
        assert evaluate(drive(log, mode=mode), log, metrics=free)["available"].all()


T = grid(4.0, 0.1)
LOG = scenario(along(T, 10.0), duration=9.0)


def _priority() -> Scenario:
    lanes = straight_road(lanes=2, limit=13.0).lanes
    road = replace(straight_road(), lanes={**lanes, 0: replace(lanes[0], yields_to=(1,))})
    region: FloatArray = np.array([[30.0, -2.0], [40.0, -2.0], [40.0, 2.0], [30.0, 2.0]])
    return replace(LOG, road=road, goal=Goal((region,)))


LOGS = {
    "plain": LOG,
    "right of way": _priority(),
    "no lanes": replace(LOG, road=replace(straight_road(), source=RoadSource.DRIVEN_PATH)),
    "one logged state": replace(LOG, ego=along(T[:1], 10.0)),
    "stands": replace(LOG, ego=along(T, 0.0)),
}
STATES_AND_FRAMES = ((1, 0), (1, 1), (2, 1), (2, 2), (len(T), 0))
"""The third is a planner that fails at its second frame."""


def _drive(log: Scenario, mode: Mode, states: int, frames: int) -> Trace:
    ego = along(T[:states], 10.0)
    return drive(log, ego, mode=mode, frames=plans(along(T, 10.0), T[:frames], 2.0))


@pytest.mark.parametrize("mode", [Mode.OPEN, Mode.CLOSED])
@pytest.mark.parametrize("log", LOGS.values(), ids=LOGS.keys())
def test_all_metrics_of_the_shortest_drives_have_a_value_or_a_reason(
    log: Scenario, mode: Mode
) -> None:
    metrics = [metric for metric in METRICS.values() if mode in metric.modes]
    for states, frames in STATES_AND_FRAMES:
        table, _ = evaluate_with_series(_drive(log, mode, states, frames), log)
        for metric in metrics:
            assert table["metric"].str.startswith(f"{metric.name}.").sum() >= len(metric.reductions)
        assert (table["available"] == np.isfinite(table["value"])).all()
        assert (table.loc[~table["available"], "reason"] != "").all()


def test_the_instant_of_contact_counts() -> None:
    """Row 20: at 30 m/s and 0.01 s only the last step, with which the drive ends, is nearer than
    0.2 m.
    """
    ego = along(grid(1.0), 30.0)
    rear = float(ego.x[-1]) + LOG.vehicle.axle_to_front
    stands = ("7", AgentKind.CAR, (4.0, 1.8), moving(rear + 2.0 - 0.01, 0.0, 0.0, 0.0, 0.0))
    log = scenario(ego, [stands])
    table = evaluate(
        drive(log, end=EndReason.COLLISION), log, metrics={"gap": METRICS["gap"]}
    ).set_index("metric")
    assert table.loc["gap.min", "value"] == 0.0
    assert table.loc["gap.time_below_20cm", "value"] == pytest.approx(0.005)
