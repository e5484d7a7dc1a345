"""Progress: the pace and the remaining time, kernels that are compiled, signs of life."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from threading import Event

import pytest
from hypothesis import given, strategies as st

from replan.cli.pace import LEAST_S, Pace
from replan.cli.progress_bar import progress
from replan.cli.sign_of_life import sign_of_life, with_kernels
from replan.core.kernel import is_cache_cold
from replan.results.log_result import LogResult


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
    # One line for each tenth of the logs but the last, and one a minute
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
    monkeypatch.setattr("replan.cli.sign_of_life.perf_counter", lambda: next(clock))
    words = with_kernels(lambda: "0 of 9 logs")
    assert is_cache_cold()
    assert words() == "0 of 9 logs"
    stored |= {"b", "c"}
    assert not is_cache_cold()
    assert words() == "compiling kernels (once): 3 of 20 are ready, 0 of 9 logs"
    stored.add("d")
    assert "4 of 20" in words()
    assert "4 of 20" in words()
    assert words() == "0 of 9 logs"  # no kernel was stored for a while


def test_progress_is_lines_on_stderr(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from replan.run.log_source import LogSource
    from replan.run.sources import Selection

    clock = iter(range(0, 1000, 10))
    monkeypatch.setattr("replan.cli.progress_bar.monotonic", lambda: float(next(clock)))
    done = replace(LogResult("a", "a"), seconds=1.0)
    with progress() as shown:
        shown.start(Selection(tuple(map(LogSource, "abcde"))), Path("out"))
        for _ in "abcde":
            shown.log(done)
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.splitlines()[:2] == [
        "5 logs -> out",
        "1 of 5 logs, 6 logs/min, about 40 s left",
    ]
    assert len(said.err.splitlines()) == 5  # the report follows the last log


def test_every_command_shows_a_sign_of_life() -> None:
    lines: list[str] = []
    twice = Event()

    def keep(line: str) -> None:
        lines.append(line)
        if len(lines) == 2:
            twice.set()

    with sign_of_life(keep, lambda: "reading log", every_s=0.01):
        assert twice.wait(10.0)
    count = len(lines)
    assert lines[0].startswith("reading log, ")
    assert lines[0].endswith(" s so far")
    assert len(lines) == count
