"""The interface to the solvers of piecewise-jerk QPs. They start cold: an answer depends on its
problem alone.

`interior_point` is replan's own (default). `osqp` and `piqp` solve the sparse form through
`replan.planners.solver`: OSQP (ADMM), with PIQP where OSQP runs out of iterations, or PIQP alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from copy import deepcopy
from dataclasses import replace
from functools import lru_cache, partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from replan.core.arrays import FloatArray
from replan.core.errors import unknown_name
from replan.logs.plan import SolverReport
from replan.planners.piecewise_jerk import interior_point
from replan.planners.piecewise_jerk.problem import DDX, PiecewiseJerkProblem, Weights
from replan.planners.solver import QPConfig, QPResult, QuadraticProgram

DEFAULT = "interior_point"  # Name of the default solver
OSQP_EPS = 1e-5  # Tolerance of OSQP: at 1e-4 its answers are up to 0.5 m off ...
# ... and the iterations in which it solves nearly all problems from a cold start.
OSQP_ITERATIONS = 4000


def check_solver(name: str) -> None:
    """Raise ConfigError if no solver has this name."""
    if name not in SOLVERS:
        raise unknown_name("solver", name, SOLVERS)


def solve(
    problem: PiecewiseJerkProblem, solver: str = DEFAULT, *, stage: str, tolerance: float
) -> QPResult:
    """Solve a problem: its curve x = (x, x', x'') `(3 n,)`, and the solver's report, which names
    the `stage`.

    `tolerance` is the largest violation of a bound in a solution, in the units of the row.
    """
    result = SOLVERS[solver](problem, stage, tolerance)
    asked = _RECORDED.get()
    if asked is not None:
        asked.append(SolvedProblem(deepcopy(problem), deepcopy(result)))
    return result


class SolvedProblem(NamedTuple):
    """A problem and its answer."""

    problem: PiecewiseJerkProblem
    result: QPResult


_RECORDED: ContextVar[list[SolvedProblem] | None] = ContextVar("recorded", default=None)


@contextmanager
def record_problems() -> Iterator[list[SolvedProblem]]:
    """Record all problems that are solved in the body, and their answers, for debugging.

    Results do not change.
    """
    asked: list[SolvedProblem] = []
    token = _RECORDED.set(asked)
    try:
        yield asked
    finally:
        _RECORDED.reset(token)


def _interior_point(problem: PiecewiseJerkProblem, stage: str, tolerance: float) -> QPResult:
    solution = interior_point.solve(
        problem, interior_point.ACCURACY_M, interior_point.MAX_ITERATIONS
    )
    solved = solution.status == interior_point.SOLVED
    status = interior_point.STATUS[solution.status]
    if solved and not solution.violation <= tolerance:
        solved, status = False, f"{status}, but a bound is violated by {solution.violation:.3g}"
    report = SolverReport(
        stage, solved, status, solution.iterations, solution.primal, solution.dual
    )
    return QPResult(solution.curve.ravel(), report)


def _sparse(
    config: QPConfig, problem: PiecewiseJerkProblem, stage: str, tolerance: float
) -> QPResult:
    """Solve the sparse form by `replan.planners.solver`."""
    program = _program(structure(problem), stage, replace(config, tolerance=tolerance))
    result = program.solve(*vectors(problem), fresh=True)
    return QPResult(result.x[: 3 * problem.lower.shape[1]], result.report)


@lru_cache(maxsize=64)
def _program(kind: Structure, stage: str, config: QPConfig) -> QuadraticProgram:
    """The workspace of a structure.

    Each solve in it is fresh, so that it does not depend on earlier ones.
    """
    form = matrices(kind)
    return QuadraticProgram(
        stage, form.P, form.A, equalities=form.equalities, scale=form.sizes, config=config
    )


SOLVERS: MappingProxyType[str, Callable[[PiecewiseJerkProblem, str, float], QPResult]] = (
    MappingProxyType(
        {
            "interior_point": _interior_point,
            "osqp": partial(_sparse, QPConfig(OSQP_EPS, OSQP_ITERATIONS)),
            "piqp": partial(_sparse, QPConfig(max_iterations=0)),
        }
    )
)
"""The solvers by the names that `[planner.dp_qp] solver` takes."""


class Structure(NamedTuple):
    """The properties that problems have in common if they share a solver's workspace."""

    knots: int
    step: float
    leads: tuple[float, ...]
    weights: Weights
    soft: float


class Matrices(NamedTuple):
    """P and A of the sparse form, the number of its equalities (the first rows), the typical size
    of each unknown.
    """

    P: sparse.csc_matrix
    A: sparse.csc_matrix
    equalities: int
    sizes: FloatArray


def structure(problem: PiecewiseJerkProblem) -> Structure:
    """The structure of a problem."""
    leads = tuple(float(lead) for lead in problem.leads)
    return Structure(
        problem.lower.shape[1], float(problem.step), leads, problem.weights, float(problem.soft)
    )


@lru_cache(maxsize=64)
def matrices(kind: Structure) -> Matrices:
    """The sparse form: minimise 1/2 z' P z + q' z subject to l <= A z <= u, z = (x, x', x'') and,
    softly, the shifts e.

    Rows of A: (1), (2) of `problem`, the start, then (5) in the order x, x', x'', x''', x + lead
    x'. P and q are divided by w_x where that is positive.
    """
    n, h = kind.knots, kind.step
    now, then = sparse.eye(n - 1, n), sparse.eye(n - 1, n, k=1)
    none, other = sparse.csc_matrix((n - 1, n)), sparse.csc_matrix((1, n))
    third, first = (then - now) / h, sparse.eye(1, n)  # (3)
    rows: list[list[Any]] = [
        [now - then, h * now, h**2 / 3.0 * now + h**2 / 6.0 * then],  # (2)
        [none, now - then, 0.5 * h * (now + then)],  # (1)
        *([first if k == j else other for j in range(3)] for k in range(3)),  # the start
        *([then if k == j else none for j in range(3)] for k in range(3)),
        [none, none, third],
        *([then, lead * then, none] for lead in kind.leads),
    ]
    A: Any = sparse.bmat(rows, format="csc")
    weights = kind.weights
    squares: list[Any] = [w * sparse.eye(n) for w in weights[:3]]
    squares[DDX] = squares[DDX] + weights.dddx * (third.T @ third)
    unit = weights.x or 1.0
    sizes = np.repeat([np.sqrt(unit / w) if w > 0.0 else 1.0 for w in weights[:3]], n)
    equalities = 2 * (n - 1) + 3
    if kind.soft > 0.0:
        gives = (
            np.r_[np.arange(n - 1), np.arange(4 * (n - 1), A.shape[0] - equalities)] + equalities
        )
        shifts = sparse.csc_matrix(
            (np.ones(len(gives)), (gives, np.arange(len(gives)))), (A.shape[0], len(gives))
        )
        A = sparse.hstack([A, shifts], format="csc")
        squares.append(kind.soft * sparse.eye(len(gives)))
        sizes = np.r_[sizes, np.full(len(gives), np.sqrt(unit / kind.soft))]
    P = 2.0 / unit * sparse.block_diag(squares, format="csc")
    return Matrices(sparse.csc_matrix(P), sparse.csc_matrix(A), equalities, sizes)


def vectors(problem: PiecewiseJerkProblem) -> tuple[FloatArray, FloatArray, FloatArray]:
    """q, l and u of the sparse form."""
    n, weights = problem.lower.shape[1], problem.weights
    q = np.zeros(len(matrices(structure(problem)).sizes))
    q[: 2 * n] = (
        -2.0 / (weights.x or 1.0) * np.array([[weights.x], [weights.dx]]) * problem.references
    ).ravel()
    dynamics = np.zeros(2 * (n - 1))

    def bounds(of: FloatArray) -> FloatArray:
        return np.concatenate(
            [dynamics, problem.start, of[:3, 1:].ravel(), of[3, :-1], of[4:, 1:].ravel()]
        )

    return q, bounds(problem.lower), bounds(problem.upper)
