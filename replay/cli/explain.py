"""`replan explain`: what was decided, and why."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from replay.cli.app import Json, answered, app, say, say_json
from replay.cli.plot import Loop, drive_of


@app.command()
def explain(
    result: Annotated[Path, typer.Argument(help="A folder of results.")],
    log: Annotated[str | None, typer.Option(help="Which log. Without it: the drive to look at first.")] = None,
    planner: Annotated[str | None, typer.Option(help="Whose drive, where there are several.")] = None,
    mode: Annotated[Loop | None, typer.Option(help="Default: closed, where it was driven.")] = None,
    at: Annotated[float | None, typer.Option(help="This instant, s. Default: each change of decision.")] = None,
    as_json: Json = False,
) -> None:
    """Say what was decided about which agent, why, what else there was and what it cost: docs/why.md.

    [bold]Examples[/bold]

      replan explain results/run-001
      replan explain results/run-001 --log paper/crossing_pedestrian --at 6.5
    """
    with answered():
        from replay.explain.explanation import explained, lines_of
        from replay.results.load import load

        drive = drive_of(load(result), log, planner, mode.value if mode else None)
        found = explained(drive, at)
        if as_json:
            say_json({"log": drive.log, "planner": drive.planner, "mode": drive.mode, "frames": found})
            return
        say(f"{drive.log}, {drive.planner}, {drive.mode} loop: {drive.info['end']} after {drive.info['t_end_s']:.2f} s")
        for one in found:
            say()
            for line in lines_of(one):
                say(drive.scenario.short_names(line))
