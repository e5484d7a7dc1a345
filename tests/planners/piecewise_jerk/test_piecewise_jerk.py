"""Piecewise-jerk QPs: optimal by KKT, infeasible where a linear program says so, the same by every
solver.
"""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import piqp
import pytest
from hypothesis import assume, given, settings, strategies as st
from jerk_problems import KINDS, answer, made
from scipy import sparse
from scipy.optimize import linprog, nnls

from replan.core.arrays import FloatArray
from replan.planners.dp_qp.path import qp as path_qp
from replan.planners.dp_qp.speed import qp as speed_qp
from replan.planners.piecewise_jerk import interior_point
from replan.planners.piecewise_jerk.interior_point import ACCURACY_M, INFEASIBLE, SOLVED, STATUS
from replan.planners.piecewise_jerk.problem import PiecewiseJerkProblem, Weights, largest_violation
from replan.planners.piecewise_jerk.solvers import SOLVERS, matrices, solve, structure, vectors
from replan.planners.solver import QPResult
from replan.replay.loop.open_loop import run_open_loop
from replan.run.log_source import LogSource

SEED = st.integers(0, 2**32 - 1)


class Form(NamedTuple):
    """The sparse form, in unknowns of size 1."""

    P: Any
    q: FloatArray
    A: Any
    low: FloatArray
    high: FloatArray
    equalities: int
    sizes: FloatArray


def sparse_form(problem: PiecewiseJerkProblem) -> Form:
    form, (q, low, high) = matrices(structure(problem)), vectors(problem)
    S = sparse.diags(form.sizes)
    P, A = sparse.csc_matrix(S @ form.P @ S), sparse.csr_matrix(form.A @ S)
    return Form(P, form.sizes * q, A, low, high, form.equalities, form.sizes)


def reference(problem: PiecewiseJerkProblem) -> FloatArray | None:
    """The curve by PIQP at 1e-9; None where it finds none."""
    P, q, A, low, high, k, sizes = sparse_form(problem)
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = solver.settings.eps_rel = 1e-9
    solver.setup(P, q, A[:k].tocsc(), low[:k], A[k:].tocsc(), low[k:], high[k:])
    solved = solver.solve() == piqp.PIQP_SOLVED
    return (
        (sizes * solver.result.x)[: 3 * problem.lower.shape[1]].reshape(3, -1) if solved else None
    )


def feasible(problem: PiecewiseJerkProblem, room: float) -> bool:
    """Whether HiGHS finds a curve that keeps the bounds of x by `room` (negative: nearly)."""
    _, q, A, low, high, k, _ = sparse_form(problem)
    less = np.where(np.arange(len(low) - k) < problem.lower.shape[1] - 1, room, 0.0)
    above, below = np.isfinite(high[k:]), np.isfinite(low[k:])
    rows = sparse.vstack([A[k:][above], -A[k:][below]])
    bound = np.r_[(high[k:] - less)[above], -(low[k:] + less)[below]]
    found = linprog(
        np.zeros(len(q)), rows, bound, A[:k], low[:k], bounds=(None, None), method="highs"
    )
    return bool(found.status == 0)


def stationarity(form: Form, z: FloatArray) -> float:
    """Least |P z + q + A' y| over multipliers y of the right sign at the bounds that z touches.

    Relative.
    """
    value, size = form.A @ z, np.abs(form.A).max(axis=1).toarray().ravel()
    push = (
        form.A.toarray()[value >= form.high - 1e-4 * size],
        -form.A.toarray()[value <= form.low + 1e-4 * size],
    )
    gradient = form.P @ z + form.q
    return float(nnls(np.vstack(push).T, -gradient)[1] / max(np.linalg.norm(gradient), 1.0))


@given(SEED, st.sampled_from([*KINDS]))
@settings(max_examples=40)
def test_the_answer_satisfies_kkt(seed: int, kind: str) -> None:
    problem = made(kind, seed)
    found, form, n = answer(problem), sparse_form(problem), problem.lower.shape[1]
    assert found.status == SOLVED and largest_violation(problem, found.curve) < 2e-6 * max(
        1.0, problem.step**-3
    )
    z = np.zeros(len(form.q))
    z[: 3 * n] = found.curve.ravel() / form.sizes[: 3 * n]
    # softly: as little as the corridor asks for
    shifts, at = form.A[:, 3 * n :].tocsc(), form.A @ z
    z[3 * n :] = np.clip(0.0, form.low - at, form.high - at)[shifts.indices] / shifts.data
    assert stationarity(form, z) < 1e-3


@given(SEED, st.sampled_from([*KINDS]))
@settings(max_examples=60)
def test_the_answer_is_as_near_to_the_optimum_as_it_claims(seed: int, kind: str) -> None:
    problem = made(kind, seed)
    best, found = reference(problem), answer(problem)
    assume(best is not None)
    assert best is not None and found.status == SOLVED
    assert np.abs(found.curve[0] - best[0]).max() < ACCURACY_M


@given(SEED, st.sampled_from(["roomy", "tight"]), st.floats(0.0, 4.0))
@settings(max_examples=60)
def test_infeasible_agrees_with_a_linear_program(seed: int, kind: str, shift: float) -> None:
    problem = made(kind, seed, shift)
    if feasible(problem, 1e-4):
        assert answer(problem).status == SOLVED
    elif not feasible(problem, -1e-4):
        assert answer(problem).status == INFEASIBLE


@given(SEED, st.sampled_from([*KINDS]), st.floats(0.0, 3.0))
@settings(max_examples=30)
def test_a_mirrored_problem_has_the_mirrored_answer(seed: int, kind: str, shift: float) -> None:
    problem = made(kind, seed, shift)
    mirrored = problem._replace(
        start=-problem.start,
        references=-problem.references,
        lower=-problem.upper,
        upper=-problem.lower,
    )
    one, other = answer(problem), answer(mirrored)
    assert one.status == other.status and one.iterations == other.iterations
    np.testing.assert_array_equal(one.curve, -other.curve)


def recorded(log: str, every: int) -> list[tuple[str, PiecewiseJerkProblem, float]]:
    """Every so-many-th problem of a log's frames."""
    asked: list[tuple[str, PiecewiseJerkProblem, float]] = []

    def noted(
        problem: PiecewiseJerkProblem, solver: str, *, stage: str, tolerance: float
    ) -> QPResult:
        asked.append((stage, problem, tolerance))
        return solve(problem, solver, stage=stage, tolerance=tolerance)

    with patch.object(path_qp, "solve", noted), patch.object(speed_qp, "solve", noted):
        run_open_loop(LogSource(log).read(), "dp_qp")
    return asked[::every]


def test_all_solvers_agree_on_problems_of_real_frames() -> None:
    asked = recorded("paper/static_obstacles", 25)
    assert {stage for stage, _, _ in asked} == {"path QP", "speed QP"} and len(asked) > 10
    for stage, problem, tolerance in asked:
        best, n = reference(problem), problem.lower.shape[1]
        for name, near in (("interior_point", ACCURACY_M), ("osqp", 0.05), ("piqp", 1e-4)):
            result = solve(problem, name, stage=stage, tolerance=tolerance)
            assert result.report.solved and result.report.stage == stage
            assert best is not None and np.abs(result.x[:n] - best[0]).max() < near


@pytest.mark.parametrize("solver", SOLVERS)
def test_no_solver_remembers(solver: str) -> None:
    first, other = made("roomy", 5), made("tight", 5)
    assert structure(first) == structure(other)

    def solved(problem: PiecewiseJerkProblem) -> FloatArray:
        return solve(problem, solver, stage="test", tolerance=1e-2).x

    before = solved(first)
    solved(other)
    np.testing.assert_array_equal(solved(first), before)


def test_without_active_bounds_the_reference_is_followed() -> None:
    """A curve at constant x' that is its own reference costs nothing."""
    n, h = 20, 0.5
    t = h * np.arange(n)
    references = np.array([2.0 + 3.0 * t, np.full(n, 3.0)])
    wide = np.full((5, n), 100.0)
    problem = PiecewiseJerkProblem(
        h,
        np.array([1.0]),
        np.array([2.0, 3.0, 0.0]),
        Weights(1.0, 1.0, 1.0, 1.0),
        references,
        -wide,
        wide,
        0.0,
    )
    found = answer(problem)
    np.testing.assert_allclose(found.curve, np.vstack([references, 0.0 * t]), atol=1e-9)
    problem.upper[4, 7] = 2.0 + 3.0 * 3.5 + 1.0 * 3.0 - 0.25  # x + 1 x' at the knot 7
    assert largest_violation(problem, found.curve) == pytest.approx(0.25, abs=1e-9)
    assert (
        found.curve[0, 7] > answer(problem).curve[0, 7]
        and largest_violation(problem, answer(problem).curve) < 1e-6
    )


def test_a_failed_solve_has_a_status_with_its_cause() -> None:
    problem = made("roomy", 1)
    for change, words in (
        ({"lower": problem.lower + 1e3}, "bounds cross"),
        ({"upper": problem.upper * np.nan}, "not numbers"),
        ({"references": problem.references * np.nan}, "not finite"),
        ({"lower": problem.lower + 50.0, "upper": problem.upper + 50.0}, "infeasible"),
    ):
        report = solve(problem._replace(**change), stage="test", tolerance=1e-2).report
        assert not report.solved and words in report.status
    spent = interior_point.solve(problem, ACCURACY_M, 2)
    assert STATUS[spent.status] == "iterations spent" and spent.iterations == 2


PRINTED = """
import sys; sys.path.insert(0, "tests/support")
from jerk_problems import KINDS, answer, made
for kind in KINDS:
    found = answer(made(kind, 3, 0.5))
    print(found.status, found.iterations, *found.curve[0].tolist())
"""


def test_without_the_compiler_the_answers_are_the_same() -> None:
    shown = subprocess.run(
        [sys.executable, "-c", PRINTED],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        text=True,
        capture_output=True,
        check=True,
        cwd=Path(__file__).parents[3],
    ).stdout.splitlines()
    for kind, line in zip(KINDS, shown, strict=True):
        found, values = answer(made(kind, 3, 0.5)), np.array(line.split(), dtype=float)
        assert (found.status, found.iterations) == (values[0], values[1])
        np.testing.assert_allclose(values[2:], found.curve[0], atol=1e-9)
