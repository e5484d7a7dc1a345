"""Speed DP: the map is its definition, dynamic programming = brute force."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from replan.core.arrays import FloatArray, IntArray
from replan.planners.dp_qp.speed.dp import COLLISION, DS_M, SpeedDpWeights, cost_map, speed_dp

SEED = st.integers(0, 2**32 - 1)
WEIGHTS = SpeedDpWeights(time=30.0, over=3.0, accel=1.0, jerk=0.5, max_accel=2.0, max_decel=7.0)


@given(SEED)
@settings(max_examples=30)
def test_the_cost_map_is_its_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lower = rng.uniform(-2.0, 20.0, (3, 5))
    upper = lower + rng.uniform(0.0, 6.0, (3, 5))
    lower[rng.random((3, 5)) < 0.3] = np.nan
    speed, gap, wanted, near = rng.uniform(-5.0, 5.0, 3), 1.0, (3.0, 1.2), 30.0
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
    rows: tuple[int, int],
    column: int,
    before: tuple[float, float],
    occupancy: FloatArray,
    limit: FloatArray,
    weights: SpeedDpWeights,
    per_column: int,
) -> tuple[float, float, float]:
    """Cost (1) of one edge, its speed and acceleration, written down from the module's
    docstring.
    """
    j, k = rows
    v = (k - j) * DS_M
    a, over = v - before[0], max(v - limit[k], 0.0)
    lost = max(1.0 - sum(DS_M / (0.5 * (limit[n] + limit[n + 1])) for n in range(j, k)), 0.0)
    cost = (
        weights.time * lost
        + weights.over * over**2
        + weights.accel * a**2
        + weights.jerk * (a - before[1]) ** 2
    )
    samples = [
        occupancy[column * per_column + n, int(j + (k - j) * n / per_column + 0.5)]
        for n in range(1, per_column + 1)
    ]
    return cost + float(np.mean(samples)), v, a


def speed_grid(
    seed: int, rows: int = 9, columns: int = 3
) -> tuple[FloatArray, FloatArray, tuple[float, float]]:
    """Map, limit and start of a small random problem, five samples to a column."""
    rng = np.random.default_rng(seed)
    occupancy = (
        20.0 * rng.random((5 * columns + 1, rows)) * (rng.random((5 * columns + 1, rows)) < 0.4)
    )
    return occupancy, rng.uniform(0.5, 3.0, rows), (rng.uniform(0.0, 2.0), rng.uniform(-1.0, 1.0))


def solved(
    occupancy: FloatArray,
    limit: FloatArray,
    start: tuple[float, float],
    weights: SpeedDpWeights,
    worth: float = np.inf,
) -> tuple[FloatArray, IntArray]:
    """The DP on a map with five samples to a column, occupied no further than it is."""
    columns = len(occupancy) // 5
    occupied = np.array([(len(limit), -1)] * columns)
    for column in range(columns):
        rows = np.flatnonzero(occupancy[5 * column + 1 : 5 * column + 6].any(axis=0))
        if len(rows):
            occupied[column] = rows[0], rows[-1]
    return speed_dp(occupancy, occupied, 5, limit, start, weights, worth)


@given(SEED)
@settings(max_examples=25)
def test_dynamic_programming_is_brute_force(seed: int) -> None:
    """Without weights on acceleration and jerk the problem is Markov, so that nothing is cheaper
    than the DP.
    """
    occupancy, limit, start = speed_grid(seed)
    weights = SpeedDpWeights(
        time=30.0, over=3.0, accel=0.0, jerk=0.0, max_accel=100.0, max_decel=100.0
    )
    cost, chosen = solved(occupancy, limit, start, weights)
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
def test_the_chosen_profile_has_the_cost_of_the_grid(seed: int) -> None:
    """With all weights; and it keeps to the accelerations that an edge may have."""
    occupancy, limit, start = speed_grid(seed, rows=16, columns=4)
    weights = WEIGHTS
    cost, chosen = solved(occupancy, limit, start, weights)
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
def test_a_faster_road_ahead_does_not_hold_the_ego_back(
    slow: float, faster: float, where: float, share: float
) -> None:
    """An empty road on which the limit rises is driven about as far as one on which it does not, or
    farther.
    """
    rows, weights = 300, WEIGHTS
    free, start = np.zeros((41, rows)), (share * slow, 0.0)
    level = np.full(rows, slow)
    rising = np.where(DS_M * np.arange(rows) < where, slow, slow + faster)
    ends = [solved(free, limit, start, weights)[1][-1] for limit in (level, rising)]
    assert ends[1] >= 0.85 * ends[0] - 1.0


@given(SEED, st.floats(1.001, 3.0))
@settings(max_examples=25)
def test_pruned_profiles_do_not_change_the_chosen_one(seed: int, share: float) -> None:
    occupancy, limit, start = speed_grid(seed, rows=16, columns=4)
    cost, chosen = solved(occupancy, limit, start, WEIGHTS)
    again = solved(occupancy, limit, start, WEIGHTS, share * cost[-1].min() + 1e-3)
    np.testing.assert_array_equal(again[1], chosen)
    assert again[0][-1].min() == cost[-1].min()


def test_a_tie_goes_to_the_smaller_station() -> None:
    free = np.zeros((16, 5))
    _, chosen = solved(
        free, np.full(5, 1.25), (0.0, 0.0), SpeedDpWeights(0.0, 0.0, 0.0, 0.0, 9.0, 9.0)
    )
    assert chosen.tolist() == [0, 0, 0, 0]
