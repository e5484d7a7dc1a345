"""What all commands share: the app, errors as one line and an exit code, options that come repeatedly."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer

from logs.errors import ConfigError, ReplanError, raised
from replay.cli.names import completion

if TYPE_CHECKING:
    from logs.readers import LogSettings
    from replay.config import RunConfig

app = typer.Typer(
    name="replan",
    help="Replay driving logs through a planner, open loop and closed loop, and judge what it did.\n\n"
    "Start with [bold]replan evaluate[/bold]: it needs no logs, the built-in suite is driven.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)

Ego = Annotated[str | None, typer.Option("--ego", help="Take this road user of the log as the ego.")]
Map = Annotated[Path | None, typer.Option("--map", help="A map that replaces the log's.")]
Repair = Annotated[
    Literal["auto", "on", "off"] | None,
    typer.Option("--repair", help="Make raw detections into tracks: auto (where they are none), on, off."),
]
Begin = Annotated[float | None, typer.Option("--from", help="Begin so many seconds after the log's.")]
End = Annotated[float | None, typer.Option("--to", help="End so many seconds after the log's begin.")]
Foxglove = Annotated[bool, typer.Option("--foxglove", help="Channels that Foxglove draws, in what is written.")]
Suite = Annotated[
    str | None,
    typer.Option(
        "--suite",
        autocompletion=completion("suite"),
        help="smoke, full, nightly; or a family or group with all its cells.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="One JSON document on stdout, and nothing else there.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say errors and the outcome only.")]
Settings = Annotated[Path | None, typer.Option("--config", help="TOML file of a run: its \\[log] table.")]

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""What the system says where there is no more room."""


@contextmanager
def answered() -> Iterator[None]:
    """What a user can mend becomes one line and an exit code; Ctrl-C and SIGTERM become 130."""
    try:
        yield
    except ReplanError as error:
        say_error(str(error))
        raise typer.Exit(2 if isinstance(error, ConfigError) else 3) from None
    except OSError as error:  # a file that cannot be written, or a full disk
        full = error.errno in FULL
        what = f"{error.filename or 'standard output'}: cannot be written: {error.strerror}"
        say_error(what if full else str(error))
        raise typer.Exit(3 if full else 2) from None
    except KeyboardInterrupt as interruption:
        say_error(str(interruption) or "interrupted")
        raise typer.Exit(130) from None


INTERNAL = 70
"""Exit code of an error that is a bug in replan (EX_SOFTWARE of sysexits.h); 1 only ever says that a gate failed."""
TRACEBACK = "REPLAN_TRACEBACK"
"""Environment variable: where it is set, such an error comes with its traceback."""


def bug(error: Exception) -> NoReturn:
    """Say in one line what happened, and end the process with `INTERNAL`."""
    import traceback

    if os.environ.get(TRACEBACK):
        say("".join(traceback.format_exception(error)), err=True)
    hint = "" if os.environ.get(TRACEBACK) else f"; please report it with what {TRACEBACK}=1 adds"
    say_error(f"a bug in replan: {raised(error)}{hint}")
    sys.exit(INTERNAL)


def say(text: object = "", *, err: bool = False) -> None:
    """On stdout or stderr, with control characters that can be seen: none reaches the terminal."""
    from replay.draw.report.console import visible

    typer.echo(visible(text), err=err)


def say_error(message: str) -> None:
    """One line on stderr."""
    say(f"error: {message}", err=True)


def say_json(document: Any) -> None:
    """One JSON document on stdout; dataclasses are objects, tables lists of rows, what is no number is null."""
    import json

    ascii_only = "utf" not in (sys.stdout.encoding or "").lower()  # else "?" would be written
    say(json.dumps(_plain(document), indent=2, ensure_ascii=ascii_only, allow_nan=False))


def _plain(value: Any) -> Any:
    """As JSON has it."""
    if is_dataclass(value) and not isinstance(value, type):
        return {item.name: _plain(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if hasattr(value, "to_dict"):
        return _plain(value.to_dict("records"))
    if hasattr(value, "item"):  # a number of NumPy's
        return _plain(value.item())
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, Enum):
        return value.value
    return value if isinstance(value, (str, int, type(None))) else str(value)


def _version(asked: bool) -> None:
    if asked:
        from replay.results.version import replan_version

        say(f"replan {replan_version()}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say the version.")
    ] = False,
) -> None:
    pass


def run_config(
    config: Path | None, options: dict[str, Any], loop: dict[str, Any], apart: dict[str, Any] | None = None
) -> RunConfig:
    """The configuration file with the options over it; None is an option that was not given."""
    from replay.config import RunConfig, load_run

    def over(table: Any, given: dict[str, Any]) -> Any:
        return replace(table, **{key: value for key, value in given.items() if value is not None})

    run = RunConfig() if config is None else load_run(config)
    limits = over(run.loop.apart, apart or {})
    made: RunConfig = over(run, {**options, "loop": over(run.loop, {**loop, "apart": limits})})
    return made


def log_settings(
    config: Path | None,
    ego: str | None,
    road_map: Path | None,
    begin: float | None,
    end: float | None,
    problem: int | None = None,
    repair: str | None = None,
) -> LogSettings:
    """The [log] table of the configuration file with the options over it."""
    from logs.readers.base import LogSettings
    from replay.config import load_run

    options: dict[str, Any] = {"ego": ego, "begin": begin, "end": end, "problem": problem, "repair": repair}
    given = {key: value for key, value in options.items() if value is not None}
    given |= {} if road_map is None else {"map": str(road_map)}
    try:
        return replace(LogSettings() if config is None else load_run(config).log, **given)
    except ValueError as error:
        raise ConfigError(str(error)) from None


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
