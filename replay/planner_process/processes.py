"""The worker's side of the launcher: it starts a process for a planner within milliseconds, and
ends it.

One launcher serves a worker as long as its Python path, folder and environment do not change; it
ends with the worker, and so do all processes that it has started. Within a run (`set_template_run`)
the drives of a planner are forked from a template, which has loaded its module once; if there
cannot be a template, from the launcher, and each loads the module itself.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from replan.core.errors import ConfigError
from replan.replay.loop_config import PlannerProcessConfig
from replan.replay.planner_process.channel import Channel

ENVIRONMENT = (
    "PATH",
    "HOME",
    "USER",
    "LANG",
    "LC_",
    "TZ",
    "TMPDIR",
    "XDG_CACHE_HOME",
    "NUMBA_",
    "OMP_",
    "OPENBLAS_",
    "MKL_",
    "LD_LIBRARY_PATH",
    "DYLD_LIBRARY_PATH",
    "CUDA_",
    "VIRTUAL_ENV",
    "COVERAGE_",
)
"""Environment variables, or prefixes of their names, that are passed on, because programs need them
to start.
"""
GRACE_S = 1.0  # Time limit for a planner to end by itself after its drive, s
KILLED_S = 10.0
"""Time limit for the system to report the end of a killed process, s.

On a busy machine, that takes seconds.
"""


@dataclass(frozen=True)
class Load:
    """The planner that a template loads."""

    planner: str  # "module:Class"
    settings: bytes  # Its table in the configuration, MessagePack
    # Whether it serves the second drive of a log's start (`replan.replay.loop.planning`). That has
    # a template of its own, as a module may draw or read something else each time it is imported.
    again: bool = False


class Process:
    """A planner's process, with the `channel` to it; its output is read, too."""

    def __init__(self, forks: ForkClient, key: int, channel: Channel[Any]) -> None:
        self._forks, self._key, self.channel = forks, key, channel

    def close(self) -> None:
        """Let it end by itself after its drive, and kill it if it does not."""
        self.channel.close()
        if self._forks.status(self._key, GRACE_S) is None:
            self._forks.kill(self._key)

    def kill(self) -> None:
        """End it, and all processes that it has started."""
        self._forks.kill(self._key)
        self.channel.close()

    def ending(self) -> str:
        """How the process ended, in words.

        A process that has only closed its output is killed first.
        """
        status = self._forks.status(self._key, GRACE_S)
        runs = status is None
        # It runs, or its end is not reported yet: a signal does not change the status of that
        if status is None:
            self._forks.kill(self._key)
            status = self._forks.status(self._key, KILLED_S)
        self.channel.read_printed()
        code = None if status is None else os.waitstatus_to_exitcode(status)
        if code is None or (runs and code == -signal.SIGKILL):
            return "it closed its output"
        if code >= 0:
            return f"its process ended with code {code}"
        name = signal.Signals(-code).name
        hint = "; the system may be out of memory" if name == "SIGKILL" else ""
        return f"its process was killed ({name}){hint}"


def start_process(
    argv: list[str] | None, kind: Any, limits: PlannerProcessConfig, load: Load | None = None
) -> Process:
    """A new process of a program or of a Python planner (`replan.replay.planner_process.child`).

    `argv`: the program and its arguments; None: a Python planner. `limits`: limits of its memory,
    and of the time to load its template. `load`: the planner of its template, within a run; None:
    it starts without a template. ConfigError if the system cannot pass descriptors between
    processes.
    """
    if not hasattr(socket, "send_fds"):
        raise ConfigError(
            "planners are kept apart on Linux and macOS only; here give --set loop.apart.trust=true"
        )
    names = set(limits.environment)
    environment = {
        name: value
        for name, value in os.environ.items()
        if name.startswith(ENVIRONMENT) or name in names
    }
    path = dict.fromkeys(str(Path(entry).absolute()) for entry in sys.path if "://" not in entry)
    environment |= {"PYTHONPATH": os.pathsep.join(path), "PYTHONHASHSEED": "0"}
    wanted = os.getpid(), str(Path.cwd()), environment
    with _starting:
        # The launcher is restarted if those change
        if _warm.get("for") != wanted or not _warm["launcher"].alive:
            _warm.update({"for": wanted, "launcher": Launcher(environment)})
        launcher: Launcher = _warm["launcher"]
        request = {
            "argv": argv,
            "path": os.environ.get("PYTHONPATH"),
            "memory": round(limits.memory_gb * 1e9),
        }
        template = launcher.template(load, limits) if load and _warm.get("run") else None
        if template is not None:
            with suppress(OSError):  # it has just died
                return template.start(request, kind)
        return launcher.forks.start(request, kind)


def set_template_run(run: str) -> None:
    """From now on, load a planner's module once in this process for all drives of a run.

    `run`: its name. Templates of another run are dropped, as the files may have changed since. "":
    no run; each drive loads the module itself.
    """
    if _warm.get("run", "") != run:
        _warm["run"] = run
        if "launcher" in _warm:
            _warm["launcher"].templates.clear()


class ForkClient:
    """The other end of a control socket: `replan.replay.planner_process.launcher.ForkServer`.

    `key`: the key under which the process at the other end was started; 0 for the launcher.
    """

    def __init__(self, control: socket.socket, key: int = 0) -> None:
        self._control, self.key = control, key
        self._ended: dict[int, int] = {}
        self._unfit: str | None = None
        self._count, self._rest, self._reading = 0, b"", threading.Lock()
        self.close = weakref.finalize(self, control.close)

    def start(self, request: Mapping[str, Any], kind: Any) -> Process:
        """Fork a planner's process at the other end; OSError if that end has closed."""
        pipes = [os.pipe() for _ in range(3)]
        (stdin, into), (outputs, stdout), (printed, stderr) = pipes
        try:
            key = self._send_request(request, [stdin, stdout, stderr])
        except OSError:
            for fd in (into, outputs, printed):
                os.close(fd)
            raise
        finally:
            for fd in (stdin, stdout, stderr):
                os.close(fd)
        return Process(self, key, Channel(into, outputs, kind, printed))

    def template(self, request: Mapping[str, Any]) -> ForkClient:
        """Fork a template at the other end, which loads a module."""
        parent_end, child_end = socket.socketpair()
        with child_end:
            return ForkClient(parent_end, self._send_request(request, [child_end.fileno()]))

    def _send_request(self, request: Mapping[str, Any], given: list[int]) -> int:
        self._count += 1
        socket.send_fds(
            self._control, [json.dumps({"start": self._count, **request}).encode() + b"\n"], given
        )
        return self._count

    def fit(self, within_s: float) -> bool:
        """Whether a template has loaded its planner within a time, and may be forked."""
        until = time.monotonic() + within_s
        while self._unfit is None and self._hear(until):
            pass
        return self._unfit == ""

    def status(self, key: int, within_s: float) -> int | None:
        """The wait status of a process that has ended within a time; None if it has not."""
        until = time.monotonic() + within_s
        while key not in self._ended:
            if not self._hear(until):
                return None
        return self._ended[key]

    def _hear(self, until: float) -> bool:
        """Read messages; False if none came until `until`, or the socket is closed."""
        try:
            ready, _, _ = select.select([self._control], [], [], max(until - time.monotonic(), 0.0))
        except (OSError, ValueError):  # it is closed
            return False
        with self._reading:
            try:
                data = self._control.recv(1 << 16, socket.MSG_DONTWAIT) if ready else b""
            except BlockingIOError:  # another thread has read it
                return True
            except OSError:
                return False
            *lines, self._rest = (self._rest + data).split(b"\n")
            for message in map(json.loads, lines):
                self._unfit = message.get("unfit", self._unfit)
                if "ended" in message:
                    self._ended[message["ended"]] = message["status"]
            return bool(data)

    def kill(self, key: int) -> None:
        """End a process and its group."""
        with suppress(OSError):
            self._control.sendall(json.dumps({"kill": key}).encode() + b"\n")


class Launcher:
    """The process of `replan.replay.planner_process.launcher`, and its templates by what they
    load.
    """

    def __init__(self, environment: Mapping[str, str]) -> None:
        control, child_end = socket.socketpair()
        with child_end:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "replan.replay.planner_process.launcher"],
                stdin=child_end.fileno(),
                stdout=subprocess.DEVNULL,
                env=dict(environment),
                start_new_session=True,
            )
        self.forks = ForkClient(control)
        self.templates: dict[Load, ForkClient | None] = {}  # None if one cannot be made
        self.close = weakref.finalize(self, _end_launcher, control, self._process, self.templates)

    @property
    def alive(self) -> bool:
        """Whether it runs and belongs to this process (after a fork it belongs to the parent)."""
        return self.close.alive and self._process.poll() is None

    def template(self, load: Load, limits: PlannerProcessConfig) -> ForkClient | None:
        """The template that has loaded a planner; None if that takes too long, or it must not be
        forked.
        """
        template = self.templates.get(load)
        if template is not None and self.forks.status(template.key, 0.0) is not None:
            del self.templates[load]  # it has died
        if load not in self.templates:
            request = {
                "load": [load.planner, load.settings.hex()],
                "memory": round(limits.memory_gb * 1e9),
            }
            new_template = self.forks.template(request)
            fit = new_template.fit(limits.start_timeout_s)
            if not fit:
                self.forks.kill(new_template.key)
            self.templates[load] = new_template if fit else None
        return self.templates[load]


def _end_launcher(
    control: socket.socket,
    process: subprocess.Popen[bytes],
    templates: Mapping[Load, ForkClient | None],
) -> None:
    for template in filter(None, templates.values()):
        template.close()  # closing ends them; otherwise the launcher would wait for them
    control.close()
    with suppress(subprocess.TimeoutExpired):
        process.wait(10.0)
        return
    process.kill()
    process.wait()


# Held while a process is started: threads that start planners at once share the launcher
_starting = threading.Lock()
_warm: dict[str, Any] = {}
"""State of this process: `launcher`; `for`: the settings that it was started with; `run`: the
current run.
"""
