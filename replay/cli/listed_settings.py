"""The settings of a planner, controller, vehicle model ... as `replan list NAME` prints them, all from its code.

key, default    the field of its dataclass, or its keyword; the key is that of `--set`
unit            from the last part of the name (`UNITS`)
range           the numbers that the dataclass accepts, with all other settings at their defaults: found by trying
meaning         the entry of the docstring: under "Attributes" of the dataclass, "Args" of a class or function
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from typing import Any

from logs.errors import ReplanError
from logs.extension import ExtensionKind
from replay.config import DEFAULT_LOOP
from replay.parts import Part, config_class
from replay.settings import dotted, meaning

UNITS: Mapping[str, str] = {
    "s": "s", "m": "m", "mps": "m/s", "mps2": "m/s2", "mps3": "m/s3", "kmh": "km/h", "rad": "rad", "deg": "deg",
    "pm": "1/m", "kg": "kg", "gb": "GB",
}  # fmt: skip
"""Units by the last part of a name (`time_gap_s`); a weight (`w_s`) has the unit of its cost, which no name gives."""

SIGNS = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
FAR, FAR_WHOLE, FINE = 1e9, 20_000, 1e-9
"""Largest values that are tried, of numbers and of whole numbers, and the relative error of a bound."""


ANY = ExtensionKind[Callable[..., Any]]("extension", "extensions", {})
"""Finds what a user names as module:NAME, of any kind."""


@dataclass(frozen=True)
class ListedSetting:
    """A setting.

    Attributes:
        key: Its key for `--set`.
        default: Its value if it is not set; None also if it has to be set.
        unit: Its unit; "" for a number without one, a weight, a text.
        range: Its bounds, named as in JSON Schema ("minimum", "exclusiveMinimum", ...); empty: none is checked.
        group: What its table is for; "" without one.
    """

    key: str
    default: Any
    unit: str
    range: Mapping[str, float]
    meaning: str
    group: str = ""


def settings_of(part: Part) -> tuple[ListedSetting, ...]:
    """The settings of a part; errors as `ExtensionKind.find`."""
    where, name, factory = part.where, part.name, part.factory
    if is_dataclass(getattr(DEFAULT_LOOP, name, None)):  # perception "sensor"
        return tuple(_of_dataclass(getattr(DEFAULT_LOOP, name), dotted("loop", name)))
    config = config_class(factory)
    if config is not None:
        needed = any(f.default is MISSING and f.default_factory is MISSING for f in fields(config))
        return tuple(_of_dataclass(config if needed else config(), where))
    keywords = [p for p in inspect.signature(factory).parameters.values() if p.kind is p.KEYWORD_ONLY]
    return tuple(
        ListedSetting(
            dotted(where, p.name), None if p.default is p.empty else p.default, unit(p.name), {},
            meaning(factory, p.name),
        )
        for p in keywords
    )  # fmt: skip


def _of_dataclass(config: Any, where: str, group: str = "") -> Iterator[ListedSetting]:
    """The settings of a dataclass, then those of its tables; a class instead of an instance has no defaults."""
    items = [item for item in fields(config) if item.metadata.get("key", item.init)]
    values = [(item.name, getattr(config, item.name, None), dotted(where, item.name)) for item in items]
    for name, value, key in values:
        if not is_dataclass(value):
            yield ListedSetting(key, value, unit(name), accepted(config, name), meaning(config, name), group)
    for name, value, key in values:
        if is_dataclass(value):
            about = meaning(config, name) or (inspect.getdoc(value) or "").partition("\n")[0]
            yield from _of_dataclass(value, key, about)


def unit(name: str) -> str:
    """The unit in a name; "" if there is none."""
    return "" if name.startswith("w_") else UNITS.get(name.rpartition("_")[2] if "_" in name else "", "")


def accepted(config: Any, name: str) -> dict[str, float]:
    """The bounds of a number, or of each number of a tuple, that the dataclass checks; see `ListedSetting.range`."""
    default = getattr(config, name, None)
    good, several = (default[0], len(default)) if isinstance(default, tuple) and default else (default, 0)
    if isinstance(config, type) or isinstance(good, bool) or not isinstance(good, int | float):
        return {}

    def accepts(value: float) -> bool:
        try:
            replace(config, **{name: (value,) * several if several else value})
        except (ReplanError, ValueError, ArithmeticError, TypeError):
            return False
        return True

    edges = {"inimum": _edge(accepts, good, -1), "aximum": _edge(accepts, good, 1)}
    found = {key: edge for key, edge in edges.items() if edge is not None}
    return {f"m{key}" if accepts(edge) else f"exclusiveM{key}": edge for key, edge in found.items()}


def _edge(accepts: Callable[[float], bool], good: float, sign: int) -> float | None:
    """The last number below or above a good one that is accepted, or the first that is not; None if there is none.

    It is found by bisection; whole numbers go in steps of two, as some must be odd.
    """
    whole = isinstance(good, int)
    bad = good + 2 * sign * FAR_WHOLE if whole else sign * FAR
    if accepts(bad) or not accepts(good):
        return None
    while abs(bad - good) > (2 if whole else FINE * max(1.0, abs(good))):
        middle = good + 2 * ((bad - good) // 4) if whole else 0.5 * (good + bad)
        good, bad = (middle, bad) if accepts(middle) else (good, middle)
    if whole:
        return good + sign if accepts(good + sign) else good
    return float(f"{round(good, 8):.7g}") + 0.0


def setting_lines(found: Iterable[ListedSetting]) -> list[str]:
    """The settings for a terminal: key and default as `--set` takes them, unit and range; below, the meaning."""
    shown, group = list[str](), ""
    for one in found:
        if one.group != group:
            group = one.group
            shown += ["", group]
        value = "..." if one.default is None else json.dumps(one.default)
        about = ", ".join(filter(None, (one.unit, *(f"{SIGNS[name]} {edge:.10g}" for name, edge in one.range.items()))))
        shown += [
            f"{one.key}={value}" + (f"  [{about}]" if about else ""),
            *([f"    {one.meaning}"] if one.meaning else ()),
        ]
    return shown
