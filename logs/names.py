"""Names and counts as messages show them: short names of road users, texts from outside, "2 agents".

A short name is "car 23f7" where the log says "car 23f7a1c8-0d5e-4b8e-9a53-6a3ef1f0c2b4". Sentences and pictures show
short names. Files, and columns of tables that hold an id, keep the whole id. Only codes are shortened: runs of more
than `LONGEST` hexadecimal digits and dashes, with a digit (UUIDs, tokens, long numbers), which are an id or a part of
one ("copy of 23f7"). The short name of a code is its shortest prefix of at least `LEAST` characters that begins no
other word. Suffixes are used where they are shorter by a character or more on average.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import pairwise, takewhile
from operator import eq

LONGEST, LEAST = 8, 4
_CODE = re.compile(
    rf"(?<![0-9A-Za-z-])(?=[A-Fa-f-]*[0-9])[0-9A-Fa-f][0-9A-Fa-f-]{{{LONGEST - 1},}}[0-9A-Fa-f](?![0-9A-Za-z-])"
)


class ShortNames:
    """The short names of one drive, from the ids of all its road users in any order (`Scenario.short_names`).

    No two ids have the same short name: where short names would be the same, every id stays whole.
    """

    def __init__(self, ids: Iterable[str]) -> None:
        self._ids = sorted(set(ids))
        words = sorted({word for name in self._ids for word in _CODE.findall(name) or [name]})
        ends = _prefixes(sorted(word[::-1] for word in words))
        suffixes = {word[::-1]: short[::-1] for word, short in ends.items()}
        found = _prefixes(words), suffixes
        self._of = min(found, key=lambda short: sum(map(len, short.values())) // max(len(short), 1))
        if len({self(name) for name in self._ids}) < len(self._ids):
            self._of = {}

    def __call__(self, text: str) -> str:
        """An id, or a text with ids in it, with their short names."""
        return _CODE.sub(lambda found: self._of.get(found[0], found[0]), text)

    def whole(self, name: str) -> str:
        """The id of a road user by its short name; the name itself where it is an id, or unknown."""
        return name if name in self._ids else next((each for each in self._ids if self(each) == name), name)


def _prefixes(words: list[str]) -> dict[str, str]:
    """Of each code among the sorted words its shortest prefix that begins no other word."""
    shared = [0, *(sum(takewhile(bool, map(eq, *pair))) for pair in pairwise(words)), 0]
    least = [max(LEAST, 1 + max(pair)) for pair in pairwise(shared)]
    return {word: word[:size] for word, size in zip(words, least, strict=False) if _CODE.fullmatch(word)}


def counted(count: int, thing: str) -> str:
    """A number of things: "1 agent", "2 agents", "0 buses"."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}{'es' if thing.endswith(('s', 'x', 'ch')) else 's'}"


_UNSEEN = [*range(0x80, 0xA0), 0x61C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A), 0xFEFF]
VISIBLE = {code: 0x2400 + code for code in range(32)} | {0x7F: 0x2421} | dict.fromkeys(_UNSEEN, 0xFFFD)
"""Control characters as their pictures (escape: U+241B); those of C1 and of the direction of text as U+FFFD."""
LONGEST_NAME = 120
"""Characters of a name; a longer one is cut."""


def visible_name(text: str, most: float = LONGEST_NAME) -> str:
    """The text in one line of at most `most` characters, each of which can be seen and encoded."""
    if text.isascii() and text.isprintable() and len(text) <= most:
        return text
    shown = text.translate(VISIBLE).encode("utf-8", "replace").decode("utf-8")
    return shown if len(shown) <= most else f"{shown[: int(most) - 1]}\u2026"
