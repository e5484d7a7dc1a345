"""Who goes first without a map: order and gap against the recorded driver, box by box."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, moved, moved_ego
from handmade import crossing_without_a_map, track, tracks
from hypothesis import given, settings
from hypothesis import strategies as st

from logs import AgentKind, Scenario, Trajectory
from metrics import METRICS, evaluate

HALF, NOSE, TAIL = 0.805 + 0.25, 3.608, 0.9
TIMES = np.arange(0.0, 15.05, 0.1)


def judged(log: Scenario, ego: Trajectory) -> pd.DataFrame:
    return evaluate(drive(log, ego), log, metrics={"yielding": METRICS["yielding"]}).set_index("metric")


def after(gap: float) -> Trajectory:
    """A drive at 12 m/s whose tail leaves the pedestrian's way `gap` s before the pedestrian takes it."""
    taken = 6.3 - HALF / 1.4
    return along(TIMES, 12.0, x=60.25 + TAIL - 12.0 * (taken - gap))


@settings(max_examples=25, deadline=None)
@given(st.floats(0.3, 2.6))
def test_the_gap_is_the_time_until_the_pedestrian_takes_the_place(gap: float) -> None:
    table = judged(crossing_without_a_map(), after(gap))
    for part, bound in (("recorded", 1.5), ("pedestrian", 1.0)):
        found = table.value[f"yielding.{part}.min"]
        assert found == pytest.approx(gap, abs=0.06)
        name = {1.5: "below_1500ms", 1.0: "below_1s"}[bound]
        assert (table.value[f"yielding.{part}.{name}"] > 0.0) == (found < bound - 1e-6)


def test_the_recorded_driver_and_who_is_far_ahead_take_nothing() -> None:
    log = crossing_without_a_map()
    for ego in (log.ego, after(4.0)):
        table = judged(log, ego)
        assert not table.available["yielding.recorded.min"]
        assert table.value["yielding.recorded.below_1500ms"] == 0.0


def test_it_is_asked_only_where_someone_was_let_go_first() -> None:
    log = crossing_without_a_map()
    alone = replace(log, tracks=tracks())
    assert judged(alone, after(1.0)).reason["yielding.recorded.below_1500ms"].startswith("the recorded driver let no")
    made = replace(log, tags=("synthetic",))
    assert judged(made, after(1.0)).reason["yielding.recorded.below_1500ms"] == "the log has no recorded driver"


def test_a_track_that_changes_its_id_counts_as_one_and_a_flicker_does_not() -> None:
    log = crossing_without_a_map()
    t, y = log.tracks.t, log.tracks.y
    pieces = np.array_split(np.arange(len(t)), len(t) // 4)
    walker = {"kind": AgentKind.PEDESTRIAN, "length": 0.5, "width": 0.5, "yaw": np.pi / 2.0, "vx": 0.0, "vy": 1.4}
    flickers = tracks(*(track(f"p{k}", t[i], 0.0 * t[i] + 60.0, y[i], **walker) for k, i in enumerate(pieces)))
    whole, parts = judged(log, after(1.1)), judged(replace(log, tracks=flickers), after(1.1))
    assert parts.value["yielding.recorded.min"] == pytest.approx(whole.value["yielding.recorded.min"], abs=0.21)
    assert parts.value["yielding.recorded.below_1500ms"] > 0.0
    at = np.flatnonzero(np.abs(t - 6.0) < 0.15)
    ghost = tracks(track("g", t[at], 0.0 * t[at] + 60.0, 0.0 * t[at], **walker))
    assert not (judged(replace(log, tracks=ghost), after(1.0)).value > 0.0).any()


@settings(max_examples=10, deadline=None)
@given(st.floats(-3.0, 3.0), st.booleans())
def test_the_verdict_does_not_depend_on_where_the_world_lies(turn: float, mirror: bool) -> None:
    log, ego = crossing_without_a_map(), after(1.2)
    here = judged(log, ego)
    there = judged(moved(log, turn, 3.0, -7.0, mirror=mirror), moved_ego(ego, turn, 3.0, -7.0, mirror=mirror))
    np.testing.assert_allclose(here.value.to_numpy(), there.value.to_numpy(), atol=1e-6)
