"""SVG elements as text, with few and short numbers.

Coordinates are CSS pixels, x to the right and y down, rounded to a tenth; points that do not move a
line by more than `KEPT_PX` are dropped. `kind` is a class of style.py, or several.
"""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

import numpy as np

from replan.core.arrays import FloatArray
from replan.draw.charts.simplify import runs, simplified

LETTER_PX = 5.9  # Mean width of a letter at the font size of charts
# Coordinates are clipped to +- this value: no picture is taller, and renderers lose digits beyond
FAR_PX = 20_000.0


def px(value: float) -> str:
    """A coordinate as text: "12.3", "12", ".5"."""
    return _tenths(round(10.0 * min(max(float(value), -FAR_PX), FAR_PX)))


def _tenths(tenths: int) -> str:
    whole, part = divmod(abs(tenths), 10)
    text = f"{whole or ''}.{part}" if part else str(whole)
    return f"-{text}" if tenths < 0 else text


def polyline(x: FloatArray, y: FloatArray, kind: str) -> str:
    """A line `(n,)`; values that are not finite are gaps, single points are dots."""
    points = np.column_stack([x, y])
    pieces = runs(np.isfinite(x) & np.isfinite(y))
    return _path("".join(_moves(points[begin:end], closed=False) for begin, end in pieces), kind)


def area(x: FloatArray, y: FloatArray, kind: str) -> str:
    """A closed outline `(n,)`, n >= 3; points that are not finite are left out."""
    known = np.isfinite(x) & np.isfinite(y)
    return areas([np.column_stack([x[known], y[known]])], kind)


def areas(outlines: Iterable[FloatArray], kind: str) -> str:
    """Several closed outlines `(n, 2)` as one element."""
    return _path(
        "".join(_moves(outline, closed=True) for outline in outlines if len(outline) > 2), kind
    )


def polylines(lines: Iterable[FloatArray], kind: str) -> str:
    """Several lines `(n, 2)` as one element."""
    return _path("".join(_moves(line, closed=False) for line in lines if len(line) > 1), kind)


def _path(moves: str, kind: str) -> str:
    return f'<path class="{kind}" d="{moves}"/>' if moves else ""


def _moves(points: FloatArray, *, closed: bool) -> str:
    """The commands of a path: a start, then steps between rounded points, so that rounding errors
    do not accumulate.
    """
    shown = np.clip(points, -FAR_PX, FAR_PX)
    tenths = np.rint(10.0 * shown[simplified(shown)]).astype(np.int64)
    first, steps = tenths[0].tolist(), np.diff(tenths, axis=0)
    steps = steps[(steps != 0).any(axis=1)].tolist()
    begin, end = f"M{_tenths(first[0])}{_after(first[1])}", "z" if closed else ""
    if not steps:
        return f"{begin}h.1{end}"
    return f"{begin}l{' '.join(f'{_tenths(right)}{_after(down)}' for right, down in steps)}{end}"


def _after(tenths: int) -> str:
    """The second number of a pair, after a space unless its minus sign separates it from the
    first.
    """
    return _tenths(tenths) if tenths < 0 else f" {_tenths(tenths)}"


def rect(
    x: float,
    y: float,
    width: float,
    height: float,
    kind: str,
    about: str = "",
    opacity: float = 1.0,
) -> str:
    """A box; `about` is its tooltip."""
    inner = f"><title>{escape(about)}</title></rect>" if about else "/>"
    place = f'x="{px(x)}" y="{px(y)}" width="{px(max(width, 0.0))}" height="{px(height)}"'
    faint = f' fill-opacity="{opacity:.2g}"' if opacity < 1.0 else ""
    return f'<rect class="{kind}" {place}{faint}{inner}'


def line(x0: float, y0: float, x1: float, y1: float, kind: str) -> str:
    """A straight line."""
    return f'<path class="{kind}" d="M{px(x0)} {px(y0)}L{px(x1)} {px(y1)}"/>'


def dot(x: float, y: float, radius: float, kind: str, about: str = "") -> str:
    """A dot; `about` is its tooltip."""
    inner = f"><title>{escape(about)}</title></circle>" if about else "/>"
    return f'<circle class="{kind}" cx="{px(x)}" cy="{px(y)}" r="{px(radius)}"{inner}'


def text(x: float, y: float, words: str, kind: str = "", *, about: str = "") -> str:
    """Words that begin at x, end there (class "end"), or are centred there ("middle")."""
    title = f"<title>{escape(about)}</title>" if about else ""
    style = f' class="{kind}"' if kind else ""
    return f'<text{style} x="{px(x)}" y="{px(y)}">{escape(printable(words))}{title}</text>'


def printable(words: str) -> str:
    """The words in one line, without control characters (names of logs and agents come from
    outside).
    """
    return "".join(c if c.isprintable() else " " for c in words)


def shortened(words: str, width: float) -> str:
    """The words, cut to a width in pixels."""
    most_letters = max(int(width / LETTER_PX), 2)
    return words if len(words) <= most_letters else f"{words[: most_letters - 1]}\u2026"


def window(x: float, y: float, width: float, height: float, inside: str) -> str:
    """Elements with their own origin, clipped to a box."""
    place = f'x="{px(x)}" y="{px(y)}" width="{px(width)}" height="{px(height)}"'
    return f'<svg {place} overflow="hidden">{inside}</svg>'


def group(x: float, y: float, inside: str) -> str:
    """Elements with their own origin."""
    return f'<g transform="translate({px(x)} {px(y)})">{inside}</g>'
