"""The only module that calls the QP solvers.

    minimise 1/2 x' P x + q' x    subject to    l <= A x <= u,  the first rows equalities

A workspace is set up once with its matrices and belongs to one owner; each solve gets new vectors,
and where A varies `refill` replaces its stored entries. OSQP (Stellato et al., 2020), an ADMM
method, solves most problems in a few warm-started iterations, but a tight corridor can cost it
thousands. PIQP (Schwan et al., 2023), an interior-point method that needs about ten iterations for
the planners' problems, solves those that OSQP has not solved within `max_iterations`; the report
then names it. A solver may report a solution that violates bounds by its own tolerance, so this
module checks the bounds again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import osqp
import piqp
from msgspec import Meta
from scipy import sparse

from replan.core.arrays import FloatArray, IntArray
from replan.core.settings import Config, Positive
from replan.logs.plan import SolverReport

SOLVED = 1  # OSQP's status of a solved problem
RHO = 0.1  # OSQP's first step size (rho), which is its default
WORDS = {
    piqp.PIQP_SOLVED: "solved",
    piqp.PIQP_MAX_ITER_REACHED: "iterations spent",
    piqp.PIQP_PRIMAL_INFEASIBLE: "infeasible",
    piqp.PIQP_DUAL_INFEASIBLE: "unbounded",
}
"""PIQP's statuses in words."""


@dataclass(frozen=True)
class QPConfig(Config):
    """Settings of the solvers."""

    eps: Positive = 1e-4
    """Absolute and relative tolerance of OSQP."""
    max_iterations: Annotated[int, Meta(ge=0)] = 60
    """Iterations of OSQP before PIQP solves the problem; 0: PIQP solves it at once."""
    check_every: Annotated[int, Meta(ge=1)] = 10
    """Iterations between two tests for convergence."""
    tolerance: Positive = 2e-2
    """Largest violation of a bound in a solution, in the units of the row."""


@dataclass(frozen=True, eq=False, slots=True)
class QPResult:
    """A solution `x` `(n,)` (to be used only where `report.solved`) and the solver's report."""

    x: FloatArray
    report: SolverReport


class QuadraticProgram:
    """A workspace for problems that share P and A.

    Args:
        stage: Name in the solver reports.
        P: `(n, n)` symmetric positive semidefinite.
        A: `(m, n)`.
        equalities: Number of rows with equal bounds, which come first.
        scale: `(n,)` typical size of each variable; the solvers work on x / scale, and on rows of
            size 1.
    """

    def __init__(
        self,
        stage: str,
        P: sparse.csc_matrix,
        A: sparse.csc_matrix,
        *,
        equalities: int = 0,
        scale: FloatArray | None = None,
        config: QPConfig | None = None,
    ) -> None:
        self._stage, self._config, self._equalities = stage, config or QPConfig(), equalities
        rows, columns = A.shape
        self._scale = np.ones(columns) if scale is None else scale
        if scale is not None:
            S = sparse.diags(self._scale)
            P, A = S @ P @ S, A @ S
        self._P, self._A = sparse.csc_matrix(P), sparse.csc_matrix(A, copy=True)
        size = np.zeros(rows)
        np.maximum.at(size, self._A.indices, np.abs(self._A.data))
        self._row_scale: FloatArray = 1.0 / size
        self._A.data *= self._row_scale[self._A.indices]
        self._P.sort_indices()
        self._A.sort_indices()
        self._rows = self._A.tocsr()
        self._zero = np.zeros(columns), np.zeros(rows)
        self._fast = osqp.OSQP(algebra="builtin") if self._config.max_iterations else None
        if self._fast is not None:
            self._fast.setup(
                P=sparse.triu(self._P, format="csc"),
                q=np.zeros(columns),
                A=self._A,
                l=-np.ones(rows),
                u=np.ones(rows),
                rho=RHO,
                eps_abs=self._config.eps,
                eps_rel=self._config.eps,
                max_iter=self._config.max_iterations,
                check_termination=self._config.check_every,
                adaptive_rho_interval=50,
                scaling=0,
                polishing=False,
                verbose=False,
            )
        self._sure: piqp.SparseSolver | None = None
        self._refilling: tuple[FloatArray, IntArray] | None = None

    def refill(self, values: FloatArray) -> None:
        """Replace the stored entries of A `(nnz,)`, in the order of its columns (`A.data`, sorted
        indices).

        The scale of the rows stays that of the set-up.
        ValueError if the number of entries differs, or one is not finite.
        """
        if values.shape != self._A.data.shape or not np.isfinite(values).all():
            raise ValueError(
                f"A has {len(self._A.data)} entries, got {values.shape}, or one that is not finite"
            )
        if self._refilling is None:
            numbered = np.arange(1.0, len(values) + 1.0), self._A.indices, self._A.indptr
            places = sparse.csc_matrix(numbered, self._A.shape).tocsr()
            columns = np.repeat(np.arange(self._A.shape[1]), np.diff(self._A.indptr))
            scale: FloatArray = self._row_scale[self._A.indices] * self._scale[columns]
            self._refilling = scale, places.data.astype(np.int64) - 1
        scale, order = self._refilling
        self._A.data[:] = scale * values
        self._rows.data[:] = self._A.data[order]
        if self._fast is not None:
            self._fast.update(Ax=self._A.data)
        self._sure = None  # each of its updates of A loses accuracy

    def solve(
        self, q: FloatArray, lower: FloatArray, upper: FloatArray, *, fresh: bool
    ) -> QPResult:
        """Solve with new vectors; `fresh` forgets the last solution, so that the result does not
        depend on it.
        """
        if not (lower <= upper).all():
            row = int(np.argmin(lower <= upper))
            bounds = f"bounds [{lower[row]:.3g}, {upper[row]:.3g}]"
            return self._unsolved_result(f"{bounds} in row {row} cross or are not numbers")
        if not np.isfinite(q).all():
            return self._unsolved_result("cost is not finite")
        q, lower, upper = self._scale * q, self._row_scale * lower, self._row_scale * upper
        if self._fast is None:
            return self._solve_surely(q, lower, upper, 0, fresh=fresh)
        self._fast.update(q=q, l=lower, u=upper)
        if fresh:
            self._fast.update_settings(rho=RHO)
            self._fast.warm_start(x=self._zero[0], y=self._zero[1])
        answer = self._fast.solve(raise_error=False)
        info, solved = answer.info, answer.info.status_val == SOLVED
        residuals = float(info.prim_res), float(info.dual_res)
        report = SolverReport(self._stage, solved, str(info.status), int(info.iter), *residuals)
        result = self._check_answer(np.asarray(answer.x), report, lower, upper)
        if result.report.solved:
            return result
        self._fast.warm_start(x=self._zero[0], y=self._zero[1])
        return self._solve_surely(q, lower, upper, report.iterations, fresh=fresh)

    def _solve_surely(
        self, q: FloatArray, lower: FloatArray, upper: FloatArray, spent: int, *, fresh: bool
    ) -> QPResult:
        k = self._equalities
        # An update rounds the matrices once more: the last bits differ
        if fresh or self._sure is None:
            self._sure = piqp.SparseSolver()
            equal, between = self._rows[:k].tocsc(), self._rows[k:].tocsc()
            self._sure.setup(self._P, q, equal, lower[:k], between, lower[k:], upper[k:])
        else:
            self._sure.update(c=q, b=lower[:k], h_l=lower[k:], h_u=upper[k:])
        status = self._sure.solve()
        result, info, solved = self._sure.result, self._sure.result.info, status == piqp.PIQP_SOLVED
        # The next problem is near this one
        if solved and self._refilling is not None and self._fast is not None:
            self._fast.warm_start(x=np.array(result.x), y=np.r_[result.y, result.z_u - result.z_l])
        before = f" after {spent} OSQP iterations" if spent else ""
        name, residuals = (
            f"{WORDS.get(status, 'numerical trouble')} by PIQP{before}",
            (info.primal_res, info.dual_res),
        )
        report = SolverReport(
            self._stage, solved, name, spent + int(info.iter), *map(float, residuals)
        )
        return self._check_answer(np.array(result.x), report, lower, upper)

    def _check_answer(
        self, z: FloatArray, report: SolverReport, lower: FloatArray, upper: FloatArray
    ) -> QPResult:
        """Scale an answer back.

        It is not solved where it violates a bound by more than the tolerance.
        """
        if report.solved:
            value = self._rows @ z
            excess = np.maximum(lower - value, value - upper) / self._row_scale
            violation = float(np.max(excess, initial=0.0))
            if not np.isfinite(z).all() or not violation <= self._config.tolerance:
                status = f"{report.status}, but a bound is violated by {violation:.3g}"
                report = replace(report, solved=False, status=status)
        return QPResult(self._scale * z, report)

    def _unsolved_result(self, status: str) -> QPResult:
        return QPResult(self._zero[0], SolverReport(self._stage, False, status, 0, np.nan, np.nan))
