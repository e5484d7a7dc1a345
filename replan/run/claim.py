"""What a command may write: a folder or a file of its own, claimed before any work. All commands
that write use this.

A folder is claimed if it is new, empty, or has only what the same command writes
(`FolderContents`); a file, if it is new or has the command's own header, and does not lie in a
result folder. Files may also be claimed among others, in a folder that several commands write
(`claimed_files`). All are locked while the command runs, so that of two commands at once the second
is refused. A URL is refused, except by `replan evaluate` and `replan merge`.

If the disk is full or the command is interrupted, the error says how to go on: of folders in
folders (a tuning drives runs), the outermost one counts, since it is the one that the user named.

`rows_file` is a claimed file of a table: CSV, Parquet or JSON, by the suffix.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from replan.core.errors import ConfigError, OutputError, writing
from replan.core.files import check_named
from replan.core.urls import on_this_machine
from replan.results.tables import (
    LOCK,
    ORIGIN,
    PARTIAL,
    PNG_MARK,
    csv_text,
    is_ours as is_of_a_run,
    next_free,
    write_file,
)
from replan.run.output import held, locked

MARKS: Mapping[str, bytes] = {
    ".png": PNG_MARK,
    ".svg": b' class="chart" ',
    ".rrd": b"replan ",
    ".xml": b"<CommonRoadSolution ",
    ".msgpack": b"\xa7version",
    **dict.fromkeys((".gif", ".mp4", ".mkv", ".mov", ".webm"), b"replan"),
}
"""What files of replan hold, and others of the same kind do not, by the end of their names."""
STUDY = "study.jsonl"
"""The file of a study (`replan.run.resume`): its first line names the command that wrote the
folder.
"""


@dataclass(frozen=True)
class FolderContents:
    """What a command writes into a folder of its own."""

    command: str
    names: tuple[str, ...] = ()  # Patterns of the names of its files and folders, beside `STUDY`
    # Instead of names: whether an entry of the folder is of the command
    is_ours: Callable[[Path], bool] | None = None
    resumes: bool = True  # Whether the command has the option --resume

    def check(self, out: Path) -> None:
        """Raise ConfigError if a folder has anything that the command did not write."""
        entries = [entry for entry in sorted(out.iterdir()) if entry.name != LOCK]
        if not entries:
            return
        other = f"not results of `replan {self.command}`; give --out a new or empty folder"
        if self.is_ours is None and self.resumes and study_of(out) != self.command:
            raise ConfigError(f"{out}: contains {entries[0].name}, {other}")
        foreign = [entry.name for entry in entries if not (self.is_ours or self._is_named)(entry)]
        if foreign:
            raise ConfigError(f"{out}: contains {foreign[0]}, {other}")

    def _is_named(self, entry: Path) -> bool:
        partial = entry.name.startswith(PARTIAL) or (entry.name[0], entry.suffix) == (".", ".part")
        return partial or any(entry.match(pattern) for pattern in (STUDY, *self.names))


LONGEST_HEAD = 16_777_216
"""Greatest length of a study's first line that is read, bytes."""
RUN = FolderContents("evaluate", is_ours=is_of_a_run)
MERGED = FolderContents("merge", is_ours=is_of_a_run, resumes=False)


def study_of(out: Path) -> str:
    """The command of the study in a folder; "" if there is none."""
    try:
        with (out / STUDY).open(encoding="utf-8") as stream:
            return str(json.loads(stream.readline(LONGEST_HEAD))["study"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return ""


@contextmanager
def claimed_folder(
    out: Path | str | None, contents: FolderContents, *, resume: bool = False
) -> Iterator[Path]:
    """The locked folder of a command; None: the next free one.

    ConfigError if it must not be written, another command writes it, or `resume` without a folder.
    OutputError if the disk is full, and KeyboardInterrupt, with the way to go on.
    """
    if resume and out is None:
        raise ConfigError("name the folder that is to be resumed with --out")
    folder = next_free() if out is None else on_this_machine(out)
    how = f"give the same command with --out {folder}{' --resume' if contents.resumes else ''}"
    consequence = "what is finished is kept" if contents.resumes else "nothing is kept"
    try:
        with held(folder):
            contents.check(folder)
            yield folder
    except OutputError as error:
        raise OutputError(error.what, f"{consequence}: make room, and {how}") from error
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted: {consequence}; to continue, {how}") from None
    finally:
        if out is None:
            with suppress(OSError):  # it has contents, as it should have
                folder.rmdir()


def emptied(out: Path) -> Path:
    """Empty a claimed folder, and return it."""
    for entry in out.iterdir():
        if entry.name != LOCK:
            shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
    return out


def is_marked(file: Path) -> bool:
    """Whether a file has the mark of its kind (`MARKS`); OSError if it cannot be read."""
    return MARKS[file.suffix] in file.read_bytes()


@contextmanager
def claimed_files(
    out: Path, suffixes: Sequence[str], is_ours: Callable[[Path], bool] = is_marked
) -> Iterator[Callable[[str], Path]]:
    """The function that gives the path of a file by its name: `out` if that is a file, else a file
    in the folder `out`.

    The folder is locked, and may have other files. Raises as `claimed_file`, the function as
    `check_file`, or if it gave this path before: call it for all files, then write the first.
    """
    is_file = out.suffix in suffixes and not out.is_dir()
    claimed: set[Path] = set()

    def place(name: str) -> Path:
        path = out if is_file else check_file(out / name, suffixes, is_ours)
        if path in claimed:
            raise ConfigError(
                f"{path}: two files of this command would have this name; "
                + ("name a folder with -o" if is_file else "write them one by one into two folders")
            )
        claimed.add(path)
        return path

    with claimed_file(out, suffixes, is_ours) if is_file else held(out):
        yield place


@contextmanager
def claimed_file(
    path: Path, suffixes: Sequence[str], is_ours: Callable[[Path], bool] = is_marked
) -> Iterator[Path]:
    """The locked file of a command, which the body writes; its folder is created.

    ConfigError as `check_file`, or if another command writes it; OutputError if it cannot be
    written.
    """
    check_file(path, suffixes, is_ours)
    with locked(path.with_name(f".{path.name}{LOCK}"), path):
        yield path


def check_file(path: Path, suffixes: Sequence[str], is_ours: Callable[[Path], bool]) -> Path:
    """Return the path of a file, of which the folder is created; ConfigError if a command must not
    write it.

    `is_ours`: whether an earlier file has the header of the command; it is then replaced. It may
    raise OSError or ValueError.
    """
    path = on_this_machine(path)
    if path.suffix not in suffixes:
        raise ConfigError(f"{path}: name a file that ends in {', '.join(suffixes)}")
    check_named(path)
    results = result_folder_of(path)
    if results is not None:
        raise ConfigError(
            f"{path}: lies in the results {results}, which have no other files; give --out another "
            "place"
        )
    try:
        ours = not path.exists() or is_ours(path)
    except (OSError, ValueError):
        ours = False
    if not ours:
        raise ConfigError(
            f"{path}: exists, and this command did not write it, or reads it; name another file"
        )
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    return path


def result_folder_of(path: Path) -> Path | None:
    """The result folder of any command in which a path lies; None if there is none."""
    for folder in path.absolute().parents:
        run = folder / "run.toml"  # people copy it: alone it is no run
        if study_of(folder) or ((folder / ORIGIN).is_file() and run.is_file() and is_of_a_run(run)):
            return folder
    return None


def _write_json(table: pd.DataFrame, path: Path) -> None:
    text = table.to_json(orient="records", indent=2, double_precision=15) or "[]"
    path.write_text(f"{text}\n", encoding="utf-8")


WRITERS: Mapping[str, Callable[[pd.DataFrame, Path], object]] = {
    ".csv": csv_text,
    ".parquet": lambda table, path: table.to_parquet(path, index=False),
    ".json": _write_json,
}
"""Functions that write rows, by the suffix of the file."""


@contextmanager
def rows_file(path: Path) -> Iterator[Callable[[pd.DataFrame], None]]:
    """The function that writes rows as .csv, .parquet or .json, by the suffix of a claimed file.

    An earlier file is replaced if it has the same columns.
    ConfigError if the file must not be written; OutputError if it cannot be written.
    """
    with claimed_file(path, tuple(WRITERS), lambda file: True) as file:

        def write(table: pd.DataFrame) -> None:
            if file.exists() and _columns_of(file) != table.columns.tolist():
                raise ConfigError(f"{file}: exists, and has other columns; name another file")
            write_file(file, lambda partial: WRITERS[file.suffix](table, partial))

        yield write


def _columns_of(file: Path) -> list[str] | None:
    """The columns of a file of rows; None if it is none."""
    try:
        if file.suffix == ".parquet":
            return list(pq.read_schema(file).names)
        if file.suffix == ".csv":
            return pd.read_csv(file, nrows=0).columns.tolist()
        rows = json.loads(file.read_text(encoding="utf-8"))
        return list(rows[0])
    except (OSError, ValueError, LookupError, TypeError, RecursionError, pa.ArrowException):
        return None
