"""Was it good? (Trace, Scenario) -> table.

`evaluate` gives the table, `series` the same numbers step by step. A metric is added in one file (vocabulary:
`metrics/metric.py`) and one line of METRICS; a user's own comes from outside: `load_metric("my_package.mine:METRIC")`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from math import nan
from operator import index
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

import replan.own
from logs.errors import raised
from logs.extension import Kind, an_instance
from logs.frame_store import light
from logs.scenario import Scenario
from logs.trace import Trace
from metrics import (
    accuracy,
    avoidability,
    comfort,
    consistency,
    cut_in,
    effort,
    encounters,
    evidence,
    false_braking,
    following,
    lane_keeping,
    needless,
    progress,
    proposals,
    rss,
    rules,
    safety,
    score,
)
from metrics.metric import Measured, Metric, Reduction, Series, Unavailable
from metrics.phantoms import phantoms, without_phantoms

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

GROUPS: Mapping[str, tuple[Metric, ...]] = MappingProxyType({
    "accuracy": (
        accuracy.ADE, accuracy.FDE, accuracy.AHE, accuracy.FHE, accuracy.ALONG, accuracy.CROSS,
        accuracy.MISS,
    ),
    "safety": (
        safety.COLLISION, safety.COLLISION_AT_FAULT, safety.GAP, safety.GAP_VULNERABLE, safety.GAP_KEPT,
        safety.GAP_KEPT_VULNERABLE, safety.TTC, safety.OFF_ROAD,
        proposals.PLAN_COLLISION, proposals.PLAN_OFF_ROAD, proposals.PLAN_TTC,
        safety.TTC_VULNERABLE, safety.COLLISION_SEVERITY, *following.FOLLOWING, encounters.TTC_ACCELERATED,
        encounters.DCE, encounters.TTCE, encounters.PET, rss.RSS_MARGIN, rss.RSS_IMPROPER,
    ),
    "rules": (
        rules.RED_LIGHT, rules.STOP_SIGN, rules.CROSSWALK, rules.PRIORITY_GAP, rules.YIELDING,
        cut_in.FORCED_BRAKING, needless.NEEDLESS_BRAKING, needless.NEEDLESS_STANDING, needless.NEEDLESS_STEERING,
        false_braking.FALSE_BRAKING, false_braking.MISSED_BRAKING,
        safety.PASSING_ROOM, lane_keeping.WRONG_WAY, lane_keeping.LANE_KEEPING, lane_keeping.LANE_LINE,
        progress.SPEED_EXCESS, progress.SPEED_RATIO, progress.ASSUMED_LIMIT_EXCESS,
    ),
    "comfort": (
        comfort.LON_ACCEL, comfort.LAT_ACCEL, comfort.LON_JERK_STATE, comfort.LAT_JERK_STATE, comfort.YAW_RATE,
        proposals.PLAN_COMFORT, proposals.PLAN_LON_ACCEL, proposals.PLAN_LAT_ACCEL, proposals.PLAN_LON_JERK,
        comfort.JERK_STATE, comfort.YAW_ACCEL, *comfort.NUPLAN, comfort.LAT_JERK_R79,
    ),
    "progress": (
        progress.COMPLETED, progress.GOAL, progress.PROGRESS, progress.DISTANCE, progress.SPEED,
        progress.ROUTE_PROGRESS,
        progress.COMPLETION,
    ),
    "tracking": effort.TRACKING,
    "effort": effort.EFFORT,
    "consistency": (
        consistency.PLAN_CHANGE, consistency.PLAN_CHANGE_LATERAL,
        consistency.EXTENDED_COMFORT, consistency.PLAN_HORIZON, consistency.PLAN_COMPLETE,
    ),
    "plans": (proposals.PLAN_SCORE, proposals.PLAN_PROGRESS, proposals.PLAN_KEPT, proposals.PLAN_KEPT_LATERAL),
    "evidence": (
        evidence.COVERAGE, evidence.EVIDENCE, evidence.AGENT_INTERVAL, evidence.REPLAY_CONTACT,
        evidence.PLAN_REFUSED, evidence.PLAN_CORRECTED, evidence.ENSEMBLE, evidence.ASKED, evidence.PHANTOM,
        evidence.DIVERGENCE, evidence.WEAK, evidence.DISPLACED,
    ),
    "reference": (avoidability.CC, avoidability.FSM),
    "score": (
        score.NUPLAN_CLOSED_SCORE, score.NUPLAN_OPEN_SCORE, score.PDMS_SCORE, score.EPDMS_SCORE, score.CARLA_SCORE,
    ),
})  # fmt: skip
"""The metrics by what they are about, in the order of the table."""

METRICS: Mapping[str, Metric] = MappingProxyType({metric.name: metric for group in GROUPS.values() for metric in group})
"""The metrics by name, in the order of the table."""

COLUMNS = (
    "log", "planner", "mode", "oracle", "metric", "value", "unit", "direction", "available", "reason", "about",
    "time_s", "version", "source",
)  # fmt: skip


Broken = Callable[[Metric, str, BaseException], None]  # a metric that raised, why in words, and the error


def evaluate(
    trace: Trace,
    scenario: Scenario,
    *,
    metrics: Mapping[str, Metric] = METRICS,
    broken: Broken | None = None,
    found: Callable[[str, Series], None] = lambda name, series: None,
) -> pd.DataFrame:
    """One row per metric and reduction of the trace's mode, columns `COLUMNS`; the same input gives the same bits.

    `metric` is "gap.min" or, with a part, "ade.3s.mean". Where `available` is False, `value` is NaN and `reason` says
    why; else `reason` names what the value is about ("car 12: from behind"), with short names (`logs.names`), and
    `about` is that road user or thing alone, with the whole id ("car 12"); both may be empty. `time_s` is when the
    value occurred, NaN where it belongs to no instant. A metric that raises is unavailable where `broken` is given,
    which is then called; else the error is raised. `found` is called with each series and its name.
    """
    head, rows = (scenario.name, trace.planner, trace.mode.value, trace.oracle), []
    for metric, name, steps in _measured(trace, scenario, metrics, broken):
        if isinstance(steps, Series):
            found(name, steps)
        for reduction in metric.reductions:
            *row, available, reason, time_s = _row(f"{name}.{reduction.name}", metric, reduction, steps, broken)
            about = reason.partition(":")[0] if available else ""
            rows.append(
                (*head, *row, available, scenario.short_names(reason), about, time_s, metric.version, metric.source)
            )
    columns = {name: [row[k] for row in rows] for k, name in enumerate(COLUMNS)}
    return pd.DataFrame({**columns, **{name: np.array(columns[name], np.float64) for name in ("value", "time_s")}})


def series(trace: Trace, scenario: Scenario, *, metrics: Mapping[str, Metric] = METRICS) -> pd.DataFrame:
    """The steps behind the table, long form: `t_s`, `metric` ("gap", "ade.3s"), `value` (NaN: this step has none).

    Sorted by metric, then by time.
    """
    found = _measured(trace, scenario, metrics)
    return _steps({name: steps for _, name, steps in found if isinstance(steps, Series)})


def evaluate_with_series(
    trace: Trace, scenario: Scenario, *, metrics: Mapping[str, Metric] = METRICS, broken: Broken | None = None
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """`evaluate` and `series`, each metric measured once."""
    steps: dict[str, Series] = {}
    table = evaluate(trace, scenario, metrics=metrics, broken=broken, found=steps.__setitem__)
    return table, _steps(steps)


def _steps(steps_of: Mapping[str, Series]) -> pd.DataFrame:
    found = sorted(steps_of.items(), key=lambda item: item[0])
    none = np.empty(0)
    return pd.DataFrame(
        {
            "t_s": np.concatenate([none, *(steps.t for _, steps in found)]),
            "metric": np.repeat(np.array([name for name, _ in found], object), [len(steps.t) for _, steps in found]),
            "value": np.concatenate([none, *(steps.value for _, steps in found)]),
        }
    )


METRIC: Kind[Metric] = Kind("metric", "metrics", METRICS, an_instance(Metric, "metrics.Metric"))
"""Those of ours, and of users."""


def load_metric(spec: str) -> Metric:
    """A metric by name ("gap"), or from outside ("module:NAME", a `Metric` object); ConfigError as `Kind.find`."""
    return METRIC.find(spec)


def _measured(
    trace: Trace, scenario: Scenario, metrics: Mapping[str, Metric], broken: Broken | None = None
) -> Iterator[tuple[Metric, str, Measured]]:
    """Every metric of the trace's mode, part by part; what is a phantom is left out for all of them."""
    ours = all(METRICS.get(name) is metric for name, metric in metrics.items())  # none looks at graphs or predictions
    frames = light(trace.frames) if ours else trace.frames
    judged = replace(trace, agents=without_phantoms(trace.agents, phantoms(scenario)), frames=frames)
    for metric in metrics.values():
        if trace.mode in metric.modes:
            try:
                parts = metric.measured(judged, scenario)
            except (Exception, SystemExit) as error:
                if broken is None:
                    raise
                reason = raised(error, of=metric.measure)
                broken(metric, reason, error)
                parts = metric.unavailable(Unavailable(reason))
            yield from ((metric, name, found) for name, found in parts.items())


def _row(
    name: str, metric: Metric, reduction: Reduction, found: Measured, broken: Broken | None
) -> tuple[str, float, str, str, bool, str, float]:
    """From `metric` to `time_s`."""
    unit, direction = reduction.unit or metric.unit, reduction.direction or metric.direction
    if isinstance(found, Unavailable):
        return name, nan, unit, direction, False, found.reason, nan
    if not found.known.any():
        if reduction.empty is None:
            return name, nan, unit, direction, False, found.missing, nan
        return name, reduction.empty, unit, direction, True, "", nan
    try:
        value, step = reduction.reduce(found)
        value, step = float(value), index(step)
        if not -1 <= step < len(found.t):
            raise ValueError(f"step {step} of {len(found.t)}")
    except (Exception, SystemExit) as error:
        if broken is None:
            raise
        reason = raised(error, of=reduction.reduce)
        broken(metric, reason, error)
        return name, nan, unit, direction, False, reason, nan
    if not np.isfinite(value):
        return name, nan, unit, direction, False, f"{reduction.name} of the steps is {value}, which is no number", nan
    label = found.labels[step] if found.labels and step >= 0 else ""
    return name, value, unit, direction, True, label, float(found.t[step]) if step >= 0 else nan


if not TYPE_CHECKING:  # a type checker would take any name for one of ours
    __getattr__ = replan.own.missing("metrics")
