"""The tables of `replan score`: a row for each scene or drive, with the original's columns, and a summary.

NAVSIM v2's two stages: a plan counts as much as what follows from where it ends (pseudo-simulation).

A window of stage one has follow-up scenes, each the window of a log that begins where a drive may be 4 s later. With d
from the plan's last pose to the begin of scene k, in the map's plane,

(1) w_k = exp(-d_k^2 / (2 `SIGMA2`)), divided by their sum; where that is 0, all are equal
(2) combined = mean over the windows of stage one of (score x sum_k w_k score_k)

The windows of both stages come in pairs 0.5 s apart; both of a pair have the same EC. Source: navsim 0a380a90,
scene_aggregator.py and run_pdm_score.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pandas as pd

from logs.arrays import FloatArray
from logs.errors import ConfigError
from logs.road import IN_JUNCTION
from logs.scenario import Scenario
from logs.trace import EndReason
from replay.draw.drawn_results import Results
from replay.score.navsim import NUPLAN_CAR, PAST_S, POSE_S, VERSIONS, ScoredWindow, window
from replay.score.trajectories import Asked, ego_at
from replay.score.yardstick import ScoredPlan, Yardstick, scored, yardstick

NUPLAN_CLS = "nuplan-cls"
CLS_COLUMNS: Mapping[str, str] = MappingProxyType({
    "collisions": "no_ego_at_fault_collisions", "drivable": "drivable_area_compliance",
    "direction": "driving_direction_compliance", "making_progress": "ego_is_making_progress",
    "progress": "ego_progress_along_expert_route", "ttc": "time_to_collision_within_bound",
    "speed_limit": "speed_limit_compliance", "comfort": "ego_is_comfortable", "score": "score",
})  # fmt: skip
"""nuPlan's column of each part of `nuplan_closed`."""
AVERAGE, FINAL = "average_all_frames", "final_score"  # Names of the summary's row in NAVSIM's and in nuPlan's tables
TIME_ONLY = 1e-3


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """Rows by scene or drive, a summary row for each agent, and what cannot be exact for these logs and why."""

    rows: pd.DataFrame
    inexact: tuple[str, ...]


def nuplan_table(results: Results) -> ScoreTable:
    """Return nuPlan's closed-loop scores of the drives of a run.

    ConfigError if the run has no closed loop, or was made without the metric.
    """
    found = results.metrics
    found = found[found["metric"].str.match(r"nuplan_closed\.\w+\.final") & (found["mode"] == "closed")]
    if found.empty:
        raise ConfigError(f"{results.path}: no closed drive with the metric nuplan_closed; evaluate with --mode closed")
    part = found["metric"].str.split(".").str[1]
    wide = found.assign(part=part).pivot_table("value", ["log", "planner"], "part", dropna=False, sort=False)
    rows = wide.reindex(columns=list(CLS_COLUMNS)).rename(columns=CLS_COLUMNS).reset_index()
    rows = rows.rename(columns={"log": "scenario", "planner": "planner_name"})
    missing = found[found["value"].isna() & found["metric"].eq("nuplan_closed.score.final")]
    ends = results.drives.loc[results.drives["mode"] == "closed", "end"]
    early = int((~ends.isin([EndReason.END_OF_LOG.value, EndReason.END_OF_LOG.name.lower()])).sum())
    traffic = results.run.loop.traffic
    reactive = "as logged: CLS-NR" if traffic == "time" else f"{traffic}, not nuPlan's IDM: comparable with CLS-R"
    notes = [f"traffic: {reactive}", "vehicle and controller: those of the run, not nuPlan's LQR and bicycle at 10 Hz"]
    again = "evaluate with --set loop.drives_on=true"
    notes += [f"{early} of {len(ends)} drives ended before the log, where nuPlan drives on: {again}"] if early else []
    notes += [f"{row.log} ({row.planner}): no score: {row.reason}" for row in missing.itertuples()]
    return ScoreTable(_with_means(rows, "scenario", "planner_name", FINAL), tuple(notes))


def navsim_table(
    name: str, asked: Sequence[Asked], logs: Mapping[str, Scenario], on_plan: Callable[[], None] = lambda: None
) -> ScoreTable:
    """Return NAVSIM's scores of plans.

    `name`: a name of `VERSIONS`. ConfigError if there are no plans, or a window does not fit its log.
    """
    if not asked:
        raise ConfigError("no plans to score: a window needs a plan of 4 s, and 4 s of the log after its begin")
    version, done, rows = VERSIONS[name], dict[tuple[str, str, int], ScoredPlan](), []
    staged = any(one.stage_one for one in asked)
    if staged and "EC" not in version.columns:
        raise ConfigError(f"stage_one: {name} has one stage; take --as navsim-v2, or leave the column out")
    here: tuple[tuple[str, float], ScoredWindow, Yardstick] | None = None
    in_order = sorted(asked, key=lambda one: (one.log, one.t, one.drive))
    for one in in_order:
        if here is None or here[0] != (one.log, one.t):
            begin = window(logs[one.log], one.t)
            here = (one.log, one.t), begin, yardstick(begin, version)
        at = round(one.t / POSE_S * 100)
        before = done.get((one.log, one.drive, at - 100)) if "EC" in version.columns else None
        done[one.log, one.drive, at] = scored(here[1], one.poses, version, before, here[2])
        on_plan()
    for one in in_order:
        at = round(one.t / POSE_S * 100)
        now, after = done[one.log, one.drive, at], done.get((one.log, one.drive, at + 100))
        if staged and after is not None and np.isnan(now.parts["EC"]):  # the earlier of a pair has the pair's
            now = now.with_comfort(after.parts["EC"])
        columns = {column: now.parts[part] for part, column in version.columns.items()}
        rows.append({"token": one.token or f"{one.log}@{one.t:g}", "log_name": one.log, "agent": one.drive,
                     "start_time": one.t, **columns, "score": now.score})  # fmt: skip
    table = pd.DataFrame(rows)
    if staged:
        table = two_stages(table, in_order, logs)
    table = table.sort_values(["log_name", "agent", "start_time"], kind="stable", ignore_index=True)
    notes = tuple(_navsim_notes(table, asked, logs, name))
    return ScoreTable(with_stages(table) if staged else _with_means(table, "token", "agent", AVERAGE), notes)


def _with_means(rows: pd.DataFrame, name: str, agent: str, word: str) -> pd.DataFrame:
    """Return the rows with one more for each agent: the means of the columns over rows that have a value."""
    parts = [column for column in rows.columns if rows[column].dtype == np.float64 and column != "start_time"]
    means = rows.groupby(agent, sort=False)[parts].mean().reset_index()
    return pd.concat([rows, means.assign(**{name: word})], ignore_index=True)[list(rows.columns)]


def _navsim_notes(rows: pd.DataFrame, asked: Sequence[Asked], logs: Mapping[str, Scenario], name: str) -> Iterable[str]:
    """Yield what cannot be exact, with the part and the number of windows that it concerns."""
    used = {one.log: logs[one.log] for one in asked}
    roads = [scenario.road for scenario in used.values()]
    past = sum(one.t < logs[one.log].ego.t[0] + PAST_S - TIME_ONLY for one in asked)
    car = [
        key for key, one in used.items()
        if abs(one.vehicle.length - NUPLAN_CAR.length) + abs(one.vehicle.width - NUPLAN_CAR.width) > 1e-3
    ]  # fmt: skip
    lights = sum(not scenario.lights for scenario in used.values())
    limits = sum(not any(np.isfinite(road.stated_limit(i)) for i in road.lanes) for road in roads)
    areas = sum(not road.areas for road in roads)
    marked = sum(not any(IN_JUNCTION in lane.kind.split("+") for lane in road.lanes.values()) for road in roads)
    if STAGE not in rows:
        yield "one stage: no trajectory names the window that it follows (column stage_one)"
    else:
        yield "stage two: its road users drive as logged; NAVSIM lets vehicles react, by its IDM"
        first = rows[rows[STAGE] == 1]
        if alone := int((~first["token"].isin(rows[FOLLOWS])).sum()):
            yield f"{COMBINED}: {alone} of {len(first)} windows of stage one have no follow-up scene: left out"
    if guessed := sum(not road.route for road in roads):
        yield f"route: {guessed} of {len(used)} logs name none: the lanes of their driver, and straight on"
    if car:
        yield f"vehicle: the ego of {len(car)} of {len(used)} logs is not nuPlan's Pacifica, whose box NAVSIM judges"
    if lights and name != "navsim-v1":
        yield f"traffic_light_compliance: {lights} of {len(used)} logs have no traffic lights: it is 1"
    if limits:
        yield f"ego_progress: {limits} of {len(used)} logs state no speed limit: PDM-Closed drives up to 15 m/s"
    if areas:
        yield f"drivable_area_compliance: {areas} of {len(used)} logs have no drivable ground beside their lanes"
    if marked:
        yield f"intersections: {marked} of {len(used)} logs mark none: lanes that cross others are taken for them"
    if past and name != "navsim-v1":
        yield f"history_comfort: {past} of {len(asked)} windows have less than {PAST_S:g} s of recorded past"
    alone = int(rows["two_frame_extended_comfort"].isna().sum()) if "two_frame_extended_comfort" in rows else 0
    if alone:
        yield f"two_frame_extended_comfort: {alone} of {len(asked)} windows have no plan 0.5 s earlier: no weight"


SIGMA2 = 0.1  # Variance of (1), m2
STAGE, FOLLOWS, WEIGHT = "stage", "stage_one", "weight"
STAGE_ONE, STAGE_TWO, COMBINED = (f"extended_pdm_score_{word}" for word in ("stage_one", "stage_two", "combined"))
"""Names of the summary's rows in NAVSIM's tables."""


def weights(end: FloatArray, begins: FloatArray) -> FloatArray:
    """Return the weights (1) `(n,)` of scenes: the plan ends at `end` `(2,)`, they begin at `begins` `(n, 2)`."""
    found = np.exp(-((begins - end) ** 2).sum(axis=1) / (2.0 * SIGMA2))
    return found / found.sum() if found.sum() > 1e-8 else np.full(len(begins), 1.0 / len(begins))


def two_stages(rows: pd.DataFrame, asked: Sequence[Asked], logs: Mapping[str, Scenario]) -> pd.DataFrame:
    """Return the rows of plans with their stage, the token that they follow, and their weight.

    ConfigError if two plans of an agent have one token; a plan follows none of stage one.
    """
    rows = rows.copy()
    rows[FOLLOWS], rows[WEIGHT] = [one.stage_one for one in asked], 1.0
    rows[STAGE] = np.where(rows[FOLLOWS] == "", 1, 2)
    twice = rows[rows.duplicated(["agent", "token"])]
    if len(twice):
        raise ConfigError(f"token {twice['token'].iloc[0]}: two windows have it; stage_one needs tokens that differ")
    first = {(one.drive, token): one for one, token in zip(asked, rows["token"], strict=True) if not one.stage_one}
    for key, group in rows[rows[STAGE] == 2].groupby(["agent", FOLLOWS], sort=False):
        agent, token = map(str, key)
        if (agent, token) not in first:
            raise ConfigError(f"stage_one: {agent or 'the agent'} has no window of stage one with the token {token}")
        before = first[agent, token]
        scenes = [(logs[asked[k].log], asked[k].t) for k in group.index]
        starts = [(ego_at(log, t), log.origin) for log, t in scenes]
        end = before.poses[-1, :2] + logs[before.log].origin
        rows.loc[group.index, WEIGHT] = weights(end, np.array([(ego.x + x, ego.y + y) for ego, (x, y) in starts]))
    return rows


def with_stages(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows with three more for each agent: the means of stage one and of stage two, and the product (2)."""
    parts = [name for name in rows.columns if rows[name].dtype == np.float64 and name not in ("start_time", WEIGHT)]
    summary = []
    for agent, own in rows.groupby("agent", sort=False):
        one, two = (own[own[STAGE] == stage] for stage in (1, 2))
        after = two[parts].mul(two[WEIGHT], axis=0).groupby(two[FOLLOWS]).sum(min_count=1)
        product = (one.set_index("token")["score"] * after["score"]).mean()
        summary += [
            {"token": STAGE_ONE, "agent": agent, **one[parts].mean()},
            {"token": STAGE_TWO, "agent": agent, **after.mean()},
            {"token": COMBINED, "agent": agent, "score": product},
        ]
    return pd.concat([rows, pd.DataFrame(summary)], ignore_index=True)[list(rows.columns)]
