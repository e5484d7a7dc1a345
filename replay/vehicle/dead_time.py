"""Dead time: a command that takes effect later than it was given."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from logs.kernel import FloatArray, IntArray, kernel


class Pending(NamedTuple):
    """Commands on their way, as kernels take them.

    Attributes:
        delay_ns: From a command to its effect.
        now_ns: Up to here the values in effect have been handed out.
        value: In effect now.
        waiting: How many are on their way.
        arrival_ns: `(k,)`, k >= waiting: when each takes effect, increasing.
        coming: `(k,)` their values.
    """

    delay_ns: int
    now_ns: int
    value: float
    waiting: int
    arrival_ns: IntArray
    coming: FloatArray


@kernel
def commanded(line: Pending, command: float) -> Pending:
    """The line with one more command, given now; its arrays have room for it."""
    line.arrival_ns[line.waiting], line.coming[line.waiting] = line.now_ns + line.delay_ns, command
    return Pending(line.delay_ns, line.now_ns, line.value, line.waiting + 1, line.arrival_ns, line.coming)


@kernel
def next_span(line: Pending, end_ns: int) -> tuple[float, float, Pending]:
    """How long the value in effect stays, not beyond `end_ns`, s; the value; the line after that."""
    value, waiting = line.value, line.waiting
    while waiting > 0 and line.arrival_ns[0] < end_ns:
        arrival, held = line.arrival_ns[0], value
        value = line.coming[0]
        waiting -= 1
        for i in range(waiting):
            line.arrival_ns[i], line.coming[i] = line.arrival_ns[i + 1], line.coming[i + 1]
        if arrival > line.now_ns and value != held:
            after = Pending(line.delay_ns, arrival, value, waiting, line.arrival_ns, line.coming)
            return (arrival - line.now_ns) / 1e9, held, after
    after = Pending(line.delay_ns, end_ns, value, waiting, line.arrival_ns, line.coming)
    return (end_ns - line.now_ns) / 1e9, value, after


def pending(delay: float, value: float) -> Pending:
    """Nothing is on its way yet.

    Args:
        delay: s, not negative.
        value: What is in effect until the first command arrives.
    """
    return Pending(round(delay * 1e9), 0, float(value), 0, np.zeros(0, np.int64), np.zeros(0))


def with_room(line: Pending, dt_ns: int) -> Pending:
    """The same line with room for a command every `dt_ns`."""
    most = line.waiting + line.delay_ns // dt_ns + 2
    if most <= len(line.coming):
        return line
    arrival, coming = np.zeros(2 * most, np.int64), np.zeros(2 * most)
    arrival[: line.waiting], coming[: line.waiting] = line.arrival_ns[: line.waiting], line.coming[: line.waiting]
    return line._replace(arrival_ns=arrival, coming=coming)


def spans(line: Pending, command: float, dt: float) -> tuple[list[tuple[float, float]], Pending]:
    """Give the command for `dt` s: the values in effect meanwhile, each with its duration in s, in order; the line."""
    dt_ns = round(dt * 1e9)
    line = commanded(with_room(line, dt_ns), command)
    end, found = line.now_ns + dt_ns, []
    while line.now_ns < end:
        span, value, line = next_span(line, end)
        found.append((span, value))
    return found, line
