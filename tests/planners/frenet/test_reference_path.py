"""Reference path: smoothing that stays within its bound, and the width of known roads."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from roads import along_x, beside, curve, lanes, strip
from scenes import CAR

from replan.core.arrays import FloatArray
from replan.logs.reference_line import ReferenceLine
from replan.logs.road import Road
from replan.logs.route import find_route
from replan.logs.states import EgoState
from replan.logs.vehicle import VehicleParameters
from replan.planners.frenet.reference_path import ReferencePath, make_reference_path
from replan.planners.frenet.route_line import BENDING_WEIGHT, MAX_SHIFT_M, SPACING_M, smooth_points

EGO = EgoState(0.0, 0.0, 0.0, 0.0, 10.0)


def reference(road: Road, ego: EgoState = EGO) -> ReferencePath:
    return make_reference_path(road, find_route(road, ego, None), ego)


class Section(NamedTuple):
    """Edges of road and lane, m, and the limit, m/s, at a station."""

    road_right: float
    lane_right: float
    lane_left: float
    road_left: float
    limit: float


def section(path: ReferencePath, x: float) -> Section:
    """The section beside a place on the x axis."""
    s, _ = path.line.project(x, 0.0)
    columns = (path.road_right, path.lane_right, path.lane_left, path.road_left, path.limit)
    return Section(*(float(np.interp(s, path.line.s, column)) for column in columns))


def resampled(points: FloatArray, count: int) -> FloatArray:
    chord = np.r_[0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T))]
    assert abs(chord[-1] / SPACING_M - (count - 1)) <= 0.5 + 1e-5
    at = np.linspace(0.0, chord[-1], count)
    return np.column_stack([np.interp(at, chord, points[:, k]) for k in (0, 1)])


@given(st.lists(st.tuples(st.floats(4.0, 30.0), st.floats(-0.6, 0.6)), min_size=2, max_size=12))
@settings(max_examples=40)
def test_smoothing_moves_no_point_further_than_it_may(legs: list[tuple[float, float]]) -> None:
    heading = np.cumsum([turn for _, turn in legs])
    steps = np.array([length for length, _ in legs])[:, None] * np.column_stack(
        [np.cos(heading), np.sin(heading)]
    )
    points = np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])
    smooth = smooth_points(points)
    raw = resampled(points, len(smooth))
    assert np.hypot(*(smooth - raw).T).max() < MAX_SHIFT_M + 0.01
    np.testing.assert_allclose(smooth[[0, -1]], points[[0, -1]], atol=0.02)
    energy = [float(np.sum(np.diff(line, 2, axis=0) ** 2)) for line in (raw, smooth)]
    assert BENDING_WEIGHT * energy[1] <= BENDING_WEIGHT * energy[0] + 1e-2


@given(
    st.lists(st.tuples(st.floats(4.0, 30.0), st.floats(-0.9, 0.9)), min_size=2, max_size=12),
    st.floats(-np.pi, np.pi),
    st.sampled_from([1.0, -1.0]),
)
@settings(max_examples=30)
def test_the_line_turns_and_mirrors_with_the_world(
    legs: list[tuple[float, float]], turn: float, flip: float
) -> None:
    heading = np.cumsum([bend for _, bend in legs])
    steps = np.array([length for length, _ in legs])[:, None] * np.column_stack(
        [np.cos(heading), np.sin(heading)]
    )
    points = np.vstack([[30.0, -20.0], np.cumsum(steps, axis=0)])
    world = np.array([[np.cos(turn), np.sin(turn)], [-flip * np.sin(turn), flip * np.cos(turn)]])
    np.testing.assert_allclose(
        smooth_points(points @ world), smooth_points(points) @ world, atol=1e-6
    )


@pytest.mark.parametrize("length", [41.0, 43.0, 300.0])  # half way between two counts of points
def test_a_figure_as_round_as_it_may_be_does_not_change_the_count(length: float) -> None:
    for near in (length - 1e-9, length + 1e-9):
        assert len(smooth_points(np.array([[0.0, 0.0], [near, 0.0]]))) == len(
            smooth_points(np.array([[0.0, 0.0], [length, 0.0]]))
        )
    exact, less = (
        ReferenceLine.through(np.array([[0.0, 0.0], [at + 0.5, 0.0]]))
        for at in (length, length - 1e-9)
    )
    assert len(exact.s) == len(less.s)


@given(st.floats(20.0, 300.0), st.floats(-np.pi, np.pi))
def test_a_straight_line_stays_straight(length: float, yaw: float) -> None:
    points = np.array([[5.0, 7.0], [5.0 + length * np.cos(yaw), 7.0 + length * np.sin(yaw)]])
    np.testing.assert_allclose(
        smooth_points(points), resampled(points, len(smooth_points(points))), atol=2e-4
    )
    assert np.abs(ReferenceLine.through(smooth_points(points)).kappa).max() < 1e-3


def test_smoothing_solves_its_problem() -> None:
    """Where no shift is at its bound, the solution of (1) is that of a linear system."""
    points = curve((30.0, 0.0), (30.0, 0.01), (30.0, -0.01), step=2.0)
    n = len(points)
    bend = np.diff(np.eye(n), 2, axis=0)
    raw = resampled(points, n)
    inner = slice(1, n - 1)
    matrix = (BENDING_WEIGHT * bend.T @ bend + np.eye(n))[inner, inner]
    expected = np.linalg.solve(matrix, -(BENDING_WEIGHT * bend.T @ bend @ raw)[inner])
    assert np.abs(expected).max() < MAX_SHIFT_M
    np.testing.assert_allclose(smooth_points(points)[inner] - raw[inner], expected, atol=2e-3)


@pytest.mark.parametrize("kappa", [0.02, -0.02])
def test_known_widths_are_found_in_a_curve(kappa: float) -> None:
    line = reference(lanes(curve((60.0, 0.0), (80.0, kappa), (60.0, 0.0)), 2))
    middle = slice(80, 120)
    # Smoothing cuts the curve by some centimetres
    np.testing.assert_allclose(line.lane_left[middle], 1.75, atol=0.06)
    np.testing.assert_allclose(line.lane_right[middle], -1.75, atol=0.06)
    np.testing.assert_allclose(line.road_left[middle], 5.25, atol=0.06)
    np.testing.assert_allclose(line.line.kappa[middle], kappa, rtol=0.05)


def pair(left_of_own: dict[str, object], right_of_other: dict[str, object]) -> Road:
    own = strip(0, along_x(), left_neighbour=1, **left_of_own)
    other = strip(1, along_x(), 5.25, 1.75, right_neighbour=0, **right_of_other)
    return Road({0: own, 1: other})


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize("other", [True, False])
def test_a_marking_is_crossed_only_where_both_lanes_allow_it(own: bool, other: bool) -> None:
    road = pair({"left_crossable": own}, {"right_crossable": other})
    assert section(reference(road), 100.0).road_left == pytest.approx(
        5.25 if own and other else 1.75, abs=1e-3
    )
    mirrored = section(reference(road, EgoState(0.0, 0.0, 3.5, 0.0, 10.0)), 100.0)
    assert mirrored.road_right == pytest.approx(-5.25 if own and other else -1.75, abs=1e-3)


def test_a_marking_two_lanes_away_is_respected() -> None:
    road = lanes(along_x(), 3)
    closed = {i: replace(lane, left_crossable=i != 1) for i, lane in road.lanes.items()}
    assert section(reference(Road(closed)), 100.0).road_left == pytest.approx(5.25, abs=1e-3)
    assert section(reference(road), 100.0).road_left == pytest.approx(8.75, abs=1e-3)


def test_the_opposite_lane_is_not_to_be_borrowed() -> None:
    opposite = strip(1, beside(along_x(), 3.5)[::-1])
    road = Road({0: strip(0, along_x(), left_opposite=True), 1: opposite})
    np.testing.assert_allclose(
        section(reference(road), 100.0)[:4], (-1.75, -1.75, 1.75, 1.75), atol=1e-3
    )


def test_a_sidewalk_is_not_to_be_borrowed() -> None:
    road = Road({0: strip(0, along_x()), 1: strip(1, along_x(), 5.25, 1.75, drivable=False)})
    assert section(reference(road), 100.0).road_left == pytest.approx(1.75, abs=1e-3)


def test_a_merging_lane_belongs_to_the_road_only_where_it_adjoins() -> None:
    """A ramp comes in from the right: 10 m away at x = 0, beside the lane from x = 100 on."""
    x = along_x(0.0, 200.0)[:, 0]
    middle = -3.5 - 10.0 * np.clip(1.0 - x / 100.0, 0.0, 1.0)
    ramp = strip(2, np.column_stack([x, middle]), left_neighbour=0, successors=())
    line = reference(Road({0: strip(0, along_x(), right_neighbour=2), 2: ramp}))
    assert section(line, 20.0).road_right == pytest.approx(-1.75, abs=1e-3)
    assert section(line, 150.0).road_right == pytest.approx(-5.25, abs=1e-2)
    np.testing.assert_allclose(line.lane_right, -1.75, atol=1e-3)


def test_the_limit_follows_the_lanes_and_the_route_goes_on_straight() -> None:
    first = strip(0, along_x(-50.0, 100.0), successors=(1,), speed_limit=14.0)
    second = strip(1, along_x(100.0, 300.0), speed_limit=8.0)
    line = reference(Road({0: first, 1: second}))
    assert line.line.length > 340.0
    assert (section(line, 50.0).limit, section(line, 200.0).limit) == pytest.approx((14.0, 8.0))


def test_a_lane_change_on_the_route_is_blended_from_the_ego_on() -> None:
    road = lanes(along_x(), 2)
    line = make_reference_path(road, (0, 1), EGO).line
    offsets = np.interp([-20.0, 0.0, 100.0, 200.0], line.xy[:, 0], line.xy[:, 1])
    np.testing.assert_allclose(offsets, (0.0, 0.0, 3.5, 3.5), atol=0.1)
    assert np.abs(line.kappa).max() < 0.05


def test_a_loop_of_more_than_a_turn_has_one_line() -> None:
    loop = curve((20.0, 0.0), (1.6 * 2.0 * np.pi * 20.0, 1.0 / 20.0))
    line = reference(lanes(loop)).line
    assert line.length == pytest.approx(221.0, abs=2.0)
    assert line.yaw[-1] == pytest.approx(1.6 * 2.0 * np.pi, abs=0.25)


def test_a_circular_lane_is_followed_once_round_and_not_for_ever() -> None:
    ring = curve((2.0 * np.pi * 30.0, 1.0 / 30.0))
    line = reference(Road({0: strip(0, ring, successors=(0,))})).line
    assert 180.0 < line.length < 700.0 and np.isfinite(line.xy).all()


@pytest.mark.parametrize(("turn", "possible"), [(70.0, True), (-90.0, True), (120.0, False)])
def test_a_kinked_lane_is_smoothed_until_a_car_can_be_steered_along(
    turn: float, possible: bool
) -> None:
    """As far as its width allows.

    In a lane hardly wider than the car the line stays where it is.
    """
    yaw, leg = np.radians(turn), np.arange(0.0, 40.0, 1.0)[:, None]
    kinked = np.vstack([leg * [1.0, 0.0], [40.0, 0.0] + leg * [np.cos(yaw), np.sin(yaw)]])

    def line(width: float, car: VehicleParameters | None) -> ReferenceLine:
        road = Road({0: strip(0, kinked, 0.5 * width, -0.5 * width)})
        return make_reference_path(road, (0,), EGO, car).line

    for width, has_room in ((1.9, False), (5.0, True)):
        plain, steerable = line(width, None), line(width, CAR)
        is_gentler = np.abs(steerable.kappa).max() < np.abs(plain.kappa).max()
        assert is_gentler == has_room
        away = [abs(plain.project(x, y)[1]) for x, y in steerable.xy]
        assert max(away) <= max(0.5 * (width - CAR.width), 0.0) + MAX_SHIFT_M
    assert (np.abs(steerable.kappa).max() <= CAR.max_kappa) == possible


@given(st.floats(2.8, 5.0), st.integers(1, 3), st.integers(0, 2))
@settings(max_examples=20)
def test_known_widths_are_found(width: float, count: int, own: int) -> None:
    own = min(own, count - 1)
    line = reference(
        lanes(along_x(), count, width=width, limit=7.0), EgoState(0.0, 0.0, own * width, 0.0, 10.0)
    )
    right = -(own + 0.5) * width
    expected = (right, -0.5 * width, 0.5 * width, right + count * width, 7.0)
    np.testing.assert_allclose(section(line, 100.0), expected, atol=1e-3)
