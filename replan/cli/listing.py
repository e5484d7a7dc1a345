"""Lists all that replan knows by name, each with one line and its place in the code. `replan list`
prints it.

The lines come from the code: for a class or function, the first line of its docstring; for a
metric, family, reader or suite, its summary; for a car, the first comment of its file.

The settings of a planner, controller, vehicle model ... come from its code, too:

key, default    the field of its dataclass, or its keyword; the key is that of `--set`
unit            from the last part of the name (`UNITS`)
range           from the annotation
meaning         the string below the field, or the description in the keyword's annotation
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import partial
from importlib.resources import files
from typing import Any

from replan.core.errors import ConfigError, unknown_name
from replan.core.extension import ExtensionKind
from replan.core.names import first_paragraph
from replan.core.settings import bounds_of, dotted, meaning, types_of
from replan.draw.charts.layout import CHART
from replan.logs.catalogue import SUITES, families
from replan.logs.readers import readers
from replan.logs.vehicle import vehicle_names
from replan.metrics import METRIC
from replan.replay.loop_config import DEFAULT_LOOP
from replan.replay.parts import PARTS, Part, config_class


@dataclass(frozen=True)
class ListedName:
    """A name."""

    name: str
    says: str
    where: str  # "package.module:line", or a file


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
        listed = {
            kind.plural: _entries_of_code({name: thing})
            for kind in PARTS.values()
            if kind.fits(thing)
        }
    else:
        listed = {kind: (entry for entry in entries(kind) if entry.name == name) for kind in KINDS}
    parts = {kind.plural: Part(kind, name) for kind in PARTS.values()}
    all_of = [
        DescribedName(
            kind,
            entry.name,
            entry.says,
            entry.where,
            settings_of(parts[kind]) if kind in parts else None,
        )
        for kind, listed_names in listed.items()
        for entry in listed_names
    ]
    if not all_of:
        if ":" in name:
            raise ConfigError(f"'{name}' takes the arguments of no {', '.join(PARTS)}")
        raise unknown_name(
            "kind or name",
            name,
            [*KINDS, *(entry.name for kind in parts for entry in entries(kind))],
        )
    return all_of


def page(entries: Iterable[DescribedName]) -> list[str]:
    """Names with their settings for a terminal."""
    shown = list[str]()
    for entry in entries:
        settings = ["no settings"] if entry.settings == () else setting_lines(entry.settings or ())
        shown += [f"{entry.name} ({entry.kind}): {entry.says}", f"    {entry.where}", *settings]
    return shown


def lines(names: Iterable[ListedName]) -> list[str]:
    """The entries for a terminal: a line each, and its place in the code below it."""
    return [
        line for entry in names for line in (f"{entry.name}: {entry.says}", f"    {entry.where}")
    ]


def counts() -> list[str]:
    """The number of names of each kind, a line each."""
    width = max(map(len, KINDS))
    return [f"{kind:{width}}  {len(entries(kind)):4d}" for kind in KINDS]


def _parts(kind: str) -> Iterator[ListedName]:
    for entry in _entries_of_code(_all(PARTS[kind])):
        oracle = entry.name in PARTS[kind].oracles
        yield ListedName(
            entry.name, f"{entry.says} (oracle)" if oracle else entry.says, entry.where
        )


def _entries_of_code(table: Mapping[str, Callable[..., Any]]) -> Iterator[ListedName]:
    for name, thing in table.items():
        yield ListedName(name, _first_line(thing), _where(thing))


def _all(kind: ExtensionKind[Any]) -> dict[str, Any]:
    """The built-in names, then those of other distributions."""
    return {**kind.builtin, **kind.installed()}


def _cars() -> Iterator[ListedName]:
    for name in vehicle_names():
        file = f"replan/logs/vehicles/{name}.toml"
        comment = (
            (files("replan.logs") / "vehicles" / f"{name}.toml")
            .read_text(encoding="utf-8")
            .partition("\n")[0]
        )
        yield ListedName(name, f"{comment.removeprefix('#').partition('.')[0].strip()}.", file)


def _first_line(thing: Callable[..., Any]) -> str:
    """The first docstring line of a class or function; settings of a `partial` are appended."""
    if isinstance(thing, partial):
        settings = ", ".join(f"{key} {value}" for key, value in thing.keywords.items())
        return f"{_first_line(thing.func)} With {settings}."
    return first_paragraph(thing)


def _where(thing: Any) -> str:
    while isinstance(thing, partial):
        thing = thing.func
    if not inspect.isroutine(thing) and not isinstance(thing, type):
        thing = type(thing)
    try:
        return f"{thing.__module__}:{inspect.getsourcelines(thing)[1]}"
    except (OSError, TypeError):  # code without source
        return str(thing.__module__)


def _metrics() -> Iterator[ListedName]:
    for name, metric in _all(METRIC).items():
        yield ListedName(name, metric.meaning, _where(metric.measure))


def _families() -> Iterator[ListedName]:
    for name, family in families().items():
        yield ListedName(name, family.summary, _where(family.build))


def _suites() -> Iterator[ListedName]:
    for name, log_suite in SUITES.items():
        yield ListedName(name, log_suite.summary, "replan.logs.catalogue")


def _readers() -> Iterator[ListedName]:
    for reader in readers():
        yield ListedName(reader.name, reader.summary, _where(reader.read))


KINDS: Mapping[str, Callable[[], Iterable[ListedName]]] = {
    "planners": lambda: _parts("planner"),
    "controllers": lambda: _parts("controller"),
    "vehicles": lambda: _parts("vehicle"),
    "cars": _cars,
    "traffic": lambda: _parts("traffic"),
    "predictions": lambda: _parts("prediction"),
    "perceptions": lambda: _parts("perception"),
    "charts": lambda: _entries_of_code(_all(CHART)),
    "metrics": _metrics,
    "families": _families,
    "suites": _suites,
    "readers": _readers,
}
"""The kinds of names, in the order of `replan list`."""

UNITS: Mapping[str, str] = {
    "s": "s",
    "m": "m",
    "mps": "m/s",
    "mps2": "m/s2",
    "mps3": "m/s3",
    "kmh": "km/h",
    "rad": "rad",
    "deg": "deg",
    "pm": "1/m",
    "kg": "kg",
    "gb": "GB",
}
"""Units by the last part of a name (`time_gap_s`).

A weight (`w_s`) has the unit of its cost, which no name gives.
"""

SIGNS = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}

ANY = ExtensionKind[Callable[..., Any]]("extension", "extensions", {})
"""Finds what a user names as module:NAME, of any kind."""


@dataclass(frozen=True)
class ListedSetting:
    """A setting."""

    key: str  # Its key for `--set`
    default: Any  # Its value if it is not set; None also if it has to be set
    unit: str  # Its unit; "" for a number without one, a weight, a text
    range: Mapping[str, float]  # Its bounds, named as in JSON Schema; empty: none is checked
    meaning: str
    group: str = ""  # What its table is for; "" without one


def settings_of(part: Part) -> tuple[ListedSetting, ...]:
    """The settings of a part; errors as `ExtensionKind.find`."""
    where, name, factory = part.where, part.name, part.factory
    if is_dataclass(getattr(DEFAULT_LOOP, name, None)):  # perception "sensor"
        return tuple(_of_dataclass(getattr(DEFAULT_LOOP, name), dotted("loop", name)))
    config = config_class(factory)
    if config is not None:
        needed = any(f.default is MISSING and f.default_factory is MISSING for f in fields(config))
        return tuple(_of_dataclass(config if needed else config(), where))
    keywords = [
        p for p in inspect.signature(factory).parameters.values() if p.kind is p.KEYWORD_ONLY
    ]
    types = types_of(factory)
    return tuple(
        ListedSetting(
            dotted(where, p.name),
            None if p.default is p.empty else p.default,
            unit(p.name),
            bounds_of(types.get(p.name)),
            meaning(factory, p.name),
        )
        for p in keywords
    )


def _of_dataclass(config: Any, where: str, group: str = "") -> Iterator[ListedSetting]:
    """The settings of a dataclass, then those of its tables.

    A class instead of an instance has no defaults.
    """
    items = [item for item in fields(config) if item.metadata.get("key", item.init)]
    values = [
        (item.name, getattr(config, item.name, None), dotted(where, item.name)) for item in items
    ]
    types = types_of(config if isinstance(config, type) else type(config))
    for name, value, key in values:
        if not is_dataclass(value):
            yield ListedSetting(
                key, value, unit(name), bounds_of(types[name]), meaning(config, name), group
            )
    for name, value, key in values:
        if is_dataclass(value):
            about = meaning(config, name) or first_paragraph(value)
            yield from _of_dataclass(value, key, about)


def unit(name: str) -> str:
    """The unit in a name; "" if there is none."""
    stem, _, last = name.rpartition("_")
    return UNITS.get(last, "") if stem and not name.startswith("w_") else ""


def setting_lines(settings: Iterable[ListedSetting]) -> list[str]:
    """The settings for a terminal: key and default as `--set` takes them, unit and range.

    Below, the meaning.
    """
    shown, group = list[str](), ""
    for setting in settings:
        if setting.group != group:
            group = setting.group
            shown += ["", group]
        value = "..." if setting.default is None else json.dumps(setting.default)
        about = ", ".join(
            filter(
                None,
                (
                    setting.unit,
                    *(f"{SIGNS[name]} {edge:.10g}" for name, edge in setting.range.items()),
                ),
            )
        )
        shown += [
            f"{setting.key}={value}" + (f"  [{about}]" if about else ""),
            *([f"    {setting.meaning}"] if setting.meaning else ()),
        ]
    return shown
