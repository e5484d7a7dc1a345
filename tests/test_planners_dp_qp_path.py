"""Path: dynamic programming = brute force, the QP keeps its bounds, the Frenet transform is exact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from worlds import CAR, Other, along_x, curve, driving, frame, lanes, standing

from logs import Decision, DecisionKind, EgoState, Plan, ReferenceLine, SlGraph, SolverReport, Trajectory
from logs.kernel import FloatArray
from logs.route import find_route
from planners.dp_qp import corridor
from planners.dp_qp.appointment import Appointment
from planners.dp_qp.corridor import CorridorConfig, PathObstacle, Room, decide_sides, narrowed, path_obstacles, widened
from planners.dp_qp.path import MIN_REGULAR, Path, frenet_start, make_path, out_of_frame, states_on_path
from planners.dp_qp.path_dp import (
    COLLISION,
    OUTSIDE,
    SAMPLES,
    PathDpConfig,
    path_dp,
    path_dp_offset,
    path_dp_to_go,
    quintic,
    side_costs,
)
from planners.dp_qp.path_qp import MAX_DL, PathProblem, PathQp, PathQpConfig
from planners.dp_qp.path_stage import ChosenPath, PathConfig, PathStage
from planners.dp_qp.reference_line import Course, make_course
from planners.dp_qp.steering import COMFORT, bend_bounds, bounded, expected_speed

SEED = st.integers(0, 2**32 - 1)
OFFSET, SLOPE, BEND = st.floats(-3.0, 3.0), st.floats(-0.5, 0.5), st.floats(-0.1, 0.1)
WEIGHTS = np.array([0.05, 20.0, 500.0, 2.0, 1.0, 1.0])


def quintic_at(l0: float, dl0: float, ddl0: float, l1: float, length: float, d: FloatArray) -> FloatArray:
    """Rows l, l', l'' `(3, n)` of the quintic, by its definition as a polynomial."""
    polynomial = np.polynomial.Polynomial([l0, dl0, 0.5 * ddl0, *quintic(l0, dl0, ddl0, l1, length)])
    return np.array([polynomial(d), polynomial.deriv(1)(d), polynomial.deriv(2)(d)])


@given(OFFSET, SLOPE, BEND, OFFSET, st.floats(2.0, 40.0))
def test_the_quintic_meets_its_ends(l0: float, dl0: float, ddl0: float, l1: float, length: float) -> None:
    begin, end = quintic_at(l0, dl0, ddl0, l1, length, np.array([0.0, length])).T
    np.testing.assert_allclose(begin, (l0, dl0, ddl0), atol=1e-12)
    np.testing.assert_allclose(end, (l1, 0.0, 0.0), atol=1e-9)


def grid(seed: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Stations, offsets, start, boxes and corridor of a small random problem."""
    rng = np.random.default_rng(seed)
    stations = 10.0 * np.arange(1, 4) + rng.uniform(0.0, 3.0)
    start = np.array([0.0, rng.uniform(-1.5, 1.5), rng.uniform(-0.2, 0.2), rng.uniform(-0.02, 0.02)])
    s, l = rng.uniform(5.0, 30.0, 3), rng.uniform(-2.0, 2.0, 3)  # noqa: E741
    sides = rng.integers(-1, 2, 3)
    boxes = np.column_stack([s, s + rng.uniform(2.0, 8.0, 3), l, l + rng.uniform(0.2, 1.5, 3), sides])
    lower, upper = -rng.uniform(0.5, 2.5, (3, SAMPLES)), rng.uniform(0.5, 2.5, (3, SAMPLES))
    return stations, np.array([1.5, 0.5, -0.5, -1.5]), start, boxes, lower, upper


def edge_cost(
    first: FloatArray, s1: float, l1: float, boxes: FloatArray, lower: FloatArray, upper: FloatArray
) -> float:
    """Cost (2) of one edge, written down from the module's docstring."""
    s0, l0, dl0, ddl0 = first
    step = (s1 - s0) / SAMPLES
    d = step * np.arange(1, SAMPLES + 1)
    l, dl, ddl = quintic_at(l0, dl0, ddl0, l1, s1 - s0, d)  # noqa: E741
    total = WEIGHTS[0] * l**2 + WEIGHTS[1] * dl**2 + WEIGHTS[2] * ddl**2
    outside = np.maximum(0.0, np.maximum(lower - l, l - upper))
    total += np.where(outside > 0.0, OUTSIDE * (0.1 + outside), 0.0)
    for s_from, s_to, l_from, l_to, before in boxes:
        beside = (s_from <= s0 + d) & (s0 + d <= s_to)
        gap = np.maximum(l_from - l, l - l_to)
        near = WEIGHTS[3] * (1.0 - gap / WEIGHTS[4]) ** 2
        total += beside * np.where(gap < 0.0, COLLISION, np.where(gap < WEIGHTS[4], near, 0.0))
        total += beside * (before * (l - 0.5 * (l_from + l_to)) < 0.0) * WEIGHTS[5]
    return float(total.sum() * step)


@given(SEED)
@settings(max_examples=30)
def test_dynamic_programming_is_brute_force(seed: int) -> None:
    stations, offsets, start, boxes, lower, upper = grid(seed)
    cost, chosen = path_dp(stations, offsets, start, boxes, lower, upper, WEIGHTS)
    least = np.full((3, len(offsets)), np.inf)
    best = np.inf, ()
    for rows in product(range(len(offsets)), repeat=3):
        total, first = 0.0, start
        for i, row in enumerate(rows):
            total += edge_cost(first, stations[i], offsets[row], boxes, lower[i], upper[i])
            least[i, row] = min(least[i, row], total)
            first = np.array([stations[i], offsets[row], 0.0, 0.0])
        best = min(best, (total, rows))
    np.testing.assert_allclose(cost, least, rtol=1e-9)
    assert cost[-1].min() == pytest.approx(best[0], rel=1e-9)
    assert tuple(chosen) == best[1]


@given(SEED)
@settings(max_examples=30)
def test_what_comes_and_what_goes_add_up(seed: int) -> None:
    """The best path costs as much as the best through a node of any column, and as the better of two sides."""
    stations, offsets, start, boxes, lower, upper = grid(seed)
    cost, _ = path_dp(stations, offsets, start, boxes, lower, upper, WEIGHTS)
    through = cost + path_dp_to_go(stations, offsets, boxes, lower, upper, WEIGHTS)
    np.testing.assert_allclose(through.min(axis=1), cost[-1].min(), rtol=1e-9)
    sides = side_costs(stations, offsets, through, boxes)
    np.testing.assert_allclose(sides.min(axis=1), cost[-1].min(), rtol=1e-9)


@given(SEED)
@settings(max_examples=30)
def test_the_mirrored_grid_has_the_mirrored_solution(seed: int) -> None:
    stations, offsets, start, boxes, lower, upper = grid(seed)
    there = start * [1.0, -1.0, -1.0, -1.0], boxes[:, [0, 1, 3, 2, 4]] * [1.0, 1.0, -1.0, -1.0, -1.0]
    cost, chosen = path_dp(stations, offsets, start, boxes, lower, upper, WEIGHTS)
    cost_m, chosen_m = path_dp(stations, -offsets, there[0], there[1], -upper, -lower, WEIGHTS)
    np.testing.assert_array_equal(cost_m, cost)
    np.testing.assert_array_equal(chosen_m, chosen)


@pytest.mark.parametrize("passes_left", [True, False])
def test_a_tie_goes_to_the_passing_side(passes_left: bool) -> None:
    stations, free = np.array([10.0, 20.0, 30.0]), np.full((3, SAMPLES), 4.0)
    rows = PathDpConfig(rows=5, row_spacing_m=1.0).offsets(passes_left=passes_left)
    boxes = np.array([[14.0, 22.0, -1.2, 1.2, 0.0]])
    _, chosen = path_dp(stations, rows, np.zeros(4), boxes, -free, free, WEIGHTS)
    assert rows[chosen[1]] == (2.0 if passes_left else -2.0)


@given(SEED)
@settings(max_examples=20)
def test_the_dp_path_goes_through_its_nodes_and_is_smooth(seed: int) -> None:
    stations, offsets, start, boxes, lower, upper = grid(seed)
    chosen = path_dp(stations, offsets, start, boxes, lower, upper, WEIGHTS)[1]
    at = np.array([path_dp_offset(stations, offsets, chosen, start, s) for s in stations])
    np.testing.assert_allclose(at, offsets[chosen], atol=1e-9)
    fine = np.linspace(0.0, 50.0, 5001)
    l = np.array([path_dp_offset(stations, offsets, chosen, start, s) for s in fine])  # noqa: E741
    assert l[0] == start[1] and l[-1] == offsets[chosen[-1]]
    assert np.abs(np.diff(l, 2)).max() < 1e-4 * 0.5  # l'' stays below 0.5 1/m: no jump, no kink


def test_an_even_number_of_rows_is_refused() -> None:
    with pytest.raises(ValueError, match="odd"):
        PathDpConfig(rows=10)


LENGTH, SPEED = 90.0, 6.0
KNOTS = PathQpConfig().knots
LEADS = (0.0, CAR.axle_to_front)
MAX_RATE = 0.5


def path_problem(seed: int) -> PathProblem:
    """A start near the line and a corridor with two obstacles nudged, wide enough to be driven."""
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, LENGTH, KNOTS) + np.array(LEADS)[:, None]
    lower, upper = np.full(s.shape, -1.5), np.full(s.shape, 3.0)
    lower[(s > 30.0) & (s < 42.0)] = rng.uniform(-1.0, 1.5)
    upper[(s > 62.0) & (s < 74.0)] = rng.uniform(-0.8, 1.0)
    kappa = 0.01 * np.sin(s[0] / 20.0 + rng.uniform(0.0, 6.0))
    start = np.array([rng.uniform(-0.5, 0.5), rng.uniform(-0.05, 0.05), rng.uniform(-0.01, 0.01)])
    bend = bend_bounds(np.full(KNOTS, CAR.max_kappa), kappa, np.zeros(KNOTS))
    slope, rate = np.full((2, KNOTS), MAX_DL), np.full((2, KNOTS - 1), MAX_RATE)
    slope[0], rate[0] = -slope[0], -rate[0]
    return PathProblem(start, lower, upper, slope, bend, rate)


def cost_of(program: PathQp, x: FloatArray, middle: FloatArray) -> float:
    """J_1 + ... + J_5, written down from the module's docstring."""
    settle = max(1.2 * SPEED, 4.0)
    l, dl, ddl = x.reshape(3, -1)  # noqa: E741
    squares = (np.sum(v**2) for v in (l, dl, ddl, np.diff(ddl) / program.step, l - middle))
    weights = 1.0, (0.5 * settle) ** 2, settle**4, (0.7 * settle) ** 6, 0.1
    return float(sum(w * square for w, square in zip(weights, squares, strict=True)))


FAST, SURE = (PathQp(LENGTH, SPEED, LEADS, PathQpConfig(), solver) for solver in ("interior_point", "piqp"))


def points_of(x: FloatArray) -> FloatArray:
    """Offsets `(points, knots)` of the ego's points along a straight line."""
    l, dl, _ = x.reshape(3, -1)  # noqa: E741
    return np.asarray(l + np.array(LEADS)[:, None] * dl)


def assert_drivable(program: PathQp, x: FloatArray, problem: PathProblem, slack: float) -> None:
    l, dl, ddl = x.reshape(3, -1)  # noqa: E741
    h = program.step
    np.testing.assert_allclose((l[0], dl[0], ddl[0]), problem.start, atol=slack)
    inner = points_of(x)[:, 1:]
    assert (inner >= problem.lower[:, 1:] - slack).all() and (inner <= problem.upper[:, 1:] + slack).all()
    dddl = np.diff(ddl) / h
    for value, (low, high) in ((dl, problem.slope), (ddl, problem.bend), (dddl, problem.rate)):
        assert (value[1:] >= low[1:] - slack).all() and (value[1:] <= high[1:] + slack).all()
    np.testing.assert_allclose(dl[1:], dl[:-1] + h * ddl[:-1] + 0.5 * h**2 * dddl, atol=slack)
    steps = l[:-1] + h * dl[:-1] + 0.5 * h**2 * ddl[:-1] + h**3 / 6.0 * dddl
    np.testing.assert_allclose(l[1:], steps, atol=slack)


@given(SEED)
@settings(max_examples=25)
def test_the_path_qp_keeps_its_bounds_and_finds_the_least_cost(seed: int) -> None:
    problem = path_problem(seed)
    (fast, costs), (sure, _) = FAST.solve(problem), SURE.solve(problem)
    assert fast.report.solved and sure.report.solved and "PIQP" in sure.report.status
    assert_drivable(FAST, fast.x, problem, 1e-5)
    assert_drivable(SURE, sure.x, problem, 1e-6)
    middle = 0.5 * (problem.lower[0] + problem.upper[0])
    best, found = cost_of(SURE, sure.x, middle), cost_of(FAST, fast.x, middle)
    assert found == pytest.approx(best, rel=1e-5, abs=1e-5)
    assert sum(value for _, value in costs.terms) == pytest.approx(found, rel=1e-9)


@given(SEED, st.floats(0.0, 0.6), st.floats(0.0, 0.6))
@settings(max_examples=15)
def test_every_step_towards_another_path_of_the_corridor_costs_more(seed: int, low: float, high: float) -> None:
    """The variational inequality of a convex problem: what a narrower corridor allows is allowed, but not better."""
    problem = path_problem(seed)
    middle = 0.5 * (problem.lower[0] + problem.upper[0])
    best = SURE.solve(problem)[0]
    narrower = replace(problem, lower=problem.lower + low, upper=problem.upper - high)
    other = SURE.solve(narrower)[0]
    assume(other.report.solved)
    step = best.x + 1e-3 * (other.x - best.x)
    assert cost_of(SURE, step, middle) >= cost_of(SURE, best.x, middle) - 1e-7


def closed(seed: int) -> PathProblem:
    """A corridor that no path can keep."""
    problem = path_problem(seed)
    problem.lower[:, 40], problem.upper[:, 43] = 2.9, -1.4
    return problem


def test_a_closed_corridor_is_reported() -> None:
    assert not FAST.solve(closed(0))[0].report.solved


@given(SEED)
@settings(max_examples=10)
def test_a_softened_corridor_is_left_as_little_as_it_must(seed: int) -> None:
    """Where it is open hardly at all; where it is closed to both sides alike, and steering keeps its bounds."""
    free, _ = FAST.solve(path_problem(seed), softly=True)
    shut, _ = FAST.solve(closed(seed), softly=True)
    assert free.report.solved and shut.report.solved
    out = np.maximum(path_problem(seed).lower - points_of(free.x), points_of(free.x) - path_problem(seed).upper)
    assert out[:, 1:].max() < 0.05
    wide = np.full((2, KNOTS), 50.0)
    assert_drivable(FAST, shut.x, replace(closed(seed), lower=-wide, upper=wide), 1e-5)
    at = points_of(shut.x)
    assert 0.5 < (2.9 - at[:, 40]).max() < 4.3 and 0.5 < (at[:, 43] + 1.4).max() < 4.3


BENDS = st.lists(st.tuples(st.floats(15.0, 60.0), st.floats(-0.06, 0.06)), min_size=1, max_size=4)


def smooth_line(bends: list[tuple[float, float]]) -> ReferenceLine:
    """A line whose curvature is continuous: arcs with clothoids between them."""
    ends = np.cumsum([0.0, 20.0] + [length for length, _ in bends])
    kappa = np.interp(np.arange(0.0, ends[-1] + 20.0, 0.5), ends, [0.0, 0.0] + [k for _, k in bends])
    return ReferenceLine.through(curve(*[(0.5, float(k)) for k in kappa], step=0.5))


@given(BENDS, st.floats(-2.0, 2.0), st.floats(-0.6, 0.6), st.floats(-0.05, 0.05), st.floats(5.0, 60.0))
@settings(max_examples=60)
def test_frenet_there_and_back(
    bends: list[tuple[float, float]],
    l: float,  # noqa: E741
    dl: float,
    ddl: float,
    s0: float,
) -> None:
    line = smooth_line(bends)
    assume(s0 < line.length - 5.0)
    knots = np.array([[l, l + dl + 0.5 * ddl], [dl, dl + ddl], [ddl, ddl]])
    path = make_path(line, s0, 1.0, knots)
    state = EgoState(0.0, path.x[0], path.y[0], path.yaw[0] + 4.0 * np.pi, 5.0, 0.0, path.kappa[0])
    s, offset = line.project(state.x, state.y, s0, 5.0)
    assert out_of_frame(line, state, s, offset) == ""
    assert s == pytest.approx(s0, abs=1e-6)
    np.testing.assert_allclose(frenet_start(line, state, s, offset), (l, dl, ddl), atol=1e-6)


@given(BENDS, SEED)
@settings(max_examples=40)
def test_heading_and_curvature_are_those_of_the_points(bends: list[tuple[float, float]], seed: int) -> None:
    line = smooth_line(bends)
    rng = np.random.default_rng(seed)
    step, n = 0.25, round((line.length - 12.0) / 0.25)
    ddl = np.interp(step * np.arange(n), np.arange(0.0, 400.0, 15.0), rng.uniform(-0.02, 0.02, 27))
    dl = np.r_[0.0, np.cumsum(0.5 * step * (ddl[1:] + ddl[:-1]))]
    dl, ddl = dl * 0.2 / max(0.2, np.abs(dl).max()), ddl * 0.2 / max(0.2, np.abs(dl).max())
    l = np.r_[0.0, np.cumsum(step * dl[:-1] + step**2 * (ddl[:-1] / 3.0 + ddl[1:] / 6.0))]  # noqa: E741
    shrink = 2.0 / max(2.0, np.abs(l).max())
    path = make_path(line, 6.0, step, shrink * np.array([l, dl, ddl]))
    yaw = np.unwrap(np.arctan2(np.diff(path.y), np.diff(path.x)))
    middle = 0.5 * (path.yaw[1:] + path.yaw[:-1])
    np.testing.assert_allclose(yaw - 2.0 * np.pi * np.round((yaw[0] - middle[0]) / 2.0 / np.pi), middle, atol=2e-3)
    kappa = np.diff(path.yaw) / np.diff(path.sigma)
    np.testing.assert_allclose(kappa, 0.5 * (path.kappa[1:] + path.kappa[:-1]), atol=2e-3)


@given(st.floats(12.0, 80.0), st.booleans(), st.floats(-4.0, 4.0))
@settings(max_examples=30)
def test_a_constant_offset_from_a_circle_is_a_concentric_circle(radius: float, left: bool, offset: float) -> None:
    kappa = (1.0 if left else -1.0) / radius
    line = ReferenceLine.through(curve((4.0 * radius, kappa), step=0.5))
    n = int(2.0 * radius)
    path = make_path(line, radius, 1.0, np.vstack([np.full(n, offset), np.zeros((2, n))]))
    x, y, yaw, _ = line.frame(2.0 * radius)
    center = np.array([x - np.sin(yaw) / kappa, y + np.cos(yaw) / kappa])
    away = np.hypot(path.x - center[0], path.y - center[1])
    np.testing.assert_allclose(away, abs(1.0 / kappa - offset), atol=2e-3)
    np.testing.assert_allclose(path.kappa, kappa / (1.0 - kappa * offset), rtol=5e-3)


def arc(radius: float, length: float, spacing: float) -> Path:
    sigma = np.arange(0.0, length, spacing)
    yaw = sigma / radius
    x, y = radius * np.sin(yaw), radius * (1.0 - np.cos(yaw))
    return Path(sigma, x, y, yaw, np.full(len(sigma), 1.0 / radius), sigma)


def states(path: Path, stations: FloatArray) -> FloatArray:
    return states_on_path(path.sigma, path.x, path.y, path.yaw, path.kappa, stations)


@given(st.floats(5.0, 200.0), st.lists(st.floats(0.0, 29.0), min_size=1, max_size=20))
def test_states_between_the_points_lie_on_the_circle(radius: float, stations: list[float]) -> None:
    at = np.sort(stations)
    x, y, yaw, kappa = states(arc(radius, 30.0, 0.4), at)
    np.testing.assert_allclose(x, radius * np.sin(at / radius), atol=1e-4)
    np.testing.assert_allclose(y, radius * (1.0 - np.cos(at / radius)), atol=1e-4)
    np.testing.assert_allclose(yaw, at / radius, atol=1e-9)
    np.testing.assert_allclose(kappa, 1.0 / radius, rtol=1e-9)


def test_beyond_its_end_a_path_goes_straight_on() -> None:
    path = arc(20.0, 10.0, 0.5)
    x, y, yaw, kappa = states(path, np.array([path.length, path.length + 3.0]))
    assert np.hypot(x[1] - x[0], y[1] - y[0]) == pytest.approx(3.0)
    assert yaw[1] == yaw[0] == path.yaw[-1] and kappa[1] == 0.0


def test_where_the_frame_ends_it_says_why() -> None:
    line = ReferenceLine.through(curve((60.0, 0.1)))
    x, y, yaw, _ = line.frame(30.0)
    assert "120 degrees" in out_of_frame(line, EgoState(0.0, x, y, yaw + np.radians(120.0), 5.0), 30.0, 0.0)
    assert "centre" in out_of_frame(line, EgoState(0.0, x, y, yaw, 5.0), 30.0, 9.5)
    assert out_of_frame(line, EgoState(0.0, x, y, yaw + np.radians(-60.0), 5.0), 30.0, 8.0) == ""


def course(points: FloatArray, count: int = 1) -> Course:
    road, ego = lanes(points, count), EgoState(0.0, 0.0, 0.0, 0.0, 8.0)
    return make_course(road, find_route(road, ego, None), ego)


STRAIGHT, LEFT_TURN = course(along_x()), course(curve((30.0, 0.0), (60.0, 1.0 / 30.0), (60.0, 0.0)))
SIDE = 0.5 * CAR.width
CONFIG = CorridorConfig()


@given(st.floats(20.0, 70.0), st.floats(-2.5, 2.5), st.floats(-3.0, 3.0), st.floats(1.0, 25.0), st.floats(0.5, 2.5))
@settings(max_examples=40)
def test_the_box_of_an_obstacle_holds_its_outline(s: float, l: float, yaw: float, length: float, width: float) -> None:  # noqa: E741
    line = LEFT_TURN.line
    x, y = line.point(s, l)
    other = standing("it", x, y, yaw, length=length, width=width)
    found = path_obstacles(LEFT_TURN, frame(EgoState(0.0, 0.0, 0.0, 0.0, 8.0), [other]), 0.0, 130.0, CAR)
    assume(found)
    u = np.linspace(-0.5, 0.5, 41)
    along, across = np.meshgrid(length * u, width * u)
    inner = x + along * np.cos(yaw) - across * np.sin(yaw), y + along * np.sin(yaw) + across * np.cos(yaw)
    feet = np.array([line.project(a, b, s, 40.0) for a, b in zip(*(v.ravel() for v in inner), strict=True)])
    box, slack = found[0], 0.02 + length**2 / 960.0  # (length / 2)^2 / 8 R: sides are tested at their middles
    assert box.s_from <= feet[:, 0].min() + slack and box.s_to >= feet[:, 0].max() - slack
    assert box.l_from <= feet[:, 1].min() + slack and box.l_to >= feet[:, 1].max() - slack


def test_only_who_stands_on_the_road_ahead_is_an_obstacle() -> None:
    others = [
        standing("ahead", 40.0, 0.0),
        standing("kerb", 40.0, -3.0),
        standing("field", 40.0, -6.0),
        standing("behind", -20.0, 0.0),
        standing("far", 300.0, 0.0),
        driving("moving", 30.0, 0.0, 3.0),
    ]
    found = path_obstacles(STRAIGHT, frame(EgoState(0.0, 0.0, 0.0, 0.0, 8.0), others), 50.0, 130.0, CAR)
    assert [box.agent for box in found] == ["ahead", "kerb"]


def room(lower: float = -1.0, upper: float = 1.0, step: float = 1.0, length: float = 100.0) -> Room:
    s = np.arange(0.0, length, step) + np.array(LEADS)[:, None]
    return Room(s, np.full(s.shape, lower), np.full(s.shape, upper))


def test_the_room_ends_short_of_the_centre_of_a_turn() -> None:
    tight = course(np.array(curve((30.0, 0.0), (20.0, 0.25), (30.0, 0.0), step=0.5)), 2)
    s = np.arange(0.0, 80.0, 1.0)
    free = corridor.room(tight, s, np.ones(len(s)), left_free=True, right_free=True, vehicle=CAR, config=CONFIG)
    kappa = np.interp(s, tight.line.s, tight.line.kappa)
    assert (1.0 - kappa * free.upper).min() >= MIN_REGULAR - 1e-9 and (free.lower < free.upper).all()
    assert free.upper.max() > 4.0 > 3.7 > free.upper[np.argmax(kappa)]


GOES_LEFT, GOES_RIGHT = 5.0, -5.0


@given(st.floats(-4.0, 4.0), st.floats(0.3, 2.0), st.sampled_from([GOES_LEFT, GOES_RIGHT]), st.floats(0.5, 4.0))
def test_a_side_is_taken_only_where_there_is_room(middle: float, width: float, aim: float, step: float) -> None:
    """And the corridor that it leaves keeps the clearance along the whole obstacle, whatever the knots' spacing."""
    box = PathObstacle("it", 40.0, 44.5, middle - 0.5 * width, middle + 0.5 * width)
    space = room(-2.0, 3.0, step)
    decisions = decide_sides((box,), np.array([aim]), np.zeros((1, 2)), space, CAR, CONFIG)
    narrow, (final,) = narrowed(space, (box,), decisions, CAR, CONFIG)
    lower, upper = narrow.lower, narrow.upper
    left, right = 3.0 - box.l_to - SIDE, box.l_from - SIDE + 2.0
    before, after = 0.5 * CAR.axle_to_front + step, max(0.5 * CAR.axle_to_front, CAR.rear_overhang) + step
    beside = (space.s > 40.0 - before) & (space.s < 44.5 + after)
    assert (lower <= upper).all()
    if final.kind is DecisionKind.NUDGE_LEFT:
        assert (lower[beside] >= box.l_to + SIDE + min(CONFIG.clearance_m, left - 0.02) - 1e-9).all()
        assert left >= CONFIG.min_clearance_m and (aim == GOES_LEFT or right < CONFIG.min_clearance_m)
    elif final.kind is DecisionKind.NUDGE_RIGHT:
        assert (upper[beside] <= box.l_from - SIDE - min(CONFIG.clearance_m, right - 0.02) + 1e-9).all()
        assert right >= CONFIG.min_clearance_m and (aim == GOES_RIGHT or left < CONFIG.min_clearance_m)
    elif final.kind is DecisionKind.STOP:
        assert max(left, right) < CONFIG.min_clearance_m and "no room" in final.reason
    else:
        assert final.kind is DecisionKind.IGNORE
        assert box.l_to + SIDE + CONFIG.clearance_m <= -2.0 or box.l_from - SIDE - CONFIG.clearance_m >= 3.0


def test_two_obstacles_that_close_the_corridor_are_a_stop() -> None:
    boxes = PathObstacle("right", 40.0, 44.0, -2.0, -0.2), PathObstacle("left", 40.0, 44.0, 0.2, 2.0)
    decisions = (
        Decision("right", DecisionKind.NUDGE_LEFT, "path", ""),
        Decision("left", DecisionKind.NUDGE_RIGHT, "path", ""),
    )
    narrow, final = narrowed(room(), boxes, decisions, CAR, CONFIG)
    assert DecisionKind.STOP in {decision.kind for decision in final}
    assert (narrow.lower <= narrow.upper).all()


@given(OFFSET, SLOPE, BEND, st.floats(0.0, 20.0))
def test_the_room_is_widened_for_an_ego_outside_of_it(l0: float, dl0: float, ddl0: float, speed: float) -> None:
    space = room()
    wide = widened(space, (l0, dl0, ddl0), speed)
    assert wide.lower[0, 0] <= l0 <= wide.upper[0, 0]
    assert (wide.lower <= space.lower).all() and (wide.upper >= space.upper).all()
    far = space.s > max(12.0, 2.5 * speed) + 1.0
    np.testing.assert_array_equal(wide.lower[far], space.lower[far])


@given(OFFSET, SLOPE, BEND, st.floats(1.0, 25.0), SEED)
@settings(max_examples=30)
def test_a_corridor_loosened_to_the_reach_can_be_kept(l0: float, dl0: float, ddl0: float, v: float, seed: int) -> None:
    """Whatever one bound asks for, with the lateral acceleration and the steering rate of the speed."""
    rng = np.random.default_rng(seed)
    s, leads = np.linspace(0.0, LENGTH, KNOTS), np.array(LEADS)[:, None]
    upper = np.interp(s + leads, np.linspace(0.0, LENGTH, 8), rng.uniform(0.2, 4.0, 8))
    start, none = np.array([l0, dl0, ddl0]), np.zeros(KNOTS)
    bend, rate, left, right = bounded(start, v, none + 30.0, none, none, FAST.step, TURNS, COMFORT)
    slope = np.array([np.minimum(-MAX_DL, left[1]), np.maximum(MAX_DL, right[1])])
    high = np.maximum(upper, right[0] + leads * right[1])
    result, _ = SURE.solve(PathProblem(start, 0.0 * high - 90.0, high, slope, bend, rate))
    assert result.report.solved


TURNS = np.array([CAR.max_kappa, CAR.max_steer_rate / CAR.wheelbase])


@given(st.floats(0.5, 30.0), st.floats(1.0, 40.0), st.floats(-0.2, 0.2))
def test_the_expected_speed_brakes_for_curves_as_hard_as_it_may(v0: float, limit: float, kappa: float) -> None:
    bends = np.r_[np.zeros(20), np.full(20, kappa), np.zeros(20)]
    v = expected_speed(v0, np.full(60, limit), bends, 1.0, 1.8, 3.0, 3.0)
    assert v[0] == v0 and (np.diff(v**2) <= 2.0 * 1.8 + 1e-9).all() and (np.diff(v**2) >= -2.0 * 3.0 - 1e-9).all()
    slow_enough = v**2 * np.abs(bends) <= 3.0 + 1e-9
    braking = np.r_[True, np.diff(v**2) < -6.0 + 1e-6]
    assert (slow_enough | braking).all()


def test_nobody_may_move_on_a_lane_that_is_borrowed() -> None:
    two = course(along_x(), 2)
    ego = EgoState(0.0, 0.0, 0.0, 0.0, 8.0)

    def free(*others: object) -> tuple[bool, bool]:
        return corridor.free_sides(two, frame(ego, others), 50.0, CONFIG)  # type: ignore[arg-type]

    assert free() == (True, True)
    assert free(driving("beside", -20.0, 3.5, 9.0)) == (False, True)
    assert free(driving("own lane", 30.0, 0.0, 5.0)) == (True, True)
    assert free(driving("far behind", -60.0, 3.5, 9.0)) == (True, True)
    assert free(standing("parked", 20.0, 3.5)) == (True, True)


def test_a_lane_is_borrowed_only_beside_an_obstacle() -> None:
    s = np.arange(0.0, 200.0, 1.0)
    box = PathObstacle("it", 100.0, 104.5, -2.0, 0.0)
    used = s[corridor.borrowed((box,), s, 4.0, CAR) > 0.0]
    assert used.min() == pytest.approx(100.0 - CAR.axle_to_front - 15.0, abs=1.0)
    assert used.max() == pytest.approx(104.5 + CAR.rear_overhang + 15.0, abs=1.0)


# The stage as a whole.


def stage(along: Course, *, passes_left: bool = True) -> PathStage:
    return PathStage(
        along,
        CAR,
        PathConfig(),
        Appointment(None, along, CAR),
        horizon=8.0,
        passes_left=passes_left,
        lap=lambda _: None,
    )


def chosen(along: Course, ego: EgoState, others: Sequence[Other] = (), previous: Plan | None = None) -> ChosenPath:
    """The path of a fresh stage."""
    s, l = along.line.project(ego.x, ego.y)  # noqa: E741
    return stage(along).choose(frame(ego, others, previous=previous), ego, s, l, fresh=True)


def graph_of(found: ChosenPath) -> SlGraph:
    return next(item for item in found.artefacts if isinstance(item, SlGraph))


def outside(along: Course, found: ChosenPath) -> FloatArray:
    """By how much each corner of the ego is outside the reported corridor along the path `(points, 4)`, m.

    Beyond its end, which a corner in front of the rear axle passes before the path ends, there is no corridor: -inf.
    """
    path, corridor_ = found.path, graph_of(found).corridor
    assert path is not None and corridor_ is not None
    lost = []
    for x, y, yaw, s in zip(path.x, path.y, path.yaw, path.s, strict=True):
        for ahead in (CAR.axle_to_front, -CAR.rear_overhang):
            for side in (SIDE, -SIDE):
                at = x + ahead * np.cos(yaw) - side * np.sin(yaw), y + ahead * np.sin(yaw) + side * np.cos(yaw)
                there, l = along.line.project(*at, s + ahead, 8.0)  # noqa: E741
                low, high = (np.interp(there, corridor_.first, v) for v in (corridor_.lower, corridor_.upper))
                lost.append(max(low - SIDE - l, l - high - SIDE) if there <= corridor_.first[-1] else -np.inf)
    return np.reshape(lost, (-1, 4))


ROADS = st.lists(st.tuples(st.floats(15.0, 50.0), st.floats(-0.1, 0.1)), min_size=1, max_size=4)
PARKED = st.lists(st.tuples(st.floats(15.0, 90.0), st.floats(-3.0, 3.0), st.floats(-0.4, 0.4)), max_size=3)


def world(bends: list[tuple[float, float]], parked: list[tuple[float, float, float]]) -> tuple[Course, list[Other]]:
    """Two lanes along a winding road, the first the course's, and others standing at (s, l, yaw)."""
    ends = np.cumsum([0.0, 30.0] + [length for length, _ in bends])
    kappa = np.interp(np.arange(0.0, ends[-1] + 150.0), ends, [0.0, 0.0] + [k for _, k in bends])
    along = course(curve(*[(1.0, float(k)) for k in kappa]), 2)
    others = []
    for i, (s, l, turn) in enumerate(parked):  # noqa: E741
        x, y, yaw, _ = (*along.line.point(s, l), *along.line.frame(s)[2:])
        others.append(standing(f"parked {i}", x, y, yaw + turn))
    return along, others


@given(ROADS, PARKED, st.floats(0.5, 14.0), st.floats(-0.4, 0.4))
@settings(max_examples=60, deadline=None)
def test_the_corners_of_the_ego_stay_in_the_corridor(
    bends: list[tuple[float, float]], parked: list[tuple[float, float, float]], v: float, aside: float
) -> None:
    """All along the path, up to what lies between two knots."""
    along, others = world(bends, parked)
    x, y, yaw, kappa = (*along.line.point(5.0, aside), *along.line.frame(5.0)[2:])
    found = chosen(along, EgoState(0.0, x, y, yaw, v, 0.0, kappa), others)
    assert found.path is not None and not found.reason
    if any(report.stage != "path QP" for report in found.artefacts if isinstance(report, SolverReport)):
        return  # the corridor could not be kept
    assert outside(along, found).max() <= 0.2


THREE = lanes(along_x(), 3)
MIDDLE = make_course(
    THREE, find_route(THREE, EgoState(0.0, 30.0, 3.5, 0.0, 8.0), None), EgoState(0.0, 30.0, 3.5, 0.0, 8.0)
)


def side_taken(l: float, previous: Plan | None, weights: PathDpConfig, v: float) -> tuple[DecisionKind, Plan]:  # noqa: E741
    """The decision about a narrow obstacle `l` m left of the middle of three lanes, and a plan that holds it."""
    ego = EgoState(0.0, 30.0, 3.5, 0.0, v)
    s, l0 = MIDDLE.line.project(ego.x, ego.y)
    once = PathStage(
        MIDDLE,
        CAR,
        PathConfig(weights),
        Appointment(None, MIDDLE, CAR),
        horizon=8.0,
        passes_left=True,
        lap=lambda _: None,
    )
    found = once.choose(
        frame(ego, [standing("it", 60.0, 3.5 + l, width=0.8)], previous=previous), ego, s, l0, fresh=True
    )
    (decision,) = (item for item in found.artefacts if isinstance(item, Decision))
    return decision.kind, Plan(Trajectory(*(np.array([0.0, 8.0]) for _ in range(7))), internals=found.artefacts)


@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(3.0, 9.0))
@settings(max_examples=25, deadline=None)
def test_the_side_does_not_change_while_nothing_changes(l: float, then: float, v: float) -> None:  # noqa: E741
    """It may be seen a little further to one side in the next frame."""
    first, plan = side_taken(l, None, PathDpConfig(), v)
    assert first in corridor.NUDGES
    assert side_taken(then, plan, PathDpConfig(), v)[0] is first


def test_without_memory_the_side_does_change() -> None:
    """That is: the law above can fail."""
    forgetful = PathDpConfig(w_switch=0.0)
    first, plan = side_taken(-0.15, None, forgetful, 8.0)
    assert side_taken(0.15, plan, forgetful, 8.0)[0] is not first


def test_a_good_reason_changes_the_side() -> None:
    first, plan = side_taken(-0.1, None, PathDpConfig(), 8.0)
    assert first is DecisionKind.NUDGE_LEFT
    assert side_taken(1.2, plan, PathDpConfig(), 8.0)[0] is DecisionKind.NUDGE_RIGHT


@given(st.floats(12.0, 70.0), st.floats(-1.5, 1.5), st.floats(2.0, 16.0))
@settings(max_examples=30, deadline=None)
def test_a_swerve_needs_no_more_than_comfortable_lateral_acceleration(ahead: float, l: float, v: float) -> None:  # noqa: E741
    """Nor more than the lock, nor a faster turn of the wheels, at the speed that may be expected."""
    ego = EgoState(0.0, 30.0, 3.5, 0.0, v)
    found = chosen(MIDDLE, ego, [standing("it", 30.0 + ahead, 3.5 + l)])
    assert found.path is not None
    assume(all(item.stage == "path QP" for item in found.artefacts if isinstance(item, SolverReport)))
    way, none = found.path, np.zeros(len(found.path.sigma))
    fast = expected_speed(v, none + 13.89, none, float(way.s[1] - way.s[0]), 1.8, 3.0, 3.0)
    slow = np.maximum(np.interp(way.s - 2.0, way.s, fast), 1.0)  # bounds hold at knots, up to 2 m apart
    assert (np.abs(way.kappa) <= np.minimum(4.0 / np.minimum(slow, fast) ** 2, CAR.max_kappa) * 1.1 + 2e-3).all()
    turned = np.abs(np.diff(way.kappa) / np.diff(way.sigma))
    assert (turned <= 1.2 * TURNS[1] / np.maximum(np.minimum(slow, fast)[1:], 1.0) + 2e-3).all()


def test_an_obstacle_too_near_to_swerve_is_a_stop() -> None:
    """At 14 m/s, 8 m before the bumper: the path cannot clear it, says so, and the speed stage meets it."""
    found = chosen(MIDDLE, EgoState(0.0, 30.0, 3.5, 0.0, 14.0), [standing("it", 44.0, 3.5)])
    decisions = [item for item in found.artefacts if isinstance(item, Decision)]
    assert [item.kind for item in decisions] == [DecisionKind.STOP] and "steering cannot" in decisions[0].reason
    assert found.path is not None and not found.passed


def test_a_path_ends_where_the_lane_turns_beyond_the_lock() -> None:
    """A hairpin of 2.6 m in a lane of 3 m: driven to its beginning."""
    hairpin = course(curve((60.0, 0.0), (8.0, 1.0 / 2.6), (60.0, 0.0), step=0.5))
    found = chosen(hairpin, EgoState(0.0, 0.0, 0.0, 0.0, 5.0))
    assert found.path is not None
    beyond = found.path.sigma > 5.0
    assert np.abs(found.path.kappa[beyond]).max() <= 1.06 * CAR.max_kappa
