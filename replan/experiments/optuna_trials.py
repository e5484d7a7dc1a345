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
        modes = {objective.mode for objective in self.objectives}
        mode: RunMode = "both" if "open" in modes else "closed"
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
            "objectives": [objective.metric for objective in self.objectives],
            "settings": {setting.key: repr(setting) for setting in self.settings},
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
        self._distributions = {setting.key: self._range(setting) for setting in plan.settings}
        self._trial: Any = None
        if all(setting.holds_default for setting in plan.settings):
            self._study.enqueue_trial({setting.key: setting.default for setting in plan.settings})

    def _range(self, setting: Setting) -> Any:
        """Optuna's distribution of a setting."""
        kinds = self._optuna.distributions
        if setting.choices:
            return kinds.CategoricalDistribution(setting.choices)
        if setting.is_whole:
            step = int(setting.step or 1)
            return kinds.IntDistribution(*map(int, setting.ends), log=setting.log, step=step)
        return kinds.FloatDistribution(*setting.ends, log=setting.log, step=setting.step)

    def ask(self) -> Values:
        """The settings of the next trial."""
        with _quiet():
            self._trial = self._study.ask(self._distributions)
        return {setting.path: self._trial.params[setting.key] for setting in self._plan.settings}

    def tell(self, row: Mapping[str, Any]) -> None:
        """Give optuna the result of the last trial."""
        with _quiet():
            if row["refused"]:
                self._study.tell(self._trial, state=self._optuna.trial.TrialState.FAIL)
                return
            self._trial.set_user_attr("violation", float(row["failed"] - self._default.failed))
            names = [f"gain {objective.metric}" for objective in self._plan.objectives]
            self._study.tell(self._trial, [row[name] for name in names])

    def row(self, values: Values, scores: RunScores | str) -> dict[str, Any]:
        """The row of a trial: its gains, or the reason why its settings are refused together."""
        objectives = self._plan.objectives
        row: dict[str, Any] = {setting.key: values[setting.path] for setting in self._plan.settings}
        names = [f"gain {objective.metric}" for objective in objectives]
        if isinstance(scores, str):
            refused = {"total": None, "failed": None, "feasible": False, "refused": scores}
            return {**row, **dict.fromkeys(names), **refused}
        gain = gains(scores.values, self._default.values, self._scale, objectives).mean(axis=1)
        return {
            **row,
            **dict(zip(names, gain.tolist(), strict=True)),
            "total": float(gain.sum()),
            "failed": scores.failed,
            "feasible": scores.failed <= self._default.failed,
            "refused": "",
        }


def _quiet() -> warnings.catch_warnings[None]:
    """Suppress optuna's warnings about changes in later versions."""
    return warnings.catch_warnings(action="ignore")


def key_of(values: Values) -> str:
    """The key of a trial in the file of the study."""
    return "; ".join(f"{'.'.join(path)} = {value!r}" for path, value in values.items())
