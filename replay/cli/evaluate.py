"""`replan evaluate | vary | paper | calibrate`: what drives."""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from logs.errors import ConfigError
from replay.cli.app import (
    Begin,
    Ego,
    End,
    Foxglove,
    Json,
    Map,
    Quiet,
    Repair,
    Suite,
    answered,
    app,
    cores,
    log_settings,
    run_config,
    say,
    say_json,
)  # fmt: skip
from replay.cli.ending import EXIT_CODES, Baseline, NoReport, before_all, ended
from replay.cli.names import completion

if TYPE_CHECKING:
    from replay.config import RunConfig
    from replay.results.log_result import LogResult
    from replay.run import RunResult
    from replay.run.engine import Engine
    from replay.run.publish import Place
    from replay.run.sources import Selection


@app.command(epilog=EXIT_CODES)
def evaluate(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Logs of any format (replan convert --formats), or folders of them; none: the built-in suite."
        ),
    ] = None,
    planner: Annotated[
        list[str] | None,
        typer.Option(
            "--planner",
            "-p",
            autocompletion=completion("planner"),
            help='A name, "module:Class", "exec:COMMAND" or "tcp://HOST:PORT"; may be repeated. Default: dp_qp.',
        ),
    ] = None,
    trust: Annotated[
        bool, typer.Option("--trust", help="Run planners of your own in our process: faster, and no limit holds.")
    ] = False,
    plan_timeout: Annotated[
        float | None, typer.Option(min=1e-3, help="Seconds after which a planner that does not answer is given up: 10.")
    ] = None,
    log_timeout: Annotated[
        float | None, typer.Option(min=0.0, help="Seconds that it may take in a whole drive. Default: no limit.")
    ] = None,
    planner_memory: Annotated[
        float | None, typer.Option(min=0.0, metavar="GB", help="What its process may hold; 0: no limit. Default: 8.")
    ] = None,
    batch: Annotated[
        int | None,
        typer.Option(min=0, help="Logs driven in lock step, for a planner with plan_batch. Default: each by itself."),
    ] = None,
    metric: Annotated[
        list[str] | None, typer.Option(help='A metric of your own beside the built-in ones, "module:NAME"; repeatable.')
    ] = None,
    chart: Annotated[
        list[str] | None, typer.Option(help='A chart of your own in the report, "module:NAME"; repeatable.')
    ] = None,
    mode: Annotated[Literal["both", "open", "closed"] | None, typer.Option(help="Loops to run. Default: both.")] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file of settings; options win over it.")] = None,
    gates: Annotated[Path | None, typer.Option(help="TOML file of thresholds. Default: the packaged ones.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Result folder. Default: results/run-NNN.")] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Go on with the interrupted run in --out: finished logs are taken as they are."),
    ] = False,
    no_recording: Annotated[bool, typer.Option("--no-recording", help="Write no .rrd files: faster.")] = False,
    foxglove: Foxglove = False,
    internals: Annotated[
        Literal["none", "summary", "full"] | None,
        typer.Option(help="What of the planner's inside goes into the traces. Default: summary."),
    ] = None,
    ensemble: Annotated[
        int | None,
        typer.Option(min=0, help="Drive each log so many times more, in worlds that should not matter: is it fragile?"),
    ] = None,
    deadline: Annotated[
        float | None,
        typer.Option(min=1e-3, help="Seconds that a plan may take; a gate on it is asked only with this option."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=0, help="Processes; 0: in this one. Default: one per core. Same results.")
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            autocompletion=completion("vehicle"),
            help="How the ego moves: kinematic_bicycle, single_track, multibody, perfect ...",
        ),
    ] = None,
    car: Annotated[
        str | None,
        typer.Option(
            autocompletion=completion("car"),
            help="Whose numbers instead of the log's: bmw_320i, small_electric, vw_vanagon.",
        ),
    ] = None,
    controller: Annotated[
        str | None,
        typer.Option(
            autocompletion=completion("controller"),
            help="How plans are followed: dlqr_pid, mpc, pure_pursuit, stanley, pid ...",
        ),
    ] = None,
    traffic: Annotated[
        str | None,
        typer.Option(
            autocompletion=completion("traffic"),
            help="The others: as logged but for those who give_way; time, ego_position, reactive.",
        ),
    ] = None,
    end_with_evidence: Annotated[
        bool, typer.Option("--end-with-evidence", help="End closed drives where the recorded traffic ends.")
    ] = False,
    prediction: Annotated[
        str | None,
        typer.Option(
            autocompletion=completion("prediction"),
            help="Their futures: constant_velocity, lane_following ..., oracle.",
        ),
    ] = None,
    perception: Annotated[
        str | None,
        typer.Option(
            autocompletion=completion("perception"), help="What is seen: ground_truth, recorded, sensor or auto."
        ),
    ] = None,
    plant: Annotated[
        list[str] | None,
        typer.Option(help="KEY=VALUE of the car that planner and controller are not told (mass=1400); repeatable."),
    ] = None,
    ego: Ego = None,
    road_map: Map = None,
    begin: Begin = None,
    end: End = None,
    repair: Repair = None,
    window: Annotated[
        float | None,
        typer.Option(min=1.0, help="Evaluate each log in parts of so many seconds."),
    ] = None,
    suite: Suite = None,
    baseline: Baseline = None,
    shard: Annotated[
        str | None, typer.Option(metavar="I/N", help="Drive every N-th log only, from the I-th: see replan merge.")
    ] = None,
    engine: Annotated[
        Literal["local", "ray"], typer.Option(help="Where logs are driven: on this machine, or on Ray. Same results.")
    ] = "local",
    address: Annotated[
        str | None, typer.Option(help="Of a Ray cluster: auto, HOST:6379, ray://HOST:10001. Default: one for this run.")
    ] = None,
    no_report: NoReport = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Annotated[
        bool,
        typer.Option("--verbose", "-v", help="Say each log as it ends, how long it took and how its drives ended."),
    ] = False,
) -> None:
    """Drive planners over logs, measure, judge by gates, and record.

    [bold]Examples[/bold]

      replan evaluate                                      the built-in suite
      replan evaluate --suite full                         300 logs of the catalogue
      replan evaluate my_logs/ --planner dp_qp --planner logged
      replan evaluate a.mcap --planner my_pkg.mine:MyPlanner --mode closed
      replan evaluate my_logs/ --gates gates.toml --out results/nightly
      replan evaluate my_logs/ --gates gates.toml --out results/nightly --resume
    """
    with answered():
        from replay.run.publish import result_place

        options: dict[str, Any] = {
            "planners": tuple(planner or ()) or None,
            "metrics": tuple(metric or ()) or None,
            "charts": tuple(chart or ()) or None,
            "mode": mode,
            "gates": None if gates is None else str(gates),
            "internals": internals,
            "recording": False if no_recording else None,
            "foxglove": foxglove or None,
            "ensemble": ensemble,
            "deadline_s": deadline,
        }
        loop = {
            "vehicle": vehicle,
            "controller": controller,
            "traffic": traffic,
            "end_with_evidence": end_with_evidence or None,
            "prediction": prediction,
            "perception": perception,
            "plant": _settings(plant) if plant else None,
        }
        options["log"] = log_settings(config, ego, road_map, begin, end, repair=repair)
        apart = {
            "trust": trust or None,
            "plan_timeout_s": plan_timeout,
            "log_timeout_s": log_timeout,
            "memory_gb": planner_memory,
            "batch": batch,
        }
        run = run_config(config, options, loop, apart).in_car(car)
        if baseline is not None and shard is not None:
            raise ConfigError("--shard drives a part only: give --baseline to replan merge")
        before = None if baseline is None else before_all(baseline, run, run.gates_path, out)
        with result_place(out, resume=resume) as place:
            result = _evaluated(
                logs or [], run, place, _engine(engine, address, workers),
                resume=resume, window=window, suite=suite, shard=shard, quiet=quiet, verbose=verbose,
            )  # fmt: skip
            said = {"report": not no_report, "as_json": as_json, "quiet": quiet}
            code = ended(result, before, place.url, gates=run.gates_path, **said)
        if place.url and not quiet:
            say(f"all of it is at {place.url}", err=True)
        raise typer.Exit(code)


@app.command()
def vary(
    log: Annotated[str | None, typer.Argument(help="A log of any format, or a family of the catalogue.")] = None,
    variation: Annotated[
        list[str] | None,
        typer.Option("--vary", help="NAME=LOW:HIGH:COUNT, an axis (one or two), or NAME=VALUE; see --list."),
    ] = None,
    agent: Annotated[
        list[str] | None,
        typer.Option(
            "--agent",
            help="Who is varied (id or short name); repeatable. Default: of those who move, who comes nearest.",
        ),
    ] = None,
    planner: Annotated[
        str | None, typer.Option("--planner", "-p", autocompletion=completion("planner"), help="Default: dp_qp.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Result folder. Default: results/run-NNN.")] = None,
    resolution: Annotated[
        float | None, typer.Option(help="How near edges are found. Default: an eighth of two cells' distance.")
    ] = None,
    list_agents: Annotated[bool, typer.Option("--list-agents", help="List who is there, the nearest first.")] = False,
    listing: Annotated[bool, typer.Option("--list", help="List what may be varied.")] = False,
    config: Annotated[Path | None, typer.Option(help="TOML file of a run; options win over it.")] = None,
    gates: Annotated[Path | None, typer.Option(help="TOML file of thresholds. Default: the packaged ones.")] = None,
    recording: Annotated[bool, typer.Option("--recording", help="Write the .rrd file of each drive.")] = False,
    workers: Annotated[
        int | None, typer.Option(min=0, help="Processes; 0: in this one. Default: one per core. Same results.")
    ] = None,
    ego: Ego = None,
    road_map: Map = None,
    begin: Begin = None,
    end: End = None,
    repair: Repair = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """One log, varied: a surface of pass and fail over one or two parameters, as a table and a picture.

    [bold]Examples[/bold]

      replan vary paper/crossing_pedestrian --vary time=-2:2:9 --vary speed=0.5:1.5:9 -o results/crossing
      replan vary my_bag --list-agents
      replan vary my_bag --agent 17 --vary time=-2:2:9 -p dp_qp
      replan vary my_log.mcap --vary standing_car=20:80:7 --vary ego_speed=0.5:1.5:5
    """
    with answered():
        from replay.vary import command
        from replay.vary.encounters import encounters

        if listing:
            say_json(command.variation_table()) if as_json else say("\n".join(command.variations()))
            return
        if log is None:
            raise ConfigError("name a log or a family: replan vary paper/crossing_pedestrian --vary time=-2:2:9")
        scenario = command.opened(log, log_settings(config, ego, road_map, begin, end, repair=repair))
        if list_agents:
            say_json(encounters(scenario)) if as_json else say("\n".join(command.agents(scenario)))
            return
        options = {"planners": (planner,) if planner else None, "gates": None if gates is None else str(gates)}
        run = replace(
            run_config(config, options, {}), recording=recording, internals="summary" if recording else "none"
        )
        asked = command.asked(scenario, variation or [], agent or [], resolution)
        count = cores() if workers is None else workers
        result = command.vary(
            scenario, asked, run, out, workers=count, say=lambda line: None if quiet else say(line, err=True)
        )
        if as_json:
            say_json(
                {"results": result.out, "exit_code": result.exit_code, "edges": result.edges, "table": result.table}
            )
        else:
            say("\n".join(result.lines()))
        raise typer.Exit(result.exit_code)


def _settings(words: list[str]) -> dict[str, float | str]:
    """Words "key=value"; a value that is no number stays a word."""
    found: dict[str, float | str] = {}
    for word in words:
        key, separator, value = word.partition("=")
        if not separator or not key:
            raise ConfigError(f"--plant {word}: write it as KEY=VALUE, for example mass=1400")
        try:
            found[key] = float(value)
        except ValueError:
            found[key] = value
    return found


def _engine(name: str, address: str | None, workers: int | None) -> Engine:
    """Where the logs are driven."""
    from replay.run.engine import Local

    if name == "ray":
        from replay.run.on_ray import OnRay

        if workers == 0:
            raise ConfigError("--workers 0 is this process, which is not --engine ray: leave one of them out")
        return OnRay(address or "", workers)
    if address is not None:
        raise ConfigError("--address is of a Ray cluster: give --engine ray, too")
    return Local(cores() if workers is None else workers)


def _evaluated(
    logs: list[Path], run: RunConfig, place: Place, engine: Engine, *, resume: bool, window: float | None,
    suite: str | None, shard: str | None, quiet: bool, verbose: bool,
) -> RunResult:  # fmt: skip
    from replay.cli.progress import progress
    from replay.run import evaluate_logs
    from replay.run.pool import settle
    from replay.run.shard import Shard

    part = None if shard is None else Shard.parsed(shard)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does: nothing half-written
    settle()
    with progress(quiet=quiet, verbose=verbose) as (on_start, on_log):

        def said_and_kept(result: LogResult) -> None:
            on_log(result)
            place.keep(result)

        def begun(selection: Selection, out: Path) -> None:
            place.check_outside(selection.sources)
            on_start(selection, out)

        return evaluate_logs(
            logs, run, place.folder, engine=engine, resume=resume, window=window, suite=suite, shard=part,
            on_start=begun, on_log=said_and_kept,
        )  # fmt: skip


@app.command()
def paper(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for figures, recordings and tables.")],
    vehicle: Annotated[
        list[str] | None,
        typer.Option(
            help="Vehicle model of figures and tables, repeatable: the first has the figures. Default: single_track."
        ),
    ] = None,
    roads: Annotated[int, typer.Option(min=0, help="Seeded roads in the table of controllers.")] = 50,
    workers: Annotated[
        int | None, typer.Option(min=0, help="Processes; 0: in this one. Default: one per core. Same results.")
    ] = None,
) -> None:
    """Run the experiments of the paper: its figures 9, 10 and 12, recordings, controllers compared, pedestrians.

    A few minutes. What agrees with the paper and what does not: docs/paper.md.
    """
    with answered():
        from replay.paper.reproduce import PaperConfig, reproduce

        count = cores() if workers is None else workers
        config = PaperConfig(tuple(vehicle or ("single_track",)), roads=roads, workers=count)
        say(reproduce(out, config, say=lambda line: say(line, err=True)))


@app.command()
def calibrate(
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for calibration.csv and calibration.png.")],
    vehicle: Annotated[str, typer.Option(help="Vehicle model.")] = "single_track",
    car: Annotated[
        str | None, typer.Option(help="Whose numbers: bmw_320i, small_electric, vw_vanagon. Default: the default car.")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="TOML file of a run: its \\[vehicle].")] = None,
) -> None:
    """Write and plot the table acceleration x speed -> throttle or brake, from the vehicle's own model."""
    with answered():
        from replay.run.calibrate import calibrate as write

        for path in write(out, vehicle, car, config):
            say(path)
