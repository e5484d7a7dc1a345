"""The door to the terminal: what comes from logs, planners and messages moves no cursor and sets no colour."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from logs.words import VISIBLE

_TABLE = {code: sign for code, sign in VISIBLE.items() if chr(code) not in "\n\t"}
"""`VISIBLE` without the ends of lines and tabs."""


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
