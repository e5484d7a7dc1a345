"""`replan mine | query | cut | suite | coverage`: find, in hours of logs, the moments that
matter.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from replan.cli import options as opt
from replan.cli.app import (
    app,
    progress_lines,
    say,
    say_error,
    say_json,
    say_sentences,
    worker_count,
)
from replan.cli.options import log_table, option, run_config
from replan.core.errors import ConfigError

if TYPE_CHECKING:
    from replan.mine.mined_log import MinedLog

Mined = Annotated[Path, typer.Argument(help="A folder that replan mine wrote.", metavar="RUN")]
Run = Annotated[
    Path, typer.Argument(help="A folder that replan mine or replan evaluate wrote.", metavar="RUN")
]


@app.command()
def mine(
    logs: Annotated[
        list[Path] | None, typer.Argument(help="Logs of any format, or folders of them.")
    ] = None,
    out: opt.Out = None,
    kind: Annotated[
        list[str] | None,
        option(None, "A kind of your own, module:NAME; repeatable.", "--kind", metavar="NAME"),
    ] = None,
    planner: Annotated[
        list[str] | None,
        opt.planner_option(
            None, "Also find where this planner's plans differ from the drive, fall back or flip."
        ),
    ] = None,
    suite: opt.Suite = None,
    ego: opt.Ego = None,
    road_map: opt.Map = None,
    begin: opt.Begin = None,
    end: opt.End = None,
    repair: opt.Repair = None,
    config: opt.Config = None,
    settings: opt.Set = None,
    workers: opt.Workers = None,
    resume: opt.Resume = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print docs/events.md.")] = False,
    as_json: opt.Json = False,
    quiet: opt.Quiet = False,
) -> None:
    """Find what happened in logs, without driving: cut-ins, crossings, hard braking, near misses
    and more.

    Writes events.parquet, logs.parquet and health.parquet (docs/results.md). Exit code 3: a log
    could not be read; the others were.

    [bold]Examples[/bold]

      replan mine my_bags/ -o results/mined
      replan mine my_bags/ -o results/mined -p dp_qp
      replan query results/mined "SELECT kind, count(*) FROM events GROUP BY kind"
    """
    if markdown:
        from replan.mine.kinds_page import page

        say(page())
        return
    from replan.cli.sign_of_life import sign_of_life, with_kernels
    from replan.mine.mine import mine_into, summary
    from replan.run.evaluate import selected

    if not logs and suite is None:
        raise ConfigError(
            "name logs, or logs of the catalogue with --suite: replan mine my_bags/ -o "
            "results/mined"
        )

    planners = list(dict.fromkeys(planner or []))
    options = {"log": log_table(ego, road_map, begin, end, repair), "planners": planners or None}
    run = run_config(config, options, settings or ())
    if planners:
        from replan.run.checks import checked

        run, _ = checked(run)
    selection = selected(logs or [], run, None, suite)
    mined_logs: list[MinedLog] = []

    def ended(log: MinedLog) -> None:
        mined_logs.append(log)
        for line in log.failures:
            say_error(line)

    def progress() -> str:
        return f"mined {len(mined_logs)} of {len(selection.sources)} logs"

    kinds, count = tuple(kind or ()), worker_count(workers)
    with sign_of_life(progress_lines(quiet=quiet), with_kernels(progress)):
        folder, mined = mine_into(
            out,
            selection,
            run,
            kinds=kinds,
            planners=planners,
            workers=count,
            resume=resume,
            on_log=ended,
        )
    if as_json:
        say_json(
            {
                "folder": str(folder),
                "logs": mined.logs,
                "events": mined.events,
                "failures": mined.failures,
            }
        )
    elif not quiet:
        say_sentences([*summary(mined), str(folder)])
    raise typer.Exit(3 if mined.failures else 0)


@app.command()
def query(
    run: Run,
    sql: Annotated[str, typer.Argument(help="One SELECT.")],
    out: Annotated[
        Path | None, opt.out_option("Write the rows to FILE.csv, .parquet or .json.")
    ] = None,
    as_json: opt.Json = False,
) -> None:
    r"""Ask a result folder in SQL: events, metrics, verdicts, frames, health and more as views,
    read only.

    The views and their columns: docs/results.md. Needs DuckDB: pip install 'replan\[improve]'.

    [bold]Examples[/bold]

      replan query results/mined "SELECT log, t_from_s FROM events WHERE kind = 'cut_in'"
      replan query results/run-001 "SELECT log, value FROM metrics ORDER BY value" -o values.csv
    """
    from replan.mine.query import query as ask
    from replan.run.claim import rows_file

    if out is not None:
        with rows_file(out) as write:
            write(ask(run, sql))
        say(out)
        return
    rows = ask(run, sql)
    if as_json:
        say_json(rows)
    else:
        say(rows.to_string(index=False, max_colwidth=80) if len(rows) else "no rows")


@app.command()
def cut(
    run: Run,
    where: Annotated[
        str, typer.Option("--where", help="Condition in SQL over the view's columns.")
    ],
    out: Annotated[Path, opt.out_option("Folder for the logs.")],
    table: Annotated[str, typer.Option("--table", help="The view.")] = "events",
    before: Annotated[float, typer.Option(help="Seconds before each moment.", min=0.0)] = 5.0,
    after: Annotated[float, typer.Option(help="Seconds after it.", min=0.0)] = 8.0,
    resume: opt.Resume = False,
) -> None:
    """Write a log of its own of each moment that a condition selects, ready for replan evaluate.

    [bold]Examples[/bold]

      replan cut results/mined --where "kind = 'pedestrian_crossing'" --before 5 -o moments
      replan cut results/run-001 --table verdicts --where "outcome = 'fail'" -o failures
    """
    from replan.mine.query import cut_logs, moments

    for file in cut_logs(run, moments(run, where, table, before, after), out, resume=resume):
        say(file)


@app.command()
def suite(run: Mined, out: Annotated[Path, opt.out_option("The FILE.toml to write.")]) -> None:
    """Choose the fewest mined logs that have all kinds of events, roads, road users and speeds
    found.

    [bold]Examples[/bold]

      replan suite results/mined -o suite.toml
      replan evaluate --suite suite.toml
    """
    from replan.core.names import counted
    from replan.mine.mine import read_mined
    from replan.mine.suite import suite_of, suite_writer
    from replan.run.output import begun_in

    with suite_writer(out) as write:
        mined = read_mined(run)
        chosen = suite_of(mined)
        write(chosen, begun_in(run, [scene.source for scene in chosen]))
    cells = sum(scene.adds for scene in chosen)
    say(
        f"{out}: {counted(len(chosen), 'log')} of {len(mined.logs)} with all "
        f"{counted(cells, 'cell')}"
    )


@app.command()
def coverage(
    run: Mined,
    against: Annotated[
        Path | None,
        typer.Option(
            help="Compare with another mined folder. Default: the catalogue.", metavar="RUN"
        ),
    ] = None,
    out: Annotated[
        Path | None,
        opt.out_option("Folder for coverage.csv and coverage.png. Default: the mined folder."),
    ] = None,
    workers: opt.Workers = None,
    as_json: opt.Json = False,
) -> None:
    """List which cells of event, road, road user and speed mined logs have, and which they lack.

    Writes coverage.csv and coverage.png. By default the families of the catalogue are mined for
    comparison, so that a gap names a family that fills it (replan synth FAMILY).
    """
    from replan.cli.sign_of_life import sign_of_life
    from replan.mine.coverage import (
        COVERAGE,
        cells_of,
        coverage_lines,
        coverage_table,
        missing_cells,
        write_coverage,
    )
    from replan.mine.mine import mine as mine_logs, read_mined
    from replan.run.claim import claimed_folder
    from replan.run.output import held

    mined = read_mined(run)
    with held(run) if out is None else claimed_folder(out, COVERAGE) as folder:
        if against is None:
            from replan.config import RunConfig
            from replan.mine.coverage import catalogue

            with sign_of_life(progress_lines(), lambda: "mining the catalogue"):
                other = mine_logs(catalogue(), RunConfig(), workers=worker_count(workers)).events
        else:
            other = read_mined(against).events
        covered = cells_of(mined.events)
        missing = missing_cells(covered, cells_of(other))
        table = coverage_table(covered, missing)
        write_coverage(folder or run, mined.events, table)
    if as_json:
        say_json(table)
    else:
        source = "the catalogue" if against is None else str(against)
        say_sentences(coverage_lines(covered, missing, source))
