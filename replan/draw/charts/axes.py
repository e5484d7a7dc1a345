"""A plot area of a chart, with a scale in x and in y, ticks, and titles with units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from replan.core.arrays import FloatArray
from replan.draw.charts.chart import Chart
from replan.draw.charts.legend import LEGEND_PX, Entry, legend, legend_rows
from replan.draw.charts.svg import (
    LETTER_PX,
    area,
    group,
    polyline,
    px,
    rect,
    shortened,
    text,
    window,
)
from replan.draw.spans import Span, ticks

Ticks = Sequence[tuple[float, str]]  # Words at values

LEFT_PX, RIGHT_PX = 46.0, 10.0
TOP_PX, BOTTOM_PX = 38.0, 30.0
"""Margins of a plot area: for y ticks, for the last x tick, for title and legend, for x ticks and
their title.
"""
FAINT = 0.08  # Opacity of a box of the value 0
# Smallest distance between ticks in x and in y if there are more than two ticks, pixels
TICK_PX = 62.0, 30.0


def number(value: float) -> str:
    """A tick as text; values below 1e-12 are shown as 0."""
    return f"{0.0 if abs(value) < 1e-12 else value:.6g}".replace("-", "\u2212")


@dataclass(frozen=True)
class Plane:
    """A plot area."""

    x: tuple[float, float]  # Range of the values; `y` likewise
    y: tuple[float, float]
    width: float  # Width of the whole chart, pixels; `height` likewise
    height: float
    left: float = LEFT_PX  # Margin at the left for ticks or words, pixels
    top: float = TOP_PX  # Margin above, pixels

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

    def line(self, x: FloatArray, y: FloatArray, kind: str) -> str:
        """A line of values `(n,)`."""
        return polyline(self.at_x(x), self.at_y(y), kind)

    def area(self, x: FloatArray, y: FloatArray, kind: str) -> str:
        """A closed outline of values `(n,)`."""
        return area(self.at_x(x), self.at_y(y), kind)

    def box(
        self, x: Span, y: Span, kind: str, about: str = "", opacity: float = 1.0, gap: float = 0.0
    ) -> str:
        """A box from lower to upper values, `gap` pixels smaller on each side; `about` is its
        tooltip.
        """
        (left, right), (low, high) = (
            self.at_x(np.array(x)).tolist(),
            self.at_y(np.array(y)).tolist(),
        )
        inner = max(right - left - 2.0 * gap, 1.0), max(low - high - 2.0 * gap, 1.0)
        return rect(left + gap, high + gap, *inner, kind, about, opacity)

    def sign(self, x: float, y: float, sign: str, kind: str = "") -> str:
        """A letter or a sign at a point."""
        return text(float(self.at_x(x)), float(self.at_y(y)) + 5.0, sign, f"sign {kind}".rstrip())

    def words(self, x: float, y: float, words: str, kind: str = "middle", down: float = 4.0) -> str:
        """Words at a point, `down` pixels below it."""
        return text(float(self.at_x(x)), float(self.at_y(y)) + down, words, kind)

    def heat(self, x: Span, y: Span, value: float, limits: Span) -> str:
        """A box whose colour tells a value: blue the more, the nearer to the upper limit.

        Red below 0.
        """
        share = abs(value) / (limits[0] if value < 0.0 else limits[1])
        return self.box(
            x,
            y,
            "red" if value < 0.0 else "blue",
            f"{value:.3g}",
            min(FAINT + abs(share), 1.0),
            0.5,
        )

    def drawn(
        self,
        inside: str,
        *,
        x_title: str,
        y_title: str = "",
        x_ticks: Ticks | None = None,
        y_ticks: Ticks | None = None,
        over: str = "",
    ) -> str:
        """Elements with grid, ticks and titles around them; `over` is drawn last and not clipped.

        `x_ticks`, `y_ticks`: words at values, without a grid; None: round numbers.
        """
        wide, high = self.inner
        columns = rows = columns_at = rows_at = ""
        if x_ticks is None:
            marks = ticks(*self.x, int(wide / TICK_PX[0])).tolist()
            x_ticks = [(mark, number(mark)) for mark in marks]
            columns = "".join(f"M{px(x)} 0V{px(high)}" for x in self.at_x(np.array(marks)).tolist())
        if y_ticks is None:
            marks = ticks(*self.y, int(high / TICK_PX[1])).tolist()
            y_ticks = [(mark, number(mark)) for mark in marks]
            rows = "".join(f"M0 {px(y)}H{px(wide)}" for y in self.at_y(np.array(marks)).tolist())
        for value, word in x_ticks:
            columns_at += text(
                min(max(float(self.at_x(value)), 4.0), wide - 4.0), high + 13.0, word
            )
        for value, word in y_ticks:
            shown = shortened(word, self.left - 8.0)
            rows_at += text(
                -5.0, float(self.at_y(value)) + 3.5, shown, about="" if shown == word else word
            )
        plot = (
            f'<path class="grid" d="{columns}{rows}"/>{inside}<path class="axis" d="M0 '
            f'0V{px(high)}H{px(wide)}"/>'
        )
        words = f'<g class="tick middle">{columns_at}</g><g class="tick end">{rows_at}</g>{over}'
        titles = text(self.left + wide, self.height - 3.0, x_title, "tick end")
        titles += text(2.0, self.top - 10.0, y_title, "tick") if y_title else ""
        return (
            window(self.left, self.top, wide, high, plot)
            + group(self.left, self.top, words)
            + titles
        )

    def chart(
        self,
        name: str,
        title: str,
        inside: str,
        *,
        says: str = "",
        entries: Sequence[Entry] = (),
        head: str = "",
        x_title: str = "",
        y_title: str = "",
        x_ticks: Ticks | None = None,
        y_ticks: Ticks | None = None,
        over: str = "",
    ) -> Chart:
        """A chart of this plot area: a title (or the longer `head`), and a legend in as many rows
        as it needs.
        """
        begin = 2.0 + LETTER_PX * len(y_title) + 14.0 if y_title else min(self.left, LEFT_PX)
        rows = legend_rows(entries, self.width - begin)
        more = LEGEND_PX * max(len(rows) - 1, 0)
        plane = replace(self, top=self.top + more, height=self.height + more)
        drawn = plane.drawn(
            inside, x_title=x_title, y_title=y_title, x_ticks=x_ticks, y_ticks=y_ticks, over=over
        )
        drawn += text(2.0, 13.0, shortened(head or title, self.width), "title")
        drawn += "".join(
            legend(begin, self.top - 10.0 + LEGEND_PX * k, row) for k, row in enumerate(rows)
        )
        return Chart(name, title, says or title, self.width, plane.height, drawn)


def rows_plane(
    names: Sequence[str], x: Span, width: float, row: float, *, top: float = TOP_PX, most: float
) -> tuple[Plane, Ticks]:
    """A plot area with rows of a height, from the top down, and their names at the left, at most
    `most` pixels wide.
    """
    high = float(len(names))
    needed = max((LETTER_PX * len(name) + 10.0 for name in names), default=LEFT_PX)
    plane = Plane(
        x, (0.0, high), width, top + row * high + BOTTOM_PX, min(max(needed, LEFT_PX), most), top
    )
    return plane, [(high - 0.5 - k, name) for k, name in enumerate(names)]
