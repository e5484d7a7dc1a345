"""Is a regression noticed? One of each kind is planted in the planner, and the run compared with
the untouched one.

python -m studies.regressions -o OUT [LOG ...] [--only NAME ...] [--ensemble N] [--workers N]

Logs are files, or names of the catalogue; without any: the built-in suite. OUT/NAME are the
results, OUT/regressions.csv has a row per change (`COLUMNS`): exit code, the rules of comparison
that it breaks (the packaged ones and `STRICT`), and where most of the drives part. The last three
must break none: the same again, the ego's log moved by 1e-9, and another solver of the same
problems.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from replan.compare_runs import compare_runs
from replan.config import RunConfig
from replan.core.errors import ReplanError
from replan.draw.drawn_results import Results
from replan.logs.agents import AgentKind
from replan.logs.frame import Frame, PlannerContext, Predictions
from replan.logs.mcap import write_scenario
from replan.logs.plan import Plan
from replan.logs.scenario import Scenario
from replan.metrics.comparison import Comparison
from replan.metrics.judge.gates import GateRule, Outcome
from replan.planners.dp_qp.planner import DpQp
from replan.results.tables import safe_name, write_file
from replan.run import evaluate_logs
from replan.run.log_source import LogSource
from replan.run.sources import builtin_suite, select

TINY_M = 1e-9
PLANNER = "dp_qp"
BASE = RunConfig(recording=False)
BLIND = f"{__name__ if __name__ != '__main__' else 'studies.regressions'}:BlindToPedestrians"
COLUMNS = (
    "change",
    "exit_code",
    "broken_rules",
    "to_fail",
    "values_worse",
    "parted",
    "stage",
    "first",
)


class BlindToPedestrians:
    """The built-in planner, shown everybody but pedestrians: a class of obstacles that is lost on
    the way to it.
    """

    def __init__(self, context: PlannerContext) -> None:
        self._planner = DpQp(context)

    def plan(self, frame: Frame) -> Plan:
        """As the built-in planner, of the frame without them."""
        return self._planner.plan(without(frame, AgentKind.PEDESTRIAN))


def without(frame: Frame, kind: AgentKind) -> Frame:
    """The frame without agents of a kind, and without their predictions."""
    agents, some = frame.agents, frame.predictions
    keep = np.array([one is not kind for one in agents.kinds], bool)
    there = np.flatnonzero(keep)
    left = agents.some(there)
    rows = keep[some.agent]
    place = np.cumsum(keep) - 1
    predictions = Predictions(
        some.t,
        place[some.agent[rows]],
        some.probability[rows],
        some.x[rows],
        some.y[rows],
        some.yaw[rows],
        some.method,
    )
    return replace(frame, agents=left, predictions=predictions)


def _same(scenario: Scenario) -> Scenario:
    return scenario


def _off(scenario: Scenario) -> Scenario:
    return replace(
        scenario, ego=replace(scenario.ego, x=scenario.ego.x + TINY_M, y=scenario.ego.y + TINY_M)
    )


@dataclass(frozen=True)
class Change:
    """Something that is changed: the run, and the logs where they are."""

    what: str
    run: RunConfig
    logs: Callable[[Scenario], Scenario] = _same


def _loop(**keys: Any) -> RunConfig:
    return replace(BASE, loop=replace(BASE.loop, **keys))


def _planner(table: Mapping[str, Any]) -> RunConfig:
    return replace(BASE, planner={PLANNER: table})


CHANGES: Mapping[str, Change] = {
    "weight": Change(
        "the speed DP's weight of nearness, 30 -> 0", _planner({"speed": {"dp": {"w_near": 0.0}}})
    ),
    "delay": Change("plans are driven 100 ms late", _loop(plan_delay_s=0.1)),
    "class": Change("the planner is not shown pedestrians", replace(BASE, planners=(BLIND,))),
    "prediction": Change(
        "everybody goes on at constant velocity", _loop(prediction="constant_velocity")
    ),
    "again": Change("nothing", BASE),
    "tiny": Change("the ego's log moved by 1e-9 m", BASE, _off),
    "solver": Change(
        "PIQP instead of the built-in interior point method", _planner({"solver": "piqp"})
    ),
}
STRICT = (
    GateRule("ttc.min", max_decrease=1.0, over="worst"),
    GateRule("thw.min", max_decrease=0.3, over="worst"),
)
"""What changes a few logs of eighteen cannot be significant: no log may come nearer to a collision
by a second, or follow nearer by 0.3 s; the latter has a value where no collision course is near."""
HARMLESS = ("again", "tiny", "solver")
"""Must break no rule."""


def compared(
    out: Path, names: Sequence[str], changes: Sequence[str], workers: int, ensemble: int = 0
) -> Iterator[tuple[str, Comparison]]:
    """Each change, compared with the baseline, as it is there.

    Args:
        out: Folder for logs and results.
        names: Files, or names of logs of the catalogue; none: the built-in suite.
        changes: Of `CHANGES`.
        workers: Processes.
        ensemble: Members of each drive of the baseline: with some, it is known which drives are
            fragile.
    """
    files = [Path(name) for name in names if Path(name).exists()]
    sources = [LogSource(name) for name in names if not Path(name).exists()]
    sources += select(files).sources if files else () if names else builtin_suite().sources
    logs = [source.read() for source in sources]
    baseline = _run(out, "baseline", Change("", replace(BASE, ensemble=ensemble)), logs, workers)
    for name in changes:
        change = CHANGES[name]
        candidate = _run(out, name, change, logs, workers)
        planners = (PLANNER, change.run.planners[0])
        # Their hashes say that they are others: asked is what 1e-9 m alone does
        if change.logs is not _same:
            hashes = {log["log"]: log["sha256"] for log in baseline.summary["logs"]}
            logs_now = [{**log, "sha256": hashes[log["log"]]} for log in candidate.summary["logs"]]
            candidate = replace(candidate, summary={**candidate.summary, "logs": logs_now})
        yield name, compare_runs(baseline, candidate, planners, more=STRICT, partings=2 * len(logs))


def _run(out: Path, name: str, change: Change, logs: Sequence[Scenario], workers: int) -> Results:
    folder = out / "logs" if change.logs is _same else out / f"logs_{name}"
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{safe_name(log.name)}.mcap" for log in logs]
    for file, log in zip(files, logs, strict=True):
        write_scenario(file, change.logs(log))
    return evaluate_logs(files, change.run, out / name, workers=workers)


def row(name: str, comparison: Comparison) -> dict[str, Any]:
    """What a change came to: `COLUMNS`."""
    broken = [verdict.rule for verdict in comparison.verdicts if verdict.outcome is Outcome.FAIL]
    partings = comparison.partings
    stage, count = Counter(partings["stage"]).most_common(1)[0] if len(partings) else ("", 0)
    first = partings[partings["stage"] == stage].iloc[0] if count else None
    return dict(
        zip(
            COLUMNS,
            (
                name,
                comparison.exit_code,
                "; ".join(broken),
                int(((comparison.flips["after"] == "fail") & ~comparison.flips["marginal"]).sum()),
                int((comparison.pairs["worse"] > 0.0).sum()),
                len(partings),
                f"{stage} ({count})" if count else "",
                f"{first['log']}, {first['mode']} loop: {first['what']}"
                if first is not None
                else "",
            ),
            strict=True,
        )
    )


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("logs", nargs="*", help="files, or names of the catalogue")
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--only", nargs="+", choices=list(CHANGES), default=list(CHANGES))
    parser.add_argument("--ensemble", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args()
    rows = []
    try:
        for name, comparison in compared(
            asked.out, asked.logs, asked.only, asked.workers, asked.ensemble
        ):
            rows.append(row(name, comparison))
            sys.stdout.write(
                "\n".join(f"{key}: {value}" for key, value in rows[-1].items()) + "\n\n"
            )
            sys.stdout.flush()
    except ReplanError as error:
        sys.exit(f"error: {error}")
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    write_file(
        asked.out / "regressions.csv",
        lambda partial: table.to_csv(partial, index=False, lineterminator="\n"),
    )


if __name__ == "__main__":
    main()
