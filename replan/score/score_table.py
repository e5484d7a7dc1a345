"""The tables of `replan score`: a row for each scene or drive, with the original's columns, and a
summary.

NAVSIM v2's two stages: a plan counts as much as what follows from where it ends
(pseudo-simulation).

A window of stage one has follow-up scenes, each the window of a log that begins where a drive may
be 4 s later. With d from the plan's last pose to the begin of scene k, in the map's plane,

(1) w_k = exp(-d_k^2 / (2 `SIGMA2`)), divided by their sum; where that is 0, all are equal
(2) combined = mean over the windows of stage one of (score x sum_k w_k score_k)

The windows of both stages come in pairs 0.5 s apart; both of a pair have the same EC. Source:
navsim 0a380a90, scene_aggregator.py and run_pdm_score.py.

The trajectories to be scored are those of a table, or the plans of a run's open loop. A table (CSV
or Parquet) has a row for each pose: `log` (its name or file), `t_s` (begin of the window, s from
the log's begin), `x`, `y`, `yaw` (rear axle, m, rad), the eight poses of a window every 0.5 s, in
order or with `after_s`. `drive` (else `planner`) separates several agents; `token` is copied to the
scores. `stage_one` names, by its token, the window of which a window is a follow-up scene
(`two_stages`); empty: none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import cos, hypot, sin
from pathlib import Path
from types import MappingProxyType
from typing import cast

import numpy as np
import pandas as pd
import pyarrow as pa

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError, unknown_name
from replan.core.files import check_regular
from replan.draw.drawn_results import Results
from replan.logs.road import IN_JUNCTION, Road
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState
from replan.logs.trace import EndReason, Trace
from replan.logs.vehicle import VehicleParameters
from replan.results.tables import safe_name
from replan.score.navsim import (
    HORIZON_S,
    NUPLAN_CAR,
    PAST_S,
    POSE_S,
    POSES,
    VERSIONS,
    Version,
    window_at,
)
from replan.score.yardstick import ScoredPlan, scored, yardstick

NUPLAN_CLS = "nuplan-cls"
CLS_COLUMNS: Mapping[str, str] = MappingProxyType(
    {
        "collisions": "no_ego_at_fault_collisions",
        "drivable": "drivable_area_compliance",
        "direction": "driving_direction_compliance",
        "making_progress": "ego_is_making_progress",
        "progress": "ego_progress_along_expert_route",
        "ttc": "time_to_collision_within_bound",
        "speed_limit": "speed_limit_compliance",
        "comfort": "ego_is_comfortable",
        "score": "score",
    }
)
"""nuPlan's column of each part of `nuplan_closed`."""
# Names of the summary's row in NAVSIM's and in nuPlan's tables
AVERAGE, FINAL = "average_all_frames", "final_score"
TIME_ONLY = 1e-3


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """Rows by scene or drive, a summary row for each agent, and what cannot be exact for these logs
    and why.
    """

    rows: pd.DataFrame
    inexact: tuple[str, ...]


def nuplan_table(results: Results) -> ScoreTable:
    """Return nuPlan's closed-loop scores of the drives of a run.

    ConfigError if the run has no closed loop, or was made without the metric.
    """
    metrics = results.metrics
    metrics = metrics[
        metrics["metric"].str.match(r"nuplan_closed\.\w+\.final") & (metrics["mode"] == "closed")
    ]
    if metrics.empty:
        raise ConfigError(
            f"{results.path}: no closed drive with the metric nuplan_closed; evaluate with --mode "
            "closed"
        )
    part = metrics["metric"].str.split(".").str[1]
    wide = metrics.assign(part=part).pivot_table(
        "value", ["log", "planner"], "part", dropna=False, sort=False
    )
    rows = wide.reindex(columns=list(CLS_COLUMNS)).rename(columns=CLS_COLUMNS).reset_index()
    rows = rows.rename(columns={"log": "scenario", "planner": "planner_name"})
    missing = metrics[metrics["value"].isna() & metrics["metric"].eq("nuplan_closed.score.final")]
    ends = results.drives.loc[results.drives["mode"] == "closed", "end"]
    early = int((~ends.isin([EndReason.END_OF_LOG.value, EndReason.END_OF_LOG.name.lower()])).sum())
    traffic = results.run.loop.traffic
    reactive = (
        "as logged: CLS-NR"
        if traffic == "time"
        else f"{traffic}, not nuPlan's IDM: comparable with CLS-R"
    )
    notes = [
        f"traffic: {reactive}",
        "vehicle and controller: those of the run, not nuPlan's LQR and bicycle at 10 Hz",
    ]
    again = "evaluate with --set loop.drives_on=true"
    notes += (
        [f"{early} of {len(ends)} drives ended before the log, where nuPlan drives on: {again}"]
        if early
        else []
    )
    notes += [f"{row.log} ({row.planner}): no score: {row.reason}" for row in missing.itertuples()]
    return ScoreTable(_with_means(rows, "scenario", "planner_name", FINAL), tuple(notes))


def navsim_table(
    name: str,
    plans: Sequence[SubmittedPlan],
    logs: Mapping[str, Scenario],
    on_plan: Callable[[], None] = lambda: None,
) -> ScoreTable:
    """Return NAVSIM's scores of plans.

    `name`: a name of `VERSIONS`. ConfigError if there are no plans, or a window does not fit its
    log.
    """
    if not plans:
        raise ConfigError(
            "no plans to score: a window needs a plan of 4 s, and 4 s of the log after its begin"
        )
    version, rows = VERSIONS[name], []
    staged = any(plan.stage_one for plan in plans)
    if staged and "EC" not in version.columns:
        raise ConfigError(
            f"stage_one: {name} has one stage; take --as navsim-v2, or leave the column out"
        )
    in_order = sorted(plans, key=lambda plan: (plan.log, plan.t, plan.drive))
    scores = _scores(in_order, logs, version, on_plan)
    for plan in in_order:
        score, pair = scores[plan.key()], scores.get(plan.key(1))
        # The earlier of a pair has the pair's
        if staged and pair is not None and np.isnan(score.parts["EC"]):
            score = score.with_comfort(pair.parts["EC"])
        columns = {column: score.parts[part] for part, column in version.columns.items()}
        rows.append(
            {
                "token": plan.token or f"{plan.log}@{plan.t:g}",
                "log_name": plan.log,
                "agent": plan.drive,
                "start_time": plan.t,
                **columns,
                "score": score.score,
            }
        )
    table = pd.DataFrame(rows)
    if staged:
        table = two_stages(table, in_order, logs)
    table = table.sort_values(["log_name", "agent", "start_time"], kind="stable", ignore_index=True)
    notes = tuple(_navsim_notes(table, plans, logs, name))
    return ScoreTable(
        with_stages(table) if staged else _with_means(table, "token", "agent", AVERAGE), notes
    )


def _scores(
    plans: Sequence[SubmittedPlan],
    logs: Mapping[str, Scenario],
    version: Version,
    on_plan: Callable[[], None],
) -> dict[tuple[str, str, int], ScoredPlan]:
    """Return the scores of plans, sorted by log and time, by `SubmittedPlan.key`."""
    scores: dict[tuple[str, str, int], ScoredPlan] = {}
    for (log, t), group in groupby(plans, key=lambda plan: (plan.log, plan.t)):
        window = window_at(logs[log], t)
        beside = yardstick(window, version)
        for plan in group:
            earlier = scores.get(plan.key(-1)) if "EC" in version.columns else None
            scores[plan.key()] = scored(window, plan.poses, version, earlier, beside)
            on_plan()
    return scores


def _with_means(rows: pd.DataFrame, name: str, agent: str, word: str) -> pd.DataFrame:
    """Return the rows with one more for each agent: the means of the columns over rows that have a
    value.
    """
    parts = [
        column
        for column in rows.columns
        if rows[column].dtype == np.float64 and column != "start_time"
    ]
    means = rows.groupby(agent, sort=False)[parts].mean().reset_index()
    return pd.concat([rows, means.assign(**{name: word})], ignore_index=True)[list(rows.columns)]


def _navsim_notes(
    rows: pd.DataFrame, plans: Sequence[SubmittedPlan], logs: Mapping[str, Scenario], name: str
) -> Iterable[str]:
    """Yield what cannot be exact, with the part and the number of windows that it concerns."""
    used = {plan.log: logs[plan.log] for plan in plans}
    roads = [scenario.road for scenario in used.values()]
    is_v2, windows = name != "navsim-v1", f"of {len(plans)} windows"
    if STAGE not in rows:
        yield "one stage: no trajectory names the window that it follows (column stage_one)"
    else:
        yield "stage two: its road users drive as logged; NAVSIM lets vehicles react, by its IDM"
        first = rows[rows[STAGE] == 1]
        if alone := int((~first["token"].isin(rows[FOLLOWS])).sum()):
            yield (
                f"{COMBINED}: {alone} of {len(first)} windows of stage one have no follow-up "
                "scene: left out"
            )
    logs_with = {
        "route: {} name none: the lanes of their driver, and straight on": sum(
            not road.route for road in roads
        ),
        "vehicle: the ego of {} is not nuPlan's Pacifica, whose box NAVSIM judges": sum(
            not _is_nuplan_car(scenario.vehicle) for scenario in used.values()
        ),
        "traffic_light_compliance: {} have no traffic lights: it is 1": is_v2
        * sum(not scenario.lights for scenario in used.values()),
        "ego_progress: {} state no speed limit: PDM-Closed drives up to 15 m/s": sum(
            not any(np.isfinite(road.stated_limit(i)) for i in road.lanes) for road in roads
        ),
        "drivable_area_compliance: {} have no drivable ground beside their lanes": sum(
            not road.areas for road in roads
        ),
        "intersections: {} mark none: lanes that cross others are taken for them": sum(
            not _marks_intersections(road) for road in roads
        ),
    }
    for note, count in logs_with.items():
        if count:
            yield note.format(f"{count} of {len(used)} logs")
    past = sum(plan.t < logs[plan.log].ego.t[0] + PAST_S - TIME_ONLY for plan in plans)
    if past and is_v2:
        yield f"history_comfort: {past} {windows} have less than {PAST_S:g} s of recorded past"
    comfort = "two_frame_extended_comfort"
    if comfort in rows and (alone := int(rows[comfort].isna().sum())):
        yield f"{comfort}: {alone} {windows} have no plan 0.5 s earlier: no weight"


def _is_nuplan_car(car: VehicleParameters) -> bool:
    off = abs(car.length - NUPLAN_CAR.length) + abs(car.width - NUPLAN_CAR.width)
    return off <= 1e-3


def _marks_intersections(road: Road) -> bool:
    return any(IN_JUNCTION in lane.kind.split("+") for lane in road.lanes.values())


SIGMA2 = 0.1  # Variance of (1), m2
STAGE, FOLLOWS, WEIGHT = "stage", "stage_one", "weight"
STAGE_ONE, STAGE_TWO, COMBINED = (
    f"extended_pdm_score_{word}" for word in ("stage_one", "stage_two", "combined")
)
"""Names of the summary's rows in NAVSIM's tables."""


def weights(end: FloatArray, begins: FloatArray) -> FloatArray:
    """Return the weights (1) `(n,)` of scenes: the plan ends at `end` `(2,)`, they begin at
    `begins` `(n, 2)`.
    """
    near = np.exp(-((begins - end) ** 2).sum(axis=1) / (2.0 * SIGMA2))
    return near / near.sum() if near.sum() > 1e-8 else np.full(len(begins), 1.0 / len(begins))


def two_stages(
    rows: pd.DataFrame, plans: Sequence[SubmittedPlan], logs: Mapping[str, Scenario]
) -> pd.DataFrame:
    """Return the rows of plans with their stage, the token that they follow, and their weight.

    ConfigError if two plans of an agent have one token; a plan follows none of stage one.
    """
    rows = rows.copy()
    rows[FOLLOWS], rows[WEIGHT] = [plan.stage_one for plan in plans], 1.0
    rows[STAGE] = np.where(rows[FOLLOWS] == "", 1, 2)
    twice = rows[rows.duplicated(["agent", "token"])]
    if len(twice):
        raise ConfigError(
            f"token {twice['token'].iloc[0]}: two windows have it; stage_one needs tokens that "
            "differ"
        )
    first = {
        (plan.drive, token): plan
        for plan, token in zip(plans, rows["token"], strict=True)
        if not plan.stage_one
    }
    for key, group in rows[rows[STAGE] == 2].groupby(["agent", FOLLOWS], sort=False):
        agent, token = map(str, key)
        if (agent, token) not in first:
            raise ConfigError(
                f"stage_one: {agent or 'the agent'} has no window of stage one with the token "
                f"{token}"
            )
        earlier = first[agent, token]
        scenes = [(logs[plans[k].log], plans[k].t) for k in group.index]
        starts = [(ego_at(log, t), log.origin) for log, t in scenes]
        end = earlier.poses[-1, :2] + logs[earlier.log].origin
        rows.loc[group.index, WEIGHT] = weights(
            end, np.array([(ego.x + x, ego.y + y) for ego, (x, y) in starts])
        )
    return rows


def with_stages(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows with three more for each agent: the means of stage one and of stage two, and
    the product (2).
    """
    parts = [
        name
        for name in rows.columns
        if rows[name].dtype == np.float64 and name not in ("start_time", WEIGHT)
    ]
    summary = []
    for agent, group in rows.groupby("agent", sort=False):
        first, second = (group[group[STAGE] == stage] for stage in (1, 2))
        scenes = second[parts].mul(second[WEIGHT], axis=0)
        followed = scenes.groupby(second[FOLLOWS]).sum(min_count=1)
        product = (first.set_index("token")["score"] * followed["score"]).mean()
        summary += [
            {"token": STAGE_ONE, "agent": agent, **first[parts].mean()},
            {"token": STAGE_TWO, "agent": agent, **followed.mean()},
            {"token": COMBINED, "agent": agent, "score": product},
        ]
    return pd.concat([rows, pd.DataFrame(summary)], ignore_index=True)[list(rows.columns)]


NEEDED = ("log", "t_s", "x", "y", "yaw")
AGENT = ("drive", "planner")
FARTHEST_M = 1000.0  # No pose of a plan is this far from where its window begins, m


@dataclass(frozen=True, eq=False)
class SubmittedPlan:
    """A plan to be scored."""

    log: str  # The log's name; `drive` the agent's, `token` the window's
    drive: str
    token: str
    t: float  # Begin of the window, s
    poses: FloatArray  # x, y, yaw in the log's world `(8, 3)`
    # The token of the window of which this is a follow-up scene; "": it is none
    stage_one: str = ""

    def key(self, periods: int = 0) -> tuple[str, str, int]:
        """Return what the plan of the same drive `periods` x 0.5 s later is found by."""
        return self.log, self.drive, round(self.t / POSE_S * 100) + 100 * periods


def read_table(path: Path) -> pd.DataFrame:
    """Read the table of a file.

    ConfigError if the file cannot be read, lacks a column, or has a value that is no number.
    """
    check_regular(path)
    if path.suffix not in (".csv", ".parquet"):
        raise ConfigError(
            f"{path}: write trajectories as .csv or .parquet; pickles are not read: they execute "
            "code"
        )
    try:
        table = pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise ConfigError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None
    table = table.rename(
        columns={name: "t_s" for name in ("t", "time_s", "time") if "t_s" not in table.columns}
    )
    if missing := [name for name in NEEDED if name not in table.columns]:
        hint = (
            "; a token names no time of a log here: add log and t_s"
            if "token" in table.columns
            else ""
        )
        raise ConfigError(
            f"{path}: no column {', '.join(missing)}; it needs {', '.join(NEEDED)}{hint}"
        )
    if table.empty:
        raise ConfigError(f"{path}: holds no rows; it needs {POSES} for each window")
    for name in ("t_s", "x", "y", "yaw", *(("after_s",) if "after_s" in table.columns else ())):
        numbers = pd.to_numeric(table[name], errors="coerce")
        if not np.isfinite(numbers).all():
            row = int(np.flatnonzero(~np.isfinite(numbers))[0])
            raise ConfigError(
                f"{path}: {name} of row {row + 1} is no finite number: {table[name].iloc[row]}"
            )
        table[name] = numbers.astype(float)
    for name in ("log", *(name for name in AGENT if name in table.columns)):
        if (empty := np.flatnonzero(table[name].isna())).size:
            raise ConfigError(f"{path}: {name} of row {empty[0] + 1} is empty")
    return table


def plans_of_table(
    path: Path, logs: Mapping[str, Scenario], *, relative: bool
) -> list[SubmittedPlan]:
    """Return the plans of a file, for logs by name.

    `relative`: whether poses are relative to the ego at the begin of their window. ConfigError as
    `read_table`, or if a window has not eight poses, or one that is `FARTHEST_M` away, or a log is
    unknown.
    """
    table = read_table(path)
    names = {name: log for log in logs for name in (log, safe_name(log), Path(log).stem)}
    agent = next((name for name in AGENT if name in table.columns), None)
    plans = []
    for key, rows in table.groupby([table["log"].astype(str), "t_s"], sort=False):
        log, t = cast("tuple[str, float]", key)
        if log not in names:
            raise unknown_name("log", log, sorted(logs))
        for drive, poses in rows.groupby(agent, sort=False) if agent else [("", rows)]:
            where = f"{path}: {log} at {t:g} s{f', {drive!s}' if drive else ''}"
            begin = ego_at(logs[names[log]], t)
            placed = _placed(poses, begin, where, relative=relative)
            token, stage_one = (_word(poses, column) for column in ("token", "stage_one"))
            plans.append(SubmittedPlan(names[log], str(drive), token, t, placed, stage_one))
    return plans


def _placed(rows: pd.DataFrame, begin: EgoState, where: str, *, relative: bool) -> FloatArray:
    """Return the poses of a window in the log's world; ConfigError as `plans_of_table`."""
    if len(rows) != POSES:
        raise ConfigError(f"{where}: {len(rows)} poses; a window has {POSES}, every {POSE_S:g} s")
    if "after_s" in rows.columns:
        rows = rows.sort_values("after_s", kind="stable")
        expected = POSE_S * np.arange(1, POSES + 1)
        if not np.allclose(rows["after_s"], expected, atol=1e-3):
            first, second, *_, last = expected.tolist()
            raise ConfigError(f"{where}: after_s must be {first:g}, {second:g}, ... {last:g} s")
    poses: FloatArray = rows[["x", "y", "yaw"]].to_numpy(np.float64)
    placed = _in_world(poses, begin) if relative else poses
    away = max(hypot(x - begin.x, y - begin.y) for x, y in placed[:, :2])
    if away > FARTHEST_M:
        frame = "poses relative to the ego need --relative"
        if relative:
            frame = "the poses are in another frame"
        raise ConfigError(f"{where}: a pose is {away:.3g} m from where the window begins: {frame}")
    return placed


def _word(rows: pd.DataFrame, column: str) -> str:
    """Return the first value of a column; "" if there is none."""
    value = rows[column].iloc[0] if column in rows.columns else None
    return "" if pd.isna(value) else str(value)


def ego_at(scenario: Scenario, t: float) -> EgoState:
    """Return the ego of a log at `t`, s; before its first and after its last state, that state."""
    return scenario.ego.resampled(np.clip([t], scenario.ego.t[0], scenario.ego.t[-1])).state(0)


def _in_world(poses: FloatArray, ego: EgoState) -> FloatArray:
    """Return poses that are relative to the ego in its log's world."""
    x, y, yaw = poses.T
    c, s = cos(ego.yaw), sin(ego.yaw)
    return np.column_stack([ego.x + x * c - y * s, ego.y + x * s + y * c, ego.yaw + yaw])


def plans_of_trace(trace: Trace, scenario: Scenario) -> Iterator[SubmittedPlan]:
    """Yield the plans of an open loop every 0.5 s that have a whole window and reach its end."""
    ahead, first = POSE_S * np.arange(1, POSES + 1), trace.ego.t[0]
    for frame in trace.frames:
        half = (frame.t - first) / POSE_S
        plan = frame.plan.trajectory
        if abs(half - round(half)) > 1e-3 or frame.t + HORIZON_S > scenario.ego.t[-1] + 1e-6:
            continue
        if plan.t[-1] < frame.t + HORIZON_S - 1e-3:
            continue
        states = plan.resampled(np.clip(frame.t + ahead, plan.t[0], plan.t[-1]))
        yield SubmittedPlan(
            scenario.name,
            trace.planner,
            "",
            float(frame.t),
            np.column_stack([states.x, states.y, states.yaw]),
        )


def names_of(plans: Sequence[SubmittedPlan]) -> list[str]:
    """Return the logs of plans, each once, in order."""
    return list(dict.fromkeys(plan.log for plan in plans))
