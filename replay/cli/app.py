"""What all commands share: the app, errors as one line and an exit code, options that come repeatedly."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from logs.errors import ConfigError, ReplanError

if TYPE_CHECKING:
    from logs.readers import LogSettings
    from replay.config import RunConfig

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


def run_config(config: Path | None, options: dict[str, Any], loop: dict[str, Any]) -> RunConfig:
    """The configuration file with the options over it; None is an option that was not given."""
    from replay.config import RunConfig, load_run

    run = RunConfig() if config is None else load_run(config)
    looped = replace(run.loop, **{key: value for key, value in loop.items() if value is not None})
    return replace(run, loop=looped, **{key: value for key, value in options.items() if value is not None})


def log_settings(
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


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
