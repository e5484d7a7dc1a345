"""The vehicle's seam: one method.

A vehicle owns its hidden state (actuators, slip) and is built per drive as `Class(parameters, start)`, already moving
as `start` does. Its longitudinal plant is a `Powertrain`, which controllers may invert.
"""

from __future__ import annotations

from typing import Protocol

from logs.states import Command, EgoState


class Powertrain(Protocol):
    """Pedals to acceleration, steady state: what a controller may know of the drive train."""

    @property
    def throttle_lag(self) -> float:
        """Time constant from the throttle to its acceleration, s; `brake_lag` likewise."""
        ...

    @property
    def brake_lag(self) -> float:
        """Time constant from the brake to its deceleration, s."""
        ...

    @property
    def brake_delay(self) -> float:
        """Dead time of the brake before its lag begins, s."""
        ...

    def coasting(self, v: float) -> float:
        """Acceleration at `v` (m/s) without pedals, m/s2, not positive."""
        ...

    def full_throttle(self, v: float) -> float:
        """What full throttle adds to coasting at `v`, m/s2; in proportion to the pedal."""
        ...

    def full_brake(self, v: float) -> float:
        """What full brake takes from coasting at `v`, m/s2, positive; in proportion to the pedal."""
        ...


class Vehicle(Protocol):
    """Moves the ego."""

    @property
    def state(self) -> EgoState:
        """Where the ego is now."""
        ...

    @property
    def actuation(self) -> Command:
        """What the actuators do now: they lag behind the command."""
        ...

    @property
    def powertrain(self) -> Powertrain:
        """The longitudinal plant."""
        ...

    def step(self, command: Command, dt: float) -> EgoState:
        """Hold the command for `dt` (s, positive); the state after that, its time a whole nanosecond."""
        ...
