"""The lateral model and the DLQR: laws of the linear plant, then the nonlinear one.

Steering that comes late.
"""

from collections import deque
from dataclasses import replace
from math import sin

import numpy as np
import pytest
from followed import controlled
from handmade import drive, s_curve
from hypothesis import given, settings, strategies as st
from scipy.linalg import solve_discrete_are

from replan.core.errors import ConfigError
from replan.logs.plan import Plan
from replan.logs.states import EgoState, Trajectory
from replan.logs.vehicle import VehicleParameters
from replan.replay.control.dlqr import (
    DlqrConfig,
    Regulators,
    gain,
    gain_table,
    regulators,
    rolling_model,
    solve_riccati,
)
from replan.replay.control.estimation import (
    LONGEST_S,
    SlipMemory,
    SteeringDelay,
    lateral_deviation,
    learn,
    slip_model,
)
from replan.replay.control.lateral_model import (
    DISCRETISATIONS,
    at_rear_axle,
    body_model,
    command_series,
    error_model,
    following,
    following_at,
    held,
    kappa_rate,
    slip_table,
    steer_for,
    with_rigid_tyres,
    with_steering,
)
from replan.replay.control.split import DLQR, SplitController, split_law
from replan.replay.vehicle.drivetrain import Drivetrain
from replan.replay.vehicle.kinematic_bicycle import KinematicBicycle
from replan.replay.vehicle.plan_path import PlanPath
from replan.replay.vehicle.state_records import ego_record, new_record

CAR = VehicleParameters()
ROLLING = with_rigid_tyres(CAR)
PERIOD = 0.01
B = CAR.wheelbase - CAR.cog_to_front
TABLE = [*np.geomspace(0.1, 50.0, 40), 60.0]


def track(plan: Trajectory, vehicle: str, plant: VehicleParameters = CAR) -> np.ndarray:
    """Lateral errors of a plan followed from its start."""
    return controlled(plan, "dlqr_pid", vehicle, float(plan.t[-1]), plant=plant)[2][:, 0]


def gains_at(v: float, car: VehicleParameters = CAR) -> list[float]:
    """K from the table."""
    table = gain_table(car, PERIOD, DlqrConfig())
    return [gain(table, v, column) for column in range(table.shape[1])]


# --- the model


@given(
    st.floats(0.3, 50.0),
    st.floats(-0.2, 0.2),
    st.floats(-1.0, 1.0),
    st.floats(-0.5, 0.5),
    st.floats(-2.0, 2.0),
)
def test_the_error_model_is_the_textbook_bicycle(
    v: float, steer: float, e_rate: float, e_phi: float, r: float
) -> None:
    """Against (1) written out: forces of both axles, a path of curvature r_path / v."""
    A, col, E = error_model(v, CAR)
    r_path = 0.4
    x = np.array([0.7, e_rate, e_phi, r - r_path])
    rate = A @ x + col * steer + E * r_path
    v_y = e_rate - v * e_phi
    front = CAR.cornering_front * (steer - (v_y + CAR.cog_to_front * r) / v)
    rear = -CAR.cornering_rear * (v_y - B * r) / v
    side, spin = (
        (front + rear) / CAR.mass - v * r,
        (CAR.cog_to_front * front - B * rear) / CAR.yaw_inertia,
    )
    expected = [e_rate, side + v * (r - r_path), r - r_path, spin]  # e_d'' = v_y' + v e_phi'
    np.testing.assert_allclose(rate, expected, rtol=1e-9, atol=1e-9)


@given(st.floats(0.5, 45.0))
def test_the_body_model_is_the_error_model_at_the_rear_axle(v: float) -> None:
    """On a straight, e_d' = v_lat + v e_phi and e_phi' = r."""
    A, col, _ = at_rear_axle(error_model(v, CAR), v, CAR)
    body, steered = body_model(v, CAR)
    rng = np.random.default_rng(3)
    e_phi, v_lat, r, steer = rng.normal(size=4)
    rate = A @ np.array([0.0, v_lat + v * e_phi, e_phi, r]) + col * steer
    moved = body @ np.array([v_lat, r]) + steered * steer
    np.testing.assert_allclose(rate[[1, 3]], [moved[0] + v * r, moved[1]], rtol=1e-9)


@settings(max_examples=15)
@given(st.floats(1.0, 45.0), st.sampled_from([0.005, 0.01, 0.05]))
def test_the_hold_is_exact(v: float, period: float) -> None:
    """Two half periods are one, and many Runge-Kutta steps come to the same."""
    A, col, _ = error_model(v, CAR)
    whole, half = held(A, col[:, None], period), held(A, col[:, None], 0.5 * period)
    np.testing.assert_allclose(whole[0], half[0] @ half[0], atol=1e-9)
    np.testing.assert_allclose(whole[1], half[0] @ half[1] + half[1], atol=1e-9)
    x, n = np.array([0.3, 0.1, -0.05, 0.2]), 2000
    exact = whole[0] @ x + whole[1][:, 0] * 0.02
    for _ in range(n):
        k1 = A @ x + col * 0.02
        k2 = A @ (x + 0.5 * period / n * k1) + col * 0.02
        x = x + period / n * k2
    np.testing.assert_allclose(x, exact, atol=1e-5)


def test_the_rolling_model_is_the_exact_hold() -> None:
    """Against a hundred thousand Euler steps of the continuous model under a held input."""
    v, u = 12.0, 0.05
    x = np.array([0.3, -0.1, 0.02])
    A, B = rolling_model(v, CAR.wheelbase, CAR.steer_lag, 0.1)
    exact = A @ x + B[:, 0] * u
    n = 100_000
    for _ in range(n):
        rate = np.array([v * x[1], v / CAR.wheelbase * x[2], (u - x[2]) / CAR.steer_lag])
        x = x + 0.1 / n * rate
    np.testing.assert_allclose(x, exact, atol=1e-6)


@pytest.mark.parametrize(
    ("v", "period", "paper", "consistent"),
    [(15.0, 0.01, 2.9e-2, 6.6e-4), (5.0, 0.01, 0.087, 0.0026), (5.0, 0.1, 0.96, 0.11)],
)
def test_the_papers_input_matrix_is_off_by_percents_and_the_consistent_one_is_not(
    v: float, period: float, paper: float, consistent: float
) -> None:
    """Errors of the order found by hand for a like car."""
    A, col, _ = error_model(v, CAR)
    exact = held(A, col[:, None], period)[1]

    def error(name: str) -> float:
        return float(
            np.linalg.norm(DISCRETISATIONS[name](A, col[:, None], period)[1] - exact)
            / np.linalg.norm(exact)
        )

    assert paper / 2.5 < error("paper") < 2.5 * paper
    assert consistent / 4.0 < error("bilinear") < 4.0 * consistent


# --- the regulator


def regulator(v: float, car: VehicleParameters) -> Regulators:
    """At one speed."""
    return Regulators(*(each[0] for each in regulators([v], car, PERIOD, DlqrConfig())))


@pytest.mark.parametrize("car", [CAR, ROLLING], ids=["slipping", "rolling"])
@given(st.floats(0.5, 45.0), st.lists(st.floats(-2.0, 2.0), min_size=5, max_size=5))
def test_predicted_cost_is_the_rolled_out_cost(
    car: VehicleParameters, v: float, start: list[float]
) -> None:
    r = regulator(v, car)
    moves, cost = r.A - r.B @ r.K, r.Q + r.K.T @ r.R @ r.K
    for _ in range(18):  # the first 2, 4, ... 2^18 steps of the roll-out
        cost, moves = cost + moves.T @ cost @ moves, moves @ moves
    x = np.array(start[: len(r.A)])
    assert x @ cost @ x == pytest.approx(x @ r.P @ x, rel=1e-6, abs=1e-12)


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(1, 2))
def test_the_riccati_equation_is_solved_as_the_library_does(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    A, B, Q = rng.normal(size=(n, n)), rng.normal(size=(n, m)), np.diag(rng.uniform(0.1, 2.0, n))
    R = np.diag(rng.uniform(0.1, 2.0, m))
    P = solve_riccati(A[None], B[None], Q, R[None])[0]
    np.testing.assert_allclose(P, solve_discrete_are(A, B, Q, R), rtol=1e-6)
    np.testing.assert_allclose(
        P, Q + A.T @ P @ np.linalg.solve(np.eye(n) + B @ np.linalg.solve(R, B.T) @ P, A), 1e-6
    )


@pytest.mark.parametrize("v", TABLE)
def test_the_tabulated_gain_is_stable_at_all_speeds(v: float) -> None:
    A, col, _ = at_rear_axle(error_model(v, CAR), v, CAR)
    A, col = held(*(lambda a, b: (a, b[:, None]))(*with_steering(A, col, CAR.steer_lag)), PERIOD)
    K = np.array([gains_at(v)])
    assert np.abs(np.linalg.eigvals(A - col @ K)).max() < 1.0
    A, col = rolling_model(v, CAR.wheelbase, CAR.steer_lag, PERIOD)
    assert np.abs(np.linalg.eigvals(A - col @ np.array([gains_at(v, ROLLING)]))).max() < 1.0


def test_gains_between_the_rows_are_close_to_the_solution() -> None:
    for v in (2.25, 7.75, 20.3, 44.9):
        exact = regulator(v, ROLLING).K[0]
        np.testing.assert_allclose(gains_at(v, ROLLING), exact, rtol=2e-2)


def test_stiff_tyres_give_the_kinematic_gains() -> None:
    stiff = replace(CAR, cornering_front=1e9, cornering_rear=1e9)
    for v in (2.0, 10.0, 20.0):
        K = regulator(v, stiff).K[0]
        k = regulator(v, ROLLING).K[0]
        # e_d' = v e_phi and e_phi' = v / L e_steer: their gains are the heading's and the
        # steering's
        merged = [K[0], K[2] + v * K[1], K[4] + v / CAR.wheelbase * K[3]]
        np.testing.assert_allclose(merged, k, rtol=2e-2)


def test_settings_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ConfigError, match="did you mean 'bilinear'"):
        DlqrConfig(discretisation="bilinaer")
    with pytest.raises(ConfigError, match="lateral_weight"):
        DlqrConfig(lateral_weight=0.0)
    with pytest.raises(ConfigError, match="steer_weight"):
        DlqrConfig(steer_weight=0.0)
    for car in (CAR, ROLLING):
        with pytest.raises(ConfigError, match="no stable gain"):
            regulator(0.0, car)
    A, B, one = np.array([[[2.0]], [[0.5]]]), np.array([[[0.0]], [[1.0]]]), np.ones((2, 1, 1))
    solved = solve_riccati(A, B, np.eye(1), one)  # the first has no solution, which spoils no other
    assert np.isnan(solved[0]).all() and solved[1] == pytest.approx(
        solve_discrete_are(A[1], B[1], np.eye(1), one[1])
    )


# --- exact following


@given(st.floats(1.0, 40.0))
def test_steady_following_is_the_analytic_understeer(v: float) -> None:
    """limits.md (iv): L/R + (m a_y/L)(b/C_f - a/C_r); heading a m a_y/(L C_r), at the rear axle."""
    rear, front, rolling = following(v, CAR)
    a, m, length = CAR.cog_to_front, CAR.mass, CAR.wheelbase
    under = m * v * v / length * (B / CAR.cornering_front - a / CAR.cornering_rear)
    assert (front - rear + rolling)[0] == pytest.approx(length + under)
    assert rear[0] == pytest.approx(a * m * v * v / (length * CAR.cornering_rear))


@given(st.floats(3.0, 35.0), st.floats(0.2, 2.0))
def test_the_series_solves_the_equations_of_motion(v: float, pace: float) -> None:
    """With kappa = exp(pace t), the residue of the series of 3 is of order pace^3."""

    def residue(pace: float) -> float:
        rear, front, rolling = following(v, CAR)
        powers = pace ** np.arange(3)
        heading, steer = rear @ powers, (front - rear + rolling) @ powers
        state = np.array([-v * heading, v + pace * heading])
        body, steered = body_model(v, CAR)
        return float(np.abs(body @ state + steered * steer - pace * state)[0])

    assert residue(0.5 * pace) < residue(pace) / 6.0 + 1e-9


@pytest.mark.parametrize(("radius", "v"), [(50.0, 10.0), (200.0, 20.0), (-250.0, 25.0)])
def test_steady_error_on_the_linear_plant_is_zero(radius: float, v: float) -> None:
    """The radii and speeds of limits.md (iv), where a feed-forward without k_3 leaves 23 to 51
    mm.
    """
    A, col, E = at_rear_axle(error_model(v, CAR), v, CAR)
    (p0, d), K = following_at(slip_table(CAR), CAR.wheelbase, (1.0, 1.0), v), gains_at(v)
    gain, kappa = np.array(K[:4]), 1.0 / radius

    def steady(with_k3: float) -> float:
        feed = (d[0] + K[2] * p0 * with_k3) * kappa
        return float(np.linalg.solve(A - np.outer(col, gain), -(col * feed + E * v * kappa))[0])

    assert steady(1.0) == pytest.approx(0.0, abs=1e-9)
    assert abs(steady(0.0)) > 0.02


def test_the_command_leads_the_wheel_by_lag_and_hold() -> None:
    d = (2.5, 0.3, 0.02)
    c = command_series(d, 0.1, 0.01)
    # Of kappa = exp(pace t): the wheel is exp(-pace h / 2) / (1 + T pace) times the command
    pace = 1e-2
    wheel = sum(c[i] * pace**i for i in range(3)) * np.exp(-pace * 0.005) / (1.0 + 0.1 * pace)
    assert wheel == pytest.approx(sum(d[i] * pace**i for i in range(3)), rel=1e-7)


@given(st.floats(2.0, 25.0), st.floats(-0.02, 0.02))
def test_on_a_circle_the_wheel_angle_is_d0_kappa(v: float, kappa: float) -> None:
    path = PlanPath.of(drive(lambda s: np.full_like(s, kappa), v, 6.0))
    assert steer_for(path.knots, 3.0 * v, v, (2.7, 0.8, 0.1)) == pytest.approx(
        2.7 * kappa, abs=1e-6
    )


# --- what is learned


@pytest.mark.parametrize("stiffness", [0.7, 1.0, 1.4])
def test_the_slip_that_was_there_is_learned(stiffness: float) -> None:
    """A linear plant with other tyres than those of the parameters."""
    p = replace(
        CAR,
        cornering_front=stiffness * CAR.cornering_front,
        cornering_rear=stiffness * CAR.cornering_rear,
    )
    A, col = held(*(lambda a, b: (a, b[:, None]))(*body_model(15.0, p)), PERIOD)
    slip, model, q = new_record(SlipMemory), slip_model(CAR, PERIOD), np.zeros(2)
    for k in range(600):
        steer = 0.03 * np.sin(0.02 * k)
        now = EgoState(
            k * PERIOD, 0.0, 0.0, 0.0, 15.0, steer=steer, yaw_rate=float(q[1]), v_lat=float(q[0])
        )
        learn(slip, model, ego_record(now))
        q = A @ q + col[:, 0] * steer
    assert (slip.front, slip.rear) == pytest.approx((1.0 / stiffness,) * 2, rel=0.03)


def test_nothing_is_learned_where_there_is_nothing_to_learn_from() -> None:
    slip, rigid = new_record(SlipMemory), new_record(SlipMemory)
    turn = {"steer": 0.02, "yaw_rate": 15.0 * 0.02 / CAR.wheelbase}
    for k in range(200):
        straight, turning = (
            EgoState(k * PERIOD, 0.0, 0.0, 0.0, 15.0, **more) for more in ({}, turn)
        )
        learn(slip, slip_model(CAR, PERIOD), ego_record(straight))
        learn(rigid, slip_model(with_rigid_tyres(CAR), PERIOD), ego_record(turning))
    assert slip.front == slip.rear == rigid.front == rigid.rear == 1.0


# --- on the vehicle models


@pytest.mark.parametrize(("radius", "v"), [(30.0, 8.0), (-250.0, 25.0)])
def test_steady_error_on_tyres_with_a_limit_vanishes(radius: float, v: float) -> None:
    plan = drive(lambda s: np.interp(s, [v, 3.0 * v], [0.0, 1.0 / radius]), v, 12.0)
    assert abs(track(plan, "single_track")[-1]) < 1e-3


def steered(
    delay_steps: int, seconds: float, *, lag: float = CAR.steer_lag, noise: float = 0.0
) -> SteeringDelay:
    """A wheel that follows wavering commands `delay_steps` periods late."""
    steering, rng = SteeringDelay(CAR, PERIOD), np.random.default_rng(5)
    car = KinematicBicycle(VehicleParameters(steer_lag=lag), EgoState(0.0, 0.0, 0.0, 0.0, 8.0))
    coming = deque([0.0] * delay_steps)
    for k in range(round(seconds / PERIOD)):
        steering.observe(car.state.steer + noise * rng.normal())
        command = 0.05 * sin(1.3 * k * PERIOD) + 0.02 * sin(3.1 * k * PERIOD)
        steering.record(command)
        coming.append(command)
        car.step(type(car.actuation)(coming.popleft(), 0.1, 0.0), PERIOD)
    return steering


@settings(max_examples=12)
@given(st.integers(0, 25))
def test_the_delay_is_learned(delay_steps: int) -> None:
    assert steered(delay_steps, 10.0).seconds == pytest.approx(delay_steps * PERIOD, abs=0.006)


def test_noise_makes_it_waver_and_not_run_away() -> None:
    assert steered(0, 20.0, noise=1e-3).seconds < 0.02
    assert steered(10, 20.0, noise=1e-3).seconds == pytest.approx(0.1, abs=0.02)


def test_a_slower_actuator_is_late_by_about_its_lag_and_a_faster_one_is_not_late() -> None:
    assert steered(0, 20.0, lag=CAR.steer_lag + 0.1).seconds == pytest.approx(0.1, abs=0.03)
    assert steered(0, 20.0, lag=0.5 * CAR.steer_lag).seconds < 0.02


def test_nothing_is_learned_while_the_wheel_rests_or_the_vehicle_is_held() -> None:
    steering = SteeringDelay(CAR, PERIOD)
    for k in range(300):
        steering.observe(0.01 * sin(0.1 * k))  # what is measured wavers, what is commanded does not
        steering.record(0.0)
    assert steering.seconds == 0.0
    late = steered(10, 10.0)
    before = late.seconds
    late.rest()
    late.observe(0.4)
    assert late.seconds == before and late.settled == pytest.approx(0.4)
    assert 0.0 <= late.seconds <= LONGEST_S


@pytest.mark.parametrize("turned", [-0.3, 0.0, 0.3])
def test_a_stop_in_which_somebody_turns_the_wheel_disturbs_nothing_learned(turned: float) -> None:
    """10 s of curves with a wheel 0.1 s late, 4 s held, then curves again."""
    way = drive(
        lambda s: 0.03 * np.sin(0.3 * s),
        lambda t: np.interp(t, [9.0, 11.0, 15.0, 18.0], [8.0, 0.0, 0.0, 6.0]),
        20.0,
        PERIOD,
    )
    controller = SplitController(split_law(DLQR, CAR, Drivetrain(CAR), PERIOD))
    share, coming, wheel, late = 1.0 - np.exp(-PERIOD / CAR.steer_lag), deque([0.0] * 10), 0.0, []
    for k in range(len(way)):
        if 1150 <= k < 1350:
            wheel = turned
        state = EgoState(
            *(float(column[k]) for column in (way.t, way.x, way.y, way.yaw, way.v)), steer=wheel
        )
        coming.append(controller.control(state, Plan(way)).steer)
        wheel += float(
            np.clip(
                share * (coming.popleft() - wheel),
                -CAR.max_steer_rate * PERIOD,
                CAR.max_steer_rate * PERIOD,
            )
        )
        late.append(controller.memory.delay.delay)
    assert late[1050] == pytest.approx(0.1, abs=0.02)
    np.testing.assert_allclose(late[1200:], late[1200], atol=0.02)


@pytest.mark.parametrize("v", [4.0, 15.0])
def test_the_deviation_is_led_as_the_continuous_model_moves(v: float) -> None:
    """Against small Euler steps of (v_lat, r, e_phi, e_d) under the wheel angles that are on their
    way.
    """
    path, slips = PlanPath.of(drive(s_curve, v, 20.0)), slip_table(CAR)
    steering = SteeringDelay(CAR, PERIOD)
    steering.observe(0.0)
    for k in range(30):
        steering.record(0.02 + 0.001 * k)
    steering.delay.delay = 0.1
    foot, y = 25.0, (0.1, 0.05, -0.02, 0.03)
    _, angle = following_at(slips, CAR.wheelbase, (1.0, 1.0), v)
    n, grid = 2000, PERIOD * np.arange(11)
    h, coming = 0.1 / n, steering.wheel[10::-1]
    exact = [steer_for(path.knots, foot + v * s, v, angle) for s in grid]
    e_d, v_lat, e_phi, r = y
    A, B = body_model(v, CAR)
    for k in range(n):
        side, spin = A @ [v_lat, r] + B * np.interp(k * h, grid, coming - np.array(exact))
        e_d, e_phi, v_lat, r = (
            e_d + h * (v_lat + v * e_phi),
            e_phi + h * r,
            v_lat + h * side,
            r + h * spin,
        )
    predicted = steering.predict(y, path.knots, foot, v, angle)
    np.testing.assert_allclose(predicted, (e_d, v_lat, e_phi, r), rtol=2e-2, atol=1e-3)
    steering.delay.delay = 0.0
    assert steering.predict(y, path.knots, foot, v, angle) == y


def test_exact_following_has_no_deviation() -> None:
    v, kappa = 12.0, 0.02
    path = PlanPath.of(drive(lambda s: np.full_like(s, kappa), v, 10.0))
    slip, _ = following_at(slip_table(CAR), CAR.wheelbase, (1.0, 1.0), v)
    at = path.deviation(EgoState(3.0, 0.0, 0.0, 0.0, v))  # only for its foot point
    x, y, yaw = (
        np.sin(kappa * 36.0) / kappa,
        (1.0 - np.cos(kappa * 36.0)) / kappa,
        kappa * 36.0 + slip * kappa,
    )
    state = EgoState(3.0, x, y, yaw, v, v_lat=-v * slip * kappa, yaw_rate=v * kappa)
    off = path.deviation(state)
    assert (
        kappa_rate(path.knots, off.foot, v) == pytest.approx(0.0, abs=1e-9) and at.foot != off.foot
    )
    np.testing.assert_allclose(
        lateral_deviation(ego_record(state), off, path.knots, slip), 0.0, atol=2e-3
    )
