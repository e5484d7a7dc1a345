"""Planners of nuPlan's devkit (`AbstractPlanner`), driven unchanged: `-p nuplan:MODULE:CLASS`.

The planner runs in a process of its own, with the interpreter that its table names (`python`), so
that a network of Python 3.9 runs beside replan. That side is the package `replan_nuplan` below,
which imports nothing of replan; it builds the objects of the devkit, which the user has.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path

from replan.core.errors import ConfigError

PREFIX = "nuplan:"
START = Path(__file__).with_name("start.py")
"""The program of the planner's process."""


def nuplan_command(spec: str, table: Mapping[str, object]) -> list[str]:
    """The command of a planner's process; `table`: its table in the configuration, with `python`.

    ConfigError if the specification is no "nuplan:MODULE:CLASS".
    """
    target = spec.removeprefix(PREFIX)
    if target.count(":") != 1 or not all(target.split(":")):
        raise ConfigError(f"planner '{spec}': write nuplan:MODULE:CLASS")
    return [str(table.get("python", sys.executable)), str(START), target]
