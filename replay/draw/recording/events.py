"""The events of a drive, a line each: what changed, when, and why."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import rerun as rr

from logs.trace import Decision, DecisionKind, EndReason, Said, Trace
from replay.draw.recording.columns import Instants, Tape
from replay.draw.recording.lane_choice import KEEP, options, taken, told
from replay.draw.recording.text import MARKDOWN, cell, document, plain


@dataclass(frozen=True)
class Event:
    """Something that happened: when, how grave ("INFO", "WARN", "ERROR"), in words."""

    t: float
    level: str
    words: str


def events(trace: Trace, said: Sequence[Said] | None = None) -> list[Event]:
    """Changes of status, of decisions, of the lane and of what a plan says of itself, and the end.

    Args:
        trace: The drive.
        said: What its plans say, where the trace does not have them all.
    """
    found: list[Event] = []
    status, gist, decided = None, "", dict[str, str]()
    for plan in [frame.said for frame in trace.frames] if said is None else said:
        if plan.status is not status and (status is not None or plan.status.is_fallback):
            level = "WARN" if plan.status.is_fallback else "INFO"
            found.append(Event(plan.t, level, f"{plan.status.value} {f'({plan.reason})' if plan.reason else ''}"))
        elif not plan.status.is_fallback and plan.reason and _gist(plan.reason) != gist:
            found.append(Event(plan.t, "INFO", plan.reason))
        gist = _gist(plan.reason)
        some = options(plan)
        if taken(some) != KEEP:
            found.append(Event(plan.t, "INFO", f"changes lane to the {taken(some)}: {told(some)}"))
        now = {
            artefact.agent: f"{artefact.kind.value} ({artefact.reason})"
            for artefact in plan.internals
            if isinstance(artefact, Decision) and artefact.kind is not DecisionKind.IGNORE
        }
        for agent in dict.fromkeys([*now, *decided]):
            before, after = decided.get(agent, "no decision ()"), now.get(agent, "no decision ()")
            if before.split(" (")[0] != after.split(" (")[0]:
                found.append(Event(plan.t, "INFO", f"{agent}: {after.removesuffix(' ()')}"))
        status, decided = plan.status, now
    grave = trace.end in (
        EndReason.COLLISION, EndReason.REPLAY_CONTACT, EndReason.OFF_ROAD, EndReason.PLANNER_FAILURE,
    )  # fmt: skip
    detail = f": {trace.detail}" if trace.detail else ""
    end = Event(float(trace.ego.t[-1]), "ERROR" if grave else "INFO", f"{trace.end.value}{detail}")
    return [*found, end]


def _gist(reason: str) -> str:
    """A reason without its numbers: the same reason with other numbers is no event."""
    return re.sub(r"[\d.]+", "#", reason)


MOST_RECENT = 6
"""Rows of the page of recent events: whole in a window of usual size."""


def recent(found: Sequence[Event], t: float) -> list[str]:
    """The page of the last events not later than `t`, the newest first; grave ones are bold."""
    past = [event for event in found if event.t <= t + 1e-9]
    rows = [
        f"- **{event.t:.1f} s** {cell(event.words) if event.level == 'INFO' else f'**{cell(event.words)}**'}"
        for event in past[::-1][:MOST_RECENT]
    ]
    return rows or ["nothing yet"]


def draw_events(tape: Tape, found: Sequence[Event], frames: Instants) -> None:
    """One line of the log view per event, and a page of the recent ones at each of their times."""
    found = [replace(event, words=tape.short(event.words)) for event in found]
    tape.static("recent", rr.TextDocument.from_fields(media_type=MARKDOWN))
    changes = np.unique([*frames.t[:1], *(event.t for event in found)])
    pages = [document(recent(found, float(t))) for t in changes]
    tape.rows("recent", Instants.among(changes, frames.t), rr.TextDocument.columns(text=pages))
    times = np.array([event.t for event in found])
    instants = Instants.among(times, frames.t)
    shown = rr.TextLog.columns(text=[plain(event.words) for event in found], level=[event.level for event in found])
    tape.rows("events", instants, shown)
