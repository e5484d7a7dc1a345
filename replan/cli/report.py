"""`replan merge | report | compare | baseline`, and the end of a run: reports, output, the exit
code.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from replan.cli import options as opt
from replan.cli.app import app, console_of, say, say_json
from replan.cli.options import option
from replan.core.errors import ConfigError

if TYPE_CHECKING:
    from replan.compare_runs import Run
    from replan.config import RunConfig
    from replan.draw.drawn_results import Results
    from replan.metrics.comparison import Comparison

EXIT_CODES = (
    "Exit codes: 0 all gates pass; 1 a gate failed; 2 wrong usage or configuration; 3 a log or "
    "planner could not be evaluated (the others were); 4 inconclusive: a gate had nothing to "
    "judge; 70 a bug in replan; 130 interrupted."
)


def load_baseline(path: Path, run: RunConfig, gates: Path | None, out: Path | None) -> Run:
    """Read the run to compare with, and the rules, before anything is driven, so that an error in
    them is found first.

    ConfigError if one of them cannot be read, or the baseline lies in the result folder.
    """
    from replan.compare_runs import read_run
    from replan.metrics.judge.gates import load_rules
    from replan.run.one_log import all_metrics

    if out is not None and path.resolve().is_relative_to(out.resolve()):
        raise ConfigError(f"--baseline {path}: is in the result folder {out}, which is cleared")
    load_rules(gates, metrics=all_metrics(run))
    return read_run(path)


def finish_run(
    results: Results,
    before: Run | None,
    url: str,
    gates: Path | None,
    *,
    as_json: bool,
    quiet: bool,
    report: bool,
) -> int:
    """Write the reports of a run, print its report, and return the exit code.

    `url`: the URL to which the results are sent; "" if they stay in their folder. `gates`: the file
    of thresholds and rules; None: the packaged ones.
    """
    from replan.api import finished
    from replan.draw.report.comparison_sections import document, last_line
    from replan.draw.report.overview import WORST, failure_lines
    from replan.draw.report.terminal import print_ending, print_report

    location, over = url or str(results.path), finished(results, before, gates, report=report)
    comparison = over.comparison
    if as_json:
        compared = {} if comparison is None else {"comparison": document(comparison)}
        say_json({"results": location, **results.summary, **compared})
    elif quiet:
        for _, line in failure_lines(over):
            say(f"FAIL: {line}")
        for gate in over.gates:
            if gate.outcome == "fail" and gate.over != WORST:
                say(f"FAIL: {gate.rule}: {gate.reason}")
        if comparison is not None:
            for verdict in comparison.verdicts:
                if verdict.outcome.value == "fail":
                    say(f"FAIL: {verdict.rule}: {verdict.reason}")
            say(last_line(comparison, alone=False))
        say(f"Outcome: {over.outcome.upper()} (exit code {over.exit_code}); results: {location}")
    else:
        console = console_of(110)
        if results.resumed:
            say(
                f"Resumed: {results.resumed} of {len(results.logs)} logs are those of the "
                "interrupted run"
            )
        print_report(over, console, results.path, ending=False)
        if comparison is not None:
            print_tables(comparison, results, alone=False)
        print_ending(over, console, results.path, location)
    return over.exit_code


@app.command(epilog=EXIT_CODES)
def merge(
    shards: Annotated[
        list[Path], typer.Argument(help="Result folders of all shards of a run, in any order.")
    ],
    out: Annotated[Path, option(None, "Result folder.", "--out", "-o", metavar="PATH")],
    baseline: opt.Baseline = None,
    no_report: opt.NoReport = False,
    as_json: opt.Json = False,
    quiet: opt.Quiet = False,
) -> None:
    """Put the shards of a run together and judge it: the tables are those of a run without shards,
    byte for byte.

    Times are a clock's (timings.parquet): they are those of the shards. Shards of other logs,
    gates, settings or code, that overlap, or of which one is missing, are refused.

    [bold]Example[/bold]

      replan evaluate my_logs/ --shard 1/2 -o shard-1
      replan evaluate my_logs/ --shard 2/2 -o shard-2
      replan merge shard-1 shard-2 -o results/merged
    """
    from replan.config import load_run
    from replan.core.urls import here
    from replan.run.output import output_location
    from replan.run.shards import gates_in, merge as merged

    with ExitStack() as near:
        folders = [near.enter_context(here(shard)) for shard in shards]
        gates = near.enter_context(gates_in(folders[0]))
        run = load_run(folders[0] / "run.toml")
        before = None if baseline is None else load_baseline(baseline, run, gates, out)
        location = near.enter_context(output_location(out))
        assert location.folder is not None
        result = merged(folders, location.folder)
        show = {"as_json": as_json, "quiet": quiet, "report": not no_report}
        code = finish_run(result, before, location.url, gates, **show)
    raise typer.Exit(code)


@app.command()
def report(
    results: Annotated[Path, typer.Argument(help="Folder of results.")],
    baseline: opt.Baseline = None,
    diagnosis: Annotated[
        Path | None, typer.Option(help="Folder that `replan diagnose` wrote of this run.")
    ] = None,
    gates: Annotated[
        Path | None,
        option(
            None,
            "TOML file with the \\[\\[compare]] rules. Default: the packaged ones.",
            metavar="FILE",
        ),
    ] = None,
    out: Annotated[
        Path | None, opt.out_option("Folder for the reports. Default: the results'.")
    ] = None,
) -> None:
    """Write the reports of a finished run: report.html, report.md, and junit.xml (a test per log
    and gate).

    The HTML is one file that opens from disk: tables, charts, and a page for each of the 100 worst
    drives.

    `replan evaluate` and `replan merge` write them too. In CI the Markdown is also appended to the
    summary of the step (GITHUB_STEP_SUMMARY). Exit code 0 if they are written, whatever the
    verdicts; `replan compare` judges.

    [bold]Examples[/bold]

      replan report results/run-001
      replan report results/run-001 --baseline baseline.parquet -o reports
    """
    from replan.compare_runs import compare_runs, read_run
    from replan.core.urls import url_of
    from replan.draw.drawn_results import load
    from replan.draw.report.overview import overview
    from replan.draw.report.write import write_reports
    from replan.experiments.diagnosis import read_diagnosis
    from replan.results.tables import REPORTS
    from replan.run.claim import FolderContents, claimed_folder
    from replan.run.output import held

    if url_of(results) and out is None:
        raise ConfigError(f"{url_of(results)}: name a folder for its reports with --out")
    if gates is not None and baseline is None:
        raise ConfigError(
            "--gates names rules of comparison: give what to compare with, --baseline RUN, too"
        )
    run = load(results)
    folder = out or run.path
    beside = folder.resolve() == run.path.resolve()
    with (
        held(folder)
        if beside
        else claimed_folder(folder, FolderContents("report", REPORTS, resumes=False))
    ):
        comparison = (
            None if baseline is None else compare_runs(read_run(baseline), run, gates=gates)
        )
        why = None if diagnosis is None else read_diagnosis(diagnosis, run)
        written = write_reports(overview(run, comparison, why), folder)
    for name in REPORTS:
        say(folder / name)
    for line in written.broken:
        say(line, err=True)


COMPARE_CODES = (
    "Exit codes: 0 no rule of comparison is broken; 1 one is; 2 wrong usage; 3 a run cannot be "
    "read; 4 inconclusive: nothing to compare, or a rule had nothing to judge."
)


@app.command(epilog=COMPARE_CODES)
def compare(
    runs: Annotated[
        list[Path],
        typer.Argument(
            help="Baseline and candidate: folders of results, or files of `replan baseline`."
        ),
    ],
    planner: Annotated[
        list[str] | None,
        opt.planner_option(
            None,
            "Drives of this planner; given twice: the first of the baseline, the second of the "
            "candidate.",
        ),
    ] = None,
    gates: Annotated[
        Path | None,
        option(
            None,
            "TOML file of thresholds and \\[\\[compare]] rules. Default: the packaged ones.",
            metavar="FILE",
        ),
    ] = None,
    as_json: opt.Json = False,
    no_first_difference: Annotated[
        bool,
        typer.Option(
            "--no-first-difference",
            help="Do not look for the first difference of drives: read no trace.",
        ),
    ] = False,
) -> None:
    """Compare two runs, or two planners of one run: what got better or worse, and the first frame
    that differs.

    [bold]Examples[/bold]

      replan compare results/main results/mine
      replan compare baseline.parquet results/mine --gates gates.toml
      replan compare results/run-001 --planner idm --planner dp_qp
    """
    from replan.compare_runs import MOST_PARTINGS, compare_runs, read_run
    from replan.draw.report.comparison_sections import document

    planners = tuple(planner or ())
    if len(planners) > 2 or len(runs) > 2 or (len(runs) == 1 and len(planners) != 2):
        raise ConfigError(
            "name two runs, or one run and two planners: replan compare RESULT -p idm -p dp_qp"
        )
    partings = 0 if no_first_difference else MOST_PARTINGS
    candidate = read_run(runs[-1])
    baseline = read_run(runs[0]) if len(runs) == 2 else candidate
    comparison = compare_runs(baseline, candidate, planners, gates=gates, partings=partings)
    if as_json:
        say_json(document(comparison))
    else:
        print_tables(comparison, candidate)
    raise typer.Exit(comparison.exit_code)


def print_tables(comparison: Comparison, candidate: Run, *, alone: bool = True) -> None:
    """Print a comparison as tables; `alone`: its exit code is that of the command."""
    from replan.compare_runs import look_commands
    from replan.draw.report.terminal import print_comparison

    print_comparison(
        comparison, console_of(130), lambda *drive: look_commands(candidate, *drive), alone=alone
    )


@app.command()
def baseline(
    results: Annotated[Path, typer.Argument(help="Folder of results.")],
    out: Annotated[Path, opt.out_option("The file, for example baseline.parquet.")],
) -> None:
    """Write what a comparison needs of a run into one small file, for example for git.

    [bold]Example[/bold]

      replan baseline results/run-001 -o baseline.parquet
    """
    from replan.compare_runs import is_baseline, read_run, write_baseline
    from replan.run.claim import claimed_file

    with claimed_file(out, (".parquet",), is_baseline):
        write_baseline(read_run(results), out)
    say(f"{out}: {out.stat().st_size / 1e3:.0f} kB")
