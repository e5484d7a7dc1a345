"""A planner in another process, as a loop uses it: frames are sent, plans are received, each within
a time limit.
"""

from __future__ import annotations

import shlex
import shutil
import socket
import threading
import time
import weakref
from collections.abc import Mapping
from typing import Any, Protocol
from urllib.parse import urlsplit

import msgspec

from replan.core.errors import ConfigError, PlannerError
from replan.logs.frame import Frame, PlannerContext
from replan.logs.past import PAST_S
from replan.logs.plan import Plan
from replan.nuplan import PREFIX, nuplan_command
from replan.replay.drive import FIRST, DriveKey, Stopwatch
from replan.replay.loop_config import PlannerProcessConfig
from replan.replay.planner_process import messages
from replan.replay.planner_process.channel import Channel, GarbageError, GoneError, LateError
from replan.replay.planner_process.past_messages import SentPast
from replan.replay.planner_process.planner_config import is_foreign
from replan.replay.planner_process.processes import Load, Process, start_process

LAST_CHARACTERS, LAST_LINES = 300, 3
"""Number of last characters and lines of a planner's output that are shown if it fails."""


class FaultError(Exception):
    """A fault of a planner, in words that follow its name in a sentence."""


class PlannerConnection(Protocol):
    """Sends messages to a planner and receives its answers."""

    def ask(self, message: Any, limit: float, when: str) -> messages.Answer:
        """The answer within `limit` seconds; FaultError, with `when` in its sentence, if there is
        none.
        """
        ...

    def fault(self, what: str) -> FaultError:
        """The error for a wrong answer; a planner that serves only this drive is ended."""
        ...

    def kill(self) -> None:
        """End the planner if it serves only this drive."""
        ...


class CurrentLog(Protocol):
    """A log that is evaluated in a thread of its own, together with others."""

    def connect(
        self, place: DriveKey, limits: PlannerProcessConfig, load: Load, watch: Stopwatch
    ) -> PlannerConnection:
        """The connection of one of its drives to the planner's process that the logs share."""
        ...


_of_thread = threading.local()


def current_log() -> CurrentLog | None:
    """The log that is evaluated in this thread together with others; None if it is evaluated
    alone.
    """
    log: CurrentLog | None = getattr(_of_thread, "log", None)
    return log


def set_current_log(log: CurrentLog) -> None:
    """Evaluate a log in this thread from now on."""
    _of_thread.log = log


class Node:
    """A running planner that is reached over TCP.

    The counterpart of `Process`, without a process to end.
    """

    def __init__(self, spec: str, within_s: float) -> None:
        try:
            link = socket.create_connection(address_of(spec), within_s)
        except OSError as error:
            raise FaultError(f"cannot be reached: {error.strerror or error}") from None
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        fd = link.detach()
        self.channel: Channel[Any] = Channel(fd, fd, messages.Answer)

    def close(self) -> None:
        """Close the connection."""
        self.channel.close()

    kill = close

    def ending(self) -> str:
        """How the planner ended, in words."""
        return "it closed the connection"


def _open(spec: str, limits: PlannerProcessConfig, load: Load | None = None) -> Process | Node:
    """Start the process, or connect to the node; errors as `Connection`."""
    if spec.startswith("tcp:"):
        return Node(spec, limits.start_timeout_s)
    if is_foreign(spec):
        table = msgspec.msgpack.decode(load.settings) if load else {}
        return start_process(_command(spec, table), messages.Answer, limits)
    return start_process(None, messages.Answer, limits, load)


def _command(spec: str, table: Mapping[str, object]) -> list[str]:
    """The command that starts a foreign planner; ConfigError if it cannot be run."""
    if not spec.startswith(PREFIX):
        return command_of(spec)
    command = nuplan_command(spec, table)
    if shutil.which(command[0]) is None:
        raise ConfigError(f"planner '{spec}': there is no interpreter {command[0]} (its python)")
    return command


class Connection:
    """The connection to a planner that is started or reached for one drive, or for a batch of
    drives.

    `spec`: "module:Class", "exec:COMMAND" or "tcp://HOST:PORT". `load`: the module and settings
    that a Python planner loads. `drives`: number of drives that it serves; the time limit of a
    drive is multiplied by it. ConfigError if the command or address is invalid; FaultError if the
    node cannot be reached.
    """

    def __init__(
        self, spec: str, limits: PlannerProcessConfig, load: Load | None = None, drives: int = 1
    ) -> None:
        self._log_timeout_s = limits.log_timeout_s * drives
        self._left = self._log_timeout_s or float("inf")
        self._planner = _open(spec, limits, load)
        self.close = weakref.finalize(self, self._planner.close)
        self.kill = self._planner.kill

    def ask(self, message: Any, limit: float, when: str) -> messages.Answer:
        """See `PlannerConnection.ask`."""
        begin, limited = time.monotonic(), min(limit, self._left)
        try:
            self._planner.channel.send(message, begin + limited)
            answer: messages.Answer = self._planner.channel.receive(begin + limited)
        except LateError:
            if limited < limit:
                raise self.fault(
                    f"took more than {self._log_timeout_s:g} s in this drive, {when}"
                ) from None
            raise self.fault(f"did not answer within {limit:g} s {when}") from None
        except GarbageError as error:
            raise self.fault(f"sent an invalid message {when}: {clean_text(str(error))}") from None
        except GoneError:
            raise self.fault(f"exited {when}: {self._planner.ending()}") from None
        self._left -= time.monotonic() - begin
        return answer

    def fault(self, what: str) -> FaultError:
        """The error, with the last output of the planner; the planner is ended."""
        self._planner.channel.read_printed()
        last = last_words(self._planner.channel.printed)
        self.kill()
        return FaultError(f"{what}; it printed last: {last}" if last else what)


class ApartPlanner:
    """A planner in another process.

    ConfigError if the planner does not take such settings; PlannerError if it cannot be loaded;
    FaultError if it cannot be built.

    Args:
        spec: "module:Class", "exec:COMMAND" or "tcp://HOST:PORT".
        context: The context of the planner; its clock is not used.
        table: The planner's table in the configuration.
        limits: Limits of time and memory.
        watch: Receives the stages of a plan and how long they took, s.
        keep_internals: Whether the internals of its plans are kept.
        place: The key of the drive that it plans.

    Attributes:
        coordinates: Those of its frames and plans: "world" or "map".
    """

    def __init__(
        self,
        spec: str,
        context: PlannerContext,
        table: Mapping[str, object],
        limits: PlannerProcessConfig,
        watch: Stopwatch,
        *,
        keep_internals: bool,
        place: DriveKey = FIRST,
    ) -> None:
        self._limits, self._watch, self._has_planned = limits, watch, False
        config = {key: value for key, value in table.items() if value is not None}
        try:
            load = Load(spec, msgspec.msgpack.encode(config), place.again)
        except TypeError as error:
            raise ConfigError(f"planner '{spec}': its settings cannot be sent: {error}") from None
        log, version = current_log() if limits.batch else None, messages.SCHEMA_VERSION
        self._connection: PlannerConnection = (
            Connection(spec, limits, load)
            if log is None
            else log.connect(place, limits, load, watch)
        )
        hello = messages.Hello(
            version, spec, config, messages.context_message(context), keep_internals
        )
        answer = self._connection.ask(hello, limits.start_timeout_s, "while it was built")
        if isinstance(answer, messages.Failed):
            raise self._failure(answer, "cannot be built")
        if not isinstance(answer, messages.Ready):
            raise self._connection.fault("cannot be built: it did not answer hello with ready")
        if answer.schema != version:
            problem = f"it speaks version {answer.schema} of the messages, replan {version}"
            raise self._connection.fault(f"cannot be built: {problem}")
        if not 0.0 <= answer.past_s <= PAST_S:
            problem = f"it asks for a past of {answer.past_s:g} s: at most {PAST_S:g} s"
            raise self._connection.fault(f"cannot be built: {problem}")
        self.coordinates, self._sent_past = answer.coordinates, SentPast(answer.past_s)

    def plan(self, frame: Frame) -> Plan:
        """The planner's plan; FaultError if it sends none."""
        limit = self._limits.plan_timeout_s
        if not self._has_planned:
            limit, self._has_planned = max(limit, self._limits.start_timeout_s), True
        begin = time.monotonic()
        answer = self._connection.ask(
            self._sent_past.message(frame), limit, f"at t = {frame.t:.2f} s"
        )
        broken = f"broke its contract at {frame.t:.2f} s"
        if isinstance(answer, messages.Failed):
            raise self._failure(
                answer, broken if answer.what == "contract" else f"raised at {frame.t:.2f} s"
            )
        if not isinstance(answer, messages.Plan):
            raise self._connection.fault(f"{broken}: it did not answer a frame with a plan")
        try:
            plan = messages.plan_of(answer)
        except (ValueError, KeyError) as error:
            raise self._connection.fault(f"{broken}: {clean_text(str(error))}") from None
        if time.monotonic() - begin > limit:
            raise self._connection.fault(
                f"needed more than {limit:g} s, reading of its plan included, at t = {frame.t:.2f} "
                "s"
            )
        for stage, seconds in answer.laps.items():
            self._watch.took(stage, seconds)
        return plan

    def _failure(self, answer: messages.Failed, how: str) -> Exception:
        """The error for a failure that the planner reports; the planner is ended."""
        self._connection.kill()
        message = clean_text(answer.message)
        errors: dict[str, Exception] = {
            "config": ConfigError(message),
            "load": PlannerError(message),
        }
        return errors.get(answer.what, FaultError(f"{how}: {message}"))


def describe_planner(
    spec: str, table: Mapping[str, object], limits: PlannerProcessConfig
) -> dict[str, Any]:
    """The planner's table with all defaults; unchanged for programs and nodes, whose defaults are
    unknown.

    ConfigError if a key is unknown, a value has the wrong type, the command or address is invalid;
    PlannerError if the planner cannot be loaded.
    """
    if is_foreign(spec):
        if spec.startswith("tcp:"):
            address_of(spec)
        else:
            _command(spec, table)
        if limits.batch:
            raise ConfigError(f"planner '{spec}' has no plan_batch: leave out loop.apart.batch")
        return dict(table)
    process = _open(spec, limits)
    config = {key: value for key, value in table.items() if value is not None}
    try:
        process.channel.send(
            messages.Describe(spec, config, limits.batch > 0),
            time.monotonic() + limits.start_timeout_s,
        )
        answer = process.channel.receive(time.monotonic() + limits.start_timeout_s)
    except LateError:
        process.kill()
        raise PlannerError(
            f"planner '{spec}': loading it took more than {limits.start_timeout_s:g} s"
        ) from None
    except (GoneError, GarbageError):
        ending = process.ending()
        last = last_words(process.channel.printed)
        process.kill()
        raise PlannerError(
            f"planner '{spec}' ended while it was loaded: {ending}; it printed last: {last}"
        ) from None
    process.close()
    if isinstance(answer, messages.Described):
        return answer.config
    message = clean_text(
        answer.message if isinstance(answer, messages.Failed) else "it does not answer"
    )
    if isinstance(answer, messages.Failed) and answer.what == "config":
        raise ConfigError(message)
    raise PlannerError(message if message.startswith("planner") else f"planner '{spec}': {message}")


def command_of(spec: str) -> list[str]:
    """The words of "exec:COMMAND", split as a shell would split them; ConfigError if there is no
    such program.
    """
    try:
        words = shlex.split(spec.removeprefix("exec:"))
    except ValueError as error:
        raise ConfigError(f"planner '{spec}': {error}") from None
    if not words or shutil.which(words[0]) is None:
        raise ConfigError(
            f"planner '{spec}': there is no program {words[0] if words else ''} that can be run"
        )
    return words


def address_of(spec: str) -> tuple[str, int]:
    """Host and port of "tcp://HOST:PORT"; ConfigError if they are missing."""
    try:
        parts = urlsplit(spec)
        if parts.scheme == "tcp" and parts.hostname and parts.port:
            return parts.hostname, parts.port
    except ValueError:
        pass
    raise ConfigError(
        f"planner '{spec}': write it as tcp://HOST:PORT, for example tcp://127.0.0.1:7000"
    )


def last_words(printed: bytes) -> str:
    """The end of the output, in one clean line."""
    lines = [line for line in printed.decode("utf-8", "replace").splitlines() if line.strip()]
    return clean_text(" | ".join(line.strip() for line in lines[-LAST_LINES:]))[-LAST_CHARACTERS:]


def clean_text(text: str) -> str:
    """A planner's text for messages of replan: one line of limited length, without control
    characters.
    """
    return "".join(
        character if character.isprintable() else "?"
        for character in " ".join(messages.shortened(text).split())
    )
