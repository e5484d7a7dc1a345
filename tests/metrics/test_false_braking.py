"""False braking has no cause; missed braking leaves out what its cause asks for."""

from __future__ import annotations

import numpy as np
import pytest
from drives import along, drive, grid, moved, moved_ego, scenario, straight_road

from logs import AgentKind, Scenario, Trajectory
from metrics import METRICS, evaluate
from metrics.needless import CAUSE_M, HARD_MPS2, hard_episodes

ROAD = straight_road(limit=15.0)
NAMES = ("false_braking", "missed_braking")


def measured(log: Scenario, ego: Trajectory, row: str) -> float:
    table = evaluate(drive(log, ego), log, metrics={name: METRICS[name] for name in NAMES}).set_index("metric")
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
    assert hard_episodes(braking(8.0, b=HARD_MPS2 - 0.3)) == [] and len(hard_episodes(braking(8.0, 12.0))) == 2
    assert len(hard_episodes(braking(8.0, 8.8))) == 1
    assert measured(EMPTY, braking(8.0, b=3.0), "false_braking.count") == 0.0


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize(
    ("x", "y", "vy", "false"),
    [
        (130.0, SIDE + 0.25 + CAUSE_M - 0.05, 0.0, 0.0), (130.0, SIDE + 0.25 + CAUSE_M + 0.05, 0.0, 1.0),
        (130.0, -14.0, 1.2, 0.0), (130.0, -20.0, 1.2, 1.0), (60.0, 0.0, 0.0, 1.0), (240.0, 0.0, 0.0, 1.0),
    ],
)  # fmt: skip
def test_braking_is_false_where_nobody_comes_near_the_way_ahead(
    x: float, y: float, vy: float, false: float, *, mirror: bool
) -> None:
    """At 8 s the ego is at 96 m and has 60 m ahead in 5 s."""
    log = scenario(EGO, [other(x, y, vy)], road=ROAD)
    world, ego = moved(log, 1.0, 50.0, -90.0, mirror=mirror), moved_ego(EGO, 1.0, 50.0, -90.0, mirror=mirror)
    assert measured(world, ego, "false_braking.rate") == false


def test_who_does_not_brake_for_one_who_stands_ahead_misses_it_and_who_does_in_time_hardly() -> None:
    t = grid(20.0, 0.1)
    v = np.clip(12.0 - 2.0 * np.maximum(t - 2.0, 0.0), 0.0, 12.0)
    stop = along(t, v, a=np.gradient(v, t))
    log = scenario(stop, [other(12.0 * 2.0 + 36.0 + 12.0, 0.0)], road=ROAD)
    assert measured(log, stop, "missed_braking.max") < 2.0
    assert measured(log, along(t[t < 5.0], 12.0), "missed_braking.max") > 5.0
