"""Planners over CommonRoad scenarios, by source and traffic: one command, one table.

python -m replay.experiments.commonroad DIR -o OUT [--planner dp_qp ...] [--traffic give_way ...] [--resume]

    OUT/commonroad.csv, .md     a row per traffic, source and planner (`COLUMNS`)
    OUT/commonroad_logs.csv     a row per traffic, log and planner: which logs these numbers are made of
    OUT/give_way, OUT/time      the runs, as `replan evaluate` writes them

The planner `logged` is always among them. A log's goal is within reach where `logged` enters it (in the same traffic)
or where the careful driver of UN R157 does, which keeps its lane and never accelerates (`REFERENCE_GOAL`). A replayed
car may run into that driver and is not counted against it, while such a touch ends a planner's drive; so the table also
counts the logs whose goal is entered by one of them whom nobody touched before (`UNTOUCHED_GOAL`).
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import pandas as pd

from logs.errors import ReplanError
from logs.scenario import Scenario
from logs.trace import Mode, Trace
from metrics.metric import FINAL, Measured, Metric, Series, Unavailable
from metrics.reference_drivers import STANDING_MPS, STEP_S, careful_drive
from replay.avoidability import reference_line
from replay.batch import RunResult, evaluate_logs
from replay.batch.results import write_file, write_text
from replay.config import RunConfig
from replay.drive import LoopConfig
from replay.traffic import TRAFFIC

PLANNERS = ("dp_qp", "idm", "lattice")
KINDS = ("give_way", "time", "reactive")
"""Of traffic."""
REFERENCE = "logged"
SOURCES = {"ngsim": "NGSIM", "mona": "MONA", "sumo": "SUMO", "synthesised": "synthesised"}
"""By tag of the scenario; what has none of these is made by hand."""
HAND_MADE, ALL = "hand-made", "all"
JERK_MPS3, LATERAL_MPS2 = 4.13, 4.89
"""Comfort is kept where 99 in 100 samples of the jerk and all of the lateral acceleration are within these (nuPlan).

A drive too short to have a jerk breaks neither.
"""

COLUMNS = {
    "logs": "driven",
    "goal": "drives that enter the goal before the log ends",
    "reachable": "logs whose goal logged or the careful driver enters",
    "goal_of_reachable": "of these, entered",
    "untouched": "of these, entered by logged or the careful driver before anybody touched it",
    "goal_of_untouched": "of these, entered",
    "collisions": "drives that touch somebody",
    "at_fault": "drives with a collision at fault",
    "avoidable": "of these, avoided by the careful driver",
    "unavoidable": "of these, not avoided by it",
    "not_applicable": "of these, at constant speed the ego would meet nobody",
    "fallback_rate": "share of all frames in which the planner could not plan",
    "comfort": f"drives with jerk p99 within {JERK_MPS3} m/s3 and lateral acceleration within {LATERAL_MPS2} m/s2",
    "p50_ms": "plan cycle, median over all frames",
    "p99_ms": "plan cycle, 99th percentile",
    "not_evaluated": "logs on which the planner could not be evaluated",
}


def _reference_goal(trace: Trace, scenario: Scenario, *, untouched: bool) -> Measured:
    """1 where the careful driver, on its line, satisfies the scenario's goal before the log ends."""
    if scenario.goal is None:
        return Unavailable("the log names no goal")
    entered, touched = _reference_drive(scenario)
    reached = entered < touched if untouched else np.isfinite(entered)
    return Series(trace.ego.t[:1], np.array([float(reached)]))


@lru_cache(maxsize=1)
def _reference_drive(scenario: Scenario) -> tuple[float, float]:
    """When the careful driver enters the goal, and when somebody who is not counted touches it, in steps; inf: never.

    Both metrics of all planners ask for one log after another, so that one is kept.
    """
    goal, start, car = scenario.goal, scenario.ego.state(0), scenario.vehicle
    if goal is None or start.v <= STANDING_MPS:
        return np.inf, np.inf
    line = reference_line(scenario)
    drive = careful_drive(scenario, line)
    x, y, yaw = (np.interp(drive.s, line.s, column) for column in (line.xy[:, 0], line.xy[:, 1], line.yaw))
    x, y = x + car.axle_to_center * np.cos(yaw), y + car.axle_to_center * np.sin(yaw)
    t = start.t + STEP_S * np.arange(len(drive.s))
    states = zip(t, x, y, yaw, drive.v, strict=True)
    entered = next((k for k, state in enumerate(states) if goal.reached(*map(float, state))), np.inf)
    return entered, drive.touched if drive.touched >= 0 else np.inf


REFERENCE_GOAL = Metric(
    "reference_goal", "1", "none", (Mode.CLOSED,), partial(_reference_goal, untouched=False), (FINAL,),
    "1 if the careful driver of UN R157, on the lane of the start, enters the goal before the log ends.",
)  # fmt: skip
UNTOUCHED_GOAL = Metric(
    "untouched_goal", "1", "none", (Mode.CLOSED,), partial(_reference_goal, untouched=True), (FINAL,),
    "1 if the careful driver of UN R157, on the lane of the start, enters the goal before anybody touches it.",
)  # fmt: skip

ROWS = {
    "goal": "goal.final",
    "reference_goal": "reference_goal.final",
    "untouched_goal": "untouched_goal.final",
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


def drives(result: RunResult, traffic: str) -> pd.DataFrame:
    """A row per log and planner of a run; `frames` is how many plans were made."""
    driven = result.table["available"] & (result.table["mode"] == Mode.CLOSED.value)
    found = result.table[driven].pivot_table(index=["log", "planner"], columns="metric", values="value", dropna=False)
    rows = found.reindex(columns=list(ROWS.values())).set_axis(list(ROWS), axis=1).reset_index()
    tags = {log.name: log.tags for log in result.logs}
    rows.insert(0, "traffic", traffic)
    rows.insert(1, "source", [source_of(tags[log]) for log in rows["log"]])
    ends = {(drive.log, drive.planner): ": ".join(filter(None, (drive.end, drive.detail))) for drive in result.drives}
    rows["end"] = [ends[key] for key in zip(rows["log"], rows["planner"], strict=True)]
    rows["verdict"] = np.select(
        [rows["applies"] == 0.0, rows["avoids"] == 1.0, rows["avoids"] == 0.0],
        ["not applicable", "avoidable", "unavoidable"],
        "unknown",
    )
    totals = result.timings[result.timings["stage"] == "total"]
    frames = totals.groupby(["log", "planner"])["seconds"].size()
    rows["frames"] = [int(frames.get(key, 0)) for key in zip(rows["log"], rows["planner"], strict=True)]
    rows["comfort"] = ~((rows["jerk_p99_mps3"] > JERK_MPS3) | (rows["lat_accel_max_mps2"] > LATERAL_MPS2))
    logged = rows[(rows["planner"] == REFERENCE) & (rows["goal"] == 1.0)]["log"]
    for name, entered in (("reachable", "reference_goal"), ("untouched", "untouched_goal")):
        rows[name] = rows["log"].isin(set(logged)) | (rows[entered] == 1.0)
    return rows.drop(columns=["applies", "avoids"])


def table_of(result: RunResult, rows: pd.DataFrame, planners: Sequence[str]) -> pd.DataFrame:
    """A row per source and planner: what `COLUMNS` says of the drives `rows` of one run."""
    seconds = result.timings[result.timings["stage"] == "total"].merge(
        rows[["log", "planner", "source"]], on=["log", "planner"]
    )
    lost = [(failure.log, failure.planner) for failure in result.failures]
    tags = {log.name: source_of(log.tags) for log in result.logs if log.digest}
    out = []
    for source in (*dict.fromkeys([*SOURCES.values(), HAND_MADE]), ALL):
        for planner in planners:
            mine = [part[part["planner"] == planner] for part in (rows, seconds)]
            if source != ALL:
                mine = [part[part["source"] == source] for part in mine]
            failed = {log for log, who in lost if who in (planner, None) and source in (ALL, tags.get(log))}
            if len(mine[0]) or failed:
                out.append({"source": source, "planner": planner, **_counted(*mine), "not_evaluated": len(failed)})
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
        "untouched": int(rows["untouched"].sum()),
        "goal_of_untouched": int(((rows["goal"] == 1.0) & rows["untouched"]).sum()),
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
        lines += [f"## Traffic: {traffic}", "", f"| {' | '.join(names)} |", "|" + " --- |" * len(names)]
        lines += [f"| {' | '.join(_cell(name, row[name]) for name in names)} |" for row in rows.to_dict("records")]
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
        metrics = tuple(f"replay.experiments.commonroad:{name}" for name in ("REFERENCE_GOAL", "UNTOUCHED_GOAL"))
        loop = LoopConfig(traffic=kind)
        run = RunConfig(planners=chosen, mode="closed", recording=False, internals="none", metrics=metrics, loop=loop)
        result = evaluate_logs(logs, run, out / kind, workers=workers, resume=resume)
        for failure in result.failures:
            say(f"traffic {kind}: {failure.line}")
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
        prog="python -m replay.experiments.commonroad", description="Compare planners over CommonRoad scenarios."
    )
    parser.add_argument("logs", nargs="+", type=Path, help="CommonRoad files, or folders of them")
    parser.add_argument("-o", "--out", required=True, type=Path, help="folder for the tables and the runs")
    parser.add_argument("-p", "--planner", action="append", help=f"default: {', '.join(PLANNERS)}")
    parser.add_argument("--traffic", action="append", choices=list(TRAFFIC), help=f"default: {', '.join(KINDS)}")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes; 0: in this one")
    parser.add_argument("--resume", action="store_true", help="go on with an interrupted run in OUT")
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
        print("interrupted: finished logs are kept; to go on give the same command with --resume", file=sys.stderr)  # noqa: T201
        return 130
    print(markdown(table))  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main())
