"""`replan suite`: the fewest logs that have all kinds of events and all cells of a set, as a file for `--suite`.

Greedy set cover (Chvatal, Math. Oper. Res. 4, 1979: within ln n + 1 of the smallest): the log that has most of what no
chosen log has comes next; of equals the shorter one, then the first by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from logs.errors import ConfigError
from logs.names import counted
from replay.mine.coverage import CELL
from replay.mine.mine import Mined
from replay.results.tables import write_text
from replay.run.sources import SUITE_HEADER

Cell = tuple[str, ...]


@dataclass(frozen=True)
class Chosen:
    """A log of the suite, and how many cells it adds to those before it."""

    log: str
    source: str
    adds: int


def smallest_cover(cells: Mapping[str, frozenset[Cell]], seconds: Mapping[str, float]) -> list[str]:
    """Logs that together have all cells, in the order in which they are chosen.

    Args:
        cells: The cells of each log.
        seconds: How long each log is.
    """
    left = set().union(*cells.values()) if cells else set()
    chosen: list[str] = []
    while left:
        best = min(cells, key=lambda log: (-len(cells[log] & left), seconds[log], log))
        left -= cells[best]
        chosen.append(best)
    return chosen


def suite_of(mined: Mined) -> list[Chosen]:
    """The suite of mined logs.

    Raises:
        ConfigError: No event was found: there is nothing to cover.
    """
    if mined.events.empty:
        raise ConfigError("no event was found in these logs: there is nothing to choose them by")
    keys = mined.events[list(CELL)].itertuples(index=False, name=None)
    rows = pd.DataFrame({"log": mined.events["log"], "cell": list(keys)})
    cells = {str(log): frozenset(group["cell"]) for log, group in rows.groupby("log")}
    seconds = dict(zip(mined.logs["log"], mined.logs["duration_s"], strict=True))
    sources = dict(zip(mined.logs["log"], mined.logs["source"], strict=True))
    seen: set[Cell] = set()
    found = []
    for log in smallest_cover(cells, seconds):
        found.append(Chosen(log, str(sources[log]), len(cells[log] - seen)))
        seen |= cells[log]
    return found


def write_suite(chosen: list[Chosen], out: Path, begun: Path) -> None:
    """Write the suite as TOML; paths are relative to its folder where they can be.

    Args:
        chosen: The logs.
        out: The file.
        begun: Where relative sources begin.

    Raises:
        OutputError: The file cannot be written.
    """
    rows = []
    for one in chosen:
        path = begun / one.source
        place = one.source
        if path.exists():
            whole, folder = path.resolve(), out.parent.resolve()
            place = whole.relative_to(folder).as_posix() if whole.is_relative_to(folder) else str(whole)
        rows.append(f'    "{place}",  # {one.log}: {counted(one.adds, "cell")}')
    out.parent.mkdir(parents=True, exist_ok=True)
    write_text(out, "\n".join([SUITE_HEADER, "logs = [", *rows, "]", ""]))
