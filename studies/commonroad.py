"""Planners over CommonRoad scenarios, by source and traffic: one command, one table.

python -m studies.commonroad DIR -o OUT [--planner dp_qp ...] [--traffic give_way ...] [--resume]

    OUT/commonroad.csv, .md     a row per traffic, source and planner (`COLUMNS`)
    OUT/commonroad_logs.csv     a row per traffic, log and planner: which logs these numbers are
                                made of
    OUT/give_way, OUT/time      the runs, as `replan evaluate` writes them

The planner `logged` is always among them. A log's goal is within reach where `logged` enters it (in
the same traffic) or where the careful driver of UN R157 does, among the log's traffic
(`replan.replay.loop.reference_drives`): they keep their lane, never accelerate, and a touch ends
their drive as it ends a planner's.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from replan.config import RunConfig
from replan.core.errors import ReplanError
from replan.draw.drawn_results import Results
from replan.logs.trace import EndReason, Mode
from replan.metrics.judge import CAREFUL, worst
from replan.metrics.judge.gates import Outcome
from replan.replay.loop_config import LoopConfig
from replan.replay.parts import TRAFFIC
from replan.results.tables import write_file, write_text
from replan.run import evaluate_logs

PLANNERS = ("dp_qp", "idm", "lattice")
KINDS = ("give_way", "time", "reactive")
"""Of traffic."""
REFERENCE = "logged"
SOURCES = {"ngsim": "NGSIM", "mona": "MONA", "sumo": "SUMO", "synthesised": "synthesised"}
"""By tag of the scenario; what has none of these is made by hand."""
HAND_MADE, ALL = "hand-made", "all"
JERK_MPS3, LATERAL_MPS2 = 4.13, 4.89
"""Comfort is kept where 99 in 100 samples of the jerk and all of the lateral acceleration are
within these (nuPlan).

A drive too short to have a jerk breaks neither.
"""

COLUMNS = {
    "logs": "driven",
    "goal": "drives that enter the goal before the log ends",
    "reachable": "logs whose goal logged or the careful driver enters",
    "goal_of_reachable": "of these, entered",
    "passed": "logs of which the default gates say pass",
    "failed": "fail",
    "inconclusive": "no evidence for or against the planner",
    "run_into": "drives that the replay ended by running into the ego",
    "collisions": "drives that touch somebody",
    "at_fault": "drives with a collision at fault",
    "avoidable": "of these, avoided by the careful driver",
    "unavoidable": "of these, not avoided by it",
    "not_applicable": "of these, at constant speed the ego would meet nobody",
    "fallback_rate": "share of all frames in which the planner could not plan",
    "comfort": (
        f"drives with jerk p99 within {JERK_MPS3} m/s3 and lateral acceleration within "
        f"{LATERAL_MPS2} m/s2"
    ),
    "p50_ms": "plan cycle, median over all frames",
    "p99_ms": "plan cycle, 99th percentile",
    "not_evaluated": "logs on which the planner could not be evaluated",
}


ROWS = {
    "goal": "goal.final",
    "collision": "collision.count",
    "at_fault": "collision_at_fault.count",
    "fallback_rate": "fallback.rate",
    "jerk_p99_mps3": "lon_jerk_state.p99",
    "lat_accel_max_mps2": "lat_accel.max_abs",
    "applies": "reference_cc.applies",
    "avoids": "reference_cc.avoids",
}
"""What is taken of each drive, by column of the table of drives."""


def source_of(tags: Sequence[str]) -> str:
    """Who made a scenario, by its tags."""
    return next((name for tag, name in SOURCES.items() if tag in tags), HAND_MADE)


def drives(result: Results, traffic: str) -> pd.DataFrame:
    """A row per log and planner of a run; `frames` is how many plans were made."""
    driven = result.metrics["available"] & (result.metrics["mode"] == Mode.CLOSED.value)
    found = result.metrics[driven].pivot_table(
        index=["log", "planner"], columns="metric", values="value", dropna=False
    )
    rows = found.reindex(columns=list(ROWS.values())).set_axis(list(ROWS), axis=1).reset_index()
    tags = dict(zip(result.logs["log"], result.logs["tags"], strict=True))
    rows.insert(0, "traffic", traffic)
    rows.insert(1, "source", [source_of(tags[log]) for log in rows["log"]])
    text = result.drives[["log", "planner", "end", "detail"]].to_dict("records")
    ends = {
        (row["log"], row["planner"]): ": ".join(filter(None, (row["end"], row["detail"])))
        for row in text
    }
    rows["end"] = [ends[key] for key in zip(rows["log"], rows["planner"], strict=True)]
    rows["verdict"] = np.select(
        [rows["applies"] == 0.0, rows["avoids"] == 1.0, rows["avoids"] == 0.0],
        ["not applicable", "avoidable", "unavoidable"],
        "unknown",
    )
    totals = result.timings[result.timings["stage"] == "total"]
    frames = totals.groupby(["log", "planner"], observed=True)["seconds"].size()
    rows["frames"] = [
        int(frames.get(key, 0)) for key in zip(rows["log"], rows["planner"], strict=True)
    ]
    rows["comfort"] = ~(
        (rows["jerk_p99_mps3"] > JERK_MPS3) | (rows["lat_accel_max_mps2"] > LATERAL_MPS2)
    )
    logged = rows[(rows["planner"] == REFERENCE) & (rows["goal"] == 1.0)]["log"]
    careful = result.references[result.references["planner"] == CAREFUL]
    entered = careful[(careful["metric"] == ROWS["goal"]) & (careful["value"] == 1.0)]["log"]
    rows["reachable"] = rows["log"].isin({*logged, *entered})
    outcomes = result.verdicts.groupby(["log", "planner"])["outcome"]
    verdicts = {
        (str(log), str(who)): worst(map(Outcome, each)).value for (log, who), each in outcomes
    }
    rows["gates"] = [
        verdicts.get(key, "") for key in zip(rows["log"], rows["planner"], strict=True)
    ]
    return rows.drop(columns=["applies", "avoids"])


def table_of(result: Results, rows: pd.DataFrame, planners: Sequence[str]) -> pd.DataFrame:
    """A row per source and planner: what `COLUMNS` says of the drives `rows` of one run."""
    seconds = result.timings[result.timings["stage"] == "total"].merge(
        rows[["log", "planner", "source"]], on=["log", "planner"]
    )
    lost = [(failure.log, failure.planner) for failure in result.failures.itertuples()]
    tags = {log["log"]: source_of(log["tags"]) for log in result.summary["logs"] if log["sha256"]}
    out = []
    for source in (*dict.fromkeys([*SOURCES.values(), HAND_MADE]), ALL):
        for planner in planners:
            mine = [part[part["planner"] == planner] for part in (rows, seconds)]
            if source != ALL:
                mine = [part[part["source"] == source] for part in mine]
            failed = {
                log
                for log, who in lost
                if who in (planner, None) and source in (ALL, tags.get(log))
            }
            if len(mine[0]) or failed:
                out.append(
                    {
                        "source": source,
                        "planner": planner,
                        **_counted(*mine),
                        "not_evaluated": len(failed),
                    }
                )
    return pd.DataFrame(out)


def _counted(rows: pd.DataFrame, seconds: pd.DataFrame) -> dict[str, float]:
    fault = rows[rows["at_fault"] > 0.0]
    frames = int(rows["frames"].sum())
    fallen = float((rows["fallback_rate"] * rows["frames"]).sum())
    times = 1e3 * seconds["seconds"].to_numpy(dtype=np.float64)
    return {
        "logs": len(rows),
        "goal": int((rows["goal"] == 1.0).sum()),
        "reachable": int(rows["reachable"].sum()),
        "goal_of_reachable": int(((rows["goal"] == 1.0) & rows["reachable"]).sum()),
        **{
            column: int((rows["gates"] == outcome).sum())
            for column, outcome in (
                ("passed", "pass"),
                ("failed", "fail"),
                ("inconclusive", "inconclusive"),
            )
        },
        "run_into": int(rows["end"].str.startswith(EndReason.REPLAY_CONTACT.value).sum()),
        "collisions": int((rows["collision"] > 0.0).sum()),
        "at_fault": len(fault),
        **{
            name.replace(" ", "_"): int((fault["verdict"] == name).sum())
            for name in ("avoidable", "unavoidable", "not applicable")
        },
        "fallback_rate": fallen / frames if frames else np.nan,
        "comfort": int(rows["comfort"].sum()),
        "p50_ms": float(np.percentile(times, 50.0)) if len(times) else np.nan,
        "p99_ms": float(np.percentile(times, 99.0)) if len(times) else np.nan,
    }


def markdown(table: pd.DataFrame) -> str:
    """The table as a page: one table per traffic, and what its columns mean."""
    lines = ["# Planners over CommonRoad scenarios", ""]
    names = ["source", "planner", *COLUMNS]
    for traffic, rows in table.groupby("traffic", sort=False):
        lines += [
            f"## Traffic: {traffic}",
            "",
            f"| {' | '.join(names)} |",
            "|" + " --- |" * len(names),
        ]
        lines += [
            f"| {' | '.join(_cell(name, row[name]) for name in names)} |"
            for row in rows.to_dict("records")
        ]
        lines += [""]
    return "\n".join([*lines, *(f"- `{name}`: {meaning}" for name, meaning in COLUMNS.items()), ""])


def _cell(name: str, value: object) -> str:
    if isinstance(value, float) and not np.isfinite(value):
        return "-"
    if name == "fallback_rate":
        return f"{100.0 * float(str(value)):.1f} %"
    return f"{value:.1f}" if name.endswith("_ms") else str(value)


def compare(
    logs: Sequence[Path | str],
    out: Path,
    *,
    planners: Sequence[str] = PLANNERS,
    traffic: Sequence[str] = KINDS,
    workers: int = 0,
    resume: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> pd.DataFrame:
    """Drive the logs with each planner in each traffic and write the tables (module docstring).

    Raises:
        ConfigError, PlannerError: As `evaluate_logs`.
    """
    chosen = tuple(dict.fromkeys([*planners, REFERENCE]))
    tables: list[pd.DataFrame] = []
    parts: list[pd.DataFrame] = []
    for kind in traffic:
        loop = LoopConfig(traffic=kind)
        run = RunConfig(
            planners=chosen, mode="closed", recording=False, internals="none", loop=loop
        )
        result = evaluate_logs(logs, run, out / kind, workers=workers, resume=resume)
        for failure in result.failures.itertuples():
            say(f"traffic {kind}: {failure.message}")
        rows = drives(result, kind)
        found = table_of(result, rows, chosen)
        found.insert(0, "traffic", kind)
        parts.append(rows)
        tables.append(found)
    table = pd.concat(tables, ignore_index=True)[["traffic", "source", "planner", *COLUMNS]]
    _write_csv(out / "commonroad.csv", table)
    _write_csv(out / "commonroad_logs.csv", pd.concat(parts, ignore_index=True))
    write_text(out / "commonroad.md", markdown(table))
    return table


def _write_csv(path: Path, table: pd.DataFrame) -> None:
    write_file(path, lambda partial: table.to_csv(partial, index=False, lineterminator="\n"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the tables and print the page; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.commonroad",
        description="Compare planners over CommonRoad scenarios.",
    )
    parser.add_argument("logs", nargs="+", type=Path, help="CommonRoad files, or folders of them")
    parser.add_argument(
        "-o", "--out", required=True, type=Path, help="folder for the tables and the runs"
    )
    parser.add_argument("-p", "--planner", action="append", help=f"default: {', '.join(PLANNERS)}")
    parser.add_argument(
        "--traffic",
        action="append",
        choices=list(TRAFFIC.builtin),
        help=f"default: {', '.join(KINDS)}",
    )
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, help="processes; 0: in this one"
    )
    parser.add_argument(
        "--resume", action="store_true", help="go on with an interrupted run in OUT"
    )
    chosen = parser.parse_args(arguments)
    try:
        table = compare(
            chosen.logs,
            chosen.out,
            planners=chosen.planner or PLANNERS,
            traffic=chosen.traffic or KINDS,
            workers=chosen.workers,
            resume=chosen.resume,
            say=lambda line: print(line, file=sys.stderr),  # noqa: T201
        )
    except ReplanError as error:
        parser.error(str(error))
    except KeyboardInterrupt:
        print(  # noqa: T201
            "interrupted: finished logs are kept; to go on give the same command with --resume",
            file=sys.stderr,
        )
        return 130
    print(markdown(table))  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main())
