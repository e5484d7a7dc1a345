"""The reference planner of a search: it plans the frames of the suspect's drives, with changes of
its input and of its settings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b
from typing import Any

import numpy as np

from replan.core.errors import PlannerError, raised
from replan.core.settings import nested
from replan.explain.changed_frames import changed, changed_context
from replan.explain.input_changes import EVERYBODY, ChangeRow, InputChange
from replan.logs.agents import NUMBERS, AgentKind
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Plan
from replan.planners.base import Planner

SETTING_SHARES = (0.2, 0.6, 1.6, 5.0)
NO_AGENTS = InputChange("drop agents")


@dataclass(frozen=True, eq=False)
class WatchedDrive:
    """A drive of the suspect: what it was built with, its frames, and its plans."""

    log: str
    context: PlannerContext
    frames: Sequence[Frame]
    plans: Sequence[Plan]

    def begin(self, count: int) -> WatchedDrive:
        """The drive with its first `count` frames."""
        return replace(self, frames=self.frames[:count], plans=self.plans[:count])


@dataclass(frozen=True)
class SettingChange:
    """A setting of the reference planner, by its dotted key, with another value than its own."""

    key: str
    value: float
    own: float
    kinds: frozenset[AgentKind] = EVERYBODY

    @property
    def row(self) -> ChangeRow:
        """Shares of the own value; of a whole number its neighbours; of 0 some powers of ten."""
        if isinstance(self.own, int):
            tries = tuple(self.own + step for step in (-4.0, -1.0, 1.0, 4.0))
            return ChangeRow(self.key, tries, None, "frames", cause="decision")
        shares = SETTING_SHARES if self.own else (0.1, 1.0, 10.0)
        tries = tuple(share * (self.own or 1.0) for share in shares)
        return ChangeRow(self.key, tries, None, cause="decision")

    @property
    def given(self) -> float:
        """The value as the planner takes it."""
        return round(self.value) if isinstance(self.own, int) else self.value

    def __str__(self) -> str:
        return f"setting {self.key} {self.own:g} -> {self.value:g}"

    def sentence(self, period_s: float = 0.1) -> str:
        """What the planner acts on."""
        return f"its setting {self.key} were {self.value:g} instead of {self.own:g}"


Change = InputChange | SettingChange
Build = Callable[[PlannerContext, Mapping[str, Any]], Planner]
"""Builds the reference planner from a context, with changes of its table of settings."""


class Reference:
    """The reference planner, which plans frames of the suspect's drives."""

    def __init__(self, build: Build) -> None:
        self._build = build
        self._planners: dict[tuple[str, tuple[Change, ...]], Planner] = {}
        self._digests: dict[str, list[bytes]] = {}
        self._planned: dict[tuple[str, tuple[Change, ...], bytes], Plan | None] = {}

    def plans(
        self, drive: WatchedDrive, changes: Sequence[Change], *, keep: bool = False
    ) -> Iterator[Plan | None]:
        """The plans of all frames of a drive, in order, with their artefacts if these are to be
        kept; None where the planner refused a change.

        PlannerError if it raises without a change.
        """
        frames = changed(drive.frames, _of_frames(changes))
        for number in range(len(frames)):
            yield self._plan(drive, changes, frames[number], keep=keep)

    def plan_afresh(
        self, drive: WatchedDrive, changes: Sequence[Change], number: int
    ) -> Plan | None:
        """The plan of one frame, with artefacts, by a planner without memory; as `plans`."""
        frame = changed(drive.frames, _of_frames(changes))[number]
        key = drive.log, _of_build(changes), _digest(frame)
        if key not in self._planned:
            alone = replace(changed([frame], [NO_AGENTS])[0], previous=None)
            self._plan(drive, changes, alone)  # forgets what was before
            self._planned[key] = self._plan(drive, changes, frame, keep=True)
        return self._planned[key]

    def is_changed(self, drive: WatchedDrive, changes: Sequence[Change]) -> bool:
        """Whether the changes change any frame of a drive, or the planner."""
        if drive.log not in self._digests:
            self._digests[drive.log] = list(map(_digest, drive.frames))
        frames = changed(drive.frames, _of_frames(changes))
        return bool(_of_build(changes)) or any(
            _digest(frames[n]) != before for n, before in enumerate(self._digests[drive.log])
        )

    def _plan(
        self,
        drive: WatchedDrive,
        changes: Sequence[Change],
        frame: Frame,
        *,
        keep: bool = False,
    ) -> Plan | None:
        """The plan of a frame as the planner made it; errors as `plans`."""
        try:
            return self._planner(drive, _of_build(changes)).plan(frame).recorded(keep=keep)
        except Exception as error:
            if changes:  # a planner may refuse a changed input, or a changed setting
                return None
            raise PlannerError(
                f"the baseline's planner raised on {drive.log} at {frame.t:.2f} s: {raised(error)}"
            ) from error

    def _planner(self, drive: WatchedDrive, context: tuple[Change, ...]) -> Planner:
        """The planner for a drive, built with changes of the context and of its settings."""
        key = drive.log, context
        if key not in self._planners:
            inputs = [change for change in context if isinstance(change, InputChange)]
            settings = [change for change in context if isinstance(change, SettingChange)]
            self._planners[key] = self._build(
                changed_context(drive.context, inputs),
                nested({change.key: change.given for change in settings}),
            )
        return self._planners[key]


def _of_build(changes: Sequence[Change]) -> tuple[Change, ...]:
    """The changes with which the planner is built."""
    return tuple(change for change in changes if change.row.edit is None)


def _of_frames(changes: Sequence[Change]) -> list[InputChange]:
    """The changes of frames."""
    inputs = [change for change in changes if isinstance(change, InputChange)]
    return [change for change in inputs if change.row.edit is not None]


def _digest(frame: Frame) -> bytes:
    """The content of a frame."""
    digest = blake2b(repr((frame.t, frame.ego, frame.agents.ids, frame.lights)).encode())
    digest.update(b"afresh" if frame.previous is None else b"goes on")
    for name in NUMBERS:
        digest.update(getattr(frame.agents, name).tobytes())
    for name in ("t", "agent", "probability", "x", "y", "yaw"):
        digest.update(np.ascontiguousarray(getattr(frame.predictions, name)).tobytes())
    return digest.digest()
