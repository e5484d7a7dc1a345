"""The layer under the charts: one style, and SVG elements as text, with few and short numbers.

Roles are colours for a light and a dark background. The hues are those of Okabe and Ito (2008),
which people with any colour vision can distinguish, lighter on the dark background. No meaning
depends on colour alone: lines differ in dash, marks in shape, and everything has a label.

Coordinates are CSS pixels, x to the right and y down, rounded to a tenth; points that do not move a
line by more than `KEPT_PX` are dropped. Elements are styled by class names only, and there is no
script and no id, so that any number of charts can be in one page.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.errors import ConfigError, writing
from replan.results.tables import write_png, write_text

Theme = Literal["auto", "light", "dark"]

LIGHT = MappingProxyType(
    {
        "ground": "#ffffff",
        "panel": "#f6f7f9",
        "ink": "#1b1f24",
        "muted": "#57606a",
        "grid": "#e4e7eb",
        "axis": "#9aa3ad",
        "ego": "#0072b2",
        "plan": "#007a59",
        "other": "#b06f00",
        "rare": "#a8487c",
        "bad": "#c04a00",
        "good": "#007a59",
        "unsure": "#7a5f00",
        "road": "#eceef1",
        "walk": "#f7f3ea",
        "lane": "#b3bac3",
        "free": "#009e73",
        "focus": "#0072b2",
    }
)
DARK = MappingProxyType(
    {
        "ground": "#14171b",
        "panel": "#1c2026",
        "ink": "#e6e9ed",
        "muted": "#a3acb7",
        "grid": "#2b3138",
        "axis": "#5d6773",
        "ego": "#56b4e9",
        "plan": "#37c99b",
        "other": "#e69f00",
        "rare": "#e394bd",
        "bad": "#ff8547",
        "good": "#37c99b",
        "unsure": "#f0e442",
        "road": "#252a31",
        "walk": "#2a2822",
        "lane": "#59626d",
        "free": "#37c99b",
        "focus": "#7cc8f5",
    }
)
"""Roles by name: `ego` blue, `plan` green, `other` road users orange, `rare` purple, `bad`
vermilion.
"""

FONT = "'DejaVu Sans', Verdana, 'Segoe UI', system-ui, sans-serif"
RULES = """
.chart{font:11px FONT}
.chart text{fill:$ink}
.chart .small{font-size:10px;fill:$muted}
.chart .tick,.chart .tick text{font-size:10px;fill:$muted}
.chart .name{paint-order:stroke;stroke:$ground;stroke-width:3px;stroke-linejoin:round}
.chart .title{font-weight:bold}
.chart .end{text-anchor:end}
.chart .mid{text-anchor:middle}
.chart .says{fill:$muted;font-style:italic;text-anchor:middle}
.chart text.warn{fill:$bad;font-weight:bold;font-size:10px;paint-order:stroke;stroke:$ground;stroke-width:2.5px}
.chart .ground{fill:$ground}
.chart path{fill:none;stroke-linejoin:round}
.chart .grid{stroke:$grid;stroke-width:1}
.chart .axis{stroke:$axis;stroke-width:1}
.chart .now{stroke:$ink;stroke-width:1.2;stroke-dasharray:6 3}
.chart .a{stroke:$ego;stroke-width:1.8}
.chart .b{stroke:$other;stroke-width:1.6;stroke-dasharray:7 3}
.chart .c{stroke:$rare;stroke-width:1.6;stroke-dasharray:2 2.5}
.chart .d{stroke:$muted;stroke-width:1.2}
.chart path.one{stroke:$ego;stroke-width:1.8}
.chart path.two{stroke:$rare;stroke-width:1.8;stroke-dasharray:7 3}
.chart path.three{stroke:$plan;stroke-width:1.8;stroke-dasharray:2 2.5}
.chart path.four{stroke:$unsure;stroke-width:1.8;stroke-dasharray:9 3 2 3}
.chart .qp{stroke:$ego;stroke-width:2.2}
.chart .dp{stroke:$other;stroke-width:1.6;stroke-dasharray:5 3}
.chart .driven{stroke:$ego;stroke-width:1.4;stroke-dasharray:1 3;stroke-linecap:round}
.chart .planned{stroke:$plan;stroke-width:2.4}
.chart .second{fill:$plan;stroke:$ground}
.chart .foreseen{stroke:$other;stroke-width:1;stroke-dasharray:2 3}
.chart path.road{fill:$road}
.chart path.walk{fill:$walk}
.chart .lane{stroke:$lane;stroke-width:.8}
.chart .stop{stroke:$ink;stroke-width:2.5}
.chart .zebra{stroke:$lane;stroke-width:1;stroke-dasharray:3 3}
.chart path.goal{fill:$free;fill-opacity:.12;stroke:$free;stroke-dasharray:4 3}
.chart .ego{fill:$ego;stroke:$ink;stroke-width:.8}
.chart .one .second{fill:$ego}
.chart .one .driven{stroke:$ego}
.chart .two .ego,.chart .two .second{fill:$rare}
.chart .two .driven{stroke:$rare}
.chart .three .ego,.chart .three .second{fill:$plan}
.chart .three .driven{stroke:$plan}
.chart .four .ego,.chart .four .second{fill:$unsure}
.chart .four .driven{stroke:$unsure}
.chart .other{fill:$other;stroke:$ink;stroke-width:.8}
.chart .still{fill:$muted;fill-opacity:.55;stroke:$ink;stroke-width:.8}
.chart .heading{stroke:$other;stroke-width:1.4}
.chart path.nose{stroke:$ground;stroke-width:1.4}
.chart .room{fill:$free;fill-opacity:.13;stroke:$free;stroke-width:.8;stroke-opacity:.6}
.chart .thing{fill:$other;fill-opacity:.3;stroke:$other;stroke-width:1.3}
.chart .ignored{fill:$muted;fill-opacity:.12;stroke:$muted;stroke-width:1;stroke-dasharray:2 2}
.chart .broken{fill:$bad;fill-opacity:.18}
.chart .edge{stroke:$bad;stroke-width:1.6}
.chart .bar{fill:$other;fill-opacity:.32;stroke:$other}
.chart .calm{fill:$ego;fill-opacity:.16;stroke:$ego}
.chart .alarm{fill:$bad;fill-opacity:.3;stroke:$bad;stroke-width:1.4}
.chart .mark{fill:$ego;stroke:$ground}
.chart .hollow{fill:$ground;stroke:$ego;stroke-width:1.6}
.chart .wrong{fill:$bad;stroke:$ground}
.chart .whisker{stroke:$ego;stroke-width:1.6}
.chart .speck{fill:$ego;fill-opacity:.55}
.chart .box{fill:$ego;fill-opacity:.12;stroke:$ego}
.chart .sign{font-size:15px;text-anchor:middle;fill:$ink}
.chart .sign.blue{fill:$ego}
.chart .sign.green{fill:$plan}
.chart .sign.orange{fill:$other}
.chart .sign.red{fill:$bad}
.chart .sign.grey{fill:$muted}
.chart .sign.olive{fill:$unsure}
.chart rect.blue{fill:$ego}
.chart rect.green{fill:$plan}
.chart rect.orange{fill:$other}
.chart rect.red{fill:$bad}
.chart rect.grey{fill:$muted}
.chart rect.olive{fill:$unsure}
.chart rect.blank{fill:$ground;stroke:$axis}
.chart .ring{fill:none;stroke:$ink;stroke-width:1.6}
.chart .bound{stroke:$ink;stroke-width:2.4}
.chart .band{fill:$ink;fill-opacity:.22}
.chart .wide{stroke:$other;stroke-opacity:.6;stroke-width:6;stroke-linecap:round}
.chart .worse{stroke:$bad;stroke-width:1.6}
.chart .better{stroke:$good;stroke-width:1.6;stroke-dasharray:4 2}
""".replace("FONT", FONT)  # noqa: E501

DRIVES = ("one", "two", "three", "four")
"""Classes of the drives in one picture: colour and dash of their lines, colour of the ego in a
group of the class.
"""


def roles(theme: Theme) -> str:
    """The CSS custom properties of the theme "auto", which follows the reader's system.

    Empty for a fixed theme.
    """
    if theme != "auto":
        return ""
    light, dark = (
        ";".join(f"--{name}:{value}" for name, value in colours.items())
        for colours in (LIGHT, DARK)
    )
    return f":root{{color-scheme:light dark;{light}}}@media(prefers-color-scheme:dark){{:root{{{dark}}}}}"  # noqa: E501


def filled(rules: str, theme: Theme) -> str:
    """The rules with `$role` as a custom property, or as the colour itself for a fixed theme."""
    colours = DARK if theme == "dark" else LIGHT
    for name in sorted(colours, key=len, reverse=True):
        rules = rules.replace(f"${name}", f"var(--{name})" if theme == "auto" else colours[name])
    return rules


def stylesheet(theme: Theme) -> str:
    """The style sheet of a chart in a file of its own."""
    return roles(theme) + "".join(filled(RULES, theme).split("\n"))


# The largest distance of a simplified line from the exact one: less than half a pixel is invisible
KEPT_PX = 0.4
LETTER_PX = 5.9  # Mean width of a letter at the font size of charts
# Coordinates are clipped to +- this value: no picture is taller, and renderers lose digits beyond
FAR_PX = 20_000.0
FORMATS = (".png", ".svg")


@dataclass(frozen=True)
class Chart:
    """A picture.

    Attributes:
        name: One word; the last part of the file name.
        title: What the chart shows, with the unit if there is only one.
        says: A description in one sentence, for screen readers.
        width: Pixels; `height` likewise.
        body: SVG elements.
    """

    name: str
    title: str
    says: str
    width: float
    height: float
    body: str

    def _repr_html_(self) -> str:
        """The chart in a notebook."""
        return self.alone("light")

    def inline(self) -> str:
        """The chart as an SVG element for an HTML page that contains the style sheet."""
        return (
            f'<svg class="chart" viewBox="0 0 {px(self.width)} {px(self.height)}" role="img" '
            f'aria-label="{escape(printable(self.says))}">{self.body}</svg>'
        )

    def alone(self, theme: Theme, width: float | None = None) -> str:
        """The chart as the text of an SVG file, with its own width or with `width` pixels."""
        wide = width or self.width
        size = f'width="{wide:g}" height="{wide * self.height / self.width:.6g}"'
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" class="chart" {size} '
            f'viewBox="0 0 {px(self.width)} '
            f'{px(self.height)}"><title>{escape(printable(self.title))}</title>'
            f"<desc>{escape(printable(self.says))}</desc><style>{stylesheet(theme)}</style>"
            f'<rect class="ground" width="100%" height="100%"/>{self.body}</svg>\n'
        )

    def save(self, path: Path | str, *, theme: Theme = "light", width: float | None = None) -> None:
        """Write the picture in the format of the path's suffix. The same picture gives the same
        bytes.

        Args:
            path: The file; it ends with .png or .svg.
            theme: "auto" is light in a PNG, which cannot follow the system of its reader.
            width: Pixels; None: half as many again as the chart has.

        Raises:
            ConfigError: The suffix is neither .png nor .svg.
            OutputError: The file cannot be written.
        """
        path = Path(path)
        if path.suffix not in FORMATS:
            raise ConfigError(f"{path}: a picture ends with .png or .svg")
        wide = width or 1.5 * self.width
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.suffix == ".svg":
                write_text(path, self.alone(theme, wide))
                return
            import resvg_py

            fonts = [
                str(Path(__file__).with_name("fonts") / f"DejaVuSans{style}.ttf")
                for style in ("", "-Bold")
            ]
            svg = self.alone("light" if theme == "auto" else theme, wide)
            data = bytes(
                resvg_py.svg_to_bytes(
                    svg_string=svg,
                    skip_system_fonts=True,
                    font_files=fonts,
                    font_family="DejaVu Sans",
                )
            )
            write_png(path, data)


def px(value: float) -> str:
    """A coordinate as text: "12.3", "12", ".5"."""
    return _tenths(round(10.0 * min(max(float(value), -FAR_PX), FAR_PX)))


def _tenths(tenths: int) -> str:
    whole, part = divmod(abs(tenths), 10)
    text = f"{whole or ''}.{part}" if part else str(whole)
    return f"-{text}" if tenths < 0 else text


def polyline(x: FloatArray, y: FloatArray, kind: str) -> str:
    """A line `(n,)`; values that are not finite are gaps, single points are dots."""
    known: BoolArray = np.isfinite(x) & np.isfinite(y)
    edge = np.diff(np.r_[False, known, False].astype(np.int64))
    points = np.column_stack([x, y])
    pieces = zip(np.flatnonzero(edge > 0), np.flatnonzero(edge < 0), strict=True)
    return _path("".join(_moves(points[a:b], False) for a, b in pieces), kind)


def area(x: FloatArray, y: FloatArray, kind: str) -> str:
    """A closed outline `(n,)`, n >= 3; points that are not finite are left out."""
    known = np.isfinite(x) & np.isfinite(y)
    return (
        _path(_moves(np.column_stack([x[known], y[known]]), True), kind) if known.sum() > 2 else ""
    )


def areas(outlines: Iterable[FloatArray], kind: str) -> str:
    """Several closed outlines `(n, 2)` as one element."""
    return _path("".join(_moves(outline, True) for outline in outlines if len(outline) > 2), kind)


def polylines(lines: Iterable[FloatArray], kind: str) -> str:
    """Several lines `(n, 2)` as one element."""
    return _path("".join(_moves(line, False) for line in lines if len(line) > 1), kind)


def _path(moves: str, kind: str) -> str:
    return f'<path class="{kind}" d="{moves}"/>' if moves else ""


def _moves(points: FloatArray, closed: bool) -> str:
    """The commands of a path: a start, then steps between rounded points, so that rounding errors
    do not accumulate.
    """
    shown = np.clip(points, -FAR_PX, FAR_PX)
    tenths = np.rint(10.0 * shown[simplified(shown)]).astype(np.int64)
    first, steps = tenths[0].tolist(), np.diff(tenths, axis=0)
    steps = steps[(steps != 0).any(axis=1)].tolist()
    begin = f"M{_tenths(first[0])}{_after(first[1])}"
    if not steps:
        return f"{begin}h.1" + ("z" if closed else "")
    return f"{begin}l{' '.join(f'{_tenths(a)}{_after(b)}' for a, b in steps)}" + (
        "z" if closed else ""
    )


def _after(tenths: int) -> str:
    """The second number of a pair, after a space unless its minus sign separates it from the
    first.
    """
    return _tenths(tenths) if tenths < 0 else f" {_tenths(tenths)}"


def simplified(points: FloatArray) -> IntArray:
    """Which points of a line `(n, 2)` draw it within `KEPT_PX` (Douglas and Peucker 1973), level by
    level.
    """
    ends = np.array([0, len(points) - 1] if len(points) > 1 else [0])
    levels, begin, end = [ends], ends[:-1], ends[1:]
    while True:
        wide = end - begin > 1
        begin, end = begin[wide], end[wide]
        if not len(begin):
            return np.sort(np.concatenate(levels))
        inner = end - begin - 1
        start = np.cumsum(inner) - inner
        owner = np.repeat(np.arange(len(begin)), inner)
        index = np.arange(len(owner)) + (begin + 1 - start)[owner]
        origin = points[begin][owner]
        from_begin, chord = points[index] - origin, points[end][owner] - origin
        length = np.hypot(chord[:, 0], chord[:, 1])
        across = np.abs(chord[:, 0] * from_begin[:, 1] - chord[:, 1] * from_begin[:, 0])
        distance = np.hypot(from_begin[:, 0], from_begin[:, 1])  # where begin and end coincide
        np.divide(across, length, out=distance, where=length > 0.0)
        worst = np.maximum.reduceat(distance, start)
        hits = np.flatnonzero(distance == worst[owner])
        split, bent = index[hits[np.searchsorted(hits, start)]], worst > KEPT_PX
        levels.append(split[bent])
        begin, end = np.r_[begin[bent], split[bent]], np.r_[split[bent], end[bent]]


# Outlines and lines are cut this far outside of a plot area, so that their cut edges are not seen
AROUND_PX = 12.0


def cut_line(points: FloatArray, width: float, height: float) -> list[FloatArray]:
    """The parts of a line `(n, 2)` whose segments come near a plot area."""
    low, high = np.minimum(points[:-1], points[1:]), np.maximum(points[:-1], points[1:])
    near = (high >= -AROUND_PX).all(axis=1) & (low <= [width + AROUND_PX, height + AROUND_PX]).all(
        axis=1
    )
    edge = np.diff(np.r_[False, near, False].astype(np.int64))
    return [
        points[a : b + 1]
        for a, b in zip(np.flatnonzero(edge > 0), np.flatnonzero(edge < 0), strict=True)
    ]


def cut_outline(points: FloatArray, width: float, height: float) -> FloatArray:
    """An outline `(n, 2)` cut at a plot area and a little around it (Sutherland and Hodgman
    1974).
    """
    x, y = (-AROUND_PX, width + AROUND_PX), (-AROUND_PX, height + AROUND_PX)
    for axis, bound, sign in ((0, x[0], 1), (0, x[1], -1), (1, y[0], 1), (1, y[1], -1)):
        inside = sign * (points[:, axis] - bound)
        if (inside >= 0.0).all():
            continue
        after, inside_after = np.roll(points, -1, axis=0), np.roll(inside, -1)
        crosses = (inside >= 0.0) != (inside_after >= 0.0)
        part = np.divide(inside, inside - inside_after, out=np.zeros(len(points)), where=crosses)
        both = np.stack([points, points + part[:, None] * (after - points)], axis=1).reshape(-1, 2)
        points = both[np.column_stack([inside >= 0.0, crosses]).ravel()]
    return points


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
    """Words that begin at x (class "end": words that end at x; "mid": words that are centred at
    x).
    """
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
    most = max(int(width / LETTER_PX), 2)
    return words if len(words) <= most else f"{words[: most - 1]}\u2026"


def window(x: float, y: float, width: float, height: float, inside: str) -> str:
    """Elements with their own origin, clipped to a box."""
    place = f'x="{px(x)}" y="{px(y)}" width="{px(width)}" height="{px(height)}"'
    return f'<svg {place} overflow="hidden">{inside}</svg>'


def group(x: float, y: float, inside: str) -> str:
    """Elements with their own origin."""
    return f'<g transform="translate({px(x)} {px(y)})">{inside}</g>'


def stacked(charts: Sequence[Chart], name: str, title: str, says: str) -> Chart:
    """Charts below each other, as one."""
    body, y = "", 0.0
    for chart in charts:
        body, y = body + group(0.0, y, chart.body), y + chart.height
    return Chart(name, title, says, max(chart.width for chart in charts), y, body)


SAMPLE_PX = 34.0  # Width of an entry of a legend without its word, pixels


def legend_words(words: Sequence[str], most: float) -> list[str]:
    """Words for a legend of this width: as they are if they fit, otherwise each shortened to its
    share.
    """
    if sum(SAMPLE_PX + LETTER_PX * len(word) for word in words) <= most:
        return list(words)
    return [shortened(word, most / len(words) - SAMPLE_PX) for word in words]


LEGEND_PX = 14.0  # Height of a row of a legend
# An entry of a legend: element ("line", "area", "dot", or a sign), class and word
Entry = tuple[str, str, str]


def legend_rows(entries: Sequence[Entry], most: float) -> list[list[Entry]]:
    """The entries in rows that are at most so wide, pixels."""
    rows, width = list[list[Entry]](), most + 1.0
    for entry in entries:
        _, _, word = entry
        needed = SAMPLE_PX + LETTER_PX * len(word)
        if width + needed > most + 8.0:
            rows.append([])
            width = 0.0
        rows[-1].append(entry)
        width += needed
    return rows


def legend(x: float, y: float, entries: Sequence[Entry]) -> str:
    """Samples in a row, each with its word."""
    samples = ""
    for element, kind, word in entries:
        if element == "area":
            samples += rect(x, y - 8.0, 16.0, 8.0, kind)
        elif element == "dot":
            samples += dot(x + 8.0, y - 4.0, 3.0, kind)
        elif element == "line":
            samples += line(x, y - 3.5, x + 16.0, y - 3.5, kind)
        else:
            samples += text(x + 8.0, y, element, f"sign {kind}")
        samples += text(x + 21.0, y, word, "small")
        x += SAMPLE_PX + LETTER_PX * len(word)
    return samples
