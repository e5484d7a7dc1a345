"""Scenarios in other worlds: what changes, what must not, there and back, in the mirror."""

import json
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from functools import cache
from math import pi

import numpy as np
import pytest
from drives import drive
from handmade import track, tracks
from hypothesis import given, settings, strategies as st
from rich_scenario import repaired_scenario

from replan.logs.catalogue import CATALOGUE
from replan.logs.edit.transform import (
    jittered,
    mirrored,
    mirrored_trajectory,
    moved,
    moved_trajectory,
    rotated,
    sampled,
    shifted_clock,
)
from replan.logs.road import Goal, Lane, Road
from replan.logs.rules import Colour, Crosswalk, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import Controls, Trajectory
from replan.logs.tracks import Tracks
from replan.metrics import evaluate

FAMILIES = (
    "everyday/cut_in",
    "everyday/traffic_light",
    "everyday/crosswalk",
    "everyday/junction",
    "paper/free_road",
)
PLACES = ("left", "right", "points", "polygon", "regions")


@cache
def world(name: str) -> Scenario:
    """A family's log with a goal whose heading is bounded, controls and an origin, so that every
    field is filled.
    """
    log = CATALOGUE[name].scenario()
    regions = log.goal.regions if log.goal is not None else ()
    square = np.array([[90.0, -3.0], [99.0, -3.0], [99.0, 3.0]])
    zero = np.zeros(len(log.ego))
    return replace(
        log,
        goal=Goal.any_of(
            [
                Goal((*regions, square), t=(0.0, 99.0), v=(0.0, 60.0), yaw=(-0.4, 1.1)),
                Goal((square + 4.0,), t=(0.0, 9.0), v=(0.0, 0.0), yaw=(0.1, 0.2)),
            ]
        ),
        controls=Controls(log.ego.t, zero + 0.1, zero, zero),
        origin=(691_000.0, 5_336_000.0),
    )


def leaves(node: object, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], object]]:
    """Every value in a scenario with the names that lead to it."""
    if is_dataclass(node):
        for field in fields(node):
            yield from leaves(getattr(node, field.name), (*path, field.name))
    elif hasattr(node, "items"):
        for key, value in node.items():
            yield from leaves(value, (*path, str(key)))
    elif isinstance(node, tuple) and any(
        is_dataclass(each) or isinstance(each, np.ndarray) for each in node
    ):
        for i, value in enumerate(node):
            yield from leaves(value, (*path, str(i)))
    else:
        yield path, node


def same(one: Scenario, two: Scenario, within: float) -> None:
    first, second = dict(leaves(one)), dict(leaves(two))
    assert first.keys() == second.keys()
    for path, value in first.items():
        if isinstance(value, (np.ndarray, float)) or (
            path[-1] in ("origin", "yaw") and value is not None
        ):
            np.testing.assert_allclose(
                value, second[path], rtol=0.0, atol=within, err_msg=".".join(path)
            )
        else:
            assert value == second[path], path


@settings(max_examples=20)
@given(
    st.sampled_from(list(CATALOGUE)),
    st.floats(-7.0, 7.0),
    st.floats(-1e3, 1e3),
    st.floats(-1e3, 1e3),
)
def test_turned_there_and_back_is_the_identity(name: str, angle: float, x: float, y: float) -> None:
    log = replace(world(name), origin=(30.0, -40.0))
    same(rotated(rotated(log, angle, (x, y)), -angle, (x, y)), log, 1e-8)


@settings(max_examples=20)
@given(
    st.sampled_from(FAMILIES),
    st.floats(-7.0, 7.0),
    st.floats(-200.0, 200.0),
    st.floats(-200.0, 200.0),
)
def test_every_place_turns_and_nothing_else_changes(
    name: str, angle: float, x: float, y: float
) -> None:
    log, turn = (
        world(name),
        np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]),
    )
    here, there, about = (
        dict(leaves(log)),
        dict(leaves(rotated(log, angle, (x, y)))),
        np.array([[x], [y]]),
    )
    for path, value in here.items():
        *parents, leaf = path
        if leaf in PLACES or PLACES[-1] in parents:
            expected = (turn @ (value.T - about) + about).T
        elif leaf == "origin":
            expected = turn @ value
        elif leaf in ("x", "y"):
            expected = (
                turn @ (np.array([here[*parents, "x"], here[*parents, "y"]]) - about) + about
            )["xy".index(leaf)]
        elif leaf in ("vx", "vy"):
            expected = (turn @ np.array([here[*parents, "vx"], here[*parents, "vy"]]))[
                ("vx", "vy").index(leaf)
            ]
        elif leaf == "yaw":
            expected = np.asarray(value) + angle
        else:
            np.testing.assert_array_equal(there[path], value, err_msg=".".join(path))
            continue
        np.testing.assert_allclose(
            there[path], expected, rtol=1e-12, atol=1e-9, err_msg=".".join(path)
        )


@pytest.mark.parametrize("name", CATALOGUE)
def test_mirroring_twice_is_the_identity(name: str) -> None:
    scenario = CATALOGUE[name].scenario()
    same(mirrored(mirrored(scenario)), scenario, 0.0)


def crooked() -> Scenario:
    """A scenario with everything that has a side: neighbours, opposite lanes, markings, steering,
    goal, rules.
    """
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 3.0], [0.0, 3.0]])
    lane = Lane(
        1,
        square[[3, 2]],
        square[[0, 1]],
        left_neighbour=2,
        left_opposite=True,
        left_crossable=False,
        right_crossable=True,
        yields_to=(2, 3),
    )
    stop = StopLine(4, 1, np.array([[9.0, 0.0], [9.0, 3.0]]), light=6, towards=(3,))
    zebra = Crosswalk(5, square)
    lights = (TrafficLight(6, np.array([0.0, 1.5]), (Colour.RED, Colour.GREEN)),)
    t = np.array([0.0, 1.0])
    ego = Trajectory(t, [1.0, 2.0], [1.0, 1.5], [0.3, 0.4], [1.0, 1.0], [0.0, 0.1], [0.1, 0.2])
    controls = Controls(t, [0.1, -0.2], [0.3, 0.0], [0.0, 0.5])
    goal = Goal((square,), t=(0.0, 1.0), v=(0.0, 2.0), yaw=(-0.2, 0.5))
    decisions = json.dumps({"a": ["nudge left"], "b": ["nudge right", "follow"]})
    road, metadata = (
        Road({1: lane}, stop_lines=(stop,), crosswalks=(zebra,)),
        {"expected_decisions": decisions},
    )
    return Scenario(
        "x/y",
        ego,
        Tracks.empty(),
        road,
        2.0,
        goal,
        lights=lights,
        controls=controls,
        origin=(3.0, 4.0),
        metadata=metadata,
    )


def test_the_mirror_swaps_every_side() -> None:
    there = mirrored(crooked())
    lane = there.road.lanes[1]
    np.testing.assert_array_equal(lane.left, [[0.0, 0.0], [10.0, 0.0]])
    np.testing.assert_array_equal(lane.right, [[0.0, -3.0], [10.0, -3.0]])
    assert (lane.left_neighbour, lane.right_neighbour) == (None, 2)
    assert lane.yields_to == (2, 3)
    (stop,), (zebra,) = there.road.stop_lines, there.road.crosswalks
    # From right to left, as before
    np.testing.assert_array_equal(stop.points, [[9.0, -3.0], [9.0, 0.0]])
    assert (stop.lane, stop.light, stop.towards) == (1, 6, (3,))
    assert {*map(tuple, zebra.polygon)} == {(0.0, 0.0), (10.0, 0.0), (10.0, -3.0), (0.0, -3.0)}
    assert [(light.id, light.colours) for light in there.lights] == [
        (6, (Colour.RED, Colour.GREEN))
    ]
    assert (lane.left_opposite, lane.right_opposite) == (False, True)
    assert (lane.left_crossable, lane.right_crossable) == (True, False)
    assert not there.road.drives_on_right
    assert there.controls is not None
    np.testing.assert_array_equal(there.controls.steer, [-0.1, 0.2])
    np.testing.assert_array_equal(there.ego.kappa, [-0.1, -0.2])
    assert json.loads(there.metadata["expected_decisions"]) == {
        "a": ["nudge right"],
        "b": ["nudge left", "follow"],
    }
    back = mirrored(there)
    same(crooked(), back, 0.0)
    assert back.road.lanes[1].left_neighbour == 2
    assert back.origin == (3.0, 4.0)


@settings(max_examples=30)
@given(x=st.floats(0.1, 9.9), y=st.floats(-5.0, 5.0), yaw=st.floats(-pi, pi), v=st.floats(0.0, 3.0))
def test_goals_are_reached_in_the_mirror_and_after_a_motion_alike(
    x: float, y: float, yaw: float, v: float
) -> None:
    here = crooked()
    assert here.goal is not None
    if min(abs(y), abs(y - 3.0), abs(yaw + 0.2), abs(yaw - 0.5)) < 1e-6:
        return  # on the edge rounding decides
    reached = here.goal.reached(0.5, x, y, yaw, v)
    glass = mirrored(here).goal
    assert glass is not None
    assert glass.reached(0.5, x, -y, -yaw, v) is reached
    turned = moved(here, 5.0, -7.0, 2.0).goal
    assert turned is not None
    c, s = np.cos(2.0), np.sin(2.0)
    assert turned.reached(0.5, c * x - s * y + 5.0, s * x + c * y - 7.0, yaw + 2.0, v) is reached


def test_detections_and_what_was_removed_go_with_the_tracks() -> None:
    scenario = repaired_scenario()
    for there in (
        mirrored(mirrored(scenario)),
        moved(moved(scenario, 0.0, 0.0, 0.5 * np.pi), 0.0, 0.0, -0.5 * np.pi),
    ):
        assert (
            there.repair is not None
            and there.repair.tracks is there.tracks
            and scenario.repair is not None
        )
        for one, two in (
            (there.repair.detections, scenario.repair.detections),
            (there.repair.removed, scenario.repair.removed),
        ):
            for name in ("x", "y", "yaw", "vx"):
                np.testing.assert_allclose(getattr(one, name), getattr(two, name), atol=1e-9)
    once = moved(scenario, 3.0, 0.0, 0.0).repair
    assert once is not None and once.detections.x == pytest.approx(
        scenario.repair.detections.x + 3.0
    )


def test_the_clock_alone_is_set() -> None:
    log = world("everyday/traffic_light")
    later = shifted_clock(log, 5_000_000_007)
    assert later.start_ns == log.start_ns + 5_000_000_007
    same(shifted_clock(later, -5_000_000_007), log, 0.0)
    changed = {
        path for (path, a), (_, b) in zip(leaves(log), leaves(later), strict=True) if a is not b
    }
    assert changed == {("start_ns",)}


@pytest.mark.parametrize("name", FAMILIES)
def test_errors_are_as_large_as_asked_seeded_and_everywhere(name: str) -> None:
    log = world(name)
    near, again, other = jittered(log, 1e-9), jittered(log, 1e-9), jittered(log, 1e-9, seed=1)
    same(near, log, 2.1e-9)
    same(near, again, 0.0)
    for path, value in leaves(log):
        measured = (
            path[-1] in (*PLACES, "x", "y", "yaw", "vx", "vy")
            or PLACES[-1] in path
            or path[0] == "ego"
        )
        if measured and isinstance(value, np.ndarray) and path[-1] != "t":
            here = dict(leaves(near))[path]
            assert value.size == 0 or (
                np.max(here != value) and np.max(here != dict(leaves(other))[path])
            ), path


@pytest.mark.parametrize("name", FAMILIES)
@pytest.mark.parametrize("mirror", [False, True])
def test_metrics_of_a_drive_do_not_change(name: str, mirror: bool) -> None:
    log = world(name)
    there = moved(mirrored(log) if mirror else log, 30.0, -20.0, 0.7)
    ego = moved_trajectory(mirrored_trajectory(log.ego) if mirror else log.ego, 30.0, -20.0, 0.7)
    one, two = evaluate(drive(log), log), evaluate(drive(there, ego), there)
    assert (
        one.metric.tolist() == two.metric.tolist()
        and one.available.tolist() == two.available.tolist()
    )
    np.testing.assert_allclose(two.value, one.value, rtol=1e-6, atol=1e-6, equal_nan=True)
    assert one.available.sum() > 10


@given(st.floats(-pi, pi))
def test_a_trajectory_moves_as_its_scenario(angle: float) -> None:
    log = world("everyday/cut_in")
    one, two = moved(log, 3.0, 4.0, angle).ego, moved_trajectory(log.ego, 3.0, 4.0, angle)
    for name in ("x", "y", "yaw", "v", "kappa"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_a_log_at_another_rate_keeps_its_curves_and_its_gaps() -> None:
    t = np.r_[np.arange(0.0, 2.05, 0.1), np.arange(4.0, 6.05, 0.1)]
    road_user = tracks(track("a", list(t), list(3.0 * t + 0.5 * t**2), list(0.0 * t)))
    log = replace(CATALOGUE["paper/free_road"].scenario(), tracks=road_user)
    for rate in (5.0, 10.0, 20.0):
        found = sampled(log, rate).tracks
        assert np.median(np.diff(found.t)) == pytest.approx(1.0 / rate)
        assert not ((found.t > 2.001) & (found.t < 3.999)).any()
        np.testing.assert_allclose(found.x, 3.0 * found.t + 0.5 * found.t**2, atol=0.005)
