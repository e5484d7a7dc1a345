"""Catalogue -> MCAP: synthesised logs with their parameters in the metadata."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from logs.catalogue import CATALOGUE, Family
from logs.errors import ConfigError, unknown_name
from logs.mcap import write_scenario
from replay.avoidability import with_avoidability
from replay.batch.results import safe_name


def chosen(names: Sequence[str]) -> tuple[Family, ...]:
    """The families of these names; "all" is every one, a group ("paper") all of its own.

    Raises:
        ConfigError: No family or group has the name.
    """
    found: dict[str, Family] = {}
    for name in names:
        matches = [key for key in CATALOGUE if name in ("all", key, key.partition("/")[0])]
        if not matches:
            raise unknown_name("family", name, [*CATALOGUE, "all"])
        found.update((key, CATALOGUE[key]) for key in matches)
    return tuple(found.values())


def overrides(settings: Sequence[str]) -> dict[str, float]:
    """Parameters from "key=value" words.

    Raises:
        ConfigError: A word has no `=`, or its value is no number.
    """
    out = {}
    for setting in settings:
        key, separator, value = setting.partition("=")
        try:
            out[key.strip()] = float(value)
        except ValueError:
            hint = f"'{value}' is no number" if separator else "there is no '='"
            raise ConfigError(f"--set {setting}: write it as parameter=number; {hint}") from None
    return out


def synthesise(families: Sequence[Family], out: Path, parameters: Mapping[str, float]) -> Iterator[Path]:
    """Write one log per family into `out`, as GROUP/NAME.mcap; yields each path when it is written.

    Raises:
        ConfigError: A family has no such parameter, or it leaves no careful drive.
    """
    scenarios = [family.scenario(**parameters) for family in families]
    for scenario in scenarios:
        group, _, name = scenario.name.rpartition("/")
        path = out / safe_name(group) / f"{safe_name(name)}.mcap" if group else out / f"{safe_name(name)}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_scenario(path, with_avoidability(scenario))
        yield path
