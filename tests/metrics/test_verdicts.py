"""Verdicts over many logs: means, shares, groups.

Ensembles, late plans, marginal values; logs that tell nothing.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, moving, scenario, straight_road
from gate_rows import row, table
from hypothesis import given, strategies as st

from replan.core.errors import ConfigError
from replan.logs.agents import AgentKind
from replan.logs.edit.transform import sampled
from replan.logs.road import RoadSource
from replan.metrics import METRICS, evaluate
from replan.metrics.judge import Verdict, judge, outcomes, worst
from replan.metrics.judge.added_rows import with_ensemble
from replan.metrics.judge.aggregate import LogLabels, wilson
from replan.metrics.judge.deadline import MISS_COLUMNS, deadline_misses
from replan.metrics.judge.discrimination import (
    BLIND,
    BLIND_FAILS,
    PARKED,
    PARKED_FAILS,
    with_discrimination,
)
from replan.metrics.judge.gates import Gate, Gates, Outcome, load_gates
from replan.metrics.judge.marginality import INTERVAL, marginal
from replan.replay.loop.reference_drives import discriminate
from replan.run.ensemble import NOISE_M, PERTURBATIONS, START_M, perturbed

PASS, FAIL, INCONCLUSIVE = Outcome.PASS, Outcome.FAIL, Outcome.INCONCLUSIVE
GAP = "gap.min"
DRIVEN = "coverage.driven_s.final"


def of_logs(values: dict[str, float | None], metric: str = GAP) -> pd.DataFrame:
    """A row per log; None: it has no value."""
    return table(
        *(
            row(log, np.nan if v is None else v, metric=metric, reason="")
            for log, v in values.items()
        )
    )


def verdicts(
    gate: Gate,
    values: dict[str, float | None],
    labels: dict[str, LogLabels] | None = None,
    lost: tuple[str, ...] = (),
) -> tuple[Verdict, ...]:
    known = labels or dict.fromkeys(values, LogLabels())
    return judge(
        Gates((gate,), "test"),
        of_logs(values, gate.metric),
        known,
        failed=dict.fromkeys(lost, "broken"),
    )


def verdict(gate: Gate, values: dict[str, float | None], **how: object) -> Verdict:
    (only,) = verdicts(gate, values, **how)  # type: ignore[arg-type]
    return only


def share(least: float, *, confident: bool = False, max_missing: float = 0.5) -> Gate:
    return Gate(
        GAP,
        min=0.5,
        over="pass_share",
        min_share=least,
        confident=confident,
        max_missing=max_missing,
    )


# one value over the logs --------------------------------------------------------------------------


@given(
    st.lists(st.floats(0.0, 1e3), min_size=1, max_size=9),
    st.sampled_from(["mean", "median", "sum"]),
)
def test_a_statistic_is_judged_over_all_logs(values: list[float], over: str) -> None:
    expected = float({"mean": np.mean, "median": np.median, "sum": np.sum}[over](values))
    logs = {f"log{i}": value for i, value in enumerate(values)}
    below, above = (
        verdict(Gate(GAP, min=expected + step, over=over), logs) for step in (-1.0, 1.0)
    )
    assert (below.outcome, above.outcome) == (PASS, FAIL)
    assert below.value == above.value == expected
    assert f"{over} gap.min" in above.reason and "below" in above.reason


def test_hours_driven_can_be_asked() -> None:
    logs: dict[str, float | None] = {f"log{i}": 1000.0 for i in range(4)}
    hour = Gate(DRIVEN, over="sum", min=3600.0)
    found = verdict(hour, logs)
    assert (found.outcome, found.value, str(hour)) == (PASS, 4000.0, f"sum {DRIVEN} >= 3600")
    assert {log.outcome for log in found.logs} == {PASS}  # a log by itself owes no hour
    assert verdict(hour, {"log": 1000.0}).outcome is FAIL


@pytest.mark.parametrize("over", ["mean", "median", "sum"])
def test_a_lost_log_is_no_pass_over_the_logs_either(over: str) -> None:
    gate = Gate(GAP, min=0.5, over=over)
    found = verdict(gate, {"a": 1.0}, lost=("b",))
    assert found.outcome is INCONCLUSIVE and "could not be evaluated (b: broken)" in found.reason
    assert verdict(gate, {"a": 1.0, "b": None}).outcome is INCONCLUSIVE  # half are without a value


# share of passes ----------------------------------------------------------------------------------


@given(
    st.integers(0, 8), st.integers(0, 8), st.integers(0, 4), st.integers(0, 4), st.floats(0.01, 1.0)
)
def test_lost_logs_count_as_failed_and_inconclusive_logs_as_neither(
    good: int, bad: int, unsure: int, lost: int, least: float
) -> None:
    values: dict[str, float | None] = {f"good{i}": 1.0 for i in range(good)}
    values |= {f"bad{i}": 0.0 for i in range(bad)} | {f"unsure{i}": None for i in range(unsure)}
    if not good + bad:
        return
    found = verdict(
        share(least, max_missing=0.999), values, lost=tuple(f"lost{i}" for i in range(lost))
    )
    n = good + bad + unsure + lost
    assert found.value == good / n
    if (good + unsure) / n < least:
        assert found.outcome is FAIL
    else:
        assert found.outcome is (PASS if good / n >= least else INCONCLUSIVE)
    assert f"{good} of {n} log" in found.reason
    as_failed = verdict(
        share(least, max_missing=0.999), values | {f"lost{i}": 0.0 for i in range(lost)}
    )
    assert (as_failed.outcome, as_failed.value) == (found.outcome, found.value)


@pytest.mark.parametrize("gate", [Gate(GAP, min=0.5), Gate(GAP, min=0.5, over="mean"), share(0.9)])
def test_a_drive_that_crashed_can_fail_and_not_pass(gate: Gate) -> None:
    crashed = {("a", "dp_qp", "closed"): "out of ideas"}
    labels = {"a": LogLabels(), "b": LogLabels()}
    good, bad = (
        judge(Gates((gate,), "test"), of_logs({"a": value, "b": 1.0}), labels, crashed=crashed)[0]
        for value in (1.0, -1.0)
    )
    assert good.outcome is (FAIL if gate.over == "pass_share" else INCONCLUSIVE)
    assert "1 log could not be evaluated (a: out of ideas)" in good.reason
    assert bad.outcome is FAIL


def test_too_many_without_evidence_are_no_pass_of_a_share() -> None:
    values: dict[str, float | None] = {f"log{i}": 1.0 if i < 8 else None for i in range(10)}
    assert verdict(share(0.5, max_missing=0.2), values).outcome is PASS
    assert verdict(share(0.5, max_missing=0.1), values).outcome is INCONCLUSIVE


@pytest.mark.parametrize("gate", [Gate(GAP, min=0.5), Gate(GAP, min=0.5, over="mean"), share(0.5)])
@given(st.lists(st.sampled_from([1.0, 0.0, None]), min_size=1, max_size=6))
def test_an_inconclusive_verdict_names_a_log_without_evidence(
    gate: Gate, values: list[float | None]
) -> None:
    logs = {f"log{i}": value for i, value in enumerate(values)}
    found = verdict(gate, logs)
    if found.outcome is INCONCLUSIVE and None in values:
        assert logs[found.log] is None
    elif any(value is not None for value in values):
        assert logs[found.log] == min(value for value in values if value is not None)


@pytest.mark.parametrize(("n", "outcome"), [(72, INCONCLUSIVE), (73, PASS)])
def test_to_be_sure_of_95_percent_takes_73_passes(n: int, outcome: Outcome) -> None:
    found = verdict(share(0.95, confident=True), {f"log{i}": 1.0 for i in range(n)})
    assert found.outcome is outcome
    assert (wilson(n, n)[0] >= 0.95) == (outcome is PASS)
    assert ("not surely" in found.reason) == (outcome is INCONCLUSIVE)


# which logs ---------------------------------------------------------------------------------------

LABELS = {
    "a": LogLabels("cut_in", "one", ("car", "wet")),
    "b": LogLabels("cut_in", "two", ("car",)),
    "c": LogLabels("merge", "one", ()),
}
VALUES: dict[str, float | None] = {"a": 1.0, "b": 0.2, "c": 0.3}


@pytest.mark.parametrize(
    ("filters", "logs"),
    [
        ({"families": ("cut_in",)}, ["a", "b"]),
        ({"families": ("cut_in", "merge")}, ["a", "b", "c"]),
        ({"datasets": ("one",)}, ["a", "c"]),
        ({"datasets": ("one",), "tags": ("car",)}, ["a"]),
    ],
)
def test_families_and_datasets_select_logs(
    filters: dict[str, tuple[str, ...]], logs: list[str]
) -> None:
    found = verdict(Gate(GAP, min=0.5, **filters), VALUES, labels=LABELS)  # type: ignore[arg-type]
    assert [log.log for log in found.logs] == logs


@pytest.mark.parametrize(
    ("per", "expected"),
    [
        ("family", {"family cut_in": FAIL, "family merge": FAIL}),
        ("dataset", {"dataset one": FAIL, "dataset two": FAIL}),
        ("tag", {"tag car": FAIL, "tag not known": FAIL, "tag wet": PASS}),
    ],
)
def test_a_verdict_for_each_group(per: str, expected: dict[str, Outcome]) -> None:
    found = verdicts(Gate(GAP, min=0.5, per=per), VALUES, labels=LABELS)
    assert {v.group: v.outcome for v in found} == expected
    assert all(f"dp_qp, closed loop, {v.group}: " in v.reason for v in found)
    assert sorted(outcomes(found)["log"]) == ["a", "b", "c"]  # once, in however many groups


def test_the_page_of_gates_has_every_key_and_no_other() -> None:
    page = (Path(__file__).parents[2] / "docs" / "gates.md").read_text(encoding="utf-8")
    rows = [
        line.split("|")[1]
        for line in page.partition("| key |")[2].partition("## ")[0].splitlines()[2:]
        if line
    ]
    assert {word for row in rows for word in re.findall(r"`(\w+)`", row)} == {
        field.name for field in fields(Gate)
    }


def test_a_file_may_ask_all_of_it(tmp_path: Path) -> None:
    path = tmp_path / "gates.toml"
    path.write_text(
        f'[[gate]]\nmetric = "{DRIVEN}"\nover = "sum"\nmin = 3600\n'
        '[[gate]]\nmetric = "gap.min"\nmin = 0.5\nover = "pass_share"\nmin_share = 0.95\nconfident '
        "= true\n"
        'families = ["cut_in"]\ndatasets = ["one"]\nper = "tag"\n'
    )
    assert [str(gate) for gate in load_gates(path).gates] == [
        f"sum {DRIVEN} >= 3600",
        "gap.min >= 0.5 in 95 % of logs, surely [family cut_in] [dataset one] [per tag]",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('over = "pass_share"', "min_share and confident need over"),
        ("min_share = 0.5", "min_share and confident need over"),
        ("confident = true", "min_share and confident need over"),
        ('over = "pass_share"\nmin_share = 0.0', "not a share above 0"),
        ('over = "pass_share"\nmin_share = 95', "not a share above 0"),
        ('over = "pass_share"\nmin_share = 1.0\nconfident = true', "no number of logs"),
        ('per = "log"', 'per is \'log\', not "family", "tag" or "dataset"'),
        ('families = "cut_in"', r"got `str` - at `\$.families`"),
        ("datasets = [1]", r"got `int` - at `\$.datasets\[0\]`"),
    ],
)
def test_contradictory_gates_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "gates.toml"
    path.write_text(f'[[gate]]\nmetric = "gap.min"\nmin = 0.5\n{text}\n')
    with pytest.raises(ConfigError, match=message):
        load_gates(path)


GATES = Gates(
    (Gate("speed.max", max=10.5, mode="closed"), Gate("ensemble.fragile", max=0.0, optional=True)),
    "test",
)


def evaluated(*speeds: float) -> list[pd.DataFrame]:
    log = scenario(along(grid(1.0), 10.0))
    return [evaluate(drive(log, along(grid(1.0), speed)), log) for speed in speeds]


def ensemble(plain: float, *members: float) -> dict[str, tuple[float, str]]:
    rows = pd.concat(
        [t.assign(member=i, perturbation=f"kind{i}") for i, t in enumerate(evaluated(*members), 1)]
    )
    found = with_ensemble(evaluated(plain)[0], rows, GATES, {"test/log": LogLabels()})
    found = found[found["metric"].str.startswith("ensemble.")]
    assert found["available"].all()
    return {row.metric: (row.value, row.reason) for row in found.itertuples()}


@pytest.mark.parametrize(("plain", "members"), [(10.0, (10.0, 9.0)), (11.0, (12.0, 13.0))])
def test_a_verdict_that_holds_everywhere_is_not_fragile(
    plain: float, members: tuple[float, ...]
) -> None:
    found = ensemble(plain, *members)
    assert found["ensemble.fragile"] == (0.0, "")
    assert found["ensemble.pass_share"][0] == (1.0 if plain < 10.5 else 0.0)


def test_a_verdict_that_flips_is_fragile_and_says_where() -> None:
    found = ensemble(10.0, 10.0, 11.0)
    assert found["ensemble.pass_share"][0] == pytest.approx(2.0 / 3.0)
    assert found["ensemble.fragile"] == (1.0, "kind2: pass -> fail (speed.max <= 10.5 [closed])")


def test_the_kinds_take_turns_and_are_the_same_in_every_run() -> None:
    car = ("7", AgentKind.CAR, (4.0, 2.0), moving(30.0, 0.0, 5.0, 0.0))
    log = scenario(along(grid(1.0, 0.1), 10.0), [car])
    kinds = list(PERTURBATIONS)
    for member in range(1, len(kinds) + 2):
        name, one = perturbed(log, member)
        assert name == kinds[(member - 1) % len(kinds)]
        assert np.array_equal(one.tracks.x, perturbed(log, member)[1].tracks.x)
    worlds = dict(perturbed(log, member) for member in range(1, len(kinds) + 1))
    assert worlds["again"] is log
    assert worlds["clock"].start_ns != log.start_ns
    assert 0.0 < np.abs(worlds["tiny"].tracks.x - log.tracks.x).max() <= 1e-9
    assert (
        0.0
        < np.hypot(worlds["start"].ego.x - log.ego.x, worlds["start"].ego.y - log.ego.y).max()
        <= START_M * 2**0.5
    )
    assert 0.3 * NOISE_M < np.std(worlds["noise"].tracks.x - log.tracks.x) < 3.0 * NOISE_M
    assert np.allclose(np.diff(worlds["rate"].tracks.t), 0.2)
    assert np.allclose(
        np.hypot(*(np.diff(c) for c in (worlds["turned"].ego.x, worlds["turned"].ego.y))), 1.0
    )
    assert not np.array_equal(
        perturbed(log, 2)[1].ego.yaw, perturbed(log, 2 + len(kinds))[1].ego.yaw
    )


def timings(seconds: list[float], log: str = "a", planner: str = "p") -> pd.DataFrame:
    rows = [
        (log, planner, "open", 0.1 * i, stage, s * part)
        for i, s in enumerate(seconds)
        for stage, part in (("path", 0.7), ("total", 1.0))
    ]
    return pd.DataFrame(rows, columns=["log", "planner", "mode", "t_s", "stage", "seconds"])


def test_misses_by_hand() -> None:
    """0.1 s is met by 0.1 s; the stages of a plan count once, as its total."""
    table = deadline_misses(
        pd.concat([timings([0.02, 0.1, 0.3, 0.11]), timings([0.2], planner="q")]), 0.1
    )
    assert tuple(table.columns) == MISS_COLUMNS
    assert table.iloc[0].tolist() == ["a", "p", "open", 4, 2, 0.5, 0.3, pytest.approx(0.2)]
    assert table.iloc[1].tolist() == ["a", "q", "open", 1, 1, 1.0, 0.2, 0.0]
    assert deadline_misses(timings([]), 0.1).empty
    with pytest.raises(ValueError, match="deadline"):
        deadline_misses(timings([0.1]), 0.0)


@given(
    st.lists(st.floats(0.001, 1.0), min_size=1, max_size=20),
    st.floats(0.001, 1.0),
    st.floats(0.0, 1.0),
)
def test_a_longer_deadline_is_missed_less(
    seconds: list[float], deadline: float, more: float
) -> None:
    table = timings(seconds)
    assert (
        deadline_misses(table, deadline + more)["misses"]
        <= deadline_misses(table, deadline)["misses"]
    ).all()


def of(values: Mapping[str, float]) -> Callable[[str], float]:
    return lambda name: values.get(name, float("nan"))


TTC = Gate("ttc.time_below_950ms", max=0.0)


@pytest.mark.parametrize(("rate", "near"), [(5.0, 0.3), (10.0, 0.15), (20.0, 0.075)])
@given(st.floats(0.05, 3.0))
def test_a_time_is_marginal_within_one_and_a_half_intervals(
    rate: float, near: float, least: float
) -> None:
    values = {"ttc.min": least, "ttc.time_below_950ms": float(least < 0.95), INTERVAL: 1.0 / rate}
    said = marginal(TTC, of(values))
    if abs(abs(least - 0.95) - near) > 1e-6:
        assert bool(said) == (abs(least - 0.95) < near)
    assert not said or said.startswith(
        f"marginal: at {rate:g} Hz the bound of 0.95 s is within {near:.2g} s of "
    )


def test_a_flip_by_the_rate_is_marked() -> None:
    """0.79 s at 20 Hz is 1.05 s at 5 Hz: the outcome at 5 Hz is marginal."""
    assert "of 1.05 s" in marginal(
        TTC, of({"ttc.min": 1.05, "ttc.time_below_950ms": 0.0, INTERVAL: 0.2})
    )
    assert not marginal(TTC, of({"ttc.min": 1.05, "ttc.time_below_950ms": 0.0}))
    assert not marginal(TTC, of({INTERVAL: 0.2}))


def test_metrics_of_the_ego_and_values_far_from_the_bound_are_not_marginal() -> None:
    values = {
        "off_road.max": 0.3,
        "off_road.time_beyond_30cm": 0.0,
        "lat_accel.worst_episode": 0.0,
        INTERVAL: 0.2,
    }
    values |= {"yielding.recorded.min": 1.4, "yielding.recorded.below_1500ms": 2.0}
    values |= {"thw.time_below_900ms": 4.8, "gap_kept.min": 0.5, "gap_kept.time_below_20cm": 0.0}
    found = {gate.metric for gate in load_gates(None).gates if marginal(gate, of(values))}
    assert found == {
        "thw.time_below_900ms",
        "gap_kept.time_below_20cm",
        "yielding.recorded.below_1500ms",
    }
    assert marginal(Gate("gap_kept.min", min=0.5), of(values | {"gap_kept.min": 0.7})).endswith(
        "0.36 m of 0.7 m"
    )
    assert not marginal(
        Gate("lon_accel.max_abs", max=4.0), of({"lon_accel.max_abs": 4.0, INTERVAL: 0.2})
    )


@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0])
def test_the_time_to_collision_of_one_drive_does_not_hang_on_the_rate(rate: float) -> None:
    """A pedestrian walks in, and a car ahead brakes: the same drive among agents at another rate,
    within (2).
    """
    t = grid(6.0, 0.05)
    walker = ("p", AgentKind.PEDESTRIAN, (0.6, 0.6), moving(45.0, -6.0, 0.0, 1.5))
    lead = (
        "c",
        AgentKind.CAR,
        (4.5, 1.8),
        lambda t: (25.0 + 10.0 * t - 0.8 * t**2, 3.5 + 0 * t, 0 * t),
    )
    log = scenario(along(t, 10.0), [walker, lead])
    asked = {name: METRICS[name] for name in ("ttc", "gap_kept", "agent_interval")}
    fine, coarse = (
        evaluate(
            drive(log, log.ego) if tracks is log else drive(tracks, log.ego), tracks, metrics=asked
        ).set_index("metric")["value"]
        for tracks in (log, sampled(log, rate))
    )
    assert coarse[INTERVAL] == pytest.approx(1.0 / rate)
    assert coarse["ttc.min"] == pytest.approx(fine["ttc.min"], abs=0.05)
    assert coarse["gap_kept.min"] == pytest.approx(fine["gap_kept.min"], abs=0.05)
    assert np.isfinite(fine["ttc.min"])


PROGRESS, CRASH = Gate("route_progress.final", min=0.5), Gate("collision_at_fault.count", max=0.0)
EASY = Gate(PARKED_FAILS, mode="closed", min=1, optional=True, broken="inconclusive")
RULES = Gates((PROGRESS, CRASH, EASY), "test")


def made(progress: float, **bad: float) -> pd.DataFrame:
    """A drive of dp_qp with this progress, and the reference drives: progress of the parked,
    contacts of the blind.
    """
    of = {PARKED: PROGRESS.metric, BLIND: CRASH.metric}
    references = (
        row("a", value, planner=planner, mode="reference", oracle=True, metric=of[planner])
        for planner, value in bad.items()
    )
    names = row("a", np.nan, metric=PARKED_FAILS), row("a", np.nan, metric=BLIND_FAILS)
    mine = row("a", progress, metric=PROGRESS.metric), row("a", 0.0, metric=CRASH.metric)
    return with_discrimination(table(*mine, *names, *references), RULES, {"a": LogLabels()})


def value(rows: pd.DataFrame, metric: str) -> float:
    return float(rows.loc[(rows["metric"] == metric) & (rows["mode"] == "closed"), "value"].iloc[0])


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.integers(0, 2))
def test_a_log_that_a_parked_driver_passes_makes_a_pass_inconclusive_and_leaves_a_failure(
    progress: float, parked: float, contacts: int
) -> None:
    rows = made(progress, parked=parked, blind=float(contacts))
    assert value(rows, PARKED_FAILS) == float(parked < 0.5)
    assert value(rows, BLIND_FAILS) == float(contacts > 0)
    outcome = worst(verdict.logs[0].outcome for verdict in judge(RULES, rows, {"a": LogLabels()}))
    if progress < 0.5:
        assert outcome is Outcome.FAIL
    else:
        assert outcome is (Outcome.PASS if parked < 0.5 else Outcome.INCONCLUSIVE)


def test_a_share_of_logs_with_an_interaction_can_be_asked_for() -> None:
    share = Gate(BLIND_FAILS, min=1, over="pass_share", min_share=0.5)
    for contacts, outcome in ((1.0, Outcome.PASS), (0.0, Outcome.FAIL)):
        rows = made(1.0, parked=0.0, blind=contacts)
        (verdict,) = judge(Gates((share,), "test"), rows, {"a": LogLabels()})
        assert verdict.outcome is outcome


def test_without_reference_drives_the_gate_is_not_asked() -> None:
    rows = made(1.0)
    assert np.isnan(value(rows, PARKED_FAILS))
    assert (
        worst(verdict.outcome for verdict in judge(RULES, rows, {"a": LogLabels()})) is Outcome.PASS
    )


@pytest.mark.parametrize("ahead", [None, 60.0])
def test_a_standing_car_is_an_interaction_and_a_free_road_is_none(ahead: float | None) -> None:
    t = grid(12.0)
    agents = (
        [("1", AgentKind.CAR, (4.5, 1.8), moving(ahead, 0.0, 0.0, 0.0, yaw=0.0))] if ahead else []
    )
    log = scenario(along(t, 10.0), agents, road=straight_road(limit=13.9))
    found = {one.driver: one.breaks for one in discriminate(log)}
    assert found[PARKED] is not None
    assert (found[BLIND] is not None) is (ahead is not None)


@pytest.mark.parametrize("seconds", [0.02, 0.12])
def test_a_log_too_short_for_the_reference_drives_has_none(seconds: float) -> None:
    log = scenario(along(grid(seconds), 5.0), [], road=straight_road(limit=13.9))
    assert discriminate(log) == ()


def test_a_log_that_only_reverses_has_no_discrimination() -> None:
    t = grid(10.0, 0.1)
    log = scenario(along(t, -2.0), [], road=replace(straight_road(), source=RoadSource.DRIVEN_PATH))
    assert discriminate(log) == ()


def test_a_log_in_which_the_driver_stands_does_not_tell_drivers_apart() -> None:
    log = scenario(along(grid(6.0), 0.0), [], road=straight_road(limit=13.9))
    found = {one.driver: one.breaks for one in discriminate(replace(log, goal=None))}
    assert found[PARKED] is None or found[PARKED].metric == "needless_standing.worst_episode"
