"""The perfect vehicle: exactly its plan, in the loop as well; and the plant's own numbers."""

from math import atan

import numpy as np
import pytest

from replan.core.errors import ConfigError
from replan.logs.catalogue import CATALOGUE
from replan.logs.plan import Plan
from replan.logs.states import Command, EgoState, Trajectory
from replan.logs.vehicle import VehicleParameters
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import LoopConfig
from replan.replay.parts import VEHICLE, Part
from replan.replay.vehicle import build_vehicle
from replan.replay.vehicle.kinematic_bicycle import Perfect

CAR = VehicleParameters()
START = EgoState(0.0, 0.0, 0.0, 0.0, 8.0, 0.5, 0.02)


def arc_plan(t0: float, a: float, kappa: float) -> Plan:
    """An arc driven from 8 m/s at constant acceleration, sampled at 10 Hz."""
    t = np.arange(0.0, 5.01, 0.1)
    s = 8.0 * t + 0.5 * a * t**2
    return Plan(
        Trajectory(
            t0 + t,
            np.sin(kappa * s) / kappa,
            (1.0 - np.cos(kappa * s)) / kappa,
            kappa * s,
            8.0 + a * t,
            np.full(len(t), a),
            np.full(len(t), kappa),
        )
    )


def test_it_is_where_its_plan_is() -> None:
    car, plan = Perfect(CAR, START), arc_plan(0.0, 0.5, 0.02)
    for k in range(1, 401):
        command = car.control(car.state, plan)
        state = car.step(command, 0.01)
        s = 8.0 * 0.01 * k + 0.25 * (0.01 * k) ** 2
        assert state.x == pytest.approx(np.sin(0.02 * s) / 0.02, abs=1e-5)
        assert state.y == pytest.approx((1.0 - np.cos(0.02 * s)) / 0.02, abs=1e-5)
        assert (state.t, state.v) == (k * 10_000_000 / 1e9, pytest.approx(8.0 + 0.005 * k))
        assert (state.kappa, state.a) == (pytest.approx(0.02), pytest.approx(0.5))
        assert command.brake == 0.0 and command.throttle > 0.0
        assert command.steer == pytest.approx(atan(CAR.wheelbase * 0.02))
    assert car.actuation == command


def test_it_brakes_in_the_command_and_needs_a_plan() -> None:
    car = Perfect(CAR, START)
    command = car.control(START, arc_plan(0.0, -2.0, 0.02))
    assert command.throttle == 0.0 and command.brake == pytest.approx(
        (2.0 + car.powertrain.coasting(8.0)) / CAR.max_decel
    )
    with pytest.raises(RuntimeError, match="needs a plan"):
        Perfect(CAR, START).step(Command(0.0, 0.0, 0.0), 0.01)


def test_in_the_loop_it_has_no_tracking_error_and_the_trace_says_so() -> None:
    scenario = CATALOGUE["everyday/nudge"].scenario()
    trace = run_closed_loop(scenario, "logged", config=LoopConfig(vehicle="perfect")).trace
    assert trace.tracking is not None
    assert np.abs(trace.tracking.lateral).max() < 1e-3
    assert np.abs(trace.tracking.speed).max() < 5e-3
    assert any("no controller drives it" in note for note in trace.notes)


def test_the_plant_may_differ_from_what_is_told() -> None:
    plant: dict[str, float | str] = {
        "mass": 1.2 * CAR.mass,
        "tyre_friction": 0.4,
        "tyre": "fiala",
        "grade": 0.02,
    }
    car = build_vehicle(Part(VEHICLE, "single_track"), CAR, START, plant)
    assert (car.model.mass, car.model.front.friction) == (pytest.approx(1.2 * CAR.mass), 0.4)
    assert car.powertrain.full_brake(10.0) == pytest.approx(CAR.max_decel / 1.2)
    assert car.model.grade_sin == pytest.approx(0.02, rel=1e-3)
    config = LoopConfig(vehicle="single_track", plant=plant)
    trace = run_closed_loop(CATALOGUE["everyday/nudge"].scenario(), "logged", config=config).trace
    assert any("tyre_friction = 0.4" in note for note in trace.notes)


@pytest.mark.parametrize(
    ("name", "plant", "words"),
    [
        (
            "kinematic_bicycle",
            {"tyre": "fiala"},
            "vehicle 'kinematic_bicycle': no key is called 'tyre'",
        ),
        ("single_track", {"tire": "fiala"}, "did you mean 'tyre'"),
        ("single_track", {"mass": "heavy"}, r"loop.plant.mass: expected a number"),
        ("single_track", {"mass": -1.0}, "loop.plant: vehicle mass must be positive"),
        ("single_track", {"mass": 0.0}, "loop.plant"),
        ("single_track", {"tyre": "slick"}, "no tyre is called 'slick'"),
        ("kinematic_rear_steer", {"rear_ratio": 1.0}, "rear_ratio must be"),
    ],
)
def test_a_wrong_plant_is_named(name: str, plant: dict[str, float | str], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        build_vehicle(Part(VEHICLE, name), CAR, START, plant)
