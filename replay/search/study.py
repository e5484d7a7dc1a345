"""The file of a study: JSON lines, first the head with the inputs, then a line per trial.

After each batch the whole file is written under another name and renamed, so that an interruption leaves the state
after the last batch. A search is deterministic: with `--resume` it makes the same trials again, and those in the file
are not driven a second time. So it gives the same bytes as a search that was never interrupted.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from logs.errors import ConfigError
from replay.results.tables import LOCK, clear_partial, write_text
from replay.run.resume import changes

FILE = "study.jsonl"


class Study:
    """The trials of a study, by key.

    Args:
        out: The folder, which is locked (`replay.run.output`).
        head: The inputs, as JSON types: a study with another head is a different study.
        resume: Use the trials in the file; otherwise an earlier study of this kind is removed from the folder.

    Raises:
        ConfigError: The folder contains other files, or no study that can be resumed.
    """

    def __init__(self, out: Path, head: Mapping[str, Any], *, resume: bool) -> None:
        self._path, self._head, self._rows = out / FILE, dict(head), list[dict[str, Any]]()
        earlier: list[dict[str, Any]] | None = None
        if self._path.is_file():
            again = "remove the file to start over"
            try:
                earlier = [json.loads(line) for line in self._path.read_text(encoding="utf-8").splitlines()]
            except (OSError, ValueError) as error:
                raise ConfigError(f"{self._path}: cannot be read as a study: {error}; {again}") from None
            if not (
                earlier and all(isinstance(row, dict) for row in earlier) and all("key" in row for row in earlier[1:])
            ):
                raise ConfigError(f"{self._path}: contains no study; {again}")
        entries = [entry for entry in out.iterdir() if entry.name != LOCK]
        if entries and (earlier is None or earlier[0].get("study") != head["study"]):
            raise ConfigError(f"{out}: contains no study of `replan {head['study']}`; give --out a new or empty folder")
        if resume:
            if earlier is None:
                raise ConfigError(f"{out}: contains no study to resume; leave out --resume to start one")
            changed = changes(earlier[0], json.loads(json.dumps(self._head)))
            if changed:
                again = "give the same options, or leave out --resume"
                raise ConfigError(f"{out}: was started with other settings: {changed}; {again}")
            self._rows = earlier[1:]
            clear_partial(out)
        else:
            for entry in entries:
                shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
        self._known = {row["key"]: row for row in self._rows}
        self.resumed = len(self._rows)
        self._write()

    def known(self, key: str) -> dict[str, Any] | None:
        """The row of a trial; None if it is not in the file."""
        return self._known.get(key)

    def add(self, rows: Iterable[dict[str, Any]]) -> None:
        """Add trials (each with its `key`), and write the file."""
        for row in rows:
            self._rows.append(row)
            self._known[row["key"]] = row
        self._write()

    def _write(self) -> None:
        lines = [json.dumps(row, ensure_ascii=False, allow_nan=False) for row in (self._head, *self._rows)]
        write_text(self._path, "\n".join(lines) + "\n")
