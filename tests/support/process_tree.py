"""Processes of this machine that tests have started, and what comes of them."""

import os
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


def started(*words: object, cwd: Path, **more: Any) -> subprocess.Popen[str]:
    """`replan WORDS` in a session of its own, with the code and the Python path of the tests;
    `more` is of Popen.
    """
    return subprocess.Popen(
        [sys.executable, "-m", "replan", *map(str, words)],
        cwd=cwd,
        text=True,
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        **more,
    )


def descendants(pid: int) -> set[int]:
    """All that come of a process, zombies too (Linux)."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
        except (OSError, IndexError):
            continue
    found = {pid}
    while more := {child for child, parent in parents.items() if parent in found} - found:
        found |= more
    return found - {pid}


def exists(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def are_gone(pids: Iterable[int | str], within_s: float = 10.0) -> bool:
    """Whether none of these processes exists any more, after a while at most."""
    left, until = list(map(int, pids)), time.monotonic() + within_s
    while any(map(exists, left)) and time.monotonic() < until:
        time.sleep(0.02)
    return not any(map(exists, left))
