"""Takes down a closed loop: a row per control step (`replay.vehicle.trace_rows`), a frame per plan."""

from __future__ import annotations

import numpy as np

from logs.frame import Frame
from logs.memory import FrameStore
from logs.states import TRAJECTORY_COLUMNS, Controls, Trajectory
from logs.trace import Plan, PlannedFrame, TrackingErrors
from replay.vehicle.base import Vehicle
from replay.vehicle.plan_path import PlanPath
from replay.vehicle.trace_rows import ACTUATION, COLUMNS, COMMAND, ERRORS, compared, write_state

EGO = slice(0, len(TRAJECTORY_COLUMNS))


class TraceRecorder:
    """The columns of a trace.

    Args:
        steps: The most control steps that there will be.
        vehicle: At the start.

    Attributes:
        rows: `(steps + 1, COLUMNS)`; what is not driven yet is not defined.
        count: Rows of the drive, once it is closed.
        frames: The plans so far.
    """

    def __init__(self, steps: int, vehicle: Vehicle) -> None:
        self.rows = np.empty((steps + 1, COLUMNS))
        self.count = 0
        self.frames = FrameStore()
        write_state(self.rows, 0, vehicle.state, vehicle.actuation)

    def planned(self, frame: Frame, plan: Plan) -> None:
        """A plan was made for a frame."""
        self.frames.append(PlannedFrame.of(frame, plan))

    def close(self, last: int, plan: Plan | None) -> None:
        """The drive is over at a row: nothing is commanded there, so the command before stands (NaN if there is none).

        Args:
            last: The row.
            plan: The plan that was driven.
        """
        row, self.count = self.rows[last], last + 1
        row[COMMAND] = self.rows[last - 1, COMMAND] if last else np.nan
        row[ERRORS] = np.nan
        if plan is not None:
            path = PlanPath.of(plan.trajectory)
            compared(path.times, path.knots, self.rows, last)

    @property
    def ego(self) -> Trajectory:
        """As driven."""
        return Trajectory(*self.rows[: self.count, EGO].T)

    @property
    def commands(self) -> Controls:
        """As commanded."""
        return Controls(self.rows[: self.count, 0], *self.rows[: self.count, COMMAND].T)

    @property
    def actuation(self) -> Controls:
        """As actuated."""
        return Controls(self.rows[: self.count, 0], *self.rows[: self.count, ACTUATION].T)

    @property
    def errors(self) -> TrackingErrors:
        """Against the plans."""
        columns = np.ascontiguousarray(self.rows[: self.count, ERRORS].T)
        return TrackingErrors(self.ego.t, *columns)
