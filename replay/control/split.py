"""A controller of two laws: one steers, the other controls speed; at a standstill neither is used.

It is one compiled step, so that the loop can run it for a whole plan period without coming back to
Python (`replan.replay.loop.plan_period`). `SplitLaw` selects the laws and holds their parameters.
To add a law, write its kernel, add its parameters here, and add a branch to `steer` or `control`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray, frozen
from replan.core.kernel import inner_kernel, kernel
from replan.logs.plan import Plan
from replan.logs.states import Command, EgoState
from replan.logs.vehicle import VehicleParameters
from replan.replay.control.dlqr import (
    DlqrLaw,
    KinematicLaw,
    dlqr_law,
    kinematic_law,
    steer_rolling,
    steer_slipping,
)
from replan.replay.control.estimation import (
    DelayMemory,
    DelayModel,
    SlipMemory,
    SlipModel,
    SteeringDelay,
    slip_model,
    straight_wheel,
)
from replan.replay.control.geometric import PursuitLaw, StanleyLaw, steer_at_front, steer_pursuing
from replan.replay.control.lateral_model import has_rigid_tyres
from replan.replay.control.pedals import PedalMemory, StopMemory, eased, hold, press, stands
from replan.replay.control.pid import (
    SINGLE_LOOP_KD,
    LateralMemory,
    PidMemory,
    SpeedLaw,
    SteeringPidLaw,
    accelerate_by_error,
    accelerate_dual_loop,
    forget_speed,
    steer_by_error,
)
from replan.replay.vehicle.base import Powertrain
from replan.replay.vehicle.pedal_map import PedalMap
from replan.replay.vehicle.plan_path import Deviation, Tracker, deviation
from replan.replay.vehicle.state_records import (
    STEP,
    Plain,
    Records,
    Step,
    new_records,
    plain,
    write_command,
    write_ego,
)

DLQR, KINEMATIC_DLQR, PURE_PURSUIT, STANLEY, STEERING_PID = range(5)
DUAL_LOOP, SPEED_PID = range(2)


class SplitLaw(NamedTuple):
    """The laws for steering (DLQR ...) and speed (DUAL_LOOP ...), the parameters of all laws, and
    the pedal map.
    """

    steers: int
    drives: int
    dlqr: DlqrLaw
    kinematic: KinematicLaw
    pursuit: PursuitLaw
    stanley: StanleyLaw
    pid: SteeringPidLaw
    speed: SpeedLaw
    train: PedalMap


class SplitMemory:
    """The memory of the laws, a record: standstill, pedal, end of a stop, integrals, what is known
    of tyres and steering.
    """

    standing: bool = False
    pedal: PedalMemory
    stop: StopMemory
    speed: PidMemory
    lateral: LateralMemory
    slip: SlipMemory
    delay: DelayMemory


@inner_kernel
def steer(
    law: SplitLaw,
    memory: SplitMemory,
    wheel: FloatArray,
    now: EgoState,
    off: Deviation,
    knots: FloatArray,
) -> float:
    """Return the front wheel angle to command, rad."""
    if law.steers == DLQR:
        return steer_slipping(law.dlqr, memory.slip, memory.delay, wheel, now, off, knots)
    if law.steers == STEERING_PID:
        return steer_by_error(law.pid, memory.lateral, now, off)
    if law.steers == PURE_PURSUIT:
        return steer_pursuing(law.pursuit, now, off, knots)
    if law.steers == STANLEY:
        return steer_at_front(law.stanley, now, off, knots)
    return steer_rolling(law.kinematic, now, off, knots)


@inner_kernel
def control(
    law: SplitLaw,
    memory: SplitMemory,
    wheel: FloatArray,
    now: EgoState,
    off: Deviation,
    times: FloatArray,
    knots: FloatArray,
) -> tuple[float, float, float]:
    """Return steer, throttle and brake for the next control period.

    A stop ends softly; while the vehicle is held at a standstill, the brake is on and the steering
    stays where it is.
    """
    memory.standing = stands(memory.standing, now.v, now.t, times)
    if memory.standing:  # forget the wheel angle and the integrals
        forget_speed(memory.speed)
        memory.delay.known = memory.delay.known and not law.dlqr.commands
        throttle, brake = hold(memory.pedal, now.v, now.a)
        return now.steer, throttle, brake
    angle = steer(law, memory, wheel, now, off, knots)
    if law.drives == SPEED_PID:
        wanted = accelerate_by_error(law.speed, memory.speed, law.train, now, off)
    else:
        wanted = accelerate_dual_loop(law.speed, memory.speed, law.train, now, off, times)
    wanted = eased(memory.stop, law.train, times, now.t, now.v, now.a, wanted, law.speed.period)
    throttle, brake = press(memory.pedal, law.train, wanted, now.v)
    return angle, throttle, brake


@inner_kernel
def named_law(laws: Plain) -> SplitLaw:
    """Return the law from plain tuples (`replan.replay.vehicle.state_records.plain`)."""
    steers, drives, dlqr, kinematic, pursuit, stanley, pid, speed, train = laws
    slip, delay = dlqr[:2]
    return SplitLaw(
        steers,
        drives,
        DlqrLaw(SlipModel(*slip), DelayModel(*delay), *dlqr[2:]),
        KinematicLaw(*kinematic),
        PursuitLaw(*pursuit),
        StanleyLaw(*stanley),
        SteeringPidLaw(*pid),
        SpeedLaw(*speed),
        PedalMap(*train),
    )


@inner_kernel
def control_row(
    law: SplitLaw,
    memory: SplitMemory,
    wheel: FloatArray,
    times: FloatArray,
    knots: FloatArray,
    row: Step,
) -> tuple[float, float, float]:
    """Write the command and the deviation into a row of a trace."""
    now = row.ego
    off = deviation(times, knots, now.t, now.x, now.y, now.yaw, now.v)
    steer, throttle, brake = control(law, memory, wheel, now, off, times, knots)
    write_command(row, steer, throttle, brake, off)
    return steer, throttle, brake


@kernel
def control_once(
    driver: tuple[Plain, Records, FloatArray], path: tuple[FloatArray, FloatArray], rows: Records
) -> tuple[float, float, float]:
    """The command at the only row; `driver` and `path` as of `SplitController` and `PlanPath`."""
    (laws, memories, wheel), (times, knots) = driver, path
    return control_row(named_law(laws), memories[0], wheel, times, knots, rows[0])


class SplitController:
    """Steering by one law, pedals by another. See `replan.replay.vehicle.base.Controller`.

    Args:
        law: The laws for steering and speed.
        delay: Delay of the steering, if another controller commands it; None: this controller does.

    Attributes:
        inputs: What kernels take of it: the law as plain tuples, `(1,)` its memory, and the wheel
            angles as in `DelayMemory`. They write into memory and wheel.
    """

    notes: tuple[str, ...] = ()

    def __init__(self, law: SplitLaw, delay: SteeringDelay | None = None) -> None:
        wheel = straight_wheel(law.speed.period) if delay is None else delay.wheel
        self.inputs = plain(law), new_records(SplitMemory), wheel
        self._delay, self._tracker, self._rows = delay, Tracker(), np.zeros(1, STEP)

    @property
    def memory(self) -> SplitMemory:
        """The memory of the laws."""
        memory: SplitMemory = self.inputs[1][0]
        return memory

    def control(self, state: EgoState, plan: Plan) -> Command:
        """The command for the next control period."""
        path = self._tracker.path(plan)
        if self._delay is not None:
            self.memory.delay = self._delay.delay
        write_ego(self._rows, 0, state)
        return Command(*control_once(self.inputs, path.columns, self._rows))


UNUSED = frozen(np.zeros((2, 5)))
UNUSED_TABLE = frozen(np.zeros((2, 5, 6)))
"""Placeholder tables of unused steering laws, which are not solved."""


def split_law(
    steers: int,
    parameters: VehicleParameters,
    powertrain: Powertrain,
    period: float,
    *,
    drives: int = DUAL_LOOP,
    commands: bool = True,
) -> SplitLaw:
    """Build the law for a vehicle; with rigid tyres, the kinematic DLQR replaces the DLQR.

    Args:
        steers: One of DLQR, KINEMATIC_DLQR, ...
        parameters: Of the vehicle.
        powertrain: Of the vehicle.
        period: Between two commands, s.
        drives: DUAL_LOOP or SPEED_PID.
        commands: Whether its output is the command.
    """
    p, wheelbase, most = parameters, float(parameters.wheelbase), float(parameters.max_steer)
    steers = KINEMATIC_DLQR if steers == DLQR and has_rigid_tyres(p) else steers
    if steers == DLQR:
        slipping = dlqr_law(p, period, commands=commands)
    else:
        delay = DelayModel(0.0, 0.0, period, UNUSED_TABLE)
        slipping = DlqrLaw(
            slip_model(p, period), delay, UNUSED, UNUSED, wheelbase, most, 0.0, False
        )
    rolling = (
        kinematic_law(p, period)
        if steers == KINEMATIC_DLQR
        else KinematicLaw(UNUSED, 0.0, 0.0, 0.0)
    )
    speed = SpeedLaw(period) if drives == DUAL_LOOP else SpeedLaw(period, kd=SINGLE_LOOP_KD)
    return SplitLaw(
        steers,
        drives,
        slipping,
        rolling,
        PursuitLaw(wheelbase, most),
        StanleyLaw(wheelbase, most),
        SteeringPidLaw(period, most),
        speed,
        powertrain.pedal_map,
    )
