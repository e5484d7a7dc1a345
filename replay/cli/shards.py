"""`replan merge`: put the shards of a run together."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from replay.cli.app import Json, Quiet, app, handle_errors
from replay.cli.ending import EXIT_CODES, Baseline, NoReport, Printed, finish_run, load_baseline


@app.command(epilog=EXIT_CODES)
def merge(
    shards: Annotated[list[Path], typer.Argument(help="Result folders of all shards of a run, in any order.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Result folder.")],
    baseline: Baseline = None,
    no_report: NoReport = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Put the shards of a run together and judge it: the tables are those of a run without shards, byte for byte.

    Times are a clock's (timings.parquet): they are those of the shards. Shards of other logs, gates, settings or code,
    that overlap, or of which one is missing, are refused.

    [bold]Example[/bold]

      replan evaluate my_logs/ --shard 1/2 -o shard-1
      replan evaluate my_logs/ --shard 2/2 -o shard-2
      replan merge shard-1 shard-2 -o results/merged
    """
    with handle_errors():
        from contextlib import ExitStack

        from logs.files import here
        from replay.config import load_run
        from replay.run.merge import gates_in
        from replay.run.merge import merge as merged
        from replay.run.publish import output_location

        with ExitStack() as near:
            folders = [near.enter_context(here(shard)) for shard in shards]
            gates = near.enter_context(gates_in(folders[0]))
            run = load_run(folders[0] / "run.toml")
            before = None if baseline is None else load_baseline(baseline, run, gates, out)
            place = near.enter_context(output_location(out))
            assert place.folder is not None
            result = merged(folders, place.folder)
            printed = Printed(as_json=as_json, quiet=quiet, report=not no_report)
            code = finish_run(result, before, place.url, gates, printed)
        raise typer.Exit(code)
