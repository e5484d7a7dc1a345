"""What all commands share: the app, errors as one line and an exit code, options that come repeatedly."""

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

if TYPE_CHECKING:
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

LOGS, LOOP, JUDGE, OUTPUT, RUNNING = "Logs", "Drive", "Judge", "Output", "Run"
"""The groups in which the options of `replan evaluate` are shown."""

Ego = Annotated[
    str | None,
    typer.Option("--ego", metavar="ID", rich_help_panel=LOGS, help="Take this road user of the log as the ego."),
]
Map = Annotated[
    Path | None,
    typer.Option("--map", metavar="FILE", rich_help_panel=LOGS, help="A map that replaces that of the log."),
]
Repair = Annotated[
    Literal["auto", "on", "off"] | None,
    typer.Option("--repair", rich_help_panel=LOGS, help="Make tracks of raw detections: auto (if it has no tracks)."),
]
Begin = Annotated[
    float | None,
    typer.Option("--from", metavar="S", rich_help_panel=LOGS, help="Begin this many seconds after the log does."),
]
End = Annotated[
    float | None,
    typer.Option("--to", metavar="S", rich_help_panel=LOGS, help="End this many seconds after the log begins."),
]
Foxglove = Annotated[
    bool, typer.Option("--foxglove", rich_help_panel=OUTPUT, help="Also write channels that Foxglove can draw.")
]
Suite = Annotated[
    str | None,
    typer.Option(
        "--suite",
        metavar="NAME",
        rich_help_panel=LOGS,
        autocompletion=completion("suite"),
        help="Built-in logs: smoke, full, nightly, or a family or group.",
    ),
]
Json = Annotated[
    bool, typer.Option("--json", rich_help_panel=OUTPUT, help="Write one JSON document, and nothing else, to stdout.")
]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", rich_help_panel=OUTPUT, help="Print errors and the outcome only.")
]
Settings = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="TOML file of a run: its \\[log] table.")
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        rich_help_panel=RUNNING,
        autocompletion=complete_setting,
        help="Any other setting, by its key in the file; repeatable.",
    ),
]
Gates = Annotated[
    Path | None,
    typer.Option(metavar="FILE", rich_help_panel=JUDGE, help="TOML file of thresholds. Default: the packaged ones."),
]
Workers = Annotated[
    int | None,
    typer.Option(min=0, metavar="N", rich_help_panel=RUNNING, help="Processes; 0: this one. Default: one per core."),
]

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""What the system says where there is no more room."""


@contextmanager
def handle_errors() -> Iterator[None]:
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
