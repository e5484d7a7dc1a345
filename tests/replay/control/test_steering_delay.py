"""The steering's delay is learned, the prediction is the model's, nothing is learned from nothing."""

from collections import deque
from math import sin

import numpy as np
import pytest
from handmade import drive, s_curve
from hypothesis import given, settings, strategies as st

from logs import EgoState, Plan, VehicleParameters
from replay.control.estimation import LONGEST_S, SteeringDelay, lateral_deviation
from replay.control.lateral_model import body_model, following_at, kappa_rate, slip_table, steer_for
from replay.control.split import DLQR, SplitController, split_law
from replay.vehicle.base import motion_of
from replay.vehicle.drivetrain import Drivetrain
from replay.vehicle.kinematic_bicycle import KinematicBicycle
from replay.vehicle.plan_path import PlanPath

CAR = VehicleParameters()
PERIOD = 0.01


def steered(delay_steps: int, seconds: float, *, lag: float = CAR.steer_lag, noise: float = 0.0) -> SteeringDelay:
    """A wheel that follows wavering commands so many periods late."""
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
    assert late.seconds == before and late.wheel == pytest.approx(0.4)
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
        state = EgoState(*(float(column[k]) for column in (way.t, way.x, way.y, way.yaw, way.v)), steer=wheel)
        coming.append(controller.control(state, Plan(way)).steer)
        wheel += float(
            np.clip(share * (coming.popleft() - wheel), -CAR.max_steer_rate * PERIOD, CAR.max_steer_rate * PERIOD)
        )
        late.append(controller.state.dlqr.delay.delay)
    assert late[1050] == pytest.approx(0.1, abs=0.02)
    np.testing.assert_allclose(late[1200:], late[1200], atol=0.02)


@pytest.mark.parametrize("v", [4.0, 15.0])
def test_the_deviation_is_led_as_the_continuous_model_moves(v: float) -> None:
    """Against small Euler steps of (v_lat, r, e_phi, e_d) under the wheel angles that are on their way."""
    path, slips = PlanPath.of(drive(s_curve, v, 20.0)), slip_table(CAR)
    steering = SteeringDelay(CAR, PERIOD)
    steering.observe(0.0)
    for k in range(30):
        steering.record(0.02 + 0.001 * k)
    steering.state = steering.state._replace(delay=0.1)
    foot, y = 25.0, (0.1, 0.05, -0.02, 0.03)
    _, angle = following_at(slips, CAR.wheelbase, (1.0, 1.0), v)
    n, grid = 2000, PERIOD * np.arange(11)
    h, coming = 0.1 / n, steering.state.wheel[10::-1]
    exact = [steer_for(path.knots, foot + v * s, v, angle) for s in grid]
    e_d, v_lat, e_phi, r = y
    A, B = body_model(v, CAR)
    for k in range(n):
        side, spin = A @ [v_lat, r] + B * np.interp(k * h, grid, coming - np.array(exact))
        e_d, e_phi, v_lat, r = e_d + h * (v_lat + v * e_phi), e_phi + h * r, v_lat + h * side, r + h * spin
    predicted = steering.predict(y, path.knots, foot, v, angle)
    np.testing.assert_allclose(predicted, (e_d, v_lat, e_phi, r), rtol=2e-2, atol=1e-3)
    steering.state = steering.state._replace(delay=0.0)
    assert steering.predict(y, path.knots, foot, v, angle) == y


def test_exact_following_has_no_deviation() -> None:
    v, kappa = 12.0, 0.02
    path = PlanPath.of(drive(lambda s: np.full_like(s, kappa), v, 10.0))
    slip, _ = following_at(slip_table(CAR), CAR.wheelbase, (1.0, 1.0), v)
    at = path.deviation(EgoState(3.0, 0.0, 0.0, 0.0, v))  # only for its foot point
    x, y, yaw = np.sin(kappa * 36.0) / kappa, (1.0 - np.cos(kappa * 36.0)) / kappa, kappa * 36.0 + slip * kappa
    state = EgoState(3.0, x, y, yaw, v, v_lat=-v * slip * kappa, yaw_rate=v * kappa)
    off = path.deviation(state)
    assert kappa_rate(path.knots, off.foot, v) == pytest.approx(0.0, abs=1e-9) and at.foot != off.foot
    np.testing.assert_allclose(lateral_deviation(motion_of(state), off, path.knots, slip), 0.0, atol=2e-3)
