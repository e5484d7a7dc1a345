"""`replan query`: SQL over the tables of a result folder, read only.

The views are the tables of docs/results.md under their names without ending: of a run `metrics`, `verdicts`, `groups`,
`health`, `timings`, `frames`, `logs`, `drives`, `gates`, `failures`, `decisions`; of mined logs `events`, `logs`,
`health`. Only those whose names are in the query are read. DuckDB runs one SELECT in memory, with its access to files,
networks and extensions locked: a query reads these views and nothing else.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from logs.errors import ConfigError
from replay.mine.mine import CARD, EVENTS, HEALTH, LOGS, read_mined
from replay.results.tables import write_file

RUN_VIEWS = (
    "metrics", "verdicts", "groups", "health", "timings", "frames", "logs", "drives", "gates", "failures", "decisions",
)  # fmt: skip
MINED_VIEWS = tuple(name.removesuffix(".parquet") for name in (EVENTS, LOGS, HEALTH))
LOCKED = (
    "SET enable_external_access = false",
    "SET autoinstall_known_extensions = false",
    "SET autoload_known_extensions = false",
    "SET python_enable_replacements = false",
    "SET threads = 1",  # the order of rows that no ORDER BY asks for
    "SET lock_configuration = true",
)
WRITERS: Mapping[str, Callable[[pd.DataFrame, Path], object]] = {
    ".csv": lambda table, path: table.to_csv(path, index=False, lineterminator="\n"),
    ".parquet": lambda table, path: table.to_parquet(path, index=False),
    ".json": lambda table, path: path.write_text(
        (table.to_json(orient="records", indent=2, double_precision=15) or "[]") + "\n", encoding="utf-8"
    ),
}
"""By the ending of the file."""


def views(folder: Path) -> Mapping[str, Callable[[], pd.DataFrame]]:
    """What reads each view of a result folder.

    Raises:
        ConfigError: It is neither the result of a run nor of `replan mine`.
    """
    if (folder / CARD).is_file():
        return {name: lambda name=name: getattr(read_mined(folder), name) for name in MINED_VIEWS}  # type: ignore[misc]
    from replay.results.load import load

    run = load(folder)
    return {name: lambda name=name: getattr(run, name) for name in RUN_VIEWS}  # type: ignore[misc]


def check_mined(folder: Path) -> None:
    """ConfigError where a folder is not the result of `replan mine`."""
    if not (folder / CARD).is_file():
        raise ConfigError(f"{folder}: holds no mined logs (no {CARD} in it): replan mine LOGS -o {folder}")


def query(folder: Path, sql: str) -> pd.DataFrame:
    """The rows that one SELECT gives.

    Args:
        folder: Of a run, or of `replan mine`.
        sql: The SELECT, over `views`.

    Raises:
        ConfigError: DuckDB is not installed, the SQL is wrong or no SELECT, or what it asks for is locked.
        LogError: A table is damaged.
    """
    duckdb = _duckdb()
    known = views(folder)
    with duckdb.connect(":memory:") as connection:
        for line in LOCKED:
            connection.execute(line)
        try:
            statements = connection.extract_statements(sql)
            if len(statements) != 1 or statements[0].type != duckdb.StatementType.SELECT:
                raise ConfigError("the query has to be one SELECT: results are read only")
            for name in sorted(set(re.findall(r"\w+", sql.lower())) & known.keys()):
                connection.register(name, known[name]())
            result: pd.DataFrame = connection.execute(statements[0]).df()
        except duckdb.Error as error:
            words = " ".join(str(error).split("\n\n")[0].split())
            if isinstance(error, duckdb.CatalogException):
                words = f"{words.partition(' Did you mean')[0]} The views are {', '.join(known)}"
            raise ConfigError(f"the query cannot be run: {words}") from None
    return result


def write_rows(table: pd.DataFrame, path: Path) -> None:
    """Write rows as .csv, .parquet or .json, by the ending.

    Raises:
        ConfigError: Another ending.
        OutputError: The file cannot be written.
    """
    if path.suffix not in WRITERS:
        raise ConfigError(f"{path}: name a file that ends in {', '.join(WRITERS)}")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_file(path, lambda partial: WRITERS[path.suffix](table, partial))


def _duckdb() -> Any:
    try:
        import duckdb
    except ImportError:
        raise ConfigError("queries need DuckDB: pip install 'replan[improve]'") from None
    return duckdb
