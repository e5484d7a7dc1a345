"""The compiled loop: the same as its parts one step after the other.

Plans that are driven later than made.
"""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from handmade import drive, s_curve, scenario
from hypothesis import given, settings, strategies as st
from numpy.lib.recfunctions import structured_to_unstructured

from replan.core.errors import ConfigError
from replan.logs.plan import Plan
from replan.logs.states import Command
from replan.logs.vehicle import VehicleParameters, vehicle_parameters
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.plan_period import Latency, PlanPeriod, TraceRecorder
from replan.replay.loop.simulation_setup import controller_of
from replan.replay.loop_config import LoopConfig
from replan.replay.parts import CONTROLLER, VEHICLE, Part
from replan.replay.vehicle.plan_path import PlanPath
from replan.replay.vehicle.state_records import Records, state_at

PERIOD = 0.01
STEPS = 900
COMPILED = [name for name in CONTROLLER.builtin if name != "mpc"]
WAY = drive(
    s_curve, lambda t: np.interp(t, [0.0, 4.0, 6.0, 6.5, 9.0], [9.0, 9.0, 0.0, 0.0, 6.0]), 10.0
)
"""Curves, a stop and a start."""


def rows_of(vehicle: str, controller: str, cuts: list[int], car: VehicleParameters) -> Records:
    """The rows of a drive along WAY, run from cut to cut; each time along a plan of its own."""
    ego = VEHICLE.builtin[vehicle](car, WAY.state(0))
    period = PlanPeriod(controller_of(ego, car, Part(CONTROLLER, controller), PERIOD), ego, PERIOD)
    recorder = TraceRecorder(STEPS, ego)
    for first, end in pairwise([0, *cuts, STEPS]):
        period.run(Plan(WAY), recorder.rows, first, end - first)
    recorder.close(STEPS, Plan(WAY))
    return recorder.rows


@cache
def whole(vehicle: str, controller: str) -> Records:
    return rows_of(vehicle, controller, [], vehicle_parameters("bmw_320i"))


@pytest.mark.parametrize("vehicle", ["kinematic_bicycle", "kinematic_rear_steer", "single_track"])
@pytest.mark.parametrize("controller", COMPILED)
def test_a_period_is_its_steps_one_after_the_other(vehicle: str, controller: str) -> None:
    """Against controller and vehicle through their methods, as anybody may call them."""
    car = vehicle_parameters("bmw_320i")
    ego = VEHICLE.builtin[vehicle](car, WAY.state(0))
    driver, plan, path = (
        controller_of(ego, car, Part(CONTROLLER, controller), PERIOD),
        Plan(WAY),
        PlanPath.of(WAY),
    )
    found = whole(vehicle, controller)
    for k in range(STEPS):
        state = ego.state
        command, off = driver.control(state, plan), path.deviation(state)
        assert state_at(found, k) == state, k
        assert Command(*found["command"][k].item()) == command, k
        assert found["deviation"][k].item() == off, k
        ego.step(command, PERIOD)


@settings(max_examples=10)
@given(
    st.sampled_from(["kinematic_bicycle", "single_track"]),
    st.sampled_from(["dlqr_pid", "pid"]),
    st.lists(st.integers(1, STEPS - 1), max_size=30, unique=True).map(sorted),
)
def test_it_does_not_matter_where_periods_end(
    vehicle: str, controller: str, cuts: list[int]
) -> None:
    rows = rows_of(vehicle, controller, cuts, vehicle_parameters("bmw_320i"))
    np.testing.assert_array_equal(rows, whole(vehicle, controller))


@pytest.mark.parametrize("controller", ["dlqr_pid", "mpc"])
@pytest.mark.parametrize("vehicle", ["perfect", "single_track"])
def test_every_row_is_complete_and_the_last_command_stands_at_the_end(
    vehicle: str, controller: str
) -> None:
    rows = rows_of(vehicle, controller, [7, 100], VehicleParameters())
    assert len(rows) == STEPS + 1 and np.isfinite(structured_to_unstructured(rows)).all()
    assert rows["command"][-1] == rows["command"][-2]
    np.testing.assert_array_equal(np.round(rows["ego"]["t"] / PERIOD), np.arange(STEPS + 1))


@given(st.integers(0, 40), st.integers(1, 12))
def test_the_plan_driven_is_the_last_that_is_old_enough(delay: int, every: int) -> None:
    latency, made = Latency(delay), {}
    for step in range(80):
        if step % every == 0:
            latency.before(step)
            made[step] = Plan(WAY)
            latency.planned(step, made[step])
        due = [k for k in made if k + delay <= step]
        assert latency.at(step) is made[max(due) if due else 0]


def test_without_delay_nothing_changes_and_with_it_the_drive_says_so() -> None:
    log = scenario(drive(s_curve, 12.0, 6.0))
    now, late = (
        run_closed_loop(log, "logged", config=LoopConfig(plan_delay_s=seconds)).trace
        for seconds in (0.0, 0.15)
    )
    plain = run_closed_loop(log, "logged").trace
    np.testing.assert_array_equal(plain.ego.y, now.ego.y)
    assert not any("after its frame" in note for note in now.notes)
    assert "each plan but the first is driven from 0.15 s after its frame on" in late.notes
    assert len(late.frames) == len(now.frames)
    assert np.abs(late.tracking.lateral).max() < 0.02  # plans carry their times: late is not wrong


def test_a_delay_must_fit_the_control_period() -> None:
    with pytest.raises(ConfigError, match="plan_delay_s"):
        LoopConfig(plan_delay_s=0.005)
