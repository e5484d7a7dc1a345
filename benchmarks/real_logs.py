"""What each of a set of real logs holds, what is wrong with it, and how planners did on it: one
table.

    python benchmarks/real_logs.py LOG_OR_FOLDER ... -o OUT [--ego ID]

Both loops with `dp_qp` and `logged`, without recordings. `OUT/real_logs.md` has a row per log,
`OUT/run` is the run.
"""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path

import pandas as pd

from replan.config import RunConfig
from replan.draw.drawn_results import Results
from replan.logs.readers import LogSettings, reader_of
from replan.metrics.judge import worst
from replan.metrics.judge.gates import Outcome
from replan.run import evaluate_logs
from replan.run.sources import select

PLANNERS = ("dp_qp", "logged")
HEAD = (
    "log",
    "format",
    "s",
    "ego states",
    "road users",
    "lanes",
    "findings",
    "dp_qp open: ADE 3 s, fallback",
    "dp_qp closed",
    "verdict",
    "logged closed",
)


def held(paths: list[Path], settings: LogSettings) -> dict[str, list[str]]:
    """By label of the log: format, duration, states, road users, lanes."""
    out = {}
    for source in select(paths, settings).sources:
        scenario, reader = source.read(), reader_of(source.path) if source.path else None
        kinds = Counter(kind.value for kind in scenario.tracks.kinds)
        users = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common()) or "none"
        row = [
            reader.name if reader else "",
            f"{scenario.duration:.1f}",
            str(len(scenario.ego)),
            users,
        ]
        out[source.label] = [*row, str(len(scenario.road.lanes))]
    return out


def row(name: str, about: list[str], result: Results) -> list[str]:
    """The cells of one log."""
    found = Counter(result.health.loc[result.health["log"] == name, "kind"])
    findings = ", ".join(f"{count} {kind}" for kind, count in found.items()) or "none"
    table = result.metrics[(result.metrics["log"] == name) & (result.metrics["planner"] == "dp_qp")]
    value = table.set_index(["mode", "metric"])["value"]
    ends = {
        (drive.planner, drive.mode): drive
        for drive in result.drives[result.drives["log"] == name].itertuples()
    }
    done = value.get(("closed", "route_progress.final"), float("nan"))
    closed = ends.get(("dp_qp", "closed"))
    opened = (
        f"{value.get(('open', 'ade.3s.mean'), float('nan')):.2f} m, "
        f"{value.get(('open', 'fallback.rate'), 0):.0%}"
    )
    verdict = worst(
        map(Outcome, result.verdicts.query("log == @name and planner == 'dp_qp'")["outcome"])
    ).value
    logged = ends.get(("logged", "closed"))
    return [
        name,
        *about,
        findings,
        opened,
        f"{closed.end}, {done:.0%}" if closed else "failed",
        str(verdict),
        logged.end if logged else "failed",
    ]


def main() -> None:
    """Evaluate and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--ego", default="")
    told = parser.parse_args()
    settings = LogSettings(ego=told.ego)
    run = RunConfig(PLANNERS, recording=False, internals="none", log=settings)
    result = evaluate_logs(told.logs, run, told.out / "run", workers=1)
    about = held(told.logs, settings)
    rows = [
        row(log.log, about[log.source], result) for log in result.logs.itertuples() if log.sha256
    ]
    frame = pd.DataFrame(rows, columns=list(HEAD))
    lines = ["| " + " | ".join(HEAD) + " |", "|" + "---|" * len(HEAD)]
    lines += ["| " + " | ".join(map(str, cells)) + " |" for cells in frame.itertuples(index=False)]
    lines += [f"\nnot evaluated: {failure.message}" for failure in result.failures.itertuples()]
    (told.out / "real_logs.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
