"""The gain of a run over the defaults, and whether it is more than chance.

For a log i and an objective j, which is a row of the table of metrics with a better direction:

(1) gain_ij = +-(value_ij - default_ij) / scale_j
        0 where the difference is rounding (`replan.metrics.resampling`, (1)), and where either run
        has no value
(2) scale_j = mean over the training logs of |default_ij|; 1 where that is 0
(3) objective_j = mean over the training logs of gain_ij, which is maximised
(4) feasible: no more failed verdicts and failed drives on the training logs than with the defaults
(5) chosen = the feasible trial with the greatest sum over j of (3), if that is above 0;
        of equals the first. It is on the Pareto front
(6) better = over the held-out logs, the 95 % interval of the mean of sum over j of gain_ij
        is above 0: a paired percentile bootstrap over logs, seeded, of `MIN_SIGNIFICANT` logs at
        least (`replan.metrics.resampling`, (2) and (3))
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError, unknown_name
from replan.draw.drawn_results import Results
from replan.logs.trace import Mode
from replan.metrics import Metric
from replan.metrics.judge.gates import Outcome
from replan.metrics.resampling import MIN_SIGNIFICANT, intervals, noise

DEFAULT_OBJECTIVES = ("plan_score.mean", "lon_jerk_state.p95")
"""Progress, safety and rules of the plans as NAVSIM weighs them (EPDMS), and comfort as it is
driven.
"""


@dataclass(frozen=True, slots=True)
class Objective:
    """One number per log: a row of the table of metrics.

    Attributes:
        metric: Its name in the table ("ttc.min").
        mode: The loop: closed if the metric is defined there, otherwise open.
        sign: 1 if higher values are better, -1 if lower ones are.
    """

    metric: str
    mode: str
    sign: float


def objectives(names: Sequence[str], metrics: Mapping[str, Metric]) -> tuple[Objective, ...]:
    """The objectives of these names.

    Raises:
        ConfigError: No metric has a row of this name, or it has no better direction; a name is
            duplicate.
    """
    by_row: dict[str, Objective | None] = {}
    for metric in metrics.values():
        mode = (Mode.CLOSED if Mode.CLOSED in metric.modes else Mode.OPEN).value
        for part in metric.parts or ("",):
            for reduction in metric.reductions:
                row = ".".join(filter(None, (metric.name, part, reduction.name)))
                sign = {"higher": 1.0, "lower": -1.0}.get(reduction.direction or metric.direction)
                by_row[row] = None if sign is None else Objective(row, mode, sign)
    chosen = []
    for name in names:
        if name not in by_row:
            raise unknown_name("metric (of --objective)", name, by_row)
        objective = by_row[name]
        if objective is None:
            raise ConfigError(
                f"--objective {name}: neither more nor less is better; replan metrics lists others"
            )
        chosen.append(objective)
    if len(set(names)) < len(names):
        raise ConfigError(f"--objective: a metric is named twice: {', '.join(names)}")
    return tuple(chosen)


@dataclass(frozen=True, eq=False)
class RunScores:
    """The values of a run that the search compares.

    Attributes:
        values: `(j, n)` by objective and log, NaN if there is none.
        failed: Failed verdicts and failed drives, all logs together.
    """

    values: FloatArray
    failed: int


def run_scores(results: Results, logs: Sequence[str], asked: Sequence[Objective]) -> RunScores:
    """The scores of a run on these logs, in this order."""
    table = results.metrics
    table = table[(table["planner"] == results.run.planners[0]) & table["available"].astype(bool)]
    keys = zip(table["log"], table["metric"], table["mode"], strict=True)
    value_of = dict(zip(keys, table["value"], strict=True))
    rows = [(objective.metric, objective.mode) for objective in asked]
    values = [float(value_of.get((log, *row), nan)) for row in rows for log in logs]
    failed = int((results.verdicts["outcome"] == Outcome.FAIL.value).sum())
    scores: FloatArray = np.reshape(values, (len(asked), len(logs)))
    return RunScores(scores, failed + len(results.failures))


def scales(default: FloatArray) -> FloatArray:
    """The scales (2) of the defaults' values `(j, n)`."""
    means = [
        float(np.mean(np.abs(row[np.isfinite(row)]))) if np.isfinite(row).any() else 0.0
        for row in default
    ]
    return np.array([scale if scale > 0.0 else 1.0 for scale in means])


def gains(
    values: FloatArray, default: FloatArray, scale: FloatArray, asked: Sequence[Objective]
) -> FloatArray:
    """The gains (1) of values `(j, n)` against those of the defaults."""
    signs = np.array([objective.sign for objective in asked])[:, None]
    with np.errstate(invalid="ignore"):
        moved = np.where(noise(default, values), 0.0, values - default)
    return np.nan_to_num(signs * moved / scale[:, None], nan=0.0)


@dataclass(frozen=True, slots=True)
class MeanGain:
    """The result of (6): mean, interval and number of logs, and the conclusion."""

    mean: float
    low: float
    high: float
    logs: int

    @property
    def holds(self) -> bool:
        """Whether the gain is more than chance."""
        return isfinite(self.low) and self.low > 0.0 and self.logs >= MIN_SIGNIFICANT

    def __str__(self) -> str:
        """One sentence."""
        word = "more than chance" if self.holds else "not more than chance"
        interval = f"[{self.low:+.4f}, {self.high:+.4f}]"
        return (
            f"mean gain {self.mean:+.4f}, 95 % interval {interval}, over {self.logs} held-out "
            f"logs: {word}"
        )


def mean_gain(gain: FloatArray) -> MeanGain:
    """The mean gain (6) of the gains `(j, n)` on the held-out logs."""
    total = gain.sum(axis=0)
    low, high = intervals(total[None, :])
    return MeanGain(float(total.mean()), float(low[0]), float(high[0]), len(total))


def is_dominated(trial: FloatArray, others: FloatArray) -> bool:
    """Whether, by the gains of a trial `(j,)` and of others `(m, j)`, another one is at least as
    good in each objective, and better in one.
    """
    return bool(((others >= trial).all(axis=1) & (others > trial).any(axis=1)).any())
