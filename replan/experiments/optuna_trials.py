"""The trials of a tuning: optuna chooses the settings to try next, and gets the result of each.

Trials are made one after the other, by optuna's multi-objective TPE (Ozaki et al., J. Artif.
Intell. Res. 73, 2022), with the gates as a constraint ((4) of `gains`). So the trials depend only
on the seed and on the results of earlier trials. The first one is the default, if it is in the
space. Settings that are refused together are a trial that failed.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from typing import Any

from replan.config import RunConfig, RunMode
from replan.core.errors import ConfigError
from replan.experiments.gains import Objective, RunScores, gains, scales
from replan.experiments.space import Setting, Value
from replan.run.resume import study_head

KIND = "tune"
TRIALS, SHARE = 50, 0.3
STARTUP = 10
"""Number of random trials before TPE has enough data (optuna's default)."""
Values = dict[tuple[str, ...], Value]
"""Values of settings by their path."""


@dataclass(frozen=True, eq=False)
class TuningInputs:
    """The inputs of a tuning.

    Attributes:
        run: Planner (one) and settings with which the search begins: the defaults.
        share: Share of the logs that are held out.
    """

    run: RunConfig
    settings: tuple[Setting, ...]
    objectives: tuple[Objective, ...]
    trials: int = TRIALS
    seed: int = 0
    share: float = SHARE

    @cached_property
    def driven(self) -> RunConfig:
        """The defaults as they are driven: the loops that the objectives need, without
        recordings.
        """
        mode: RunMode = "both" if any(one.mode == "open" for one in self.objectives) else "closed"
        return replace(
            self.run, mode=mode, recording=False, internals="none", deadline_s=0.0, ensemble=0
        )

    def head(self, logs: Mapping[str, str]) -> dict[str, Any]:
        """The inputs that identify a tuning, except the number of trials; `logs` are the identities
        by name.
        """
        inputs = {
            "seed": self.seed,
            "share": self.share,
            "objectives": [one.metric for one in self.objectives],
            "settings": {one.key: repr(one) for one in self.settings},
            "logs": {
                name: sha256(identity.encode()).hexdigest()[:16] for name, identity in logs.items()
            },
        }
        return study_head(KIND, self.driven, inputs)


def optuna_module() -> Any:
    """Optuna without log output; ConfigError if it is not installed."""
    try:
        import optuna
    except ImportError:
        raise ConfigError("replan tune needs optuna: pip install 'replan[improve]'") from None
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna


class OptunaTrials:
    """optuna's study: it gives the next trial, and takes its result."""

    def __init__(self, plan: TuningInputs, default: RunScores) -> None:
        self._plan, self._default, self._scale = plan, default, scales(default.values)
        self._optuna = optuna_module()
        with _quiet():
            sampler = self._optuna.samplers.TPESampler(
                seed=plan.seed,
                n_startup_trials=STARTUP,
                multivariate=True,
                constraints_func=lambda trial: (trial.user_attrs["violation"],),
            )
            self._study: Any = self._optuna.create_study(
                directions=["maximize"] * len(plan.objectives), sampler=sampler
            )
        self._distributions: dict[str, Any] = {}
        for one in plan.settings:
            kinds, low, high = self._optuna.distributions, one.low, one.high
            if one.choices:
                self._distributions[one.key] = kinds.CategoricalDistribution(one.choices)
                continue
            assert low is not None and high is not None
            if one.is_whole:
                step = int(one.step or 1)
                self._distributions[one.key] = kinds.IntDistribution(
                    int(low), int(high), log=one.log, step=step
                )
                continue
            self._distributions[one.key] = kinds.FloatDistribution(
                float(low), float(high), log=one.log, step=one.step
            )
        self._trial: Any = None
        if all(one.holds_default for one in plan.settings):
            self._study.enqueue_trial({one.key: one.default for one in plan.settings})

    def ask(self) -> Values:
        """The settings of the next trial."""
        with _quiet():
            self._trial = self._study.ask(self._distributions)
        return {one.path: self._trial.params[one.key] for one in self._plan.settings}

    def tell(self, row: Mapping[str, Any]) -> None:
        """Give optuna the result of the last trial."""
        with _quiet():
            if row["refused"]:
                self._study.tell(self._trial, state=self._optuna.trial.TrialState.FAIL)
                return
            self._trial.set_user_attr("violation", float(row["failed"] - self._default.failed))
            self._study.tell(
                self._trial, [row[f"gain {one.metric}"] for one in self._plan.objectives]
            )

    def row(self, values: Values, found: RunScores | str) -> dict[str, Any]:
        """The row of a trial: its gains, or the reason why its settings are refused together."""
        row: dict[str, Any] = {one.key: values[one.path] for one in self._plan.settings}
        names = [f"gain {one.metric}" for one in self._plan.objectives]
        if isinstance(found, str):
            refused = {"total": None, "failed": None, "feasible": False, "refused": found}
            return {**row, **dict.fromkeys(names), **refused}
        mean = gains(found.values, self._default.values, self._scale, self._plan.objectives).mean(
            axis=1
        )
        return {
            **row,
            **dict(zip(names, mean.tolist(), strict=True)),
            "total": float(mean.sum()),
            "failed": found.failed,
            "feasible": found.failed <= self._default.failed,
            "refused": "",
        }


def _quiet() -> warnings.catch_warnings[None]:
    """Suppress optuna's warnings about changes in later versions."""
    return warnings.catch_warnings(action="ignore")


def key_of(values: Values) -> str:
    """The key of a trial in the file of the study."""
    return "; ".join(f"{'.'.join(path)} = {value!r}" for path, value in values.items())
