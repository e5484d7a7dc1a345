"""Output to the terminal: text from logs, planners and messages cannot move the cursor or set a
colour.
"""

from __future__ import annotations

import errno
import io
import os
import sys
import textwrap
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from replan.core.names import VISIBLE

STDERR = 2  # its descriptor
_TABLE = {code: sign for code, sign in VISIBLE.items() if chr(code) not in "\n\t"}
"""`VISIBLE` without line ends and tabs."""


def visible(text: object) -> str:
    """The text with visible characters instead of control characters; line ends and tabs stay."""
    return str(text).translate(_TABLE)


def wrapped(line: str, width: int) -> str:
    """The line, wrapped at spaces to a width, with two more spaces before each further line.

    Words stay whole.
    """
    deeper = " " * (len(line) - len(line.lstrip(" ")) + 2)
    return textwrap.fill(
        line, width, subsequent_indent=deeper, break_long_words=False, break_on_hyphens=False
    )


class SafeConsole(Console):
    """A console that applies only its own styles: texts are made `visible`."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Render as Console does; the control sequences of rich itself are kept."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=visible(segment.text))


class LastingFile(io.FileIO):
    """An open descriptor that discards data after its reader has exited, or after it was closed.

    A full disk is raised once, so that nothing is written again as the process ends.
    """

    def write(self, data: Any, /) -> int:
        """Write as FileIO does, but do not raise EPIPE and EBADF, nor anything on stderr: after an
        error, the descriptor is the null device.
        """
        try:
            return super().write(data)
        except OSError as error:
            descriptor = self.fileno()
            _to_nothing(descriptor)
            if descriptor != STDERR and error.errno not in (errno.EPIPE, errno.EBADF):
                raise
        return memoryview(data).nbytes


def lasting_streams() -> None:
    """Make stdout and stderr safe to write to; characters that the encoding of a terminal lacks
    become "?".

    Standard descriptors that are closed are opened on the null device: otherwise a result file
    could get the number of one, and printed text would be written into it.
    """
    for fd in range(3):
        try:
            os.fstat(fd)
        except OSError:
            _to_nothing(fd)
    for name, fd in (("stdout", 1), ("stderr", STDERR)):
        stream = getattr(sys, name)
        if sys.platform == "win32" and stream is not None:
            stream.reconfigure(errors="replace")
            continue
        with suppress(ValueError, OSError, AttributeError):
            stream.flush()
        raw = LastingFile(fd, "w", closefd=False)
        on_line = fd == STDERR or raw.isatty()
        encoding = getattr(stream, "encoding", None) or "utf-8"
        setattr(
            sys,
            name,
            io.TextIOWrapper(io.BufferedWriter(raw), encoding, "replace", line_buffering=on_line),
        )


def _to_nothing(fd: int) -> None:
    """Open the null device as this descriptor."""
    nothing = os.open(os.devnull, os.O_RDWR)
    if nothing == fd:
        os.set_inheritable(fd, True)
        return
    os.dup2(nothing, fd)
    os.close(nothing)
