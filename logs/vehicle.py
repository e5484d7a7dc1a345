"""Vehicle parameters: numbers only, shared by planner, controller, vehicle model and metrics.

The parameters of known vehicles, with their sources, are files in `logs/vehicles`
(`vehicle_parameters(name)`).
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import files
from math import inf, tan
from typing import Any, NamedTuple

from replan.core.errors import unknown_name

VEHICLE_ASSUMED = "The log does not describe the ego's vehicle: a mid-size car is assumed"
"""First words of the note on a log that does not describe a vehicle.

A converted log keeps the note.
"""
SIZES_M = (0.01, 100.0)
"""Smallest and greatest length, width and wheelbase, m, from a model to a road train: with others,
equations of motion and grids overflow.
"""


@dataclass(frozen=True)
class VehicleParameters:
    """Dimensions, masses, tyres, drive and limits of one vehicle.

    Defaults: dimensions and masses of the BMW 320i as identified in commonroad-vehicle-models
    (vehicle 2); cornering stiffness (with the compliance of steering and suspension), actuator lags
    and pedal maxima are round figures of a passenger car.

    Raises:
        ValueError: A value is out of its range, or the motor is described in part only.
    """

    length: float = 4.508
    """Bumper to bumper, m."""
    width: float = 1.610
    """m, without mirrors."""
    wheelbase: float = 2.578904
    """m."""
    rear_overhang: float = 0.9
    """Rear axle to rear bumper, m."""
    mass: float = 1093.3
    """Mass, kg."""
    yaw_inertia: float = 1791.6
    """Moment of inertia about the vertical axis, kg m2."""
    cog_to_front: float = 1.156195
    """Centre of gravity to front axle, m."""
    cornering_front: float = 66_000.0
    """Cornering stiffness of the front axle at its static load, N/rad, positive."""
    cornering_rear: float = 61_000.0
    """Cornering stiffness of the rear axle likewise."""
    max_steer: float = 0.61
    """Front wheel angle, rad."""
    max_steer_rate: float = 0.4
    """rad/s."""
    steer_lag: float = 0.1
    """Time constant of the steering, s."""
    max_accel: float = 4.5
    """Acceleration at full throttle from standstill, m/s2."""
    max_power: float = 80.0
    """Power at the wheels, W per kg of mass: without a described motor, full throttle gives
    min(max_accel, max_power / v).
    """
    max_decel: float = 9.0
    """Deceleration at full brake, m/s2, positive."""
    throttle_lag: float = 0.2
    """Time constant of the throttle, s."""
    brake_lag: float = 0.1
    """Time constant of the brake, s."""
    drag: float = 4.0e-4
    """Aerodynamic deceleration per v squared, 1/m."""
    rolling: float = 0.12
    """Rolling deceleration, m/s2."""
    cog_height: float = 0.574869
    """Centre of gravity above the ground, m."""
    tyre_friction: float = 1.0489
    """Peak of tyre force over load, on a dry road."""
    tyre_shape: float = 1.3507
    """C of the magic formula of the lateral force."""
    tyre_curvature: float = -0.0074722
    """E of the magic formula."""
    tyre_load_sensitivity: float = 0.0
    """Relative loss of friction and stiffness per load, per relative rise of load over static."""
    brake_delay: float = 0.05
    """Dead time from the brake pedal to the first deceleration, s."""
    drive_front_share: float = 0.0
    """Share of the drive at the front axle, 0 to 1."""
    wheel_radius: float = 0.344
    """Rolling radius, m."""
    gears: tuple[float, ...] = ()
    """Motor speed over wheel speed (gear times axle ratio), lowest gear first; a motor without a
    gearbox has one ratio.
    """
    motor_speed: tuple[float, ...] = ()
    """Speeds at which the motor is described, rad/s, increasing; the first is idle. Empty: no motor
    is described.
    """
    motor_torque: tuple[float, ...] = ()
    """Torque at full throttle at those speeds, N m."""
    motor_overrun: tuple[float, ...] = ()
    """Drag (or recuperation) at closed throttle at those speeds, N m, positive."""
    drive_efficiency: float = 0.9
    """Efficiency from motor to wheels, 0 to 1."""
    shift_time: float = 0.2
    """Duration of a gear shift, s."""

    def __post_init__(self) -> None:
        for name in (
            "length",
            "width",
            "wheelbase",
            "mass",
            "max_steer",
            "max_decel",
            "tyre_friction",
            "wheel_radius",
        ):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"vehicle {name} must be positive, got {getattr(self, name)}")
        low, high = SIZES_M
        for name in ("length", "width", "wheelbase"):
            if not low <= getattr(self, name) <= high:
                raise ValueError(
                    f"vehicle {name} must lie between {low:g} and {high:g} m, "
                    f"got {getattr(self, name):g}"
                )
        if not 0.0 <= self.rear_overhang <= self.length - self.wheelbase:
            raise ValueError("vehicle rear_overhang must lie between 0 and length - wheelbase")
        n = len(self.motor_speed)
        if (len(self.motor_torque), len(self.motor_overrun)) != (n, n) or bool(self.gears) != bool(
            n
        ):
            raise ValueError(
                "vehicle gears, motor_speed, motor_torque and motor_overrun: give all of them or "
                "none"
            )
        if n and (
            n < 2
            or not all(
                a < b for a, b in zip((0.0, *self.motor_speed), self.motor_speed, strict=False)
            )
        ):
            raise ValueError(
                "vehicle motor_speed must have at least two values, positive and increasing"
            )
        if (
            min((*self.gears, 1.0)) <= 0.0
            or min((*self.motor_torque, *self.motor_overrun, 0.0)) < 0.0
        ):
            raise ValueError(
                "vehicle gears must be positive, motor_torque and motor_overrun not negative"
            )

    @property
    def axle_to_front(self) -> float:
        """Rear axle to front bumper, m."""
        return self.length - self.rear_overhang

    @property
    def axle_to_center(self) -> float:
        """Rear axle to the centre of the box, m, forward."""
        return self.length / 2.0 - self.rear_overhang

    @property
    def cog_to_rear(self) -> float:
        """Centre of gravity to rear axle, m."""
        return self.wheelbase - self.cog_to_front

    @property
    def max_kappa(self) -> float:
        """Curvature at full steering lock, 1/m."""
        return tan(self.max_steer) / self.wheelbase

    @property
    def top_speed(self) -> float:
        """Speed at the top speed of the motor, in the top gear, m/s; inf without a motor."""
        if not self.gears:
            return inf
        return self.motor_speed[-1] / self.gears[-1] * self.wheel_radius

    def loaded(self, mass: float) -> VehicleParameters:
        """Return the vehicle with another mass, kg.

        The forces of motor, brakes and drag stay the same.
        """
        ratio = self.mass / mass
        scaled = {
            name: ratio * getattr(self, name)
            for name in ("max_accel", "max_power", "max_decel", "drag")
        }
        return replace(self, mass=mass, **scaled)


class _Class(NamedTuple):
    """Vehicles up to a length, m, and the vehicle of `logs/vehicles` that stands for them; "": the
    default car.
    """

    longest: float
    vehicle: str
    word: str


CLASSES = (
    _Class(2.0, "delivery_robot", "a delivery robot"),
    _Class(5.4, "", "the default car"),
    _Class(7.5, "delivery_van", "a delivery van"),
    _Class(10.5, "truck", "a rigid truck"),
    _Class(13.5, "city_bus", "a city bus"),
    _Class(inf, "tractor_semitrailer", "a tractor with a semi-trailer, driven as one body"),
)
"""What a vehicle of which only some sizes are known is taken for, by its length."""


def assumed_car(sizes: Mapping[str, float], notes: list[str]) -> VehicleParameters:
    """Make the ego's vehicle of sizes, m; missing ones are those of `CLASSES`, in proportion to the
    length. Appends what it assumes to `notes`.

    ValueError if a size is not positive.
    """
    length = sizes.get("length", VehicleParameters().length)
    kind = next(kind for kind in CLASSES if length <= kind.longest)
    usual = vehicle_parameters(kind.vehicle) if kind.vehicle else VehicleParameters()
    scale = length / usual.length
    wheelbase = sizes.get("wheelbase", scale * usual.wheelbase)
    overhang = sizes.get("rear_overhang", scale * usual.rear_overhang)
    if not 0.0 < wheelbase < length:
        notes.append(
            f"The ego's wheelbase does not fit its length: it is that of {kind.word}, in "
            "proportion."
        )
        wheelbase = scale * usual.wheelbase
    if not 0.0 <= overhang <= length - wheelbase:
        notes.append(
            f"The log does not say where the ego's rear axle is in its box: as in {kind.word}, "
            "assumed."
        )
        overhang = min(scale * usual.rear_overhang, length - wheelbase)
    values: dict[str, Any] = {
        "length": length,
        "width": sizes.get("width", usual.width),
        "wheelbase": wheelbase,
        "rear_overhang": overhang,
        "cog_to_front": usual.cog_to_front * wheelbase / usual.wheelbase,
    }
    if not kind.vehicle:
        notes.append("Masses, tyres and limits of the ego's vehicle are those of the default car.")
        return replace(usual, **values)
    weight = scale * values["width"] / usual.width
    for name in ("mass", "cornering_front", "cornering_rear"):
        values[name] = weight * getattr(usual, name)
    for name in ("motor_torque", "motor_overrun"):
        values[name] = tuple(weight * number for number in getattr(usual, name))
    values["yaw_inertia"] = weight * scale**2 * usual.yaw_inertia
    notes.append(
        f"The ego's vehicle, {length:.2f} m long, is taken for {kind.word}: wheelbase "
        f"{wheelbase:.2f} m, rear overhang {overhang:.2f} m, mass {values['mass']:.0f} kg, tyres "
        "and drive in proportion where they are not stated (--car or [vehicle] states others)."
    )
    return replace(usual, **values)


def vehicle_names() -> tuple[str, ...]:
    """The vehicles of `logs/vehicles`, in alphabetical order."""
    folder = files("replan.logs") / "vehicles"
    return tuple(
        sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml"))
    )


def vehicle_parameters(name: str) -> VehicleParameters:
    """Return the parameters of a vehicle, read from its file; ConfigError if none has this name."""
    if name not in vehicle_names():
        raise unknown_name("vehicle", name, vehicle_names())
    text = (files("replan.logs") / "vehicles" / f"{name}.toml").read_text(encoding="utf-8")
    table = tomllib.loads(text)
    numbers: dict[str, Any] = {
        key: tuple(v) if isinstance(v, list) else float(v) for key, v in table.items()
    }
    return VehicleParameters(**numbers)
