"""Coverage: the cells of a set of logs, and those that another set has beside them.

A cell is an event's kind, road, kind of road user and range of speed. The set of all possible cells
is unknown, so the gaps of a set are the cells of another set that it lacks, by default those of the
catalogue, whose families can be synthesised: a gap names the family that fills it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from replan.core.names import counted, listed
from replan.draw.charts.axes import rows_plane
from replan.draw.charts.chart import Chart
from replan.draw.charts.layout import GAP_PX, together
from replan.logs.catalogue import families
from replan.mine.mined_log import ALONE, FASTER, ROADS, SPEEDS
from replan.results.tables import write_csv
from replan.run.claim import FolderContents
from replan.run.log_source import LogSource
from replan.run.sources import Selection

CELL = ("kind", "road", "agent_kind", "speed")
_ORDER = {
    "road": list(ROADS),
    "agent_kind": ["car", "truck", "bus", "motorcycle", "bicycle", "pedestrian", "object", ALONE],
    "speed": [*(name for _, name in SPEEDS), FASTER],
}
_TITLES = {"road": "road", "agent_kind": "main road user", "speed": "speed of the ego"}
CELL_PX, NAMES_PX = (70.0, 20.0), 150.0


def cells_of(events: pd.DataFrame) -> pd.DataFrame:
    """The cells of some events, a row each: `CELL`, numbers of events and logs, and the log with
    most events.
    """
    rows = []
    for key, group in events.groupby(list(CELL), sort=True):
        counts = group["log"].value_counts()
        most = sorted(counts[counts == counts.max()].index)[0]
        rows.append((*key, len(group), group["log"].nunique(), most))
    return pd.DataFrame(rows, columns=[*CELL, "events", "logs", "example"])


def missing_cells(covered: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    """The cells of another set that are not covered, as `cells_of` has them; `example` is a log of
    the other set.
    """
    joined = other.merge(covered[list(CELL)], on=list(CELL), how="left", indicator=True)
    return joined[joined["_merge"] == "left_only"].drop(columns="_merge").reset_index(drop=True)


def coverage_table(covered: pd.DataFrame, missing: pd.DataFrame) -> pd.DataFrame:
    """Both as one table, as in coverage.csv; the column `covered` tells them apart."""
    parts = [covered.assign(covered=True), missing.assign(covered=False)]
    return pd.concat([part for part in parts if len(part)] or parts[:1], ignore_index=True)


def coverage_figure(events: pd.DataFrame, title: str) -> Chart:
    """The number of events of each kind, by road, by kind of road user and by speed."""
    kinds, charts = sorted(events["kind"].unique()), list[Chart]()
    for column, names in _ORDER.items():
        counts = pd.crosstab(events["kind"], events[column]).reindex(
            index=kinds, columns=names, fill_value=0
        )
        most = float(np.log1p(max(counts.to_numpy().max(initial=0), 30.0)))
        wide = CELL_PX[0] * len(names) + NAMES_PX
        plane, rows = rows_plane(
            kinds, (0.0, float(len(names))), wide, CELL_PX[1], top=22.0, most=NAMES_PX
        )
        inside = over = ""
        for (y, _), numbers in zip(rows, counts.to_numpy(), strict=True):
            for j in np.flatnonzero(numbers).tolist():
                shade = float(np.log1p(int(numbers[j])))
                box = (j, j + 1.0), (y - 0.5, y + 0.5)
                inside += plane.heat(*box, shade, (-1.0, 1.3 * most))
                over += plane.words(j + 0.5, y, str(numbers[j]))
        words = [(j + 0.5, name) for j, name in enumerate(names)]
        charts.append(
            plane.chart(column, _TITLES[column], inside, x_ticks=words, y_ticks=rows, over=over)
        )
    return together(charts, title, "", sum(chart.width + GAP_PX for chart in charts))


def catalogue() -> Selection:
    """Every family of the catalogue, at its defaults."""
    return Selection(tuple(LogSource(name) for name in families()))


COVERAGE = FolderContents("coverage", ("coverage.csv", "coverage.png"), resumes=False)


def write_coverage(out: Path, events: pd.DataFrame, rows: pd.DataFrame) -> None:
    """Write coverage.csv and coverage.png into a folder of mined logs; OutputError if that
    fails.
    """
    write_csv(out / "coverage.csv", rows)
    title = f"{counted(len(events), 'event')} in {counted(events['log'].nunique(), 'log')}"
    coverage_figure(events, title).save(out / "coverage.png")


def coverage_lines(covered: pd.DataFrame, missing: pd.DataFrame, source: str) -> list[str]:
    """The cells in words: their number, and the gaps by kind with a log of `source` that fills
    each.
    """
    lines = [
        f"{counted(len(covered), 'cell')} covered; {counted(len(missing), 'cell')} of {source} not"
    ]
    for kind, group in missing.groupby("kind", sort=True):
        examples = listed(list(dict.fromkeys(group["example"])), 3)
        lines.append(f"    {kind}: {counted(len(group), 'cell')}, for example in {examples}")
    return lines
