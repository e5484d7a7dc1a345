"""The perfect vehicle: it is where its plan is, so that only planning is judged; the bound of every controller.

It is its own controller: given the plan at each control step, it answers with the command that a kinematic bicycle
without lags would need, and moves along the plan's path as `replay.vehicle.plan_path` has it.
"""

from __future__ import annotations

from math import atan

from logs.states import Command, EgoState
from logs.trace import Plan
from logs.vehicle import VehicleParameters
from replay.vehicle.pedal_map import PedalPowertrain
from replay.vehicle.plan_path import PlanPath, Tracker, path_point


class Perfect:
    """Is where its plan is; both a `replay.vehicle.base.Vehicle` and a `replay.vehicle.base.Controller`.

    Args:
        parameters: Of the ego; they limit nothing.
        start: Where it is until its first step.
    """

    has_rigid_tyres = True
    notes: tuple[str, ...] = ()

    def __init__(self, parameters: VehicleParameters, start: EgoState) -> None:
        self.powertrain = PedalPowertrain(parameters)
        self.state = start
        self.actuation = Command(start.steer, 0.0, 0.0)
        self._wheelbase = parameters.wheelbase
        self._tracker = Tracker()
        self._path: PlanPath | None = None

    @property
    def own_controller(self) -> Perfect:
        """Itself."""
        return self

    def control(self, state: EgoState, plan: Plan) -> Command:
        """Take the plan to follow; the command that would drive it."""
        self._path = self._tracker.path(plan)
        return self._command(self._on_path(self._path, state.t))

    def step(self, command: Command, dt: float) -> EgoState:
        """Be on the plan `dt` s later; the command moves nothing.

        Raises:
            RuntimeError: It has not been given a plan.
        """
        if self._path is None:
            raise RuntimeError("the perfect vehicle needs a plan (`control`) before its first step")
        self.state = self._on_path(self._path, round((self.state.t + dt) * 1e9) / 1e9)
        self.actuation = command
        return self.state

    def _on_path(self, path: PlanPath, t: float) -> EgoState:
        station, v, a = path.timed(t)
        x, y, yaw, kappa = path_point(path.knots, station)
        return EgoState(t, x, y, yaw, v, a, kappa, atan(self._wheelbase * kappa), v * kappa)

    def _command(self, state: EgoState) -> Command:
        train = self.powertrain
        beyond = state.a - train.coasting(state.v)
        throttle = min(max(beyond / train.full_throttle(state.v), 0.0), 1.0)
        return Command(state.steer, throttle, min(max(-beyond / train.full_brake(state.v), 0.0), 1.0))
