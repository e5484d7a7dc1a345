"""Run against run: deltas, flips, groups with intervals, and rules that say pass or fail."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from gate_rows import row, table
from hypothesis import given, settings, strategies as st

from replan.core.errors import ConfigError
from replan.metrics.comparison import Comparison, Side, compare
from replan.metrics.comparison_rules import judge_rules
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.gates import Gate, GateRule, Gates, Outcome, load_gates, load_rules
from replan.metrics.resampling import MIN_PAIRS, MIN_SIGNIFICANT, by_recording, intervals, noise

GAP = Gate("gap.min", min=0.5)


def side(
    label: str, *rows: dict[str, object], facts: dict[str, str] | None = None, sha: str = "1"
) -> Side:
    found = table(*rows)
    logs = pd.DataFrame(
        [
            (log, sha, log[0], "here", ["synthetic", log[0]], "")
            for log in dict.fromkeys(found["log"])
        ],
        columns=["log", "sha256", "family", "dataset", "tags", "vehicle"],
    )
    return Side(label, found, logs, facts or {}, {})


def of(
    before: dict[str, float], now: dict[str, float], *gates: Gate, **changes: object
) -> Comparison:
    """Runs whose logs have these gaps."""
    one, two = (
        side(x, *(row(log, v, **changes) for log, v in y.items()))
        for x, y in (("old", before), ("new", now))
    )
    return compare(one, two, Gates(gates or (GAP,), "test"))


def said(comparison: Comparison, *rules: GateRule) -> list[str]:
    labels = {log: LogLabels(tags=("synthetic", log[0])) for log in comparison.pairs["log"]}
    return [verdict.outcome.value for verdict in judge_rules(rules, comparison, labels).verdicts]


GAPS = st.dictionaries(
    st.sampled_from([f"{x}{i}" for x in "ab" for i in range(4)]), st.floats(-3.0, 3.0), min_size=1
)
RISES = GateRule("gap.min", max_increase=0.0, significant=True)
FALLS = GateRule("gap.min", max_decrease=0.0, significant=True)
NO_FLIPS = GateRule(max_flips=0)
NONE_MISSING = GateRule(max_missing=0)


@settings(max_examples=6, deadline=None)
@given(GAPS)
def test_a_run_against_itself_is_no_difference(gaps: dict[str, float]) -> None:
    found = of(gaps, gaps)
    assert (
        (found.pairs["delta"] == 0.0).all()
        and (found.pairs["worse"] == 0.0).all()
        and len(found.pairs) == len(gaps)
    )
    assert (
        found.flips.empty
        and not found.groups["significant"].any()
        and len(found.regressions(9)) == 0
    )
    assert (found.differences, found.only_in_baseline, found.only_in_candidate) == ((), (), ())
    assert said(found, RISES, FALLS, NO_FLIPS, NONE_MISSING) == ["pass"] * 4
    assert (found.groups[["low", "high"]].dropna() == 0.0).all(axis=None)


@settings(max_examples=6, deadline=None)
@given(GAPS, GAPS)
def test_the_other_way_round_is_the_opposite(one: dict[str, float], two: dict[str, float]) -> None:
    there, back = of(one, two), of(two, one)
    keys = ["log", "metric"]
    first, second = (found.pairs.sort_values(keys).reset_index() for found in (there, back))
    assert list(first["delta"]) == [-value + 0.0 for value in second["delta"]]
    assert there.only_in_baseline == back.only_in_candidate
    assert sorted(there.flips["before"]) == sorted(back.flips["after"])
    bounds = (there.groups[["low", "high"]].to_numpy(), -back.groups[["high", "low"]].to_numpy())
    np.testing.assert_allclose(*bounds, atol=1e-12)
    assert len(first) == len(one.keys() & two.keys()) == len(one) - len(there.only_in_baseline)


@settings(max_examples=12, deadline=None)
@given(st.lists(st.floats(-5.0, 5.0), min_size=MIN_PAIRS, max_size=30))
def test_the_interval_holds_the_mean_and_is_the_same_twice(deltas: list[float]) -> None:
    values = np.array([deltas])
    (low,), (high,) = intervals(values)
    assert min(deltas) - 1e-12 <= low <= high <= max(deltas) + 1e-12
    assert ((low,), (high,)) == tuple(map(tuple, intervals(values)))
    (shifted,), _ = intervals(values + 1.0)
    assert shifted == pytest.approx(low + 1.0)


@given(st.floats(-1e6, 1e6), st.floats(-1.0, 1.0))
def test_rounding_is_noise(value: float, share: float) -> None:
    assert noise(
        np.array([value]), np.array([value + share * 0.9e-9 + share * 0.9e-6 * value])
    ).all()
    assert not noise(np.array([value]), np.array([value + 1e-8 + 1e-5 * abs(value)])).any()


@given(st.lists(st.lists(st.floats(-9.0, 9.0), min_size=1, max_size=4), min_size=1, max_size=5))
def test_windows_of_a_recording_count_together_and_the_mean_is_that_of_all(
    recordings: list[list[float]],
) -> None:
    names = [
        f"drive {i}@{10 * k}" for i, windows in enumerate(recordings) for k in range(len(windows))
    ]
    rows = pd.DataFrame([[delta for windows in recordings for delta in windows]], columns=names)
    found = by_recording(rows)
    assert list(found.columns) == [f"drive {i}" for i in range(len(recordings))]
    assert found.mean(axis=1)[0] == pytest.approx(rows.mean(axis=1)[0], abs=1e-9)
    apart = rows.set_axis([f"raw/queue@seed={k}" for k in range(rows.shape[1])], axis=1)
    assert (
        by_recording(apart).to_numpy().tolist() == apart[sorted(apart.columns)].to_numpy().tolist()
    )


def test_intervals_cover_the_mean_as_often_as_they_say() -> None:
    """500 samples of 20 from a normal distribution: 95 % intervals, of a percentile bootstrap 92 %
    (Efron 1993).
    """
    low, high = intervals(np.random.default_rng(1).normal(0.3, 1.0, (500, 20)))
    assert 0.90 <= np.mean((low <= 0.3) & (high >= 0.3)) <= 0.96


def test_worst_regressions_come_first_with_their_moment() -> None:
    found = of(
        {"a1": 1.0, "a2": 2.0, "b1": 0.4, "b2": 1.0}, {"a1": 0.7, "a2": 0.2, "b1": 0.9, "b2": 1.0}
    )
    assert list(found.pairs["log"]) == ["a2", "a1", "b2", "b1"]
    worst = found.regressions(1).iloc[0]
    assert (worst["delta"], worst["worse"], worst["time_s"], worst["reason"]) == (
        -1.8,
        1.8,
        3.2,
        "car 7",
    )
    assert worst["relative"] == pytest.approx(1.8 / (7.2 / 8.0))
    flips = found.flips.set_index("log")
    assert tuple(flips.loc["a2", ["before", "after", "value_before", "value_after"]]) == (
        "pass",
        "fail",
        2.0,
        0.2,
    )
    assert tuple(flips.loc["b1", ["before", "after"]]) == ("fail", "pass") and len(flips) == 2
    suite = found.groups[found.groups["kind"] == "suite"].iloc[0]
    assert (suite["logs"], suite["better"], suite["worse"]) == (4, 1, 2)
    assert (
        suite["delta"] == pytest.approx(-1.6 / 4.0)
        and -1.8 <= suite["low"] < -0.9
        and not suite["significant"]
    )
    assert set(found.groups["kind"]) == {"suite", "family", "tag"} and "synthetic" not in set(
        found.groups["group"]
    )
    small = found.groups[found.groups["group"] == "b"]
    assert small["low"].isna().all() and not small["significant"].any()


def test_both_sides_are_judged_by_the_same_gates_and_the_same_careful_driver() -> None:
    """A careful driver who comes as near excuses both runs, whichever of them they were driven
    with.
    """
    careful = row("a1", 0.1, planner="careful", mode="reference")
    gaps = (row("a1", 0.3), row("a1", 0.2))
    one, two = side("old", gaps[0]), side("new", gaps[1], careful)
    assert compare(one, two, Gates((GAP,), "test")).flips.empty
    found = compare(side("old", row("a1", 0.6)), two, Gates((GAP,), "test"))
    assert list(found.flips["after"]) == ["inconclusive"] and said(found, NO_FLIPS) == ["pass"]


def test_a_lost_value_is_named_and_has_no_delta() -> None:
    found = of({"a1": 1.0, "a2": np.nan}, {"a1": np.nan, "a2": 0.1}, replace(GAP, optional=True))
    reasons = dict(zip(found.pairs["log"], found.pairs["reason"], strict=True))
    assert reasons == {
        "a1": "only in the baseline; candidate: no agent there",
        "a2": "only in the candidate; baseline: no agent there",
    }
    assert found.pairs["delta"].isna().all()
    assert [tuple(flip) for flip in found.flips[["log", "before", "after"]].to_numpy()] == [
        ("a2", "not asked", "fail")
    ]
    assert said(found, NO_FLIPS, GateRule(max_flips=1), RISES) == ["fail", "pass", "inconclusive"]


def test_other_inputs_and_other_metrics_are_named() -> None:
    one = side(
        "old",
        row("a1", 1.0),
        row("a1", 1.0, metric="thw.min"),
        facts={"loop.plan_delay_s": "0.0", "x": "1"},
    )
    two = side(
        "new", row("a1", 0.1, version=2), facts={"loop.plan_delay_s": "0.1", "x": "1"}, sha="2"
    )
    found = compare(one, two, Gates((GAP,), "test"))
    assert found.differences == (
        "logs of one name with other content (SHA-256): a1 (1 -> 2)",
        "loop.plan_delay_s: 0.0 -> 0.1",
        "metrics of another version, not compared: gap.min (1 -> 2)",
        "metrics in the baseline only: thw.min",
    )
    assert found.pairs.empty and found.flips.empty and found.exit_code == 4


def test_a_missing_log_counts_against_the_candidate_and_no_log_is_inconclusive() -> None:
    found = of({"a1": 1.0, "a2": 1.0}, {"a1": 1.0})
    assert found.only_in_baseline == ("a2, dp_qp, closed loop",)
    assert judge_rules((NONE_MISSING,), found, {}).exit_code == 1
    assert judge_rules((replace(NONE_MISSING, max_missing=1),), found, {}).exit_code == 0
    assert of({"a1": 1.0}, {"b1": 1.0}).exit_code == 4
    assert judge_rules((NONE_MISSING,), of({"a1": 1.0}, {"b1": 1.0}), {}).exit_code == 1


def test_significance_needs_the_logs_to_agree_and_to_be_enough() -> None:
    names = [f"a{i}" for i in range(MIN_SIGNIFICANT)]
    base = dict.fromkeys(names, 2.0)
    agree = {name: 1.5 - 0.01 * i for i, name in enumerate(names)}
    split = {name: 1.0 if i else 6.0 for i, name in enumerate(names)}
    few = dict(list(agree.items())[:-1])
    assert [said(of(base, now), FALLS)[0] for now in (agree, split, few)] == [
        "fail",
        "pass",
        "inconclusive",
    ]
    assert said(of(base, dict.fromkeys(few, 2.1)), FALLS) == ["pass"]
    assert said(of(base, few), replace(FALLS, significant=False)) == ["fail"]
    assert said(of(base, agree), replace(FALLS, max_decrease=0.6)) == ["pass"]
    assert said(of(base, agree), RISES) == ["pass"]


@pytest.mark.parametrize(
    ("rule", "outcome"),
    [
        (GateRule("gap.min", max_decrease=0.9, over="worst"), "fail"),
        (GateRule("gap.min", max_decrease=1.0, over="worst"), "pass"),
        (GateRule("gap.min", max_decrease=0.1, over="median"), "fail"),
        (GateRule("gap.min", max_decrease=0.1, over="median", tags=("b",)), "pass"),
        (GateRule("gap.min", max_decrease=0.5, over="mean"), "pass"),
        (GateRule("gap.min", max_increase=0.4, over="worst", tags=("b",)), "fail"),
        (GateRule("gap.min", max_increase=0.0, mode="open"), "inconclusive"),
        (GateRule(max_flips=0, gate="gap.min"), "fail"),
        (GateRule(max_flips=0, gate="thw.min"), "pass"),
        (GateRule(max_flips=0, tags=("b",)), "pass"),
        (GateRule(max_flips=0, planner="idm"), "inconclusive"),
    ],
)
def test_each_rule_judges_its_change(rule: GateRule, outcome: str) -> None:
    found = of({"a1": 1.4, "a2": 2.0, "b1": 0.6}, {"a1": 0.4, "a2": 1.8, "b1": 1.1})
    assert said(found, rule) == [outcome]


def test_a_log_does_not_flip_a_gate_on_a_mean() -> None:
    runs = {"a1": 1.0, "a2": 1.0}, {"a1": 1.0, "a2": 0.4}
    mean = of(*runs, replace(GAP, over="mean"))
    assert mean.flips.empty and said(mean, NO_FLIPS) == ["pass"]
    assert said(of(*runs, replace(GAP, over="pass_share", min_share=0.5)), NO_FLIPS) == ["fail"]


def test_noise_and_fragile_drives_cause_no_flip() -> None:
    near = {"a1": 0.5 + 1e-8}, {"a1": 0.5 - 1e-8}
    assert list(of(*near).flips["marginal"]) == [True] and said(of(*near), NO_FLIPS) == ["pass"]
    fragile = row("a1", 1.0, metric="ensemble.fragile")
    one, two = (
        side("old", row("a1", 1.0), row("a2", 1.0), fragile),
        side("new", row("a1", 0.1), row("a2", 1.0)),
    )
    found = compare(one, two, Gates((GAP,), "test"))
    assert list(found.flips["marginal"]) == [True]
    verdicts = judge_rules(
        (NO_FLIPS, GateRule("gap.min", max_decrease=0.1, over="worst")), found, {}
    ).verdicts
    assert [verdict.outcome for verdict in verdicts] == [Outcome.PASS] * 2
    assert (
        verdicts[0].reason == "0 flips; 1 marginal"
        and "fragile and left out: 1" in verdicts[1].reason
    )


def test_a_candidate_does_not_excuse_itself() -> None:
    """Only where the baseline was fragile already is a flip no evidence."""
    fragile = row("a1", 1.0, metric="ensemble.fragile")
    found = compare(
        side("old", row("a1", 1.0)), side("new", row("a1", 0.1), fragile), Gates((GAP,), "test")
    )
    assert list(found.flips["marginal"]) == [False] and said(found, NO_FLIPS) == ["fail"]


def test_a_log_with_another_content_is_not_the_same_log() -> None:
    one, two = side("old", row("a1", 1.0)), side("new", row("a1", 1.0), sha="2")
    found = compare(one, two, Gates((GAP,), "test"))
    (verdict,) = judge_rules((NONE_MISSING,), found, {}).verdicts
    assert (
        found.other_logs == ("a1",)
        and verdict.outcome is Outcome.INCONCLUSIVE
        and "a1" in verdict.reason
    )


def test_a_drive_in_which_the_planner_failed_is_missing() -> None:
    one, two = side("old", row("a1", 1.0)), side("new", row("a1", 1.0))
    crashed = replace(two, crashed=(("a1", "dp_qp", "closed"),))
    found = compare(one, crashed, Gates((GAP,), "test"))
    assert found.only_in_baseline == ("a1, dp_qp, closed loop (failed)",) and said(
        found, NONE_MISSING
    ) == ["fail"]
    assert said(compare(crashed, crashed, Gates((GAP,), "test")), NONE_MISSING) == ["pass"]
    assert compare(crashed, two, Gates((GAP,), "test")).only_in_candidate == (
        "a1, dp_qp, closed loop (failed)",
    )


def test_lost_evidence_is_no_pass() -> None:
    logs = [f"a{i}" for i in range(20)]
    base, gone = dict.fromkeys(logs, 1.0), dict.fromkeys(logs[:3], np.nan)
    assert said(of(base, base | gone), NO_FLIPS) == ["inconclusive"]  # 3 of 20 without a value
    assert said(of(base, base | dict.fromkeys(logs[:2], np.nan)), NO_FLIPS) == ["pass"]
    assert said(of(base, base | gone, replace(GAP, optional=True)), NO_FLIPS) == ["pass"]
    optional = replace(RISES, optional=True)
    for now in (row("a1", 0.1, version=2), row("a1", 0.1, metric="thw.min")):
        found = compare(side("old", row("a1", 1.0)), side("new", now), Gates((GAP,), "test"))
        assert found.not_compared == ("gap.min",) and said(found, optional) == ["inconclusive"]
    other = [row("a1", 1.0, metric="thw.min")]
    found = compare(
        side("old", row("a1", 1.0), *other),
        side("new", row("a1", 0.1, version=2), *other),
        Gates((GAP,), ""),
    )
    assert said(found, NO_FLIPS, replace(NO_FLIPS, gate="thw.min")) == ["inconclusive", "pass"]


def test_rules_and_gates_share_a_file(tmp_path: Path) -> None:
    file = tmp_path / "gates.toml"
    file.write_text('[[gate]]\nmetric = "gap.min"\nmin = 0.5\n')
    assert load_rules(file) == load_rules(None) and len(load_rules(None)) > 5
    file.write_text(
        file.read_text()
        + '[[compare]]\nmetric = "ade.3s.mean"\nmax_increase = 0.1\ntags = ["paper"]\n'
    )
    assert load_rules(file) == (GateRule("ade.3s.mean", max_increase=0.1, tags=("paper",)),)
    assert len(load_gates(file).gates) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "needs one of max_increase"),
        ('metric = "gap.min"\nmax_increase = 1\nmax_flips = 1', "max_increase and max_flips"),
        ("max_increase = 1", "needs a metric"),
        ('metric = "gap.min"\nmax_flips = 1', "has no metric"),
        ('metric = "gap.mim"\nmax_increase = 1', "did you mean 'gap.min'"),
        ('metric = "gap.min"\nmax_increase = -1', "at least 0"),
        ('metric = "gap.min"\nmax_increase = "1"', "max_increase"),
        ('metric = "gap.min"\nmax_increase = 1\nover = "best"', "over is 'best'"),
        (
            'metric = "gap.min"\nmax_increase = 1\nover = "worst"\nsignificant = true',
            "significant goes with",
        ),
        ("max_missing = 0\nmode = 'open'", "counts all drives"),
        ("max_flips = 0\nmode = 'loop'", "mode is 'loop'"),
        ("max_flip = 0", "did you mean 'max_flips'"),
    ],
)
def test_a_rule_without_a_limit_is_refused(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "gates.toml"
    file.write_text(f"[[compare]]\n{text}\n")
    with pytest.raises(ConfigError, match="compare 1.*" + words):
        load_rules(file)
