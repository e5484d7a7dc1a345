"""The source of a log: where it is, how it is read, and what identifies it."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from math import inf
from pathlib import Path

from replan.config import IN_MEMORY
from replan.core.errors import LogError
from replan.core.files import check_regular
from replan.core.urls import RemoteFile, fetch, ranged
from replan.logs.catalogue import FAMILY, scenario
from replan.logs.maps import map_files
from replan.logs.mcap import write_scenario
from replan.logs.mcap.records import write_part
from replan.logs.readers import LogSettings, read_log, reader_of, with_tracks
from replan.logs.scenario import Scenario

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
"""Bytes per second of drive by format, medians of recorded logs; for the order of drives only."""
_OTHER_BYTES_PER_S = 50e3


@dataclass(frozen=True)
class LogSource:
    """The source of a log: a file or folder of any format, or the catalogue.

    Attributes:
        label: Its name for the user; for the catalogue, the name of a scenario
            (`replan.logs.catalogue.scenario`).
        path: The file or folder; None for the catalogue.
        settings: How it is read.
        digest: Its `log_hash`, so that a log with many windows is hashed once; "" if unknown.
        remote: Its files if it is named by URL; `fetched` gives it as a path.
        format: Format of a remote log, as known from its name.
        content: A scenario in memory, as a native MCAP file; `fetched` gives it as a path.
    """

    label: str
    path: Path | None = None
    settings: LogSettings = field(default_factory=LogSettings)
    digest: str = ""
    remote: tuple[RemoteFile, ...] = ()
    format: str = ""
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
        settings = self.settings
        if self.path is None and not self.remote and not self.content:
            file = FAMILY.file(self.label.partition("@")[0])
            part = f" {settings}" if settings.between(0.0, inf) != settings else ""
            return f"catalogue {self.label}{f' {file_hash(file)}' if file else ''}{part}"
        if settings.map:
            settings = replace(
                settings, map=" ".join(map(file_hash, map_files(Path(settings.map))))
            )
        part = "" if settings == LogSettings() else f" {settings}"
        if self.content:
            return f"{self.label} {self.digest}{part}"
        if self.path is None:
            return f"{self._entry} {version_of(self.remote) or self.label}{part}"
        return f"{self.path.name} {self.digest or log_hash(self.path, settings)}{part}"

    @property
    def named(self) -> tuple[str, str]:
        """The place and the digest (of a remote log the version) by which run.toml names it; "" for
        the catalogue, whose suite is named.
        """
        if self.path is not None:
            return str(self.path), self.digest
        label = self.label.removesuffix(window_suffix(self.settings))
        if self.content:
            return f"{IN_MEMORY}{label}", self.digest
        return (label, version_of(self.remote)) if self.remote else ("", "")

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
        """Fetch the window that is read, if the format permits it, or the whole log."""
        begin, end, (file, *others) = self.settings.begin, self.settings.end, self.remote
        is_part = self.format == "native" and not others and (begin > 0.0 or end < inf)
        target = folder / self._entry
        if not is_part or not write_part(ranged(file), file.size, begin, end, target):
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


def window_suffix(window: LogSettings) -> str:
    """The end of the label of a window of a log."""
    return f" from {window.begin:g} s"


def version_of(files: Sequence[RemoteFile]) -> str:
    """A hash of names, sizes and versions of a log's files; "" where a version is not known."""
    if not all(file.version for file in files):
        return ""
    if len(files) == 1:
        return f"{files[0].size}-{files[0].version}"
    text = "".join(f"{file.name.partition('/')[2]} {file.size} {file.version}\n" for file in files)
    return hashlib.sha256(text.encode()).hexdigest() if files else ""


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
