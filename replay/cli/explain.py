"""`replan explain`: what was decided, and why."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from replay.cli.app import Json, app, handle_errors, say, say_json
from replay.cli.chosen import OfLog, OfMode, OfPlanner, chosen_drive


@app.command()
def explain(
    result: Annotated[Path, typer.Argument(help="A folder of results.")],
    log: OfLog = None,
    planner: OfPlanner = None,
    mode: OfMode = None,
    at: Annotated[float | None, typer.Option(help="Time, s. Default: each change of a decision.")] = None,
    as_json: Json = False,
) -> None:
    """Print each decision of a drive: about which agent, why, the alternatives and their costs (docs/why.md).

    [bold]Examples[/bold]

      replan explain results/run-001
      replan explain results/run-001 --log paper/crossing_pedestrian --at 6.5
    """
    with handle_errors():
        from replay.explain.explanation import explained, lines_of
        from replay.results.load import load

        chosen = chosen_drive(load(result), log, planner, mode)
        drive = chosen.drive
        found = explained(drive, at)
        if as_json:
            say_json({"log": drive.log, "planner": drive.planner, "mode": drive.mode, "frames": found})
            return
        say(f"{chosen.title}: {drive.info['end']} after {drive.info['t_end_s']:.2f} s{chosen.remark}")
        for one in found:
            say()
            for line in lines_of(one):
                say(drive.scenario.short_names(line))
