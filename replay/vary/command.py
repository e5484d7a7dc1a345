"""What `replan vary` does with its words."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any

from logs.catalogue import CATALOGUE
from logs.errors import ConfigError
from logs.files import here
from logs.readers import LogSettings
from logs.scenario import Scenario
from logs.variations import VARIATIONS
from replay.config import RunConfig
from replay.results.tables import next_free
from replay.run.sources import LogSource
from replay.vary import surface
from replay.vary.axes import Question, question
from replay.vary.encounters import conflicting_agent, encounters, listing, prepared


def variations() -> Iterator[str]:
    """What may be varied, a line each."""
    width = max(map(len, VARIATIONS))
    for one in VARIATIONS.values():
        neutral = f"; {one.shown(one.neutral)}: as recorded" if isfinite(one.neutral) else ""
        yield f"{one.name:{width}}  {one.summary} ({one.low:g} to {one.shown(one.high)}{neutral})"


def variation_table() -> list[dict[str, Any]]:
    """What `variations` says, as data."""
    keys = ("name", "summary", "low", "high", "neutral")
    return [{key: getattr(one, key) for key in keys} for one in VARIATIONS.values()]


def opened(log: str, settings: LogSettings) -> Scenario:
    """The scenario of a file, folder or family, as it is varied.

    Raises:
        ConfigError: There is no such file, folder or family.
        LogError: It cannot be read.
    """
    with here(log) as path:
        if path.exists():
            return prepared(LogSource(log, path, settings).read())
    if log not in CATALOGUE:
        raise ConfigError(f"{log}: no such file or folder, and no family of the catalogue (replan synth --list)")
    return prepared(LogSource(log).read())


def agents(scenario: Scenario) -> list[str]:
    """Who is there, a line each."""
    return listing(encounters(scenario), scenario.short_names)


def asked(scenario: Scenario, words: Sequence[str], named: Sequence[str], resolution: float | None) -> Question:
    """The question, with the agent in conflict where one is needed and none is named; ConfigError as `question`.

    An agent is named by the whole id or by the short name.
    """
    found = question(words, [*map(scenario.short_names.whole, named)], resolution)
    return found if named or not found.varies_agents else replace(found, agents=(conflicting_agent(scenario),))


def vary(
    scenario: Scenario,
    asked_for: Question,
    run: RunConfig,
    out: Path | None,
    *,
    workers: int,
    say: Callable[[str], None],
) -> surface.VaryResult:
    """`surface.vary`, into the next free folder where none is named; says who is varied."""
    out = next_free() if out is None else out
    if asked_for.agents:
        say(f"varied: {', '.join(map(scenario.short_names, asked_for.agents))}")
    return surface.vary(scenario, asked_for, run, out, workers=workers, say=say)
