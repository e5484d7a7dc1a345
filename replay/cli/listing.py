"""Lists all that replan knows by name, each with one line and its place in the code. `replan list` prints it.

The lines come from the code: for a class or function, the first line of its docstring; for a table of names, the entry
in the docstring of its module; for a metric, family, reader or suite, its summary; for a car, the first comment of its
file.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.resources import files
from typing import Any

from logs.catalogue import SUITES, families
from logs.errors import unknown_name
from logs.extension import ExtensionKind
from logs.readers import readers
from logs.vehicle import vehicle_names
from metrics import METRIC
from planners import PLANNER
from replay.control import CONTROLLER
from replay.draw.charts.layout import CHART
from replay.loop.perception import PERCEPTION, PREDICTIONS
from replay.oracle import ORACLES
from replay.prediction import PREDICTION
from replay.traffic import TRAFFIC_KIND
from replay.vehicle import VEHICLE


@dataclass(frozen=True)
class ListedName:
    """A name.

    Attributes:
        name: The name in options and files.
        says: Its description in one line.
        where: "package.module:line", or a file.
    """

    name: str
    says: str
    where: str


def entries(kind: str) -> tuple[ListedName, ...]:
    """All names of a kind, in the order of its table; ConfigError if there is no such kind."""
    if kind not in KINDS:
        raise unknown_name("kind", kind, KINDS)
    return tuple(KINDS[kind]())


def lines(found: Iterable[ListedName]) -> list[str]:
    """The entries for a terminal: a line each, and its place in the code below it."""
    return [line for one in found for line in (f"{one.name}: {one.says}", f"    {one.where}")]


def counts() -> list[str]:
    """The number of names of each kind, a line each."""
    width = max(map(len, KINDS))
    return [f"{kind:{width}}  {len(entries(kind)):4d}" for kind in KINDS]


def _planners() -> Iterator[ListedName]:
    yield from _entries_of_code(_all(PLANNER))
    for one in _entries_of_code(ORACLES):
        yield ListedName(one.name, f"{one.says} (oracle)", one.where)


def _entries_of_code(table: Mapping[str, Callable[..., Any]]) -> Iterator[ListedName]:
    """The entries of a table, described by the docstrings of its values."""
    for name, thing in table.items():
        yield ListedName(name, _first_line(thing), _where(thing))


def _all(kind: ExtensionKind[Any]) -> dict[str, Any]:
    """The built-in names, then those of other distributions."""
    return {**kind.builtin, **kind.installed()}


def _entries_of_table(module: str, names: Mapping[str, Callable[..., Any]] | Iterable[str]) -> Iterator[ListedName]:
    """Entries that are described by the table in a module's docstring: `"name"    what it is`."""
    doc = inspect.getdoc(import_module(module)) or ""
    code = names if isinstance(names, Mapping) else {}
    for name in names:
        found = re.search(rf'^ *"?{name}"?  +(\S.*(?:\n {{10,}}\S.*)*)', doc, re.MULTILINE)
        says = " ".join(found[1].split()) if found else _first_line(code[name]) if name in code else ""
        yield ListedName(name, re.sub(r" *\(`[^)]*\)$", "", says), _where(code[name]) if name in code else module)


def _predictions() -> Iterator[ListedName]:
    where = {one.name: one for one in _entries_of_code(_all(PREDICTION))}
    for one in _entries_of_table("replay.prediction", tuple(dict.fromkeys((*PREDICTIONS, *where)))):
        own = where.get(one.name, one)
        yield ListedName(one.name, one.says or own.says, "replay.loop.perception" if own is one else own.where)


def _cars() -> Iterator[ListedName]:
    for name in vehicle_names():
        file = f"logs/vehicles/{name}.toml"
        comment = (files("logs") / "vehicles" / f"{name}.toml").read_text(encoding="utf-8").partition("\n")[0]
        yield ListedName(name, f"{comment.removeprefix('#').partition('.')[0].strip()}.", file)


def _first_line(thing: Callable[..., Any]) -> str:
    """The first docstring line of a class or function; settings of a `partial` are appended."""
    if isinstance(thing, partial):
        settings = ", ".join(f"{key} {value}" for key, value in thing.keywords.items())
        return f"{_first_line(thing.func)} With {settings}."
    return re.sub(r"; (see|both) .*", ".", (inspect.getdoc(thing) or "").partition("\n")[0])


def _where(thing: Any) -> str:
    """The module and line at which the code begins."""
    while isinstance(thing, partial):
        thing = thing.func
    if not inspect.isroutine(thing) and not isinstance(thing, type):
        thing = type(thing)
    return f"{thing.__module__}:{inspect.getsourcelines(thing)[1]}"


KINDS: Mapping[str, Callable[[], Iterable[ListedName]]] = {
    "planners": _planners,
    "controllers": lambda: _entries_of_code(_all(CONTROLLER)),
    "vehicles": lambda: _entries_of_code(_all(VEHICLE)),
    "cars": _cars,
    "traffic": lambda: _entries_of_table("replay.traffic", _all(TRAFFIC_KIND)),
    "predictions": _predictions,
    "perceptions": lambda: _entries_of_table("replay.loop.perception", _all(PERCEPTION)),
    "charts": lambda: _entries_of_code(_all(CHART)),
    "metrics": lambda: (ListedName(name, one.meaning, _where(one.measure)) for name, one in _all(METRIC).items()),
    "families": lambda: (ListedName(name, one.summary, _where(one.build)) for name, one in families().items()),
    "suites": lambda: (ListedName(name, one.summary, "logs.catalogue") for name, one in SUITES.items()),
    "readers": lambda: (ListedName(one.name, one.summary, _where(one.read)) for one in readers()),
}
"""The kinds of names, in the order of `replan list`."""
