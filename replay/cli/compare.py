"""`replan compare | baseline`: run against run."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from logs.errors import ConfigError
from replay.cli.app import Json, app, handle_errors, say, say_json

if TYPE_CHECKING:
    from metrics.compare import Comparison
    from replay.compare import Opened

EXIT_CODES = (
    "Exit codes: 0 no rule of comparison is broken; 1 one is; 2 wrong usage; 3 a run cannot be read; 4 inconclusive:"
    " nothing to compare, or a rule had nothing to judge."
)


@app.command(epilog=EXIT_CODES)
def compare(
    runs: Annotated[
        list[Path],
        typer.Argument(help="Baseline and candidate: folders of results, or files of `replan baseline`."),
    ],
    planner: Annotated[
        list[str] | None,
        typer.Option(
            "--planner",
            "-p",
            help="Only this planner; given twice: the first of the baseline, the second of the other.",
        ),
    ] = None,
    gates: Annotated[
        Path | None, typer.Option(help="TOML file of thresholds and \\[\\[compare]] rules. Default: the packaged ones.")
    ] = None,
    as_json: Json = False,
    no_partings: Annotated[
        bool, typer.Option("--no-partings", help="Do not look for where drives part: no trace is read.")
    ] = False,
) -> None:
    """Is it better, where did it get worse, and since which frame? Two runs, or two planners of one run.

    [bold]Examples[/bold]

      replan compare results/main results/mine
      replan compare baseline.parquet results/mine --gates gates.toml
      replan compare results/run-001 --planner idm --planner dp_qp
    """
    with handle_errors():
        from replay.compare import MOST_PARTINGS, compare_runs, opened
        from replay.draw.report.compared import document

        planners = tuple(planner or ())
        if len(planners) > 2 or len(runs) > 2 or (len(runs) == 1 and len(planners) != 2):
            raise ConfigError("name two runs, or one run and two planners: replan compare RESULT -p idm -p dp_qp")
        most = 0 if no_partings else MOST_PARTINGS
        candidate = opened(runs[-1])
        baseline = opened(runs[0]) if len(runs) == 2 else candidate
        comparison = compare_runs(baseline, candidate, planners, gates=gates, partings=most)
        if as_json:
            say_json(document(comparison))
        else:
            shown(comparison, candidate)
        raise typer.Exit(comparison.exit_code)


def shown(comparison: Comparison, candidate: Opened, *, alone: bool = True) -> None:
    """A comparison as tables on stdout; `alone`: its exit code is the command's."""
    from replay.compare import watched
    from replay.draw.report.compared import print_comparison
    from replay.draw.report.console import SafeConsole

    wide = None if sys.stdout.isatty() or "COLUMNS" in os.environ else 130
    console = SafeConsole(width=wide, soft_wrap=False)
    print_comparison(comparison, console, lambda *drive: watched(candidate, *drive), alone=alone)


@app.command()
def baseline(
    results: Annotated[Path, typer.Argument(help="Folder of results.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The file, for example baseline.parquet.")],
) -> None:
    """Keep what comparing needs of a run in one small file that git can hold.

    [bold]Example[/bold]

      replan baseline results/run-001 -o baseline.parquet
    """
    with handle_errors():
        from replay.compare import opened, write_baseline

        if not out.parent.is_dir():
            raise ConfigError(f"{out}: no such folder")
        write_baseline(opened(results), out)
        say(f"{out}: {out.stat().st_size / 1e3:.0f} kB")
