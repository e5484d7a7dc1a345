"""Every QP of a set of drives, by each solver, against a reference: how near, how often, how many
iterations, how long.

    python benchmarks/solvers.py [--no-builtin] [--limit 100] [COMMONROAD_FOLDER ...] [--out table.md]

`dp_qp` drives each log in closed loop; the problems of its path and speed QPs are recorded and
solved again, by each solver of `replan.planners.piecewise_jerk.solvers` and by the referee: PIQP at
1e-9, and where that finds no solution HiGHS says whether there is one. CPU time, building the
solver's input included; it means this machine on this day. The outcome is in benchmarks/README.md.
"""  # noqa: E501

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path
from time import process_time
from typing import Any
from unittest.mock import patch

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd
import piqp
from rich.console import Console
from scipy import sparse
from scipy.optimize import linprog

from replan.core.arrays import FloatArray
from replan.planners.dp_qp.path import qp as path_qp
from replan.planners.dp_qp.speed import qp as speed_qp
from replan.planners.piecewise_jerk.problem import PiecewiseJerkProblem
from replan.planners.piecewise_jerk.solvers import SOLVERS, matrices, solve, structure, vectors
from replan.planners.solver import QPResult
from replan.replay.loop.closed_loop import run_closed_loop
from replan.run.log_source import LogSource
from replan.run.sources import builtin_suite

REFERENCE = 1e-9
Asked = tuple[str, PiecewiseJerkProblem, float]


def problems_of(source: LogSource) -> list[Asked]:
    """Stage, problem and tolerance of every QP of one drive."""
    asked: list[Asked] = []

    def recorded(
        problem: PiecewiseJerkProblem, solver: str, *, stage: str, tolerance: float
    ) -> QPResult:
        asked.append((stage, problem, tolerance))
        return solve(problem, solver, stage=stage, tolerance=tolerance)

    with patch.object(path_qp, "solve", recorded), patch.object(speed_qp, "solve", recorded):
        run_closed_loop(source.read(), "dp_qp")
    return asked


def reference(problem: PiecewiseJerkProblem) -> tuple[str, FloatArray]:
    """Feasible, with the curve.

    Infeasible; or no reference, where PIQP gives up on what HiGHS calls feasible.
    """
    form, (q, low, high) = matrices(structure(problem)), vectors(problem)
    none, k = np.full(3 * problem.lower.shape[1], np.nan), form.equalities
    if not (low <= high).all():
        return "infeasible", none
    S, rows = form.sizes, form.A.tocsr()
    A = rows.multiply(S).tocsr()
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = solver.settings.eps_rel = REFERENCE
    P = form.P.multiply(np.outer(S, S)).tocsc()
    solver.setup(P, q * S, A[:k].tocsc(), low[:k], A[k:].tocsc(), low[k:], high[k:])
    if solver.solve() == piqp.PIQP_SOLVED:
        return "feasible", (np.array(solver.result.x) * S)[: len(none)]
    between = {
        "A_ub": sparse.vstack([A[k:], -A[k:]]),
        "b_ub": np.r_[high[k:], -low[k:]],
        "A_eq": A[:k],
        "b_eq": low[:k],
    }
    found = linprog(np.zeros(len(S)), bounds=(None, None), method="highs", **between)
    return ("infeasible" if found.status == 2 else "no reference"), none


def rows_of(source: LogSource, group: str) -> Iterator[dict[str, Any]]:
    """One row per problem and solver."""
    for stage, problem, tolerance in problems_of(source):
        verdict, best = reference(problem)
        for name in SOLVERS:
            begin = process_time()
            result = solve(problem, name, stage=stage, tolerance=tolerance)
            spent = process_time() - begin
            n, report = problem.lower.shape[1], result.report
            yield {
                "problems": f"{stage}, {group}",
                "solver": name,
                "verdict": verdict,
                "solved": report.solved,
                "named": "infeasible" in report.status,
                "off": np.abs(result.x[:n] - best[:n]).max() if report.solved else np.nan,
                "iterations": report.iterations,
                "us": 1e6 * spent,
            }


def summary(rows: pd.DataFrame) -> dict[str, Any]:
    """One line of the table."""
    possible, none = rows[rows.verdict == "feasible"], rows[rows.verdict == "infeasible"]
    off = possible.off.dropna()

    def quantiles(values: pd.Series, *shares: float, digits: str = ".0f") -> str:
        return (
            " / ".join(format(values.quantile(share), digits) for share in shares)
            if len(values)
            else "-"
        )

    return {
        "n": len(rows),
        "solved": f"{int(possible.solved.sum())} of {len(possible)}",
        "off p50 / p99 / max, m": quantiles(off, 0.5, 0.99, 1.0, digits=".0e"),
        "infeasible: named / unsolved / 'solved'": f"{int((none.named & ~none.solved).sum())} / "
        f"{int((~none.named & ~none.solved).sum())} / {int(none.solved.sum())}",
        "iterations p50 / p99": quantiles(rows.iterations, 0.5, 0.99),
        "CPU us p50 / p95": quantiles(rows.us, 0.5, 0.95),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="*", type=Path)
    parser.add_argument("--no-builtin", action="store_true")
    parser.add_argument("--limit", type=int, help="logs of each folder")
    parser.add_argument("--out", type=Path, help="Markdown")
    chosen = parser.parse_args()
    sources = [] if chosen.no_builtin else [(one, "built-in") for one in builtin_suite().sources]
    for folder in chosen.folder:
        files = sorted(folder.glob("*.xml"))[: chosen.limit]
        sources += [(LogSource(str(file), file), folder.name) for file in files]
    rows = []
    for source, group in sources:
        rows += list(rows_of(source, group))
        print(source.label, len(rows) // len(SOLVERS), flush=True)
    table = pd.DataFrame(
        [
            {"problems": problems, "solver": solver, **summary(each)}
            for (problems, solver), each in pd.DataFrame(rows).groupby(
                ["problems", "solver"], sort=False
            )
        ]
    )
    text = "\n".join(
        [
            "| " + " | ".join(map(str, line)) + " |"
            for line in (table.columns, ["---"] * len(table.columns))
        ]
        + ["| " + " | ".join(map(str, line)) + " |" for line in table.itertuples(index=False)]
    )
    Console(width=240).print(text, markup=False, highlight=False, soft_wrap=True)
    if chosen.out:
        chosen.out.write_text(text + "\n")


if __name__ == "__main__":
    main()
