"""Speed: swept boxes and dynamic programming = brute force, the QP keeps its bounds, braking obeys its limits."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from worlds import CAR, Other, along_x, driving, frame, lanes, standing

from logs import AgentKind, DecisionKind, EgoState
from logs.kernel import FloatArray
from logs.route import find_route
from logs.shapes import overlap
from planners.dp_qp.path import Path
from planners.dp_qp.reference_line import make_course
from planners.dp_qp.speed_dp import COLLISION, DS_M, cost_map, speed_dp
from planners.dp_qp.speed_qp import (
    STEP_S,
    Limits,
    SpeedLimits,
    SpeedProblem,
    SpeedQp,
    SpeedQpConfig,
    braking,
    cruising,
    limit_profile,
)
from planners.dp_qp.st_graph import Blocks, StGraphConfig, behind, block_intervals, decide_speed

SEED = st.integers(0, 2**32 - 1)
CONFIG = SpeedQpConfig()
AS_PREDICTED = StGraphConfig(early_s=0.0, late_s=0.0)
EGO = EgoState(0.0, 0.0, 0.0, 0.0, 8.0)


def path_of(kappa: FloatArray, spacing: float) -> Path:
    """A path through the origin from curvatures at points `spacing` m apart."""
    sigma = spacing * np.arange(len(kappa))
    yaw = np.r_[0.0, np.cumsum(0.5 * spacing * (kappa[1:] + kappa[:-1]))]
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    x, y = (np.r_[0.0, np.cumsum(spacing * rate)] for rate in (np.cos(middle), np.sin(middle)))
    return Path(sigma, x, y, yaw, kappa, sigma)


def turning(radius: float, angle: float = 2.0, spacing: float = 0.4) -> Path:
    """Straight for 15 m, a turn by `angle` rad or 40 m long, straight again."""
    turn = min(radius * angle, 40.0)
    s = np.arange(0.0, 15.0 + turn + 30.0, spacing)
    return path_of(np.where((s > 15.0) & (s < 15.0 + turn), 1.0 / radius, 0.0), spacing)


STRAIGHT = path_of(np.zeros(301), 0.4)


def blocks_of(path: Path, other: Other, config: StGraphConfig = AS_PREDICTED, *, passed: bool = False) -> Blocks:
    skip = np.zeros(1, np.bool_)
    return block_intervals(path, frame(EGO, [other]), CAR, skip, frozenset({other.id} if passed else ()), config)


def met(path: Path, other: Other, t: float, margin: float) -> FloatArray:
    """The stations of the path's points at which the ego's box, widened, overlaps the other's at time t."""
    x, y, yaw, _, _ = other.at(t)
    reach = CAR.axle_to_center
    found = [
        sigma
        for sigma, px, py, a in zip(path.sigma, path.x, path.y, path.yaw, strict=True)
        if overlap(
            px + reach * np.cos(a), py + reach * np.sin(a), a, CAR.length, CAR.width + 2.0 * margin,
            x, y, yaw, other.length, other.width,
        )
    ]  # fmt: skip
    return np.array(found)


@st.composite
def crossings(draw: st.DrawFn) -> tuple[Path, Other]:
    """A path with a turn of any tightness, and somebody who passes near it at some time."""
    path = turning(draw(st.sampled_from([4.0, 8.0, 15.0, 40.0, 1e6])), draw(st.floats(0.5, 3.0)))
    i = draw(st.integers(0, len(path.sigma) - 1))
    course, speed = draw(st.floats(-np.pi, np.pi)), draw(st.floats(0.0, 20.0))
    when = draw(st.floats(0.0, 8.0))
    vx, vy = speed * np.cos(course), speed * np.sin(course)
    x, y = path.x[i] + draw(st.floats(-6.0, 6.0)) - when * vx, path.y[i] + draw(st.floats(-6.0, 6.0)) - when * vy
    length, width = draw(st.sampled_from([(4.5, 1.8), (0.5, 0.6), (14.0, 2.5)]))
    return path, Other("it", lambda t: (x + vx * t, y + vy * t, course, vx, vy), length=length, width=width)


@given(crossings())
@settings(max_examples=40)
def test_blocked_intervals_are_where_the_boxes_overlap(crossing: tuple[Path, Other]) -> None:
    path, other = crossing
    blocks = blocks_of(path, other)
    for k, t in enumerate(0.1 * np.arange(81)):
        stations = met(path, other, float(t), AS_PREDICTED.margin_m)
        if not len(stations):
            assert not len(blocks) or np.isnan(blocks.lower[0, k])
            continue
        assert max(stations[0] - 0.4, 0.0) - 1e-9 <= blocks.lower[0, k] <= stations[0]
        assert stations[-1] <= blocks.upper[0, k] <= min(stations[-1] + 0.4, path.length) + 1e-9


@given(crossings(), st.floats(0.0, 0.5), st.floats(0.0, 0.5))
@settings(max_examples=30)
def test_a_wider_margin_blocks_more(crossing: tuple[Path, Other], first: float, more: float) -> None:
    path, other = crossing
    narrow, wide = (
        blocks_of(path, other, StGraphConfig(margin_m=margin, early_s=0.0, late_s=0.0))
        for margin in (first, first + more)
    )
    assert len(narrow) <= len(wide)
    if len(narrow):
        blocked = np.isfinite(narrow.lower[0])
        assert (wide.lower[0, blocked] <= narrow.lower[0, blocked]).all()
        assert (wide.upper[0, blocked] >= narrow.upper[0, blocked]).all()


@given(crossings())
@settings(max_examples=30)
def test_uncertain_times_only_add_to_a_block(crossing: tuple[Path, Other]) -> None:
    sure, drawn = blocks_of(*crossing), blocks_of(*crossing, StGraphConfig())
    assert len(sure) == len(drawn)
    if len(sure):
        blocked = np.isfinite(sure.lower)
        np.testing.assert_array_equal(drawn.lower[blocked], sure.lower[blocked])
        extra = drawn.t[np.isfinite(drawn.lower[0]) & ~blocked[0]]
        times = sure.t[blocked[0]]
        assert ((extra > times[0] - 0.4 - 1e-9) & (extra < times[-1] + 0.6 + 1e-9)).all()


def test_margins_depend_on_who_it_is() -> None:
    beside = 0.5 * CAR.width + 0.9
    assert len(blocks_of(STRAIGHT, standing("car", 30.0, beside + 0.29))) == 1
    assert len(blocks_of(STRAIGHT, standing("car", 30.0, beside + 0.31))) == 0
    assert len(blocks_of(STRAIGHT, standing("car", 30.0, beside + 0.11), passed=True)) == 0
    walker = Other("ped", lambda t: (30.0, beside + 0.59, 0.0, 0.0, 0.0), AgentKind.PEDESTRIAN)
    assert len(blocks_of(STRAIGHT, walker)) == 1


def test_the_speed_along_the_path_is_the_projection_of_the_velocity() -> None:
    assert blocks_of(STRAIGHT, driving("lead", 20.0, 0.0, 5.0)).speed[0] == pytest.approx(5.0)
    assert blocks_of(STRAIGHT, driving("oncoming", 70.0, 0.0, -5.0)).speed[0] == pytest.approx(-5.0)
    assert blocks_of(STRAIGHT, driving("crossing", 20.0, -6.0, 0.0, 3.0)).speed[0] == pytest.approx(0.0, abs=1e-9)


def test_who_follows_is_not_in_the_way() -> None:
    road = lanes(along_x(), 2)
    course = make_course(road, find_route(road, EGO, None), EGO)
    others = [
        driving("follower", -12.0, 0.0, 9.0),
        driving("beside, behind", -12.0, 3.5, 9.0),
        driving("lead", 12.0, 0.0, 5.0),
        driving("oncoming from behind", -12.0, 0.0, -1.0),
    ]
    for keeps_track, expected in ((True, [True, True, False, False]), (False, [True, False, False, False])):
        assert behind(course, frame(EGO, others), 50.0, 0.0, CAR, keeps_track=keeps_track).tolist() == expected


@given(SEED)
@settings(max_examples=30)
def test_the_cost_map_is_its_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lower = rng.uniform(-2.0, 20.0, (3, 5))
    upper = lower + rng.uniform(0.0, 6.0, (3, 5))
    lower[rng.random((3, 5)) < 0.3] = np.nan
    speed, gap, wanted, near = rng.uniform(-5.0, 5.0, 3), 1.0, np.array([3.0, 1.2]), 30.0
    found = cost_map(50, lower, upper, speed, gap, wanted, near)
    expected = np.zeros((5, 50))
    for i, k, row in product(range(3), range(5), range(50)):
        s, space = DS_M * row, 3.0 + 1.2 * max(speed[i], 0.0)
        free = max(lower[i, k] - s, s - upper[i, k])
        if free < gap:
            expected[k, row] += COLLISION
        elif free < space:
            expected[k, row] += near * (1.0 - free / space) ** 2
    np.testing.assert_allclose(found, expected, atol=1e-9)


def edge(
    rows: tuple[int, int], column: int, before: tuple[float, float], occupancy: FloatArray, limit: FloatArray,
    weights: FloatArray, per_column: int,
) -> tuple[float, float, float]:  # fmt: skip
    """Cost (1) of one edge, its speed and acceleration, written down from the module's docstring."""
    j, k = rows
    v = (k - j) * DS_M
    a, over = v - before[0], max(v - limit[k], 0.0)
    lost = max(1.0 - sum(DS_M / (0.5 * (limit[n] + limit[n + 1])) for n in range(j, k)), 0.0)
    cost = weights[0] * lost + weights[5] * over**2 + weights[1] * a**2 + weights[2] * (a - before[1]) ** 2
    samples = [
        occupancy[column * per_column + n, int(j + (k - j) * n / per_column + 0.5)] for n in range(1, per_column + 1)
    ]
    return cost + float(np.mean(samples)), v, a


def speed_grid(seed: int, rows: int = 9, columns: int = 3) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Map, limit and start of a small random problem, five samples to a column."""
    rng = np.random.default_rng(seed)
    occupancy = 20.0 * rng.random((5 * columns + 1, rows)) * (rng.random((5 * columns + 1, rows)) < 0.4)
    return occupancy, rng.uniform(0.5, 3.0, rows), np.array([rng.uniform(0.0, 2.0), rng.uniform(-1.0, 1.0)])


@given(SEED)
@settings(max_examples=25)
def test_dynamic_programming_is_brute_force(seed: int) -> None:
    """Without weights on acceleration and jerk the problem is Markov, so that nothing is cheaper than the DP."""
    occupancy, limit, start = speed_grid(seed)
    weights = np.array([30.0, 0.0, 0.0, 100.0, 100.0, 3.0])
    cost, chosen = speed_dp(occupancy, 5, limit, start, weights, 3)
    best = np.inf, ()
    for rows in product(range(9), repeat=3):
        if sorted(rows) != list(rows):
            continue
        total, now = 0.0, (start[0], start[1])
        for i, step in enumerate(zip((0, *rows), rows, strict=False)):
            price, *now = edge(step, i, tuple(now), occupancy, limit, weights, 5)  # type: ignore[arg-type]
            total += price
        best = min(best, (total, rows))
    assert cost[-1].min() == pytest.approx(best[0], rel=1e-12)
    assert tuple(chosen[1:]) == best[1]


@given(SEED)
@settings(max_examples=40)
def test_the_chosen_way_costs_what_the_grid_says(seed: int) -> None:
    """With all weights; and it keeps to the accelerations that an edge may have."""
    occupancy, limit, start = speed_grid(seed, rows=16, columns=4)
    weights = np.array([30.0, 1.0, 0.5, 2.0, 7.0, 3.0])
    cost, chosen = speed_dp(occupancy, 5, limit, start, weights, 4)
    total, now = 0.0, (float(start[0]), float(start[1]))
    assert chosen[0] == 0
    for i, step in enumerate(pairwise(chosen)):
        assert -7.0 - 1e-9 <= (step[1] - step[0]) * DS_M - now[0] <= 2.0 + 1e-9
        price, *rest = edge((int(step[0]), int(step[1])), i, now, occupancy, limit, weights, 5)
        now, total = (rest[0], rest[1]), total + price
        assert cost[i + 1, step[1]] == pytest.approx(total, rel=1e-9)
    assert cost[-1].min() == pytest.approx(total, rel=1e-9)


@given(st.floats(3.0, 15.0), st.floats(0.0, 20.0), st.floats(0.0, 60.0), st.floats(0.3, 1.2))
@settings(max_examples=40)
def test_a_faster_road_ahead_does_not_hold_the_ego_back(slow: float, faster: float, where: float, share: float) -> None:
    """An empty road on which the limit rises is driven about as far as one on which it does not, or farther."""
    rows, weights = 300, np.array([30.0, 1.0, 0.5, 2.0, 7.0, 3.0])
    free, start = np.zeros((41, rows)), np.array([share * slow, 0.0])
    level = np.full(rows, slow)
    rising = np.where(DS_M * np.arange(rows) < where, slow, slow + faster)
    ends = [speed_dp(free, 5, limit, start, weights, 8)[1][-1] for limit in (level, rising)]
    assert ends[1] >= 0.85 * ends[0] - 1.0


def test_a_tie_goes_to_the_smaller_station() -> None:
    free = np.zeros((16, 5))
    _, chosen = speed_dp(free, 5, np.full(5, 1.25), np.zeros(2), np.array([0.0, 0.0, 0.0, 9.0, 9.0, 0.0]), 3)
    assert chosen.tolist() == [0, 0, 0, 0]


KAPPA = st.lists(st.floats(-0.2, 0.2), min_size=2, max_size=8)
LIMIT = st.lists(st.floats(0.0, 20.0), min_size=2, max_size=8)


def profile(kappa: list[float], limit: list[float]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Stations, curvature, limit and the profile (2) of them."""
    sigma = 0.5 * np.arange(300)
    k, v = (np.interp(sigma, np.linspace(0.0, 150.0, len(values)), values) for values in (kappa, limit))
    return sigma, k, v, limit_profile(sigma, k, v, 3.0, 1.5)


@given(KAPPA, LIMIT)
def test_the_limit_profile_keeps_every_limit_and_can_be_driven(kappa: list[float], limit: list[float]) -> None:
    sigma, k, allowed, v = profile(kappa, limit)
    assert (v <= allowed + 1e-12).all() and (v**2 * np.abs(k) <= 3.0 + 1e-9).all()
    falling = -np.diff(v**2) / (2.0 * np.diff(sigma))
    assert falling.max() <= 1.5 + 1e-9
    own = np.minimum(allowed, np.sqrt(3.0 / np.maximum(np.abs(k), 1e-9)))
    lowered = np.flatnonzero(v[:-1] < own[:-1] - 1e-9)  # lowered only as far as the deceleration asks for
    np.testing.assert_allclose(falling[lowered], 1.5, atol=1e-9)


@given(KAPPA, LIMIT, st.floats(0.0, 1.0))
def test_cruising_follows_the_limit(kappa: list[float], limit: list[float], share: float) -> None:
    """Less than 1 m/s late where the limit bends down; at a constant limit it stays there."""
    sigma, _, _, v_limit = profile(kappa, limit)
    s, v = cruising(sigma, v_limit, share * v_limit[0], 0.0, 1.8, 3.0, 3.0, STEP_S, 81)
    assert (v >= 0.0).all() and (np.diff(s) >= 0.0).all()
    assert (v - np.interp(s, sigma, v_limit)).max() < 1.0
    assert np.abs(np.diff(v)).max() <= 3.0 * STEP_S + 1e-9
    even = np.full(300, 10.0)
    assert cruising(sigma, even, 10.0 * share, 0.0, 1.8, 3.0, 3.0, STEP_S, 81)[1].max() < 10.3
    assert cruising(sigma, even, 10.0, 0.0, 1.8, 3.0, 3.0, STEP_S, 81)[1].max() <= 10.0 + 1e-9


JERK = st.floats(2.0, 15.0)


def stopped(v0: float, a0: float, decel: float, jerk: float) -> FloatArray:
    return braking(v0, a0, decel, jerk, STEP_S, 600)


@given(st.floats(0.0, 35.0), st.floats(0.0, 1.0), st.floats(1.0, 8.0), JERK)
def test_braking_keeps_its_limits_and_ends_at_rest(v0: float, share: float, decel: float, jerk: float) -> None:
    hardest = -min(decel, np.sqrt(2.0 * jerk * v0))
    s, v, a = stopped(v0, hardest + share * (1.8 - hardest), decel, jerk)
    assert (v >= 0.0).all() and (np.diff(s) >= 0.0).all()
    assert a.min() >= -decel - 1e-9
    assert np.abs(np.diff(a)).max() / STEP_S <= 1.01 * jerk
    assert v[-1] == a[-1] == 0.0 and s[-1] == s[-2]


@given(st.floats(0.3, 35.0), st.floats(1.0, 8.0), JERK)
def test_braking_takes_the_distance_of_the_closed_form(v0: float, decel: float, jerk: float) -> None:
    """Jerk to the full deceleration, hold, jerk to rest; where the speed is too low for it, jerk and jerk."""
    assume(decel >= jerk * STEP_S)  # the ramp takes a step at least: a profile knows no shorter one
    held = v0 >= decel**2 / jerk
    expected = v0**2 / (2.0 * decel) + v0 * decel / (2.0 * jerk) if held else v0 * np.sqrt(v0 / jerk)
    assert stopped(v0, 0.0, decel, jerk)[0, -1] == pytest.approx(expected, abs=0.05 + 0.007 * v0)


@given(st.floats(0.0, 30.0), st.floats(0.2, 3.0))
def test_harder_braking_is_shorter(v0: float, more: float) -> None:
    soft, hard = stopped(v0, 0.0, 3.0, 3.0)[0], stopped(v0, 0.0, 3.0 + more, 3.0 + more)[0]
    assert (hard <= soft + 1e-9).all()


def speed_problem(seed: int) -> SpeedProblem:
    """A start that can brake for the bound: a limit, and somebody ahead who drives at constant speed."""
    rng = np.random.default_rng(seed)
    t = STEP_S * np.arange(CONFIG.knots)
    v0, limit = rng.uniform(0.0, 14.0), rng.uniform(8.0, 15.0)
    a0 = max(rng.uniform(-1.0, 1.0), -np.sqrt(2.0 * 0.9 * 3.0 * v0))
    stop = braking(v0, a0, 0.85 * 3.0, 0.85 * 3.0, STEP_S, CONFIG.knots)
    upper = np.maximum(rng.uniform(20.0, 60.0) + rng.uniform(0.0, 8.0) * t, stop[0])
    v_ref = np.minimum(limit, v0 + 1.0 * t)
    s_ref = np.minimum(np.cumsum(STEP_S * v_ref), upper)
    bound = np.maximum(np.full(CONFIG.knots, limit + 0.8), stop[1] + 0.05)
    return SpeedProblem((v0, a0), np.zeros(CONFIG.knots), upper, bound, s_ref, v_ref)


FAST, SURE = SpeedQp(CONFIG, "interior_point"), SpeedQp(CONFIG, "piqp")


def cost_of(x: FloatArray, problem: SpeedProblem) -> float:
    """(1), written down from the module's docstring."""
    s, v, a = x.reshape(3, -1)
    squares = (np.sum(e**2) for e in (s - problem.s_ref, v - problem.v_ref, a, np.diff(a) / STEP_S))
    return float(sum(w * square for w, square in zip((0.2, 1.0, 2.0, 3.0), squares, strict=True)))


def assert_drivable(x: FloatArray, problem: SpeedProblem, limits: SpeedLimits, slack: float) -> None:
    s, v, a = x.reshape(3, -1)
    jerk = np.diff(a) / STEP_S
    np.testing.assert_allclose((s[0], v[0], a[0]), (0.0, *problem.start), atol=slack)
    assert (s[1:] <= problem.upper[1:] + slack).all() and (s[1:] >= problem.lower[1:] - slack).all()
    assert v.min() >= -slack and (v[1:] <= problem.limit[1:] + slack).all()
    assert a.min() >= -limits.decel_mps2 - slack and a.max() <= limits.accel_mps2 + slack
    assert np.abs(jerk).max() <= limits.jerk_mps3 + 10.0 * slack
    np.testing.assert_allclose(v[1:], v[:-1] + STEP_S * a[:-1] + 0.5 * STEP_S**2 * jerk, atol=slack)
    steps = s[:-1] + STEP_S * v[:-1] + 0.5 * STEP_S**2 * a[:-1] + STEP_S**3 / 6.0 * jerk
    np.testing.assert_allclose(s[1:], steps, atol=slack)


@given(SEED)
@settings(max_examples=25)
def test_the_speed_qp_keeps_its_bounds_and_finds_the_least_cost(seed: int) -> None:
    problem = speed_problem(seed)
    (fast, costs), (sure, _) = (program.solve(problem, Limits(CONFIG.comfort)) for program in (FAST, SURE))
    assert fast.report.solved and sure.report.solved and "PIQP" in sure.report.status
    assert_drivable(fast.x, problem, CONFIG.comfort, 1e-4)
    assert_drivable(sure.x, problem, CONFIG.comfort, 1e-6)
    found = cost_of(fast.x, problem)
    assert found == pytest.approx(cost_of(sure.x, problem), rel=1e-5, abs=1e-5)
    assert sum(value for _, value in costs.terms) == pytest.approx(found, rel=1e-9)


@given(SEED, st.floats(0.0, 10.0))
@settings(max_examples=15)
def test_every_step_towards_another_profile_within_the_bounds_costs_more(seed: int, less: float) -> None:
    """The variational inequality of a convex problem, towards what a tighter bound of s allows."""
    problem = speed_problem(seed)
    best = SURE.solve(problem, Limits(CONFIG.comfort))[0].x
    tight = SpeedProblem(
        problem.start, problem.lower, problem.upper - less, problem.limit, problem.s_ref, problem.v_ref
    )
    other, _ = SURE.solve(tight, Limits(CONFIG.comfort))
    assume(other.report.solved)
    assert cost_of(best + 1e-3 * (other.x - best), problem) >= cost_of(best, problem) - 1e-7


def test_braking_is_a_profile_of_the_qp() -> None:
    """What `braking` says can be kept, the QP can keep."""
    s, v, a = braking(12.0, 0.5, 3.0, 3.0, STEP_S, CONFIG.knots)
    still = SpeedProblem((12.0, 0.5), s - 1e-3, s + 1e-3, v + 1e-3, s, v)
    result, _ = SURE.solve(still, Limits(CONFIG.comfort))
    assert result.report.solved
    np.testing.assert_allclose(result.x.reshape(3, -1)[2][:30], a[:30], atol=0.3)


def test_a_bound_behind_the_braking_distance_is_reported() -> None:
    problem = speed_problem(3)
    near = SpeedProblem(
        (12.0, 0.0), problem.lower, np.full(CONFIG.knots, 5.0), problem.limit, problem.s_ref, problem.v_ref
    )
    assert not FAST.solve(near, Limits(CONFIG.emergency))[0].report.solved


def decided(other: Other, profile: FloatArray) -> DecisionKind:
    blocks = blocks_of(STRAIGHT, other)
    return decide_speed(blocks, frame(EGO, [other]), np.interp(blocks.t, [0.0, 8.0], profile))[0].kind


def test_words_for_what_is_done() -> None:
    slow, quick = np.array([0.0, 10.0]), np.array([0.0, 110.0])
    assert decided(standing("it", 40.0, 0.0), slow) is DecisionKind.STOP
    assert decided(driving("it", 20.0, 0.0, 5.0), slow) is DecisionKind.FOLLOW
    assert decided(driving("it", 40.0, -6.0, 0.0, 1.5), slow) is DecisionKind.YIELD
    assert decided(driving("it", 40.0, -9.0, 0.0, 1.5), quick) is DecisionKind.OVERTAKE


@pytest.mark.parametrize("wrong", [{"knots": 5}, {"curve_accel_mps2": 0.0}, {"ease_mps2": -1.0}])
def test_settings_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="speed QP"):
        SpeedQpConfig(**wrong)  # type: ignore[arg-type]
