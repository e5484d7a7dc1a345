"""Which logs a run evaluates: files, folders, or the built-in suite; and how many were found, kept and left out.

An empty selection is an error that says what was looked for: it must not look like a run in which nothing failed.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from logs.catalogue import CATALOGUE
from logs.errors import ConfigError, LogError
from logs.scenario import Scenario

LOG_CARD = "log.json"
"""A file that replan puts beside the traces of a log: what lies beside it is a result, not an input."""


@dataclass(frozen=True)
class LogSource:
    """Where a log comes from: a file, or a family of the catalogue at its defaults.

    Attributes:
        label: What the user calls it.
        path: The file; None for the catalogue.
    """

    label: str
    path: Path | None = None

    def identity(self) -> str:
        """What tells it from every other input: the file's name and hash, the family's name; LogError as `read`."""
        return f"catalogue {self.label}" if self.path is None else f"{self.path.name} {file_hash(self.path)}"

    def read(self) -> Scenario:
        """The scenario; LogError where it cannot be read."""
        if self.path is None:
            return CATALOGUE[self.label].scenario()
        if self.path.suffix.lower() == ".xml":
            from logs.convert.commonroad import read_commonroad

            return read_commonroad(self.path)
        from logs.mcap import read_scenario

        return read_scenario(self.path)


@dataclass(frozen=True)
class Selection:
    """The logs of a run; as text the funnel: found, kept, and why not the others.

    Attributes:
        sources: Kept, in the order given (folders: sorted by path).
        dropped: Why others were left out, one line each.
    """

    sources: tuple[LogSource, ...]
    dropped: tuple[str, ...] = ()

    def __str__(self) -> str:
        counts = f"{len(self.sources) + len(self.dropped)} found, {len(self.sources)} kept"
        return "; ".join([counts, *(f"left out {reason}" for reason in self.dropped)])


def builtin_suite() -> Selection:
    """Every family of the catalogue at its defaults."""
    return Selection(tuple(LogSource(name) for name in CATALOGUE))


def select(paths: Sequence[Path | str]) -> Selection:
    """The logs that files and folders hold.

    A folder is searched for `*.mcap` and for `*.xml` that are CommonRoad scenarios. Results of earlier runs, hidden
    files and second copies of the same bytes are left out.

    Raises:
        ConfigError: A path does not exist, is of a kind that no reader knows, or nothing is left.
    """
    kept: dict[str, LogSource] = {}
    dropped: list[str] = []
    for path in map(Path, paths):
        candidates = list(_files(path))
        if not candidates:
            raise ConfigError(f"{path}: no logs in this folder; looked for *.mcap and CommonRoad *.xml, 0 found")
        for file, reason in candidates:
            digest = "" if reason else _identity(file)
            twin = kept.get(digest)
            reason = reason or (f"the same bytes as {twin.label}" if twin else "")
            if reason:
                dropped.append(f"{file}: {reason}")
            else:
                kept[digest] = LogSource(str(file), file)
    selection = Selection(tuple(kept.values()), tuple(dropped))
    if not kept:
        raise ConfigError(f"no logs to evaluate: {selection}")
    return selection


def _files(path: Path) -> Iterator[tuple[Path, str]]:
    """Candidate files under a path, each with the reason why it is left out ("" keeps it)."""
    if path.is_dir():
        for file in sorted(path.rglob("*")):
            if file.suffix.lower() in (".mcap", ".xml") and file.is_file():
                yield file, _objection(file, path)
    elif not path.exists():
        raise ConfigError(f"{path}: no such file or folder")
    elif path.suffix.lower() not in (".mcap", ".xml"):
        raise ConfigError(f"{path}: not a log that replan reads; expected .mcap, a CommonRoad .xml or a folder of them")
    else:
        yield path, ""


def _objection(file: Path, folder: Path) -> str:
    """Why a file found in a folder is no input."""
    if any(part.startswith(".") for part in file.relative_to(folder).parts):
        return "hidden"
    if (file.parent / LOG_CARD).exists():
        return "a result of an earlier run (name it to evaluate it)"
    if file.suffix.lower() == ".xml":
        with file.open("rb") as stream:
            return "" if b"<commonRoad" in stream.read(4096) else "not a CommonRoad scenario"
    return ""


def _identity(file: Path) -> str:
    """Hash of the bytes; the path where they cannot be read (the evaluation will say why)."""
    try:
        return file_hash(file)
    except LogError:
        return str(file.resolve())


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal; LogError where it cannot be read."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}", file=path) from None
