"""Boxes in which the recorded ego stands: found, left out for a while, and only in recorded logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from handmade import drive, scenario, straight, track, tracks

from logs import AgentKind, Scenario
from logs.catalogue import CATALOGUE
from logs.observed import MAX_GAP_S
from logs.states import EgoState
from metrics.others import others_at
from metrics.phantoms import AROUND_S, phantoms, without_phantoms
from replay.world import World, contact

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
    assert found.t_from == pytest.approx(5.0 - AROUND_S, abs=0.11)  # it slides onto the ego within the sample before
    assert found.t_to == pytest.approx(6.0 + AROUND_S, abs=0.11)
    left = without_phantoms(made.tracks, (found,))
    for t in T:
        gone = found.t_from < t < found.t_to
        assert left.truth(t).ids == (("8",) if gone else ("7", "8"))
        world = World(EgoState(t, 10.0 * t, 0.0, 0.0, 10.0), made.tracks)
        assert (contact(world, made.vehicle) == 0) == (5.0 - 1e-9 <= t <= 6.0 + 1e-9)
        assert contact(world, made.vehicle, (found,)) == contact(replace(world, tracks=left), made.vehicle) == -1
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


def test_runs_that_are_close_are_one() -> None:
    box = track("7", T, 10.0 * T + CENTRE, np.where((np.abs(T - 4.0) < 0.3) | (np.abs(T - 5.5) < 0.3), 0.0, 30.0))
    assert len(phantoms(log(box))) == 1
    far = track("7", T, 10.0 * T + CENTRE, np.where((np.abs(T - 3.0) < 0.3) | (np.abs(T - 8.5) < 0.3), 0.0, 30.0))
    assert len(phantoms(log(far))) == 2


def test_nothing_is_excused_in_a_log_that_was_made_nor_where_nobody_stands() -> None:
    box = jumping(5.0, 6.0)
    assert phantoms(log(box, tags=("synthetic",))) == phantoms(log(box, metadata={"generator": "x"})) == ()
    made = log(track("8", T, 10.0 * T + CENTRE + LENGTH + 1.0, 0.0 * T))
    assert phantoms(made) == ()
    assert without_phantoms(made.tracks, ()) is made.tracks
    for family in CATALOGUE.values():
        assert not family.scenario().is_recorded


@pytest.mark.parametrize(
    ("changes", "recorded"),
    [
        ({}, True), ({"tags": ("commonroad", "recorded")}, True), ({"tags": ("commonroad",)}, False),
        ({"tags": ("osi",)}, True), ({"tags": ("recorded", "synthetic")}, False),
        ({"ego": EGO.between(0.0, 0.0)}, False), ({"tags": ("recorded",), "ego": EGO.between(0.0, 0.0)}, True),
    ],
)  # fmt: skip
def test_what_counts_as_recorded(changes: dict[str, object], recorded: bool) -> None:
    assert log(**changes).is_recorded is recorded


def test_what_is_left_out_is_a_gap_of_any_track() -> None:
    assert 2.0 * AROUND_S > MAX_GAP_S
