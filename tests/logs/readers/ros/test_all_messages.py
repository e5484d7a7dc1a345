"""All messages of a bag are read, or a word says which are lost.

Bags of other writers, of killed recorders, in parts, renamed, and cut off at any byte.
"""

import shutil
import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import ros_bags as bags
from command_line import evaluate, replan
from differences import differences
from hypothesis import HealthCheck, given, settings, strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from ros_bags import START_NS, Row, message
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer as Writer2
from zstandard import ZstdCompressor

from replan.core.errors import LogError
from replan.logs.mcap.records import BEGIN, HEAD, salvage
from replan.logs.readers import LogSettings, read_log, reader_of
from replan.logs.readers.ros import READER
from replan.logs.readers.ros.bag import opened
from replan.logs.readers.ros.storage import parts_of
from replan.logs.readers.ros.walked_mcap import WalkedMcap
from replan.run.sources import select

TRACKED = "autoware_perception_msgs/msg/TrackedObjects"
TOPIC = "/perception/object_recognition/tracking/objects"
MIDDLE_NS = START_NS + 3_000_000_000
ALL = {"/tf": 332, "/tf_static": 1, TOPIC: 61}
"""Numbers of messages of the drive below."""


def drive() -> list[Row]:
    """Six seconds, whose objects are in the frame of a sensor that only /tf_static places."""
    objects = bags.autoware_objects(TRACKED, TOPIC, "base_link")
    for _, _, _, each in objects:
        each.header.frame_id = "lidar"
    return bags.transforms() + objects


def packed(
    source: Path,
    target: Path,
    *,
    profile: str = "ros2",
    stop_index_ns: int | None = None,
    keep: Callable[[str, int], bool] = lambda topic, time: True,
    extra: int = 0,
    **options: Any,
) -> Path:
    """Write the messages of an MCAP file once more; `extra` are stated and not there."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with source.open("rb") as stream, target.open("wb") as file:
        writer: Any = Writer(file, **{"chunk_size": 8_000, **options})
        writer.start(profile=profile)
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, each in make_reader(stream).iter_messages():
            if not keep(channel.topic, each.log_time):
                continue
            if stop_index_ns is not None and each.log_time > stop_index_ns:
                writer._Writer__index_types = IndexType.CHUNK
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id]
                )
            writer.add_message(channels[channel.id], each.log_time, each.data, each.publish_time)
        writer._Writer__statistics.message_count += extra
        writer.finish()
    return target


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bags.write_ros2(tmp_path_factory.mktemp("source") / "drive", drive())


@pytest.fixture(scope="module")
def source(folder: Path) -> Path:
    return next(folder.glob("*.mcap"))


@pytest.fixture(scope="module")
def whole(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return packed(source, tmp_path_factory.mktemp("whole") / "drive.mcap")


def numbers(path: Path) -> dict[str, int]:
    """The messages that are read, by topic; each topic as many as it says."""
    with opened(path) as bag:
        read = {topic.name: len(list(bag.raw(topic))) for topic in bag.topics}
        assert read == {topic.name: topic.count for topic in bag.topics}
        return read


def notes(path: Path) -> str:
    with opened(path) as bag:
        return " ".join(bag.notes)


def is_walked(path: Path) -> bool:
    with opened(path) as bag:
        return any(isinstance(part.storage, WalkedMcap) for part in bag.parts)


# Files whose index does not account for all messages

WITHOUT = {
    "message indexes": {"index_types": IndexType.CHUNK},
    "message indexes, in large chunks": {"index_types": IndexType.CHUNK, "chunk_size": 1 << 20},
    "message indexes, in tiny chunks": {"index_types": IndexType.CHUNK, "chunk_size": 300},
    "message indexes, lz4": {
        "index_types": IndexType.CHUNK,
        "compression": CompressionType.LZ4,
    },
    "message indexes, uncompressed": {
        "index_types": IndexType.CHUNK,
        "compression": CompressionType.NONE,
    },
    "message indexes from the middle on": {"stop_index_ns": MIDDLE_NS},
    "message indexes from the middle on, nor statistics": {
        "stop_index_ns": MIDDLE_NS,
        "use_statistics": False,
    },
    "chunk indexes": {"index_types": IndexType.MESSAGE},
    "any index": {"index_types": IndexType.NONE, "use_statistics": False},
    "a summary": {
        "index_types": IndexType.NONE,
        "use_statistics": False,
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_summary_offsets": False,
    },
    "schemas in the summary": {"repeat_schemas": False, "repeat_channels": False},
    "chunks": {"use_chunking": False},
    "chunks and statistics": {"use_chunking": False, "use_statistics": False},
    "a profile": {"profile": ""},
    "a profile of ROS 2": {"profile": "x-vehicle", "compression": CompressionType.LZ4},
    "a profile and message indexes": {"profile": "", "index_types": IndexType.CHUNK},
}


@pytest.mark.parametrize("lacks", WITHOUT)
def test_a_file_without_an_index_is_the_same_log(
    lacks: str, source: Path, whole: Path, tmp_path: Path
) -> None:
    options: dict[str, Any] = WITHOUT[lacks]
    path = packed(source, tmp_path / "drive.mcap", **options)
    assert is_walked(path) and numbers(path) == ALL
    assert differences(read_log(path), read_log(whole)) == []
    part = LogSettings(begin=2.0, end=4.0)
    assert differences(read_log(path, part), read_log(whole, part)) == []


def test_a_whole_file_is_read_by_its_index(whole: Path, folder: Path) -> None:
    assert not is_walked(whole) and numbers(whole) == ALL and notes(whole) == ""
    assert not is_walked(folder) and numbers(folder) == ALL and notes(folder) == ""


def test_messages_in_any_order_are_read_without_an_index(source: Path, tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with source.open("rb") as stream:
        late_first = list(make_reader(stream).iter_messages())[::-1]
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start("ros2")
        channels: dict[str, int] = {}
        for schema, channel, each in late_first:
            assert schema is not None
            if channel.topic not in channels:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", kind)
            writer.add_message(channels[channel.topic], each.log_time, each.data, 0)
        writer.finish()
    assert numbers(path) == ALL
    assert differences(read_log(path), read_log(source)) == []


def test_channels_of_other_encodings_are_passed_over(source: Path, tmp_path: Path) -> None:
    path = tmp_path / "drive.mcap"
    with source.open("rb") as stream, path.open("wb") as file:
        writer = Writer(file)
        writer.start("")
        said = writer.register_channel(
            "/said", "json", writer.register_schema("said", "jsonschema", b"{}")
        )
        channels: dict[str, int] = {}
        for schema, channel, each in make_reader(stream).iter_messages():
            assert schema is not None
            if channel.topic not in channels:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", kind)
            writer.add_message(channels[channel.topic], each.log_time, each.data, 0)
            writer.add_message(said, each.log_time, b"{}", 0)
        writer.finish()
    assert numbers(path) == ALL and notes(path) == ""


@pytest.mark.parametrize("index_types", [IndexType.ALL, IndexType.CHUNK])
def test_messages_that_are_stated_and_not_there_are_a_note(
    index_types: IndexType, source: Path, tmp_path: Path
) -> None:
    path = packed(source, tmp_path / "drive.mcap", extra=6, index_types=index_types)
    assert numbers(path) == ALL
    assert "drive.mcap states 400 messages; it holds 394." in read_log(path).notes


# Recordings that were not closed


def records(raw: bytes) -> list[int]:
    """Where the records of a file end."""
    place, ends = BEGIN, []
    while place + HEAD <= len(raw) - BEGIN:
        place += HEAD + struct.unpack_from("<Q", raw, place + 1)[0]
        ends.append(place)
    return ends


def check_prefix(path: Path, tmp_path: Path) -> None:
    """The first messages are read with a note, or a remedy is named that works."""
    try:
        read = read_log(path)
    except LogError as error:
        line = str(error)
        assert str(path) in line and "\n" not in line and error.remedy
        if "replan salvage" in line and "copy it again" not in line:
            salvage(path, tmp_path / "saved.mcap")
            assert len(read_log(tmp_path / "saved.mcap").ego)
        return
    assert any("was not closed" in note or "is cut off" in note for note in read.notes)
    held = numbers(path)
    assert all(held.get(topic, 0) <= count for topic, count in ALL.items())


CONTAINERS = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "uncompressed": {"compression": CompressionType.NONE},
    "no chunks": {"use_chunking": False},
    "no index": {"index_types": IndexType.NONE, "use_statistics": False},
    "no profile": {"profile": ""},
    "no checksums": {"enable_crcs": False, "compression": CompressionType.NONE},
}


@pytest.fixture(scope="module")
def contents(source: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The bytes of a file by what is special with it."""
    place = tmp_path_factory.mktemp("contents")
    options: dict[str, dict[str, Any]] = CONTAINERS
    files = {name: packed(source, place / f"{name}.mcap", **options[name]) for name in CONTAINERS}
    files["SQLite"] = next(bags.write_ros2(place / "sql", drive(), sqlite=True).glob("*.db3"))
    for compression in (None, *Writer1.CompressionFormat):
        files[f"ROS 1 {compression}"] = write_ros1(place / f"{compression}.bag", compression)
    return {name: path.read_bytes() for name, path in files.items()}


def write_ros1(path: Path, compression: Any = None) -> Path:
    """A ROS 1 bag of several chunks."""
    types = bags.store(ros1=True)
    rows = [(t, k, n, message(k, types, **bags.values_of(m))) for t, k, n, m in bags.transforms()]
    writer = Writer1(path)
    writer.chunk_threshold = 8_000
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        bags.write_rows(writer, rows, types, types.serialize_ros1)
    return path


OTHERS = ("SQLite", *(f"ROS 1 {each}" for each in (None, *Writer1.CompressionFormat)))


@given(st.data(), st.sampled_from([*CONTAINERS, *OTHERS]), st.booleans())
@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_a_file_cut_off_anywhere_is_a_prefix_or_refused(
    contents: dict[str, bytes], tmp_path: Path, data: st.DataObject, name: str, at_a_record: bool
) -> None:
    raw = contents[name]
    at_a_record = at_a_record and name in CONTAINERS
    places = st.sampled_from(records(raw)) if at_a_record else st.integers(0, len(raw) - 1)
    path = tmp_path / "cut.mcap"
    path.write_bytes(raw[: data.draw(places)])
    check_prefix(path, tmp_path)


def test_a_killed_recording_says_what_is_lost(contents: dict[str, bytes], tmp_path: Path) -> None:
    raw = contents["zstd"]
    ends = [end for end in records(raw) if end < 0.6 * len(raw)]
    path = tmp_path / "killed.mcap"
    path.write_bytes(raw[: ends[-1] + 100])
    scenario = read_log(path)
    count = sum(numbers(path).values())
    assert "killed.mcap was not closed" in scenario.notes[0]
    assert f"{count} messages" in scenario.notes[0] and "the last 100 bytes" in scenario.notes[0]
    path.write_bytes(raw[: ends[-1]])
    assert sum(numbers(path).values()) == count and "damaged" not in read_log(path).notes[0]
    path.write_bytes(raw[: ends[-1]] + bytes(4096))  # as a power cut leaves a file
    assert "the last 4096 bytes" in read_log(path).notes[0]


@pytest.mark.parametrize("name", OTHERS)
def test_what_is_whole_of_other_files_that_are_cut_off_is_read(
    name: str, contents: dict[str, bytes], tmp_path: Path
) -> None:
    raw, path, held = contents[name], tmp_path / "cut.bag", [0]
    for part in (0.5, 0.7, 0.9):
        path.write_bytes(raw[: int(part * len(raw))])
        assert len(read_log(path).ego) >= 100 * part
        held.append(sum(numbers(path).values()))
    assert held == sorted(held) and held[0] < held[1] < held[2]
    path.write_bytes(raw[:-1])
    assert "cut.bag" in notes(path)


def chunks_of_ros1(raw: bytes) -> list[tuple[int, int]]:
    """Where the data of the chunks begin and end."""
    place, chunks = raw.index(b"\n") + 1, []
    while place < len(raw):
        header = place + 4 + int.from_bytes(raw[place : place + 4], "little")
        end = header + 4 + int.from_bytes(raw[header : header + 4], "little")
        chunks += [(header + 4, end)] if b"op=\x05" in raw[place:header] else []
        place = end
    return chunks


def test_a_ros1_bag_whose_recorder_was_killed_has_all_whole_messages(
    contents: dict[str, bytes], tmp_path: Path
) -> None:
    """It has no index, and its last chunk does not say how long it is."""
    raw = bytearray(contents["ROS 1 None"])
    chunks = chunks_of_ros1(bytes(raw))
    place = raw.index(b"index_pos=") + len(b"index_pos=")
    raw[place : place + 8] = bytes(8)
    begin, end = chunks[-1]
    raw[begin - 4 : begin] = bytes(4)
    path = tmp_path / "drive.bag.active"
    path.write_bytes(raw[:end])
    assert numbers(path) == all_of(".bag") and f"333 messages of {len(chunks)}" in notes(path)
    path.write_bytes(raw[: end - 30])
    assert numbers(path)["/tf"] == ALL["/tf"] - 1
    begin, _ = chunks[2]
    raw[begin + 500 : begin + 600] = bytes(100)
    path.write_bytes(raw[:end])
    with pytest.raises(LogError, match=r"damaged in the chunk at byte \d+"):
        read_log(path)


def test_damage_before_whole_chunks_is_refused_with_a_remedy_that_works(
    contents: dict[str, bytes], tmp_path: Path
) -> None:
    raw = bytearray(contents["zstd"])
    chunks = [end for end in [BEGIN, *records(raw)] if raw[end : end + 1] == bytes([Opcode.CHUNK])]
    raw[chunks[2] + 200] ^= 0xFF
    for end in (len(raw), chunks[6]):  # whole but for it, and cut off, too
        path = tmp_path / "damaged.mcap"
        path.write_bytes(raw[:end])
        with pytest.raises(LogError, match="replan salvage") as refused:
            read_log(path)
        assert str(path) in str(refused.value)
        saved = tmp_path / "saved.mcap"
        assert replan("salvage", path, saved).exit_code == 0
        assert read_log(saved).notes and numbers(saved)
        saved.unlink()


def test_an_index_that_leaves_messages_out_is_refused_with_their_number(
    whole: Path, tmp_path: Path
) -> None:
    """Times in an index of chunks that are not those of the messages."""
    raw = bytearray(whole.read_bytes())
    index = bytes([Opcode.CHUNK_INDEX])
    place = next(end for end in records(bytes(raw)) if raw[end : end + 1] == index)
    begin, end = struct.unpack_from("<QQ", raw, place + HEAD)
    struct.pack_into("<QQ", raw, place + HEAD, begin + (end - begin) // 2, end)
    path = tmp_path / "drive.mcap"
    path.write_bytes(raw)
    with pytest.raises(LogError, match=r"\d+ of 332 messages can be read") as refused:
        read_log(path)
    assert "replan salvage" in str(refused.value)
    salvage(path, tmp_path / "saved.mcap")
    assert numbers(tmp_path / "saved.mcap") == ALL


# Parts of one recording


def write_parts(place: Path, kind: str, bounds: list[int]) -> Path:
    """The drive in parts drive_0, drive_1 ... that begin at `bounds`, ns; without metadata.yaml.

    In ROS 1 without its objects, whose type ROS 1 has not.
    """
    types = bags.store(ros1=True)
    rows = bags.transforms() if kind == ".bag" else drive()
    place.mkdir()
    for number, (begin, end) in enumerate(zip(bounds, [*bounds[1:], 2**62], strict=True)):
        part = [row for row in rows if begin <= row[2] < end]
        scratch = place.parent / f"{place.name}_{number}"
        if kind == ".bag":
            old = [(t, k, n, message(k, types, **bags.values_of(m))) for t, k, n, m in part]
            bags.write_ros1(place / f"drive_{number}.bag", old, types)
        else:
            written = bags.write_ros2(scratch, part, sqlite=kind == ".db3")
            shutil.move(next(written.glob(f"*{kind}")), place / f"drive_{number}{kind}")
            shutil.rmtree(scratch)
    return place


def all_of(kind: str) -> dict[str, int]:
    return {topic: count for topic, count in ALL.items() if kind != ".bag" or topic != TOPIC}


THREE = [0, START_NS + 2_000_000_000, START_NS + 4_000_000_000]


@pytest.mark.parametrize("kind", [".mcap", ".db3", ".bag"])
def test_parts_without_metadata_are_one_log(kind: str, folder: Path, tmp_path: Path) -> None:
    place = write_parts(tmp_path / "drive", kind, THREE)
    assert [part.name for part in parts_of(place)] == [f"drive_{k}{kind}" for k in range(3)]
    assert numbers(place) == all_of(kind)
    if kind == ".bag":
        folder = bags.write_ros2(tmp_path / "one", bags.transforms())
    scenario, one = read_log(place), read_log(folder)
    note = f"Read as one recording, without metadata.yaml: drive_0{kind}"
    assert scenario.notes[0].startswith(note)
    if kind != ".bag":
        with pytest.raises(LogError, match="lidar"):
            read_log(place / f"drive_1{kind}")  # /tf_static is in the first part
    alike = replace(scenario, name=one.name, notes=one.notes, source=one.source)
    assert differences(alike, one) == []
    assert [source.path for source in select([place]).sources] == [place]


def test_a_killed_recording_in_parts_has_what_its_last_part_has(tmp_path: Path) -> None:
    place = write_parts(tmp_path / "drive", ".mcap", THREE)
    last = place / "drive_2.mcap"
    last.write_bytes(last.read_bytes()[:-400])
    assert "drive_2.mcap was not closed" in notes(place)
    assert len(read_log(place).ego) > 200
    last.write_bytes(b"")
    assert "Empty: drive_2.mcap." in notes(place) and len(read_log(place).ego) > 150
    (place / "drive_0.mcap").unlink()
    last.unlink()
    (place / "drive_1.mcap").rename(place / "drive_7.mcap")
    assert "The 7 parts before drive_7.mcap are not in the folder." in notes(place)


def later(row: Row, by_ns: int) -> Row:
    return row[0], row[1], row[2] + by_ns, row[3]


@pytest.mark.parametrize("after_s", [-6.0, 60.0, -3600.0])
def test_numbered_recordings_of_other_times_are_logs_of_their_own(
    after_s: float, tmp_path: Path
) -> None:
    place = tmp_path / "drive"
    place.mkdir()
    for number, by_ns in enumerate((0, round(1e9 * (6.0 + after_s)))):
        rows = [later(row, by_ns) for row in bags.odometry(duration=6.0 - number)]
        written = bags.write_ros2(tmp_path / f"of_{number}", rows)
        shutil.move(next(written.glob("*.mcap")), place / f"drive_{number}.mcap")
    assert reader_of(place) is None
    kept = select([place])
    assert len(kept.sources) == 2
    result = replan("inspect", place)
    assert result.exit_code == 2
    assert "a folder of 2 logs, drive_0.mcap, drive_1.mcap; name one of them" in result.stderr


@pytest.mark.parametrize(
    "names",
    [
        ("drive_0", "drive_2"),
        ("drive_0", "ride_1"),
        ("drive_0", "drive_01"),
        ("drive_0", "drive_1", "notes"),
        ("first", "second"),
    ],
)
def test_files_that_are_not_named_as_parts_are_logs_of_their_own(
    names: tuple[str, ...], tmp_path: Path
) -> None:
    place = write_parts(tmp_path / "drive", ".mcap", THREE[: len(names)])
    for number, name in enumerate(names):
        (place / f"drive_{number}.mcap").rename(place / f"{name}.moved")
    for name in names:
        (place / f"{name}.moved").rename(place / f"{name}.mcap")
    assert parts_of(place) == () and reader_of(place) is None
    with pytest.raises(LogError, match="not the parts of one recording"):
        read_log(place, reader=READER)


# metadata.yaml that differs from the folder


def test_a_part_that_metadata_lists_and_is_missing_is_a_note(folder: Path, tmp_path: Path) -> None:
    place = write_parts(tmp_path / "drive", ".mcap", THREE)
    listed = "".join(f"  - drive_{k}.mcap\n" for k in range(3))
    text = (folder / "metadata.yaml").read_text()
    (place / "metadata.yaml").write_text(text.replace("  - drive.mcap\n", listed))
    assert numbers(place) == ALL and notes(place) == ""
    (place / "drive_2.mcap").rename(place / "last.mcap.bak")
    assert "metadata.yaml lists drive_2.mcap, missing" in notes(place)
    assert "Read in their place: last.mcap.bak." in notes(place) and numbers(place) == ALL
    (place / "last.mcap.bak").unlink()
    said = notes(place)
    assert "metadata.yaml lists drive_2.mcap, missing" in said
    assert "states more messages than are read" in said and f"{TOPIC} 40 of 61" in said
    (place / "metadata.yaml").write_text(text.replace("drive.mcap", "drive_0.mcap"))
    said = notes(place)
    assert "Not read, because metadata.yaml does not list them: drive_1.mcap" in said


def test_a_folder_whose_file_was_renamed_is_read(folder: Path, tmp_path: Path) -> None:
    place = tmp_path / "drive"
    shutil.copytree(folder, place)
    (place / "drive.mcap").rename(place / "tuesday.mcap")
    assert numbers(place) == ALL
    assert "drive.mcap, missing or empty. Read in their place: tuesday.mcap." in notes(place)
    (place / "tuesday.mcap").unlink()
    with pytest.raises(LogError, match=r"metadata\.yaml lists drive\.mcap, missing") as refused:
        read_log(place)
    assert refused.value.remedy


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_what_rosbag2_compresses_itself_is_read(
    mode: CompressionMode, plugin: StoragePlugin, folder: Path, tmp_path: Path
) -> None:
    place = tmp_path / "drive"
    writer = Writer2(place, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        bags.write_rows(writer, drive(), bags.STORE, bags.STORE.serialize_cdr)
    assert numbers(place) == ALL and notes(place) == ""
    assert differences(read_log(place), read_log(folder)) == []
    if mode is CompressionMode.MESSAGE:
        file = next(file for file in place.iterdir() if file.suffix != ".yaml")
        assert differences(replace(read_log(file), name="drive"), read_log(folder)) == []


@pytest.mark.parametrize("text", ["", "rosbag2_bagfile_information: {", "other: 1\n", "\0\0\0"])
def test_damaged_metadata_is_done_without(text: str, folder: Path, tmp_path: Path) -> None:
    place = tmp_path / "drive"
    place.mkdir()
    shutil.copy(folder / "drive.mcap", place / "drive_0.mcap")
    (place / "metadata.yaml").write_text(text)
    assert numbers(place) == ALL
    assert "metadata.yaml cannot be read" in notes(place)


def test_compressed_parts_beside_damaged_metadata_are_in_the_order_of_their_numbers(
    tmp_path: Path,
) -> None:
    begins = [0, *(START_NS + 500_000_000 * k for k in range(1, 11))]
    place = write_parts(tmp_path / "drive", ".mcap", begins)
    for file in list(place.iterdir()):
        file.with_name(f"{file.name}.zstd").write_bytes(
            ZstdCompressor().compress(file.read_bytes())
        )
        file.unlink()
    (place / "metadata.yaml").write_text("")
    with opened(place) as bag:
        assert [part.path.name for part in bag.parts] == [
            f"drive_{number}.mcap.zstd" for number in range(11)
        ]


def test_metadata_that_lists_no_files_is_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  relative_file_paths: []\n  topics_with_message_count: []\n"
    )
    with pytest.raises(LogError, match=r"metadata\.yaml lists no files"):
        read_log(tmp_path)


def test_rows_that_are_missing_in_a_database_are_a_note(tmp_path: Path) -> None:
    place = bags.write_ros2(tmp_path / "drive", drive(), sqlite=True)
    file = next(place.glob("*.db3"))
    with closing(sqlite3.connect(file)) as database, database:
        database.execute("DELETE FROM messages WHERE id > 300")
    assert "metadata.yaml states more messages than are read" in notes(place)
    with closing(sqlite3.connect(file)) as database, database:
        database.execute("DELETE FROM topics WHERE name = '/tf_static'")
    assert f"{file.name} states 300 messages; it holds 299." in notes(file)


# Renamed files


@pytest.mark.parametrize("suffix", [".mcap", ".db3", ".bag", ".mcap.bak", "", ".sqlite", ".zip"])
@pytest.mark.parametrize("kind", [".mcap", ".db3", ".bag"])
def test_a_renamed_bag_is_read_by_its_content(
    kind: str, suffix: str, folder: Path, tmp_path: Path
) -> None:
    place = write_parts(tmp_path / "parts", kind, [0])
    path = (place / f"drive_0{kind}").rename(tmp_path / f"drive{suffix}")
    assert numbers(path) == all_of(kind)
    assert [source.path for source in select([path]).sources] == [path]


# What users bring


def test_what_users_bring_is_read(shared_data: Path, tmp_path: Path) -> None:
    users = shared_data / "users"
    scenarios = []
    for name in ("whole", "half", "none"):
        path = users / "mcap_without_message_index" / f"{name}.mcap"
        assert sorted(numbers(path).values()) == [120, 480], name
        shutil.copy(path, tmp_path / "drive.mcap")
        scenarios.append(read_log(tmp_path / "drive.mcap"))
    assert [(len(each.ego), len(each.tracks.t)) for each in scenarios] == [(480, 120)] * 3
    for each in scenarios[1:]:
        assert differences(each, scenarios[0]) == []
    for path in (users / "killed_recording/killed.mcap", users / "killed_recording/killed_bag"):
        assert sum(numbers(path).values()) == 435 and "435 messages of 9 chunks" in notes(path)
        assert read_log(path).duration == pytest.approx(8.675, abs=1e-3)
    export = users / "mcap_without_profile" / "export.mcap"
    assert sorted(numbers(export).values()) == [120, 240]
    done = evaluate(users / "killed_recording/killed_bag", "-o", tmp_path / "run")
    assert done.exit_code in (0, 1), done.stderr
