"""SQLite files that were not closed, or are cut off: copies of them that can be read."""

from __future__ import annotations

import os
import sqlite3
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory
from typing import NamedTuple

MAGIC = b"SQLite format 3\0"
JOURNALS = ("-wal", "-journal")
"""Suffixes of the files beside a SQLite file that hold what was not yet written into it."""


class _Size(NamedTuple):
    """Bytes of a page, and of all pages, as a file's header states them."""

    page: int
    stated: int


def _read_only(file: Path) -> sqlite3.Connection:
    database = sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    # Else SQLite compares the size with the header, and reads nothing of a file that is cut off
    database.execute("PRAGMA writable_schema = ON")
    return database


def has_messages(file: Path) -> bool:
    """Whether a SQLite file has the tables of a bag."""
    try:
        with closing(_read_only(file)) as database:
            database.execute("SELECT timestamp, data, topics.name FROM messages, topics LIMIT 0")
    except (sqlite3.Error, UnicodeError):
        return False
    return True


def copy_to_read(file: Path, stack: ExitStack) -> tuple[Path, str]:
    """Return a copy of a SQLite file that is closed and whole, with a note; the file itself, with
    "", if it is so. The copy lasts as long as `stack`.
    """
    journals = [Path(f"{file}{suffix}") for suffix in JOURNALS]
    is_unclosed = any(journal.is_file() and journal.stat().st_size for journal in journals)
    size, present = _stated_size(file), file.stat().st_size
    if not is_unclosed and present >= size.stated:
        return file, ""
    folder = Path(stack.enter_context(TemporaryDirectory(prefix="replan-")))
    if is_unclosed:
        note = f"{file.name} was not closed: its journal beside it is read too, in a copy."
        return _closed_copy(file, folder), note
    note = (
        f"{file.name} is cut off: it has {present} of the {size.stated} bytes that its header "
        "states. The messages in them are read."
    )
    return _copy_of_rows(file, folder, size), note


def _closed_copy(file: Path, folder: Path) -> Path:
    """Copy a file with its journals, and write them into it."""
    near = folder / file.name
    for suffix in ("", *JOURNALS):
        if Path(f"{file}{suffix}").is_file():
            copyfile(f"{file}{suffix}", f"{near}{suffix}")
    with closing(sqlite3.connect(near)) as database:
        # Reads the journal, and leaves one file
        database.execute("PRAGMA journal_mode = DELETE")
    return near


def _stated_size(file: Path) -> _Size:
    with file.open("rb") as stream:
        head = stream.read(100)
    page = int.from_bytes(head[16:18], "big")
    page = (1 << 16) if page <= 1 else page
    is_valid = head[24:28] == head[92:96]  # the counters of changes
    return _Size(page, page * int.from_bytes(head[28:32], "big") if is_valid else 0)


def _copy_of_rows(file: Path, folder: Path, size: _Size) -> Path:
    """Copy the rows in the whole pages of a file, up to the first that is not there."""
    cut_off, near = folder / f"cut_off_{file.name}", folder / file.name
    copyfile(file, cut_off)
    os.truncate(cut_off, file.stat().st_size // size.page * size.page)
    with closing(_read_only(cut_off)) as source, closing(sqlite3.connect(near)) as target:
        tables = "SELECT name, sql FROM sqlite_master WHERE type = 'table' AND sql NOT NULL"
        for name, definition in source.execute(tables).fetchall():
            with suppress(sqlite3.DatabaseError):
                target.execute(definition)
                for row in source.execute(f'SELECT * FROM "{name}"'):
                    places = ", ".join("?" * len(row))
                    target.execute(f'INSERT INTO "{name}" VALUES ({places})', row)
        target.commit()
    return near
