"""Occupancy sets: boxes that cover them from outside, closely, and stand as long as their set
does.
"""

from math import pi
from pathlib import Path

import numpy as np
import pytest
from commonroad_files import RECTANGLE, points, problem, state, straight, written
from hypothesis import given, strategies as st

from replan.logs.agents import AgentKind
from replan.logs.polylines import inside
from replan.logs.readers.commonroad import read_commonroad
from replan.logs.readers.commonroad.document_records import OccupiedSet
from replan.logs.readers.commonroad.occupancy_sets import (
    DEEPEST,
    EXCESS_M,
    SHORTEST_M,
    Box,
    covering,
    smallest_box,
    standing,
)
from replan.replay.loop.closed_loop import run_closed_loop


def within(box: Box, p: np.ndarray) -> np.ndarray:
    d = p - (box.x, box.y)
    along = d @ (np.cos(box.yaw), np.sin(box.yaw))
    aside = d @ (-np.sin(box.yaw), np.cos(box.yaw))
    return (np.abs(along) <= 0.5 * box.length + 1e-6) & (np.abs(aside) <= 0.5 * box.width + 1e-6)


def band(radius: float, angle: float, width: float) -> np.ndarray:
    """A piece of a lane on a circle."""
    turn = np.linspace(0.0, angle, 30)
    ring = np.column_stack([np.sin(turn), 1.0 - np.cos(turn)])
    return np.vstack([ring * radius, (ring * (radius + width) - (0.0, width))[::-1]])


@given(st.floats(10.0, 200.0), st.floats(0.1, 1.5), st.floats(1.5, 8.0), st.floats(-pi, pi))
def test_the_boxes_cover_the_set_and_little_else(
    radius: float, angle: float, width: float, yaw: float
) -> None:
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    outline = band(radius, angle, width) @ turn
    boxes = list(covering(outline))
    low, high = outline.min(axis=0), outline.max(axis=0)
    some = low + (high - low) * np.random.default_rng(0).uniform(size=(300, 2))
    held = np.array([inside(*p, outline) for p in some.tolist()])
    covered = np.any([within(box, some) for box in boxes], axis=0)
    assert covered[held].all() and len(boxes) <= 2**DEEPEST
    boxes = list(covering(outline, cuts=20))  # without the limit, which leaves wide boxes
    area = 0.5 * ((radius + width) ** 2 - radius**2) * angle
    wider = sum(
        EXCESS_M * box.length if box.length > SHORTEST_M else box.length * box.width
        for box in boxes
    )
    assert sum(box.length * box.width for box in boxes) <= area + wider + 1e-6


@given(st.floats(-50.0, 50.0), st.floats(-pi, pi), st.floats(2.0, 20.0), st.floats(0.5, 1.9))
def test_a_rectangle_is_itself(x: float, yaw: float, length: float, width: float) -> None:
    c, s = np.cos(yaw), np.sin(yaw)
    half = 0.5 * np.array([[length, width], [-length, width], [-length, -width], [length, -width]])
    corners = half @ np.array([[c, s], [-s, c]]) + (x, 3.0)
    (box,) = covering(corners)
    assert (box.length, box.width, box.x, box.y) == pytest.approx((length, width, x, 3.0), abs=1e-6)
    assert abs(np.sin(box.yaw - yaw)) < 1e-6
    assert smallest_box(corners) == box


def test_a_set_stands_until_the_next_one_or_over_its_interval() -> None:
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    sets = [
        OccupiedSet(0.0, 0.0, (square,)),
        OccupiedSet(3.0, 3.0, (square, square + 9.0)),
        OccupiedSet(5.0, 9.0, ()),
    ]
    assert [(name, first, last) for name, first, last, _ in standing(sets)] == [
        ("set 0 part 0", 0.0, 3.0),
        ("set 1 part 0", 3.0, 5.0),
        ("set 1 part 1", 3.0, 5.0),
    ]


def occupancy(step: int, low: float, high: float) -> str:
    outline = points((low, -1.0), (high, -1.0), (high, 1.0), (low, 1.0), (low, -1.0))
    return f"<occupancy><shape><polygon>{outline}</polygon></shape><time><exact>{step}</exact></time></occupancy>"  # noqa: E501


def test_a_set_that_grows_over_the_way_is_met_at_its_time(tmp_path: Path) -> None:
    """From 60 m ahead it reaches back to 20 m at 1.5 s, when the ego's front, at 10 m/s, is there
    already.
    """
    sets = "".join(occupancy(k, 60.0 if k < 15 else 15.0, 64.0) for k in range(1, 30))
    first = state(0, 62.0, 0.0, 0.0, 0.0, tag="initialState")
    other = (
        f'<dynamicObstacle id="7"><type>car</type><shape>{RECTANGLE}</shape>{first}'
        f"<occupancySet>{sets}</occupancySet></dynamicObstacle>"
    )
    log = read_commonroad(written(tmp_path, straight(1), other, problem(1, 0.0, 0.0, 10.0)))
    assert set(log.tracks.kinds) == {AgentKind.OBJECT}
    assert log.traffic_spans == ((0.0, pytest.approx(3.0)),)
    before, after = log.tracks.truth(1.45), log.tracks.truth(1.55)
    assert (before.x - 0.5 * before.length).min() + log.origin[0] == pytest.approx(60.0)
    assert (after.x - 0.5 * after.length).min() + log.origin[0] == pytest.approx(15.0)
    trace = run_closed_loop(log, "constant_speed").trace
    assert trace.ego.t[-1] == pytest.approx(1.5, abs=0.011) and "object 7 set 15" in trace.detail
