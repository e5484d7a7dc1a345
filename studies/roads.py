"""Windows of recorded drives: planners compared with the recorded driver, in folds by recording,
against overfitting.

python -m studies.roads DATA ... -o OUT [-p dp_qp ...] [--fold K ...] [--workers N] [--against FILE]

DATA holds recorded logs (Tartu's bags, Argoverse 2, 123D, recorded CommonRoad). What is driven,
closed loop:

    windows   of `WINDOW_S`, a start every `EVERY_S`; a shorter log as a whole. A recorded
              CommonRoad log is driven by `EGOS` of its road users in turn, those in sight for
              longest
    variants  each window as recorded, mirrored, and with one change of the start in turn: `STARTS`
    scenes    `SCENES` raw scenes of each family of the catalogue, by seed, as they are

A fold is a fifth of the recordings of each kind. Develop on some folds (`--fold`), accept on the
others.

    OUT/logs/           the windows, made once
    OUT/PLANNER.csv     a row per drive (`Row`); a planner that is not named keeps those of the run
                        before
    OUT/worse.csv       the drives in which the first planner costs more than the best other one,
                        most costly first

(1) cost = 30 [contact at fault] + 5 hard_s + 3 false + stands_s + delay_s + 0.2 jerk_s
        weights are seconds of delay
(2) delay = T - t_h(s + `NEAR_M`), s the station at the drive's end,
        t_h(s) the time at which the person passed it; who is ahead, or not farther behind than
        that, has none (the person may stand there)
(3) intervals hold 90 %, by resampling recordings (`RESAMPLES`), as the windows of a recording
    depend on each other

`--against` compares with rows of an earlier version, fold by fold: change of each column, and its
interval.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from itertools import count
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from replan import metrics
from replan.core.arrays import FloatArray
from replan.core.errors import LogError, ReplanError
from replan.logs.agents import AgentKind
from replan.logs.catalogue.raw import FAMILIES as RAW
from replan.logs.edit.cut import cut
from replan.logs.edit.transform import mirrored
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.readers import LogSettings, read_log
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason
from replan.metrics.metric import Series
from replan.metrics.route_gain import gain_along, route_of
from replan.paper.reproduce import markdown
from replan.replay.loop.closed_loop import run_closed_loop
from replan.results.tables import safe_name, write_file
from replan.run.log_source import LogSource
from replan.run.pool import WorkerLost, run_all
from replan.run.sources import select

WINDOW_S, EVERY_S, LEAST_S, LEAST_M, NEAR_M = 10.0, 2.0, 4.0, 5.0, 1.0
"""Length and distance of windows; less time, or less way of the person, is no drive."""
EGOS, SCENES, FOLDS = 3, 20, 5
HARD_MPS2, STANDS_MPS, GOES_MPS = 3.5, 0.2, 1.0
FADES_S = 3.0
"""A change of the ego's start fades out of the person's drive within this."""
RESAMPLES, SEED, CONFIDENCE = 1000, 0, 0.9
COST: Mapping[str, float] = {
    "at_fault": 30.0,
    "hard_s": 5.0,
    "false": 3.0,
    "stands_s": 1.0,
    "delay_s": 1.0,
    "jerk_s": 0.2,
}
KINDS: Mapping[str, str] = {
    "ros": "city",
    "argoverse2": "argoverse",
    "123d": "argoverse",
    "ngsim": "ngsim",
    "mona": "mona",
}
"""Kinds of recordings by tag of their logs; others are not driven."""
CLUSTERS = "clusters"
"""City drives of which no road user has a kind."""


@dataclass(frozen=True)
class Row:
    """The measures of one drive.

    Attributes:
        log: File of the window.
        recording: Recording that the window was cut from.
        kind: Kind of the recording (`KINDS`).
        fold: Fold of the recording.
        variant: Change of the window (`VARIANTS`).
        planner: Name of the planner.
        end: Reason for the end of the drive.
        progress: Share of the recorded driver's way, at most 1.
        touched: 1 if a road user touched the ego.
        at_fault: 1 if that was the planner's fault.
        hard_s: Time of braking beyond `HARD_MPS2`, s.
        hardest: Least acceleration, m/s2.
        false: Number of hard brakings for road users that did not come into the way.
        stands_s: Time in which the ego stands while the recorded driver moves, s.
        delay_s: (2), s
        jerk_s: Time of jerk out of bounds, s.
        gap_people_m: Least gap to pedestrians and riders, m.
        cost: (1)
    """

    log: str
    recording: str
    kind: str
    fold: int
    variant: str
    planner: str
    end: str
    progress: float
    touched: float
    at_fault: float
    hard_s: float
    hardest: float
    false: float
    stands_s: float
    delay_s: float
    jerk_s: float
    gap_people_m: float
    cost: float


SHOWN = (
    "progress",
    "touched",
    "at_fault",
    "hard_s",
    "hardest",
    "false",
    "stands_s",
    "delay_s",
    "jerk_s",
    "gap_people_m",
    "cost",
)


@dataclass(frozen=True)
class Task:
    """One drive that is asked for."""

    path: Path
    recording: str
    kind: str
    fold: int
    variant: str


# the drives ---------------------------------------------------------------------------------------


def _start(ego_m: float, factor: float, scenario: Scenario) -> Scenario:
    """The ego's start moved to the left, and its speed times a factor."""
    ego = scenario.ego
    left = np.clip(1.0 - (ego.t - ego.t[0]) / FADES_S, 0.0, 1.0) ** 2
    x, y = ego.x - ego_m * left * np.sin(ego.yaw), ego.y + ego_m * left * np.cos(ego.yaw)
    return replace(scenario, ego=replace(ego, x=x, y=y, v=ego.v * (1.0 + (factor - 1.0) * left)))


def _late(seconds: float, scenario: Scenario) -> Scenario:
    """The ego starts later: the traffic is ahead of its log."""
    return replace(scenario, tracks=scenario.tracks.shifted(-seconds))


STARTS: Mapping[str, Callable[[Scenario], Scenario]] = {
    "faster": partial(_start, 0.0, 1.1),
    "aside": partial(_start, 0.3, 1.0),
    "late": partial(_late, 0.5),
    "slower": partial(_start, 0.0, 0.9),
    "other side": partial(_start, -0.3, 1.0),
}
VARIANTS: Mapping[str, Callable[[Scenario], Scenario]] = {
    "as recorded": lambda one: one,
    "mirrored": mirrored,
    **STARTS,
}


def _kind(scenario: Scenario) -> str:
    kind = next((kind for tag, kind in KINDS.items() if tag in scenario.tags), "")
    labelled = any(each is not AgentKind.OBJECT for each in scenario.tracks.kinds)
    return CLUSTERS if kind == "city" and not labelled else kind


def _egos(source: LogSource, scenario: Scenario) -> Iterator[Scenario]:
    """The scenario, or that of several of its road users."""
    if "commonroad" not in scenario.tags:
        yield scenario
        return
    tracks = scenario.tracks
    first, last = tracks.offsets[:-1], tracks.offsets[1:] - 1
    there = tracks.t[last] - tracks.t[first]
    way = np.hypot(tracks.x[last] - tracks.x[first], tracks.y[last] - tracks.y[first])
    order = np.lexsort((np.arange(len(tracks)), -there))
    found = [i for i in order.tolist() if way[i] > LEAST_M and there[i] >= LEAST_S]
    for i in found[:: max(len(found) // EGOS, 1)][:EGOS]:
        assert source.path is not None
        try:
            yield read_log(source.path, LogSettings(ego=tracks.ids[i]))
        except LogError as error:
            print(f"left out: {error}", file=sys.stderr)


def _windows(scenario: Scenario) -> Iterator[Scenario]:
    begin, end = float(scenario.ego.t[0]), float(scenario.ego.t[-1])
    if end - begin < WINDOW_S:
        parts = [scenario] if end - begin >= LEAST_S else []
    else:
        starts = np.arange(begin, end - WINDOW_S + 1e-6, EVERY_S)
        parts = [cut(scenario, float(start), float(start) + WINDOW_S) for start in starts]
    for part in parts:
        if gain_along(route_of(part), part.ego).metres[-1] >= LEAST_M:
            yield part


def _recordings(data: Sequence[Path]) -> Iterator[tuple[str, str, list[Scenario]]]:
    """Name, kind and windows of each recording; the first of those of one name."""
    seen = set[str]()
    for source in select(data).sources:
        name = source.label.rpartition("/")[2].partition(".")[0]
        if name in seen:
            continue
        try:
            scenario = source.read()
        except LogError as error:
            print(f"left out: {error}", file=sys.stderr)
            continue
        kind = _kind(scenario)
        if kind:
            seen.add(name)
            yield name, kind, [part for one in _egos(source, scenario) for part in _windows(one)]
    for seed in range(1, SCENES + 1):
        for family in RAW:
            yield (
                f"{family.name}@seed={seed}",
                "raw scenes",
                [LogSource(f"{family.name}@seed={seed}").read()],
            )


def tasks(data: Sequence[Path], out: Path) -> list[Task]:
    """The drives; their windows are written where they are not there."""
    index = out / "logs.csv"
    if not index.exists():
        (out / "logs").mkdir(parents=True, exist_ok=True)
        rows, of_kind = [], dict[str, Iterator[int]]()
        for name, kind, parts in sorted(_recordings(data), key=lambda one: one[:2]):
            fold = (next(of_kind.setdefault(kind, count())) + len(of_kind)) % FOLDS
            for part in parts:
                path = out / "logs" / f"{safe_name(part.name)}.mcap"
                write_scenario(path, part)
                rows.append({"path": path.name, "recording": name, "kind": kind, "fold": fold})
        write_file(index, partial(pd.DataFrame(rows).to_csv, index=False))
    table = pd.read_csv(index)
    found, starts = list[Task](), list(STARTS)
    columns = (table[name].tolist() for name in ("path", "recording", "kind", "fold"))
    for k, (file, name, kind, fold) in enumerate(zip(*columns, strict=True)):
        variants = (
            ["as recorded"]
            if kind == "raw scenes"
            else ["as recorded", "mirrored", starts[k % len(starts)]]
        )
        found += [Task(out / "logs" / file, name, kind, fold, variant) for variant in variants]
    return found


# the rows -----------------------------------------------------------------------------------------

MEASURED = {
    name: metrics.METRICS[name]
    for name in (
        "collision_at_fault",
        "lon_accel",
        "false_braking",
        "lon_jerk_state",
        "gap_vulnerable",
    )
}


def drive(planner: str, task: Task) -> Row | str:
    """The row of one drive; a message if it cannot be driven."""
    scenario = VARIANTS[task.variant](read_scenario(task.path))
    try:
        trace = run_closed_loop(scenario, planner).trace
    except ReplanError as error:
        return f"{task.path.name}, {task.variant}: {error}"
    series = dict[str, FloatArray]()

    def keep(name: str, one: Series) -> None:
        series[name] = one.value

    table = metrics.evaluate(trace, scenario, metrics=MEASURED, found=keep).set_index("metric")[
        "value"
    ]
    ego, person, route = trace.ego, scenario.ego, route_of(scenario)
    hers, its = (gain_along(route, one).metres for one in (person, ego))
    way, until = (
        float(np.interp(ego.t[-1], person.t, hers)),
        min(float(ego.t[-1]), float(person.t[-1])),
    )
    passed = np.flatnonzero(np.maximum.accumulate(hers) >= its[-1] + NEAR_M)
    delay = max(until - float(person.t[passed[0]]), 0.0) if len(passed) else 0.0
    step = np.diff(ego.t, append=ego.t[-1])
    waits = (np.abs(ego.v) < STANDS_MPS) & (np.interp(ego.t, person.t, np.abs(person.v)) > GOES_MPS)
    found: dict[str, Any] = {
        "progress": min(max(float(its[-1]) / way, 0.0), 1.0) if way > LEAST_M else nan,
        "touched": float(trace.end in (EndReason.COLLISION, EndReason.REPLAY_CONTACT)),
        "at_fault": float(table.get("collision_at_fault.count", 0.0) > 0.0),
        "hard_s": float(step[series["lon_accel"] < -HARD_MPS2].sum()),
        "hardest": float(table["lon_accel.min"]),
        "false": float(np.nan_to_num(table.get("false_braking.count", 0.0))),
        "stands_s": float(step[waits].sum()),
        "delay_s": delay,
        "jerk_s": float(np.nan_to_num(table["lon_jerk_state.time_out_of_bounds"])),
        "gap_people_m": float(table.get("gap_vulnerable.min", nan)),
    }
    cost = sum(weight * found[name] for name, weight in COST.items())  # (1)
    whose = (task.path.name, task.recording, task.kind, task.fold, task.variant, planner)
    return Row(*whose, trace.end.value, **found, cost=cost)


def driven(planner: str, asked: Sequence[Task], workers: int) -> pd.DataFrame:
    """The rows of a planner, in the order of the tasks."""
    rows: dict[int, Row] = {}
    for k, (i, row) in enumerate(run_all(partial(drive, planner), asked, workers)):
        if isinstance(row, Row):
            rows[i] = row
        else:
            print(
                f"not driven: {row.reason if isinstance(row, WorkerLost) else row}", file=sys.stderr
            )
        if k % 50 == 49:
            print(f"{planner}: {k + 1} of {len(asked)}", file=sys.stderr)
    return pd.DataFrame(
        [asdict(rows[i]) for i in sorted(rows)], columns=[each.name for each in fields(Row)]
    )


# the tables ---------------------------------------------------------------------------------------


def interval(values: pd.DataFrame, column: str) -> str:
    """Mean, and interval (3)."""
    by = values.groupby("recording")[column].agg(["sum", "count"]).to_numpy(float)
    if not by[:, 1].sum():
        return "-"
    drawn = np.random.default_rng(SEED).integers(len(by), size=(RESAMPLES, len(by)))
    some = by[drawn].sum(axis=1)
    means = some[:, 0] / np.maximum(some[:, 1], 1.0)
    low, high = np.quantile(means, [(1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0])
    return f"{by[:, 0].sum() / by[:, 1].sum():.3g} ({low:.2g} to {high:.2g})"


def summary(rows: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """A row per group: drives, and mean and interval of each column."""
    groups = rows.groupby(list(by), sort=False)
    columns = {name: [interval(part, name) for _, part in groups] for name in SHOWN}
    index = pd.DataFrame([key for key, _ in groups], columns=list(by))
    return index.assign(drives=groups.size().to_numpy(), **columns)


def worse(rows: pd.DataFrame, planner: str) -> pd.DataFrame:
    """The drives in which a planner costs more than the best other one, most costly first."""
    keys = ["log", "variant"]
    others = (
        rows[rows["planner"] != planner].sort_values("cost", kind="stable").drop_duplicates(keys)
    )
    both = rows[rows["planner"] == planner].merge(
        others[[*keys, "planner", "cost"]], on=keys, suffixes=("", "_best")
    )
    both = both.assign(more=both["cost"] - both["cost_best"]).sort_values(
        "more", ascending=False, kind="stable"
    )
    return both[both["more"] > 0.0]


def changes(before: pd.DataFrame, now: pd.DataFrame) -> pd.DataFrame:
    """What changed in the drives that both have, over all folds and by fold."""
    both = before.merge(now, on=["log", "variant"], suffixes=("_before", ""))
    delta = both[["recording", "kind", "fold"]].assign(
        **{name: both[name] - both[f"{name}_before"] for name in SHOWN}
    )
    return pd.concat([summary(delta.assign(fold="all"), ["fold"]), summary(delta, ["fold"])])


def main(argv: Sequence[str] | None = None) -> None:
    """Drive, and print the tables."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.roads", description=__doc__.partition("\n\n")[0]
    )
    parser.add_argument("data", type=Path, nargs="+", help="folders of recorded logs")
    parser.add_argument(
        "-o", "--out", type=Path, required=True, help="folder for windows and tables"
    )
    parser.add_argument("-p", "--planner", nargs="*", default=["dp_qp"])
    parser.add_argument(
        "--fold", nargs="*", type=int, default=list(range(FOLDS)), help="these folds only"
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument(
        "--against", type=Path, help="rows of an earlier version of the first planner"
    )
    options = parser.parse_args(argv)
    try:
        asked = [task for task in tasks(options.data, options.out) if task.fold in options.fold]
        for planner in options.planner:
            rows = driven(planner, asked, options.workers)
            write_file(options.out / f"{safe_name(planner)}.csv", partial(rows.to_csv, index=False))
    except ReplanError as error:
        sys.exit(f"error: {error}")
    there = pd.concat(
        [
            pd.read_csv(file)
            for file in sorted(options.out.glob("*.csv"))
            if file.stem not in ("logs", "worse")
        ]
    )
    there = there[there["fold"].isin(options.fold)]
    print(markdown(summary(there, ["planner"])))
    print(markdown(summary(there[there["planner"] == options.planner[0]], ["kind"])))
    costly = worse(there, options.planner[0])
    write_file(options.out / "worse.csv", partial(costly.to_csv, index=False))
    print(markdown(costly.head(30)[["log", "variant", "end", "more", "planner_best", *COST]]))
    if options.against is not None:
        print(
            markdown(
                changes(pd.read_csv(options.against), there[there["planner"] == options.planner[0]])
            )
        )


if __name__ == "__main__":
    main()
