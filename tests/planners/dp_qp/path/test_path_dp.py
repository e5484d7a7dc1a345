"""Path DP: it is brute force, mirrored where the world is, smooth, and its ties go to the passing
side.
"""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError
from replan.planners.dp_qp.path.dp import (
    COLLISION,
    OUTSIDE,
    SAMPLES,
    PathDpConfig,
    PathDpWeights,
    path_dp,
    path_dp_offset,
    path_dp_to_go,
    side_costs,
)
from replan.planners.frenet.path import quintic

SEED = st.integers(0, 2**32 - 1)
WEIGHTS = PathDpWeights(ref=0.05, dl=20.0, ddl=500.0, near=2.0, reach=1.0, switch=1.0)


def quintic_at(
    l0: float, dl0: float, ddl0: float, l1: float, length: float, d: FloatArray
) -> FloatArray:
    """Rows l, l', l'' `(3, n)` of the quintic, by its definition as a polynomial."""
    polynomial = np.polynomial.Polynomial(
        [l0, dl0, 0.5 * ddl0, *quintic(l0, dl0, ddl0, l1, length)]
    )
    return np.array([polynomial(d), polynomial.deriv(1)(d), polynomial.deriv(2)(d)])


def grid(
    seed: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Stations, offsets, start, boxes and corridor of a small random problem."""
    rng = np.random.default_rng(seed)
    stations = 10.0 * np.arange(1, 4) + rng.uniform(0.0, 3.0)
    start = np.array(
        [0.0, rng.uniform(-1.5, 1.5), rng.uniform(-0.2, 0.2), rng.uniform(-0.02, 0.02)]
    )
    s, l = rng.uniform(5.0, 30.0, 3), rng.uniform(-2.0, 2.0, 3)
    sides = rng.integers(-1, 2, 3)
    boxes = np.column_stack(
        [s, s + rng.uniform(2.0, 8.0, 3), l, l + rng.uniform(0.2, 1.5, 3), sides]
    )
    lower, upper = -rng.uniform(0.5, 2.5, (3, SAMPLES)), rng.uniform(0.5, 2.5, (3, SAMPLES))
    return stations, np.array([1.5, 0.5, -0.5, -1.5]), start, boxes, lower, upper


def edge_cost(
    first: FloatArray, s1: float, l1: float, boxes: FloatArray, lower: FloatArray, upper: FloatArray
) -> float:
    """Cost (2) of one edge, written down from the module's docstring."""
    s0, l0, dl0, ddl0 = first
    step = (s1 - s0) / SAMPLES
    d = step * np.arange(1, SAMPLES + 1)
    l, dl, ddl = quintic_at(l0, dl0, ddl0, l1, s1 - s0, d)
    total = WEIGHTS.ref * l**2 + WEIGHTS.dl * dl**2 + WEIGHTS.ddl * ddl**2
    outside = np.maximum(0.0, np.maximum(lower - l, l - upper))
    total += np.where(outside > 0.0, OUTSIDE * (0.1 + outside), 0.0)
    for s_from, s_to, l_from, l_to, before in boxes:
        beside = (s_from <= s0 + d) & (s0 + d <= s_to)
        gap = np.maximum(l_from - l, l - l_to)
        near = WEIGHTS.near * (1.0 - gap / WEIGHTS.reach) ** 2
        total += beside * np.where(gap < 0.0, COLLISION, np.where(gap < WEIGHTS.reach, near, 0.0))
        total += beside * (before * (l - 0.5 * (l_from + l_to)) < 0.0) * WEIGHTS.switch
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
def test_cost_to_come_and_cost_to_go_add_up(seed: int) -> None:
    """The best path costs as much as the best through a node of any column, and as the better of
    two sides.
    """
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
    there = (
        start * [1.0, -1.0, -1.0, -1.0],
        boxes[:, [0, 1, 3, 2, 4]] * [1.0, 1.0, -1.0, -1.0, -1.0],
    )
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
    l = np.array([path_dp_offset(stations, offsets, chosen, start, s) for s in fine])
    assert l[0] == start[1] and l[-1] == offsets[chosen[-1]]
    assert np.abs(np.diff(l, 2)).max() < 1e-4 * 0.5  # l'' stays below 0.5 1/m: no jump, no kink


def test_an_even_number_of_rows_is_refused() -> None:
    with pytest.raises(ConfigError, match="odd"):
        PathDpConfig(rows=10)
