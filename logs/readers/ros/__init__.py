"""Reads ROS 2 bags (rosbag2: MCAP and SQLite, one file or a folder with metadata.yaml) and ROS 1
bags, without ROS.

Only `bag` uses rosbags. A folder with `metadata.yaml` is one bag, split over its files; `.mcap` and
`.db3` alone are bags of ROS 2, `.bag` of ROS 1. Message definitions come from the file; if it has
none, from `definitions.msg` (Autoware and other packages) and from those of the distribution in
rosbags. If the file has an index, only the chunks of the requested times and topics are read. A
SQLite bag whose recorder did not close it has messages in a journal beside it: both are read,
through a copy.
"""

from __future__ import annotations

from pathlib import Path

from replan.core.errors import LogError
from replan.logs.log_settings import LogSettings
from replan.logs.readers.base import LogContents, Reader, TopicSummary
from replan.logs.readers.ros.bag import BAG, LISTED_BYTES, MAGIC, METADATA, bag_files, opened
from replan.logs.scenario import Scenario


def _claims(path: Path) -> bool:
    try:
        if path.is_dir():
            metadata = path / METADATA
            return metadata.is_file() and BAG in metadata.read_bytes()[:4096]
        magic = MAGIC.get(path.suffix.lower())
        if magic is None or not path.is_file():
            return False
        with path.open("rb") as stream:
            begin = stream.read(64)
    except OSError:
        return False
    if path.suffix.lower() == ".mcap":
        return (
            begin.startswith(magic) and begin[8:9] == b"\x01" and begin[17:25] == b"\x04\0\0\0ros2"
        )
    return begin.startswith(magic)


def _read(path: Path, settings: LogSettings) -> Scenario:
    from replan.logs.readers.ros.read import read_bag  # here: it loads SciPy, which takes long

    return read_bag(path, settings)


def _span(path: Path) -> tuple[float, float] | None:
    try:
        with opened(path) as bag:
            return 0.0, max(0.0, (bag.end_ns - bag.start_ns) / 1e9)
    except LogError:
        return None


def _contents(path: Path) -> LogContents:
    """Return the topics with their numbers of messages, and first and last times if the bag is
    small.
    """
    try:
        small = sum(each.stat().st_size for each in bag_files(path)) <= LISTED_BYTES
        with opened(path) as bag:
            found = []
            for topic in bag.topics:
                times = sorted(time for time, _ in bag.raw(topic)) if small else []
                first, last = (times[0], times[-1]) if times else (None, None)
                coded = ("cdr", "ros2msg") if bag.is_ros2 else ("ros1", "ros1msg")
                found.append(TopicSummary(topic.name, topic.kind, *coded, topic.count, first, last))
            return LogContents("ROS 2 bag" if bag.is_ros2 else "ROS 1 bag", tuple(found))
    except (LogError, OSError):
        return LogContents("ROS bag, damaged")


READER = Reader(
    "ros",
    "ROS 2 bags (rosbag2 as MCAP or SQLite) and ROS 1 bags",
    "rosbag2 folder, .bag",
    (".bag", ".db3"),
    _claims,
    _read,
    bag_files,
    _span,
    _contents,
    ("topics", "frames", "clock", "car", "ego_axes"),
    cuts=True,
)
