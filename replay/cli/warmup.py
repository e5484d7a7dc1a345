"""`replan warmup`: compile kernels beforehand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from replay.cli.app import Json, Quiet, app, handle_errors, run_config, say, say_error, say_json
from replay.cli.names import completion


@app.command()
def warmup(
    planner: Annotated[
        list[str] | None,
        typer.Option("--planner", "-p", autocompletion=completion("planner"), help="Repeatable. Default: dp_qp."),
    ] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file of a run, for its kernels.")] = None,
    every: Annotated[bool, typer.Option("--all", help="Compile the kernels of all that is built in.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compile the kernels that a run needs, and keep them, so that the first log starts at once.

    They are kept in NUMBA_CACHE_DIR, else beside the installed code, else in the user's cache folder: docs/ci.md.

    [bold]Examples[/bold]

      replan warmup
      NUMBA_CACHE_DIR=/var/cache/replan replan warmup --planner dp_qp --planner lattice
    """
    with handle_errors():
        run = run_config(config, {"planners": planner})
        from replay.run.warmup import everything, warm_up

        if not quiet:
            say("compiling kernels (a minute or two; seconds if they were compiled before)", err=True)
        done = warm_up(run, *(everything() if every else ()))
        for failure in done.failures:
            say_error(failure.message)
        where = "nowhere: no folder can be written" if done.folder is None else done.folder
        if as_json:
            say_json(
                {"seconds": done.seconds, "compiled": done.compiled, "folder": done.folder, "failures": done.failures}
            )
        elif not quiet:
            say(f"{done.compiled} kernels compiled, {done.seconds:.1f} s; kept in: {where}")
        if done.failures:
            raise typer.Exit(3)
