"""Names for shell completion, read from the source of their tables: to import those would take longer than to wait.

A table is a dictionary of string keys that is written out in a module: `PLANNERS: ... = {"dp_qp": DpQp, ...}`.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
TABLES = {
    "planner": (("planners/__init__.py", "PLANNERS"), ("replay/oracle.py", "ORACLES")),
    "controller": (("replay/control/__init__.py", "CONTROLLERS"),),
    "vehicle": (("replay/vehicle/__init__.py", "VEHICLES"),),
    "traffic": (("replay/traffic/__init__.py", "TRAFFIC"),),
    "prediction": (("replay/prediction/__init__.py", "PREDICTORS"),),
    "perception": (("replay/loop/perception.py", "PERCEPTIONS"),),
    "chart": (("replay/draw/charts/layout.py", "CHARTS"),),
    "suite": (("logs/catalogue/__init__.py", "SUITES"),),
    "kind": (("replay/cli/listing.py", "KINDS"),),
}
"""Of each option the tables of its names: file and variable."""

BESIDES = {"prediction": ("oracle",), "chart": ("all",)}
"""Names that are in no table."""


def names(option: str) -> tuple[str, ...]:
    """The names that an option takes, in the order of their tables."""
    if option == "car":
        return tuple(sorted(file.stem for file in (ROOT / "logs" / "vehicles").glob("*.toml")))
    return (*(key for file, table in TABLES[option] for key in _keys(ROOT / file, table)), *BESIDES.get(option, ()))


def completion(option: str) -> Callable[[str], list[str]]:
    """What `typer.Option(autocompletion=...)` takes; a file that cannot be read completes nothing."""

    def complete(incomplete: str) -> list[str]:
        try:
            return [name for name in names(option) if name.startswith(incomplete)]
        except (OSError, SyntaxError):
            return []

    return complete


def complete_setting(incomplete: str) -> list[str]:
    """The keys that `--set` takes, each with "="; of a planner, controller ... that is named, those of its table."""
    from replay.config import RunConfig
    from replay.settings import SETTINGS, dotted_keys

    tables = {"planner": "planner", **{table: option for option, table in SETTINGS.items()}}
    keys: list[str] = []
    for key in dotted_keys(RunConfig):
        keys += [f"{key}.{name}." for name in names(tables[key])] if key in tables else [f"{key}="]
    return [key for key in keys if key.startswith(incomplete)]


def _keys(file: Path, table: str) -> Iterator[str]:
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == table:
            keys = node.value.keys if isinstance(node.value, ast.Dict) else ()
            yield from (str(key.value) for key in keys if isinstance(key, ast.Constant))
