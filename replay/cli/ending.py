"""The end of a run, of `replan evaluate` and `replan merge` alike: reports, what is printed, the exit code."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from logs.errors import ConfigError
from replay.cli.app import JUDGE, OUTPUT, say, say_json

if TYPE_CHECKING:
    from replay.compare import Opened
    from replay.config import RunConfig
    from replay.run import RunResult

EXIT_CODES = (
    "Exit codes: 0 all gates pass; 1 a gate failed; 2 wrong usage or configuration; 3 a log or planner could not be"
    " evaluated (the others were); 4 inconclusive: a gate had nothing to judge; 70 a bug in replan; 130 interrupted."
)
Baseline = Annotated[
    Path | None,
    typer.Option(
        metavar="RUN",
        rich_help_panel=JUDGE,
        help="A run, or file of replan baseline, to compare with.",
    ),
]
NoReport = Annotated[
    bool, typer.Option("--no-report", rich_help_panel=OUTPUT, help="Write no report.html, report.md and junit.xml.")
]


@dataclass(frozen=True)
class Printed:
    """What a run prints and writes at its end.

    Attributes:
        as_json: One JSON document on stdout.
        quiet: The outcome alone.
        report: Whether the report files are written.
    """

    as_json: bool
    quiet: bool
    report: bool


def load_baseline(path: Path, run: RunConfig, gates: Path | None, out: Path | None) -> Opened:
    """Read the run to compare with, and the rules, before anything is driven: an error in them costs no run.

    Raises:
        ConfigError: One of them cannot be read, or the baseline lies in the result folder.
    """
    from metrics.compare_rules import load_rules
    from replay.compare import opened
    from replay.run.one_log import all_metrics

    if out is not None and path.resolve().is_relative_to(out.resolve()):
        raise ConfigError(f"--baseline {path}: is in the result folder {out}, which is cleared")
    load_rules(gates, metrics=all_metrics(run))
    return opened(path)


def finish_run(result: RunResult, before: Opened | None, url: str, gates: Path | None, printed: Printed) -> int:
    """Write the reports of a run, print its report, and return the exit code.

    Args:
        result: The run.
        before: The run to compare with.
        url: Where the results are sent from their folder; "": they stay there.
        gates: The file of thresholds and rules; None: the packaged ones.
        printed: What is printed and written.
    """
    from replay.cli.compare import shown
    from replay.compare import compare_runs, opened
    from replay.draw.report.compared import document, last_line
    from replay.draw.report.console import SafeConsole
    from replay.draw.report.overview import overview
    from replay.draw.report.terminal import print_ending, print_report
    from replay.draw.report.write import write_reports
    from replay.results.load import load
    from replay.run.evaluate import summary
    from replay.run.lock import held

    place = url or str(result.out)
    with held(result.out):
        after = None if before is None else opened(result.out)
        results = load(result.out) if after is None or after.results is None else after.results
        compared = None if before is None or after is None else compare_runs(before, after, gates=gates)
        over = overview(results, compared)
        if printed.report:
            over = write_reports(results, over, result.out)
    if printed.as_json:
        more = {} if compared is None else {"comparison": document(compared)}
        say_json({"results": place, **summary(result), **more})
    elif printed.quiet:
        if compared is not None:
            say(last_line(compared, alone=False))
        say(f"Outcome: {over.outcome.upper()} (exit code {over.exit_code}); results: {place}")
    else:
        wide = None if sys.stdout.isatty() or "COLUMNS" in os.environ else 110
        console = SafeConsole(width=wide, soft_wrap=False)
        if result.resumed:
            say(f"Resumed: {result.resumed} of {len(result.logs)} logs are those of the interrupted run")
        print_report(over, console, result.out, ending=False)
        if compared is not None and after is not None:
            shown(compared, after, alone=False)
        print_ending(over, console, result.out, place)
    return over.exit_code
