"""Many logs as one: Wilson's interval against scipy, groups against what pandas says, lost logs
count against.
"""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st
from scipy.stats import binomtest

from replan.metrics.judge.aggregate import (
    COLUMNS,
    LogLabels,
    groups,
    membership,
    pass_shares,
    standings,
    wilson,
)

ASKED = [("dp_qp", "open"), ("dp_qp", "closed")]
LABELS = {
    "a": LogLabels("cut_in", "one", ("car", "wet")),
    "b": LogLabels("cut_in", "two", ("car",)),
    "c": LogLabels("", "one", ()),
}


@given(st.integers(1, 400), st.data())
def test_the_interval_is_that_of_scipy(n: int, data: st.DataObject) -> None:
    passed = data.draw(st.integers(0, n))
    expected = binomtest(passed, n).proportion_ci(0.95, method="wilson")
    low, high = wilson(passed, n)
    assert (low, high) == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert 0.0 <= low <= passed / n <= high <= 1.0


def test_the_interval_of_no_logs_is_0_to_1() -> None:
    assert wilson(0, 0) == (0.0, 1.0)


def drives(*rows: tuple[str, str, str], oracle: bool = False) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=["log", "planner", "mode"]).assign(oracle=oracle)


def said(*rows: tuple[str, str, str, str]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=["log", "planner", "mode", "outcome"])


def test_a_missing_or_crashed_log_counts_as_failed_and_an_inconclusive_log_apart() -> None:
    driven = drives(
        *(("a", *one) for one in ASKED), *(("b", *one) for one in ASKED), ("c", "dp_qp", "open")
    )
    found = said(
        ("a", "dp_qp", "open", "pass"),
        ("a", "dp_qp", "closed", "pass"),
        ("a", "dp_qp", "closed", "pass"),
        ("b", "dp_qp", "open", "pass"),
        ("b", "dp_qp", "closed", "pass"),
        ("b", "dp_qp", "closed", "inconclusive"),
        ("c", "dp_qp", "open", "pass"),
        ("c", "dp_qp", "closed", "inconclusive"),
    )
    stand = standings(found, driven, list(LABELS), ASKED)
    shares = pass_shares(stand, LABELS).set_index(["kind", "group", "mode"])
    counts = ["logs", "passed", "failed", "inconclusive", "missing"]
    assert list(shares.loc[("suite", "", "closed"), counts]) == [3, 1, 0, 1, 1]
    assert list(shares.loc[("suite", "", "open"), counts]) == [3, 3, 0, 0, 0]
    assert list(shares.loc[("suite", "", "both"), counts]) == [3, 1, 0, 1, 1]
    assert list(shares.loc[("family", "cut_in", "closed"), counts]) == [2, 1, 0, 1, 0]
    suite = shares.loc[("suite", "", "both")]
    assert (suite["mean"], suite["low"], suite["high"]) == pytest.approx((1 / 3, *wilson(1, 3)))


@pytest.mark.parametrize(
    "crashed", [("a", "dp_qp", "open"), ("a", "dp_qp", None), ("a", None, None)]
)
def test_a_crashed_drive_is_missing_with_any_outcome_of_its_gates(
    crashed: tuple[str, str | None, str | None],
) -> None:
    found = said(("a", "dp_qp", "open", "pass"), ("b", "dp_qp", "open", "pass"))
    driven = drives(("a", "dp_qp", "open"), ("b", "dp_qp", "open"))
    stand = standings(
        found,
        driven,
        ["a", "b"],
        ASKED[:1],
        [crashed, ("b", "dp_qp", "closed"), ("b", "idm", None)],
    )
    assert list(stand["standing"]) == ["missing", "passed"]
    failed = standings(said(("a", "dp_qp", "open", "fail")), driven, ["a"], ASKED[:1], [crashed])
    assert list(failed["standing"]) == ["failed"]


def test_a_loop_without_gates_is_not_asked_unless_a_drive_of_it_is_lost() -> None:
    driven, found = drives(*(("a", *one) for one in ASKED)), said(("a", "dp_qp", "closed", "pass"))
    stand = standings(found, driven, ["a"], ASKED)
    assert stand[["mode", "standing"]].to_numpy().tolist() == [["closed", "passed"]]
    lost = standings(
        found, drives(("a", "dp_qp", "closed")), ["a"], ASKED, [("a", "dp_qp", "open")]
    )
    assert dict(zip(lost["mode"], lost["standing"], strict=True))["both"] == "missing"


@given(st.lists(st.sampled_from(["pass", "fail", "inconclusive", "lost"]), min_size=1, max_size=12))
def test_every_log_is_counted_once_and_a_lost_one_never_helps(outcomes: list[str]) -> None:
    logs = [f"log{i}" for i in range(len(outcomes))]
    there = [
        (log, outcome) for log, outcome in zip(logs, outcomes, strict=True) if outcome != "lost"
    ]
    stand = standings(
        said(*((log, "dp_qp", "open", outcome) for log, outcome in there)),
        drives(*((log, "dp_qp", "open") for log, _ in there)),
        logs,
        ASKED[:1],
    )
    (row,) = pass_shares(stand, dict.fromkeys(logs, LogLabels())).to_dict("records")
    assert (
        row["passed"] + row["failed"] + row["inconclusive"] + row["missing"]
        == row["logs"]
        == len(outcomes)
    )
    assert row["mean"] == outcomes.count("pass") / len(outcomes)


def test_logs_belong_to_the_suite_their_family_their_dataset_and_each_tag() -> None:
    assert membership(LABELS) == {
        ("suite", ""): ("a", "b", "c"),
        ("family", "cut_in"): ("a", "b"),
        ("tag", "car"): ("a", "b"),
        ("tag", "wet"): ("a",),
        ("dataset", "one"): ("a", "c"),
        ("dataset", "two"): ("b",),
    }


def table(direction: str, values: dict[str, float], *, mode: str = "closed") -> pd.DataFrame:
    rows = [("gap.min", log, value) for log, value in values.items()]
    return pd.DataFrame(rows, columns=["metric", "log", "value"]).assign(
        planner="dp_qp",
        mode=mode,
        unit="m",
        direction=direction,
        available=lambda t: t["value"].notna(),
    )


NOTHING_STANDS = standings(said(), drives(), [], [])


@pytest.mark.parametrize(
    ("direction", "worst", "log"), [("higher", 1.0, "a"), ("lower", 4.0, "b"), ("none", np.nan, "")]
)
def test_the_worst_follows_the_direction_and_missing_values_are_counted(
    direction: str, worst: float, log: str
) -> None:
    found = groups(table(direction, {"a": 1.0, "b": 4.0, "c": np.nan}), NOTHING_STANDS, LABELS)
    assert tuple(found.columns) == COLUMNS
    suite = found[found["kind"] == "suite"].iloc[0]
    assert list(suite[["logs", "available", "missing"]]) == [3, 2, 1]
    assert list(suite[["mean", "median", "total"]]) == [2.5, 2.5, 5.0]
    assert (suite["worst_log"], suite["worst"]) == (log, pytest.approx(worst, nan_ok=True))
    one = found[(found["kind"] == "dataset") & (found["group"] == "one")].iloc[0]
    assert (one["mean"], one["missing"]) == (1.0, 1)


@settings(max_examples=10)
@given(st.lists(st.floats(-1e3, 1e3) | st.none(), min_size=1, max_size=8), st.randoms())
def test_groups_do_not_depend_on_the_order_of_rows(
    values: list[float | None], random: object
) -> None:
    labels = {f"log{i}": LogLabels("even" if i % 2 == 0 else "odd") for i in range(len(values))}
    rows = table(
        "lower", {log: np.nan if v is None else v for log, v in zip(labels, values, strict=True)}
    )
    found = groups(rows, NOTHING_STANDS, labels)
    random.shuffle(order := list(range(len(rows))))  # type: ignore[attr-defined]
    again = groups(rows.iloc[order].sort_values("log"), NOTHING_STANDS, labels)
    pd.testing.assert_frame_equal(found, again, check_exact=True)
    known = [v for v in values if v is not None]
    suite = found[found["kind"] == "suite"].iloc[0]
    assert suite["worst"] == (max(known) if known else pytest.approx(np.nan, nan_ok=True))
    assert suite["mean"] == pytest.approx(np.mean(known) if known else np.nan, nan_ok=True)
