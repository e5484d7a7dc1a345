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
    """The command of a planner's process; `table`: its table in the configuration, with `python`
    and `path`, folders from which the planner and the devkit are imported.

    ConfigError if the specification is no "nuplan:MODULE:CLASS", or a folder is not there.
    """
    target = spec.removeprefix(PREFIX)
    if target.count(":") != 1 or not all(target.split(":")):
        raise ConfigError(f"planner '{spec}': write nuplan:MODULE:CLASS")
    folders = table.get("path", ())
    if not isinstance(folders, list | tuple):
        raise ConfigError(f"planner '{spec}': path is a list of folders, not {folders!r}")
    for folder in folders:
        if not isinstance(folder, str) or not Path(folder).is_dir():
            raise ConfigError(f"planner '{spec}': there is no folder {folder} (in its path)")
    return [str(table.get("python", sys.executable)), str(START), target, *folders]
