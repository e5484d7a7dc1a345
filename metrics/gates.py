"""Gates: thresholds on the table, and their verdicts.

    [[gate]]
    metric = "gap_vulnerable.min"       # a name of the table's column `metric`
    min = 0.5                           # min, max or both, inclusive
    mode = "closed"                     # optional: "open" or "closed"; without it, each mode that has the metric
    tags = ["pedestrian"]               # optional: only logs that have all of these
    planner = "dp_qp"                   # optional; without it every planner, oracles excepted
    over = "worst"                      # "worst": every log must hold it (default); "mean": the mean over the logs
    min_logs = 1                        # how many logs must have the value
    optional = true                     # not asked where no log has the value (it needs lights, say); default: false
    reason = "why this threshold"       # shown with the verdict

A verdict per gate, planner and mode: FAIL where the threshold is broken; else INCONCLUSIVE where a log could not be
evaluated or fewer than `min_logs` logs have a value (nothing to judge is not a pass); else PASS. Logs in which the
metric is unavailable are counted in the reason. An optional gate has no verdict where no log has the value.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import Enum
from importlib import resources
from math import inf, isfinite, nan
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from logs.errors import ConfigError
from logs.trace import Mode
from metrics import METRICS, Metric

_NOTHING: Mapping[str, str] = MappingProxyType({})


class Outcome(Enum):
    """What a gate says."""

    PASS = "pass"
    FAIL = "fail"
    INCONCLUSIVE = "inconclusive"


@dataclass(frozen=True, slots=True)
class Gate:
    """One threshold (module docstring)."""

    metric: str
    min: float | None = None
    max: float | None = None
    mode: str | None = None
    tags: tuple[str, ...] = ()
    planner: str | None = None
    over: str = "worst"
    min_logs: int = 1
    reason: str = ""
    optional: bool = False

    def __post_init__(self) -> None:
        if self.min is None and self.max is None:
            raise ValueError("has neither min nor max")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"min {self.min:g} is above max {self.max:g}")
        if not all(isfinite(bound) for bound in (self.min, self.max) if bound is not None):
            raise ValueError("a bound is not finite")
        if self.mode not in (None, *(mode.value for mode in Mode)):
            raise ValueError(f'mode is {self.mode!r}, not "open" or "closed"')
        if self.over not in ("worst", "mean"):
            raise ValueError(f'over is {self.over!r}, not "worst" or "mean"')
        if self.min_logs < 1:
            raise ValueError("min_logs is below 1: a gate with nothing to judge is no pass")

    def __str__(self) -> str:
        """The rule: "gap.min >= 0.5 [closed] [pedestrian]"."""
        low = f"{self.min:g} <= " if self.min is not None and self.max is not None else ""
        high = f" <= {self.max:g}" if self.max is not None else f" >= {self.min:g}"
        scope = "".join(f" [{word}]" for word in (self.mode, *self.tags, self.planner) if word)
        return f"{low}{'mean ' if self.over == 'mean' else ''}{self.metric}{high}{scope}"

    def margin(self, value: float) -> float:
        """How far a value is inside the bounds; negative outside."""
        low = inf if self.min is None else value - self.min
        high = inf if self.max is None else self.max - value
        return min(low, high)


@dataclass(frozen=True, slots=True)
class Gates:
    """The gates of a run and where they come from."""

    gates: tuple[Gate, ...]
    source: str

    def asked_of(self, modes: Iterable[str]) -> Gates:
        """The gates that name one of these modes or none."""
        wanted = set(modes)
        return replace(self, gates=tuple(gate for gate in self.gates if not gate.mode or gate.mode in wanted))


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a gate says of one planner in one mode, and why.

    Attributes:
        gate: The rule.
        outcome: Pass, fail or inconclusive.
        reason: One sentence that names planner, worst log, value and time.
        planner: "" where no planner was to be judged; `mode` likewise.
        value: The judged value (the mean with `over = "mean"`, else the worst log's); NaN where there is none.
        log: The worst log; "" where there is none.
        time_s: When its value occurred; NaN where it has no time.
    """

    gate: Gate
    outcome: Outcome
    reason: str
    planner: str = ""
    mode: str = ""
    value: float = nan
    log: str = ""
    time_s: float = nan


def load_gates(path: Path | None, *, metrics: Mapping[str, Metric] = METRICS) -> Gates:
    """The gates of a TOML file; None: the packaged default.

    Raises:
        ConfigError: Not readable, unknown key or metric, no or senseless bounds; names the file and the gate.
    """
    source = "default gates" if path is None else str(path)
    try:
        text = (
            resources.files("metrics").joinpath("default_gates.toml").read_text() if path is None else path.read_text()
        )
        content = tomllib.loads(text)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{source}: cannot read gates: {error}") from error
    _known(content, ("gate",), source)
    tables = content.get("gate")
    if not isinstance(tables, list) or not tables or not all(isinstance(table, dict) for table in tables):
        raise ConfigError(f"{source}: holds no [[gate]]")
    return Gates(tuple(_gate(table, f"{source}: gate {i}", metrics) for i, table in enumerate(tables, 1)), source)


_TYPES: Mapping[str, tuple[type, ...]] = MappingProxyType(
    {
        "metric": (str,), "min": (int, float), "max": (int, float), "mode": (str,), "tags": (list,), "planner": (str,),
        "over": (str,), "min_logs": (int,), "reason": (str,), "optional": (bool,),
    }
)  # fmt: skip


def _gate(table: Mapping[str, Any], place: str, metrics: Mapping[str, Metric]) -> Gate:
    name = table.get("metric")
    if not isinstance(name, str):
        raise ConfigError(f'{place}: needs metric = "name.reduction"')
    place = f"{place} ({name})"
    _known(table, tuple(field.name for field in fields(Gate)), place)
    for key, value in table.items():
        if not isinstance(value, _TYPES[key]) or (isinstance(value, bool) and bool not in _TYPES[key]):
            raise ConfigError(f"{place}: {key} = {value!r} must be {_TYPES[key][-1].__name__}")
    if not all(isinstance(tag, str) for tag in table.get("tags", [])):
        raise ConfigError(f"{place}: tags must be words")
    _check_metric(name, place, metrics)
    try:
        return Gate(**{**table, "tags": tuple(table.get("tags", ()))})
    except ValueError as error:
        raise ConfigError(f"{place}: {error}") from error


def _known(table: Mapping[str, Any], keys: Sequence[str], place: str) -> None:
    for key in table:
        if key not in keys:
            raise ConfigError(f"{place}: unknown key {key!r}{_meant(key, keys)}; known: {', '.join(keys)}")


def _check_metric(name: str, place: str, metrics: Mapping[str, Metric]) -> None:
    """Raise unless the table can hold a row of this name; of open parts ("qp_iterations.*.max") any word will do."""
    names = [
        ".".join(filter(None, (metric.name, part, reduction.name)))
        for metric in metrics.values()
        for part in metric.parts or ("",)
        for reduction in metric.reductions
    ]
    words = name.split(".")
    if name not in names and not (len(words) == 3 and f"{words[0]}.*.{words[2]}" in names):
        raise ConfigError(f"{place}: no metric has this name{_meant(name, names)}")


def _meant(word: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.4)
    return f", did you mean {close[0]!r}?" if close else ""


def judge(
    gates: Gates,
    table: pd.DataFrame,
    tags: Mapping[str, tuple[str, ...]],
    *,
    failed: Mapping[str, str] = _NOTHING,
) -> tuple[Verdict, ...]:
    """The verdicts on a table of `evaluate` rows, in the order of the gates.

    Args:
        gates: The rules.
        table: The rows of all logs, planners and modes.
        tags: Tags by log: all logs of the run, so that one without rows is missed.
        failed: Logs that could not be evaluated, and why.
    """
    return tuple(
        verdict
        for gate in gates.gates
        for verdict in _judge(gate, table, tags, failed)
        if not gate.optional or isfinite(verdict.value)
    )


def _judge(
    gate: Gate, table: pd.DataFrame, tags: Mapping[str, tuple[str, ...]], failed: Mapping[str, str]
) -> list[Verdict]:
    logs = [log for log in dict.fromkeys([*tags, *table["log"], *failed]) if _tagged(log, gate, tags, failed)]
    lost = "".join(f"; {log} could not be evaluated: {failed[log]}" for log in logs if log in failed)
    if not logs:
        return [Verdict(gate, Outcome.INCONCLUSIVE, f"nothing to judge: no log has the tags {', '.join(gate.tags)}")]
    rows = table[_judged_planner(gate, table)]
    if gate.mode is not None:
        rows = rows[rows["mode"] == gate.mode]
    modes = rows.loc[rows["metric"] == gate.metric, "mode"].unique()
    pairs = rows.loc[rows["mode"].isin(modes), ["planner", "mode"]].drop_duplicates()
    if pairs.empty:
        return [Verdict(gate, Outcome.INCONCLUSIVE, f"nothing to judge: {_nothing(gate)} in this run{lost}")]
    return [
        _verdict(gate, planner, mode, rows[(rows["planner"] == planner) & (rows["mode"] == mode)], logs, failed)
        for planner, mode in pairs.itertuples(index=False)
    ]


def _tagged(log: str, gate: Gate, tags: Mapping[str, tuple[str, ...]], failed: Mapping[str, str]) -> bool:
    """Whether the gate asks for a log; one that failed before its tags were known may be asked for."""
    return set(gate.tags) <= set(tags.get(log, ())) or (log in failed and log not in tags)


def _judged_planner(gate: Gate, table: pd.DataFrame) -> pd.Series[bool]:
    return ~table["oracle"].astype(bool) if gate.planner is None else table["planner"] == gate.planner


def _nothing(gate: Gate) -> str:
    planner = f"planner {gate.planner}" if gate.planner else "a planner that is no oracle"
    return f"{gate.metric} was not measured for {planner}{f' in {gate.mode} loop' if gate.mode else ''}"


def _verdict(
    gate: Gate, planner: str, mode: str, rows: pd.DataFrame, logs: Sequence[str], failed: Mapping[str, str]
) -> Verdict:
    """`rows` are all of one planner and mode."""
    ran = set(rows["log"])
    missing = {log: failed.get(log, "no result") for log in logs if log in failed or log not in ran}
    mine = rows[(rows["metric"] == gate.metric) & rows["log"].isin(logs)]
    found = mine[mine["available"].astype(bool)]
    without = mine[~mine["available"].astype(bool)]
    who, count = f"{planner}, {mode} loop", len(ran.intersection(logs))
    aside = _aside(count - len(found), count, without, missing)
    if found.empty:
        return Verdict(gate, Outcome.INCONCLUSIVE, f"{who}: nothing to judge{aside}", planner, mode)
    margins = found["value"].map(gate.margin)
    worst = found.iloc[int(np.argmin(margins.to_numpy()))]
    value = float(found["value"].mean()) if gate.over == "mean" else float(worst["value"])
    outcome = _outcome(gate, value, len(found), missing)
    short = f"; {_logs(len(found))} with a value, {gate.min_logs} must have one" if len(found) < gate.min_logs else ""
    broken = int((margins < 0.0).sum())
    share = f"; broken in {broken} of {_logs(len(found))}" if gate.over == "worst" and broken else ""
    reason = f"{who}: {_found(gate, value, worst)}{share}{short}{aside}"
    return Verdict(gate, outcome, reason, planner, mode, value, str(worst["log"]), float(worst["time_s"]))


def _outcome(gate: Gate, value: float, count: int, missing: Mapping[str, str]) -> Outcome:
    if gate.margin(value) < 0.0:
        return Outcome.FAIL
    return Outcome.INCONCLUSIVE if missing or count < gate.min_logs else Outcome.PASS


def _found(gate: Gate, value: float, worst: pd.Series[Any]) -> str:
    """What was found: "gap.min = 0.31 m, below 0.5, on log X at 3.20 s (car 12)"."""
    unit = "" if worst["unit"] in ("1", "count") else f" {worst['unit']}"
    if gate.min is not None and value < gate.min:
        bound = f", below {gate.min:g},"
    elif gate.max is not None and value > gate.max:
        bound = f", above {gate.max:g},"
    else:
        bound = ", within bounds,"
    where = f"worst {worst['value']:.4g}{unit} on {worst['log']}" if gate.over == "mean" else f"on {worst['log']}"
    when = f" at {worst['time_s']:.2f} s" if isfinite(worst["time_s"]) else ""
    about = f" ({worst['reason']})" if worst["reason"] else ""
    mean = "mean " if gate.over == "mean" else ""
    return f"{mean}{gate.metric} = {value:.4g}{unit}{bound} {where}{when}{about}"


def _logs(count: int) -> str:
    return "1 log" if count == 1 else f"{count} logs"


def _aside(lacking: int, count: int, without: pd.DataFrame, missing: Mapping[str, str]) -> str:
    """What could not be judged: logs without a value (with the commonest reason), logs without a result."""
    out = ""
    if lacking:
        reasons = without["reason"].value_counts()
        out = f"; not available in {lacking} of {_logs(count)}" + (f" ({reasons.index[0]})" if len(reasons) else "")
    if missing:
        log, why = next(iter(missing.items()))
        out += f"; {_logs(len(missing))} could not be evaluated ({log}: {why})"
    return out
