"""Formats names and counts for messages: short names of road users, printable text, "2 agents", "a,
b and 3 more".

For the id "car 23f7a1c8-0d5e-4b8e-9a53-6a3ef1f0c2b4" in a log, the short name is "car 23f7".
Sentences and pictures show short names. Files, and columns of tables that hold an id, keep the
whole id. Only codes are shortened: runs of more than `LONGEST` hexadecimal digits and dashes, with
at least one digit (UUIDs, tokens, long numbers). A code is a whole id or a part of one ("copy of
23f7"). The short name of a code is its shortest prefix of at least `LEAST` characters with which no
other id or code begins. Suffixes are used instead where they are shorter by about a character or
more on average.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Sequence
from itertools import pairwise, takewhile
from operator import eq

LONGEST, LEAST = 8, 4
"""Characters: a longer code is shortened, to this many at least."""
_CODE = re.compile(
    rf"(?<![0-9A-Za-z-])(?=[A-Fa-f-]*[0-9])[0-9A-Fa-f][0-9A-Fa-f-]{{{LONGEST - 1},}}[0-9A-Fa-f](?![0-9A-Za-z-])"  # noqa: E501
)


class ShortNames:
    """The short names of one drive, from the ids of all its road users in any order
    (`Scenario.short_names`).

    No two ids have the same short name: if two short names were equal, all ids of the drive stay
    whole.
    """

    def __init__(self, ids: Iterable[str]) -> None:
        self._ids = sorted(set(ids))
        words = sorted({word for name in self._ids for word in _CODE.findall(name) or [name]})
        ends = _prefixes(sorted(word[::-1] for word in words))
        suffixes = {word[::-1]: short[::-1] for word, short in ends.items()}
        candidates = _prefixes(words), suffixes
        self._of = min(
            candidates, key=lambda short: sum(map(len, short.values())) // max(len(short), 1)
        )
        if len({self(name) for name in self._ids}) < len(self._ids):
            self._of = {}

    def __call__(self, text: str) -> str:
        """Return an id, or a text that contains ids, with each id replaced by its short name."""
        return _CODE.sub(lambda match: self._of.get(match[0], match[0]), text)

    def whole(self, name: str) -> str:
        """Return the id that has this short name; the name itself if it is an id or is unknown."""
        if name in self._ids:
            return name
        return next((whole_name for whole_name in self._ids if self(whole_name) == name), name)


def _prefixes(words: list[str]) -> dict[str, str]:
    """Map each code among the sorted words to its shortest prefix with which no other word
    begins.
    """
    shared = [0, *(sum(takewhile(bool, map(eq, *pair))) for pair in pairwise(words)), 0]
    least = [max(LEAST, 1 + max(pair)) for pair in pairwise(shared)]
    return {
        word: word[:size] for word, size in zip(words, least, strict=False) if _CODE.fullmatch(word)
    }


def counted(count: int, thing: str) -> str:
    """Return a count with its noun: "1 agent", "2 agents", "0 buses"."""
    if count == 1:
        return f"1 {thing}"
    return f"{count} {thing}{'es' if thing.endswith(('s', 'x', 'ch')) else 's'}"


def listed(texts: Sequence[str], most: int) -> str:
    """Join the first `most` texts; the others are counted: "a, b and 3 more"."""
    return ", ".join(texts[:most]) + (f" and {len(texts) - most} more" if len(texts) > most else "")


def told_apart(names: Sequence[str], digests: Sequence[str]) -> list[str]:
    """The names of logs, of which the first of a name keeps it.

    Each later one gets "@" and the begin of its digest, or its place where it has none.
    """
    apart, used = list[str](), set[str]()
    for number, (name, digest) in enumerate(zip(names, digests, strict=True), 1):
        apart.append(f"{name}@{digest[:8] or number}" if name in used else name)
        used.add(name)
    return apart


_UNSEEN = [
    *range(0x80, 0xA0),
    0x61C,
    0x200E,
    0x200F,
    *range(0x2028, 0x202F),
    *range(0x2066, 0x206A),
    0xFEFF,
]
VISIBLE = (
    {code: 0x2400 + code for code in range(32)} | {0x7F: 0x2421} | dict.fromkeys(_UNSEEN, 0xFFFD)
)
"""Maps control characters to their pictures (escape: U+241B).

Those of C1 and of text direction to U+FFFD.
"""
LONGEST_NAME = 120
"""Greatest number of characters of a name; longer names are cut."""


def visible_name(text: str, most: float = LONGEST_NAME) -> str:
    """Return the text as one line of at most `most` printable characters that UTF-8 can encode."""
    if text.isascii() and text.isprintable() and len(text) <= most:
        return text
    shown = text.translate(VISIBLE).encode("utf-8", "replace").decode("utf-8")
    return shown if len(shown) <= most else f"{shown[: int(most) - 1]}\u2026"


def first_paragraph(thing: object) -> str:
    """Return the first paragraph of a docstring, in one line; "" if there is none."""
    return " ".join((inspect.getdoc(thing) or "").partition("\n\n")[0].split())
