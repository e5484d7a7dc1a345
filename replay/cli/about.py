"""`replan metrics`: what replan knows."""

from __future__ import annotations

from typing import Annotated

import typer

from replay.cli.app import answered, app


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
