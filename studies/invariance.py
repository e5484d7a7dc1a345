"""Does a drive stay the same in a world that should not matter? Turned, mirrored, another clock,
rate or noise.

python -m studies.invariance [LOG ...] -o OUT [-p dp_qp ...] [--only turn_30 ...] [--workers N]

Without logs: the built-in suite. OUT/invariance.csv has a row per log, planner and perturbation
(`COLUMNS`). What is printed counts, per planner and perturbation, the logs whose outcome (why the
drive ended, the goal, collisions at fault) is another, and those whose ego parted from the
unperturbed drive, mapped back, by more than 1 cm and 10 cm. Of the gates it counts those that pass
or fail (`gates`), those that flip to or from a failure, and the flips that are marginal
(`replan.metrics.judge.excuses`) in neither world (`unmarked`).
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import nan, radians
from pathlib import Path

import numpy as np
import pandas as pd

from replan.core.errors import ReplanError
from replan.logs.edit.transform import (
    jittered,
    mirrored,
    mirrored_trajectory,
    moved_trajectory,
    rotated,
    sampled,
    shifted_clock,
)
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.metrics import evaluate
from replan.metrics.judge import judge
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.gates import Outcome, load_gates
from replan.metrics.judge.marginality import marginal
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.reference_drives import with_avoidability
from replan.replay.loop_config import LoopConfig
from replan.results.tables import write_file
from replan.run.ensemble import noisy
from replan.run.log_source import LogSource
from replan.run.pool import WorkerLost, run_all
from replan.run.sources import builtin_suite, select

TURNS_DEG = (30, 45, 60, 90, 120, 150, 180, 210, 240, 270, 300, 330)
TINY = 1e-9
"""Of a jitter, m, m/s and so on: far above rounding, far below anything that is measured."""
CLOCK_NS = 3_600_000_000_007
RATES_HZ, NOISE_M = (5.0, 10.0, 20.0), (0.02, 0.05)
PARTED_M = (0.01, 0.1)

COLUMNS = (
    "log",
    "planner",
    "perturbation",
    "end",
    "detail",
    "end_s",
    "goal",
    "at_fault",
    "gap_m",
    "failed_gates",
    "marginal_gates",
    "gates",
    "parted_m",
)
"""`gap_m`: smallest gap; `parted_m`: largest distance of the ego to where it was, unperturbed, at
the same time.
"""


@dataclass(frozen=True)
class Perturbation:
    """A world that should not matter, and the way back of what was driven in it."""

    name: str
    there: Callable[[Scenario], Scenario]
    back: Callable[[Trajectory], Trajectory] = lambda ego: ego


def _turn(name: str, angle: float) -> Perturbation:
    return Perturbation(
        name, partial(rotated, angle=angle), lambda ego: moved_trajectory(ego, 0.0, 0.0, -angle)
    )


def _noisy(log: Scenario, size: float) -> Scenario:
    return noisy(log, np.random.default_rng(0), size)


PERTURBATIONS: dict[str, Perturbation] = {
    each.name: each
    for each in (
        Perturbation("none", lambda log: log),
        _turn("turn_1e-12_rad", 1e-12),
        *(_turn(f"turn_{degrees}", radians(degrees)) for degrees in TURNS_DEG),
        Perturbation(
            "mirror", lambda log: replace(mirrored(log), name=log.name), mirrored_trajectory
        ),
        Perturbation("clock", lambda log: shifted_clock(log, CLOCK_NS)),
        Perturbation("jitter_1e-9", lambda log: jittered(log, TINY)),
        *(Perturbation(f"{rate:g}_hz", partial(sampled, rate_hz=rate)) for rate in RATES_HZ),
        *(
            Perturbation(f"noise_{100.0 * size:g}_cm", partial(_noisy, size=size))
            for size in NOISE_M
        ),
    )
}


@dataclass(frozen=True)
class Job:
    """One log, all its drives."""

    source: LogSource
    planners: tuple[str, ...]
    names: tuple[str, ...]
    traffic: str


def driven(job: Job) -> list[dict[str, object]]:
    """The rows of one log; one row that says why where it cannot be driven."""
    try:
        scenario = with_avoidability(job.source.read())
        return [row for planner in job.planners for row in _rows(scenario, planner, job)]
    except ReplanError as error:
        return [{"log": job.source.label, "planner": "", "perturbation": "none", "end": str(error)}]


def _rows(scenario: Scenario, planner: str, job: Job) -> Iterator[dict[str, object]]:
    gates, still = load_gates(None).asked_of(["closed"]), None
    for name in ("none", *(name for name in job.names if name != "none")):
        world = PERTURBATIONS[name].there(scenario)
        trace = run_closed_loop(world, planner, config=LoopConfig(traffic=job.traffic)).trace
        table = evaluate(trace, world)
        value = defaultdict(lambda: nan, zip(table["metric"], table["value"], strict=True))
        verdicts = judge(gates, table, {world.name: LogLabels(tags=world.tags)})
        failed = [v.gate.metric for v in verdicts if v.outcome is Outcome.FAIL]
        near = [v.gate.metric for v in verdicts if marginal(v.gate, value.__getitem__)]
        ego = PERTURBATIONS[name].back(trace.ego)
        still = ego if still is None else still
        yield {
            "log": scenario.name,
            "planner": planner,
            "perturbation": name,
            "end": trace.end.value,
            "detail": trace.detail,
            "end_s": float(ego.t[-1]),
            "goal": value.get("goal.final", nan),
            "at_fault": value.get("collision_at_fault.count", nan),
            "gap_m": value.get("gap.min", nan),
            "failed_gates": " ".join(failed),
            "marginal_gates": " ".join(near),
            "gates": sum(v.outcome is not Outcome.INCONCLUSIVE for v in verdicts),
            "parted_m": parted(still, ego),
        }


def parted(one: Trajectory, two: Trajectory) -> float:
    """Largest distance of two drives at equal times, as long as both last, m."""
    t = one.t[one.t <= two.t[-1] + 1e-9]
    x, y = (np.interp(t, two.t, column) for column in (two.x, two.y))
    return float(np.hypot(one.x[: len(t)] - x, one.y[: len(t)] - y).max(initial=0.0))


def counted(table: pd.DataFrame) -> pd.DataFrame:
    """A row per planner and perturbation: how many logs, flips and partings."""
    keys = ["log", "planner"]
    table = table[table["planner"] != ""]
    still = table[table["perturbation"] == "none"].set_index(keys)
    out = []
    for (planner, name), rows in table.groupby(["planner", "perturbation"], sort=False):
        here, there = (
            rows.set_index(keys),
            still.loc[list(rows[keys].itertuples(index=False, name=None))],
        )
        flips = pd.Series(False, index=here.index)
        for column in ("end", "goal", "at_fault"):
            flips |= ~(
                (here[column] == there[column]) | (here[column].isna() & there[column].isna())
            )
        counts = {
            f"beyond_{limit:g}_m": int((here["parted_m"] > limit).sum()) for limit in PARTED_M
        }
        changed = {
            key: _words(here, "failed_gates", key) ^ _words(there, "failed_gates", key)
            for key in here.index
        }
        near = {
            key: _words(here, "marginal_gates", key) | _words(there, "marginal_gates", key)
            for key in here.index
        }
        gates = {"gates": int(here["gates"].sum()), "gate_flips": sum(map(len, changed.values()))}
        gates["unmarked"] = sum(len(changed[key] - near[key]) for key in changed)
        row = {
            "planner": planner,
            "perturbation": name,
            "logs": len(here),
            "outcome_flips": int(flips.sum()),
        }
        out.append(row | gates | counts)
    return pd.DataFrame(out)


def _words(table: pd.DataFrame, column: str, key: Hashable) -> set[str]:
    return set(str(table.at[key, column]).split())


def compare(
    jobs: Sequence[Job], out: Path, *, workers: int, say: Callable[[str], None]
) -> pd.DataFrame:
    """Drive all jobs and write OUT/invariance.csv; returns its rows."""
    found: dict[int, list[dict[str, object]]] = {}
    ended = (
        run_all(driven, jobs, workers)
        if workers
        else ((i, driven(job)) for i, job in enumerate(jobs))
    )
    for index, rows in ended:
        label = jobs[index].source.label
        lost: dict[str, object] = {"log": label, "planner": "", "perturbation": "none"}
        found[index] = [lost | {"end": rows.reason}] if isinstance(rows, WorkerLost) else rows
        say(f"{len(found)} of {len(jobs)}: {label}")
    table = pd.DataFrame(
        [row for index in sorted(found) for row in found[index]], columns=list(COLUMNS)
    )
    out.mkdir(parents=True, exist_ok=True)
    write_file(
        out / "invariance.csv",
        lambda partial: table.to_csv(partial, index=False, lineterminator="\n"),
    )
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the table and print the counts; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.invariance", description="Perturbed drives."
    )
    parser.add_argument(
        "logs", nargs="*", type=Path, help="files or folders; none: the built-in suite"
    )
    parser.add_argument("-o", "--out", required=True, type=Path, help="folder for the table")
    parser.add_argument("-p", "--planner", action="append", help="default: dp_qp")
    parser.add_argument("--only", action="append", choices=list(PERTURBATIONS), help="default: all")
    parser.add_argument("--traffic", default=LoopConfig().traffic)
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, help="processes; 0: in this one"
    )
    chosen = parser.parse_args(arguments)
    planners, names = tuple(chosen.planner or ["dp_qp"]), tuple(chosen.only or PERTURBATIONS)
    try:
        selection = select(chosen.logs) if chosen.logs else builtin_suite()
    except ReplanError as error:
        parser.error(str(error))
    jobs = [Job(source, planners, names, chosen.traffic) for source in selection.sources]
    table = compare(
        jobs,
        chosen.out,
        workers=chosen.workers,
        say=lambda line: print(line, file=sys.stderr),  # noqa: T201
    )
    print(counted(table).to_string(index=False))  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main())
