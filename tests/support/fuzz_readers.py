"""Logs of every format and how they are damaged, for `fuzz_evaluate`.

Real logs of each format (and those that the tests write) are mutated: bytes flipped, overwritten by telling values, cut
off, cut out, doubled, swapped; where checksums or a parser would keep every change from the reader, single messages,
values or columns inside the file.
"""

import os
import re
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import recorded_cases
import ros_bags as bags
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_cases import rich_scenario

from logs.maps import read_map
from logs.mcap import write_scenario
from logs.mcap.records import salvage
from logs.readers import LogSettings, read_log

DATA = Path(os.environ.get("REPLAN_DATA", Path(__file__).parents[3] / "shared" / "data"))
TELLING = [
    *(b"\xff" * n for n in (1, 2, 4, 8)), *(b"\x00" * n for n in (1, 4, 8)), b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f",
    *(struct.pack("<d", x) for x in (np.nan, np.inf, -1e300, 1e18, -0.0)), struct.pack("<f", np.nan),
    b"-", b"e999", b"nan", b"9" * 20, b"<", b">", b'"', b"{", b"]", b",", b"\n", b"\xc3\x28", b"null",
]  # fmt: skip
NUMBERS = [b"0", b"-1", b"1e308", b"nan", b"inf", b"-0.0", b"9" * 20, b"", b"1.5", b"x", b"null", b"1e-320"]
VALUE = re.compile(rb'-?\b\d+\.?\d*(?:[eE][-+]?\d+)?\b|"[^"<>{}\n]*"')
Mutation = Callable[[bytes, np.random.Generator], bytes]


def place(raw: bytes, rng: np.random.Generator) -> int:
    """Anywhere, the two ends more often: headers and indexes are there."""
    n = len(raw)
    span = n if rng.random() < 0.6 else min(n, 512)
    at = int(rng.integers(0, max(span, 1)))
    return at if rng.random() < 0.5 else max(n - 1 - at, 0)


def part(raw: bytes, rng: np.random.Generator) -> tuple[int, int]:
    """Begin and end of a part of up to a quarter, often small."""
    at = place(raw, rng)
    return at, min(len(raw), at + 1 + int(len(raw) / 4 * rng.random() ** 4))


def damaged(raw: bytes, rng: np.random.Generator, kinds: int = 7) -> bytes:
    """One mutation of some bytes; with `kinds` 2, one that keeps their number."""
    out = bytearray(raw)
    kind = int(rng.integers(0, kinds))
    if kind == 0:
        for _ in range(int(rng.integers(1, 9))):
            out[place(raw, rng)] ^= int(rng.integers(1, 256))
    elif kind in (1, 2):
        for _ in range(int(rng.integers(1, 4))):
            value, at = TELLING[int(rng.integers(0, len(TELLING)))], place(raw, rng)
            out[at : at + len(value) * (kind == 1)] = value
    elif kind == 3:
        del out[place(raw, rng) :]
    elif kind == 4:
        first, last = part(raw, rng)
        del out[first:last]
    elif kind == 5:
        first, last = part(raw, rng)
        out[last:last] = out[first:last]
    else:
        (a, b), (c, d) = sorted((part(raw, rng), part(raw, rng)))
        if b <= c:
            out[a:d] = raw[c:d] + raw[b:c] + raw[a:b]
    return bytes(out)


def values_damaged(raw: bytes, rng: np.random.Generator) -> bytes:
    """Some numbers and texts of XML, JSON or CSV replaced by others of the file or by telling ones, or lines lost."""
    found = list(VALUE.finditer(raw))
    out = raw
    for k in sorted(rng.integers(0, len(found), int(rng.integers(1, 4))).tolist(), reverse=True):
        at, other = found[k], found[int(rng.integers(0, len(found)))][0]
        word = NUMBERS[int(rng.integers(0, len(NUMBERS)))] if rng.random() < 0.6 else other.strip(b'"')
        word = b'"' + word + b'"' if at[0].startswith(b'"') else word
        out = out[: at.start()] + word + out[at.end() :]
        if rng.random() < 0.2 and len(at[0]) > 3:  # the same value everywhere: an id, a unit, a key
            out = out.replace(at[0], word)
    if rng.random() < 0.3:
        lines = out.splitlines(keepends=True)
        first = int(rng.integers(0, len(lines)))
        del lines[first : first + int(rng.integers(1, 4))]
        out = b"".join(lines)
    return out


def columns_damaged(raw: bytes, rng: np.random.Generator) -> bytes:
    """A column of an Arrow or Parquet file lost, emptied, of another type, or with telling values; or rows lost."""
    parquet = raw.startswith(b"PAR1")
    table = pq.read_table(BytesIO(raw)) if parquet else pa.ipc.open_file(raw).read_all()
    at, kind = int(rng.integers(0, table.num_columns)), int(rng.integers(0, 6))
    field, n = table.schema.field(at), len(table)
    values = table.column(at).to_pylist()
    if kind == 0:
        table = table.remove_column(at)
    elif kind == 1:
        table = table.set_column(at, field.with_nullable(True), pa.nulls(n, field.type))
    elif kind == 2:
        other = [None if v is None else str(v) for v in values] if rng.random() < 0.5 else list(range(n))
        table = table.set_column(at, field.name, pa.array(other))
    elif kind == 3:
        table = table.slice(int(rng.integers(0, max(n, 1))), int(rng.integers(0, n + 1)))
    elif kind == 4:
        table = pa.concat_tables([table.slice(n // 2), table.slice(0, n // 2 + 1)])
    else:
        table = table.set_column(at, field.with_nullable(True), _spoilt(values, field.type, rng))
    out = BytesIO()
    if parquet:
        pq.write_table(table, out)
    else:
        with pa.ipc.new_file(out, table.schema) as writer:
            writer.write_table(table)
    return out.getvalue()


def _spoilt(values: list[Any], kind: Any, rng: np.random.Generator) -> Any:
    """Some values as numbers that readers may not expect, lists cut, or None."""
    some = [np.nan, np.inf, -1e300, 0.0] if pa.types.is_floating(kind) else [0, 1, 127]
    if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
        some = [None]
    for _ in range(1 + len(values) // 20):
        if values:
            k = int(rng.integers(0, len(values)))
            short = isinstance(values[k], list) and len(values[k]) > 1 and not pa.types.is_fixed_size_list(kind)
            values[k] = values[k][:-1] if short else some[int(rng.integers(0, len(some)))]
    return pa.array(values, kind)


def messages_damaged(raw: bytes, rng: np.random.Generator, share: float = 0.02) -> bytes:
    """Some messages of an MCAP file damaged, in a file that is whole."""
    reader = make_reader(BytesIO(raw))
    out, schemas, channels = BytesIO(), dict[int, int](), dict[int, int]()
    writer: Any = Writer(out, compression=CompressionType.NONE)
    writer.start(profile=reader.get_header().profile)
    for record in reader.iter_metadata():
        writer.add_metadata(record.name, record.metadata)
    some = list(reader.iter_messages(log_time_order=False))
    rare = Counter(channel.topic for _, channel, _ in some)
    chosen = int(rng.integers(0, len(some)))
    for k, (schema, channel, message) in enumerate(some):
        if channel.id not in channels:
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
            )
        hit = k == chosen or rng.random() < max(share / 10, share / rare[channel.topic])
        kinds = 2 if rng.random() < 0.7 else 7
        data = damaged(message.data, rng, kinds) if hit and message.data else message.data
        writer.add_message(channels[channel.id], message.log_time, data, message.publish_time, message.sequence)
    writer.finish()
    return out.getvalue()


@dataclass(frozen=True)
class Case:
    """A log of a format: the folder that is copied, the log in it, the files that are damaged, and how."""

    name: str
    folder: Path
    log: str
    files: str
    mutate: Mutation = damaged
    read: Callable[[Path], object] = read_log


def cases(made: Path) -> Iterator[Case]:
    """All formats: written into `made`, or from the recorded data."""
    (made / "native").mkdir()
    write_scenario(made / "native" / "log.mcap", rich_scenario(20))
    yield Case("native", made / "native", "log.mcap", "log.mcap")
    yield Case("native, messages", made / "native", "log.mcap", "log.mcap", messages_damaged)
    yield Case("native, salvage", made / "native", "log.mcap", "log.mcap", read=_salvaged)
    rows = bags.transforms(2.0) + bags.odometry(duration=2.0)
    for kind in ("Tracked", "Predicted", "Detected"):
        rows += bags.autoware_objects(f"autoware_perception_msgs/msg/{kind}Objects", f"/objects/{kind}")[:20]
    (made / "bag").mkdir()
    bags.write_ros2(made / "bag" / "log", rows, compressed=False)
    yield Case("ROS 2, not compressed", made / "bag", "log", "log/*")
    yield Case("ROS 2, messages", made / "bag", "log", "log/*.mcap", messages_damaged)
    (made / "db3").mkdir()
    bags.write_ros2(made / "db3" / "log", rows, sqlite=True)
    yield Case("ROS 2, SQLite", made / "db3", "log", "log/*")
    recorded_cases.write_forecasting(made / "forecasting")
    yield Case("Argoverse 2 forecasting", made / "forecasting", ".", "**/*.*")
    _write_table(made / "table")
    yield Case("Argoverse 2 f., JSON", made / "forecasting", ".", "**/*.json", values_damaged)
    yield Case("Argoverse 2 f., columns", made / "forecasting", ".", "**/*.parquet", columns_damaged)
    yield Case("table", made / "table", ".", "*.csv")
    yield Case("table, values", made / "table", ".", "*.csv", values_damaged)
    av2, tartu = "3b3570b4-7b0b-3268-a571-b0889dbf40b6", "pedestrian_crossing_09"
    yield Case("ROS 2, zstd", DATA / "tartu" / "ros2" / tartu, ".", "*.*")
    yield Case(
        "ROS 2, real messages", DATA / "tartu" / "ros2" / tartu, ".", "*.mcap", partial(messages_damaged, share=0.005)
    )
    yield Case("ROS 1", DATA / "tartu" / "ros1", f"{tartu}.bag", f"{tartu}.bag")
    yield Case("OSI, MCAP", DATA / "osi", "osi_centerline_example.mcap", "*.mcap")
    yield Case("OSI, messages", DATA / "osi", "osi_centerline_example.mcap", "*.mcap", messages_damaged)
    ego = partial(read_log, settings=LogSettings(ego="0"))
    yield Case("OSI, .osi", DATA / "osi", "alks_cut-in.osi", "alks_cut-in.osi", read=ego)
    for name, mutate in (("", damaged), (", values", values_damaged)):
        yield Case(f"OpenDRIVE{name}", DATA / "osi", "e6mini.xodr", "e6mini.xodr", mutate, read_map)
        folder = DATA / "tartu" / "lanelet2"
        yield Case(f"Lanelet2{name}", folder, "erm_parking.osm", "erm_parking.osm", mutate, read_map)
    for name, mutate in (("", damaged), (", columns", columns_damaged)):
        log = "logs/madeup_train/signalled_crossing_001"
        yield Case(f"123D{name}", DATA / "py123d" / "madeup", log, "**/*.arrow", mutate)
        files = "**/*.feather" if name else "**/*.*"
        yield Case(f"Argoverse 2 sensor{name}", DATA / "argoverse2" / av2, ".", files, mutate)
    yield Case("Argoverse 2 sensor, JSON", DATA / "argoverse2" / av2, ".", "**/log_map*.json", values_damaged)
    yield Case("comma2k19", DATA / "comma2k19" / "segment_40", ".", "**/[vtf]*")
    for name in ("C-DEU_B471-1_3_T-1", "DEU_Muc-4_2_T-1.cr", "ZAM_Tutorial-1_1_T-1"):
        yield Case(f"CommonRoad {name[:8]}, values", DATA / "commonroad", f"{name}.xml", f"{name}.xml", values_damaged)
    yield Case("CommonRoad", DATA / "commonroad", f"{name}.xml", f"{name}.xml")


def _salvaged(path: Path) -> object:
    """What is left of a damaged file is read again, or refused."""
    out = path.with_name("saved.mcap")
    salvage(path, out)
    return read_log(out)


def _write_table(folder: Path) -> None:
    folder.mkdir()
    t = np.arange(40) / 10.0
    lines = [f"{100 + x},{8 * x},{0.1 * x},0.01,8.0" for x in t]
    (folder / "ego.csv").write_text("\n".join(["t,x,y,yaw,v", *lines]))
    lines = [f"{100 + x},a{i},{20 + i + 5 * x},{3 * i},0.0,car" for i in range(3) for x in t]
    (folder / "agents.csv").write_text("\n".join(["t,id,x,y,yaw,kind", *lines]))
