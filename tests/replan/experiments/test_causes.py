"""From passing changes to a cause, the table of changes, and the smallest change of a setting."""

from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from replan.config import RunConfig, load_run
from replan.core.errors import ConfigError
from replan.experiments.changes import (
    NOT_FOUND,
    RANKS,
    UNAVOIDABLE,
    ChangedRun,
    TriedChange,
    cause_of,
    changed_runs,
    driven,
    load_changes,
)
from replan.experiments.remedy import STEPS, distance, smallest_change
from replan.experiments.space import Setting, Value

CAUSES = ("prediction", "control", "latency")
RUN = driven(RunConfig(), "dp_qp")


@st.composite
def changed(draw: st.DrawFn) -> list[ChangedRun]:
    """Changes of some keys, every one of other keys."""
    keys = draw(
        st.lists(
            st.frozensets(st.sampled_from("abcd"), min_size=1), unique=True, min_size=1, max_size=6
        )
    )
    return [
        ChangedRun(
            TriedChange(
                f"c{i}", "", draw(st.sampled_from(CAUSES)), draw(st.sampled_from(RANKS)), ("a",)
            ),
            RUN,
            frozenset((key, "1") for key in some),
        )
        for i, some in enumerate(keys)
    ]


@given(changed(), st.data())
def test_a_cause_is_named_by_least_changes_that_pass(
    runs: list[ChangedRun], data: st.DataObject
) -> None:
    passing = set(data.draw(st.lists(st.sampled_from([run.change.name for run in runs]))))
    cause = cause_of(runs, passing)
    known = {run.change.name: run for run in runs}
    assert (cause.name == NOT_FOUND) == (not passing)
    assert set(cause.changes) <= passing
    named = [known[name].change for name in cause.changes]
    assert len({change.rank for change in named}) <= 1
    assert not passing or set(cause.name.split(" or ")) == {change.cause for change in named}
    for name in cause.changes:
        parts = [known[other] for other in passing if known[other].is_part_of(known[name])]
        assert {part.change.cause for part in parts} <= {known[name].change.cause}
    assert set(cause_of(runs[::-1], passing).changes) == set(cause.changes)


@given(changed())
def test_a_fragile_drive_has_no_cause_and_unavoidable_is_where_nothing_passes(
    runs: list[ChangedRun],
) -> None:
    everything = [run.change.name for run in runs]
    assert cause_of(runs, everything, ["tiny"]).name == NOT_FOUND
    assert cause_of(runs, (), avoidable=False).name == UNAVOIDABLE
    assert cause_of(runs, everything, avoidable=False).name != UNAVOIDABLE


def test_a_change_is_tried_where_it_makes_another_run_and_once() -> None:
    names = [run.change.name for run in changed_runs(load_changes(), RUN)[0]]
    assert names == [
        "true_futures",
        "perfect_car",
        "replayed_traffic",
        "reactive_traffic",
        "other_solver",
        "hard_limits_dp_qp",
    ]
    late = load_run(
        None,
        {
            "planners": ["idm"],
            "mode": "closed",
            "loop": {"plan_delay_s": 0.3, "perception": "sensor"},
        },
    )
    changed, refused = changed_runs(load_changes(), driven(late, "idm"))
    runs = {run.change.name: run for run in changed}
    assert runs["no_latency"].keys == {("loop.plan_delay_s", "0.0")} and not refused
    assert runs["replayed_traffic"].is_part_of(runs["true_futures"]) and "hard_limits_idm" in runs
    assert "true_objects" not in runs, "the same run as with the default perception"


def test_a_change_that_a_run_refuses_is_named_with_the_reason() -> None:
    row = TriedChange(
        "worse", "worse", "decision", "ideal", set={"planner": {"dp_qp": {"no_such_key": 1.0}}}
    )
    changed, refused = changed_runs([row], RUN)
    assert not changed and "no_such_key" in refused["worse"]


ROW = (
    '[[change]]\nname = "{0}"\nwords = "so"\ncause = "prediction"\nrank = "{1}"\nset.loop = {{ '
    'traffic = "time" }}\n'
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            ROW.format("mine", "worst"),
            "rank is one of default, ideal, limits, got 'worst'",
        ),
        (ROW.format("a/b", "ideal"), "must be valid for a folder"),
        (ROW.format("true_futures", "ideal"), "two changes are called 'true_futures'"),
        ('[[changes]]\nname = "mine"\n', "holds rows [[change]] and nothing else"),
        (ROW.format("mine", "ideal") + "colour = 1\n", "colour"),
    ],
)
def test_a_wrong_row_is_refused_by_name(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "changes.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as refused:
        load_changes(tmp_path / "changes.toml")
    assert message in str(refused.value) and "changes.toml" in str(refused.value)


@given(st.floats(0.02, 0.98), st.booleans(), st.booleans())
def test_the_smallest_change_is_within_a_step_of_where_drives_pass(
    share: float, along: bool, upward: bool
) -> None:
    setting = Setting(("planner", "idm", "time_gap_s"), 1.0 if upward else 4.0, 1.0, 4.0, log=along)
    asked: list[Value] = []

    def passes(one: Setting, value: Value) -> bool:
        asked.append(value)
        return distance(one, value) >= share

    change = smallest_change([setting], passes)
    assert change is not None and change[2] == distance(setting, change[1])
    assert share <= change[2] <= share + 0.5**STEPS + 1e-5, "rounded to six digits"
    assert len(asked) <= 2 + STEPS


def test_of_several_settings_the_nearest_is_taken_and_whole_numbers_stay_whole() -> None:
    knots = Setting(("planner", "dp_qp", "path", "qp", "knots"), 80, 40, 200)
    solver = Setting(("planner", "dp_qp", "solver"), "osqp", choices=("osqp", "piqp"))
    change = smallest_change([solver, knots], lambda one, value: one is solver or int(value) >= 97)
    assert (
        change is not None
        and change[0] is knots
        and isinstance(change[1], int)
        and 97 <= change[1] <= 99
    )
    assert smallest_change([knots], lambda one, value: False) is None
