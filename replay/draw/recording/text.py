"""Text for the viewer: only characters that its font can draw, and entity paths from names of users.

A glyph that the viewer's font lacks terminates the headless viewer, so every text goes through `plain` (one line),
`cell` (one line inside Markdown) or `document` (our own Markdown). Many names come from users.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable
from pathlib import Path

import rerun as rr

MARKDOWN = "text/markdown"
_ASCII = frozenset(chr(code) for code in range(0x20, 0x7F))
_LATIN = frozenset(chr(code) for code in range(0xA1, 0x100) if code != 0xAD)
_GREEK = frozenset("ΑΒΓΔΕΖΗΘΙΚΛΜΝΞΟΠΡΣΤΥΦΧΨΩαβγδεζηθικλμνξοπρςστυφχψω")
DRAWABLE = _ASCII | _LATIN | _GREEK | frozenset("≤≥√∑→←↑↓")
"""The characters that the viewer's font has (tried with the headless viewer)."""

_MARKDOWN = str.maketrans({mark: f"\\{mark}" for mark in "\\`*_[]<>|#~"})


def plain(text: object) -> str:
    """One line of drawable characters: white space becomes a space, any other character "?"."""
    composed = unicodedata.normalize("NFC", " ".join(str(text).split()))
    return _drawable(composed)


def cell(text: object) -> str:
    """One line inside Markdown: special characters of Markdown are escaped."""
    return plain(text).translate(_MARKDOWN)


def document(lines: Iterable[str]) -> str:
    """Our own Markdown, made drawable; names of users in it must have been escaped by `cell`."""
    return "\n".join(map(_drawable, lines))


def _drawable(text: str) -> str:
    return text if DRAWABLE.issuperset(text) else "".join(mark if mark in DRAWABLE else "?" for mark in text)


class Marked(str):
    """A cell of a table that is our own Markdown."""


def link(words: object, file: Path) -> Marked:
    """A link that opens a recording; the words alone if its path cannot be drawn."""
    path = file.as_posix()
    can = DRAWABLE.issuperset(path) and not set("<>|\\") & set(path)
    return Marked(f"[{cell(words)}](<{path}>)" if can else cell(words))


def table(header: Iterable[str], rows: Iterable[Iterable[object]]) -> list[str]:
    """The lines of a Markdown table, with an empty line before and after it."""
    names = list(header)
    body = [
        "| " + " | ".join(value if isinstance(value, Marked) else cell(value) for value in row) + " |" for row in rows
    ]
    return ["", "| " + " | ".join(names) + " |", "|" + " --- |" * len(names), *body, ""]


def path_parts(words: Iterable[str]) -> dict[str, str]:
    """An escaped part of an entity path for each distinct word; different words never share one."""
    parts: dict[str, str] = {}
    for word in words:
        if word not in parts:
            name, count = plain(word) or "?", 1
            while (part := rr.escape_entity_path_part(name)) in parts.values():
                count += 1
                name = f"{plain(word) or '?'} {count}"
            parts[word] = part
    return parts


def field_name(word: str) -> str:
    """A word as a name of a recording property: letters, digits and underscores."""
    return "".join(mark if mark.isascii() and mark.isalnum() else "_" for mark in word) or "_"


def application_name(words: str) -> str:
    """The name under which the viewer stores a layout: at most 100 characters of a small set."""
    return "".join(mark if mark.isascii() and (mark.isalnum() or mark in " _-") else "-" for mark in words)[:100]
