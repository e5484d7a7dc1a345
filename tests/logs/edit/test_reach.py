"""Road users that are out of reach of the whole drive cost nothing, and are counted in a note."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from short_logs import short

from replan.logs.agents import AgentKind
from replan.logs.edit import reach
from replan.logs.edit.reach import REACH_M, within_reach
from replan.logs.scenario import Scenario
from replan.logs.tracks import Tracks


def parked(x: list[float], y: list[float]) -> Scenario:
    """A drive along x, and cars that stand at these places."""
    count = len(x)
    none = np.zeros(count)
    tracks = Tracks(
        tuple(f"car {k}" for k in range(count)),
        (AgentKind.CAR,) * count,
        none + 4.5,
        none + 1.8,
        np.zeros(count, np.bool_),
        np.arange(count + 1),
        none,
        np.array(x),
        np.array(y),
        none,
        none,
        none,
    )
    return replace(short("test/parked"), tracks=tracks)


@given(
    y=st.lists(st.floats(-3.0 * REACH_M, 3.0 * REACH_M), min_size=3, max_size=9),
)
def test_exactly_the_far_ones_of_many_are_left_out(y: list[float]) -> None:
    scenario = parked([0.0] * len(y), y)
    sides = scenario.ego.y.min() - REACH_M, scenario.ego.y.max() + REACH_M
    near = tuple(f"car {k}" for k, side in enumerate(y) if sides[0] <= side <= sides[1])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reach, "MANY", 2)
        left = within_reach(scenario)
    assert left.tracks.ids == near
    assert left.traffic_spans == scenario.traffic_spans
    count = len(y) - len(near)
    notes = [note for note in left.notes if f"{count} of {len(y)} road users are left out" in note]
    assert len(notes) == (count > 0)


def test_few_road_users_stay_wherever_they_are() -> None:
    scenario = parked([0.0, 1e5], [1e5, 0.0])
    assert within_reach(scenario) is scenario


def test_agents_that_pass_between_distant_samples_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """The box around a track counts, not its samples."""
    monkeypatch.setattr(reach, "MANY", 0)
    scenario = parked([0.0, 0.0], [-2e4, 2e4])
    tracks = replace(
        scenario.tracks,
        ids=("passes",),
        kinds=(AgentKind.CAR,),
        length=np.array([4.5]),
        width=np.array([1.8]),
        static=np.zeros(1, np.bool_),
        offsets=np.array([0, 2]),
        t=np.array([0.0, 1.0]),
    )
    assert within_reach(replace(scenario, tracks=tracks)).tracks.ids == ("passes",)
