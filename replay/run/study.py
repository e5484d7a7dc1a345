"""The file of a study: JSON lines, first the head with the inputs, then a line per trial.

A line is added as each batch ends, with a checksum of what it says: a trial that was edited is refused. The last line,
if an interruption has cut it, is left out. A search is
deterministic: with `--resume` it makes the same trials again, and those in the file are not driven a second time. So it
gives the same bytes as a search that was never interrupted.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any
from zlib import crc32

from logs.errors import ConfigError, writing
from replay.config import RunConfig, dump_run
from replay.results.tables import clear_partial, write_text
from replay.run.claim import STUDY, emptied
from replay.run.resume import changes, stamp_of

CHECKSUM = "crc32"  # The key of the checksum of a trial's line


def study_head(kind: str, run: RunConfig, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """The head of a study: its kind, the versions of replan and the code, its own inputs (JSON types), its run."""
    stamp = stamp_of(run)
    return {"study": kind, "replan": stamp.replan, "code": stamp.code[:12], **inputs, "run": dump_run(run)}


class Study:
    """The trials of a study, by key.

    `out`: the folder, which is claimed (`replay.run.claim`). `head`: the inputs, as JSON types: a study with another
    head is a different study. `resume`: use the trials in the file; otherwise the folder is emptied. ConfigError if the
    folder contains no study that can be resumed.
    """

    def __init__(self, out: Path, head: Mapping[str, Any], *, resume: bool) -> None:
        self._path, self._head, rows = out / STUDY, dict(head), list[dict[str, Any]]()
        if resume:
            earlier, *rows = self._read()
            changed = changes(earlier, json.loads(json.dumps(self._head)))
            if changed:
                again = "give the same options, or leave out --resume"
                raise ConfigError(f"{out}: was started with other settings: {changed}; {again}")
            clear_partial(out)
        else:
            emptied(out)
        self._known = {row["key"]: row for row in rows}
        self.resumed = len(self._known)
        self.keep(self._known)

    def _read(self) -> list[dict[str, Any]]:
        """The lines of the file, of which the first is the head."""
        if not self._path.is_file():
            raise ConfigError(f"{self._path.parent}: contains no study to resume; leave out --resume to start one")
        again = "leave out --resume to start over"
        try:
            lines = self._path.read_bytes().split(b"\n")[:-1]  # what follows the last end is cut
            rows = [json.loads(line) for line in lines]
        except (OSError, ValueError, RecursionError) as error:
            raise ConfigError(f"{self._path}: cannot be read as a study: {error}; {again}") from None
        if not (rows and all(isinstance(row, dict) for row in rows) and all("key" in row for row in rows[1:])):
            raise ConfigError(f"{self._path}: contains no study; {again}")
        for number, row in enumerate(rows[1:], 2):
            if row.pop(CHECKSUM, None) != _checksum(row):
                raise ConfigError(f"{self._path}: line {number} is not as replan wrote it; {again}")
        return rows

    def known(self, key: str) -> dict[str, Any] | None:
        """The row of a trial; None if it is not in the file."""
        return self._known.get(key)

    def row(self, key: str, make: Callable[[], Mapping[str, Any]]) -> dict[str, Any]:
        """The row of a trial; if it is not in the file, it is made and added."""
        if key not in self._known:
            self.add([{"key": key, **make()}])
        return self._known[key]

    def add(self, rows: Iterable[dict[str, Any]]) -> None:
        """Add trials (each with its `key`) to the file."""
        new = {row["key"]: row for row in rows}
        self._known.update(new)
        with writing(self._path), self._path.open("a", encoding="utf-8", newline="\n") as file:
            file.write("".join(map(_checked, new.values())))

    def keep(self, keys: Iterable[str]) -> None:
        """Write the file anew with these trials, in this order."""
        self._known = {key: self._known[key] for key in keys}
        write_text(self._path, "".join([_line(self._head), *map(_checked, self._known.values())]))


def _checksum(row: Mapping[str, Any]) -> int:
    return crc32(json.dumps(row).encode())


def _checked(row: Mapping[str, Any]) -> str:
    return _line({**row, CHECKSUM: _checksum(row)})


def _line(row: Mapping[str, Any]) -> str:
    return json.dumps(row, ensure_ascii=False, allow_nan=False) + "\n"
