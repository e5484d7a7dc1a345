"""Needless braking, standing and steering.

False braking has no cause, missed braking leaves out what it asks for.
"""

from dataclasses import replace

import numpy as np
import pytest
from drives import along, changing, drive, grid, moved, moved_ego, scenario, straight_road

from replan.logs.agents import AgentKind
from replan.logs.road import Goal
from replan.logs.rules import Colour, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.metrics import METRICS, evaluate
from replan.metrics.needless import CAUSE_M, HARD_MPS2, hard_episodes, turning_points

NAMES = ("needless_braking.max", "needless_standing.worst_episode", "needless_steering.count")
ROAD = straight_road(limit=15.0)


def measured(log: Scenario, ego: Trajectory) -> list[float]:
    metrics = {
        name: METRICS[name]
        for name in ("needless_braking", "needless_standing", "needless_steering")
    }
    table = evaluate(drive(log, ego), log, metrics=metrics).set_index("metric")
    return [float(table.loc[name, "value"]) for name in NAMES]


def stopping(at: float, lasts: float = 8.0) -> Trajectory:
    """10 m/s, from the time `at` on a full stop with 2 m/s2, and on again after `lasts` s."""
    t = grid(30.0, 0.1)
    v = np.clip(
        np.minimum(10.0, np.maximum(10.0 - 2.0 * (t - at), 1.5 * (t - at - lasts))), 0.0, 10.0
    )
    return along(t, np.where(t < at, 10.0, v))


def box(kind: AgentKind, x: float, y: float) -> tuple:
    return (
        "7",
        kind,
        (0.6, 0.6) if kind is AgentKind.PEDESTRIAN else (4.5, 1.8),
        lambda t: (x + 0 * t, y + 0 * t, 0 * t),
    )


LOG = scenario(along(grid(30.0, 0.1), 10.0), road=ROAD)
STOP = stopping(8.0)
"""Stands at 105 m, its front at about 109 m."""


def test_a_drive_at_constant_speed_is_not_charged() -> None:
    assert measured(LOG, LOG.ego) == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("mirror", [False, True])
def test_a_full_stop_on_a_free_road_is_needless_in_any_direction(mirror: bool) -> None:
    world, ego = (
        moved(LOG, 2.0, 50.0, -900.0, mirror=mirror),
        moved_ego(STOP, 2.0, 50.0, -900.0, mirror=mirror),
    )
    lost, stood, swings = measured(world, ego)
    assert (lost, swings) == (pytest.approx(10.0, abs=0.1), 0.0)
    assert stood == pytest.approx(float(np.diff(STOP.t[STOP.v < 0.5][[0, -1]])[0]), abs=0.2)


STOP_LINE = replace(
    ROAD, stop_lines=(StopLine(1, 0, np.array([[111.0, 1.75], [111.0, -1.75]]), light=1),)
)
FAR_LINE = replace(
    ROAD, stop_lines=(StopLine(1, 0, np.array([[134.0, 1.75], [134.0, -1.75]]), light=1),)
)
RED = (TrafficLight(1, np.array([0.0, 20.0]), (Colour.RED, Colour.GREEN)),)
GREEN = (TrafficLight(1, np.array([0.0]), (Colour.GREEN,)),)


def goal_from(x: float, to: float, **more: tuple[float, float]) -> Goal:
    return Goal((np.array([[x, -2.0], [to, -2.0], [to, 2.0], [x, 2.0]]),), **more)


CALLED_FOR = {
    "a car that stands ahead": scenario(LOG.ego, [box(AgentKind.CAR, 116.0, 0.0)], road=ROAD),
    "a pedestrian beside the road ahead": scenario(
        LOG.ego, [box(AgentKind.PEDESTRIAN, 113.0, 3.0)], road=ROAD
    ),
    "a red light": replace(LOG, road=STOP_LINE, lights=RED),
    "the far end of the goal": replace(LOG, goal=goal_from(90.0, 115.0)),
    "a goal that asks for a speed": replace(LOG, goal=goal_from(112.0, 160.0, v=(0.0, 1.0))),
    "the goal's time": replace(LOG, goal=goal_from(90.0, 115.0, t=(28.0, 30.0))),
}


@pytest.mark.parametrize("time", [None, (12.0, 30.0)])
def test_a_goal_that_can_be_driven_through_is_no_reason_to_stop(
    time: tuple[float, float] | None,
) -> None:
    """Its near end is at the stop, its far end 150 m ahead.

    By its time the ego could be 20 m farther.
    """
    lost, stood, _ = measured(
        replace(LOG, goal=goal_from(112.0, 260.0, **({"t": time} if time else {}))), STOP
    )
    assert lost == pytest.approx(10.0, abs=0.1)
    assert stood > 3.0


@pytest.mark.parametrize("what", CALLED_FOR)
def test_a_stop_with_a_reason_is_not_charged(what: str) -> None:
    lost, stood, _ = measured(CALLED_FOR[what], STOP)
    assert not lost > 1.0
    assert stood < 3.0


@pytest.mark.parametrize(
    "log",
    [
        pytest.param(replace(LOG, road=STOP_LINE, lights=GREEN), id="a green light"),
        pytest.param(
            scenario(LOG.ego, [box(AgentKind.CAR, 60.0, 0.0)], road=ROAD), id="a car that is passed"
        ),
        pytest.param(
            scenario(LOG.ego, [box(AgentKind.CAR, 116.0, 9.0)], road=ROAD),
            id="a car that stands off the road",
        ),
    ],
)
def test_irrelevant_road_users_and_rules_are_no_reason(log: Scenario) -> None:
    lost, stood, _ = measured(log, STOP)
    assert lost > 5.0
    assert stood > 3.0


def test_standing_25_m_before_a_red_light_is_needless() -> None:
    log = replace(LOG, road=FAR_LINE, lights=RED)
    assert measured(log, STOP)[1] > 3.0


def test_slow_weaving_is_needless_and_a_lane_change_and_a_nudge_are_not() -> None:
    t = grid(20.0, 0.1)
    y = 0.4 * np.sin(2.0 * np.pi * t / 5.0)
    weaving = replace(along(t, 10.0), y=y, yaw=np.arctan2(np.gradient(y, t), 10.0))
    assert measured(LOG, weaving)[2] >= 6.0
    two = replace(LOG, road=straight_road(lanes=2, limit=15.0))
    assert measured(two, changing(t, 10.0, 5.0, 4.0))[2] == 0.0
    out, back = changing(t, 10.0, 4.0, 3.0, to=1.2), changing(t, 10.0, 10.0, 3.0, to=1.2)
    y = out.y - back.y
    nudge = replace(out, y=y, yaw=np.arctan2(np.gradient(y, t), 10.0))
    assert measured(scenario(LOG.ego, [box(AgentKind.CAR, 90.0, -2.4)], road=ROAD), nudge)[2] == 0.0


def test_turning_points_are_those_of_changes_above_the_threshold() -> None:
    value = np.array([0.0, 0.1, 0.0, 1.0, 0.8, 1.1, 0.2, 0.3, 0.1, 0.9])
    assert turning_points(value, 0.5) == [0, 5, 8, 9]
    assert turning_points(np.zeros(5), 0.5) == []


FALSE_NAMES = ("false_braking", "missed_braking")


def measured_row(log: Scenario, ego: Trajectory, row: str) -> float:
    table = evaluate(
        drive(log, ego), log, metrics={name: METRICS[name] for name in FALSE_NAMES}
    ).set_index("metric")
    return float(table.loc[row, "value"])


def braking(*begins: float, b: float = 6.0, lasts: float = 0.6) -> Trajectory:
    """12 m/s, less by `b` m/s2 for a while from each of these times on."""
    t = grid(20.0, 0.1)
    v = 12.0 - sum(b * np.clip(t - begin, 0.0, lasts) for begin in begins)
    return along(t, v, a=np.gradient(v, t))


def other(x: float, y: float, vy: float = 0.0) -> tuple:
    return ("7", AgentKind.PEDESTRIAN, (0.5, 0.5), lambda t: (x + 0.0 * t, y + vy * t, 0.0 * t))


EGO = braking(8.0)
EMPTY = scenario(EGO, road=ROAD)
SIDE = 0.5 * EMPTY.vehicle.width
"""Where the ego's side is, m."""


def test_mild_braking_is_no_episode_and_two_far_apart_are_two() -> None:
    assert (
        hard_episodes(braking(8.0, b=HARD_MPS2 - 0.3)) == []
        and len(hard_episodes(braking(8.0, 12.0))) == 2
    )
    assert len(hard_episodes(braking(8.0, 8.8))) == 1
    assert measured_row(EMPTY, braking(8.0, b=3.0), "false_braking.count") == 0.0


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize(
    ("x", "y", "vy", "false"),
    [
        (130.0, SIDE + 0.25 + CAUSE_M - 0.05, 0.0, 0.0),
        (130.0, SIDE + 0.25 + CAUSE_M + 0.05, 0.0, 1.0),
        (130.0, -14.0, 1.2, 0.0),
        (130.0, -20.0, 1.2, 1.0),
        (60.0, 0.0, 0.0, 1.0),
        (240.0, 0.0, 0.0, 1.0),
    ],
)
def test_braking_is_false_without_a_road_user_near(
    x: float, y: float, vy: float, false: float, *, mirror: bool
) -> None:
    """At 8 s the ego is at 96 m and has 60 m ahead in 5 s."""
    log = scenario(EGO, [other(x, y, vy)], road=ROAD)
    world, ego = (
        moved(log, 1.0, 50.0, -90.0, mirror=mirror),
        moved_ego(EGO, 1.0, 50.0, -90.0, mirror=mirror),
    )
    assert measured_row(world, ego, "false_braking.rate") == false


def test_missed_braking_falls_with_the_braking_before_a_standing_road_user() -> None:
    t = grid(20.0, 0.1)
    v = np.clip(12.0 - 2.0 * np.maximum(t - 2.0, 0.0), 0.0, 12.0)
    stop = along(t, v, a=np.gradient(v, t))
    log = scenario(stop, [other(12.0 * 2.0 + 36.0 + 12.0, 0.0)], road=ROAD)
    assert measured_row(log, stop, "missed_braking.max") < 2.0
    assert measured_row(log, along(t[t < 5.0], 12.0), "missed_braking.max") > 5.0
