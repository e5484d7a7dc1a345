"""Continues an interrupted run or study: the results of logs whose folders are complete are kept.

A folder is kept if it was made from the same input (name and bytes) under the same configuration,
version and source of replan and of extensions of users (planners, metrics, ...); gates may differ,
because they are applied at the end. Any other content of the folder is an error: no log is
evaluated again silently, and results of other runs are not mixed in.

The file of a study is JSON lines, first the head with the inputs, then a line per trial. A line is
added as each batch ends, with a checksum of what it says: a trial that was edited is refused. The
last line, if an interruption has cut it, is left out. A search is deterministic: with `--resume` it
makes the same trials again, and those in the file are not driven a second time. So it gives the
same bytes as a search that was never interrupted.
"""

from __future__ import annotations

import json
import shutil
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any
from zlib import crc32

from replan.config import RunConfig, dump_run
from replan.core.errors import ConfigError, LogError, writing
from replan.core.extension import ExtensionKind
from replan.core.files import read_toml
from replan.core.names import listed
from replan.core.own_sources import own_folders
from replan.core.settings import flat
from replan.logs.readers import READER
from replan.metrics import METRIC
from replan.nuplan import PREFIX
from replan.replay.parts import OF_LOOP, PLANNER
from replan.replay.planner_process.connection import command_of
from replan.results.log_result import LogResult, Stamp, load_result
from replan.results.tables import FILES, LOG_CARD, PARTIAL, clear_partial, write_text
from replan.results.version import replan_version
from replan.run.claim import STUDY, emptied
from replan.run.log_source import LogSource

START_OVER = "leave out --resume to start over"


def stamp_of(run: RunConfig, also: Iterable[tuple[ExtensionKind[Any], str]] = ()) -> Stamp:
    """Version, and hash of the source files of replan and of the modules that the run names, and
    `also` these names.
    """
    digest = sha256()
    for folder in own_folders():
        for file in sorted(folder.rglob("*.py")):
            digest.update(f"{file.relative_to(folder.parent)}\n".encode() + file.read_bytes())
    # Files of users: modules ("module:NAME", entry points), and files that commands name
    own: list[Path] = []
    for name in run.planners:
        if name.startswith("exec:"):
            words = command_of(name)
            files = [Path(shutil.which(words[0]) or words[0]), *map(Path, words[1:])]
            own += [file for file in files if file.is_file()]
        elif not name.startswith("tcp:"):
            source = PLANNER.file(name.removeprefix(PREFIX))
            own += [] if source is None else [source]
    named: list[tuple[ExtensionKind[Any], str]] = [(METRIC, name) for name in run.metrics]
    named += [(READER, name) for name in (*READER.entries(), run.log.reader) if name]
    named += [(kind, getattr(run.loop, key)) for key, kind in OF_LOOP.items()]
    for kind, name in (*named, *also):
        if name not in kind.besides and (source := kind.file(name)) is not None:
            own.append(source)
    for file in own:
        digest.update(f"{file.name}\n".encode() + file.read_bytes())
    return Stamp(replan_version(), digest.hexdigest())


def finished(
    out: Path, sources: Sequence[LogSource], run: RunConfig, stamp: Stamp
) -> dict[int, LogResult]:
    """The results that an interrupted run left in `out`, by index of their source; removes
    unfinished folders.

    ConfigError if `out` is not an interrupted run of these logs with this configuration and this
    code.
    """
    folders = [folder for folder in sorted(out.iterdir()) if (folder / LOG_CARD).is_file()]
    if folders or (out / "run.toml").is_file():
        changed = changes(
            read_toml(out / "run.toml"), tomllib.loads(dump_run(run)), ("gates", "selection")
        )
        if changed:
            raise ConfigError(
                f"{out}: was begun with another configuration: {changed}; give the same options, "
                f"or {START_OVER}"
            )
    contents = {
        folder: load_result(folder) for folder in folders if not folder.name.startswith(PARTIAL)
    }
    inputs = {identity_of(source): index for index, source in enumerate(sources)}
    results: dict[int, LogResult] = {}
    for content in contents.values():
        if content is None:
            continue
        result, identity, was = content
        if was != stamp:
            with_what = "other code of replan, of a planner or of a metric than there is now"
            if was.replan != stamp.replan:
                with_what = f"replan {was.replan}, this is {stamp.replan}"
            raise ConfigError(f"{out}: was begun with {with_what}; {START_OVER}")
        if identity not in inputs:
            raise ConfigError(
                f"{out}: holds results of {result.source}, which is not among the logs or has "
                f"changed; name the same logs as before, or {START_OVER}"
            )
        results[inputs[identity]] = replace(result, source=sources[inputs[identity]].label)
    clear_partial(out)
    for folder in (folder for folder, content in contents.items() if content is None):
        shutil.rmtree(folder)
    for name in FILES:  # the tables are written anew at the end
        if name != "run.toml":
            (out / name).unlink(missing_ok=True)
    return results


def identity_of(source: LogSource) -> str:
    """The identity of a source.

    Its label if it cannot be read (the evaluation then reports the reason).
    """
    try:
        return source.identity()
    except LogError:
        return source.label


def changes(
    before: Mapping[str, Any], now: Mapping[str, Any], besides: tuple[str, ...] = ()
) -> str:
    """The keys, except `besides` and those in these tables, in which two configurations differ, in
    words; "" if there are none.
    """
    was, now = dict(flat(before)), dict(flat(now))
    changed = [
        key
        for key in dict.fromkeys([*was, *now])
        if was.get(key) != now.get(key) and key.partition(".")[0] not in besides
    ]
    return listed(
        [f"{key} was {_describe(was, key)}, is {_describe(now, key)}" for key in changed], 3
    )


def _describe(table: Mapping[str, Any], key: str) -> str:
    return repr(table[key]) if key in table else "not set"


CHECKSUM = "crc32"  # The key of the checksum of a trial's line


def study_head(kind: str, run: RunConfig, inputs: Mapping[str, Any]) -> dict[str, Any]:
    """The head of a study: its kind, the versions of replan and the code, its own inputs (JSON
    types), its run.
    """
    stamp = stamp_of(run)
    return {
        "study": kind,
        "replan": stamp.replan,
        "code": stamp.code[:12],
        **inputs,
        "run": dump_run(run),
    }


class Study:
    """The trials of a study, by key.

    `out`: the folder, which is claimed (`replan.run.claim`). `head`: the inputs, as JSON types: a
    study with another head is a different study. `resume`: use the trials in the file; otherwise
    the folder is emptied. ConfigError if the folder contains no study that can be resumed.
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
            raise ConfigError(
                f"{self._path.parent}: contains no study to resume; leave out --resume to start one"
            )
        again = "leave out --resume to start over"
        try:
            lines = self._path.read_bytes().split(b"\n")[:-1]  # what follows the last end is cut
            rows = [json.loads(line) for line in lines]
        except (OSError, ValueError, RecursionError) as error:
            raise ConfigError(
                f"{self._path}: cannot be read as a study: {error}; {again}"
            ) from None
        if not (
            rows
            and all(isinstance(row, dict) for row in rows)
            and all("key" in row for row in rows[1:])
        ):
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
