from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, changing, drive, grid, moved, moved_ego, moving, scenario, straight_road
from hypothesis import given, settings, strategies as st

from replan.logs.agents import AgentKind
from replan.logs.road import Lane, Road
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.metrics import METRICS, evaluate

ASKED = {name: METRICS[name] for name in ("wrong_way", "lane_keeping", "lane_line")}
WIDTH = 3.5


def judged(log: Scenario, ego: Trajectory | None = None) -> pd.DataFrame:
    return evaluate(drive(log, ego), log, metrics=ASKED).set_index("metric")


def two_way() -> Road:
    """Our lane on y = 0 along x, the oncoming one on y = 3.5."""
    road = straight_road(lanes=2)
    ours, theirs = road.lanes[0], road.lanes[1]
    back = replace(
        theirs,
        left=theirs.right[::-1],
        right=theirs.left[::-1],
        right_neighbour=None,
        left_opposite=True,
    )
    return replace(road, lanes={0: replace(ours, left_neighbour=None, left_opposite=True), 1: back})


def beside(t: np.ndarray, v: float, y: np.ndarray | float) -> Trajectory:
    ego = along(t, v)
    return replace(ego, y=np.broadcast_to(np.asarray(y, float), t.shape))


LOG = scenario(along(grid(10.0, 0.1), 10.0), road=two_way())


def test_ten_seconds_in_the_oncoming_lane() -> None:
    """Row 14: no metric objected. 10 m/s against the lane: 10 m in each second, 100 m in all."""
    table = judged(LOG, beside(grid(10.0), 10.0, WIDTH))
    assert table.loc["wrong_way.worst_1s", "value"] == pytest.approx(10.0, abs=0.01)
    assert table.loc["wrong_way.distance", "value"] == pytest.approx(100.0, abs=0.11)
    assert table.loc["wrong_way.time", "value"] == pytest.approx(10.0, abs=0.011)
    assert table.loc["wrong_way.worst_episode", "value"] == pytest.approx(10.0, abs=0.011)
    assert (table["unit"] == ["m", "m", "s", "s", "m", "s", "s", "m", "s"]).all()
    fine = judged(LOG)["value"]
    assert (fine[[name for name in fine.index if name.startswith("wrong_way")]] == 0.0).all()


def test_reversing_is_against_the_lane_and_so_is_turning_round() -> None:
    for ego in (
        along(grid(3.0), -3.0),
        replace(along(grid(3.0), -3.0), v=np.full(301, 3.0), yaw=np.full(301, np.pi)),
    ):
        table = judged(LOG, ego)["value"]
        assert table["wrong_way.worst_1s"] == pytest.approx(3.0, abs=0.01)
        assert table["wrong_way.distance"] == pytest.approx(9.0, abs=0.04)
    standing = judged(LOG, beside(grid(3.0), 0.05, WIDTH))["value"]
    assert standing["wrong_way.time"] == 0.0


def test_two_visits_are_two_episodes() -> None:
    t = grid(10.0)
    y = np.where((t > 1.995) & (t < 3.995), WIDTH, 0.0) + np.where(
        (t > 5.995) & (t < 8.995), WIDTH, 0.0
    )
    table = judged(LOG, beside(t, 10.0, y))
    assert table.loc["wrong_way.time", "value"] == pytest.approx(5.0)
    assert table.loc["wrong_way.worst_episode", "value"] == pytest.approx(3.0)
    assert table.loc["wrong_way.worst_episode", "time_s"] == pytest.approx(6.0)
    # off its own centre it never is: the deviation is that from the oncoming lane's
    assert table.loc["lane_keeping.max_abs", "value"] == pytest.approx(0.0, abs=1e-9)


def test_where_lanes_cross_nothing_is_asked() -> None:
    """A lane across at x = 40 ..

    50 m, from left to right: in it the ego drives neither against nor off a lane.
    """
    y = np.array([-60.0, 60.0])
    across = Lane(7, np.column_stack([np.full(2, 40.0), y]), np.column_stack([np.full(2, 50.0), y]))
    road = replace(LOG.road, lanes={**LOG.road.lanes, 7: across})
    log = replace(LOG, road=road)
    t = grid(10.0)
    table = judged(log, beside(t, 10.0, WIDTH))["value"]
    assert table["wrong_way.distance"] == pytest.approx(100.0 - 10.0, abs=0.25)
    off = judged(log, beside(t, 10.0, 0.8))["value"]
    assert off["lane_keeping.time_beyond_50cm"] == pytest.approx(9.0, abs=0.03)
    assert off["lane_keeping.worst_episode"] == pytest.approx(
        (100.0 - 50.0 + LOG.vehicle.axle_to_center) / 10, abs=0.02
    )


def test_lanes_that_lead_both_ways_may_be_driven_both_ways() -> None:
    ours = straight_road().lanes[0]
    back = replace(ours, id=1, left=ours.right[::-1], right=ours.left[::-1])
    log = replace(LOG, road=Road({0: ours, 1: back}))
    for ego in (along(grid(3.0), 8.0), replace(along(grid(3.0), 8.0), yaw=np.full(301, np.pi))):
        assert judged(log, ego).loc["wrong_way.distance", "value"] == 0.0


@pytest.mark.parametrize(
    ("aside", "seconds", "expected"), [(0.45, 3.0, 0.0), (0.55, 1.5, 1.5), (-0.55, 3.0, 3.0)]
)
def test_lane_keeping_is_the_longest_stretch_beyond_half_a_metre(
    aside: float, seconds: float, expected: float
) -> None:
    """NAVSIM fails 2.0 s and more."""
    t = grid(8.0)
    y = np.where((t > 1.995) & (t < 1.995 + seconds), aside, 0.0)
    table = judged(LOG, beside(t, 10.0, y))
    assert table.loc["lane_keeping.worst_episode", "value"] == pytest.approx(expected)
    assert table.loc["lane_keeping.max_abs", "value"] == pytest.approx(abs(aside))


@settings(max_examples=20)
@given(
    st.floats(-3.0, 3.0),
    st.floats(-50, 50),
    st.floats(-50, 50),
    st.booleans(),
    st.floats(-0.4, 0.4),
)
def test_the_map_may_be_turned_moved_and_mirrored(
    turn: float, dx: float, dy: float, mirror: bool, yaw: float
) -> None:
    t = grid(4.0, 0.05)
    ego = Trajectory(t, 8 * t, 1.7 + 1.6 * np.sin(t), np.full(len(t), yaw), 8 + 0 * t, 0 * t, 0 * t)
    one = judged(LOG, ego)["value"]
    two = judged(
        moved(LOG, turn, dx, dy, mirror=mirror), moved_ego(ego, turn, dx, dy, mirror=mirror)
    )["value"]
    assert two.to_numpy() == pytest.approx(one.to_numpy(), abs=1e-6)


@pytest.mark.parametrize(
    ("y", "over"), [(0.0, 0.0), (0.8, 0.0), (1.4, 10.0), (1.7, 10.0), (-1.5, 10.0), (3.5, 0.0)]
)
@pytest.mark.parametrize("mirror", [False, True])
def test_a_drive_on_the_line_of_its_lane_is_one_episode(
    y: float, over: float, mirror: bool
) -> None:
    log = replace(LOG, road=straight_road(lanes=2))
    ego = moved_ego(beside(grid(10.0, 0.1), 10.0, y), 1.0, 5.0, -300.0, mirror=mirror)
    table = judged(moved(log, 1.0, 5.0, -300.0, mirror=mirror), ego)
    assert table.loc["lane_line.worst_episode", "value"] == pytest.approx(over, abs=0.11)


def test_a_lane_change_and_a_nudge_round_a_car_are_no_straddling() -> None:
    two, t = replace(LOG, road=straight_road(lanes=2)), grid(10.0, 0.1)
    assert judged(two, changing(t, 10.0, 2.0, 4.0))["value"]["lane_line.worst_episode"] < 4.0
    parked = ("7", AgentKind.CAR, (4.5, 1.8), moving(60.0, -1.6, 0.0, 0.0, yaw=0.0))
    nudge = scenario(LOG.ego, [parked], road=straight_road(lanes=2))
    assert judged(nudge, beside(t, 10.0, 1.4))["value"]["lane_line.worst_episode"] < 4.0
