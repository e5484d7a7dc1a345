"""A recorded log, or a family of the catalogue, prepared for variation."""

from __future__ import annotations

from dataclasses import replace

from replan.core.errors import ConfigError
from replan.core.urls import here
from replan.logs.catalogue import FAMILY, families
from replan.logs.catalogue.family import Family
from replan.logs.readers import LogSettings
from replan.logs.scenario import Scenario
from replan.metrics.arrival import goal_of
from replan.metrics.boxes import phantoms, without_phantoms
from replan.run.log_source import LogSource


def prepared(scenario: Scenario) -> Scenario:
    """The scenario prepared for variation: without phantoms, and with a goal at the end of its
    drive if it has none.

    Both need the recorded drive, which a varied log no longer contains.
    """
    notes = []
    ghosts = phantoms(scenario)
    if ghosts:
        names = ", ".join(dict.fromkeys(ghost.name for ghost in ghosts))
        notes.append(f"Left out where the recorded ego stood in them: {names}.")
    goal, note = goal_of(scenario)
    if note:
        notes.append(f"{note[0].upper()}{note[1:]}.")
    tracks = without_phantoms(scenario.tracks, ghosts)
    return replace(scenario, tracks=tracks, goal=goal, notes=(*scenario.notes, *notes))


def opened(name: str, settings: LogSettings) -> tuple[Scenario, Family | None]:
    """The scenario of a file, folder, URL or family, prepared for variation; and the family.

    Raises:
        ConfigError: There is no such file, folder or family.
        LogError: The log cannot be read.
    """
    with here(name) as path:
        if path.exists():
            return prepared(LogSource(name, path, settings).read()), None
    if ":" not in name and name not in families():
        raise ConfigError(
            f"{name}: no such file or folder, and no family of the catalogue (replan synth --list)"
        )
    family = FAMILY.find(name)
    return prepared(family.scenario()), family
