"""Offsets that are kept, swings of the speed, lane changes for nothing, braking before a follower,
fast curves.
"""

from dataclasses import replace

import numpy as np
import pytest
from drives import (
    CAR,
    EGO,
    NOSE,
    along,
    car,
    changing,
    drive,
    grid,
    moved,
    moved_ego,
    scenario,
    straight_road,
)
from hypothesis import given, settings, strategies as st

from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.metrics import METRICS, evaluate
from replan.metrics.cut_in import REACT_S
from replan.metrics.steadiness import JUDGED_S, LEAST_S, RETURN_MPS, SETTLES_S

T = grid(30.0, 0.1)
ROAD = straight_road(lanes=2, limit=15.0)
LOG = scenario(along(T, 12.0), road=ROAD)


def value(name: str, ego: Trajectory, log: Scenario = LOG) -> float:
    """The value of a row; NaN where it has none."""
    key = name.partition(".")[0]
    table = evaluate(drive(log, ego), log, metrics={key: METRICS[key]}).set_index("metric")
    return float(table["value"].get(name, float("nan")))


def beside(y: np.ndarray | float) -> Trajectory:
    """12 m/s along x at the offset y(t)."""
    y = np.broadcast_to(np.asarray(y, float), T.shape)
    return replace(along(T, 12.0), y=y, yaw=np.arctan2(np.gradient(y, T), 12.0))


def at_speed(v: np.ndarray) -> Trajectory:
    return along(T, v, a=np.gradient(v, T))


@settings(max_examples=15, deadline=None)
@given(st.floats(-0.9, 0.9), st.floats(-3.0, 3.0), st.booleans())
def test_a_constant_offset_is_measured_on_any_road(
    offset: float, turn: float, mirror: bool
) -> None:
    ego = beside(offset * np.clip(T / 3.0, 0.0, 1.0))
    world, ego = (
        moved(LOG, turn, 50.0, -90.0, mirror=mirror),
        moved_ego(ego, turn, 50.0, -90.0, mirror=mirror),
    )
    assert value("lane_offset.kept", ego, world) == pytest.approx(abs(offset), abs=1e-3)


def test_swaying_and_passing_offsets_are_not_kept() -> None:
    swaying = 0.5 * np.sin(2.0 * np.pi * T / 6.0)
    assert value("lane_offset.kept", beside(swaying)) < 0.1
    for_a_while = 0.6 * np.clip(np.minimum(T - 5.0, 14.0 - T), 0.0, 1.0)
    assert value("lane_offset.kept", beside(for_a_while)) == 0.0
    start = np.maximum(0.8 - RETURN_MPS * T, 0.0)
    assert value("lane_offset.kept", beside(start)) < 0.01


def test_an_offset_is_not_judged_while_there_is_something_to_pass_nor_in_a_short_drive() -> None:
    walker = car(20.0, -2.2, 12.0, kind=AgentKind.PEDESTRIAN)
    assert np.isnan(value("lane_offset.kept", beside(0.5), scenario(LOG.ego, [walker], road=ROAD)))
    assert np.isnan(value("lane_offset.kept", beside(0.5).between(0.0, SETTLES_S + JUDGED_S - 0.5)))
    # As it began: 5 s for 0.5 m, then a fault
    assert value("lane_offset.kept", beside(0.5)) == pytest.approx(0.5)


def test_swings_of_the_speed_are_counted_per_minute() -> None:
    swings = at_speed(10.0 + 0.8 / (0.6 * np.pi) * np.sin(0.6 * np.pi * T))
    assert value("speed_swing.all.per_minute", swings) == pytest.approx(18.0, abs=1.0)
    assert value("speed_swing.needless.per_minute", swings) > 12.0
    hiccup = at_speed(12.0 - 2.5 * np.clip(1.5 - np.abs(T % 8.0 - 6.0), 0.0, 1.0))
    assert value("speed_swing.needless.per_minute", hiccup) > 4.0
    once = at_speed(12.0 - 2.5 * np.clip(1.5 - np.abs(T - 10.0), 0.0, 1.0))
    assert value("speed_swing.needless.count", once) == 1.0
    assert value("speed_swing.needless.per_minute", once) <= 60.0 / LEAST_S
    assert value("speed_swing.all.count", at_speed(np.minimum(5.0 + T, 12.0))) == 0.0


@pytest.mark.parametrize("place", ["a car ahead", "a car on the other lane"])
def test_a_car_ahead_explains_that_the_speed_falls_and_one_beside_does_not(place: str) -> None:
    slows = at_speed(12.0 - np.clip(T - 8.0, 0.0, 4.0))
    log = scenario(LOG.ego, [car(60.0, 0.0 if place == "a car ahead" else 3.5, 8.0)], road=ROAD)
    assert value("speed_swing.needless.count", slows, log) == (
        0.0 if place == "a car ahead" else 1.0
    )
    assert value("speed_swing.all.count", slows, log) == 1.0


def back_and_forth(first: float = 6.0) -> Trajectory:
    out, back = changing(T, 12.0, first), changing(T, 12.0, first + 6.0)
    y = out.y - back.y + changing(T, 12.0, first + 12.0).y
    return replace(out, y=y, yaw=np.arctan2(np.gradient(y, T), 12.0))


@pytest.mark.parametrize("mirror", [False, True])
def test_lane_changes_away_from_the_route_are_needless_unless_a_road_user_is_in_the_way(
    mirror: bool,
) -> None:
    def count(log: Scenario, ego: Trajectory) -> float:
        turned = (
            moved(log, 1.0, 5.0, 5.0, mirror=mirror),
            moved_ego(ego, 1.0, 5.0, 5.0, mirror=mirror),
        )
        return value("needless_lane_change.count", turned[1], turned[0])

    assert count(LOG, back_and_forth()) == 2.0  # the one between leads back to the route
    assert count(LOG, beside(0.0)) == 0.0
    slower = scenario(LOG.ego, [car(90.0, 0.0, 5.0)], road=ROAD)
    assert count(slower, changing(T, 12.0, 3.0)) == 0.0
    # The route changes later
    assert count(scenario(changing(T, 12.0, 20.0), road=ROAD), changing(T, 12.0, 3.0)) == 0.0
    assert np.isnan(
        count(
            replace(LOG, road=replace(ROAD, source=type(ROAD.source).DRIVEN_PATH)), back_and_forth()
        )
    )


def test_needless_braking_forces_a_follower_to_brake() -> None:
    brakes = at_speed(np.clip(12.0 - 4.0 * (T - 8.0), 0.0, 12.0))
    follower = car(-16.0, 0.0, 12.0)
    gap = 16.0 - (EGO.length - NOSE) - 0.5 * CAR[0]
    stops = 12.0**2 / (2.0 * (gap + 12.0**2 / (2.0 * 4.0) - 12.0 * REACT_S))
    forced = value("braked_behind.max", brakes, scenario(LOG.ego, [follower], road=ROAD))
    assert forced == pytest.approx(stops, abs=0.15)
    gentle = at_speed(12.0 - np.clip(0.5 * (T - 8.0), 0.0, 2.0))
    assert (
        value("braked_behind.max", gentle, scenario(LOG.ego, [car(-40.0, 0.0, 12.0)], road=ROAD))
        < 1.0
    )
    faster = scenario(LOG.ego, [car(-40.0, 0.0, 15.0)], road=ROAD)  # it would have to brake anyway
    assert value("braked_behind.max", gentle, faster) < 0.6
    for others in ([car(-16.0, 3.5, 12.0)], [follower, ("8", *car(140.0, 0.0, 1.0)[1:])]):
        assert np.isnan(value("braked_behind.max", brakes, scenario(LOG.ego, others, road=ROAD)))


@pytest.mark.parametrize("kappa", [0.03, -0.03])
def test_a_curve_is_judged_by_the_mean_over_a_second_and_a_swerve_is_none(kappa: float) -> None:
    ego = replace(along(T, 12.0), kappa=np.where(T > 10.0, kappa, 0.0))
    assert value("curve_accel.max", ego) == pytest.approx(144.0 * 0.03, rel=1e-6)
    swerve = replace(along(T, 12.0), kappa=kappa * np.sign(np.sin(2.0 * np.pi * T / 0.8)))
    assert value("curve_accel.max", swerve) < 2.0
