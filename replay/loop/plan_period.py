"""Control, vehicle and record over the control steps until the next frame: the inner loop, compiled.

A step reads row k of the trace (`replay.vehicle.trace_rows`) and writes row k + 1:

(1) errors = the motion of row k against the plan
(2) command, memory = control(law, memory, motion, errors, plan)            `replay.control.split.control_row`
(3) row k: command, errors
(4) motion, state = step(state, command, dt)                                the vehicle's own kernel
(5) row k + 1: motion, actuation

Who has compiled steps is run by one kernel over all steps; any other pair of controller and vehicle takes one step at a
time through their methods, into the same rows. Adding a compiled vehicle is its kernel of (4) and a line in RUNS.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from logs.kernel import FloatArray, kernel
from logs.trace import Plan
from replay.control.split import SplitController, control_row, named_law
from replay.vehicle import kinematic_bicycle, single_track
from replay.vehicle.base import Controller, Plain, Vehicle
from replay.vehicle.dead_time import Pending, with_room
from replay.vehicle.drivetrain import Gearbox
from replay.vehicle.kinematic_bicycle import KinematicBicycle, Kinematics
from replay.vehicle.plan_path import PlanPath, Tracker
from replay.vehicle.single_track import SingleTrack, named_car
from replay.vehicle.trace_rows import ACTUATION, COMMAND, arrived, compared, state_at, write_state

ANY_NUMBER = 1 << 30


@kernel
def run_kinematic(
    laws: Plain, memory: FloatArray, wheel: FloatArray, times: FloatArray, knots: FloatArray, rows: FloatArray,
    first: int, count: int, dt: float, numbers: Plain,
) -> None:  # fmt: skip
    """`count` steps of a kinematic bicycle from row `first` on; its state stands in the rows."""
    law, car = named_law(laws), Kinematics(*numbers)
    for k in range(first, first + count):
        command = control_row(law, memory, wheel, times, knots, rows, k)  # (1)-(3)
        row = rows[k]
        s = kinematic_bicycle.State(row[1], row[2], row[3], row[4], row[7], row[14], row[15])
        s, now = kinematic_bicycle.step(s, command, car, row[0], dt)  # (4)
        arrived(rows[k + 1], now, s.steer, s.throttle, s.brake)  # (5)


@kernel
def run_single_track(
    laws: Plain, memory: FloatArray, wheel: FloatArray, times: FloatArray, knots: FloatArray, rows: FloatArray,
    first: int, count: int, dt: float, numbers: Plain, inner: Plain, gears: Plain, brakes: Plain,
) -> tuple[Plain, Plain, Plain]:  # fmt: skip
    """`count` steps of a single-track vehicle from row `first` on: its state, gearbox and brake commands then."""
    law, car = named_law(laws), named_car(numbers)
    s, box, line = single_track.State(*inner), Gearbox(*gears), Pending(*brakes)
    for k in range(first, first + count):
        command = control_row(law, memory, wheel, times, knots, rows, k)  # (1)-(3)
        s, box, line, now = single_track.step(s, box, line, command, car, rows[k, 0], dt)  # (4)
        arrived(rows[k + 1], now, s.steer, s.throttle, s.brake)  # (5)
    return s[:], box[:], line[:]


Run = Callable[[Any, Any, PlanPath, FloatArray, int, int, float], None]
"""Controller, vehicle, path of the plan, rows, first row, steps, dt."""


def _kinematic(
    driver: SplitController, car: KinematicBicycle, path: PlanPath, rows: FloatArray, first: int, count: int, dt: float
) -> None:
    memory = driver.laws, driver.memory, driver.wheel
    run_kinematic(*memory, path.times, path.knots, rows, first, count, dt, car.numbers)
    car.set_state(state_at(rows, first + count), rows[first + count, ACTUATION])


def _single_track(
    driver: SplitController, car: SingleTrack, path: PlanPath, rows: FloatArray, first: int, count: int, dt: float
) -> None:
    memory, line = (driver.laws, driver.memory, driver.wheel), with_room(car.brakes, round(dt * 1e9))
    inner, box, line_after = run_single_track(
        *memory, path.times, path.knots, rows, first, count, dt, car.numbers, car.inner[:], car.box[:], line[:]
    )
    car.inner, car.box, car.brakes = single_track.State(*inner), Gearbox(*box), Pending(*line_after)
    car.state = state_at(rows, first + count)


RUNS: dict[tuple[type, type], Run] = {
    (SplitController, KinematicBicycle): _kinematic,
    (SplitController, SingleTrack): _single_track,
}
"""By the types of controller and vehicle."""


class PlanPeriod:
    """Runs one drive's controller and vehicle over the rows of its trace.

    Args:
        controller: Drives.
        vehicle: Is driven.
        period: Of the control, s.

    Attributes:
        most_steps: The greatest number of control steps in one call.
    """

    def __init__(self, controller: Controller, vehicle: Vehicle, period: float) -> None:
        self._controller, self._vehicle, self._period, self._tracker = controller, vehicle, period, Tracker()
        self._run = RUNS.get((type(controller), type(vehicle)))
        self.most_steps = ANY_NUMBER if self._run else 1

    def run(self, plan: Plan, rows: FloatArray, first: int, count: int) -> None:
        """Drive `count` control steps along the plan, from row `first`, whose motion and actuation stand there."""
        path = self._tracker.path(plan)
        if self._run:
            self._run(self._controller, self._vehicle, path, rows, first, count, self._period)
            return
        for k in range(first, first + count):
            command = self._controller.control(self._vehicle.state, plan)
            rows[k, COMMAND] = command.steer, command.throttle, command.brake
            compared(path.times, path.knots, rows, k)
            write_state(rows, k + 1, self._vehicle.step(command, self._period), self._vehicle.actuation)
