"""A planner in another process, as a loop uses it: frames are sent, plans are received, each within
a time limit.

With `loop.apart.batch`, several logs are in lock step: the frames of one step are sent to one
planner's process together. Each log is evaluated in a thread. One thread runs at a time, until its
drive sends a request to the planner; then the next one runs. So code that drives, measures or
writes needs no locks, and the results depend on no clock. When all logs wait, their requests are
answered: first the frames of the current drive (one planner, one loop, the same step in each log).
If no log waits for a plan, the first of the drives for which logs wait begins.
"""

from __future__ import annotations

import shlex
import shutil
import socket
import threading
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextvars import copy_context
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar
from urllib.parse import urlsplit

import msgspec

from replan.core.errors import ConfigError, PlannerError
from replan.logs.frame import Frame, PlannerContext
from replan.logs.past import PAST_S
from replan.logs.plan import Plan
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
    return start_process(
        command_of(spec) if spec.startswith("exec:") else None, messages.Answer, limits, load
    )


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
        (command_of if spec.startswith("exec:") else address_of)(spec)
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


R = TypeVar("R")


class AbandonedError(BaseException):
    """The run ended before this log; raised in the thread of the log to end it."""


@dataclass(frozen=True, eq=False)
class Request:
    """A request of the drive of a log."""

    place: DriveKey
    message: Any  # `schema.Hello` at its begin, or `schema.Frame`
    limit: float  # Time limit of the answer, s
    limits: PlannerProcessConfig
    load: Load


class BatchLog(Generic[R]):
    """A log that is evaluated in a thread, which runs while `run_on` waits for it."""

    request: Request  # The request that it waits for
    answer: messages.Answer | FaultError
    result: R

    def __init__(self, task: Callable[[], R]) -> None:
        # Whether its evaluation has returned; duration of the answer, s
        self.ended, self.took_s = False, 0.0
        self._task, self._raised, self._abandoned = task, list[BaseException](), False
        self._go, self._back = threading.Semaphore(0), threading.Semaphore(0)
        self._thread = threading.Thread(target=copy_context().run, args=(self._run,), daemon=True)

    def run_on(self) -> None:
        """Run until the log sends a request or has ended.

        Exceptions of its evaluation are raised here.
        """
        if self._thread.ident is None:
            self._thread.start()
        else:
            self._go.release()
        self._back.acquire()
        if self._raised:
            raise self._raised[0]

    def ask(self, request: Request) -> messages.Answer | FaultError:
        """Wait until all logs wait, and return the answer; called in the log's thread."""
        self.request = request
        self._back.release()
        self._go.acquire()
        if self._abandoned:
            raise AbandonedError
        return self.answer

    def connect(
        self, place: DriveKey, limits: PlannerProcessConfig, load: Load, watch: Stopwatch
    ) -> PlannerConnection:
        """The connection of one of the log's drives; `watch` does not count the time that other
        logs take.
        """

        def ask(message: Any, limit: float) -> messages.Answer:
            begin = time.perf_counter()
            answer = self.ask(Request(place, message, limit, limits, load))
            watch.waited(time.perf_counter() - begin - self.took_s)
            if isinstance(answer, FaultError):
                raise FaultError(str(answer))
            return answer

        return BatchConnection(ask)

    def abandon(self) -> None:
        """End the evaluation; its cleanup code runs."""
        self._abandoned = True
        if self._thread.is_alive():
            self._go.release()
            self._thread.join()

    def _run(self) -> None:
        set_current_log(self)
        try:
            self.result = self._task()
        except BaseException as error:
            self._raised.append(error)
        self.ended = True
        self._back.release()


@dataclass(frozen=True, eq=False)
class BatchConnection:
    """The `PlannerConnection` of a drive to a process that it shares: a fault of this drive does
    not end the others.
    """

    answer: Callable[[Any, float], messages.Answer]

    def ask(self, message: Any, limit: float, when: str) -> messages.Answer:
        """See `PlannerConnection.ask`.

        The step takes the place of `when`, as the logs have different times.
        """
        return self.answer(message, limit)

    def fault(self, what: str) -> FaultError:
        """The error; the process continues."""
        return FaultError(what)

    def kill(self) -> None:
        """Do nothing: the process continues."""


class BatchSession:
    """The planner's process for the drives of some logs.

    `logs`: the logs that wait for the begin of their drive.
    """

    def __init__(self, logs: Sequence[BatchLog[Any]]) -> None:
        first = logs[0].request
        self._connection = Connection(first.load.planner, first.limits, first.load, len(logs))
        self._seats, self._steps = {log: seat for seat, log in enumerate(logs)}, 0
        self._together = f"for {len(logs)} logs together"
        hellos = messages.Hellos([log.request.message for log in logs])
        self._answer(logs, hellos, f"while it was built {self._together}")

    def plan(self, logs: Sequence[BatchLog[Any]]) -> None:
        """Answer the frames of logs."""
        self._steps += 1
        frames = messages.Frames(
            [self._seats[log] for log in logs], [log.request.message for log in logs]
        )
        self._answer(logs, frames, f"in step {self._steps} of drives {self._together}")

    def _answer(self, logs: Sequence[BatchLog[Any]], message: Any, when: str) -> None:
        """Send a message for all these logs, and give each its answer.

        If it fails, all get the failure.
        """
        begin = time.perf_counter()
        answer: messages.Answer | FaultError
        try:
            answer = self._connection.ask(message, sum(log.request.limit for log in logs), when)
            if not isinstance(answer, messages.Failed) and len(getattr(answer, "each", ())) != len(
                logs
            ):
                raise self._connection.fault(
                    f"broke its contract {when}: it did not answer every frame"
                )
        except FaultError as fault:
            answer = fault
        answers = answer.each if isinstance(answer, messages.Answers) else [answer] * len(logs)
        for log, answer_of_log in zip(logs, answers, strict=True):
            log.answer, log.took_s = answer_of_log, time.perf_counter() - begin

    def close(self) -> None:
        """End the drives."""
        self._connection.close()


def in_lockstep(tasks: Sequence[Callable[[], R]]) -> list[R]:
    """Run tasks that each evaluate a log, and return their results.

    Shared planners plan for all of them.
    """
    logs = [BatchLog(task) for task in tasks]
    session: BatchSession | None = None
    try:
        for log in logs:
            log.run_on()
        while waiting := [log for log in logs if not log.ended]:
            team = [log for log in waiting if isinstance(log.request.message, messages.Frame)]
            if session is not None and team:
                session.plan(team)
            else:
                if session is not None:
                    session.close()
                first = min(log.request.place for log in waiting)
                team = [log for log in waiting if log.request.place == first]
                session = BatchSession(team)
            for log in team:
                log.run_on()
    finally:
        if session is not None:
            session.close()
        for log in logs:
            log.abandon()
    return [log.result for log in logs]
