"""The command line: words in, exit code out; no logic here.

`replan evaluate | vary | synth | convert | inspect | salvage | export | view | metrics | paper | calibrate`
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console

from logs.errors import ConfigError, ReplanError

if TYPE_CHECKING:
    from logs.readers import LogSettings
    from replay.batch import RunResult
    from replay.config import RunConfig

EXIT_CODES = (
    "Exit codes: 0 all gates pass; 1 a gate failed; 2 wrong usage or configuration; 3 a log or planner could not be"
    " evaluated (the others were); 4 inconclusive: a gate had nothing to judge; 130 interrupted."
)

app = typer.Typer(
    name="replan",
    help="Replay driving logs through a planner, open loop and closed loop, and judge what it did.\n\n"
    "Start with [bold]replan evaluate[/bold]: it needs no logs, the built-in suite is driven.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)

Ego = Annotated[str | None, typer.Option("--ego", help="Take this road user of the log as the ego.")]
Map = Annotated[Path | None, typer.Option("--map", help="A map that replaces the log's.")]
Begin = Annotated[float | None, typer.Option("--from", help="Begin so many seconds after the log's.")]
End = Annotated[float | None, typer.Option("--to", help="End so many seconds after the log's begin.")]
Foxglove = Annotated[bool, typer.Option("--foxglove", help="Channels that Foxglove draws, in what is written.")]
Suite = Annotated[
    str | None, typer.Option("--suite", help="smoke, full, nightly; or a family or group with all its cells.")
]
Settings = Annotated[Path | None, typer.Option("--config", help="TOML file of a run: its \\[log] table.")]


def main() -> None:
    """Run the command line; ends the process with its exit code."""
    app()


@contextmanager
def answered() -> Iterator[None]:
    """What a user can mend becomes one line and an exit code; Ctrl-C and SIGTERM become 130."""
    try:
        yield
    except ReplanError as error:
        say_error(str(error))
        raise typer.Exit(2 if isinstance(error, ConfigError) else 3) from None
    except KeyboardInterrupt as interruption:
        say_error(str(interruption) or "interrupted")
        raise typer.Exit(130) from None


def say_error(message: str) -> None:
    """One line on stderr."""
    typer.echo(f"error: {message}", err=True)


def _version(asked: bool) -> None:
    if asked:
        from replay.batch import replan_version

        typer.echo(f"replan {replan_version()}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say the version.")
    ] = False,
) -> None:
    pass


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
        typer.Option("--planner", "-p", help='A planner\'s name or "module:Class"; may be repeated. Default: dp_qp.'),
    ] = None,
    metric: Annotated[
        list[str] | None, typer.Option(help='A metric of your own beside the built-in ones, "module:NAME"; repeatable.')
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
        str | None, typer.Option(help="How the ego moves: kinematic_bicycle, single_track, multibody, perfect ...")
    ] = None,
    car: Annotated[
        str | None, typer.Option(help="Whose numbers instead of the log's: bmw_320i, small_electric, vw_vanagon.")
    ] = None,
    controller: Annotated[
        str | None, typer.Option(help="How plans are followed: dlqr_pid, mpc, pure_pursuit, stanley, pid ...")
    ] = None,
    traffic: Annotated[
        str | None, typer.Option(help="The others: as logged but for those who give_way; time, ego_position, reactive.")
    ] = None,
    prediction: Annotated[
        str | None, typer.Option(help="Their futures: constant_velocity, lane_following ..., oracle.")
    ] = None,
    perception: Annotated[str | None, typer.Option(help="What is seen: ground_truth or sensor.")] = None,
    plant: Annotated[
        list[str] | None,
        typer.Option(help="KEY=VALUE of the car that planner and controller are not told (mass=1400); repeatable."),
    ] = None,
    ego: Ego = None,
    road_map: Map = None,
    begin: Begin = None,
    end: End = None,
    window: Annotated[
        float | None,
        typer.Option(min=1.0, help="Evaluate each log in parts of so many seconds."),
    ] = None,
    suite: Suite = None,
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
        options: dict[str, Any] = {
            "planners": tuple(planner or ()) or None,
            "metrics": tuple(metric or ()) or None,
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
            "prediction": prediction,
            "perception": perception,
            "plant": _settings(plant) if plant else None,
        }
        options["log"] = _log_settings(config, ego, road_map, begin, end)
        run = _run(config, options, loop).in_car(car)
        result = _evaluated(
            logs or [], run, out, _cores() if workers is None else workers, resume=resume, window=window, suite=suite
        )
        raise typer.Exit(result.exit_code)


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
            "--agent", help="Who is varied; repeatable: all together. Default: of those who move, who comes nearest."
        ),
    ] = None,
    planner: Annotated[str | None, typer.Option("--planner", "-p", help="Default: dp_qp.")] = None,
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

        if listing:
            typer.echo("\n".join(command.variations()))
            return
        if log is None:
            raise ConfigError("name a log or a family: replan vary paper/crossing_pedestrian --vary time=-2:2:9")
        scenario = command.opened(log, _log_settings(config, ego, road_map, begin, end))
        if list_agents:
            typer.echo("\n".join(command.agents(scenario)))
            return
        options = {"planners": (planner,) if planner else None, "gates": None if gates is None else str(gates)}
        run = replace(_run(config, options, {}), recording=recording, internals="summary" if recording else "none")
        asked = command.asked(scenario, variation or [], agent or [], resolution)
        count = _cores() if workers is None else workers
        result = command.vary(scenario, asked, run, out, workers=count, say=lambda line: typer.echo(line, err=True))
        typer.echo("\n".join(result.lines()))
        raise typer.Exit(result.exit_code)


def _run(config: Path | None, options: dict[str, Any], loop: dict[str, Any]) -> RunConfig:
    """The configuration file with the options over it; None is an option that was not given."""
    from replay.config import RunConfig, load_run

    run = RunConfig() if config is None else load_run(config)
    looped = replace(run.loop, **{key: value for key, value in loop.items() if value is not None})
    return replace(run, loop=looped, **{key: value for key, value in options.items() if value is not None})


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


def _evaluated(
    logs: list[Path], run: RunConfig, out: Path | None, workers: int, *, resume: bool, window: float | None,
    suite: str | None,
) -> RunResult:  # fmt: skip
    from replay.batch import evaluate_logs
    from replay.batch.pool import settle
    from replay.report.progress import progress
    from replay.report.terminal import print_report

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does: nothing half-written
    settle()
    with progress() as (on_start, on_log):
        result = evaluate_logs(
            logs, run, out, workers=workers, resume=resume, window=window, suite=suite, on_start=on_start, on_log=on_log
        )
    wide = None if sys.stdout.isatty() or "COLUMNS" in os.environ else 110
    print_report(result, Console(width=wide, soft_wrap=False))
    return result


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@app.command()
def synth(
    names: Annotated[
        list[str] | None, typer.Argument(help="Families (paper/free_road), groups (paper), or all.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder to write to.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", help="parameter=number; may be repeated.", metavar="KEY=VALUE")
    ] = None,
    suite: Suite = None,
    listing: Annotated[bool, typer.Option("--list", help="List the families and their parameters.")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="The page of all: docs/catalogue.md.")] = False,
) -> None:
    """Write synthesised logs of the catalogue.

    [bold]Examples[/bold]

      replan synth --list
      replan synth all -o my_logs
      replan synth paper/free_road -o my_logs --set radius_m=40
      replan synth --suite smoke -o my_logs
    """
    with answered():
        from replay.synth import chosen, listed, markdown_page, overrides, synthesise, write_suite

        if listing or markdown:
            typer.echo(markdown_page() if markdown else "\n".join(listed()))
            return
        if bool(names) == bool(suite) or out is None:
            raise ConfigError(
                "name a family (or all) or a --suite, and a folder: replan synth all -o my_logs; see --list"
            )
        if suite and settings:
            raise ConfigError("--set changes families that are named; the logs of a suite have their parameters")
        written = write_suite(suite, out) if suite else synthesise(chosen(names or ()), out, overrides(settings or []))
        for path in written:
            typer.echo(path)


@app.command()
def convert(
    logs: Annotated[
        list[Path] | None, typer.Argument(help="Logs of any format; a format's name first asks for that one.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="FILE.mcap for one log, else a folder.")] = None,
    ego: Ego = None,
    problem: Annotated[
        int | None, typer.Option(help="CommonRoad: the planning problem, its id or its place from 1.")
    ] = None,
    road_map: Map = None,
    begin: Begin = None,
    end: End = None,
    config: Settings = None,
    foxglove: Foxglove = False,
    formats: Annotated[bool, typer.Option("--formats", help="List the formats that replan reads.")] = False,
) -> None:
    """Logs of other formats to replan's own MCAP.

    [bold]Examples[/bold]

      replan convert --formats
      replan convert my_bags/ -o my_logs
      replan convert drive.mcap -o for_foxglove.mcap --foxglove
      replan convert commonroad USA_US101-6_1_T-1.xml -o us101.mcap
    """
    with answered():
        from replay.convert import convert_all, listing

        if formats:
            typer.echo("\n".join(listing()))
            return
        if not logs or out is None:
            raise ConfigError("name logs and where to write them: replan convert LOG ... -o FOLDER; see --formats")
        settings = _log_settings(config, ego, road_map, begin, end, problem)
        if not convert_all(logs, out, settings, foxglove=foxglove, say=typer.echo, say_error=say_error):
            raise typer.Exit(3)


def _log_settings(
    config: Path | None,
    ego: str | None,
    road_map: Path | None,
    begin: float | None,
    end: float | None,
    problem: int | None = None,
) -> LogSettings:
    """The [log] table of the configuration file with the options over it."""
    from logs.readers.base import LogSettings
    from replay.config import load_run

    options: dict[str, Any] = {"ego": ego, "begin": begin, "end": end, "problem": problem}
    given = {key: value for key, value in options.items() if value is not None}
    given |= {} if road_map is None else {"map": str(road_map)}
    try:
        return replace(LogSettings() if config is None else load_run(config).log, **given)
    except ValueError as error:
        raise ConfigError(str(error)) from None


@app.command()
def inspect(
    log: Annotated[Path, typer.Argument(help="A log of any format.")],
    ego: Ego = None,
    road_map: Map = None,
    begin: Begin = None,
    end: End = None,
    config: Settings = None,
) -> None:
    """Say what a log holds, over which time, and what is missing for which evaluation."""
    with answered():
        from logs.summary import summarise

        if not log.exists():
            raise ConfigError(f"{log}: no such file or folder")
        summary = summarise(log, _log_settings(config, ego, road_map, begin, end))
        typer.echo("\n".join(summary.lines()))
        if summary.error is not None:
            raise typer.Exit(3)
        if summary.read is not None:
            from metrics.health import report

            typer.echo("\n".join(report(summary.read)))


@app.command()
def salvage(
    damaged: Annotated[Path, typer.Argument(help="A damaged MCAP file, of any kind.")],
    out: Annotated[Path, typer.Argument(help="The MCAP file to write.")],
) -> None:
    """Keep every intact chunk of a damaged MCAP file, and name what was lost."""
    with answered():
        from logs.mcap.salvage import salvage as save

        if not damaged.is_file():
            raise ConfigError(f"{damaged}: no such file")
        if out.exists():
            raise ConfigError(f"{out}: exists already; name a new file")
        typer.echo("\n".join([str(out), *(f"    {line}" for line in save(damaged, out).lines())]))


export_app = typer.Typer(help="Drives in the formats of others.", no_args_is_help=True)
app.add_typer(export_app, name="export")


@export_app.callback()
def _export() -> None:
    pass


@export_app.command("commonroad-solution")
def commonroad_solution(
    trace: Annotated[Path, typer.Argument(help="closed.mcap of a CommonRoad scenario, in a result folder.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The XML file to write.")],
    cost: Annotated[str, typer.Option(help="Cost function that the benchmark id names.")] = "JB1",
) -> None:
    """A closed drive as a CommonRoad solution, for CommonRoad's own checker.

    [bold]Example[/bold]

      replan evaluate USA_US101-6_1_T-1.xml --vehicle kinematic_bicycle --car bmw_320i -o results/us101
      replan export commonroad-solution results/us101/USA_US101-6_1_T-1-56aaf9ca/closed.mcap -o solution.xml
    """
    with answered():
        from logs.errors import unknown_name
        from replay.batch.results import write_text
        from replay.export import COSTS
        from replay.export import commonroad_solution as solution

        if cost not in COSTS:
            raise unknown_name("cost function", cost, COSTS)
        text = solution(trace, cost)
        try:
            out.parent.mkdir(parents=True, exist_ok=True)
            write_text(out, text)
        except OSError as error:
            raise ReplanError(f"{out}: cannot be written: {error.strerror or error}") from None
        typer.echo(out)


@app.command()
def view(
    target: Annotated[Path, typer.Argument(help="A log, a recording (.rrd), or a folder of results.")],
    save: Annotated[Path | None, typer.Option(help="Write the log's recording here instead of opening it.")] = None,
    memory_limit: Annotated[str, typer.Option(help="Of the viewer.")] = "2GB",
    web: Annotated[bool, typer.Option("--web", help="Show it in a browser.")] = False,
    ego: Ego = None,
    road_map: Map = None,
    begin: Begin = None,
    end: End = None,
    config: Settings = None,
) -> None:
    """Open a log or recordings in the Rerun viewer.

    [bold]Examples[/bold]

      replan view results/run-001
      replan view my_log.mcap --save my_log.rrd
    """
    with answered():
        import tempfile

        from logs.readers import reader_of
        from replay.view import recordings, save_log, show

        if not target.exists():
            raise ConfigError(f"{target}: no such file or folder")
        is_log = target.suffix != ".rrd" and (target.is_file() or reader_of(target) is not None)
        settings = _log_settings(config, ego, road_map, begin, end)
        if save is not None:
            if not is_log:
                raise ConfigError(f"--save writes the recording of a log; {target} holds recordings already")
            if save.suffix != ".rrd":
                raise ConfigError(f"--save {save}: a recording is called FILE.rrd")
            save_log(target, save, settings)
            typer.echo(save)
            return
        if not is_log:
            show([target] if target.is_file() else recordings(target), memory_limit, web=web)
            return
        with tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / f"{target.stem}.rrd"
            save_log(target, recording, settings)
            show([recording], memory_limit, web=web)


@app.command()
def metrics(
    name: Annotated[str | None, typer.Argument(help='A metric\'s name, or "module:NAME" of your own.')] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="The page of all: docs/metrics.md.")] = False,
) -> None:
    """List the metrics, or say all about one: formula, parameters, source, what it needs.

    [bold]Examples[/bold]

      replan metrics
      replan metrics route_progress
    """
    with answered():
        from metrics import GROUPS, load_metric, pages

        if name is not None:
            typer.echo(pages.page(load_metric(name)))
        else:
            typer.echo(pages.markdown(GROUPS) if markdown else pages.listing(GROUPS))


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
        from replay.experiments.paper import PaperConfig, reproduce

        count = _cores() if workers is None else workers
        config = PaperConfig(tuple(vehicle or ("single_track",)), roads=roads, workers=count)
        typer.echo(reproduce(out, config, say=lambda line: typer.echo(line, err=True)))


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
        from replay.calibrate import calibrate as write

        for path in write(out, vehicle, car, config):
            typer.echo(path)
