"""Where a drive ends does not depend on how many rows are looked at at once, and is what Goal and
contact say.
"""

from dataclasses import replace

import numpy as np
from handmade import drive, lanes_along, scenario, square, straight, track, tracks
from hypothesis import given, settings, strategies as st

from replan.logs.road import Goal
from replan.logs.trace import EndReason
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.contacts import contact
from replan.replay.loop.termination import Ended, Termination
from replan.replay.loop_config import LoopConfig
from replan.replay.vehicle.state_records import STEP, Records, state_at
from replan.replay.world import World, box_center

WAY = drive(straight, 10.0, 6.0)
N = 300
CAR_AHEAD = tracks(track("1", np.arange(0.0, 6.1, 0.5), np.full(13, 45.0), np.full(13, 1.0)))
LOG = replace(scenario(WAY, agents=CAR_AHEAD), road=lanes_along(WAY))
GOAL = Goal.any_of(
    [Goal((square(35.0, 0.0, 3.0),), v=(0.0, 8.0)), Goal((square(20.0, 0.0, 3.0),), v=(0.0, 0.0))]
)


def rows_of(slope: float, v: float) -> Records:
    """A straight drive that leaves the lane's direction by `slope` rad."""
    rows, s = np.zeros(N, STEP), v * 0.02 * np.arange(N)
    ego = rows["ego"]
    ego["t"], ego["x"], ego["y"] = 0.02 * np.arange(N), s * np.cos(slope), s * np.sin(slope)
    ego["yaw"], ego["v"] = slope, v
    return rows


def found_in(rows: Records, cuts: list[int]) -> Ended | None:
    termination = Termination(LOG, GOAL, state_at(rows, 0))
    ends = (
        termination.first(rows, a, b, LOG.tracks)
        for a, b in zip([1, *cuts], [*cuts, N], strict=True)
    )
    return next((end for end in ends if end), None)


@settings(max_examples=60)
@given(
    st.floats(-0.15, 0.15),
    st.sampled_from([6.0, 9.0, 14.0]),
    st.lists(st.integers(2, N - 1), max_size=20, unique=True).map(sorted),
)
def test_the_end_is_that_of_the_first_row_that_ends(
    slope: float, v: float, cuts: list[int]
) -> None:
    rows, car = rows_of(slope, v), LOG.vehicle
    end = found_in(rows, cuts)
    assert end == found_in(rows, list(range(2, N)))
    last = N if end is None else end.row
    for k in range(1, last):
        state = state_at(rows, k)
        x, y = box_center(state, car)
        assert contact(World(state, LOG.tracks), car) == -1
        assert not GOAL.reached(state.t, x, y, state.yaw, state.v)
    if end is not None and end.reason is EndReason.GOAL:
        state = state_at(rows, end.row)
        assert GOAL.reached(state.t, *box_center(state, car), state.yaw, state.v)
    elif end is not None and end.reason is not EndReason.OFF_ROAD:
        assert contact(World(state_at(rows, end.row), LOG.tracks), car) == 0


def test_all_ends_occur() -> None:
    reasons = {
        end.reason
        for end in (found_in(rows_of(a, v), []) for a in (0.0, -0.12, 0.09) for v in (6.0, 14.0))
        if end
    }
    assert {EndReason.GOAL, EndReason.OFF_ROAD, EndReason.COLLISION} <= reasons


def test_a_drive_may_go_on_to_the_end_of_the_logs_drive() -> None:
    """Into a wall and through it, past the goal, and no further than the log's driver, though the
    log lasts longer.
    """
    wall = tracks(track("wall", [0.0], [30.0], [0.0], static=True))
    log = replace(
        scenario(WAY, agents=wall, road=lanes_along(WAY)),
        goal=Goal((square(40.0, 0.0, 3.0),)),
        duration=9.0,
    )
    short = run_closed_loop(log, "constant_speed").trace
    assert short.end is EndReason.COLLISION
    whole = run_closed_loop(log, "constant_speed", config=LoopConfig(drives_on=True)).trace
    assert whole.end is EndReason.END_OF_LOG
    assert whole.ego.t[-1] == WAY.t[-1]
    assert whole.ego.x[-1] > 45.0
    steps = len(short.ego)
    assert (whole.ego.x[:steps] == short.ego.x).all()
