"""What is falsified: a recorded log, or a family of the catalogue; a point of the axes makes a scenario of it.

Of a log, and of a family of which a variation is an axis, every point is a varied log (`logs.variations.varied`), the
recorded point too: of the ego's log only the start is kept. Of a family's own parameters alone, a point is the scenario
that the family builds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from logs.catalogue import FAMILY, families
from logs.catalogue.family import Family
from logs.errors import ConfigError, LogError
from logs.files import here
from logs.readers import LogSettings
from logs.scenario import Scenario
from logs.variations import VARIATIONS, varied
from replay.run.sources import LogSource
from replay.search.axes import SearchAxis
from replay.vary.encounters import conflicting_agent, prepared


@dataclass(frozen=True, eq=False)
class Subject:
    """A log or a family.

    Attributes:
        name: Of the log or the family.
        scenario: As it was recorded, or the family's with its defaults; prepared for variations.
        family: None: a log.
        agents: Ids of those who are varied; empty: nobody, or the inserted one.
    """

    name: str
    scenario: Scenario
    family: Family | None = None
    agents: tuple[str, ...] = ()

    def of(self, agents: tuple[str, ...]) -> Subject:
        """The same with these agents varied."""
        return replace(self, agents=agents)

    @property
    def short_agents(self) -> tuple[str, ...]:
        """Short names of those who are varied."""
        return tuple(map(self.scenario.short_names, self.agents))

    def at(self, axes: Sequence[SearchAxis], values: Mapping[str, float]) -> Scenario:
        """The scenario with these values of the axes.

        Raises:
            LogError: There is no such scenario.
        """
        changes = {axis.name: values[axis.name] for axis in axes if axis.is_variation}
        own = {axis.name: values[axis.name] for axis in axes if not axis.is_variation}
        made = self.scenario
        if own:
            assert self.family is not None
            try:
                made = self.family.scenario(**own)
            except ConfigError as error:  # the family refuses the values: there is no such scenario
                raise LogError(str(error)) from None
            made = prepared(made) if changes else made
        return varied(made, self.agents, changes) if changes else made


def opened(name: str, settings: LogSettings) -> Subject:
    """The log at a path or URL, or the family of a name.

    Raises:
        ConfigError: There is no such file, folder or family.
        LogError: It cannot be read.
    """
    with here(name) as path:
        if path.exists():
            scenario = LogSource(name, path, settings).read()
            return Subject(scenario.name, prepared(scenario))
    if ":" not in name and name not in families():
        raise ConfigError(f"{name}: no such file or folder, and no family of the catalogue (replan synth --list)")
    family = FAMILY.find(name)
    return Subject(name, prepared(family.scenario()), family)


def agents_of(subject: Subject, axes: Sequence[SearchAxis], named: Sequence[str]) -> tuple[str, ...]:
    """Who is varied: those who are named, else the one in the conflict of the drive, where an axis asks for one.

    Raises:
        ConfigError: An agent is not there, or there is none.
    """
    short = subject.scenario.short_names
    found = tuple(short.whole(word) for word in named)
    missing = [agent for agent in found if agent not in subject.scenario.tracks.ids]
    if missing:
        raise ConfigError(f"no agent is called '{missing[0]}'; `replan vary LOG --list-agents` lists them")
    changed = [VARIATIONS[axis.name] for axis in axes if axis.is_variation]
    asks = any(one.of == "agent" for one in changed) and not any(one.inserts for one in changed)
    return found if found or not asks else (conflicting_agent(subject.scenario),)
