"""The dynamic single-track model: laws, analytic cornering, limits, standstill, agreement with
CommonRoad's models.
"""

from dataclasses import replace
from math import atan2, cos, hypot, sin, sqrt, tan
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from replan.core.errors import ConfigError
from replan.logs.states import Command, EgoState
from replan.logs.vehicle import VehicleParameters, vehicle_names, vehicle_parameters
from replan.replay.vehicle.drivetrain import Drivetrain
from replan.replay.vehicle.single_track import (
    Gearbox,
    SingleTrack,
    SingleTrackCar,
    SingleTrackState,
    advance,
    car_of,
    loads,
    wheel_forces,
)
from replan.replay.vehicle.tyres import GRAVITY

CAR = VehicleParameters()
FREE = replace(CAR, drag=0.0, rolling=0.0)
BMW = vehicle_parameters("bmw_320i")
PEDAL, STEER = st.floats(0.0, 1.0), st.floats(-0.6, 0.6)
COMMANDS = st.lists(st.tuples(STEER, PEDAL, PEDAL), min_size=3, max_size=25)


def start(v: float, kappa: float = 0.0, a: float = 0.0) -> EgoState:
    return EgoState(0.0, 0.0, 0.0, 0.0, v, a, kappa)


def kernel_car(p: VehicleParameters = CAR, **keywords: Any) -> SingleTrackCar:
    return car_of(p, Drivetrain(p), **keywords)


def energy(car: SingleTrack) -> float:
    """Kinetic, J."""
    s = car.inner
    return 0.5 * car.model.mass * (s.vx**2 + s.vy**2) + 0.5 * car.model.inertia * s.r**2


@pytest.mark.parametrize("tyre", ["linear", "fiala", "pacejka"])
def test_integration_is_of_order_four(tyre: str) -> None:
    """The error of a smooth manoeuvre falls with the fourth power of the sub-step."""
    car = kernel_car(tyre=tyre)
    begin = SingleTrackState(0.0, 0.0, 0.0, 14.0, 0.1, 0.05, 0.02, 0.0, 0.1)
    box = Gearbox(0, 0.0, 1.0)
    held = (0.05, 0.3, 0.0)
    exact = np.array(advance(begin, box, held, car, 1.0, 20_000)[0])
    steps = np.array([40, 80, 160, 320])
    errors = [
        np.abs(np.array(advance(begin, box, held, car, 1.0, int(n))[0]) - exact).max()
        for n in steps
    ]
    slope = np.polyfit(np.log(1.0 / steps), np.log(errors), 1)[0]
    assert 3.7 < slope < 4.4
    assert errors[1] < 1e-5


@pytest.mark.parametrize("v", [5.0, 15.0, 30.0])
@pytest.mark.parametrize("stiffness", [1.0, 0.7])
def test_steady_cornering_is_that_of_the_understeer_gradient(v: float, stiffness: float) -> None:
    """Yaw rate v steer / (L + K v^2), side slip at the rear axle -m a a_y / (L C_r); K by the
    linear theory.
    """
    car = SingleTrack(FREE, start(v), tyre="linear", tyre_stiffness=stiffness)
    for _ in range(800):
        state = car.step(Command(1e-3, 0.0, 0.0), 0.01)
    p, L = FREE, FREE.wheelbase
    front, rear = stiffness * p.cornering_front, stiffness * p.cornering_rear
    gradient = p.mass / L * (p.cog_to_rear / front - p.cog_to_front / rear)
    assert state.yaw_rate == pytest.approx(state.v * 1e-3 / (L + gradient * state.v**2), rel=1e-3)
    slip = -p.mass * p.cog_to_front * state.v * state.yaw_rate / (L * rear)
    assert state.v_lat / state.v == pytest.approx(slip, rel=2e-3)
    assert state.kappa == pytest.approx(state.yaw_rate / state.v, rel=1e-3)


@pytest.mark.parametrize("tyre", ["fiala", "pacejka"])
@pytest.mark.parametrize("mu", [1.0, 0.4])
def test_cornering_saturates_at_friction(tyre: str, mu: float) -> None:
    car = SingleTrack(replace(FREE, tyre_friction=mu), start(18.0), tyre=tyre)
    lateral = []
    for k in range(300):
        state = car.step(Command(min(2e-3 * k, 0.3), 0.0, 0.0), 0.01)
        fxf, fyf, _, fyr = wheel_forces(car.inner, 1.0, 0, car.model)
        lateral.append((fyf * cos(state.steer) + fxf * sin(state.steer) + fyr) / FREE.mass)
    assert 0.95 * mu * GRAVITY < max(lateral) <= mu * GRAVITY * (1.0 + 1e-9)


@given(
    st.floats(-5.0, 40.0),
    st.floats(-15.0, 15.0),
    st.floats(-3.0, 3.0),
    STEER,
    PEDAL,
    PEDAL,
    st.sampled_from(["fiala", "pacejka"]),
    st.floats(0.1, 1.2),
)
def test_the_ground_never_gives_more_than_friction(
    vx: float,
    vy: float,
    r: float,
    steer: float,
    throttle: float,
    brake: float,
    tyre: str,
    mu: float,
) -> None:
    car = kernel_car(replace(CAR, tyre_friction=mu), tyre=tyre)
    s = SingleTrackState(0.0, 0.0, 0.0, vx, vy, r, steer, throttle, brake)
    for direction in (-1.0, 0.0, 1.0):
        fxf, fyf, fxr, fyr = wheel_forces(s, direction, 0, car)
        assert hypot(fxf, fyf) + hypot(fxr, fyr) <= mu * CAR.mass * GRAVITY * (1.0 + 1e-9)


@given(st.floats(-20.0, 20.0))
def test_loads_add_up_and_shift_against_the_pull(pull: float) -> None:
    car = kernel_car(tyre="fiala")
    front, rear = loads(pull, car)
    assert front + rear == pytest.approx(CAR.mass * GRAVITY)
    assert min(front, rear) >= 0.0
    if abs(pull) < 9.0:
        assert rear - car.rear.load == pytest.approx(
            CAR.mass * pull * CAR.cog_height / CAR.wheelbase, abs=1e-6
        )


@given(COMMANDS, st.floats(0.0, 30.0), st.sampled_from(["linear", "fiala", "pacejka"]))
def test_mirrored_commands_drive_mirrored_ways(
    commands: list[tuple[float, float, float]], v: float, tyre: str
) -> None:
    left, right = (
        SingleTrack(BMW, start(v, 0.01), tyre=tyre),
        SingleTrack(BMW, start(v, -0.01), tyre=tyre),
    )
    for steer, throttle, brake in commands:
        one = left.step(Command(steer, throttle, brake), 0.1)
        two = right.step(Command(-steer, throttle, brake), 0.1)
    assert (one.x, one.v, one.a) == (two.x, two.v, two.a)
    assert (one.y, one.yaw, one.yaw_rate, one.v_lat, one.kappa, one.steer) == (
        -two.y,
        -two.yaw,
        -two.yaw_rate,
        -two.v_lat,
        -two.kappa,
        -two.steer,
    )


@given(
    st.lists(st.tuples(STEER, PEDAL), min_size=3, max_size=20),
    st.floats(0.0, 40.0),
    st.floats(0.1, 1.1),
    st.sampled_from(sorted(vehicle_names())),
)
def test_without_throttle_energy_falls(
    commands: list[tuple[float, float]], v: float, mu: float, name: str
) -> None:
    car = SingleTrack(replace(vehicle_parameters(name), tyre_friction=mu), start(v))
    before = energy(car)
    for steer, brake in commands:
        car.step(Command(steer, 0.0, brake), 0.1)
        assert energy(car) <= before * (1.0 + 1e-6) + 1e-9
        before = energy(car)


@given(COMMANDS, st.floats(0.0, 45.0), st.floats(0.05, 1.1))
def test_nothing_breaks_it(commands: list[tuple[float, float, float]], v: float, mu: float) -> None:
    """Any command at any friction leaves a finite state within the actuators' limits."""
    car = SingleTrack(replace(BMW, tyre_friction=mu), start(v))
    for command in commands:
        state = car.step(Command(*command), 0.2)
        assert np.isfinite(
            [state.x, state.y, state.yaw, state.v, state.a, state.kappa, state.yaw_rate]
        ).all()
        assert abs(state.steer) <= BMW.max_steer + 1e-12 and abs(state.yaw_rate) < 20.0
        assert hypot(state.v, state.v_lat) < v + 6.5 * state.t + 3.0


def test_a_spin_on_ice_ends_at_a_stand() -> None:
    car = SingleTrack(replace(BMW, tyre_friction=0.15), start(15.0))
    car.inner = car.inner._replace(r=2.5)
    backwards, before = 0.0, energy(car)
    for k in range(3000):
        state = car.step(Command(0.3, 0.0, 0.2 if k > 500 else 0.0), 0.01)
        backwards = min(backwards, state.v)
        assert energy(car) <= before
        before = energy(car)
    assert backwards < -1.0
    assert (state.v, state.v_lat, state.yaw_rate, state.a) == (0.0, 0.0, 0.0, 0.0)


@given(st.floats(0.0, CAR.rolling / CAR.max_accel * 0.999), PEDAL, STEER)
def test_a_standstill_is_held_exactly(throttle: float, brake: float, steer: float) -> None:
    car = SingleTrack(CAR, start(0.0))
    for _ in range(50):
        state = car.step(Command(steer, throttle, brake), 0.02)
    assert (state.x, state.y, state.yaw, state.v, state.a, state.yaw_rate) == (0.0,) * 6


@given(st.floats(0.5, 20.0), STEER, st.floats(0.1, 1.0))
def test_braking_stops_and_never_reverses(v: float, steer: float, brake: float) -> None:
    """Within the grip; beyond it, a vehicle that turns round may stop backwards."""
    assume(v**2 * abs(tan(steer)) / CAR.wheelbase + CAR.max_decel * brake < 9.5)
    car = SingleTrack(CAR, start(v))
    for _ in range(int(100 * (v / (CAR.max_decel * brake) + 1.0)) + 20):
        state = car.step(Command(steer, 0.0, brake), 0.01)
        assert state.v >= 0.0
    assert (state.v, state.yaw_rate, state.v_lat) == (0.0, 0.0, 0.0)
    after = car.step(Command(steer, 0.0, 0.0), 1.0)
    assert (after.x, after.y, after.yaw, after.v, after.a) == (
        state.x,
        state.y,
        state.yaw,
        0.0,
        0.0,
    )


@pytest.mark.parametrize(
    ("name", "mu"),
    [
        ("bmw_320i", 1.0),
        ("bmw_320i", 0.4),
        ("small_electric", 1.0),
        ("small_electric", 0.4),
        ("vw_vanagon", 0.4),
    ],
)
def test_full_brake_in_a_curve_does_not_spin_it(name: str, mu: float) -> None:
    """With the steering wheel held.

    (The van, tall and with stiffness in proportion to load, needs a driver at 1.0.)
    """
    p = replace(vehicle_parameters(name), tyre_friction=mu)
    car = SingleTrack(p, start(20.0, 0.35 * mu * GRAVITY / 400.0))
    for _ in range(700):
        state = car.step(Command(car.state.steer, 0.0, 1.0), 0.01)
        assert abs(state.v_lat) < 0.2 * state.v + 0.05
    assert state.v == 0.0


@pytest.mark.parametrize("grade", [0.05, 0.15])
def test_it_is_held_on_a_grade_and_starts_uphill(grade: float) -> None:
    car = SingleTrack(BMW, start(0.0, a=-3.0), grade=grade)
    for command in (Command(0.0, 0.0, 0.3), Command(0.0, 0.0, 0.0), Command(0.0, 0.02, 0.0)):
        for _ in range(100):
            assert car.step(command, 0.01).v == 0.0
    for _ in range(300):
        state = car.step(Command(0.0, 0.6, 0.0), 0.01)
        assert state.v >= 0.0
    assert state.v > 1.5 and state.x > 2.0


def test_the_grade_slows_by_its_sine() -> None:
    car = SingleTrack(FREE, start(20.0), grade=0.1)
    assert car.step(Command(0.0, 0.0, 0.0), 0.01).a == pytest.approx(
        -GRAVITY * 0.1 / sqrt(1.01), rel=1e-6
    )


@pytest.mark.parametrize("steer", [0.1, -0.4, 0.6])
@pytest.mark.parametrize("v", [0.05, 0.2, 0.5])
def test_slowly_it_drives_the_kinematic_circle(v: float, steer: float) -> None:
    kappa = tan(steer) / FREE.wheelbase
    car = SingleTrack(FREE, start(v, kappa))
    radius = 1.0 / kappa
    for _ in range(2000):
        state = car.step(Command(steer, 0.0, 0.0), 0.01)
        assert abs(hypot(state.x, state.y - radius) - abs(radius)) < 0.01
    assert state.yaw_rate == pytest.approx(state.v * kappa, rel=2e-3)


@given(
    st.floats(1.0, 35.0),
    st.floats(-2.0, 1.0),
    st.floats(-6.0, 6.0),
    st.sampled_from(vehicle_names()),
)
def test_it_starts_cornering_as_the_log_says(v: float, a: float, lateral: float, name: str) -> None:
    p = vehicle_parameters(name)
    tightest = min(0.15, 0.6 * p.max_kappa)
    kappa = float(np.clip(lateral / v**2, -tightest, tightest))
    assume(v < p.top_speed)
    begin = start(v, kappa, a)
    car = SingleTrack(p, begin)
    assert (car.state.x, car.state.y, car.state.yaw, car.state.v) == (0.0, 0.0, 0.0, v)
    if v > 2.5:
        assert car.state.kappa == pytest.approx(kappa, rel=0.06, abs=1e-5)
    later = car.step(Command(car.state.steer, car.actuation.throttle, car.actuation.brake), 0.05)
    assert later.yaw_rate == pytest.approx(car.state.yaw_rate, rel=1e-9)
    assert later.yaw == pytest.approx(v * kappa * 0.05, rel=0.1, abs=1e-4)


def test_sub_steps_are_short_enough_at_every_speed() -> None:
    """A control step of 10 ms, whatever sub-steps it takes, is as good as steps of 0.5 ms."""
    for v in (0.3, 1.0, 3.0, 10.0, 30.0):
        coarse, fine = SingleTrack(BMW, start(v)), SingleTrack(BMW, start(v))
        for k in range(200):
            command = Command(0.08 * sin(0.05 * k), 0.1, 0.0)
            one = coarse.step(command, 0.01)
            for _ in range(20):
                two = fine.step(command, 0.0005)
        assert hypot(one.x - two.x, one.y - two.y) < 2e-4
        assert one.yaw_rate == pytest.approx(two.yaw_rate, abs=1e-4)


def test_the_reference_point_is_the_rear_axle() -> None:
    """Positions add up to the velocities of the rear axle, and kappa is the curvature of its
    path.
    """
    car = SingleTrack(BMW, start(15.0))
    states = [car.step(Command(0.05 * sin(0.02 * k), 0.1, 0.0), 0.01) for k in range(300)]
    x, y = np.array([s.x for s in states]), np.array([s.y for s in states])
    velocity = np.array(
        [
            (s.v * cos(s.yaw) - s.v_lat * sin(s.yaw), s.v * sin(s.yaw) + s.v_lat * cos(s.yaw))
            for s in states
        ]
    )
    np.testing.assert_allclose(np.gradient(x, 0.01)[1:-1], velocity[1:-1, 0], atol=2e-3)
    np.testing.assert_allclose(np.gradient(y, 0.01)[1:-1], velocity[1:-1, 1], atol=2e-3)
    course = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    kappa = np.gradient(course, 0.01) / np.hypot(*velocity.T)
    np.testing.assert_allclose([s.kappa for s in states][5:-5], kappa[5:-5], atol=2e-4)


def test_keywords_are_checked() -> None:
    with pytest.raises(ConfigError, match="no tyre is called 'magic'"):
        SingleTrack(CAR, start(1.0), tyre="magic")


def side_by_side(
    rates: Any, begin: list[float], q: Any, tyre: str, amplitude: float, v: float
) -> tuple[np.ndarray, np.ndarray]:
    """Four seconds of a 0.5 Hz slalom in our model, and the package's model with the same steering
    and acceleration.

    Columns of both: centre of gravity x and y, yaw, yaw rate, side slip.
    """
    car, x, h, b = SingleTrack(BMW, start(v), tyre=tyre), begin, 1e-3, BMW.cog_to_rear
    ours, theirs = [], []
    for k in range(4000):
        s0 = car.state
        s1 = car.step(Command(amplitude * sin(np.pi * k * h), 0.05, 0.0), h)
        u = [(s1.steer - s0.steer) / h, 0.5 * (s0.a + s1.a)]
        k1 = rates(list(x), u, q)
        k2 = rates([a + 0.5 * h * c for a, c in zip(x, k1, strict=True)], u, q)
        x = [a + h * c for a, c in zip(x, k2, strict=True)]
        at = (s1.x + b * cos(s1.yaw), s1.y + b * sin(s1.yaw))
        ours.append((*at, s1.yaw, s1.yaw_rate, atan2(s1.v_lat + b * s1.yaw_rate, s1.v)))
        theirs.append((x[0], x[1], x[4], x[5], x[6]))
    return np.array(ours), np.array(theirs)


REASON = "needs the package commonroad-vehicle-models"


@pytest.mark.parametrize("amplitude", [0.01, 0.03])
def test_the_linear_tyre_agrees_with_commonroads_single_track(amplitude: float) -> None:
    """Within 1 % of the peak yaw rate and slip angle, and 2 cm over 60 m."""
    rates = pytest.importorskip(
        "vehiclemodels.vehicle_dynamics_st", reason=REASON
    ).vehicle_dynamics_st
    q = pytest.importorskip("vehiclemodels.vehicle_parameters").setup_vehicle_parameters(
        vehicle_id=2
    )
    begin = [BMW.cog_to_rear, 0.0, 0.0, 15.0, 0.0, 0.0, 0.0]
    ours, theirs = side_by_side(rates, begin, q, "linear", amplitude, 15.0)
    peaks = np.abs(theirs).max(axis=0)
    worst = np.abs(ours - theirs).max(axis=0)
    assert peaks[3] > 5.0 * amplitude
    assert (worst[2:] < 0.01 * peaks[2:]).all()
    assert (worst[:2] < 0.02).all()


def test_the_magic_formula_agrees_with_commonroads_drift_model() -> None:
    """At 4 m/s2 lateral: within 1 % of the peak yaw rate, 3 % of the slip angle, 2 cm to the side.

    Along the road they differ, since the drift model takes the given acceleration as that of its
    wheels.
    """
    rates = pytest.importorskip(
        "vehiclemodels.vehicle_dynamics_std", reason=REASON
    ).vehicle_dynamics_std
    init = pytest.importorskip("vehiclemodels.init_std").init_std
    q = pytest.importorskip("vehiclemodels.vehicle_parameters").setup_vehicle_parameters(
        vehicle_id=2
    )
    begin = init([BMW.cog_to_rear, 0.0, 0.0, 15.0, 0.0, 0.0, 0.0], q)
    ours, theirs = side_by_side(rates, begin, q, "pacejka", 0.05, 15.0)
    worst, peaks = np.abs(ours - theirs).max(axis=0), np.abs(theirs).max(axis=0)
    assert 15.0 * peaks[3] > 3.8
    assert worst[3] < 0.01 * peaks[3] and worst[4] < 0.03 * peaks[4]
    assert worst[1] < 0.02
