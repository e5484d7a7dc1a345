"""Tasks of worker processes, which import them by this module's name."""

import signal
import time
from pathlib import Path


def count_files(path: Path) -> None:
    """Write how many files there were before."""
    path.write_text(str(len(list(path.parent.iterdir()))))


def wait_for_beside(path: Path) -> None:
    """Wait for the work beside it, at most some seconds."""
    for _ in range(100 if path.name == "first" else 0):
        if (path.parent / "beside").exists():
            return
        time.sleep(0.05)


def touch(path: Path) -> None:
    """Make an empty file."""
    path.touch()


def square_of(number: int) -> int:
    """The square; 13 kills its worker."""
    if number == 13:
        signal.raise_signal(signal.SIGKILL)
    return number * number
