"""The page docs/log_format.md: topics and messages of the native log."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from inspect import cleandoc
from itertools import chain
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from replan.logs.mcap import native

NOTE = """<!-- written by `replan.logs.mcap.format_page.markdown`; do not edit -->

Any MCAP reader opens a log: its messages are JSON, and their JSON Schema is in the file. The only topic that a log must
have is `/ego`; `replan inspect` says what is missing for which evaluation."""  # noqa: E501

_NAMES = {
    float: "number",
    int: "integer",
    str: "text",
    bool: "boolean",
    type(None): "null",
    Any: "any",
}


def markdown() -> str:
    """docs/log_format.md, written from the types of the messages."""
    topics = [
        f"| `{topic}` | {_link(kind)} | {' '.join((kind.__doc__ or '').split())} |"
        for topic, kind in native.TOPICS.items()
    ]
    described = ["```text", (native.__doc__ or "").strip(), "```"]
    head = ["# The native log format", "", NOTE, "", *described, "", "## Topics", ""]
    head += ["| topic | message | what |", "|---|---|---|", *topics, "", "## Messages"]
    return "\n".join([*head, *chain.from_iterable(map(_section, _messages()))])


def _messages() -> list[type[msgspec.Struct]]:
    """The messages of the topics, then those that stand in them, in order of first mention."""
    kinds: list[type[msgspec.Struct]] = [*dict.fromkeys(native.TOPICS.values())]
    kinds.append(native.RepairedColumns)
    for kind in kinds:
        inner = chain.from_iterable(map(_structs, get_type_hints(kind).values()))
        kinds += [part for part in dict.fromkeys(inner) if part not in kinds]
    return kinds


def _section(kind: type[msgspec.Struct]) -> list[str]:
    """The lines about a message: what it is, and a table of its fields."""
    lines = ["", f"### {kind.__name__}", "", cleandoc(kind.__doc__ or "")]
    if kind in native.BLOCKS:
        block = native.BLOCKS[kind].__name__
        lines.append(f"As `{block}`: `log_time_ns`, and a list of each of these.")
    lines += ["", "| field | type | |", "|---|---|---|"]
    hints = get_type_hints(kind)
    for field in msgspec.structs.fields(kind):
        needed = "needed" if field.required else "optional"
        lines.append(f"| `{field.encode_name}` | {_type(hints[field.name])} | {needed} |")
    return lines


def _structs(hint: Any) -> Iterator[type[msgspec.Struct]]:
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        yield hint
    for part in get_args(hint):
        yield from _structs(part)


def _type(hint: Any) -> str:
    origin, args = get_origin(hint), get_args(hint)
    if hint in _NAMES:
        return _NAMES[hint]
    if origin in (Union, UnionType):
        return " or ".join(_type(arg) for arg in args)
    if origin is Literal or (isinstance(hint, type) and issubclass(hint, Enum)):
        return ", ".join(f'"{value}"' for value in (args or [member.value for member in hint]))
    if origin is dict:
        return f"object of {_type(args[1])}"
    if origin is tuple and args[-1] is not ...:
        return f"list of {len(args)} of {_type(args[0])}"
    return f"list of {_type(args[0])}" if origin in (list, tuple) else _link(hint)


def _link(kind: type[msgspec.Struct]) -> str:
    return f"[{kind.__name__}](#{kind.__name__.lower()})"
