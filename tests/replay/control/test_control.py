"""Controllers: the laws of the regulator, the tracking errors, one pedal at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from handmade import drive, s_curve
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are

from logs import ConfigError, EgoState, Plan, Trajectory, VehicleParameters
from replay.control import CONTROLLERS
from replay.control.dlqr_kinematic import KinematicDlqrConfig as DlqrConfig
from replay.control.dlqr_kinematic import error_model, kinematic_law, regulator
from replay.control.lateral_model import with_rigid_tyres
from replay.control.pedals import HYSTERESIS_MPS2, Pedals
from replay.control.pid import AT_REST, PidConfig, accelerate_dual_loop, dual_loop_law
from replay.control.regulator import gain, solve_riccati
from replay.vehicle import VEHICLES
from replay.vehicle.base import motion_of
from replay.vehicle.pedal_map import PedalPowertrain
from replay.vehicle.plan_path import PlanPath

CAR = VehicleParameters()
TRAIN = PedalPowertrain(CAR)
PERIOD = 0.01
SPEEDS = (0.5, 1.0, 3.0, 8.0, 12.0, 25.0, 40.0)


def follow(plan: Trajectory, start: EgoState, seconds: float, name: str = "dlqr_pid") -> dict[str, np.ndarray]:
    """One plan followed to its end, without replanning."""
    car = VEHICLES["kinematic_bicycle"](CAR, start)
    controller = CONTROLLERS[name](with_rigid_tyres(CAR), car.powertrain, PERIOD)
    one, path, rows = Plan(plan), PlanPath.of(plan), []
    for _ in range(round(seconds / PERIOD)):
        off = path.deviation(car.state)
        command = controller.control(car.state, one)
        rows.append((*off[:4], command.steer, command.throttle, command.brake, car.state.v))
        car.step(command, PERIOD)
    names = ("lateral", "heading", "speed", "station", "steer", "throttle", "brake", "v")
    return dict(zip(names, np.array(rows).T, strict=True))


# --- the regulator


@given(st.floats(0.5, 45.0), st.tuples(st.floats(-2.0, 2.0), st.floats(-0.5, 0.5), st.floats(-0.3, 0.3)))
def test_predicted_cost_is_the_rolled_out_cost(v: float, x0: tuple[float, float, float]) -> None:
    r = regulator(v, CAR.wheelbase, CAR.steer_lag, PERIOD, DlqrConfig())
    moves, cost = r.A - r.B @ r.K, r.Q + r.K.T @ r.R @ r.K
    for _ in range(18):  # the first 2, 4, ... 2^18 steps of the roll-out
        cost, moves = cost + moves.T @ cost @ moves, moves @ moves
    x = np.array(x0)
    assert x @ cost @ x == pytest.approx(x @ r.P @ x, rel=1e-6, abs=1e-12)


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.integers(1, 2))
def test_the_riccati_equation_is_solved_as_the_library_does(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    A, B, Q = rng.normal(size=(n, n)), rng.normal(size=(n, m)), np.diag(rng.uniform(0.1, 2.0, n))
    R = np.diag(rng.uniform(0.1, 2.0, m))
    P = solve_riccati(A, B, Q, R)
    np.testing.assert_allclose(P, solve_discrete_are(A, B, Q, R), rtol=1e-6)
    np.testing.assert_allclose(P, Q + A.T @ P @ np.linalg.solve(np.eye(n) + B @ np.linalg.solve(R, B.T) @ P, A), 1e-6)


def test_what_cannot_be_stabilised_is_said() -> None:
    assert np.isnan(solve_riccati(np.array([[2.0]]), np.array([[0.0]]), np.eye(1), np.eye(1))).all()
    with pytest.raises(ConfigError, match="no stable gain"):
        regulator(0.0, CAR.wheelbase, CAR.steer_lag, PERIOD, DlqrConfig())


@pytest.mark.parametrize("v", [0.1, 0.2, *SPEEDS, 60.0])
def test_the_tabulated_gain_is_stable(v: float) -> None:
    A, B = error_model(v, CAR.wheelbase, CAR.steer_lag, PERIOD)
    gains = kinematic_law(CAR, PERIOD).gains
    K = np.array([[gain(gains, v, column) for column in range(3)]])
    assert np.abs(np.linalg.eigvals(A - B @ K)).max() < 1.0


def test_the_error_model_is_the_exact_hold() -> None:
    """Against a hundred thousand Euler steps of the continuous model under a held input."""
    v, u = 12.0, 0.05
    x = np.array([0.3, -0.1, 0.02])
    A, B = error_model(v, CAR.wheelbase, CAR.steer_lag, 0.1)
    exact = A @ x + B[:, 0] * u
    n = 100_000
    for _ in range(n):
        rate = np.array([v * x[1], v / CAR.wheelbase * x[2], (u - x[2]) / CAR.steer_lag])
        x = x + 0.1 / n * rate
    np.testing.assert_allclose(x, exact, atol=1e-6)


def test_gains_between_the_rows_are_close_to_the_solution() -> None:
    gains = kinematic_law(CAR, PERIOD).gains
    for v in (2.25, 7.75, 20.3, 44.9):
        exact = regulator(v, CAR.wheelbase, CAR.steer_lag, PERIOD, DlqrConfig()).K[0]
        np.testing.assert_allclose([gain(gains, v, column) for column in range(3)], exact, rtol=2e-2)


def test_weights_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ConfigError, match="steer_weight"):
        DlqrConfig(steer_weight=0.0)
    with pytest.raises(ConfigError, match="kp"):
        PidConfig(kp=-1.0)


# --- steering in closed loop


@pytest.mark.parametrize("v", [0.1, 0.5, 2.0, 5.0, 12.0, 25.0, 40.0])
def test_closed_loop_comes_back_to_a_straight_plan(v: float) -> None:
    seconds = max(8.0, 25.0 / v)
    plan = drive(np.zeros_like, v, seconds + 1.0)
    seen = follow(plan, EgoState(0.0, 0.0, 0.3, 0.02, v), seconds)
    assert np.abs(seen["lateral"]).max() < 0.5
    assert abs(seen["lateral"][-1]) < 0.05
    assert np.abs(seen["lateral"][-len(seen["lateral"]) // 5 :]).max() < 0.06
    assert np.abs(seen["speed"]).max() < 0.2


@pytest.mark.parametrize(("radius", "v"), [(10.0, 4.0), (-30.0, 8.0), (50.0, 12.0), (400.0, 30.0)])
def test_steady_lateral_error_on_a_constant_curve_vanishes(radius: float, v: float) -> None:
    seconds = max(8.0, 70.0 / v)
    plan = drive(lambda s: np.full_like(s, 1.0 / radius), v, seconds + 1.0)
    seen = follow(plan, EgoState(0.0, 0.0, 0.0, 0.0, v), seconds)
    assert np.abs(seen["lateral"]).max() > 1e-3  # it starts with straight wheels
    assert abs(seen["lateral"][-1]) < 2e-4
    assert abs(seen["heading"][-1]) < 1e-3


def test_an_s_curve_is_tracked_within_the_aim() -> None:
    plan = drive(s_curve, 12.0, 14.5)
    seen = follow(plan, EgoState(0.0, 0.0, 0.0, 0.0, 12.0), 14.0)
    assert np.abs(seen["lateral"]).max() < 0.02
    assert np.abs(seen["speed"]).max() < 0.02
    assert np.abs(seen["station"]).max() < 0.05


# --- tracking errors


@given(st.floats(0.5, 11.0), st.floats(-1.5, 1.5), st.floats(-0.3, 0.3), st.floats(-1.0, 1.0))
def test_errors_are_those_that_were_put_in(t: float, lateral: float, heading: float, speed: float) -> None:
    fine = drive(s_curve, 12.0, 12.0, step=0.01)
    truth = fine.at(t)
    ego = EgoState(
        t, truth.x - lateral * np.sin(truth.yaw), truth.y + lateral * np.cos(truth.yaw),
        truth.yaw + heading, truth.v + speed,
    )  # fmt: skip
    off = PlanPath.of(drive(s_curve, 12.0, 12.0)).deviation(ego)
    assert off.lateral == pytest.approx(lateral, abs=2e-3)
    assert off.heading == pytest.approx(heading, abs=2e-3)
    assert off.speed == pytest.approx(speed, abs=1e-6)
    assert off.station == pytest.approx(0.0, abs=2e-2)


def test_station_error_is_ahead_positive_and_beyond_the_ends_straight() -> None:
    path = PlanPath.of(drive(np.zeros_like, 10.0, 4.0))
    assert path.deviation(EgoState(2.0, 23.0, 0.5, 0.0, 10.0)).station == pytest.approx(3.0)
    assert path.deviation(EgoState(0.0, -2.0, 0.5, 0.0, 10.0))[:4] == pytest.approx((0.5, 0.0, 0.0, -2.0))
    assert path.deviation(EgoState(4.5, 46.0, -0.5, 0.0, 10.0))[:4] == pytest.approx((-0.5, 0.0, 0.0, 1.0))


def test_standing_plans_and_noise_have_no_station() -> None:
    t = np.arange(0.0, 5.0, 0.1)
    rng = np.random.default_rng(1)
    x, y = rng.normal(0.0, 0.01, (2, len(t)))
    still = PlanPath.of(Trajectory(t, x, y, np.zeros_like(t), np.zeros_like(t), np.zeros_like(t), np.zeros_like(t)))
    assert still.times[-1, 1] < 0.06
    off = still.deviation(EgoState(2.0, 0.0, 0.2, 0.1, 0.0))
    assert off.lateral == pytest.approx(0.2, abs=0.03) and off.heading == pytest.approx(0.1, abs=1e-9)
    single = PlanPath.of(drive(np.zeros_like, 10.0, 1.0).between(0.0, 0.0))
    assert single.deviation(EgoState(0.5, 5.0, 0.1, 0.0, 10.0))[:4] == pytest.approx((0.1, 0.0, 0.0, 0.0))


def test_a_loop_is_followed_where_the_plan_is_and_not_where_it_crosses_itself() -> None:
    """A circle driven twice has two feet for each point."""
    plan = drive(lambda s: np.full_like(s, 0.1), 10.0, 2 * 2 * np.pi)
    path = PlanPath.of(plan)
    late = replace(plan.at(10.0), t=10.0)
    assert path.deviation(late).station == pytest.approx(0.0, abs=0.05)
    assert path.deviation(late).foot > 95.0


# --- pedals and speed


@given(st.lists(st.tuples(st.floats(-12.0, 6.0), st.floats(0.0, 40.0)), min_size=1, max_size=60))
def test_pedals_are_never_on_together(asked: list[tuple[float, float]]) -> None:
    pedals = Pedals(TRAIN)
    for acceleration, v in asked:
        throttle, brake = pedals.press(acceleration, v)
        assert 0.0 <= throttle <= 1.0 and 0.0 <= brake <= 1.0
        assert throttle == 0.0 or brake == 0.0


@given(st.floats(0.5, 35.0), st.floats(-8.0, 1.5))
def test_pedals_invert_the_powertrain(v: float, acceleration: float) -> None:
    beyond = acceleration - TRAIN.coasting(v)
    if abs(beyond) <= HYSTERESIS_MPS2 or beyond > TRAIN.full_throttle(v):
        return
    throttle, brake = Pedals(TRAIN).press(acceleration, v)
    given_back = TRAIN.coasting(v) + throttle * TRAIN.full_throttle(v) - brake * TRAIN.full_brake(v)
    assert given_back == pytest.approx(acceleration, abs=1e-9)


def test_pedals_do_not_alternate_with_noise() -> None:
    pedals, rng = Pedals(TRAIN), np.random.default_rng(2)
    asked = TRAIN.coasting(15.0) + rng.uniform(-0.9, 0.9, 500) * HYSTERESIS_MPS2
    used = [pedals.press(float(a), 15.0) for a in asked]
    assert not any(brake for _, brake in used)


def test_the_integral_does_not_wind_up() -> None:
    """Ten seconds of an unreachable plan leave no more integral than the first of them."""
    plan = PlanPath.of(drive(np.zeros_like, 40.0, 12.0))
    law, memory = dual_loop_law(PERIOD), AT_REST
    for k in range(1000):
        state = EgoState(k * PERIOD, 0.0, 0.0, 0.0, 5.0)
        off = plan.deviation(state)
        wanted, memory = accelerate_dual_loop(law, memory, TRAIN.pedal_map, motion_of(state), off, plan.times)
    assert wanted == pytest.approx(TRAIN.coasting(5.0) + TRAIN.full_throttle(5.0))
    calm = EgoState(10.0, 400.0, 0.0, 0.0, 40.0)
    off = plan.deviation(calm)
    assert abs(accelerate_dual_loop(law, memory, TRAIN.pedal_map, motion_of(calm), off, plan.times)[0]) < 0.1


def stop_and_go(t: np.ndarray) -> np.ndarray:
    return np.interp(t, [0.0, 1.0, 6.0, 9.0, 15.0], [10.0, 10.0, 0.0, 0.0, 9.0])


def test_a_stop_is_held_without_creep_and_left_again() -> None:
    seen = follow(drive(s_curve, stop_and_go, 16.0), EgoState(0.0, 0.0, 0.0, 0.0, 10.0), 15.5)
    t = PERIOD * np.arange(len(seen["v"]))
    held = (t > 6.5) & (t < 8.5)
    assert (seen["v"][held] == 0.0).all()
    assert (seen["throttle"][(t > 6.5) & (t < 7.9)] == 0.0).all()
    assert (seen["brake"][(t > 6.5) & (t < 7.9)] > 0.0).all()
    assert seen["v"][-1] > 8.0
    assert np.abs(seen["station"]).max() < 0.2
    assert np.abs(seen["lateral"]).max() < 0.02
    assert not (seen["throttle"] * seen["brake"]).any()
    pedal = np.sign(seen["throttle"]) - np.sign(seen["brake"])
    assert np.count_nonzero(np.diff(pedal[pedal != 0.0])) <= 3


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_controller_is_deterministic_and_keeps_to_one_pedal(name: str) -> None:
    """The contract of the seam, for controllers to come as well."""
    plan, start = drive(s_curve, stop_and_go, 16.0), EgoState(0.0, 0.0, 0.2, 0.05, 9.0)
    one, two = follow(plan, start, 14.0, name), follow(plan, start, 14.0, name)
    assert all(np.array_equal(one[key], two[key]) for key in one)
    assert all(np.isfinite(column).all() for column in one.values())
    assert not (one["throttle"] * one["brake"]).any()
    assert np.abs(one["steer"]).max() <= CAR.max_steer
