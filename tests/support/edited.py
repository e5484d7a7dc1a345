"""Edited results: one change of one file, chosen by a seed."""

import json
import random
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
from mcap.reader import make_reader
from mcap.writer import Writer

VALUES: tuple[Any, ...] = (
    None,
    True,
    -1,
    3,
    1e308,
    10**30,
    "",
    "x",
    "../../..",
    "/etc/passwd",
    "a\0b",
    "\ud800",
    "é" * 300,
    [],
    ["x"],
    [[]],
    {},
    {"a": 1},
    [{}],
    "closed",
    "fail",
    "[[[",
)
TOKENS = ("NaN", "Infinity", "-Infinity", "1e999", "[" * 100_000, '{"a":' * 50_000, "")
WORDS = ("1", "-1", "nan", "inf", '"x"', '"../.."', "[]", "{}", "true", "[[1]]")


def edit(rng: random.Random, folder: Path) -> str:
    """Change one file of a folder (or the file itself), and say what was done."""
    files = (
        [folder]
        if folder.is_file()
        else sorted(file for file in folder.rglob("*") if file.suffix in EDITS)
    )
    file = rng.choice(files)
    what = (_edit_bytes if rng.random() < 0.25 else EDITS.get(file.suffix, _edit_bytes))(rng, file)
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
    keys = (
        value.keys()
        if isinstance(value, dict)
        else range(len(value))
        if isinstance(value, list)
        else ()
    )
    return [path, *(place for key in keys for place in _places(value[key], (*path, key)))]


def _edit_json(rng: random.Random, file: Path) -> str:
    text, what = _edited_json(rng, file.read_text(encoding="utf-8"))
    file.write_text(text, encoding="utf-8")
    return what


def _edit_lines(rng: random.Random, file: Path) -> str:
    """Edit a line of JSON lines."""
    lines = file.read_text(encoding="utf-8").splitlines()
    k = rng.randrange(len(lines))
    lines[k], what = _edited_json(rng, lines[k])
    file.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return f"line {k}: {what}"


def _edit_log(rng: random.Random, file: Path) -> str:
    """Edit a message or a record of a native log; its checksums hold."""
    with file.open("rb") as stream:
        reader = make_reader(stream)
        header, records = reader.get_header(), list(reader.iter_metadata())
        messages = list(reader.iter_messages(log_time_order=False))
    k = rng.randrange(-len(records), len(messages))
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(header.profile, header.library)
        schemas, channels, what = dict[int, int](), dict[int, int](), ""
        for i, record in enumerate(records):
            if i == -1 - k:
                key = rng.choice(sorted(record.metadata))
                value = what = rng.choice(
                    ["", "x", "-1", "1e999", "nan", "[" * 100_000, record.metadata[key][:-1]]
                )
                record.metadata[key], what = value, f"{key} = {what[:40]}"
            writer.add_metadata(record.name, record.metadata)
        for i, (schema, channel, message) in enumerate(messages):
            data, time = message.data, message.log_time
            if i == k and rng.random() < 0.2:
                time = what = rng.choice([0, 1, 2**63, time + 10**12])
                what = f"{channel.topic} at {what}"
            elif i == k and channel.message_encoding == "json":
                text, what = _edited_json(rng, data.decode())
                data, what = text.encode(), f"{channel.topic} {what}"
            if schema and schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.id not in channels:
                known = schemas[schema.id] if schema else 0
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, known
                )
            writer.add_message(
                channels[channel.id], time, data, message.publish_time, message.sequence
            )
        writer.finish()
    return what


def _edited_json(rng: random.Random, text: str) -> tuple[str, str]:
    """The text of a document with one value changed, and what was done."""
    document = json.loads(text)
    if not (places := _places(document)[1:]):
        return text, "nothing"
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
            return json.dumps(document).replace('"TOKEN"', what), f"{[*way, key]} = {what[:20]}"
        case _:
            inner[key] = what = rng.choice(VALUES)
    return json.dumps(document), f"{[*way, key]}: {what!r}"[:300]


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
            table = table.set_column(
                place, column, pa.array([rng.choice([1.5, float("inf"), None])] * len(table))
            )
        case 2:
            table = table.set_column(
                place, column, pa.array([rng.choice(["x", "", "../..", "closed"])] * len(table))
            )
        case 3:
            cells = values.to_pylist()
            if cells:
                odd = (
                    [float("inf"), float("-inf"), 1e308, None]
                    if pa.types.is_floating(values.type)
                    else [None]
                )
                odd = ["x", "", "../..", None] if pa.types.is_large_string(values.type) else odd
                odd = [10**18, -1, None] if pa.types.is_integer(values.type) else odd
                cells[rng.randrange(len(cells))] = rng.choice(odd)
            table = table.set_column(place, column, pa.array(cells, values.type))
        case 4:
            table = table.slice(0, rng.choice([0, 1, len(table) // 2]))
        case 5:
            table = pa.concat_tables([table, table.slice(0, 1)])
        case 6:
            table = table.replace_schema_metadata(
                rng.choice([None, {"replan_schema_version": "99"}, {"x": "y"}])
            )
        case _:
            table = table.append_column(rng.choice([column, "new"]), values)
    pq.write_table(table, file)
    return f"column {column}"


EDITS = {
    ".json": _edit_json,
    ".jsonl": _edit_lines,
    ".toml": _edit_text,
    ".parquet": _edit_table,
    ".mcap": _edit_log,
}
"""What edits a file with its checks in mind, by the end of its name.

Other files get other bytes.
"""
