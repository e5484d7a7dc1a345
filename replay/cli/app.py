"""What the commands share: the app, errors as one line and an exit code, and options of several commands."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from enum import Enum
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer

from logs.errors import ConfigError, ReplanError, raised, unknown_name
from replay.cli.names import complete_setting, completion
from replay.interruption import EXIT_CODE, as_exception

if TYPE_CHECKING:
    from replay.config import RunConfig

app = typer.Typer(
    name="replan",
    help="Replay driving logs through a planner, open loop and closed loop, and judge the drives.\n\n"
    "Start with [bold]replan evaluate[/bold]: without logs it drives the built-in suite.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)

LOGS, LOOP, JUDGE, OUTPUT, RUNNING = "Logs", "Drive", "Judge", "Output", "Run"
"""The groups in which the options of `replan evaluate` are shown."""


def option(panel: str | None, words: str, *names: str, complete: str = "", **more: Any) -> Any:
    """A `typer.Option` in a group of the help.

    Args:
        panel: The group; None: that of all options.
        words: What the help says.
        names: As the option is written; none: by its parameter.
        complete: The table of `replay.cli.names` that the shell completes it from.
        more: As `typer.Option` takes it.
    """
    if complete:
        more["autocompletion"] = completion(complete)
    make: Any = typer.Option
    return make(*names, rich_help_panel=panel, help=words, **more)


Ego = Annotated[str | None, option(LOGS, "Take this road user of the log as the ego.", "--ego", metavar="ID")]
Map = Annotated[Path | None, option(LOGS, "A map that replaces that of the log.", "--map", metavar="FILE")]
Repair = Annotated[
    Literal["auto", "on", "off"] | None,
    option(LOGS, "Make tracks of raw detections: auto (if it has no tracks).", "--repair"),
]
Begin = Annotated[float | None, option(LOGS, "Begin this many seconds after the log does.", "--from", metavar="S")]
End = Annotated[float | None, option(LOGS, "End this many seconds after the log begins.", "--to", metavar="S")]
Suite = Annotated[
    str | None,
    option(
        LOGS, "Built-in logs: smoke, full, nightly, or a family or group.", "--suite", metavar="NAME", complete="suite"
    ),
]
Foxglove = Annotated[bool, option(OUTPUT, "Also write channels that Foxglove can draw.", "--foxglove")]
Json = Annotated[bool, option(OUTPUT, "Write one JSON document, and nothing else, to stdout.", "--json")]
Quiet = Annotated[bool, option(OUTPUT, "Print errors and the outcome only.", "--quiet", "-q")]
Settings = Annotated[Path | None, option(None, "TOML file of a run: its \\[log] table.", "--config", metavar="FILE")]
Set = Annotated[
    list[str] | None,
    option(
        RUNNING, "Any other setting, by its key in the file; repeatable.", "--set", metavar="KEY=VALUE",
        autocompletion=complete_setting,
    ),
]  # fmt: skip
Gates = Annotated[Path | None, option(JUDGE, "TOML file of thresholds. Default: the packaged ones.", metavar="FILE")]
Workers = Annotated[int | None, option(RUNNING, "Processes; 0: this one. Default: one per core.", min=0, metavar="N")]

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Error numbers of a full disk."""


@contextmanager
def handle_errors() -> Iterator[None]:
    """Turn errors that a user can correct into one line and an exit code; Ctrl-C and SIGTERM into 130."""
    try:
        with as_exception():
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
        raise typer.Exit(EXIT_CODE) from None


INTERNAL = 70
"""Exit code of a bug in replan (EX_SOFTWARE of sysexits.h); 1 always means that a gate failed."""
TRACEBACK = "REPLAN_TRACEBACK"
"""Environment variable: if it is set, the traceback of such an error is printed."""


def bug(error: Exception) -> NoReturn:
    """Print the error of a bug in one line, and end the process with `INTERNAL`."""
    import traceback

    if os.environ.get(TRACEBACK):
        say("".join(traceback.format_exception(error)), err=True)
    hint = "" if os.environ.get(TRACEBACK) else f"; please report it with what {TRACEBACK}=1 adds"
    say_error(f"a bug in replan: {raised(error)}{hint}")
    sys.exit(INTERNAL)


def say(text: object = "", *, err: bool = False) -> None:
    """Print to stdout or stderr, with control characters made visible: none reaches the terminal."""
    from replay.draw.report.console import visible

    typer.echo(visible(text), err=err)


def say_error(message: str) -> None:
    """Print one line to stderr."""
    say(f"error: {message}", err=True)


def say_json(document: Any) -> None:
    """Print one JSON document to stdout: dataclasses as objects, tables as lists of rows, NaN as null."""
    import json

    ascii_only = "utf" not in (sys.stdout.encoding or "").lower()  # else "?" would be written
    say(json.dumps(_plain(document), indent=2, ensure_ascii=ascii_only, allow_nan=False))


def _plain(value: Any) -> Any:
    """A value as JSON has it."""
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
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


def run_config(config: Path | None, options: Mapping[str, Any], words: Sequence[str] = ()) -> RunConfig:
    """The configuration of a run: the file, over it the options, over these the words of `--set`.

    Args:
        config: A TOML file, or None.
        options: A table like that of the file; None and empty lists are options that were not given.
        words: "KEY=VALUE" each, the key dotted, the value as TOML has it; a value that is not TOML is taken as text.

    Raises:
        ConfigError: A key is unknown, a value is wrong, or the file cannot be read.
    """
    from replay.config import RunConfig, load_run
    from replay.settings import dotted_keys, merged, set_table

    changed = set_table(words)
    keys = list(dotted_keys(RunConfig))
    for key in changed:
        if not any(key == known.partition(".")[0] for known in keys):
            raise unknown_name("key", key, keys)
    return load_run(config, merged(_given(options), changed))


def _given(options: Mapping[str, Any]) -> dict[str, Any]:
    """A table without the options that were not given."""
    tables = {key: _given(value) if isinstance(value, Mapping) else value for key, value in options.items()}
    return {key: value for key, value in tables.items() if value is not None and value != []}


def log_table(
    ego: str | None, road_map: Path | None, begin: float | None, end: float | None, repair: str | None
) -> dict[str, Any]:
    """The options about logs as the table [log] of a run."""
    place = None if road_map is None else str(road_map)
    return {"ego": ego, "map": place, "begin": begin, "end": end, "repair": repair}


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
