"""The planner that a loop sees where the real one is kept apart: frames go out, plans come back, in time or never."""

from __future__ import annotations

import shlex
import shutil
import socket
import time
import weakref
from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import urlsplit

import msgspec

from logs.errors import ConfigError, PlannerError
from logs.frame import Frame, PlannerContext
from logs.trace import Plan
from replay.apart import schema
from replay.apart.channel import Channel, GarbageError, GoneError, LateError
from replay.apart.convert import context_message, frame_message, plan_of
from replay.apart.processes import Load, Process, started
from replay.drive import ApartConfig

LAST_CHARACTERS, LAST_LINES = 300, 3
"""So much of what it printed last is shown of a planner that has failed."""


class FaultError(Exception):
    """What a planner did wrong, as it follows its name in a sentence."""


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


class ApartPlanner:
    """A planner in another process.

    Args:
        spec: "module:Class", "exec:COMMAND" or "tcp://HOST:PORT".
        context: As every planner's; its clock is not used.
        table: The planner's table in the configuration.
        limits: What it may take.
        took: Is given the stages of a plan and how long they took, s.
        keep_internals: Whether the inside of its plans is kept.
        again: As in `Load`.

    Raises:
        ConfigError: The planner does not take such settings.
        PlannerError: It cannot be loaded.
        FaultError: It cannot be built.
    """

    def __init__(
        self,
        spec: str,
        context: PlannerContext,
        table: Mapping[str, object],
        limits: ApartConfig,
        took: Callable[[str, float], None],
        *,
        keep_internals: bool,
        again: bool = False,
    ) -> None:
        self._limits, self._took, self._made = limits, took, 0
        self._left = limits.log_timeout_s or float("inf")
        config = {key: value for key, value in table.items() if value is not None}
        try:
            load = Load(spec, msgspec.msgpack.encode(config), again)
        except TypeError as error:
            raise ConfigError(f"planner '{spec}': its settings cannot be sent: {error}") from None
        self._to = _opened(spec, limits, load)
        self._end = weakref.finalize(self, self._to.close)
        hello = schema.Hello(schema.SCHEMA_VERSION, spec, config, context_message(context), keep_internals)
        answer = self._asked(hello, limits.start_timeout_s, "while it was built")
        if isinstance(answer, schema.Failed):
            self._failed(answer, "cannot be built")
        if not isinstance(answer, schema.Ready):
            raise self._fault("cannot be built: it did not answer hello with ready")
        if answer.schema != schema.SCHEMA_VERSION:
            raise self._fault(
                f"cannot be built: it speaks version {answer.schema} of the messages, replan {schema.SCHEMA_VERSION}"
            )

    def plan(self, frame: Frame) -> Plan:
        """The planner's plan; FaultError where none comes."""
        limit = self._limits.plan_timeout_s
        limit = limit if self._made else max(limit, self._limits.start_timeout_s)
        self._made += 1
        answer = self._asked(frame_message(frame), limit, f"at t = {frame.t:.2f} s")
        if isinstance(answer, schema.Failed):
            how = "broke its contract" if answer.what == "contract" else "raised"
            self._failed(answer, f"{how} at {frame.t:.2f} s")
        if not isinstance(answer, schema.Plan):
            raise self._fault(f"broke its contract at {frame.t:.2f} s: it did not answer a frame with a plan")
        for stage, seconds in answer.laps.items():
            self._took(stage, seconds)
        try:
            return plan_of(answer)
        except (ValueError, KeyError) as error:
            raise self._fault(f"broke its contract at {frame.t:.2f} s: {clean(str(error))}") from None

    def _asked(self, message: Any, limit: float, when: str) -> schema.Answer:
        """The answer within a limit; Fault says why there is none."""
        begin, limited = time.monotonic(), min(limit, self._left)
        try:
            self._to.channel.send(message, begin + limited)
            answer: schema.Answer = self._to.channel.receive(begin + limited)
        except LateError:
            if limited < limit:
                raise self._fault(f"took more than {self._limits.log_timeout_s:g} s in this drive, {when}") from None
            raise self._fault(f"did not answer within {limit:g} s {when}") from None
        except GarbageError as error:
            raise self._fault(f"sent what is no message {when}: {clean(str(error))}") from None
        except GoneError:
            raise self._fault(f"has gone {when}: {self._to.ending()}") from None
        self._left -= time.monotonic() - begin
        return answer

    def _failed(self, answer: schema.Failed, how: str) -> None:
        """Raise what a planner says of itself."""
        self._to.kill()
        if answer.what in ("config", "load"):
            raise (ConfigError if answer.what == "config" else PlannerError)(clean(answer.message))
        raise FaultError(f"{how}: {clean(answer.message)}")

    def _fault(self, what: str) -> FaultError:
        """The fault, with what the planner printed last; its process is ended."""
        self._to.channel.listen()
        last = last_words(self._to.channel.said)
        self._to.kill()
        return FaultError(f"{what}; it printed last: {last}" if last else what)


def described(spec: str, table: Mapping[str, object], limits: ApartConfig) -> dict[str, Any]:
    """The planner's table with every default spelled out, as far as it can be known.

    Raises:
        ConfigError: A key is unknown, a value of the wrong type, the command or address is none.
        PlannerError: It cannot be loaded.
    """
    if spec.startswith("exec:"):
        command_of(spec)
        return dict(table)
    if spec.startswith("tcp:"):
        address_of(spec)
        return dict(table)
    process = _opened(spec, limits)
    config = {key: value for key, value in table.items() if value is not None}
    try:
        process.channel.send(schema.Describe(spec, config), time.monotonic() + limits.start_timeout_s)
        answer = process.channel.receive(time.monotonic() + limits.start_timeout_s)
    except LateError:
        process.kill()
        raise PlannerError(f"planner '{spec}': loading it took more than {limits.start_timeout_s:g} s") from None
    except (GoneError, GarbageError):
        ending = process.ending()
        last = last_words(process.channel.said)
        process.kill()
        raise PlannerError(f"planner '{spec}' ended while it was loaded: {ending}; it printed last: {last}") from None
    process.close()
    if isinstance(answer, schema.Described):
        return answer.config
    message = clean(answer.message if isinstance(answer, schema.Failed) else "it does not answer")
    if isinstance(answer, schema.Failed) and answer.what == "config":
        raise ConfigError(message)
    raise PlannerError(message if message.startswith("planner") else f"planner '{spec}': {message}")


def _opened(spec: str, limits: ApartConfig, load: Load | None = None) -> Process | Node:
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
    """Text of a planner's for our messages: in one line, without control characters."""
    return "".join(each if each.isprintable() else "?" for each in " ".join(text.split()))
