"""Where two planners part: the first frame at which their speeds or places differ by more than stated."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from logs.catalogue import scenario
from logs.trace import Mode, Trace
from replay.explain.first_difference import AHEAD_S, PARTED_M, PARTED_MPS, planners_part
from replay.loop.closed_loop import run_closed_loop
from replay.loop.open_loop import run_open_loop

LOOPS = {Mode.CLOSED: run_closed_loop, Mode.OPEN: run_open_loop}


@cache
def drive(mode: Mode, planner: str = "idm") -> Trace:
    return LOOPS[mode](scenario("everyday/nudge"), planner, keep_internals=True).trace


@pytest.mark.parametrize("mode", LOOPS)
def test_a_drive_does_not_part_from_itself(mode: Mode) -> None:
    assert planners_part(drive(mode), drive(mode)) is None


@given(st.integers(1, 100), st.floats(-3.0, 3.0), st.floats(-1.5, 1.5))
def test_the_first_frame_beyond_a_bound_is_found(k: int, faster: float, aside: float) -> None:
    one = drive(Mode.CLOSED)
    ego, since = one.ego, one.ego.t >= one.frames[k].t - 1e-9
    moved = replace(
        ego, v=ego.v + faster * since, x=ego.x - aside * np.sin(ego.yaw) * since,
        y=ego.y + aside * np.cos(ego.yaw) * since,
    )  # fmt: skip
    found = planners_part(one, replace(one, ego=moved))
    if abs(faster) > PARTED_MPS + 1e-6 or abs(aside) > PARTED_M + 1e-6:
        assert found is not None and found.t == one.frames[k].t
        assert ("to the left" in found.what) == (aside > PARTED_M + 1e-6) or abs(abs(aside) - PARTED_M) < 1e-5
    elif abs(faster) < PARTED_MPS - 1e-6 and abs(aside) < PARTED_M - 1e-6:
        assert found is None


@pytest.mark.parametrize("mode", LOOPS)
def test_what_each_planner_decides_there_is_said(mode: Mode) -> None:
    found = planners_part(drive(mode), drive(mode, "dp_qp"))
    assert found is not None and "(stop parked) -> " in found.what and "(nudge left parked)" in found.what
    assert (f"in {AHEAD_S:g} s" in found.what) == (mode is Mode.OPEN)
