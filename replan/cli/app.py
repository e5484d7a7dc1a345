"""What the commands share: the app, errors as one line and an exit code, and output."""

from __future__ import annotations

import errno
import os
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from enum import Enum
from math import isfinite
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand

from replan.core.errors import ConfigError, ReplanError, bounded, limit_error, raised
from replan.interruption import EXIT_CODE, as_exception

if TYPE_CHECKING:
    from typer.models import CommandInfo, TyperInfo

    from replan.draw.report.console import SafeConsole

app = typer.Typer(
    name="replan",
    help=(
        "Replay driving logs through a planner, open loop and closed loop, and judge the "
        "drives.\n\n"
        "Start with [bold]replan evaluate[/bold]: without logs it drives the built-in suite."
    ),
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # Error numbers of a full disk


@contextmanager
def handle_errors() -> Iterator[None]:
    """Turn errors that a user can correct into one line and an exit code; Ctrl-C and SIGTERM into
    130.
    """
    try:
        with as_exception():
            yield
    except KeyboardInterrupt as interruption:
        say_error(str(interruption) or "interrupted")
        raise typer.Exit(EXIT_CODE) from None
    except Exception as error:
        code = say_correctable(error)
        if code is None:
            raise
        raise typer.Exit(code) from None


def say_correctable(error: Exception) -> int | None:
    """Print an error that a user can correct in one line, and return its exit code; None for any
    other.
    """
    correctable = error if isinstance(error, ReplanError) else limit_error(error)
    if correctable is not None:
        say_error(str(correctable))
        return 2 if isinstance(correctable, ConfigError) else 3
    if not isinstance(error, OSError):
        return None
    full = error.errno in FULL  # a full disk; else a file that cannot be written
    problem = f"{error.filename or 'standard output'}: cannot be written: {error.strerror}"
    say_error(problem if full else bounded(str(error)))
    return 3 if full else 2


class StrictCommand(TyperCommand):
    """A command that handles errors, and refuses an option with one value that is given twice."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        with handle_errors():
            return super().invoke(ctx)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The words, parsed; UsageError if an option would lose a value."""
        options: dict[str, Any] = {}
        for parameter in self.params:
            if parameter.param_type_name == "option" and not getattr(parameter, "is_flag", False):
                names = (*parameter.opts, *parameter.secondary_opts)
                options |= dict.fromkeys(names, parameter)
        times = Counter[Any]()
        words = iter(args)
        for word in words:
            if word == "--":
                break
            name = word.partition("=")[0] if word.startswith("--") else word[:2]
            if name in options:
                times[options[name]] += 1
                if word == name:  # its value is the next word
                    next(words, None)
        arguments = {
            f"--{parameter.name}"
            for parameter in self.params
            if parameter.param_type_name == "argument"
        }
        for name in (word.partition("=")[0] for word in args):
            if name in arguments:
                hint = f"is given by position: {ctx.command_path} {name[2:].upper()} ..."
                raise typer.BadParameter(hint, ctx, param_hint=name)
        for option, number in times.items():
            if number > 1 and not option.multiple:
                raise typer.BadParameter(
                    f"takes one value, and is given {number} times", ctx, param=option
                )
        parsed: list[str] = super().parse_args(ctx, args)
        return parsed


def group_commands(panels: Mapping[str, Sequence[str]]) -> None:
    """Show the commands, now strict, in the help in these groups and this order; KeyError if one
    has no group.
    """
    places = {name: panel for panel, names in panels.items() for name in names}
    order = {name: position for position, name in enumerate(places)}
    for command in app.registered_commands:
        command.rich_help_panel = places[_name_of(command)]
        command.cls = StrictCommand
    for group in app.registered_groups:
        group.rich_help_panel = places[_name_of(group)]
    app.registered_commands.sort(key=lambda command: order[_name_of(command)])


def _name_of(command: CommandInfo | TyperInfo) -> str:
    return command.name or command.callback.__name__  # type: ignore[union-attr]


# Exit code of a bug in replan (EX_SOFTWARE of sysexits.h); 1 always means that a gate failed
INTERNAL = 70
# Environment variable: if it is set, the traceback of a bug is printed
TRACEBACK = "REPLAN_TRACEBACK"


def bug(error: Exception) -> NoReturn:
    """Print the error of a bug in one line, and end the process with `INTERNAL`."""
    import traceback

    if os.environ.get(TRACEBACK):
        say("".join(traceback.format_exception(error)), err=True)
    hint = "" if os.environ.get(TRACEBACK) else f"; please report it with what {TRACEBACK}=1 adds"
    say_error(f"a bug in replan: {raised(error)}{hint}")
    sys.exit(INTERNAL)


def say(text: object = "", *, err: bool = False) -> None:
    """Print to stdout or stderr, with control characters made visible, so that none reaches the
    terminal.
    """
    from replan.draw.report.console import visible

    typer.echo(visible(text), err=err)


def say_sentences(lines: Iterable[str]) -> None:
    """Print lines of text to stdout, on a terminal wrapped at spaces."""
    from replan.draw.report.console import wrapped

    columns = shutil.get_terminal_size().columns if sys.stdout.isatty() else 0
    for line in "\n".join(lines).split("\n"):
        say(wrapped(line, columns) if columns else line)


def console_of(width: int) -> SafeConsole:
    """The console of stdout for tables; `width` characters wide if stdout is not a terminal and
    COLUMNS is not set.
    """
    from replan.draw.report.console import SafeConsole

    wide = None if sys.stdout.isatty() or "COLUMNS" in os.environ else width
    return SafeConsole(width=wide, soft_wrap=False)


def progress_lines(*, quiet: bool = False) -> Callable[[str], None]:
    """The function that prints a line of progress to stderr; with `quiet` it prints nothing."""

    def print_line(line: str) -> None:
        if not quiet:
            say(line, err=True)

    return print_line


def say_error(message: str) -> None:
    """Print one line to stderr."""
    say(f"error: {message}", err=True)


def say_json(document: Any) -> None:
    """Print one JSON document to stdout: dataclasses as objects, tables as lists of rows, NaN as
    null.
    """
    import json

    ascii_only = "utf" not in (sys.stdout.encoding or "").lower()  # else "?" would be written
    say(json.dumps(_as_json_value(document), indent=2, ensure_ascii=ascii_only, allow_nan=False))


def _as_json_value(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return {item.name: _as_json_value(getattr(value, item.name)) for item in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _as_json_value(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_as_json_value(item) for item in value]
    if hasattr(value, "to_dict"):
        return _as_json_value(value.to_dict("records"))
    if hasattr(value, "item"):  # a number of NumPy's
        return _as_json_value(value.item())
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, Enum):
        return value.value
    return value if isinstance(value, (str, int, type(None))) else str(value)


def _print_version(asked: bool) -> None:
    if asked:
        from replan.results.version import replan_version

        say(f"replan {replan_version()}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    pass


def worker_count(workers: int | None) -> int:
    """The number of worker processes of `--workers`.

    By default one for each core that this process may use.
    """
    if workers is not None:
        return workers
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
