"""Plans against the log and against each other, by hand, and their laws."""

from collections.abc import Callable
from dataclasses import replace
from math import pi

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, moved, moved_ego, plans, scenario
from hypothesis import given, settings, strategies as st

from replan.logs.plan import Plan
from replan.logs.road import RoadSource
from replan.logs.states import Trajectory
from replan.logs.trace import Mode, PlannedFrame
from replan.metrics import GROUPS, evaluate

LOG = scenario(along(grid(12.0, 0.1), 10.0))
CURVE = 0.1 * grid(12.0, 0.1)
BENT = scenario(
    Trajectory(
        grid(12.0, 0.1),
        100 * np.sin(CURVE),
        100 * (1 - np.cos(CURVE)),
        CURVE,
        10 + 0 * CURVE,
        0 * CURVE,
        0.01 + 0 * CURVE,
    )
)
FRAMES = grid(12.0, 0.1)[:-1]


def table(log, frames) -> pd.DataFrame:
    return evaluate(drive(log, mode=Mode.OPEN, frames=frames), log).set_index("metric")


def shifted(dx: float = 0.0, dy: float = 0.0, turn: float = 0.0):
    return lambda plan: replace(plan, x=plan.x + dx, y=plan.y + dy, yaw=plan.yaw + turn)


@pytest.mark.parametrize("log", [LOG, BENT], ids=["straight", "bent"])
def test_a_plan_that_is_the_log_has_no_error_at_all(log) -> None:
    found = table(log, plans(log.ego, FRAMES, 8.0))
    for name in ("ade", "fde", "ahe", "fhe", "along_error", "cross_error"):
        for h in (1, 3, 5, 8):
            assert found.loc[f"{name}.{h}s.max", "value"] == 0.0, (name, h)


def test_on_the_driven_path_errors_across_it_are_not_available() -> None:
    """The planner is given the path on which the log's driver will go: to be on it is no merit."""
    log = replace(LOG, road=replace(LOG.road, source=RoadSource.DRIVEN_PATH))
    found = table(log, plans(LOG.ego, FRAMES, 8.0, shifted(3.0)))
    for name in ("cross_error.5s.mean", "ahe.3s.mean", "fhe.3s.max"):
        assert not found.loc[name, "available"] and np.isnan(found.loc[name, "value"])
        assert "driven path, which the planner is given" in found.loc[name, "reason"]
    for name in ("ade.3s.mean", "fde.5s.mean", "along_error.5s.mean"):
        assert found.loc[name, "value"] == pytest.approx(3.0)


def test_a_shifted_plan_is_off_by_the_shift() -> None:
    found = table(LOG, plans(LOG.ego, FRAMES, 8.0, shifted(3.0, -4.0, 0.2)))["value"]
    for h in (1, 3, 5, 8):
        assert found[f"ade.{h}s.mean"] == pytest.approx(5.0)
        assert found[f"fde.{h}s.mean"] == pytest.approx(5.0)
        assert found[f"along_error.{h}s.mean"] == pytest.approx(3.0)
        assert found[f"cross_error.{h}s.mean"] == pytest.approx(4.0)
        assert found[f"ahe.{h}s.mean"] == pytest.approx(0.2)
        assert found[f"fhe.{h}s.mean"] == pytest.approx(0.2)


def test_the_first_point_is_left_out_and_the_last_is_in() -> None:
    """An error that grows by 1 m/s: mean of 0.1 .. 3.0 is 1.55, with t = 0 it were 1.5."""
    ahead = plans(LOG.ego, FRAMES, 8.0, lambda plan: replace(plan, x=plan.x + (plan.t - plan.t[0])))
    found = table(LOG, ahead)["value"]
    assert found["ade.3s.mean"] == pytest.approx(1.55)
    assert found["fde.3s.mean"] == pytest.approx(3.0)


@given(st.integers(-2, 2))
def test_heading_errors_are_principal_values(turns: int) -> None:
    found = table(LOG, plans(LOG.ego, FRAMES[:3], 3.0, shifted(turn=2 * pi * turns - 0.3)))["value"]
    assert found["ahe.3s.max"] == pytest.approx(0.3)


def test_short_plans_are_seen_in_the_share_and_the_logs_end_is_not() -> None:
    found = table(LOG, plans(LOG.ego, FRAMES, 4.0))
    for h in (1, 3):  # frames later than 11 s and 9 s ask for nothing: the log ends at 12 s
        assert found.loc[f"ade.{h}s.share", "value"] == 1.0
    assert found.loc["ade.5s.mean", "reason"] == "every plan ends before 5 s"
    assert not found.loc["ade.5s.mean", "available"]
    assert found.loc["ade.5s.share", "value"] == 0.0
    late = plans(LOG.ego, FRAMES[-3:], 8.0)
    assert (
        table(LOG, late).loc["ade.1s.share", "reason"]
        == "the log ends less than 1 s after every frame"
    )


def test_a_mean_over_few_plans_shows_its_share() -> None:
    """Row 12: of 85 frames one has a value. Its miss rate is no 0 either."""
    frames = list(plans(LOG.ego, FRAMES[:85], 0.05))
    assert not table(LOG, tuple(frames)).loc["miss.1s.rate", "available"]
    frames[7] = plans(LOG.ego, FRAMES[7:8], 8.0, shifted(1.0))[0]
    found = table(LOG, tuple(frames))
    assert found.loc["ade.1s.mean", "value"] == pytest.approx(1.0)
    assert (
        found.loc["ade.1s.share", "value"]
        == found.loc["miss.1s.share", "value"]
        == pytest.approx(1 / 85)
    )
    assert found.loc["plan_complete.rate", "value"] == pytest.approx(1 / 85)
    assert found.loc["plan_horizon.min", "value"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("off", "missed"),
    [
        (1.9, ()),
        (2.1, (1,)),
        (4.5, (1, 2)),
        (6.5, (1, 2, 3)),
        (8.5, (1, 2, 3, 5)),
        (16.5, (1, 2, 3, 5, 8)),
    ],
)
def test_a_plan_misses_where_it_is_beyond_the_bound_of_the_horizon(
    off: float, missed: tuple[int, ...]
) -> None:
    """Bounds 2, 4, 6, 8, 16 m.

    Half of the frames are off, once and only once on their way, 0.5 s after the frame.
    """

    def aside(plan: Trajectory) -> Trajectory:
        return replace(plan, y=plan.y + np.where(np.abs(plan.t - plan.t[0] - 0.5) < 0.01, off, 0.0))

    frames = plans(LOG.ego, FRAMES[:20], 8.0) + plans(LOG.ego, FRAMES[20:40], 8.0, aside)
    found = table(LOG, frames)["value"]
    for h in (1, 2, 3, 5, 8):
        assert found[f"miss.{h}s.rate"] == (0.5 if h in missed else 0.0)


@settings(max_examples=20)
@given(st.floats(-3.0, 3.0), st.floats(-50, 50), st.floats(-50, 50), st.booleans())
def test_errors_do_not_change_with_the_map(turn: float, dx: float, dy: float, mirror: bool) -> None:
    bend = shifted(1.0, 0.7, 0.1)
    one = table(BENT, plans(BENT.ego, FRAMES[:20], 5.0, bend))["value"]
    frames = plans(
        BENT.ego, FRAMES[:20], 5.0, lambda plan: moved_ego(bend(plan), turn, dx, dy, mirror=mirror)
    )
    two = table(moved(BENT, turn, dx, dy, mirror=mirror), frames)["value"]
    names = [
        name
        for name in one.index
        if name.split(".")[0] in ("ade", "fde", "ahe", "along_error", "cross_error")
    ]
    assert two[names].to_numpy() == pytest.approx(one[names].to_numpy(), abs=1e-9, nan_ok=True)


ASKED = {metric.name: metric for metric in GROUPS["consistency"]}
TIMES = grid(12.0, 0.1)[:11]


def judged(frames: tuple[PlannedFrame, ...], mode: Mode = Mode.OPEN) -> pd.DataFrame:
    return evaluate(drive(LOG, mode=mode, frames=frames), LOG, metrics=ASKED).set_index("metric")


def every_other(bend: Callable[[Trajectory], Trajectory]) -> tuple[PlannedFrame, ...]:
    """The frames 0, 0.5, 1 s; the middle one is bent."""
    return (
        *plans(LOG.ego, TIMES[:1], 6.0),
        *plans(LOG.ego, TIMES[5:6], 6.0, bend),
        *plans(LOG.ego, TIMES[10:], 6.0),
    )


@pytest.mark.parametrize("mode", Mode)
def test_plans_that_go_on_have_no_difference(mode: Mode) -> None:
    table = judged(plans(LOG.ego, TIMES, 5.0), mode)
    for row in ("plan_change.max", "plan_change_lateral.max", "extended_comfort.max"):
        assert table.loc[row, "value"] == pytest.approx(
            0.0, abs=1e-9 if row.startswith("extended") else 1e-12
        )
    assert table.loc["plan_horizon.min", "value"] == pytest.approx(5.0)
    assert table.loc["plan_complete.rate", "value"] == 1.0


def test_a_change_of_mind_in_jerk_yaw_rate_and_yaw_acceleration() -> None:
    """a = 2 t: seen from the plan at 1 s, t = 0.5 .. 4.5 s of the one before, rms 5.5 m/s2; the
    jerk's 2 is less.

    A yaw rate of 0.05 rad/s is half its bound.
    """

    def since(plan: Trajectory) -> np.ndarray:
        return plan.t - plan.t[0]

    jerk = judged(every_other(lambda plan: replace(plan, a=2.0 * since(plan))))
    rms = 2.0 * np.sqrt(np.mean((0.5 + 0.1 * np.arange(41)) ** 2))
    assert jerk.loc["extended_comfort.max", "value"] == pytest.approx(rms / 0.7)
    turn = judged(every_other(lambda plan: replace(plan, yaw=0.05 * since(plan))))
    assert turn.loc["extended_comfort.max", "value"] == pytest.approx(0.5)
    assert turn.loc["extended_comfort.max", "reason"] == "yaw rate"
    saw = judged(
        every_other(lambda plan: replace(plan, yaw=0.0005 * (-1.0) ** np.arange(len(plan))))
    )
    # headings +-0.0005 rad: yaw rate +-0.01 rad/s, yaw acceleration +-0.2 rad/s2, twice its bound
    assert saw.loc["extended_comfort.max", "value"] == pytest.approx(2.0)
    assert saw.loc["extended_comfort.max", "reason"] == "yaw acceleration"


def test_short_plans_are_incomplete() -> None:
    frames = plans(LOG.ego, TIMES[:3], 2.9) + plans(LOG.ego, TIMES[3:4], 3.0)
    table = judged(frames)
    assert table.loc["plan_complete.rate", "value"] == 0.25
    assert table.loc["plan_horizon.min", "value"] == pytest.approx(2.9)
    assert judged(()).loc["plan_complete.rate", "reason"] == "the drive has no plans"
    # The log ends at 12 s: two of them are asked
    last = plans(LOG.ego, np.array([8.9, 9.0, 9.1, 12.0]), 9.0)
    assert judged(last).loc["plan_complete.rate", "value"] == 1.0
    late = judged(last[2:])
    assert (
        late.loc["plan_complete.rate", "reason"] == "the log ends less than 3 s after every frame"
    )


def test_a_plan_that_flips_to_the_other_side() -> None:
    frames = list(plans(LOG.ego, FRAMES[:20], 2.0))
    for i, frame in enumerate(frames):
        side = 1.0 if i < 7 else -1.0
        plan = frame.plan.trajectory
        frames[i] = PlannedFrame(frame.t, Plan(replace(plan, y=side * (plan.t - plan.t[0]))))
    table = judged(tuple(frames))
    assert table.loc["plan_change_lateral.max", "time_s"] == pytest.approx(0.7)
    assert table.loc["plan_change_lateral.max", "value"] == pytest.approx(2.0 + 1.9)
    assert table.loc["plan_change.max", "value"] == pytest.approx(1.05 + 0.95)
