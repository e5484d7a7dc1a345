"""The MPC: its reference, its model, its optimum, its limits, and what it does without a
solution.
"""

import numpy as np
import pytest
from handmade import drive, s_curve, straight
from hypothesis import given, settings, strategies as st
from scipy import sparse

from replan.logs.plan import Plan
from replan.logs.states import Command, EgoState, Trajectory
from replan.logs.vehicle import VehicleParameters
from replan.planners.solver import QPConfig, QuadraticProgram
from replan.replay.control.lateral_model import (
    body_model,
    lateral_table,
    slip_table,
    with_rigid_tyres,
)
from replan.replay.control.mpc import Mpc, MpcConfig, TrackingProgram
from replan.replay.control.mpc_model import (
    INPUTS,
    LIMITS,
    SIDES,
    STATES,
    EnteredPlan,
    PedalLags,
    entered,
    limits,
    predicted,
)
from replan.replay.control.plan_resampling import quintic, resampled
from replan.replay.vehicle.drivetrain import Drivetrain
from replan.replay.vehicle.pedal_map import NO_MOTOR, PedalMap
from replan.replay.vehicle.plan_path import PlanPath
from replan.replay.vehicle.tyres import GRAVITY

CAR = VehicleParameters()
TRAIN = Drivetrain(CAR)
PERIOD = 0.01
CONFIG = MpcConfig()


def stage(plan: Trajectory, t: float, v: float, car: VehicleParameters = CAR) -> EnteredPlan:
    """The plan as entered on it at `t` with speed `v`."""
    path = PlanPath.of(plan)
    return entered(
        path.times,
        path.knots,
        slip_table(car),
        car.wheelbase,
        (1.0, 1.0),
        PedalLags(0.2, 0.1, -0.1),
        t,
        path.timed(t)[0],
        v,
        CONFIG.step_s,
        CONFIG.steps,
    )


def wide_open(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Limits that nothing reaches."""
    return np.full((n, LIMITS), -np.inf), np.full((n, LIMITS), np.inf), np.ones((n, SIDES, 2))


@given(st.lists(st.floats(-20.0, 20.0), min_size=6, max_size=6), st.floats(0.05, 2.0))
def test_the_quintic_matches_position_speed_and_acceleration(ends: list[float], h: float) -> None:
    p0, v0, a0, p1, v1, a1 = ends
    scale = 1.0 + max(map(abs, ends)) / h**2
    np.testing.assert_allclose(quintic(*ends, h, 0.0), (p0, v0, a0), atol=1e-9 * scale)
    np.testing.assert_allclose(quintic(*ends, h, 1.0), (p1, v1, a1), atol=1e-9 * scale)
    near = [quintic(*ends, h, 0.4 + d)[0] for d in (-1e-4, 0.0, 1e-4)]
    assert quintic(*ends, h, 0.4)[1] == pytest.approx(
        (near[2] - near[0]) / (2e-4 * h), rel=1e-4, abs=1e-5 * scale
    )


def test_resampling_keeps_the_samples_and_lies_on_the_drive_between_them() -> None:
    def wavering(t: np.ndarray) -> np.ndarray:
        return 10.0 + 2.0 * np.sin(t)

    coarse, fine = (
        drive(s_curve, wavering, 12.0, step=0.2),
        drive(s_curve, wavering, 12.0, step=0.05),
    )
    seen = resampled(coarse, 0.05)
    np.testing.assert_allclose(seen.t, fine.t, atol=1e-9)
    for name, most in (
        ("x", 2e-4),
        ("y", 2e-4),
        ("yaw", 2e-4),
        ("v", 2e-3),
        ("a", 2e-2),
        ("kappa", 1e-3),
    ):
        np.testing.assert_allclose(
            getattr(seen, name), getattr(fine, name), atol=most, err_msg=name
        )
        at_knots = getattr(seen, name)[::4]
        np.testing.assert_allclose(at_knots, getattr(coarse, name), atol=1e-6, err_msg=name)


def test_plans_that_stand_or_have_one_sample_are_resampled_too() -> None:
    still = resampled(drive(straight, 0.0, 2.0), 0.05)
    assert len(still) == 41 and not still.v.any() and not still.yaw.any()
    one = drive(straight, 5.0, 1.0).between(0.0, 0.0)
    assert resampled(one, 0.05) is one


@pytest.mark.parametrize("rigid", [False, True])
@pytest.mark.parametrize("v", [3.0, 12.0, 30.0])
def test_the_prediction_is_what_the_continuous_model_does(v: float, rigid: bool) -> None:
    car = with_rigid_tyres(CAR) if rigid else CAR
    along = stage(drive(straight, v, 12.0), 1.0, v, car)
    A, B = predicted(along, lateral_table(car, CONFIG.step_s), CONFIG.speed_mps, CONFIG.step_s)
    scale, n = 1.0 + (v / CONFIG.speed_mps) ** 2, 20_000
    steer, rate, h = 0.02, -0.03, CONFIG.step_s / n
    turn = v / car.wheelbase * steer
    xi = np.array(
        [0.2, -0.3, 0.4, 0.1, 0.0 if rigid else 0.05, 0.03, turn if rigid else 0.1, scale * steer]
    )
    u = np.array([0.5, scale * rate])
    x = xi.copy()
    body = None if rigid else body_model(v, car)
    for _ in range(n):
        _, e_v, e_a, _, v_lat, e_phi, r, sigma = x
        wheel = sigma / scale
        lag = along.lag[0]
        side, spin = (
            (0.0, v / car.wheelbase * rate)
            if body is None
            else body[0] @ [v_lat, r] + body[1] * wheel
        )
        x = x + h * np.array([e_v, e_a, (u[0] - e_a) / lag, v_lat + v * e_phi, side, r, spin, u[1]])
    np.testing.assert_allclose(A[0] @ xi + B[0] @ u, x, atol=2e-4)


@settings(max_examples=10)
@given(st.integers(0, 2**31), st.sampled_from([4.0, 12.0, 25.0]))
def test_without_limits_the_program_is_the_finite_horizon_regulator(seed: int, v: float) -> None:
    """Riccati's recursion over (xi, u before) gives the same first input."""
    rng = np.random.default_rng(seed)
    along = stage(drive(s_curve, v, 20.0), 2.0, v)
    A, B = predicted(along, lateral_table(CAR, CONFIG.step_s), CONFIG.speed_mps, CONFIG.step_s)
    xi = rng.normal(size=STATES) * [0.5, 0.5, 0.3, 0.3, 0.1, 0.05, 0.1, 0.1]
    before = rng.normal(size=INPUTS) * 0.1
    n, Q = CONFIG.steps, np.diag(CONFIG.state_weights)
    Ru, Rd = np.diag(CONFIG.input_weights), np.diag(CONFIG.change_weights)
    P = np.zeros((STATES + INPUTS, STATES + INPUTS))
    P[:STATES, :STATES] = CONFIG.terminal * Q
    for k in range(n - 1, -1, -1):
        F = np.block([[A[k], np.zeros((STATES, INPUTS))], [np.zeros((INPUTS, STATES + INPUTS))]])
        G = np.vstack([B[k], np.eye(INPUTS)])
        S = np.hstack([np.zeros((INPUTS, STATES)), -Rd])
        K = np.linalg.solve(Ru + Rd + G.T @ P @ G, G.T @ P @ F + S)
        own = np.zeros_like(P)
        own[:STATES, :STATES] = Q if k else np.zeros_like(Q)
        own[STATES:, STATES:] = Rd
        P = own + F.T @ P @ F - (F.T @ P @ G + S.T) @ K
    expected = -K @ np.r_[xi, before]
    result = TrackingProgram(CONFIG).solve(xi, before, A, B, wide_open(n), fresh=True)
    assert result.report.solved
    np.testing.assert_allclose(result.x[:INPUTS], expected, atol=2e-3)


@settings(max_examples=20)
@given(st.floats(-2.0, 2.0), st.floats(-0.3, 0.3), st.floats(-2.0, 2.0))
def test_limits_are_respected(lateral: float, heading: float, speed: float) -> None:
    v = 15.0
    along = stage(drive(lambda s: np.full_like(s, 0.02), v, 12.0), 1.0, v)
    A, B = predicted(along, lateral_table(CAR, CONFIG.step_s), CONFIG.speed_mps, CONFIG.step_s)
    train = PedalMap(1.0, 1e3, 3.0, 0.0, 0.0, NO_MOTOR, NO_MOTOR, 0.1, 0.1, 0.0)
    grip = 0.7 * GRAVITY
    bounds = limits(
        along, train, grip, (CAR.max_steer, CAR.max_steer_rate), CONFIG.speed_mps, CONFIG.step_s
    )
    xi = np.array([0.0, speed, 0.0, lateral, 0.0, heading, 0.0, 0.0])
    result = TrackingProgram(CONFIG).solve(xi, np.zeros(INPUTS), A, B, bounds, fresh=True)
    assert result.report.solved, result.report.status
    z = result.x.reshape(CONFIG.steps, INPUTS + STATES)
    assert (z[:, 0] <= 1.0 + 0.03).all() and (z[:, 0] >= -3.03).all()
    scale = 1.0 + (along.speed / CONFIG.speed_mps) ** 2
    rate = z[:, 1] / scale[:-1] + np.diff(along.steer) / CONFIG.step_s
    assert np.abs(rate).max() <= CAR.max_steer_rate + 0.03
    steer = z[:, 9] / scale[1:]
    a_lat = along.speed[1:] ** 2 * (along.kappa[1:] + steer / along.d_0[1:])
    assert np.hypot(z[:, 4] + along.a[1:], a_lat).max() <= grip + 0.2


def test_a_warm_start_changes_nothing_but_the_way() -> None:
    along = stage(drive(s_curve, 12.0, 12.0), 3.0, 12.0)
    A, B = predicted(along, lateral_table(CAR, CONFIG.step_s), CONFIG.speed_mps, CONFIG.step_s)
    program, xi = TrackingProgram(CONFIG), np.array([0.1, 0.2, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
    first = program.solve(xi, np.zeros(INPUTS), A, B, wide_open(CONFIG.steps), fresh=True)
    again = program.solve(xi, np.zeros(INPUTS), A, B, wide_open(CONFIG.steps), fresh=False)
    np.testing.assert_allclose(first.x, again.x, atol=3e-3)
    assert again.report.iterations <= first.report.iterations


def test_new_numbers_in_a_program_are_a_new_program() -> None:
    rng = np.random.default_rng(4)
    P, one, two = (
        np.diag(rng.uniform(1.0, 2.0, 3)),
        rng.normal(size=(4, 3)),
        rng.normal(size=(4, 3)),
    )
    bounds, q = (np.full(4, -0.1), np.full(4, 0.2)), rng.normal(size=3)
    config = QPConfig(eps=1e-7, max_iterations=2000)
    first = QuadraticProgram("t", sparse.csc_matrix(P), sparse.csc_matrix(one), config=config)
    first.refill(sparse.csc_matrix(two).data)
    other = QuadraticProgram("t", sparse.csc_matrix(P), sparse.csc_matrix(two), config=config)
    np.testing.assert_allclose(
        first.solve(q, *bounds, fresh=True).x, other.solve(q, *bounds, fresh=True).x, atol=1e-5
    )
    with pytest.raises(ValueError, match="12 entries"):
        first.refill(np.ones(5))


class Halt:
    """A controller that brakes."""

    def control(self, state: EgoState, plan: Plan) -> Command:
        return Command(0.123, 0.0, 1.0)


def test_where_there_is_no_solution_the_fallback_drives_and_it_is_told() -> None:
    """Sideways through a curve that no tyre can hold: the polygon is empty at the first step."""
    mpc = Mpc(CAR, TRAIN, PERIOD, Halt())  # type: ignore[arg-type]
    plan = Plan(drive(lambda s: np.full_like(s, 0.1), 25.0, 6.0))
    command = mpc.control(EgoState(0.0, 0.0, 0.0, 0.0, 25.0, steer=0.25, yaw_rate=2.5), plan)
    assert (command.steer, command.brake) == (0.123, 1.0)
    assert len(mpc.notes) == 1
    assert mpc.notes[0].startswith("MPC found no solution in 1 of 1 solves (first at 0.00 s: ")
    fine = Plan(drive(straight, 10.0, 6.0))
    back = mpc.control(EgoState(0.0, 0.0, 0.0, 0.0, 10.0), fine)
    assert back.steer == 0.123, "it drives until the next solve"
