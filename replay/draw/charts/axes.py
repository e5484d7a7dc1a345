"""A plot area of a chart, with a scale in x and in y, ticks, and titles with units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from logs.arrays import FloatArray
from replay.draw.charts.canvas import LETTER_PX, px, text, window
from replay.draw.model import ticks

LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 46.0, 10.0, 38.0, 30.0
"""Margins of a plot area: for y ticks, for the last x tick, for title and legend, for x ticks and their title."""
TICK_PX = 62.0, 30.0
"""Smallest distance between ticks in x and in y if there are more than two ticks, pixels."""


def number(value: float) -> str:
    """A tick as text; values below 1e-12 are shown as 0."""
    return f"{0.0 if abs(value) < 1e-12 else value:.6g}".replace("-", "\u2212")


@dataclass(frozen=True)
class Plane:
    """A plot area.

    Attributes:
        x: Range of the values; `y` likewise.
        width: Width of the whole chart, pixels; `height` likewise.
        left: Margin at the left for ticks or words, pixels.
        top: Margin above, pixels.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    width: float
    height: float
    left: float = LEFT_PX
    top: float = TOP_PX

    @property
    def inner(self) -> tuple[float, float]:
        """Width and height of the plot area, pixels."""
        return self.width - self.left - RIGHT_PX, self.height - self.top - BOTTOM_PX

    def at_x(self, x: FloatArray | float) -> FloatArray:
        """Pixels from the left edge of the plot area."""
        return (np.asarray(x, np.float64) - self.x[0]) * (self.inner[0] / (self.x[1] - self.x[0]))

    def at_y(self, y: FloatArray | float) -> FloatArray:
        """Pixels from the upper edge of the plot area."""
        return (self.y[1] - np.asarray(y, np.float64)) * (self.inner[1] / (self.y[1] - self.y[0]))

    def drawn(self, inside: str, *, x_title: str, y_title: str = "", y_ticks: bool = True, over: str = "") -> str:
        """Elements with grid, ticks and titles around them; `over` is drawn last and not clipped."""
        wide, high = self.inner
        marks = ticks(*self.x, int(wide / TICK_PX[0]))
        at = self.at_x(marks).tolist()
        columns = "".join(f"M{px(x)} 0V{px(high)}" for x in at)
        labels = "".join(
            f'<text x="{px(min(max(x, 4.0), wide - 4.0))}" y="{px(high + 13.0)}">{number(mark)}</text>'
            for x, mark in zip(at, marks.tolist(), strict=True)
        )
        grid, words = f'<path class="grid" d="{columns}"/>', f'<g class="tick mid">{labels}</g>'
        if y_ticks:
            marks = ticks(*self.y, int(high / TICK_PX[1]))
            at = self.at_y(marks).tolist()
            rows = "".join(f"M0 {px(y)}H{px(wide)}" for y in at)
            labels = "".join(
                f'<text x="-5" y="{px(y + 3.5)}">{number(mark)}</text>'
                for y, mark in zip(at, marks.tolist(), strict=True)
            )
            grid += f'<path class="grid" d="{rows}"/>'
            words += f'<g class="tick end">{labels}</g>'
        frame = f'<path class="axis" d="M0 0V{px(high)}H{px(wide)}"/>'
        titles = text(self.left + wide, self.height - 3.0, x_title, "tick end")
        titles += text(2.0, self.top - 5.0, y_title, "tick") if y_title else ""
        plot = window(self.left, self.top, wide, high, grid + inside + frame)
        return plot + f'<g transform="translate({self.left:g} {self.top:g})">{words}{over}</g>' + titles


def for_words(plane: Plane, words: Sequence[str], most: float) -> Plane:
    """The plane with a left margin that is wide enough for some words, at most `most` pixels."""
    needed = max((LETTER_PX * len(word) + 10.0 for word in words), default=LEFT_PX)
    return replace(plane, left=min(max(needed, LEFT_PX), most))
