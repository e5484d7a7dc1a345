"""Measure a drive with metrics: (Trace, Scenario) -> table.

`evaluate` returns the table, `series` the same numbers step by step. To add a built-in metric,
define it in one file with the decorator of `metrics/metric.py` and list it in GROUPS. Load a metric
from your own package by its name: `load_metric("my_package.mine:my_metric")`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import isfinite, nan
from operator import index
from types import MappingProxyType

import numpy as np
import pandas as pd

from replan.core.errors import raised
from replan.core.extension import ExtensionKind, an_instance
from replan.core.former_names import refuse_copy
from replan.logs.frame_store import light
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.metrics import (
    accuracy,
    alternatives,
    arrival,
    collisions,
    comfort,
    crosswalks,
    cut_in,
    divergence,
    driving_scores,
    effort,
    encounters,
    evidence,
    following,
    gaps,
    lane_position,
    needless,
    off_road,
    plans,
    priority,
    progress,
    proposals,
    reference_drivers,
    rss,
    severity,
    speed_limits,
    steadiness,
    stop_lines,
    time_to_collision,
    tracking,
)
from replan.metrics.boxes import phantoms, without_phantoms
from replan.metrics.metric import Measured, Metric, Reduction, Series, Unavailable

refuse_copy(__name__, "replan.metrics")

__all__ = [
    "COLUMNS",
    "METRICS",
    "Metric",
    "Reduction",
    "Series",
    "Unavailable",
    "evaluate",
    "evaluate_with_series",
    "load_metric",
    "series",
]

GROUPS: Mapping[str, tuple[Metric, ...]] = MappingProxyType(
    {
        "accuracy": (
            accuracy.ade,
            accuracy.fde,
            accuracy.ahe,
            accuracy.fhe,
            accuracy.along_error,
            accuracy.cross_error,
            accuracy.miss,
        ),
        "safety": (
            collisions.collision,
            collisions.collision_at_fault,
            gaps.gap,
            gaps.gap_vulnerable,
            gaps.gap_kept,
            gaps.gap_kept_vulnerable,
            time_to_collision.ttc,
            off_road.off_road,
            proposals.plan_collision,
            proposals.plan_off_road,
            proposals.plan_ttc,
            time_to_collision.ttc_vulnerable,
            severity.collision_severity,
            following.headway,
            following.thw,
            following.drac,
            following.required_decel_of_lead,
            following.btn,
            following.stn,
            following.following_gap,
            encounters.ttc_accelerated,
            encounters.dce,
            encounters.ttce,
            encounters.pet,
            rss.rss_margin,
            rss.rss_improper,
        ),
        "rules": (
            stop_lines.red_light,
            stop_lines.yellow_light,
            stop_lines.stop_sign,
            crosswalks.crosswalk,
            priority.priority_gap,
            priority.priority_gap_assumed,
            priority.yielding,
            cut_in.forced_braking,
            needless.needless_braking,
            needless.needless_standing,
            needless.needless_steering,
            needless.false_braking,
            needless.missed_braking,
            gaps.passing_room,
            lane_position.wrong_way,
            lane_position.lane_keeping,
            lane_position.lane_line,
            speed_limits.speed_excess,
            speed_limits.speed_ratio,
            speed_limits.assumed_limit_excess,
            steadiness.lane_offset,
            steadiness.speed_swing,
            steadiness.needless_lane_change,
            steadiness.braked_behind,
            steadiness.curve_accel,
        ),
        "comfort": (
            comfort.lon_accel,
            comfort.lat_accel,
            comfort.lon_jerk_state,
            comfort.lat_jerk_state,
            comfort.yaw_rate,
            proposals.plan_comfort,
            proposals.plan_lon_accel,
            proposals.plan_lat_accel,
            proposals.plan_lon_jerk,
            comfort.jerk_state,
            comfort.yaw_accel,
            comfort.lon_accel_nuplan,
            comfort.lat_accel_nuplan,
            comfort.lon_jerk_nuplan,
            comfort.jerk_nuplan,
            comfort.yaw_rate_nuplan,
            comfort.yaw_accel_nuplan,
            comfort.lat_jerk_r79,
        ),
        "progress": (
            arrival.completed,
            arrival.goal,
            progress.progress,
            progress.distance,
            progress.speed,
            progress.route_progress,
            progress.completion,
        ),
        "tracking": (
            tracking.tracking_lateral,
            tracking.tracking_heading,
            tracking.tracking_speed,
            tracking.tracking_station,
        ),
        "effort": (
            effort.throttle,
            effort.brake,
            effort.pedals_together,
            effort.pedal_switches,
            effort.steer_rate,
            effort.qp_iterations,
            effort.solver_unsolved,
            effort.fallback,
        ),
        "consistency": (
            plans.plan_change,
            plans.plan_change_lateral,
            plans.extended_comfort,
            plans.plan_horizon,
            plans.plan_complete,
        ),
        "plans": (
            proposals.plan_score,
            proposals.plan_progress,
            proposals.plan_kept,
            proposals.plan_kept_lateral,
        ),
        "alternatives": (
            alternatives.alternatives,
            alternatives.min_ade,
            alternatives.min_fde,
            alternatives.min_miss,
            alternatives.alternatives_spread,
            alternatives.alternatives_off_road,
            alternatives.alternatives_contact,
            alternatives.selection_regret,
            alternatives.nearest_chosen,
            alternatives.brier,
        ),
        "evidence": (
            evidence.coverage,
            progress.covered,
            arrival.goal_route,
            evidence.evidence,
            evidence.agent_interval,
            evidence.replay_contact,
            evidence.plan_refused,
            evidence.plan_corrected,
            evidence.planned_afresh,
            evidence.driven_by,
            evidence.ensemble,
            evidence.asked,
            evidence.discrimination,
            evidence.phantom,
            divergence.divergence,
            divergence.divergence_weak,
            divergence.displaced,
        ),
        "reference": (
            reference_drivers.reference_cc,
            reference_drivers.reference_fsm,
        ),
        "score": (
            driving_scores.nuplan_closed,
            driving_scores.nuplan_open,
            driving_scores.carla,
        ),
    }
)
"""The metrics by topic, in the order of the table."""

METRICS: Mapping[str, Metric] = MappingProxyType(
    {metric.name: metric for group in GROUPS.values() for metric in group}
)
"""The metrics by name, in the order of the table."""

COLUMNS = (
    "log",
    "planner",
    "mode",
    "oracle",
    "metric",
    "value",
    "unit",
    "direction",
    "available",
    "reason",
    "about",
    "time_s",
    "version",
    "source",
)

# The metric that raised, the reason as text, and the error
OnError = Callable[[Metric, str, BaseException], None]


def evaluate(
    trace: Trace,
    scenario: Scenario,
    *,
    metrics: Mapping[str, Metric] = METRICS,
    broken: OnError | None = None,
    found: Callable[[str, Series], None] = lambda name, series: None,
) -> pd.DataFrame:
    """Return one row per metric and reduction of the trace's mode, with `COLUMNS`; equal input
    gives equal bits.

    `metric` is "gap.min" or, with a part, "ade.3s.mean". Where `available` is False, `value` is NaN
    and `reason` says why. Otherwise `reason` names the subject of the value ("car 12: from
    behind"), with short names (`replan.core.names`), and `about` holds only the kind and full id of
    that road user or object ("car 12"); both may be empty. `time_s` is the time of the value, NaN
    where it belongs to no instant. If a metric raises, `broken` is called and the metric is
    unavailable; without `broken` the error is raised. `found` is called with each series and its
    name.
    """
    return as_table(rows_of(trace, scenario, metrics=metrics, broken=broken, found=found))


def series(
    trace: Trace, scenario: Scenario, *, metrics: Mapping[str, Metric] = METRICS
) -> pd.DataFrame:
    """Return the steps behind the table in long form: `t_s`, `metric` ("gap", "ade.3s"), `value`
    (NaN: no value).

    Sorted by metric, then by time.
    """
    return evaluate_with_series(trace, scenario, metrics=metrics)[1]


def evaluate_with_series(
    trace: Trace, scenario: Scenario, *, metrics: Mapping[str, Metric] = METRICS
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the tables of `evaluate` and `series`; each metric is measured once."""
    steps_of: dict[str, Series] = {}
    table = evaluate(trace, scenario, metrics=metrics, found=steps_of.__setitem__)
    by_name = sorted(steps_of.items(), key=lambda item: item[0])
    none = np.empty(0)
    return table, pd.DataFrame(
        {
            "t_s": np.concatenate([none, *(steps.t for _, steps in by_name)]),
            "metric": np.repeat(
                np.array([name for name, _ in by_name], object),
                [len(steps.t) for _, steps in by_name],
            ),
            "value": np.concatenate([none, *(steps.value for _, steps in by_name)]),
        }
    )


def as_table(rows: Sequence[tuple[object, ...]]) -> pd.DataFrame:
    """Convert the rows of `rows_of` to a table.

    One call for several drives is cheaper than joining their tables.
    """
    columns = {name: [row[k] for row in rows] for k, name in enumerate(COLUMNS)}
    return pd.DataFrame(
        {**columns, **{name: np.array(columns[name], np.float64) for name in ("value", "time_s")}}
    )


def rows_of(
    trace: Trace,
    scenario: Scenario,
    *,
    metrics: Mapping[str, Metric] = METRICS,
    broken: OnError | None = None,
    found: Callable[[str, Series], None] = lambda name, series: None,
) -> list[tuple[object, ...]]:
    """Return the rows of `evaluate`. All metrics ignore phantom agents."""
    ours = all(METRICS.get(name) is metric for name, metric in metrics.items())
    # No built-in metric reads graphs or predictions
    frames = light(trace.frames) if ours else trace.frames
    agents = without_phantoms(trace.agents, phantoms(scenario))
    changed = agents is not trace.agents or frames is not trace.frames
    # an unchanged trace keeps its cached measurements
    judged = replace(trace, agents=agents, frames=frames) if changed else trace
    drive, short = (
        (scenario.name, trace.planner, trace.mode.value, trace.oracle),
        scenario.short_names,
    )
    rows: list[tuple[object, ...]] = []
    for metric in metrics.values():
        if trace.mode not in metric.modes:
            continue
        try:
            parts = metric.measured(judged, scenario)
        except (Exception, SystemExit) as error:
            parts = metric.unavailable(
                Unavailable(_report_error(metric, metric.measure, error, broken))
            )
        for name, steps in parts.items():
            if isinstance(steps, Series):
                found(name, steps)
            for reduction in metric.reductions:
                unit, better = (
                    reduction.unit or metric.unit,
                    reduction.direction or metric.direction,
                )
                try:
                    value, available, reason, time_s = _reduce(reduction, steps)
                except (Exception, SystemExit) as error:
                    reason = _report_error(metric, reduction.reduce, error, broken)
                    value, available, time_s = nan, False, nan
                rows.append(
                    (
                        *drive,
                        f"{name}.{reduction.name}",
                        value,
                        unit,
                        better,
                        available,
                        short(reason) if reason else "",
                        reason.partition(":")[0] if available else "",
                        time_s,
                        metric.version,
                        metric.source,
                    )
                )
    return rows


def _report_error(
    metric: Metric, function: Callable[..., object], error: BaseException, broken: OnError | None
) -> str:
    """Call `broken` and return the reason of an error in a metric's function.

    Without `broken`, raise it again.
    """
    if broken is None:
        raise error
    reason = raised(error, of=function)
    broken(metric, reason, error)
    return reason


def _reduce(reduction: Reduction, steps: Measured) -> tuple[float, bool, str, float]:
    """Return the columns value, available, reason (with full ids) and time_s.

    An error of the reduction is raised; ValueError if it returns a step that does not exist.
    """
    if isinstance(steps, Unavailable):
        return nan, False, steps.reason, nan
    if not steps.known.any():
        return (
            (nan, False, steps.missing, nan)
            if reduction.empty is None
            else (reduction.empty, True, "", nan)
        )
    value, step = reduction.reduce(steps)
    value, step = float(value), index(step)
    if not -1 <= step < len(steps.t):
        raise ValueError(f"step {step} of {len(steps.t)}")
    if not isfinite(value):
        return nan, False, f"{reduction.name} of the steps is {value}, not a number", nan
    label = steps.labels[step] if steps.labels and step >= 0 else ""
    return value, True, label, float(steps.t[step]) if step >= 0 else nan


METRIC: ExtensionKind[Metric] = ExtensionKind(
    "metric", "metrics", METRICS, an_instance(Metric, "replan.Metric")
)
"""Finds metrics by name: the built-in ones and those of users."""


def load_metric(spec: str) -> Metric:
    """Return a built-in metric ("gap") or a user's ("module:NAME", a `Metric`); ConfigError as
    `ExtensionKind.find`.
    """
    return METRIC.find(spec)
