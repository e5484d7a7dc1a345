"""A TOML file of settings to search: keys as in a run's TOML file, each with its range.

    planner.dp_qp.speed.w_jerk = { low = 0.1, high = 10.0, log = true }
    planner.dp_qp.lane.dwell_s = { low = 1.0, high = 5.0, step = 0.5 }
    planner.dp_qp.solver = { choices = ["piqp", "osqp"] }

A setting whose default is a whole number takes whole numbers. All settings are checked before
anything is driven: the configured object must accept each end of each range, with all other
settings at their defaults.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any

from replan.config import RunConfig, dump_run
from replan.core.errors import ConfigError, unknown_name
from replan.core.files import read_toml
from replan.core.settings import dotted, merged, strict
from replan.metrics.judge.gates import PACKAGED
from replan.run.checks import checked

KEYS = ("low", "high", "log", "step", "choices")
Value = float | int | str | bool


@dataclass(frozen=True)
class Setting:
    """One setting that is searched.

    Attributes:
        path: Its key, part by part.
        default: Its value without the search.
        low: Least value; `high` the greatest; both None with choices.
        high: The greatest value.
        log: Whether the search is along the logarithm.
        step: Interval of the values low, low + step, ...; None: all values between.
        choices: The values, if there is no range.
    """

    path: tuple[str, ...]
    default: Value
    low: float | None = None
    high: float | None = None
    log: bool = False
    step: float | None = None
    choices: tuple[Value, ...] = ()

    def __post_init__(self) -> None:
        numbers = [value for value in (self.low, self.high, self.step) if value is not None]
        ends = len(numbers) - (self.step is not None)
        finite = [_is_number(value) and isfinite(value) for value in numbers]
        self._hold(
            {
                "needs low and high, or choices": bool(self.choices) != (ends == 2) and ends != 1,
                f"is no number ({self.default!r}): give choices": bool(self.choices)
                or _is_number(self.default),
                "low, high and step must be finite numbers": all(finite),
            }
        )
        if self.choices:
            different = len(set(self.choices)) == len(self.choices) > 1
            plain = not self.log and self.step is None
            self._hold(
                {
                    "choices: give at least two, all different": different,
                    "choices go without log and step": plain,
                }
            )
            return
        assert self.low is not None and self.high is not None
        self._hold(
            {
                f"low ({self.low:g}) must be below high ({self.high:g})": self.low < self.high,
                f"log needs a positive low, got {self.low:g}": not self.log or self.low > 0.0,
                "log and step do not go together": not self.log or self.step is None,
                "step must be positive and at most high - low": self.step is None
                or 0.0 < self.step <= self.high - self.low,
                (
                    f"its default is the whole number {self.default!r}: low, high and step must be "
                    "whole, too"
                ): not self.is_whole or all(float(value).is_integer() for value in numbers),
            }
        )

    def _hold(self, rules: Mapping[str, bool]) -> None:
        """Raise ConfigError with the text of the first rule that is False."""
        for complaint, holds in rules.items():
            if not holds:
                raise ConfigError(f"{self.key}: {complaint}")

    @property
    def key(self) -> str:
        """The key as in TOML: "planner.dp_qp.speed.w_jerk"."""
        key = ""
        for part in self.path:
            key = dotted(key, part)
        return key

    @property
    def is_whole(self) -> bool:
        """Whether it takes whole numbers."""
        return (
            isinstance(self.default, int)
            and not isinstance(self.default, bool)
            and not self.choices
        )

    @property
    def holds_default(self) -> bool:
        """Whether the default is in the range, on its steps."""
        if self.choices:
            return self.default in self.choices
        assert (
            self.low is not None and self.high is not None and isinstance(self.default, int | float)
        )
        steps = (self.default - self.low) / self.step if self.step else 0.0
        return self.low <= self.default <= self.high and abs(steps - round(steps)) < 1e-9

    @property
    def ends(self) -> tuple[Value, ...]:
        """The values that are checked beforehand."""
        if self.choices:
            return self.choices
        return tuple(
            int(end) if self.is_whole else float(end)
            for end in (self.low, self.high)
            if end is not None
        )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def load_space(path: Path, run: RunConfig) -> tuple[Setting, ...]:
    """The settings of a file, in its order; the run is not resolved.

    Raises:
        ConfigError: The file is unreadable or empty, or it has an unknown key, an invalid range, or
            a refused value.
    """
    table = read_toml(path)
    try:
        resolved = tomllib.loads(dump_run(checked(run)[0]))
        settings = tuple(_settings(table, resolved, ()))
        if not settings:
            raise ConfigError("contains no setting; write KEY = { low = 0.1, high = 10.0 }")
        for setting in settings:
            for value in setting.ends:
                try:
                    checked(with_values(run, {setting.path: value}))
                except ConfigError as error:
                    raise ConfigError(f"{setting.key} = {value!r} is refused: {error}") from None
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    return settings


def _settings(
    table: Mapping[str, Any], resolved: Mapping[str, Any], where: tuple[str, ...]
) -> Iterator[Setting]:
    for name, entry in table.items():
        path = (*where, name)
        key = ".".join(path)
        if name not in resolved:
            raise unknown_name("setting", name, resolved, "".join(f"{part}." for part in where))
        if not isinstance(entry, Mapping):
            raise ConfigError(
                f"{key} is {entry!r}; write {{ low = ..., high = ... }} or {{ choices = [...] }}"
            )
        default = resolved[name]
        if isinstance(default, Mapping):
            yield from _settings(entry, default, path)
            continue
        for word in entry:
            if word not in KEYS:
                raise unknown_name("key of a range", word, KEYS, f"{key}.")
        choices = entry.get("choices", [])
        plain = isinstance(choices, list) and all(
            isinstance(choice, (str, int, float)) for choice in choices
        )
        if not plain or not isinstance(entry.get("log", False), bool):
            raise ConfigError(
                f"{key}: choices is a list of numbers, texts or true and false, and log is true or "
                "false"
            )
        yield Setting(path, default, **{**entry, "choices": tuple(choices)})


def with_values(run: RunConfig, values: Mapping[tuple[str, ...], Value]) -> RunConfig:
    """The run with other settings; ConfigError if the run's own checks refuse them."""
    table: dict[str, Any] = tomllib.loads(dump_run(run))
    for path, value in values.items():
        entry: Any = value
        for part in reversed(path):
            entry = {part: entry}
        table = merged(table, entry)
    return strict(RunConfig, table)


def difference(table: Mapping[str, Any], base: Mapping[str, Any]) -> dict[str, Any]:
    """The entries of a table that differ in another one."""
    changed: dict[str, Any] = {}
    for key, value in table.items():
        base_value = base.get(key)
        if isinstance(value, Mapping) and isinstance(base_value, Mapping):
            if inner := difference(value, base_value):
                changed[key] = inner
        elif key not in base or value != base_value:
            changed[key] = value
    return changed


def chosen_table(run: RunConfig) -> dict[str, Any]:
    """The keys of a run that are not the defaults, and the planners, for `--config`."""
    table = tomllib.loads(dump_run(replace(run, gates="default")))
    changed = difference(table, tomllib.loads(dump_run(RunConfig())))
    gates_path = run.gates if run.gates in PACKAGED else str(Path(run.gates).absolute())
    gates = {} if run.gates == "default" else {"gates": gates_path}
    return {
        "planners": list(run.planners),
        **gates,
        **{key: changed[key] for key in changed if key != "planners"},
    }


def listed(settings: Sequence[Setting], values: Mapping[tuple[str, ...], Value]) -> str:
    """Settings and their values: "planner.idm.time_gap_s = 1.2"."""
    return ", ".join(f"{setting.key} = {shown(values[setting.path])}" for setting in settings)


def shown(value: Value) -> str:
    """A value, numbers with six digits."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
