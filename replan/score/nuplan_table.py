"""nuPlan's closed-loop scores of the drives of a run: its columns, and the final score."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from replan.core.errors import ConfigError
from replan.draw.drawn_results import Results
from replan.logs.trace import EndReason
from replan.score.score_table import ScoreTable, agent_means

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
FINAL = "final_score"
"""The scenario of the row with the means."""


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
    if early:
        notes.append(
            f"{early} of {len(ends)} drives ended before the log, where nuPlan drives on: {again}"
        )
    notes += [f"{row.log} ({row.planner}): no score: {row.reason}" for row in missing.itertuples()]
    means = agent_means(rows, "planner_name", list(CLS_COLUMNS.values()))
    return ScoreTable(rows, means.assign(scenario=FINAL), tuple(notes))
