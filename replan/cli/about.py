"""`replan list | metrics | warmup`: what replan knows; kernels compiled beforehand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from replan.cli import options as opt
from replan.cli.app import app, progress_lines, say, say_error, say_json
from replan.cli.options import completion, run_config


@app.command("list")
def listed(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[KIND|NAME]",
            help=(
                "A kind (planners, metrics ...), or a name: idm, my_pkg.mine:Mine. Default: the "
                "kinds."
            ),
            autocompletion=completion("listed"),
        ),
    ] = None,
    as_json: opt.Json = False,
) -> None:
    """List the names of a kind, each with one line and its place in the code; or a name, with its
    settings.

    A setting has its key for --set, its default, unit, permitted range with the other defaults, and
    meaning.

    [bold]Examples[/bold]

      replan list
      replan list controllers
      replan list dp_qp
    """
    from replan.cli import listing

    if name is None:
        entries: Any = (
            {kind: listing.entries(kind) for kind in listing.KINDS} if as_json else listing.counts()
        )
    elif name in listing.KINDS:
        entries = listing.entries(name) if as_json else listing.lines(listing.entries(name))
    else:
        entries = listing.described(name) if as_json else listing.page(listing.described(name))
    say_json(entries) if as_json else say("\n".join(entries))


@app.command()
def metrics(
    name: Annotated[
        str | None, typer.Argument(help='Name of a metric, or "module:NAME" of your own.')
    ] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print docs/metrics.md.")] = False,
    as_json: opt.Json = False,
) -> None:
    """List the metrics, or describe one: formula, parameters, source, what it needs.

    [bold]Examples[/bold]

      replan metrics
      replan metrics route_progress
    """
    from replan.metrics import GROUPS, load_metric
    from replan.metrics.metric_pages import (
        list_metrics,
        metric_facts,
        metric_page,
        metrics_markdown,
    )

    if as_json:
        facts = [metric_facts(metric) for group in GROUPS.values() for metric in group]
        say_json(facts if name is None else metric_facts(load_metric(name)))
    elif name is not None:
        say(metric_page(load_metric(name)))
    else:
        say(metrics_markdown(GROUPS) if markdown else list_metrics(GROUPS))


@app.command()
def warmup(
    planner: Annotated[
        list[str] | None, opt.planner_option(None, "Repeatable. Default: dp_qp.")
    ] = None,
    config: Annotated[
        Path | None, opt.config_option("TOML file of a run, for its kernels.")
    ] = None,
    every: Annotated[
        bool, typer.Option("--all", help="Compile the kernels of all that is built in.")
    ] = False,
    as_json: opt.Json = False,
    quiet: opt.Quiet = False,
) -> None:
    """Compile the kernels that a run needs, and keep them, so that the first log starts at once.

    They are kept in NUMBA_CACHE_DIR, else beside the installed code, else in the user's cache
    folder: docs/ci.md.

    [bold]Examples[/bold]

      replan warmup
      NUMBA_CACHE_DIR=/var/cache/replan replan warmup --planner dp_qp --planner lattice
    """
    run = run_config(config, {"planners": planner})
    from replan.cli.sign_of_life import sign_of_life, with_kernels
    from replan.run.warmup import SCENES, everything, warm_up

    if not quiet:
        say("compiling kernels (a minute or two; seconds if they were compiled before)", err=True)
    with sign_of_life(progress_lines(quiet=quiet), with_kernels(lambda: "driving built-in logs")):
        warmed = warm_up([(run, SCENES), *(everything() if every else ())])
    for failure in warmed.failures:
        say_error(failure.message)
    where = "nowhere: no folder can be written" if warmed.folder is None else warmed.folder
    if as_json:
        say_json(
            {
                "seconds": warmed.seconds,
                "compiled": warmed.compiled,
                "folder": warmed.folder,
                "failures": warmed.failures,
            }
        )
    elif not quiet:
        say(f"{warmed.compiled} kernels compiled, {warmed.seconds:.1f} s; kept in: {where}")
    if warmed.failures:
        raise typer.Exit(3)
