"""Coverage: the cells of a set of logs, and the fewest logs that together have all of them.

A cell is an event's kind, road, kind of road user and range of speed. The set of all possible cells is unknown, so the
gaps of a set are the cells of another set that it lacks, by default those of the catalogue, whose families can be
synthesised: a gap names the family that fills it.

`replan suite` chooses by greedy set cover (Chvatal, Math. Oper. Res. 4, 1979: within ln n + 1 of the smallest): the
next log is the one with most cells that no chosen log has; of equal ones that in which a blind driver fails, then the
shorter, then the first by name. A log that a parked driver passes is left out, since it tells no drivers apart.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
import tomli_w

from logs.catalogue import families
from logs.errors import ConfigError
from logs.files import local_path, url_of
from logs.names import counted, visible_name
from replay.draw.report.figures import STYLE, empty_figure, save
from replay.mine.mine import ALONE, FASTER, ROADS, SPEEDS, Mined
from replay.results.tables import write_csv, write_text
from replay.run.claim import FolderContents, claimed_file
from replay.run.sources import SUITE_HEADER, LogSource, Selection

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CELL = ("kind", "road", "agent_kind", "speed")
_ORDER = {
    "road": list(ROADS),
    "agent_kind": ["car", "truck", "bus", "motorcycle", "bicycle", "pedestrian", "object", ALONE],
    "speed": [*(name for _, name in SPEEDS), FASTER],
}
_TITLES = {"road": "road", "agent_kind": "main road user", "speed": "speed of the ego"}


def cells(events: pd.DataFrame) -> pd.DataFrame:
    """The cells of some events, a row each: `CELL`, numbers of events and logs, and the log with most events."""
    rows = []
    for key, group in events.groupby(list(CELL), sort=True):
        counts = group["log"].value_counts()
        most = sorted(counts[counts == counts.max()].index)[0]
        rows.append((*key, len(group), group["log"].nunique(), most))
    return pd.DataFrame(rows, columns=[*CELL, "events", "logs", "example"])


def gaps(have: pd.DataFrame, other: pd.DataFrame) -> pd.DataFrame:
    """The cells of `other` that `have` lacks, as `cells` has them; `example` is a log of the other set."""
    joined = other.merge(have[list(CELL)], on=list(CELL), how="left", indicator=True)
    return joined[joined["_merge"] == "left_only"].drop(columns="_merge").reset_index(drop=True)


def table(have: pd.DataFrame, missing: pd.DataFrame) -> pd.DataFrame:
    """Both as one table, as in coverage.csv; `covered` tells them apart."""
    parts = [have.assign(covered=True), missing.assign(covered=False)]
    return pd.concat([part for part in parts if len(part)] or parts[:1], ignore_index=True)


def figure(events: pd.DataFrame, title: str) -> Figure:
    """The number of events of each kind, by road, by kind of road user and by speed."""
    import matplotlib as mpl
    import numpy as np

    kinds = sorted(events["kind"].unique())
    with mpl.rc_context({**STYLE, "axes.grid": False}):
        drawn = empty_figure(13.0, 1.6 + 0.27 * max(len(kinds), 1))
        axes = drawn.subplots(1, len(_ORDER), sharey=True, width_ratios=[len(each) for each in _ORDER.values()])
        for place, (column, names) in zip(axes, _ORDER.items(), strict=True):
            counts = pd.crosstab(events["kind"], events[column]).reindex(index=kinds, columns=names, fill_value=0)
            values = counts.to_numpy(float)
            most = np.log1p(max(values.max(initial=0.0), 30.0))
            place.imshow(np.log1p(values), cmap="Blues", aspect="auto", vmin=0.0, vmax=most)
            for i, j in np.argwhere(values > 0).tolist():
                dark = np.log1p(values[i, j]) > 0.6 * most
                place.text(j, i, f"{values[i, j]:.0f}", ha="center", va="center", color="white" if dark else "black")
            place.set_xticks(range(len(names)), names, rotation=40, ha="right")
            place.set_yticks(range(len(kinds)), kinds)
            place.set_title(_TITLES[column])
        drawn.suptitle(title)
    return drawn


def catalogue() -> Selection:
    """Every family of the catalogue, at its defaults."""
    return Selection(tuple(LogSource(name) for name in families()))


COVERAGE = FolderContents("coverage", ("coverage.csv", "coverage.png"), resumes=False)


def write_coverage(out: Path, events: pd.DataFrame, rows: pd.DataFrame) -> None:
    """Write coverage.csv and coverage.png into a folder of mined logs; OutputError if that fails."""
    write_csv(out / "coverage.csv", rows)
    title = f"{counted(len(events), 'event')} in {counted(events['log'].nunique(), 'log')}"
    save(figure(events, title), out / "coverage.png")


def lines(have: pd.DataFrame, missing: pd.DataFrame, source: str) -> list[str]:
    """The cells in words: their number, and the gaps by kind with a log of `source` that fills each."""
    found = [f"{counted(len(have), 'cell')} covered; {counted(len(missing), 'cell')} of {source} not"]
    for kind, group in missing.groupby("kind", sort=True):
        examples: Sequence[str] = list(dict.fromkeys(group["example"]))
        shown = ", ".join(examples[:3]) + (f" and {len(examples) - 3} more" if len(examples) > 3 else "")
        found.append(f"    {kind}: {counted(len(group), 'cell')}, for example in {shown}")
    return found


# the fewest logs --------------------------------------------------------------------------------------------------

Cell = tuple[str, ...]


@dataclass(frozen=True)
class ChosenLog:
    """A log of the suite, the number of cells that it adds to the logs before it, and what a blind driver breaks."""

    log: str
    source: str
    adds: int
    blind_breaks: str


def smallest_cover(cells: Mapping[str, frozenset[Cell]], cost: Mapping[str, tuple[bool, float]]) -> list[str]:
    """Logs that together have all cells, in the order in which they are chosen.

    Args:
        cells: The cells of each log.
        cost: Of logs that add equally many cells the one with the least is chosen: without interaction, length in s.
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
        ConfigError: No event was found in a log that tells drivers apart: there is nothing to cover.
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
        found.append(ChosenLog(log, str(of_log.loc[log, "source"]), len(cells[log] - seen), blind[log]))
        seen |= cells[log]
    return found


@contextmanager
def suite_writer(out: Path) -> Iterator[Callable[[Sequence[ChosenLog], Path], None]]:
    """The function that writes a suite as TOML into a claimed file, with paths relative to the file.

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
                what = f"a blind driver breaks {one.blind_breaks}" if one.blind_breaks else "no interaction"
                lines.append(f"# {visible_name(one.log, inf)}: {counted(one.adds, 'cell')}; {visible_name(what, inf)}")
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
