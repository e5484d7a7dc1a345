"""Pedals: one at a time, the power train inverted, its lag too.

Stops that end softly and near, standstill held.
"""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from replan.logs.states import Trajectory
from replan.logs.vehicle import VehicleParameters
from replan.paper.manoeuvres import JERK_OVER, Manoeuvre, follow
from replan.replay.control.pedals import (
    GENTLE_MPS3,
    HOLDING_BRAKE,
    HYSTERESIS_MPS2,
    LONGER_M,
    Calibration,
    PedalMemory,
    StopMemory,
    compensated,
    eased,
    hold,
    press,
    stands,
)
from replan.replay.vehicle.drivetrain import Drivetrain
from replan.replay.vehicle.plan_path import PlanPath
from replan.replay.vehicle.state_records import new_record
from replan.run.calibrate import picture

CAR = VehicleParameters()
TRAIN = Drivetrain(CAR)
PEDALS = TRAIN.pedal_map
TABLE = Calibration.of(TRAIN)
PERIOD = 0.01


def braked(v: float, decel: float, jerk: float, *, soft: bool = True) -> Trajectory:
    """A second at `v`, then braking to a stop.

    Its end released with the same jerk, or not at all.
    """
    h = 1e-3
    t = np.arange(0.0, 1.0 + v / decel + 2.0 * decel / jerk + 3.0, h)
    a, speed = np.zeros(len(t)), np.full(len(t), v)
    for i in range(1, len(t)):
        wanted = -decel if t[i] > 1.0 else 0.0
        if soft:
            wanted = max(wanted, -np.sqrt(2.0 * jerk * speed[i - 1]))
        a[i] = max(a[i - 1] - jerk * h, wanted)
        speed[i] = max(speed[i - 1] + h * a[i], 0.0)
        a[i] = a[i] if speed[i] else 0.0
    s = np.r_[0.0, np.cumsum(0.5 * h * (speed[1:] + speed[:-1]))]
    zero = np.zeros(len(t[::100]))
    return Trajectory(t[::100], s[::100], zero, zero, speed[::100], a[::100], zero)


def wave(amplitude: float, pace: float) -> PlanPath:
    """A plan along x that brakes and accelerates smoothly around -2 m/s2."""
    t = np.arange(0.0, 6.0, 0.02)
    a = -2.0 + amplitude * np.sin(pace * t)
    v = 20.0 - 2.0 * t + amplitude / pace * (1.0 - np.cos(pace * t))
    s = np.r_[0.0, np.cumsum(0.01 * (v[1:] + v[:-1]))]
    return PlanPath.of(Trajectory(t, s, 0 * t, 0 * t, v, a, 0 * t))


@settings(max_examples=20)
@given(st.floats(0.1, 1.5), st.floats(0.5, 4.0))
def test_the_brake_gives_the_plans_deceleration_at_its_time(amplitude: float, pace: float) -> None:
    """Through a dead time and a lag, once what was missing at first is made up for."""
    path, m, a = wave(amplitude, pace), np.nan, -2.0
    dead = round(CAR.brake_delay / PERIOD)
    coming, errors = [-2.0] * dead, []
    for k in range(500):
        command, m = compensated(m, PEDALS, path.times, k * PERIOD, 15.0, PERIOD)
        coming.append(command)
        errors.append(a - path.timed(k * PERIOD)[2])
        a += (1.0 - np.exp(-PERIOD / CAR.brake_lag)) * (coming.pop(0) - a)
    assert np.abs(errors[200:]).max() < 0.02 * amplitude + 1e-3


@settings(max_examples=20)
@given(st.floats(-7.5, 2.0), st.floats(-7.5, 2.0))
def test_the_lead_asks_for_no_other_pedal_than_the_plan(before: float, after: float) -> None:
    t = np.array([0.0, 1.0, 1.1, 3.0])
    zero = np.zeros(4)
    path = PlanPath.of(
        Trajectory(
            t,
            15.0 * t,
            zero,
            zero,
            np.full(4, 15.0),
            np.array([before, before, after, after]),
            zero,
        )
    )
    m, coast = np.nan, TRAIN.coasting(15.0)
    for k in range(200):
        asked, m = compensated(m, PEDALS, path.times, k * PERIOD, 15.0, PERIOD)
        brakes = path.timed(k * PERIOD + CAR.brake_delay + PERIOD)[2] < coast
        assert asked <= coast if brakes else asked >= coast


def point_mass(decel: float, v: float, slope: float = 0.0) -> tuple[float, float, float]:
    """A mass with dead time and lag, braked by `decel` until it stands: how far, the last
    deceleration, how long.
    """
    t = np.array([0.0, 0.01, 100.0])
    standing = PlanPath.of(Trajectory(t, *(np.zeros(3) for _ in range(6))))
    stop, x, a = new_record(StopMemory), 0.0, -decel
    coming = [-decel] * round(CAR.brake_delay / PERIOD)
    for k in range(4000):
        wanted = eased(stop, PEDALS, standing.times, k * PERIOD, v, a, -decel - slope, PERIOD)
        coming.append(wanted)
        force = coming.pop(0)
        share = 1.0 - np.exp(-PERIOD / CAR.brake_lag)
        a += share * (min(force, -CAR.rolling) + slope - a)
        if v + PERIOD * a <= 0.0:
            return x, -a, k * PERIOD
        x, v = x + PERIOD * (v + 0.5 * PERIOD * a), v + PERIOD * a
    return x, -a, np.inf


@given(st.floats(0.5, 8.0), st.floats(6.0, 15.0))
def test_a_stop_ends_softly_and_within_the_bound(decel: float, v: float) -> None:
    way, last, seconds = point_mass(decel, v)
    assert np.isfinite(seconds)
    assert last <= 0.35 * decel + 0.1 or last < 0.5
    assert -0.02 <= way - v * v / (2.0 * decel) <= 2.5 * LONGER_M + decel / (24.0 * GENTLE_MPS3)


def test_a_stop_downhill_is_still_a_stop() -> None:
    assert point_mass(3.0, 8.0, slope=1.0)[2] < 8.0


def test_where_the_plan_goes_on_nothing_is_eased() -> None:
    t, zero = np.array([0.0, 9.0]), np.zeros(2)
    path = PlanPath.of(Trajectory(t, 3.0 * t, zero, zero, np.array([3.0, 3.0]), zero, zero))
    stop = new_record(StopMemory)
    assert eased(stop, PEDALS, path.times, 0.0, 0.5, -7.0, -7.0, PERIOD) == -7.0


@pytest.mark.parametrize("controller", ["dlqr_pid", "mpc"])
@pytest.mark.parametrize("soft", [True, False])
@pytest.mark.parametrize(
    ("v", "decel", "jerk"), [(13.9, 7.5, 15.0), (8.0, 7.5, 15.0), (12.0, 3.0, 3.0)]
)
def test_a_hard_stop_is_as_hard_as_planned(
    controller: str, v: float, decel: float, jerk: float, *, soft: bool
) -> None:
    """Peak deceleration, jerk as the metric has it, and where it stands.

    A stop planned without release is released.
    """
    plan = braked(v, decel, jerk, soft=soft)
    seen = follow(Manoeuvre("stop", plan), controller, "single_track", CAR).columns
    a = seen["a"]
    assert -a.min() < 1.02 * decel
    assert np.abs(a[JERK_OVER:] - a[:-JERK_OVER]).max() / (JERK_OVER * PERIOD) < max(
        1.1 * jerk, 5.0
    )
    assert -0.05 < seen["x"][-1] - plan.x[-1] < 0.15
    assert seen["x"][-1] == seen["x"][-50]


@pytest.mark.parametrize("grade", [-0.12, -0.04, 0.06])
@pytest.mark.parametrize("controller", ["dlqr_pid", "mpc"])
def test_a_stop_on_a_slope_that_nobody_told_of_is_held(controller: str, grade: float) -> None:
    plan = braked(10.0, 3.0, 3.0)
    seen = follow(
        Manoeuvre("stop", plan), controller, "single_track", CAR, plant={"grade": grade}
    ).columns
    assert seen["x"][-1] == seen["x"][-30]


def test_the_brake_is_released_while_the_last_speed_goes_and_then_holds_for_good() -> None:
    pedal = new_record(PedalMemory)
    for v, a, held in ((0.08, -0.4, 0.0), (0.08, 0.1, HOLDING_BRAKE), (0.08, -0.4, HOLDING_BRAKE)):
        assert hold(pedal, v, a) == (0.0, held), "and does not let go again"
    press(pedal, PEDALS, 1.0, 0.1)
    assert hold(pedal, 0.0, 0.0) == (0.0, HOLDING_BRAKE)


def test_standstill_has_hysteresis() -> None:
    t = np.arange(0.0, 6.0, 0.5)
    v = np.where(t < 3.0, 0.0, t - 3.0)
    path = PlanPath.of(
        Trajectory(t, np.r_[0.0, np.cumsum(0.25 * (v[1:] + v[:-1]))], 0 * t, 0 * t, v, 0 * t, 0 * t)
    )
    still = False
    for v, t, holds in ((0.2, 0.0, False), (0.05, 0.5, True), (0.12, 1.0, True), (0.0, 2.6, False)):
        still = stands(still, v, t, path.times)
        assert still is holds


@given(st.lists(st.tuples(st.floats(-12.0, 6.0), st.floats(0.0, 40.0)), min_size=1, max_size=60))
def test_pedals_are_never_on_together(asked: list[tuple[float, float]]) -> None:
    pedal = new_record(PedalMemory)
    for acceleration, v in asked:
        throttle, brake = press(pedal, PEDALS, acceleration, v)
        assert 0.0 <= throttle <= 1.0 and 0.0 <= brake <= 1.0
        assert throttle == 0.0 or brake == 0.0


@given(st.floats(0.5, 35.0), st.floats(-8.0, 1.5))
def test_pedals_invert_the_powertrain(v: float, acceleration: float) -> None:
    beyond = acceleration - TRAIN.coasting(v)
    if abs(beyond) <= HYSTERESIS_MPS2 or beyond > TRAIN.full_throttle(v):
        return
    throttle, brake = press(new_record(PedalMemory), PEDALS, acceleration, v)
    given_back = TRAIN.coasting(v) + throttle * TRAIN.full_throttle(v) - brake * TRAIN.full_brake(v)
    assert given_back == pytest.approx(acceleration, abs=1e-9)


def test_pedals_do_not_alternate_with_noise() -> None:
    pedal, rng = new_record(PedalMemory), np.random.default_rng(2)
    for a in TRAIN.coasting(15.0) + rng.uniform(-0.9, 0.9, 500) * HYSTERESIS_MPS2:
        _, brake = press(pedal, PEDALS, float(a), 15.0)
        assert not brake


@given(st.floats(0.5, 40.0), st.floats(-8.0, 1.0))
def test_the_table_is_near_the_exact_inverse(v: float, acceleration: float) -> None:
    beyond = acceleration - TRAIN.coasting(v)
    if abs(beyond) <= HYSTERESIS_MPS2:
        return
    pedals = press(new_record(PedalMemory), PEDALS, acceleration, v)
    looked_up = TABLE.at(acceleration, v)
    if not np.isnan(looked_up).any():
        assert looked_up == pytest.approx(pedals, abs=0.02)


def test_what_the_vehicle_cannot_do_has_no_pedal() -> None:
    assert np.isnan(TABLE.at(5.0, 45.0)).all()
    reachable = TABLE.pedal[np.isfinite(TABLE.pedal)]
    assert np.abs(reachable).max() <= 1.0
    assert (np.diff(TABLE.pedal, axis=0)[np.isfinite(np.diff(TABLE.pedal, axis=0))] > 0.0).all()


def test_it_is_written_and_drawn(tmp_path: Path) -> None:
    TABLE.save(tmp_path / "table.csv")
    with (tmp_path / "table.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert len(rows) == 1 + len(TABLE.acceleration) and len(rows[0]) == 1 + len(TABLE.speed)
    read = np.array([[float(value or "nan") for value in row[1:]] for row in rows[1:]])
    np.testing.assert_allclose(read, TABLE.pedal, atol=1e-6)
    drawn, known = picture(TABLE).body, TABLE.pedal[np.isfinite(TABLE.pedal)]
    cells = {"blue": (known >= 0.0).sum(), "red": (known < 0.0).sum()}
    # One more is in the legend
    assert {kind: drawn.count(f'class="{kind}"') - 1 for kind in cells} == cells
