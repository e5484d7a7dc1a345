"""`replan falsify | tune | diagnose`: find the mildest failure of a planner, better settings,
causes of failures.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from replan.cli import options as opt
from replan.cli.app import app, progress_lines, say, say_json, say_sentences, worker_count
from replan.cli.options import JUDGE, LOGS, LOOP, RUNNING, log_table, option, run_config
from replan.core.errors import ConfigError

if TYPE_CHECKING:
    from replan.draw.drawn_results import Results

SHOWN = 20  # Largest number of trials of a Pareto front that are printed; pareto.csv has all
FALSIFY_CODES = (
    "Exit codes: 0 no such case found; 1 one is found: falsified; 2 wrong usage or configuration; "
    "3 the recorded case could not be driven; 130 interrupted."
)


@app.command(epilog=FALSIFY_CODES)
def falsify(
    log: Annotated[
        str | None, typer.Argument(help="A log of any format, or a family of the catalogue.")
    ] = None,
    planner: Annotated[
        str | None, opt.planner_option(LOOP, "The planner that is searched.")
    ] = None,
    list_agents: opt.ListAgents = False,
    listing: opt.ListAxes = False,
    against: Annotated[
        str,
        option(LOOP, "Who must not fail: careful (of UN R157), or a planner.", complete="planner"),
    ] = "careful",
    axis: Annotated[
        list[str] | None,
        option(
            LOGS,
            "NAME=LOW:HIGH, repeatable: what replan vary --list names, or a parameter of the "
            "family.",
        ),
    ] = None,
    scale: Annotated[
        list[str] | None,
        option(LOGS, "NAME=VALUE, repeatable: what counts as distance 1 on an axis."),
    ] = None,
    agent: Annotated[
        list[str] | None,
        option(LOGS, "Agent to vary, repeatable. Default: the one in conflict.", metavar="ID"),
    ] = None,
    budget: Annotated[int, option(RUNNING, "The most drives of the search.", metavar="N")] = 200,
    seed: opt.Seed = 0,
    resolution: Annotated[
        float, option(RUNNING, "Of the distance, at the end.", metavar="D")
    ] = 0.02,
    out: opt.Out = None,
    resume: opt.Resume = False,
    config: opt.Config = None,
    settings: opt.Set = None,
    gates: opt.Gates = None,
    workers: opt.Workers = None,
    ego: opt.Ego = None,
    road_map: opt.Map = None,
    begin: opt.Begin = None,
    end: opt.End = None,
    repair: opt.Repair = None,
    as_json: opt.Json = False,
    quiet: opt.Quiet = False,
) -> None:
    """Find the mildest variation of a log in which a planner fails its gates and the careful driver
    does not.

    [bold]Examples[/bold]

      replan falsify paper/crossing_pedestrian -p idm -o results/falsified
      replan falsify my_bag -p dp_qp --axis time=-3:3 --axis speed=0.5:2 --budget 100
      replan falsify unece_r157/cut_in -p idm --axis gap_m=0:60 --axis relative_kmh=-50:-10
      replan falsify my_log.mcap -p my_pkg.mine:MyPlanner --against dp_qp --axis standing_car=15:80
    """
    from replan.experiments.falsify import FalsifyQuestion, falsify as falsified
    from replan.experiments.search_subject import agents_of, search_axes, subject_of

    if listing:
        opt.say_axes(as_json=as_json)
        return
    if log is None or (planner is None and not list_agents):
        raise ConfigError(
            "name a log or a family, and a planner: replan falsify paper/crossing_pedestrian -p idm"
        )
    if not resolution > 0.0:
        raise ConfigError(f"--resolution must be positive, got {resolution:g}")
    options = {
        "planners": [planner] if planner else None,
        "gates": gates,
        "log": log_table(ego, road_map, begin, end, repair),
    }
    run = run_config(config, options, settings or ())
    subject = subject_of(log, run.log)
    if list_agents:
        opt.say_agents(subject.scenario, as_json=as_json)
        return
    axes = search_axes(
        axis or [], scale or [], subject.family, with_agents=len(subject.scenario.tracks) > 0
    )
    agents = agents_of(subject, axes, agent or [])
    question = FalsifyQuestion(subject.of(agents), axes, run, against, budget, seed, resolution)
    say_progress = progress_lines(quiet=quiet)
    varied = ", ".join(axis.name for axis in axes)
    names = ", ".join(question.subject.short_agents)
    say_progress(f"varied: {varied} of {names}" if names else f"varied: {varied}")
    result = falsified(
        question, out, workers=worker_count(workers), resume=resume, say=say_progress
    )
    if as_json:
        say_json(
            {
                "results": result.out,
                "exit_code": result.exit_code,
                "distance": result.mildest.distance,
                "case": result.case,
                "said": result.lines(),
            }
        )
    else:
        say_sentences(result.lines())
        say("\n".join([*result.next_steps(), f"written to {result.out}"]))
    raise typer.Exit(result.exit_code)


TUNE_CODES = (
    "Exit codes: 0 the chosen settings are better on the held-out logs; 1 they are not; 2 wrong "
    "usage or configuration; 3 a log or the planner cannot be read; 130 interrupted."
)


@app.command(epilog=TUNE_CODES)
def tune(
    planner: Annotated[str, opt.planner_option(LOOP, "The planner that is tuned.")],
    space: Annotated[Path, option(LOOP, "TOML file: settings with their ranges.", metavar="FILE")],
    logs: Annotated[
        list[Path] | None,
        typer.Argument(help="Logs of any format, or folders of them. Default: the built-in suite."),
    ] = None,
    objective: Annotated[
        list[str] | None,
        option(
            JUDGE,
            "A metric of the table, ttc.min for example; repeatable.",
            "--objective",
            metavar="METRIC",
        ),
    ] = None,
    trials: Annotated[
        int, option(RUNNING, "How many settings are tried.", min=1, metavar="N")
    ] = 50,
    seed: opt.Seed = 0,
    held_out: Annotated[
        float,
        option(
            LOGS,
            "Share of the logs that judge, and are not searched.",
            "--held-out",
            min=0.0,
            max=1.0,
        ),
    ] = 0.3,
    suite: opt.Suite = None,
    out: opt.Out = None,
    resume: opt.Resume = False,
    config: opt.Config = None,
    settings: opt.Set = None,
    gates: opt.Gates = None,
    metric: opt.Metric = None,
    workers: opt.Workers = None,
    engine: opt.Engine = "local",
    address: opt.Address = None,
    as_json: opt.Json = False,
    quiet: opt.Quiet = False,
) -> None:
    """Search settings of a planner on a part of the logs, and judge them on the others against the
    defaults.

    [bold]Examples[/bold]

      replan tune -p dp_qp --space space.toml my_logs/ --objective lon_jerk_state.p95
      replan tune -p idm --space space.toml --suite full --trials 100 -o results/tuned
      replan evaluate my_logs/ --config results/tuned/best.toml
    """
    from replan.cli.evaluate import engine_of
    from replan.cli.report import print_tables
    from replan.draw.drawn_results import load
    from replan.experiments.gains import DEFAULT_OBJECTIVES, objectives
    from replan.experiments.optuna_trials import TuningInputs
    from replan.experiments.space import load_space
    from replan.experiments.tune import tune as tuned
    from replan.run.evaluate import selected
    from replan.run.one_log import all_metrics

    options = {"planners": [planner], "metrics": metric, "gates": gates}
    run = run_config(config, options, settings or ())
    chosen = objectives(objective or DEFAULT_OBJECTIVES, all_metrics(run))
    plan = TuningInputs(run, load_space(space, run), chosen, trials, seed, held_out)
    selection = selected(logs or [], run, None, suite)
    driven_on = engine_of(engine, address, workers)
    result = tuned(
        plan, selection, out, engine=driven_on, resume=resume, say=progress_lines(quiet=quiet)
    )
    if as_json:
        say_json(
            {
                "results": result.out,
                "exit_code": result.exit_code,
                "chosen": result.chosen,
                "said": result.lines(),
            }
        )
        raise typer.Exit(result.exit_code)
    if not quiet:
        front = result.table[result.table["pareto"]].sort_values(
            "total", ascending=False, kind="stable"
        )
        shown = front.drop(columns=["feasible", "refused", "pareto"]).head(SHOWN)
        say(shown.to_string(index=False, float_format=lambda value: f"{value:.4g}"))
        if result.comparison is not None:
            print_tables(result.comparison, load(result.out / "held_out" / "chosen"), alone=False)
    say_sentences([*result.lines(), f"written to {result.out}"])
    raise typer.Exit(result.exit_code)


DIAGNOSE_CODES = (
    "Exit codes: 0 the diagnosis is done; 2 wrong usage; 3 a drive cannot be driven again, the "
    "others are diagnosed; 130 interrupted: --resume goes on."
)


@app.command(epilog=DIAGNOSE_CODES)
def diagnose(
    run: Annotated[Path, typer.Argument(help="A result folder of replan evaluate.", metavar="RUN")],
    log: Annotated[
        list[str] | None,
        opt.log_option(LOGS, "Only this log, or the logs with this in the name; repeatable."),
    ] = None,
    planner: Annotated[
        str | None, opt.planner_option(LOOP, "Whose drives. Default: the run's only planner.")
    ] = None,
    changes: Annotated[
        Path | None,
        option(LOOP, "TOML file of further changes to try (docs/experiments.md).", metavar="FILE"),
    ] = None,
    space: Annotated[
        Path | None,
        option(
            LOOP,
            "TOML file: settings with ranges; finds the smallest change that passes.",
            metavar="FILE",
        ),
    ] = None,
    against: Annotated[
        Path | None,
        option(
            LOOP,
            "A run that does better: which change of its input makes its planner plan the same.",
            metavar="BASELINE",
        ),
    ] = None,
    out: opt.Out = None,
    resume: opt.Resume = False,
    workers: opt.Workers = None,
    as_json: opt.Json = False,
    quiet: opt.Quiet = False,
) -> None:
    """Find out why drives fail: drive them again with one thing changed, and see what turns FAIL
    into PASS; or, against another run, what the planner acts on.

    [bold]Examples[/bold]

      replan diagnose results/run-001 -o results/diagnosed
      replan diagnose results/run-001 --log everyday/cut_in --planner idm
      replan diagnose results/run-001 --space space.toml
      replan diagnose results/run-002 --against results/run-001
    """
    from replan.draw.drawn_results import load
    from replan.experiments.changes import load_changes
    from replan.experiments.diagnose import diagnose as diagnosed, question
    from replan.experiments.space import load_space

    if against is not None:
        _attribute(load(run), load(against), planner, log or (), as_json=as_json, quiet=quiet)
        return
    drives = question(load(run), planner, log or (), load_changes(changes))
    settings = () if space is None else load_space(space, drives.run)
    count, say_progress = worker_count(workers), progress_lines(quiet=quiet)
    result = diagnosed(drives, out, settings, workers=count, resume=resume, say=say_progress)
    if as_json:
        say_json({**result.document(), "results": str(result.out)})
    else:
        say_sentences([*result.lines(), f"written to {result.out}"])
    if result.exit_code:
        raise typer.Exit(result.exit_code)


def _attribute(
    run: Results,
    baseline: Results,
    planner: str | None,
    logs: Sequence[str],
    *,
    as_json: bool,
    quiet: bool,
) -> None:
    """Say why the planners of two runs drive differently."""
    from replan.experiments.attribution import Pair, attribute
    from replan.results.load import named_logs

    pair = Pair.of(run, baseline, planner)
    names = dict.fromkeys(name for text in logs for name in named_logs(text, run.logs["log"]))
    result = attribute(pair, tuple(names), progress_lines(quiet=quiet))
    if as_json:
        say_json(result.document())
    else:
        say_sentences(result.lines())
