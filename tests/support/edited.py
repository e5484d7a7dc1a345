"""Edited results: one change of one file, chosen by a seed."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

VALUES: tuple[Any, ...] = (
    None, True, -1, 3, 1e308, 10**30, "", "x", "../../..", "/etc/passwd", "a\0b", "\ud800", "é" * 300, [], ["x"], [[]],
    {}, {"a": 1}, [{}], "closed", "fail", "[[[",
)  # fmt: skip
TOKENS = ("NaN", "Infinity", "-Infinity", "1e999", "[" * 100_000, '{"a":' * 50_000, "")
WORDS = ("1", "-1", "nan", "inf", '"x"', '"../.."', "[]", "{}", "true", "[[1]]")
EDITED = (".json", ".toml", ".parquet")


def edit(rng: random.Random, folder: Path) -> str:
    """Change one file of a folder (or the file itself), and say what was done."""
    files = [folder] if folder.is_file() else sorted(file for file in folder.rglob("*") if file.suffix in EDITED)
    file = rng.choice(files)
    if rng.random() < 0.25:
        what = _edit_bytes(rng, file)
    elif file.suffix == ".json":
        what = _edit_json(rng, file)
    elif file.suffix == ".parquet":
        what = _edit_table(rng, file)
    else:
        what = _edit_text(rng, file)
    return f"{file.name}: {what}"


def _edit_bytes(rng: random.Random, file: Path) -> str:
    content = bytearray(file.read_bytes())
    match rng.randrange(4):
        case 0:
            file.write_bytes(content[: rng.randrange(len(content) + 1)])
            return "cut"
        case 1:
            for _ in range(rng.randrange(1, 6)):
                content[rng.randrange(len(content))] = rng.randrange(256)
            file.write_bytes(content)
            return "bytes"
        case 2:
            file.unlink()
            return "removed"
    file.write_bytes(rng.randbytes(200))
    return "noise"


def _places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    keys = value.keys() if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    return [path, *(place for key in keys for place in _places(value[key], (*path, key)))]


def _edit_json(rng: random.Random, file: Path) -> str:
    document = json.loads(file.read_text(encoding="utf-8"))
    if not (places := _places(document)[1:]):
        return "nothing"
    *way, key = rng.choice(places)
    inner = document
    for step in way:
        inner = inner[step]
    match rng.randrange(4):
        case 0:
            del inner[key]
            what = "deleted"
        case 1 if isinstance(inner, list):
            inner.append(inner[key])
            what = "twice"
        case 2:
            inner[key] = "TOKEN"
            what = rng.choice(TOKENS)
            file.write_text(json.dumps(document).replace('"TOKEN"', what), encoding="utf-8")
            return f"{[*way, key]} = {what[:20]}"
        case _:
            inner[key] = what = rng.choice(VALUES)
    file.write_text(json.dumps(document), encoding="utf-8")
    return f"{[*way, key]}: {what!r}"[:300]


def _edit_text(rng: random.Random, file: Path) -> str:
    lines = file.read_text(encoding="utf-8").splitlines()
    k = rng.randrange(len(lines))
    key, _, _ = lines[k].partition(" = ")
    lines[k] = rng.choice(["", f"{key} = {rng.choice(WORDS)}"])
    file.write_text("\n".join(lines), encoding="utf-8")
    return f"line {k}: {lines[k]!r}"


def _edit_table(rng: random.Random, file: Path) -> str:
    table = pq.read_table(file, partitioning=None)
    column = rng.choice(table.column_names)
    place, values = table.column_names.index(column), table[column]
    match rng.randrange(8):
        case 0:
            table = table.drop_columns(column)
        case 1:
            table = table.set_column(place, column, pa.array([rng.choice([1.5, float("inf"), None])] * len(table)))
        case 2:
            table = table.set_column(place, column, pa.array([rng.choice(["x", "", "../..", "closed"])] * len(table)))
        case 3:
            cells = values.to_pylist()
            if cells:
                odd = [float("inf"), float("-inf"), 1e308, None] if pa.types.is_floating(values.type) else [None]
                odd = ["x", "", "../..", None] if pa.types.is_large_string(values.type) else odd
                odd = [10**18, -1, None] if pa.types.is_integer(values.type) else odd
                cells[rng.randrange(len(cells))] = rng.choice(odd)
            table = table.set_column(place, column, pa.array(cells, values.type))
        case 4:
            table = table.slice(0, rng.choice([0, 1, len(table) // 2]))
        case 5:
            table = pa.concat_tables([table, table.slice(0, 1)])
        case 6:
            table = table.replace_schema_metadata(rng.choice([None, {"replan_schema_version": "99"}, {"x": "y"}]))
        case _:
            table = table.append_column(rng.choice([column, "new"]), values)
    pq.write_table(table, file)
    return f"column {column}"
