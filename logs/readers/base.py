"""The class of log readers, one instance per format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from replan.logs.log_settings import LogSettings
from replan.logs.scenario import Scenario


@dataclass(frozen=True)
class TopicSummary:
    """One topic or table: schema, encoding, number of messages, first and last log time (ns; None
    without messages).
    """

    topic: str
    schema: str
    encoding: str
    schema_encoding: str
    messages: int
    first_ns: int | None
    last_ns: int | None


@dataclass(frozen=True)
class LogContents:
    """The content of a log for `replan inspect`: its format in words ("": the reader's summary) and
    its topics.
    """

    profile: str = ""
    topics: tuple[TopicSummary, ...] = ()


def files_named(suffix: str) -> Callable[[Path], bool]:
    """Return a function that claims all files with a suffix."""

    def claims(path: Path) -> bool:
        return path.suffix.lower() == suffix and path.is_file()

    return claims


@dataclass(frozen=True)
class Reader:
    """The reader of one log format.

    Attributes:
        name: Its name in `replan convert NAME` and in messages.
        summary: The format in one line.
        looks_for: The files that it reads, in words ("*.bag").
        suffixes: Suffixes of its files (".bag"): a file with such a suffix that no reader claims is
            reported.
        claims: Whether a path, file or folder, is a log of this format; fast, and raises nothing on
            any bytes.
        read: Reads the scenario; raises only LogError on any bytes.
        files: The files of a log, in a fixed order: the log's identity is their hash. Default: the
            file itself.
        span: First and last time of the log, s, if they can be found quickly; else None.
        contents: The topics that can be read; raises nothing.
        settings: The keys of `LogSettings` that it uses, besides `begin`, `end` and `repair`, which
            apply to all.
        cuts: Whether it reads only the surroundings of the part from `begin` to `end`, in times of
            the whole log.
        claims_with: Whether a path that it does not claim is a log of this format by the settings
            (names of columns).
    """

    name: str
    summary: str
    looks_for: str
    suffixes: tuple[str, ...]
    claims: Callable[[Path], bool]
    read: Callable[[Path, LogSettings], Scenario]
    files: Callable[[Path], tuple[Path, ...]] = lambda path: (path,)
    span: Callable[[Path], tuple[float, float] | None] = lambda path: None
    contents: Callable[[Path], LogContents] = lambda path: LogContents()
    settings: tuple[str, ...] = ()
    cuts: bool = False
    claims_with: Callable[[Path, LogSettings], bool] = lambda path, settings: False
