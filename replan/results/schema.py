"""The schema of the tables of a run: written tables have these columns; reading by it;
docs/results.md is made from it.

python -c 'from replan.results.schema import markdown; print(markdown())' > docs/results.md

Files of results are read here only: what passes may be used without further checks. Results may
come from another person, or be damaged. A JSON file is checked against its type, a table against
its schema: version, columns, types, values that are missing or infinite, words that are none of the
known ones. Names of folders and files are plain names: nothing outside of the results is read or
written.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Annotated, Any, NoReturn, TypeVar

import msgspec
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from replan.core.errors import ConfigError, LogError
from replan.core.files import check_regular
from replan.metrics.judge.gates import Outcome

# Version of the tables and JSON files; it increases when a column changes its meaning or is removed
SCHEMA_VERSION = 1
VERSION_KEY = "replan_schema_version"  # Key of the version in the metadata of a table
METADATA = {VERSION_KEY: str(SCHEMA_VERSION)}

_TYPES = {
    "text": pa.large_string(),
    "number": pa.float64(),
    "count": pa.int64(),
    "yes/no": pa.bool_(),
}
_TEXTS = (pa.string(), pa.large_string())
_TYPES["list"] = pa.list_(pa.large_string())


@dataclass(frozen=True)
class Column:
    """One column."""

    name: str  # The name; its last part is the unit of a quantity with one unit
    kind: str  # "text", "number" (NaN if there is none), "count", "yes/no", "list" (of texts)
    meaning: str  # Its meaning
    # Its value in files of before the column; None: all files have it
    older: str | float | None = None


@dataclass(frozen=True)
class Table:
    """One table."""

    rows: str  # A description of a row and of the file
    same: bool  # Whether the same inputs give the same bytes
    columns: tuple[Column, ...]  # The columns, in their order


Row = Column | tuple[str, str, str] | tuple[str, str, str, str | float]


def _columns(*rows: Row) -> tuple[Column, ...]:
    return tuple(row if isinstance(row, Column) else Column(*row) for row in rows)


def _table(text: str, *rows: Row, same: bool = True) -> Table:
    return Table(text, same, _columns(*rows))


_DRIVE = _columns(
    ("log", "text", "name of the log"),
    ("planner", "text", "as it was named in the run; of mode `reference`: the reference driver"),
    ("mode", "text", "`open`, `closed`, or `reference`: what the reference drives did or could do"),
)
_METRICS = _columns(
    *_DRIVE,
    ("oracle", "yes/no", "whether the planner was given the log's future"),
    ("metric", "text", "`metric.reduction`, or `metric.part.reduction`: docs/metrics.md"),
    ("value", "number", "in `unit`; NaN where `available` is false"),
    ("unit", "text", "SI; `1` a ratio, `count` a number of things"),
    ("direction", "text", "which is better: `lower`, `higher`, `none`"),
    ("available", "yes/no", "whether there is a value"),
    (
        "reason",
        "text",
        "why there is none; else which road user or thing the value is about, or empty",
    ),
    (
        "about",
        "text",
        "that road user or thing with the whole id, as `reason` has a short name; or empty",
    ),
    (
        "time_s",
        "number",
        "when the value occurred, s since the log's start; NaN where it belongs to no instant",
    ),
    ("version", "count", "of the metric: counts up when its numbers change their meaning"),
    ("source", "text", "where the metric's definition comes from; empty: replan"),
)
TABLES: dict[str, Table] = {
    "metrics.parquet": _table(
        "A row per log, planner, mode and metric. `metrics.csv` is the same; there an apostrophe "
        "precedes a text that spreadsheets take for a formula. In a log's folder: of that log.",
        ("schema_version", "count", "of all these tables; not in a log's folder"),
        *_METRICS,
    ),
    "verdicts.parquet": _table(
        "A row per gate, log, planner and mode: the gate's outcome on this log.",
        ("gate", "text", "the rule as text: `collision_at_fault.count <= 0`"),
        *_DRIVE,
        ("outcome", "text", "`pass`, `fail`, `inconclusive`"),
        ("value", "number", "of the gate's metric, in its unit; NaN where it has none"),
        ("time_s", "number", "when the value occurred, s since the log's start"),
        ("reason", "text", "why it is not passed, or which road user the value is about"),
        ("metric", "text", "that the gate judges, as in metrics.parquet", ""),
        (
            "over",
            "text",
            "what must be within the bounds: `worst`: each log; else of all logs",
            "worst",
        ),
        ("low", "number", "the gate's lower bound; NaN: none", nan),
        ("high", "number", "the gate's upper bound; NaN: none", nan),
    ),
    "groups.parquet": _table(
        "A row per group of logs, planner, mode and metric; metric `pass` is the share of the logs "
        "that pass.",
        ("kind", "text", "of group: `suite` (all logs), `family`, `tag`, `dataset`"),
        ("group", "text", "its name"),
        ("planner", "text", "as in metrics.parquet"),
        ("mode", "text", "`open`, `closed`; `both`: both loops of a log together"),
        ("metric", "text", "as in metrics.parquet, or `pass`"),
        ("unit", "text", "of the metric"),
        ("direction", "text", "of the metric"),
        ("logs", "count", "in the group"),
        ("available", "count", "of them with a value"),
        ("missing", "count", "of them without"),
        ("mean", "number", "over the logs with a value; of `pass`: the share of all logs"),
        ("median", "number", "likewise"),
        ("worst", "number", "by the metric's direction"),
        ("worst_log", "text", "where that was"),
        ("total", "number", "sum over the logs with a value"),
        ("low", "number", "of `pass`: lower end of the Wilson 95 % interval of the share"),
        ("high", "number", "of `pass`: its upper end"),
        ("passed", "number", "of `pass`: how many logs"),
        ("failed", "number", "of `pass`: how many logs"),
        ("inconclusive", "number", "of `pass`: how many logs"),
    ),
    "health.parquet": _table(
        "A row per finding: what is wrong with the logs. In a log's folder: of that log.",
        ("log", "text", "name of the log"),
        ("kind", "text", "of finding"),
        ("topic", "text", "where: `ego`, `agents`, `road`, `lights`"),
        ("who", "text", "agent, lane or light, or empty"),
        ("t_from_s", "number", "begin, s since the log's start"),
        ("t_to_s", "number", "end, s since the log's start"),
        ("value", "number", "how much, in `unit`"),
        ("unit", "text", "`m`, `s`, `rad`, `x` (a factor), `1` (a count or a share)"),
        ("text", "text", "in words, with the figures"),
        ("effect", "text", "what it does to which metric"),
    ),
    "events.parquet": _table(
        "Written by `replan mine`: a row per event, sorted by log and begin.",
        ("log", "text", "name of the log"),
        ("kind", "text", "of event: docs/events.md"),
        ("t_from_s", "number", "begin, s since the log's start"),
        ("t_to_s", "number", "end, s since the log's start"),
        ("agents", "list", "ids of the road users that took part, the main one first"),
        ("agent_kind", "text", "of the main one (`car`, `pedestrian` ...); `none`: the ego alone"),
        (
            "road",
            "text",
            "where the ego was: `roundabout`, `junction`, `curve`, `straight`, `no lanes`",
        ),
        ("speed", "text", "range of the ego's speed at the begin"),
        ("v_mps", "number", "the ego's speed at the begin, m/s"),
        ("x_m", "number", "where the ego's rear axle was at the begin, m; y_m likewise"),
        ("y_m", "number", "see x_m"),
        ("value", "number", "what the kind measures, in `unit`; NaN: nothing"),
        ("unit", "text", "SI; `1`: a number"),
        ("what", "text", "more in words (the side, the stop line); may be empty"),
        (
            "doubt",
            "text",
            "why it may be none: docs/events.md; empty: nothing speaks against it",
            "",
        ),
        ("planner", "text", "whose plans the event is about; empty: of the log alone"),
    ),
    "logs.parquet": _table(
        "Written by `replan mine`: a row per log.",
        ("log", "text", "name; of logs that share one: with `@` and 8 digits of the hash"),
        ("source", "text", "the path as it was named, or the catalogue's name"),
        (
            "sha256",
            "text",
            "of the log's bytes; empty for the catalogue, and where it could not be read",
        ),
        ("duration_s", "number", "how long it lasts, s"),
        ("driven_m", "number", "the way that the ego drove, m"),
        ("agents", "count", "other road users"),
        ("lanes", "yes/no", "whether the log has lanes"),
        ("family", "text", "of the catalogue, or what the log says; may be empty"),
        ("dataset", "text", "where the log is from; may be empty"),
        ("tags", "list", "words by which gates and reports group"),
        ("place", "text", "as the log's metadata says; may be empty"),
        ("weather", "text", "as the log's metadata says; may be empty"),
        (
            "parked_breaks",
            "text",
            "the first packaged gate that a driver breaks who stops; empty: none, too easy",
        ),
        (
            "creeping_breaks",
            "text",
            "that a driver at a constant 2 m/s breaks; empty: none, too easy",
        ),
        (
            "blind_breaks",
            "text",
            "that a driver breaks who ignores road users and lights; empty: no interaction",
        ),
        ("not_asked", "list", "kinds of events that were not looked for, with the reason"),
        ("error", "text", "why the log could not be mined; empty: it was"),
    ),
    "input_use.parquet": _table(
        "Written by `replan explain --table`: a row per frame and agent that the plan used or "
        "needed, red light before the ego, and plan that starts at the ego (docs/why.md).",
        *_DRIVE,
        ("t_s", "number", "time of the frame, s since the log's start"),
        ("agent", "text", "id, or name of the stop line; empty for a start"),
        ("kind", "text", "of agent (`car`, `pedestrian` ...), `red light`, `start`"),
        ("named", "yes/no", "whether an artefact of the plan names it"),
        ("needed", "yes/no", "whether a plan must know it: ahead, and soon on the plan's way"),
        ("ahead_m", "number", "centre as shown, from the ego's rear axle along its heading"),
        ("left_m", "number", "likewise, to the left"),
        ("speed_mps", "number", "as shown, m/s"),
        (
            "off_m",
            "number",
            "how far outlines are off what was shown, without margins, m; at most 6",
        ),
        ("allowed_m", "number", "how far they may be off before it counts, m"),
        ("shown_along_m", "number", "shown minus true position, along the ego's heading, m"),
        ("shown_across_m", "number", "likewise, to the left"),
        (
            "along_m",
            "number",
            "used (S-L, standing; start) minus shown, along the ego's heading, m",
        ),
        ("across_m", "number", "likewise, to the left"),
        ("station_m", "number", "used (S-T) minus shown, along the path, at the first time, m"),
        ("age_s", "number", "the age that would explain station_m, s; NaN: not along the path"),
        ("share", "number", "used over shown displacement along the path; of a start: of speed"),
    ),
    "timings.parquet": _table(
        "A row per log, planner, mode, plan and stage: wall clock. In a log's folder: of that log.",
        *_DRIVE,
        ("t_s", "number", "time of the frame, s since the log's start"),
        ("stage", "text", "of the planner; `total`: the whole plan"),
        ("seconds", "number", "how long it took, s"),
        same=False,
    ),
    "frames.parquet": _table(
        "In a log's folder: a row per planner, mode, metric and step.",
        *_DRIVE[1:],
        ("t_s", "number", "time of the step, s since the log's start"),
        ("metric", "text", "`metric`, or `metric.part`"),
        ("value", "number", "in the metric's unit; NaN: this step has none"),
    ),
    "ensemble.parquet": _table(
        "In a log's folder, with `--ensemble N`: the metrics of the log driven again in worlds "
        "that should not matter.",
        *_METRICS,
        ("member", "count", "from 1"),
        ("perturbation", "text", "what was changed (`replan/run/ensemble.py`)"),
    ),
}
"""Tables by file name.

The text gives the difference between a file of a run and one of a log with the same name.
"""

FRAMES: dict[str, Table] = {
    "logs": _table(
        "A row per log.",
        ("log", "text", "name; of logs that share one: with `@` and 8 digits of the hash"),
        ("source", "text", "the path as given, or the catalogue's name"),
        ("sha256", "text", "of the log's bytes; empty where it could not be read"),
        ("folder", "text", "its folder in the result folder; empty where there is none"),
        ("family", "text", "of the catalogue, or what the log says; may be empty"),
        ("dataset", "text", "where the log is from; may be empty"),
        ("tags", "list", "words by which gates and reports group"),
        ("notes", "list", "what was assumed in reading it, a sentence each"),
    ),
    "drives": _table(
        "A row per log, planner and mode.",
        *_DRIVE,
        ("oracle", "yes/no", "whether the planner was given the log's future"),
        ("end", "text", "why the drive ended"),
        ("detail", "text", "which road user it met, or what went wrong; may be empty"),
        ("t_end_s", "number", "when it ended, s since the log's start"),
        ("marks", "list", "of the planner: `trusted`, `batched`, `not deterministic`"),
        ("notes", "list", "what must be known to read it, a sentence each"),
        ("files", "list", "trace and recording, relative to the result folder"),
    ),
    "gates": _table(
        "A row per gate, planner and mode: what all logs say together; none where a shard was "
        "driven.",
        ("gate", "text", "the rule as text"),
        ("planner", "text", "the one that the worst value is of"),
        ("mode", "text", "likewise"),
        ("group", "text", "of a gate that is asked per family, tag or dataset: which; else empty"),
        ("outcome", "text", "`pass`, `fail`, `inconclusive`"),
        ("value", "number", "the worst, or what the gate asks of all logs (`over`)"),
        ("log", "text", "where that was"),
        ("time_s", "number", "when, s since the log's start"),
        ("reason", "text", "why, in words"),
    ),
    "failures": _table(
        "A row per thing that could not be evaluated.",
        ("log", "text", "name, or the path as given"),
        ("planner", "text", "none: the log itself"),
        ("mode", "text", "none: before any loop"),
        ("message", "text", "what, where, and what to do"),
        ("exit_code", "count", "what it costs: 2 configuration, 3 else"),
    ),
    "decisions": _table(
        "A row per frame and decision, read from the traces.",
        *_DRIVE,
        ("t_s", "number", "time of the frame, s since the log's start"),
        ("agent", "text", "about which road user, stop or ground"),
        ("decision", "text", "`follow`, `yield`, `overtake`, `stop`, `nudge left` ..."),
        ("stage", "text", "of the planner that decided"),
        ("reason", "text", "why, in words"),
    ),
}
"""Tables of `replan.results.load` only, made from summary.json and the traces."""


def names_of(table: str) -> list[str]:
    """The columns of a file or of one of `FRAMES`, in their order."""
    return [column.name for column in (TABLES | FRAMES)[table].columns]


def is_table(file: Path, name: str) -> bool:
    """Whether a Parquet file has the columns of a table; ValueError if it is no Parquet file."""
    return bool(pq.read_schema(file).names == arrow_schema(name).names)


def arrow_schema(file: str) -> pa.Schema:
    """The columns of a file with their types in Parquet."""
    return pa.schema([(column.name, _TYPES[column.kind]) for column in TABLES[file].columns])


def arrow(file: str, table: pd.DataFrame) -> pa.Table:
    """The table with the types of its schema, even without rows; other files get the types of
    pandas.

    KeyError if it has a column that the schema does not know.
    """
    if file not in TABLES:
        return pa.Table.from_pandas(table, preserve_index=False)
    known = arrow_schema(file)
    return pa.Table.from_pandas(
        table, pa.schema([known.field(name) for name in table.columns]), preserve_index=False
    )


def pa_type(kind: str) -> pa.DataType:
    """The type of a kind of column in Parquet files."""
    return _TYPES[kind]


def is_of_kind(type_: pa.DataType, kind: str) -> bool:
    """Whether a column of a Parquet file has the type of a kind of column.

    Texts may be stored as words.
    """
    if kind == "list":
        return pa.types.is_list(type_) and type_.value_type in _TEXTS
    if kind == "text":
        return (type_.value_type if pa.types.is_dictionary(type_) else type_) in _TEXTS
    return bool(type_ == _TYPES[kind])


def typed(file: str, table: pd.DataFrame) -> pd.DataFrame:
    """The table with the types of pandas that it has when it is read back."""
    kinds: dict[str, Any] = {
        "text": object,
        "number": float,
        "count": "int64",
        "yes/no": bool,
        "list": object,
    }
    return table.astype(
        {column.name: kinds[column.kind] for column in TABLES[file].columns if column.name in table}
    )


def markdown() -> str:
    """The text of docs/results.md."""
    lines = INTRODUCTION.format(version=SCHEMA_VERSION).strip().splitlines()
    for file, table in TABLES.items():
        same = (
            "The same inputs give the same bytes."
            if table.same
            else "Not the same twice: it holds a clock."
        )
        lines += ["", f"## {file}", "", f"{table.rows} {same}", "", *_rows(table.columns)]
    lines.append(BELOW.strip())
    for name, table in FRAMES.items():
        lines += ["", f"### result.{name}", "", table.rows, "", *_rows(table.columns)]
    return "\n".join(lines)


def _rows(columns: Sequence[Column]) -> list[str]:
    rows = [f"| `{column.name}` | {column.kind} | {column.meaning} |" for column in columns]
    return ["| column | type | meaning |", "|---|---|---|", *rows]


INTRODUCTION = """
# Results: tables and files

<!-- written by `replan.results.schema.markdown`; do not edit -->

Schema version {version}: a column that changes its meaning or goes makes it a higher one, a new column does not. It
stands in the first column of `metrics.*`, in the metadata of every Parquet file (`replan_schema_version`), and in
`summary.json` and `log.json`. SI units; the unit stands in the name of a column (`t_s`) or in the column `unit`. Text
is `large_string`, numbers are `float64`, also in a table without rows.

<!-- not run: it needs a run; tests/replan/results/test_results.py does the same -->
```python
import replan

result = replan.load("results/run-001")  # nothing is read before it is asked for
# pandas frames: metrics, verdicts, groups, health, timings, and below
result.metrics.query("metric == 'gap.min'")  # of the planners of the run
result.references  # rows of metrics.parquet of the mode reference: the recorded driver ...
result.frames  # frames.parquet of all logs, with the column log: large
# one drive; with several planners: drive(log, planner, mode)
drive = result.drive("paper/free_road")
drive.series["gap"]  # a metric step by step, by t_s
plan = drive.plan(at=6.5)  # the plan that was driven at 6.5 s
plan.trajectory.v  # as arrays
list(plan.internals)  # S-T and S-L graphs, decisions, costs: logs/plan.py
```

[examples/results.ipynb](../examples/results.ipynb) is a notebook that does this (it needs matplotlib).

| file | what | the same twice |
|---|---|---|
| `metrics.parquet`, `metrics.csv`, `verdicts.parquet`, `groups.parquet`, `health.parquet` | below | yes |
| `timings.parquet` | below | no: a clock |
| `summary.json` | version, outcome, exit code, logs and drives, gates, failures | yes, but for Python's version |
| `run.toml` | the resolved configuration, and the logs with their digests | yes, but for the places of the logs |
| `origin.json` | the directory in which the run was started, from which its logs are found again | no: a place |
| `report.md`, `report.html`, `junit.xml` | the reports | yes, but for the planning times in `report.*` |
| `shard.json` | of a shard: which part of which run it is ([ci.md](ci.md)) | yes |
| `LOG-HASH/open.mcap`, `closed.mcap` | traces: the drive as a log, with plans and their inside | yes |
| `LOG-HASH/open.rrd`, `closed.rrd` | recordings for the Rerun viewer | no: they show stage times |
| `LOG-HASH/metrics.parquet`, `health.parquet`, `frames.parquet`, `ensemble.parquet` | below | yes |
| `LOG-HASH/timings.parquet` | below | no: a clock |
| `LOG-HASH/log.json` | the log's card: hash, tags, notes, drives, failures, version and code of replan | yes |
| `LOG-HASH/log.mcap` | the log, where it was no MCAP file | yes |
"""  # noqa: E501

BELOW = """

## Frames that are made of the files

`replan.load` makes these of `summary.json` and the traces.
"""

AGAIN = "evaluate again"
WORDS: dict[str, Collection[str]] = {
    "mode": ("open", "closed", "reference", "both", ""),
    "direction": ("lower", "higher", "none"),
    "outcome": [one.value for one in Outcome],
}
"""The values of columns that have no others."""

Name = Annotated[str, msgspec.Meta(pattern=r"^(?:[A-Za-z0-9_-][A-Za-z0-9._-]*)?\Z")]
"""A plain name, as `replan.results.tables.safe_name` makes it; may be empty."""
FileName = Annotated[
    str, msgspec.Meta(pattern=r"^[A-Za-z0-9_-][A-Za-z0-9._-]*/[A-Za-z0-9_-][A-Za-z0-9._-]*\Z")
]
"""The plain name of a file in a log's folder."""
Place = Annotated[str, msgspec.Meta(pattern=r"^[^\0]*\Z")]  # A path or URL
T = TypeVar("T")


def read_json(file: Path, kind: type[T], again: str = AGAIN) -> tuple[dict[str, Any], T]:
    """The contents of a JSON file, as they are and as a type.

    `kind`: the type of its contents, a Struct; further keys are allowed. ConfigError if it cannot
    be read, is of another version, or not of the type.
    """
    try:
        check_regular(file)
        content = file.read_bytes()
        document: Any = msgspec.json.decode(content)
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{file}: cannot be read: {error}; {again}") from None
    version = document.get("schema_version") if isinstance(document, dict) else None
    if isinstance(version, int) and version != SCHEMA_VERSION:
        raise ConfigError(
            f"{file}: is of version {version}, this replan reads {SCHEMA_VERSION}; {again}"
        )
    return checked(file, document, kind, again)


def checked(file: Path, found: Any, kind: type[T], again: str) -> tuple[dict[str, Any], T]:
    """Decoded JSON as it is and as a type; ConfigError as `read_json`."""
    if not isinstance(found, dict) or found.get("schema_version") != SCHEMA_VERSION:
        raise ConfigError(f"{file}: is no file of results; {again}")
    try:
        return found, msgspec.convert(found, kind)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{file}: is not as replan writes it: {error}; {again}") from None


def read_table(
    file: Path, without: Sequence[str] = (), again: str = AGAIN, *, words: Sequence[str] = ()
) -> pa.Table:
    """A table, checked by the schema of its name; columns that the schema does not know are left
    out.

    `words`: columns of few different texts, which are read as dictionaries. LogError if it cannot
    be read, or is not as replan writes it; ConfigError if it is of another version.
    """
    check_regular(file)
    try:
        table = pq.read_table(file, partitioning=None, read_dictionary=list(words))
    except (OSError, ValueError, pa.ArrowException) as error:
        raise LogError(f"cannot be read: {error}", file=file, remedy=again) from None
    version = (
        (table.schema.metadata or {}).get(VERSION_KEY.encode(), b"").decode("utf-8", "replace")
    )
    if version != str(SCHEMA_VERSION):
        is_of = f"is of version {version}" if version else "has no version"
        raise ConfigError(f"{file}: {is_of}, this replan reads {SCHEMA_VERSION}; {again}")
    table = table.replace_schema_metadata(None)
    check_table(table, file, file.name, without, again)
    for position, column in enumerate(TABLES[file.name].columns):
        if column.name not in table.column_names and column.older is not None:
            table = table.add_column(
                position, column.name, pa.array([column.older] * len(table), pa_type(column.kind))
            )
    return table.select([name for name in names_of(file.name) if name in table.column_names])


def check_table(
    table: pa.Table, file: Path, name: str, without: Sequence[str] = (), again: str = AGAIN
) -> None:
    """Raise LogError unless a table is as the schema of a file's name says.

    Columns `without` may be missing.
    """

    def refuse(what: str) -> NoReturn:
        raise LogError(what, file=file, remedy=again)

    try:
        table.validate(full=True)
    except (ValueError, pa.ArrowException) as error:
        refuse(f"is damaged: {error}")
    for column in TABLES[name].columns:
        if table.column_names.count(column.name) != 1:
            if column.name in table.column_names or not (
                column.name in without or column.older is not None
            ):
                refuse(f"has no column {column.name}, or several")
            continue
        values = table[column.name]
        if not is_of_kind(values.type, column.kind):
            refuse(f"column {column.name} is {values.type}, not {column.kind}")
        if values.null_count and column.kind != "number":
            refuse(f"column {column.name} has no value in {values.null_count} rows")
        if column.kind == "number" and pc.any(pc.is_inf(values)).as_py():
            refuse(f"column {column.name} has infinite values")
        if column.name in WORDS and (
            other := set(pc.unique(values).to_pylist()) - {*WORDS[column.name]}
        ):
            refuse(f"column {column.name} has the value {min(other)!r}, which is unknown")
