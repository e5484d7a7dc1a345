"""run.toml: the resolved configuration of a run, each setting with its meaning from the code.

The meanings are those of `replan list NAME`: entries of docstrings. Settings of parts that are not built in have none,
as their modules may only be loaded where they run.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import is_dataclass, replace
from pathlib import Path
from typing import Any, get_type_hints

import tomli_w

from logs.vehicle import VehicleParameters
from metrics.judge.gates import PACKAGED
from replay.config import HEADER, RunConfig, dump_run
from replay.parts import PARTS, config_class
from replay.settings import dotted, meaning


def explained(run: RunConfig, folder: Path) -> str:
    """The text of run.toml in a folder; `load_run` reads it as that of `dump_run`: a path of gates begins there."""
    if run.gates not in PACKAGED:
        run = replace(run, gates=os.path.relpath(run.gates, folder))
    return f"{HEADER}{chr(10).join(_lines(tomllib.loads(dump_run(run)), RunConfig, ''))}\n"


def _lines(table: Mapping[str, Any], of: Any, where: str) -> Iterator[str]:
    """The lines of a table, whose keys are fields of a dataclass or keywords of a factory; None: they are not known."""
    for key, value in table.items():
        if not isinstance(value, Mapping):
            line, about = tomli_w.dumps({key: value}).rstrip("\n"), "" if of is None else meaning(of, key)
            yield f"{line}  # {about}" if about and "\n" not in line else f"# {about}\n{line}" if about else line
    for key, value in table.items():
        if isinstance(value, Mapping):
            place = dotted(where, key)
            if not value or not all(isinstance(item, Mapping) for item in value.values()):
                yield f"\n[{place}]"
            yield from _lines(value, _described(of, key, where), place)


def _described(of: Any, key: str, where: str) -> Any:
    """The dataclass or factory that describes a table in a table; None: there is none."""
    if of is RunConfig and key == "vehicle":
        return VehicleParameters
    kinds = {kind.table: kind for kind in PARTS.values()}
    if where in kinds:
        factory = kinds[where].builtin.get(key)
        return None if factory is None else config_class(factory) or factory
    hint = get_type_hints(of).get(key) if isinstance(of, type) and is_dataclass(of) else None
    return hint if isinstance(hint, type) and is_dataclass(hint) else None
