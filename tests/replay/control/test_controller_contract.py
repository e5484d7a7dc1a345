"""What every controller must hold to: the executable contract, for those to come as well."""

from dataclasses import replace

import numpy as np
import pytest
from drives import along, grid
from followed import controlled
from handmade import drive, s_curve
from hypothesis import given, settings, strategies as st

from replan.logs.catalogue import CATALOGUE
from replan.logs.plan import Plan
from replan.logs.states import Command, EgoState, Trajectory
from replan.logs.vehicle import VehicleParameters
from replan.replay.control.geometric import StanleyLaw
from replan.replay.loop.simulation_setup import controller_of
from replan.replay.parts import CONTROLLER, VEHICLE, Part

CAR = VehicleParameters()
PERIOD = 0.01


def assert_lawful(commands: list[Command]) -> None:
    table = np.array([(one.steer, one.throttle, one.brake) for one in commands])
    assert np.isfinite(table).all()
    assert np.abs(table[:, 0]).max() <= CAR.max_steer
    assert (table[:, 1:] >= 0.0).all() and (table[:, 1:] <= 1.0).all()
    assert not (table[:, 1] * table[:, 2]).any(), "throttle and brake together"


@pytest.mark.parametrize("name", CONTROLLER.builtin)
@pytest.mark.parametrize(
    "family",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (i % 3 > 0))
        for i, name in enumerate(CATALOGUE)
    ],
)
def test_every_controller_follows_every_logged_drive(name: str, family: str) -> None:
    """Finite, within the limits, one pedal at a time.

    And the car is still on its drive in the end.
    """
    logged = CATALOGUE[family].scenario().ego
    if len(logged) < 2:
        pytest.skip("the family has no drive, only a start")
    seconds = min(float(logged.t[-1] - logged.t[0]), 8.0)
    commands, states, _ = controlled(logged, name, "single_track", seconds)
    assert_lawful(commands)
    last = logged.at(states[-1].t)
    assert np.hypot(states[-1].x - last.x, states[-1].y - last.y) < (
        0.5 if name in ("dlqr_pid", "mpc") else 12.0
    )


def stop_and_go(t: np.ndarray) -> np.ndarray:
    return np.interp(t, [0.0, 1.0, 5.0, 7.0, 11.0], [8.0, 8.0, 0.0, 0.0, 8.0])


@pytest.mark.parametrize("name", CONTROLLER.builtin)
@pytest.mark.parametrize("vehicle", ["kinematic_bicycle", "single_track"])
def test_two_drives_are_identical_and_hold_at_the_stop(name: str, vehicle: str) -> None:
    plan, start = drive(s_curve, stop_and_go, 12.0), EgoState(0.0, 0.0, 0.2, 0.05, 7.0)
    one, two = (controlled(plan, name, vehicle, 11.0, start)[:2] for _ in range(2))
    assert one == two
    assert_lawful(one[0])
    if name != "pid":  # a single loop knows no station: it stops where it stops
        assert max(state.v for state in one[1] if 5.8 < state.t < 6.0) == 0.0


@pytest.mark.parametrize(("y", "yaw"), [(0.0, 0.1), (0.3, -0.2), (-0.4, 0.0)])
def test_stanley_steers_by_where_the_front_axle_is(y: float, yaw: float) -> None:
    straight, law = along(grid(6.0, 0.1), 10.0), StanleyLaw(CAR.wheelbase, CAR.max_steer)
    (first, *_), *_ = controlled(
        straight, "stanley", "kinematic_bicycle", 0.1, EgoState(0.0, 10.0, y, yaw, 10.0)
    )
    front = y + CAR.wheelbase * np.sin(yaw)
    assert first.steer == pytest.approx(
        -yaw - np.arctan(law.gain * front / (law.softening + 10.0)), abs=1e-6
    )


def mirrored(plan: Trajectory) -> Trajectory:
    return replace(plan, y=-plan.y, yaw=-plan.yaw, kappa=-plan.kappa)


@pytest.mark.parametrize("name", CONTROLLER.builtin)
def test_a_mirrored_plan_has_the_mirrored_commands(name: str) -> None:
    plan = drive(s_curve, stop_and_go, 6.0)
    start = EgoState(0.0, 0.0, 0.3, -0.05, 7.0)
    there = EgoState(0.0, 0.0, -0.3, 0.05, 7.0)
    one, two = (
        controlled(plan, name, "single_track", 5.0, start),
        controlled(mirrored(plan), name, "single_track", 5.0, there),
    )
    left = np.array([(c.steer, c.throttle, c.brake) for c in one[0]])
    right = np.array([(-c.steer, c.throttle, c.brake) for c in two[0]])
    np.testing.assert_allclose(left, right, atol=1e-6 if name == "mpc" else 1e-9)


@settings(max_examples=15)
@given(
    st.sampled_from(sorted(CONTROLLER.builtin)),
    st.lists(
        st.tuples(
            st.floats(-3.0, 3.0),
            st.floats(-0.6, 0.6),
            st.floats(0.0, 30.0),
            st.floats(-0.5, 0.5),
            st.floats(-1.0, 1.0),
            st.floats(-2.0, 2.0),
            st.floats(-8.0, 4.0),
        ),
        min_size=3,
        max_size=12,
    ),
)
def test_whatever_the_state_commands_are_lawful(name: str, states: list[tuple[float, ...]]) -> None:
    """States that jump about as no car does."""
    plan = Plan(drive(s_curve, 10.0, 4.0))
    car = VEHICLE.builtin["single_track"](CAR, plan.trajectory.state(0))
    controller = controller_of(car, CAR, Part(CONTROLLER, name), PERIOD)
    commands = []
    for k, (lateral, heading, v, steer, yaw_rate, v_lat, a) in enumerate(states):
        on = plan.trajectory.at(0.01 * k)
        state = EgoState(
            0.01 * k,
            on.x,
            on.y + lateral,
            on.yaw + heading,
            v,
            a,
            steer=steer,
            yaw_rate=yaw_rate,
            v_lat=v_lat,
        )
        commands.append(controller.control(state, plan))
    assert_lawful(commands)
