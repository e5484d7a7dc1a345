"""Words as messages show them: counts, and texts that come from outside."""

from __future__ import annotations


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
