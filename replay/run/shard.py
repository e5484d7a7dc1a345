"""A run in parts, on as many machines: shard i of n drives every n-th log, `merge` makes the tables of all of them.

The i-th of n shards (from 1) has the logs i, i + n, i + 2n, ... of the selection. The logs of a folder are in the order
of their names and those of a suite with its families mixed, so that logs of one kind, which take about as long, are
dealt out evenly; and a log's shard depends on nothing but its place.

A shard measures and does not judge: a gate's outcome on a part (a mean, a share, missing logs) need not hold for all.
Its folder also holds `shard.json`: the number of the shard, all logs of the run, the gates, and the failures of logs
without a folder. The tables of all shards are made from the folders of the logs, as by `--resume`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from logs.errors import ConfigError
from replay.config import RunConfig
from replay.results.log_result import Failure, LogResult, Stamp
from replay.results.tables import SHARD_CARD, write_json
from replay.run.resume import identity_of
from replay.run.sources import Selection


@dataclass(frozen=True)
class Shard:
    """A part of a run.

    Attributes:
        number: Which, from 1.
        of: How many there are.
    """

    number: int
    of: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.of:
            raise ConfigError(f"shard {self}: write it as I/N with I from 1 to N, for example 2/5")

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    @classmethod
    def parsed(cls, text: str) -> Shard:
        """The shard that "2/5" means; ConfigError where it means none."""
        number, _, of = text.partition("/")
        if not (number.isdecimal() and of.isdecimal()):
            raise ConfigError(f"shard {text!r}: write it as I/N with I from 1 to N, for example 2/5")
        return cls(int(number), int(of))

    def places(self, count: int) -> range:
        """Which of `count` logs it has, from 0."""
        return range(self.number - 1, count, self.of)

    def part(self, selection: Selection) -> Selection:
        """Its logs; none where there are fewer logs than shards."""
        return replace(selection, sources=selection.sources[self.number - 1 :: self.of])


def write_card(
    out: Path, shard: Shard, whole: Selection, run: RunConfig, stamp: Stamp,
    failures: Iterable[Failure], results: Iterable[LogResult],
) -> None:  # fmt: skip
    """Write `shard.json` into a shard's folder: it is whole now.

    Args:
        out: The folder.
        shard: Which it is.
        whole: The logs of all shards.
        run: As it was driven.
        stamp: What it depends on beside.
        failures: What is about no log.
        results: In the order of the shard's logs, under the names that they have in their own folders.
    """
    card: dict[str, Any] = {
        **asdict(shard),
        "inputs": [identity_of(source) for source in whole.sources],
        "logs_left_out": list(whole.dropped),
        "gates": None if run.gates_path is None else run.gates_path.read_text(encoding="utf-8"),
        **asdict(stamp),
        "failures": [asdict(failure) for failure in failures],
        "logs": [],
    }
    for result in results:
        log: dict[str, Any] = {"source": result.source, "folder": result.folder}
        if not result.folder:
            log |= {"log": result.name, "failures": [asdict(failure) for failure in result.failures]}
        card["logs"].append(log)
    write_json(out / SHARD_CARD, card)
