from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, plans, scenario
from hypothesis import given, settings, strategies as st

from replan.logs.agents import AgentKind
from replan.logs.plan import Plan
from replan.logs.readers import read_log
from replan.logs.states import Trajectory
from replan.logs.trace import Mode, PlannedFrame
from replan.metrics import GROUPS, evaluate
from replan.metrics.judge.gates import load_gates

COMFORT = {metric.name: metric for metric in GROUPS["comfort"]}
JERK_GATES = [gate for gate in load_gates(None).gates if "jerk" in gate.metric]


def judged(ego: Trajectory, **changes: object) -> pd.DataFrame:
    log = scenario(ego)
    return evaluate(drive(log, **changes), log, metrics=COMFORT).set_index("metric")


def braking(
    start: float, jerk: float, hardest: float, seconds: float = 8.0, step: float = 0.01
) -> Trajectory:
    """Constant speed, then a ramp of acceleration down to -hardest that stays."""
    t = grid(seconds, step)
    a = -np.clip(jerk * (t - start), 0.0, hardest)
    return along(t, 30.0 + np.r_[0.0, np.cumsum(0.5 * np.diff(t) * (a[1:] + a[:-1]))], a=a)


@pytest.mark.parametrize("start", [1.0, 4.0, 7.2])
@pytest.mark.parametrize("step", [0.01, 0.02, 0.05])
def test_the_jerk_of_a_brake_ramp_does_not_depend_on_where_the_log_is_cut(
    start: float, step: float
) -> None:
    """Jerk 6 m/s3: nuPlan's filter reads 2.9 in the middle and 6.3 at the end."""
    table = judged(braking(start, 6.0, 3.0, step=step))
    assert table.loc["lon_jerk_state.max_abs", "value"] == pytest.approx(6.0)
    assert start + 0.1 - 1e-9 <= table.loc["lon_jerk_state.max_abs", "time_s"] <= start + 0.5 + 1e-9


def test_time_out_of_bounds_and_percentiles_of_a_ramp() -> None:
    table = judged(braking(2.0, 6.0, 6.0))["value"]
    assert table["lon_jerk_state.time_out_of_bounds"] == pytest.approx(
        1.0 + 0.1 - 2 * 0.1 * 4.13 / 6.0, abs=0.021
    )
    assert table["lon_jerk_state.p95"] == pytest.approx(6.0)
    assert table["lon_accel.min"] == pytest.approx(-6.0)
    assert table["lon_accel.max"] == 0.0
    assert table["lon_accel.max_abs"] == table["lon_accel.p99"] == pytest.approx(6.0)
    assert table["lon_accel.time_out_of_bounds"] == pytest.approx(6.0 - 4.05 / 6.0, abs=0.02)


def test_speeding_up_has_the_tighter_bound() -> None:
    t = grid(2.0)
    assert judged(along(t, 5 + 3 * t, a=3.0))["value"][
        "lon_accel.time_out_of_bounds"
    ] == pytest.approx(2.0)
    assert judged(along(t, 15 - 3 * t, a=-3.0))["value"]["lon_accel.time_out_of_bounds"] == 0.0


@given(st.floats(2.0, 20.0), st.floats(-0.05, 0.05))
def test_a_circle_has_constant_lateral_acceleration_and_yaw_rate(v: float, kappa: float) -> None:
    t = grid(2.0, 0.05)
    zero = 0 * t
    table = judged(Trajectory(t, v * t, zero, kappa * v * t, v + zero, zero, kappa + zero))["value"]
    assert table["lat_accel.max_abs"] == pytest.approx(v * v * abs(kappa))
    assert table["yaw_rate.max_abs"] == pytest.approx(v * abs(kappa), abs=1e-9)
    assert table["lat_jerk_state.max_abs"] == pytest.approx(0.0, abs=1e-9)


@settings(max_examples=25)
@given(st.floats(0.2, 2.0), st.integers(1, 60), st.booleans())
def test_quiet_driving_before_or_after_a_slam_changes_nothing(
    slam: float, quiet: int, before: bool
) -> None:
    """Row 15: p99 falls to 0 in a longer drive.

    The time out of bounds and the worst episode stay.
    """

    def slammed(pre: float, post: float) -> pd.Series:
        t = grid(pre + slam + post, 0.05)
        inside = (t >= pre - 1e-9) & (t < pre + slam - 1e-9)
        a = np.where(inside, -8.0, 0.0)
        return judged(
            along(t, 90.0 + np.r_[0.0, np.cumsum(0.5 * np.diff(t) * (a[1:] + a[:-1]))], a=a)
        )["value"]

    short = slammed(2.0, 2.0)
    long = slammed(2.0 + quiet * before, 2.0 + quiet * (not before))
    for name in ("lon_accel", "lon_jerk_state", "jerk_state"):
        for reduction in ("time_out_of_bounds", "worst_episode", "max_abs"):
            row = f"{name}.{reduction}"
            assert long[row] == pytest.approx(short[row], abs=1e-6), row
            assert short[row] > 0.0
    assert short["lon_accel.worst_episode"] == pytest.approx(slam, abs=0.051)


def test_the_worst_episode_is_the_longest_and_not_the_sum() -> None:
    t = grid(10.0, 0.1)
    # 0.6, 1.3, 0.25 s
    a = np.where(((t > 0.95) & (t < 1.55)) | ((t > 3.95) & (t < 5.25)) | (t > 9.75), -6.0, 0.0)
    table = judged(along(t, 80.0 + 0.0 * t, a=a))
    assert table.loc["lon_accel.worst_episode", "value"] == pytest.approx(1.3)
    assert table.loc["lon_accel.worst_episode", "time_s"] == pytest.approx(4.0)
    assert table.loc["lon_accel.time_out_of_bounds", "value"] == pytest.approx(0.6 + 1.3 + 0.25)


def test_turning_the_acceleration_is_jerk() -> None:
    """|A| = 3 m/s2 turning with 0.5 Hz: |dA/dt| = 2 pi 0.5 3 = 9.42, over 0.1 s 2 * 3 sin(pi 0.05)
    / 0.1 = 9.39.

    nuPlan's d|A|/dt sees 0.
    """
    t, v, spin = grid(6.0), 20.0, np.pi
    a, kappa = 3.0 * np.cos(spin * t), 3.0 * np.sin(spin * t) / v**2
    ego = Trajectory(t, v * t, 0 * t, 0 * t, v + 0 * t, a, kappa)
    table = judged(ego)["value"]
    assert table["jerk_state.max_abs"] == pytest.approx(6.0 * np.sin(0.05 * np.pi) / 0.1)
    assert table["jerk_nuplan.max_abs"] == pytest.approx(0.0, abs=1e-9)
    assert table["lon_jerk_nuplan.max_abs"] > 5.0


def signal(a: np.ndarray, t: np.ndarray) -> pd.Series:
    return judged(along(t, 60.0 + 0.0 * t, a=a))["value"]


def test_the_filter_agrees_with_the_code_of_nuplan() -> None:
    """At 10 Hz: a ramp of 6 m/s3 to -3 m/s2 is 2.91, or 6.27 where the log ends with it; a tap of
    -5 m/s2 for 0.3 s is 2.80; -3 to 2 m/s2 in 0.5 s is 4.84 along, and 1.63 of |a|."""
    t = grid(20.0, 0.1)
    ramp = -np.clip(6.0 * (t - 8.0), 0.0, 3.0)
    assert signal(ramp, t)["lon_jerk_nuplan.max_abs"] == pytest.approx(2.906, abs=1e-3)
    cut = t <= 8.5 + 1e-9
    assert signal(ramp[cut], t[cut])["lon_jerk_nuplan.max_abs"] == pytest.approx(6.269, abs=1e-3)
    tap = np.where((t > 7.95) & (t < 8.25), -5.0, 0.0)
    assert signal(tap, t)["lon_jerk_nuplan.max_abs"] == pytest.approx(2.801, abs=1e-3)
    switch = signal(np.clip(-3.0 + 10.0 * (t - 8.0), -3.0, 2.0), t)
    assert switch["lon_jerk_nuplan.max_abs"] == pytest.approx(4.844, abs=1e-3)
    assert switch["jerk_nuplan.max_abs"] == pytest.approx(1.633, abs=1e-3)
    assert switch["lon_jerk_nuplan.time_out_of_bounds"] > 0.0
    assert switch["lon_jerk_state.max_abs"] == pytest.approx(10.0)


def too_abrupt(table: pd.Series) -> set[str]:
    """The signals whose gates are broken."""
    return {
        gate.metric.partition(".")[0]
        for gate in JERK_GATES
        if gate.margin(table[gate.metric]) < 0.0
    }


def steered(t: np.ndarray, a: np.ndarray, aside: np.ndarray) -> Trajectory:
    """15 m/s with a longitudinal and a lateral acceleration."""
    return replace(along(t, 15.0), a=a, kappa=aside / 15.0**2)


@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0])
@pytest.mark.parametrize("seed", range(3))
def test_the_jitter_of_a_recorded_drive_is_not_abrupt(rate: float, seed: float) -> None:
    """0.5 m/s2 of noise in both accelerations: the unfiltered signals are beyond the bounds for
    seconds.
    """
    t, rng = grid(15.0, 1.0 / rate), np.random.default_rng(seed)
    calm = 1.5 * np.sin(0.4 * t)
    table = judged(steered(t, *(calm + 0.5 * rng.standard_normal((2, len(t))))))["value"]
    assert not too_abrupt(table)
    if rate >= 10.0:
        assert min(table[f"{name}_jerk_state.time_out_of_bounds"] for name in ("lon", "lat")) > 2.0


@pytest.mark.parametrize("rate", [5.0, 10.0, 20.0])
@pytest.mark.parametrize(
    ("hardest", "lasts", "every"), [(-6.0, 1.0, 5.0), (-8.0, 0.6, 4.0), (-5.0, 1.4, 4.0)]
)
def test_hiccups_and_swerves_are_abrupt(
    rate: float, hardest: float, lasts: float, every: float
) -> None:
    """Braking by steps in the middle of a drive, and swaying by 0.8 m with 0.4 Hz."""
    t = grid(20.0, 1.0 / rate)
    braking, calm = np.where((t + 2.0) % every < lasts - 1e-9, hardest, 0.0), 0.0 * t
    assert too_abrupt(judged(steered(t, braking, calm))["value"]) == {"lon_jerk_nuplan"}
    sway = 0.8 * (0.8 * np.pi) ** 2 * np.sin(0.8 * np.pi * t)
    assert too_abrupt(judged(steered(t, calm, sway))["value"]) == {"lat_jerk_r79"}


@pytest.mark.parametrize(
    "name", ["3b3570b4-7b0b-3268-a571-b0889dbf40b6", "7fab2350-7eaf-3b7e-a39d-6937a4c1bede"]
)
def test_recorded_humans_are_not_abrupt(name: str, shared_data: Path) -> None:
    log = read_log(shared_data / "argoverse2" / name)
    table = evaluate(drive(log), log, metrics=COMFORT).set_index("metric")["value"]
    assert not too_abrupt(table) and table["lon_jerk_state.time_out_of_bounds"] > 1.0


def test_the_road_user_that_the_ego_brakes_for_is_named_although_the_filter_is_early() -> None:
    """A car appears at 2 s, the ego brakes from then on: the filtered jerk is beyond its bound
    before.
    """
    t = grid(6.0, 0.1)
    ego = along(t, 10.0, a=np.where((t >= 2.0) & (t < 3.2), -8.0, 0.0))
    log = scenario(
        ego, [("7", AgentKind.CAR, (4.5, 1.8), lambda at: (45.0 + 0 * at, 0 * at, 0 * at))]
    )
    seen = replace(log, tracks=log.tracks.taken(log.tracks.t > 1.95))
    row = (
        evaluate(drive(seen), seen, metrics=COMFORT)
        .set_index("metric")
        .loc["lon_jerk_nuplan.worst_episode"]
    )
    assert row["time_s"] < 2.0 and row["reason"] == "car 7"


def test_r79_reads_half_of_a_short_ramp() -> None:
    """A ramp of 6 m/s3 for 0.5 s: 3.2 after low-pass and moving mean.

    A tap of 5 m/s2 for 0.3 s: 2.7.
    """
    t, v = grid(12.0), 20.0
    for lateral, expected in (
        (np.clip(6.0 * (t - 4.0), 0.0, 3.0), 3.2),
        (np.where((t >= 4) & (t < 4.3), 5.0, 0), 2.7),
    ):
        ego = Trajectory(t, v * t, 0 * t, 0 * t, v + 0 * t, 0 * t, lateral / v**2)
        assert judged(ego)["value"]["lat_jerk_r79.max_abs"] == pytest.approx(expected, abs=0.03)


def test_yaw_acceleration_of_a_growing_turn() -> None:
    t, rate = grid(3.0), 0.4
    ego = Trajectory(t, 10 * t, 0 * t, 0.5 * rate * t**2, 10 + 0 * t, 0 * t, 0 * t)
    table = judged(ego)["value"]
    assert table["yaw_accel.max_abs"] == pytest.approx(rate)
    assert table["yaw_accel_nuplan.max_abs"] == pytest.approx(rate)
    assert table["yaw_rate_nuplan.max_abs"] == pytest.approx(rate * 3.0, abs=1e-6)


def test_lateral_jerk_of_a_clothoid() -> None:
    t = grid(3.0)
    zero, v, rate = 0 * t, 10.0, 0.02
    table = judged(Trajectory(t, v * t, zero, 0.5 * v * rate * t**2, v + zero, zero, rate * t))[
        "value"
    ]
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
