"""The compiled inner loop of a closed-loop drive: controller and vehicle run from plan to plan and
fill the trace.

Planning time is modelled without a clock, so that repeated drives are equal (`Latency`). A step
reads row k of the trace (`replan.replay.vehicle.state_records`) and writes row k + 1:

(1) deviation = the motion of row k against the plan
(2) command, memory = control(law, memory, motion, deviation, plan)
        `replan.replay.control.split.control_row`
(3) row k: command, deviation
(4) motion, state = step(state, command, dt)                                the vehicle's own kernel
(5) row k + 1: motion, actuation

A pair of controller and vehicle in RUNS is run by one kernel over all steps; any other pair of
controller and vehicle takes one step at a time through their methods, into the same rows. To add a
compiled vehicle, write its kernel (4) and add a line to RUNS.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.kernel import kernel
from replan.logs.frame import Frame
from replan.logs.frame_store import FrameStore
from replan.logs.plan import Plan
from replan.logs.states import Controls, Trajectory
from replan.logs.trace import PlannedFrame, TrackingErrors
from replan.replay.control.split import SplitController, control_row, named_law
from replan.replay.vehicle import kinematic_bicycle, single_track
from replan.replay.vehicle.base import Controller, Vehicle
from replan.replay.vehicle.drivetrain import Gearbox, Pending, with_room
from replan.replay.vehicle.kinematic_bicycle import BicycleState, KinematicBicycle, Kinematics
from replan.replay.vehicle.plan_path import PlanPath, Tracker
from replan.replay.vehicle.single_track import SingleTrack, SingleTrackState, named_car
from replan.replay.vehicle.state_records import (
    STEP,
    Plain,
    Records,
    state_at,
    trajectory_of,
    write_motion,
    write_state,
)


class Latency:
    """Delays plans: each is driven from `delay` control steps after its frame; the first one at
    once.

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
        """Add the plan of the frame at `step`."""
        self._coming.append((step + self._delay, plan))
        self.driven = self.driven or plan

    def next_change(self, step: int) -> int | None:
        """The first step after `step` at which another plan may take effect; None if none is
        pending.
        """
        return next((due for due, _ in self._coming if due > step), None)

    def at(self, step: int) -> Plan:
        """The plan to drive at `step`, after the first was made; steps do not decrease."""
        while self._coming and self._coming[0][0] <= step:
            self.driven = self._coming.popleft()[1]
        assert self.driven is not None, "no plan was made yet"
        return self.driven


@kernel
def run_kinematic(
    driver: tuple[Plain, Records, FloatArray],
    path: tuple[FloatArray, FloatArray],
    rows: Records,
    first: int,
    count: int,
    dt: float,
    numbers: Plain,
) -> None:
    """Run `count` steps of a kinematic bicycle from row `first`; its state is in the rows.

    `driver` and `path` as in `replan.replay.control.split.control_once`.
    """
    (laws, memories, wheel), (times, knots) = driver, path
    law, memory, car = named_law(laws), memories[0], Kinematics(*numbers)
    s = kinematic_bicycle.state_of(rows[first].ego, rows[first].actuation)
    for k in range(first, first + count):
        command = control_row(law, memory, wheel, times, knots, rows[k])  # (1)-(3)
        s, motion = kinematic_bicycle.step(s, command, car, rows[k].ego.t, dt)  # (4)
        write_motion(rows[k + 1], motion, s.steer, s.throttle, s.brake)  # (5)


@kernel
def run_single_track(
    driver: tuple[Plain, Records, FloatArray],
    path: tuple[FloatArray, FloatArray],
    rows: Records,
    first: int,
    count: int,
    dt: float,
    numbers: Plain,
    inner: tuple[Plain, Plain, Plain],
) -> tuple[Plain, Plain, Plain]:
    """Run `count` steps of a single-track vehicle from row `first`; `inner`: the state of vehicle,
    gearbox and brake commands, which is returned as it is after them.
    """
    (laws, memories, wheel), (times, knots), (body, gearbox, brakes) = driver, path, inner
    law, memory = named_law(laws), memories[0]
    car, s = named_car(numbers), SingleTrackState(*body)
    box, line = Gearbox(*gearbox), Pending(*brakes)
    for k in range(first, first + count):
        command = control_row(law, memory, wheel, times, knots, rows[k])  # (1)-(3)
        s, box, line, motion = single_track.step(
            s, box, line, command, car, rows[k].ego.t, dt
        )  # (4)
        write_motion(rows[k + 1], motion, s.steer, s.throttle, s.brake)  # (5)
    return s[:], box[:], line[:]


Run = Callable[[Any, Any, PlanPath, Records, int, int, float], None]
"""Controller, vehicle, path of the plan, rows, first row, steps, dt."""


def _kinematic(
    driver: SplitController,
    car: KinematicBicycle,
    path: PlanPath,
    rows: Records,
    first: int,
    count: int,
    dt: float,
) -> None:
    run_kinematic(driver.inputs, path.columns, rows, first, count, dt, car.numbers)
    car.state, actuation = state_at(rows, first + count), rows["actuation"].item(first + count)
    car.inner = BicycleState(car.state.x, car.state.y, car.state.yaw, car.state.v, *actuation)


def _single_track(
    driver: SplitController,
    car: SingleTrack,
    path: PlanPath,
    rows: Records,
    first: int,
    count: int,
    dt: float,
) -> None:
    before = car.inner[:], car.box[:], with_room(car.brakes, round(dt * 1e9))[:]
    inner, box, brakes = run_single_track(
        driver.inputs, path.columns, rows, first, count, dt, car.numbers, before
    )
    car.inner, car.box, car.brakes = SingleTrackState(*inner), Gearbox(*box), Pending(*brakes)
    car.state = state_at(rows, first + count)


RUNS: dict[tuple[type, type], Run] = {
    (SplitController, KinematicBicycle): _kinematic,
    (SplitController, SingleTrack): _single_track,
}
"""Compiled runs by the types of controller and vehicle."""


class PlanPeriod:
    """Runs one drive's controller and vehicle over the rows of its trace.

    Args:
        controller: Gives the commands.
        vehicle: Receives the commands.
        period: Control period, s.

    Attributes:
        is_compiled: Whether a call runs all of its steps in one kernel.
    """

    def __init__(self, controller: Controller, vehicle: Vehicle, period: float) -> None:
        self._controller, self._vehicle = controller, vehicle
        self._period, self._tracker = period, Tracker()
        self._run = RUNS.get((type(controller), type(vehicle)))
        self.is_compiled = self._run is not None

    def run(self, plan: Plan, rows: Records, first: int, count: int) -> None:
        """Drive `count` control steps along the plan, from row `first`, which holds motion and
        actuation.
        """
        path = self._tracker.path(plan)
        if self._run:
            self._run(self._controller, self._vehicle, path, rows, first, count, self._period)
            return
        for k in range(first, first + count):
            command = self._controller.control(self._vehicle.state, plan)
            rows["command"][k] = command.steer, command.throttle, command.brake
            rows["deviation"][k] = path.deviation(state_at(rows, k))
            state = self._vehicle.step(command, self._period)
            write_state(rows, k + 1, state, self._vehicle.actuation)


class TraceRecorder:
    """The columns of a trace.

    Args:
        steps: The greatest number of control steps.
        vehicle: The vehicle at the start.

    Attributes:
        rows: `(steps + 1,)` records of type `STEP`; rows of later steps are undefined.
        count: Number of rows, after `close`.
        frames: The plans so far.
    """

    def __init__(self, steps: int, vehicle: Vehicle) -> None:
        self.rows: Records = np.empty(steps + 1, STEP)
        self.count = 0
        self.frames = FrameStore()
        write_state(self.rows, 0, vehicle.state, vehicle.actuation)

    def planned(self, frame: Frame, plan: Plan) -> None:
        """Add the plan of a frame."""
        self.frames.append(PlannedFrame.of(frame, plan))

    def close(self, last: int, plan: Plan | None) -> None:
        """End the drive at a row, which repeats the previous command (NaN if there is none).

        Args:
            last: The row.
            plan: The plan that was driven.
        """
        self.count = last + 1
        self.rows["command"][last] = self.rows["command"][last - 1] if last else np.nan
        self.rows["deviation"][last] = np.nan
        if plan is not None:
            path = PlanPath.of(plan.trajectory)
            self.rows["deviation"][last] = path.deviation(state_at(self.rows, last))

    @property
    def ego(self) -> Trajectory:
        """The ego's states as driven."""
        return trajectory_of(self.rows["ego"][: self.count])

    @property
    def commands(self) -> Controls:
        """The commands of the controller."""
        return self._controls("command")

    @property
    def actuation(self) -> Controls:
        """The actuation of the vehicle."""
        return self._controls("actuation")

    def _controls(self, name: str) -> Controls:
        rows = self.rows[: self.count]
        return Controls(
            rows["ego"]["t"], *(rows[name][part] for part in ("steer", "throttle", "brake"))
        )

    @property
    def errors(self) -> TrackingErrors:
        """The tracking errors against the plans."""
        off = self.rows["deviation"][: self.count]
        names = ("lateral", "heading", "speed", "station")
        return TrackingErrors(self.ego.t, *(np.ascontiguousarray(off[name]) for name in names))
