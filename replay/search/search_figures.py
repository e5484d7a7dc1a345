"""The pictures of `replan falsify` and `replan tune`. Colours are of Okabe and Ito's palette for the colour-blind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from replay.draw.report.figures import STYLE, empty_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from replay.search.search_space import SearchAxis

LOOKS = {
    "pass": ("o", "#56b4e9", "passes"),
    "fail": ("X", "#d55e00", "fails, the reference driver does not"),
    "both fail": ("s", "#999999", "fails, the reference driver too"),
    "inconclusive": ("D", "#f0e442", "inconclusive"),
    "error": ("+", "#000000", "cannot be made or driven"),
}
"""Marker, colour and meaning of each outcome."""
RECORDED, MILDEST = "#009e73", "#000000"


def falsify_figure(table: pd.DataFrame, axes: Sequence[SearchAxis], case: Mapping[str, Any], title: str) -> Figure:
    """The trials over the two axes that the case moves most (without a case: the first two); lines of equal distance.

    Args:
        table: A row per trial: a column per axis, `outcome`.
        axes: The axes of the search.
        case: The row of the mildest case; empty if there is none.
        title: Title of the picture.
    """
    import matplotlib as mpl

    by_step = sorted(axes, key=lambda axis: -abs(case.get(axis.name, axis.origin) - axis.origin) / axis.scale)
    first, second = by_step[0], by_step[1] if len(by_step) > 1 else None
    with mpl.rc_context(STYLE):
        figure = empty_figure(8.0, 5.6 if second else 3.2)
        picture = figure.subplots()
        spread = np.zeros(len(table)) if second is None else table[second.name].to_numpy(float)
        for name, (marker, colour, meaning) in LOOKS.items():
            mine = (table["outcome"] == name).to_numpy()
            if mine.any():
                x, y, label = table[first.name][mine], spread[mine], f"{meaning} ({mine.sum()})"
                picture.scatter(x, y, marker=marker, c=colour, s=34.0, label=label, lw=1.0 if marker == "+" else 0.3)
        origin = (first.origin, 0.0 if second is None else second.origin)
        picture.plot(*origin, "o", ms=16.0, mfc="none", mec=RECORDED, mew=2.0, label="as recorded")
        if case:
            place = case[first.name], 0.0 if second is None else case[second.name]
            label = f"mildest failure, distance {case['distance']:.3f}"
            picture.plot(*place, "*", ms=15.0, mfc="none", mec=MILDEST, mew=1.4, label=label)
            turn, away = np.linspace(0.0, 2.0 * np.pi, 181), float(case["distance"])
            along = first.origin + first.scale * away * np.cos(turn)  # if no other axis is moved
            if second is not None:
                across = second.origin + second.scale * away * np.sin(turn)
                picture.plot(along, across, color="#555555", lw=0.8, ls="--", label="as far as that")
            for end in (along.min(), along.max()) if second is None else ():
                picture.axvline(end, color="#555555", lw=0.8, ls="--")
        picture.set(xlabel=first.label, xlim=_padded_range(first), title=title)
        if second is None:
            picture.set_yticks([])
        else:
            picture.set(ylabel=second.label, ylim=_padded_range(second))
        figure.legend(loc="outside lower left", ncols=2, fontsize=8)
        return figure


def _padded_range(axis: SearchAxis) -> tuple[float, float]:
    room = 0.03 * (axis.high - axis.low)
    return axis.low - room, axis.high + room


def pareto_figure(table: pd.DataFrame, metrics: Sequence[str], chosen: Mapping[str, Any], title: str) -> Figure:
    """The gains of all trials in the first two objectives; a single objective is drawn over the trial number.

    Args:
        table: A row per trial: `gain METRIC` for each objective, `feasible`, `pareto`.
        metrics: The objectives.
        chosen: The row of the chosen trial; empty if there is none.
        title: Title of the picture.
    """
    import matplotlib as mpl

    names = [f"gain {name}" for name in metrics]
    x, y = ("trial", names[0]) if len(names) == 1 else (names[0], names[1])
    front = table[table["pareto"]].sort_values([x, y], kind="stable")
    with mpl.rc_context(STYLE):
        figure = empty_figure(7.5, 5.2)
        picture = figure.subplots()
        for name, mine, colour in (
            ("feasible", table["feasible"] & ~table["pareto"], "#56b4e9"),
            ("fails more gates than the defaults", ~table["feasible"] & table["total"].notna(), "#999999"),
            ("no other trial is better in all objectives", table["pareto"], "#d55e00"),
        ):
            if mine.any():
                label = f"{name} ({mine.sum()})"
                picture.scatter(table[x][mine], table[y][mine], s=30.0, c=colour, ec="#555555", lw=0.4, label=label)
        if len(names) == 2:
            picture.plot(front[x], front[y], color="#d55e00", lw=0.8)
        if len(names) == 1:
            picture.axhline(0.0, color=RECORDED, lw=1.0, label="the defaults")
        else:
            picture.plot(0.0, 0.0, "o", ms=14.0, mfc="none", mec=RECORDED, mew=2.0, label="the defaults")
        if chosen:
            picture.plot(chosen[x], chosen[y], "*", ms=15.0, mfc="none", mec=MILDEST, mew=1.4, label="chosen")
        picture.set(xlabel=x, ylabel=y, title=title)
        figure.legend(loc="outside lower left", ncols=2, fontsize=8)
        return figure
