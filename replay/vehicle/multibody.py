"""The 29-state multi-body model of commonroad-vehicle-models, driven by replan's pedals and
steering: reference plant.

Sprung and unsprung masses, roll, pitch, four wheels that spin, magic formula with combined slip and
camber (Althoff and Wuersching, "CommonRoad: Vehicle Models", 2020, section 9). The package
implements all of this; replan adds the following:

- Its inputs, steering rate and acceleration, come from replan's actuators and drive train
  (drivetrain.py): (1) u = drive - rolling - drag v^2 - brake, a torque at the wheels; held over a
  sub-step.
- It has no anti-lock brakes and no traction control: (2) drive and brake are kept below SHARE of
  what the axle that gives way first can bear, less by the lateral acceleration (friction circle).
- Its wheels are stiff at low speed, it has no standstill, it divides by the speed ahead of each
  wheel, and its tyres pull at the road where they leave it, until it diverges. So where the slowest
  wheel goes ahead (4) slower than SLOW_MPS (at low speed, in a spin), or a wheel bears nothing (5),
  the vehicle is the single-track model of the same numbers. It comes back, with its body level,
  from LEAVE_MPS on and with slip angles below CALM.
- Suspension, track and tyres are those of the package's vehicle that is nearest in mass; mass, yaw
  inertia, axle distances and friction are those of VehicleParameters. Level road only.

Integration: Runge-Kutta of order 4, sub-steps of 1 ms, shorter where the wheels' slip asks for it:
(3) h <= STABLE u I_w / (K_x R^2), K_x = p_kx1 times the static load of a wheel, u = vx
(4) ahead = min(vx, vx cos(steer) + (vy + a r) sin(steer)) - T |r| / 2        T: the wider track
(5) deflection of a tyre = z_u + R (cos(phi_u) - 1) +- T sin(phi_u) / 2 <= 0
        of its axle's unsprung mass
"""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from importlib import import_module
from math import atan, ceil, cos, exp, hypot, isfinite, nan, sin, sqrt
from typing import Any

from replan.core.errors import ConfigError
from replan.logs.states import Command, EgoState
from replan.logs.vehicle import VehicleParameters
from replan.replay.vehicle.base import Controller
from replan.replay.vehicle.drivetrain import (
    Drivetrain,
    Gearbox,
    drive_force,
    pending,
    shifted,
    spans,
    steer_rate,
    throttle_target,
)
from replan.replay.vehicle.kinematic_bicycle import MAX_SUBSTEP_S
from replan.replay.vehicle.single_track import (
    SingleTrackCar,
    SingleTrackState,
    advance,
    car_of,
    cornering,
    motion,
    substeps,
)
from replan.replay.vehicle.tyres import GRAVITY, TyreStiffness

SLOW_MPS, LEAVE_MPS, CALM = 1.0, 1.5, 0.1
SUBSTEP_S = 1e-3
STABLE = 1.2
SHARE = 0.85
SETS = (1, 2, 3)
"""Vehicles of the package: Ford Escort, BMW 320i, VW Vanagon."""
STEER, VX, YAW = 2, 3, 4
YAW_RATE, VY, WHEELS = 5, 10, range(23, 27)
FRONT_ROLL, FRONT_Z = 13, 16
REAR_ROLL, REAR_Z = 18, 21
"""Places in the package's state."""

Rates = Callable[[list[float], list[float], Any], list[float]]


class Multibody:
    """The multi-body model of 29 states of commonroad-vehicle-models.

    A `replan.replay.vehicle.base.Vehicle`.

    Args:
        parameters: Of the ego.
        start: As `SingleTrack`.
        tyre_stiffness: As annotated.

    Raises:
        ConfigError: The package commonroad-vehicle-models is not installed, or a keyword has no
            such value.
    """

    has_rigid_tyres = False
    own_controller: Controller | None = None

    def __init__(
        self, parameters: VehicleParameters, start: EgoState, *, tyre_stiffness: TyreStiffness = 1.0
    ) -> None:
        self.powertrain = Drivetrain(parameters)
        try:
            self._rates: Rates = import_module(
                "vehiclemodels.vehicle_dynamics_mb"
            ).vehicle_dynamics_mb
            self._init: Callable[..., list[float]] = import_module("vehiclemodels.init_mb").init_mb
        except ImportError:
            remedy = "needs the package commonroad-vehicle-models: pip install 'replan[multibody]'"
            raise ConfigError(f"vehicle 'multibody' {remedy}") from None
        self.package = package_parameters(parameters, tyre_stiffness)
        p, tyre = parameters, self.package.tire
        weight = p.mass * GRAVITY / p.wheelbase * -tyre.p_ky1
        stiffness = {
            "cornering_front": weight * p.cog_to_rear,
            "cornering_rear": weight * p.cog_to_front,
        }
        self.car = car_of(replace(p, **stiffness, tyre_load_sensitivity=0.0), self.powertrain)
        self.inner = cornering(self.car, start, self.powertrain)
        self.box = self.powertrain.gearbox(self.inner.vx, self.inner.throttle)
        self.body: list[float] | None = None
        self._brakes = pending(parameters.brake_delay, self.inner.brake)
        self._limits = _limits(self.car, self.package)
        load = 0.5 * max(self.car.front.load, self.car.rear.load)
        # K_x R^2 / I_w of (3)
        self._stiff = float(tyre.p_kx1 * load * self.package.R_w**2 / self.package.I_y_w)
        self._reach = float(self.car.a), 0.5 * float(max(self.package.T_f, self.package.T_r))
        self._t = float(start.t)
        self._choose_model()
        self.state = self._ego_state(tuple(self.inner[6:]))

    @property
    def actuation(self) -> Command:
        """Steering and pedals as they are."""
        return Command(self.inner.steer, self.inner.throttle, self.inner.brake)

    def step(self, command: Command, dt: float) -> EgoState:
        """Hold the command for `dt` s.

        Raises:
            ConfigError: The package's model diverged.
        """
        held = (float(command.steer), float(command.throttle), 0.0)
        taking_effect, self._brakes = spans(self._brakes, float(command.brake), dt)
        for span, brake in taking_effect:
            held = (held[0], held[1], brake)
            self._choose_model()
            left = span if self.body is None else self._drive(self.body, held, span)
            if self.body is None and left > 0.0:
                steps = substeps(self.inner.vx, left, MAX_SUBSTEP_S, self.car)
                inner, box = advance(self.inner, self.box, held, self.car, left, steps)
                self.inner, self.box = SingleTrackState(*inner), Gearbox(*box)
        self._t = round((self._t + dt) * 1e9) / 1e9
        self.state = self._ego_state(held)
        return self.state

    def _choose_model(self) -> None:
        """Switch to the package's model if it is valid."""
        s, car = self.inner, self.car
        if self.body is None and slowest_wheel(s.vx, s.vy, s.r, s.steer, self._reach) > LEAVE_MPS:
            front, rear = (
                atan((s.vy + car.a * s.r) / s.vx) - s.steer,
                atan((s.vy - car.b * s.r) / s.vx),
            )
            if max(abs(front), abs(rear)) < CALM:
                x, y = s.x + car.b * cos(s.yaw), s.y + car.b * sin(s.yaw)
                self.body = self._init(
                    [x, y, s.steer, hypot(s.vx, s.vy), s.yaw, s.r, atan(s.vy / s.vx)], self.package
                )

    def _drive(self, body: list[float], held: tuple[float, float, float], span: float) -> float:
        """Sub-steps of the package's model; the actuators are exact over each (commands are
        constant).

        Returns:
            How much of the span is left where the model is not valid any more, s.

        Raises:
            ConfigError: The model diverged.
        """
        # (3)
        steps = ceil(span / min(SUBSTEP_S, STABLE * max(body[VX], SLOW_MPS) / self._stiff) - 1e-9)
        h = span / steps
        throttle, brake, car = self.inner.throttle, self.inner.brake, self.car
        left, valid = 0.0, True
        for k in range(steps):
            inputs = [
                steer_rate(body[STEER], held[0], car.steering),
                self._pull(body, throttle, brake),
            ]
            try:
                body = _runge_kutta(self._rates, body, inputs, self.package, h)
            # Division by a wheel that stands, cosine of infinity
            except (ArithmeticError, ValueError):
                body = [nan]
            if not all(map(isfinite, body)):
                remedy = "use loop.vehicle = 'single_track'"
                raise ConfigError(f"the multi-body model diverged at {self._t:.2f} s: {remedy}")
            asked = throttle_target(held[1], self.box)
            throttle = asked + (throttle - asked) * exp(-h / car.throttle_lag)
            brake = held[2] + (brake - held[2]) * exp(-h / car.brake_lag)
            self.box = Gearbox(*shifted(self.box, body[VX], held[1], car.drive, h))
            ahead = slowest_wheel(body[VX], body[VY], body[YAW_RATE], body[STEER], self._reach)
            valid = ahead >= SLOW_MPS and least_deflection(body, self.package) > 0.0
            if not valid:
                left = (steps - 1 - k) * h
                break
        self.body = body if valid else None
        x, y, yaw = body[0] - car.b * cos(body[YAW]), body[1] - car.b * sin(body[YAW]), body[YAW]
        self.inner = SingleTrackState(
            x, y, yaw, body[VX], body[VY], body[YAW_RATE], body[STEER], throttle, brake
        )
        return left

    def _pull(self, body: list[float], throttle: float, brake: float) -> float:
        """The acceleration that drive and brakes want at the wheels, m/s2."""
        car, v = self.car, body[VX]
        left = sqrt(max(1.0 - (v * body[YAW_RATE] / (car.front.friction * GRAVITY)) ** 2, 0.1))
        # (2)
        drive = min(drive_force(v, throttle, self.box.gear, car.drive), self._limits[0] * left)
        resist = brake * car.drive.max_decel + car.drive.rolling + car.drive.drag * v * abs(v)
        return max(drive - resist, -self._limits[1] * left)  # (1), (2)

    def _ego_state(self, held: tuple[float, ...]) -> EgoState:
        s, car = self.inner, self.car
        if self.body is None:
            return EgoState(*motion(s, self.box, (held[0], held[1], held[2]), car, self._t))
        inputs = [
            steer_rate(s.steer, held[0], car.steering),
            self._pull(self.body, s.throttle, s.brake),
        ]
        k = self._rates(list(self.body), inputs, self.package)
        v_lat = s.vy - car.b * s.r
        ahead, left = k[VX] - s.r * v_lat, k[VY] - car.b * k[YAW_RATE] + s.r * s.vx
        kappa = (s.vx * left - v_lat * ahead) / hypot(s.vx, v_lat) ** 3
        return EgoState(self._t, s.x, s.y, s.yaw, s.vx, k[VX], kappa, s.steer, s.r, v_lat)


def package_parameters(p: VehicleParameters, tyre_stiffness: float = 1.0) -> Any:
    """Return the package's vehicle nearest in mass, with the mass, inertia, axle distances and
    friction of `p`.

    Raises:
        ConfigError: The stiffness is not positive.
    """
    if not tyre_stiffness > 0.0:
        raise ConfigError(f"tyre_stiffness must be positive, got {tyre_stiffness}")
    setup = import_module("vehiclemodels.vehicle_parameters").setup_vehicle_parameters
    q = deepcopy(
        min(
            (setup(vehicle_id=number) for number in SETS),
            key=lambda package: abs(package.m - p.mass),
        )
    )
    q.m_s = p.mass - q.m_uf - q.m_ur
    q.m, q.I_z = float(p.mass), float(p.yaw_inertia)
    q.a, q.b = float(p.cog_to_front), float(p.cog_to_rear)
    ratio = p.tyre_friction / q.tire.p_dy1
    q.tire.p_dy1, q.tire.p_dx1 = q.tire.p_dy1 * ratio, q.tire.p_dx1 * ratio
    q.tire.p_ky1 *= tyre_stiffness
    return q


def slowest_wheel(
    vx: float, vy: float, r: float, steer: float, reach: tuple[float, float]
) -> float:
    """How fast the slowest wheel goes ahead (4), m/s; `reach`: to the front axle, half of the
    track, m.
    """
    front = vx * cos(steer) + (vy + reach[0] * r) * sin(steer)
    return min(vx, front) - reach[1] * abs(r)  # (4)


def least_deflection(body: list[float], q: Any) -> float:
    """The least deflection of the four tyres (5), m.

    Not positive where a wheel is off the ground.
    """
    axles = ((q.T_f, body[FRONT_ROLL], body[FRONT_Z]), (q.T_r, body[REAR_ROLL], body[REAR_Z]))
    return min(
        float(z + q.R_w * (cos(roll) - 1.0) - 0.5 * track * abs(sin(roll)))
        for track, roll, z in axles
    )


def _limits(car: SingleTrackCar, q: Any) -> tuple[float, float]:
    """The greatest drive and brake (2) on a straight road, m/s2; T_se and T_sb are the shares of
    the front.
    """
    wheelbase, mu = car.a + car.b, car.front.friction
    lift = mu * car.height / wheelbase

    def bears(share: float, lever: float, gain: float) -> float:
        left = share - gain * lift
        return mu * GRAVITY * lever / wheelbase / left if left > 1e-6 else 1e3

    drive = min(bears(q.T_se, car.b, -1.0), bears(1.0 - q.T_se, car.a, 1.0))
    return SHARE * drive, SHARE * min(bears(q.T_sb, car.b, 1.0), bears(1.0 - q.T_sb, car.a, -1.0))


def _runge_kutta(rates: Rates, x: list[float], u: list[float], q: Any, h: float) -> list[float]:
    """One classical step; wheels do not turn backwards."""
    k1 = rates(list(x), u, q)
    k2 = rates([a + 0.5 * h * b for a, b in zip(x, k1, strict=True)], u, q)
    k3 = rates([a + 0.5 * h * b for a, b in zip(x, k2, strict=True)], u, q)
    k4 = rates([a + h * b for a, b in zip(x, k3, strict=True)], u, q)
    after = [
        a + h / 6.0 * (p + 2.0 * (r + s) + t)
        for a, p, r, s, t in zip(x, k1, k2, k3, k4, strict=True)
    ]
    for wheel in WHEELS:
        after[wheel] = max(after[wheel], 0.0)
    return after
