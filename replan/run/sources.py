"""Selects the logs of a run: files, folders, or the built-in suite; and the numbers found, kept and
left out.

An empty selection is an error that names the searched formats: it must not look like a run without
failures.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path

from replan.config import IN_MEMORY, LogSelection
from replan.core.errors import ConfigError, LogError, encodable
from replan.core.files import check_regular, read_toml
from replan.core.names import listed as first_of, told_apart
from replan.core.urls import RemoteFile, fetch, heads, listed, local_path, ranged, url_of
from replan.logs.catalogue import BUILTIN, FAMILY, scenario, suite
from replan.logs.maps import map_files
from replan.logs.mcap import write_scenario
from replan.logs.mcap.records import write_part
from replan.logs.readers import (
    FORMATS,
    LogSettings,
    foreign,
    known_format,
    logs_in,
    read_log,
    reader_of,
    readers,
    windows,
    with_tracks,
)
from replan.logs.scenario import Scenario
from replan.results.tables import LOG_CARD

BYTES_PER_S: Mapping[str, float] = {
    "native": 1e3,
    "commonroad": 80e3,
    "osi": 50e3,
    "comma2k19": 2e3,
    "table": 20e3,
    "ros": 25e3,
    "123d": 165e3,
    "argoverse2": 65e3,
}
"""Bytes per second of drive by format, medians of logs that we have.

Only for the order in which logs are driven.
"""
_OTHER_BYTES_PER_S = 50e3

LOOKED_INTO = (".xml", ".bag", ".db3", ".yaml", ".mcap", ".csv")
"""Suffixes of files whose first bytes readers check to recognise a log.

Other files are recognised by name.
"""
HEAD_BYTES = 4096
_SHOWN = 6
SUITE_HEADER = (
    "# A suite of logs, written by `replan suite`; give it to --suite. Paths are "
    "relative to this file."
)
"""First line of a suite's file."""


@dataclass(frozen=True)
class LogSource:
    """The source of a log: a file or folder of any format, or the catalogue."""

    # Its name for the user; for the catalogue, the name of a scenario
    # (`replan.logs.catalogue.scenario`)
    label: str
    path: Path | None = None  # The file or folder; None for the catalogue
    settings: LogSettings = field(default_factory=LogSettings)
    # Its `log_hash`, so that a log with many windows is hashed once; "" if unknown
    digest: str = ""
    # Its files if it is named by URL; `fetched` gives it as a path
    remote: tuple[RemoteFile, ...] = ()
    format: str = ""  # Format of a remote log, as known from its name
    # A scenario in memory, as a native MCAP file; `fetched` gives it as a path
    content: bytes = field(default=b"", repr=False)

    @classmethod
    def in_memory(cls, scenario: Scenario, settings: LogSettings) -> LogSource:
        """The source of a scenario that is in no file."""
        with tempfile.TemporaryDirectory(prefix="replan-") as scratch:
            file = Path(scratch, "log.mcap")
            write_scenario(file, scenario)
            digest, content = file_hash(file), file.read_bytes()
        return cls(scenario.name, None, settings, digest, content=content)

    def identity(self) -> str:
        """Identifies the input: names and hashes of log and map, or the name; LogError as `read`.

        For a remote log, sizes and versions replace the hash, so that it need not be fetched.
        """
        if self.path is None and not self.remote and not self.content:
            file = FAMILY.file(self.label.partition("@")[0])
            return f"catalogue {self.label}{f' {file_hash(file)}' if file else ''}"
        settings = self.settings
        if settings.map:
            settings = replace(
                settings, map=" ".join(map(file_hash, map_files(Path(settings.map))))
            )
        part = "" if settings == LogSettings() else f" {settings}"
        if self.content:
            return f"{self.label} {self.digest}{part}"
        if self.path is None:
            return f"{self._entry} {_version(self.remote) or self.label}{part}"
        return f"{self.path.name} {self.digest or log_hash(self.path, settings)}{part}"

    @property
    def named(self) -> tuple[str, str]:
        """The place and the digest (of a remote log the version) by which run.toml names it; "" for
        the catalogue, whose suite is named.
        """
        if self.path is not None:
            return str(self.path), self.digest
        label = self.label.removesuffix(_window_suffix(self.settings))
        if self.content:
            return f"{IN_MEMORY}{label}", self.digest
        return (label, _version(self.remote)) if self.remote else ("", "")

    @contextmanager
    def fetched(self) -> Iterator[LogSource]:
        """This log on this machine, within a `with` block; LogError if it cannot be fetched."""
        if not self.remote and not self.content:
            yield self
            return
        with tempfile.TemporaryDirectory(prefix="replan-") as scratch:
            if self.content:
                Path(scratch, self._entry).write_bytes(self.content)
            else:
                self._fetch(Path(scratch))
            try:
                yield replace(self, path=Path(scratch, self._entry), remote=())
            except LogError as error:
                raise error.at(self.label) from None

    def _fetch(self, folder: Path) -> None:
        begin, end, (file, *others) = self.settings.begin, self.settings.end, self.remote
        fetched = False
        # Its window is enough
        if self.format == "native" and not others and (begin > 0.0 or end < inf):
            fetched = write_part(ranged(file), file.size, begin, end, folder / self._entry)
        if not fetched:
            fetch(self.remote, folder)

    @property
    def _entry(self) -> str:
        return self.remote[0].name.partition("/")[0] if self.remote else "log.mcap"

    def read(self) -> Scenario:
        """The scenario; LogError if it cannot be read."""
        if self.path is None:
            return with_tracks(scenario(self.label), self.settings)
        return read_log(self.path, self.settings)

    @property
    def expected_s(self) -> float:
        """Approximate length of the drive, s, from the log's size; 0 for the catalogue, whose logs
        do not exist yet.
        """
        if self.settings.end < inf:
            return self.settings.end - self.settings.begin
        if self.path is None:
            size = sum(file.size for file in self.remote)
            if self.content:
                return len(self.content) / BYTES_PER_S["native"]
            return size / BYTES_PER_S.get(self.format, _OTHER_BYTES_PER_S)
        reader = reader_of(self.path, self.settings)
        try:
            files = () if reader is None else reader.files(self.path)
        except LogError:  # the evaluation will say why
            files = ()
        size = sum(file.stat().st_size for file in files if file.is_file())
        return size / BYTES_PER_S.get(reader.name if reader else "", _OTHER_BYTES_PER_S)

    @property
    def is_mcap(self) -> bool:
        """Whether it is a file of native or OSI MCAP that is read without settings, so that the
        results need no copy of it.
        """
        if self.content:
            return False
        reader = None if self.path is None else reader_of(self.path, self.settings)
        return reader is not None and reader.name == "native" and self.settings == LogSettings()


@dataclass(frozen=True)
class Selection:
    """The logs of a run.

    As text, the numbers found and kept, and the reasons why others were left out.
    """

    sources: tuple[LogSource, ...]  # The kept logs, in the given order (folders: sorted by path)
    dropped: tuple[str, ...] = ()  # The reasons why others were left out, one line each
    chosen: LogSelection = field(default_factory=LogSelection)  # As run.toml names them

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
    first_sources: dict[str, LogSource] = {}
    dropped: list[str] = []
    drives = _Drives()
    for log_given in logs:
        url = "" if isinstance(log_given, Scenario) else url_of(log_given)
        if isinstance(log_given, Scenario):
            candidates = [(LogSource.in_memory(log_given, settings), "")]
        elif url:
            candidates = list(_remote(url, settings))
        else:
            candidates = [
                (LogSource(encodable(str(path)), path, settings), reason)
                for path, reason in _logs(local_path(log_given), settings)
            ]
        if not candidates and not isinstance(log_given, Scenario):
            if not url and (foreign_format := known_format(local_path(log_given))) is not None:
                raise ConfigError(str(foreign_format))
            looked = ", ".join(
                dict.fromkeys(reader.looks_for for reader in readers(settings.reader))
            )
            raise ConfigError(
                f"{url or log_given}: no logs in this folder; looked for {looked}, 0 found; "
                f"{FORMATS}"
            )
        for log, reason in candidates:
            source = log
            if not reason and log.path is not None:
                with suppress(LogError):  # the evaluation will say why
                    source = replace(log, digest=log_hash(log.path, settings))
            key = (
                _version(log.remote)
                or source.digest
                or (os.path.realpath(log.path) if log.path else log.label)
            )
            if not reason and (twin := first_sources.get(key) or drives.twin_of(source)):
                reason = f"the same log as {twin.label}"
            if reason:
                dropped.append(f"{log.label}: {reason}")
            else:
                first_sources[key] = source
    sources: list[LogSource] = []
    labels = told_apart(
        [source.label for source in first_sources.values()],
        [source.digest for source in first_sources.values()],
    )
    for log, label in zip(first_sources.values(), labels, strict=True):
        source = replace(log, label=label)
        parts: Sequence[LogSettings] = (source.settings,)
        if window is None:
            sources.append(source)
            continue
        # The evaluation will say why it cannot be read
        with suppress(LogError), source.fetched() as near:
            assert near.path is not None
            parts = windows(near.path, source.settings, window, every)
        sources += [
            replace(source, label=f"{source.label}{_window_suffix(part)}", settings=part)
            for part in parts
        ]
    selection = Selection(tuple(sources), tuple(dropped))
    if not first_sources:
        raise ConfigError(f"no logs to evaluate: {selection}")
    return selection


def _window_suffix(window: LogSettings) -> str:
    return f" from {window.begin:g} s"


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
        twin = next(
            (other for other in others if self._content(other) == self._content(source)), None
        )
        if twin is None:
            others.append(source)
        return twin

    def _content(self, source: LogSource) -> str:
        """Hash of what the log holds.

        Its label if it cannot be read, for which the evaluation gives the reason.
        """
        if source.label not in self.contents:
            self.contents[source.label] = source.label
            with suppress(LogError), tempfile.TemporaryDirectory(prefix="replan-") as scratch:
                write_scenario(
                    Path(scratch, "log.mcap"),
                    replace(source.read(), name="log", source="", notes=()),
                )
                self.contents[source.label] = file_hash(Path(scratch, "log.mcap"))
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
        looked = [file for file in files if Path(file.name).suffix.lower() in LOOKED_INTO]
        begins = dict(zip(looked, heads(looked, HEAD_BYTES), strict=True))
        for path, file in files_by_path.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(begins.get(file, b""))
        for log, reason in _logs(root, settings):
            reader = reader_of(log, settings)
            names = log.relative_to(root.parent).as_posix().removeprefix(root.name)
            try:
                needed = [
                    path
                    for path in (() if reader is None else reader.files(log))
                    if path in files_by_path
                ]
            except Exception:  # a reader that treats empty files as damaged
                needed = []
            if not needed or not all(path.is_relative_to(log.parent) for path in needed):
                needed = [path for path in files_by_path if path == log or path.is_relative_to(log)]
            parts = [
                replace(files_by_path[path], name=path.relative_to(log.parent).as_posix())
                for path in needed
            ]
            yield (
                LogSource(
                    url + names, None, settings, "", tuple(parts), reader.name if reader else ""
                ),
                reason,
            )


def _version(files: Sequence[RemoteFile]) -> str:
    """A hash of names, sizes and versions of a log's files; "" where a version is not known."""
    if not all(file.version for file in files):
        return ""
    if len(files) == 1:
        return f"{files[0].size}-{files[0].version}"
    text = "".join(f"{file.name.partition('/')[2]} {file.size} {file.version}\n" for file in files)
    return hashlib.sha256(text.encode()).hexdigest() if files else ""


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


def log_hash(path: Path, settings: LogSettings | None = None) -> str:
    """SHA-256 of a log's bytes: of its file, or of the names and hashes of its files (maps may be
    elsewhere).
    """
    reader = reader_of(path, settings)
    try:
        files = (path,) if reader is None else reader.files(path)
    except LogError as error:
        raise error if error.file is not None else error.at(path) from None
    if files == (path,):
        return file_hash(path)
    digest, log = hashlib.sha256(), os.path.realpath(path)
    for file in files:  # each by its path relative to the log: the same if both are moved
        beside = Path(os.path.relpath(os.path.realpath(file), log)).as_posix()
        digest.update(f"{beside} {file_hash(file)}\n".encode())
    return digest.hexdigest()


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal; LogError if it cannot be read."""
    try:
        check_regular(path)
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except LogError as error:
        raise error.at(path) from None
    except OSError as error:
        raise LogError(f"cannot be read: {error.strerror}", file=path) from None
