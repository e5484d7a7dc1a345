"""Training and held-out logs; the gain of a run over the defaults, and whether it is more than
chance.

For a log i and an objective j, which is a row of the table of metrics with a better direction:

(1) gain_ij = +-(value_ij - default_ij) / scale_j
        0 where the difference is rounding (`replan.metrics.resampling`, (1)), and where one of both
        runs has no value
(2) scale_j = mean over the training logs of |default_ij|; 1 where that is 0
(3) objective_j = mean over the training logs of gain_ij, which is maximised
(4) feasible: no more failed verdicts and failed drives on the training logs than with the defaults
(5) chosen = the feasible trial with the greatest sum over j of (3), if that is above 0;
        of equals the first. It is on the Pareto front
(6) better = over the held-out logs, the 95 % interval of the mean of sum over j of gain_ij
        is above 0: a paired percentile bootstrap over logs, seeded, of `LEAST_LOGS` logs at least
        (`replan.metrics.resampling`, (2) and (3))

Logs are put in the order of their stratum (the family, else the dataset, else none), then of the
SHA-256 of their name. The k-th log in this order, from 0, is held out if

(7) floor((k + 1) share) > floor(k share)

a systematic sample: every stratum gives about its share, and floor(n share) logs are held out in
    all. The sample does not depend on time, seed or order of arguments. Adding a log may change
    which logs of its stratum and of later strata are held out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from math import floor, isfinite, nan

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError, unknown_name
from replan.draw.drawn_results import Results
from replan.logs.trace import Mode
from replan.metrics import Metric
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.gates import Outcome
from replan.metrics.resampling import MIN_SIGNIFICANT, intervals, noise

LEAST_LOGS = MIN_SIGNIFICANT
SLACK = 1e-9
"""Tolerance so that rounding does not change floor(): 0.3 of ten logs are three."""
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
    known: dict[str, Objective | None] = {}
    for metric in metrics.values():
        mode = (Mode.CLOSED if Mode.CLOSED in metric.modes else Mode.OPEN).value
        for part in metric.parts or ("",):
            for reduction in metric.reductions:
                row = ".".join(filter(None, (metric.name, part, reduction.name)))
                sign = {"higher": 1.0, "lower": -1.0}.get(reduction.direction or metric.direction)
                known[row] = None if sign is None else Objective(row, mode, sign)
    chosen = []
    for name in names:
        if name not in known:
            raise unknown_name("metric (of --objective)", name, known)
        objective = known[name]
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
    known = dict(zip(keys, table["value"], strict=True))
    rows = [(objective.metric, objective.mode) for objective in asked]
    values = [float(known.get((log, *row), nan)) for row in rows for log in logs]
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
        return isfinite(self.low) and self.low > 0.0 and self.logs >= LEAST_LOGS

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


def is_dominated(gain: FloatArray, others: FloatArray) -> bool:
    """Whether one of the others `(m, j)` is at least as good in each objective, and better in
    one.
    """
    return bool(((others >= gain).all(axis=1) & (others > gain).any(axis=1)).any())


def held_out(labels: Mapping[str, LogLabels], share: float) -> frozenset[str]:
    """The names of the logs that are held out (7), from the labels of each by name."""
    order = sorted(labels, key=lambda name: (stratum(labels[name]), sha256(name.encode()).digest()))
    return frozenset(
        name
        for k, name in enumerate(order)
        if floor((k + 1) * share + SLACK) > floor(k * share + SLACK)
    )


def stratum(labels: LogLabels) -> str:
    """The stratum of a log: its family, else its dataset."""
    return labels.family or labels.dataset
