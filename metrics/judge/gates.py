"""Gates (thresholds on the table) and rules of comparison, from a TOML file; docs/gates.md explains
all keys.

The file contains tables [[gate]], whose keys are the attributes of `Gate` (judged by `verdicts`).
It may contain tables [[compare]] with the attributes of `GateRule`: how much worse than a baseline
a candidate may be (`replan.metrics.comparison`).
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import Enum
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from replan.core.errors import ConfigError
from replan.core.files import read_toml
from replan.logs.observed import ENOUGH
from replan.logs.trace import Mode
from replan.metrics import METRICS, Metric
from replan.metrics.judge.aggregate import LogLabels

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


class Outcome(Enum):
    """The outcome of a gate, most important first: of several outcomes, the first one applies."""

    FAIL = "fail"
    INCONCLUSIVE = "inconclusive"
    PASS = "pass"
    NOT_ASKED = "not asked"


R = TypeVar("R", bound="DataclassInstance")
EVIDENCE = ("traffic", "lights", "limit", "lane")  # The parts of the metric `evidence`
OVER = ("worst", "mean", "median", "sum", "pass_share")
RULE_OVER = ("mean", "median", "worst")
# A rule has exactly one of these
RULE_KINDS = ("max_increase", "max_decrease", "max_flips", "max_missing")


@dataclass(frozen=True, slots=True)
class Gate:
    """One threshold.

    Attributes:
        metric: A name of the table's column `metric`.
        min: Least allowed value; `max` is the greatest. Bounds are inclusive; a gate has one or
            both.
        mode: "open" or "closed"; None: each mode that has the metric.
        tags: Only logs that have all of these; `families`, `datasets`: one of these.
        planner: None: every planner, oracles excepted.
        over: What must be within the bounds: every log ("worst"), a statistic of the logs ("mean",
            "median", "sum"), or a share of the logs ("pass_share"): at least `min_share`; with
            `confident`, also the lower end of its 95 % interval.
        per: A verdict for each "family", "tag" or "dataset" by itself.
        min_logs: How many logs must be judged; `max_missing`: the share of the logs that may be
            without evidence.
        optional: Logs without the value are NOT ASKED.
        reachable: A broken bound is inconclusive if no yardstick stays within it (`excuses`).
        evidence: Kind of evidence (`EVIDENCE`) that a pass needs over at least `min_evidence` of
            the driven time.
        broken: What a broken bound means, "fail" or "inconclusive"; `reason` is shown with it.
    """

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
    max_missing: float = 0.1
    reachable: bool = False
    evidence: str | None = None
    min_evidence: float = ENOUGH
    broken: str = Outcome.FAIL.value
    min_share: float | None = None
    confident: bool = False
    families: tuple[str, ...] = ()
    datasets: tuple[str, ...] = ()
    per: str | None = None

    def __post_init__(self) -> None:
        bounds = [bound for bound in (self.min, self.max) if bound is not None]
        shared, missing = self.over == "pass_share", self.max_missing
        share = 1.0 if self.min_share is None else self.min_share
        rules = {
            "has neither min nor max": bool(bounds),
            f"min {' is above max '.join(f'{b:g}' for b in bounds)}": not (
                len(bounds) == 2 and bounds[0] > bounds[1]
            ),
            "a bound is not finite": all(map(isfinite, bounds)),
            f'mode is {self.mode!r}, not "open" or "closed"': self.mode
            in (None, *(mode.value for mode in Mode)),
            f"over is {self.over!r}, not one of {', '.join(OVER)}": self.over in OVER,
            (
                'over = "pass_share" needs min_share; min_share and confident need over = '
                '"pass_share"'
            ): shared is (self.min_share is not None) and (shared or not self.confident),
            f"min_share is {share:g}, not a share above 0": 0.0 < share <= 1.0,
            "confident: no number of logs makes a share of 1 sure": not self.confident
            or share < 1.0,
            f'per is {self.per!r}, not "family", "tag" or "dataset"': self.per
            in (None, "family", "tag", "dataset"),
            "min_logs is below 1: a gate with nothing to judge is no pass": self.min_logs >= 1,
            f"max_missing is {missing:g}, not a share of at least 0 and below 1": 0.0
            <= missing
            < 1.0,
            f"evidence is {self.evidence!r}, not one of {', '.join(EVIDENCE)}": self.evidence
            in (None, *EVIDENCE),
            f"min_evidence is {self.min_evidence:g}, not a share": 0.0 <= self.min_evidence <= 1.0,
            f'broken is {self.broken!r}, not "fail" or "inconclusive"': self.broken
            in ("fail", "inconclusive"),
        }
        for complaint, holds in rules.items():
            if not holds:
                raise ValueError(complaint)

    def __str__(self) -> str:
        """The rule: "gap.min >= 0.5 [closed] [pedestrian]"."""
        share = ""
        if self.min_share is not None:
            share = (
                f" in {100.0 * self.min_share:g} % of logs{', surely' if self.confident else ''}"
            )
        kinds = (
            *(f"family {word}" for word in self.families),
            *(f"dataset {word}" for word in self.datasets),
        )
        per_group = f"per {self.per}" if self.per else ""
        scope = "".join(
            f" [{word}]"
            for word in (self.mode, *self.tags, *kinds, self.planner, per_group)
            if word
        )
        return f"{self.bound}{share}{scope}"

    @property
    def judged(self) -> str:
        """The value that must be within the bounds: "gap.min", "mean gap.min"."""
        return self.metric if self.over in ("worst", "pass_share") else f"{self.over} {self.metric}"

    @property
    def bound(self) -> str:
        """The bounds: "gap.min >= 0.5"."""
        low = f"{self.min:g} <= " if self.min is not None and self.max is not None else ""
        high = f" <= {self.max:g}" if self.max is not None else f" >= {self.min:g}"
        return f"{low}{self.judged}{high}"

    def selects(self, labels: LogLabels) -> bool:
        """Return whether the gate applies to a log with these labels."""
        named = (not self.families or labels.family in self.families) and set(self.tags) <= set(
            labels.tags
        )
        return named and (not self.datasets or labels.dataset in self.datasets)

    def margin(self, value: float) -> float:
        """Return how far a value is inside the bounds; negative outside."""
        low = inf if self.min is None else value - self.min
        high = inf if self.max is None else self.max - value
        return min(low, high)


@dataclass(frozen=True, slots=True)
class Gates:
    """The gates of a run and their source."""

    gates: tuple[Gate, ...]
    source: str

    def asked_of(self, modes: Iterable[str]) -> Gates:
        """Return the gates for one of these modes, or for all modes."""
        wanted = set(modes)
        return replace(
            self, gates=tuple(gate for gate in self.gates if not gate.mode or gate.mode in wanted)
        )


@dataclass(frozen=True)
class GateRule:
    """One rule: exactly one of `RULE_KINDS`.

    Attributes:
        metric: A name of the table's column `metric`, which may not rise by more than
            `max_increase` or fall by more than `max_decrease`, in its unit; over the logs its
            "mean" or "median", or no log ("worst").
        significant: The rule is broken only if the interval of the mean change excludes 0.
        max_flips: The number of gates that may change from PASS or NOT ASKED to FAIL; `gate`: only
            gates on this metric.
        max_missing: The number of drives of the baseline that may be missing in the candidate.
        mode: Only this mode; `planner`, `tags` likewise.
        optional: There is no verdict if no log has the metric; otherwise the verdict is
            INCONCLUSIVE then.
        reason: Shown with the verdict.
    """

    metric: str = ""
    max_increase: float | None = None
    max_decrease: float | None = None
    over: str = "mean"
    significant: bool = False
    max_flips: int | None = None
    gate: str = ""
    max_missing: int | None = None
    mode: str | None = None
    planner: str | None = None
    tags: tuple[str, ...] = ()
    optional: bool = False
    reason: str = ""

    def __post_init__(self) -> None:
        kinds = [kind for kind in RULE_KINDS if getattr(self, kind) is not None]
        if len(kinds) != 1:
            raise ValueError(
                f"needs one of {', '.join(RULE_KINDS)}, has {' and '.join(kinds) or 'none'}"
            )
        scoped, kind = self.mode or self.planner or self.tags, kinds[0]
        rules = {
            f"{kind} is {self.limit:g}, not a number of at least 0": isfinite(self.limit)
            and self.limit >= 0.0,
            f"{kind} {'has no' if self.metric else 'needs a'} metric": bool(self.metric)
            == (kind in RULE_KINDS[:2]),
            "gate goes with max_flips": not self.gate or self.max_flips is not None,
            "max_missing counts all drives: no mode, planner or tags": self.max_missing is None
            or not scoped,
            f"over is {self.over!r}, not one of {', '.join(RULE_OVER)}": self.over in RULE_OVER,
            'significant goes with over = "mean"': not self.significant or self.over == "mean",
            f'mode is {self.mode!r}, not "open" or "closed"': self.mode
            in (None, *(mode.value for mode in Mode)),
        }
        for complaint, holds in rules.items():
            if not holds:
                raise ValueError(complaint)

    @property
    def limit(self) -> float:
        """The number that must not be exceeded."""
        return float(
            next(value for kind in RULE_KINDS if (value := getattr(self, kind)) is not None)
        )

    @property
    def sign(self) -> float:
        """1 where the metric may not rise, -1 where it may not fall."""
        return 1.0 if self.max_increase is not None else -1.0

    def __str__(self) -> str:
        """The rule: "mean ade.3s.mean rises by at most 0.05, where significant [open]"."""
        scope = "".join(f" [{word}]" for word in (self.mode, *self.tags, self.planner) if word)
        if self.max_missing is not None:
            return f"at most {self.max_missing} drives missing"
        if self.max_flips is not None:
            return (
                f"at most {self.max_flips} flips to "
                f"FAIL{f' of {self.gate}' if self.gate else ''}{scope}"
            )
        word = "rises" if self.sign > 0.0 else "falls"
        sure = ", where significant" if self.significant else ""
        return f"{self.over} {self.metric} {word} by at most {self.limit:g}{sure}{scope}"


PACKAGED: Mapping[str, Path | None] = {
    "default": None,
    "safety": Path(__file__).with_name("safety_gates.toml"),
}
"""The packaged sets of gates by name, and their files; None: as `load_gates`."""


def load_gates(path: Path | None, *, metrics: Mapping[str, Metric] = METRICS) -> Gates:
    """Load the gates of a TOML file; None: the packaged default.

    ConfigError if the file cannot be read, a key or metric is unknown, or bounds are missing or
    contradictory; it names file and gate.
    """
    source, gates = _read_tables(path, "gate", Gate, metrics)
    if not gates:
        raise ConfigError(f"{source}: holds no [[gate]]")
    return Gates(gates, source)


def load_rules(
    path: Path | None, *, metrics: Mapping[str, Metric] = METRICS
) -> tuple[GateRule, ...]:
    """Load the rules of a TOML file; the packaged rules if it has none, or for None.

    ConfigError if the file cannot be read, a key or metric is unknown, or a rule is contradictory;
    names file and rule.
    """
    return (
        _read_tables(path, "compare", GateRule, metrics)[1]
        or _read_tables(None, "compare", GateRule, metrics)[1]
    )


def _read_tables(
    path: Path | None, kind: str, rule: type[R], metrics: Mapping[str, Metric]
) -> tuple[str, tuple[R, ...]]:
    """Return the name of a file of gates (None: the packaged one), and its tables [[gate]] or
    [[compare]] as objects.

    ConfigError if the file cannot be read, has other tables, or a table has an invalid key, value
    or metric.
    """
    source = "default gates" if path is None else str(path)
    content = read_toml(Path(__file__).with_name("default_gates.toml") if path is None else path)
    _check_keys(content, ("gate", "compare"), source)
    tables = content.get(kind, [])
    if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
        raise ConfigError(f"{source}: holds no [[{kind}]]: {kind} is no list of tables")
    rows = [row for metric in metrics.values() for row in metric.rows]
    loaded = []
    for i, table in enumerate(tables, 1):
        names = [table[key] for key in ("metric", "gate") if isinstance(table.get(key), str)]
        place = f"{source}: {kind} {i}" + "".join(f" ({name})" for name in names)
        _check_keys(table, tuple(field.name for field in fields(rule)), place)
        for name in names:
            words = name.split(".")
            # "qp_iterations.*.max" matches all words of its middle part
            open_part = len(words) == 3 and f"{words[0]}.*.{words[2]}" in rows
            if name not in rows and not open_part:
                raise ConfigError(f"{place}: no metric has this name{meant(name, rows)}")
        try:
            loaded.append(msgspec.convert(table, rule))
        except msgspec.ValidationError as error:
            raise ConfigError(f"{place}: {error}") from None
    return source, tuple(loaded)


def _check_keys(table: Mapping[str, Any], keys: Sequence[str], place: str) -> None:
    for key in table:
        if key not in keys:
            raise ConfigError(
                f"{place}: unknown key {key!r}{meant(key, keys)}; known: {', '.join(keys)}"
            )


def unit_of(unit: str) -> str:
    """Return a unit as suffix of its number; empty for ratios and counts."""
    return "" if unit in ("1", "count") else f" {unit}"


def count_logs(count: int) -> str:
    """Return the text "1 log", "2 logs"."""
    return "1 log" if count == 1 else f"{count} logs"


def meant(word: str, known: Sequence[str], *, cutoff: float = 0.4) -> str:
    """Return ", did you mean '...'?" for a word that is similar to a known one; else ""."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=cutoff)
    return f", did you mean {close[0]!r}?" if close else ""
