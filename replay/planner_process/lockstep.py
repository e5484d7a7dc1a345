"""Several logs in lock step (`loop.apart.batch`): the frames of one step are sent to one planner's
process together.

Each log is evaluated in a thread. One thread runs at a time, until its drive sends a request to the
planner; then the next one runs. So code that drives, measures or writes needs no locks, and the
results depend on no clock. When all logs wait, their requests are answered: first the frames of the
current drive (one planner, one loop, the same step in each log). If no log waits for a plan, the
first of the drives for which logs wait begins.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextvars import copy_context
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from replan.replay.drive import DriveKey, Stopwatch
from replan.replay.loop_config import PlannerProcessConfig
from replan.replay.planner_process import messages
from replan.replay.planner_process.connection import (
    Connection,
    FaultError,
    PlannerConnection,
    set_current_log,
)
from replan.replay.planner_process.processes import Load

R = TypeVar("R")


class AbandonedError(BaseException):
    """The run ended before this log; raised in the thread of the log to end it."""


@dataclass(frozen=True, eq=False)
class Request:
    """A request of the drive of a log.

    Attributes:
        place: The key of the drive.
        message: `messages.Hello` at its begin, or `messages.Frame`.
        limit: Time limit of the answer, s.
        limits: Limits of the planner's process.
        load: What the process loads.
    """

    place: DriveKey
    message: Any
    limit: float
    limits: PlannerProcessConfig
    load: Load


class BatchLog(Generic[R]):
    """A log that is evaluated in a thread, which runs while `run_on` waits for it.

    Attributes:
        request: The request that it waits for.
        answer: The answer to its last request, which took `took_s`, s.
        result: What its evaluation returned, once it has `ended`.
    """

    request: Request
    answer: messages.Answer | FaultError
    result: R

    def __init__(self, task: Callable[[], R]) -> None:
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
            count = len(getattr(answer, "each", ()))
            if not isinstance(answer, messages.Failed) and count != len(logs):
                problem = f"broke its contract {when}: it did not answer every frame"
                raise self._connection.fault(problem)
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
