"""`replan synth | convert | repair | inspect | salvage | export`: read and write logs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from replan.cli import options as opt
from replan.cli.app import (
    StrictCommand,
    app,
    progress_lines,
    say,
    say_error,
    say_json,
    worker_count,
)
from replan.cli.options import log_table, run_config
from replan.core.errors import ConfigError, unknown_name


@app.command()
def synth(
    names: Annotated[
        list[str] | None, typer.Argument(help="Families (paper/free_road), groups (paper), or all.")
    ] = None,
    out: Annotated[Path | None, opt.out_option("Folder to write to.")] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="parameter=number; may be repeated.", metavar="KEY=VALUE"),
    ] = None,
    suite: opt.Suite = None,
    form: Annotated[
        str,
        typer.Option(
            "--as", help="native, or ros2: a bag of raw detections (group raw).", metavar="FORM"
        ),
    ] = "native",
    listing: Annotated[
        bool, typer.Option("--list", help="List the families and their parameters.")
    ] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print docs/catalogue.md.")] = False,
    as_json: opt.Json = False,
) -> None:
    """Write synthesised logs of the catalogue.

    [bold]Examples[/bold]

      replan synth --list
      replan synth all -o my_logs
      replan synth paper/free_road -o my_logs --set radius_m=40
      replan synth --suite smoke -o my_logs
      replan synth raw --as ros2 -o my_bags
    """
    from contextlib import closing

    from replan.cli.synth import (
        FORMS,
        chosen,
        listed,
        markdown_page,
        synthesise,
        table,
        write_suite,
    )
    from replan.logs.catalogue import numbers

    if as_json:
        if not listing:
            raise ConfigError("--json is for --list")
        say_json(table())
        return
    if listing or markdown:
        say(markdown_page() if markdown else "\n".join(listed()))
        return
    if bool(names) == bool(suite) or out is None:
        raise ConfigError(
            "name a family (or all) or a --suite, and a folder: replan synth all -o my_logs; see "
            "--list"
        )
    if suite and settings:
        raise ConfigError(
            "--set changes families that are named; the logs of a suite have their parameters"
        )
    if form not in FORMS:
        raise unknown_name("form", form, FORMS)
    changed = numbers(settings or [], "--set")
    logs = (
        write_suite(suite, out, form)
        if suite
        else synthesise(chosen(names or ()), out, changed, form)
    )
    with closing(logs) as written:
        for path in written:
            say(path)


@app.command()
def convert(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(help="Logs of any format; a format's name before them chooses it."),
    ] = None,
    out: Annotated[Path | None, opt.out_option("FILE.mcap for one log, else a folder.")] = None,
    ego: opt.Ego = None,
    problem: Annotated[
        int | None,
        typer.Option(help="CommonRoad: the planning problem, its id or its place from 1."),
    ] = None,
    road_map: opt.Map = None,
    begin: opt.Begin = None,
    end: opt.End = None,
    repair: opt.Repair = None,
    config: opt.Settings = None,
    foxglove: opt.Foxglove = False,
    formats: Annotated[
        bool, typer.Option("--formats", help="List the formats that replan reads.")
    ] = False,
    as_json: opt.Json = False,
) -> None:
    """Convert logs of other formats to replan's own MCAP.

    [bold]Examples[/bold]

      replan convert --formats
      replan convert my_bags/ -o my_logs
      replan convert drive.mcap -o for_foxglove.mcap --foxglove
      replan convert commonroad USA_US101-6_1_T-1.xml -o us101.mcap
    """
    from replan.cli.convert import convert_all, listing, table
    from replan.cli.sign_of_life import sign_of_life

    if as_json:
        if not formats:
            raise ConfigError("--json is for --formats")
        say_json(table())
        return
    if formats:
        say("\n".join(listing()))
        return
    if not logs or out is None:
        raise ConfigError(
            "name logs and where to write them: replan convert LOG ... -o FOLDER; see --formats"
        )
    options = log_table(ego, road_map, begin, end, repair)
    settings = run_config(config, {"log": {**options, "problem": problem}}).log
    with sign_of_life(progress_lines(), lambda: "converting"):
        all_read = convert_all(logs, out, settings, foxglove=foxglove, say=say, say_error=say_error)
    if not all_read:
        raise typer.Exit(3)


@app.command()
def repair(
    log: Annotated[Path, typer.Argument(help="A log of raw detections, of any format.")],
    out: Annotated[Path, opt.out_option("The FILE.mcap to write.")],
    table: Annotated[
        Path | None, opt.output("Write the changes as FILE.csv, not to stdout.", "--table")
    ] = None,
    ego: opt.Ego = None,
    road_map: opt.Map = None,
    begin: opt.Begin = None,
    end: opt.End = None,
    repair: opt.Repair = None,
    config: opt.Settings = None,
) -> None:
    """Make tracks of a log's raw detections, and list what was joined, removed and extended, and
    why.

    [bold]Example[/bold]

      replan repair my_bag/ -o my_bag.mcap --table changes.csv
    """
    from replan.cli.convert import changes_as_text, repair_log
    from replan.cli.sign_of_life import sign_of_life

    settings = run_config(config, {"log": log_table(ego, road_map, begin, end, repair)}).log
    with sign_of_life(progress_lines(), lambda: f"repairing {log}"):
        scenario = repair_log(log, out, table, settings)
    say("\n".join([str(out), *(f"    note: {note}" for note in scenario.notes)]))
    say("\n".join(changes_as_text(scenario)) if table is None else table)


@app.command()
def inspect(
    log: Annotated[Path, typer.Argument(help="A log of any format.")],
    ego: opt.Ego = None,
    road_map: opt.Map = None,
    begin: opt.Begin = None,
    end: opt.End = None,
    repair: opt.Repair = None,
    config: opt.Settings = None,
    as_json: opt.Json = False,
) -> None:
    """List what a log contains, over which time, and what is missing for which evaluation."""
    from replan.cli.convert import unrepaired
    from replan.cli.sign_of_life import sign_of_life
    from replan.core.urls import here
    from replan.logs.summary import summarise
    from replan.replay.loop.reference_drives import discriminate
    from replan.run.sources import log_at

    with here(log) as near, sign_of_life(progress_lines(), lambda: f"reading {log}"):
        if not near.exists():
            raise ConfigError(f"{log}: no such file or folder")
        settings = run_config(config, {"log": log_table(ego, road_map, begin, end, repair)}).log
        near = log_at(near, settings)
        summary = summarise(near, settings)
        raw = None if summary.read is None else unrepaired(near, settings, summary.read)
    if as_json:
        from replan.metrics.health import findings

        apart = () if summary.read is None else discriminate(summary.read)
        health = None if summary.read is None else findings(summary.read)
        before = None if raw is None else {"agents": len(raw.tracks), "health": findings(raw)}
        document = {key: value for key, value in vars(summary).items() if key != "read"}
        document |= {
            "error": summary.error and str(summary.error),
            "health": health,
            "before_repair": before,
        }
        document |= {
            "discrimination": {driver.driver: str(driver.breaks or "") for driver in apart}
        }
        say_json(document)
        raise typer.Exit(0 if summary.error is None else 3)
    say("\n".join(summary.lines()))
    if summary.error is not None:
        raise typer.Exit(3)
    if summary.read is not None:
        from replan.metrics.health import report

        with sign_of_life(progress_lines(), lambda: f"checking {log}"):
            say("\n".join(report(summary.read, raw)))
            say("\n".join(f"drivers: {driver.text}" for driver in discriminate(summary.read)))


@app.command()
def salvage(
    damaged: Annotated[Path, typer.Argument(help="A damaged MCAP file, of any kind.")],
    out: Annotated[Path, typer.Argument(help="The MCAP file to write.", callback=opt.local_path)],
) -> None:
    """Keep every intact chunk of a damaged MCAP file, and name what was lost."""
    from replan.logs.mcap.records import is_salvaged, salvage as save
    from replan.run.claim import claimed_file

    if not damaged.is_file():
        raise ConfigError(f"{damaged}: no such file")

    def is_ours(file: Path) -> bool:
        return is_salvaged(file) and not file.samefile(damaged)

    with claimed_file(out, (".mcap",), is_ours):
        say("\n".join([str(out), *(f"    {line}" for line in save(damaged, out).lines())]))


export_app = typer.Typer(
    help="Write drives in the formats of other projects.", no_args_is_help=True
)
app.add_typer(export_app, name="export")


@export_app.callback()
def _export() -> None:
    pass


@export_app.command("commonroad-solution", cls=StrictCommand)
def commonroad_solution(
    run: Annotated[
        Path, typer.Argument(help="A result folder, or closed.mcap of one drive in it.")
    ],
    out: Annotated[
        Path, opt.out_option("Folder for the files of a run; of one drive also FILE.xml.")
    ],
    cost: Annotated[str, typer.Option(help="Cost function that the benchmark id names.")] = "JB1",
) -> None:
    """Write the closed drives over CommonRoad scenarios as CommonRoad solutions, for CommonRoad's
    own checker.

    For a run, drives over other logs are skipped and named; exit code 3 if no drive could be
    written.

    [bold]Example[/bold]

      replan evaluate USA_US101-6_1_T-1.xml --car bmw_320i -o results/us101
      replan export commonroad-solution results/us101 -o solutions
    """
    from replan.cli.convert import COSTS, commonroad_solution as solution, solutions
    from replan.results.tables import write_text
    from replan.run.claim import claimed_files

    if cost not in COSTS:
        raise unknown_name("cost function", cost, COSTS)
    with claimed_files(out, (".xml",)) as path_of:
        if run.is_dir():
            files, skipped = solutions(run, cost)
            for line in skipped:
                say(f"skipped {line}", err=True)
        else:
            files = {f"{run.parent.name}.xml": solution(run, cost)}
        texts = {path_of(name): text for name, text in files.items()}
        for file, text in texts.items():
            write_text(file, text)
            say(file)
    if not texts:
        raise typer.Exit(3)


@export_app.command("features", cls=StrictCommand)
def export_features(
    logs: Annotated[
        list[Path] | None, typer.Argument(help="Logs of any format, or folders of them.")
    ] = None,
    out: Annotated[Path | None, opt.out_option("Folder for the arrays.")] = None,
    every: Annotated[
        int, typer.Option("--every", help="A sample of every N-th frame.", min=1, metavar="N")
    ] = 5,
    suite: opt.Suite = None,
    ego: opt.Ego = None,
    road_map: opt.Map = None,
    begin: opt.Begin = None,
    end: opt.End = None,
    repair: opt.Repair = None,
    config: opt.Config = None,
    settings: opt.Set = None,
    workers: opt.Workers = None,
    size: Annotated[
        list[str] | None,
        typer.Option("--size", help="A size of replan.features.FeatureSizes.", metavar="NAME=N"),
    ] = None,
    quiet: opt.Quiet = False,
) -> None:
    """Write the features of logs, with the recorded future, as NumPy arrays to train a network on.

    An .npz file a log, and features.json (docs/bring_planner.md). Exit code 3: a log could not be
    read; the others were.

    [bold]Examples[/bold]

      replan export features my_bags -o data
      replan export features results/expert -o data --every 2 --size agents=64
    """
    from replan.cli.sign_of_life import sign_of_life
    from replan.core.names import counted
    from replan.core.settings import set_table, strict
    from replan.features import FeatureSizes
    from replan.run.evaluate import selected
    from replan.run.feature_export import ExportedLog, export_features as export

    if out is None or (not logs and suite is None):
        raise ConfigError(
            "name logs, or logs of the catalogue with --suite, and a folder: "
            "replan export features my_bags -o data"
        )
    options = {"log": log_table(ego, road_map, begin, end, repair)}
    run = run_config(config, options, settings or ())
    sizes = strict(FeatureSizes, set_table(size or ()), "size")
    selection = selected(logs or [], run, None, suite)
    exported: list[ExportedLog] = []

    def ended(log: ExportedLog) -> None:
        exported.append(log)
        if log.error:
            say_error(log.error)

    def progress() -> str:
        return f"exported {len(exported)} of {counted(len(selection.sources), 'log')}"

    with sign_of_life(progress_lines(quiet=quiet), progress):
        export(
            selection,
            run,
            out,
            sizes=sizes,
            every=every,
            workers=worker_count(workers),
            on_log=ended,
        )
    written = [log for log in exported if not log.error]
    samples = sum(log.row["samples"] for log in written)
    say(f"{out}: {counted(samples, 'sample')} of {counted(len(written), 'log')}")
    if len(written) < len(exported):
        raise typer.Exit(3)
