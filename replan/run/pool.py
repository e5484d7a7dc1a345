"""A pool of worker processes that survives the death of a worker.

Each worker is a fresh interpreter (`spawn`: nothing of numba, Arrow or Rerun is forked) that serves
many items, one at a time. If a worker is killed or crashes, only its current item is lost, and a
new worker replaces it.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

T = TypeVar("T")
R = TypeVar("R")

_CONTEXT = multiprocessing.get_context("spawn")


@dataclass(frozen=True)
class WorkerLost:
    """The result of an item whose worker died: a sentence for the user."""

    reason: str


@dataclass
class _Worker(Generic[T, R]):
    """One child process, the pipe to it, and its current item (None: idle)."""

    process: BaseProcess
    pipe: Connection
    item: int | None = None

    def take(self) -> R | WorkerLost:
        """The result that the worker sent for its item, or the reason for its end."""
        try:
            result: R = self.pipe.recv()
        except (EOFError, ConnectionError):
            self.process.join()
            code = self.process.exitcode or 0
            if code >= 0:
                return WorkerLost(
                    f"its worker process ended with code {code} (its message is above)"
                )
            name = signal.Signals(-code).name
            hint = (
                "; the system may be out of memory: try fewer --workers"
                if name == "SIGKILL"
                else ""
            )
            return WorkerLost(f"its worker process was killed ({name}){hint}")
        return result


def run_all(
    function: Callable[[T], R],
    items: Sequence[T],
    workers: int,
    *,
    one_first: bool = False,
    meanwhile: Callable[[], object] | None = None,
) -> Iterator[tuple[int, R | WorkerLost]]:
    """Apply a module-level function to items in child processes; yields `(index, result)` as they
    end.

    Args:
        function: Picklable; an exception in it ends its worker, so it should return its errors.
        items: Picklable; handed out in order.
        workers: Number of child processes, at least 1.
        one_first: The last item is processed alone before the others, so that files that all need
            are made only once.
        meanwhile: Picklable; called once, beside that item, in a process of its own.

    Closing the iterator, or an exception in its consumer (KeyboardInterrupt), kills the workers.
    """
    waiting = list(range(len(items)))[::-1]
    if one_first:
        waiting.append(waiting.pop(0))
    crew: list[_Worker[T, R]] = []
    beside = None
    if one_first and meanwhile is not None:
        beside = _CONTEXT.Process(target=_call, args=(meanwhile,), daemon=True)
        _start(beside)
    try:
        while waiting or crew:
            while waiting and len(crew) < (1 if one_first else workers):
                parent_end, child_end = _CONTEXT.Pipe()
                process = _CONTEXT.Process(target=_serve, args=(child_end, function), daemon=True)
                _start(process)
                child_end.close()
                crew.append(_Worker(process, parent_end))
                _hand_out(crew[-1], items, waiting)
            answered = wait([worker.pipe for worker in crew])
            for worker in [worker for worker in crew if worker.pipe in answered]:
                index, result = worker.item, worker.take()
                worker.item = None
                if waiting and not isinstance(result, WorkerLost):
                    _hand_out(worker, items, waiting)
                else:
                    crew.remove(worker)
                    _dismiss(worker)
                if index is not None:
                    one_first = False
                    yield index, result
    finally:
        if beside is not None:
            beside.kill()
            beside.join()
        for worker in crew:
            worker.process.kill()
            _dismiss(worker)


def _start(process: BaseProcess) -> None:
    """Start a child, in which Ctrl-C waits until it is ignored: it takes a moment to import.

    In this process, it waits for the start.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        process.start()
        return
    resource_tracker.ensure_running()  # else the start would do it, and unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _ignore_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _call(function: Callable[[], object]) -> None:
    """The child beside the workers; it ends with the parent, too."""
    _ignore_interrupts()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    function()


def _hand_out(worker: _Worker[T, R], items: Sequence[T], waiting: list[int]) -> None:
    worker.item = waiting.pop()
    # The worker died before it got an item; `take` reports the closed pipe
    with suppress(ConnectionError):
        worker.pipe.send(items[worker.item])


def _dismiss(worker: _Worker[T, R]) -> None:
    worker.pipe.close()
    worker.process.join()
    worker.process.close()


def _serve(pipe: Connection, function: Callable[[Any], Any]) -> None:
    """The child: answer items until the pipe is closed.

    The parent handles Ctrl-C, and the child ends with it.
    """
    _ignore_interrupts()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    freeze_gc()
    served = 0
    while True:
        try:
            item = pipe.recv()
        except EOFError:
            return
        pipe.send(function(item))
        served += 1
        if served == 1:  # by now all kernels are loaded, too
            freeze_gc()


def freeze_gc() -> None:
    """Exclude the modules and kernels that are loaded from garbage collection.

    A full collection took 117 ms with them, sometimes in the middle of a plan.
    """
    gc.collect()
    gc.freeze()


def _end_with_parent() -> None:
    """End this child when its parent is killed, so that it does not go on writing into the folder
    of the run.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
