"""A lock on a result folder: one run at a time writes into it.

The lock is the operating system's on the file `.lock` in the folder: it ends with the process however that ends, holds
between containers that share a folder, and on network file systems between machines. Where a file system has no locks,
the file itself is one: that of a process of this machine that has ended is taken over, that of another machine is not.
"""

from __future__ import annotations

import errno
import json
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from logs.errors import ConfigError, writing
from replay.results.tables import LOCK

_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL)
_CARD_BYTES = 4096
_FAR = 1 << 30
"""Windows locks bytes, and none may read them: this one is behind all that is written."""


@contextmanager
def held(out: Path) -> Iterator[None]:
    """Hold the folder, which is made where it is not there; nothing of the lock stays behind.

    Raises:
        ConfigError: Another run holds it (says which, where and since when), or it cannot be made or written to.
    """
    made, path = not out.exists(), out / LOCK
    try:
        out.mkdir(parents=True, exist_ok=True)
        handle = _taken(path)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be the result folder: {error.strerror}") from None
    try:
        with writing(path):
            os.ftruncate(handle, 0)
            os.lseek(handle, 0, os.SEEK_SET)
            os.write(handle, card())
        yield
    finally:
        if sys.platform == "win32":  # has no file removed that is open
            os.close(handle)
            path.unlink(missing_ok=True)
        else:
            path.unlink(missing_ok=True)
            os.close(handle)
        if made:
            with suppress(OSError):  # there is something in it, as there should be
                out.rmdir()


def _taken(path: Path) -> int:
    """The lock's file, open and locked."""
    while True:
        handle, ours = _opened(path)
        locked = _locked(handle)
        if locked is None:
            locked = ours or has_ended(_read(handle))
        if not locked:
            card = _read(handle)
            os.close(handle)
            raise ConfigError(f"{path.parent}: {_said(card, path)}")
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), path.stat()):
                return handle
        os.close(handle)  # its holder removed it between our opening and our locking


def _opened(path: Path) -> tuple[int, bool]:
    """The file, and whether it was not there before."""
    with suppress(FileExistsError):
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666), True
    return os.open(path, os.O_RDWR | os.O_CREAT, 0o666), False


def _locked(handle: int) -> bool | None:
    """Lock the file; False: another has it; None: the file system has no locks."""
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


def card() -> bytes:
    """Who holds it, for people and for a file system without locks."""
    since = datetime.now(UTC).isoformat(timespec="seconds")
    card = {"pid": os.getpid(), "host": socket.gethostname(), "since": since, "started": _started(os.getpid())}
    return json.dumps(card).encode()


def _read(handle: int) -> dict[str, Any]:
    """What the holder wrote; empty where it has not yet."""
    os.lseek(handle, 0, os.SEEK_SET)
    try:
        return dict(json.loads(os.read(handle, _CARD_BYTES)))
    except ValueError:
        return {}


def _said(card: dict[str, Any], path: Path) -> str:
    if not card:
        return "another run writes into it just now; wait for it, or give --out another folder"
    who = f"process {card['pid']} on {card['host']} since {card['since']}"
    return f"another run writes into it ({who}); wait for it, or give --out another folder; if it has ended: rm {path}"


def has_ended(card: dict[str, Any]) -> bool:
    """Whether the holder was a process of this machine, and is no more."""
    if card.get("host") != socket.gethostname():
        return False
    try:
        os.kill(card["pid"], 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return bool(card["started"] != _started(card["pid"]))


def _started(pid: int) -> str:
    """When a process was started, in the system's ticks: another process of its number has another; "": not known."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return ""
