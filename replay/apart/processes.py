"""The worker's side of the launcher: a process for a planner, started within milliseconds, and its end.

One launcher serves a worker as long as its Python path, folder and environment stay as they are; it ends with the
worker, and with it all that it has started.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
import weakref
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from logs.errors import ConfigError
from replay.apart.channel import Channel

ENVIRONMENT = (
    "PATH", "HOME", "USER", "LANG", "LC_", "TZ", "TMPDIR", "XDG_CACHE_HOME", "NUMBA_", "OMP_", "OPENBLAS_", "MKL_",
    "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "CUDA_", "VIRTUAL_ENV", "COVERAGE_",
)  # fmt: skip
"""Variables, and beginnings of their names, that a planner's process is given: what programs need to start."""
GRACE_S = 1.0
"""A planner whose drive is over has so long to end by itself."""
ROOT = Path(__file__).parents[2]


class Process:
    """A planner's process.

    Attributes:
        channel: To it; what it prints is read along.
    """

    def __init__(self, launcher: Launcher, key: int, channel: Channel[Any]) -> None:
        self._launcher, self._key, self.channel = launcher, key, channel

    def close(self) -> None:
        """The drive is over: it may end by itself, and is killed where it does not."""
        self.channel.close()
        if self._launcher.status(self._key, GRACE_S) is None:
            self._launcher.kill(self._key)

    def kill(self) -> None:
        """End it, and what it has started."""
        self._launcher.kill(self._key)
        self.channel.close()

    def ending(self) -> str:
        """How it ended, in words; it is ended where it has only closed its output."""
        status = self._launcher.status(self._key, GRACE_S)
        self.channel.listen()
        if status is None:
            return "it closed its output"
        code = os.waitstatus_to_exitcode(status)
        if code >= 0:
            return f"its process ended with code {code}"
        name = signal.Signals(-code).name
        hint = "; the system may be out of memory" if name == "SIGKILL" else ""
        return f"its process was killed ({name}){hint}"


def started(argv: list[str] | None, kind: Any, *, memory_gb: float, environment: Iterable[str]) -> Process:
    """A new process: a program, or (None) the Python planner of `replay.apart.child`; `kind` is what it answers.

    Raises:
        ConfigError: The system has no such processes.
    """
    if not hasattr(socket, "send_fds"):
        raise ConfigError("planners are kept apart on Linux and macOS only; here give --trust")
    return _launcher(environment).start(argv, kind, round(memory_gb * 1e9))


class Launcher:
    """The process of `replay.apart.launcher`."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._control, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "replay.apart.launcher"],
                stdin=theirs.fileno(), stdout=subprocess.DEVNULL, env=dict(environment), start_new_session=True,
            )  # fmt: skip
        self._ended: dict[int, int] = {}
        self._count, self._rest = 0, b""
        self.close = weakref.finalize(self, _ended_with, self._control, self._process)

    @property
    def alive(self) -> bool:
        """Whether it runs, and is this process' own (and not that of one that has forked)."""
        return self.close.alive and self._process.poll() is None

    def start(self, argv: list[str] | None, kind: Any, memory: int) -> Process:
        """See `started`."""
        self._count += 1
        pipes = [os.pipe() for _ in range(3)]
        (stdin, into), (out, stdout), (said, stderr) = pipes
        asked = json.dumps({"start": self._count, "argv": argv, "memory": memory})
        try:
            socket.send_fds(self._control, [asked.encode() + b"\n"], [stdin, stdout, stderr])
        finally:
            for fd in (stdin, stdout, stderr):
                os.close(fd)
        return Process(self, self._count, Channel(into, out, kind, said))

    def status(self, key: int, within_s: float) -> int | None:
        """The wait status of a process that has ended within a time; None: it has not."""
        until = time.monotonic() + within_s
        while key not in self._ended:
            left = until - time.monotonic()
            if left <= 0.0:
                return None
            try:
                select.select([self._control], [], [], left)
                data = self._control.recv(1 << 16, socket.MSG_DONTWAIT)
            except BlockingIOError:
                continue
            except (OSError, ValueError):  # it is closed
                return None
            if not data:
                return None
            *lines, self._rest = (self._rest + data).split(b"\n")
            self._ended.update((ended["ended"], ended["status"]) for ended in map(json.loads, lines))
        return self._ended[key]

    def kill(self, key: int) -> None:
        """End a process and its group."""
        with suppress(OSError):
            self._control.sendall(json.dumps({"kill": key}).encode() + b"\n")


def _ended_with(control: socket.socket, process: subprocess.Popen[bytes]) -> None:
    control.close()
    with suppress(subprocess.TimeoutExpired):
        process.wait(10.0)
        return
    process.kill()
    process.wait()


_warm: dict[str, Any] = {}
"""The launcher of this process, and for what it was started."""


def _launcher(environment: Iterable[str]) -> Launcher:
    wanted = os.getpid(), str(Path.cwd()), _environment(environment)
    if _warm.get("for") != wanted or not _warm["launcher"].alive:
        _warm.update({"for": wanted, "launcher": Launcher(wanted[2])})
    launcher: Launcher = _warm["launcher"]
    return launcher


def _environment(more: Iterable[str]) -> dict[str, str]:
    """What a planner's process is given of ours."""
    wanted = set(more)
    found = {name: value for name, value in os.environ.items() if name.startswith(ENVIRONMENT) or name in wanted}
    path = dict.fromkeys([*(str(Path(entry).absolute()) for entry in sys.path if "://" not in entry), str(ROOT)])
    return {**found, "PYTHONPATH": os.pathsep.join(path), "PYTHONHASHSEED": "0"}
