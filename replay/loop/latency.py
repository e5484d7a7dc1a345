"""The time that planning takes, as the loop models it: without a clock, so that a drive is the same twice."""

from __future__ import annotations

from collections import deque

from logs.trace import Plan

NEVER = 1 << 62


class Latency:
    """Plans on their way: each is driven from `delay` control steps after its frame on; the first one at once.

    Args:
        delay: Steps, not negative.

    Attributes:
        driven: The plan being driven; None before the first.
    """

    def __init__(self, delay: int) -> None:
        self._delay = delay
        self._coming: deque[tuple[int, Plan]] = deque()
        self.driven: Plan | None = None

    def before(self, step: int) -> Plan | None:
        """The plan that is driven when the frame at `step` is taken; None at the first."""
        return None if self.driven is None else self.at(step)

    def planned(self, step: int, plan: Plan) -> None:
        """A plan was made of the frame at `step`."""
        self._coming.append((step + self._delay, plan))
        self.driven = self.driven or plan

    def changes(self, step: int) -> int:
        """The first step after `step` at which another plan may come to be driven; NEVER where none is on its way."""
        return next((due for due, _ in self._coming if due > step), NEVER)

    def at(self, step: int) -> Plan:
        """The plan to drive at `step`, after the first was made; steps do not decrease."""
        while self._coming and self._coming[0][0] <= step:
            self.driven = self._coming.popleft()[1]
        assert self.driven is not None, "no plan was made yet"
        return self.driven
