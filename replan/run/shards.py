"""Splits a run over machines: shard i of n drives every n-th log, and `merge` makes the tables of
all shards.

The i-th of n shards (from 1) has the logs i, i + n, i + 2n, ... of the selection. The logs of a
folder are in the order of their names and those of a suite with its families mixed, so that logs of
one kind, which take about the same time, are distributed evenly; and the shard of a log depends
only on its position.

A shard measures and does not judge: a gate's outcome on a part (a mean, a share, missing logs) need
not hold for all. Its folder also holds `shard.json`: the number of the shard, all logs of the run,
the gates, and the failures of logs without a folder. The tables of all shards are made from the
folders of the logs, as by `--resume`: they are equal, byte for byte, to those of a run that drives
all logs itself, except for measured times: `timings.parquet`, and the verdicts on `deadline_s`.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from replan.config import RunConfig, load_run
from replan.core.errors import ConfigError
from replan.core.files import read_toml
from replan.core.names import counted
from replan.draw.drawn_results import Results
from replan.replay.planner_process.planner_config import is_foreign, planner_part
from replan.results.log_result import Failure, LogResult, Stamp, load_result
from replan.results.schema import Name, Place, read_json
from replan.results.tables import SHARD_CARD, write_folder, write_json, write_text
from replan.run.claim import MERGED, claimed_folder, emptied
from replan.run.judging import explained, gates_of, judge_and_write
from replan.run.log_source import LogSource
from replan.run.output import begun_in, write_origin
from replan.run.resume import changes, identity_of, stamp_of
from replan.run.sources import Selection


@dataclass(frozen=True)
class Shard:
    """A part of a run."""

    number: int  # Number of this shard, from 1
    of: int  # Number of all shards

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.of:
            raise ConfigError(f"shard {self}: write it as I/N with I from 1 to N, for example 2/5")

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"

    @classmethod
    def parsed(cls, text: str) -> Shard:
        """Parse a shard such as "2/5"; ConfigError if the text is invalid."""
        number, _, of = text.partition("/")
        if not (number.isdecimal() and of.isdecimal()):
            raise ConfigError(
                f"shard {text!r}: write it as I/N with I from 1 to N, for example 2/5"
            )
        return cls(int(number), int(of))

    def places(self, count: int) -> range:
        """Indices of its logs among `count` logs, from 0."""
        return range(self.number - 1, count, self.of)

    def part(self, selection: Selection) -> Selection:
        """Its logs; may be empty if there are fewer logs than shards."""
        return replace(selection, sources=selection.sources[self.number - 1 :: self.of])


def write_card(
    out: Path,
    shard: Shard,
    whole: Selection,
    run: RunConfig,
    stamp: Stamp,
    failures: Iterable[Failure],
    results: Iterable[LogResult],
) -> None:
    """Write `shard.json` into a shard's folder, which marks it as complete.

    `stamp`: version and code on which the results depend. `results`: results in the order of the
    shard's logs, under the names in their own folders.
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
            log |= {
                "log": result.name,
                "failures": [asdict(failure) for failure in result.failures],
            }
        card["logs"].append(log)
    write_json(out / SHARD_CARD, card)


class ShardLog(msgspec.Struct):
    """A log in `ShardCard`; without a folder it has a name and failures."""

    source: Place
    folder: Name
    log: str = ""
    failures: tuple[Failure, ...] = ()


class ShardCard(msgspec.Struct):
    """The contents of shard.json."""

    number: int
    of: int
    inputs: tuple[str, ...]
    logs_left_out: tuple[str, ...]
    gates: str | None
    replan: str
    code: str
    failures: tuple[Failure, ...]
    logs: tuple[ShardLog, ...]


@dataclass(frozen=True, eq=False)
class ShardContents:
    """A complete shard: its folder, the contents of its `shard.json`, and the results of its logs,
    in their order.
    """

    folder: Path
    card: ShardCard
    results: tuple[LogResult, ...]

    @property
    def shard(self) -> Shard:
        """Its number; ConfigError if there is no such shard."""
        return Shard(self.card.number, self.card.of)

    @property
    def stamp(self) -> Stamp:
        """Version and code of replan and of the user's planners and metrics."""
        return Stamp(self.card.replan, self.card.code)


def merge(folders: Sequence[Path | str], out: Path | str) -> Results:
    """Judge the logs of all shards together and write one result folder.

    `folders`: folders of all shards of a run (`evaluate_logs(shard=...)`), in any order. `out`:
    result folder: new, empty, or results of an earlier run, which are replaced. ConfigError if a
    folder is not a complete shard; the shards are of different runs (logs, configuration, gates,
    version, code), or of another version or code than this replan; one is duplicate or missing;
    `out` must not be written, or is in use. OutputError if the disk is full.
    """
    parts, result_folder = _read_parts([Path(folder) for folder in folders]), Path(out)
    for part in parts:
        shard_folder, target = part.folder.resolve(), result_folder.resolve()
        if shard_folder.is_relative_to(target) or target.is_relative_to(shard_folder):
            raise ConfigError(f"{out}: the shard {part.folder} lies there; give -o another folder")
    run = load_run(parts[0].folder / "run.toml")
    with gates_in(parts[0].folder) as path:
        gates = gates_of(run, path)
    with claimed_folder(result_folder, MERGED):
        emptied(result_folder)
        write_text(result_folder / "run.toml", explained(run, result_folder))
        write_origin(
            result_folder, begun_in(parts[0].folder, (result.source for result in parts[0].results))
        )
        placed: dict[int, LogResult] = {}
        for part in parts:
            placed.update(zip(part.shard.places(len(part.card.inputs)), part.results, strict=True))
            for folder in (result.folder for result in part.results if result.folder):
                copy = partial(shutil.copytree, part.folder / folder, copy_function=_link_or_copy)
                write_folder(result_folder / folder, copy)  # twins in two shards: the first counts
        results = tuple(placed[position] for position in range(len(placed)))
        # Labels only: no log is read again
        sources = tuple(LogSource(result.source) for result in results)
        selection = Selection(sources, parts[0].card.logs_left_out)
        return judge_and_write(
            result_folder, run, selection, results, gates, parts[0].card.failures
        )


@contextmanager
def gates_in(shard: Path) -> Iterator[Path | None]:
    """The gates of a shard as a temporary file; None: the packaged ones.

    ConfigError if the shard is not complete.
    """
    text = _card(shard).gates
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gates.toml"
        path.write_text(text or "", encoding="utf-8")
        yield None if text is None else path


def _read_parts(folders: Sequence[Path]) -> tuple[ShardContents, ...]:
    """The shards in these folders, by number; ConfigError unless all are of one run and of this
    replan, each once.
    """
    if not folders:
        raise ConfigError("name the folders of all shards: replan merge SHARD1 SHARD2 ... -o OUT")
    parts = sorted(
        (_read_part(folder) for folder in folders),
        key=lambda part: (part.shard.number, str(part.folder)),
    )
    first = parts[0]
    for other in parts[1:]:
        not_one_run = f"{first.folder} and {other.folder} are not of one run"
        if first.shard.of != other.shard.of:
            raise ConfigError(f"{not_one_run}: shard {first.shard} and shard {other.shard}")
        if first.card.inputs != other.card.inputs:
            first_inputs, other_inputs = Counter(first.card.inputs), Counter(other.card.inputs)
            differing = [*(first_inputs - other_inputs), *(other_inputs - first_inputs)] or [
                "their order"
            ]
            counts = f"{len(first.card.inputs)} and {counted(len(other.card.inputs), 'log')}"
            raise ConfigError(f"{not_one_run}: {counts}; they differ in {differing[0]}")
        if first.stamp != other.stamp:
            stamps = f"{_describe(first.stamp)} and with {_describe(other.stamp)}"
            raise ConfigError(f"{not_one_run}: driven with {stamps}")
        first_run, other_run = (read_toml(part.folder / "run.toml") for part in (first, other))
        changed = changes(first_run, other_run, ("selection",))
        if changed:
            raise ConfigError(f"{not_one_run}: {changed}")
        if first.card.gates != other.card.gates:
            raise ConfigError(f"{not_one_run}: their gates are not the same")
    of, numbers = first.shard.of, Counter(part.shard.number for part in parts)
    twice = [part for part in parts if numbers[part.shard.number] > 1]
    if twice:
        raise ConfigError(
            f"{twice[0].folder} and {twice[1].folder} are both shard {twice[0].shard}"
        )
    missing = [str(Shard(number, of)) for number in range(1, of + 1) if number not in numbers]
    if missing:
        raise ConfigError(
            f"shards are missing: {', '.join(missing)}; given are {len(parts)} of {of}"
        )
    run = load_run(first.folder / "run.toml")
    for planner in run.planners:
        if not is_foreign(planner):
            _ = planner_part(planner).factory  # raises an error that names a missing package
    now = stamp_of(run)
    if now != first.stamp:
        raise ConfigError(
            f"{first.folder}: was driven with {_describe(first.stamp)}, this is {_describe(now)}"
        )
    return tuple(parts)


def _card(folder: Path) -> ShardCard:
    """The contents of `shard.json`; ConfigError if it is missing or of another version."""
    if not (folder / SHARD_CARD).exists():
        hint = "it was evaluated without --shard, or interrupted: `--resume` finishes it"
        raise ConfigError(f"{folder}: is no whole shard: no {SHARD_CARD} in it; {hint}")
    return read_json(folder / SHARD_CARD, ShardCard)[1]


def _read_part(folder: Path) -> ShardContents:
    card, results = _card(folder), list[LogResult]()
    for log in card.logs:
        if not log.folder:
            results.append(LogResult(log.source, log.log, failures=log.failures))
            continue
        content = load_result(folder / log.folder)
        if content is None:
            raise ConfigError(
                f"{folder}: the folder {log.folder} in it is not there or not whole; copy the "
                "shard again"
            )
        results.append(replace(content[0], source=log.source))
    contents = ShardContents(folder, card, tuple(results))
    if len(contents.shard.places(len(card.inputs))) != len(results):
        raise ConfigError(
            f"{folder / SHARD_CARD}: has not the logs of shard {contents.shard}; copy it again"
        )
    return contents


def _describe(stamp: Stamp) -> str:
    return f"replan {stamp.replan}, code {stamp.code[:8]}"


def _link_or_copy(source: str, target: str) -> str:
    """Make a hard link if the file system has them, because files of a log's folder never change;
    otherwise copy.
    """
    with suppress(OSError):
        os.link(source, target)
        return target
    return str(shutil.copy2(source, target))
