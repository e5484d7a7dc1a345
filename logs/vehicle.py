"""Vehicle parameters: numbers only, shared by planner, controller, vehicle model and metrics."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class VehicleParameters:
    """Dimensions, masses, tyres and limits of one vehicle.

    Defaults: BMW 320i as identified in commonroad-vehicle-models (vehicle 2); actuator lags and pedal maxima
    are round figures of a passenger car.

    Attributes:
        length: Bumper to bumper, m.
        width: m, without mirrors.
        wheelbase: m.
        rear_overhang: Rear axle to rear bumper, m.
        mass: kg.
        yaw_inertia: kg m2.
        cog_to_front: Centre of gravity to front axle, m.
        cornering_front: Cornering stiffness of the front axle, N/rad, positive.
        cornering_rear: The same of the rear axle.
        max_steer: Front wheel angle, rad.
        max_steer_rate: rad/s.
        steer_lag: Time constant of the steering, s.
        max_accel: At full throttle from standstill, m/s2.
        max_power: At the wheels, W per kg of mass: full throttle gives min(max_accel, max_power / v).
        max_decel: At full brake, m/s2, positive.
        throttle_lag: Time constant, s.
        brake_lag: Time constant, s.
        drag: Aerodynamic deceleration per v squared, 1/m.
        rolling: Rolling deceleration, m/s2.
    """

    length: float = 4.508
    width: float = 1.610
    wheelbase: float = 2.578904
    rear_overhang: float = 0.9
    mass: float = 1093.3
    yaw_inertia: float = 1791.6
    cog_to_front: float = 1.156195
    cornering_front: float = 66_000.0
    cornering_rear: float = 61_000.0
    max_steer: float = 0.61
    max_steer_rate: float = 0.4
    steer_lag: float = 0.1
    max_accel: float = 4.5
    max_power: float = 80.0
    max_decel: float = 9.0
    throttle_lag: float = 0.2
    brake_lag: float = 0.1
    drag: float = 4.0e-4
    rolling: float = 0.12

    def __post_init__(self) -> None:
        for name in ("length", "width", "wheelbase", "mass", "max_steer", "max_decel"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"vehicle {name} must be positive, got {getattr(self, name)}")
        if not 0.0 <= self.rear_overhang <= self.length - self.wheelbase:
            raise ValueError("vehicle rear_overhang must lie between 0 and length - wheelbase")

    @property
    def axle_to_front(self) -> float:
        """Rear axle to front bumper, m."""
        return self.length - self.rear_overhang

    @property
    def axle_to_center(self) -> float:
        """Rear axle to the centre of the box, m, forward."""
        return self.length / 2.0 - self.rear_overhang

    @property
    def max_kappa(self) -> float:
        """Curvature at full steering lock, 1/m."""
        from math import tan

        return tan(self.max_steer) / self.wheelbase
