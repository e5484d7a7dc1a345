"""The changes with which failing drives are driven again, and the cause to which the passing ones
point.

The changes are rows of TOML tables; the built-in ones are in `changes.toml`.

[[change]]
name = "no_delay"                           # of its folder
words = "without delay"                     # completes "passes ..."
cause = "latency"                           # what it points to
rank = "ideal"                              # one of RANKS
default = ["loop.plan_delay_s"]             # keys that are set to their defaults
set.loop = { traffic = "time" }             # keys that are set
planner = "dp_qp"                           # only for this planner; left out: for all

(1) a change counts     the drive passes with it, and with no part of it that points to another
                        cause
(2) cause               what the changes that count point to, those of the first rank of `RANKS` in
                        which one counts; "prediction or control" where they point to several
(3) fragile             it passes with a perturbation that should change nothing
                        (`replan.run.ensemble`): then no change shows anything, and the cause is not
                        found
(4) unavoidable         with every change it fails a gate that it failed before, and the careful
                        driver of UN R157 does not avoid the contact either
(5) not found           it passes with no change, and (4) does not hold

That another planner passes is a fact, and no cause: it is no change here. What a planner acts on is
found against a run that does better (`replan.experiments.attribution`).
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from replan.config import RunConfig, dump_run
from replan.core.errors import ConfigError, PlannerError
from replan.core.files import read_toml
from replan.core.settings import flat, merged, strict
from replan.experiments.trial import QUIET, closed
from replan.results.tables import safe_name
from replan.run.checks import checked

BUILT_IN = Path(__file__).with_name("changes.toml")
NOT_FOUND, UNAVOIDABLE = "not found", "unavoidable"
RANKS = ("default", "ideal", "limits")
"""The order in which a cause is searched: settings that differ from the defaults before possible
improvements.
"""


@dataclass(frozen=True)
class TriedChange:
    """A row of the table; the keys are those of the file."""

    name: str
    words: str
    cause: str
    rank: str
    default: tuple[str, ...] = ()
    set: Mapping[str, Any] = field(default_factory=dict)
    planner: str = ""

    def __post_init__(self) -> None:
        if self.rank not in RANKS:
            raise ConfigError(
                f"change '{self.name}': rank is one of {', '.join(RANKS)}, got '{self.rank}'"
            )
        if not self.name or safe_name(self.name) != self.name:
            raise ConfigError(
                f"change '{self.name}': the name must be valid for a folder: letters, digits and _"
            )
        if not (self.default or self.set):
            raise ConfigError(f"change '{self.name}': needs default or set")

    def applied_to(self, run: dict[str, Any]) -> dict[str, Any]:
        """The table of a run with the change."""
        for key in self.default:  # the default applies to a missing key
            *parents, last = key.split(".")
            table = run
            for name in parents:
                table = table.get(name, {})
            table.pop(last, None)
        return merged(run, self.set)


@dataclass(frozen=True, eq=False)
class ChangedRun:
    """A run with a change.

    Attributes:
        keys: Keys and values in which it differs from the run.
    """

    change: TriedChange
    run: RunConfig
    keys: frozenset[tuple[str, str]]

    def is_part_of(self, other: ChangedRun) -> bool:
        """Whether the other changes all that this one does, and more."""
        return self.keys < other.keys


def load_changes(path: Path | None = None) -> tuple[TriedChange, ...]:
    """The built-in changes, and those of a file.

    Raises:
        ConfigError: The file cannot be read, a row is invalid, or two rows have the same name.
    """
    rows: list[TriedChange] = []
    for file in filter(None, (BUILT_IN, path)):
        table = read_toml(file)
        table_rows = table.get("change")
        if set(table) != {"change"} or not isinstance(table_rows, list):
            raise ConfigError(f"{file}: holds rows [[change]] and nothing else")
        try:
            rows += [strict(TriedChange, row, "change") for row in table_rows]
        except ConfigError as error:
            raise ConfigError(f"{file}: {error}") from None
    names = [row.name for row in rows]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ConfigError(f"{path}: two changes are called '{twice}'; rename yours")
    return tuple(rows)


def driven(run: RunConfig, planner: str) -> RunConfig:
    """The part of a run to drive: the closed loop of one planner, with internals for the first
    difference.
    """
    settings = {planner: run.planner.get(planner, {})}
    return closed(run, planners=(planner,), planner=settings, **{**QUIET, "internals": "summary"})


def changed_runs(
    changes: Sequence[TriedChange], run: RunConfig
) -> tuple[tuple[ChangedRun, ...], dict[str, str]]:
    """The changes that alter a run of one planner, each once, and the reasons why others cannot be
    applied.
    """
    run = checked(run)[0]
    table = dump_run(run)
    base = dict(flat(tomllib.loads(table)))
    runs: list[ChangedRun] = []
    refused: dict[str, str] = {}
    for change in changes:
        if change.planner and change.planner != run.planners[0]:
            continue
        try:
            changed = checked(strict(RunConfig, change.applied_to(tomllib.loads(table))))[0]
        except (ConfigError, PlannerError) as error:
            refused[change.name] = str(error)
            continue
        values = dict(flat(tomllib.loads(dump_run(changed))))
        differing = [key for key in {*base, *values} if base.get(key) != values.get(key)]
        keys = frozenset((key, repr(values.get(key))) for key in differing)
        if keys and all(keys != other.keys for other in runs):
            runs.append(ChangedRun(change, changed, keys))
    return tuple(runs), refused


@dataclass(frozen=True)
class FailureCause:
    """The cause of the failure of a drive.

    Attributes:
        name: "prediction", "prediction or control", "unavoidable", "not found".
        changes: Names of the changes that point to it.
        fragile: Perturbations with which the drive passes.
    """

    name: str
    changes: tuple[str, ...] = ()
    fragile: tuple[str, ...] = ()


def _is_due_to_part(run: ChangedRun, passed: Sequence[ChangedRun]) -> bool:
    """Whether a part of the change that points to another cause passes, too."""
    parts = (part.change for part in passed if part.is_part_of(run))
    return any(part.cause != run.change.cause for part in parts)


def cause_of(
    runs: Sequence[ChangedRun],
    passing: Collection[str],
    fragile: Sequence[str] = (),
    *,
    avoidable: bool = True,
) -> FailureCause:
    """The cause of a drive, from the changes that were driven, and those and the perturbations with
    which it passes.

    `avoidable`: the careful driver avoids the contact, or there is none, or the gates hold with a
    change.
    """
    if fragile:
        return FailureCause(NOT_FOUND, fragile=tuple(fragile))  # (3)
    passed = [run for run in runs if run.change.name in passing]
    counts = [run.change for run in passed if not _is_due_to_part(run, passed)]  # (1)
    for rank in RANKS:
        counting = [change for change in counts if change.rank == rank]
        if counting:
            causes = dict.fromkeys(change.cause for change in counting)
            names = tuple(change.name for change in counting)
            return FailureCause(" or ".join(causes), names)  # (2)
    return FailureCause(NOT_FOUND if avoidable else UNAVOIDABLE)  # (4), (5)
