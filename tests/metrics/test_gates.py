from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, scenario
from gate_rows import row, table
from hypothesis import given, strategies as st

from replan.core.errors import ConfigError, LogError
from replan.metrics import METRICS, evaluate
from replan.metrics.judge import Verdict, judge, outcomes, worst
from replan.metrics.judge.added_rows import with_asked
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.gates import PACKAGED, Gate, Gates, Outcome, load_gates

PASS, FAIL, INCONCLUSIVE = Outcome.PASS, Outcome.FAIL, Outcome.INCONCLUSIVE


def verdicts(gate: Gate, rows: pd.DataFrame, **how: object) -> tuple[Verdict, ...]:
    tags = how.pop("tags", dict.fromkeys(rows["log"], ()))
    labels = {log: LogLabels(tags=words) for log, words in tags.items()}  # type: ignore[attr-defined]
    return judge(Gates((gate,), "test"), rows, how.pop("labels", labels), **how)  # type: ignore[arg-type]


def verdict(gate: Gate, rows: pd.DataFrame, **how: object) -> Verdict:
    (only,) = verdicts(gate, rows, **how)
    return only


AT_LEAST = Gate("gap.min", min=0.5)

# judging ------------------------------------------------------------------------------------------


@given(
    st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=9),
    st.floats(-5.0, 5.0) | st.none(),
    st.floats(0.0, 5.0),
    st.booleans(),
)
def test_every_log_must_hold_the_bounds(
    values: list[float], low: float | None, width: float, two: bool
) -> None:
    high = (low or 0.0) + width if two or low is None else None
    rows = table(*(row(f"log{i}", value) for i, value in enumerate(values)))
    found = verdict(Gate("gap.min", min=low, max=high), rows)
    good = [(low is None or low <= v) and (high is None or v <= high) for v in values]
    assert found.outcome is (PASS if all(good) else FAIL)
    if not all(good):
        assert not good[int(found.log.removeprefix("log"))]


@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=9), st.floats(-5.0, 5.0))
def test_over_the_mean_only_the_mean_must(values: list[float], low: float) -> None:
    rows = table(*(row(f"log{i}", value) for i, value in enumerate(values)))
    found = verdict(Gate("gap.min", min=low, over="mean"), rows)
    assert found.value == pytest.approx(np.mean(values))
    assert (found.outcome is PASS) == (found.value >= low)


def test_a_failure_names_worst_log_value_time_planner_and_road_user() -> None:
    found = verdict(AT_LEAST, table(row("a", 0.31), row("b", 0.12, time_s=1.5), row("c", 2.0)))
    assert (found.outcome, found.planner, found.mode, found.log) == (FAIL, "dp_qp", "closed", "b")
    assert (found.value, found.time_s) == (0.12, 1.5)
    assert found.reason == (
        "dp_qp, closed loop: gap.min = 0.12 m, below 0.5, on b at 1.50 s (car 7); broken in 2 of 3 "
        "logs"
    )


def test_a_bound_of_zero_is_a_bound() -> None:
    assert verdict(Gate("gap.min", max=0), table(row("a", 1e-9))).outcome is FAIL
    assert verdict(Gate("gap.min", max=0), table(row("a", 0.0))).outcome is PASS


def test_nothing_to_judge_is_not_a_pass() -> None:
    nothing = verdict(AT_LEAST, table(row("a", np.nan), row("b", np.nan)))
    assert nothing.outcome is INCONCLUSIVE
    assert (nothing.log, [log.why for log in nothing.logs]) == ("a", ["no agent there"] * 2)
    assert "nothing to judge" in nothing.reason and "no agent there" in nothing.reason
    assert (
        verdict(Gate("gap.min", min=0, mode="open"), table(row("a", 1.0))).outcome is INCONCLUSIVE
    )
    assert verdict(Gate("ttc.min", min=0), table(row("a", 1.0))).outcome is INCONCLUSIVE
    assert verdict(AT_LEAST, table(), tags={}).outcome is INCONCLUSIVE
    tagged = verdict(Gate("gap.min", min=0, tags=("rain",)), table(row("a", 1.0)))
    assert (tagged.outcome, tagged.reason) == (
        INCONCLUSIVE,
        "nothing to judge: no log has the tags rain",
    )


def test_missing_values_are_counted_and_bounded() -> None:
    rows = table(*(row(f"log{i}", np.nan if i < 2 else 1.0) for i in range(20)))
    found = verdict(AT_LEAST, rows)
    assert found.outcome is PASS
    assert "no evidence in 2 of 20 logs (log0: no agent there)" in found.reason
    assert verdict(replace(AT_LEAST, max_missing=0.05), rows).outcome is INCONCLUSIVE
    assert verdict(AT_LEAST, rows[:19].iloc[:10]).outcome is INCONCLUSIVE  # 2 of 10
    short = verdict(replace(AT_LEAST, min_logs=19), rows)
    assert short.outcome is INCONCLUSIVE
    assert "; 18 logs judged, 19 must be" in short.reason


@given(st.permutations([-1e6, np.nan, -5.0, 3.0]))
def test_nan_is_a_missing_value(values: list[float]) -> None:
    rows = table(
        *(row(f"log{i}", value, available=True, reason="") for i, value in enumerate(values))
    )
    found = verdict(Gate("gap.min", min=0.0), rows)
    assert (found.outcome, found.value) == (FAIL, -1e6)
    assert "broken in 2 of 3 logs; no evidence in 1 of 4 logs" in found.reason
    assert {log.why for log in found.logs if log.outcome is INCONCLUSIVE} == {
        "the value is not a number"
    }
    alone = verdict(Gate("gap.min", min=0.0), table(row("a", np.nan, available=True)))
    assert alone.outcome is INCONCLUSIVE


def test_a_misspelt_tag_or_planner_does_not_make_an_optional_gate_vanish() -> None:
    rows, tags = table(row("a", 1.0)), {"a": ("pedestrian",)}
    tag = verdict(Gate("gap.min", min=0.5, tags=("pedestrain",), optional=True), rows, tags=tags)
    assert (tag.outcome, tag.reason) == (
        INCONCLUSIVE,
        "nothing to judge: no log has the tags pedestrain, did you mean 'pedestrian'?",
    )
    planner = verdict(Gate("gap.min", min=0.5, planner="dp_pq", optional=True), rows)
    assert planner.outcome is INCONCLUSIVE
    assert "planner dp_pq, did you mean 'dp_qp'?" in planner.reason


# evidence -----------------------------------------------------------------------------------------


def reference(planner: str, value: float, **changes: object) -> dict[str, object]:
    return row("a", value, planner=planner, mode="reference", oracle=True, **changes)


IMPACT = row("a", 4.0, metric="collision_severity.impact_speed.max", unit="m/s")
CONTACT = row("a", 1.0, metric="replay_contact.final", reason="car 7: from behind", unit="1")


@pytest.mark.parametrize(
    ("rows", "outcome", "why"),
    [
        ([], FAIL, "car 7"),
        ([CONTACT], INCONCLUSIVE, "the replay ran into the ego (car 7: from behind)"),
        ([CONTACT | {"reason": "car 8: from behind"}], FAIL, "car 7"),
        ([CONTACT | {"value": 0.0, "reason": ""}], FAIL, "car 7"),
        (
            [reference("careful", 0.2)],
            INCONCLUSIVE,
            "the careful driver breaks gap.min >= 0.5 too: 0.2 m (car 7)",
        ),
        ([reference("careful", 0.2, reason="car 8")], FAIL, "car 7"),
        ([reference("careful", 0.2, time_s=9.0)], FAIL, "car 7"),
        ([reference("careful", 0.2, time_s=np.nan)], FAIL, "car 7"),
        ([reference("careful", 0.4)], FAIL, "car 7"),  # 0.4 m below the bound, and not 0.1 m
        (
            [reference("careful", 0.2), IMPACT, reference("careful", 3.5, metric=IMPACT["metric"])],
            INCONCLUSIVE,
            "the careful driver breaks gap.min >= 0.5 too: 0.2 m (car 7)",
        ),
        (
            [reference("careful", 0.2), IMPACT, reference("careful", 1.0, metric=IMPACT["metric"])],
            FAIL,
            "car 7",
        ),
        ([reference("careful", 0.2), IMPACT], FAIL, "car 7"),
        ([reference("careful", 0.6)], FAIL, "car 7"),
        (
            [reference("driver", 0.0)],
            INCONCLUSIVE,
            "the recorded driver breaks gap.min >= 0.5 too: 0 m (car 7)",
        ),
        ([reference("driver", 0.0, reason="car 3")], FAIL, "car 7"),  # another road user
        ([reference("driver", 0.0, time_s=13.1)], FAIL, "car 7"),  # another time
        ([reference("driver", 0.5)], FAIL, "car 7"),
    ],
)
def test_a_broken_bound_without_evidence_is_inconclusive(
    rows: list[dict[str, object]], outcome: Outcome, why: str
) -> None:
    found = verdict(AT_LEAST, table(row("a", 0.1), *rows))
    assert (found.outcome, found.logs[0].outcome, found.logs[0].why) == (outcome, outcome, why)
    assert found.planner == "dp_qp"


def collision(planner: str, count: float, **changes: object) -> dict[str, object]:
    return reference(planner, count, metric="collision_at_fault.count", unit="count", **changes)


def test_the_careful_driver_excuses_nothing_that_the_follower_avoids() -> None:
    gate = Gate("collision_at_fault.count", max=0.0)
    mine = row("a", 1.0, metric="collision_at_fault.count", unit="count")
    assert verdict(gate, table(mine, collision("careful", 1.0))).outcome is INCONCLUSIVE
    assert (
        verdict(gate, table(mine, collision("careful", 1.0), collision("follower", 1.0))).outcome
        is INCONCLUSIVE
    )
    assert (
        verdict(gate, table(mine, collision("careful", 1.0), collision("follower", 0.0))).outcome
        is FAIL
    )


def test_the_follower_excuses_the_start_of_a_log_only() -> None:
    rule = Gate("lat_accel.max", max=4.0)
    about = {"metric": "lat_accel.max", "unit": "m/s2"}
    near = row("a", 0.5, metric="ttc.min", unit="s")  # so that the follower is asked for
    for time_s, outcome in ((0.3, INCONCLUSIVE), (3.2, FAIL)):
        both = (
            row("a", 5.0, time_s=time_s, **about),
            reference("follower", 5.0, time_s=time_s, **about),
        )
        assert verdict(rule, table(*both, near)).outcome is outcome


def test_a_fallback_is_excused_where_careful_driver_and_follower_come_too_near_at_that_time() -> (
    None
):
    mine = row("a", 0.2, metric="fallback.rate", unit="1")
    near = [reference(name, 0.5, metric="ttc.min", unit="s") for name in ("careful", "follower")]
    rule = Gate("fallback.rate", max=0.01)
    assert verdict(rule, table(mine, *near)).outcome is INCONCLUSIVE
    assert verdict(rule, table(mine, near[0])).outcome is FAIL
    assert verdict(rule, table(mine, near[0], near[1] | {"time_s": 9.0})).outcome is FAIL
    assert verdict(rule, table(mine, near[0], near[1] | {"value": 2.0})).outcome is FAIL


@given(st.floats(0.6, 0.94), st.sampled_from([0.02, 0.1, 0.2]))
def test_a_broken_bound_that_another_sampling_rate_could_mend_is_inconclusive(
    ttc: float, interval: float
) -> None:
    gate = Gate("ttc.min", min=0.95)
    rows = table(
        row("a", ttc, metric="ttc.min", unit="s"),
        row("a", interval, metric="agent_interval.final", unit="s"),
    )
    late = 1.5 * interval
    assert verdict(gate, rows).outcome is (INCONCLUSIVE if 0.95 - ttc <= late else FAIL)


def test_a_verdict_is_the_same_whichever_other_planners_ran() -> None:
    def rows(planner: str, **values: float) -> list[dict[str, object]]:
        return [row("a", value, metric=metric, planner=planner) for metric, value in values.items()]

    gates = Gates((Gate("goal.final", min=1, reachable=True), Gate("gap.min", min=0.5)), "test")
    known = [
        reference("follower", 0.0, metric="goal.final"),
        reference("follower", 0.1),
        reference("careful", 0.2),
    ]
    mine = rows("dp_qp", **{"goal.final": 0.0, "gap.min": 0.1})
    others = rows("idm", **{"goal.final": 1.0, "gap.min": 0.7})

    def judged(*found: dict[str, object]) -> list[Outcome]:
        return [
            v.outcome
            for v in judge(gates, table(*found), {"a": LogLabels()})
            if v.planner == "dp_qp"
        ]

    assert judged(*mine, *known) == judged(*mine, *others, *known)


def test_each_reference_excuses_the_gates_of_its_groups() -> None:
    def judged(metric: str, *rows: dict[str, object]) -> Outcome:
        mine = [
            each | {"metric": metric}
            for each in (row("a", 0.1), reference("driver", 0.0), reference("careful", 0))
        ]
        return verdict(Gate(metric, min=0.5), table(*mine, *rows)).outcome

    assert judged("speed.max", CONTACT) is INCONCLUSIVE
    assert judged("tracking_lateral.max_abs", CONTACT) is FAIL
    assert judged("wrong_way.worst_1s") is INCONCLUSIVE  # so does the recorded driver
    rule = [
        row("a", 2.0, metric="red_light.count"),
        reference("careful", 2.0, metric="red_light.count"),
    ]
    # Who knows no rules excuses none
    assert verdict(Gate("red_light.count", max=0.0), table(*rule)).outcome is FAIL
    assert judged("lon_accel.min", CONTACT) is INCONCLUSIVE  # the careful driver brakes as hard
    assert judged("completed.final") is FAIL
    assert judged("completed.final", CONTACT) is INCONCLUSIVE
    phantom = row("a", 1.0, metric="phantom.count", reason="car 9", unit="count")
    follower = reference("follower", 0.0, metric="goal.final")
    assert judged("goal.final", phantom) is FAIL  # the follower was not stopped by it
    assert judged("goal.final", phantom, follower) is INCONCLUSIVE
    crash = row(
        "a",
        1.0,
        metric="collision_at_fault.count",
        reason="car 7: with the front, at fault",
        unit="count",
    )
    assert judged("completed.final", crash) is FAIL
    careful = reference(
        "careful", 1.0, metric="collision_at_fault.count", reason="car 7: with the front, at fault"
    )
    assert judged("completed.final", crash, careful) is INCONCLUSIVE


@pytest.mark.parametrize("metric", ["completed.final", "goal.final"])
def test_nothing_excuses_a_drive_in_which_the_planner_failed(metric: str) -> None:
    gate, mine = Gate(metric, min=1, reachable=metric == "goal.final"), row("a", 0.0, metric=metric)
    crashed = {("a", "dp_qp", "closed"): "the planner failed at 0.00 s"}
    assert verdict(gate, table(mine, CONTACT), crashed=crashed).outcome is FAIL
    assert verdict(gate, table(mine, CONTACT)).outcome is INCONCLUSIVE


@pytest.mark.parametrize(
    ("mine", "careful", "outcome"),
    [("", "", FAIL), ("car 7a", "car 7b", FAIL), ("car 7a", "car 7a", INCONCLUSIVE)],
)
def test_hard_braking_without_a_road_user_is_not_excused(
    mine: str, careful: str, outcome: Outcome
) -> None:
    """At 3 s, where the careful driver brakes as hard: for nothing, for another car or the same by
    the whole id.
    """
    rows = (
        row("a", 0.1, reason="car 7", about=mine),
        reference("careful", 0.1, reason="car 7", about=careful),
    )
    gate, same = Gate("lon_accel.min", min=0.5), {"metric": "lon_accel.min"}
    assert verdict(gate, table(*(each | same for each in rows))).outcome is outcome
    older = table(*(each | same | {"reason": each["about"]} for each in rows)).drop(columns="about")
    assert verdict(gate, older).outcome is outcome


@pytest.mark.parametrize(
    ("changes", "others", "outcome"),
    [
        ({}, (), INCONCLUSIVE),  # twice as long as the careful driver, who collides
        # The recorded driver needs it not
        ({}, (reference("driver", 0.5, metric="lon_accel.worst_episode"),), FAIL),
        ({}, (reference("driver", 3.0, metric="lon_accel.worst_episode"),), INCONCLUSIVE),
        ({"reason": "car 8"}, (), FAIL),
        ({"time_s": 9.0}, (), FAIL),
        ({"reason": ""}, (), FAIL),
    ],
)
def test_hard_braking_for_a_road_user_that_the_careful_driver_hits_is_excused(
    changes: dict[str, object], others: tuple[dict[str, object], ...], outcome: Outcome
) -> None:
    gate, name = (
        Gate("lon_accel.worst_episode", max=1.0),
        {"metric": "lon_accel.worst_episode", "unit": "s"},
    )
    mine, careful = row("a", 2.0, **{**name, **changes}), reference("careful", 1.02, **name)
    assert (
        verdict(gate, table(mine, careful, collision("careful", 1.0), *others)).outcome is outcome
    )
    assert verdict(gate, table(mine, careful, collision("careful", 0.0), *others)).outcome is FAIL


def test_a_missed_goal_that_a_reference_reaches_fails_with_any_other_planner_in_the_run() -> None:
    gate = Gate("goal.final", min=1, reachable=True, optional=True)

    def judged(value: float, *others: dict[str, object], **references: float) -> Outcome:
        rows = [
            reference(planner, reached, metric="goal.final")
            for planner, reached in references.items()
        ]
        return verdicts(gate, table(row("a", value, metric="goal.final"), *rows, *others))[
            0
        ].outcome

    assert judged(0.0, driver=1.0, careful=0.0) is FAIL
    # Who knows no rules is no yardstick
    assert judged(0.0, driver=0.0, careful=1.0) is INCONCLUSIVE
    assert judged(0.0, follower=1.0) is FAIL
    assert (
        judged(0.0, row("a", 1.0, metric="goal.final", planner="idm"), follower=0.0) is INCONCLUSIVE
    )
    unseen = reference("driver", 0.1, metric="evidence.traffic.share", unit="1")
    # The traffic of its drive was not recorded
    assert judged(0.0, unseen, driver=1.0) is INCONCLUSIVE
    assert judged(0.0, driver=0.0, careful=0.0) is INCONCLUSIVE
    assert judged(0.0) is INCONCLUSIVE
    assert judged(1.0) is PASS
    rules = Gates((gate, Gate("red_light.count", max=0.0)), "test")
    # The follower goes through a red light or not
    for lights, outcome in ((0.0, FAIL), (1.0, INCONCLUSIVE)):
        there = (
            reference("follower", 1.0, metric="goal.final"),
            reference("follower", lights, metric="red_light.count"),
        )
        found = table(
            row("a", 0.0, metric="goal.final"), row("a", 0.0, metric="red_light.count"), *there
        )
        assert judge(rules, found, {"a": LogLabels()})[0].outcome is outcome
    assert judged(np.nan) is Outcome.NOT_ASKED  # its metric says by name why no vehicle reaches it


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.booleans())
def test_a_pass_needs_evidence_and_a_broken_bound_does_not(
    share: float, least: float, broken: bool
) -> None:
    gate = Gate("gap.min", min=0.5, evidence="traffic", min_evidence=least)
    evidence = row(
        "a", share, metric="evidence.traffic.share", reason="traffic is recorded until 0.1 s"
    )
    found = verdict(gate, table(row("a", 0.1 if broken else 0.7), evidence))
    assert found.outcome is (FAIL if broken else PASS if share >= least else INCONCLUSIVE)
    assert (found.outcome is INCONCLUSIVE) == (
        "traffic is recorded until 0.1 s" in found.logs[0].why
    )


def test_gates_not_asked_are_counted_and_can_be_gated() -> None:
    rows = table(
        row("a", 0.7), row("a", np.nan, metric="ttc.min"), row("a", np.nan, metric="asked.share")
    )
    gates = Gates(
        (AT_LEAST, Gate("ttc.min", min=1.0, optional=True), Gate("asked.share", min=0.6)), "test"
    )
    filled = with_asked(rows, gates, {"a": LogLabels()})
    found = judge(gates, filled, {"a": LogLabels()})
    assert [v.outcome for v in found] == [PASS, Outcome.NOT_ASKED, FAIL]
    assert found[1].logs[0].why == "no agent there"
    assert (found[2].value, found[2].logs[0].why) == (0.5, "not asked: ttc.min >= 1")
    assert worst(v.outcome for v in found[:2]) is PASS
    assert worst([Outcome.NOT_ASKED]) is INCONCLUSIVE


def test_outcomes_of_each_log_are_a_table() -> None:
    found = outcomes(verdicts(AT_LEAST, table(row("a", 0.7), row("b", 0.1), row("c", np.nan))))
    assert found[["log", "outcome", "reason"]].values.tolist() == [
        ["a", "pass", "car 7"],
        ["b", "fail", "car 7"],
        ["c", "inconclusive", "no agent there"],
    ]
    assert worst([Outcome(o) for o in found["outcome"]]) is FAIL
    assert worst([PASS, INCONCLUSIVE]) is INCONCLUSIVE
    assert worst([]) is INCONCLUSIVE


def test_tags_select_logs() -> None:
    tags = {"a": ("pedestrian", "rain"), "b": ("pedestrian",), "c": ()}
    rows = table(row("a", 0.6), row("b", 0.2), row("c", 0.1))
    assert verdict(AT_LEAST, rows, tags=tags).log == "c"
    assert verdict(Gate("gap.min", min=0.5, tags=("pedestrian",)), rows, tags=tags).log == "b"
    assert (
        verdict(Gate("gap.min", min=0.5, tags=("rain", "pedestrian")), rows, tags=tags).outcome
        is PASS
    )


def test_a_planner_is_judged_though_a_reference_drive_has_its_name() -> None:
    rows = table(
        row("a", 0.7, planner="parked"),
        row("a", 0.1, planner="parked", mode="reference", oracle=True),
    )
    assert [(found.planner, found.outcome) for found in verdicts(AT_LEAST, rows)] == [
        ("parked", PASS)
    ]


def test_each_planner_and_mode_is_judged_but_oracles_only_if_named() -> None:
    rows = table(
        row("a", 1.0),
        row("a", 0.1, planner="constant_speed"),
        row("a", 0.1, planner="logged", oracle=True),
        row("a", 1.0, mode="open"),
    )
    found = verdicts(AT_LEAST, rows)
    assert [(v.planner, v.mode, v.outcome) for v in found] == [
        ("dp_qp", "closed", PASS),
        ("constant_speed", "closed", FAIL),
        ("dp_qp", "open", PASS),
    ]
    assert verdict(Gate("gap.min", min=0.5, planner="logged"), rows).outcome is FAIL
    only = table(row("a", 1.0, planner="logged", oracle=True))
    assert "a planner that is no oracle" in verdict(AT_LEAST, only).reason


@pytest.mark.parametrize("gate", [AT_LEAST, Gate("gap.min", min=0.5, tags=("x",))])
def test_a_log_that_could_not_be_evaluated_is_not_a_pass(gate: Gate) -> None:
    rows, broken = table(row("a", 1.0)), {"b": "yaw is NaN"}
    found = verdict(gate, rows, tags={"a": ("x",), "b": ("x",)}, failed=broken)
    assert found.outcome is INCONCLUSIVE
    assert found.reason.endswith("; 1 log could not be evaluated (b: yaw is NaN)")
    assert verdict(gate, rows, tags={"a": ("x",)}, failed=broken).outcome is INCONCLUSIVE
    assert verdict(gate, table(row("a", 0.1)), tags={"a": ("x",)}, failed=broken).outcome is FAIL
    assert verdict(gate, table(), tags={}, failed=broken).reason.endswith(
        "b could not be evaluated: yaw is NaN"
    )


def test_a_failed_log_with_other_tags_does_not_matter() -> None:
    gate = Gate("gap.min", min=0.5, tags=("x",))
    assert (
        verdict(
            gate, table(row("a", 1.0)), tags={"a": ("x",), "b": ()}, failed={"b": "broken"}
        ).outcome
        is PASS
    )


def test_a_log_without_any_row_is_missed() -> None:
    rows = table(row("a", 1.0), row("b", 1.0, planner="other"))
    found = {v.planner: v for v in verdicts(AT_LEAST, rows, tags={"a": (), "b": ()})}
    assert found["dp_qp"].outcome is found["other"].outcome is INCONCLUSIVE
    assert found["dp_qp"].reason.endswith("1 log could not be evaluated (b: no result)")


def test_tables_that_were_put_together_keep_their_rows_apart() -> None:
    rows = pd.concat([table(row("a", 1.0)), table(row("b", 0.2)), table(row("c", 0.3))])
    assert verdict(AT_LEAST, rows).log == "b"


def gates(tmp_path: Path, text: str) -> Gates:
    path = tmp_path / "gates.toml"
    path.write_text(text)
    return load_gates(path)


def test_a_file_is_read(tmp_path: Path) -> None:
    found = gates(
        tmp_path,
        '[[gate]]\nmetric = "gap_vulnerable.min"\nmin = 0.5\nmax = 9\nmode = "closed"\ntags = '
        '["pedestrian"]\n'
        'planner = "dp_qp"\nover = "mean"\nmin_logs = 2\nreason = "keep away"\n\n'
        '[[gate]]\nmetric = "qp_iterations.path.max"\nmax = 4000\n[[gate]]\nmetric = '
        '"ade.3s.mean"\nmax = 2\n',
    )
    assert found.source.endswith("gates.toml")
    assert found.gates[0] == Gate(
        "gap_vulnerable.min", 0.5, 9, "closed", ("pedestrian",), "dp_qp", "mean", 2, "keep away"
    )
    assert (
        str(found.gates[0]) == "0.5 <= mean gap_vulnerable.min <= 9 [closed] [pedestrian] [dp_qp]"
    )
    assert [str(gate) for gate in found.gates[1:]] == [
        "qp_iterations.path.max <= 4000",
        "ade.3s.mean <= 2",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '[[gate]]\nmetric = "gap.min"\n',
            r"gates.toml: gate 1 \(gap.min\): has neither min nor max",
        ),
        (
            '[[gate]]\nmetric = "gap.mni"\nmin = 0\n',
            "gate 1 .gap.mni.: no metric has this name, did you mean 'gap.min'",
        ),
        ('[[gate]]\nmetric = "gap"\nmin = 0\n', "no metric has this name"),
        ('[[gate]]\nmetric = "ade.4s.mean"\nmax = 1\n', "did you mean 'ade.[1358]s.mean'"),
        ('[[gate]]\nmetric = "gap.min"\nmim = 0\n', "unknown key 'mim', did you mean 'min'"),
        (
            '[[gate]]\nmetric = "gap.min"\nmin = 0\n[[gate]]\nmax = 1\n',
            "gate 2: .*missing required field `metric`",
        ),
        ('[[gate]]\nmetric = "gap.min"\nmin = nan\n', "not finite"),
        ('[[gate]]\nmetric = "gap.min"\nmin = 2\nmax = 1\n', "min 2 is above max 1"),
        ('[[gate]]\nmetric = "gap.min"\nmin = 0\nmode = "close"\n', "mode is 'close'"),
        ('[[gate]]\nmetric = "gap.min"\nmin = 0\nover = "best"\n', "over is 'best'"),
        ('[[gate]]\nmetric = "gap.min"\nmin = 0\nmin_logs = 0\n', "nothing to judge is no pass"),
        (
            '[[gate]]\nmetric = "gap.min"\nmin = 0\nmax_missing = 1.0\n',
            "not a share of at least 0 and below 1",
        ),
        ('[[gate]]\nmetric = "gap.min"\nmin = 0\nbroken = "pass"\n', "broken is 'pass'"),
        ('[[gates]]\nmetric = "gap.min"\nmin = 0\n', "unknown key 'gates', did you mean 'gate'"),
        ("", "holds no"),
        ('gate = "gap"', "holds no"),
        ("[[gate]\n", "not TOML"),
    ],
)
def test_a_bad_file_gives_one_line_with_its_name(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        gates(tmp_path, text)
    assert "gates.toml" in str(error.value)
    assert "\n" not in str(error.value)
    assert not isinstance(error.value, LogError)


def test_gates_of_safety_are_those_of_the_default() -> None:
    safety, every = load_gates(PACKAGED["safety"]).gates, load_gates(None).gates
    assert len(safety) > 15 and set(safety) < set(every)


def test_gates_on_metrics_of_users(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text('[[gate]]\nmetric = "mine.min"\nmin = 0\n')
    mine = {"mine": replace(METRICS["gap"], name="mine")}
    assert len(load_gates(tmp_path / "mine.toml", metrics=mine).gates) == 1


# the default --------------------------------------------------------------------------------------


def test_the_default_gates_judge_any_closed_loop_drive() -> None:
    """Whatever a log lacks (others, lanes, goal), none of them but those on plans is left without a
    value by it.
    """
    default = load_gates(None)
    needs_plans = ("plan_", "fallback")
    log = scenario(along(grid(3.0), 10.0))
    found = judge(default, evaluate(drive(log), log), {log.name: LogLabels()})
    assert {gate for gate in default.gates if not gate.optional and gate.mode != "open"} <= {
        v.gate for v in found
    }
    for each in found:
        if not each.gate.metric.startswith(needs_plans):
            assert each.outcome in ((PASS, Outcome.NOT_ASKED) if each.gate.optional else (PASS,)), (
                each.reason
            )
        else:
            assert each.outcome is (Outcome.NOT_ASKED if each.gate.optional else INCONCLUSIVE)
        assert each.gate.reason
