"""123D logs: folders of Arrow files, converted by py123d from nuPlan, Waymo, nuScenes, Argoverse 2 and others."""

from __future__ import annotations

from pathlib import Path

from logs.readers.base import Contents, LogSettings, Reader
from logs.scenario import Scenario

SYNC = "sync.arrow"
_HEAD = 65_536
"""Bytes in which an old log's schema says what it is."""


def _claims(path: Path) -> bool:
    try:
        if path.is_dir():
            return (path / SYNC).is_file()
        if path.suffix.lower() != ".arrow" or not path.is_file():
            return False
        if path.name == SYNC:
            return True
        with path.open("rb") as stream:
            head = stream.read(_HEAD)
        return head.startswith(b"ARROW1") and b"log_metadata" in head  # a log of py123d 0.0.8 or 0.0.9
    except OSError:
        return False


def folder_of(path: Path) -> Path:
    """The log's folder, where its `sync.arrow` was named."""
    return path.parent if path.name == SYNC else path


def _read(path: Path, settings: LogSettings) -> Scenario:
    from logs.errors import LogError
    from logs.readers.arrow123d.log import read_123d
    from logs.readers.recorded.tables import reading

    if path.is_file() and path.name != SYNC:
        what = "a 123D log of py123d 0.0.8 or 0.0.9: one file with other tables"
        raise LogError(what, file=path, remedy="convert the data set again with py123d 0.1.0 or newer")
    with reading(folder_of(path)):
        return read_123d(folder_of(path))


def _files(path: Path) -> tuple[Path, ...]:
    """The files that are read: never cameras or lidar."""
    from logs.readers.arrow123d.log import files_of

    return files_of(folder_of(path)) if path.is_dir() or path.name == SYNC else (path,)


def _span(path: Path) -> tuple[float, float] | None:
    from logs.readers.arrow123d.log import span_of

    return span_of(folder_of(path))


def _contents(path: Path) -> Contents:
    from logs.readers.arrow123d.log import contents_of

    return contents_of(folder_of(path))


READER = Reader(
    "123d", "123D logs (py123d 0.1.0 and newer): nuPlan, Waymo, nuScenes, Argoverse 2 ...", "folders with sync.arrow",
    (), _claims, _read, files=_files, span=_span, contents=_contents,
)  # fmt: skip
