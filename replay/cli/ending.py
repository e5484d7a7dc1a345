"""What is said and written at the end of a run, of `replan evaluate` and `replan merge` alike."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from logs.errors import ConfigError
from replay.cli.app import say, say_json

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
    typer.Option(help="Compare with this run (a folder, or a file of replan baseline): its rules count, too."),
]
NoReport = Annotated[bool, typer.Option("--no-report", help="Write no report.html, report.md and junit.xml.")]


def before_all(path: Path, run: RunConfig, gates: Path | None, out: Path | None) -> Opened:
    """The run to compare with, and the rules, read before anything is driven: what is wrong with them costs no run.

    Raises:
        ConfigError: One of them cannot be read, or the baseline lies in the result folder.
    """
    from metrics.compare.rules import load_rules
    from replay.compare import opened
    from replay.run.one_log import all_metrics

    if out is not None and path.resolve().is_relative_to(out.resolve()):
        raise ConfigError(f"--baseline {path}: lies in the result folder {out}, which is cleared")
    load_rules(gates, metrics=all_metrics(run))
    return opened(path)


def ended(
    result: RunResult, before: Opened | None, url: str, *, gates: Path | None, report: bool, as_json: bool, quiet: bool
) -> int:  # fmt: skip
    """The written reports, and on stdout the report; or summary.json and where it lies; or its last lines.

    Args:
        result: The run.
        before: What it is compared with.
        url: Where it goes from its folder; "": it stays there.
        gates: The file of its thresholds and rules; None: the packaged ones.
        report: Whether files are written.
        as_json: One document on stdout.
        quiet: The outcome alone.

    Returns:
        The exit code.
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
        if report:
            over = write_reports(results, over, result.out)
    if as_json:
        more = {} if compared is None else {"comparison": document(compared)}
        say_json({"results": place, **summary(result), **more})
    elif quiet:
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
