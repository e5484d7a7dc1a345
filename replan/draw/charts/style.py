"""The style of all charts: colours by role in two themes, and the CSS rules of each class.

Roles are colours for a light and a dark background. The hues are those of Okabe and Ito (2008),
which people with any colour vision can distinguish, lighter on the dark background. No meaning
depends on colour alone: lines differ in dash, marks in shape, and everything has a label.

Elements are styled by class names only, and there is no script and no id, so that any number of
charts can be in one page.
"""

from __future__ import annotations

import re
from types import MappingProxyType
from typing import Literal

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
"""Colours by role.

ground, panel: background of a page and of a box; ink, muted: text; grid, axis: lines of a plot
area; road, walk, lane: the road; free: where the ego may be; focus: the outline of a link.
ego, plan, other, rare: the ego and first curves, the plan, road users, third curves.
bad, good, unsure: outcomes.
"""

RULES = """
/* Words. label: a name in a plot area; end, middle: they end or are centred at their x; empty:
why a chart shows nothing; warning: the name of a broken gate. */
.chart{font:11px 'DejaVu Sans', Verdana, 'Segoe UI', system-ui, sans-serif}
.chart text{fill:$ink}
.chart .small{font-size:10px;fill:$muted}
.chart .tick,.chart .tick text{font-size:10px;fill:$muted}
.chart .label{paint-order:stroke;stroke:$ground;stroke-width:3px;stroke-linejoin:round}
.chart .title{font-weight:bold}
.chart .end{text-anchor:end}
.chart .middle{text-anchor:middle}
.chart .empty{fill:$muted;font-style:italic;text-anchor:middle}
.chart text.warning{fill:$bad;font-weight:bold;font-size:10px;paint-order:stroke;stroke:$ground;stroke-width:2.5px}
/* Background and plot area. reference: the present moment, or what values are compared with. */
.chart .ground{fill:$ground}
.chart path{fill:none;stroke-linejoin:round}
.chart .grid{stroke:$grid;stroke-width:1}
.chart .axis{stroke:$axis;stroke-width:1}
.chart .reference{stroke:$ink;stroke-width:1.2;stroke-dasharray:6 3}
/* Panels over time: the curves of one drive, or one curve of each drive. */
.chart .curve1{stroke:$ego;stroke-width:1.8}
.chart .curve2{stroke:$other;stroke-width:1.6;stroke-dasharray:7 3}
.chart .curve3{stroke:$rare;stroke-width:1.6;stroke-dasharray:2 2.5}
.chart .curve4{stroke:$muted;stroke-width:1.2}
.chart path.drive1{stroke:$ego;stroke-width:1.8}
.chart path.drive2{stroke:$rare;stroke-width:1.8;stroke-dasharray:7 3}
.chart path.drive3{stroke:$plan;stroke-width:1.8;stroke-dasharray:2 2.5}
.chart path.drive4{stroke:$unsure;stroke-width:1.8;stroke-dasharray:9 3 2 3}
/* Intervals of time. broken, onset: a gate is broken, and where that begins; decision, normal,
alarm: bars of the decisions, and other bars. */
.chart .broken{fill:$bad;fill-opacity:.18}
.chart .onset{stroke:$bad;stroke-width:1.6}
.chart .decision{fill:$other;fill-opacity:.32;stroke:$other}
.chart .normal{fill:$ego;fill-opacity:.16;stroke:$ego}
.chart .alarm{fill:$bad;fill-opacity:.3;stroke:$bad;stroke-width:1.4}
/* Scenes from above: road, driven and planned paths, egos and road users. */
.chart path.drivable{fill:$road}
.chart path.undrivable{fill:$walk}
.chart .lane_side{stroke:$lane;stroke-width:.8}
.chart .stop_line{stroke:$ink;stroke-width:2.5}
.chart .crosswalk{stroke:$lane;stroke-width:1;stroke-dasharray:3 3}
.chart path.goal{fill:$free;fill-opacity:.12;stroke:$free;stroke-dasharray:4 3}
.chart .driven{stroke:$ego;stroke-width:1.4;stroke-dasharray:1 3;stroke-linecap:round}
.chart .planned{stroke:$plan;stroke-width:2.4}
.chart .alternative{stroke:$unsure;stroke-width:1;stroke-opacity:.8}
.chart .plan_second{fill:$plan;stroke:$ground}
.chart .predicted{stroke:$other;stroke-width:1;stroke-dasharray:2 3}
.chart .ego{fill:$ego;stroke:$ink;stroke-width:.8}
.chart .drive1 .plan_second{fill:$ego}
.chart .drive1 .driven{stroke:$ego}
.chart .drive2 .ego,.chart .drive2 .plan_second{fill:$rare}
.chart .drive2 .driven{stroke:$rare}
.chart .drive3 .ego,.chart .drive3 .plan_second{fill:$plan}
.chart .drive3 .driven{stroke:$plan}
.chart .drive4 .ego,.chart .drive4 .plan_second{fill:$unsure}
.chart .drive4 .driven{stroke:$unsure}
.chart path.ego_front{stroke:$ground;stroke-width:1.4}
.chart .moving{fill:$other;stroke:$ink;stroke-width:.8}
.chart .standing{fill:$muted;fill-opacity:.55;stroke:$ink;stroke-width:.8}
.chart .pointed_out{fill:$bad;stroke:$ground}
.chart .velocity{stroke:$other;stroke-width:1.4}
.chart .paper_plan{stroke:$other;stroke-opacity:.6;stroke-width:6;stroke-linecap:round}
/* S-T and S-L graphs. */
.chart .qp{stroke:$ego;stroke-width:2.2}
.chart .dp{stroke:$other;stroke-width:1.6;stroke-dasharray:5 3}
.chart .corridor{fill:$free;fill-opacity:.13;stroke:$free;stroke-width:.8;stroke-opacity:.6}
.chart .obstacle{fill:$other;fill-opacity:.3;stroke:$other;stroke-width:1.3}
.chart .ignored{fill:$muted;fill-opacity:.12;stroke:$muted;stroke-width:1;stroke-dasharray:2 2}
.chart .true_box{stroke:$rare;stroke-width:1.6;stroke-dasharray:2 2.5}
/* Charts of a run and of a comparison: dots, and the lines between or around them. */
.chart .hollow{fill:$ground;stroke:$ego;stroke-width:1.6}
.chart .filled{fill:$ego;stroke:$ground}
.chart .regressed{fill:$bad;stroke:$ground}
.chart .whisker{stroke:$ego;stroke-width:1.6}
.chart .log_dot{fill:$ego;fill-opacity:.55}
.chart .quartiles{fill:$ego;fill-opacity:.12;stroke:$ego}
.chart .worse{stroke:$bad;stroke-width:1.6}
.chart .better{stroke:$good;stroke-width:1.6;stroke-dasharray:4 2}
/* Pictures of experiments: signs and cells by their outcome, the recorded point in a ring, the
boundary between outcomes with its bracket, and the Pareto front. */
.chart .sign{font-size:15px;text-anchor:middle;fill:$ink}
.chart .sign.blue{fill:$ego}
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
.chart .boundary{stroke:$ink;stroke-width:2.4}
.chart .bracket{fill:$ink;fill-opacity:.22}
.chart .front{stroke:$bad;stroke-width:1.6}
"""  # noqa: E501
"""The rules of each class, by chart."""

DRIVES = ("drive1", "drive2", "drive3", "drive4")
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
    """The rules without comments, and with `$role` as a custom property, or as the colour itself
    for a fixed theme.
    """
    rules = re.sub(r"/\*.*?\*/\n", "", rules, flags=re.DOTALL)
    colours = DARK if theme == "dark" else LIGHT
    for name in sorted(colours, key=len, reverse=True):
        rules = rules.replace(f"${name}", f"var(--{name})" if theme == "auto" else colours[name])
    return rules


def stylesheet(theme: Theme) -> str:
    """The style sheet of a chart in a file of its own."""
    return roles(theme) + "".join(filled(RULES, theme).split("\n"))
