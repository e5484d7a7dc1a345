"""One style for all charts and pages: roles as colours for a light and a dark background.

The hues are those of Okabe and Ito (2008), which people with any colour vision can distinguish, lighter on the dark
background. No meaning depends on colour alone: lines differ in dash, marks in shape, and everything has a label.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import Literal

Theme = Literal["auto", "light", "dark"]

LIGHT = MappingProxyType({
    "ground": "#ffffff", "panel": "#f6f7f9", "ink": "#1b1f24", "muted": "#57606a", "grid": "#e4e7eb", "axis": "#9aa3ad",
    "ego": "#0072b2", "plan": "#007a59", "other": "#b06f00", "rare": "#a8487c", "bad": "#c04a00", "good": "#007a59",
    "unsure": "#7a5f00", "road": "#eceef1", "walk": "#f7f3ea", "lane": "#b3bac3", "free": "#009e73", "focus": "#0072b2",
})  # fmt: skip
DARK = MappingProxyType({
    "ground": "#14171b", "panel": "#1c2026", "ink": "#e6e9ed", "muted": "#a3acb7", "grid": "#2b3138", "axis": "#5d6773",
    "ego": "#56b4e9", "plan": "#37c99b", "other": "#e69f00", "rare": "#e394bd", "bad": "#ff8547", "good": "#37c99b",
    "unsure": "#f0e442", "road": "#252a31", "walk": "#2a2822", "lane": "#59626d", "free": "#37c99b", "focus": "#7cc8f5",
})  # fmt: skip
"""Roles by name: `ego` blue, `plan` green, `other` road users orange, `rare` purple, `bad` vermilion."""

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
.chart .worse{stroke:$bad;stroke-width:1.6}
.chart .better{stroke:$good;stroke-width:1.6;stroke-dasharray:4 2}
""".replace("FONT", FONT)


def roles(theme: Theme) -> str:
    """The custom properties; "auto" follows the system of the reader. Empty for a fixed theme."""
    if theme != "auto":
        return ""
    light, dark = (";".join(f"--{name}:{value}" for name, value in some.items()) for some in (LIGHT, DARK))
    return f":root{{color-scheme:light dark;{light}}}@media(prefers-color-scheme:dark){{:root{{{dark}}}}}"


def filled(rules: str, theme: Theme) -> str:
    """The rules with `$role` as a custom property, or as the colour itself for a fixed theme."""
    colours = DARK if theme == "dark" else LIGHT
    for name in sorted(colours, key=len, reverse=True):
        rules = rules.replace(f"${name}", f"var(--{name})" if theme == "auto" else colours[name])
    return rules


def stylesheet(theme: Theme) -> str:
    """The style sheet of a chart in a file of its own."""
    return roles(theme) + "".join(filled(RULES, theme).split("\n"))
