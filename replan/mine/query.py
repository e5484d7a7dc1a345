"""`replan query`: SQL over the tables of a result folder, read only; `replan cut`: the moments that
it finds, as logs.

The views are the tables of docs/results.md under their names without suffix: for a run `metrics`,
`verdicts`, `groups`, `health`, `timings`, `frames`, `logs`, `drives`, `gates`, `failures`,
`decisions`; for mined logs `events`, `logs`, `health`. Only those whose names are in the query are
read. DuckDB runs one SELECT in memory, with its access to files, networks and extensions locked: a
query can read only these views. Memory, the space of its own temporary folder, time and the size of
the result are limited.

A row of a query gives a log and a moment: its columns `t_from_s` and `t_to_s`, or `time_s`, or
`t_s`. Moments of one log that overlap after `before` and `after` are added are merged. The cut log
is native, with its origin in its metadata ("cut.of", "cut.from_s", "cut.to_s", and the kinds of its
events in "cut.kinds").
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from hashlib import sha256
from itertools import groupby
from math import isfinite
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Timer

import pandas as pd

from replan.config import load_run
from replan.core.errors import ConfigError, LogError, unknown_name
from replan.draw.drawn_results import load
from replan.logs.edit.cut import cut as cut_scenario, in_nanoseconds
from replan.logs.mcap import write_scenario
from replan.logs.scenario import Scenario
from replan.metrics.boxes import ego_boxes
from replan.mine.mine import CARD, EVENTS, HEALTH, LOGS, read_mined
from replan.results.tables import safe_names
from replan.results.version import replan_version
from replan.run.claim import FolderContents, claimed_folder
from replan.run.output import scenario_of
from replan.run.resume import Study

RUN_VIEWS = (
    "metrics",
    "verdicts",
    "groups",
    "health",
    "timings",
    "frames",
    "logs",
    "drives",
    "gates",
    "failures",
    "decisions",
)
MINED_VIEWS = tuple(name.removesuffix(".parquet") for name in (EVENTS, LOGS, HEALTH))
LOCKED = (
    "SET enable_external_access = false",
    "SET autoinstall_known_extensions = false",
    "SET autoload_known_extensions = false",
    "SET python_enable_replacements = false",
    "SET threads = 1",  # a fixed order of rows without ORDER BY
    "SET lock_configuration = true",
)
MEMORY_GB, SPILLED_GB, RESULT_GB = 2, 20, 1
TIME_S = 300.0
"""Limits of a query: memory of DuckDB, disk space where that is not enough, memory of the result,
time.
"""
SMALLER = "ask for less, or open the Parquet files with DuckDB itself"
ROWS = 50
"""Chunks of rows that are fetched at once; a chunk has 2048 rows."""
TIMES = (("t_from_s", "t_to_s"), ("time_s", "time_s"), ("t_s", "t_s"))
CUTS = FolderContents("cut", ("*.mcap",))
LEAST_S = 0.5
"""A cut with less of the log than this is an error."""


def views(folder: Path) -> Mapping[str, Callable[[], pd.DataFrame]]:
    """The function that reads each view of a result folder.

    Raises:
        ConfigError: The folder is neither the result of a run nor of `replan mine`.
    """
    if (folder / CARD).is_file():
        return {name: lambda name=name: getattr(read_mined(folder), name) for name in MINED_VIEWS}  # type: ignore[misc]
    run = load(folder)
    return {name: lambda name=name: getattr(run, name) for name in RUN_VIEWS}  # type: ignore[misc]


def query(folder: Path, sql: str) -> pd.DataFrame:
    """The result rows of one SELECT over the `views` of the result folder of a run or of
    `replan mine`.

    Raises:
        ConfigError: DuckDB is not installed, the SQL is invalid or not a SELECT, or it needs access
            that is locked.
        LogError: A table is damaged.
    """
    try:
        import duckdb
    except ImportError:
        raise ConfigError("queries need DuckDB: pip install 'replan[improve]'") from None
    if not sql.strip():
        raise ConfigError("the query is empty: give one SELECT, for example SELECT * FROM logs")
    known, late = views(folder), False

    def stop() -> None:
        nonlocal late
        late = True
        connection.interrupt()

    timer = Timer(TIME_S, stop)
    with TemporaryDirectory(prefix="replan-") as spilled, duckdb.connect(":memory:") as connection:
        limits = {"memory_limit": f"{MEMORY_GB}GB", "max_temp_directory_size": f"{SPILLED_GB}GB"}
        for name, value in (*limits.items(), ("temp_directory", spilled.replace("'", "''"))):
            connection.execute(f"SET {name} = '{value}'")
        for line in LOCKED:
            connection.execute(line)
        try:
            timer.start()
            statements = connection.extract_statements(sql)
            if len(statements) != 1 or statements[0].type != duckdb.StatementType.SELECT:
                raise ConfigError("the query has to be one SELECT: results are read only")
            for name in sorted(set(re.findall(r"\w+", sql.lower())) & known.keys()):
                connection.register(name, known[name]())
            connection.execute(statements[0])
            parts, size = [connection.fetch_df_chunk(ROWS)], 0
            while len(parts[-1]):
                size += int(parts[-1].memory_usage(deep=True).sum())
                if size > RESULT_GB * 1e9:
                    raise ConfigError(
                        f"the query gives more than {RESULT_GB} GB: add LIMIT, or {SMALLER}"
                    )
                parts.append(connection.fetch_df_chunk(ROWS))
        except duckdb.Error as error:
            words = " ".join(str(error).split("\n\n")[0].split("\nThis limit")[0].split())
            if late:
                words = f"it takes more than {TIME_S:g} s; {SMALLER}"
            elif isinstance(error, duckdb.OutOfMemoryException):
                words = (
                    f"it needs more than {MEMORY_GB} GB of memory and {SPILLED_GB} GB of disk: "
                    f"{SMALLER} ({words})"
                )
            elif isinstance(error, duckdb.CatalogException):
                words = f"{words.partition(' Did you mean')[0]} The views are {', '.join(known)}"
            raise ConfigError(f"the query cannot be run: {words}") from None
        finally:
            timer.cancel()
    return pd.concat(parts[:-1] or parts, ignore_index=True)


# moments as logs ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class FoundMoment:
    """A part of a log.

    Attributes:
        begin: s since the log's start; `end` likewise.
    """

    log: str
    begin: float
    end: float
    kinds: tuple[str, ...]


def moments(
    folder: Path, where: str, table: str = "events", before: float = 5.0, after: float = 8.0
) -> list[FoundMoment]:
    """The moments that a condition, in SQL over the columns of a view, selects, sorted by log and
    begin.

    `before` and `after`, s, are added to each row.

    Raises:
        ConfigError: As `query`; nothing is selected, or the view has no log and time.
    """
    known = views(folder)
    if table not in known:
        raise unknown_name("view", table, known)
    if not where.strip():
        raise ConfigError(
            "--where is empty: give a condition, for example \"kind = 'cut_in'\"; true takes all "
            "rows"
        )
    rows = query(folder, f'SELECT * FROM "{table}" WHERE ({where})')
    times = next((pair for pair in TIMES if set(pair) <= set(rows.columns)), None)
    if times is None or "log" not in rows:
        other = "events, verdicts, metrics, health or decisions"
        raise ConfigError(f"the view {table} has no log and time; cut by {other}")
    rows = rows[rows[times[0]].notna() & rows[times[1]].notna()].sort_values(
        ["log", times[0]], kind="stable"
    )
    if rows.empty:
        raise ConfigError(f"nothing to cut: no row of {table} with a time where {where}")
    parts: list[FoundMoment] = []
    kinds = rows["kind"] if "kind" in rows else pd.Series(table, rows.index)
    for log, begin, end, kind in zip(
        rows["log"], rows[times[0]], rows[times[1]], kinds, strict=True
    ):
        part = FoundMoment(str(log), float(begin) - before, float(end) + after, (str(kind),))
        last = parts[-1] if parts else None
        if last is not None and last.log == part.log and part.begin <= last.end:
            joined = tuple(sorted({*last.kinds, *part.kinds}))
            parts[-1] = FoundMoment(part.log, last.begin, max(last.end, part.end), joined)
        else:
            parts.append(part)
    return parts


def cut_logs(
    folder: Path, parts: Sequence[FoundMoment], out: Path, *, resume: bool = False
) -> Iterator[Path]:
    """Write a native log per moment into a folder; yields each file when it is written.

    `folder` has the results that name the logs; `out` is new, empty, or has earlier cuts, which are
    replaced or, with `resume`, gone on with.

    Raises:
        ConfigError: A log was moved, the folder must not be written, or there is nothing to resume.
        LogError: A log cannot be read.
        OutputError: A file cannot be written.
    """
    settings = load_run(folder / "run.toml").log
    logs = views(folder)["logs"]().drop_duplicates("log").set_index("log")
    unknown = [part.log for part in parts if part.log not in logs.index]
    if unknown:
        raise LogError(
            f"no log is called '{unknown[0]}' in its logs",
            file=folder,
            remedy="make these results again",
        )
    labels = {part: f"{part.log}_{max(part.begin, 0.0):.1f}s" for part in parts}
    names = safe_names(labels.values())
    inputs = [[*astuple(part), str(logs.loc[part.log, "sha256"])] for part in parts]
    head = {
        "study": CUTS.command,
        "replan": replan_version(),
        "moments": sha256(repr(inputs).encode()).hexdigest(),
    }
    with claimed_folder(out, CUTS, resume=resume) as cuts:
        study = Study(cuts, head, resume=resume)
        for log, moments_of_log in groupby(parts, key=lambda part: part.log):
            scenario: Scenario | None = None
            for part in moments_of_log:
                name = f"{names[labels[part]]}.mcap"
                if study.known(name) is None:
                    scenario = scenario or scenario_of(folder, logs.loc[log].to_dict(), settings)
                    write_scenario(cuts / name, _part(scenario, part))
                    study.add([{"key": name}])
                yield cuts / name


def _part(scenario: Scenario, moment: FoundMoment) -> Scenario:
    """The part of a log that a moment is, with its origin; LogError if it is too short."""
    begin = max(moment.begin, float(scenario.ego.t[0]))
    end = min(moment.end, scenario.duration)
    if not (isfinite(begin) and end - begin >= LEAST_S):
        ends = f"from {moment.begin:.1f} to {moment.end:.1f} s"
        raise LogError(f"{moment.log}: {ends} there is less than {LEAST_S} s of the log")
    part = in_nanoseconds(cut_scenario(scenario, begin, end))
    origin = {"cut.of": scenario.name, "cut.from_s": repr(begin), "cut.to_s": repr(end)}
    origin["cut.kinds"] = " ".join(moment.kinds)
    tags = tuple(dict.fromkeys((*scenario.tags, *moment.kinds)))
    notes = [f"Cut from {scenario.name}, from {begin:.1f} to {end:.1f} s."]
    x, y = ego_boxes(part.ego, part)[:2]
    if part.goal is not None and not any(
        map(part.goal.reached, part.ego.t, x, y, part.ego.yaw, part.ego.v)
    ):
        part = replace(part, goal=None)
        notes.append("The goal of the whole log is beyond this part and is left out.")
    return replace(
        part,
        name=f"{scenario.name}@{begin:.1f}s",
        metadata={**part.metadata, **origin},
        tags=tags,
        notes=(*part.notes, *notes),
    )
