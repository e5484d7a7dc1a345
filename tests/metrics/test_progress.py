from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, moved, moved_ego, scenario, straight_road
from hypothesis import given, settings, strategies as st

from replan.logs.road import Goal, Lane, RoadSource
from replan.logs.scenario import References, Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import EndReason, TrackingErrors
from replan.metrics import GROUPS, METRICS, evaluate
from replan.metrics.metric import Series
from replan.metrics.route_gain import gain_along, route_of

ASKED = {
    metric.name: metric for group in ("progress", "rules", "tracking") for metric in GROUPS[group]
}


def judged(log: Scenario, ego: Trajectory | None = None, **changes: object) -> pd.DataFrame:
    return evaluate(drive(log, ego, **changes), log, metrics=ASKED).set_index("metric")


LOG = scenario(along(grid(5.0, 0.1), 10.0), duration=8.0)


@given(st.floats(1.0, 20.0))
def test_progress_is_the_share_of_the_logs_way(v: float) -> None:
    """The log's driver gains 50 m in 5 s."""
    table = judged(LOG, along(grid(5.0), v))
    assert table.loc["route_progress.final", "value"] == pytest.approx(v / 10.0, abs=1e-6)
    assert table.loc["progress.final", "value"] == pytest.approx(min(v / 10.0, 1.0), abs=1e-6)
    assert table.loc["completion.final", "value"] == pytest.approx(min(v / 10.0, 1.0), abs=0.01)
    assert table.loc["distance.final", "value"] == pytest.approx(5.0 * v)
    assert table.loc["speed.mean", "value"] == pytest.approx(v)


@given(st.floats(0.5, 5.0))
def test_progress_of_a_short_drive_is_relative_to_the_whole_log(seconds: float) -> None:
    """Row 13: 1 s of 10 was 1.0."""
    log = scenario(along(grid(10.0, 0.1), 10.0))
    table = judged(log, along(grid(seconds), 10.0), end=EndReason.COLLISION)
    for name in ("route_progress", "progress", "completion"):
        assert table.loc[f"{name}.final", "value"] == pytest.approx(
            round(seconds, 2) / 10.0, abs=2e-3
        )


@settings(max_examples=20)
@given(st.floats(3.0, 20.0), st.integers(1, 4), st.booleans())
def test_circles_gain_nothing(radius: float, turns: int, left: bool) -> None:
    """Row 13: whole circles end where they began; the path length said 1.0 and more."""
    angle = np.linspace(0.0, 2.0 * np.pi * turns, 400)
    sign = 1.0 if left else -1.0
    t = angle * radius / 10.0
    ego = Trajectory(
        t,
        radius * np.sin(angle),
        sign * radius * (1 - np.cos(angle)),
        sign * angle,
        10 + 0 * t,
        0 * t,
        sign / radius + 0 * t,
    )
    table = judged(scenario(along(grid(10.0, 0.1), 10.0), duration=200.0), ego)
    assert table.loc["distance.final", "value"] == pytest.approx(
        2 * np.pi * turns * radius, rel=0.01
    )
    assert table.loc["route_progress.final", "value"] == pytest.approx(0.0, abs=0.02)


@given(st.floats(20.0, 400.0), st.integers(1, 99))
def test_a_leap_gains_no_more_than_the_car_could_drive(leap: float, at: int) -> None:
    """Row 13: teleports were counted in full (137.8).

    In the step of the leap, 2 * 10 m/s * 0.1 s = 2 m count.
    """
    t = grid(10.0, 0.1)
    ego = along(t, 10.0)
    ego = replace(ego, x=ego.x + np.where(np.arange(101) >= at, leap, 0.0))
    found = judged(scenario(along(t, 10.0)), ego, end=EndReason.GOAL).loc[
        "route_progress.final", "value"
    ]
    assert 0.99 <= found <= 1.0 + 0.01 * (1.1 + leap / 30.0) + 1e-6


@pytest.mark.parametrize("radius", [1.5, 2.0, 4.0, 6.0, 30.0])
@pytest.mark.parametrize("step", [0.02, 0.1, 0.2])
def test_laps_count_in_full_however_short_they_are(radius: float, step: float) -> None:
    """Three laps: a lap shorter than the search for the foot was taken for another one."""
    t = np.arange(0.0, 6.0 * np.pi * radius / 2.0, step)
    w = 2.0 * t / radius
    laps = Trajectory(
        t,
        radius * np.sin(w),
        radius - radius * np.cos(w),
        w,
        2.0 + 0.0 * t,
        0.0 * t,
        1.0 / radius + 0.0 * t,
    )
    log = scenario(laps)
    assert gain_along(route_of(log), laps).metres[-1] == pytest.approx(
        2.0 * t[-1], rel=0.02, abs=0.3
    )


def test_a_short_drive_without_lanes_is_no_yardstick() -> None:
    """A planner that drove 400 m where the log's driver went 2 m had done 20801 % of the way."""
    for way, asked in ((2.5, False), (8.0, True)):
        log = scenario(along(grid(10.0, 0.1), way / 10.0))
        bare = replace(log, road=replace(log.road, source=RoadSource.DRIVEN_PATH))
        assert judged(log, along(grid(10.0), 10.0)).loc["route_progress.final", "available"]
        found = judged(bare, along(grid(10.0), 10.0)).loc["route_progress.final"]
        assert found["available"] == asked and (asked or "no yardstick" in found["reason"])


def test_a_path_that_the_vehicle_cannot_follow_is_not_asked_of_planners() -> None:
    t = np.arange(0.0, 20.0, 0.1)
    laps = Trajectory(
        t, 2.0 * np.sin(t), 2.0 - 2.0 * np.cos(t), t, 2.0 + 0.0 * t, 0.0 * t, 0.5 + 0.0 * t
    )
    log = scenario(laps)
    bare = replace(log, road=replace(log.road, source=RoadSource.DRIVEN_PATH))
    every = {
        name: metric
        for group in GROUPS.values()
        for name, metric in ((one.name, one) for one in group)
    }
    for each, known in ((log, True), (bare, False)):
        table = evaluate(drive(each, laps), each, metrics=every).set_index("metric")
        for name in (
            "fallback.rate",
            "plan_refused.rate",
            "plan_corrected.rate",
            "plan_change_lateral.mean",
            "route_progress.final",
        ):
            if not known:
                assert (
                    not table.loc[name, "available"]
                    and "turns within 2.0 m" in table.loc[name, "reason"]
                )
        assert table.loc["route_progress.final", "available"] == known


def test_driving_back_is_negative_and_nuplans_score_is_then_zero() -> None:
    ego = along(grid(5.0), -2.0)
    table = judged(LOG, ego)["value"]
    assert table["route_progress.final"] == pytest.approx(-10.0 / 50.0)
    assert table["progress.final"] == table["completion.final"] == 0.0


def test_reaching_the_goal_before_the_log_does_is_enough() -> None:
    """The goal is at 35 m, the log's driver gained 50 m.

    The lanes' route to it is 35 m less the axle's distance.
    """
    log = replace(
        LOG, goal=Goal((np.array([[35.0, -2.0], [40.0, -2.0], [40.0, 2.0], [35.0, 2.0]]),))
    )
    there = judged(log, along(grid(3.5), 10.0), end=EndReason.GOAL)["value"]
    assert there["route_progress.final"] == there["completion.final"] == 1.0
    short = judged(log, along(grid(2.0), 10.0))["value"]
    assert short["route_progress.final"] == pytest.approx(0.4)
    assert short["completion.final"] == pytest.approx(
        20.0 / (35.0 - log.vehicle.axle_to_center), abs=0.02
    )


def test_a_standing_log_is_no_yardstick_of_progress() -> None:
    still = scenario(along(grid(5.0, 0.1), 0.0))
    for ego in (still.ego, along(grid(5.0), 0.2)):
        table = judged(still, ego)["value"]
        assert table["progress.final"] == 1.0
    assert "no yardstick for progress" in judged(still).loc["route_progress.final", "reason"]
    assert "neither a goal" in judged(still).loc["completion.final", "reason"]


def test_without_a_logged_drive_the_route_follower_is_the_yardstick() -> None:
    alone = scenario(along(np.zeros(1), 10.0), duration=5.0)
    ego = along(grid(5.0), 10.0)
    table = judged(alone, ego)
    assert table.loc["progress.final", "reason"].startswith("the log holds one ego state only")
    assert "no route follower was driven" in table.loc["route_progress.final", "reason"]
    told = replace(alone, references=References(follower_gain=40.0))
    assert judged(told, ego).loc["route_progress.final", "value"] == pytest.approx(
        50.0 / 40.0, abs=1e-3
    )
    region = Goal((np.array([[95.0, -2.0], [99.0, -2.0], [99.0, 2.0], [95.0, 2.0]]),))
    way = judged(replace(told, goal=region), ego).loc["completion.final", "value"]
    assert way == pytest.approx(50.0 / (95.0 - alone.vehicle.axle_to_center), abs=0.01)


def test_a_goal_that_is_a_time_only_asks_for_progress() -> None:
    """A log of 12 s at 10 m/s whose goal begins after 5 s: a drive of 50 m has come as far as its
    driver then had.
    """
    log = scenario(along(grid(12.0), 10.0), goal=Goal(t=(5.0, 6.0)))
    for speed in (10.0, 5.0, 0.0):
        table = judged(log, along(grid(5.0), speed), end=EndReason.GOAL)
        assert "the goal is a time only" in table.loc["goal.final", "reason"]
        assert table.loc["route_progress.final", "value"] == pytest.approx(speed / 10.0, abs=0.01)


@given(st.floats(0.0, 20.0), st.floats(1.0, 400.0), st.floats(1.0, 8.0))
def test_a_goal_that_no_vehicle_reaches_is_not_asked_by_name(
    speed: float, ahead: float, until: float
) -> None:
    """A vehicle that accelerates with 1 g up to 70 m/s comes to every goal that is asked."""
    region = np.array([[ahead, -2.0], [ahead + 5.0, -2.0], [ahead + 5.0, 2.0], [ahead, 2.0]])
    log = scenario(along(np.zeros(1), speed), duration=until, goal=Goal((region,)))
    found = judged(log, along(grid(until), 0.0)).loc["goal.final"]
    away = ahead - log.vehicle.axle_to_center
    fast = min(until, (70.0 - speed) / 9.81)  # until when it accelerates
    assert found["available"] == (
        away <= speed * fast + 0.5 * 9.81 * fast**2 + 70.0 * (until - fast)
    )
    assert found["available"] or found["reason"].startswith("no vehicle reaches the goal")


def test_progress_leads_around_bends_and_over_lane_changes() -> None:
    """A quarter circle of 60 m, driven a lane (3.5 m) inside of the log's path: the stations are
    the same.
    """
    angle = np.linspace(0.0, 0.5 * np.pi, 200)
    t = angle * 60.0 / 10.0

    def bend(radius: float) -> Trajectory:
        return Trajectory(
            t,
            radius * np.sin(angle),
            60.0 - radius * np.cos(angle),
            angle,
            radius / 6.0 + 0 * t,
            0 * t,
            1 / radius + 0 * t,
        )

    log = scenario(bend(60.0))
    assert judged(log, bend(56.5)).loc["route_progress.final", "value"] == pytest.approx(
        1.0, abs=0.01
    )
    lanes = scenario(
        along(np.zeros(1), 10.0),
        road=straight_road(lanes=2),
        duration=12.0,
        goal=Goal((np.array([[90.0, 1.8], [110.0, 1.8], [110.0, 5.0], [90.0, 5.0]]),)),
        references=References(follower_gain=80.0),
    )
    s = grid(8.0)
    change = along(s, 10.0)
    change = replace(change, y=3.5 / (1.0 + np.exp(-(change.x - 40.0) / 5.0)))
    assert judged(lanes, change).loc["route_progress.final", "value"] == pytest.approx(
        1.0, abs=0.02
    )


def test_a_lane_change_in_the_middle_of_the_route_is_no_leap() -> None:
    """Lanes 0, 1 from -100 m and 2, 3 from 100 m on; the goal is in 3: the line changes over within
    20 m.

    A car that changes 40 m later, and is a lane aside until then, gains what it drives.
    """
    x = (np.array([-100.0, 100.0]), np.array([100.0, 300.0]))
    lanes = {}
    for i in range(4):
        along_x, y = x[i // 2], 3.5 * (i % 2)
        left, right = (np.column_stack([along_x, np.full(2, y + side)]) for side in (1.75, -1.75))
        beside = {"left_neighbour": i + 1} if i % 2 == 0 else {"right_neighbour": i - 1}
        lanes[i] = Lane(i, left, right, (i + 2,) if i < 2 else (), **beside)
    region = np.array([[200.0, 1.75], [220.0, 1.75], [220.0, 5.25], [200.0, 5.25]])
    log = scenario(
        along(np.zeros(1), 10.0),
        road=replace(straight_road(), lanes=lanes),
        duration=20.0,
        goal=Goal((region,)),
        references=References(follower_gain=200.0),
    )
    ego = along(grid(20.0), 10.0)
    ego = replace(ego, y=3.5 / (1.0 + np.exp(-(ego.x - 140.0) / 5.0)))
    assert gain_along(route_of(log), ego).cut == 0.0
    assert judged(log, ego).loc["route_progress.final", "value"] == pytest.approx(1.0, abs=0.01)
    assert route_of(log).length == pytest.approx(200.0 - log.vehicle.axle_to_center, abs=1.5)


@settings(max_examples=15)
@given(st.floats(-3.0, 3.0), st.floats(-50, 50), st.floats(-50, 50), st.booleans())
def test_progress_does_not_change_with_the_map(
    turn: float, dx: float, dy: float, mirror: bool
) -> None:
    ego = along(grid(4.0), 9.0)
    ego = replace(ego, y=0.8 * np.sin(ego.x / 9.0))
    one = judged(LOG, ego)["value"]
    two = judged(
        moved(LOG, turn, dx, dy, mirror=mirror), moved_ego(ego, turn, dx, dy, mirror=mirror)
    )["value"]
    for name in ("route_progress", "progress", "completion"):
        assert two[f"{name}.final"] == pytest.approx(one[f"{name}.final"], abs=1e-6)


@pytest.mark.parametrize("end", EndReason)
def test_goal_and_completion_are_the_end_of_the_drive(end: EndReason) -> None:
    log = replace(LOG, goal=Goal(v=(0.0, 20.0)))
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
    assert table.loc["speed_excess.share_above_1mps", "value"] == pytest.approx(0.5, abs=0.01)
    # 9, 10, 11, 12, 12 m/s at 0 .. 4 s, limit 10: the excess integrates to 0.5 * 2 * 2 + 2 * 1 = 4
    # m in 4 s
    assert table.loc["speed_excess.compliance", "value"] == pytest.approx(
        1.0 - 4.0 / (2.23 * 4.0), abs=0.01
    )
    # 10 % is 11 m/s, passed at 2 s
    assert table.loc["speed_ratio.time_above_10pct", "value"] == pytest.approx(2.0, abs=0.02)
    assert table.loc["speed_ratio.max", "value"] == pytest.approx(0.2)


@pytest.mark.parametrize(("brake", "charged"), [(2.0, 0.0), (1.0, 0.0), (0.6, 0.4), (0.0, 1.0)])
def test_an_excess_at_the_start_is_charged_unless_it_comes_down_comfortably(
    brake: float, charged: float
) -> None:
    """From 14.65 m/s, 4.65 m/s above the limit, after 1 s with a deceleration."""
    t = grid(12.0, 0.1)
    ego = along(t, np.maximum(14.65 - brake * np.maximum(t - 1.0, 0.0), 10.0))
    table = judged(scenario(ego, road=straight_road(limit=10.0)))
    assert table.loc["speed_excess.max", "value"] == pytest.approx(charged * 4.65, abs=0.1)
    assert (table.loc["speed_excess.time_above_1mps", "value"] > 1.0) == (charged > 0.0)


def test_a_later_excess_is_charged_with_any_start() -> None:
    t = grid(12.0, 0.1)
    again = along(t, np.interp(t, [0.0, 4.0, 6.0, 8.0, 12.0], [13.0, 10.0, 10.0, 13.0, 13.0]))
    assert judged(scenario(again, road=straight_road(limit=10.0))).loc[
        "speed_excess.max", "value"
    ] == pytest.approx(3.0)
    below = along(t, np.interp(t, [0.0, 2.0, 12.0], [9.9, 13.0, 10.0]))
    assert judged(scenario(below, road=straight_road(limit=10.0))).loc[
        "speed_excess.max", "value"
    ] == pytest.approx(3.0)


def test_the_larger_limit_counts_where_lanes_overlap() -> None:
    one = straight_road(limit=5.0).lanes[0]
    road = replace(
        straight_road(),
        lanes={
            0: one,
            1: replace(one, id=1, speed_limit=8.0),
            2: replace(one, id=2, speed_limit=np.nan),
        },
    )
    assert judged(scenario(LOG.ego, road=road)).loc["speed_excess.max", "value"] == pytest.approx(
        2.0
    )


def test_tracking_errors() -> None:
    t = LOG.ego.t
    wave = np.sin(2 * np.pi * t)
    errors = TrackingErrors(t, 0.2 * wave, -0.1 * wave, 0 * t + 0.5, -t)
    table = judged(LOG, tracking=errors)
    assert table.loc["tracking_lateral.rms", "value"] == pytest.approx(
        0.2 * np.sqrt(np.mean(wave**2))
    )
    assert table.loc["tracking_lateral.max_abs", "value"] == pytest.approx(0.2 * np.abs(wave).max())
    assert table.loc["tracking_speed.p95", "value"] == pytest.approx(0.5)
    assert table.loc["tracking_station.max_abs", "value"] == pytest.approx(5.0)
    assert table.loc["tracking_station.max_abs", "time_s"] == pytest.approx(5.0)
    assert table.loc["tracking_heading.max_abs", "unit"] == "rad"
    assert (
        judged(LOG)
        .loc["tracking_lateral.rms", "reason"]
        .startswith("the drive has no tracking errors")
    )


AHEAD = np.array([[40.0, -2.0], [50.0, -2.0], [50.0, 2.0], [40.0, 2.0]])


@pytest.mark.parametrize(
    ("goal", "missed"),
    [
        (Goal((np.array([[80.0, 5.0], [90.0, 5.0], [90.0, 9.0], [80.0, 9.0]]),)), "place"),
        (Goal((AHEAD,), yaw=(1.0, 2.0)), "heading"),
        (Goal((AHEAD,), v=(0.0, 5.0)), "speed"),
        (Goal((AHEAD,), t=(0.0, 3.0)), "time"),
        (Goal((AHEAD,), v=(0.0, 5.0), yaw=(1.0, 2.0)), "speed and heading"),
    ],
)
def test_a_missed_goal_names_its_unmet_conditions(goal: Goal, missed: str) -> None:
    log = replace(scenario(along(grid(12.0, 0.1), 10.0), road=straight_road()), goal=goal)
    series = METRICS["goal"].measure(drive(log), log)
    assert isinstance(series, Series)
    assert (series.value[-1], series.labels[-1]) == (
        0.0,
        f"end of the log: {missed} of the goal missed",
    )
