"""The shards of a run put together: the tables are those of the run that drove all logs itself, byte for byte.

What cannot be the same is a clock: `timings.parquet`, and what is judged by it (`deadline_s`).
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from logs.errors import ConfigError, writing
from logs.files import read_toml
from logs.names import counted
from replay.config import load_run
from replay.planner_process.planner_config import planner_factory
from replay.results.load import Results
from replay.results.log_result import Failure, LogResult, Stamp, load_result
from replay.results.schema import SCHEMA_VERSION
from replay.results.tables import PARTIAL, SHARD_CARD, claim, write_text
from replay.run.evaluate import gates_of, judge_and_write
from replay.run.lock import held
from replay.run.origin import begun_in, write_origin
from replay.run.resume import changes, stamp_of
from replay.run.shard import Shard
from replay.run.sources import LogSource, Selection


@dataclass(frozen=True, eq=False)
class Part:
    """A shard's folder, read.

    Attributes:
        folder: Where it is.
        shard: Which it is.
        inputs: Of all logs of the run: what tells them from every other (`LogSource.identity`).
        dropped: Why logs were left out of the selection.
        gates: The text of the thresholds; None: the packaged ones.
        stamp: Version and code of replan and of the user's planners and metrics.
        failures: What is about no log.
        results: What came of its logs, in their order.
    """

    folder: Path
    shard: Shard
    inputs: tuple[str, ...]
    dropped: tuple[str, ...]
    gates: str | None
    stamp: Stamp
    failures: tuple[Failure, ...]
    results: tuple[LogResult, ...]


def merge(folders: Sequence[Path | str], out: Path | str) -> Results:
    """Judge the logs of all shards together and write one result folder.

    Args:
        folders: Of all shards of a run (`evaluate_logs(shard=...)`), in any order.
        out: Result folder: new, empty, or results of an earlier run, which are replaced.

    Raises:
        ConfigError: A folder is no whole shard; they are of different runs (logs, configuration, gates, version, code),
            or of another version or code than there is now; one is there twice or missing; `out` is not ours to write,
            or in use.
        OutputError: The disk is full.
    """
    found, out = _parts([Path(folder) for folder in folders]), Path(out)
    for part in found:
        theirs, ours = part.folder.resolve(), out.resolve()
        if theirs.is_relative_to(ours) or ours.is_relative_to(theirs):
            raise ConfigError(f"{out}: the shard {part.folder} lies there; give -o another folder")
    text = (found[0].folder / "run.toml").read_text(encoding="utf-8")
    run = replace(load_run(found[0].folder / "run.toml"), gates=str(read_toml(found[0].folder / "run.toml")["gates"]))
    with gates_in(found[0].folder) as path:
        gates = gates_of(run, path)
    with held(out):
        claim(out)
        write_text(out / "run.toml", text)
        write_origin(out, begun_in(found[0].folder, (result.source for result in found[0].results)))
        _copy_folders(found, out)
        placed = {
            place: result
            for part in found
            for place, result in zip(part.shard.places(len(part.inputs)), part.results, strict=True)
        }
        results = tuple(placed[place] for place in range(len(placed)))
        sources = tuple(LogSource(result.source) for result in results)  # by label alone: no log is read any more
        return judge_and_write(out, run, Selection(sources, found[0].dropped), results, gates, found[0].failures)


@contextmanager
def gates_in(shard: Path) -> Iterator[Path | None]:
    """The thresholds of a shard as a file, for a while; None: the packaged ones. ConfigError: it is no whole shard."""
    text = _card(shard)["gates"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "gates.toml"
        path.write_text(text or "", encoding="utf-8")
        yield None if text is None else path


def _parts(folders: Sequence[Path]) -> tuple[Part, ...]:
    """The shards in these folders, by number: all of one run, each once, of what replan is now; else ConfigError."""
    if not folders:
        raise ConfigError("name the folders of all shards: replan merge SHARD1 SHARD2 ... -o OUT")
    found = sorted((_part(folder) for folder in folders), key=lambda one: (one.shard.number, str(one.folder)))
    for other in found[1:]:
        _check_same(found[0], other)
    of, numbers = found[0].shard.of, Counter(part.shard.number for part in found)
    twice = [part for part in found if numbers[part.shard.number] > 1]
    if twice:
        raise ConfigError(f"{twice[0].folder} and {twice[1].folder} are both shard {twice[0].shard}")
    missing = [str(Shard(number, of)) for number in range(1, of + 1) if number not in numbers]
    if missing:
        raise ConfigError(f"shards are missing: {', '.join(missing)}; given are {len(found)} of {of}")
    run = load_run(found[0].folder / "run.toml")
    for planner in run.planners:
        planner_factory(planner)  # says what is not installed
    now = stamp_of(run)
    if now != found[0].stamp:
        raise ConfigError(f"{found[0].folder}: was driven with {_said(found[0].stamp)}, this is {_said(now)}")
    return tuple(found)


def _card(folder: Path) -> Mapping[str, Any]:
    """What `shard.json` says; ConfigError where it is not there or of another version."""
    try:
        card: Mapping[str, Any] = json.loads((folder / SHARD_CARD).read_text(encoding="utf-8"))
    except FileNotFoundError:
        hint = "it was evaluated without --shard, or interrupted: `--resume` finishes it"
        raise ConfigError(f"{folder}: is no whole shard: no {SHARD_CARD} in it; {hint}") from None
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{folder / SHARD_CARD}: cannot be read: {error}") from None
    if card.get("schema_version") != SCHEMA_VERSION:
        was = card.get("schema_version")
        raise ConfigError(f"{folder}: its tables are of version {was}, this replan reads {SCHEMA_VERSION}")
    return card


def _part(folder: Path) -> Part:
    card = _card(folder)
    return Part(
        folder,
        Shard(card["number"], card["of"]),
        tuple(card["inputs"]),
        tuple(card["logs_left_out"]),
        card["gates"],
        Stamp(card["replan"], card["code"]),
        tuple(Failure(**failure) for failure in card["failures"]),
        tuple(_result(folder, log) for log in card["logs"]),
    )


def _result(folder: Path, card: Mapping[str, Any]) -> LogResult:
    if not card["folder"]:
        failures = tuple(Failure(**failure) for failure in card["failures"])
        return LogResult(card["source"], card["log"], failures=failures)
    content = load_result(folder / card["folder"])
    if content is None:
        raise ConfigError(
            f"{folder}: the folder {card['folder']} in it is not there or not whole; copy the shard again"
        )
    return replace(content[0], source=card["source"])


def _check_same(one: Part, other: Part) -> None:
    """Refuse two shards of different runs."""
    both = f"{one.folder} and {other.folder} are not of one run"
    if one.shard.of != other.shard.of:
        raise ConfigError(f"{both}: shard {one.shard} and shard {other.shard}")
    if one.inputs != other.inputs:
        mine, theirs = Counter(one.inputs), Counter(other.inputs)
        differing = [*(mine - theirs), *(theirs - mine)] or ["their order"]
        raise ConfigError(
            f"{both}: {len(one.inputs)} and {counted(len(other.inputs), 'log')}; they differ in {differing[0]}"
        )
    if one.stamp != other.stamp:
        raise ConfigError(f"{both}: driven with {_said(one.stamp)} and with {_said(other.stamp)}")
    changed = changes(read_toml(one.folder / "run.toml"), read_toml(other.folder / "run.toml"))
    if changed:
        raise ConfigError(f"{both}: {changed}")
    if one.gates != other.gates:
        raise ConfigError(f"{both}: their gates are not the same")


def _said(stamp: Stamp) -> str:
    return f"replan {stamp.replan}, code {stamp.code[:8]}"


def _copy_folders(found: Sequence[Part], out: Path) -> None:
    """The folders of the logs, as hard links where the file system has them: no file of them is ever written again."""
    for part in found:
        for result in part.results:
            if result.folder:
                partial = out / f"{PARTIAL}{result.folder}"
                try:
                    with writing(out / result.folder):
                        shutil.copytree(part.folder / result.folder, partial, copy_function=_linked)
                        partial.rename(out / result.folder)
                finally:
                    shutil.rmtree(partial, ignore_errors=True)


def _linked(source: str, target: str) -> str:
    with suppress(OSError):
        os.link(source, target)
        return target
    return str(shutil.copy2(source, target))
