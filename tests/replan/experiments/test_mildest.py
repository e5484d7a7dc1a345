"""The search for the mildest failure, on holes whose mildest point is known."""

from collections.abc import Callable, Sequence
from math import inf, isnan

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from replan.core.arrays import FloatArray
from replan.experiments.mildest import Mildest, Point, ScoredPoint, norm, search

pytest.importorskip(
    "cmaes", reason="the extra improve is not installed: pip install 'replan[improve]'"
)
BOX = np.array([[-3.0, -2.5], [3.0, 5.0]])
Hole = Callable[[FloatArray], float]
"""How far a point is inside the hole, negative outside."""


class Counted:
    """Evaluates points, and keeps what it was asked."""

    def __init__(self, hole: Hole, box: FloatArray) -> None:
        self.hole, self.farthest, self.asked = hole, norm(np.abs(box).max(axis=0)), list[Point]()

    def __call__(self, points: Sequence[Point], part: str) -> list[ScoredPoint]:
        self.asked += points
        inside = [self.hole(np.array(point)) for point in points]
        return [
            ScoredPoint(
                norm(point) / self.farthest if depth > 0.0 else 1.0 + depth / (depth - 1.0),
                depth > 0.0,
            )
            for point, depth in zip(points, inside, strict=True)
        ]


def found(
    hole: Hole, *, box: FloatArray = BOX, budget: int = 200, seed: int = 0
) -> tuple[Mildest, Counted]:
    evaluate = Counted(hole, box)
    return search(box, evaluate, budget=budget, seed=seed, resolution=0.01), evaluate


@settings(max_examples=12, deadline=None)
@given(st.floats(0.0, 6.28), st.floats(0.5, 2.2), st.integers(0, 1000))
def test_the_mildest_point_beyond_a_line_is_found_to_a_tenth(
    angle: float, away: float, seed: int
) -> None:
    normal = np.array([np.cos(angle), np.sin(angle)])
    result, evaluate = found(lambda u: float(u @ normal) - away, seed=seed)
    assert result.point is not None and away - 1e-3 <= result.distance <= 1.1 * away
    assert len(evaluate.asked) == len(set(evaluate.asked)) == result.evaluations <= 200
    assert evaluate.hole(np.array(result.point)) > 0.0 and norm(result.point) == result.distance
    assert result.passes < result.distance


@settings(max_examples=8, deadline=None)
@given(st.floats(-2.0, 2.0), st.floats(2.0, 4.0), st.floats(0.5, 1.2), st.integers(0, 1000))
def test_the_near_side_of_a_pocket_is_found_to_a_tenth(
    x: float, y: float, radius: float, seed: int
) -> None:
    middle = np.array([x, y])
    result, _ = found(lambda u: radius - norm(u - middle), seed=seed)
    assert norm(middle) - radius - 1e-3 <= result.distance <= 1.1 * (norm(middle) - radius)


def test_axes_that_do_not_matter_stay_as_recorded() -> None:
    box = np.array([[-3.0, -3.0, -3.0], [3.0, 3.0, 3.0]])
    result, _ = found(lambda u: u[1] - 1.5, box=box)
    assert result.point is not None and result.point[0] == result.point[2] == 0.0
    assert (
        result.distance == pytest.approx(1.5, abs=0.01)
        and result.distance - result.passes <= 0.01 + 1e-3
    )


def test_the_same_seed_asks_for_the_same_points_and_another_for_others() -> None:
    one, two, three = (
        found(lambda u: u[0] + u[1] - 2.0, budget=64, seed=seed)[1].asked for seed in (5, 5, 6)
    )
    assert one == two != three
    assert all((BOX[0] <= point).all() and (point <= BOX[1]).all() for point in map(np.array, one))


def test_a_box_without_failures_has_no_mildest_and_the_budget_is_used() -> None:
    result, evaluate = found(lambda u: -1.0 - norm(u), budget=48)
    assert (result.point, result.distance) == (None, inf) and isnan(result.passes)
    assert 40 <= len(evaluate.asked) == result.evaluations <= 48 and result.is_spent


def test_a_recorded_failure_ends_the_search_at_once() -> None:
    result, evaluate = found(lambda u: 1.0)
    assert (result.point, result.distance, evaluate.asked) == (
        (0.0, 0.0),
        0.0,
        [(0.0, 0.0)],
    ) and not result.is_spent
