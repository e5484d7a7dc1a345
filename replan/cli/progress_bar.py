"""Progress of a run: a bar on a terminal, else occasional lines; errors as they occur; after
Ctrl-C, how to continue.

All of it goes to stderr, so that stdout has the report alone.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from time import monotonic

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from replan.cli.pace import Pace
from replan.cli.sign_of_life import QUIET_S, sign_of_life, with_kernels
from replan.core.kernel import KernelWatch, is_cache_cold
from replan.core.names import counted
from replan.draw.report.console import SafeConsole
from replan.results.log_result import LogResult
from replan.run.sources import Selection

REFRESH_S = 2.0
"""On a terminal, the text beside the bar is renewed after this time, s."""


@dataclass(frozen=True)
class _Begun:
    """A run that has begun."""

    folder: Path
    pace: Pace
    costs: dict[str, float]  # Expected time of each log by its label, s; 1 if it is not known
    kernels: KernelWatch


class RunProgress:
    """Shows the beginning of a run, and each log as it ends."""

    def __init__(self, *, quiet: bool, verbose: bool) -> None:
        self._quiet, self._verbose = quiet, verbose
        self._on_terminal = sys.stderr.isatty()
        self._console = SafeConsole(stderr=True)
        self.bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rest]}"),
            console=self._console,
            transient=True,
            disable=quiet or not self._on_terminal,
        )
        self._task = self.bar.add_task("evaluating", total=None, rest="")
        self._begun: _Begun | None = None

    def start(self, selection: Selection, out: Path) -> None:
        """Show the logs of a run that begins, and the folder of its results."""
        costs = {source.label: source.expected_s or 1.0 for source in selection.sources}
        pace = Pace(len(selection.sources), monotonic(), sum(costs.values()))
        self.bar.update(self._task, total=pace.total)
        for reason in selection.dropped:
            self._say(f"left out: {reason}")
        self._say(f"{counted(pace.total, 'log')} -> {out}")
        if is_cache_cold():
            self._say("compiling kernels (once, a minute or two); replan warmup does it beforehand")
        self._begun = _Begun(out, pace, costs, KernelWatch())

    def log(self, result: LogResult) -> None:
        """Show a log that ended: its failures, and the pace of the run."""
        assert self._begun is not None, "a log ends after the run began"
        if result.twin:
            self._say(f"left out: {result.source}: the same log as {result.name}")
        for failure in result.failures:
            self._console_line(f"error: {failure.line}")
        begun = self._begun
        now = monotonic()
        line = begun.pace.step(
            now,
            driven=isfinite(result.seconds) or not result.folder,
            cost=begun.costs[result.source],
            compiled=bool(begun.kernels.look()),
        )
        self.bar.update(self._task, advance=1, rest=begun.pace.rest(now))
        if self._verbose:
            self._say(f"{begun.pace.ended_logs} of {begun.pace.total}  {_outcome(result)}")
        elif line is not None and not self._on_terminal:
            self._say(line)

    @contextmanager
    def alive(self) -> Iterator[None]:
        """While the body runs, renew the text beside the bar, or print how far the run is."""
        if self._on_terminal:
            show, words, every_s = self._describe, lambda: "evaluating", REFRESH_S
        else:
            show, words, every_s = self._say, self._state, QUIET_S
        with sign_of_life(show, with_kernels(words), every_s):
            yield

    def interruption(self) -> str:
        """What is finished after Ctrl-C, and how to continue."""
        if self._begun is None:
            return "interrupted: no log was started"
        folder, pace = self._begun.folder, self._begun.pace
        return (
            f"interrupted: {pace.ended_logs} of {counted(pace.total, 'log')} are finished in "
            f"{folder}, and no tables are written; to continue, give the same command with "
            f"--out {folder} --resume"
        )

    def _state(self) -> str:
        if self._begun is None:
            return "looking for logs"
        return f"{self._begun.pace.ended_logs} of {counted(self._begun.pace.total, 'log')}"

    def _describe(self, line: str) -> None:
        self.bar.update(self._task, description=line)

    def _say(self, line: str) -> None:
        if not self._quiet:
            self._console_line(line)

    def _console_line(self, line: str) -> None:
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)


def _outcome(result: LogResult) -> str:
    """A log that ended in a line: its time, and how its drives ended."""
    took = f"{result.seconds:.1f} s" if isfinite(result.seconds) else "finished before"
    ends = [f"{drive.planner} {drive.mode}: {drive.end}" for drive in result.drives]
    if result.failures:
        ends.append(f"{len(result.failures)} could not be evaluated")
    return f"{result.name}  {took}  {'; '.join(ends)}"


@contextmanager
def progress(*, quiet: bool = False, verbose: bool = False) -> Iterator[RunProgress]:
    """Show the progress of the run in the body.

    KeyboardInterrupt is raised again with a message about the finished logs and how to continue.
    `quiet`: print errors only. `verbose`: print each log as it ends, with its time and how its
    drives ended.
    """
    shown = RunProgress(quiet=quiet, verbose=verbose)
    with shown.bar:
        try:
            with shown.alive():
                yield shown
        except KeyboardInterrupt:
            raise KeyboardInterrupt(shown.interruption()) from None
