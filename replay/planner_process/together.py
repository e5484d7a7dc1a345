"""Several logs in lock step: the frames of one step go to one planner's process together (`loop.apart.batch`).

Each log is evaluated in a thread, of which one runs at a time: it runs until it asks a planner, and then the next one
does. So nothing that drives, measures or writes has to know of threads, and what happens depends on no clock. When all
have asked, they are answered: first the frames, of the drive that is on (one planner, one loop; each log has made as
many steps); where none asks for a plan any more, the drive begins that comes first of those that they wait for.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextvars import copy_context
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from replay.config import PlannerProcessConfig
from replay.drive import DriveKey
from replay.planner_process import schema
from replay.planner_process.link import FaultError, Link
from replay.planner_process.processes import Load
from replay.planner_process.stopwatch import Stopwatch

R = TypeVar("R")

_of_thread = threading.local()
"""`log`: that which is evaluated in this thread."""


class AbandonedError(BaseException):
    """The run has ended before this log has: its thread unwinds."""


@dataclass(frozen=True, eq=False)
class Ask:
    """What the drive of a log asks.

    Attributes:
        place: Which drive.
        message: `schema.Hello`, where it begins, or `schema.Frame`.
        limit: How long the answer may take, s.
        limits: Of the planner's process.
        load: What it loads.
    """

    place: DriveKey
    message: Any
    limit: float
    limits: PlannerProcessConfig
    load: Load


class Log(Generic[R]):
    """A log that is evaluated in a thread, which runs while `go_on` waits for it.

    Attributes:
        asked: What it waits for.
        answer: What it is answered, or the planner's fault.
        took_s: How long that took, s.
        ended: Whether it has returned.
        result: What.
    """

    asked: Ask
    answer: schema.Answer | FaultError
    result: R

    def __init__(self, task: Callable[[], R]) -> None:
        self.ended, self.took_s = False, 0.0
        self._task, self._raised, self._abandoned = task, list[BaseException](), False
        self._go, self._back = threading.Semaphore(0), threading.Semaphore(0)
        self._thread = threading.Thread(target=copy_context().run, args=(self._run,), daemon=True)

    def go_on(self) -> None:
        """Let it run until it asks or has ended; what it raises is raised here."""
        if self._thread.ident is None:
            self._thread.start()
        else:
            self._go.release()
        self._back.acquire()
        if self._raised:
            raise self._raised[0]

    def ask(self, asked: Ask) -> schema.Answer | FaultError:
        """The answer, for which others are waited for; called in its thread."""
        self.asked = asked
        self._back.release()
        self._go.acquire()
        if self._abandoned:
            raise AbandonedError
        return self.answer

    def abandon(self) -> None:
        """End it, wherever it is, with what it has to clear away."""
        self._abandoned = True
        if self._thread.is_alive():
            self._go.release()
            self._thread.join()

    def _run(self) -> None:
        _of_thread.log = self
        try:
            self.result = self._task()
        except BaseException as error:
            self._raised.append(error)
        self.ended = True
        self._back.release()


def log_here() -> Log[Any] | None:
    """The log that is evaluated in this thread; None: no others are beside it."""
    log: Log[Any] | None = getattr(_of_thread, "log", None)
    return log


class Shared:
    """What a drive sees of a planner's process that it shares; as `Link`.

    Args:
        log: Which is driven.
        place: Which of its drives.
        limits: What the planner may take for one log.
        load: What its process loads.
        watch: Does not count the time that others take.
    """

    def __init__(
        self, log: Log[Any], place: DriveKey, limits: PlannerProcessConfig, load: Load, watch: Stopwatch
    ) -> None:
        self._log, self._place, self._limits, self._load, self._watch = log, place, limits, load, watch

    def ask(self, message: Any, limit: float, when: str) -> schema.Answer:
        """As `Link.ask`; `when` is said by the step, as the logs have other times."""
        begin = time.perf_counter()
        answer = self._log.ask(Ask(self._place, message, limit, self._limits, self._load))
        self._watch.waited(time.perf_counter() - begin - self._log.took_s)
        if isinstance(answer, FaultError):
            raise FaultError(str(answer))
        return answer

    def fault(self, what: str) -> FaultError:
        """The fault; the others go on."""
        return FaultError(what)

    def kill(self) -> None:
        """The others go on: nothing."""


class Together:
    """The planner's process for the drives of some logs.

    Args:
        logs: Those that wait for its begin.
    """

    def __init__(self, logs: Sequence[Log[Any]]) -> None:
        first = logs[0].asked
        self._link = Link(first.load.planner, first.limits, first.load, len(logs))
        self._seats, self._steps = {log: seat for seat, log in enumerate(logs)}, 0
        self._all = f"for {len(logs)} logs together"
        hellos = schema.Hellos([log.asked.message for log in logs])
        self._answer(logs, hellos, f"while it was built {self._all}")

    def plan(self, logs: Sequence[Log[Any]]) -> None:
        """Answer the frames that logs have asked for."""
        self._steps += 1
        frames = schema.Frames([self._seats[log] for log in logs], [log.asked.message for log in logs])
        self._answer(logs, frames, f"in step {self._steps} of drives {self._all}")

    def _answer(self, logs: Sequence[Log[Any]], message: Any, when: str) -> None:
        begin = time.perf_counter()
        answers = self._answers(message, sum(log.asked.limit for log in logs), when)
        for log, answer in zip(logs, answers, strict=True):
            log.answer, log.took_s = answer, time.perf_counter() - begin

    def _answers(self, message: Any, limit: float, when: str) -> Sequence[Any]:
        """What each is answered: a failure of all of them is that of each."""
        answer: schema.Answer | FaultError
        try:
            answer = self._link.ask(message, limit, when)
        except FaultError as fault:
            answer = fault
        if isinstance(answer, schema.Answers) and len(answer.each) == len(message.each):
            return answer.each
        if not isinstance(answer, FaultError | schema.Failed):
            answer = self._link.fault(f"broke its contract {when}: it did not answer each")
        return [answer] * len(message.each)

    def close(self) -> None:
        """The drives are over."""
        self._link.close()


def in_lockstep(tasks: Sequence[Callable[[], R]]) -> list[R]:
    """What the tasks return, each of which evaluates a log; planners that may be shared plan for all of them."""
    logs = [Log(task) for task in tasks]
    planner: Together | None = None
    try:
        for log in logs:
            log.go_on()
        while waiting := [log for log in logs if not log.ended]:
            some = [log for log in waiting if isinstance(log.asked.message, schema.Frame)]
            if planner is not None and some:
                planner.plan(some)
            else:
                if planner is not None:
                    planner.close()
                first = min(log.asked.place for log in waiting)
                some = [log for log in waiting if log.asked.place == first]
                planner = Together(some)
            for log in some:
                log.go_on()
    finally:
        if planner is not None:
            planner.close()
        for log in logs:
            log.abandon()
    return [log.result for log in logs]
