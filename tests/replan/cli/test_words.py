"""The command line for people and scripts: lists, JSON on stdout, quiet and verbose, progress,
completion, speed.
"""

import json
import os
import subprocess
import sys
from dataclasses import replace
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from threading import Event
from typing import Any

import pytest
from command_line import evaluate, one_error, replan
from hypothesis import given, strategies as st

from replan.cli.listing import KINDS, entries
from replan.cli.options import complete_setting, names
from replan.cli.progress_bar import LEAST_S, Pace, progress, sign_of_life, with_kernels
from replan.core.kernel import is_cache_cold
from replan.draw.charts.layout import CHARTS
from replan.logs.catalogue import FAMILIES, SUITES
from replan.logs.readers import readers
from replan.logs.vehicle import vehicle_names
from replan.metrics import METRICS
from replan.replay.parts import CONTROLLER, PERCEPTION, PLANNER, PREDICTION, TRAFFIC, VEHICLE
from replan.results.log_result import LogResult

ROOT = Path(__file__).parents[3]
TABLES = {
    "planners": PLANNER.builtin,
    "controllers": CONTROLLER.builtin,
    "vehicles": VEHICLE.builtin,
    "cars": vehicle_names(),
    "traffic": TRAFFIC.builtin,
    "predictions": PREDICTION.builtin,
    "perceptions": PERCEPTION.builtin,
    "charts": CHARTS,
    "metrics": METRICS,
    "families": FAMILIES,
    "suites": SUITES,
    "readers": [reader.name for reader in readers()],
}


def python(*words: str, **env: str) -> subprocess.CompletedProcess[str]:
    places = {**os.environ, **env}
    return subprocess.run(
        [sys.executable, *words], env=places, capture_output=True, text=True, check=False
    )


def test_every_name_of_every_table_is_listed_with_a_line_and_a_place() -> None:
    assert KINDS.keys() == TABLES.keys()
    for kind, names_of in TABLES.items():
        found = entries(kind)
        assert [one.name for one in found] == list(names_of)
        for one in found:
            assert one.says.strip(), one
            assert "\n" not in one.says
            module, _, line = one.where.partition(":")
            if module.endswith(".toml"):
                source = ROOT / module.removeprefix("replan/")
            else:
                source = Path(str(find_spec(module).origin))  # type: ignore[union-attr]
            text = source.read_text(encoding="utf-8").splitlines()
            assert not line or text[int(line) - 1].lstrip().startswith(
                ("def ", "class ", "@", '"', "lambda ")
            ), one


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("list",), lambda said: said["planners"][0]["name"] == "dp_qp"),
        (("list", "cars"), lambda said: [one["name"] for one in said] == list(vehicle_names())),
        (("metrics",), lambda said: [one["name"] for one in said] == list(METRICS)),
        (("metrics", "gap"), lambda said: said["unit"] == "m" and "min" in said["reductions"]),
        (
            ("synth", "--list"),
            lambda said: {one["name"] for one in said["families"]} == FAMILIES.keys(),
        ),
        (("convert", "--formats"), lambda said: "native" in [one["name"] for one in said]),
        (("vary", "--list"), lambda said: "speed" in [one["name"] for one in said]),
        (("falsify", "--list"), lambda said: "speed" in [one["name"] for one in said]),
        (
            ("falsify", "paper/crossing_pedestrian", "--list-agents"),
            lambda said: said[0]["kind"] == "pedestrian",
        ),
        (
            ("vary", "paper/crossing_pedestrian", "--list-agents"),
            lambda said: said[0]["kind"] == "pedestrian",
        ),
        (
            ("inspect", "{free}"),
            lambda said: said["scenario"]["name"] == "test/free" and said["health"] == [],
        ),
    ],
)
def test_json_is_one_document_and_says_what_the_words_say(
    folder: Path, words: tuple[str, ...], found: Any
) -> None:
    result = replan(*(word.format(free=folder / "free.mcap") for word in words), "--json")
    assert result.exit_code == 0
    assert found(json.loads(result.stdout))
    assert replan(*(word.format(free=folder / "free.mcap") for word in words)).exit_code == 0


def test_errors_leave_stdout_empty_and_quiet_says_them(folder: Path, tmp_path: Path) -> None:
    for words in (
        ("synth", "all", "--json"),
        ("convert", "x", "--json"),
        ("evaluate", "nowhere", "--json", "-q"),
    ):
        result = replan(*words)
        assert (result.exit_code, result.stdout) == (2, "")
        assert one_error(result)
    bad = tmp_path / "bad.mcap"
    bad.write_bytes((folder / "free.mcap").read_bytes()[:-100])
    inspected = replan("inspect", bad, "--json")
    assert inspected.exit_code == 3
    assert "bad.mcap" in json.loads(inspected.stdout)["error"]
    quiet = evaluate(bad, folder / "free.mcap", "-q", "--out", tmp_path / "out")
    assert str(bad) in one_error(quiet)
    assert quiet.stderr.count("\n") == 1
    assert quiet.stdout.splitlines() == [
        f"Outcome: NOT ALL COULD BE EVALUATED (exit code 3); results: {tmp_path / 'out'}"
    ]


def test_remaining_time_follows_the_length_of_the_logs() -> None:
    pace = Pace(12, 0.0, left=2 * 50.0 + 10 * 1.0)
    pace.step(50.0, driven=True, cost=50.0)
    assert pace.step(100.0, driven=True, cost=50.0) == "2 of 12 logs, 1.2 logs/min, about 10 s left"


@given(st.lists(st.floats(0.01, 40.0), min_size=1, max_size=200))
def test_lines_off_a_terminal_are_few_and_none_comes_too_soon(steps: list[float]) -> None:
    pace, now, said = Pace(len(steps), 100.0, len(steps)), 100.0, []
    for step in steps:
        now += step
        line = pace.step(now, driven=True)
        if line is not None:
            said.append((now, line))
    times = [100.0, *(t for t, _ in said)]
    assert all(after - before >= LEAST_S for before, after in pairwise(times))
    assert len(said) <= 9 + (now - 100.0) / 60.0
    assert all(line.endswith(" left") for _, line in said)


def test_the_pace_is_that_of_the_logs_that_were_driven() -> None:
    pace = Pace(300, 0.0, 300.0)
    for _ in range(100):
        assert pace.step(1.0, driven=False) is None  # there already
    for index in range(50):
        line = pace.step(1.0 + index, driven=True)
    assert line == "150 of 300 logs, 60 logs/min, about 2 min left"


@given(st.lists(st.tuples(st.floats(1.0, 300.0), st.booleans()), min_size=1, max_size=30))
def test_the_time_in_which_kernels_were_compiled_counts_for_nothing(
    logs_: list[tuple[float, bool]],
) -> None:
    pace, other, now, warm = Pace(100, 0.0, 100.0), Pace(100, 0.0, 100.0), 0.0, 0.0
    for seconds, compiled in logs_:
        now, warm = now + seconds, warm + seconds * (not compiled)
        pace.step(now, driven=True, compiled=compiled)
        other.step(warm, driven=not compiled)
        assert pace.rest(now) == other.rest(warm)


def test_kernels_that_are_compiled_meanwhile_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    stored: set[str] = {"a"}
    monkeypatch.setattr("replan.core.kernel._is_stored", stored.__contains__)
    monkeypatch.setattr("replan.core.kernel.STORED", list("abcd") + [str(k) for k in range(16)])
    clock = iter([0.0, 20.0, 40.0, 60.0, 101.0])
    monkeypatch.setattr("replan.cli.progress_bar.perf_counter", lambda: next(clock))
    words = with_kernels(lambda: "0 of 9 logs")
    assert is_cache_cold() and words() == "0 of 9 logs"
    stored |= {"b", "c"}
    assert (
        not is_cache_cold()
        and words() == "compiling kernels (once): 3 of 20 are ready, 0 of 9 logs"
    )
    stored.add("d")
    assert "4 of 20" in words() and "4 of 20" in words() and words() == "0 of 9 logs"


def test_progress_is_lines_on_stderr(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from replan.run.sources import LogSource, Selection

    clock = iter(range(0, 1000, 10))
    monkeypatch.setattr("replan.cli.progress_bar.monotonic", lambda: float(next(clock)))
    done = replace(LogResult("a", "a"), seconds=1.0)
    with progress() as (on_start, on_log):
        on_start(Selection(tuple(map(LogSource, "abcde"))), Path("out"))
        for _ in "abcde":
            on_log(done)
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.splitlines()[:2] == [
        "5 logs -> out",
        "1 of 5 logs, 6 logs/min, about 40 s left",
    ]
    assert len(said.err.splitlines()) == 5  # the report follows the last log


def test_the_command_line_is_there_at_once() -> None:
    heavy = "numba numpy scipy pandas pyarrow rerun"
    code = (
        f"import sys, replan.cli, replan; print(*sorted(set('{heavy}'.split()) & set(sys.modules)))"
    )
    result = python("-c", code)
    assert (result.stdout.strip(), result.stderr) == ("", "")


def test_completion_knows_the_tables_without_importing_them() -> None:
    options = {
        "planner": "planners",
        "controller": "controllers",
        "vehicle": "vehicles",
        "traffic": "traffic",
        "prediction": "predictions",
        "perception": "perceptions",
        "suite": "suites",
        "car": "cars",
    }
    for option, kind in options.items():
        assert sorted(names(option)) == sorted(TABLES[kind]), option
    assert list(names("kind")) == list(KINDS)


def test_a_shell_is_given_names() -> None:
    words = {
        "_REPLAN_COMPLETE": "complete_bash",
        "COMP_WORDS": "replan evaluate --controller p",
        "COMP_CWORD": "3",
    }
    result = python("-m", "replan", **words)
    assert result.stdout.split() == ["pure_pursuit", "pid"]
    assert "loop.plan_period_s=" in complete_setting("loop.pl")
    assert complete_setting("controller.p") == ["controller.pure_pursuit.", "controller.pid."]
    # Else the shell above this process counts
    named = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    assert "replan" in python("-m", "replan", "--show-completion", "bash", **named).stdout


def test_every_command_shows_a_sign_of_life() -> None:
    said: list[str] = []
    twice = Event()

    def keep(line: str) -> None:
        said.append(line)
        if len(said) == 2:
            twice.set()

    with sign_of_life(keep, lambda: "reading log", every_s=0.01):
        assert twice.wait(10.0)
    count = len(said)
    assert (
        said[0].startswith("reading log, ") and said[0].endswith(" s so far") and len(said) == count
    )
