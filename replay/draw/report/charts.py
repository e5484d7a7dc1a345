"""Charts of a run and of a comparison: pass shares, distributions over the logs, and changes of metrics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from logs.names import counted
from replay.draw.charts.axes import Plane, Ticks, rows_plane
from replay.draw.charts.canvas import Chart, dot, line, rect, text
from replay.draw.model import Span, widened
from replay.draw.report.contents import DriveRow, MetricColumn, PassShare

WIDTH_PX, WIDE_PX, ROW_PX = 440.0, 640.0, 19.0
LABEL_SHARE = 0.4  # The largest share of the width for names
MAX_SHARES, MAX_PAIRS = 40, 20
FEW = 5  # A box of quartiles is drawn for more values than this


def pass_shares(shares: Sequence[PassShare], planners: int) -> Chart:
    """The share of logs that pass, with its 95 % interval, by group: a dot, a whisker, and counts."""
    shown = shares[:MAX_SHARES]
    names = [f"{share.name}, {share.planner}" if planners > 1 else share.name for share in shown]
    plane, ticks = _rows(names, (-2.0, 102.0), width=WIDE_PX)
    marks, counts = [], []
    for k, share in enumerate(shown):
        y = ROW_PX * (k + 0.5)
        low, at, high = plane.at_x(100.0 * np.array([share.low, share.share, share.high])).tolist()
        kind = "mark" if share.passed == share.logs else "hollow"
        marks.append(line(low, y, high, y, "whisker") + line(low, y - 4, low, y + 4, "whisker"))
        marks.append(line(high, y - 4, high, y + 4, "whisker") + dot(at, y, 4.5, kind, f"{share.name}: {share.text}"))
        words, wide = f"{share.passed}/{share.logs}", plane.inner[0]
        beside = low - 6.0 if high > wide - 50.0 else high + 6.0
        counts.append(text(beside, y + 3.5, words, "small end" if high > wide - 50.0 else "small"))
    title = "Logs that pass, with the 95 % interval of the share"
    entries = [("dot", "mark", "all pass"), ("dot", "hollow", "some do not")]
    says = f"{title}: " + "; ".join(f"{name}: {share.text}" for name, share in zip(names, shown, strict=True))
    axes = dict[str, Any](entries=entries, x_title="share [%]", y_ticks=ticks, over="".join(counts))
    return plane.chart("pass_shares", title, "".join(marks), says=says, **axes)


def distributions(columns: Sequence[MetricColumn], drives: Sequence[DriveRow]) -> list[Chart]:
    """One chart per column of the table of drives that has at least three different values.

    A row per planner: a dot per log, and the box of the quartiles with the median.
    """
    out = []
    for i, column in enumerate(columns):
        strips: dict[str, list[tuple[float, str]]] = {drive.shown: [] for drive in drives}
        for drive in drives:
            if np.isfinite(drive.cells[i].value):
                strips[drive.shown].append((drive.cells[i].value, drive.log))
        strips = {planner: strip for planner, strip in strips.items() if strip}
        if len({value for strip in strips.values() for value, _ in strip}) < 3:
            continue
        names, values = list(strips), [np.array([value for value, _ in strip]) for strip in strips.values()]
        least, most = float(min(v.min() for v in values)), float(max(v.max() for v in values))
        low, high = widened(least, most, 1e-3, 0.04)
        plane, ticks = _rows(names, (min(low, 0.0) if least >= 0.0 and low < 0.0 else low, high), top=22.0)
        marks = ""
        for k, (some, strip) in enumerate(zip(values, strips.values(), strict=True)):
            middle = ROW_PX * (k + 0.5)
            if len(some) > FEW:
                left, median, right = plane.at_x(np.percentile(some, (25.0, 50.0, 75.0))).tolist()
                marks += rect(left, middle - 6.0, right - left, 12.0, "box")
                marks += line(median, middle - 6.0, median, middle + 6.0, "whisker")
            order = np.argsort(some, kind="stable")
            away = np.array([0.0, -3.0, 3.0])[np.arange(len(order)) % 3]
            for n, x, offset in zip(order, plane.at_x(some[order]).tolist(), away.tolist(), strict=True):
                marks += dot(x, middle + offset, 2.6, "speck", f"{strip[n][1]}: {some[n]:.4g}")
        title = f"{column.words}, {column.mode} loop"
        says = f"{title}: " + "; ".join(
            f"{name}: {some.min():.3g} to {some.max():.3g}, median {np.median(some):.3g}, {counted(len(some), 'log')}"
            for name, some in zip(names, values, strict=True)
        )
        x_title = f"{column.metric}, a dot a log"
        out.append(plane.chart(column.metric, title, marks, says=says, x_title=x_title, y_ticks=ticks))
    return out


def moved(pairs: pd.DataFrame, title: str) -> Chart:
    """One metric from baseline to candidate, the worst regression first.

    Args:
        pairs: Rows of `Comparison.pairs` of one metric, with both values.
        title: Title of the chart.
    """
    shown = pairs.sort_values(["worse", "log"], ascending=[False, True], kind="stable").head(MAX_PAIRS)
    names = [str(log) for log in shown["log"]]
    both = shown[["baseline", "candidate"]].to_numpy(np.float64)
    plane, ticks = _rows(names, widened(float(both.min()), float(both.max()), 1e-6))
    marks, rows = [], list[Any](shown.itertuples())
    for k, (row, (before, now)) in enumerate(zip(rows, plane.at_x(both).tolist(), strict=True)):
        y, kind = ROW_PX * (k + 0.5), "worse" if row.worse > 0.0 else "better"
        marks.append(line(before, y, now, y, kind) + dot(before, y, 4.0, "hollow", f"baseline {row.baseline:.4g}"))
        marks.append(dot(now, y, 4.0, "wrong" if row.worse > 0.0 else "mark", f"candidate {row.candidate:.4g}"))
    unit = str(shown["unit"].iloc[0])
    x_title = f"{shown['metric'].iloc[0]}{f' [{unit}]' if unit not in ('', '1', 'count') else ''}"
    says = f"{title}: " + "; ".join(f"{r.log} {r.baseline:.3g} to {r.candidate:.3g}" for r in rows)
    axes = dict[str, Any](entries=_MOVED, x_title=x_title, y_ticks=ticks)
    return plane.chart(str(shown["metric"].iloc[0]), title, "".join(marks), says=says, **axes)


def _rows(names: Sequence[str], x: Span, *, top: float = 40.0, width: float = WIDTH_PX) -> tuple[Plane, Ticks]:
    return rows_plane(names, x, width, ROW_PX, top=top, most=LABEL_SHARE * width)


_MOVED = (
    ("dot", "hollow", "baseline"), ("dot", "mark", "candidate"),
    ("line", "better", "better"), ("line", "worse", "worse"),
)  # fmt: skip
