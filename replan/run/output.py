"""The place of the results of a run: a folder that it locks, or a URL; and the place of its logs.

A folder is locked by the operating system's lock on the file `.lock` in it: it is released when the
process ends for any reason, and works between containers that share a folder, and between machines
on network file systems. If a file system has no locks, the file itself is the lock: a lock of a
process of this machine that has ended is taken over, a lock of another machine is not.

A result folder at a URL is a folder of this machine while the run lasts, from which each log's
folder is sent. At any time the URL has the files that an interrupted run would have left:
`run.toml`, and the folders of the finished logs, each with its card `log.json` written last; a
folder without a card is incomplete and is not used. Tables and reports follow at the end.
`--resume` first fetches the files at the URL. Files of an earlier run are removed when the first
log is sent: a run that cannot begin (a name is wrong, a log is missing) removes nothing. The object
`.lock` is written only if it does not exist, which S3 (conditional writes) and Google's store do in
one step. No object store releases a lock when its holder ends: a lock of a process of this machine
that has ended is taken over; a lock of another machine is named in the error, and must be removed
by hand.

`origin.json` gives the directory in which a run was started. Logs are named as they were given,
mostly relative to that directory. It is stored relative to the results, for results that are moved
together with their logs, and as an absolute path, for results that are moved without them.
"""

from __future__ import annotations

import errno
import json
import os
import socket
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from replan.core.errors import ConfigError, ReplanError, writing
from replan.core.urls import (
    RemoteFile,
    content,
    fetch,
    listed,
    local_path,
    on_this_machine,
    put,
    put_new,
    remove,
    url_of,
)
from replan.logs.forward import drivable_part
from replan.logs.mcap import read_scenario
from replan.logs.readers import LogSettings
from replan.logs.scenario import Scenario
from replan.results.log_result import LogResult
from replan.results.schema import Place, read_json
from replan.results.tables import FILES, LOCK, LOG_CARD, ORIGIN, PARTIAL, write_json
from replan.run.log_source import LogSource, log_hash
from replan.run.sources import select

_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL)
_CARD_BYTES = 4096
# Windows locks bytes, which then cannot be read: this byte is behind all written bytes
_FAR = 1_073_741_824
_START_TICKS = 19  # Field of /proc/PID/stat after the process's name


@contextmanager
def held(out: Path) -> Iterator[None]:
    """Lock the folder, and create it if needed; the lock file is removed afterwards.

    ConfigError if another run has locked it (with process, host and time), it cannot be created or
    written to, or it is a URL.
    """
    on_this_machine(out)
    is_new = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be the result folder: {error.strerror}") from None
    try:
        with locked(out / LOCK, out):
            yield
    finally:
        if is_new:
            with suppress(OSError):  # it has contents, as it should have
                out.rmdir()


@contextmanager
def locked(path: Path, what: Path) -> Iterator[None]:
    """Lock a folder or file `what` by the lock file at `path`, which is removed afterwards;
    ConfigError as `held`.
    """
    try:
        handle = _lock(path, what)
    except OSError as error:
        raise ConfigError(
            f"{what}: cannot be written: {error.strerror}; give --out another place"
        ) from None
    try:
        with writing(path):
            os.ftruncate(handle, 0)
            os.lseek(handle, 0, os.SEEK_SET)
            os.write(handle, lock_card())
        yield
    finally:
        if sys.platform == "win32":  # an open file cannot be removed
            os.close(handle)
        with suppress(OSError):  # the folder is gone, or has become read-only
            path.unlink()
        if sys.platform != "win32":
            os.close(handle)


def _lock(path: Path, what: Path) -> int:
    """The lock file, open and locked; ConfigError if another run has locked it."""
    while True:
        try:
            handle, is_new = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666), True
        except FileExistsError:
            handle, is_new = os.open(path, os.O_RDWR | os.O_CREAT, 0o666), False
        locked = _try_lock(handle)
        os.lseek(handle, 0, os.SEEK_SET)
        try:
            card: dict[str, Any] = dict(json.loads(os.read(handle, _CARD_BYTES)))
        except ValueError:  # its holder has not written it yet
            card = {}
        if not (locked or (locked is None and (is_new or has_ended(card)))):
            os.close(handle)
            wait = "wait for it, or give --out another place"
            if not card:
                raise ConfigError(f"{what}: another run writes it just now; {wait}")
            owner = f"process {card['pid']} on {card['host']} since {card['since']}"
            raise ConfigError(
                f"{what}: another run writes it ({owner}); {wait}; if it has ended: rm {path}"
            )
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), path.stat()):
                return handle
        os.close(handle)  # its holder removed it after it was opened, and before it was locked


def _try_lock(handle: int) -> bool | None:
    """Lock the file; False: another process has locked it; None: the file system has no locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(handle, _FAR, os.SEEK_SET)
            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
            os.lseek(handle, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return None if error.errno in _NO_LOCKS else False
    return True


def lock_card() -> bytes:
    """The owner of a lock, for people and for file systems without locks."""
    since = datetime.now(UTC).isoformat(timespec="seconds")
    card = {
        "pid": os.getpid(),
        "host": socket.gethostname(),
        "since": since,
        "started": _start_of_process(os.getpid()),
    }
    return json.dumps(card).encode()


def has_ended(card: dict[str, Any]) -> bool:
    """Whether the holder was a process of this machine that has ended."""
    if card.get("host") != socket.gethostname():
        return False
    try:
        os.kill(card["pid"], 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return bool(card["started"] != _start_of_process(card["pid"]))


def _start_of_process(pid: int) -> str:
    """Start time of a process in system ticks, which differs for another process with this number;
    "" if unknown.
    """
    try:
        return (
            Path(f"/proc/{pid}/stat")
            .read_text(encoding="utf-8")
            .rpartition(")")[2]
            .split()[_START_TICKS]
        )
    except (OSError, IndexError):
        return ""


@dataclass
class OutputLocation:
    """The place to which the results of a run are written."""

    folder: Path | None  # The folder on this machine; None: the next free one
    url: str = ""  # The URL to which it is sent; "" if there is none
    # Write times of the files that are at the URL already; they are sent again only if written anew
    sent: dict[str, int] = field(default_factory=dict)
    # Files at the URL that are removed before anything is sent
    old: list[str] = field(default_factory=list)

    def check_outside(self, sources: Sequence[LogSource]) -> None:
        """Raise ConfigError if the URL contains a log that is to be driven: it would be removed."""
        urls = [file.url for source in sources for file in source.remote]
        inside = [url for url in urls if self.url and url.startswith(f"{self.url}/")]
        if inside:
            where = f"lies in the results {self.url}, which are replaced"
            raise ConfigError(f"{inside[0]}: {where}; give --out another place")

    def keep(self, result: LogResult) -> None:
        """Send a log's folder, and `run.toml` before the first one; OutputError if that fails."""
        if self.url and self.folder is not None and result.folder:
            log_folder = self.folder / result.folder
            files = sorted(path for path in log_folder.iterdir() if path.name != LOG_CARD)
            self._send([self.folder / "run.toml", *files, log_folder / LOG_CARD])

    def finish(self) -> None:
        """Send all files that are not at the URL yet; OutputError if that fails."""
        if self.url and self.folder is not None:
            files = (
                path
                for path in sorted(self.folder.rglob("*"))
                if path.is_file() and path.name != LOCK
            )
            self._send(
                [
                    path
                    for path in files
                    if not path.relative_to(self.folder).parts[0].startswith(PARTIAL)
                ]
            )

    def _send(self, files: Sequence[Path]) -> None:
        assert self.folder is not None
        remove(self.old)
        self.old = []
        for path in files:
            name, written = path.relative_to(self.folder).as_posix(), path.stat().st_mtime_ns
            if self.sent.get(name) != written:
                put(path, f"{self.url}/{name}")
                self.sent[name] = written


@contextmanager
def output_location(out: Path | str | None, *, resume: bool = False) -> Iterator[OutputLocation]:
    """A place for a run's results; a URL is locked, and its contents are fetched (`resume`) or
    replaced.

    ConfigError if another run writes there, its contents are not results, or it cannot be written.
    OutputError if the connection is lost; finished logs are kept for `resume`.
    """
    url = "" if out is None else url_of(out)
    if not url:
        yield OutputLocation(None if out is None else local_path(out))
        return
    lock = f"{url}/{LOCK}"
    while not put_new(lock_card(), lock):
        try:
            holder = dict(json.loads(content(lock)))
        except ValueError:
            holder = {}
        if not has_ended(holder):
            owner = (
                f"process {holder.get('pid')} on {holder.get('host')} since {holder.get('since')}"
            )
            remedy = f"wait for it, or give --out another place; if it has ended, remove {lock}"
            raise ConfigError(f"{url}: another run writes into it ({owner}); {remedy}")
        remove([lock])
    try:
        with tempfile.TemporaryDirectory(prefix="replan-") as scratch:
            folder = Path(scratch, "results")
            location = _open_url(url, folder, resume=resume)
            try:
                yield location
                location.finish()
            except (ReplanError, KeyboardInterrupt) as error:
                raise type(error)(str(error).replace(str(folder), url)) from error
    finally:
        remove([lock])


def _open_url(url: str, folder: Path, *, resume: bool) -> OutputLocation:
    """The location at a URL, with those existing results that are kept."""
    files = [file for file in listed(url) if file.name != LOCK]
    cards = {file.name.partition("/")[0] for file in files if file.name.endswith(f"/{LOG_CARD}")}
    logs = [file for file in files if "/" in file.name]
    foreign = [file for file in files if "/" not in file.name and file.name not in FILES]
    if not any(file.name == "run.toml" for file in files):
        foreign += files
    if foreign:
        raise ConfigError(
            f"{url}: contains {foreign[0].name}, not a replan result; give --out a new or empty "
            "place"
        )
    whole = [file for file in logs if file.name.partition("/")[0] in cards] if resume else []
    fetched = [*whole, *(file for file in files if resume and file.name == "run.toml")]
    if fetched:
        folder.mkdir()
        fetch(fetched, folder)
    sent = {file.name: (folder / file.name).stat().st_mtime_ns for file in fetched}

    def order_of_removal(file: RemoteFile) -> tuple[bool, bool, str]:
        """Cards first, so that no incomplete folder looks complete; run.toml, which identifies
        results, last.
        """
        return file.name == "run.toml", not file.name.endswith(LOG_CARD), file.name

    order = sorted(files, key=order_of_removal)
    return OutputLocation(folder, url, sent, [file.url for file in order if file not in fetched])


class Origin(msgspec.Struct):
    """The contents of origin.json."""

    directory: Place
    from_results: Place


def write_origin(out: Path, begun: Path | None = None) -> None:
    """Record in the results where the run was started (None: the working directory); OutputError if
    that fails.
    """
    directory = begun or Path.cwd()
    try:
        from_results = Path(os.path.relpath(directory, out.resolve())).as_posix()
    except ValueError:  # on another drive of Windows
        from_results = ""
    write_json(out / ORIGIN, {"directory": str(directory), "from_results": from_results})


def begun_in(out: Path, sources: Iterable[str]) -> Path:
    """The directory in which a run was started: the first from which one of its logs is found, else
    the current one.
    """
    logs = [local_path(source) for source in sources if not url_of(source)]
    directories = (
        directory
        for directory in _directories(out)
        if any((directory / log).exists() for log in logs)
    )
    return Path(os.path.normpath(next(directories, Path.cwd())))


def scenario_of(out: Path, row: Mapping[Any, Any], settings: LogSettings) -> Scenario:
    """The driven part of the log of a row of `Results.logs`: of the copy in the results, otherwise
    of the original.

    ConfigError if the log was moved or changed; LogError if the log cannot be read.
    """
    folder = str(row.get("folder", ""))
    if folder and (out / folder / "log.mcap").is_file():
        return drivable_part(read_scenario(out / folder / "log.mcap"))
    if not str(row["sha256"]):
        return LogSource(str(row["source"])).read()
    return drivable_part(log_of(out, str(row["source"]), str(row["sha256"]), settings))


def log_of(out: Path, source: str, digest: str, settings: LogSettings) -> Scenario:
    """The original log that a run read.

    `source`: the log's path or URL as it was given. `digest`: SHA-256 of its bytes. ConfigError if
    the log was moved or changed; LogError if the log cannot be read.
    """
    if url_of(source):
        log = select([source], settings).sources[0]
    else:
        places = list(
            dict.fromkeys(
                Path(os.path.normpath(directory / local_path(source)))
                for directory in _directories(out)
            )
        )
        candidates = [
            LogSource(str(directory), directory, settings)
            for directory in places
            if directory.exists()
        ]
        if not candidates:
            where = " nor at ".join(map(str, places))
            raise ConfigError(
                f"{source}: the log of these results is not at {where}; put it back there"
            )
        log = next(
            (
                candidate
                for candidate in candidates
                if candidate.path and log_hash(candidate.path, settings) == digest
            ),
            candidates[0],
        )
    with log.fetched() as near:
        assert near.path is not None
        if log_hash(near.path, settings) != digest:
            raise ConfigError(
                f"{log.label}: is no longer the log of these results: its bytes differ"
            )
        return near.read()


def _directories(out: Path) -> list[Path]:
    """The directories to which the paths of a run may be relative, in the order in which they are
    tried.
    """
    if not (out / ORIGIN).is_file():  # results of an older replan
        return [Path.cwd()]
    _, card = read_json(out / ORIGIN, Origin)
    from_results = [out.resolve() / card.from_results] if card.from_results else []
    return [*from_results, Path(card.directory), Path.cwd()]
