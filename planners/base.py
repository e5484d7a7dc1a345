"""The interface of a planner: one method.

A planner is built as `Class(context, **config)`, once per scenario, and then asked for a plan at each frame. Its
memory (solver warm starts, hysteresis) lives in the object; there is no reset. `frame.previous is None` means fresh
memory: nothing remembered may change the plan.
"""

from __future__ import annotations

from typing import Protocol

from logs.frame import Frame
from logs.trace import Plan


class Planner(Protocol):
    """Plans from a frame.

    A planner that cannot plan returns its fallback with the status and the reason; it neither returns None nor
    raises. It leaves the frame untouched and is deterministic.
    """

    def plan(self, frame: Frame) -> Plan:
        """A plan from `frame.t` on, at least one sample, in the world frame, at the rear axle."""
        ...
