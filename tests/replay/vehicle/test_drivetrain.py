"""Drive trains: the inverse, gears, overrun, dead time, load."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from replan.logs.states import Command, EgoState
from replan.logs.vehicle import VehicleParameters, vehicle_names, vehicle_parameters
from replan.replay.vehicle.drivetrain import (
    MIN_HOLD_S,
    Drivetrain,
    Gearbox,
    drive_force,
    pending,
    shifted,
    spans,
)
from replan.replay.vehicle.pedal_map import PedalPowertrain
from replan.replay.vehicle.single_track import SingleTrack

CARS = {
    "default": VehicleParameters(),
    **{name: vehicle_parameters(name) for name in vehicle_names()},
}
NAMES = sorted(CARS)
BMW = CARS["bmw_320i"]


@given(st.sampled_from(NAMES), st.floats(0.5, 40.0), st.floats(-1.0, 1.0))
def test_the_inverse_gives_the_acceleration_back(name: str, v: float, share: float) -> None:
    """A pedal computed from an acceleration gives that acceleration in steady state, in the gear
    for it.
    """
    train = Drivetrain(CARS[name])
    reach = train.full_throttle(v) if share > 0.0 else train.full_brake(v)
    wanted = train.coasting(v) + share * reach
    throttle = max(wanted - train.coasting(v), 0.0) / train.full_throttle(v)
    brake = max(train.coasting(v) - wanted, 0.0) / train.full_brake(v)
    gear = train.gearbox(v, throttle).gear
    tables = train.tables
    given_back = (
        drive_force(v, throttle, gear, tables)
        - tables.rolling
        - tables.drag * v * v
        - brake * tables.max_decel
    )
    assert given_back == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("v", "acceleration"), [(3.0, 1.0), (12.0, 0.6), (15.0, -3.0), (25.0, -0.8)]
)
def test_the_vehicle_gives_the_acceleration_that_was_asked_for(
    name: str, v: float, acceleration: float
) -> None:
    if v > CARS[name].top_speed:
        pytest.skip("it does not reach this speed")
    car = SingleTrack(
        replace(CARS[name], throttle_lag=0.01, brake_lag=0.01), EgoState(0.0, 0.0, 0.0, 0.0, v)
    )
    for _ in range(40):
        beyond = acceleration - car.powertrain.coasting(car.state.v)
        throttle = max(beyond / car.powertrain.full_throttle(car.state.v), 0.0)
        state = car.step(
            Command(0.0, throttle, max(-beyond / car.powertrain.full_brake(car.state.v), 0.0)), 0.01
        )
    assert state.a == pytest.approx(acceleration, abs=0.02)


@pytest.mark.parametrize("name", NAMES)
def test_overrun_and_resistance_only_slow_down(name: str) -> None:
    train = Drivetrain(CARS[name])
    assert all(
        train.coasting(v) < 0.0 and train.full_throttle(v) >= 0.0
        for v in np.linspace(0.0, 60.0, 241)
    )
    assert train.coasting(0.0) == -CARS[name].rolling


def test_without_a_motor_it_is_the_plain_powertrain() -> None:
    plain, train = PedalPowertrain(CARS["default"]), Drivetrain(CARS["default"])
    for v in np.linspace(0.0, 40.0, 81):
        assert train.full_throttle(v) == pytest.approx(plain.full_throttle(v), rel=1e-3)
        assert train.coasting(v) == pytest.approx(plain.coasting(v), abs=1e-12)


@pytest.mark.parametrize(
    ("name", "gears"), [("bmw_320i", 5), ("vw_vanagon", 3), ("small_electric", 1)]
)
def test_full_throttle_shifts_up_through_the_gears(name: str, gears: int) -> None:
    car = SingleTrack(CARS[name], EgoState(0.0, 0.0, 0.0, 0.0, 0.0))
    seen, speeds = [car.gear], [0.0]
    for k in range(3000):
        throttle = 1.0 if k < 2500 else 0.3
        speeds.append(car.step(Command(0.0, throttle, 0.0), 0.01).v)
        seen.append(car.gear)
    assert sorted(set(seen)) == list(range(1, max(seen) + 1)) and max(seen) == gears
    assert (np.diff(speeds[:500]) >= 0.0).all()
    told = CARS[name]
    assert max(np.diff(speeds)) / 0.01 <= max(told.max_accel * 1.05, 1.0)


def test_a_kick_down_takes_its_time() -> None:
    car = SingleTrack(BMW, EgoState(0.0, 0.0, 0.0, 0.0, 20.0))
    cruising = car.gear
    accelerations = [car.step(Command(0.0, 1.0, 0.0), 0.01).a for _ in range(100)]
    assert car.gear < cruising
    assert max(accelerations[:10]) < 0.6 * accelerations[-1]


@given(st.lists(st.tuples(st.floats(0.0, 45.0), st.floats(0.0, 1.0)), min_size=2, max_size=30))
def test_gears_do_not_hunt(demands: list[tuple[float, float]]) -> None:
    """Between two shifts up there is at least MIN_HOLD_S, whatever is asked for.

    A gear always exists.
    """
    tables, box, ups, t = Drivetrain(BMW).tables, Gearbox(0, 0.0, MIN_HOLD_S), [], 0.0
    for v, throttle in demands:
        for _ in range(20):
            after = Gearbox(*shifted(box, v, throttle, tables, 0.01))
            t += 0.01
            if after.gear > box.gear:
                ups.append(t)
            assert 0 <= after.gear < len(BMW.gears)
            box = after
    assert all(np.diff(ups) >= MIN_HOLD_S - 1e-9)


def test_a_load_leaves_the_forces() -> None:
    empty, full = Drivetrain(BMW), Drivetrain(BMW.loaded(1.2 * BMW.mass))
    for v in (2.0, 15.0, 30.0):
        assert 1.2 * full.full_throttle(v) == pytest.approx(empty.full_throttle(v))
        assert 1.2 * full.full_brake(v) == pytest.approx(empty.full_brake(v))
        assert 1.2 * (full.coasting(v) + BMW.rolling) == pytest.approx(
            empty.coasting(v) + BMW.rolling
        )


@given(st.integers(0, 300), st.lists(st.floats(0.0, 1.0), min_size=1, max_size=40))
def test_dead_time_delays_and_loses_nothing(delay_ms: int, commands: list[float]) -> None:
    delay = delay_ms / 1e3
    line, t, effect = pending(delay, -1.0), 0.0, []
    for command in commands:
        found, line = spans(line, command, 0.01)
        for span, value in found:
            assert span > 0.0
            effect.append((t, value))
            t += span
    assert t == pytest.approx(0.01 * len(commands))
    for begin, value in effect:
        index = int(np.floor((begin + 1e-9 - delay) / 0.01))
        assert value == (-1.0 if index < 0 else commands[index])


def test_the_brake_answers_after_its_dead_time_and_with_its_lag() -> None:
    p = replace(CARS["default"], brake_delay=0.1, brake_lag=0.2, drag=0.0, rolling=0.0)
    car = SingleTrack(p, EgoState(0.0, 0.0, 0.0, 0.0, 20.0))
    a = np.array([car.step(Command(0.0, 0.0, 0.4), 0.01).a for _ in range(150)])
    t = 0.01 * np.arange(1, 151)
    expected = -0.4 * p.max_decel * (1.0 - np.exp(-np.maximum(t - 0.1, 0.0) / 0.2))
    assert (a[t <= 0.1 + 1e-9] == 0.0).all()
    np.testing.assert_allclose(a, expected, atol=1e-4)
