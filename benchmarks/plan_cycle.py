"""How long a plan takes, stage by stage, over the built-in suite in closed loop.

    python benchmarks/plan_cycle.py [--planner dp_qp] [--repeat 3] [LOG ...]

One process, one drive per log to warm up (kernels compiled, caches hot), then `--repeat` measured
drives. Beside milliseconds, which mean this machine on this day, the table quotes ratios that
travel: to a yardstick (one Cholesky solution of a fixed 200 x 200 system, timed in between), p99 to
p50, and the share of the plan period.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table
from scipy.linalg import cho_factor, cho_solve

from replan.logs.scenario import Scenario
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import LoopConfig
from replan.run.sources import builtin_suite, select


def yardstick(count: int = 50) -> list[float]:
    """Seconds of each of `count` solutions of the same positive definite system."""
    rng = np.random.default_rng(1)
    half = rng.normal(size=(200, 200))
    matrix, right = half @ half.T + 200.0 * np.eye(200), rng.normal(size=200)
    times = []
    for _ in range(count):
        begin = perf_counter()
        cho_solve(cho_factor(matrix), right)
        times.append(perf_counter() - begin)
    return times


def measured(
    scenarios: Sequence[Scenario], planner: str, repeat: int
) -> tuple[pd.DataFrame, float]:
    """One row per stage of each plan (log, stage, seconds), and the yardstick's median, s."""
    for scenario in scenarios:
        run_closed_loop(scenario, planner)
    rows: list[tuple[str, str, float]] = []
    solutions = yardstick()
    for _ in range(repeat):
        for scenario in scenarios:
            timings = run_closed_loop(scenario, planner).timings
            rows += [(scenario.name, timing.stage, timing.seconds) for timing in timings]
            solutions += yardstick()
    return pd.DataFrame(rows, columns=["log", "stage", "seconds"]), float(np.median(solutions))


def table(title: str, rows: pd.DataFrame, by: str, unit: float, period: float) -> Table:
    """Quantiles and ratios of each group."""
    out = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))
    out.add_column(by)
    for head in (
        "plans",
        "p50 ms",
        "p95 ms",
        "p99 ms",
        "p50 / yardstick",
        "p99 / p50",
        "p99 of period",
    ):
        out.add_column(head, justify="right")
    for name, seconds in rows.groupby(by, sort=False)["seconds"]:
        p50, p95, p99 = (float(seconds.quantile(q)) for q in (0.5, 0.95, 0.99))
        milliseconds = (f"{1e3 * value:.3f}" for value in (p50, p95, p99))
        ratios = f"{p50 / unit:.2f}", f"{p99 / p50:.1f}", f"{100.0 * p99 / period:.1f}%"
        out.add_row(str(name), str(len(seconds)), *milliseconds, *ratios)
    return out


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="How long a plan takes, stage by stage.")
    parser.add_argument(
        "logs", nargs="*", type=Path, help="logs or folders; none: the built-in suite"
    )
    parser.add_argument("--planner", default="dp_qp")
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    chosen = select(options.logs) if options.logs else builtin_suite()
    scenarios = [source.read() for source in chosen.sources]
    rows, unit = measured(scenarios, options.planner, options.repeat)
    period = LoopConfig().plan_period_s
    console = Console(width=None if Console().is_terminal else 120)
    console.print(
        f"{options.planner}, {len(scenarios)} logs, closed loop; yardstick {1e3 * unit:.3f} ms"
    )
    console.print(table("\nby stage", rows, "stage", unit, period))
    console.print(table("\nwhole plan by log", rows[rows["stage"] == "total"], "log", unit, period))


if __name__ == "__main__":
    main()
