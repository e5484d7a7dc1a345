"""RSS: distances, dangerous situations and proper responses, by hand.

Parameters: rho 0.75, 3, 6, 6, 1, 1, 0.3.
"""

import numpy as np
import pandas as pd
import pytest
from drives import CAR, NOSE, Agent, along, drive, grid, moving, scenario

from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.metrics import GROUPS, evaluate, series
from replan.metrics.rss import lateral_distance, longitudinal_distance

MINE = {metric.name: metric for metric in GROUPS["safety"] if metric.name.startswith("rss")}


def car(gap: float, v: float, y: float = 0.0, vy: float = 0.0) -> Agent:
    return "7", AgentKind.CAR, CAR, moving(NOSE + gap + 2.25, y, v, vy, 0.0)


def world(v: float, *agents: Agent, seconds: float = 3.0) -> Scenario:
    return scenario(along(grid(seconds), v), agents)


def table(log: Scenario) -> pd.DataFrame:
    return evaluate(drive(log), log, metrics=MINE).set_index("metric")


def steps(log: Scenario, name: str) -> pd.Series:
    frames = series(drive(log), log, metrics=MINE)
    mine = frames[frames["metric"] == name]
    return mine.set_index(mine["t_s"].round(3))["value"]


def test_the_longitudinal_distance() -> None:
    """15 behind 10 m/s: 11.25 + 0.84375 + 17.25^2 / 12 - 100 / 12 = 28.5573; 15 behind 15: 18.1406;
    oncoming at 10: 36.890625 + 7.5 + 0.84375 + 12.25^2 / 12 = 57.7396; a much faster lead: 0."""
    assert longitudinal_distance(15.0, 10.0) == pytest.approx(28.557291667)
    assert longitudinal_distance(15.0, 15.0) == pytest.approx(18.140625)
    assert longitudinal_distance(15.0, -10.0) == pytest.approx(
        36.890625 + 7.5 + 0.84375 + 12.25**2 / 12.0
    )
    assert longitudinal_distance(5.0, 30.0) == 0.0


def test_the_lateral_distance() -> None:
    """Each for itself: 0.375 * 0.75 + 0.75^2 / 2 = 0.5625; both 1.125, and 0.3. Nearing at 1 m/s:
    1.375 * 0.75 + 1.75^2 / 2 = 2.5625. Leaving at 1 m/s: -0.625 * 0.75 - 0.25^2 / 2 = -0.5: 0.3625;
    at 3 m/s only 0.3 remain."""
    assert lateral_distance(0.0, True) == pytest.approx(1.425)
    assert lateral_distance(0.0, False) == pytest.approx(0.8625)
    assert lateral_distance(1.0, True) == pytest.approx(0.3 + 0.5625 + 2.5625)
    assert lateral_distance(-1.0, True) == pytest.approx(0.3 + 0.5625 - 0.5)
    assert lateral_distance(-3.0, True) == pytest.approx(0.3)


def test_the_margin_is_the_greater_of_both() -> None:
    """40 m behind 10 m/s with 15: 40 - 28.557 ahead; beside at 3 m: 3 - 0.9 - 0.805 - 1.425 = -0.13
    m, so 0 m ahead is dangerous there, and at 3.5 m it is not."""
    log = world(15.0, car(40.0, 10.0), seconds=0.2)
    assert steps(log, "rss_margin")[0.0] == pytest.approx(40.0 - 28.557291667)
    beside = world(15.0, car(-4.0, 15.0, y=3.0), seconds=0.2)
    assert steps(beside, "rss_margin")[0.0] == pytest.approx(-0.13)
    assert steps(world(15.0, car(-4.0, 15.0, y=3.5), seconds=0.2), "rss_margin")[
        0.0
    ] == pytest.approx(0.37)


def test_the_share_of_dangerous_time() -> None:
    """15 behind 10 m/s, 33.557 m: 5 m to spare, gone after 1 s of 3."""
    found = table(world(15.0, car(33.557291667, 10.0)))
    assert found.loc["rss_margin.time_dangerous", "value"] == pytest.approx(2.0, abs=0.1)
    assert found.loc["rss_margin.share_dangerous", "value"] == pytest.approx(2.0 / 3.0, abs=0.03)
    assert found.loc["rss_margin.min", "reason"] == "car 7"


def test_agents_behind_do_not_count_and_without_others_rss_has_no_value() -> None:
    behind = table(world(10.0, car(-NOSE - 8.0, 15.0), seconds=0.5))
    assert not behind.loc["rss_margin.min", "available"]
    assert (
        behind.loc["rss_improper.share", "reason"] == "no dangerous situation: no response was due"
    )
    standing = table(world(0.0, car(0.5, 0.0), seconds=0.5))
    assert not standing.loc["rss_margin.min", "available"]


def test_an_ego_that_does_not_brake_responds_improperly_from_rho_on() -> None:
    """In danger from the start: from 0.75 s on, on the grid from 0.8 s, to the end at 1.5 s."""
    log = world(15.0, car(20.0, 12.0), seconds=1.5)
    found = steps(log, "rss_improper")
    assert found.index[found > 0].to_numpy() == pytest.approx(np.arange(0.8, 1.55, 0.1))
    assert table(log).loc["rss_improper.time", "value"] == pytest.approx(0.75, abs=0.051)
    assert table(log).loc["rss_improper.time", "reason"] == "car 7"


@pytest.mark.parametrize(("brake", "proper"), [(6.0, True), (5.5, False)])
def test_braking_hard_enough_after_rho_is_the_proper_response(brake: float, proper: bool) -> None:
    t = grid(2.5)
    a = np.where(t < 0.7, 0.0, -brake)
    v = 15.0 - brake * np.maximum(t - 0.7, 0.0)
    log = scenario(along(t, v, a=a), [car(20.0, 12.0)])
    assert bool(table(log).loc["rss_improper.time", "value"] == 0.0) is proper


def test_within_rho_the_ego_may_accelerate_up_to_its_greatest() -> None:
    t = grid(0.7)
    for a, proper in ((3.0, True), (3.5, False)):
        log = scenario(along(t, 10.0 + a * t, a=a), [car(10.0, 10.0)])
        assert bool(table(log).loc["rss_improper.time", "value"] == 0.0) is proper


def cut_in(drift: float) -> Scenario:
    """A car ahead and aside comes nearer at 0.5 m/s: the lateral distance becomes unsafe last,
    after 0.99 s: then 0.3 + 0.5625 + 0.875 * 0.75 + 1.25^2 / 2 = 2.3 m are asked for. From 1.2 s on
    the ego heads `drift` rad to it."""
    t = grid(2.5)
    yaw = np.where(t < 1.2, 0.0, drift)
    y = np.r_[0.0, np.cumsum(15.0 * np.sin(yaw[1:])) * 0.01]
    beside = ("7", AgentKind.CAR, CAR, lambda s: (15.0 * s + 9.0, 4.5 - 0.5 * s, 0 * s))
    return scenario(Trajectory(t, 15.0 * t, y, yaw, 15 + 0 * t, 0 * t, 0 * t), [beside])


@pytest.mark.parametrize(("drift", "proper"), [(0.0, True), (0.03, False), (-0.03, True)])
def test_a_danger_from_the_side_asks_for_no_brake_but_not_to_drift_nearer(
    drift: float, proper: bool
) -> None:
    """0.03 rad at 15 m/s are 0.45 m/s to the car.

    Allowed is what it was at rho, less 1 m/s per s.
    """
    found = table(cut_in(drift))
    assert found.loc["rss_margin.time_dangerous", "time_s"] == pytest.approx(1.0)
    assert bool(found.loc["rss_improper.time", "value"] == 0.0) is proper
