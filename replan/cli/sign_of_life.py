"""A line every few seconds while a command works, also while it compiles kernels."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import inf
from threading import Event, Thread
from time import perf_counter

from replan.core.kernel import KernelWatch

QUIET_S = 20.0
"""Longest time without output, s."""
LONGEST_KERNEL_S = 60.0
"""Kernels are taken to be compiled until this time after the last one, s: one may take that long on
a busy machine.
"""


@contextmanager
def sign_of_life(
    say: Callable[[str], None], words: Callable[[], str], every_s: float = QUIET_S
) -> Iterator[None]:
    """While the body runs, `say` the words and the elapsed time every `every_s` seconds."""
    ended, began = Event(), perf_counter()

    def speak() -> None:
        while not ended.wait(every_s):
            say(f"{words()}, {perf_counter() - began:.0f} s so far")

    thread = Thread(target=speak, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def with_kernels(words: Callable[[], str]) -> Callable[[], str]:
    """The words; before them the number of compiled kernels, while kernels are compiled."""
    watch, grown = KernelWatch(), -inf

    def line() -> str:
        nonlocal grown
        now = perf_counter()
        grown = now if watch.look() else grown
        if now - grown >= LONGEST_KERNEL_S:
            return words()
        return f"compiling kernels (once): {watch.stored} of {watch.known} are ready, {words()}"

    return line
