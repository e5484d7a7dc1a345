"""The kinematic bicycle with rear steering: the corrected equation 1 of the paper."""

from __future__ import annotations

from math import atan, cos, hypot, sin, tan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from logs import Command, ConfigError, EgoState, VehicleParameters
from replay.vehicle import REAR_RATIO, VEHICLES
from replay.vehicle.kinematic_bicycle import KinematicBicycle, State, advance, derivative, kinematics_of

CAR = VehicleParameters()


def start(v: float, kappa: float = 0.0) -> EgoState:
    return EgoState(0.0, 0.0, 0.0, 0.0, v, 0.0, kappa)


@given(st.floats(0.1, 30.0), st.floats(-0.6, 0.6), st.floats(-1.0, 0.9), st.floats(-3.0, 3.0))
def test_it_is_the_corrected_equation_at_the_centre_of_gravity(
    v: float, steer: float, ratio: float, yaw: float
) -> None:
    """x' = V cos(yaw + beta), y' = V sin(yaw + beta), yaw' = V cos(beta) (tan df - tan dr) / L; no wheel slips."""
    state = State(0.0, 0.0, yaw, v, steer, 0.0, 0.0)
    rate = derivative(state, (0.0, 0.0, 0.0), True, kinematics_of(CAR, ratio))
    lf, lr = CAR.cog_to_front, CAR.cog_to_rear
    df, dr = steer, ratio * steer
    beta = atan((lf * tan(dr) + lr * tan(df)) / CAR.wheelbase)
    V = v / cos(beta)
    assert rate[2] == pytest.approx(V * cos(beta) * (tan(df) - tan(dr)) / CAR.wheelbase)
    at_cog = (rate[0] - lr * rate[2] * sin(yaw), rate[1] + lr * rate[2] * cos(yaw))
    assert at_cog == (pytest.approx(V * cos(yaw + beta)), pytest.approx(V * sin(yaw + beta)))
    for ahead, wheel in ((CAR.wheelbase, df), (0.0, dr)):
        vx, vy = rate[0] - ahead * rate[2] * sin(yaw), rate[1] + ahead * rate[2] * cos(yaw)
        assert vy * cos(yaw + wheel) - vx * sin(yaw + wheel) == pytest.approx(0.0, abs=1e-9 * V)


@given(st.floats(1.0, 20.0), st.floats(0.02, 0.3), st.floats(-0.9, 0.5))
def test_held_wheels_drive_a_circle_of_the_stated_curvature(v: float, steer: float, ratio: float) -> None:
    free = VehicleParameters(drag=0.0, rolling=0.0)
    car = KinematicBicycle(free, start(v), rear_ratio=ratio)
    for _ in range(200):
        car.step(Command(steer, 0.0, 0.0), 0.01)
    points = []
    for _ in range(100):
        state = car.step(Command(steer, 0.0, 0.0), 0.01)
        points.append((state.x, state.y))
    course = state.yaw + atan(state.v_lat / state.v)
    center = (state.x - sin(course) / state.kappa, state.y + cos(course) / state.kappa)
    radii = [hypot(x - center[0], y - center[1]) for x, y in points]
    np.testing.assert_allclose(radii, 1.0 / state.kappa, rtol=1e-4)


def test_the_named_vehicle_is_the_bicycle_with_its_ratio_and_a_ratio_out_of_range_is_refused() -> None:
    named, own = VEHICLES["kinematic_rear_steer"](CAR, start(8.0)), KinematicBicycle(CAR, start(8.0), rear_ratio=-0.2)
    command = Command(0.2, 0.3, 0.0)
    assert [named.step(command, 0.01) for _ in range(50)] == [own.step(command, 0.01) for _ in range(50)]
    assert REAR_RATIO == -0.2 and named.state.v_lat < 0.0
    with pytest.raises(ConfigError, match="rear_ratio"):
        KinematicBicycle(CAR, start(8.0), rear_ratio=1.0)


def test_opposite_rear_wheels_turn_more_tightly_and_parallel_ones_less() -> None:
    rates = {}
    for ratio in (-0.5, 0.0, 0.5):
        car = KinematicBicycle(CAR, start(5.0), rear_ratio=ratio)
        for _ in range(100):
            state = car.step(Command(0.2, 0.0, 0.0), 0.01)
        rates[ratio] = state.yaw_rate
    assert rates[-0.5] > 1.4 * rates[0.0] > 2.5 * rates[0.5]


def test_integration_is_of_order_four() -> None:
    begin = State(0.0, 0.0, 0.0, 12.0, 0.0, 0.0, 0.1)
    arguments = ((0.03, 0.3, 0.0), kinematics_of(CAR, -0.4), 1.0)
    exact = np.array(advance(begin, *arguments, 20_000))
    steps = np.array([10, 20, 40, 80])
    errors = [np.abs(np.array(advance(begin, *arguments, int(n))) - exact).max() for n in steps]
    assert 3.7 < np.polyfit(np.log(1.0 / steps), np.log(errors), 1)[0] < 4.4


@given(st.floats(-0.1, 0.1), st.floats(-0.9, 0.6))
def test_it_starts_with_the_curvature_of_the_log(kappa: float, ratio: float) -> None:
    assert KinematicBicycle(CAR, start(6.0, kappa), rear_ratio=ratio).state.kappa == pytest.approx(kappa, abs=1e-9)
