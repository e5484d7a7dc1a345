"""A part of a native file by its index: the scenario of the whole, cut, for a few of its bytes."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from handmade import drive, lanes_along, scenario, straight, track, tracks
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from mcap_cases import differences

from logs import Scenario
from logs.agents import Repair
from logs.mcap import write_scenario
from logs.mcap.container import read_container
from logs.mcap.records import write_part
from logs.readers import LogSettings, read_log
from logs.readers.cut import cut, in_nanoseconds
from logs.repair import detections_of

SECONDS = 400.0


def long_log() -> Scenario:
    """Some minutes straight on; others come and go."""
    log = drive(straight, 10.0, SECONDS)
    t = np.arange(0.0, SECONDS, 0.1)
    seen = [t[k::5] for k in range(5)] + [np.arange(50.0 * k, 50.0 * k + 60.0, 0.1) for k in range(7)]
    seen.append(np.r_[t[t < 100.0], t[t > 300.0]])  # out of sight for minutes
    others = [track(f"other{k}", some, 10.0 * some + 20.0, np.full(len(some), 3.0)) for k, some in enumerate(seen)]
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
    repair = Repair(detections_of(log.tracks), log.tracks, np.zeros(len(log.tracks.t), np.bool_), (), log.tracks)
    write_scenario(tmp_path / "long.mcap", replace(log, repair=repair))
    asked = LogSettings(begin=60.0, end=61.0)
    path, taken, _ = part(tmp_path / "long.mcap", 60.0, 61.0)
    assert taken < 0.8 * (tmp_path / "long.mcap").stat().st_size
    assert differences(read_log(path, asked), read_log(tmp_path / "long.mcap", asked)) == []


def test_a_short_part_takes_few_bytes(whole: Path) -> None:
    _, taken, requests = part(whole, 200.0, 210.0)
    assert taken < 0.6 * whole.stat().st_size
    assert requests <= 8  # summary, two records, head, first chunk, those of the part, the ends of agents


def test_chunks_side_by_side_are_one_request(whole: Path) -> None:
    _, _, requests = part(whole, 1.0, 399.0)
    assert requests <= 6


def without_chunks(whole: Path) -> bytes:
    """The same messages, each a record of its own."""
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
        assert not write_part(lambda a, b, c=content: c[a:b], len(content), 200.0, 210.0, tmp_path / "part.mcap")
