"""A small process, warm and without secrets, from which the planners' processes are forked.

    python -P -m replay.apart.launcher      its control socket is its stdin; replan starts it (`replay.apart.processes`)

It has imported what every Python planner needs, and never holds a frame, so that a process for a drive costs
milliseconds and knows nothing of the drives before. On the control socket, JSON by the line:

    {"start": KEY, "argv": [...] or null, "memory": bytes or 0}    with three descriptors: stdin, stdout, stderr of it
    {"kill": KEY}                                    the process and its group
    {"ended": KEY, "status": wait status}            what comes back, once for each that was started

`argv` null is a Python planner (`replay.apart.child`), else a program. Where the control socket closes, all are killed.
"""

from __future__ import annotations

import gc
import json
import os
import resource
import select
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, NoReturn

from replay.apart import child

PDEATHSIG = 1
"""`prctl`: which signal comes when the parent has died (Linux)."""


def main() -> None:
    """Serve until the control socket closes."""
    control = socket.socket(fileno=os.dup(0))
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, signal.SIG_IGN)  # they are for replan: it ends this
    wake, waker = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC) if hasattr(os, "pipe2") else os.pipe()
    os.set_blocking(waker, False)
    signal.set_wakeup_fd(waker, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    child.warm()
    gc.collect()
    gc.freeze()
    live: dict[int, int] = {}
    asked, given = b"", list[int]()
    while True:
        ready, _, _ = select.select([control.fileno(), wake], [], [])
        if wake in ready:
            os.read(wake, 4096)
            _reap(control, live)
        if control.fileno() not in ready:
            continue
        try:
            data, came, _, _ = socket.recv_fds(control, 1 << 16, 3)
        except ConnectionError:
            data, came = b"", []
        if not data:
            break
        *lines, asked = (asked + data).split(b"\n")
        given += came
        for line in lines:
            _serve(json.loads(line), given, live, (control.fileno(), wake, waker))
    for pid in live:
        _kill(pid)


def _serve(asked: dict[str, Any], given: list[int], live: dict[int, int], ours: tuple[int, ...]) -> None:
    """One request; a start takes its descriptors from `given`."""
    if "kill" in asked:
        for pid in [pid for pid, key in live.items() if key == asked["kill"]]:
            _kill(pid)
        return
    taken = [given.pop(0) for _ in range(3)]
    pid = os.fork()
    if pid == 0:
        for fd in (*ours, *given):
            os.close(fd)
        _become(asked["argv"], asked["memory"], taken)
    live[pid] = asked["start"]
    for fd in taken:
        os.close(fd)


def _reap(control: socket.socket, live: dict[int, int]) -> None:
    for pid in list(live):
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            with suppress(OSError):
                os.killpg(pid, signal.SIGKILL)  # what it started goes with it
            with suppress(OSError):
                control.send(json.dumps({"ended": live.pop(pid), "status": status}).encode() + b"\n")


def _kill(pid: int) -> None:
    for kill in (os.killpg, os.kill):
        with suppress(OSError):
            kill(pid, signal.SIGKILL)


def _become(argv: list[str] | None, memory: int, given: list[int]) -> NoReturn:
    """The planner's process, after the fork."""
    code = 1
    try:
        os.setsid()
        _end_with_parent()
        signal.set_wakeup_fd(-1)
        for name in (signal.SIGCHLD, signal.SIGINT, signal.SIGTERM):
            signal.signal(name, signal.SIG_DFL)
        for fd, place in zip(given, (0, 1, 2), strict=True):
            os.dup2(fd, place)
            os.close(fd)
        _limit(memory)
        if argv is not None:
            _execute(argv)
        child.main()
        code = 0
    except BaseException as error:  # the interpreter of the launcher must not go on in the fork
        sys.stderr.write(f"{type(error).__name__}: {error}\n")
    finally:
        with suppress(Exception):
            sys.stderr.flush()
        os._exit(code)


def _execute(argv: list[str]) -> NoReturn:
    try:
        os.execvp(argv[0], argv)
    except OSError as error:
        sys.stderr.write(f"{argv[0]}: {error.strerror}\n")
        sys.stderr.flush()
        os._exit(127)


def _limit(memory: int) -> None:
    """Bound the memory, write no core file, and be the first to go where the system runs out of memory (Linux)."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if memory:
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000", encoding="ascii")


def _end_with_parent() -> None:
    """A launcher that has died takes this process along, even if it hangs (Linux; elsewhere the closed stdin does)."""
    if not sys.platform.startswith("linux"):
        return
    import ctypes

    prctl: Any = ctypes.CDLL(None, use_errno=True).prctl
    prctl(PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() == 1:
        os._exit(1)


if __name__ == "__main__":
    main()
