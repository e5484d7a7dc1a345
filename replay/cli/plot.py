"""`replan plot`: pictures of a drive."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from logs.errors import ConfigError
from replay.cli.app import app, handle_errors, say
from replay.cli.chosen import OfLog, OfMode, OfPlanner, chosen_drive
from replay.cli.names import completion


class Look(StrEnum):
    """Light or dark ground; auto: an SVG follows its reader's system, a PNG is light."""

    auto = "auto"
    light = "light"
    dark = "dark"


@app.command()
def plot(
    result: Annotated[Path, typer.Argument(help="A folder of results.")],
    log: OfLog = None,
    planner: OfPlanner = None,
    mode: OfMode = None,
    at: Annotated[float | None, typer.Option(help="Time, s. Default: the worst moment.")] = None,
    chart: Annotated[
        str,
        typer.Option(
            autocompletion=completion("chart"),
            help="What is drawn: scene, st, sl, curves, decisions, all, or module:NAME of your own.",
        ),
    ] = "all",
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="FILE.png, FILE.svg, or a folder: each by itself.")
    ] = None,
    theme: Annotated[Look, typer.Option(help="Auto: an SVG follows its reader's system, a PNG is light.")] = Look.auto,
    width: Annotated[int, typer.Option(min=200, max=8000, help="Width of the picture, pixels.")] = 1400,
) -> None:
    """Draw a drive as SVG or PNG: scene, S-T and S-L graph, curves, decisions.

    [bold]Examples[/bold]

      replan plot results/run-001
      replan plot results/run-001 --log paper/crossing_pedestrian --at 6.5 --chart st -o st.svg
    """
    with handle_errors():
        from replay.draw.charts.layout import charts_of, save, together
        from replay.draw.charts.subject import subject
        from replay.results.load import load
        from replay.results.tables import safe_name

        chosen = chosen_drive(load(result), log, planner, mode)
        drive, title = chosen.drive, chosen.title
        name = f"{safe_name(drive.log)}-{safe_name(drive.planner)}-{drive.mode}"
        path = Path(f"{name}-{safe_name(chart)}.png") if out is None else out
        if path.suffix not in ("", ".png", ".svg") and not path.is_dir():
            raise ConfigError(f"{path}: a picture ends with .png or .svg, a folder has no ending")
        seen = subject(drive, at)
        charts = charts_of(seen, chart, width)
        why = "" if at is not None else f": {seen.moment.why}"
        if path.suffix in (".png", ".svg") and not path.is_dir():
            save(together(charts, title, f"at {seen.moment.t:.2f} s{why}", width), path, theme=theme.value, width=width)
            say(f"{path}  ({title}, at {seen.moment.t:.2f} s{why}){chosen.remark}")
            return
        for one in charts:
            for ending in (".png", ".svg"):
                file = path / f"{name}-{one.name}{ending}"
                save(one, file, theme=theme.value, width=width)
                say(file)
