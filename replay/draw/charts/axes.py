"""Axes: a plot area with a scale in x and in y, "nice" ticks, titles with units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, floor, log10

import numpy as np

from logs.kernel import FloatArray
from replay.draw.charts.canvas import LETTER_PX, px, text, window

LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX = 46.0, 10.0, 38.0, 30.0
"""Room around a plot area: for y ticks, for the last x tick, for title and legend, for x ticks and their title."""
TICK_PX = 62.0, 30.0
"""Ticks are not nearer than this, in x and in y, where there are more than two."""


def ticks(low: float, high: float, most: int) -> FloatArray:
    """Multiples of 1, 2, 2.5 or 5 times a power of ten within a range: two at least, about `most` at most."""
    for bins in range(max(most, 2), 40):
        found = _multiples(low, high, bins)
        if len(found) > 1:
            return found
    return np.array([low, high])


def _multiples(low: float, high: float, bins: int) -> FloatArray:
    """The multiples, within a range, of the least nice step that gives at most so many intervals."""
    rough = (high - low) / bins
    unit = 10.0 ** floor(log10(rough))
    step = next(unit * nice for nice in (1.0, 2.0, 2.5, 5.0, 10.0) if unit * nice >= rough * (1.0 - 1e-9))
    return np.arange(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1) * step


def number(value: float) -> str:
    """A tick as text; a tick that is next to nothing is nothing."""
    return f"{0.0 if abs(value) < 1e-12 else value:.6g}".replace("-", "\u2212")


def spread(low: float, high: float, least: float, room: float = 0.06) -> tuple[float, float]:
    """A range with some room, never shorter than `least`: what is still looks still."""
    half = max((0.5 + room) * (high - low), 0.5 * least)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half


@dataclass(frozen=True)
class Plane:
    """A plot area.

    Attributes:
        x: Range of the values; `y` likewise.
        width: Of the whole chart, pixels; `height` likewise.
        left: Room at the left for ticks or words, pixels.
        top: Room above, pixels.
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
        """Grid, ticks and titles around what is inside; `over` is not cut off."""
        wide, high = self.inner
        grid, labels = self._columns()
        if y_ticks:
            rows, beside = self._rows()
            grid, labels = grid + rows, labels + beside
        frame = f'<path class="axis" d="M0 0V{px(high)}H{px(wide)}"/>'
        titles = text(self.left + wide, self.height - 3.0, x_title, "tick end")
        titles += text(2.0, self.top - 5.0, y_title, "tick") if y_title else ""
        plot = window(self.left, self.top, wide, high, grid + inside + frame)
        return plot + f'<g transform="translate({self.left:g} {self.top:g})">{labels}{over}</g>' + titles

    def _columns(self) -> tuple[str, str]:
        wide, high = self.inner
        marks = ticks(*self.x, int(wide / TICK_PX[0]))
        at = self.at_x(marks).tolist()
        grid = "".join(f"M{px(x)} 0V{px(high)}" for x in at)
        labels = "".join(
            f'<text x="{px(min(max(x, 4.0), wide - 4.0))}" y="{px(high + 13.0)}">{number(mark)}</text>'
            for x, mark in zip(at, marks.tolist(), strict=True)
        )
        return f'<path class="grid" d="{grid}"/>', f'<g class="tick mid">{labels}</g>'

    def _rows(self) -> tuple[str, str]:
        wide, high = self.inner
        marks = ticks(*self.y, int(high / TICK_PX[1]))
        at = self.at_y(marks).tolist()
        grid = "".join(f"M0 {px(y)}H{px(wide)}" for y in at)
        labels = "".join(
            f'<text x="-5" y="{px(y + 3.5)}">{number(mark)}</text>' for y, mark in zip(at, marks.tolist(), strict=True)
        )
        return f'<path class="grid" d="{grid}"/>', f'<g class="tick end">{labels}</g>'


def for_words(plane: Plane, words: Sequence[str], most: float) -> Plane:
    """The plane with as much room at its left as the words need, at most `most` pixels."""
    needed = max((LETTER_PX * len(word) + 10.0 for word in words), default=LEFT_PX)
    return replace(plane, left=min(max(needed, LEFT_PX), most))
