"""`replan report`: write the reports of finished runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from logs.errors import ConfigError
from replay.cli.app import app, handle_errors, say


@app.command()
def report(
    results: Annotated[Path, typer.Argument(help="Folder of results.")],
    baseline: Annotated[
        Path | None, typer.Option(help="Compare with this: a folder of results, or a file of `replan baseline`.")
    ] = None,
    diagnosis: Annotated[Path | None, typer.Option(help="Folder that `replan diagnose` wrote of this run.")] = None,
    gates: Annotated[
        Path | None, typer.Option(help="TOML file with the \\[\\[compare]] rules. Default: the packaged ones.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for the reports. Default: the results'.")
    ] = None,
) -> None:
    """Write the reports of a finished run: report.html, report.md, and junit.xml (a test per log and gate).

    The HTML is one file that opens from disk: tables, charts, and a page for each of the 100 worst drives.

    `replan evaluate` and `replan merge` write them too. In CI the Markdown is also appended to the summary of the step
    (GITHUB_STEP_SUMMARY). Exit code 0 where they are written, whatever they say; `replan compare` judges.

    [bold]Examples[/bold]

      replan report results/run-001
      replan report results/run-001 --baseline baseline.parquet -o reports
    """
    with handle_errors():
        from logs.files import url_of
        from replay.compare import compare_runs, read_run
        from replay.diagnose.findings import read_diagnosis
        from replay.draw.report.overview import overview
        from replay.draw.report.write import write_reports
        from replay.results.load import load
        from replay.results.tables import REPORTS

        if url_of(results) and out is None:
            raise ConfigError(f"{url_of(results)}: name a folder for its reports with --out")
        found = load(results)
        comparison = None if baseline is None else compare_runs(read_run(baseline), found, gates=gates)
        folder = out or found.path
        why = None if diagnosis is None else read_diagnosis(diagnosis, found)
        written = write_reports(found, overview(found, comparison, why), folder)
        for name in REPORTS:
            say(folder / name)
        for line in written.broken:
            say(line, err=True)
