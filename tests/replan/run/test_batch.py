"""Many logs: the same bytes whatever the number of workers; what fails costs only itself."""

import csv
import signal
import tempfile
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given, strategies as st
from short_logs import QUICK, identical, run, short
from worker_tasks import square_of

from replan.config import load_run
from replan.core.errors import ConfigError, PlannerError
from replan.logs.mcap import write_scenario
from replan.logs.readers import LogSettings
from replan.metrics.judge.gates import Outcome
from replan.replay.loop_config import PlannerProcessConfig
from replan.results.tables import LONGEST_SAFE, is_formula, numbered, safe_name, write_csv
from replan.run import evaluate_logs
from replan.run.claim import RUN
from replan.run.judging import exit_code_of
from replan.run.one_log import Failure
from replan.run.pool import WorkerLost, run_all
from replan.run.sources import select

REFERENCES = "driver", "careful", "parked", "creeping", "blind"
PLANNERS = '''
import os, signal
from replan.planners.constant_speed import ConstantSpeed

class Killed(ConstantSpeed):
    """Kills its process where anybody else is in the scene."""
    def plan(self, frame):
        if len(frame.agents):
            os.kill(os.getpid(), signal.SIGKILL)
        return super().plan(frame)

class Raising(ConstantSpeed):
    def plan(self, frame):
        if frame.t > 0.5:
            raise RuntimeError("out of ideas")
        return super().plan(frame)

class Leaving(ConstantSpeed):
    def plan(self, frame):
        raise SystemExit(0)
'''


@pytest.fixture
def planners(module: Callable[[str, str], str]) -> str:
    """Name of a module of planners that misbehave."""
    return module("misbehaving", PLANNERS)


@pytest.mark.slow  # .ci/run compares two runs of the whole suite
def test_two_runs_and_any_number_of_workers_give_the_same_bytes(logs: Path, tmp_path: Path) -> None:
    config = replace(QUICK, planners=("constant_speed", "dp_qp"))
    outs = [
        run(logs, tmp_path / str(i), config, workers=workers).path
        for i, workers in enumerate((0, 0, 2))
    ]
    assert len(list(outs[0].glob("*/*.mcap"))) == 3 * 4
    assert identical(outs[0], outs[1])
    assert identical(outs[0], outs[2])


def test_the_order_of_the_logs_changes_nothing_but_the_order_of_the_report(
    logs: Path, tmp_path: Path
) -> None:
    files = [logs / "a.mcap", logs / "b.mcap"]
    one, other = run(files, tmp_path / "one"), run(files[::-1], tmp_path / "other")
    assert identical(one.path, other.path)
    assert list(one.logs["log"]) == list(other.logs["log"])[::-1]


def test_tables_hold_every_log_planner_and_mode_sorted(logs: Path, tmp_path: Path) -> None:
    result = run(logs, tmp_path / "out", replace(QUICK, planners=("logged", "constant_speed")))
    table = pq.read_table(result.path / "metrics.parquet")
    assert table.schema.metadata[b"replan_schema_version"] == b"1"
    rows = table.to_pandas()
    assert set(rows["schema_version"]) == {1}
    keys = list(zip(rows["log"], rows["planner"], rows["mode"], rows["metric"], strict=True))
    assert keys == sorted(keys)
    assert len(set(keys)) == len(keys)
    assert {key[:3] for key in keys} == {
        (f"test/{log}", planner, mode)
        for log in "abc"
        for planner in ("logged", "constant_speed")
        for mode in ("open", "closed")
    } | {(f"test/{log}", planner, "reference") for log in "abc" for planner in REFERENCES}
    assert rows.loc[rows["planner"] == "logged", "oracle"].all()
    assert (
        rows.loc[(rows["planner"] == "logged") & (rows["metric"] == "ade.1s.mean"), "value"] == 0.0
    ).all()
    csv = pd.read_csv(result.path / "metrics.csv")
    np.testing.assert_array_equal(csv["value"], rows["value"])
    timings = pd.read_parquet(result.path / "timings.parquet")
    assert (timings["seconds"] > 0.0).all()
    assert set(timings.columns) == {"log", "planner", "mode", "t_s", "stage", "seconds"}


def test_the_resolved_configuration_runs_the_same_again(logs: Path, tmp_path: Path) -> None:
    first = run(
        logs / "a.mcap",
        tmp_path / "one",
        replace(QUICK, planner={"constant_speed": {"horizon_s": 3.0}}),
    )
    again = run(logs / "a.mcap", tmp_path / "two", load_run(first.path / "run.toml"))
    assert identical(first.path, again.path)
    assert again.run.planner["constant_speed"] == {"horizon_s": 3.0, "step_s": 0.1}


def test_a_bad_log_is_one_failure_and_the_others_are_evaluated(logs: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes((logs / "a.mcap").read_bytes()[:400])
    result = run([bad, logs / "b.mcap"], tmp_path / "out")
    assert [failure.log for failure in result.failures.itertuples()] == [str(bad)]
    assert str(bad) in result.failures.iloc[0].message
    assert not result.summary["failures"][0]["traceback"]
    assert {drive.log for drive in result.drives.itertuples()} == {"test/b"}
    assert result.exit_code == 3


def test_when_nothing_can_be_evaluated_the_tables_are_empty_and_nothing_passes(
    tmp_path: Path,
) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"no log at all")
    result = run(bad, tmp_path / "out")
    assert result.exit_code == 3
    assert set(result.gates["outcome"]) == {"inconclusive"}
    assert len(pd.read_parquet(tmp_path / "out" / "metrics.parquet")) == 0


@pytest.mark.slow
def test_a_killed_planner_costs_its_drives_only(logs: Path, tmp_path: Path, planners: str) -> None:
    result = run(
        logs, tmp_path / "out", replace(QUICK, planners=(f"{planners}:Killed", "logged")), workers=2
    )
    assert [failure.log for failure in result.failures.itertuples()] == ["test/b", "test/b"]
    assert all(
        "was killed (SIGKILL)" in failure.message for failure in result.failures.itertuples()
    )
    assert len(result.drives) == 12 and result.exit_code == 3


@pytest.mark.slow
def test_a_killed_worker_costs_its_log_only(logs: Path, tmp_path: Path, planners: str) -> None:
    """Of a planner that is trusted, so that it takes the worker along."""
    trusted = replace(QUICK.loop, apart=PlannerProcessConfig(trust=True))
    config = replace(QUICK, planners=(f"{planners}:Killed",), loop=trusted)
    result = run(logs, tmp_path / "out", config, workers=2)
    assert [Path(failure.log).name for failure in result.failures.itertuples()] == ["b.mcap"]
    assert "SIGKILL" in result.failures.iloc[0].message
    assert {drive.log for drive in result.drives.itertuples()} == {"test/a", "test/c"}
    assert result.exit_code == 3
    assert not list(result.path.rglob(".partial*"))


def test_a_planner_that_raises_is_a_failure_that_names_it(
    logs: Path, tmp_path: Path, planners: str
) -> None:
    said = {f"{planners}:Raising": "out of ideas", f"{planners}:Leaving": "SystemExit"}
    result = run(
        logs / "a.mcap", tmp_path / "out", replace(QUICK, planners=("constant_speed", *said))
    )
    failures = list(result.failures.itertuples())
    assert {(one.planner, one.mode) for one in failures} == {*product(said, ("open", "closed"))}
    assert all(said[one.planner] in one.message and one.planner in one.message for one in failures)
    assert result.exit_code == 3 and len(failures) == 4
    assert "constant_speed" in set(result.metrics["planner"])


@pytest.mark.slow
def test_a_planner_that_cannot_be_loaded_leaves_the_others(logs: Path, tmp_path: Path) -> None:
    result = run(
        logs / "a.mcap",
        tmp_path / "out",
        replace(QUICK, planners=("nowhere:Mine", "constant_speed")),
    )
    assert result.run.planners == ("constant_speed",)
    assert "nowhere" in result.failures.iloc[0].message
    assert result.exit_code == 3
    with pytest.raises(PlannerError, match="nowhere"):
        run(logs / "a.mcap", tmp_path / "other", replace(QUICK, planners=("nowhere:Mine",)))


def test_a_second_log_of_one_name_gets_its_digest_and_the_first_keeps_the_name(
    logs: Path, tmp_path: Path
) -> None:
    for i, v in enumerate((9.0, 10.0)):
        write_scenario(tmp_path / f"{i}.mcap", short("same", v=v))
    result = run([tmp_path / "0.mcap", tmp_path / "1.mcap"], tmp_path / "out")
    names = [log.log for log in result.logs.itertuples()]
    assert names == ["same", f"same@{result.logs['sha256'][1][:8]}"]
    assert set(result.metrics["log"]) == set(names)
    assert len({log.folder for log in result.logs.itertuples()}) == 2


@given(
    failures=st.lists(st.sampled_from([2, 3]), max_size=3),
    outcomes=st.lists(st.sampled_from(list(Outcome)), max_size=4),
)
def test_exit_codes_three_beats_one_beats_four(
    failures: list[int], outcomes: list[Outcome]
) -> None:
    wrong = [Failure("log", "wrong", exit_code=code) for code in failures]
    code = exit_code_of(wrong, outcomes)
    assert exit_code_of(wrong, None) == (min(failures) if failures else 0)
    if failures:
        assert code == min(failures)
    elif Outcome.FAIL in outcomes:
        assert code == 1
    else:
        assert code == (0 if set(outcomes) - {Outcome.NOT_ASKED} == {Outcome.PASS} else 4)


def test_folders_are_searched_and_what_is_left_out_is_said(logs: Path, tmp_path: Path) -> None:
    deep = tmp_path / "deep" / "deeper"
    deep.mkdir(parents=True)
    (deep / "a.mcap").write_bytes((logs / "a.mcap").read_bytes())
    (deep / "twin.mcap").write_bytes((logs / "a.mcap").read_bytes())
    (deep / ".hidden.mcap").write_bytes(b"")
    (deep / "pom.xml").write_text("<project/>", encoding="utf-8")
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "log.json").write_text("{}", encoding="utf-8")
    (tmp_path / "results" / "closed.mcap").write_bytes(b"")
    selection = select([tmp_path])
    assert [source.path for source in selection.sources] == [deep / "a.mcap"]
    for word in ("same log", "hidden", "no reader recognises", "earlier run"):
        assert any(word in reason for reason in selection.dropped)
    assert "5 found, 1 kept" in str(selection)


def test_an_empty_selection_says_what_was_looked_for(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"no logs in this folder; looked for CommonRoad \*\.xml"):
        select([tmp_path])
    (tmp_path / ".hidden.mcap").write_bytes(b"")
    with pytest.raises(ConfigError, match=r"1 found, 0 kept; left out .*hidden"):
        select([tmp_path])
    with pytest.raises(ConfigError, match="no such file or folder"):
        select([tmp_path / "nowhere"])
    (tmp_path / "notes.txt").write_text("", encoding="utf-8")
    with pytest.raises(ConfigError, match="not a log that replan reads"):
        select([tmp_path / "notes.txt"])


def test_a_folder_of_somebody_else_is_never_written_to(logs: Path, tmp_path: Path) -> None:
    mine = tmp_path / "thesis.tex"
    mine.write_text("", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"thesis\.tex"):
        run(logs / "a.mcap", tmp_path)
    assert list(tmp_path.iterdir()) == [mine]
    config = tmp_path / "exp" / "run.toml"
    config.parent.mkdir()
    config.write_text('mode = "open"', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"run\.toml"):
        RUN.check(config.parent)


def test_results_of_an_earlier_run_are_replaced(logs: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run(logs, out)
    again = run(logs / "a.mcap", out)
    assert [path.name for path in out.iterdir() if path.is_dir()] == [again.logs.iloc[0].folder]


def test_a_result_folder_that_holds_the_log_is_not_cleared(logs: Path, tmp_path: Path) -> None:
    evaluate_logs([logs / "a.mcap"], replace(QUICK, mode="closed"), tmp_path / "out")
    (trace,) = (tmp_path / "out").glob("*/closed.mcap")
    with pytest.raises(
        ConfigError, match=r"closed\.mcap: lies in the result folder .*out, which is cleared"
    ):
        evaluate_logs([trace], QUICK, tmp_path / "out")
    assert trace.exists()


def test_the_builtin_suite_takes_no_settings_of_logs(tmp_path: Path) -> None:
    for asked, window in ((QUICK, 2.0), (replace(QUICK, log=LogSettings(ego="17")), None)):
        with pytest.raises(ConfigError, match="built-in suite"):
            evaluate_logs([], asked, tmp_path / "out", window=window)
    assert not (tmp_path / "out").exists()


@given(name=st.text(max_size=200))
def test_safe_names_are_safe(name: str) -> None:
    safe = safe_name(name, "0123456789")
    assert safe.endswith("-01234567")
    assert len(safe) <= 89
    assert Path(safe).name == safe
    assert safe.isascii()
    assert safe_name(safe) == safe
    assert safe_name(safe_name(name)) == safe_name(name)


@given(text=st.text(alphabet="ab_.-0123456789", min_size=1, max_size=150), digit=st.integers(0, 9))
def test_a_name_that_is_cut_stays_distinct(text: str, digit: int) -> None:
    """The rest of a long name is in a hash; a name that fits is its own file name."""
    names = [f"x{text}{digit}", f"x{text}{(digit + 1) % 10}"]
    files = [safe_name(name) for name in names]
    assert files[0] != files[1]
    assert all(len(file) <= LONGEST_SAFE for file in files)
    assert all(
        file == name for file, name in zip(files, names, strict=True) if len(name) <= LONGEST_SAFE
    )


@given(texts=st.lists(st.text(st.sampled_from("=+-@1.e a'\t"), max_size=4) | st.none(), min_size=1))
def test_no_cell_of_csv_is_a_formula_and_all_others_stay(texts: list[str | None]) -> None:
    """A spreadsheet calculates what begins with a sign and is no number."""
    table = pd.DataFrame({"log": pd.Series(texts, dtype=object), "value": -1.5})
    with tempfile.TemporaryDirectory() as folder:
        write_csv(Path(folder, "table.csv"), table)
        with Path(folder, "table.csv").open(encoding="utf-8", newline="") as stream:
            cells = [row["log"] for row in csv.DictReader(stream)]
    for text, cell in zip(texts, cells, strict=True):
        assert not is_formula(cell)
        assert cell == (f"'{text}" if is_formula(text) else text or "")


@given(names=st.lists(st.sampled_from(["a", "a-2", "a-3", "b"]), max_size=8))
def test_numbered_names_differ_and_first_ones_stay(names: list[str]) -> None:
    numbers = list(numbered(names))
    assert len(set(numbers)) == len(names)
    assert not names or numbers[0] == names[0]


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals of POSIX")
def test_a_worker_that_is_interrupted_as_it_imports_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C reaches all processes of the terminal; the parent decides."""
    (tmp_path / "interrupted_import.py").write_text(
        "import multiprocessing, os, signal\n"
        "if multiprocessing.parent_process() is not None:\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "def double(item):\n    return 2 * item\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    double = import_module("interrupted_import").double
    assert list(run_all(double, [21], 1)) == [(0, 42)]


@pytest.mark.slow
def test_the_pool_gives_every_item_once_and_survives_deaths() -> None:
    items = [1, 13, 2, 3, 13, 4]
    answers = dict(run_all(square_of, items, 2))
    assert sorted(answers) == list(range(len(items)))
    for index, item in enumerate(items):
        assert (
            isinstance(answers[index], WorkerLost) if item == 13 else answers[index] == item * item
        )
