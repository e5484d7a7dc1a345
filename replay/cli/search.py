"""`replan falsify | tune`: the mildest failure of a planner, and better settings."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from logs.errors import ConfigError
from replay.cli.app import (
    JUDGE,
    LOGS,
    LOOP,
    OUTPUT,
    RUNNING,
    Begin,
    Ego,
    End,
    Gates,
    Json,
    Map,
    Quiet,
    Repair,
    Set,
    Suite,
    Workers,
    app,
    cores,
    handle_errors,
    log_table,
    option,
    run_config,
    say,
    say_json,
)  # fmt: skip

if TYPE_CHECKING:
    from replay.search.tune import Tuned

SHOWN = 20
"""Trials of a Pareto front that are printed; pareto.csv has all."""
Config = Annotated[Path | None, option(RUNNING, "TOML file of settings; options win over it.", metavar="FILE")]
Out = Annotated[
    Path | None, option(OUTPUT, "Result folder. Default: results/run-NNN.", "--out", "-o", metavar="FOLDER")
]
Seed = Annotated[int, option(RUNNING, "Another seed, another search.", min=0, metavar="N")]
Resume = Annotated[bool, option(RUNNING, "Continue the interrupted search in --out.", "--resume")]
FALSIFY_CODES = (
    "Exit codes: 0 no such case found; 1 one is found: falsified; 2 wrong usage or configuration; 3 the recorded case"
    " could not be driven; 130 interrupted."
)


@app.command(epilog=FALSIFY_CODES)
def falsify(
    log: Annotated[str, typer.Argument(help="A log of any format, or a family of the catalogue.")],
    planner: Annotated[
        str, option(LOOP, "The planner that is searched.", "--planner", "-p", metavar="NAME", complete="planner")
    ],
    against: Annotated[
        str, option(LOOP, "Who must not fail: careful (of UN R157), or a planner.", metavar="NAME", complete="planner")
    ] = "careful",
    axis: Annotated[
        list[str] | None,
        option(LOGS, "NAME=LOW:HIGH, repeatable: what replan vary --list names, or a parameter of the family."),
    ] = None,
    scale: Annotated[
        list[str] | None, option(LOGS, "NAME=VALUE, repeatable: what counts as distance 1 on an axis.")
    ] = None,
    agent: Annotated[
        list[str] | None, option(LOGS, "Agent to vary, repeatable. Default: the one in conflict.", metavar="ID")
    ] = None,
    budget: Annotated[int, option(RUNNING, "The most drives of the search.", metavar="N")] = 200,
    seed: Seed = 0,
    resolution: Annotated[float, option(RUNNING, "Of the distance, at the end.", metavar="D")] = 0.02,
    out: Out = None,
    resume: Resume = False,
    config: Config = None,
    settings: Set = None,
    gates: Gates = None,
    workers: Workers = None,
    ego: Ego = None,
    road_map: Map = None,
    begin: Begin = None,
    end: End = None,
    repair: Repair = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find the mildest variation of a log in which a planner fails its gates and the careful driver does not.

    [bold]Examples[/bold]

      replan falsify paper/crossing_pedestrian -p idm -o results/falsified
      replan falsify my_bag -p dp_qp --axis time=-3:3 --axis speed=0.5:2 --budget 100
      replan falsify unece_r157/cut_in -p idm --axis gap_m=0:60 --axis relative_kmh=-50:-10
      replan falsify my_log.mcap -p my_pkg.mine:MyPlanner --against dp_qp --axis standing_car=15:80
    """
    with handle_errors():
        from replay.results.tables import next_free
        from replay.search.axes import search_axes
        from replay.search.falsify import Question
        from replay.search.falsify import falsify as falsified
        from replay.search.subject import agents_of, opened

        if not resolution > 0.0:
            raise ConfigError(f"--resolution must be positive, got {resolution:g}")
        options = {
            "planners": [planner],
            "gates": None if gates is None else str(gates),
            "log": log_table(ego, road_map, begin, end, repair),
        }
        run = run_config(config, options, settings or ())
        subject = opened(log, run.log)
        axes = search_axes(axis or [], scale or [], subject.family, with_agents=len(subject.scenario.tracks) > 0)
        agents = agents_of(subject, axes, agent or [])
        question = Question(subject.of(agents), axes, run, against, budget, seed, resolution)
        with kept(out, resume=resume) as folder:
            folder = next_free() if folder is None else folder
            count = cores() if workers is None else workers
            tell(f"varied: {', '.join(axis.name for axis in axes)}{_of(subject.of(agents).short_agents)}", quiet=quiet)
            result = falsified(question, folder, workers=count, resume=resume, say=lambda line: tell(line, quiet=quiet))
        if as_json:
            say_json({"results": result.out, "exit_code": result.exit_code, "distance": result.found.distance,
                      "case": result.case, "said": result.lines()})  # fmt: skip
        else:
            say("\n".join([*result.lines(), *result.next_steps(), f"written to {result.out}"]))
        raise typer.Exit(result.exit_code)


def _of(agents: tuple[str, ...]) -> str:
    return f" of {', '.join(agents)}" if agents else ""


def tell(line: str, *, quiet: bool) -> None:
    """Print a line of progress to stderr."""
    if not quiet:
        say(line, err=True)


@contextmanager
def kept(out: Path | None, *, resume: bool) -> Iterator[Path | None]:
    """The folder; an interruption says how to continue."""
    if resume and out is None:
        raise ConfigError("name the folder of the search to be resumed with --out")
    try:
        yield out
    except KeyboardInterrupt:
        how = "" if out is None else f"; to continue, give the same command with --out {out} --resume"
        raise KeyboardInterrupt(f"interrupted: finished trials are kept{how}") from None


TUNE_CODES = (
    "Exit codes: 0 the chosen settings are better on the held-out logs; 1 they are not; 2 wrong usage or configuration;"
    " 3 a log or the planner cannot be read; 130 interrupted."
)


@app.command(epilog=TUNE_CODES)
def tune(
    planner: Annotated[
        str, option(LOOP, "The planner that is tuned.", "--planner", "-p", metavar="NAME", complete="planner")
    ],
    space: Annotated[Path, option(LOOP, "TOML file: settings with their ranges.", metavar="FILE")],
    logs: Annotated[
        list[Path] | None, typer.Argument(help="Logs of any format, or folders of them. Default: the built-in suite.")
    ] = None,
    objective: Annotated[
        list[str] | None,
        option(JUDGE, "A metric of the table, ttc.min for example; repeatable.", "--objective", metavar="METRIC"),
    ] = None,
    trials: Annotated[int, option(RUNNING, "How many settings are tried.", min=1, metavar="N")] = 50,
    seed: Seed = 0,
    held_out: Annotated[
        float, option(LOGS, "Share of the logs that judge, and are not searched.", "--held-out", min=0.0, max=1.0)
    ] = 0.3,
    suite: Suite = None,
    out: Out = None,
    resume: Resume = False,
    config: Config = None,
    settings: Set = None,
    gates: Gates = None,
    metric: Annotated[
        list[str] | None, option(JUDGE, "A metric of your own, module:NAME; repeatable.", metavar="NAME")
    ] = None,
    workers: Workers = None,
    engine: Annotated[
        Literal["local", "ray"], option(RUNNING, "Where logs are driven. Default: local.", show_default=False)
    ] = "local",
    address: Annotated[
        str | None, option(RUNNING, "Ray cluster (or auto). Default: one for this run.", metavar="HOST:PORT")
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Search settings of a planner on a part of the logs, and judge them on the others against the defaults.

    [bold]Examples[/bold]

      replan tune -p dp_qp --space space.toml my_logs/ --objective route_progress.final --objective lon_jerk_state.p95
      replan tune -p idm --space space.toml --suite full --trials 100 -o results/tuned
      replan evaluate my_logs/ --config results/tuned/best.toml
    """
    with handle_errors():
        from replay.cli.evaluate import engine_of
        from replay.results.tables import next_free
        from replay.run.evaluate import selected
        from replay.run.one_log import all_metrics
        from replay.search.gains import DEFAULT_OBJECTIVES, objectives
        from replay.search.space import load_space
        from replay.search.trials import Plan
        from replay.search.tune import tune as tuned

        options = {"planners": [planner], "metrics": metric, "gates": None if gates is None else str(gates)}
        run = run_config(config, options, settings or ())
        asked = objectives(objective or DEFAULT_OBJECTIVES, all_metrics(run))
        plan = Plan(run, load_space(space, run), asked, trials, seed, held_out)
        selection = selected(logs or [], run, None, suite)
        driven_on = engine_of(engine, address, workers)
        with kept(out, resume=resume) as folder:
            folder = next_free() if folder is None else folder
            result = tuned(plan, selection, folder, engine=driven_on, resume=resume,
                           say=lambda line: tell(line, quiet=quiet))  # fmt: skip
        if as_json:
            say_json({"results": result.out, "exit_code": result.exit_code, "chosen": result.chosen,
                      "said": result.lines()})  # fmt: skip
        else:
            print_tuned(result, quiet=quiet)
        raise typer.Exit(result.exit_code)


def print_tuned(result: Tuned, *, quiet: bool) -> None:
    """Print the Pareto table, the comparison on the held-out logs, and what is said of both."""
    from replay.cli.compare import print_tables
    from replay.results.load import load

    if not quiet:
        front = result.table[result.table["pareto"]].sort_values("total", ascending=False, kind="stable")
        shown = front.drop(columns=["feasible", "refused", "pareto"]).head(SHOWN)
        say(shown.to_string(index=False, float_format=lambda value: f"{value:.4g}"))
        if result.comparison is not None:
            print_tables(result.comparison, load(result.out / "held_out" / "chosen"), alone=False)
    say("\n".join([*result.lines(), f"written to {result.out}"]))
