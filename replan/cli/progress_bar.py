"""Progress of a run: a bar on a terminal, else occasional lines; errors as they occur; after
Ctrl-C, how to continue.

All of it goes to stderr, so that stdout has the report alone.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path
from threading import Event, Thread
from time import monotonic, perf_counter

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from replan.core.kernel import KernelWatch, is_cache_cold
from replan.core.names import counted
from replan.draw.report.console import SafeConsole
from replan.results.log_result import LogResult
from replan.run.sources import Selection

QUIET_S, REFRESH_S = 20.0, 2.0
"""Longest time without output, s.

On a terminal, the bar's text is renewed after the second time, s.
"""
LONGEST_KERNEL_S = 60.0
"""Kernels are taken to be compiled until this time after the last one, s: one may take that long on
a busy machine.
"""
LEAST_S, MOST_S = 5.0, 60.0
"""Without a terminal, a line is printed after each tenth of the logs, at least 5 s apart, and at
least each minute.
"""


@dataclass
class Pace:
    """Decides when to print the progress of a run, and makes the line."""

    total: int
    # Time at which the first log was started, s; later by the time in which kernels were compiled
    begin: float
    left: float  # Expected cost of the logs that have not ended, in the unit of `step`'s `cost`
    ended_logs: int = 0  # Number of logs that have ended
    driven: int = 0  # Number of them that were driven in this run
    spent: float = 0.0  # Expected cost of the logs that were driven
    ended: float = 0.0  # Time at which the last log ended, s
    last: float = 0.0  # Time at which the last line was printed, s
    tenth: int = 0  # Number of tenths that were done at that time

    def __post_init__(self) -> None:
        self.last = self.ended = self.begin

    def step(
        self, now: float, *, driven: bool, cost: float = 1.0, compiled: bool = False
    ) -> str | None:
        """Count a log that ended at `now`, s; return the line to print, if any. The last log has
        none.

        The time since the last log counts for nothing if kernels were `compiled` in it: others do
        not need it again.
        """
        if compiled:
            self.begin, driven = self.begin + now - self.ended, False
        self.ended = now
        self.ended_logs += 1
        self.driven += driven
        self.left = max(self.left - cost, 0.0)
        self.spent += cost * driven
        tenth = 10 * self.ended_logs // self.total
        due = now - self.last >= (LEAST_S if tenth > self.tenth else MOST_S)
        if not due or self.ended_logs == self.total or not self.driven:
            return None
        self.last, self.tenth = now, tenth
        return f"{self.ended_logs} of {counted(self.total, 'log')}, {self.rest(now)}"

    def rest(self, now: float) -> str:
        """Rate and remaining time, by expected costs as the longest logs come first; "" before a
        log was driven.
        """
        if not self.spent:
            return ""
        elapsed = max(now - self.begin, 1e-9)
        rest_s = elapsed * self.left / self.spent
        when = f"{rest_s:.0f} s" if rest_s < 90.0 else f"{rest_s / 60.0:.0f} min"
        return f"{60.0 * self.driven / elapsed:.3g} logs/min, about {when} left"


@contextmanager
def sign_of_life(
    say: Callable[[str], None], words: Callable[[], str], every_s: float = QUIET_S
) -> Iterator[None]:
    """While the body runs, `say` the words and the elapsed time every `every_s` seconds."""
    ended, began = Event(), perf_counter()

    def speak() -> None:
        while not ended.wait(every_s):
            say(f"{words()}, {perf_counter() - began:.0f} s so far")

    thread = Thread(target=speak, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def with_kernels(words: Callable[[], str]) -> Callable[[], str]:
    """The words; before them the number of compiled kernels, while kernels are compiled."""
    watch, grown = KernelWatch(), -inf

    def line() -> str:
        nonlocal grown
        now = perf_counter()
        grown = now if watch.look() else grown
        compiling = now - grown < LONGEST_KERNEL_S
        return (
            f"compiling kernels (once): {watch.stored} of {watch.known} are ready, {words()}"
            if compiling
            else words()
        )

    return line


@contextmanager
def progress(
    *, quiet: bool = False, verbose: bool = False
) -> Iterator[tuple[Callable[[Selection, Path], None], Callable[[LogResult], None]]]:
    """The functions to call when a run begins and when each log ends.

    KeyboardInterrupt is raised again with a message about the finished logs and how to continue.
    `quiet`: print errors only. `verbose`: print each log as it ends, with its time and how its
    drives ended.
    """
    rest = TextColumn("{task.fields[rest]}")
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), rest
    console = SafeConsole(stderr=True)
    begun: list[tuple[Path, Pace]] = []
    watches: list[KernelWatch] = []
    costs: dict[str, float] = {}
    on_terminal = sys.stderr.isatty()
    with Progress(
        *columns, console=console, transient=True, disable=quiet or not on_terminal
    ) as bar:
        task = bar.add_task("evaluating", total=None, rest="")

        def say(line: str | None, *, always: bool = False) -> None:
            if line is not None and (always or not quiet):
                console.print(line, markup=False, highlight=False, soft_wrap=True)

        def on_start(selection: Selection, out: Path) -> None:
            costs.update({source.label: source.expected_s or 1.0 for source in selection.sources})
            begun.append((out, Pace(len(selection.sources), monotonic(), sum(costs.values()))))
            bar.update(task, total=len(selection.sources))
            for reason in selection.dropped:
                say(f"left out: {reason}")
            say(f"{counted(len(selection.sources), 'log')} -> {out}")
            if is_cache_cold():
                say("compiling kernels (once, a minute or two); replan warmup does it beforehand")
            watches.append(KernelWatch())

        def on_log(result: LogResult) -> None:
            if result.twin:
                say(f"left out: {result.source}: the same log as {result.name}")
            for failure in result.failures:
                say(f"error: {failure.line}", always=True)
            pace = begun[0][1]
            now, driven = monotonic(), isfinite(result.seconds) or not result.folder
            line = pace.step(
                now, driven=driven, cost=costs[result.source], compiled=bool(watches[0].look())
            )
            bar.update(task, advance=1, rest=pace.rest(now))
            if verbose:
                took = f"{result.seconds:.1f} s" if isfinite(result.seconds) else "finished before"
                ends = [f"{drive.planner} {drive.mode}: {drive.end}" for drive in result.drives]
                ends += (
                    [f"{len(result.failures)} could not be evaluated"] if result.failures else []
                )
                say(f"{pace.ended_logs} of {pace.total}  {result.name}  {took}  {'; '.join(ends)}")
            elif not on_terminal:
                say(line)

        def state() -> str:
            if not begun:
                return "looking for logs"
            return f"{begun[0][1].ended_logs} of {counted(begun[0][1].total, 'log')}"

        def describe(line: str) -> None:
            bar.update(task, description=line)

        show, words, every_s = (
            (describe, lambda: "evaluating", REFRESH_S) if on_terminal else (say, state, QUIET_S)
        )
        try:
            with sign_of_life(show, with_kernels(words), every_s):
                yield on_start, on_log
        except KeyboardInterrupt:
            if not begun:
                raise KeyboardInterrupt("interrupted: no log was started") from None
            folder, pace = begun[0]
            raise KeyboardInterrupt(
                f"interrupted: {pace.ended_logs} of {counted(pace.total, 'log')} are finished in "
                f"{folder}, and no tables are written; to continue, give the same command with "
                f"--out {folder} --resume"
            ) from None
