"""NAVSIM's scores of plans: its columns, the means of each agent, and what cannot be exact."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import groupby

import numpy as np
import pandas as pd

from replan.core.errors import ConfigError
from replan.logs.road import IN_JUNCTION, Road
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VehicleParameters
from replan.score.navsim import NUPLAN_CAR, PAST_S, VERSIONS, Version, window_at
from replan.score.score_table import ScoreTable, agent_means
from replan.score.submitted_plans import SAME_TIME_S, SubmittedPlan
from replan.score.two_stages import COMBINED, FOLLOWS, STAGE, stage_means, with_weights
from replan.score.yardstick import ScoredPlan, scored, yardstick

AVERAGE = "average_all_frames"
"""The token of the row with the means."""
SAME_SIZE_M = 1e-3
"""A car whose length and width are off by less, together, has the same box, m."""


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
    version = VERSIONS[name]
    parts = [*version.columns.values(), "score"]
    staged = any(plan.stage_one for plan in plans)
    if staged and "EC" not in version.columns:
        raise ConfigError(
            f"stage_one: {name} has one stage; take --as navsim-v2, or leave the column out"
        )
    rows = []
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
        table = with_weights(table, in_order, logs)
    table = table.sort_values(["log_name", "agent", "start_time"], kind="stable", ignore_index=True)
    if staged:
        summary = stage_means(table, parts)
    else:
        summary = agent_means(table, "agent", parts).assign(token=AVERAGE)
    return ScoreTable(table, summary, tuple(_inexact(table, plans, logs, version)))


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
        pdm_closed = yardstick(window, version)
        for plan in group:
            earlier = scores.get(plan.key(-1)) if "EC" in version.columns else None
            scores[plan.key()] = scored(window, plan.poses, version, earlier, pdm_closed)
            on_plan()
    return scores


def _inexact(
    rows: pd.DataFrame,
    plans: Sequence[SubmittedPlan],
    logs: Mapping[str, Scenario],
    version: Version,
) -> Iterable[str]:
    """Yield what cannot be exact, with the part and the number of windows that it concerns."""
    used = {plan.log: logs[plan.log] for plan in plans}
    roads = [scenario.road for scenario in used.values()]
    windows = f"of {len(plans)} windows"
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
        "traffic_light_compliance: {} have no traffic lights: it is 1": sum(
            "TLC" in version.columns and not scenario.lights for scenario in used.values()
        ),
        "ego_progress: {} state no speed limit: PDM-Closed drives up to 15 m/s": sum(
            not any(np.isfinite(road.stated_limit(i)) for i in road.lanes) for road in roads
        ),
        "drivable_area_compliance: {} have no drivable ground beside their lanes": sum(
            not road.open_ground for road in roads
        ),
        "intersections: {} mark none: lanes that cross others are taken for them": sum(
            not _marks_intersections(road) for road in roads
        ),
    }
    for note, count in logs_with.items():
        if count:
            yield note.format(f"{count} of {len(used)} logs")
    early = sum(plan.t < logs[plan.log].ego.t[0] + PAST_S - SAME_TIME_S for plan in plans)
    if early and version.past:
        yield f"history_comfort: {early} {windows} have less than {PAST_S:g} s of recorded past"
    comfort = "two_frame_extended_comfort"
    if comfort in rows and (alone := int(rows[comfort].isna().sum())):
        yield f"{comfort}: {alone} {windows} have no plan 0.5 s earlier: no weight"


def _is_nuplan_car(car: VehicleParameters) -> bool:
    off = abs(car.length - NUPLAN_CAR.length) + abs(car.width - NUPLAN_CAR.width)
    return off <= SAME_SIZE_M


def _marks_intersections(road: Road) -> bool:
    return any(IN_JUNCTION in lane.kind.split("+") for lane in road.lanes.values())
