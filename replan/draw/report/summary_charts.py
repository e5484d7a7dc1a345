"""Charts over all logs in the HTML report: pass shares, distributions of metrics, and changes of
metrics against a baseline.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from replan.core.arrays import FloatArray
from replan.core.names import counted
from replan.draw.charts.axes import Plane, Ticks, rows_plane
from replan.draw.charts.chart import Chart
from replan.draw.charts.svg import dot, line, rect, text
from replan.draw.report.drive_table import MetricColumn
from replan.draw.report.overview import Overview, share_words
from replan.draw.report.run_sections import group_name
from replan.draw.report.section import NO_UNIT
from replan.draw.spans import Span, widened
from replan.metrics.comparison import Comparison

WIDTH_PX, WIDE_PX, ROW_PX = 440.0, 640.0, 19.0
LABEL_SHARE = 0.4  # The largest share of the width for names
COUNT_PX = 50.0  # Space for the counts beside an interval
MAX_SHARES, MAX_PAIRS = 40, 20
MOST_MOVED = 6  # Largest number of metrics of a comparison that are drawn
FEW = 5  # A box of quartiles is drawn for more values than this
LEAST_DIFFERENT = 3  # A distribution of fewer different values is not drawn
STAGGER_PX = (0.0, -3.0, 3.0)  # Neighbouring dots are apart from each other
SHARE_MARKS = (("dot", "filled", "all pass"), ("dot", "hollow", "some do not"))
MOVE_MARKS = (
    ("dot", "hollow", "baseline"),
    ("dot", "filled", "candidate"),
    ("line", "better", "better"),
    ("line", "worse", "worse"),
)


def pass_shares(over: Overview) -> Chart | None:
    """The share of logs that pass, with its 95 % interval, by group: a dot, a whisker, and
    counts; None for a shard, which is not judged.
    """
    rows = list[Any](pd.concat([over.whole, over.grouped]).head(MAX_SHARES).itertuples())
    if not rows:
        return None
    names = [group_name(row) for row in rows]
    if len(over.planners) > 1:
        names = [f"{name}, {row.planner}" for name, row in zip(names, rows, strict=True)]
    plane, ticks = _rows(names, (-2.0, 102.0), width=WIDE_PX)
    width = plane.inner[0]
    marks, counts = "", ""
    for k, row in enumerate(rows):
        y = ROW_PX * (k + 0.5)
        low, share, high = plane.at_x(100.0 * np.array([row.low, row.mean, row.high])).tolist()
        for x_from, y_from, x_to, y_to in (
            (low, y, high, y),
            (low, y - 4, low, y + 4),
            (high, y - 4, high, y + 4),
        ):
            marks += line(x_from, y_from, x_to, y_to, "whisker")
        kind = "filled" if row.passed == row.logs else "hollow"
        marks += dot(share, y, 4.5, kind, f"{group_name(row)}: {share_words(row)}")
        count = f"{row.passed}/{row.logs}"
        if high > width - COUNT_PX:
            counts += text(low - 6.0, y + 3.5, count, "small end")
        else:
            counts += text(high + 6.0, y + 3.5, count, "small")
    title = "Logs that pass, with the 95 % interval of the share"
    words = "; ".join(f"{name}: {share_words(row)}" for name, row in zip(names, rows, strict=True))
    return plane.chart(
        "pass_shares",
        title,
        marks,
        says=f"{title}: {words}",
        entries=SHARE_MARKS,
        x_title="share [%]",
        y_ticks=ticks,
        over=counts,
    )


def distributions(over: Overview) -> list[Chart]:
    """One chart per column of the table of drives that has at least three different values.

    A row per planner: a dot per log, and the box of the quartiles with the median.
    """
    charts = []
    for column in over.columns:
        strips: dict[str, list[tuple[float, str]]] = {name: [] for name in over.planners.values()}
        for drive in over.drives:
            if np.isfinite(value := drive.values[column]):
                strips.setdefault(drive.shown, []).append((value, drive.log))
        strips = {name: sorted(strip) for name, strip in strips.items() if strip}
        if len({value for strip in strips.values() for value, _ in strip}) >= LEAST_DIFFERENT:
            charts.append(_distribution(column, strips))
    return charts


def _distribution(column: MetricColumn, strips: dict[str, list[tuple[float, str]]]) -> Chart:
    """The values of a metric in rows; `strips`: sorted values and their logs by planner."""
    values = {name: np.array([value for value, _ in strip]) for name, strip in strips.items()}
    least = min(float(row.min()) for row in values.values())
    most = max(float(row.max()) for row in values.values())
    plane, ticks = _rows(list(strips), widened(least, most, 1e-3, 0.04), top=22.0)
    marks, words = "", []
    for k, (name, strip) in enumerate(strips.items()):
        y, row = ROW_PX * (k + 0.5), values[name]
        if len(row) > FEW:
            left, median, right = plane.at_x(np.percentile(row, (25.0, 50.0, 75.0))).tolist()
            marks += rect(left, y - 6.0, right - left, 12.0, "quartiles")
            marks += line(median, y - 6.0, median, y + 6.0, "whisker")
        for n, (x, (value, log)) in enumerate(zip(plane.at_x(row).tolist(), strip, strict=True)):
            y_dot = y + STAGGER_PX[n % len(STAGGER_PX)]
            marks += dot(x, y_dot, 2.6, "log_dot", f"{log}: {value:.4g}")
        span = f"{row.min():.3g} to {row.max():.3g}, median {np.median(row):.3g}"
        words.append(f"{name}: {span}, {counted(len(row), 'log')}")
    title = f"{column.words}, {column.mode} loop"
    return plane.chart(
        column.metric,
        title,
        marks,
        says=f"{title}: {'; '.join(words)}",
        x_title=f"{column.metric}, a dot a log",
        y_ticks=ticks,
    )


def most_moved(comparison: Comparison) -> Iterator[Chart]:
    """A chart for each of the metrics, planners and loops with the largest changes.

    Those of gates come first.
    """
    pairs = comparison.pairs
    in_both = pairs[["baseline", "candidate", "worse"]].notna().all(axis=1)
    pairs = pairs[in_both & (pairs["delta"] != 0.0)]
    groups = pairs.groupby(["metric", "planner", "mode"], sort=False)
    for k, ((metric, planner, mode), rows) in enumerate(groups):
        if k < MOST_MOVED:
            yield _moved(rows, f"{metric}, {planner}, {mode} loop")


def _moved(pairs: pd.DataFrame, title: str) -> Chart:
    """One metric from baseline to candidate, the worst regression first.

    `pairs`: rows of `Comparison.pairs` of one metric, with both values.
    """
    pairs = pairs.sort_values(["worse", "log"], ascending=[False, True], kind="stable")
    pairs = pairs.head(MAX_PAIRS)
    values: FloatArray = pairs[["baseline", "candidate"]].to_numpy(np.float64)
    span = widened(float(values.min()), float(values.max()), 1e-6)
    plane, ticks = _rows([str(log) for log in pairs["log"]], span)
    rows, marks = list[Any](pairs.itertuples()), ""
    for k, (row, (before, after)) in enumerate(zip(rows, plane.at_x(values).tolist(), strict=True)):
        y, worse = ROW_PX * (k + 0.5), row.worse > 0.0
        marks += line(before, y, after, y, "worse" if worse else "better")
        marks += dot(before, y, 4.0, "hollow", f"baseline {row.baseline:.4g}")
        kind = "regressed" if worse else "filled"
        marks += dot(after, y, 4.0, kind, f"candidate {row.candidate:.4g}")
    first = rows[0]
    unit = "" if first.unit in NO_UNIT else f" [{first.unit}]"
    words = "; ".join(f"{row.log} {row.baseline:.3g} to {row.candidate:.3g}" for row in rows)
    return plane.chart(
        first.metric,
        title,
        marks,
        says=f"{title}: {words}",
        entries=MOVE_MARKS,
        x_title=f"{first.metric}{unit}",
        y_ticks=ticks,
    )


def _rows(
    names: Sequence[str], x: Span, *, top: float = 40.0, width: float = WIDTH_PX
) -> tuple[Plane, Ticks]:
    return rows_plane(names, x, width, ROW_PX, top=top, most=LABEL_SHARE * width)
