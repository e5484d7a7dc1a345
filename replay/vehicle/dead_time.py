"""Dead time: a command that takes effect later than it was given."""

from __future__ import annotations


class DeadTime:
    """A value that arrives `delay` s after it was commanded.

    Args:
        delay: s, not negative.
        value: What is in effect until the first command arrives.
    """

    def __init__(self, delay: float, value: float) -> None:
        self._delay_ns = round(delay * 1e9)
        self._now_ns = 0
        self._value = value
        self._coming: list[tuple[int, float]] = []

    def advance(self, command: float, dt: float) -> list[tuple[float, float]]:
        """Give the command for `dt` s: the values in effect meanwhile, each with its duration in s, in order."""
        end = self._now_ns + round(dt * 1e9)
        self._coming.append((self._now_ns + self._delay_ns, command))
        spans = []
        while self._coming and self._coming[0][0] < end:
            arrival, value = self._coming.pop(0)
            if arrival > self._now_ns and value != self._value:
                spans.append(((arrival - self._now_ns) / 1e9, self._value))
                self._now_ns = arrival
            self._value = value
        spans.append(((end - self._now_ns) / 1e9, self._value))
        self._now_ns = end
        return spans
