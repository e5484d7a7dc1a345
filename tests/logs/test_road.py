from dataclasses import replace
from math import pi

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from replan.logs.polylines import inside, thinned
from replan.logs.reference_line import ReferenceLine
from replan.logs.road import Goal, Lane, Road, RoadSource
from replan.logs.shapes import point_segment
from replan.logs.states import wrap


def circle(radius: float, turns: float, pitch: float = 0.0, start: float = 0.0) -> np.ndarray:
    """Points of a circle, or, with a pitch (m per turn), of an outward spiral."""
    u = start + np.linspace(0.0, 2 * pi * turns, max(8, round(48 * turns)))
    r = radius + pitch * (u - start) / (2 * pi)
    return np.column_stack([r * np.cos(u), r * np.sin(u)])


def wavy(seed: int, n: int = 30) -> np.ndarray:
    """A road-like line: segments of about 4 m whose heading wanders."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(rng.normal(0.0, 0.15, n))
    return np.cumsum(4.0 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)


def there_and_back(line: ReferenceLine, s: float, share: float) -> float:
    """Largest error of (s, l) after a trip to the world, l as a share of the regular width (at most
    4 m).
    """
    near = slice(*np.searchsorted(line.s, [s - 8.0, s + 8.0]))
    kappa = max([1e-9, *np.abs(line.kappa[near])])
    l = share * min(4.0, 0.8 / kappa)
    back = line.project(*line.point(s, l), near=s + 1.3, window=10.0)
    return max(abs(back[0] - s), abs(back[1] - l))


@settings(max_examples=40)
@given(st.integers(0, 30), st.floats(-20.0, 160.0), st.floats(-1.0, 1.0))
def test_frenet_there_and_back(seed: int, s: float, share: float) -> None:
    assert there_and_back(ReferenceLine.through(wavy(seed)), s, share) < 1e-6


@given(st.floats(0.0, 1.0), st.floats(-1.0, 1.0))
def test_frenet_there_and_back_on_a_spiral_of_two_and_a_half_turns(u: float, share: float) -> None:
    line = SPIRAL
    assert line.yaw[-1] - line.yaw[0] > 4.5 * pi
    assert there_and_back(line, u * line.length, share) < 1e-6


SPIRAL = ReferenceLine.through(circle(20.0, 2.5, pitch=9.0))


@given(st.floats(0.1, 1.4), st.floats(-1.0, 1.0), st.floats(-25.0, 25.0))
@settings(max_examples=40)
def test_frenet_there_and_back_at_a_kink(bend: float, share: float, s: float) -> None:
    arm = 4.0 * np.arange(1, 11)[:, None]
    points = np.vstack(
        [-arm[::-1] * [[1.0, 0.0]], [[0.0, 0.0]], arm * [[np.cos(bend), np.sin(bend)]]]
    )
    assert there_and_back(ReferenceLine.through(points), 40.0 + s, share) < 1e-6


@given(st.floats(8.0, 200.0), st.booleans())
@settings(max_examples=30)
def test_curvature_of_a_circle_and_unit_speed(radius: float, left: bool) -> None:
    points = circle(radius, 0.8) * ([1.0, 1.0] if left else [1.0, -1.0])
    line = ReferenceLine.through(points)
    middle = slice(len(line.s) // 5, -len(line.s) // 5)
    assert np.allclose(line.kappa[middle], (1.0 if left else -1.0) / radius, rtol=0.01)
    assert line.length == pytest.approx(2 * pi * 0.8 * radius, rel=1e-3)
    steps = np.hypot(*np.diff(line.xy, axis=0).T)
    assert steps.max() <= (line.s[1] - line.s[0]) * (1 + 1e-4)


@given(st.integers(0, 20), st.floats(0.0, 110.0), st.floats(-3.0, 3.0))
@settings(max_examples=30)
def test_projection_is_the_nearest_point(seed: int, s: float, l: float) -> None:
    line = ReferenceLine.through(wavy(seed))
    x, y = line.point(s, l)
    foot, offset = line.project(x, y)
    fine = np.array([line.point(station, 0.0) for station in np.linspace(0.0, line.length, 2000)])
    assert abs(offset) <= np.hypot(*(fine - [x, y]).T).min() + 1e-6
    assert np.hypot(*(np.array(line.point(foot, 0.0)) - [x, y])) == pytest.approx(
        abs(offset), abs=1e-6
    )


@given(st.integers(0, 20), st.floats(-5.0, 115.0), st.floats(-3.0, 3.0))
@settings(max_examples=30)
def test_a_mirrored_line_mirrors_the_offset(seed: int, s: float, l: float) -> None:
    points = wavy(seed)
    line, mirror = ReferenceLine.through(points), ReferenceLine.through(points * [1.0, -1.0])
    x, y = line.point(s, l)
    one, two = line.project(x, y, near=s), mirror.project(x, -y, near=s)
    assert one[0] == pytest.approx(two[0], abs=1e-9)
    assert one[1] == pytest.approx(-two[1], abs=1e-9)


def test_beyond_its_ends_a_line_goes_straight() -> None:
    line = ReferenceLine.through(wavy(3))
    x, y, yaw, kappa = line.frame(line.length + 10.0)
    end = line.frame(line.length)
    assert np.hypot(x - end[0], y - end[1]) == pytest.approx(10.0, rel=2e-3)
    assert (yaw, kappa) == (pytest.approx(end[2]), 0.0)


@pytest.mark.parametrize("points", [[[0, 0]], [[1, 1], [1, 1]], [[0, 0], [np.nan, 1]], [0.0, 1.0]])
def test_lines_without_direction_are_refused(points: list) -> None:
    with pytest.raises(ValueError, match="reference line needs"):
        ReferenceLine.through(np.array(points, float))


@given(
    st.lists(st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)), min_size=1, max_size=40),
    st.floats(0.1, 3.0),
)
def test_thinned_keeps_the_ends_and_the_spacing(
    points: list[tuple[float, float]], spacing: float
) -> None:
    out = thinned(np.array(points), spacing)
    assert (out[0] == points[0]).all()
    assert (out[:, None] == np.array(points)[None]).all(axis=2).any(axis=1).all()
    if len(out) > 1:
        steps = np.hypot(*np.diff(out, axis=0).T)
        assert (out[-1] == points[-1]).all()
        assert (steps[:-1] >= 0.5 * spacing).all()
        assert steps[-1] > 0.0


@pytest.mark.parametrize(
    ("end", "kept"), [(1.7, [0.0, 1.0, 1.7]), (1.4, [0.0, 1.4]), (1.0, [0.0, 1.0])]
)
def test_the_end_takes_the_place_of_a_point_that_is_nearer_than_half_the_spacing(
    end: float, kept: list
) -> None:
    line = np.array([[0.0, 0.0], [1.0, 0.0], [end, 0.0]])
    assert thinned(line, 1.0)[:, 0].tolist() == kept


@given(st.integers(0, 20))
def test_a_road_along_a_path_holds_the_path_and_goes_on(seed: int) -> None:
    path = wavy(seed)
    road = Road.along(path, speed_limit=10.0, beyond=50.0)
    assert road.source is RoadSource.DRIVEN_PATH
    assert all(road.is_drivable(*point) for point in path[1:-1])
    ahead = (path[-1] - path[-2]) / np.hypot(*(path[-1] - path[-2]))
    assert road.is_drivable(*(path[-1] + 45.0 * ahead))
    assert not road.is_drivable(*(path[-1] + 60.0 * ahead))
    assert road.limit(0) == 10.0
    assert np.allclose(np.hypot(*(road.lanes[0].left - road.lanes[0].right).T), 3.5)


@pytest.mark.parametrize(
    "path", [[[0, 0], [2, 0], [2.3, 0]], [[0, 0], [5, 0], [0, 0]], [[0, 0], [1.2, 0], [1.3, 0]]]
)
def test_a_road_along_an_odd_path_is_finite(path: list) -> None:
    lane = Road.along(np.array(path, float), speed_limit=10.0).lanes[0]
    assert np.isfinite(lane.polygon).all()


def test_a_standing_ego_has_no_path() -> None:
    with pytest.raises(ValueError, match="shorter than 1 m"):
        Road.along(np.zeros((50, 2)), speed_limit=10.0)


polygons = st.integers(3, 9).flatmap(
    lambda n: st.tuples(*[st.floats(1.0, 5.0)] * n).map(
        lambda r: np.column_stack(
            [np.array(r) * f(2 * pi * np.arange(len(r)) / len(r)) for f in (np.cos, np.sin)]
        )
    )
)


@given(polygons, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
def test_inside_is_the_winding_number(polygon: np.ndarray, x: float, y: float) -> None:
    angle = np.arctan2(polygon[:, 1] - y, polygon[:, 0] - x)
    turns = sum(wrap(a) for a in np.diff(np.r_[angle, angle[0]])) / (2 * pi)
    edge = min(point_segment(x, y, *polygon[i - 1], *polygon[i]) for i in range(len(polygon)))
    if edge > 1e-9:
        assert inside(x, y, polygon) == (abs(turns) > 0.5)


def lane(number: int, x: float, **changes: object) -> Lane:
    return Lane(
        number,
        np.array([[x, 1.0], [x + 10, 1.0]]),
        np.array([[x, -1.0], [x + 10, -1.0]]),
        **changes,
    )  # type: ignore[arg-type]


def test_lanes_by_place() -> None:
    road = Road(
        {1: lane(1, 0.0, speed_limit=5.0), 2: lane(2, 5.0), 3: lane(3, 20.0, drivable=False)}
    )
    assert [found.id for found in road.lanes_at(7.0, 0.0)] == [1, 2]
    assert road.lanes_at(7.0, 1.5) == ()
    assert road.is_drivable(2.0, 0.5)
    assert not road.is_drivable(25.0, 0.0)
    assert (road.limit(1), road.limit(2)) == (5.0, road.default_speed_limit)
    assert lane(1, 0.0).length == 10.0
    assert Road({}).lanes_at(0.0, 0.0) == ()


def test_bad_lanes_are_refused() -> None:
    with pytest.raises(ValueError, match="boundaries have shapes"):
        Lane(1, np.zeros((3, 2)), np.zeros((2, 2)))
    with pytest.raises(ValueError, match="not finite"):
        Lane(1, np.array([[0, 0], [np.nan, 0]]), np.ones((2, 2)))


@given(st.floats(-7.0, 7.0), st.floats(0.0, 6.2), st.floats(-0.2, 1.2), st.integers(-2, 2))
def test_a_heading_interval_holds_its_headings_modulo_a_turn(
    first: float, width: float, share: float, turns: int
) -> None:
    goal = Goal(yaw=(first, first + width))
    yaw = first + share * width
    outside = (share < 0.0 or share > 1.0) and min(abs(share), abs(share - 1)) * width > 1e-6
    wraps_into = outside and abs(share - 0.5) * width > pi
    if not wraps_into:
        assert goal.reached(0.0, 0.0, 0.0, yaw + 2 * pi * turns, 0.0) != outside or width < 1e-6


@given(st.floats(-9.0, 9.0))
def test_a_full_turn_is_any_heading(yaw: float) -> None:
    assert Goal(yaw=(-pi, pi)).reached(0.0, 0.0, 0.0, yaw, 0.0)
    assert Goal(yaw=(0.0, 7.0)).reached(0.0, 0.0, 0.0, yaw, 0.0)


def test_a_goal_needs_each_of_its_conditions() -> None:
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])
    goal = Goal((square, square + 10.0), t=(1.0, 2.0), v=(0.0, 5.0))
    assert goal.reached(1.0, 1.0, 1.0, 0.0, 3.0)
    assert goal.reached(2.0, 11.0, 11.0, 9.0, 5.0)
    for miss in ((0.9, 1, 1, 0, 3), (1.5, 3, 1, 0, 3), (1.5, 1, 1, 0, 5.1)):
        assert not goal.reached(*miss)
    assert Goal().reached(0.0, 0.0, 0.0, 0.0, 0.0)


def box(x: float, half: float) -> np.ndarray:
    return np.array([[x - half, -half], [x + half, -half], [x + half, half], [x - half, half]])


bounds = st.one_of(
    st.none(),
    st.tuples(st.floats(-2.0, 2.0), st.floats(0.0, 3.0)).map(lambda b: (b[0], b[0] + b[1])),
)
places = st.lists(st.builds(box, st.floats(-5.0, 5.0), st.floats(0.5, 4.0)), max_size=2).map(tuple)
goals = st.builds(Goal, places, bounds, bounds, bounds)


@given(
    st.lists(goals, min_size=1, max_size=4), st.lists(st.floats(-3.0, 3.0), min_size=5, max_size=5)
)
def test_any_of_some_goals_is_reached_exactly_where_one_of_them_is(
    some: list[Goal], state: list[float]
) -> None:
    goal = Goal.any_of(some)
    assert goal.reached(*state) == any(one.reached(*state) for one in some)
    loose = replace(goal, alternatives=())  # what readers that do not know alternatives see
    assert loose.reached(*state) or not goal.reached(*state) or goal.yaw is not None


def test_goals_that_differ_in_place_alone_are_one() -> None:
    near, far = Goal((box(0.0, 1.0),), v=(0.0, 5.0)), Goal((box(9.0, 1.0),), v=(0.0, 5.0))
    goal = Goal.any_of([near, far])
    assert not goal.alternatives and len(goal.regions) == 2 and goal.v == (0.0, 5.0)
    stop = Goal.any_of([near, far, Goal((box(20.0, 1.0),), v=(0.0, 0.0))])
    assert len(stop.alternatives) == 2 and len(stop.regions) == 3 and stop.v == (0.0, 5.0)
    assert not stop.reached(0.0, 20.0, 0.0, 0.0, 3.0) and stop.reached(0.0, 20.0, 0.0, 0.0, 0.0)
