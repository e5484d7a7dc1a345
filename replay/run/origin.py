"""Where the logs of a run are: `origin.json` says in which directory it was started, so that it is read from any.

Logs are called as they were given, mostly relative to that directory. It is kept as it is seen from the results, for
those that were moved together with their logs, and as it was called, for those that were moved without.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from logs.errors import ConfigError
from logs.files import local_path, url_of
from logs.mcap import read_scenario
from logs.readers import LogSettings
from logs.scenario import Scenario
from replay.results.tables import ORIGIN, write_json
from replay.run.sources import LogSource, log_hash, select


def write_origin(out: Path, begun: Path | None = None) -> None:
    """Note beside the results where they were begun (None: in the working directory); OutputError."""
    here = begun or Path.cwd()
    try:
        seen = Path(os.path.relpath(here, out.resolve())).as_posix()
    except ValueError:  # on another drive of Windows
        seen = ""
    write_json(out / ORIGIN, {"directory": str(here), "from_results": seen})


def begun_in(out: Path, sources: Iterable[str]) -> Path:
    """Where results were begun: the first place from which one of their logs is seen, else the working directory."""
    logs = [local_path(source) for source in sources if not url_of(source)]
    seen = (place for place in _directories(out) if any((place / log).exists() for log in logs))
    return Path(os.path.normpath(next(seen, Path.cwd())))


def scenario_of(out: Path, row: Mapping[Any, Any], settings: LogSettings) -> Scenario:
    """The log of a row of `Results.logs`: the copy in the results where there is one, else from where it was read.

    Raises:
        ConfigError: It is not where it was, or another.
        LogError: It cannot be read.
    """
    folder = str(row.get("folder", ""))
    if folder and (out / folder / "log.mcap").is_file():
        return read_scenario(out / folder / "log.mcap")
    if not str(row["sha256"]):
        return LogSource(str(row["source"])).read()
    return log_of(out, str(row["source"]), str(row["sha256"]), settings)


def log_of(out: Path, source: str, digest: str, settings: LogSettings) -> Scenario:
    """The log that a run read, from where it was read.

    Args:
        out: The result folder.
        source: The log's path or URL as it was given.
        digest: SHA-256 of its bytes.
        settings: How it is read.

    Raises:
        ConfigError: It is not where it was, or another.
        LogError: It cannot be read.
    """
    if url_of(source):
        found = select([source], settings).sources[0]
    else:
        places = list(dict.fromkeys(Path(os.path.normpath(place / local_path(source))) for place in _directories(out)))
        there = [LogSource(str(place), place, settings) for place in places if place.exists()]
        if not there:
            where = " nor at ".join(map(str, places))
            raise ConfigError(f"{source}: the log of these results is not at {where}; put it back there")
        found = next((one for one in there if one.path and log_hash(one.path, settings) == digest), there[0])
    with found.fetched() as near:
        assert near.path is not None
        if log_hash(near.path, settings) != digest:
            raise ConfigError(f"{found.label}: is not the log of these results any more, its bytes are others")
        return near.read()


def _directories(out: Path) -> list[Path]:
    """Where the paths of a run may begin, in the order in which they are tried."""
    try:
        card = json.loads((out / ORIGIN).read_text(encoding="utf-8"))
        seen, called = str(card["from_results"]), Path(card["directory"])
    except (OSError, ValueError, KeyError, TypeError):  # results of an older replan
        return [Path.cwd()]
    return [*([out.resolve() / seen] if seen else []), called, Path.cwd()]
