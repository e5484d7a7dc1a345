"""nuPlan's closed-loop score: equal to the devkit's own values, and the same in a turned or
mirrored world.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from drives import along, grid, moved, moved_ego, moving, scenario, straight_road
from hypothesis import given, settings, strategies as st

from replan.logs.agents import AgentKind
from replan.logs.catalogue import scenario as catalogue
from replan.logs.readers import read_log
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import EndReason, Mode, Trace
from replan.metrics.driving_scores import NUPLAN_CLOSED
from replan.metrics.nuplan_closed_loop import closed_loop_parts

VALUES = Path(__file__).parents[1] / "support" / "leaderboards"
BUILT_IN = {
    "everyday_cut_in": "everyday/cut_in",
    "everyday_junction": "everyday/junction",
    "everyday_crosswalk": "everyday/crosswalk",
    "paper_crossing_pedestrian": "paper/crossing_pedestrian",
}
COLUMNS = ("t", "x", "y", "yaw", "v", "a", "kappa")


def parts(world: Scenario, ego: Trajectory) -> dict[str, float]:
    found = closed_loop_parts(
        Trace(world.name, "", Mode.CLOSED, False, ego, world.tracks, (), EndReason.GOAL), world
    )
    assert isinstance(found, dict)
    return found


def compared(folder: Path, mine: str, logs: object) -> pd.DataFrame:
    """The absolute differences from the devkit's values, a row for each trajectory of the logs that
    `mine` matches.
    """
    trajectories = pd.read_parquet(folder / "nuplan_trajectories.parquet")
    values = pd.read_csv(folder / "nuplan_original.csv").set_index("trajectory")
    rows = {}
    for name, one in trajectories[trajectories.trajectory.str.match(mine)].groupby("trajectory"):
        found = parts(
            logs(name.rsplit("__", 1)[0]), Trajectory(*(one[c].to_numpy() for c in COLUMNS))
        )  # type: ignore[operator]
        rows[name] = {
            part: abs(found[part] - values.loc[name, part]) for part in NUPLAN_CLOSED.names
        }
    return pd.DataFrame(rows).T


def test_all_parts_equal_those_of_the_devkit_on_the_catalogue() -> None:
    differences = compared(VALUES, "", cache(lambda name: catalogue(BUILT_IN[name])))
    assert len(differences) == 42
    assert differences.to_numpy().max() < 1e-6


def test_all_parts_equal_those_of_the_devkit_on_recorded_logs(shared_data: Path) -> None:
    if not (shared_data / "leaderboards").is_dir():
        pytest.skip("no values for recorded logs")
    read = cache(lambda name: read_log(shared_data / "commonroad" / f"{name}.xml"))
    differences = compared(shared_data / "leaderboards", "C-", read)
    assert len(differences) == 41
    assert differences.to_numpy().max() < 1e-6


T = grid(10.0, 0.1)


def test_agents_that_appear_in_contact_are_judged_and_later_ones_are_not_close() -> None:
    """A car that stands 40 m ahead: at fault, ttc 0.

    One that rear-ends the ego: neither, though they go on.
    """
    world = scenario(
        along(T, 10.0),
        [("7", AgentKind.CAR, (4.5, 1.8), moving(40.0, 0.0, 0.0, 0.0, 0.0))],
        road=straight_road(limit=10.0),
    )
    found = parts(world, along(T, 10.0))
    assert (found["collisions"], found["ttc"]) == (0.0, 0.0)
    inside = scenario(
        along(T, 10.0),
        [("7", AgentKind.CAR, (4.5, 1.8), moving(3.0, 0.0, 0.0, 0.0, 0.0))],
        road=straight_road(limit=10.0),
    )
    assert parts(inside, along(T, 10.0))["collisions"] == 0.0
    behind = scenario(
        along(T, 10.0),
        [("7", AgentKind.CAR, (4.5, 1.8), moving(-20.0, 0.0, 14.0, 0.0, 0.0))],
        road=straight_road(limit=10.0),
    )
    found = parts(behind, along(T, 10.0))
    assert (found["collisions"], found["ttc"]) == (1.0, 1.0)


def test_a_finer_drive_has_the_parts_of_10_hz() -> None:
    world, fine = (
        scenario(along(T, 10.0), road=straight_road(limit=10.0)),
        along(grid(10.0, 0.01), 8.0),
    )
    assert parts(world, fine) == pytest.approx(parts(world, along(T, 8.0)), abs=1e-9)


@settings(max_examples=20)
@given(
    st.floats(-3.0, 3.0),
    st.floats(-50.0, 50.0),
    st.booleans(),
    st.floats(4.0, 14.0),
    st.floats(-1.0, 1.0),
)
def test_parts_do_not_change_with_the_world(
    turn: float, shift: float, mirror: bool, v: float, y: float
) -> None:
    world = scenario(
        along(T, 10.0),
        [("7", AgentKind.CAR, (4.5, 1.8), moving(30.0, 1.0, 6.0, 0.0, 0.0))],
        road=straight_road(limit=10.0, lanes=2),
    )
    ego = along(T, v)
    ego = replace(ego, y=ego.y + y)
    two = parts(
        moved(world, turn, shift, -shift, mirror=mirror),
        moved_ego(ego, turn, shift, -shift, mirror=mirror),
    )
    assert two == pytest.approx(parts(world, ego), abs=1e-6)


def test_the_humans_own_drive_is_whole() -> None:
    for name in BUILT_IN.values():
        found = parts(world := catalogue(name), world.ego)
        assert found["progress"] == found["making_progress"] == found["direction"] == 1.0
        assert np.isclose(found["speed_limit"], 1.0)
