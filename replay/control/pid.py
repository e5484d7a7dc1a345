"""The dual-loop PID: station error -> speed -> acceleration.

(1) v_wanted = v_plan - clip(station_gain * e_station, -station_limit, station_limit)     outer loop, e = ego - plan
(2) e        = v_wanted - v
(3) a        = a_plan + kp e + ki int(e) dt            inner loop; a_plan led by the pedal's lag (`pedals.Lead`)
(4) a within what the vehicle can do at this speed; the integral stands still while it would push a further out of it
    (conditional integration), so that it does not wind up.
"""

from __future__ import annotations

from dataclasses import dataclass

from logs.errors import ConfigError
from logs.states import EgoState
from replay.control.pedals import Lead
from replay.control.tracking import Deviation, PlanPath
from replay.vehicle.base import Powertrain


@dataclass(frozen=True)
class PidConfig:
    """Gains of (1)-(3).

    Attributes:
        station_gain: Speed per station error, 1/s.
        station_limit_mps: The most speed that the outer loop adds or takes.
        kp: Acceleration per speed error, 1/s.
        ki: Acceleration per integrated speed error, 1/s2.
    """

    station_gain: float = 0.5
    station_limit_mps: float = 3.0
    kp: float = 1.5
    ki: float = 0.3

    def __post_init__(self) -> None:
        for name in ("station_gain", "station_limit_mps", "kp", "ki"):
            if not 0.0 <= getattr(self, name) < float("inf"):
                raise ConfigError(f"dual-loop PID: {name} must not be negative, got {getattr(self, name)}")


class DualLoopPid:
    """(1)-(4); remembers the integral. See `replay.control.base.LongitudinalLaw`."""

    def __init__(self, powertrain: Powertrain, period: float, config: PidConfig | None = None) -> None:
        self._train = powertrain
        self._period = period
        self._config = config or PidConfig()
        self._integral = 0.0
        self._lead = Lead(powertrain, period)

    def rest(self) -> None:
        """Forget the integral, and what was commanded."""
        self._integral = 0.0
        self._lead.rest()

    def accelerate(self, state: EgoState, path: PlanPath, off: Deviation) -> float:
        """Acceleration to command, m/s2."""
        gains, train = self._config, self._train
        v_plan = path.timed(state.t)[1]
        v_wanted = v_plan - min(
            max(gains.station_gain * off.station, -gains.station_limit_mps), gains.station_limit_mps
        )
        error = v_wanted - state.v
        wanted = self._lead.command(path, state.t, state.v) + gains.kp * error + gains.ki * self._integral
        coast = train.coasting(state.v)
        lowest, highest = coast - train.full_brake(state.v), coast + train.full_throttle(state.v)
        if (wanted < highest or error < 0.0) and (wanted > lowest or error > 0.0):
            self._integral += self._period * error
        return min(max(wanted, lowest), highest)
