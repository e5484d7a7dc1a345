"""The door to the terminal: what comes from logs, planners and messages moves no cursor and sets no colour."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

_CONTROLS = {code: 0x2400 + code for code in range(32) if chr(code) not in "\n\t"} | {0x7F: 0x2421}
_UNSEEN = [*range(0x80, 0xA0), 0x61C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A)]
_TABLE = _CONTROLS | dict.fromkeys(_UNSEEN, 0xFFFD)
"""Control characters as their pictures (escape: U+241B); those of C1 and of the direction of text as U+FFFD."""


def visible(text: object) -> str:
    """The text with control characters that can be seen, each as one character; lines and tabs stay."""
    return str(text).translate(_TABLE)


class SafeConsole(Console):
    """A console that styles its own words alone: what is in the texts is `visible`."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """As Console's; sequences of rich's own are segments of control, and stay."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=visible(segment.text))


def encode_all() -> None:
    """What a terminal's encoding lacks is written as "?"."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure: Any = getattr(stream, "reconfigure", None)
        with suppress(ValueError, OSError):
            if reconfigure is not None:
                reconfigure(errors="replace")
