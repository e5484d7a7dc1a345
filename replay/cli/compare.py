"""`replan compare | baseline`: run against run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from logs.errors import ConfigError
from replay.cli import options as opt
from replay.cli.app import app, console_of, handle_errors, say, say_json
from replay.cli.options import option

if TYPE_CHECKING:
    from metrics.comparison import Comparison
    from replay.compare import Run

EXIT_CODES = (
    "Exit codes: 0 no rule of comparison is broken; 1 one is; 2 wrong usage; 3 a run cannot be read; 4 inconclusive:"
    " nothing to compare, or a rule had nothing to judge."
)


@app.command(epilog=EXIT_CODES)
def compare(
    runs: Annotated[
        list[Path], typer.Argument(help="Baseline and candidate: folders of results, or files of `replan baseline`.")
    ],
    planner: Annotated[
        list[str] | None,
        opt.planner_option(
            None, "Drives of this planner; given twice: the first of the baseline, the second of the candidate."
        ),
    ] = None,
    gates: Annotated[
        Path | None,
        option(None, "TOML file of thresholds and \\[\\[compare]] rules. Default: the packaged ones.", metavar="FILE"),
    ] = None,
    as_json: opt.Json = False,
    no_first_difference: Annotated[
        bool,
        typer.Option("--no-first-difference", help="Do not look for the first difference of drives: read no trace."),
    ] = False,
) -> None:
    """Compare two runs, or two planners of one run: what got better or worse, and the first frame that differs.

    [bold]Examples[/bold]

      replan compare results/main results/mine
      replan compare baseline.parquet results/mine --gates gates.toml
      replan compare results/run-001 --planner idm --planner dp_qp
    """
    with handle_errors():
        from replay.compare import MOST_PARTINGS, compare_runs, read_run
        from replay.draw.report.terminal import document

        planners = tuple(planner or ())
        if len(planners) > 2 or len(runs) > 2 or (len(runs) == 1 and len(planners) != 2):
            raise ConfigError("name two runs, or one run and two planners: replan compare RESULT -p idm -p dp_qp")
        most = 0 if no_first_difference else MOST_PARTINGS
        candidate = read_run(runs[-1])
        baseline = read_run(runs[0]) if len(runs) == 2 else candidate
        comparison = compare_runs(baseline, candidate, planners, gates=gates, partings=most)
        if as_json:
            say_json(document(comparison))
        else:
            print_tables(comparison, candidate)
        raise typer.Exit(comparison.exit_code)


def print_tables(comparison: Comparison, candidate: Run, *, alone: bool = True) -> None:
    """Print a comparison as tables; `alone`: its exit code is that of the command."""
    from replay.compare import view_command
    from replay.draw.report.terminal import print_comparison

    print_comparison(comparison, console_of(130), lambda *drive: view_command(candidate, *drive), alone=alone)


@app.command()
def baseline(
    results: Annotated[Path, typer.Argument(help="Folder of results.")],
    out: Annotated[Path, opt.out_option("The file, for example baseline.parquet.")],
) -> None:
    """Write what a comparison needs of a run into one small file, for example for git.

    [bold]Example[/bold]

      replan baseline results/run-001 -o baseline.parquet
    """
    with handle_errors():
        from replay.compare import is_baseline, read_run, write_baseline
        from replay.run.claim import claimed_file

        with claimed_file(out, (".parquet",), is_baseline):
            write_baseline(read_run(results), out)
        say(f"{out}: {out.stat().st_size / 1e3:.0f} kB")
