"""`replan diagnose`: why the drives of a run fail."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from replay.cli.app import LOGS, LOOP, Json, Quiet, Workers, app, cores, handle_errors, option, say, say_json
from replay.cli.search import Out, Resume, kept, tell

CODES = (
    "Exit codes: 0 the diagnosis is done; 2 wrong usage; 3 a drive cannot be driven again, the others are diagnosed;"
    " 130 interrupted: --resume goes on."
)


@app.command(epilog=CODES)
def diagnose(
    run: Annotated[Path, typer.Argument(help="A result folder of replan evaluate.", metavar="RUN")],
    log: Annotated[list[str] | None, option(LOGS, "Only this log; repeatable.", metavar="NAME")] = None,
    planner: Annotated[
        str | None, option(LOOP, "Whose drives. Default: the run's only planner.", "--planner", "-p", metavar="NAME")
    ] = None,
    changes: Annotated[
        Path | None, option(LOOP, "TOML file of further changes to try (docs/diagnose.md).", metavar="FILE")
    ] = None,
    space: Annotated[
        Path | None,
        option(LOOP, "TOML file: settings with ranges; finds the smallest change that passes.", metavar="FILE"),
    ] = None,
    out: Out = None,
    resume: Resume = False,
    workers: Workers = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find out why drives fail: drive them again with one thing changed, and see what turns FAIL into PASS.

    [bold]Examples[/bold]

      replan diagnose results/run-001 -o results/diagnosed
      replan diagnose results/run-001 --log everyday/cut_in --planner idm
      replan diagnose results/run-001 --space space.toml
    """
    with handle_errors():
        from replay.diagnose.changes import load_changes
        from replay.diagnose.diagnose import diagnose as diagnosed
        from replay.diagnose.diagnose import question
        from replay.results.load import load
        from replay.results.tables import next_free
        from replay.search.space import load_space

        asked = question(load(run), planner, log or (), load_changes(changes))
        settings = () if space is None else load_space(space, asked.run)
        count = cores() if workers is None else workers
        with kept(out, resume=resume) as folder:
            folder = next_free() if folder is None else folder
            result = diagnosed(
                asked, folder, settings, workers=count, resume=resume, say=lambda line: tell(line, quiet=quiet)
            )
        if as_json:
            say_json({**result.document(), "results": str(result.out)})
        else:
            say("\n".join([*result.lines(), f"written to {result.out}"]))
        if result.exit_code:
            raise typer.Exit(result.exit_code)
