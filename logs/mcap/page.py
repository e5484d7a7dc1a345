"""docs/log_format.md, written from the types of the messages.

python -c 'from logs.mcap.page import markdown; print(markdown())' > docs/log_format.md
"""

from __future__ import annotations

import enum
import types
from collections.abc import Iterator
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from logs.mcap import native

_NAMES = {float: "number", int: "integer", str: "text", bool: "boolean", type(None): "null", Any: "any"}


def markdown() -> str:
    """The page."""
    kinds = _kinds()
    rows = [
        f"| `{topic}` | {_link(kind)} | {' '.join((kind.__doc__ or '').split())} |"
        for topic, kind in native.TOPICS.items()
    ]
    described = ["```text", (native.__doc__ or "").strip(), "```"]
    head = ["# The native log format", "", _NOTE, "", *described, "", "## Topics", ""]
    tables = [line for kind in kinds for line in _table(kind)]
    return "\n".join([*head, "| topic | message | what |", "|---|---|---|", *rows, "", "## Messages", *tables])


_NOTE = """<!-- written by `logs.mcap.page.markdown`; do not edit -->

Any MCAP reader opens a log: its messages are JSON, and their JSON Schema is in the file. The only topic that a log must
have is `/ego`; `replan inspect` says what is missing for which evaluation."""


def _kinds() -> list[type[msgspec.Struct]]:
    """The messages of the topics, and then those that stand in them, in order of first mention."""
    found: list[type[msgspec.Struct]] = [*dict.fromkeys(native.TOPICS.values()), native.RepairedColumns]
    for kind in found:
        inner = [part for hint in get_type_hints(kind).values() for part in _structs(hint)]
        found += [part for part in dict.fromkeys(inner) if part not in found]
    return found


def _structs(hint: Any) -> Iterator[type[msgspec.Struct]]:
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        yield hint
    for part in get_args(hint):
        yield from _structs(part)


def _table(kind: type[msgspec.Struct]) -> Iterator[str]:
    yield from ("", f"### {kind.__name__}", "", kind.__doc__ or "")
    if kind in native.BLOCKS:
        yield f"As `{native.BLOCKS[kind].__name__}`: `log_time_ns`, and a list of each of these."
    yield from ("", "| field | type | |", "|---|---|---|")
    for field in msgspec.structs.fields(kind):
        needed = "needed" if field.required else "optional"
        yield f"| `{field.encode_name}` | {_type(get_type_hints(kind)[field.name])} | {needed} |"


def _type(hint: Any) -> str:
    """A type in words."""
    origin, args = get_origin(hint), get_args(hint)
    if hint in _NAMES:
        return _NAMES[hint]
    if origin in (Union, types.UnionType):
        return " or ".join(_type(arg) for arg in args)
    if origin is Literal or (isinstance(hint, type) and issubclass(hint, enum.Enum)):
        return ", ".join(f'"{value}"' for value in (args or [member.value for member in hint]))
    if origin is dict:
        return f"object of {_type(args[1])}"
    if origin is tuple and args[-1] is not ...:
        return f"list of {len(args)} of {_type(args[0])}"
    return f"list of {_type(args[0])}" if origin in (list, tuple) else _link(hint)


def _link(kind: type[msgspec.Struct]) -> str:
    return f"[{kind.__name__}](#{kind.__name__.lower()})"
