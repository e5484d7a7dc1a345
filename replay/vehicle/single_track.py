"""The dynamic single-track model: two axles with tyres, load transfer, drive train; from standstill
to the limit.

Position and heading of the rear axle; vx, vy of the centre of gravity in the body's frame, a and b
from it to the front and rear axle, wheelbase L, height h, grade angle g (uphill positive, along the
vehicle's way wherever it turns):

(1) dx/dt = vx cos(yaw) - v_lat sin(yaw),  dy/dt = vx sin(yaw) + v_lat cos(yaw),  v_lat = vy - b r,
        dyaw/dt = r
(2) dvx/dt = (Fxf cos(steer) - Fyf sin(steer) + Fxr) / m - drag vx |vx| - G sin(g) + r vy
(3) dvy/dt = (Fyf cos(steer) + Fxf sin(steer) + Fyr) / m - r vx
(4) dr/dt  = (a (Fyf cos(steer) + Fxf sin(steer)) - b Fyr) / I
(5) slip   = v_left / floor(v_ahead)
        of each wheel, in its own directions; tan of the slip angle
    floor(u) = |u| from SLIP_MPS on, below it (u^2 / SLIP_MPS + SLIP_MPS) / 2
(6) load   = (m G cos(g) b - m ax h) / L in front, a and + at the rear; ax is what the pedals ask,
        at most mu G
(7) Fx     = m (share of the drive - share of the friction (rolling + brake) along the motion);
        Fx, Fy by tyres (6)-(7) of the friction the rear axle takes REAR_BRAKE of what its share of
        the load is, the front the rest
(8) d(steer)/dt, d(throttle)/dt, d(brake)/dt             drivetrain (5), (7)

Low speed: with the floor (5) a tyre is a damper against sideways motion of its wheel. The slower,
the more exactly the wheels roll without slip, so that the model tends to the kinematic bicycle and
stays defined at standstill (the floor is that of Pacejka, Tire and Vehicle Dynamics, 7.2.3, with a
smooth joint). From SLIP_MPS on nothing is changed.

Standstill: friction (rolling, brake) and a hill holder keep it exactly; it leaves only forwards.
While the vehicle slides sideways, brakes and rolling resistance oppose each wheel's own motion.

Integration: Runge-Kutta of order 4; sub-steps of at most 10 ms, half the shortest lag, and STABLE
over the trace of the lateral dynamics, (Cf + Cr) / (m u) + (a^2 Cf + b^2 Cr) / (I u) with u =
floor(vx). Coming to a standstill is an event within the sub-step. Gear shifts are decided once per
sub-step.
"""

from __future__ import annotations

from math import atan, atan2, ceil, cos, sin, sqrt, tan
from typing import Annotated, NamedTuple

from msgspec import Meta

from replan.core.kernel import inner_kernel, kernel
from replan.logs.states import Command, EgoState
from replan.logs.vehicle import VehicleParameters
from replan.replay.vehicle.base import Controller, steady_pedals
from replan.replay.vehicle.drivetrain import (
    SHORTEST_LAG_S,
    DriveTables,
    Drivetrain,
    Gearbox,
    Pending,
    Steering,
    commanded,
    drive_force,
    next_span,
    pending,
    shifted,
    steer_rate,
    throttle_target,
    with_room,
)
from replan.replay.vehicle.kinematic_bicycle import MAX_SUBSTEP_S
from replan.replay.vehicle.state_records import Motion, Plain, plain
from replan.replay.vehicle.tyres import (
    GRAVITY,
    Tyre,
    TyreStiffness,
    axle_force,
    axle_tyres,
    slip_for,
)

SLIP_MPS = 1.0  # From this speed of a wheel on, its slip is not limited (5)
SLIDING_MPS = 0.5
"""A vehicle with an axle that moves sideways faster than this is not at a standstill."""
TURNOVER_MPS = 0.1  # Friction turns over within this speed of a wheel of a sliding vehicle
REAR_BRAKE = 0.85  # Share of its load's part of the friction that the rear axle takes (7)
STABLE = 1.25  # Longest sub-step times the trace of the lateral dynamics


class SingleTrackState(NamedTuple):
    """Rear axle x, y m.

    Yaw rad; vx, vy of the centre of gravity m/s; r rad/s; steer rad; throttle, brake 0 to 1.
    """

    x: float
    y: float
    yaw: float
    vx: float
    vy: float
    r: float
    steer: float
    throttle: float
    brake: float


class SingleTrackCar(NamedTuple):
    """What the kernels take of a vehicle; names as in the equations, `grade` as sine and cosine.

    `substep` is the longest that the actuators' lags allow, s.
    """

    front: Tyre
    rear: Tyre
    drive: DriveTables
    mass: float
    inertia: float
    a: float
    b: float
    height: float
    front_drive: float
    steering: Steering
    throttle_lag: float
    brake_lag: float
    grade_sin: float
    grade_cos: float
    substep: float


@inner_kernel
def named_car(numbers: Plain) -> SingleTrackCar:
    """The car that plain tuples hold (`replan.replay.vehicle.state_records.plain`)."""
    front, rear, drive = numbers[:3]
    return SingleTrackCar(Tyre(*front), Tyre(*rear), DriveTables(*drive), *numbers[3:])


@inner_kernel
def floored(u: float) -> float:
    """floor(u), m/s."""
    u = abs(u)
    return u if u >= SLIP_MPS else 0.5 * (u * u / SLIP_MPS + SLIP_MPS)  # (5)


@inner_kernel
def slides(s: SingleTrackState, car: SingleTrackCar) -> bool:
    """Return whether an axle moves sideways faster than a standstill allows."""
    lateral = (s.vy + car.a * s.r) * cos(s.steer) - s.vx * sin(s.steer)
    return abs(lateral) > SLIDING_MPS or abs(s.vy - car.b * s.r) > SLIDING_MPS


@inner_kernel
def along(u: float, direction: float) -> float:
    """How a wheel moves, for friction: as the vehicle does, or where that slides (0) by its own
    speed u, m/s.
    """
    return direction if direction != 0.0 else min(max(u / TURNOVER_MPS, -1.0), 1.0)


@kernel
def loads(pull: float, car: SingleTrackCar) -> tuple[float, float]:
    """Front and rear axle load, N, for a wanted acceleration m/s2."""
    limit = car.front.friction * GRAVITY
    transfer = car.mass * min(max(pull, -limit), limit) * car.height
    weight = car.mass * GRAVITY * car.grade_cos
    wheelbase = car.a + car.b
    front = min(max((weight * car.b - transfer) / wheelbase, 0.0), weight)  # (6)
    return front, weight - front


@kernel
def wheel_forces(
    s: SingleTrackState, direction: float, gear: int, car: SingleTrackCar
) -> tuple[float, float, float, float]:
    """Fxf, Fyf, Fxr, Fyr (5)-(7), N, each along and to the left of its own wheel."""
    cosine, sine = cos(s.steer), sin(s.steer)
    left = s.vy + car.a * s.r
    ahead_front, left_front = s.vx * cosine + left * sine, left * cosine - s.vx * sine
    left_rear = s.vy - car.b * s.r
    way_front, way_rear = along(ahead_front, direction), along(s.vx, direction)
    drive = drive_force(s.vx, s.throttle, gear, car.drive)
    friction = car.drive.rolling + s.brake * car.drive.max_decel
    drive_front = drive if drive > 0.0 else drive * way_front
    drive_rear = drive if drive > 0.0 else drive * way_rear
    pull = (
        car.front_drive * drive_front + (1.0 - car.front_drive) * drive_rear - friction * way_rear
    )
    load_front, load_rear = loads(pull, car)
    share = 1.0 - REAR_BRAKE * load_rear / (load_front + load_rear)  # (7)
    wanted_front = car.mass * (car.front_drive * drive_front - share * friction * way_front)
    wanted_rear = car.mass * (
        (1.0 - car.front_drive) * drive_rear - (1.0 - share) * friction * way_rear
    )
    fx_front, fy_front = axle_force(
        left_front / floored(ahead_front), load_front, wanted_front, car.front
    )
    fx_rear, fy_rear = axle_force(left_rear / floored(s.vx), load_rear, wanted_rear, car.rear)
    return fx_front, fy_front, fx_rear, fy_rear


@inner_kernel
def rate(
    s: SingleTrackState,
    command: tuple[float, float, float],
    moves: bool,
    direction: float,
    gear: int,
    car: SingleTrackCar,
) -> SingleTrackState:
    """(1)-(8): the state's rate; only the actuators move where the vehicle does not."""
    steer = steer_rate(s.steer, command[0], car.steering)
    throttle, brake = (
        (command[1] - s.throttle) / car.throttle_lag,
        (command[2] - s.brake) / car.brake_lag,
    )
    if not moves:
        return SingleTrackState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, steer, throttle, brake)
    fx_front, fy_front, fx_rear, fy_rear = wheel_forces(s, direction, gear, car)
    cosine, sine = cos(s.steer), sin(s.steer)
    side = fy_front * cosine + fx_front * sine
    v_lat = s.vy - car.b * s.r
    return SingleTrackState(
        s.vx * cos(s.yaw) - v_lat * sin(s.yaw),  # (1)
        s.vx * sin(s.yaw) + v_lat * cos(s.yaw),
        s.r,
        (fx_front * cosine - fy_front * sine + fx_rear) / car.mass
        - car.drive.drag * s.vx * abs(s.vx)
        - GRAVITY * car.grade_sin
        + s.r * s.vy,  # (2)
        (side + fy_rear) / car.mass - s.r * s.vx,  # (3)
        (car.a * side - car.b * fy_rear) / car.inertia,  # (4)
        steer,
        throttle,
        brake,  # (8)
    )


@inner_kernel
def moved(s: SingleTrackState, k: SingleTrackState, h: float) -> SingleTrackState:
    """The state after `h` s at a constant rate."""
    return SingleTrackState(
        s.x + h * k.x,
        s.y + h * k.y,
        s.yaw + h * k.yaw,
        s.vx + h * k.vx,
        s.vy + h * k.vy,
        s.r + h * k.r,
        s.steer + h * k.steer,
        s.throttle + h * k.throttle,
        s.brake + h * k.brake,
    )


@inner_kernel
def runge_kutta(
    s: SingleTrackState,
    command: tuple[float, float, float],
    moves: bool,
    direction: float,
    gear: int,
    car: SingleTrackCar,
    h: float,
) -> SingleTrackState:
    """One classical step of order 4 over `h` s."""
    k1 = rate(s, command, moves, direction, gear, car)
    k2 = rate(moved(s, k1, 0.5 * h), command, moves, direction, gear, car)
    k3 = rate(moved(s, k2, 0.5 * h), command, moves, direction, gear, car)
    k4 = rate(moved(s, k3, h), command, moves, direction, gear, car)
    return moved(moved(moved(moved(s, k1, h / 6.0), k2, h / 3.0), k3, h / 3.0), k4, h / 6.0)


@inner_kernel
def is_moving(s: SingleTrackState, gear: int, car: SingleTrackCar) -> bool:
    """Whether the vehicle moves, or is about to: forwards only."""
    if s.vx != 0.0 or slides(s, car):
        return True
    pull = drive_force(0.0, s.throttle, gear, car.drive) - GRAVITY * car.grade_sin
    return pull > car.drive.rolling + s.brake * car.drive.max_decel


@inner_kernel
def heading_of(s: SingleTrackState, car: SingleTrackCar) -> float:
    """1 forwards, -1 backwards, 0 where it slides (`along`)."""
    if slides(s, car):
        return 0.0
    return -1.0 if s.vx < 0.0 else 1.0


@kernel
def substeps(vx: float, dt: float, limit: float, car: SingleTrackCar) -> int:
    """How many sub-steps `dt` s take, none longer than `limit` s."""
    front, rear = car.front.cornering, car.rear.cornering
    trace = (front + rear) / car.mass + (car.a * car.a * front + car.b * car.b * rear) / car.inertia
    return max(ceil(dt / min(limit, STABLE * floored(vx) / trace) - 1e-9), 1)


@kernel
def advance(
    s: SingleTrackState,
    box: Gearbox,
    command: tuple[float, float, float],
    car: SingleTrackCar,
    dt: float,
    steps: int,
) -> tuple[SingleTrackState, Gearbox]:
    """State and gearbox after holding `command` (steer, throttle, brake) for `dt` s, in `steps`
    equal sub-steps.
    """
    h = dt / steps
    for _ in range(steps):
        asked = (command[0], throttle_target(command[1], box), command[2])
        moves, direction = is_moving(s, box.gear, car), heading_of(s, car)
        after = runge_kutta(s, asked, moves, direction, box.gear, car, h)
        if (after.vx * s.vx < 0.0 or (s.vx == 0.0 and after.vx < 0.0)) and not slides(after, car):
            until = h * s.vx / (s.vx - after.vx)
            stop = runge_kutta(s, asked, moves, direction, box.gear, car, until)
            stop = SingleTrackState(
                stop.x, stop.y, stop.yaw, 0.0, 0.0, 0.0, stop.steer, stop.throttle, stop.brake
            )
            after = runge_kutta(stop, asked, False, 1.0, box.gear, car, h - until)
        s, box = after, shifted(box, after.vx, command[1], car.drive, h)
    return s, box


@kernel
def motion(
    s: SingleTrackState,
    box: Gearbox,
    command: tuple[float, float, float],
    car: SingleTrackCar,
    t: float,
) -> Motion:
    """The motion at `t` under a command.

    The curvature is that of the rear axle's path while the vehicle moves faster than 2 SLIP_MPS,
    that of the wheel angle below SLIP_MPS, and in between a mixture, because a path has no
    curvature at standstill.
    """
    k = rate(s, command, is_moving(s, box.gear, car), heading_of(s, car), box.gear, car)
    v_lat = s.vy - car.b * s.r
    speed = sqrt(s.vx * s.vx + v_lat * v_lat)
    share = min(max(speed / SLIP_MPS - 1.0, 0.0), 1.0)
    kappa = (1.0 - share) * tan(s.steer) / (car.a + car.b)
    if share > 0.0:
        ahead, left = k.vx - s.r * v_lat, k.vy - car.b * k.r + s.r * s.vx
        kappa += share * (s.vx * left - v_lat * ahead) / speed**3
    return t, s.x, s.y, s.yaw, s.vx, k.vx, kappa, s.steer, s.r, v_lat


@kernel
def step(
    s: SingleTrackState,
    box: Gearbox,
    line: Pending,
    command: tuple[float, float, float],
    car: SingleTrackCar,
    t: float,
    dt: float,
) -> tuple[SingleTrackState, Gearbox, Pending, Motion]:
    """State, gearbox, brake commands on their way and motion after holding `command` for `dt` s
    from `t` on.
    """
    end = line.now_ns + round(dt * 1e9)
    line = commanded(line, command[2])
    held = command
    while line.now_ns < end:
        span, brake, line = next_span(line, end)
        held = (command[0], command[1], brake)
        s, box = advance(s, box, held, car, span, substeps(s.vx, span, car.substep, car))
    return s, box, line, motion(s, box, held, car, round((t + dt) * 1e9) / 1e9)


class SingleTrack:
    """A single track with tyres, load transfer and drive train.

    A `replan.replay.vehicle.base.Vehicle`.

    Args:
        parameters: Of the ego.
        start: Where and how fast it moves at first. It corners steadily along the start's curvature
            (as far as the tyres allow), so steering, slip and yaw rate come from the model and not
            from the start. It is not driven in reverse: a negative speed is taken as 0.
        tyre: As annotated; `tyre_stiffness` and `grade` likewise.

    Attributes:
        model: The numbers of (1)-(8); `numbers` likewise, as plain tuples.
        inner: The state of (1)-(8); `box` is the gearbox, `brakes` the brake commands on their way.

    Raises:
        ConfigError: A keyword has an invalid value.
    """

    has_rigid_tyres = False
    own_controller: Controller | None = None

    def __init__(
        self,
        parameters: VehicleParameters,
        start: EgoState,
        *,
        tyre: Annotated[
            str, Meta(description="Name in `replan.replay.vehicle.tyres.TYRES`.")
        ] = "pacejka",
        tyre_stiffness: TyreStiffness = 1.0,
        grade: Annotated[float, Meta(description="Rise over run, positive uphill.")] = 0.0,
    ) -> None:
        self.powertrain = Drivetrain(parameters)
        self.model = car_of(
            parameters, self.powertrain, tyre=tyre, tyre_stiffness=tyre_stiffness, grade=grade
        )
        self.numbers: Plain = plain(self.model)
        self.inner = cornering(self.model, start, self.powertrain)
        self.box = self.powertrain.gearbox(self.inner.vx, self.inner.throttle)
        self.brakes = pending(parameters.brake_delay, self.inner.brake)
        held = (self.inner.steer, self.inner.throttle, self.inner.brake)
        self.state = EgoState(*motion(self.inner, self.box, held, self.model, float(start.t)))

    @property
    def actuation(self) -> Command:
        """Steering and pedals as they are."""
        return Command(self.inner.steer, self.inner.throttle, self.inner.brake)

    @property
    def gear(self) -> int:
        """The gear, counted from 1."""
        return int(self.box.gear) + 1

    def step(self, command: Command, dt: float) -> EgoState:
        """Hold the command for `dt` s."""
        held = (float(command.steer), float(command.throttle), float(command.brake))
        line = with_room(self.brakes, round(dt * 1e9))
        self.inner, self.box, self.brakes, now = step(
            self.inner, self.box, line, held, self.model, self.state.t, dt
        )
        self.state = EgoState(*now)
        return self.state


def car_of(
    p: VehicleParameters,
    train: Drivetrain,
    *,
    tyre: str = "pacejka",
    tyre_stiffness: float = 1.0,
    grade: float = 0.0,
) -> SingleTrackCar:
    """What the kernels take; ConfigError as `axle_tyres`."""
    front, rear = axle_tyres(p, tyre, float(tyre_stiffness))
    slope = atan(float(grade))
    steering: Steering = (
        float(p.max_steer),
        float(p.max_steer_rate),
        max(float(p.steer_lag), SHORTEST_LAG_S),
    )
    lags = (max(float(p.throttle_lag), SHORTEST_LAG_S), max(float(p.brake_lag), SHORTEST_LAG_S))
    return SingleTrackCar(
        front=front,
        rear=rear,
        drive=train.tables,
        mass=float(p.mass),
        inertia=float(p.yaw_inertia),
        a=float(p.cog_to_front),
        b=float(p.cog_to_rear),
        height=float(p.cog_height),
        front_drive=float(p.drive_front_share),
        steering=steering,
        throttle_lag=lags[0],
        brake_lag=lags[1],
        grade_sin=sin(slope),
        grade_cos=cos(slope),
        substep=min(MAX_SUBSTEP_S, 0.5 * min(steering[2], *lags)),
    )


def cornering(car: SingleTrackCar, start: EgoState, train: Drivetrain) -> SingleTrackState:
    """The steady state at the start's speed, curvature and acceleration, each as far as the vehicle
    can.
    """
    v = max(float(start.v), 0.0)
    r = v * float(start.kappa)
    steer = atan((car.a + car.b) * start.kappa)
    v_lat = 0.0
    if v >= SLIP_MPS:
        pull = min(
            max(v * r, -0.9 * car.front.friction * GRAVITY), 0.9 * car.front.friction * GRAVITY
        )
        front, rear = loads(start.a, car)
        share = car.mass * pull / (car.a + car.b)
        v_lat = v * slip_for(share * car.a, rear, car.rear)
        steer = atan2(v_lat + (car.a + car.b) * r, v) - atan(
            slip_for(share * car.b, front, car.front)
        )
    steer = min(max(steer, -car.steering[0]), car.steering[0])
    throttle, brake = steady_pedals(train, start.a, v)
    return SingleTrackState(
        float(start.x),
        float(start.y),
        float(start.yaw),
        v,
        v_lat + car.b * r,
        r,
        steer,
        throttle,
        brake,
    )
