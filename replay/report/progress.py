"""How far a run is: a bar on a terminal, else occasional lines; errors of a log at once; how to go on when interrupted.

Everything is said on stderr, so that stdout has the report alone.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from time import monotonic

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from logs.kernel import cold
from replay.batch.log_result import LogResult
from replay.batch.sources import Selection
from replay.report.console import SafeConsole

LEAST_S, MOST_S = 5.0, 60.0
"""Off a terminal a line comes when another tenth of the logs is done, but not within 5 s, and each minute."""


@dataclass
class Pace:
    """When to say how far a run is, and what.

    Attributes:
        total: How many logs there are.
        begin: When the first was begun, s.
        done: How many have ended.
        driven: How many of them were not there already.
        last: When the last line was said, s.
        tenth: How many tenths had been done then.
    """

    total: int
    begin: float
    done: int = 0
    driven: int = 0
    last: float = 0.0
    tenth: int = 0

    def __post_init__(self) -> None:
        self.last = self.begin

    def step(self, now: float, *, driven: bool) -> str | None:
        """A log has ended at `now`, s; the line that is due, if one is. The last log needs none: the report follows."""
        self.done, self.driven = self.done + 1, self.driven + driven
        tenth = 10 * self.done // self.total
        due = now - self.last >= (LEAST_S if tenth > self.tenth else MOST_S)
        if not due or self.done == self.total or not self.driven:
            return None
        self.last, self.tenth = now, tenth
        rate = self.driven / max(now - self.begin, 1e-9)
        left = (self.total - self.done) / rate
        when = f"{left:.0f} s" if left < 90.0 else f"{left / 60.0:.0f} min"
        return f"{self.done} of {self.total} logs, {rate:.2g} logs/s, about {when} left"


@contextmanager
def progress(
    *, quiet: bool = False, verbose: bool = False
) -> Iterator[tuple[Callable[[Selection, Path], None], Callable[[LogResult], None]]]:
    """What is to be called as a run begins and as each log ends.

    Args:
        quiet: Only errors are said.
        verbose: Each log is named as it ends, with how long it took and how its drives ended.

    Raises:
        KeyboardInterrupt: As it came, with words that say what is left of the run and how to go on with it.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = SafeConsole(stderr=True)
    begun: list[tuple[Path, Pace]] = []
    on_terminal = sys.stderr.isatty()
    with Progress(*columns, console=console, transient=True, disable=quiet or not on_terminal) as bar:
        task = bar.add_task("evaluating", total=None)

        def say(line: str | None, *, always: bool = False) -> None:
            if line is not None and (always or not quiet):
                console.print(line, markup=False, highlight=False, soft_wrap=True)

        def on_start(selection: Selection, out: Path) -> None:
            begun.append((out, Pace(len(selection.sources), monotonic())))
            bar.update(task, total=len(selection.sources))
            for reason in selection.dropped:
                say(f"left out: {reason}")
            say(f"{len(selection.sources)} logs -> {out}")
            if cold():
                say("compiling kernels (once; about a minute): replan warmup does it beforehand")

        def on_log(result: LogResult) -> None:
            bar.advance(task)
            for failure in result.failures:
                say(f"error: {failure.line}", always=True)
            pace = begun[0][1]
            line = pace.step(monotonic(), driven=isfinite(result.seconds))
            if verbose:
                say(f"{pace.done} of {pace.total}  {_ended(result)}")
            elif not on_terminal:
                say(line)

        try:
            yield on_start, on_log
        except KeyboardInterrupt:
            said = _interrupted(*begun[0]) if begun else "interrupted: nothing was begun"
            raise KeyboardInterrupt(said) from None


def _ended(result: LogResult) -> str:
    """A log in a line: how long it took, and how its drives ended."""
    took = f"{result.seconds:.1f} s" if isfinite(result.seconds) else "there already"
    ends = [f"{drive.planner} {drive.mode}: {drive.end}" for drive in result.drives]
    lacking = [f"{len(result.failures)} could not be evaluated"] if result.failures else []
    return f"{result.name}  {took}  {'; '.join([*ends, *lacking])}"


def _interrupted(out: Path, pace: Pace) -> str:
    return (
        f"interrupted: {pace.done} of {pace.total} logs are finished in {out}, no tables are written;"
        f" to go on give the same command with --out {out} --resume"
    )
