"""Control, vehicle and record over the control steps until the next frame: the inner loop, compiled.

The rows of a trace, one per control step, are columns: the ego's motion and the actuation at the row's time, what is
commanded from then on, and the errors against the plan being driven. A step reads row k and writes row k + 1:

(1) errors = the motion of row k against the plan
(2) command, memory = control(law, memory, motion, errors, plan)            replay.control.split
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
from logs.states import Command, EgoState
from logs.trace import Plan
from replay.control.base import Controller
from replay.control.split import SplitController, SplitLaw, SplitState, control
from replay.plan_path import PlanPath, Tracker, deviation
from replay.vehicle import kinematic_bicycle, single_track
from replay.vehicle.base import Motion, Vehicle, motion_of
from replay.vehicle.dead_time import Pending, with_room
from replay.vehicle.drivetrain import Gearbox
from replay.vehicle.kinematic_bicycle import KinematicBicycle, Kinematics
from replay.vehicle.single_track import Car, SingleTrack

MOTION, COMMAND, ACTUATION, ERRORS = slice(0, 10), slice(10, 13), slice(13, 16), slice(16, 20)
"""Columns of a row: `Motion`; steer, throttle, brake twice; lateral, heading, speed, station (`Deviation`)."""
COLUMNS = 20
ANY_NUMBER = 1 << 30


@kernel
def commanded(
    law: SplitLaw, memory: SplitState, times: FloatArray, knots: FloatArray, rows: FloatArray, k: int
) -> tuple[tuple[float, float, float], SplitState]:
    """(1)-(3): the command at row k, and what is remembered then."""
    row = rows[k]
    now = Motion(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9])
    off = deviation(times, knots, now.t, now.x, now.y, now.yaw, now.v)
    steer, throttle, brake, memory = control(law, memory, now, off, times, knots)
    row[10], row[11], row[12] = steer, throttle, brake
    row[16], row[17], row[18], row[19] = off.lateral, off.heading, off.speed, off.station
    return (steer, throttle, brake), memory


@kernel
def arrived(row: FloatArray, now: Motion, steer: float, throttle: float, brake: float) -> None:
    """(5)."""
    row[0], row[1], row[2], row[3], row[4] = now.t, now.x, now.y, now.yaw, now.v
    row[5], row[6], row[7], row[8], row[9] = now.a, now.kappa, now.steer, now.yaw_rate, now.v_lat
    row[13], row[14], row[15] = steer, throttle, brake


@kernel
def run_kinematic(
    law: SplitLaw, memory: SplitState, times: FloatArray, knots: FloatArray, rows: FloatArray, first: int, count: int,
    dt: float, car: Kinematics, s: kinematic_bicycle.State,
) -> tuple[SplitState, kinematic_bicycle.State]:  # fmt: skip
    """`count` steps of a kinematic bicycle from row `first` on: what is remembered, and its state."""
    for k in range(first, first + count):
        command, memory = commanded(law, memory, times, knots, rows, k)
        s, now = kinematic_bicycle.step(s, command, car, rows[k, 0], dt)  # (4)
        arrived(rows[k + 1], now, s.steer, s.throttle, s.brake)
    return memory, s


@kernel
def run_single_track(
    law: SplitLaw, memory: SplitState, times: FloatArray, knots: FloatArray, rows: FloatArray, first: int, count: int,
    dt: float, car: Car, s: single_track.State, box: Gearbox, line: Pending,
) -> tuple[SplitState, single_track.State, Gearbox, Pending]:  # fmt: skip
    """`count` steps of a single-track vehicle from row `first` on: what is remembered, and its state."""
    for k in range(first, first + count):
        command, memory = commanded(law, memory, times, knots, rows, k)
        s, box, line, now = single_track.step(s, box, line, command, car, rows[k, 0], dt)  # (4)
        arrived(rows[k + 1], now, s.steer, s.throttle, s.brake)
    return memory, s, box, line


Run = Callable[[Any, Any, PlanPath, FloatArray, int, int, float], None]
"""Controller, vehicle, path of the plan, rows, first row, steps, dt."""


def _kinematic(
    driver: SplitController, car: KinematicBicycle, path: PlanPath, rows: FloatArray, first: int, count: int, dt: float
) -> None:
    driver.state, car.inner = run_kinematic(
        driver.law, driver.state, path.times, path.knots, rows, first, count, dt, car.model, car.inner
    )
    car.state = state_at(rows, first + count)


def _single_track(
    driver: SplitController, car: SingleTrack, path: PlanPath, rows: FloatArray, first: int, count: int, dt: float
) -> None:
    line = with_room(car.brakes, round(dt * 1e9))
    driver.state, car.inner, car.box, car.brakes = run_single_track(
        driver.law, driver.state, path.times, path.knots, rows, first, count, dt, car.model, car.inner, car.box, line
    )
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
        most_steps: So many control steps may be run at once.
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
            self._step(plan, path, rows, k)

    def _step(self, plan: Plan, path: PlanPath, rows: FloatArray, k: int) -> None:
        """One step through the methods of controller and vehicle."""
        state = self._vehicle.state
        command = self._controller.control(state, plan)
        rows[k, COMMAND] = command.steer, command.throttle, command.brake
        rows[k, ERRORS] = path.deviation(state)[:4]
        write_state(rows, k + 1, self._vehicle.step(command, self._period), self._vehicle.actuation)


def write_state(rows: FloatArray, k: int, state: EgoState, actuation: Command) -> None:
    """(5) of a state."""
    arrived(rows[k], motion_of(state), actuation.steer, actuation.throttle, actuation.brake)


def state_at(rows: FloatArray, k: int) -> EgoState:
    """The ego at row k."""
    return EgoState(*rows[k, MOTION].tolist())
