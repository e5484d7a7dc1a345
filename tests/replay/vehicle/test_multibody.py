"""The multi-body plant: it stands, drives, brakes, corners as the single-track model does.

Says what it needs.
"""

import sys
from dataclasses import replace
from math import hypot, sin

import numpy as np
import pytest

from replan.core.errors import ConfigError
from replan.logs.states import Command, EgoState
from replan.logs.vehicle import VehicleParameters, vehicle_parameters
from replan.replay.vehicle.multibody import Multibody, package_parameters, slowest_wheel
from replan.replay.vehicle.single_track import SingleTrack

BMW = vehicle_parameters("bmw_320i")


@pytest.fixture(autouse=True)
def _package(request: pytest.FixtureRequest) -> None:
    if "absent" not in request.node.name:
        pytest.importorskip("vehiclemodels", reason="needs the package commonroad-vehicle-models")


def start(v: float, kappa: float = 0.0, a: float = 0.0) -> EgoState:
    return EgoState(0.0, 0.0, 0.0, 0.0, v, a, kappa)


def test_absent_package_is_an_error_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("vehiclemodels", "vehiclemodels.vehicle_dynamics_mb", "vehiclemodels.init_mb"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ConfigError, match=r"pip install 'replan\[multibody\]'"):
        Multibody(BMW, start(0.0))


@pytest.mark.parametrize("v", [10.0, 20.0])
def test_it_corners_like_the_single_track_model(v: float) -> None:
    """A slalom of 2 m/s2: yaw rates within 20 % of the peak (it rolls, and its wheels camber), the
    same way round.
    """
    one, two = SingleTrack(BMW, start(v)), Multibody(BMW, start(v))
    rates, speeds = [], []
    for k in range(200):
        command = Command(5.5 / v**2 * sin(0.03 * k), 0.1, 0.0)
        a, b = one.step(command, 0.01), two.step(command, 0.01)
        rates.append((a.yaw_rate, b.yaw_rate))
        speeds.append((a.v, b.v))
    peak = np.abs(rates).max(axis=0)
    assert np.abs(np.diff(rates)).max() < 0.2 * peak[0]
    assert np.abs(np.diff(speeds)).max() < 0.3
    assert np.corrcoef(np.array(rates).T)[0, 1] > 0.98


def test_it_stands_starts_and_stops() -> None:
    car = Multibody(BMW, start(0.0, a=-2.0))
    for _ in range(50):
        assert car.step(Command(0.1, 0.0, 0.2), 0.01).x == 0.0
    for _ in range(300):
        state = car.step(Command(0.05, 0.3, 0.0), 0.01)
        assert state.v >= 0.0
    assert state.v > 2.0 and state.yaw > 0.0
    for _ in range(300):
        state = car.step(Command(0.0, 0.0, 0.4), 0.01)
    assert (state.v, state.a, state.yaw_rate) == (0.0, 0.0, 0.0)


@pytest.mark.slow
def test_handing_over_is_smooth() -> None:
    """Through the speeds where the models take over from each other, positions and speeds join."""
    car = Multibody(BMW, start(3.0, 0.05))
    states = [
        car.step(Command(0.13, 0.0, 0.15 if k < 220 else 0.0), 0.01)
        if k < 260
        else car.step(Command(0.13, 0.25, 0.0), 0.01)
        for k in range(700)
    ]
    step = np.hypot(np.diff([s.x for s in states]), np.diff([s.y for s in states]))
    assert step.max() < 0.05
    assert np.abs(np.diff([s.v for s in states])).max() < 0.08
    assert np.abs(np.diff([s.yaw_rate for s in states])).max() < 0.03
    assert min(s.v for s in states) < 1.0 < states[-1].v - 1.0


@pytest.mark.slow
def test_full_brake_neither_locks_nor_spins() -> None:
    car = Multibody(BMW, start(25.0))
    states = [car.step(Command(0.0, 0.0, 1.0), 0.01) for _ in range(500)]
    assert states[-1].v == 0.0
    assert abs(states[-1].yaw) < 0.01
    assert -7.5 < min(s.a for s in states if s.v > 1.5) < -6.5


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 8))]
)
def test_whatever_is_commanded_it_ends_as_numbers_and_gains_no_speed_by_sliding(seed: int) -> None:
    """Random full steering, throttle and brake at speed: spins, lifted wheels, backwards."""
    rng = np.random.default_rng(seed)
    v = rng.uniform(15.0, 40.0)
    car = Multibody(vehicle_parameters(("bmw_320i", "small_electric")[seed % 2]), start(v))
    slid, allowed = 0.0, v
    for _ in range(12):
        command = Command(rng.uniform(-0.65, 0.65), *rng.permutation([rng.uniform(0.0, 1.0), 0.0]))
        for _ in range(25):
            state = car.step(command, 0.01)
            allowed += 0.01 * 6.0 * command.throttle
            assert np.isfinite([getattr(state, name) for name in EgoState.__slots__]).all()
            assert hypot(state.v, state.v_lat) < allowed + 4.0 + 2.0 * abs(state.yaw_rate)
        slid = max(slid, abs(state.v_lat))
    assert slid > 1.0


@pytest.mark.slow
def test_a_spin_is_driven_by_the_single_track_model_and_left_again() -> None:
    car = Multibody(BMW, start(25.0))
    for k in range(300):
        car.step(Command(0.5 if k < 100 else -0.5, 0.0, 0.0 if k < 60 else 0.5), 0.01)
        ahead = slowest_wheel(car.inner.vx, car.inner.vy, car.inner.r, car.inner.steer, (1.16, 0.7))
        assert car.body is None or ahead > 0.0
    assert car.body is None
    for _ in range(600):
        state = car.step(Command(0.0, 0.4 if car.inner.vx < 5.0 else 0.1, 0.0), 0.01)
    assert car.body is not None and state.v > 3.0


def test_a_model_that_diverges_is_a_line_for_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    car = Multibody(BMW, start(20.0))

    def rates(*_: object) -> list[float]:
        raise ZeroDivisionError("float division by zero")

    monkeypatch.setattr(car, "_rates", rates)
    with pytest.raises(
        ConfigError, match=r"diverged at 0\.00 s: use loop\.vehicle = 'single_track'"
    ):
        car.step(Command(0.0, 0.0, 0.0), 0.01)


def test_mirrored_commands_drive_nearly_the_mirrored_way() -> None:
    """Its tyres have a side (ply steer), so only nearly."""
    left, right = Multibody(BMW, start(12.0)), Multibody(BMW, start(12.0))
    for k in range(100):
        one = left.step(Command(0.04 * sin(0.05 * k), 0.1, 0.0), 0.01)
        two = right.step(Command(-0.04 * sin(0.05 * k), 0.1, 0.0), 0.01)
    assert one.yaw == pytest.approx(-two.yaw, abs=0.01)
    assert one.x == pytest.approx(two.x, abs=0.02)


def test_our_numbers_replace_those_of_the_package() -> None:
    p = BMW.loaded(1.2 * BMW.mass)
    q = package_parameters(replace(p, cog_to_front=1.2), 0.7)
    assert (q.m, q.a, q.a + q.b) == (p.mass, 1.2, pytest.approx(p.wheelbase))
    assert q.m_s + q.m_uf + q.m_ur == pytest.approx(p.mass)
    assert q.tire.p_ky1 == pytest.approx(-21.92 * 0.7)
    van = package_parameters(vehicle_parameters("vw_vanagon"))
    assert van.T_f == pytest.approx(1.574292)
    with pytest.raises(ConfigError, match="tyre_stiffness"):
        package_parameters(VehicleParameters(), 0.0)
