"""The end of a run, of `replan evaluate` and `replan merge` alike: reports, what is printed, the exit code."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from logs.errors import ConfigError
from replay.cli.app import JUDGE, OUTPUT, option, say, say_json

if TYPE_CHECKING:
    from replay.compare import Run
    from replay.config import RunConfig
    from replay.results.load import Results

EXIT_CODES = (
    "Exit codes: 0 all gates pass; 1 a gate failed; 2 wrong usage or configuration; 3 a log or planner could not be"
    " evaluated (the others were); 4 inconclusive: a gate had nothing to judge; 70 a bug in replan; 130 interrupted."
)
Baseline = Annotated[Path | None, option(JUDGE, "A run, or file of replan baseline, to compare with.", metavar="RUN")]
NoReport = Annotated[bool, option(OUTPUT, "Write no report.html, report.md and junit.xml.", "--no-report")]


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


def load_baseline(path: Path, run: RunConfig, gates: Path | None, out: Path | None) -> Run:
    """Read the run to compare with, and the rules, before anything is driven: an error in them costs no run.

    Raises:
        ConfigError: One of them cannot be read, or the baseline lies in the result folder.
    """
    from metrics.judge.gates import load_rules
    from replay.compare import read_run
    from replay.run.one_log import all_metrics

    if out is not None and path.resolve().is_relative_to(out.resolve()):
        raise ConfigError(f"--baseline {path}: is in the result folder {out}, which is cleared")
    load_rules(gates, metrics=all_metrics(run))
    return read_run(path)


def finish_run(results: Results, before: Run | None, url: str, gates: Path | None, printed: Printed) -> int:
    """Write the reports of a run, print its report, and return the exit code.

    Args:
        results: The run.
        before: The run to compare with.
        url: Where the results are sent from their folder; "": they stay there.
        gates: The file of thresholds and rules; None: the packaged ones.
        printed: What is printed and written.
    """
    from replay.cli.compare import print_tables
    from replay.compare import compare_runs
    from replay.draw.report.console import SafeConsole
    from replay.draw.report.overview import overview
    from replay.draw.report.terminal import document, last_line, print_ending, print_report
    from replay.draw.report.write import write_reports
    from replay.run.lock import held

    place = url or str(results.path)
    with held(results.path):
        comparison = None if before is None else compare_runs(before, results, gates=gates)
        over = overview(results, comparison)
        if printed.report:
            over = write_reports(results, over, results.path)
    if printed.as_json:
        more = {} if comparison is None else {"comparison": document(comparison)}
        say_json({"results": place, **results.summary, **more})
    elif printed.quiet:
        if comparison is not None:
            say(last_line(comparison, alone=False))
        say(f"Outcome: {over.outcome.upper()} (exit code {over.exit_code}); results: {place}")
    else:
        wide = None if sys.stdout.isatty() or "COLUMNS" in os.environ else 110
        console = SafeConsole(width=wide, soft_wrap=False)
        if results.resumed:
            say(f"Resumed: {results.resumed} of {len(results.logs)} logs are those of the interrupted run")
        print_report(over, console, results.path, ending=False)
        if comparison is not None:
            print_tables(comparison, results, alone=False)
        print_ending(over, console, results.path, place)
    return over.exit_code
