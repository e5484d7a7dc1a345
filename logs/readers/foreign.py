"""Names the content of a path that no reader claims, and how to make a log of it.

`SIGNS` has one row per format that is known and not read.
"""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from replan.core.errors import LogError
from replan.core.files import check_regular
from replan.core.names import listed
from replan.logs.readers.csv_table import SUFFIXES, header_of

FORMATS = "`replan convert --formats` lists what replan reads and how a format is added"
CONVERT = "convert it with py123d (pip install py123d) and read its logs"
FRAMES = "and give its poses and objects to replan.from_frames as tables"
_SHOWN = 8
_SQLITE, _MCAP = b"SQLite format 3\0", b"\x89MCAP0\r\n"
_NUPLAN = {"ego_pose", "lidar_pc", "lidar_box", "scenario_tag"}
_NUSCENES = ("sample.json", "ego_pose.json", "scene.json", "sample_annotation.json")


class _Sign(NamedTuple):
    """A format: its name, whether a path is of it (by its first bytes and, of a folder, its names),
    and the remedy.
    """

    name: str
    fits: Callable[[Path, bytes, Sequence[str]], bool]
    remedy: str


def _tables(path: Path) -> set[str]:
    if not path.is_file():
        return set()
    try:
        with closing(
            sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        ) as file:
            return {
                str(row[0])
                for row in file.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
            }
    except (sqlite3.Error, UnicodeError):
        return set()


def _named(pattern: str) -> Callable[[Path, bytes, Sequence[str]], bool]:
    """Return a test for files whose name has a part that matches `pattern`, and folders that hold
    such files.
    """
    part = re.compile(pattern, re.IGNORECASE)

    def fits(path: Path, begin: bytes, names: Sequence[str]) -> bool:
        held = names or [path.name]
        return any(part.search(name) is not None for name in held)

    return fits


SIGNS = (
    _Sign(
        "a nuPlan database",
        lambda path, begin, names: begin.startswith(_SQLITE) and bool(_tables(path) & _NUPLAN),
        CONVERT,
    ),
    _Sign(
        "a folder of nuPlan databases",
        lambda path, begin, names: bool(
            _tables(path / next((name for name in names if name.endswith(".db")), "")) & _NUPLAN
        ),
        CONVERT,
    ),
    _Sign(
        "nuScenes",
        lambda path, begin, names: (
            bool({*_NUSCENES} & {*names})
            or any(re.fullmatch(r"v1\.0-\w+", name) for name in names)
            or path.name in _NUSCENES
        ),
        CONVERT,
    ),
    _Sign("Waymo Open Dataset records", _named(r"\.tfrecord(\W|$)"), CONVERT),
    _Sign(
        "an Apollo record",
        _named(r"\.record(\.\w+)*$"),
        f"read it with cyber_record (pip install cyber-record), {FRAMES}",
    ),
    _Sign(
        "an openpilot log",
        _named(r"(^|--)[rq]log(\.(bz2|zst))?$"),
        f"read it with openpilot's tools/lib/logreader.py, {FRAMES}",
    ),
    _Sign(
        "an MCAP file whose name does not end in .mcap",
        lambda path, begin, names: begin.startswith(_MCAP) and path.suffix != ".mcap",
        "rename it to NAME.mcap",
    ),
)
"""The formats that are known and not read; the first that fits is named."""


def known_format(path: Path) -> LogError | None:
    """Return the error for a path of a format in `SIGNS`; None if it is of none of them, or cannot
    be read.
    """
    names, begin = list[str](), b""
    try:
        if path.is_dir():
            names = sorted(entry.name for entry in path.iterdir())
        else:
            with path.open("rb") as stream:
                begin = stream.read(len(_SQLITE))
    except OSError:
        return None
    known = next(
        (sign for sign in SIGNS if (names or begin) and sign.fits(path, begin, names)), None
    )
    return known and LogError(
        f"{known.name}, which replan does not read", file=path, remedy=known.remedy
    )


def foreign(path: Path) -> LogError:
    """Return the error for a path that no reader claims: what it contains, and how to convert
    it.
    """
    if not path.exists():
        return LogError("no such file or folder", file=path)
    try:
        check_regular(path)
        if (known := known_format(path)) is not None:
            return known
        if path.is_dir():
            names = sorted(entry.name for entry in path.iterdir())
            problem = (
                "not a log that replan reads; the folder holds "
                f"{listed(names, _SHOWN) or 'nothing'}"
            )
            return LogError(problem, file=path, remedy=FORMATS)
        with path.open("rb") as stream:
            begin = stream.read(8)
    except LogError as error:
        return error.at(path)
    except OSError as error:
        return LogError(f"cannot be read: {error.strerror or error}", file=path)
    if path.suffix in SUFFIXES:
        problem = (
            f"a table with the columns {', '.join(header_of(path)[:12]) or '(none)'} is not a "
            "log by itself"
        )
        remedy = (
            "the table of an ego is ego.csv in a folder of its own; a table of tracks has t, id, "
            "x, y, or names them in [log.columns]"
        )
        return LogError(problem, file=path, remedy=remedy)
    problem = (
        f"not a log that replan reads; a {path.suffix or 'nameless'} file that begins with "
        f"{begin!r}"
    )
    return LogError(problem, file=path, remedy=FORMATS)
