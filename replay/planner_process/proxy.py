"""The planner that a loop sees where the real one is kept apart: frames go out, plans come back, in time or never."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, Protocol

import msgspec

from logs.errors import ConfigError, PlannerError
from logs.frame import Frame, PlannerContext
from logs.trace import Plan
from replay.config import PlannerProcessConfig
from replay.drive import FIRST, DriveKey
from replay.planner_process import schema
from replay.planner_process.channel import GarbageError, GoneError, LateError
from replay.planner_process.convert import context_message, frame_message, plan_of
from replay.planner_process.link import FaultError, Link, address_of, clean, command_of, last_words, opened
from replay.planner_process.planner_config import is_foreign
from replay.planner_process.processes import Load
from replay.planner_process.stopwatch import Stopwatch
from replay.planner_process.together import Shared, log_here


class Asked(Protocol):
    """What answers: a process of the drive's own, or one that it shares."""

    def ask(self, message: Any, limit: float, when: str) -> schema.Answer:
        """See `Link.ask`."""
        ...

    def fault(self, what: str) -> FaultError:
        """See `Link.fault`."""
        ...

    def kill(self) -> None:
        """See `Link.kill`."""
        ...


class ApartPlanner:
    """A planner in another process.

    Args:
        spec: "module:Class", "exec:COMMAND" or "tcp://HOST:PORT".
        context: As every planner's; its clock is not used.
        table: The planner's table in the configuration.
        limits: What it may take.
        watch: Is given the stages of a plan and how long they took, s.
        keep_internals: Whether the inside of its plans is kept.
        place: Which of the log's drives it is.

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
        limits: PlannerProcessConfig,
        watch: Stopwatch,
        *,
        keep_internals: bool,
        place: DriveKey = FIRST,
    ) -> None:
        self._limits, self._watch, self._made = limits, watch, 0
        config = {key: value for key, value in table.items() if value is not None}
        try:
            load = Load(spec, msgspec.msgpack.encode(config), place.again)
        except TypeError as error:
            raise ConfigError(f"planner '{spec}': its settings cannot be sent: {error}") from None
        log = log_here() if limits.batch else None
        self._link: Asked = Link(spec, limits, load) if log is None else Shared(log, place, limits, load, watch)
        hello = schema.Hello(schema.SCHEMA_VERSION, spec, config, context_message(context), keep_internals)
        answer = self._link.ask(hello, limits.start_timeout_s, "while it was built")
        if isinstance(answer, schema.Failed):
            self._failed(answer, "cannot be built")
        if not isinstance(answer, schema.Ready):
            raise self._link.fault("cannot be built: it did not answer hello with ready")
        if answer.schema != schema.SCHEMA_VERSION:
            raise self._link.fault(
                f"cannot be built: it speaks version {answer.schema} of the messages, replan {schema.SCHEMA_VERSION}"
            )

    def plan(self, frame: Frame) -> Plan:
        """The planner's plan; FaultError where none comes."""
        limit = self._limits.plan_timeout_s
        limit = limit if self._made else max(limit, self._limits.start_timeout_s)
        self._made += 1
        answer = self._link.ask(frame_message(frame), limit, f"at t = {frame.t:.2f} s")
        if isinstance(answer, schema.Failed):
            how = "broke its contract" if answer.what == "contract" else "raised"
            self._failed(answer, f"{how} at {frame.t:.2f} s")
        if not isinstance(answer, schema.Plan):
            raise self._link.fault(f"broke its contract at {frame.t:.2f} s: it did not answer a frame with a plan")
        try:
            plan = plan_of(answer)
        except (ValueError, KeyError) as error:
            raise self._link.fault(f"broke its contract at {frame.t:.2f} s: {clean(str(error))}") from None
        for stage, seconds in answer.laps.items():
            self._watch.took(stage, seconds)
        return plan

    def _failed(self, answer: schema.Failed, how: str) -> None:
        """Raise what a planner says of itself."""
        self._link.kill()
        if answer.what in ("config", "load"):
            raise (ConfigError if answer.what == "config" else PlannerError)(clean(answer.message))
        raise FaultError(f"{how}: {clean(answer.message)}")


def described(spec: str, table: Mapping[str, object], limits: PlannerProcessConfig) -> dict[str, Any]:
    """The planner's table with every default spelled out, as far as it can be known.

    Raises:
        ConfigError: A key is unknown, a value of the wrong type, the command or address is none.
        PlannerError: It cannot be loaded.
    """
    if is_foreign(spec):
        (command_of if spec.startswith("exec:") else address_of)(spec)
        if limits.batch:
            raise ConfigError(
                f"planner '{spec}' has no plan_batch, as a Python planner may have: leave out loop.apart.batch"
            )
        return dict(table)
    process = opened(spec, limits)
    config = {key: value for key, value in table.items() if value is not None}
    try:
        process.channel.send(schema.Describe(spec, config, limits.batch > 0), time.monotonic() + limits.start_timeout_s)
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
