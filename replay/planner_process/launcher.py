"""A small process with loaded modules and without logs, from which the planners' processes are
forked.

    python -P -m replan.replay.planner_process.launcher      its control socket is its stdin; replan
        starts it
    (`replan.replay.planner_process.processes`)

It has imported what every Python planner needs, and never holds a frame, so that a process for a
drive starts in milliseconds and has no data of earlier drives. The control socket carries JSON, one
message a line:

    {"start": KEY, "argv": [...] or null, "path": text or null, "memory": bytes or 0}
        with three descriptors: stdin, stdout, stderr of it
    {"start": KEY, "load": [planner, settings], "memory": ...}
        with one: the control socket of a template
    {"kill": KEY}
        the process and its group
    {"ended": KEY, "status": wait status}
        the reply, once for each process that was started

`path` is the PYTHONPATH of a program. `argv` null is a Python planner
(`replan.replay.planner_process.child`), else a program. When the control socket closes, all are
killed.

A template is a fork of this process that has also loaded a planner's module (`child.load`): it
sends `{"unfit": reason}`, and if the reason is empty, it serves requests as this process does, on
its own control socket. Threads, open files and connections, and own processes make it unfit,
because a fork would share them between drives, or break them.

A planner may start processes in their own sessions, outside of its process group. On Linux each of
these processes is a subreaper (`prctl`): orphans become its children. So a planner's process keeps
its descendants as long as it runs; when it has ended, those that are left become children of this
process, which kills them.
"""

from __future__ import annotations

import gc
import json
import os
import random
import resource
import select
import signal
import socket
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

from replan.core.errors import raised
from replan.replay.planner_process import child

PDEATHSIG, CHILD_SUBREAPER = 1, 36
"""Options of `prctl` (Linux): the signal when the parent dies.

Whether orphans become children of the process.
"""
ENDING_S = 2.0  # Time limit for a template to end with all its processes when this process ends, s


def main() -> None:
    """Serve until the control socket closes."""
    control = socket.socket(fileno=os.dup(0))
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, signal.SIG_IGN)  # replan handles them and ends this process
    child.warm()
    _prctl(CHILD_SUBREAPER, 1)
    ForkServer(control).serve()


@dataclass(eq=False)
class ForkServer:
    """Serves the requests on a control socket: forks processes and kills them."""

    control: socket.socket
    # Whether a fork keeps the state of `random`, which the planner's module may have set, and which
    # Python reseeds
    seed: bool = False
    # The requests of running processes, by process id
    live: dict[int, dict[str, Any]] = field(default_factory=dict)
    given: list[int] = field(default_factory=list)  # Received descriptors that are not used yet

    def serve(self) -> None:
        """Serve requests until the socket closes; then end all processes that run."""
        self._wake, self._waker = (
            os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC) if hasattr(os, "pipe2") else os.pipe()
        )
        os.set_blocking(self._waker, False)
        signal.set_wakeup_fd(self._waker, warn_on_full_buffer=False)
        self._handler = signal.signal(signal.SIGCHLD, lambda number, frame: None)
        gc.collect()
        gc.freeze()
        rest = b""
        while True:
            ready, _, _ = select.select([self.control.fileno(), self._wake], [], [])
            if self._wake in ready:
                os.read(self._wake, 4096)
                self._reap()
            if self.control.fileno() not in ready:
                continue
            try:
                data, came, _, _ = socket.recv_fds(self.control, 1 << 16, 3)
            except ConnectionError:
                break
            if not data:
                break
            *lines, rest = (rest + data).split(b"\n")
            self.given += came
            for line in lines:
                self._do(json.loads(line))
        until = time.monotonic() + ENDING_S
        for pid in [pid for pid, request in self.live.items() if "load" not in request]:
            _kill(pid)
        # Templates end by themselves: their sockets have closed, too
        while self.live and time.monotonic() < until:
            time.sleep(0.005)
            self._reap()
        for pid in self.live:
            _kill(pid)

    def _do(self, request: dict[str, Any]) -> None:
        """Serve one request; a start takes its descriptors from `given`."""
        if "kill" in request:
            for pid in [
                pid for pid, started in self.live.items() if started["start"] == request["kill"]
            ]:
                _kill(pid)
            return
        taken = [self.given.pop(0) for _ in range(1 if "load" in request else 3)]
        state, parent = random.getstate(), os.getpid()
        pid = os.fork()
        if pid == 0:
            if self.seed:
                random.setstate(state)
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, self._handler or signal.SIG_DFL)
            for fd in (self.control.fileno(), self._wake, self._waker, *self.given):
                os.close(fd)
            _become(request, taken, parent)
        self.live[pid] = request
        for fd in taken:
            os.close(fd)

    def _reap(self) -> None:
        for pid in list(self.live):
            ended, status = os.waitpid(pid, os.WNOHANG)
            if ended:
                with suppress(OSError):
                    os.killpg(pid, signal.SIGKILL)  # its group ends with it
                message = {"ended": self.live.pop(pid)["start"], "status": status}
                # The ended process left children, and this one is their parent now
                until = time.monotonic() + ENDING_S
                while (orphans := children() - self.live.keys()) and time.monotonic() < until:
                    for orphan in orphans:
                        _kill(orphan)
                        with suppress(ChildProcessError):
                            # Then its own children become children of this process
                            os.waitpid(orphan, 0)
                with suppress(OSError):
                    self.control.send(json.dumps(message).encode() + b"\n")


def children() -> set[int]:
    """Processes whose parent is this one, as Linux lists them.

    None on other systems, where it adopts no orphans.
    """
    pids = set[int]()
    for task in Path("/proc/self/task").glob("*/stat"):
        pids |= {int(word) for word in (task.parent / "children").read_text().split()}
    return pids


def _kill(pid: int) -> None:
    for kill in (os.killpg, os.kill):
        with suppress(OSError):
            kill(pid, signal.SIGKILL)


def _become(request: dict[str, Any], given: list[int], parent: int) -> NoReturn:
    """The planner's process, or a template of it, after the fork; `parent` is the process that has
    forked.
    """
    code = 1
    try:
        os.setsid()
        # Ends this process when the launcher dies, even if it hangs
        _prctl(PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it died before that
            os._exit(1)
        _prctl(CHILD_SUBREAPER, 1)
        for name in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(name) is signal.SIG_IGN:
                signal.signal(name, signal.SIG_DFL)
        if "load" in request:
            nothing = os.open(os.devnull, os.O_RDWR)
            _at_places(nothing, nothing, nothing)
            _limit(request["memory"])
            planner, settings = request["load"]
            control, before = socket.socket(fileno=given[0]), _descriptors()
            try:
                child.load(planner, bytes.fromhex(settings))
                unfit = _unfit(before)
            except BaseException as error:  # the drive's own process reports it
                unfit = raised(error)
            control.sendall(json.dumps({"unfit": unfit}).encode() + b"\n")
            if not unfit:
                ForkServer(control, seed=True).serve()
        else:
            _at_places(*given)
            _limit(request["memory"])
            if request["argv"] is not None:
                _execute(request["argv"], request["path"])
            child.main()
        code = 0
    except BaseException as error:  # the interpreter of the launcher must not go on in the fork
        sys.stderr.write(f"{type(error).__name__}: {error}\n")
    finally:
        with suppress(Exception):
            sys.stderr.flush()
        os._exit(code)


def _at_places(*given: int) -> None:
    for place, fd in enumerate(given):
        os.dup2(fd, place)
    for fd in set(given):
        os.close(fd)


def _unfit(before: set[int]) -> str:
    """The reason why this process must not be forked for drives; "" if it may be."""
    if _threads() > 1:
        # Libraries that stop their threads for a fork, such as OpenBLAS, have then stopped them
        pid = os.fork()
        if pid == 0:
            os._exit(0)
        os.waitpid(pid, 0)
    if _threads() > 1:
        return "it has threads, which a fork loses"
    if _descriptors() - before:
        return "it holds files or connections open, which its drives would share"
    try:
        os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return ""
    return "it has started processes, which its drives would share"


def _threads() -> int:
    """The number of threads of this process.

    On other systems than Linux, of those that Python knows.
    """
    tasks = Path("/proc/self/task")
    return len(list(tasks.iterdir())) if tasks.is_dir() else threading.active_count()


def _descriptors() -> set[int]:
    numbers = set()
    for place in list(Path("/dev/fd").iterdir()):
        with suppress(OSError):  # the descriptor of the listing itself
            os.fstat(int(place.name))
            numbers.add(int(place.name))
    return numbers


def _execute(argv: list[str], path: str | None) -> NoReturn:
    """Become a program, with the user's PYTHONPATH: ours leads to packages of another Python."""
    os.environ.pop("PYTHONPATH")
    if path is not None:
        os.environ["PYTHONPATH"] = path
    try:
        os.execvp(argv[0], argv)
    except OSError as error:
        sys.stderr.write(f"{argv[0]}: {error.strerror}\n")
        sys.stderr.flush()
        os._exit(127)


def _limit(memory: int) -> None:
    """Bound the memory, write no core file, and be killed first if the system runs out of memory
    (Linux).
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if memory:
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")


def _prctl(option: int, value: int) -> None:
    """Set a property of this process (Linux; elsewhere nothing)."""
    if not sys.platform.startswith("linux"):
        return
    import ctypes

    prctl: Any = ctypes.CDLL(None, use_errno=True).prctl
    prctl(option, value, 0, 0, 0)


if __name__ == "__main__":
    main()
