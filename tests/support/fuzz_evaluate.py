"""Hostile logs through `evaluate`.

Logs of the formats that the tests write are damaged one by one: bytes flipped, overwritten by
telling values, cut off, cut out, doubled, swapped; single messages, values or columns, where a
checksum or a parser would keep every other change from the reader; files emptied, replaced by a
folder, a link that leads nowhere, a pipe or a device, renamed, in another encoding, with doubled or
shuffled rows, another clock, other separators, control characters in names. Each is evaluated by
the command line in a process of its own, in both loops. It may be judged (exit code 0, 1 or 4, with
a verdict on the terminal) or refused (2 or 3, with one line that says why). It may not

    crash   end with a traceback, "a bug in replan", another exit code, or 0, 1 or 4 without a
            verdict
    hang    take longer than `MOST_S`
    lose    be judged with fewer agents than the input has, without a note that the whole log does
            not have

What may not happen is printed with the seed that makes it again.
"""

import csv
import json
import os
import re
import resource
import shutil
import signal
import struct
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
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
from rich_scenario import rich_scenario

from replan.cli import main as replan
from replan.draw.report import overview, terminal, write
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.readers import read_log
from replan.run import evaluate_logs  # imported here, so that no child has to

MOST_S, ADDRESSES = 60, 12 * 2**30
OUTCOMES = ("judged", "refused", "crashed", "hung", "lost")
GOOD = OUTCOMES[:2]
TELLING = [
    *(b"\xff" * n for n in (1, 2, 4, 8)),
    *(b"\x00" * n for n in (1, 4, 8)),
    b"\x7f\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    *(struct.pack("<d", x) for x in (np.nan, np.inf, -1e300, 1e18, -0.0)),
    struct.pack("<f", np.nan),
    b"-",
    b"e999",
    b"nan",
    b"9" * 20,
    b"<",
    b">",
    b'"',
    b"{",
    b"]",
    b",",
    b"\n",
    b"\xc3\x28",
    b"null",
]
NUMBERS = [
    b"0",
    b"-1",
    b"1e308",
    b"nan",
    b"inf",
    b"-0.0",
    b"9" * 20,
    b"",
    b"1.5",
    b"x",
    b"null",
    b"1e-320",
]
VALUE = re.compile(rb'-?\b\d+\.?\d*(?:[eE][-+]?\d+)?\b|"[^"<>{}\n]*"')
Mutation = Callable[[bytes, np.random.Generator], bytes]
HOSTILE = (
    *NUMBERS,
    b"-1e308",
    b"1e5",
    b"-1e5",
    b"1e18",
    b"1e-300",
    b"True",
    b"\xff",
    b"1,5",
    b"0x10",
    b"  ",
)
NAMES = (
    b"a\x1b[31m",
    b"\xe2\x80\xae",
    b"\x00",
    b"x" * 500,
    b"<b>",
    b"",
    b"\t",
    b"a0",
    b"'",
    b"nan",
)
IMPORTED = evaluate_logs, overview, terminal, write


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
    """Some numbers and texts of XML, JSON or CSV replaced by others of the file or by telling ones,
    or lines lost.
    """
    found = list(VALUE.finditer(raw))
    out = raw
    for k in sorted(rng.integers(0, len(found), int(rng.integers(1, 4))).tolist(), reverse=True):
        at, other = found[k], found[int(rng.integers(0, len(found)))][0]
        word = (
            NUMBERS[int(rng.integers(0, len(NUMBERS)))] if rng.random() < 0.6 else other.strip(b'"')
        )
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
    """A column of an Arrow or Parquet file lost, emptied, of another type, or with telling values;
    or rows lost.
    """
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
        other = (
            [None if v is None else str(v) for v in values]
            if rng.random() < 0.5
            else list(range(n))
        )
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
            short = (
                isinstance(values[k], list)
                and len(values[k]) > 1
                and not pa.types.is_fixed_size_list(kind)
            )
            values[k] = values[k][:-1] if short else some[int(rng.integers(0, len(some)))]
    return pa.array(values, kind)


def rewritten(raw: bytes, change: Callable[[int, Any, Any], Iterable[tuple[int, bytes]]]) -> bytes:
    """An MCAP file that is whole, with other messages: `change(k, channel, message)` gives log
    times and contents.
    """
    reader = make_reader(BytesIO(raw))
    out, schemas, channels = BytesIO(), dict[int, int](), dict[int, int]()
    writer: Any = Writer(out, compression=CompressionType.NONE)
    writer.start(profile=reader.get_header().profile)
    for record in reader.iter_metadata():
        writer.add_metadata(record.name, record.metadata)
    for k, (schema, channel, message) in enumerate(reader.iter_messages(log_time_order=False)):
        if channel.id not in channels:
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, schemas[schema.id], channel.metadata
            )
        for time_ns, data in change(k, channel, message):
            writer.add_message(
                channels[channel.id], time_ns, data, message.publish_time, message.sequence
            )
    writer.finish()
    return out.getvalue()


def messages_damaged(raw: bytes, rng: np.random.Generator, spoil: Mutation | None = None) -> bytes:
    """Some messages of an MCAP file damaged: their bytes, or as `spoil` does."""
    topics = [
        channel.topic
        for _, channel, _ in make_reader(BytesIO(raw)).iter_messages(log_time_order=False)
    ]
    rare, chosen = Counter(topics), int(rng.integers(0, len(topics)))

    def change(k: int, channel: Any, message: Any) -> Iterable[tuple[int, bytes]]:
        hit = k == chosen or rng.random() < max(0.002, 0.02 / rare[channel.topic])
        kinds = 2 if rng.random() < 0.7 else 7
        data = message.data
        if hit and data:
            data = spoil(data, rng) if spoil else damaged(data, rng, kinds)
        yield message.log_time, data

    return rewritten(raw, change)


def json_damaged(raw: bytes, rng: np.random.Generator) -> bytes:
    """Messages of a native log with hostile numbers and names in some of their fields."""
    return messages_damaged(raw, rng, values_damaged)


def clock_changed(raw: bytes, rng: np.random.Generator) -> bytes:
    """An MCAP file with one topic on another clock, shuffled, doubled or lost."""
    some = list(make_reader(BytesIO(raw)).iter_messages(log_time_order=False))
    topics, times = (
        sorted({channel.topic for _, channel, _ in some}),
        [message.log_time for *_, message in some],
    )
    topic, kind = topics[int(rng.integers(0, len(topics)))], int(rng.integers(0, 5))
    shift = int(rng.choice([10**15, 10**11, 60 * 10**9]))

    def change(k: int, channel: Any, message: Any) -> Iterable[tuple[int, bytes]]:
        at = message.log_time
        if channel.topic != topic:
            return [(at, message.data)]
        at = {0: at + shift, 1: max(at - shift, 0), 2: int(rng.choice(times))}.get(kind, at)
        return [(at, message.data)] * {3: 2, 4: 0}.get(kind, 1)

    return rewritten(raw, change)


def lines_of(raw: bytes) -> list[bytes]:
    return raw.splitlines(keepends=True)


def cells_damaged(raw: bytes, rng: np.random.Generator) -> bytes:
    """One column of a CSV file, in one row or in all, with a hostile value.

    Or a hostile name of an agent.
    """
    rows = [line.rstrip(b"\r\n").split(b",") for line in lines_of(raw)]
    k = int(rng.integers(0, len(rows[0])))
    values = NAMES if rows[0][k] in (b"id", b"kind") else HOSTILE
    value = values[int(rng.integers(0, len(values)))]
    chosen = range(1, len(rows)) if rng.random() < 0.3 else [int(rng.integers(1, len(rows)))]
    for i in chosen:
        rows[i][k] = value
    return b"\n".join(b",".join(row) for row in rows)


def rows_damaged(raw: bytes, rng: np.random.Generator) -> bytes:
    """Rows shuffled, doubled, lost, or with another clock.

    Columns lost or exchanged; other separators and units.
    """
    head, *rest = lines_of(raw)
    kind = int(rng.integers(0, 9))
    if kind == 0:
        return head + b"".join(rest[i] for i in rng.permutation(len(rest)))
    if kind == 1:
        return head + b"".join(rest + rest[: int(rng.integers(1, len(rest)))])
    if kind == 2:
        return head
    cells = [line.rstrip(b"\r\n").split(b",") for line in (head, *rest)]
    if kind in (3, 4):
        add = float(rng.choice([1e6, -99.0, 1e9, 50.0, -1e6]))
        some = range(1, len(cells)) if kind == 3 else range(1, len(cells), 2)
        for i in some:
            cells[i][0] = str(float(cells[i][0]) + add).encode()
    elif kind == 5:
        order = rng.permutation(len(cells[0]))
        cells = [
            [row[i] for i in order] for row in cells[: 1 + int(rng.integers(0, 2)) * len(cells)]
        ]
    elif kind == 6:
        k = int(rng.integers(0, len(cells[0])))
        cells = [row[:k] + row[k + 1 :] for row in cells]
    elif kind == 7:
        units = (b"[ms]", b"[km/h]", b"[parsec]", b"(s)", b"[]", b"_ms", b"[deg]")
        cells[0][int(rng.integers(0, len(cells[0])))] += (
            b" " + units[int(rng.integers(0, len(units)))]
        )
    mark = (b";", b"\t", b"|", b" ")[int(rng.integers(0, 4))] if kind == 8 else b","
    return b"\n".join(mark.join(row) for row in cells)


def encoded_otherwise(raw: bytes, rng: np.random.Generator) -> bytes:
    """A text in UTF-16, UTF-32 or with a mark in front.

    Of bytes that are no text, some replaced.
    """
    words = raw.decode("utf-8", "replace")
    return words.encode(("utf-16", "utf-32", "utf-8-sig", "utf-16-le")[int(rng.integers(0, 4))])


Replace = Callable[[Path, np.random.Generator], None]


def emptied(file: Path, rng: np.random.Generator) -> None:
    file.write_bytes(b"")


def made_a_folder(file: Path, rng: np.random.Generator) -> None:
    file.unlink()
    file.mkdir()


def made_a_link(file: Path, rng: np.random.Generator) -> None:
    file.unlink()
    file.symlink_to(("nowhere", "/dev/null", "/dev/zero", file.name)[int(rng.integers(0, 4))])


def made_a_pipe(file: Path, rng: np.random.Generator) -> None:
    file.unlink()
    os.mkfifo(file)


def renamed(file: Path, rng: np.random.Generator) -> None:
    other = (file.name.capitalize(), file.name.upper(), f"{file.name}.gz")[int(rng.integers(0, 3))]
    file.rename(file.with_name(other))


def removed(file: Path, rng: np.random.Generator) -> None:
    file.unlink()


FILES: tuple[Replace, ...] = (emptied, made_a_folder, made_a_link, made_a_pipe, renamed, removed)


@dataclass(frozen=True)
class Case:
    """A log of a format: the folder that is copied, the log in it, the files that are damaged, and
    how.
    """

    name: str
    folder: Path
    log: str
    files: str
    mutations: tuple[Mutation, ...]


def cases(made: Path) -> Iterator[Case]:
    """The logs, written into `made`."""
    (made / "native").mkdir(parents=True)
    write_scenario(made / "native" / "log.mcap", rich_scenario(20))
    of_messages = (messages_damaged, clock_changed)
    yield Case("native", made / "native", "log.mcap", "log.mcap", (damaged,))
    yield Case(
        "native, messages", made / "native", "log.mcap", "log.mcap", (*of_messages, json_damaged)
    )
    rows = bags.transforms(2.0) + bags.odometry(duration=2.0)
    for kind in ("Tracked", "Predicted", "Detected"):
        rows += bags.autoware_objects(
            f"autoware_perception_msgs/msg/{kind}Objects", f"/objects/{kind}"
        )[:20]
    (made / "bag").mkdir()
    bags.write_ros2(made / "bag" / "log", rows, compressed=False)
    yield Case("ROS 2, not compressed", made / "bag", "log", "log/*", (damaged,))
    yield Case("ROS 2, messages", made / "bag", "log", "log/*.mcap", of_messages)
    forecasting = made / "forecasting"
    recorded_cases.write_forecasting(forecasting)
    yield Case("Argoverse 2 forecasting", forecasting, ".", "**/*.*", (damaged,))
    yield Case("Argoverse 2 f., JSON", forecasting, ".", "**/*.json", (values_damaged,))
    yield Case("Argoverse 2 f., columns", forecasting, ".", "**/*.parquet", (columns_damaged,))
    _write_table(made / "table")
    of_tables = (cells_damaged, rows_damaged, encoded_otherwise)
    yield Case("table", made / "table", ".", "*.csv", (damaged, *of_tables))
    yield Case("table, values", made / "table", ".", "*.csv", (values_damaged, *of_tables))


def _write_table(folder: Path) -> None:
    folder.mkdir()
    t = np.arange(40) / 10.0
    lines = [f"{100 + x},{8 * x},{0.1 * x},0.01,8.0" for x in t]
    (folder / "ego.csv").write_text("\n".join(["t,x,y,yaw,v", *lines]))
    lines = [f"{100 + x},a{i},{20 + i + 5 * x},{3 * i},0.0,car" for i in range(3) for x in t]
    (folder / "agents.csv").write_text("\n".join(["t,id,x,y,yaw,kind", *lines]))


def spoil(case: Case, work: Path, rng: np.random.Generator) -> str:
    """Change one file of a copied log; what was done, in words."""
    files = sorted(file for file in work.glob(case.files) if file.is_file() and file.stat().st_size)
    file = files[int(rng.integers(0, len(files)))]
    if rng.random() < 0.2:
        change = FILES[int(rng.integers(0, len(FILES)))]
        change(file, rng)
        return f"{file.name} {change.__name__}"
    mutate = case.mutations[int(rng.integers(0, len(case.mutations)))]
    file.write_bytes(mutate(file.read_bytes(), rng))
    return f"{file.name} {mutate.__name__}"


def agents_in(case: Case, path: Path) -> int | None:
    """How many agents a log has, counted without replan; None where that is not done for its
    format.
    """
    if not case.name.startswith("table"):
        return None
    found = [file for file in path.iterdir() if file.name.casefold().startswith("agents")]
    if not found or not found[0].is_file():
        return len(found) and None
    text = found[0].read_bytes().decode("utf-8-sig", "replace").replace(";", ",").replace("\t", ",")
    rows = list(csv.DictReader(text.splitlines()))
    return len({row["id"] for row in rows if "id" in row})


def evaluated(path: Path, out: Path, said: Path) -> tuple[str, str]:
    """The command line on a log in a child process: outcome without a look at agents, and what was
    said.
    """
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.alarm(MOST_S)
        stream = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(stream, 1)
        os.dup2(stream, 2)
        sys.stdout, sys.stderr = (
            os.fdopen(number, "w", encoding="utf-8", closefd=False) for number in (1, 2)
        )
        sys.argv = [
            "replan",
            "evaluate",
            str(path),
            "-o",
            str(out),
            "-p",
            "constant_speed",
            "--workers",
            "0",
        ]
        code = 99
        try:
            replan()
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 98
        except BaseException:
            import traceback

            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    _, status = os.waitpid(child, 0)
    words = said.read_text(encoding="utf-8", errors="replace")
    if os.WIFSIGNALED(status):
        name = signal.Signals(os.WTERMSIG(status)).name
        return ("hung" if name == "SIGALRM" else "crashed"), f"ended by {name}\n{words[-1500:]}"
    code = os.WEXITSTATUS(status)
    summary = out / "summary.json"
    failures = json.loads(summary.read_text())["failures"] if summary.is_file() else []
    bugs = [str(one["message"]) for one in failures if "a bug in replan" in one["message"]]
    if "Traceback" in words or "a bug in replan" in words or bugs or code not in (0, 1, 2, 3, 4):
        traces = [one.get("traceback") or "" for one in failures]
        return "crashed", "\n".join([f"exit code {code}", *bugs, *traces, words])[-2500:]
    if code in (2, 3) and "error" not in words.lower():
        return "crashed", f"exit code {code} without an error line\n{words[-1500:]}"
    if code in (0, 1, 4) and "Outcome:" not in words:
        return "crashed", f"exit code {code} without a verdict\n{words[-1500:]}"
    return ("refused" if code in (2, 3) else "judged"), words


def lost(case: Case, path: Path, out: Path, whole: tuple[int, frozenset[str]]) -> str:
    """How many agents are missing in what was judged, where no note says so; "": none."""
    summary = json.loads((out / "summary.json").read_text())
    notes = {note for log in summary["logs"] for note in log["notes"]} - whole[1]
    traces = sorted(out.glob("*/*.mcap"))
    if not traces:
        return ""
    driven = min(len(read_scenario(trace).tracks) for trace in traces)
    given = agents_in(case, path)
    expected = whole[0] if given is None else given
    return (
        f"{driven} of {expected} agents are left, and no note says why"
        if driven < expected and not notes
        else ""
    )


def campaign(chosen: Sequence[Case], count: int, seed: int, folder: Path) -> Counter[str]:
    """The outcomes of `count` inputs of the cases in turn."""
    counts = Counter[str]()
    wholes: dict[str, tuple[int, frozenset[str]]] = {}
    for k in range(count):
        case = chosen[k % len(chosen)]
        rng = np.random.default_rng([seed, k])
        work, out = folder / "work", folder / "out"
        shutil.copytree(case.folder, work)
        path = (work / case.log).resolve()
        if case.name not in wholes:
            read = read_log(path)
            wholes[case.name] = len(read.tracks), frozenset(read.notes)
        what, began = spoil(case, work, rng), time.monotonic()
        outcome, words = evaluated(path, out, folder / "said.txt")
        missing = lost(case, path, out, wholes[case.name]) if outcome == "judged" else ""
        outcome, words = ("lost", missing) if missing else (outcome, words)
        counts[outcome] += 1
        took = time.monotonic() - began
        if outcome not in GOOD:
            print(
                f"--- {case.name}, seed {seed}, input {k}, {what}, {took:.1f} s: "
                f"{outcome}\n{words}\n",
                flush=True,
            )
        for place in (work, out):
            shutil.rmtree(place, ignore_errors=True)
    return counts
