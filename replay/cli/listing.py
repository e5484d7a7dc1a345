"""Lists all that replan knows by name, each with one line and its place in the code. `replan list` prints it.

The lines come from the code: for a class or function, the first line of its docstring; for a metric, family, reader or
suite, its summary; for a car, the first comment of its file.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from typing import Any

from logs.catalogue import SUITES, families
from logs.errors import ConfigError, unknown_name
from logs.extension import ExtensionKind
from logs.readers import readers
from logs.vehicle import vehicle_names
from metrics import METRIC
from replay.cli.listed_settings import ANY, ListedSetting, setting_lines, settings_of
from replay.draw.charts.layout import CHART
from replay.parts import PARTS, Part


@dataclass(frozen=True)
class ListedName:
    """A name.

    Attributes:
        where: "package.module:line", or a file.
    """

    name: str
    says: str
    where: str


@dataclass(frozen=True)
class DescribedName:
    """A name of a kind, with its settings; None for a kind without settings."""

    kind: str
    name: str
    says: str
    where: str
    settings: tuple[ListedSetting, ...] | None


def entries(kind: str) -> tuple[ListedName, ...]:
    """All names of a kind, in the order of its table; ConfigError if there is no such kind."""
    if kind not in KINDS:
        raise unknown_name("kind", kind, KINDS)
    return tuple(KINDS[kind]())


def described(name: str) -> list[DescribedName]:
    """A name in each kind that has it, or a planner, controller ... "module:NAME" of a user.

    ConfigError if nothing has this name; PlannerError if the user's module cannot be imported.
    """
    if all(name.partition(":")):
        thing = ANY.find(name)
        found = {kind.plural: _entries_of_code({name: thing}) for kind in PARTS.values() if kind.fits(thing)}
    else:
        found = {kind: (one for one in entries(kind) if one.name == name) for kind in KINDS}
    parts = {kind.plural: Part(kind, name) for kind in PARTS.values()}
    all_of = [
        DescribedName(kind, one.name, one.says, one.where, settings_of(parts[kind]) if kind in parts else None)
        for kind, some in found.items()
        for one in some
    ]
    if not all_of:
        if ":" in name:
            raise ConfigError(f"'{name}' takes the arguments of no {', '.join(PARTS)}")
        raise unknown_name("kind or name", name, [*KINDS, *(one.name for kind in parts for one in entries(kind))])
    return all_of


def page(found: Iterable[DescribedName]) -> list[str]:
    """Names with their settings for a terminal."""
    shown = list[str]()
    for one in found:
        settings = ["no settings"] if one.settings == () else setting_lines(one.settings or ())
        shown += [f"{one.name} ({one.kind}): {one.says}", f"    {one.where}", *settings]
    return shown


def lines(found: Iterable[ListedName]) -> list[str]:
    """The entries for a terminal: a line each, and its place in the code below it."""
    return [line for one in found for line in (f"{one.name}: {one.says}", f"    {one.where}")]


def counts() -> list[str]:
    """The number of names of each kind, a line each."""
    width = max(map(len, KINDS))
    return [f"{kind:{width}}  {len(entries(kind)):4d}" for kind in KINDS]


def _parts(kind: str) -> Iterator[ListedName]:
    for one in _entries_of_code(_all(PARTS[kind])):
        oracle = one.name in PARTS[kind].oracles
        yield ListedName(one.name, f"{one.says} (oracle)" if oracle else one.says, one.where)


def _entries_of_code(table: Mapping[str, Callable[..., Any]]) -> Iterator[ListedName]:
    for name, thing in table.items():
        yield ListedName(name, _first_line(thing), _where(thing))


def _all(kind: ExtensionKind[Any]) -> dict[str, Any]:
    """The built-in names, then those of other distributions."""
    return {**kind.builtin, **kind.installed()}


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
    return (inspect.getdoc(thing) or "").partition("\n")[0]


def _where(thing: Any) -> str:
    while isinstance(thing, partial):
        thing = thing.func
    if not inspect.isroutine(thing) and not isinstance(thing, type):
        thing = type(thing)
    try:
        return f"{thing.__module__}:{inspect.getsourcelines(thing)[1]}"
    except (OSError, TypeError):  # code without source
        return str(thing.__module__)


KINDS: Mapping[str, Callable[[], Iterable[ListedName]]] = {
    "planners": lambda: _parts("planner"),
    "controllers": lambda: _parts("controller"),
    "vehicles": lambda: _parts("vehicle"),
    "cars": _cars,
    "traffic": lambda: _parts("traffic"),
    "predictions": lambda: _parts("prediction"),
    "perceptions": lambda: _parts("perception"),
    "charts": lambda: _entries_of_code(_all(CHART)),
    "metrics": lambda: (ListedName(name, one.meaning, _where(one.measure)) for name, one in _all(METRIC).items()),
    "families": lambda: (ListedName(name, one.summary, _where(one.build)) for name, one in families().items()),
    "suites": lambda: (ListedName(name, one.summary, "logs.catalogue") for name, one in SUITES.items()),
    "readers": lambda: (ListedName(one.name, one.summary, _where(one.read)) for one in readers()),
}
"""The kinds of names, in the order of `replan list`."""
