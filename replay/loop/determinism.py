"""Is a planner deterministic? The start of its drive is driven twice, each time by a planner that is built anew.

The worlds are the same, so the plans must be, bit for bit: what differs comes out of the planner (a random number, a
clock, the order of a set, threads that race). It is a note of the drive and a mark in the reports: figures of a
planner that is not deterministic are those of one try.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import zip_longest

import numpy as np

from logs.states import TRAJECTORY_COLUMNS
from logs.trace import EndReason, PlannedFrame, Trace

NOT_DETERMINISTIC = "not deterministic: "
"""How the note begins."""


def with_probe(trace: Trace, again: Trace, until_s: float) -> Trace:
    """The trace, with a note where a second drive of the same start parts from it.

    Args:
        trace: The drive.
        again: The same scenario, planner and loop, driven once more up to `until_s`.
        until_s: s since the scenario's start; later frames are not compared.
    """
    found = parting(trace, again, until_s)
    return replace(trace, notes=(*trace.notes, f"{NOT_DETERMINISTIC}{found}")) if found else trace


def parting(trace: Trace, again: Trace, until_s: float) -> str:
    """Where and by how much two drives of the same part, a sentence; "": nowhere up to `until_s`."""
    first, second = ([frame for frame in one.frames if frame.t <= until_s] for one in (trace, again))
    for one, other in zip_longest(first, second):
        if one is None or other is None:
            shorter = again if other is None else trace
            failed = shorter.end is EndReason.PLANNER_FAILURE
            why = shorter.detail if failed else f"it ended by {shorter.end.value}"
            return f"{trace.planner}, driven twice: it goes on only once: {why}"
        said = _apart(one, other)
        if said:
            return f"{trace.planner}, driven twice: {said} at {one.t:.2f} s"
    return ""


def _apart(one: PlannedFrame, other: PlannedFrame) -> str:
    """What differs between two plans, in words."""
    a, b = one.plan.trajectory, other.plan.trajectory
    if len(a) != len(b):
        return f"the plans have {len(a)} and {len(b)} states"
    if one.plan.status is not other.plan.status:
        return f"the plans are '{one.plan.status.value}' and '{other.plan.status.value}'"
    if all(getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in TRAJECTORY_COLUMNS):
        return ""
    metres = float(np.max(np.hypot(a.x - b.x, a.y - b.y)))
    speed = float(np.max(np.abs(a.v - b.v)))
    return f"the plans differ by up to {metres:.3g} m and {speed:.3g} m/s"
