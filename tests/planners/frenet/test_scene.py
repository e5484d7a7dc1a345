"""The scene: its columns are what geometry says, and turn and mirror with the world."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from roads import curve, lanes
from scenes import CAR, Other, reference, scene

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.states import EgoState, wrapped
from replan.planners.frenet.reference_path import ReferencePath
from replan.planners.frenet.scene import STANDING_MPS, Scene, behind

POINTS = curve((60.0, 0.0), (60.0, 1.0 / 40.0), (40.0, -1.0 / 60.0), (60.0, 0.0))
KINDS = st.sampled_from([AgentKind.CAR, AgentKind.PEDESTRIAN, AgentKind.BICYCLE, AgentKind.OBJECT])
ROWS = st.lists(
    st.tuples(
        st.floats(10.0, 180.0),
        st.floats(-8.0, 8.0),
        st.floats(-3.0, 3.0),
        st.floats(-12.0, 12.0),
        KINDS,
    ),
    min_size=1,
    max_size=5,
)


def turned(angle: float) -> FloatArray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


MIRROR = np.array([[1.0, 0.0], [0.0, -1.0]])
COURSE = reference(lanes(POINTS, 2), ego=EgoState(0.0, 5.0, 0.0, 0.0, 8.0))


FINE = np.array([COURSE.line.point(s, 0.0) for s in np.arange(0.0, COURSE.line.length, 0.1)]).T


def world(
    rows: list[tuple[float, float, float, float, AgentKind]], by: FloatArray, course: ReferencePath
) -> Scene:
    """Agents at (s, l, turn, speed) of the first course, all of it multiplied by a matrix, along
    another course.
    """
    others = [placed(f"it{i}", *row, by) for i, row in enumerate(rows)]
    x, y, yaw, *_ = placed("ego", 20.0, 0.3, 0.05, 8.0, AgentKind.CAR, by).at(0.0)
    return scene(course, EgoState(0.0, x, y, yaw, 8.0), others)


def placed(
    name: str, s: float, l: float, turn: float, v: float, kind: AgentKind, by: FloatArray
) -> Other:
    yaw = COURSE.line.frame(s)[2] + turn
    (x, y), (vx, vy) = by @ COURSE.line.point(s, l), by @ (v * np.cos(yaw), v * np.sin(yaw))
    yaw = np.arctan2(by[1, 0], by[0, 0]) + np.sign(np.linalg.det(by)) * yaw
    state = float(x), float(y), float(yaw), float(vx), float(vy)
    return Other(name, lambda t: state, kind)


@given(ROWS)
@settings(max_examples=40)
def test_the_columns_agree_with_geometry(
    rows: list[tuple[float, float, float, float, AgentKind]],
) -> None:
    """Foot points are the nearest of a fine polyline; the rest is trigonometry at the foot."""
    now, (x, y) = world(rows, np.eye(2), COURSE), FINE
    agents, along = now.frame.agents, now.agents
    for i in range(len(agents)):
        away = np.hypot(x - agents.x[i], y - agents.y[i])
        assert (
            abs(along.l[i]) - 1e-6
            <= away.min()
            <= np.hypot(along.l[i], 0.06 + 0.002 * abs(along.l[i]))
        )
        assert (
            np.hypot(
                *(np.array(COURSE.line.point(along.s[i], along.l[i])) - (agents.x[i], agents.y[i]))
            )
            < 1e-6
        )
        dx, dy = np.array(COURSE.line.point(along.s[i] + 0.01, 0.0)) - COURSE.line.point(
            along.s[i] - 0.01, 0.0
        )
        tangent = np.array([dx, dy]) / np.hypot(dx, dy)
        velocity = np.array([agents.vx[i], agents.vy[i]])
        assert along.v_s[i] == pytest.approx(velocity @ tangent, abs=2e-3)
        assert along.v_l[i] == pytest.approx(velocity @ (-tangent[1], tangent[0]), abs=2e-3)
        assert abs(wrapped(along.turn[i] - agents.yaw[i] + np.arctan2(dy, dx))) < 2e-4
        assert abs(along.turn[i]) <= np.pi
    np.testing.assert_allclose(along.v_s**2 + along.v_l**2, now.speed**2, atol=1e-9)
    np.testing.assert_array_equal(now.standing, np.hypot(agents.vx, agents.vy) < STANDING_MPS)
    assert now.vulnerable.tolist() == [
        row[4] in (AgentKind.PEDESTRIAN, AgentKind.BICYCLE) for row in rows
    ]
    assert (now.s, now.l) == pytest.approx((20.0, 0.3), abs=1e-6)
    assert now.front - now.rear == pytest.approx(CAR.length)


def assert_same_columns(one: Scene, two: Scene, side: float) -> None:
    for name, sign in (("s", 1.0), ("v_s", 1.0), ("l", side), ("v_l", side), ("turn", side)):
        np.testing.assert_allclose(
            getattr(two.agents, name), sign * getattr(one.agents, name), atol=1e-6, err_msg=name
        )
    assert (two.s, two.l, two.limit) == pytest.approx((one.s, side * one.l, one.limit), abs=1e-6)
    assert two.frenet == pytest.approx([side * value for value in one.frenet], abs=1e-6)
    np.testing.assert_array_equal(one.standing, two.standing)
    for keeps in (True, False):
        np.testing.assert_array_equal(
            behind(one, keeps_track=keeps), behind(two, keeps_track=keeps)
        )


@given(ROWS, st.floats(-3.0, 3.0))
@settings(max_examples=20)
def test_a_turned_world_has_these_columns(
    rows: list[tuple[float, float, float, float, AgentKind]], angle: float
) -> None:
    by = turned(angle)
    x, y = by @ (5.0, 0.0)
    ego = EgoState(0.0, float(x), float(y), angle, 8.0)
    assert_same_columns(
        world(rows, np.eye(2), COURSE),
        world(rows, by, reference(lanes(POINTS @ by.T, 2), ego=ego)),
        1.0,
    )


@given(ROWS)
@settings(max_examples=20)
def test_a_mirrored_world_has_the_mirrored_columns(
    rows: list[tuple[float, float, float, float, AgentKind]],
) -> None:
    line = COURSE.line
    flipped = replace(
        COURSE,
        line=type(line).through(np.array([MIRROR @ line.point(float(s), 0.0) for s in line.s])),
        **{
            f"{what}_{side}": -getattr(COURSE, f"{what}_{other}")
            for what in ("lane", "road", "facing")
            for side, other in (("left", "right"), ("right", "left"))
        },
    )
    assert_same_columns(world(rows, np.eye(2), COURSE), world(rows, MIRROR, flipped), -1.0)
