from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, moved, moved_ego, moving, plans, scenario, straight_road
from hypothesis import given, strategies as st

from replan.logs.agents import AgentKind
from replan.logs.road import Road, RoadSource
from replan.logs.rules import Colour, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import EndReason, Mode
from replan.metrics import GROUPS, evaluate
from replan.metrics.driving_scores import CARLA, NUPLAN_CLOSED, PARTS, Formula, combined
from replan.metrics.metric import Unavailable

ASKED = {metric.name: metric for metric in GROUPS["score"]}
T = grid(10.0, 0.1)
FRAMES = grid(9.0, 0.5)


def log(v: float = 10.0, limit: float = 10.0, **changes: object) -> Scenario:
    return scenario(along(T, v), road=straight_road(limit=limit), duration=12.0, **changes)  # type: ignore[arg-type]


def judged(world: Scenario, ego: Trajectory | None = None, **changes: object) -> pd.DataFrame:
    long = along(grid(20.0, 0.1), 10.0)
    fields = {"frames": plans(long, FRAMES, 5.0)} | changes
    return evaluate(drive(world, ego, **fields), world, metrics=ASKED).set_index("metric")


def totals(table: pd.DataFrame) -> dict[str, float]:
    rows = table[table.index.str.endswith(".score.final")]
    return {name.split(".")[0]: float(value) for name, value in rows["value"].items()}


def test_the_logs_own_drive_has_full_marks() -> None:
    table = judged(log())
    assert totals(table) == pytest.approx({"nuplan_closed": 1.0, "carla": 1.0})
    assert table.loc["nuplan_closed.score.final", "reason"] == ""
    assert table.loc["carla.score.final", "reason"] == "without: red lights, stop signs"
    found = judged(log(), mode=Mode.OPEN, frames=plans(along(T, 10.0), FRAMES[:2], 9.0))
    assert totals(found) == {"nuplan_open": 1.0}


def test_parts_that_lose_marks() -> None:
    """Half of the log's way, 1.115 m/s too fast (half of 2.23), braking with 5 m/s2: each alone, by
    hand.
    """
    half = totals(judged(log(), along(T, 5.0)))
    # progress 0.5: (2.5 + 5 + 4 + 2) / 16, 0.5
    expected = {"nuplan_closed": 13.5 / 16, "carla": 0.5}
    assert half == pytest.approx(expected, abs=5e-3)
    fast = totals(judged(log(), along(T, 11.115)))
    assert fast == pytest.approx({"nuplan_closed": 14 / 16, "carla": 1.0}, abs=5e-3)
    a = np.where((T > 3) & (T < 6), -5.0, 0.0)
    harsh = totals(judged(log(), along(T, 10.0, a=a)))
    # Comfort 0: (5 + 5 + 4) / 16
    assert harsh == pytest.approx({"nuplan_closed": 14 / 16, "carla": 1.0})
    slow = totals(judged(log(), along(T, 1.9)))
    assert slow["nuplan_closed"] == 0.0  # 0.19 of the way is no progress: the multiplier


def test_penalties_depend_on_the_kind_of_the_road_user() -> None:
    """The ego drives into something that stands 50 m ahead; 42 m of 100 m are driven.

    ttc is 0: it is at fault.
    """
    for kind, nuplan, carla in (
        (AgentKind.OBJECT, 0.5, 0.65),
        (AgentKind.CAR, 0.0, 0.6),
        (AgentKind.PEDESTRIAN, 0.0, 0.5),
        (AgentKind.BICYCLE, 0.0, 0.6),
    ):
        world = scenario(
            along(T, 10.0),
            [("7", kind, (1.0, 1.0), moving(50.0, 0.0, 0.0, 0.0, 0.0))],
            road=straight_road(limit=10.0),
        )
        ego = along(grid(4.7, 0.1), 10.0)
        table = judged(world, ego, end=EndReason.COLLISION)
        assert table.loc["nuplan_closed.collisions.final", "value"] == nuplan
        assert table.loc["nuplan_closed.ttc.final", "value"] == 0.0
        assert totals(table)["nuplan_closed"] == pytest.approx(
            nuplan * (5 * 0.47 + 4 + 2) / 16, abs=2e-3
        )
        assert totals(table)["carla"] == pytest.approx(carla * 0.47, abs=2e-3)


def test_against_the_lane() -> None:
    """5 m against the lane within 1 s is half, 10 m nothing."""
    back = straight_road(limit=10.0).lanes[0]
    back = replace(back, left=back.right[::-1], right=back.left[::-1])
    against = replace(log(), road=Road({0: back}))
    table = judged(against)
    assert (
        table.loc["nuplan_closed.direction.final", "value"] == totals(table)["nuplan_closed"] == 0.0
    )
    assert totals(table)["carla"] == 0.0  # not a metre of it was on the right side
    slow = scenario(along(T, 5.0), road=Road({0: back}))
    assert judged(slow).loc["nuplan_closed.direction.final", "value"] == 0.5


def test_red_lights_and_the_lanes_edge() -> None:
    line = StopLine(3, 0, np.array([[50.0, 1.75], [50.0, -1.75]]), light=4)
    road = replace(straight_road(limit=10.0), stop_lines=(line,))
    red = replace(log(), road=road, lights=(TrafficLight(4, np.zeros(1), (Colour.RED,)),))
    table = judged(red)
    assert table.loc["carla.score.final", "value"] == pytest.approx(0.7)
    assert table.loc["carla.score.final", "reason"] == "without: stop signs"
    # a corner is 0.3 m off from y = 1.75 + 0.3 - half the car's width on: a quarter of the way
    y = np.where((T > 2.45) & (T < 4.95), 2.0, 0.0)
    off = judged(log(), replace(along(T, 10.0), y=y))
    assert off.loc["carla.inside_lanes.final", "value"] == pytest.approx(0.75, abs=0.03)
    assert totals(off)["nuplan_closed"] == 0.0


def test_a_missing_multiplier_is_the_reason() -> None:
    table = judged(log(limit=float("nan")), along(T, 5.0))
    # Without a limit, none is exceeded
    assert totals(table)["nuplan_closed"] == pytest.approx(13.5 / 16, abs=5e-3)
    bare = judged(replace(log(), road=replace(straight_road(), source=RoadSource.DRIVEN_PATH)))
    assert "the log has no lanes" in bare.loc["nuplan_closed.score.final", "reason"]
    alone = judged(replace(log(), ego=along(T[:1], 10.0)), along(T, 10.0))
    assert "fewer than" in alone.loc["nuplan_closed.score.final", "reason"]


def test_nuplans_open_loop_score() -> None:
    """Plans 7 m aside: within 8 m, but beyond the 6 m of a miss at 3 s.

    Turned by 0.9 rad: both headings fail.
    """

    def opened(horizon: float, **bend: float) -> pd.DataFrame:
        def bent(plan: Trajectory) -> Trajectory:
            return replace(plan, y=plan.y + bend.get("y", 0.0), yaw=plan.yaw + bend.get("yaw", 0.0))

        return judged(
            log(), mode=Mode.OPEN, frames=plans(along(grid(20.0, 0.1), 10.0), FRAMES, horizon, bent)
        )

    assert totals(opened(8.0, y=5.0)) == {"nuplan_open": 1.0}
    missed = opened(8.0, y=7.0)
    assert missed.loc["nuplan_open.ade.final", "value"] == 1.0
    assert totals(missed) == {"nuplan_open": 0.0}
    assert totals(opened(8.0, yaw=0.9)) == pytest.approx({"nuplan_open": 2.0 / 6.0})
    assert totals(opened(2.0)) == {"nuplan_open": 0.0}  # short plans miss
    assert totals(opened(2.0, y=-0.1))["nuplan_open"] == 0.0


@given(
    st.lists(st.floats(0.0, 1.0), min_size=9, max_size=9), st.integers(0, 8), st.floats(0.0, 1.0)
)
def test_a_score_is_in_0_to_1_and_grows_with_each_part(
    values: list[float], which: int, more: float
) -> None:
    for formula in (NUPLAN_CLOSED, CARLA):
        parts = dict(zip(formula.names, values, strict=False))
        name = formula.names[which % len(formula.names)]
        one, _ = combined(formula, parts)
        two, _ = combined(formula, {**parts, name: max(parts[name], more)})
        assert isinstance(one, float)
        assert isinstance(two, float)
        assert 0.0 <= one <= two + 1e-12
        assert two <= 1.0 + 1e-12


def test_a_mean_without_parts_is_no_score() -> None:
    formula = Formula(("a",), {"b": 1.0})
    found, _ = combined(formula, {"a": 1.0, "b": Unavailable("not today")})
    assert isinstance(found, Unavailable)
    assert all(name in PARTS for name in CARLA.names)


@pytest.mark.parametrize("mirror", [False, True])
def test_scores_do_not_change_with_the_map(mirror: bool) -> None:
    world, ego = log(), replace(along(T, 8.0), y=0.3 * np.sin(T))
    one = judged(world, ego)["value"]
    two = judged(
        moved(world, 0.7, 20.0, -5.0, mirror=mirror), moved_ego(ego, 0.7, 20.0, -5.0, mirror=mirror)
    )["value"]
    assert two.to_numpy() == pytest.approx(one.to_numpy(), abs=1e-6, nan_ok=True)
