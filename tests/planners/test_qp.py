"""QP solvers behind one door: answers satisfy the optimality conditions, and what is not solved is
not called so.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import sparse
from scipy.optimize import nnls

from replan.core.arrays import FloatArray
from replan.planners.solver import QPConfig, QPResult, QuadraticProgram

FAST = QPConfig(eps=1e-6, max_iterations=20_000)
SURE = QPConfig(max_iterations=1, check_every=1)  # OSQP gives up at once: PIQP answers
SEED = st.integers(0, 2**32 - 1)
EQUALITIES = 2
Vectors = tuple[FloatArray, FloatArray, FloatArray]


def matrices(seed: int, n: int = 7, m: int = 10) -> tuple[sparse.csc_matrix, sparse.csc_matrix]:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n - 2))  # P is singular: only semidefinite
    rows = rng.normal(size=(m, n)) * rng.uniform(0.1, 10.0, (m, 1))
    return sparse.csc_matrix(root @ root.T), sparse.csc_matrix(np.vstack([rows, np.eye(n)]))


def vectors(A: sparse.csc_matrix, seed: int) -> Vectors:
    """A cost and bounds that some point satisfies; the last rows keep the problem bounded."""
    rng = np.random.default_rng(seed)
    value = A @ rng.normal(size=A.shape[1])
    lower, upper = (
        value - rng.uniform(0.01, 2.0, len(value)),
        value + rng.uniform(0.01, 2.0, len(value)),
    )
    lower[:EQUALITIES] = upper[:EQUALITIES] = value[:EQUALITIES]
    return 5.0 * rng.normal(size=A.shape[1]), lower, upper


def program(
    seed: int, config: QPConfig
) -> tuple[QuadraticProgram, sparse.csc_matrix, sparse.csc_matrix]:
    P, A = matrices(seed)
    return QuadraticProgram("test", P, A, equalities=EQUALITIES, config=config), P, A


def cost(P: sparse.csc_matrix, q: FloatArray, x: FloatArray) -> float:
    return float(0.5 * x @ (P @ x) + q @ x)


def stationarity(
    P: sparse.csc_matrix, A: sparse.csc_matrix, data: Vectors, x: FloatArray, active: float
) -> float:
    """Least |P x + q + A' y| over multipliers of the right sign at the bounds that x touches within
    `active`.
    """
    q, lower, upper = data
    value = A @ x
    push = A.toarray()[value >= upper - active], -A.toarray()[value <= lower + active]
    gradient = P @ x + q
    return float(nnls(np.vstack(push).T, -gradient)[1])


@given(SEED, SEED)
@settings(max_examples=40)
def test_the_interior_point_answer_satisfies_kkt(matrix: int, vector: int) -> None:
    solver, P, A = program(matrix, SURE)
    data = vectors(A, vector)
    result = solver.solve(*data, fresh=True)
    assert result.report.solved and "PIQP" in result.report.status
    value = A @ result.x
    assert max((data[1] - value).max(), (value - data[2]).max()) < 1e-6
    assert stationarity(P, A, data, result.x, 1e-5) < 1e-4


@given(SEED, SEED)
@settings(max_examples=40)
def test_both_solvers_reach_the_same_cost(matrix: int, vector: int) -> None:
    fast, P, A = program(matrix, FAST)
    data = vectors(A, vector)
    one, two = fast.solve(*data, fresh=True), program(matrix, SURE)[0].solve(*data, fresh=True)
    assert one.report.solved and two.report.solved
    assert cost(P, data[0], one.x) == pytest.approx(cost(P, data[0], two.x), abs=2e-3, rel=1e-4)


@given(SEED, SEED, st.floats(-3.0, 3.0))
@settings(max_examples=40)
def test_a_solved_problem_keeps_its_bounds(matrix: int, vector: int, exponent: float) -> None:
    """However loose the solver's own tolerance is."""
    config = QPConfig(eps=10.0**exponent, tolerance=1e-3)
    solver, _, A = program(matrix, config)
    data = vectors(A, vector)
    result = solver.solve(*data, fresh=True)
    value = A @ result.x
    assert result.report.solved
    assert max((data[1] - value).max(), (value - data[2]).max()) <= 1e-3 + 1e-12


@pytest.mark.parametrize("config", [QPConfig(), SURE, FAST], ids=["default", "piqp", "osqp"])
@given(matrix=SEED, vector=SEED, before=st.lists(SEED, min_size=1, max_size=3))
@settings(max_examples=20)
def test_a_fresh_solve_does_not_depend_on_others(
    config: QPConfig, matrix: int, vector: int, before: list[int]
) -> None:
    used, _, A = program(matrix, config)
    for seed in before:
        used.solve(*vectors(A, seed), fresh=False)
    data = vectors(A, vector)
    again, first = (
        used.solve(*data, fresh=True),
        program(matrix, config)[0].solve(*data, fresh=True),
    )
    np.testing.assert_array_equal(again.x, first.x)
    assert again.report == first.report


def broken(kind: str, data: Vectors) -> Vectors:
    q, lower, upper = (column.copy() for column in data)
    if kind == "bounds cross":
        lower[4], upper[4] = upper[4], lower[4]
    elif kind == "a bound is no number":
        upper[4] = np.nan
    elif kind == "the cost is no number":
        q[0] = np.nan
    elif kind == "the cost is infinite":
        q[0] = -np.inf
    elif kind == "nothing satisfies it":  # the last rows bound x, the first ask for more
        lower[:EQUALITIES] = upper[:EQUALITIES] = 1e4
    return q, lower, upper


BROKEN = (
    "bounds cross",
    "a bound is no number",
    "the cost is no number",
    "the cost is infinite",
    "nothing satisfies it",
)


@pytest.mark.parametrize("kind", BROKEN)
@pytest.mark.parametrize("config", [QPConfig(), SURE, FAST], ids=["default", "piqp", "osqp"])
def test_an_unsolvable_problem_is_reported_and_forgotten(kind: str, config: QPConfig) -> None:
    solver, _, A = program(1, config)
    data = vectors(A, 2)
    expected = solver.solve(*data, fresh=True)
    bad = solver.solve(*broken(kind, data), fresh=False)
    assert not bad.report.solved and bad.report.status
    after = solver.solve(*data, fresh=False)
    assert after.report.solved
    np.testing.assert_allclose(A @ after.x, A @ expected.x, atol=5e-2)


def test_an_unbounded_problem_is_not_solved() -> None:
    solver = QuadraticProgram("test", sparse.csc_matrix((2, 2)), sparse.eye(2, format="csc"))
    free = np.full(2, np.inf)
    assert not solver.solve(np.ones(2), -free, free, fresh=True).report.solved


def test_the_report_names_the_crossing_row_and_the_solver() -> None:
    solver, _, A = program(1, SURE)
    data = vectors(A, 2)
    assert "row 4" in solver.solve(*broken("bounds cross", data), fresh=True).report.status
    assert "nan" in solver.solve(*broken("a bound is no number", data), fresh=True).report.status
    result: QPResult = solver.solve(*data, fresh=True)
    assert (
        result.report.stage == "test"
        and result.report.status == "solved by PIQP after 1 OSQP iterations"
    )
    assert result.report.iterations > 1 and result.report.primal_residual < 1e-6


@given(SEED, SEED, st.lists(st.floats(-2.0, 2.0), min_size=7, max_size=7))
@settings(max_examples=20)
def test_the_scale_of_the_variables_does_not_change_the_answer(
    matrix: int, vector: int, sizes: list[float]
) -> None:
    P, A = matrices(matrix)
    P = P + sparse.eye(7)  # strictly convex: one answer only
    scaled = QuadraticProgram(
        "test", P, A, equalities=EQUALITIES, scale=10.0 ** np.array(sizes), config=SURE
    )
    plain = QuadraticProgram("test", P, A, equalities=EQUALITIES, config=SURE)
    data = vectors(A, vector)
    one, two = scaled.solve(*data, fresh=True), plain.solve(*data, fresh=True)
    assert one.report.solved and two.report.solved
    np.testing.assert_allclose(one.x, two.x, atol=5e-5)


def other_numbers(A: sparse.csc_matrix, seed: int) -> sparse.csc_matrix:
    """A matrix with entries in the places of A."""
    other = A.copy()
    other.data = other.data * np.random.default_rng(seed).uniform(0.5, 2.0, len(other.data))
    return other


@pytest.mark.parametrize("config", [SURE, FAST], ids=["piqp", "osqp"])
@given(matrix=SEED, vector=SEED, before=st.lists(SEED, max_size=3))
@settings(max_examples=15)
def test_new_numbers_in_the_matrix_are_a_new_problem(
    config: QPConfig, matrix: int, vector: int, before: list[int]
) -> None:
    """With the cost of a program built for it, and the same bits whatever numbers were in it
    before.
    """
    used, P, A = program(matrix, config)
    wanted = other_numbers(A, vector)
    data = vectors(wanted, vector)
    for seed in before:
        used.refill(other_numbers(A, seed).data)
        used.solve(*vectors(A, seed), fresh=False)
    used.refill(wanted.data)
    found = used.solve(*data, fresh=True)
    built = QuadraticProgram("test", P, wanted, equalities=EQUALITIES, config=SURE).solve(
        *data, fresh=True
    )
    assert found.report.solved and built.report.solved
    assert cost(P, data[0], found.x) == pytest.approx(cost(P, data[0], built.x), abs=2e-3, rel=1e-4)
    value = wanted @ found.x
    assert max((data[1] - value).max(), (value - data[2]).max()) < 2e-2
    new = program(matrix, config)[0]
    new.refill(wanted.data)
    np.testing.assert_array_equal(new.solve(*data, fresh=True).x, found.x)


def test_numbers_that_do_not_fit_are_refused() -> None:
    solver, _, A = program(1, QPConfig())
    with pytest.raises(ValueError, match="entries"):
        solver.refill(A.data[:-1])
    with pytest.raises(ValueError, match="finite"):
        solver.refill(np.full(len(A.data), np.nan))
