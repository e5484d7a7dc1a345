"""The fewest logs that together have all cells of a set (`replan.mine.coverage`).

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

import pandas as pd
import tomli_w

from replan.core.errors import ConfigError
from replan.core.names import counted, visible_name
from replan.core.urls import local_path, url_of
from replan.logs.catalogue import families
from replan.mine.coverage import CELL
from replan.mine.mine import Mined
from replan.results.tables import write_text
from replan.run.claim import claimed_file
from replan.run.sources import SUITE_HEADER

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

    @property
    def comment(self) -> str:
        """The line of the log in the file of the suite."""
        reason = "no interaction"
        if self.blind_breaks:
            reason = f"a blind driver breaks {self.blind_breaks}"
        name, cells = visible_name(self.log, inf), counted(self.adds, "cell")
        return f"# {name}: {cells}; {visible_name(reason, inf)}"


def smallest_cover(
    cells_by_log: Mapping[str, frozenset[Cell]], cost: Mapping[str, tuple[bool, float]]
) -> list[str]:
    """Logs that together have all cells, in the order in which they are chosen.

    Of logs that add equally many cells the one with the least cost is chosen: without interaction,
    length in s.
    """
    missing = set().union(*cells_by_log.values())
    chosen: list[str] = []
    while missing:
        adds = {log: len(cells & missing) for log, cells in cells_by_log.items()}
        chosen.append(min(adds, key=lambda log: (-adds[log], cost[log], log)))
        missing -= cells_by_log[chosen[-1]]
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
    cells_by_log = {str(log): frozenset(group["cell"]) for log, group in rows.groupby("log")}
    blind = {str(log): str(breaks) for log, breaks in of_log["blind_breaks"].items()}
    seconds = dict(zip(blind, of_log["duration_s"].tolist(), strict=True))
    cost = {log: (not breaks, seconds[log]) for log, breaks in blind.items()}
    covered: set[Cell] = set()
    suite = []
    for log in smallest_cover(cells_by_log, cost):
        adds = len(cells_by_log[log] - covered)
        suite.append(ChosenLog(log, str(of_log.loc[log, "source"]), adds, blind[log]))
        covered |= cells_by_log[log]
    return suite


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
    with claimed_file(out, (".toml",), lambda file: file.read_bytes().startswith(header)) as file:

        def write(suite: Sequence[ChosenLog], begun: Path) -> None:
            places = [_place(chosen.source, begun, file.parent) for chosen in suite]
            comments = [chosen.comment for chosen in suite]
            write_text(file, "\n".join([SUITE_HEADER, *comments, tomli_w.dumps({"logs": places})]))

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
