"""A table of `replan score`: a row for each scene or drive, with the original's columns, and a
summary for each agent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd


@dataclass(frozen=True, eq=False)
class ScoreTable:
    """The scores of scenes or drives.

    Attributes:
        scenes: A row for each scene or drive.
        summary: The means and products of each agent's scenes, with the same columns or fewer.
        inexact: What cannot be exact for these logs, and why.
    """

    scenes: pd.DataFrame
    summary: pd.DataFrame
    inexact: tuple[str, ...]

    @property
    def rows(self) -> pd.DataFrame:
        """The rows of the scenes, then those of the summary."""
        columns = list(self.scenes.columns)
        return pd.concat([self.scenes, self.summary], ignore_index=True)[columns]


def agent_means(scenes: pd.DataFrame, agent: str, parts: Sequence[str]) -> pd.DataFrame:
    """Return a row for each agent (a value of the column `agent`): the means of the columns `parts`
    over scenes that have a value.
    """
    return scenes.groupby(agent, sort=False)[list(parts)].mean().reset_index()
