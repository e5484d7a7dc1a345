"""The functions of `import replan`: drive and judge (`evaluate`), and compare two runs
(`compare`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

import pandas as pd

from replan.compare_runs import Run, compare_runs, read_run
from replan.config import Internals, RunConfig, RunMode, load_run
from replan.core.errors import ConfigError
from replan.core.settings import converted, dotted, known_keys
from replan.draw.drawn_results import Results
from replan.draw.report.overview import Overview, overview
from replan.draw.report.write import write_reports
from replan.logs.scenario import Scenario
from replan.metrics.comparison import Comparison
from replan.run import evaluate_logs
from replan.run.evaluate import Engine
from replan.run.output import held
from replan.run.shards import Shard

if TYPE_CHECKING:
    from replan.planners.base import Planner


def evaluate(
    logs: Path | str | Scenario | Sequence[Path | str | Scenario] = (),
    *,
    planners: str | type[Planner] | Sequence[str | type[Planner]] | None = None,
    out: Path | str | None = None,
    mode: RunMode | None = None,
    gates: Path | str | None = None,
    metrics: Sequence[str] | None = None,
    charts: Sequence[str] | None = None,
    recording: bool | None = None,
    foxglove: bool | None = None,
    internals: Internals | None = None,
    ensemble: int | None = None,
    config: RunConfig | Path | str | None = None,
    suite: str | None = None,
    window: float | None = None,
    every: float | None = None,
    workers: int = 0,
    engine: Engine | None = None,
    resume: bool = False,
    shard: str | None = None,
    loop: dict[str, Any] | None = None,
    log: dict[str, Any] | None = None,
    baseline: Results | Path | str | None = None,
    report: bool = True,
) -> Results:
    """Drive planners over logs, measure, judge by gates, and write everything into one folder, as
    `replan evaluate`.

    An argument that is left out is as in `config`, else the default of `replan.config.RunConfig`.

    Args:
        logs: Files and folders of any format, and scenarios in memory, of which the results keep
            a copy; none: the built-in suite.
        planners: Names, "module:Class", "exec:COMMAND", or classes that can be imported.
        out: Result folder: new, empty, or results of an earlier run, which are replaced; None:
            `results/run-NNN`.
        mode: "open", "closed" or "both".
        gates: A TOML file of thresholds.
        metrics: "module:NAME" of metrics of your own.
        charts: "module:NAME" of charts of your own.
        recording: Whether .rrd files are written.
        foxglove: Whether logs and traces get channels for Foxglove.
        internals: How much of a planner's internals is kept: "none", "summary", "full".
        ensemble: How many times each log is driven again in a world that should not change the
            verdict.
        config: All settings of a run, or a TOML file of them.
        suite: Instead of logs: a suite of the catalogue, or a family or group of it.
        window: Split each log into windows of this length, s.
        every: Time between the begins of two windows, s; None: `window`.
        workers: Child processes; 0 evaluates in this one. Results do not depend on it. With any, a
            script needs `if __name__ == "__main__":`.
        engine: Where logs are driven, instead of `workers` (`replan.run.on_ray.OnRay`).
        resume: Continue the interrupted run in `out`.
        shard: "I/N": drive every N-th log, from the I-th; `replan merge` judges all shards.
        loop: Keys of [loop] (`replan.replay.loop_config.LoopConfig`): {"controller": "mpc",
            "plan_period_s": 0.2}.
        log: Keys of [log] (`replan.logs.log_settings.LogSettings`): {"ego": "17", "begin": 2.0}.
        baseline: Results, their folder, or a file of `replan baseline`: the reports compare this
            run with it.
        report: Whether report.html, report.md and junit.xml are written.

    Raises:
        ConfigError: No logs, a wrong name or setting; nothing was run.
        PlannerError: None of the planners can be loaded.
        OutputError: The disk is full.
    """
    run = load_run(Path(config)) if isinstance(config, (str, Path)) else config or RunConfig()
    if isinstance(planners, str | type) or not isinstance(planners, Iterable | None):
        planners = [planners]
    changes = {
        "planners": None if planners is None else tuple(map(named, planners)),
        "mode": mode,
        "gates": None if gates is None else str(gates),
        "metrics": None if metrics is None else tuple(metrics),
        "charts": None if charts is None else tuple(charts),
        "recording": recording,
        "foxglove": foxglove,
        "internals": internals,
        "ensemble": ensemble,
        "loop": None if loop is None else _over(run.loop, loop, "loop"),
        "log": None if log is None else _over(run.log, log, "log"),
    }
    run = _over(run, {key: value for key, value in changes.items() if value is not None})
    before = None if baseline is None else _run(baseline)
    results = evaluate_logs(
        _listed(logs),
        run,
        out,
        workers=workers,
        engine=engine,
        resume=resume,
        window=window,
        every=every,
        suite=suite,
        shard=None if shard is None else Shard.parsed(shard),
    )
    if report:
        finished(results, before, run.gates_path)
    return results


def finished(
    results: Results, before: Run | None = None, gates: Path | None = None, *, report: bool = True
) -> Overview:
    """The overview of a run that has ended, with its comparison; `report` also writes its reports
    into its folder.
    """
    with held(results.path):
        comparison = None if before is None else compare_runs(before, results, gates=gates)
        over = overview(results, comparison)
        return write_reports(over, results.path) if report else over


def compare(
    baseline: Results | Path | str,
    candidate: Results | Path | str,
    *,
    planners: Sequence[str] = (),
    gates: Path | str | None = None,
) -> Comparison:
    """Compare two runs per log and metric, as `replan compare`.

    Args:
        baseline: Results, their folder, or a file of `replan baseline`.
        candidate: Likewise.
        planners: One: only this planner of both. Two: the first of the baseline with the second of
            the candidate.
        gates: A TOML file of thresholds and rules of comparison; None: the packaged ones.

    Raises:
        ConfigError: The results do not exist, or do not contain the planner.
        LogError: The results are damaged.
    """
    return compare_runs(
        _run(baseline),
        _run(candidate),
        tuple(planners),
        gates=None if gates is None else Path(gates),
    )


def _listed(logs: Any) -> list[Path | str | Scenario]:
    """One log or several as a list; ConfigError for anything else."""
    is_one = isinstance(logs, str | Path | Scenario | pd.DataFrame) or not isinstance(
        logs, Iterable
    )
    several = [logs] if is_one else list(logs)
    for log in several:
        if not isinstance(log, str | Path | Scenario):
            problem = f"a log is a path, a URL or a Scenario, not a {type(log).__name__}"
            raise ConfigError(f"{problem}; replan.from_frames makes a Scenario of tables")
    return several


def _run(of: Results | Path | str) -> Run:
    return of if isinstance(of, Results) else read_run(of)


def named(planner: object) -> str:
    """Return the name by which a worker finds a planner; for a class, "module:Class".

    Raises:
        ConfigError: It is an object of a class; or the class is defined in a script or a notebook,
            which a worker cannot import.
    """
    if isinstance(planner, str):
        return planner
    kind: Any = planner if hasattr(planner, "__qualname__") else type(planner)
    if kind.__module__ == "__main__" or "<locals>" in kind.__qualname__:
        raise ConfigError(
            f"planner {kind.__qualname__}: put it into a file of its own, which its process can "
            "import"
        )
    name = f"{kind.__module__}:{kind.__qualname__}"
    if kind is not planner:
        raise ConfigError(
            f"planner {kind.__qualname__}: is an object, and each drive builds a planner of its "
            f'own: pass the class, planners=[{kind.__qualname__}], or its name, "{name}"; its '
            f'keywords are the table [planner."{name}"] of `config`'
        )
    return name


def _over(config: Any, changes: dict[str, Any], where: str = "") -> Any:
    """Return a configuration with keys replaced; ConfigError if a key is unknown, or a value has
    the wrong type.
    """
    known_keys(changes, [item.name for item in fields(config)], where)
    kinds = get_type_hints(type(config))
    return replace(
        config,
        **{key: converted(value, kinds[key], dotted(where, key)) for key, value in changes.items()},
    )
