"""The door to the solvers of piecewise-jerk QPs. None is warm-started: an answer depends on its problem alone.

`interior_point` is ours (default). `osqp` and `piqp` solve the sparse form through `planners.qp`: OSQP (ADMM) with PIQP
to the rescue where it runs out of iterations, or PIQP at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from copy import deepcopy
from dataclasses import replace
from functools import lru_cache, partial
from types import MappingProxyType
from typing import NamedTuple

from logs.errors import unknown_name
from logs.trace import SolverReport
from planners.piecewise_jerk import interior_point
from planners.piecewise_jerk.problem import PiecewiseJerkProblem, Structure, matrices, structure, vectors
from planners.qp import QPConfig, QPResult, QuadraticProgram

DEFAULT = "interior_point"
"""The solver where none is named."""
OSQP_EPS = 1e-5
"""Tolerance of OSQP: at 1e-4 its answers are up to 0.5 m off ..."""
OSQP_ITERATIONS = 4000
"""... and the iterations with which it solves nearly all, cold."""


def check_solver(name: str) -> None:
    """ConfigError where no solver has this name."""
    if name not in SOLVERS:
        raise unknown_name("solver", name, SOLVERS)


def solve(problem: PiecewiseJerkProblem, solver: str = DEFAULT, *, stage: str, tolerance: float) -> QPResult:
    """The curve of a problem, x = (x, x', x'') `(3 n,)`, and how the solver got there.

    Args:
        problem: What is asked.
        solver: A name of `SOLVERS`.
        stage: Name in the report.
        tolerance: Largest violation of a bound that still counts as solved, in the units of the row.
    """
    result = SOLVERS[solver](problem, stage, tolerance)
    asked = _WATCHED.get()
    if asked is not None:
        asked.append(Asked(deepcopy(problem), deepcopy(result)))
    return result


class Asked(NamedTuple):
    """A problem and its answer."""

    problem: PiecewiseJerkProblem
    result: QPResult


_WATCHED: ContextVar[list[Asked] | None] = ContextVar("watched", default=None)


@contextmanager
def watched() -> Iterator[list[Asked]]:
    """Within it all problems that are solved and their answers are kept: for debugging, they change nothing."""
    asked: list[Asked] = []
    token = _WATCHED.set(asked)
    try:
        yield asked
    finally:
        _WATCHED.reset(token)


def _interior_point(problem: PiecewiseJerkProblem, stage: str, tolerance: float) -> QPResult:
    found = interior_point.solve(problem, interior_point.ACCURACY_M, interior_point.MAX_ITERATIONS)
    solved, status = found.status == interior_point.SOLVED, interior_point.STATUS[found.status]
    if solved and not found.violation <= tolerance:
        solved, status = False, f"{status}, but a bound is violated by {found.violation:.3g}"
    report = SolverReport(stage, solved, status, found.iterations, found.primal, found.dual)
    return QPResult(found.curve.ravel(), report)


def _sparse(config: QPConfig, problem: PiecewiseJerkProblem, stage: str, tolerance: float) -> QPResult:
    """The answer of the solvers of `planners.qp` to the sparse form."""
    program = _program(structure(problem), stage, replace(config, tolerance=tolerance))
    result = program.solve(*vectors(problem), fresh=True)
    return QPResult(result.x[: 3 * problem.lower.shape[1]], result.report)


@lru_cache(maxsize=64)
def _program(kind: Structure, stage: str, config: QPConfig) -> QuadraticProgram:
    """The workspace of a structure; every solve in it is a fresh one, so that it remembers nothing."""
    form = matrices(kind)
    return QuadraticProgram(stage, form.P, form.A, equalities=form.equalities, scale=form.sizes, config=config)


SOLVERS: MappingProxyType[str, Callable[[PiecewiseJerkProblem, str, float], QPResult]] = MappingProxyType(
    {
        "interior_point": _interior_point,
        "osqp": partial(_sparse, QPConfig(OSQP_EPS, OSQP_ITERATIONS)),
        "piqp": partial(_sparse, QPConfig(max_iterations=0)),
    }
)
"""By the names that `[planner.dp_qp] solver` takes."""
