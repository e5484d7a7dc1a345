"""The interface of a planner: one method.

The replay builds a planner as `Class(context, **config)`, once per scenario, and calls `plan` at
each frame. The planner's memory (solver warm starts, hysteresis) lives in the object; there is no
reset. Where `frame.previous` is None, memory of earlier frames must not change the plan; what was
before is in `frame.past`, if the class asks for it with `past_s` (s, at most 2.1).
"""

from __future__ import annotations

from typing import Protocol

from replan.logs.frame import Frame
from replan.logs.plan import Plan


class Planner(Protocol):
    """Plans from a frame.

    A planner that cannot plan returns its fallback with the status and the reason; it neither
    returns None nor raises. It does not change the frame and is deterministic.
    """

    def plan(self, frame: Frame) -> Plan:
        """Return a plan from `frame.t` on: at least one sample, of the rear axle, in the world
        frame.
        """
        ...
