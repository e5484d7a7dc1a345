"""`replan plot`: pictures of a drive."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from logs.errors import ConfigError
from replay.cli.app import answered, app, say
from replay.cli.names import completion

if TYPE_CHECKING:
    from replay.results.load import DriveResult, Results


class Look(StrEnum):
    """Light or dark ground; auto: an SVG follows its reader's system, a PNG is light."""

    auto = "auto"
    light = "light"
    dark = "dark"


class Loop(StrEnum):
    """Which drive."""

    open = "open"
    closed = "closed"


@app.command()
def plot(
    result: Annotated[Path, typer.Argument(help="A folder of results.")],
    log: Annotated[str | None, typer.Option(help="Which log. Without it: the drive to look at first.")] = None,
    planner: Annotated[str | None, typer.Option(help="Whose drive, where there are several.")] = None,
    mode: Annotated[Loop | None, typer.Option(help="Default: closed, where it was driven.")] = None,
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
    width: Annotated[int, typer.Option(min=200, max=8000, help="Of the picture, pixels.")] = 1400,
) -> None:
    """Draw a drive as SVG or PNG: scene, S-T and S-L graph, curves, decisions.

    [bold]Examples[/bold]

      replan plot results/run-001
      replan plot results/run-001 --log paper/crossing_pedestrian --at 6.5 --chart st -o st.svg
    """
    with answered():
        from replay.draw.charts.picture import charts_of, save, together
        from replay.draw.charts.subject import subject
        from replay.results.load import load
        from replay.results.tables import safe_name

        drive = drive_of(load(result), log, planner, mode.value if mode else None)
        name = f"{safe_name(drive.log)}-{safe_name(drive.planner)}-{drive.mode}"
        path = Path(f"{name}-{safe_name(chart)}.png") if out is None else out
        if path.suffix not in ("", ".png", ".svg") and not path.is_dir():
            raise ConfigError(f"{path}: a picture ends with .png or .svg, a folder has no ending")
        seen = subject(drive, at)
        charts = charts_of(seen, chart, width)
        title = f"{drive.log}, {drive.planner}, {drive.mode} loop"
        why = "" if at is not None else f": {seen.moment.why}"
        if path.suffix in (".png", ".svg") and not path.is_dir():
            save(together(charts, title, f"at {seen.moment.t:.2f} s{why}", width), path, theme=theme.value, width=width)
            say(f"{path}  ({title}, at {seen.moment.t:.2f} s{why})")
            return
        for one in charts:
            for ending in (".png", ".svg"):
                file = path / f"{name}-{one.name}{ending}"
                save(one, file, theme=theme.value, width=width)
                say(file)


def drive_of(results: Results, log: str | None, planner: str | None, mode: str | None) -> DriveResult:
    """The drive that is asked for; without a log the one to look at first.

    Without a mode the loop in which a gate failed; of both, and of neither, the closed loop if there is one.
    """
    from metrics.judge.gates import Outcome
    from replay.draw.report.overview import overview

    if log is None:
        rows = overview(results).drives
        mine = [row for row in rows if planner in (None, row.planner)]
        order = {"fail": 0, "inconclusive": 1}
        if not mine:
            raise ConfigError(f"{results.path}: no drive{f' of {planner}' if planner else ''}")
        worst = min(mine, key=lambda row: (order.get(row.verdict, 2), -row.trouble))
        log, planner = worst.log, worst.planner
    here = results.drives[results.drives["log"] == log]
    modes = set(here["mode"] if planner is None else here.loc[here["planner"] == planner, "mode"])
    drives = [results.drive(log, planner, each) for each in ([mode] if mode else sorted(modes) or ["closed"])]
    return next((drive for drive in drives if (drive.verdicts["outcome"] == Outcome.FAIL.value).any()), drives[0])
