"""Model predictive control: trajectory tracking of lateral and longitudinal motion together.

(1) J = sum over k of |xi_k|^2_Q + |u_k|^2_R_u + |u_k - u_(k-1)|^2_R_du        the paper's eq. 17
    The paper calls R_u the weight of the change and R_u_rate that of the magnitude; the names here
    say what they weigh.
(2) subject to the prediction and limits of `replan.replay.control.mpc_model` (deviations from exact
    following of the plan)

The plan is resampled by quintic polynomials (`plan_resampling`). The weights apply to the
differences from the inputs of exact following, because weights on the inputs themselves would pull
the ego off a plan that accelerates.

One solve per `period_s` (20 Hz), warm-started; between two the steering goes on at the solved rate
and the acceleration is held. The actuators' lag is in the prediction of the acceleration and is
inverted for the steering and the plan:

(3) steer command   = that of exact following + steer_0 + w (tau + lag + period / 2)
(4) acceleration    = a_plan, led by the pedal's dead time and lag (`pedals` (3)), + a

The prediction starts when a present command takes effect (`estimation`: the delay is learned), with
the wheel angle of the actuator's model under the commands so far. A controller that started from
the measured angle would take back commands that a late actuator has not executed yet.

A plan has times, so a plan that arrives late is followed from its present station. Without a
solution, DLQR and dual-loop PID command until the next solve; `notes` report how often and why.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from math import nan
from typing import Annotated

import numpy as np
from msgspec import Meta
from scipy import sparse

from replan.core.arrays import FloatArray, IntArray
from replan.core.settings import Config, NotNegative, Positive
from replan.logs.plan import Plan
from replan.logs.states import Command, EgoState
from replan.logs.vehicle import VehicleParameters
from replan.planners.solver import QPConfig, QPResult, QuadraticProgram
from replan.replay.control import pedals
from replan.replay.control.estimation import (
    SlipMemory,
    SteeringDelay,
    lateral_deviation,
    learn,
    slip_model,
)
from replan.replay.control.lateral_model import (
    command_series,
    following_at,
    lateral_table,
    slip_table,
    steer_for,
)
from replan.replay.control.mpc_model import (
    E_A,
    INPUTS,
    LIMITS,
    PATTERN_A,
    PATTERN_B,
    POLYGON,
    SIDES,
    SIGMA,
    STATES,
    PedalLags,
    entered,
    limits,
    predicted,
)
from replan.replay.control.plan_resampling import resampled
from replan.replay.vehicle.base import Controller, Powertrain
from replan.replay.vehicle.drivetrain import SHORTEST_LAG_S
from replan.replay.vehicle.plan_path import Deviation, PlanPath, Tracker
from replan.replay.vehicle.state_records import ego_record, new_record
from replan.replay.vehicle.tyres import GRAVITY

RESAMPLED_S = 0.05
WIDTH = INPUTS + STATES
"""Variables of a step: u_k, xi_(k+1)."""
SCALE = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.3, 1.0, 0.3])
"""Usual sizes of a step's variables, for the solver."""
USUAL_DYNAMICS, USUAL_SIDE_MPS2 = 0.1, 30.0
"""Usual sizes of entries, for the solver: of A and B, and of the lateral acceleration per sigma."""
ABSENT = -1
"""The place of an entry that is always 0."""


@dataclass(frozen=True)
class MpcConfig(Config):
    """Horizon and weights of (1)."""

    steps: Annotated[int, Meta(ge=2)] = 20
    """Number of steps of the horizon."""
    step_s: Positive = 0.1
    """Length of a step of the prediction."""
    period_s: Positive = 0.05
    """Time between two solves."""
    station_weight: NotNegative = 1.0
    """Weight of the squared error along the path, 1/m2."""
    speed_weight: NotNegative = 1.0
    """Weight of the squared error of the speed, (s/m)2."""
    lateral_weight: Positive = 1.0
    """Weight of the squared error across the path, 1/m2."""
    heading_weight: NotNegative = 1.0
    """Weight of the squared error of the heading, 1/rad2."""
    steer_weight: NotNegative = 40.0
    """Weight of the squared deviation of the steering angle (sigma), 1/rad2."""
    accel_weight: NotNegative = 0.5
    """Weight of the squared deviation of the acceleration, (s2/m)2."""
    steer_rate_weight: NotNegative = 0.1
    """Weight of the squared deviation of the steering rate (w), (s/rad)2."""
    accel_change_weight: NotNegative = 0.5
    """Weight of the squared change of the acceleration from step to step, (s2/m)2."""
    steer_rate_change_weight: NotNegative = 0.02
    """Weight of the squared change of w from step to step, (s/rad)2."""
    terminal: NotNegative = 5.0
    """Factor on the weights of errors at the last step."""
    speed_mps: Positive = 12.0
    """The weights of the steering grow with the speed over this one (v_0 of the prediction's (3)).
    """
    friction_share: Annotated[float, Meta(gt=0.0, le=1.0)] = 0.95
    """Share of the tyres' friction that may be used."""

    @property
    def state_weights(self) -> tuple[float, ...]:
        """Diagonal of Q, in the order of xi."""
        steer = self.steer_weight
        return (
            self.station_weight,
            self.speed_weight,
            0.0,
            self.lateral_weight,
            0.0,
            self.heading_weight,
            0.0,
            steer,
        )

    @property
    def input_weights(self) -> tuple[float, float]:
        """Diagonal of R_u."""
        return self.accel_weight, self.steer_rate_weight

    @property
    def change_weights(self) -> tuple[float, float]:
        """Diagonal of R_du."""
        return self.accel_change_weight, self.steer_rate_change_weight


class TrackingProgram:
    """(1)-(2) as a quadratic program in (u_0, xi_1, u_1, ...

    xi_n); set up once, refilled at each solve.
    """

    def __init__(self, config: MpcConfig) -> None:
        self._config = config
        n = config.steps
        A, self._places = _pattern(n)
        self._lower, self._upper = np.zeros(n * (STATES + LIMITS)), np.zeros(n * (STATES + LIMITS))
        self._q = np.zeros(n * WIDTH)
        self._program = QuadraticProgram(
            "mpc",
            cost_matrix(config),
            A,
            equalities=n * STATES,
            scale=np.tile(SCALE, n),
            config=QPConfig(eps=1e-4),
        )

    def solve(
        self,
        xi: FloatArray,
        before: FloatArray,
        A: FloatArray,
        B: FloatArray,
        bounds: tuple[FloatArray, FloatArray, FloatArray],
        *,
        fresh: bool,
    ) -> QPResult:
        """The inputs and deviations from `xi` `(8,)` on, after the input `before` `(2,)`.

        Args:
            xi: Deviation now.
            before: Input of the step before.
            A: `(n, 8, 8)`.
            B: `(n, 8, 2)`.
            bounds: From `mpc_model.limits`.
            fresh: Forget the last solution.
        """
        lower, upper, sides = bounds
        split = len(A) * STATES
        self._program.refill(_entries(A, B, sides)[self._places])
        self._lower[:STATES] = self._upper[:STATES] = A[0] @ xi
        self._lower[split:], self._upper[split:] = lower.ravel(), upper.ravel()
        self._q[:INPUTS] = -np.array(self._config.change_weights) * before
        return self._program.solve(self._q, self._lower, self._upper, fresh=fresh)


def cost_matrix(config: MpcConfig) -> sparse.csc_matrix:
    """P of (1), so that J / 2 = 1/2 z' P z + q' z + constant."""
    n = config.steps
    P = np.zeros((n * WIDTH, n * WIDTH))
    for k in range(n):
        u = slice(k * WIDTH, k * WIDTH + INPUTS)
        xi = slice(u.stop, u.stop + STATES)
        P[xi, xi] = np.diag(config.state_weights) * (config.terminal if k == n - 1 else 1.0)
        P[u, u] += np.diag(config.input_weights) + np.diag(config.change_weights)
        if k:
            last = slice(u.start - WIDTH, u.start - WIDTH + INPUTS)
            P[last, last] += np.diag(config.change_weights)
            P[last, u] -= np.diag(config.change_weights)
            P[u, last] -= np.diag(config.change_weights)
    return sparse.csc_matrix(P)


def _pattern(n: int) -> tuple[sparse.csc_matrix, IntArray]:
    """The program's matrix with entries of usual size, and the place of each in `_entries`."""
    counts = np.cumsum([0, n * STATES * INPUTS, n * STATES * STATES, n * SIDES * 2])
    of_B, of_A, of_sides = (
        np.arange(first, end).reshape(n, -1, width)
        for (first, end), width in zip(pairwise(counts), (INPUTS, STATES, 2), strict=True)
    )
    of_one = counts[-1]
    variables = np.arange(n * WIDTH).reshape(n, WIDTH)
    inputs, states = variables[:, :INPUTS], variables[:, INPUTS:]
    dynamics = np.arange(n * STATES).reshape(n, STATES)
    bounds = n * STATES + np.arange(n * LIMITS).reshape(n, LIMITS)
    polygon = bounds[:, POLYGON:]

    places = np.full((n * (STATES + LIMITS), n * WIDTH), ABSENT)
    places[dynamics[:, :, None], inputs[:, None]] = np.where(PATTERN_B, of_B, ABSENT)
    places[dynamics[1:, :, None], states[:-1, None]] = np.where(PATTERN_A, of_A[1:], ABSENT)
    sizes = np.full(places.shape, USUAL_DYNAMICS)
    limited = np.column_stack([inputs, states[:, SIGMA]])
    for rows, columns in ((dynamics, states), (bounds[:, :POLYGON], limited)):
        places[rows, columns], sizes[rows, columns] = of_one, 1.0
    for side, (state, size) in enumerate(((E_A, 1.0), (SIGMA, USUAL_SIDE_MPS2))):
        columns = states[:, [state]]
        places[polygon, columns], sizes[polygon, columns] = of_sides[:, :, side], size

    columns, rows = np.nonzero(places.T != ABSENT)
    A = sparse.csc_matrix((sizes[rows, columns], (rows, columns)), places.shape)
    return A, places[rows, columns]


def _entries(A: FloatArray, B: FloatArray, sides: FloatArray) -> FloatArray:
    """The numbers in the program's matrix: of the dynamics, of the polygon, and 1."""
    return np.concatenate([-B.ravel(), -A.ravel(), sides.ravel(), [1.0]])


class Mpc:
    """(1)-(4). See `replan.replay.vehicle.base.Controller`.

    Args:
        parameters: Of the ego.
        powertrain: Its longitudinal plant.
        period: Between two commands, s.
        fallback: Controller that drives without a solution.
        delay: Learned delay of the steering; the fallback may read it too.
        config: Horizon and weights.
    """

    def __init__(
        self,
        parameters: VehicleParameters,
        powertrain: Powertrain,
        period: float,
        fallback: Controller,
        delay: SteeringDelay | None = None,
        config: MpcConfig | None = None,
    ) -> None:
        self._p, self._train = parameters, powertrain
        self._period, self._fallback = period, fallback
        self._config = config or MpcConfig()
        self._table = lateral_table(parameters, self._config.step_s)
        self._slips = slip_table(parameters)
        self._lag = max(parameters.steer_lag, SHORTEST_LAG_S)
        self._every = max(round(self._config.period_s / period), 1)
        self._program = TrackingProgram(self._config)
        self._slip_model, self._slip = slip_model(parameters, period), new_record(SlipMemory)
        self._delay = delay or SteeringDelay(parameters, period)
        self._tracker = Tracker(partial(resampled, step=RESAMPLED_S))
        self._pedal, self._stop = new_record(pedals.PedalMemory), new_record(pedals.StopMemory)
        self._lead = nan
        self._stands = self._solved = False
        self._since = 0  # control periods since the vehicle drives
        self._input: FloatArray = np.zeros(INPUTS)
        self._steer = self._steer_rate = 0.0
        self._solves = self._falls = 0
        self._first_fall = ""

    @property
    def notes(self) -> tuple[str, ...]:
        """How often the fallback was used and why, in one sentence."""
        if not self._falls:
            return ()
        how_often = f"{self._falls} of {self._solves} solves (first {self._first_fall})"
        return (f"MPC found no solution in {how_often}: DLQR and PID drove",)

    def control(self, state: EgoState, plan: Plan) -> Command:
        """The command for the next control period."""
        path = self._tracker.path(plan)
        self._delay.observe(state.steer)
        other = self._fallback.control(state, plan)
        self._stands = pedals.stands(self._stands, state.v, state.t, path.times)
        if self._stands:
            self._since, self._solved = 0, False
            self._lead, self._input = nan, np.zeros(INPUTS)
            self._delay.rest()
            throttle, brake = pedals.hold(self._pedal, state.v, state.a)
            return Command(state.steer, throttle, brake)
        off = path.deviation(state)
        learn(self._slip, self._slip_model, ego_record(state))
        if self._since % self._every == 0:
            self._solve(state, path, off)
        tau = self._period * (self._since % self._every)
        self._since += 1
        command = other
        if self._solved:
            train, t, v = self._train.pedal_map, state.t, state.v
            _, angle = following_at(self._slips, self._p.wheelbase, self._ratios, v)
            foot = off.foot + v * self._delay.seconds
            steer = steer_for(path.knots, foot, v, command_series(angle, self._lag, self._period))
            steer += self._steer + self._steer_rate * (tau + self._lag + 0.5 * self._period)  # (3)
            steer = min(max(steer, -self._p.max_steer), self._p.max_steer)
            led, self._lead = pedals.compensated(self._lead, train, path.times, t, v, self._period)
            wanted = led + float(self._input[0])  # (4)
            wanted = pedals.eased(
                self._stop, train, path.times, t, v, state.a, wanted, self._period
            )
            throttle, brake = pedals.press(self._pedal, train, wanted, v)
            command = Command(float(steer), throttle, brake)
        self._delay.record(command.steer)
        return command

    @property
    def _ratios(self) -> tuple[float, float]:
        return float(self._slip.front), float(self._slip.rear)

    def _solve(self, state: EgoState, path: PlanPath, off: Deviation) -> None:
        """Solve (1)-(2) from the deviation xi now."""
        config, delay = self._config, self._delay
        p, v = self._p, state.v
        train = self._train.pedal_map
        lags = PedalLags(train.throttle_lag, train.brake_lag, self._train.coasting(v))
        along = entered(
            path.times,
            path.knots,
            self._slips,
            p.wheelbase,
            self._ratios,
            lags,
            state.t,
            off.foot + v * delay.seconds,
            v,
            config.step_s,
            config.steps,
        )
        A, B = predicted(along, self._table, config.speed_mps, config.step_s)
        grip = config.friction_share * p.tyre_friction * GRAVITY
        bounds = limits(
            along, train, grip, (p.max_steer, p.max_steer_rate), config.speed_mps, config.step_s
        )
        slip, angle = following_at(self._slips, p.wheelbase, self._ratios, v)
        now = lateral_deviation(ego_record(state), off, path.knots, slip)
        y = delay.predict(now, path.knots, off.foot, v, angle)
        scale = 1.0 + (v / config.speed_mps) ** 2
        sigma = scale * (delay.settled - along.steer[0])
        xi = np.array([off.station, off.speed, state.a - along.a[0], *y, sigma])
        result = self._program.solve(xi, self._input, A, B, bounds, fresh=not self._solved)
        self._solved, self._solves = result.report.solved, self._solves + 1
        if not self._solved:
            self._falls += 1
            self._first_fall = self._first_fall or f"at {state.t:.2f} s: {result.report.status}"
        self._input = result.x[:INPUTS].copy()
        self._steer, self._steer_rate = xi[SIGMA] / scale, self._input[1] / scale
