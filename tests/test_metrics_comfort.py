from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, plans, scenario
from hypothesis import given
from hypothesis import strategies as st

from logs import Mode, Plan, PlannedFrame, Trajectory
from metrics import evaluate


def judged(ego: Trajectory, **changes: object) -> pd.DataFrame:
    log = scenario(ego)
    return evaluate(drive(log, **changes), log).set_index("metric")


def braking(start: float, jerk: float, hardest: float, seconds: float = 8.0, step: float = 0.01) -> Trajectory:
    """Constant speed, then a ramp of acceleration down to -hardest that stays."""
    t = grid(seconds, step)
    a = -np.clip(jerk * (t - start), 0.0, hardest)
    return along(t, 30.0 + np.r_[0.0, np.cumsum(0.5 * np.diff(t) * (a[1:] + a[:-1]))], a=a)


@pytest.mark.parametrize("start", [1.0, 4.0, 7.2])
@pytest.mark.parametrize("step", [0.01, 0.02, 0.05])
def test_a_brake_ramp_has_its_jerk_wherever_the_log_is_cut(start: float, step: float) -> None:
    """Jerk 6 m/s3: nuPlan's filter reads 2.9 in the middle and 6.3 at the end."""
    table = judged(braking(start, 6.0, 3.0, step=step))
    assert table.loc["lon_jerk_state.max_abs", "value"] == pytest.approx(6.0)
    assert start + 0.1 - 1e-9 <= table.loc["lon_jerk_state.max_abs", "time_s"] <= start + 0.5 + 1e-9


def test_time_out_of_bounds_and_percentiles_of_a_ramp() -> None:
    table = judged(braking(2.0, 6.0, 6.0))["value"]
    assert table["lon_jerk_state.time_out_of_bounds"] == pytest.approx(1.0 + 0.1 - 2 * 0.1 * 4.13 / 6.0, abs=0.021)
    assert table["lon_jerk_state.p95"] == pytest.approx(6.0)
    assert table["lon_accel.min"] == pytest.approx(-6.0)
    assert table["lon_accel.max"] == 0.0
    assert table["lon_accel.max_abs"] == table["lon_accel.p99"] == pytest.approx(6.0)
    assert table["lon_accel.time_out_of_bounds"] == pytest.approx(6.0 - 4.05 / 6.0, abs=0.02)


def test_speeding_up_has_the_tighter_bound() -> None:
    t = grid(2.0)
    assert judged(along(t, 5 + 3 * t, a=3.0))["value"]["lon_accel.time_out_of_bounds"] == pytest.approx(2.0)
    assert judged(along(t, 15 - 3 * t, a=-3.0))["value"]["lon_accel.time_out_of_bounds"] == 0.0


@given(st.floats(2.0, 20.0), st.floats(-0.05, 0.05))
def test_a_circle_has_constant_lateral_acceleration_and_yaw_rate(v: float, kappa: float) -> None:
    t = grid(2.0, 0.05)
    zero = 0 * t
    table = judged(Trajectory(t, v * t, zero, kappa * v * t, v + zero, zero, kappa + zero))["value"]
    assert table["lat_accel.max_abs"] == pytest.approx(v * v * abs(kappa))
    assert table["yaw_rate.max_abs"] == pytest.approx(v * abs(kappa), abs=1e-9)
    assert table["lat_jerk_state.max_abs"] == pytest.approx(0.0, abs=1e-9)


def test_lateral_jerk_of_a_clothoid() -> None:
    t = grid(3.0)
    zero, v, rate = 0 * t, 10.0, 0.02
    table = judged(Trajectory(t, v * t, zero, 0.5 * v * rate * t**2, v + zero, zero, rate * t))["value"]
    assert table["lat_jerk_state.max_abs"] == pytest.approx(v * v * rate)
    assert table["yaw_rate.max_abs"] == pytest.approx(v * rate * 2.95)


def test_a_drive_shorter_than_the_window_has_no_jerk() -> None:
    table = judged(along(grid(0.05), 5.0))
    assert table.loc["lon_jerk_state.max_abs", "reason"] == "the drive is shorter than 0.1 s"
    assert table.loc["lon_jerk_state.time_out_of_bounds", "value"] == 0.0


def test_open_loop_judges_the_plans_not_the_log() -> None:
    log = scenario(along(grid(9.0, 0.1), 10.0))
    frames = list(plans(log.ego, np.array([0.0, 1.0, 2.0]), 4.0))
    plan = frames[1].plan.trajectory
    ramp = -2.0 * (plan.t - plan.t[0])
    frames[1] = PlannedFrame(1.0, Plan(replace(plan, a=ramp, kappa=np.full(len(plan), 0.02))))
    table = evaluate(drive(log, mode=Mode.OPEN, frames=tuple(frames)), log).set_index("metric")
    assert table.loc["plan_lon_jerk.max", "value"] == pytest.approx(2.0)
    assert table.loc["plan_lon_jerk.max", "time_s"] == 1.0
    assert table.loc["plan_lon_accel.max", "value"] == pytest.approx(8.0)
    assert table.loc["plan_lat_accel.max", "value"] == pytest.approx(2.0)
    assert table.loc["plan_lat_accel.mean", "value"] == pytest.approx(2.0 / 3.0)
