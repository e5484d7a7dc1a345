"""Hostile logs through `evaluate`.

The logs of `fuzz_readers` are mutated one by one, by bytes, by values, and as files: emptied, cut off, replaced by a
folder, a link that leads nowhere, a pipe or a device, renamed by case, written in another encoding, with doubled or
shuffled rows, another clock, other separators, control characters in names. Each is evaluated by the command line in a
process of its own, in both loops. It may be judged (exit code 0, 1 or 4, with a verdict on the terminal) or refused (2
or 3, with one line that says why). It may not

    crash   end with a traceback, "a bug in replan", another exit code, or 0, 1 or 4 without a verdict
    hang    take longer than `MOST_S`
    lose    be judged with fewer agents than the input has, without a note that the whole log does not have

What may not happen is printed with the seed that makes it again.
"""

from __future__ import annotations

import csv
import io
import json
import os
import resource
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from fuzz_readers import NUMBERS, Case, Mutation, cases, messages_damaged, values_damaged
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from logs.mcap import read_scenario
from logs.readers import read_log
from replay.cli import main as replan
from replay.draw.report import overview, sections, write
from replay.run import evaluate_logs  # imported here, so that no child has to

MOST_S, ADDRESSES = 60, 12 * 2**30
OUTCOMES = ("judged", "refused", "crashed", "hung", "lost")
GOOD = OUTCOMES[:2]
HOSTILE = (*NUMBERS, b"-1e308", b"1e5", b"-1e5", b"1e18", b"1e-300", b"True", b"\xff", b"1,5", b"0x10", b"  ")
NAMES = (b"a\x1b[31m", b"\xe2\x80\xae", b"\x00", b"x" * 500, b"<b>", b"", b"\t", b"a0", b"'", b"nan")


def lines_of(raw: bytes) -> list[bytes]:
    return raw.splitlines(keepends=True)


def cells_damaged(raw: bytes, rng: np.random.Generator) -> bytes:
    """One column of a CSV file, in one row or in all, with a hostile value; or a hostile name of an agent."""
    rows = [line.rstrip(b"\r\n").split(b",") for line in lines_of(raw)]
    k = int(rng.integers(0, len(rows[0])))
    values = NAMES if rows[0][k] in (b"id", b"kind") else HOSTILE
    value = values[int(rng.integers(0, len(values)))]
    chosen = range(1, len(rows)) if rng.random() < 0.3 else [int(rng.integers(1, len(rows)))]
    for i in chosen:
        rows[i][k] = value
    return b"\n".join(b",".join(row) for row in rows)


def rows_damaged(raw: bytes, rng: np.random.Generator) -> bytes:
    """Rows shuffled, doubled, lost, or with another clock; columns lost or exchanged; other separators and units."""
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
        cells = [[row[i] for i in order] for row in cells[: 1 + int(rng.integers(0, 2)) * len(cells)]]
    elif kind == 6:
        k = int(rng.integers(0, len(cells[0])))
        cells = [row[:k] + row[k + 1 :] for row in cells]
    elif kind == 7:
        units = (b"[ms]", b"[km/h]", b"[parsec]", b"(s)", b"[]", b"_ms", b"[deg]")
        cells[0][int(rng.integers(0, len(cells[0])))] += b" " + units[int(rng.integers(0, len(units)))]
    mark = (b";", b"\t", b"|", b" ")[int(rng.integers(0, 4))] if kind == 8 else b","
    return b"\n".join(mark.join(row) for row in cells)


def encoded_otherwise(raw: bytes, rng: np.random.Generator) -> bytes:
    """A text in UTF-16, UTF-32 or with a mark in front; of bytes that are no text, some replaced."""
    words = raw.decode("utf-8", "replace")
    return words.encode(("utf-16", "utf-32", "utf-8-sig", "utf-16-le")[int(rng.integers(0, 4))])


def clock_changed(raw: bytes, rng: np.random.Generator) -> bytes:
    """An MCAP file with one topic on another clock, shuffled, doubled or lost."""
    reader = make_reader(io.BytesIO(raw))
    header = reader.get_header()
    records = [(record.name, record.metadata) for record in reader.iter_metadata()]
    some = list(reader.iter_messages(log_time_order=False))
    topics = sorted({channel.topic for _, channel, _ in some})
    topic, kind = topics[int(rng.integers(0, len(topics)))], int(rng.integers(0, 5))
    shift = int(rng.choice([10**15, 10**11, 60 * 10**9]))
    out, schemas, channels = io.BytesIO(), dict[int, int](), dict[int, int]()
    writer = Writer(out, compression=CompressionType.NONE)
    writer.start(profile=header.profile)
    for name, metadata in records:
        writer.add_metadata(name, metadata)
    for schema, channel, message in some:
        if channel.id not in channels:
            if schema is not None and schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, schemas[schema.id] if schema else 0, channel.metadata
            )
        at, times = message.log_time, 1
        if channel.topic == topic:
            at += shift * (kind == 0)
            at = max(at - shift, 0) if kind == 1 else at
            at = int(rng.permutation([m.log_time for *_, m in some])[0]) if kind == 2 else at
            times = {3: 2, 4: 0}.get(kind, 1)
        for _ in range(times):
            writer.add_message(channels[channel.id], at, message.data, message.publish_time, message.sequence)
    writer.finish()
    return out.getvalue()


def json_damaged(raw: bytes, rng: np.random.Generator) -> bytes:
    """Messages of a native log with hostile numbers and names in some of their fields."""

    def spoilt(data: bytes, _: np.random.Generator, kinds: int = 7) -> bytes:
        return values_damaged(data, rng)

    import fuzz_readers

    whole = fuzz_readers.damaged
    fuzz_readers.damaged = spoilt
    try:
        return messages_damaged(raw, rng)
    finally:
        fuzz_readers.damaged = whole


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


IMPORTED = evaluate_logs, overview, sections, write
FILES: tuple[Replace, ...] = (emptied, made_a_folder, made_a_link, made_a_pipe, renamed, removed)


def mutations(case: Case) -> dict[str, Mutation]:
    """How the files of a case are changed inside, by name."""
    own = {case.mutate.func.__name__ if hasattr(case.mutate, "func") else case.mutate.__name__: case.mutate}  # type: ignore[attr-defined]
    if case.name.startswith("table"):
        own |= {"cells": cells_damaged, "rows": rows_damaged, "encoding": encoded_otherwise}
    if case.name == "native, messages":
        own |= {"json": json_damaged}
    if case.name.endswith("messages"):
        own |= {"clock": clock_changed}
    return own


def spoil(case: Case, work: Path, rng: np.random.Generator) -> str:
    """Change one file of a copied log; what was done, in words."""
    files = sorted(file for file in work.glob(case.files) if file.is_file() and file.stat().st_size)
    file = files[int(rng.integers(0, len(files)))]
    if rng.random() < 0.2:
        change = FILES[int(rng.integers(0, len(FILES)))]
        change(file, rng)
        return f"{file.name} {change.__name__}"
    name, mutate = list(mutations(case).items())[int(rng.integers(0, len(mutations(case))))]
    file.write_bytes(mutate(file.read_bytes(), rng))
    return f"{file.name} {name}"


def agents_in(case: Case, path: Path) -> int | None:
    """How many agents a log has, counted without replan; None where that is not done for its format."""
    if not case.name.startswith("table"):
        return None
    found = [file for file in path.iterdir() if file.name.casefold().startswith("agents")]
    if not found or not found[0].is_file():
        return len(found) and None
    text = found[0].read_bytes().decode("utf-8-sig", "replace").replace(";", ",").replace("\t", ",")
    rows = list(csv.DictReader(text.splitlines()))
    return len({row["id"] for row in rows if "id" in row})


def evaluated(path: Path, out: Path, said: Path, planner: str, ego: str = "") -> tuple[str, str]:
    """The command line on a log in a child process: outcome without a look at agents, and what was said."""
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.alarm(MOST_S)
        stream = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(stream, 1)
        os.dup2(stream, 2)
        sys.stdout, sys.stderr = (os.fdopen(number, "w", encoding="utf-8", closefd=False) for number in (1, 2))
        asked = ["--ego", ego] if ego else []
        sys.argv = ["replan", "evaluate", str(path), "-o", str(out), "-p", planner, "--workers", "0", *asked]
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
    return f"{driven} of {expected} agents are left, and no note says why" if driven < expected and not notes else ""


def campaign(
    chosen: Sequence[Case], count: int, seed: int, folder: Path, planner: str = "constant_speed"
) -> dict[str, Counter[str]]:
    """`count` inputs of the cases in turn; the outcomes by format."""
    counts = {case.name: Counter[str]() for case in chosen}
    wholes: dict[str, tuple[int, frozenset[str]]] = {}
    for k in range(count):
        case = chosen[k % len(chosen)]
        rng = np.random.default_rng([seed, k])
        work, out = folder / "work", folder / "out"
        shutil.copytree(case.folder, work)
        path = (work / case.log).resolve()
        ego = "0" if case.log.endswith(".osi") else ""
        if case.name not in wholes:
            read = read_log(path) if not ego else case.read(path)
            wholes[case.name] = len(read.tracks), frozenset(read.notes)  # type: ignore[attr-defined]
        what, began = spoil(case, work, rng), time.monotonic()
        outcome, words = evaluated(path, out, folder / "said.txt", planner, ego)
        missing = lost(case, path, out, wholes[case.name]) if outcome == "judged" else ""
        outcome, words = ("lost", missing) if missing else (outcome, words)
        counts[case.name][outcome] += 1
        took = time.monotonic() - began
        if outcome not in GOOD:
            print(f"--- {case.name}, seed {seed}, input {k}, {what}, {took:.1f} s: {outcome}\n{words}\n", flush=True)
        for place in (work, out):
            shutil.rmtree(place, ignore_errors=True)
    return counts


def formats(made: Path) -> list[Case]:
    """The cases of `fuzz_readers` that are logs and whose data are there."""
    found = [case for case in cases(made) if case.folder.exists()]
    return [case for case in found if not case.name.startswith(("OpenDRIVE", "Lanelet2", "native, salvage"))]
