"""The way to a planner in another process: a message goes out, an answer comes back, in time or never."""

from __future__ import annotations

import shlex
import shutil
import socket
import time
import weakref
from typing import Any
from urllib.parse import urlsplit

from logs.errors import ConfigError
from replay.config import PlannerProcessConfig
from replay.planner_process import schema
from replay.planner_process.channel import Channel, GarbageError, GoneError, LateError
from replay.planner_process.plan_limits import shortened
from replay.planner_process.processes import Load, Process, started

LAST_CHARACTERS, LAST_LINES = 300, 3
"""So much of what it printed last is shown of a planner that has failed."""


class FaultError(Exception):
    """What a planner did wrong, as it follows its name in a sentence."""


class Link:
    """A planner that was started or reached for one drive, or for those of several logs in lock step.

    Args:
        spec: "module:Class", "exec:COMMAND" or "tcp://HOST:PORT".
        limits: What it may take.
        load: What a Python planner loads.
        drives: How many there are: so often has it the time of one.

    Raises:
        ConfigError: The command or address is none.
        FaultError: It cannot be reached.
    """

    def __init__(self, spec: str, limits: PlannerProcessConfig, load: Load | None = None, drives: int = 1) -> None:
        self._limits, self._drives = limits, drives
        self._left = limits.log_timeout_s * drives or float("inf")
        self._to = opened(spec, limits, load)
        self.close = weakref.finalize(self, self._to.close)

    def ask(self, message: Any, limit: float, when: str) -> schema.Answer:
        """The answer within a limit; FaultError says why there is none."""
        begin, limited = time.monotonic(), min(limit, self._left)
        try:
            self._to.channel.send(message, begin + limited)
            answer: schema.Answer = self._to.channel.receive(begin + limited)
        except LateError:
            if limited < limit:
                most = self._limits.log_timeout_s * self._drives
                raise self.fault(f"took more than {most:g} s in this drive, {when}") from None
            raise self.fault(f"did not answer within {limit:g} s {when}") from None
        except GarbageError as error:
            raise self.fault(f"sent what is no message {when}: {clean(str(error))}") from None
        except GoneError:
            raise self.fault(f"has gone {when}: {self._to.ending()}") from None
        self._left -= time.monotonic() - begin
        return answer

    def fault(self, what: str) -> FaultError:
        """The fault, with what the planner printed last; its process is ended."""
        self._to.channel.listen()
        last = last_words(self._to.channel.said)
        self._to.kill()
        return FaultError(f"{what}; it printed last: {last}" if last else what)

    def kill(self) -> None:
        """End it."""
        self._to.kill()


class Node:
    """A planner that runs already, reached over TCP; `Process` for what is ours to end."""

    def __init__(self, spec: str, within_s: float) -> None:
        host, port = address_of(spec)
        try:
            link = socket.create_connection((host, port), within_s)
        except OSError as error:
            raise FaultError(f"cannot be reached: {error.strerror or error}") from None
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        fd = link.detach()
        self.channel: Channel[Any] = Channel(fd, fd, schema.Answer)

    def close(self) -> None:
        """The drive is over."""
        self.channel.close()

    kill = close

    def ending(self) -> str:
        """How it ended."""
        return "it closed the connection"


def opened(spec: str, limits: PlannerProcessConfig, load: Load | None = None) -> Process | Node:
    """The process, started, or the node, reached; errors as `Link`."""
    if spec.startswith("tcp:"):
        return Node(spec, limits.start_timeout_s)
    if spec.startswith("exec:"):
        return started(command_of(spec), schema.Answer, limits)
    return started(None, schema.Answer, limits, load)


def command_of(spec: str) -> list[str]:
    """The words of "exec:COMMAND", as a shell would split them; no shell sees them. ConfigError where it is none."""
    try:
        words = shlex.split(spec.removeprefix("exec:"))
    except ValueError as error:
        raise ConfigError(f"planner '{spec}': {error}") from None
    if not words or shutil.which(words[0]) is None:
        raise ConfigError(f"planner '{spec}': there is no program {words[0] if words else ''} that can be run")
    return words


def address_of(spec: str) -> tuple[str, int]:
    """Host and port of "tcp://HOST:PORT"; ConfigError where it is none."""
    try:
        parts = urlsplit(spec)
        if parts.scheme == "tcp" and parts.hostname and parts.port:
            return parts.hostname, parts.port
    except ValueError:
        pass
    raise ConfigError(f"planner '{spec}': write it as tcp://HOST:PORT, for example tcp://127.0.0.1:7000")


def last_words(printed: bytes) -> str:
    """The end of what was printed, in one clean line."""
    lines = [line for line in printed.decode("utf-8", "replace").splitlines() if line.strip()]
    return clean(" | ".join(line.strip() for line in lines[-LAST_LINES:]))[-LAST_CHARACTERS:]


def clean(text: str) -> str:
    """Text of a planner's for our messages: in one line of limited length, without control characters."""
    return "".join(each if each.isprintable() else "?" for each in " ".join(shortened(text).split()))
