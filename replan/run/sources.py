"""Selects the logs of a run: files, folders, or the built-in suite; and the numbers found, kept and
left out.

An empty selection is an error that names the searched formats: it must not look like a run without
failures.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from replan.config import LogSelection
from replan.core.errors import ConfigError, LogError, encodable
from replan.core.files import read_toml
from replan.core.names import listed as first_of, told_apart
from replan.core.urls import heads, listed, local_path, url_of
from replan.logs.catalogue import BUILTIN, suite
from replan.logs.readers import (
    FORMATS,
    LogSettings,
    foreign,
    known_format,
    logs_in,
    reader_of,
    readers,
    windows,
)
from replan.logs.scenario import Scenario
from replan.results.tables import LOG_CARD
from replan.run.log_source import LogSource, log_hash, version_of, window_suffix

LOOKED_INTO = (".xml", ".bag", ".db3", ".yaml", ".mcap", ".csv")
"""Suffixes of files whose first bytes readers check to recognise a log.

Other files are recognised by name.
"""
HEAD_BYTES = 4096
_SHOWN = 6  # Logs of a folder that an error names
SUITE_HEADER = (
    "# A suite of logs, written by `replan suite`; give it to --suite. Paths are "
    "relative to this file."
)
"""First line of a suite's file."""


@dataclass(frozen=True)
class Selection:
    """The logs of a run.

    As text, the numbers found and kept, and the reasons why others were left out.

    Attributes:
        sources: The kept logs, in the given order (folders: sorted by path).
        dropped: The reasons why others were left out, one line each.
        chosen: The logs as run.toml names them.
    """

    sources: tuple[LogSource, ...]
    dropped: tuple[str, ...] = ()
    chosen: LogSelection = field(default_factory=LogSelection)

    def __str__(self) -> str:
        counts = f"{len(self.sources) + len(self.dropped)} found, {len(self.sources)} kept"
        return "; ".join([counts, *(f"left out {reason}" for reason in self.dropped)])


def builtin_suite() -> Selection:
    """Every family of the catalogue at its defaults."""
    return Selection(tuple(LogSource(name) for name in BUILTIN))


def named_suite(name: str) -> Selection:
    """A suite of the catalogue, or all cells of one of its families or groups; ConfigError if
    nothing has this name.
    """
    return Selection(tuple(LogSource(label) for label in suite(name)))


def suite_file(path: Path) -> list[Path | str]:
    """The logs that a suite's file names: TOML with one key, `logs`, a list of paths (relative to
    the file) or URLs.

    ConfigError if it cannot be read, or has other keys.
    """
    table = read_toml(path)
    logs = table.get("logs")
    if (
        set(table) != {"logs"}
        or not isinstance(logs, list)
        or not all(isinstance(log, str) for log in logs)
    ):
        raise ConfigError(
            f"{path}: a suite has one key, logs, a list of paths (replan suite writes such a file)"
        )
    return [log if url_of(log) else path.parent / log for log in logs]


def select(
    logs: Sequence[Path | str | Scenario],
    settings: LogSettings | None = None,
    window: float | None = None,
    every: float | None = None,
) -> Selection:
    """The logs in files and folders, of all formats in `replan.logs.readers`, and in memory.

    A folder that is not a log is searched for logs. Results of earlier runs, hidden files and
    second copies of a log are left out: the same bytes, or the same drive in another container or
    under another name, if the reader knows its span without reading it. With `window`, each log is
    split into windows of this length, s, that begin every `every` s (by default `window`).
    ConfigError if a path does not exist, no reader knows its format, or no log is left.
    """
    settings = settings or LogSettings()
    by_key: dict[str, LogSource] = {}
    dropped, drives = list[str](), _Drives()
    for place in logs:
        for log, reason in _candidates(place, settings):
            source = log
            if not reason and log.path is not None:
                with suppress(LogError):  # the evaluation will say why
                    source = replace(log, digest=log_hash(log.path, settings))
            place_of_log = os.path.realpath(log.path) if log.path else log.label
            key = version_of(log.remote) or source.digest or place_of_log
            if not reason and (twin := by_key.get(key) or drives.twin_of(source)):
                reason = f"the same log as {twin.label}"
            if reason:
                dropped.append(f"{log.label}: {reason}")
            else:
                by_key[key] = source
    labels = told_apart(
        [source.label for source in by_key.values()], [source.digest for source in by_key.values()]
    )
    sources = [
        part
        for source, label in zip(by_key.values(), labels, strict=True)
        for part in _windows_of(replace(source, label=label), window, every)
    ]
    selection = Selection(tuple(sources), tuple(dropped))
    if not by_key:
        raise ConfigError(f"no logs to evaluate: {selection}")
    return selection


def _candidates(place: Path | str | Scenario, settings: LogSettings) -> list[tuple[LogSource, str]]:
    """The logs at a place, each with the reason why it is left out ("" keeps it); ConfigError if
    there are none.
    """
    if isinstance(place, Scenario):
        return [(LogSource.in_memory(place, settings), "")]
    if url := url_of(place):
        candidates = list(_remote(url, settings))
    else:
        candidates = [
            (LogSource(encodable(str(path)), path, settings), reason)
            for path, reason in _logs(local_path(place), settings)
        ]
    if candidates:
        return candidates
    if not url and (foreign_format := known_format(local_path(place))) is not None:
        raise ConfigError(str(foreign_format))
    looked = ", ".join(dict.fromkeys(reader.looks_for for reader in readers(settings.reader)))
    raise ConfigError(
        f"{url or place}: no logs in this folder; looked for {looked}, 0 found; {FORMATS}"
    )


def _windows_of(source: LogSource, window: float | None, every: float | None) -> list[LogSource]:
    """The windows of a log; the log itself without a window."""
    if window is None:
        return [source]
    parts: Sequence[LogSettings] = (source.settings,)
    # The evaluation will say why it cannot be read
    with suppress(LogError), source.fetched() as near:
        assert near.path is not None
        parts = windows(near.path, source.settings, window, every)
    return [
        replace(source, label=f"{source.label}{window_suffix(part)}", settings=part)
        for part in parts
    ]


def log_at(path: Path, settings: LogSettings) -> Path:
    """Return the log at a path: of a folder, the one that `select` keeps, if it keeps one; the path
    if it finds none.

    ConfigError if there are several.
    """
    if not path.is_dir() or reader_of(path, settings) is not None:
        return path
    try:
        logs = [source.path for source in select([path], settings).sources]
    except ConfigError:
        return path
    if len(logs) > 1:
        names = sorted(str(log.relative_to(path)) for log in logs if log is not None)
        raise ConfigError(
            f"{path}: a folder of {len(logs)} logs, {first_of(names, _SHOWN)}; name one of them"
        )
    return logs[0] or path


@dataclass
class _Drives:
    """The drives of logs, whatever their names and containers.

    Only logs with the same span (ns) are read.
    """

    by_span: dict[tuple[float, float], list[LogSource]] = field(default_factory=dict)
    contents: dict[str, str] = field(default_factory=dict)

    def twin_of(self, source: LogSource) -> LogSource | None:
        """Return the earlier log with the same drive.

        If there is none, this log is kept for later ones.
        """
        reader = None if source.path is None else reader_of(source.path, source.settings)
        span = None if reader is None or source.path is None else reader.span(source.path)
        if span is None:
            return None
        others = self.by_span.setdefault(span, [])
        for other in others:
            if self._content(other) == self._content(source):
                return other
        others.append(source)
        return None

    def _content(self, source: LogSource) -> str:
        """Hash of what the log holds.

        Its label if it cannot be read, for which the evaluation gives the reason.
        """
        if source.label not in self.contents:
            self.contents[source.label] = source.label
            with suppress(LogError):
                plain = replace(source.read(), name="log", source="", notes=())
                self.contents[source.label] = LogSource.in_memory(plain, LogSettings()).digest
        return self.contents[source.label]


def _remote(url: str, settings: LogSettings) -> Iterator[tuple[LogSource, str]]:
    """The logs at a URL, found in a folder with the same file names and only the bytes that readers
    check.
    """
    files = listed(url)
    if not files:
        raise ConfigError(f"{url}: no such file or folder")
    with tempfile.TemporaryDirectory(prefix="replan-") as scratch:
        root = Path(scratch, url.rpartition("/")[2])
        is_file = files[0].url == url
        files_by_path = {root if is_file else root / file.name: file for file in files}
        looked_into = [file for file in files if Path(file.name).suffix.lower() in LOOKED_INTO]
        begins = dict(zip(looked_into, heads(looked_into, HEAD_BYTES), strict=True))
        for path, file in files_by_path.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(begins.get(file, b""))
        for log, reason in _logs(root, settings):
            reader = reader_of(log, settings)
            label = url + log.relative_to(root.parent).as_posix().removeprefix(root.name)
            try:
                files_of_log = () if reader is None else reader.files(log)
            except Exception:  # a reader that treats empty files as damaged
                files_of_log = ()
            needed = [path for path in files_of_log if path in files_by_path]
            if not needed or not all(path.is_relative_to(log.parent) for path in needed):
                needed = [path for path in files_by_path if path == log or path.is_relative_to(log)]
            parts = [
                replace(files_by_path[path], name=path.relative_to(log.parent).as_posix())
                for path in needed
            ]
            name = reader.name if reader else ""
            yield LogSource(label, None, settings, remote=tuple(parts), format=name), reason


def _logs(path: Path, settings: LogSettings) -> Iterator[tuple[Path, str]]:
    """Candidates at a path, each with the reason why it is left out ("" keeps it)."""
    if not path.exists():
        raise ConfigError(f"{path}: no such file or folder")
    if reader_of(path, settings) is not None:
        yield path, ""
    elif path.is_dir():
        for log, reader in logs_in(path, settings):
            reason = "" if reader else "no reader recognises it"
            if any(part.startswith(".") for part in log.relative_to(path).parts):
                reason = "hidden"
            elif (log.parent / LOG_CARD).exists():
                reason = "a result of an earlier run (name it to evaluate it)"
            yield log, reason
    else:
        raise ConfigError(str(foreign(path)))
