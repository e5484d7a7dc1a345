"""Coverage: the cells of a set of logs, and the fewest logs that together have all of them.

A cell is an event's kind, road, kind of road user and range of speed. The set of all possible cells
is unknown, so the gaps of a set are the cells of another set that it lacks, by default those of the
catalogue, whose families can be synthesised: a gap names the family that fills it.

`replan suite` chooses by greedy set cover (Chvatal, Math. Oper. Res. 4, 1979: within ln n + 1 of
the smallest): the next log is the one with most cells that no chosen log has; of equal ones that in
which a blind driver fails, then the shorter, then the first by name. A log that a parked driver
passes is left out, since it tells no drivers apart.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np
import pandas as pd
import tomli_w

from replan.core.errors import ConfigError
from replan.core.files import local_path, url_of
from replan.core.names import counted, listed, visible_name
from replan.draw.charts.axes import rows_plane
from replan.draw.charts.canvas import Chart
from replan.draw.charts.layout import GAP_PX, together
from replan.logs.catalogue import families
from replan.mine.mine import ALONE, FASTER, ROADS, SPEEDS, Mined
from replan.results.tables import write_csv, write_text
from replan.run.claim import FolderContents, claimed_file
from replan.run.sources import SUITE_HEADER, LogSource, Selection

CELL = ("kind", "road", "agent_kind", "speed")
_ORDER = {
    "road": list(ROADS),
    "agent_kind": ["car", "truck", "bus", "motorcycle", "bicycle", "pedestrian", "object", ALONE],
    "speed": [*(name for _, name in SPEEDS), FASTER],
}
_TITLES = {"road": "road", "agent_kind": "main road user", "speed": "speed of the ego"}
CELL_PX, NAMES_PX = (70.0, 20.0), 150.0


def cells(events: pd.DataFrame) -> pd.DataFrame:
    """The cells of some events, a row each: `CELL`, numbers of events and logs, and the log with
    most events.
    """
    rows = []
    for key, group in events.groupby(list(CELL), sort=True):
        counts = group["log"].value_counts()
        most = sorted(counts[counts == counts.max()].index)[0]
        rows.append((*key, len(group), group["log"].nunique(), most))
    return pd.DataFrame(rows, columns=[*CELL, "events", "logs", "example"])


def gaps(have: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    """The cells of `other` that `have` lacks, as `cells` has them; `example` is a log of the other
    set.
    """
    joined = other.merge(have[list(CELL)], on=list(CELL), how="left", indicator=True)
    return joined[joined["_merge"] == "left_only"].drop(columns="_merge").reset_index(drop=True)


def table(have: pd.DataFrame, missing: pd.DataFrame) -> pd.DataFrame:
    """Both as one table, as in coverage.csv; `covered` tells them apart."""
    parts = [have.assign(covered=True), missing.assign(covered=False)]
    return pd.concat([part for part in parts if len(part)] or parts[:1], ignore_index=True)


def figure(events: pd.DataFrame, title: str) -> Chart:
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
        numbers = counts.to_numpy()
        for i, j in np.argwhere(numbers > 0).tolist():
            count, at = int(numbers[i, j]), rows[i][0]
            inside += plane.heat(
                (j, j + 1.0), (at - 0.5, at + 0.5), float(np.log1p(count)), (-1.0, 1.3 * most)
            )
            over += plane.words(j + 0.5, at, str(count))
        words = [(j + 0.5, name) for j, name in enumerate(names)]
        charts.append(
            plane.chart(column, _TITLES[column], inside, x_ticks=words, y_ticks=rows, over=over)
        )
    return together(charts, title, "", sum(one.width + GAP_PX for one in charts))


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
    figure(events, title).save(out / "coverage.png")


def lines(have: pd.DataFrame, missing: pd.DataFrame, source: str) -> list[str]:
    """The cells in words: their number, and the gaps by kind with a log of `source` that fills
    each.
    """
    found = [
        f"{counted(len(have), 'cell')} covered; {counted(len(missing), 'cell')} of {source} not"
    ]
    for kind, group in missing.groupby("kind", sort=True):
        examples = listed(list(dict.fromkeys(group["example"])), 3)
        found.append(f"    {kind}: {counted(len(group), 'cell')}, for example in {examples}")
    return found


# the fewest logs ----------------------------------------------------------------------------------

Cell = tuple[str, ...]


@dataclass(frozen=True)
class ChosenLog:
    """A log of the suite, the number of cells that it adds to the logs before it, and what a blind
    driver breaks.
    """

    log: str
    source: str
    adds: int
    blind_breaks: str


def smallest_cover(
    cells: Mapping[str, frozenset[Cell]], cost: Mapping[str, tuple[bool, float]]
) -> list[str]:
    """Logs that together have all cells, in the order in which they are chosen.

    Of logs that add equally many cells the one with the least cost is chosen: without interaction,
    length in s.
    """
    left = set().union(*cells.values()) if cells else set()
    chosen: list[str] = []
    while left:
        best = min(cells, key=lambda log: (-len(cells[log] & left), cost[log], log))
        left -= cells[best]
        chosen.append(best)
    return chosen


def suite_of(mined: Mined) -> list[ChosenLog]:
    """The suite of mined logs.

    Raises:
        ConfigError: No event was found in a log that tells drivers apart: there is nothing to
            cover.
    """
    of_log = mined.logs.set_index("log")
    apart = (of_log["parked_breaks"] != "") & (of_log["creeping_breaks"] != "")
    events = mined.events[mined.events["log"].map(apart).astype(bool)]
    if events.empty:
        columns = "parked_breaks, creeping_breaks in logs.parquet"
        easy = f" that parked and creeping drivers fail ({columns})" if len(mined.events) else ""
        raise ConfigError(f"no event was found in logs{easy}: there is nothing to choose them by")
    keys = events[list(CELL)].itertuples(index=False, name=None)
    rows = pd.DataFrame({"log": events["log"], "cell": list(keys)})
    cells = {str(log): frozenset(group["cell"]) for log, group in rows.groupby("log")}
    blind = {str(log): str(breaks) for log, breaks in of_log["blind_breaks"].items()}
    seconds = dict(zip(blind, of_log["duration_s"].tolist(), strict=True))
    cost = {log: (not breaks, seconds[log]) for log, breaks in blind.items()}
    seen: set[Cell] = set()
    found = []
    for log in smallest_cover(cells, cost):
        found.append(
            ChosenLog(log, str(of_log.loc[log, "source"]), len(cells[log] - seen), blind[log])
        )
        seen |= cells[log]
    return found


@contextmanager
def suite_writer(out: Path) -> Iterator[Callable[[Sequence[ChosenLog], Path], None]]:
    """The function that writes a suite as TOML into a claimed file, with paths relative to the
    file.

    It takes the logs, and the directory to which relative sources refer.

    Raises:
        ConfigError: The file must not be written, or a log is not there.
        OutputError: The file cannot be written.
    """
    header = f"{SUITE_HEADER}\n".encode()
    with claimed_file(out, (".toml",), lambda file: file.read_bytes().startswith(header)) as out:

        def write(chosen: Sequence[ChosenLog], begun: Path) -> None:
            lines, places = [SUITE_HEADER], list[str]()
            for one in chosen:
                places.append(_place(one.source, begun, out.parent))
                what = (
                    f"a blind driver breaks {one.blind_breaks}"
                    if one.blind_breaks
                    else "no interaction"
                )
                lines.append(
                    f"# {visible_name(one.log, inf)}: {counted(one.adds, 'cell')}; "
                    f"{visible_name(what, inf)}"
                )
            write_text(out, "\n".join([*lines, tomli_w.dumps({"logs": places})]))

        yield write


def _place(source: str, begun: Path, folder: Path) -> str:
    """The path of a log relative to a folder, or its URL."""
    if url_of(source):
        return source
    if (family := source.partition("@")[0]) in families():
        remedy = f"write the logs first, and mine those: replan synth {family} -o my_logs"
        raise ConfigError(f"{source}: is a log of the catalogue, and not a file; {remedy}")
    path = begun / local_path(source)
    if not path.exists():
        remedy = "put it there, or mine again where the logs are"
        raise ConfigError(f"{source}: the log of these results is not at {path}; {remedy}")
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
