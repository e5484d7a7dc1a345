"""`replan frame`: plan one frame again."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from replay.cli.app import app, handle_errors, say
from replay.cli.chosen import OfLog, OfMode, chosen_drive


@app.command()
def frame(
    result: Annotated[Path, typer.Argument(help="A folder of results.")],
    at: Annotated[float, typer.Option(help="Time, s; the last frame up to it is planned again.")],
    log: OfLog = None,
    of: Annotated[str | None, typer.Option("--of", help="The drive of this planner. Default: the worst drive.")] = None,
    planner: Annotated[
        str | None, typer.Option(help="Plan the frame with this planner instead; it gets this frame only.")
    ] = None,
    mode: OfMode = None,
    dump: Annotated[Path | None, typer.Option(help="Write frames, plan and QPs to FILE.msgpack.")] = None,
    debug: Annotated[bool, typer.Option("--debug", help="Open the debugger before the frame is planned.")] = False,
) -> None:
    """Drive up to a frame again, in one process, and plan it with a report: stages, times, sizes, residuals.

    [bold]Examples[/bold]

      replan frame results/run-001 --at 6.5 --dump frame.msgpack
      replan frame results/run-001 --at 6.5 --planner idm
    """
    with handle_errors():
        from replay.results.load import load
        from replay.run.frame_again import planned_again, report_of
        from replay.run.frame_dump import dump as write_dump

        chosen = chosen_drive(load(result), log, of, mode)
        again = planned_again(chosen.drive, at, planner, debug=debug)
        say(f"{chosen.title}{chosen.remark}")
        for line in report_of(again):
            say(line)
        if dump is not None:
            write_dump(dump, again.dump)
            say(f"\n{dump}: {dump.stat().st_size / 1e6:.1f} MB; replay.run.frame_dump.load reads it")
