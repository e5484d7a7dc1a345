"""A tuning: settings that are better than the defaults, judged on logs that were not searched, and
its files.

    OUT/tune.json            the inputs, the result, and the printed sentences
    OUT/study.jsonl          the trials, a line each; `--resume` goes on from it
    OUT/trials.parquet, .csv the same as a table; OUT/pareto.csv, .png the trials that no other trial beats
    OUT/best.toml            the chosen settings, for `--config`
    OUT/training/            results with the defaults on the training logs
    OUT/held_out/default/, OUT/held_out/chosen/      results on the held-out logs, as
        `replan compare` takes them

Trials are made one after the other (`optuna_trials`), and the logs of a trial are driven in
parallel: the same logs, space and seed give the same trials at any number of workers.
"""  # noqa: E501

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import tomli_w

from replan.compare_runs import compare_runs
from replan.config import RunConfig
from replan.core.errors import ConfigError
from replan.core.names import counted
from replan.draw.drawn_results import Results
from replan.experiments.gains import (
    MeanGain,
    RunScores,
    gains,
    is_dominated,
    mean_gain,
    run_scores,
    scales,
)
from replan.experiments.held_out import held_out, stratum
from replan.experiments.optuna_trials import (
    KIND,
    OptunaTrials,
    TuningInputs,
    Values,
    key_of,
    optuna_module,
)
from replan.experiments.pareto_figure import pareto_figure
from replan.experiments.space import chosen_table, listed, with_values
from replan.experiments.trial import one_planner, scratch_folder, write_table
from replan.logs.mcap import write_scenario
from replan.metrics.comparison import Comparison
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.judge.gates import Outcome
from replan.metrics.resampling import MIN_SIGNIFICANT
from replan.results.tables import write_csv, write_json, write_text
from replan.results.version import replan_version
from replan.run import evaluate_logs
from replan.run.checks import checked
from replan.run.claim import FolderContents, claimed_folder
from replan.run.evaluate import Engine, Local
from replan.run.resume import Study, identity_of
from replan.run.sources import Selection

CONTENTS = FolderContents(
    KIND,
    ("tune.json", "trials.*", "pareto.*", "best.toml", "training", "held_out", "logs"),
)


@dataclass(frozen=True, eq=False)
class Logs:
    """The logs of a tuning: the place of each by name, and the names of the held-out logs."""

    places: Mapping[str, Path | str]
    identities: Mapping[str, str]
    strata: Mapping[str, str]
    held: frozenset[str]

    @property
    def training(self) -> tuple[str, ...]:
        """Names, sorted."""
        return tuple(sorted(name for name in self.places if name not in self.held))

    @property
    def held_out(self) -> tuple[str, ...]:
        """Names, sorted."""
        return tuple(sorted(self.held))

    def at(self, names: Sequence[str]) -> list[Path | str]:
        """The places of logs."""
        return [self.places[name] for name in names]


@dataclass(frozen=True, eq=False)
class Tuned:
    """The end of a tuning.

    Attributes:
        table: A row per trial.
        chosen: The row of the chosen trial; empty if none is better than the defaults.
        values: The chosen settings; empty in that case, too.
        better: The gain on the held-out logs; None in that case.
        comparison: Comparison of the chosen settings with the defaults there; None in that case.
    """

    out: Path
    plan: TuningInputs
    logs: Logs
    table: pd.DataFrame
    chosen: Mapping[str, Any]
    values: Values
    better: MeanGain | None
    comparison: Comparison | None

    @property
    def passed(self) -> bool:
        """Whether the chosen settings are better on the held-out logs, and break no rule of
        comparison.
        """
        if self.better is None or self.comparison is None:
            return False
        return self.better.holds and self.comparison.exit_code != 1

    @property
    def exit_code(self) -> int:
        """0 if the chosen settings are better, otherwise 1."""
        return 0 if self.passed else 1

    def lines(self) -> list[str]:
        """The result in sentences."""
        feasible = int(self.table["feasible"].sum())
        refused = int((self.table["refused"] != "").sum())
        tried = (
            f"{counted(len(self.table), 'trial')} on "
            f"{counted(len(self.logs.training), 'training log')}"
        )
        aside = f", {refused} refused by the configuration" if refused else ""
        lines = [f"{tried}: {feasible} feasible{aside}."]
        if self.better is None or self.comparison is None:
            lines.append(
                "FAIL: no feasible trial is better than the defaults on the training logs."
            )
            return lines
        lines.append(
            f"Chosen is trial {self.chosen['trial']}: {listed(self.plan.settings, self.values)}; "
            f"gain {float(self.chosen['total']):+.4f}."
        )
        lines.append(f"Held out: {self.better}.")
        lines += [
            f"Broken: {verdict.rule}: {verdict.reason}."
            for verdict in self.comparison.verdicts
            if verdict.outcome is Outcome.FAIL
        ]
        if self.passed:
            lines.append(
                "PASS: the chosen settings are better on the held-out logs, and no rule of "
                "comparison is broken."
            )
        elif not self.better.holds:
            lines.append("FAIL: they are not better on the held-out logs.")
        else:
            lines.append("FAIL: they break a rule of comparison on the held-out logs.")
        return lines


def tune(
    plan: TuningInputs,
    selection: Selection,
    out: Path | None,
    *,
    engine: Engine | None = None,
    resume: bool = False,
    say: Callable[[str], None] = lambda line: None,
) -> Tuned:
    """Search, judge on the held-out logs, and write the results into `out`; arguments as in
    `replan.experiments`.

    Raises:
        ConfigError: A wrong setting, too few logs, no point of the space is accepted, a folder that
            must not be written, nothing to resume, or optuna is not installed.
        LogError: A log cannot be read.
        PlannerError: The planner cannot be loaded.
    """
    one_planner(plan.run, "a tuning")
    optuna_module()
    checked(plan.driven)
    engine = engine or Local()
    with claimed_folder(out, CONTENTS, resume=resume) as folder:
        logs = _sorted_logs(selection, folder, plan.share)
        study = Study(folder, plan.head(logs.identities), resume=resume)
        for source in selection.sources:  # logs of the catalogue as files
            if source.path is None and not source.remote:
                scenario = source.read()
                file = Path(logs.places[scenario.name])
                file.parent.mkdir(exist_ok=True)
                write_scenario(file, scenario)
        return _run_search(plan, logs, study, _Driver(folder, engine, resume), say)


# logs ---------------------------------------------------------------------------------------------


def _sorted_logs(selection: Selection, out: Path, share: float) -> Logs:
    """The logs, read once for their names and strata.

    Raises:
        ConfigError: Two logs have the same name, or one of the sets has too few logs.
        LogError: A log cannot be read.
    """
    labels: dict[str, LogLabels] = {}
    places: dict[str, Path | str] = {}
    identities: dict[str, str] = {}
    for source in selection.sources:
        with source.fetched() as near:
            scenario = near.read()
        name = scenario.name
        if name in labels:
            raise ConfigError(
                f"two logs are called '{name}' ({places[name]}, {source.label}); leave one of them "
                "out"
            )
        labels[name] = LogLabels(scenario.family, scenario.dataset, scenario.tags)
        synthesised = out / "logs" / f"{sha256(name.encode()).hexdigest()[:16]}.mcap"
        places[name] = source.path or (source.label if source.remote else synthesised)
        identities[name] = identity_of(source)
    held = held_out(labels, share)
    strata = {name: stratum(label) for name, label in labels.items()}
    logs = Logs(places, identities, strata, held)
    if len(held) < MIN_SIGNIFICANT:
        raise ConfigError(
            f"--held-out {share:g} of {counted(len(labels), 'log')} holds out {len(held)}, and on "
            f"fewer than {MIN_SIGNIFICANT} no difference is more than chance: name more logs, or "
            "hold out more of them"
        )
    if not logs.training:
        raise ConfigError(
            f"--held-out {share:g} of {counted(len(labels), 'log')} leaves none to search on"
        )
    return logs


@dataclass(frozen=True)
class _Driver:
    """Drives logs into folders of a tuning."""

    out: Path
    engine: Engine
    resume: bool

    def kept(self, logs: Sequence[Path | str], run: RunConfig, folder: str) -> Results:
        """The results of a run whose files are kept.

        Logs that an interrupted tuning finished are not driven again.
        """
        results = self.out / folder
        results.parent.mkdir(parents=True, exist_ok=True)
        resume = self.resume and (results / "run.toml").is_file()
        return evaluate_logs(logs, run, results, engine=self.engine, resume=resume)

    def passing(
        self, logs: Sequence[Path | str], run: RunConfig, asked: Callable[[Results], RunScores]
    ) -> RunScores:
        """The value of `asked` for a run whose files are removed."""
        with scratch_folder(self.out, "trial") as scratch:
            return asked(evaluate_logs(logs, run, scratch, engine=self.engine))


# trials -------------------------------------------------------------------------------------------


def _run_search(
    plan: TuningInputs, logs: Logs, study: Study, driver: _Driver, say: Callable[[str], None]
) -> Tuned:
    say(
        f"{counted(len(logs.training), 'training log')}, {len(logs.held)} held out; first the "
        "defaults"
    )
    names, where = logs.training, logs.at(logs.training)
    default = run_scores(driver.kept(where, plan.driven, "training"), names, plan.objectives)
    search = OptunaTrials(plan, default)

    def scores_of(results: Results) -> RunScores:
        return run_scores(results, names, plan.objectives)

    def drive(values: Values) -> dict[str, Any]:
        """The row of a trial."""
        try:
            run = with_values(plan.driven, values)
            checked(run)
        except ConfigError as error:
            return search.row(values, str(error))
        return search.row(values, driver.passing(where, run, scores_of))

    rows: list[dict[str, Any]] = []
    for trial in range(plan.trials):
        values = search.ask()
        row = study.row(key_of(values), partial(drive, values))
        search.tell(row)
        rows.append({"trial": trial, **{name: cell for name, cell in row.items() if name != "key"}})
        feasible = [trial_row["total"] for trial_row in rows if trial_row["feasible"]]
        best = f"best gain {max(feasible):+.4f}" if feasible else "no feasible one yet"
        say(f"{trial + 1} of {counted(plan.trials, 'trial')}, {best}")
    if all(row["refused"] for row in rows):
        raise ConfigError(
            f"no trial of {len(rows)} is accepted by the configuration: {rows[0]['refused']}"
        )
    table = pd.DataFrame(rows)
    columns = [f"gain {objective.metric}" for objective in plan.objectives]
    table = table.astype({**dict.fromkeys([*columns, "total", "failed"], float), "feasible": bool})
    points = table.loc[table["feasible"], columns].to_numpy(float)
    table["pareto"] = False
    table.loc[table["feasible"], "pareto"] = [not is_dominated(point, points) for point in points]
    result = _judge_held_out(plan, logs, table, scales(default.values), driver, say)
    _write(result, default)
    return result


# the end ------------------------------------------------------------------------------------------


def _judge_held_out(
    plan: TuningInputs,
    logs: Logs,
    table: pd.DataFrame,
    scale: np.ndarray,
    driver: _Driver,
    say: Callable[[str], None],
) -> Tuned:
    """Choose, and drive the held-out logs with the chosen settings and the defaults."""
    good = table[table["feasible"] & (table["total"] > 0.0)]
    if good.empty:
        return Tuned(driver.out, plan, logs, table, {}, {}, None, None)
    chosen = {str(name): cell for name, cell in good.iloc[int(np.argmax(good["total"]))].items()}
    values: Values = {}
    for setting in plan.settings:
        cell = chosen[setting.key]
        value = cell.item() if hasattr(cell, "item") else cell
        values[setting.path] = int(value) if setting.is_whole else value
    say(f"trial {chosen['trial']} is chosen; now the held-out logs")
    where = logs.at(logs.held_out)
    default = driver.kept(where, plan.driven, "held_out/default")
    tuned = driver.kept(where, with_values(plan.driven, values), "held_out/chosen")
    default_scores = run_scores(default, logs.held_out, plan.objectives)
    tuned_scores = run_scores(tuned, logs.held_out, plan.objectives)
    gain = gains(tuned_scores.values, default_scores.values, scale, plan.objectives)
    comparison = compare_runs(default, tuned, gates=plan.run.gates_path, partings=0)
    return Tuned(driver.out, plan, logs, table, chosen, values, mean_gain(gain), comparison)


def _write(result: Tuned, default: RunScores) -> None:
    folder, plan, table = result.out, result.plan, result.table
    write_table(folder, "trials", table)
    front = table[table["pareto"]].sort_values("total", ascending=False, kind="stable")
    write_csv(folder / "pareto.csv", front)
    title = (
        f"{plan.run.planners[0]}: {counted(len(table), 'trial')} on "
        f"{counted(len(result.logs.training), 'log')}"
    )
    metrics = [objective.metric for objective in plan.objectives]
    pareto_figure(table, metrics, result.chosen, title).save(folder / "pareto.png")
    note = "the chosen settings"
    if not result.passed:
        note = "NOT better than the defaults on the held-out logs"
    best = tomli_w.dumps(chosen_table(with_values(plan.run, result.values)))
    write_text(folder / "best.toml", f"# Written by `replan tune`: {note}.\n{best}")
    chosen = None
    if result.values:
        chosen = {setting.key: result.values[setting.path] for setting in plan.settings}
    card = {
        "replan": replan_version(),
        "planner": plan.run.planners[0],
        "objectives": metrics,
        "seed": plan.seed,
        "trials": len(table),
        "training": list(result.logs.training),
        "held_out": list(result.logs.held_out),
        "strata": dict(result.logs.strata),
        "failed_by_default": default.failed,
        "chosen": chosen,
        "gain": None if result.better is None else _gain_entry(result.better),
        "said": result.lines(),
        "exit_code": result.exit_code,
    }
    write_json(folder / "tune.json", card)


def _gain_entry(gain: MeanGain) -> dict[str, Any]:
    interval = [end if isfinite(end) else None for end in (gain.low, gain.high)]
    return {"mean": gain.mean, "interval": interval, "logs": gain.logs}
