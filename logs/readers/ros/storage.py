"""The files of a bag: recognised by their first bytes, opened, and their messages counted.

A folder is one bag if it has `metadata.yaml`, or if its files are the parts of one recording: named
STEM_0, STEM_1 ... as recorders name them, each of which begins when the one before ends (within
`SPLIT_S`). One part alone is a bag if the folder has its stem as a name, as a killed recorder
leaves it.

What a file or `metadata.yaml` states is compared with what is there, once, on opening: a note
states what is lost.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path, PurePath
from shutil import copyfileobj
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from replan.core.errors import LogError
from replan.core.names import listed
from replan.logs.mcap.container import COPY_AGAIN, SALVAGE
from replan.logs.readers.ros.sqlite_files import (
    JOURNALS,
    MAGIC as SQLITE,
    copy_to_read,
    has_messages,
)
from replan.logs.readers.ros.walked_mcap import MAGIC as MCAP, WalkedMcap, is_ros2_mcap

ROS1, ZSTD = b"#ROSBAG V", b"\x28\xb5\x2f\xfd"
METADATA = "metadata.yaml"
BAG = b"rosbag2_bagfile_information"
HEAD_BYTES = 64
SUFFIXES = (".bag", ".db3", ".mcap")
SPLIT_S = 2.0
"""Longest time between two parts of a recording, and longest overlap, s: recorders lose some
messages at most.
"""
MAX_CHUNK_BYTES = 1024**3
"""Largest decompressed chunk of a bag, bytes: rosbag2 writes 768 KiB, the largest known are 100
MiB.
"""
_CHUNK_HEAD_BYTES, _FRAME_HEAD_BYTES = 9 + 40, 18
"""Size of an MCAP chunk's head without the name of the compression, and greatest size of a zstd
frame's head.
"""
_PART = re.compile(r"(?P<stem>.+)_(?P<number>0|[1-9]\d{0,8})")
_SHOWN = 6
DAMAGE = (Exception,)
"""Exceptions of rosbags and the decompressors on damaged bytes; they have no common base
(AssertionError, KeyError ...)."""


def describe(error: BaseException) -> str:
    """An exception of a library in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())[:300]


def kind_of(path: Path) -> bytes | None:
    """Return the magic bytes of a bag's file, whatever its name; None if it is none, or cannot be
    read.
    """
    try:
        with path.open("rb") as stream:
            begin = stream.read(HEAD_BYTES)
        if begin.startswith(MCAP):
            return MCAP if is_ros2_mcap(path, begin) else None
    except OSError:
        return None
    if begin.startswith(SQLITE):
        is_bag = path.suffix.lower() == ".db3" or has_messages(path)
        return SQLITE if is_bag else None
    return ROS1 if begin.startswith(ROS1) else None


@dataclass(frozen=True)
class BagFile:
    """An open file of a bag: its first bytes, topics, times (ns), and numbers of messages."""

    path: Path
    magic: bytes
    storage: Any  # of rosbags, or a `WalkedMcap`
    start_ns: int  # log time of the first message; `end_ns` of the last
    end_ns: int
    count: int
    stated: int  # by the file
    note: str = ""

    @property
    def remedy(self) -> str:
        """What helps where it is damaged."""
        return SALVAGE if self.magic == MCAP else COPY_AGAIN


@contextmanager
def opened_parts(path: Path) -> Iterator[tuple[list[BagFile], list[str]]]:
    """Open the files of a bag; also what was lost or mended, one sentence each. LogError if one
    cannot be opened.
    """
    with ExitStack() as stack:
        files, stated, notes = _files_of(path) if path.is_dir() else ([path], Counter(), [])
        parts = [_opened(file, stack, notes) for file in files]
        held = Counter[str]()
        for part in parts:
            for connection in part.storage.connections:
                held[connection.topic] += connection.msgcount
        lost = [
            f"{topic} {held[topic]} of {count}"
            for topic, count in sorted(stated.items())
            if held[topic] < count
        ]
        if lost:
            notes.append(f"{METADATA} states more messages than are read: {listed(lost, _SHOWN)}.")
        yield parts, notes


def _opened(path: Path, stack: ExitStack, notes: list[str]) -> BagFile:
    """Open a file of a bag, through a copy if it is compressed or has a journal."""
    try:
        near = _unpacked(path, stack) if _begins(path, ZSTD) else path
        if _begins(near, SQLITE):
            near, note = copy_to_read(near, stack)
            notes += [note] if note else []
        opener = next(opener for magic, opener in _OPENERS.items() if _begins(near, magic))
        part = opener(path, near, stack)
    except LogError as error:
        raise error.at(path) from None
    except StopIteration:
        raise LogError("the file is not one of a bag", file=path, remedy=COPY_AGAIN) from None
    except DAMAGE as error:
        problem = f"the bag cannot be opened ({describe(error)})"
        raise LogError(problem, file=path, remedy=COPY_AGAIN) from None
    if part.note:
        notes.append(part.note)
    if part.count < part.stated:
        notes.append(f"{path.name} states {part.stated} messages; it holds {part.count}.")
    return part


def _begins(path: Path, magic: bytes) -> bool:
    with path.open("rb") as stream:
        return stream.read(len(magic)) == magic


def _has_content(path: Path) -> bool:
    return path.is_file() and path.stat().st_size > 0


def _unpacked(file: Path, stack: ExitStack) -> Path:
    """Decompress a file into a folder that lasts as long as `stack`."""
    near = Path(stack.enter_context(TemporaryDirectory(prefix="replan-")), file.stem)
    with file.open("rb") as packed, near.open("wb") as copy:
        copyfileobj(ZstdDecompressor().stream_reader(packed, read_across_frames=True), copy)
    return near


def _open_mcap(path: Path, near: Path, stack: ExitStack) -> BagFile:
    """By its index if that accounts for all messages, else from front to back."""
    from rosbags.rosbag2.storage_mcap import McapReader

    storage: Any = McapReader(near)
    storage.meta_scan = _refuse_scan
    try:
        storage.open()
    except DAMAGE:
        return _walked(path, near, stack)
    stack.callback(storage.close)
    indexed, stated = Counter[int](), storage.statistics
    for chunk in storage.chunks:
        indexed.update(chunk.channel_count)
    is_whole = (
        indexed.total() == stated.message_count
        and indexed == Counter(stated.channel_message_counts)
        and all(chunk.channel_count for chunk in storage.chunks)
    )
    if not is_whole or not storage.chunks:
        return _walked(path, near, stack)
    _check_chunks(path, storage)
    return _file_of(path, MCAP, storage, indexed.total())


def _refuse_scan() -> None:
    """What replaces the scan of rosbags, which inflates chunks of any size."""
    raise ValueError("no summary")


def _walked(path: Path, near: Path, stack: ExitStack) -> BagFile:
    walked = WalkedMcap(near)
    stack.callback(walked.close)
    times = walked.start_ns, walked.end_ns
    return BagFile(path, MCAP, walked, *times, walked.count, walked.stated, walked.note)


def _check_chunks(path: Path, storage: Any) -> None:
    """LogError, before it is inflated, if a chunk is larger than `MAX_CHUNK_BYTES`."""
    for chunk in storage.chunks:
        size = chunk.uncompressed_size
        # The frame states how many bytes it holds, whatever the index states
        if chunk.compression == "zstd":
            begin = chunk.chunk_start_offset + _CHUNK_HEAD_BYTES + len(chunk.compression)
            # Reading it says what is wrong
            with suppress(ZstdError, OSError, OverflowError):
                frame = os.pread(storage.bio.fileno(), _FRAME_HEAD_BYTES, begin)
                size = max(size, frame_content_size(frame))
        if size > MAX_CHUNK_BYTES:
            problem = f"a chunk of {chunk.compressed_size} bytes would become {size}"
            raise LogError(problem, file=path, time_ns=chunk.message_start_time, remedy=COPY_AGAIN)


def _open_sqlite(path: Path, near: Path, stack: ExitStack) -> BagFile:
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    # It makes a URI of the path
    storage = Sqlite3Reader(Path(quote(str(near))))
    storage.open()
    stack.callback(storage.close)
    return _file_of(
        path, SQLITE, storage, sum(connection.msgcount for connection in storage.connections)
    )


def _file_of(path: Path, magic: bytes, storage: Any, count: int) -> BagFile:
    about = storage.metadata
    times = about.start_time, about.end_time - 1
    return BagFile(path, magic, storage, *times, count, about.message_count)


def _open_ros1(path: Path, near: Path, stack: ExitStack) -> BagFile:
    from rosbags.rosbag1 import Reader

    storage, note = Reader(near), ""
    try:
        storage.open()
    except DAMAGE:
        from replan.logs.readers.ros.walked_ros1 import WalkedBag

        storage = WalkedBag(near)
        storage.open()
        note = storage.note
    stack.callback(storage.close)
    stated = sum(sum(info.connection_counts.values()) for info in storage.chunk_infos)
    count = sum(connection.msgcount for connection in storage.connections)
    times = storage.start_time, storage.end_time - 1
    return BagFile(path, ROS1, storage, *times, count, stated, note)


_OPENERS: dict[bytes, Callable[[Path, Path, ExitStack], BagFile]] = {
    MCAP: _open_mcap,
    SQLITE: _open_sqlite,
    ROS1: _open_ros1,
}


def _files_of(folder: Path) -> tuple[list[Path], Counter[str], list[str]]:
    """The files of a folder that is a bag, the numbers of messages of its topics by metadata.yaml,
    and how the two differ, one sentence each.
    """
    if not (folder / METADATA).is_file():
        parts = parts_of(folder)
        if not parts:
            problem = f"without {METADATA}, the files are not the parts of one recording"
            raise LogError(problem, file=folder, remedy="name one of its files")
        files = [file for file in parts if _has_content(file)]
        notes = [f"Read as one recording, without {METADATA}: {_listed(parts)}."]
        if len(files) < len(parts):
            notes.append(f"Empty: {_listed(file for file in parts if file not in files)}.")
        if number := _number(parts[0]):
            notes.append(f"The {number} parts before {parts[0].name} are not in the folder.")
        return files, Counter(), notes
    files_there = sorted(filter(_is_storage, bag_files(folder)), key=_number)
    try:
        names, stated = _metadata(folder)
    except DAMAGE as error:
        note = f"{METADATA} cannot be read ({describe(error)}): all files beside it are read."
        return files_there, Counter(), [note]
    files = [folder / name for name in names if _has_content(folder / name)]
    missing = [folder / name for name in names if folder / name not in files]
    others = [file for file in files_there if file.name not in names]
    notes = [f"{METADATA} lists {_listed(missing)}, missing or empty."] if missing else []
    if not files and not others:
        problem = notes[0].rstrip(".") if notes else f"{METADATA} lists no files, and none is there"
        raise LogError(problem, file=folder, remedy=COPY_AGAIN)
    is_renamed = len(missing) == len(others) or not files
    if others and is_renamed:
        notes.append(f"Read in their place: {_listed(others)}.")
        return [*files, *others], stated, notes
    if others:
        notes.append(
            f"Not read, because {METADATA} does not list them: {_listed(others)} (`ros2 bag "
            "reindex` writes it again)."
        )
    return files, stated, notes


def _listed(files: Iterable[Path]) -> str:
    return listed([file.name for file in files], _SHOWN)


def _is_storage(file: Path) -> bool:
    return file.is_file() and (file.suffix == ".zstd" or kind_of(file) is not None)


def _part_name(file: Path) -> re.Match[str] | None:
    """The stem and the number in a part's name, also of a compressed part (rec_10.db3.zstd)."""
    return _PART.fullmatch(Path(file.name.removesuffix(".zstd")).stem)


def _number(file: Path) -> int:
    """The number of a part in its recording; 0 without one."""
    named = _part_name(file)
    return int(named["number"]) if named else 0


def _metadata(folder: Path) -> tuple[list[str], Counter[str]]:
    """The files in metadata.yaml, and the numbers of messages by topic."""
    from ruamel.yaml import YAML

    about = YAML(typ="safe").load((folder / METADATA).read_text())[BAG.decode()]
    stated = Counter[str]()
    for topic in about["topics_with_message_count"]:
        stated[topic["topic_metadata"]["name"]] += int(topic["message_count"])
    return [PurePath(name).name for name in about["relative_file_paths"]], stated


def bag_files(path: Path) -> tuple[Path, ...]:
    """Return the files of a bag: the file itself, or a folder's metadata and all its bag files."""
    if not path.is_dir():
        beside = (Path(f"{path}{suffix}") for suffix in JOURNALS)
        return (path, *(file for file in beside if file.is_file()))
    kinds = (".mcap", ".db3", ".zstd", *(f".db3{suffix}" for suffix in JOURNALS))
    metadata = path / METADATA
    files = sorted(
        file
        for file in path.iterdir()
        if file.suffix in kinds or (file.is_file() and kind_of(file) is not None)
    )
    return (metadata, *files) if metadata.is_file() else tuple(files)


def parts_of(folder: Path) -> tuple[Path, ...]:
    """Return the parts of one recording in a folder without metadata.yaml, in their order; none if
    its files are logs of their own.
    """
    files = [file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES]
    files = sorted((file for file in files if file.is_file()), key=_number)
    names = [_part_name(file) for file in files]
    stems = {None if name is None else name["stem"] for name in names}
    numbers = [_number(file) for file in files]
    is_counted = all(after == number + 1 for number, after in pairwise(numbers))
    if len(stems) != 1 or None in stems or not is_counted:
        return ()
    kinds = {kind_of(file) for file in files if _has_content(file)}
    if len(kinds) != 1 or None in kinds:
        return ()
    if len(files) == 1:
        return tuple(files) if stems == {folder.name} else ()
    facts = [(file, file.stat()) for file in files]
    spans = [_span(file, about.st_size, about.st_mtime_ns) for file, about in facts]
    known = [span for span in spans if span is not None]
    follows = all(abs(begin - end) <= 1e9 * SPLIT_S for (_, end), (begin, _) in pairwise(known))
    return tuple(files) if follows and None not in spans[:-1] else ()


@lru_cache(maxsize=256)
def _span(file: Path, size: int, changed_ns: int) -> tuple[int, int] | None:
    """First and last log time of a file (of this size and time of change), ns; None if it has no
    messages or is damaged.
    """
    try:
        with opened_parts(file) as (parts, _):
            return (parts[0].start_ns, parts[0].end_ns) if parts[0].count else None
    except LogError:
        return None
