"""Salvage keeps what is whole and names what was lost.

A part by the index is the scenario of the whole, cut.
"""

import struct
import zlib
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import zstandard
from differences import differences
from handmade import drive, lanes_along, scenario, straight, track, tracks
from hypothesis import HealthCheck, given, settings, strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from replan.core.errors import LogError
from replan.logs.edit.cut import cut, in_nanoseconds
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.mcap.container import read_container
from replan.logs.mcap.records import BEGIN, HEAD, salvage, write_part
from replan.logs.readers import LogSettings, read_log
from replan.logs.repair.detections import Repair
from replan.logs.repair.offline import detections_of
from replan.logs.scenario import Scenario

Messages = dict[str, list[tuple[int, bytes]]]


def held(path: Path) -> Messages:
    streams = read_container(path).whole().streams
    return {
        topic: list(zip(stream.times, stream.payloads, strict=True))
        for topic, stream in streams.items()
    }


def chunks(raw: bytes) -> list[tuple[int, int]]:
    at, found = BEGIN, []
    while at + HEAD <= len(raw):
        end = at + HEAD + struct.unpack_from("<Q", raw, at + 1)[0]
        found += [(at, end)] if raw[at] == Opcode.CHUNK else []
        at = end
    return found


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """40 s of two topics, a second a chunk."""
    path = tmp_path_factory.mktemp("salvage") / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file, 600, CompressionType.ZSTD)
        writer.start()
        schema = writer.register_schema("by.hand", "jsonschema", b"{}")
        ids = [writer.register_channel(topic, "json", schema) for topic in ("/one", "/two")]
        for k in range(400):
            payload = f'{{"k": {k}, "pad": "{k:040d}"}}'.encode()
            writer.add_message(ids[k % 2], k * 100_000_000, payload, k * 100_000_000)
        writer.add_metadata("said", {"by": "hand"})
        writer.finish()
    return path


def damaged(log: Path, tmp_path: Path, raw: bytes) -> Path:
    path = tmp_path / "damaged.mcap"
    path.write_bytes(raw)
    return path


@given(
    st.lists(st.tuples(st.integers(0, 10**6), st.integers(1, 255)), min_size=1, max_size=6),
    st.integers(0, 400),
)
@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_only_true_messages_are_kept(
    log: Path, tmp_path: Path, flips: list[tuple[int, int]], cut: int
) -> None:
    raw = bytearray(log.read_bytes())
    for place, bits in flips:
        raw[place % len(raw)] ^= bits
    target = tmp_path / "out.mcap"
    target.unlink(missing_ok=True)
    try:
        salvage(damaged(log, tmp_path, bytes(raw[: len(raw) - cut])), target)
    except LogError as error:
        assert "no intact message" in str(error) and not target.exists()
        return
    true = {message for messages in held(log).values() for message in messages}
    assert {message for messages in held(target).values() for message in messages} <= true


def test_a_ros_bag_stays_one_and_chunks_without_checksum_are_said(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file, 600, CompressionType.NONE, enable_crcs=False)
        writer.start(profile="ros2")
        channel = writer.register_channel(
            "/one", "cdr", writer.register_schema("std_msgs/msg/String", "ros2msg", b"")
        )
        for k in range(100):
            writer.add_message(channel, 10**9 + k, bytes(40), 10**9 + k)
        writer.finish()
    report = salvage(path, tmp_path / "out.mcap")
    with (tmp_path / "out.mcap").open("rb") as file:
        assert make_reader(file).get_header().profile == "ros2"
    assert report.unchecked == report.chunks > 3
    assert "of the chunks have no checksum" in report.lines()[-1]
    raw = bytearray(path.read_bytes())
    begin, _ = chunks(bytes(raw))[2]
    at = raw.index((10**9 + 30).to_bytes(8, "little"), begin + HEAD + 40)  # the time of a message
    raw[at + 6] ^= 0xFF
    report = salvage(damaged(path, tmp_path, bytes(raw)), tmp_path / "less.mcap")
    assert len(report.lost) == 1 and report.messages < 100


def test_nothing_is_written_where_nothing_is_left(log: Path, tmp_path: Path) -> None:
    for raw in (b"", b"\x89MCAP0\r\n", log.read_bytes()[:60], bytes(500)):
        with pytest.raises(LogError, match="no intact message is left"):
            salvage(damaged(log, tmp_path, raw), tmp_path / "out.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["damaged.mcap"]


def bomb(tmp_path: Path, stated: int, size: int) -> Path:
    """A file with one chunk of `size` zeros that states another size."""
    data = zstandard.ZstdCompressor().compress(bytes(size))
    chunk = (
        struct.pack("<QQQII", 0, 0, stated, zlib.crc32(bytes(size)), 4)
        + b"zstd"
        + struct.pack("<Q", len(data))
        + data
    )
    stream = BytesIO()
    stream.write(b"\x89MCAP0\r\n" + bytes([Opcode.HEADER]) + struct.pack("<QII", 8, 0, 0))
    stream.write(bytes([Opcode.CHUNK]) + struct.pack("<Q", len(chunk)) + chunk)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(stream.getvalue())
    return path


def test_a_chunk_is_not_inflated_beyond_its_bound(tmp_path: Path) -> None:
    with pytest.raises(
        LogError, match=r"would inflate to 4096 MiB; the bound is 256 MiB; write smaller chunks"
    ):
        read_scenario(bomb(tmp_path, 4 * 2**30, 2**20))
    with pytest.raises(
        LogError, match=r"chunk that begins there is damaged .*states 1000 bytes and holds more"
    ):
        read_scenario(bomb(tmp_path, 1000, 64 * 2**20))
    with pytest.raises(LogError, match="no intact message"):
        salvage(bomb(tmp_path, 4 * 2**30, 2**20), tmp_path / "out.mcap")


SECONDS = 400.0


def long_log() -> Scenario:
    """Some minutes straight on; others come and go."""
    log = drive(straight, 10.0, SECONDS)
    t = np.arange(0.0, SECONDS, 0.1)
    seen = [t[k::5] for k in range(5)] + [
        np.arange(50.0 * k, 50.0 * k + 60.0, 0.1) for k in range(7)
    ]
    seen.append(np.r_[t[t < 100.0], t[t > 300.0]])  # out of sight for minutes
    others = [
        track(f"other{k}", some, 10.0 * some + 20.0, np.full(len(some), 3.0))
        for k, some in enumerate(seen)
    ]
    return replace(scenario(log, agents=tracks(*others), road=lanes_along(log)), name="test/long")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "long.mcap"
    write_scenario(path, long_log())
    return path


def part(whole: Path, begin: float, end: float) -> tuple[Path, int, int]:
    """The part's file, and how many bytes of the whole it took, in how many requests."""
    raw, taken = whole.read_bytes(), []

    def ranged(first: int, last: int) -> bytes:
        taken.append(last - first)
        return raw[first:last]

    path = whole.parent / "part" / whole.name
    path.parent.mkdir(exist_ok=True)
    assert write_part(ranged, len(raw), begin, end, path)
    return path, sum(taken), len(taken)


@given(st.floats(0.0, SECONDS - 2.0), st.floats(1.0, 100.0))
@settings(max_examples=10)
def test_a_part_is_that_of_the_whole(whole: Path, begin: float, length: float) -> None:
    asked = LogSettings(begin=begin, end=begin + length)
    path, _, _ = part(whole, begin, begin + length)
    files = [whole.parent / "one.mcap", whole.parent / "other.mcap"]
    for file, source in zip(files, (whole, path), strict=True):
        write_scenario(file, read_log(source, asked))
    assert files[0].read_bytes() == files[1].read_bytes()


def test_a_part_of_a_repaired_log_has_what_its_tracker_remembers(tmp_path: Path) -> None:
    log = in_nanoseconds(cut(long_log(), 0.0, 90.0))
    repair = Repair(
        detections_of(log.tracks), log.tracks, np.zeros(len(log.tracks.t), np.bool_), (), log.tracks
    )
    write_scenario(tmp_path / "long.mcap", replace(log, repair=repair))
    asked = LogSettings(begin=60.0, end=61.0)
    path, taken, _ = part(tmp_path / "long.mcap", 60.0, 61.0)
    assert taken < 0.8 * (tmp_path / "long.mcap").stat().st_size
    assert differences(read_log(path, asked), read_log(tmp_path / "long.mcap", asked)) == []


def test_a_short_part_takes_few_bytes(whole: Path) -> None:
    _, taken, requests = part(whole, 200.0, 210.0)
    assert taken < 0.6 * whole.stat().st_size
    # summary, two records, head, first chunk, those of the part, the ends of agents
    assert requests <= 8


def test_chunks_side_by_side_are_one_request(whole: Path) -> None:
    _, _, requests = part(whole, 1.0, 399.0)
    assert requests <= 6


def without_chunks(whole: Path) -> bytes:
    out = BytesIO()
    writer = Writer(out, use_chunking=False)
    writer.start()
    container = read_container(whole)
    for name, record in container.metadata.items():
        writer.add_metadata(name, record)
    for stream in container.streams.values():
        schema = writer.register_schema(stream.schema, stream.schema_encoding, stream.schema_data)
        channel = writer.register_channel(stream.topic, stream.encoding, schema)
        for time, payload in zip(stream.times, stream.payloads, strict=True):
            writer.add_message(channel, time, payload, time)
    writer.finish()
    return out.getvalue()


def test_what_has_no_index_is_needed_whole(whole: Path, tmp_path: Path) -> None:
    raw = whole.read_bytes()
    for content in (raw[:-1], raw[:1000], bytes(100), without_chunks(whole)):
        assert not write_part(
            lambda a, b, c=content: c[a:b], len(content), 200.0, 210.0, tmp_path / "part.mcap"
        )
