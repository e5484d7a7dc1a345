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
    DlqrState,
    KinematicLaw,
    dlqr_law,
    dlqr_start,
    kinematic_law,
    steer_rolling,
    steer_slipping,
)
from replan.replay.control.estimation import (
    DelayModel,
    DelayState,
    SlipModel,
    SlipState,
    SteeringDelay,
    slip_model,
)
from replan.replay.control.geometric import PursuitLaw, StanleyLaw, steer_at_front, steer_pursuing
from replan.replay.control.lateral_model import has_rigid_tyres
from replan.replay.control.pedals import (
    NO_PEDAL,
    NO_STOP,
    PedalState,
    StopState,
    eased,
    hold,
    press,
    stands,
)
from replan.replay.control.pid import (
    AT_REST,
    SINGLE_LOOP_KD,
    SpeedLaw,
    SpeedState,
    SteeringPidLaw,
    accelerate_by_error,
    accelerate_dual_loop,
    steer_by_error,
)
from replan.replay.vehicle.base import (
    COLUMNS,
    MOTION,
    MotionState,
    Plain,
    Powertrain,
    motion_at,
    motion_of,
    plain,
    write_command,
)
from replan.replay.vehicle.pedal_map import PedalMap
from replan.replay.vehicle.plan_path import Deviation, Tracker, deviation

DLQR, KINEMATIC_DLQR, PURE_PURSUIT, STANLEY, STEERING_PID = range(5)
DUAL_LOOP, SPEED_PID = range(2)
MEMORY, DELAY = 18, slice(15, 18)
"""Length of a `SplitState` as an array (`remembered`), and the entries of its steering delay."""


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


class SplitState(NamedTuple):
    """The memory of the laws: standstill, pedal, end of a stop, integrals, tyres and steering."""

    standing: bool
    pedal: PedalState
    stop: StopState
    speed: SpeedState
    steer_integral: float
    dlqr: DlqrState


@inner_kernel
def steer(
    law: SplitLaw, state: SplitState, now: MotionState, off: Deviation, knots: FloatArray
) -> tuple[float, float, DlqrState]:
    """Return the front wheel angle to command, rad, the new steering integral and the new state of
    the DLQR.
    """
    if law.steers == DLQR:
        angle, known = steer_slipping(law.dlqr, state.dlqr, now, off, knots)
        return angle, state.steer_integral, known
    if law.steers == STEERING_PID:
        angle, integral = steer_by_error(law.pid, state.steer_integral, now, off)
        return angle, integral, state.dlqr
    if law.steers == PURE_PURSUIT:
        angle = steer_pursuing(law.pursuit, now, off, knots)
    elif law.steers == STANLEY:
        angle = steer_at_front(law.stanley, now, off, knots)
    else:
        angle = steer_rolling(law.kinematic, now, off, knots)
    return angle, state.steer_integral, state.dlqr


@inner_kernel
def control(
    law: SplitLaw,
    state: SplitState,
    now: MotionState,
    off: Deviation,
    times: FloatArray,
    knots: FloatArray,
) -> tuple[float, float, float, SplitState]:
    """Return steer, throttle and brake for the next control period, and the new state.

    A stop ends softly; while the vehicle is held at a standstill, the brake is on and the steering
    stays where it is.
    """
    if stands(state.standing, now.v, now.t, times):  # forget the wheel angle and the integrals
        throttle, brake, pedal = hold(state.pedal, now.v, now.a)
        delay = state.dlqr.delay
        unknown = DelayState(
            delay.wheel, delay.offset, delay.delay, delay.known and not law.dlqr.commands
        )
        rests = SplitState(
            True,
            pedal,
            state.stop,
            AT_REST,
            state.steer_integral,
            DlqrState(state.dlqr.slip, unknown),
        )
        return now.steer, throttle, brake, rests
    angle, integral, known = steer(law, state, now, off, knots)
    if law.drives == SPEED_PID:
        wanted, speed = accelerate_by_error(law.speed, state.speed, law.train, now, off)
    else:
        wanted, speed = accelerate_dual_loop(law.speed, state.speed, law.train, now, off, times)
    wanted, stop = eased(
        state.stop, law.train, times, now.t, now.v, now.a, wanted, law.speed.period
    )
    throttle, brake, pedal = press(state.pedal, law.train, wanted, now.v)
    return angle, throttle, brake, SplitState(False, pedal, stop, speed, integral, known)


@kernel
def remembered(m: FloatArray, wheel: FloatArray) -> SplitState:
    """The state stored in an array of MEMORY numbers and the wheel's angles."""
    return SplitState(
        m[0] > 0.0,
        PedalState(m[1] > 0.0, m[2] > 0.0),
        StopState(m[3], m[4]),
        SpeedState(m[5], m[6], m[7]),
        m[8],
        DlqrState(
            SlipState(m[9], m[10], m[11], m[12], m[13], m[14]),
            DelayState(wheel, m[15], m[16], m[17] > 0.0),
        ),
    )


@kernel
def remember(m: FloatArray, s: SplitState) -> None:
    """The inverse of `remembered`; the wheel's angles are written in place."""
    slip, delay = s.dlqr.slip, s.dlqr.delay
    m[0], m[1], m[2], m[3], m[4] = (
        s.standing,
        s.pedal.braking,
        s.pedal.holding,
        s.stop.jerk,
        s.stop.offset,
    )
    m[5], m[6], m[7], m[8] = s.speed.integral, s.speed.m, s.speed.error, s.steer_integral
    m[9], m[10], m[11], m[12] = slip.front, slip.rear, slip.v_lat, slip.turn
    m[13], m[14], m[15], m[16], m[17] = (
        slip.alpha_front,
        slip.alpha_rear,
        delay.offset,
        delay.delay,
        delay.known,
    )


@inner_kernel
def named_law(p: Plain) -> SplitLaw:
    """Return the law from plain tuples (`replan.replay.vehicle.base.plain`)."""
    d = p[2]
    dlqr = DlqrLaw(d[0], d[1], SlipModel(*d[2]), DelayModel(*d[3]), d[4], d[5], d[6], d[7])
    others = KinematicLaw(*p[3]), PursuitLaw(*p[4]), StanleyLaw(*p[5]), SteeringPidLaw(*p[6])
    return SplitLaw(
        p[0],
        p[1],
        dlqr,
        others[0],
        others[1],
        others[2],
        others[3],
        SpeedLaw(*p[7]),
        PedalMap(*p[8]),
    )


@inner_kernel
def control_row(
    law: SplitLaw,
    memory: FloatArray,
    wheel: FloatArray,
    times: FloatArray,
    knots: FloatArray,
    rows: FloatArray,
    k: int,
) -> tuple[float, float, float]:
    """Write the command and the errors into row k of a trace, and the state into `memory`."""
    now = motion_at(rows, k)
    off = deviation(times, knots, now.t, now.x, now.y, now.yaw, now.v)
    steer, throttle, brake, state = control(law, remembered(memory, wheel), now, off, times, knots)
    remember(memory, state)
    write_command(rows[k], steer, throttle, brake, off)
    return steer, throttle, brake


@kernel
def control_once(
    laws: Plain,
    memory: FloatArray,
    wheel: FloatArray,
    times: FloatArray,
    knots: FloatArray,
    rows: FloatArray,
) -> tuple[float, float, float]:
    """The command at the only row."""
    return control_row(named_law(laws), memory, wheel, times, knots, rows, 0)


class SplitController:
    """Steering by one law, pedals by another. See `replan.replay.vehicle.base.Controller`.

    Args:
        law: The laws for steering and speed.
        delay: Delay of the steering, if another controller commands it; None: this controller does.

    Attributes:
        laws: The law as plain tuples.
        memory: `(MEMORY,)` the state as an array; kernels write into it.
        wheel: As in `DelayState`; kernels write into it.
    """

    notes: tuple[str, ...] = ()

    def __init__(self, law: SplitLaw, delay: SteeringDelay | None = None) -> None:
        self.laws: Plain = plain(law)
        self.memory, self.wheel = np.zeros(MEMORY), dlqr_start(law.speed.period).delay.wheel
        remember(
            self.memory,
            SplitState(False, NO_PEDAL, NO_STOP, AT_REST, 0.0, dlqr_start(law.speed.period)),
        )
        self._delay, self._tracker, self._row = delay, Tracker(), np.zeros((1, COLUMNS))

    @property
    def state(self) -> SplitState:
        """The state of the laws."""
        return remembered(self.memory, self.wheel)

    def control(self, state: EgoState, plan: Plan) -> Command:
        """The command for the next control period."""
        path = self._tracker.path(plan)
        if self._delay is not None:
            known = self._delay.state
            self.wheel, self.memory[DELAY] = known.wheel, (known.offset, known.delay, known.known)
        self._row[0, MOTION] = motion_of(state)
        return Command(
            *control_once(self.laws, self.memory, self.wheel, path.times, path.knots, self._row)
        )


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
            UNUSED, UNUSED, slip_model(p, period), delay, wheelbase, most, 0.0, False
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
