"""Boxes on a grid in pieces or agent by agent, and phantoms: boxes in which the recorded ego
stands.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from handmade import drive, scenario, straight, track, tracks

from replan import metrics
from replan.logs import catalogue
from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState
from replan.metrics import boxes
from replan.metrics.boxes import AROUND_S, each, others_at, phantoms, pieces, without_phantoms
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.contacts import contact
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.world import World

LOGS = ("everyday/junction", "everyday/crosswalk", "pedestrian/group", "everyday/cyclist")
SIZES = ((40, 7), (1, 1), (900, 250))
CASES = [
    pytest.param(name, *size, marks=[pytest.mark.slow] * (i != k or i > 1))
    for i, name in enumerate(LOGS)
    for k, size in enumerate(SIZES)
]


@pytest.mark.parametrize(("name", "cells", "steps"), CASES)
def test_the_size_of_pieces_changes_no_bit(
    monkeypatch: pytest.MonkeyPatch, name: str, cells: int, steps: int
) -> None:
    world = catalogue.scenario(name)
    drives = [loop(world, "constant_speed").trace for loop in (run_open_loop, run_closed_loop)]
    whole = [metrics.evaluate_with_series(trace, world) for trace in drives]
    monkeypatch.setattr(boxes, "MOST_CELLS", cells)
    monkeypatch.setattr(boxes, "PIECE_STEPS", steps)
    monkeypatch.setattr("replan.metrics.proposals.PIECE", steps)
    for trace, (table, series) in zip(drives, whole, strict=True):
        again = catalogue.scenario(name)  # the caches of the first know what was measured at once
        table_again, series_again = metrics.evaluate_with_series(trace, again)
        pd.testing.assert_frame_equal(table, table_again, check_exact=True)
        pd.testing.assert_frame_equal(series, series_again, check_exact=True)


def test_a_piece_holds_the_agents_present(monkeypatch: pytest.MonkeyPatch) -> None:
    tracks, t = catalogue.scenario("everyday/junction").tracks, np.arange(0.0, 30.0, 0.1)
    whole = others_at(tracks, t)
    monkeypatch.setattr(boxes, "MOST_CELLS", 100)
    seen = np.zeros_like(whole.there)
    for steps, agents, some in pieces(tracks, t):
        assert some.there.size <= 100 and some.there.shape == (
            len(agents),
            steps.stop - steps.start,
        )
        np.testing.assert_array_equal(some.pose, whole.pose[:, agents, steps])
        seen[agents, steps] = some.there
    np.testing.assert_array_equal(seen, whole.there)
    for i, some, row in each(tracks, t):
        np.testing.assert_array_equal(some.accel[row], whole.accel[i])


EGO = drive(straight, 10.0, 12.0)
T = np.round(np.arange(0.0, 12.05, 0.1), 9)
CENTRE = scenario(EGO).vehicle.axle_to_center
LENGTH = scenario(EGO).vehicle.length


def log(*agents: dict[str, object], **changes: object) -> Scenario:
    return replace(scenario(EGO, agents=tracks(*agents)), **({"metadata": {}} | changes))


def jumping(begin: float, end: float) -> dict[str, object]:
    """A box 30 m beside the ego, which is on it from `begin` to `end`."""
    beside = np.where((begin - 1e-9 <= T) & (end + 1e-9 >= T), 0.0, 30.0)
    return track("7", T, 10.0 * T + CENTRE, beside)


def test_a_box_on_the_recorded_ego_is_named_and_left_out_with_a_margin() -> None:
    made = log(jumping(5.0, 6.0), track("8", T, 10.0 * T + 20.0, 0.0 * T))
    (found,) = phantoms(made)
    assert (found.agent, found.name) == ("7", "car 7")
    # It slides onto the ego within the sample before
    assert found.t_from == pytest.approx(5.0 - AROUND_S, abs=0.11)
    assert found.t_to == pytest.approx(6.0 + AROUND_S, abs=0.11)
    left = without_phantoms(made.tracks, (found,))
    for t in T:
        gone = found.t_from < t < found.t_to
        assert left.truth(t).ids == (("8",) if gone else ("7", "8"))
        world = World(EgoState(t, 10.0 * t, 0.0, 0.0, 10.0), made.tracks)
        assert (contact(world, made.vehicle) == 0) == (5.0 - 1e-9 <= t <= 6.0 + 1e-9)
        assert (
            contact(world, made.vehicle, (found,))
            == contact(replace(world, tracks=left), made.vehicle)
            == -1
        )
    assert not others_at(left, T).there[0].all() and others_at(left, T).there[1].all()


def test_contacts_at_another_time_and_of_others_still_count() -> None:
    made = log(jumping(5.0, 6.0), track("8", T, 0.0 * T + 105.0 + CENTRE, 0.0 * T))
    found = phantoms(made)
    world = World(EgoState(9.0, 90.0, 30.0, 0.0, 10.0), made.tracks)
    assert contact(world, made.vehicle, found) == 0, "the box beside is no phantom at 9 s"
    assert [one.agent for one in found] == ["7", "8"]


def test_a_box_at_the_start_and_a_static_one() -> None:
    (first,) = phantoms(log(jumping(0.0, 0.2)))
    assert first.t_from == -np.inf and first.t_to < 1.5
    made = log(track("cone", [0.0], [60.0], [0.0], static=True, kind=AgentKind.OBJECT))
    (cone,) = phantoms(made)
    assert (cone.t_from, cone.t_to) == (-np.inf, np.inf)
    assert len(without_phantoms(made.tracks, (cone,))) == 0


def test_only_overlaps_in_recorded_logs_are_phantoms() -> None:
    box = jumping(5.0, 6.0)
    assert (
        phantoms(log(box, tags=("synthetic",)))
        == phantoms(log(box, metadata={"generator": "x"}))
        == ()
    )
    made = log(track("8", T, 10.0 * T + CENTRE + LENGTH + 1.0, 0.0 * T))
    assert phantoms(made) == ()
    assert without_phantoms(made.tracks, ()) is made.tracks
    for family in catalogue.CATALOGUE.values():
        assert not family.scenario().is_recorded


@pytest.mark.parametrize(
    ("changes", "recorded"),
    [
        ({}, True),
        ({"tags": ("commonroad", "recorded")}, True),
        ({"tags": ("commonroad",)}, False),
        ({"tags": ("osi",)}, True),
        ({"tags": ("recorded", "synthetic")}, False),
        ({"ego": EGO.between(0.0, 0.0)}, False),
        ({"tags": ("recorded",), "ego": EGO.between(0.0, 0.0)}, True),
    ],
)
def test_logs_that_count_as_recorded(changes: dict[str, object], recorded: bool) -> None:
    assert log(**changes).is_recorded is recorded
