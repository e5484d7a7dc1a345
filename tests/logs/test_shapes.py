from math import cos, inf, sin

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from replan.logs import shapes
from replan.logs.shapes import corners, distance, overlap, point_segment

place, angle, side, rate = (
    st.floats(-8.0, 8.0),
    st.floats(-7.0, 7.0),
    st.floats(0.3, 6.0),
    st.floats(-5.0, 5.0),
)
box = st.tuples(place, place, angle, side, side)
velocity = st.tuples(rate, rate)
Box = tuple[float, float, float, float, float]


def local(b: Box, points: np.ndarray) -> np.ndarray:
    """World points in the frame of a box."""
    dx, dy = points[..., 0] - b[0], points[..., 1] - b[1]
    return np.stack([dx * cos(b[2]) + dy * sin(b[2]), dy * cos(b[2]) - dx * sin(b[2])], axis=-1)


def outline(b: Box, count: int = 60) -> np.ndarray:
    """Points on the edges."""
    c, u = corners(*b), np.linspace(0.0, 1.0, count)[:, None]
    return np.vstack([c[i] + u * (c[(i + 1) % 4] - c[i]) for i in range(4)])


def point_to_box(b: Box, points: np.ndarray) -> np.ndarray:
    """Distance of points to a box by the closed form of an axis-aligned rectangle."""
    out = np.maximum(np.abs(local(b, points)) - 0.5 * np.array(b[3:]), 0.0)
    return np.hypot(out[..., 0], out[..., 1])


def sampled_distance(one: Box, two: Box) -> float:
    """Upper bound by points on the edges: exact where a corner is the nearest point."""
    return min(point_to_box(one, outline(two)).min(), point_to_box(two, outline(one)).min())


def time_to_contact(one: Box, v1: tuple, two: Box, v2: tuple) -> float:
    return shapes.time_to_contact(*one, *two, v2[0] - v1[0], v2[1] - v1[1])


def turned(b: Box, turn: float, dx: float, dy: float) -> Box:
    x, y = b[0] * cos(turn) - b[1] * sin(turn) + dx, b[0] * sin(turn) + b[1] * cos(turn) + dy
    return x, y, b[2] + turn, b[3], b[4]


def mirrored(b: Box) -> Box:
    return b[0], -b[1], -b[2], b[3], b[4]


@given(box)
def test_corners_go_around_counter_clockwise_from_the_front_left(b: Box) -> None:
    half = 0.5 * np.array(b[3:])
    expected = half * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    assert np.allclose(local(b, corners(*b)), expected, atol=1e-9)


@given(box, box)
def test_distance_is_that_of_points_on_the_edges(one: Box, two: Box) -> None:
    exact, sampled = distance(*one, *two), sampled_distance(one, two)
    if exact > 0.0:
        assert exact == pytest.approx(sampled, abs=1e-9)
    else:
        assert overlap(*one, *two)


@given(box, box)
def test_overlap_is_a_corner_inside_or_edges_that_cross(one: Box, two: Box) -> None:
    found = overlap(*one, *two)
    assert not found or touches(one, two, slack=1e-9)
    assert found or not touches(grown(one, -1e-9), grown(two, -1e-9), slack=0.0)


def grown(b: Box, by: float) -> Box:
    return *b[:3], b[3] + by, b[4] + by


def touches(one: Box, two: Box, *, slack: float) -> bool:
    """Brute force, without separating axes."""
    a, b = corners(*one), corners(*two)
    if min(point_to_box(two, a).min(), point_to_box(one, b).min()) <= slack:
        return True
    return any(cross(a[i], a[i - 1], b[j], b[j - 1]) for i in range(4) for j in range(4))


def cross(p: np.ndarray, q: np.ndarray, a: np.ndarray, b: np.ndarray) -> bool:
    def side_of(start: np.ndarray, end: np.ndarray, point: np.ndarray) -> float:
        d, e = end - start, point - start
        return float(d[0] * e[1] - d[1] * e[0])

    return side_of(p, q, a) * side_of(p, q, b) < 0.0 and side_of(a, b, p) * side_of(a, b, q) < 0.0


@given(box, box)
def test_all_are_symmetric_in_the_boxes(one: Box, two: Box) -> None:
    assert overlap(*one, *two) == overlap(*two, *one)
    assert distance(*one, *two) == distance(*two, *one)


@given(box, box, velocity, velocity)
def test_time_to_contact_is_symmetric(one: Box, two: Box, v1: tuple, v2: tuple) -> None:
    forth, back = time_to_contact(one, v1, two, v2), time_to_contact(two, v2, one, v1)
    assert forth == back or forth == pytest.approx(back, abs=1e-9)


@given(box, box, velocity, velocity, angle, place, place)
def test_invariant_under_turning_shifting_and_mirroring(
    one: Box, two: Box, v1: tuple, v2: tuple, turn: float, dx: float, dy: float
) -> None:
    gap = distance(*one, *two)
    moved = distance(*turned(one, turn, dx, dy), *turned(two, turn, dx, dy))
    assert gap == pytest.approx(moved, abs=1e-7)
    assert distance(*mirrored(one), *mirrored(two)) == pytest.approx(gap, abs=1e-9)
    touch = time_to_contact(one, v1, two, v2)
    w1, w2 = (turned((*v, 0.0, 1.0, 1.0), turn, 0.0, 0.0)[:2] for v in (v1, v2))
    again = time_to_contact(turned(one, turn, dx, dy), w1, turned(two, turn, dx, dy), w2)
    grazing = _closest(one, two, v1, v2) < 1e-4
    assert grazing or touch == again == inf or again == pytest.approx(touch, abs=1e-5, rel=1e-5)


def _closest(one: Box, two: Box, v1: tuple, v2: tuple) -> float:
    """How nearly the outcome turns over: |margin| by which a slightly larger box changes the
    answer.
    """
    a, b = (time_to_contact(grown(one, by), v1, two, v2) for by in (1e-4, -1e-4))
    return inf if (a == inf) == (b == inf) and (a == b or abs(a - b) < 1.0) else 0.0


@settings(max_examples=60)
@given(box, box, velocity, velocity)
def test_time_to_contact_is_when_stepping_finds_the_first_touch(
    one: Box, two: Box, v1: tuple, v2: tuple
) -> None:
    assume(_closest(one, two, v1, v2) > 0.0)
    exact, step = time_to_contact(one, v1, two, v2), 0.01
    found = inf
    for t in np.arange(0.0, 8.0, step):
        at = ((b[0] + t * v[0], b[1] + t * v[1], *b[2:]) for b, v in ((one, v1), (two, v2)))
        if overlap(*next(at), *next(at)):
            found = float(t)
            break
    if found < inf:
        assert exact - 1e-9 <= found
    if exact < 7.9 and found == inf:  # a touch shorter than a step
        t = exact + 1e-9
        assert overlap(
            one[0] + t * v1[0],
            one[1] + t * v1[1],
            *one[2:],
            two[0] + t * v2[0],
            two[1] + t * v2[1],
            *two[2:],
        )
    elif exact < 7.9:
        assert found == pytest.approx(exact, abs=step + 1e-9) or exact < found


def turning(
    one: Box, v1: tuple, w1: float, two: Box, v2: tuple, w2: float, lasts: float = 1.5
) -> float:
    return shapes.time_to_contact_turning(*one, *v1, w1, *two, *v2, w2, lasts)


def on_arc(b: Box, v: tuple, w: float, t: float) -> Box:
    """The box after t s at the constant yaw rate w: a closed form of the circle."""
    c, s = (t * np.sinc(w * t / np.pi), 0.5 * w * t**2 * np.sinc(0.5 * w * t / np.pi) ** 2)
    return b[0] + c * v[0] - s * v[1], b[1] + s * v[0] + c * v[1], b[2] + w * t, *b[3:]


turns = st.floats(-0.6, 0.6)


@settings(max_examples=60)
@given(box, box, velocity, velocity, turns, turns)
def test_turning_time_to_contact_is_when_stepping_along_the_arcs_finds_the_first_touch(
    one: Box, two: Box, v1: tuple, v2: tuple, w1: float, w2: float
) -> None:
    """Within the turn, up to the headings' error of 0.03 rad at half of a diagonal."""
    found, error = (
        turning(one, v1, w1, two, v2, w2),
        0.03 * max(np.hypot(*one[3:]), np.hypot(*two[3:])) + 0.01,
    )
    assert turning(two, v2, w2, one, v1, w1) == pytest.approx(found, abs=1e-6)
    for t in np.arange(0.0, min(found, 1.5) - 1e-9, 0.01):
        assert not overlap(
            *grown(on_arc(one, v1, w1, t), -error), *grown(on_arc(two, v2, w2, t), -error)
        )
    if found < 1.5:
        assert overlap(
            *grown(on_arc(one, v1, w1, found), error), *grown(on_arc(two, v2, w2, found), error)
        )


@given(box, box, velocity, velocity, turns)
def test_without_turning_it_is_the_straight_time_and_after_the_turn_the_tangent(
    one: Box, two: Box, v1: tuple, v2: tuple, w: float
) -> None:
    assert turning(one, v1, 0.0, two, v2, 0.0) == time_to_contact(one, v1, two, v2)
    found = turning(one, v1, w, two, v2, 0.0)
    if 1.5 < found < inf:
        later, after = on_arc(one, v1, w, 1.5), turned((*v1, 0.0, 1.0, 1.0), 1.5 * w, 0.0, 0.0)[:2]
        assert time_to_contact(later, after, on_arc(two, v2, 0.0, 1.5), v2) == pytest.approx(
            found - 1.5, abs=1e-5
        )


@given(box, box, velocity)
def test_no_relative_motion_touches_now_or_never(one: Box, two: Box, v: tuple) -> None:
    assert time_to_contact(one, v, two, v) == (0.0 if overlap(*one, *two) else inf)


def test_a_thin_box_cannot_slip_through() -> None:
    assert shapes.time_to_contact(0, 0, 0, 4, 2, 0, 30, 0, 0.01, 0.01, 0, -1000) == pytest.approx(
        0.028995
    )


def test_touching_boxes_overlap_and_a_segment_has_length() -> None:
    assert overlap(0, 0, 0, 2, 2, 2, 0, 0, 2, 2)
    assert not overlap(0, 0, 0, 2, 2, 2.001, 0, 0, 2, 2)
    assert point_segment(0.0, 1.0, -1.0, 0.0, 1.0, 0.0) == 1.0
    assert point_segment(4.0, 4.0, 1.0, 0.0, 1.0, 0.0) == 5.0
