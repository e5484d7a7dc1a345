"""SIGINT and SIGTERM on the command line: exit code 130 until the end of the command, then ignored.

Users of the library keep their own handlers: nothing changes before `end_at_once` is called. A
signal that the process ignores from its start (`nohup`) stays ignored.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Any

EXIT_CODE = 130
REPEAT_S = 1.0
"""A second signal within this time is part of the first: `timeout` sends one to the process and one
to its group.
"""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_raised_s = float("-inf")


class Interrupted(KeyboardInterrupt):
    """A signal in a command.

    CPython 3.11 ends by SIGINT if KeyboardInterrupt itself leaves `exec` of a string.
    """


def end_at_once() -> None:
    """Let signals end the process with `EXIT_CODE`: no command has begun, so there is nothing to
    clean up.
    """
    for name in _SIGNALS:
        if signal.getsignal(name) is not signal.SIG_IGN:
            signal.signal(name, _end)


@contextmanager
def as_exception() -> Iterator[None]:
    """Raise `Interrupted` for a signal in the body; afterwards, ignore signals: the exit code is
    that of the body.

    Compiled code of a library may turn `Interrupted` into an error of its own: that is an
    interruption, too. Does nothing where `end_at_once` was not called.
    """
    ours, begin = [name for name in _SIGNALS if signal.getsignal(name) is _end], monotonic()
    try:
        for name in ours:
            signal.signal(name, _raise)
        yield
    except Exception as error:
        if _raised_s > begin and not hasattr(error, "exit_code"):  # `typer.Exit`
            raise Interrupted from error
        raise
    finally:
        for name in ours:
            signal.signal(name, signal.SIG_IGN)


def _end(number: int, frame: Any) -> None:
    os.write(2, b"error: interrupted\n")
    os._exit(EXIT_CODE)


def _raise(number: int, frame: Any) -> None:
    global _raised_s
    if monotonic() - _raised_s > REPEAT_S:
        _raised_s = monotonic()
        raise Interrupted
