"""Takes down a closed loop step by step."""

from __future__ import annotations

import numpy as np

from logs.frame import Frame
from logs.states import Command, Controls, EgoState, Trajectory
from logs.trace import Plan, PlannedFrame, TrackingErrors
from replay.control.tracking import NO_PLAN, Tracker

UNKNOWN = Command(float("nan"), float("nan"), float("nan"))
_EGO, _COMMAND, _ACTUATION, _ERRORS = slice(0, 7), slice(7, 10), slice(10, 13), slice(13, 17)


class Journal:
    """The columns of a trace, row by row.

    Args:
        rows: The most rows that there will be.

    Attributes:
        frames: The plans so far.
    """

    def __init__(self, rows: int) -> None:
        self._rows = np.empty((rows, 17))
        self._count = 0
        self._tracker = Tracker()
        self._plan: Plan | None = None
        self.frames: list[PlannedFrame] = []

    def planned(self, frame: Frame, plan: Plan) -> None:
        """A plan was made for a frame."""
        self.frames.append(PlannedFrame.of(frame, plan))

    def add(self, ego: EgoState, command: Command, actuation: Command, plan: Plan | None) -> None:
        """The ego, what is commanded from now on, what the actuators do now; errors are taken against `plan`."""
        self._plan = plan
        off = NO_PLAN if plan is None else self._tracker.path(plan).deviation(ego)
        self._rows[self._count] = (
            ego.t, ego.x, ego.y, ego.yaw, ego.v, ego.a, ego.kappa,
            command.steer, command.throttle, command.brake,
            actuation.steer, actuation.throttle, actuation.brake,
            off.lateral, off.heading, off.speed, off.station,
        )  # fmt: skip
        self._count += 1

    def close(self, ego: EgoState, actuation: Command) -> None:
        """The last row: nothing is commanded any more, so the last command stands there (unknown, if there is none)."""
        command = Command(*self._rows[self._count - 1, _COMMAND].tolist()) if self._count else UNKNOWN
        self.add(ego, command, actuation, self._plan)

    @property
    def ego(self) -> Trajectory:
        """As driven."""
        return Trajectory(*self._rows[: self._count, _EGO].T)

    @property
    def commands(self) -> Controls:
        """As commanded."""
        return Controls(self._rows[: self._count, 0], *self._rows[: self._count, _COMMAND].T)

    @property
    def actuation(self) -> Controls:
        """As actuated."""
        return Controls(self._rows[: self._count, 0], *self._rows[: self._count, _ACTUATION].T)

    @property
    def errors(self) -> TrackingErrors:
        """Against the plans."""
        columns = np.ascontiguousarray(self._rows[: self._count, _ERRORS].T)
        return TrackingErrors(self.ego.t, *columns)
