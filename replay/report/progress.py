"""How far a run is: a bar on a terminal, errors of a log at once, and what to do after an interruption."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, Task, TextColumn, TimeRemainingColumn

from replay.batch.log_result import LogResult
from replay.batch.sources import Selection


@contextmanager
def progress() -> Iterator[tuple[Callable[[Selection, Path], None], Callable[[LogResult], None]]]:
    """What is to be called as a run begins and as each log ends: a bar on stderr where that is a terminal, and lines.

    Raises:
        KeyboardInterrupt: As it came, with words that say what is left of the run and how to go on with it.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    folders: list[Path] = []
    with Progress(*columns, console=console, transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("evaluating", total=None)

        def on_start(selection: Selection, out: Path) -> None:
            folders.append(out)
            bar.update(task, total=len(selection.sources))
            for reason in selection.dropped:
                console.print(f"left out: {reason}", markup=False, highlight=False, soft_wrap=True)
            console.print(f"{len(selection.sources)} logs -> {out}", markup=False, highlight=False, soft_wrap=True)

        def on_log(result: LogResult) -> None:
            bar.advance(task)
            for failure in result.failures:
                console.print(f"error: {failure.line}", markup=False, highlight=False, soft_wrap=True)

        try:
            yield on_start, on_log
        except KeyboardInterrupt:
            said = _interrupted(folders[0], bar.tasks[0]) if folders else "interrupted: nothing was begun"
            raise KeyboardInterrupt(said) from None


def _interrupted(out: Path, task: Task) -> str:
    return (
        f"interrupted: {task.completed:.0f} of {task.total or 0:.0f} logs are finished in {out}, no tables are written;"
        f" to go on give the same command with --out {out} --resume"
    )
