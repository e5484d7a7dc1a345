from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, moved_ego, plans, scenario

from logs import Mode, PlannedFrame, Trajectory
from metrics import GROUPS, evaluate

ASKED = {metric.name: metric for metric in GROUPS["consistency"]}
LOG = scenario(along(grid(12.0, 0.1), 10.0))
TIMES = grid(12.0, 0.1)[:11]


def judged(frames: tuple[PlannedFrame, ...], mode: Mode = Mode.OPEN) -> pd.DataFrame:
    return evaluate(drive(LOG, mode=mode, frames=frames), LOG, metrics=ASKED).set_index("metric")


def every_other(bend: Callable[[Trajectory], Trajectory]) -> tuple[PlannedFrame, ...]:
    """The frames 0, 0.5, 1 s; the middle one is bent."""
    return (*plans(LOG.ego, TIMES[:1], 6.0), *plans(LOG.ego, TIMES[5:6], 6.0, bend), *plans(LOG.ego, TIMES[10:], 6.0))


@pytest.mark.parametrize("mode", Mode)
def test_plans_that_go_on_have_no_difference(mode: Mode) -> None:
    table = judged(plans(LOG.ego, TIMES, 5.0), mode)
    for row in ("plan_change.max", "plan_change_lateral.max", "extended_comfort.max"):
        assert table.loc[row, "value"] == pytest.approx(0.0, abs=1e-9)
    assert table.loc["plan_horizon.min", "value"] == pytest.approx(5.0)
    assert table.loc["plan_complete.rate", "value"] == 1.0


def test_a_change_of_mind_in_acceleration() -> None:
    """A plan that brakes with 1.4 m/s2 all along after one that holds its speed: rms 1.4, bound 0.7: 2.0."""
    table = judged(every_other(lambda plan: replace(plan, a=np.full(len(plan), -1.4))))
    assert table.loc["extended_comfort.max", "value"] == pytest.approx(2.0)
    assert table.loc["extended_comfort.max", "time_s"] == pytest.approx(0.5)
    assert table.loc["extended_comfort.max", "reason"] == "acceleration"


def test_a_change_of_mind_in_jerk_yaw_rate_and_yaw_acceleration() -> None:
    """a = 2 t: seen from the plan at 1 s, t = 0.5 .. 4.5 s of the one before, rms 5.5 m/s2; the jerk's 2 is less.

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
    saw = judged(every_other(lambda plan: replace(plan, yaw=0.0005 * (-1.0) ** np.arange(len(plan)))))
    # headings +-0.0005 rad: yaw rate +-0.01 rad/s, yaw acceleration +-0.2 rad/s2, twice its bound
    assert saw.loc["extended_comfort.max", "value"] == pytest.approx(2.0)
    assert saw.loc["extended_comfort.max", "reason"] == "yaw acceleration"


def test_only_plans_half_a_second_apart_are_compared() -> None:
    assert (
        judged(plans(LOG.ego, TIMES[:5], 5.0)).loc["extended_comfort.max", "reason"] == "no two plans are 0.5 s apart"
    )
    apart = plans(LOG.ego, TIMES[:1], 0.3) + plans(LOG.ego, TIMES[5:6], 5.0)
    assert judged(apart).loc["extended_comfort.max", "reason"] == "plans 0.5 s apart never overlap"


def test_short_plans_are_incomplete() -> None:
    frames = plans(LOG.ego, TIMES[:3], 2.9) + plans(LOG.ego, TIMES[3:4], 3.0)
    table = judged(frames)
    assert table.loc["plan_complete.rate", "value"] == 0.25
    assert table.loc["plan_horizon.min", "value"] == pytest.approx(2.9)
    assert judged(()).loc["plan_complete.rate", "reason"] == "the drive has no plans"
    last = plans(LOG.ego, np.array([8.9, 9.0, 9.1, 12.0]), 9.0)  # the log ends at 12 s: two of them are asked
    assert judged(last).loc["plan_complete.rate", "value"] == 1.0
    late = judged(last[2:])
    assert late.loc["plan_complete.rate", "reason"] == "the log ends less than 3 s after every frame"


@pytest.mark.parametrize("mirror", [False, True])
def test_plans_may_be_turned_and_mirrored(mirror: bool) -> None:
    def bend(plan: Trajectory) -> Trajectory:
        s = plan.t - plan.t[0]
        return replace(plan, yaw=0.1 * s, kappa=0.01 * s, a=np.sin(s), y=0.05 * s**2)

    one = judged(every_other(bend))["value"]
    frames = tuple(
        PlannedFrame(f.t, replace(f.plan, trajectory=moved_ego(f.plan.trajectory, 1.2, 30.0, -9.0, mirror=mirror)))
        for f in every_other(bend)
    )
    assert judged(frames)["value"].to_numpy() == pytest.approx(one.to_numpy(), abs=1e-9)
