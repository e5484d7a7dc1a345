"""`replan evaluate | vary | paper | calibrate`: the commands that drive."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from replan.cli import options as opt
from replan.cli.app import app, progress_lines, say, say_json, say_sentences, worker_count
from replan.cli.options import JUDGE, LOGS, LOOP, OUTPUT, RUNNING, log_table, option, run_config
from replan.cli.report import EXIT_CODES, finish_run, load_baseline
from replan.core.errors import ConfigError

if TYPE_CHECKING:
    from replan.results.log_result import LogResult
    from replan.run.evaluate import Engine
    from replan.run.sources import Selection


@app.command(epilog=EXIT_CODES)
def evaluate(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(
            help=(
                "Logs of any format (replan convert --formats), or folders of them. Default: the "
                "built-in suite."
            )
        ),
    ] = None,
    planner: Annotated[
        list[str] | None,
        opt.planner_option(
            LOOP,
            "A name, module:Class, exec:COMMAND, tcp://HOST:PORT or nuplan:MODULE:CLASS; "
            "repeatable. Default: dp_qp.",
        ),
    ] = None,
    mode: Annotated[opt.Loop | None, option(LOOP, "Loops to run. Default: both.")] = None,
    vehicle: Annotated[
        str | None,
        option(LOOP, "kinematic_bicycle, single_track, multibody or perfect.", complete="vehicle"),
    ] = None,
    car: Annotated[
        str | None,
        option(LOOP, "Vehicle parameters in place of the log's: bmw_320i ...", complete="car"),
    ] = None,
    controller: Annotated[
        str | None,
        option(LOOP, "dlqr_pid, mpc, pure_pursuit, stanley, pid ...", complete="controller"),
    ] = None,
    traffic: Annotated[
        str | None,
        option(LOOP, "The others: give_way, time (as logged), reactive ...", complete="traffic"),
    ] = None,
    prediction: Annotated[
        str | None,
        option(LOOP, "lane_following, constant_velocity, ..., oracle.", complete="prediction"),
    ] = None,
    perception: Annotated[
        str | None, option(LOOP, "ground_truth, recorded, sensor or auto.", complete="perception")
    ] = None,
    suite: opt.Suite = None,
    ego: opt.Ego = None,
    road_map: opt.Map = None,
    begin: opt.Begin = None,
    end: opt.End = None,
    repair: opt.Repair = None,
    window: Annotated[
        float | None,
        option(LOGS, "Split each log into windows of S seconds.", min=1.0, metavar="S"),
    ] = None,
    every: Annotated[
        float | None,
        option(LOGS, "Begin a window every S seconds: they may overlap.", min=0.1, metavar="S"),
    ] = None,
    gates: opt.Gates = None,
    baseline: opt.Baseline = None,
    ensemble: Annotated[
        int | None,
        option(JUDGE, "Perturbed runs per log: do the verdicts hold?", min=0, metavar="N"),
    ] = None,
    metric: opt.Metric = None,
    out: opt.Out = None,
    chart: Annotated[
        list[str] | None,
        option(OUTPUT, "A report chart of your own, module:NAME; repeatable.", metavar="NAME"),
    ] = None,
    foxglove: opt.Foxglove = False,
    no_recording: Annotated[
        bool, option(OUTPUT, "Write no .rrd files: faster.", "--no-recording")
    ] = False,
    no_report: opt.NoReport = False,
    as_json: opt.Json = False,
    quiet: opt.Quiet = False,
    verbose: Annotated[
        bool,
        option(
            OUTPUT, "Print each log as it ends: its time, how its drives ended.", "--verbose", "-v"
        ),
    ] = False,
    config: opt.Config = None,
    settings: opt.Set = None,
    workers: opt.Workers = None,
    resume: Annotated[
        bool, option(RUNNING, "Continue the interrupted run in --out.", "--resume")
    ] = False,
    shard: Annotated[
        str | None,
        option(RUNNING, "Drive every N-th log, from the I-th: replan merge.", metavar="I/N"),
    ] = None,
    engine: opt.Engine = "local",
    address: opt.Address = None,
) -> None:
    """Drive planners over logs, measure, judge by gates, and record.

    [bold]Examples[/bold]

      replan evaluate                                      the built-in suite
      replan evaluate --suite full                         300 logs of the catalogue
      replan evaluate my_logs/ --planner dp_qp --planner logged
      replan evaluate a.mcap --planner my_pkg.mine:MyPlanner --mode closed
      replan evaluate my_logs/ --gates gates.toml --out results/nightly --resume
      replan evaluate my_logs/ --set loop.plan_period_s=0.2 --set loop.apart.trust=true

    The keys of --set are those of a run's TOML file: docs/use.md.
    """
    from replan.cli.progress_bar import progress
    from replan.run import evaluate_logs
    from replan.run.output import output_location
    from replan.run.pool import freeze_gc
    from replan.run.shards import Shard

    loop = {"vehicle": vehicle, "controller": controller, "traffic": traffic}
    loop |= {"prediction": prediction, "perception": perception}
    options = {
        "planners": planner,
        "metrics": metric,
        "charts": chart,
        "mode": mode,
        "gates": gates,
        "recording": False if no_recording else None,
        "foxglove": foxglove or None,
        "ensemble": ensemble,
        "vehicle": {"set": car},
        "log": log_table(ego, road_map, begin, end, repair),
        "loop": loop,
    }
    run = run_config(config, options, settings or ())
    if every is not None and window is None:
        raise ConfigError("--every is about windows: give their length, --window S")
    if baseline is not None and shard is not None:
        raise ConfigError("--shard drives a part of the logs only: give --baseline to replan merge")
    before = None if baseline is None else load_baseline(baseline, run, run.gates_path, out)
    part = None if shard is None else Shard.parsed(shard)
    driven_on = engine_of(engine, address, workers)
    freeze_gc()
    with output_location(out, resume=resume) as location:
        with progress(quiet=quiet, verbose=verbose) as shown:

            def check_and_start(selection: Selection, folder: Path) -> None:
                location.check_outside(selection.sources)
                shown.start(selection, folder)

            def log_and_send(result: LogResult) -> None:
                shown.log(result)
                location.keep(result)

            result = evaluate_logs(
                logs or [],
                run,
                location.folder,
                engine=driven_on,
                resume=resume,
                shard=part,
                window=window,
                every=every,
                suite=suite,
                on_start=check_and_start,
                on_log=log_and_send,
            )
        show = {"as_json": as_json, "quiet": quiet, "report": not no_report}
        code = finish_run(result, before, location.url, run.gates_path, **show)
    if location.url and not quiet:
        say(f"all of it is at {location.url}", err=True)
    raise typer.Exit(code)


@app.command()
def vary(
    log: Annotated[
        str | None, typer.Argument(help="A log of any format, or a family of the catalogue.")
    ] = None,
    variation: Annotated[
        list[str] | None,
        option(
            None, "NAME=LOW:HIGH:COUNT, an axis (one or two), or NAME=VALUE; see --list.", "--vary"
        ),
    ] = None,
    agent: Annotated[
        list[str] | None,
        option(None, "Agent to vary, repeatable. Default: the one in conflict.", "--agent"),
    ] = None,
    planner: Annotated[str | None, opt.planner_option(None, "Default: dp_qp.")] = None,
    out: opt.Out = None,
    resume: opt.Resume = False,
    resolution: Annotated[
        float | None,
        option(None, "Width to which edges are bisected. Default: an eighth of a cell."),
    ] = None,
    list_agents: opt.ListAgents = False,
    listing: opt.ListAxes = False,
    config: opt.Config = None,
    settings: opt.Set = None,
    gates: opt.Gates = None,
    recording: Annotated[
        bool, typer.Option("--recording", help="Write the .rrd file of each drive.")
    ] = False,
    workers: opt.Workers = None,
    ego: opt.Ego = None,
    road_map: opt.Map = None,
    begin: opt.Begin = None,
    end: opt.End = None,
    repair: opt.Repair = None,
    as_json: opt.Json = False,
    quiet: opt.Quiet = False,
) -> None:
    """Vary one log: a surface of pass and fail over one or two parameters, as a table and a
    picture.

    [bold]Examples[/bold]

      replan vary paper/crossing_pedestrian --vary time=-2:2:9 --vary speed=0.5:1.5:9 -o crossing
      replan vary my_bag --list-agents
      replan vary my_bag --agent 17 --vary time=-2:2:9 -p dp_qp
      replan vary my_log.mcap --vary standing_car=20:80:7 --vary ego_speed=0.5:1.5:5
    """
    from replan.experiments.question import question_about
    from replan.experiments.recorded_log import opened
    from replan.experiments.surface import vary as evaluate_surface

    if listing:
        opt.say_axes(as_json=as_json)
        return
    if log is None:
        raise ConfigError(
            "name a log or a family: replan vary paper/crossing_pedestrian --vary time=-2:2:9"
        )
    options = {
        "planners": [planner] if planner else None,
        "gates": gates,
        "log": log_table(ego, road_map, begin, end, repair),
        "recording": recording,
        "internals": "summary" if recording else "none",
    }
    run = run_config(config, options, settings or ())
    scenario, _ = opened(log, run.log)
    if list_agents:
        opt.say_agents(scenario, as_json=as_json)
        return
    question = question_about(scenario, variation or [], agent or [], resolution)
    say_progress = progress_lines(quiet=quiet)
    if question.agents:
        say_progress(f"varied: {', '.join(map(scenario.short_names, question.agents))}")
    result = evaluate_surface(
        scenario, question, run, out, workers=worker_count(workers), resume=resume, say=say_progress
    )
    if as_json:
        say_json(
            {
                "results": result.out,
                "exit_code": result.exit_code,
                "edges": result.edges,
                "table": result.table,
            }
        )
    else:
        say_sentences(result.lines())
    raise typer.Exit(result.exit_code)


def engine_of(name: str, address: str | None, workers: int | None) -> Engine:
    """The engine that drives the logs; ConfigError if options conflict."""
    from replan.run.evaluate import Local

    if name == "ray":
        from replan.run.on_ray import OnRay

        if workers == 0:
            raise ConfigError(
                "--workers 0 drives in this process, and --engine ray on a cluster: leave one of "
                "them out"
            )
        return OnRay(address or "", workers)
    if address is not None:
        raise ConfigError("--address names a Ray cluster: give --engine ray, too")
    return Local(worker_count(workers))


@app.command()
def paper(
    out: Annotated[Path, opt.out_option("Folder for figures, recordings and tables.")],
    vehicle: Annotated[
        list[str] | None,
        typer.Option(
            help=(
                "Vehicle model of figures and tables, repeatable: the first has the figures. "
                "Default: single_track."
            )
        ),
    ] = None,
    roads: Annotated[
        int, typer.Option(min=0, help="Seeded roads in the table of controllers.")
    ] = 50,
    workers: opt.Workers = None,
) -> None:
    """Run the experiments of the paper: its figures 9, 10 and 12, recordings, controllers compared,
    pedestrians.

    This takes a few minutes. docs/paper.md compares the results with the paper.
    """
    from replan.paper.reproduce import CONTENTS, PaperConfig, reproduce
    from replan.run.claim import claimed_folder

    config = PaperConfig(
        tuple(vehicle or ("single_track",)), roads=roads, workers=worker_count(workers)
    )
    with claimed_folder(out, CONTENTS):
        say(reproduce(out, config, say=progress_lines()))


@app.command()
def calibrate(
    out: Annotated[Path, opt.out_option("Folder for calibration.csv and calibration.png.")],
    vehicle: Annotated[str, typer.Option(help="Vehicle model.")] = "single_track",
    car: Annotated[
        str | None,
        typer.Option(help="Whose numbers: bmw_320i, city_bus ... Default: the default car."),
    ] = None,
    config: Annotated[
        Path | None, opt.config_option("TOML file of a run: its \\[vehicle].")
    ] = None,
) -> None:
    """Write and plot the table acceleration x speed -> throttle or brake, from the vehicle's own
    model.
    """
    from replan.run.calibrate import calibrate as write

    for path in write(out, vehicle, car, config):
        say(path)
