"""Gates over many logs: mean, median, sum, share of passes, by family, tag and dataset; what is lost counts against."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from logs.errors import ConfigError
from metrics import COLUMNS
from metrics.judge import Verdict, judge, outcomes
from metrics.judge.aggregate import LogLabels, wilson
from metrics.judge.gates import Gate, Gates, Outcome, load_gates

PASS, FAIL, INCONCLUSIVE = Outcome.PASS, Outcome.FAIL, Outcome.INCONCLUSIVE
GAP = "gap.min"
DRIVEN = "coverage.driven_s.final"


def table(values: dict[str, float | None], metric: str = GAP) -> pd.DataFrame:
    """A row per log; None: it has no value."""
    rows = [
        {"log": log, "planner": "dp_qp", "mode": "closed", "oracle": False, "metric": metric, "unit": "m",
         "value": np.nan if value is None else value, "available": value is not None, "reason": "", "time_s": 3.2}
        for log, value in values.items()
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=list(COLUMNS))


def verdicts(
    gate: Gate, values: dict[str, float | None], labels: dict[str, LogLabels] | None = None, lost: tuple[str, ...] = ()
) -> tuple[Verdict, ...]:
    known = labels or dict.fromkeys(values, LogLabels())
    return judge(Gates((gate,), "test"), table(values, gate.metric), known, failed=dict.fromkeys(lost, "broken"))


def verdict(gate: Gate, values: dict[str, float | None], **how: object) -> Verdict:
    (only,) = verdicts(gate, values, **how)  # type: ignore[arg-type]
    return only


def share(least: float, *, confident: bool = False, max_missing: float = 0.5) -> Gate:
    return Gate(GAP, min=0.5, over="pass_share", min_share=least, confident=confident, max_missing=max_missing)


# one value over the logs ------------------------------------------------------------------------------------------


@given(st.lists(st.floats(0.0, 1e3), min_size=1, max_size=9), st.sampled_from(["mean", "median", "sum"]))
def test_only_what_the_logs_make_together_must_hold(values: list[float], over: str) -> None:
    expected = float({"mean": np.mean, "median": np.median, "sum": np.sum}[over](values))
    logs = {f"log{i}": value for i, value in enumerate(values)}
    below, above = (verdict(Gate(GAP, min=expected + step, over=over), logs) for step in (-1.0, 1.0))
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


# share of passes --------------------------------------------------------------------------------------------------


@given(st.integers(0, 8), st.integers(0, 8), st.integers(0, 4), st.integers(0, 4), st.floats(0.01, 1.0))
def test_what_is_lost_counts_as_failed_and_what_is_inconclusive_as_neither(
    good: int, bad: int, unsure: int, lost: int, least: float
) -> None:
    values: dict[str, float | None] = {f"good{i}": 1.0 for i in range(good)}
    values |= {f"bad{i}": 0.0 for i in range(bad)} | {f"unsure{i}": None for i in range(unsure)}
    if not good + bad:
        return
    found = verdict(share(least, max_missing=0.999), values, lost=tuple(f"lost{i}" for i in range(lost)))
    n = good + bad + unsure + lost
    assert found.value == good / n
    if (good + unsure) / n < least:
        assert found.outcome is FAIL
    else:
        assert found.outcome is (PASS if good / n >= least else INCONCLUSIVE)
    assert f"{good} of {n} log" in found.reason
    as_failed = verdict(share(least, max_missing=0.999), values | {f"lost{i}": 0.0 for i in range(lost)})
    assert (as_failed.outcome, as_failed.value) == (found.outcome, found.value)


@pytest.mark.parametrize("gate", [Gate(GAP, min=0.5), Gate(GAP, min=0.5, over="mean"), share(0.9)])
def test_a_drive_that_crashed_can_fail_and_not_pass(gate: Gate) -> None:
    crashed = {("a", "dp_qp", "closed"): "out of ideas"}
    labels = {"a": LogLabels(), "b": LogLabels()}
    good, bad = (judge(Gates((gate,), "test"), table({"a": value, "b": 1.0}), labels, crashed=crashed)[0]
                 for value in (1.0, -1.0))  # fmt: skip
    assert good.outcome is (FAIL if gate.over == "pass_share" else INCONCLUSIVE)
    assert "1 log could not be evaluated (a: out of ideas)" in good.reason
    assert bad.outcome is FAIL


def test_too_many_without_evidence_are_no_pass_of_a_share() -> None:
    values: dict[str, float | None] = {f"log{i}": 1.0 if i < 8 else None for i in range(10)}
    assert verdict(share(0.5, max_missing=0.2), values).outcome is PASS
    assert verdict(share(0.5, max_missing=0.1), values).outcome is INCONCLUSIVE


@pytest.mark.parametrize(("n", "outcome"), [(72, INCONCLUSIVE), (73, PASS)])
def test_to_be_sure_of_95_percent_takes_73_passes(n: int, outcome: Outcome) -> None:
    found = verdict(share(0.95, confident=True), {f"log{i}": 1.0 for i in range(n)})
    assert found.outcome is outcome
    assert (wilson(n, n)[0] >= 0.95) == (outcome is PASS)
    assert ("not surely" in found.reason) == (outcome is INCONCLUSIVE)


def test_a_share_that_fails_names_interval_and_worst_log() -> None:
    found = verdict(share(0.95), {"a": 1.0, "b": 0.25, "c": 0.75, "d": 2.0})
    assert found.outcome is FAIL
    assert found.reason == (
        "dp_qp, closed loop: gap.min >= 0.5 holds in 3 of 4 logs (75 %, 95 % interval 30.1 to 95.4 %), below 95 %;"
        " worst 0.25 m on b at 3.20 s"
    )
    assert str(found.gate) == "gap.min >= 0.5 in 95 % of logs"


# which logs -------------------------------------------------------------------------------------------------------

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
def test_families_and_datasets_select_logs(filters: dict[str, tuple[str, ...]], logs: list[str]) -> None:
    found = verdict(Gate(GAP, min=0.5, **filters), VALUES, labels=LABELS)  # type: ignore[arg-type]
    assert [log.log for log in found.logs] == logs


def test_a_misspelt_family_is_inconclusive_and_says_so() -> None:
    found = verdict(Gate(GAP, min=0.5, families=("cut_on",), optional=True), VALUES, labels=LABELS)
    assert (found.outcome, found.reason) == (
        INCONCLUSIVE,
        "nothing to judge: no log has the families cut_on, did you mean 'cut_in'?",
    )


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


def test_a_log_that_could_not_be_read_is_in_a_group_of_its_own() -> None:
    found = verdicts(Gate(GAP, min=0.1, per="family"), VALUES, labels=LABELS, lost=("broken",))
    assert {v.group: v.outcome for v in found} == {
        "family cut_in": PASS, "family merge": PASS, "family not known": INCONCLUSIVE,
    }  # fmt: skip


def test_the_page_of_gates_has_every_key_and_no_other() -> None:
    page = (Path(__file__).parents[2] / "docs" / "gates.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1] for line in page.partition("| key |")[2].partition("## ")[0].splitlines()[2:] if line]
    assert {word for row in rows for word in re.findall(r"`(\w+)`", row)} == {field.name for field in fields(Gate)}


# files ------------------------------------------------------------------------------------------------------------


def test_a_file_may_ask_all_of_it(tmp_path: Path) -> None:
    path = tmp_path / "gates.toml"
    path.write_text(
        f'[[gate]]\nmetric = "{DRIVEN}"\nover = "sum"\nmin = 3600\n'
        '[[gate]]\nmetric = "gap.min"\nmin = 0.5\nover = "pass_share"\nmin_share = 0.95\nconfident = true\n'
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
def test_what_makes_no_sense_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "gates.toml"
    path.write_text(f'[[gate]]\nmetric = "gap.min"\nmin = 0.5\n{text}\n')
    with pytest.raises(ConfigError, match=message):
        load_gates(path)
