"""Vehicles: laws of motion first, then limits and standstill."""

from math import atan, cos, hypot, pi, sin, tan

import numpy as np
import pytest
from hypothesis import given, strategies as st

from replan.core.errors import ConfigError
from replan.logs.states import Command, EgoState
from replan.logs.vehicle import VehicleParameters
from replan.replay.parts import VEHICLE
from replan.replay.vehicle.kinematic_bicycle import (
    REAR_RATIO,
    BicycleState,
    KinematicBicycle,
    advance,
    derivative,
    kinematics_of,
)

CAR = VehicleParameters()
PEDAL = st.floats(0.0, 1.0)
STEER = st.floats(-1.0, 1.0)


def at_speed(v: float, kappa: float = 0.0, a: float = 0.0) -> EgoState:
    return EgoState(0.0, 0.0, 0.0, 0.0, v, a, kappa)


@given(st.floats(1.0, 40.0), st.floats(-0.5, 0.5).filter(lambda steer: abs(steer) > 1e-3))
def test_constant_steer_is_a_circle(v: float, steer: float) -> None:
    radius = CAR.wheelbase / tan(steer)
    coasting = VehicleParameters(drag=0.0, rolling=0.0)
    car = KinematicBicycle(coasting, at_speed(v, tan(steer) / CAR.wheelbase))
    for _ in range(100):
        state = car.step(Command(steer, 0.0, 0.0), 0.01)
        assert hypot(state.x, state.y - radius) == pytest.approx(abs(radius), abs=1e-6)
    assert state.v == pytest.approx(v)
    assert state.yaw == pytest.approx(v / radius, abs=1e-6)


@pytest.mark.parametrize("ratio", [0.0, -0.4])
def test_integration_is_of_order_four(ratio: float) -> None:
    """The error of a smooth manoeuvre falls with the fourth power of the sub-step."""
    start = BicycleState(0.0, 0.0, 0.0, 12.0, 0.0, 0.0, 0.1)
    arguments = ((0.03, 0.3, 0.0), kinematics_of(CAR, ratio), 1.0)
    exact = np.array(advance(start, *arguments, 20_000))
    steps = np.array([10, 20, 40, 80])
    errors = [np.abs(np.array(advance(start, *arguments, int(n))) - exact).max() for n in steps]
    slope = np.polyfit(np.log(1.0 / steps), np.log(errors), 1)[0]
    assert 3.7 < slope < 4.4


@given(st.lists(st.tuples(STEER, PEDAL, PEDAL), min_size=5, max_size=40), st.floats(0.0, 30.0))
def test_no_command_makes_it_reverse_or_break_its_limits(
    commands: list[tuple[float, float, float]], v: float
) -> None:
    car = KinematicBicycle(CAR, at_speed(v))
    before = car.state
    for command in commands:
        state = car.step(Command(*command), 0.1)
        assert state.v >= 0.0
        assert abs(state.steer) <= CAR.max_steer + 1e-12
        assert abs(state.steer - before.steer) <= CAR.max_steer_rate * 0.1 + 1e-12
        assert state.a <= CAR.max_accel and state.a * max(state.v, 1e-9) <= CAR.max_power
        assert state.v <= before.v + 0.1 * CAR.max_accel
        assert hypot(state.x - before.x, state.y - before.y) <= 0.1 * max(state.v, before.v) + 0.03
        assert 0.0 <= car.actuation.throttle <= 1.0 and 0.0 <= car.actuation.brake <= 1.0
        before = state


@given(st.floats(0.0, 40.0), PEDAL)
def test_energy_only_falls_without_throttle(v: float, brake: float) -> None:
    car = KinematicBicycle(CAR, at_speed(v))
    speeds = [car.step(Command(0.0, 0.0, brake), 0.05).v for _ in range(40)]
    assert (np.diff([v, *speeds]) <= 1e-12).all()


@given(st.floats(0.0, CAR.rolling / CAR.max_accel * 0.999), PEDAL, STEER)
def test_a_standstill_is_held_exactly(throttle: float, brake: float, steer: float) -> None:
    car = KinematicBicycle(CAR, at_speed(0.0))
    for _ in range(50):
        state = car.step(Command(steer, throttle, brake), 0.02)
    assert (state.x, state.y, state.yaw, state.v, state.a) == (0.0, 0.0, 0.0, 0.0, 0.0)


def test_stopping_distance_is_that_of_constant_deceleration() -> None:
    car = KinematicBicycle(VehicleParameters(drag=0.0, rolling=0.0), at_speed(20.0, a=-4.5))
    while car.state.v > 0.0:
        car.step(Command(0.0, 0.0, 0.5), 0.01)
    assert car.state.x == pytest.approx(20.0**2 / (2.0 * 4.5), abs=1e-6)
    assert car.state.t == pytest.approx(20.0 / 4.5, abs=0.011)
    assert car.state.a == 0.0


@given(st.floats(0.0, 35.0), st.floats(-3.0, 1.5), st.floats(-0.15, 0.15))
def test_it_starts_as_the_log_says(v: float, a: float, kappa: float) -> None:
    car = KinematicBicycle(CAR, at_speed(v, kappa, a))
    assert car.state.kappa == pytest.approx(kappa, abs=1e-12)
    if v > 0.0:
        assert car.state.a == pytest.approx(a, abs=1e-9)


def test_a_log_in_reverse_starts_from_a_standstill() -> None:
    assert KinematicBicycle(CAR, at_speed(-2.0)).state.v == 0.0


def test_time_is_a_whole_nanosecond() -> None:
    car = KinematicBicycle(CAR, at_speed(10.0))
    for step in range(1, 2001):
        assert car.step(Command(0.0, 0.0, 0.0), 0.01).t == step * 10_000_000 / 1e9


@pytest.mark.parametrize("lag", [0.0, 1e-4, 0.02, 1.0])
def test_any_lag_is_integrated_stably(lag: float) -> None:
    car = KinematicBicycle(
        VehicleParameters(steer_lag=lag, throttle_lag=lag, brake_lag=lag), at_speed(10.0)
    )
    for _ in range(300):
        state = car.step(Command(0.1, 0.2, 0.0), 0.05)
    assert state.steer == pytest.approx(0.1, abs=1e-5)
    assert car.actuation.throttle == pytest.approx(0.2, abs=1e-5)


@pytest.mark.parametrize("name", [name for name in VEHICLE.builtin if name != "perfect"])
def test_every_vehicle_turns_with_its_steering_and_is_deterministic(name: str) -> None:
    """The contract of the seam, for models to come as well.

    The perfect vehicle is steered by its plan.
    """
    if name == "multibody":
        pytest.importorskip("vehiclemodels", reason="needs the package commonroad-vehicle-models")

    def ride() -> list[EgoState]:
        car = VEHICLE.builtin[name](CAR, at_speed(5.0))
        return [car.step(Command(0.1 if k < 50 else -0.1, 0.1, 0.0), 0.01) for k in range(100)]

    one, two = ride(), ride()
    assert one == two
    assert one[49].yaw_rate > 0.0 > one[99].yaw_rate
    assert one[-1].t == 1.0
    assert abs(one[-1].yaw) < pi


@given(st.floats(0.1, 30.0), st.floats(-0.6, 0.6), st.floats(-1.0, 0.9), st.floats(-3.0, 3.0))
def test_it_is_the_corrected_equation_at_the_centre_of_mass(
    v: float, steer: float, ratio: float, yaw: float
) -> None:
    """x' = V cos(yaw + beta), y' = V sin(yaw + beta), yaw' = V cos(beta) (tan df - tan dr) / L.

    No wheel slips.
    """
    state = BicycleState(0.0, 0.0, yaw, v, steer, 0.0, 0.0)
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
def test_held_wheels_drive_a_circle_of_the_stated_curvature(
    v: float, steer: float, ratio: float
) -> None:
    free = VehicleParameters(drag=0.0, rolling=0.0)
    car = KinematicBicycle(free, at_speed(v), rear_ratio=ratio)
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


def test_the_named_vehicle_is_the_bicycle_with_its_ratio_and_a_ratio_out_of_range_is_refused() -> (
    None
):
    named, own = (
        VEHICLE.builtin["kinematic_rear_steer"](CAR, at_speed(8.0)),
        KinematicBicycle(CAR, at_speed(8.0), rear_ratio=-0.2),
    )
    command = Command(0.2, 0.3, 0.0)
    assert [named.step(command, 0.01) for _ in range(50)] == [
        own.step(command, 0.01) for _ in range(50)
    ]
    assert REAR_RATIO == -0.2 and named.state.v_lat < 0.0
    with pytest.raises(ConfigError, match="rear_ratio"):
        KinematicBicycle(CAR, at_speed(8.0), rear_ratio=1.0)


@given(st.floats(-0.1, 0.1), st.floats(-0.9, 0.6))
def test_it_starts_with_the_curvature_of_the_log(kappa: float, ratio: float) -> None:
    assert KinematicBicycle(
        CAR, at_speed(6.0, kappa), rear_ratio=ratio
    ).state.kappa == pytest.approx(kappa, abs=1e-9)
