"""`replan list | metrics`: what replan knows."""

from __future__ import annotations

from typing import Annotated

import typer

from replay.cli.app import Json, app, handle_errors, say, say_json
from replay.cli.names import completion


@app.command("list")
def listed(
    kind: Annotated[
        str | None,
        typer.Argument(
            help="planners, controllers, metrics ... Default: the number of names of each kind.",
            autocompletion=completion("kind"),
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """List the names of a kind, each with one line and its place in the code.

    [bold]Examples[/bold]

      replan list
      replan list controllers
    """
    with handle_errors():
        from replay.cli import listing

        if as_json:
            kinds = listing.KINDS if kind is None else (kind,)
            found = {one: listing.entries(one) for one in kinds}
            say_json(found if kind is None else found[kind])
        else:
            say("\n".join(listing.counts() if kind is None else listing.lines(listing.entries(kind))))


@app.command()
def metrics(
    name: Annotated[str | None, typer.Argument(help='Name of a metric, or "module:NAME" of your own.')] = None,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print docs/metrics.md.")] = False,
    as_json: Json = False,
) -> None:
    """List the metrics, or describe one: formula, parameters, source, what it needs.

    [bold]Examples[/bold]

      replan metrics
      replan metrics route_progress
    """
    with handle_errors():
        from metrics import GROUPS, load_metric
        from metrics.metric import list_metrics, metric_facts, metric_page, metrics_markdown

        if as_json:
            found = [metric_facts(metric) for group in GROUPS.values() for metric in group]
            say_json(found if name is None else metric_facts(load_metric(name)))
        elif name is not None:
            say(metric_page(load_metric(name)))
        else:
            say(metrics_markdown(GROUPS) if markdown else list_metrics(GROUPS))
