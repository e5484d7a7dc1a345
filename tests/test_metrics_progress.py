from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, scenario, straight_road
from hypothesis import given
from hypothesis import strategies as st

from logs import EndReason, Goal, RoadSource, Scenario, TrackingErrors, Trajectory
from metrics import evaluate


def judged(log: Scenario, ego: Trajectory | None = None, **changes: object) -> pd.DataFrame:
    return evaluate(drive(log, ego, **changes), log).set_index("metric")


LOG = scenario(along(grid(5.0, 0.1), 10.0), duration=8.0)


@given(st.floats(1.0, 20.0))
def test_progress_is_the_share_of_the_logs_way(v: float) -> None:
    table = judged(LOG, along(grid(5.0), v))
    assert table.loc["progress.final", "value"] == pytest.approx(v / 10.0)
    assert table.loc["distance.final", "value"] == pytest.approx(5.0 * v)
    assert table.loc["speed.mean", "value"] == pytest.approx(v)


def test_progress_is_compared_while_the_log_lasts() -> None:
    table = judged(LOG, along(grid(8.0), 10.0))
    assert table.loc["progress.final", "value"] == pytest.approx(1.0)
    assert table.loc["progress.final", "time_s"] == pytest.approx(5.0)
    assert table.loc["distance.final", "value"] == pytest.approx(80.0)


def test_a_log_that_stands_still_asks_for_nothing() -> None:
    still = scenario(along(grid(5.0, 0.1), 0.0))
    assert judged(still).loc["progress.final", "value"] == 1.0
    assert judged(still, along(grid(5.0), 0.2)).loc["progress.final", "value"] == 1.0


def test_progress_needs_a_logged_drive() -> None:
    alone = scenario(along(np.zeros(1), 10.0), duration=5.0)
    table = judged(alone, along(grid(5.0), 10.0))
    assert table.loc["progress.final", "reason"].startswith("the log holds one ego state only")
    assert table.loc["distance.final", "value"] == pytest.approx(50.0)


@pytest.mark.parametrize("end", EndReason)
def test_goal_and_completion_are_the_end_of_the_drive(end: EndReason) -> None:
    log = replace(LOG, goal=Goal())
    table = judged(log, end=end, detail="car 12")
    assert table.loc["goal.final", "value"] == (end is EndReason.GOAL)
    assert table.loc["completed.final", "value"] == (end in (EndReason.GOAL, EndReason.END_OF_LOG))
    assert table.loc["completed.final", "reason"] == f"{end.value}: car 12"
    assert table.loc["completed.final", "time_s"] == 5.0
    assert judged(LOG, end=end).loc["goal.final", "reason"] == "the log names no goal"


def test_speed_above_the_limit() -> None:
    t = grid(4.0)
    ego = along(t, np.minimum(9.0 + t, 12.0), a=0.0)
    log = scenario(ego, road=straight_road(limit=10.0))
    table = judged(log)
    assert table.loc["speed_excess.max", "value"] == pytest.approx(2.0)
    assert table.loc["speed_excess.max", "time_s"] == pytest.approx(3.0)
    assert table.loc["speed_excess.time_above_1mps", "value"] == pytest.approx(2.0, abs=0.02)


def test_the_larger_limit_counts_where_lanes_overlap() -> None:
    one = straight_road(limit=5.0).lanes[0]
    road = replace(
        straight_road(),
        lanes={0: one, 1: replace(one, id=1, speed_limit=8.0), 2: replace(one, id=2, speed_limit=np.nan)},
    )
    assert judged(scenario(LOG.ego, road=road)).loc["speed_excess.max", "value"] == pytest.approx(2.0)


def test_why_speed_limits_are_not_judged() -> None:
    for road in (straight_road(), replace(straight_road(limit=9.0), source=RoadSource.DRIVEN_PATH)):
        assert judged(scenario(LOG.ego, road=road)).loc["speed_excess.max", "reason"] == "the log has no speed limits"
    far = replace(
        straight_road(limit=9.0),
        lanes={0: replace(straight_road(limit=9.0).lanes[0], left=np.ones((2, 2)), right=np.zeros((2, 2)))},
    )
    away = along(grid(1.0), 10.0, x=50.0)
    assert judged(scenario(away, road=far)).loc["speed_excess.max", "reason"].startswith("the ego is never on a lane")


def test_tracking_errors() -> None:
    t = LOG.ego.t
    wave = np.sin(2 * np.pi * t)
    errors = TrackingErrors(t, 0.2 * wave, -0.1 * wave, 0 * t + 0.5, -t)
    table = judged(LOG, tracking=errors)
    assert table.loc["tracking_lateral.rms", "value"] == pytest.approx(0.2 * np.sqrt(np.mean(wave**2)))
    assert table.loc["tracking_lateral.max_abs", "value"] == pytest.approx(0.2 * np.abs(wave).max())
    assert table.loc["tracking_speed.p95", "value"] == pytest.approx(0.5)
    assert table.loc["tracking_station.max_abs", "value"] == pytest.approx(5.0)
    assert table.loc["tracking_station.max_abs", "time_s"] == pytest.approx(5.0)
    assert table.loc["tracking_heading.max_abs", "unit"] == "rad"
    assert judged(LOG).loc["tracking_lateral.rms", "reason"].startswith("the drive has no tracking errors")
