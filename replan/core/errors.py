"""The errors of replan and their exit codes: one base class, few subclasses.

    ReplanError                 one line that names the problem, the place and the remedy
     |- LogError                a log cannot be read or evaluated            exit code 3
     |- PlannerError            a planner cannot be loaded, or raised        exit code 3
     |- OutputError             a file cannot be written: a full disk        exit code 3
     |- LimitError              no more memory, or no more open files        exit code 3
     '- ConfigError             a wrong option, key, threshold or name       exit code 2

The command line prints `str(error)` and never a traceback for these; any other exception is a bug.
"""

from __future__ import annotations

import os
import re
import sysconfig
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from traceback import extract_tb
from types import FunctionType
from typing import Any

from replan.core.own_sources import own_folders

LONGEST_ERROR = 2000
"""Greatest number of characters of an error: of a longer one, the middle is left out."""


class ReplanError(Exception):
    """Base class of all errors that a user can cause and correct."""

    def __str__(self) -> str:
        return bounded(super().__str__())


def encodable(text: str) -> str:
    """Return the text with an escape instead of each character that UTF-8 cannot encode."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def bounded(text: str) -> str:
    """Return the text, `encodable`, with at most about `LONGEST_ERROR` characters."""
    text = encodable(text)
    if len(text) <= LONGEST_ERROR:
        return text
    begin, end = text[: LONGEST_ERROR // 2], text[-LONGEST_ERROR // 3 :]
    return f"{begin} ... ({len(text)} characters) ... {end}"


class LogError(ReplanError):
    """A log cannot be used.

    Args:
        what: The problem, in a few words ("yaw is NaN").
        file: The log.
        topic: The channel or the part of the file that has the problem.
        time_ns: Log time of the offending message, nanoseconds.
        remedy: What the user can do.
    """

    def __init__(
        self,
        what: str,
        *,
        file: str | Path | None = None,
        topic: str | None = None,
        time_ns: int | None = None,
        remedy: str | None = None,
    ) -> None:
        self.what = what
        self.file = file
        self.topic = topic
        self.time_ns = time_ns
        self.remedy = remedy
        super().__init__(what)

    def __str__(self) -> str:
        parts = [str(self.file)] if self.file is not None else []
        if self.topic is not None:
            parts.append(f"topic {self.topic}")
        if self.time_ns is not None:
            parts.append(f"time {self.time_ns / 1e9:.3f} s")
        line = ": ".join(filter(None, [", ".join(parts), self.what]))
        return bounded(" ".join((f"{line}; {self.remedy}" if self.remedy else line).split()))

    def at(self, file: str | Path) -> LogError:
        """Return a copy of the error that names the file: the code that decodes a message does not
        know the file.
        """
        return LogError(
            self.what, file=file, topic=self.topic, time_ns=self.time_ns, remedy=self.remedy
        )


class PlannerError(ReplanError):
    """A planner cannot be loaded, or broke its contract: it raised, or returned an object that is
    not a plan.
    """


class ConfigError(ReplanError):
    """A wrong option, configuration key, gate or name."""


class OutputError(ReplanError):
    """A file cannot be written: the disk is full, or the folder is not writable.

    Args:
        what: The file and the problem.
        remedy: What the user can do; set by the outermost folder that is claimed
            (`replan.run.claim`).
    """

    def __init__(self, what: str, remedy: str = "") -> None:
        self.what = what
        super().__init__(f"{what}; {remedy}" if remedy else what)


class LimitError(ReplanError):
    """The memory, or the open files, that the process may have are used up."""


_NO_MEMORY = (
    "failed to map segment",
    "cannot allocate memory",
    "can't start new thread",
    "failed to launch worker thread",
)
_NO_FILES = "too many open files"
"""What libraries say of these limits that raise exceptions of their own."""


def limit_error(error: BaseException | None) -> LimitError | None:
    """Return the LimitError for an exception that the limits of the process cause, itself or as its
    context; None for any other.
    """
    if error is None:
        return None
    words = str(error).lower() if isinstance(error, ImportError | OSError | RuntimeError) else ""
    if _NO_FILES in words:
        file = getattr(error, "filename", None) or "a file or pipe"
        raise_it = "raise the limit (`ulimit -n 4096`), or lower --workers"
        return LimitError(f"{file}: cannot be opened: {_NO_FILES}; {raise_it}")
    if isinstance(error, MemoryError) or any(part in words for part in _NO_MEMORY):
        free_it = "close other programs, raise the limit (`ulimit -v`), lower --workers"
        return LimitError(f"the memory is used up; {free_it}, or shorten the log (--from, --to)")
    return limit_error(error.__cause__ or error.__context__)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an OSError in the `with` block into an OutputError that names the file."""
    try:
        yield
    except OSError as error:
        if limit := limit_error(error):
            raise limit from error
        raise OutputError(
            f"{path}: cannot be written: {os.strerror(error.errno) if error.errno else error}"
        ) from error


@contextmanager
def reading(kinds: tuple[type[Exception], ...] = (ValueError,), **place: Any) -> Iterator[None]:
    """Turn an error of `kinds` in the `with` block into a LogError, with `place` as the arguments
    of `LogError`.
    """
    try:
        yield
    except kinds as error:
        raise LogError(str(error), **place) from None


@contextmanager
def in_file(path: Path) -> Iterator[None]:
    """Name the file in a LogError of the `with` block that names none."""
    try:
        yield
    except LogError as error:
        raise error if error.file is not None else error.at(path) from None


OWN_FOLDERS = tuple(map(str, own_folders()))
_LIBRARIES = tuple(sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib"))
LONGEST_MESSAGE = 400


def of_users(error: BaseException) -> bool:
    """Return whether the traceback of an exception contains code that belongs neither to replan nor
    to a library.
    """
    return any(_is_users(frame.filename) for frame in extract_tb(error.__traceback__))


def _is_users(file: str) -> bool:
    return not file.startswith((*OWN_FOLDERS, *_LIBRARIES, "<"))


def raised(error: BaseException, *, of: Callable[..., Any] | None = None) -> str:
    """Describe an exception in one line, with the innermost line of the user's code, else that of
    the function `of`.
    """
    try:
        words = " ".join(str(error)[: 10 * LONGEST_MESSAGE].split())
    except Exception:  # the user's exception class may raise in its `__str__`
        words = "(its message cannot be read)"
    # Addresses differ from run to run
    words = re.sub(r"\b0x[0-9a-f]{6,}\b", "0x...", words)[:LONGEST_MESSAGE]
    places = [(frame.filename, frame.lineno) for frame in extract_tb(error.__traceback__)]
    of_the_user = [place for place in places if _is_users(place[0])]
    if isinstance(error, SyntaxError) and error.filename:
        places = [(error.filename, error.lineno)]
    elif of_the_user:
        places = of_the_user
    elif isinstance(of, FunctionType):  # attributes of another callable may raise
        places = [(of.__code__.co_filename, of.__code__.co_firstlineno)]
    file, line = places[-1] if places else ("", 0)
    return f"{type(error).__name__}: {words}" + (f" ({Path(file).name}:{line})" if file else "")


def described(error: BaseException, *, of: Callable[..., Any] | None = None) -> str:
    """Describe an exception as `raised` does, after the one whose it is: of the user's code, of
    replan, or of the limits of the process.
    """
    if limit := limit_error(error):
        return str(limit)
    origin = "raised by code that the run names" if of_users(error) else "a bug in replan"
    return f"{origin}: {raised(error, of=of)}"


def unknown_name(kind: str, name: str, known: Iterable[str], within: str = "") -> ConfigError:
    """Return the error for an unknown name, with the nearest or all known names; `within`: prefix
    ("loop.").
    """
    names = sorted(known)
    near = get_close_matches(name, names, n=1, cutoff=0.6)
    hint = (
        f"did you mean '{within}{near[0]}'?" if near else f"known are: {', '.join(names) or 'none'}"
    )
    return ConfigError(f"no {kind} is called '{within}{name}'; {hint}")
