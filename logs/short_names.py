"""Short names of road users: "car 23f7" where the log says "car 23f7a1c8-0d5e-4b8e-9a53-6a3ef1f0c2b4".

Sentences and pictures show them; files, and columns of tables that hold an id, keep the whole id. Only codes are
shortened: runs of more than `LONGEST` hexadecimal digits and dashes, with a digit (UUIDs, tokens, long numbers), which
are an id or a part of one ("copy of 23f7"). The short name of a code is its shortest prefix of at least `LEAST`
characters that begins no other word; suffixes are taken where these are shorter by a character or more in the mean.
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
        self._of = min(_prefixes(words), _suffixes(words), key=_mean_length)
        if len({self(name) for name in self._ids}) < len(self._ids):
            self._of = {}

    def __call__(self, text: str) -> str:
        """An id, or a text with ids in it, with their short names."""
        return _CODE.sub(lambda found: self._of.get(found[0], found[0]), text)

    def whole(self, name: str) -> str:
        """The id of a road user by its short name; the name itself where it is an id, or unknown."""
        return name if name in self._ids else next((each for each in self._ids if self(each) == name), name)


def _mean_length(found: dict[str, str]) -> int:
    return sum(map(len, found.values())) // max(len(found), 1)


def _prefixes(words: list[str]) -> dict[str, str]:
    """Of each code among the sorted words its shortest prefix that begins no other word."""
    shared = [0, *(sum(takewhile(bool, map(eq, *pair))) for pair in pairwise(words)), 0]
    least = [max(LEAST, 1 + max(pair)) for pair in pairwise(shared)]
    return {word: word[:size] for word, size in zip(words, least, strict=False) if _CODE.fullmatch(word)}


def _suffixes(words: list[str]) -> dict[str, str]:
    """The same of suffixes."""
    found = _prefixes(sorted(word[::-1] for word in words))
    return {word[::-1]: short[::-1] for word, short in found.items()}
