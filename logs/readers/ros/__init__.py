"""Reads ROS 2 bags (rosbag2: MCAP and SQLite, one file or a folder) and ROS 1 bags, without ROS.

`storage` opens the files, which it recognises by their content; `bag` makes topics of them. Message
definitions come from the file; if it has none, from `definitions.msg` (Autoware and other packages)
and from those of the distribution in rosbags. If the file has an index, only the chunks of the
requested times and topics are read. A SQLite bag whose recorder did not close it has messages in a
journal beside it: both are read, through a copy.
"""

from __future__ import annotations

from pathlib import Path

from replan.core.errors import LogError
from replan.logs.log_settings import LogSettings
from replan.logs.readers.base import LogContents, Reader, TopicSummary
from replan.logs.readers.ros.bag import LISTED_BYTES, opened
from replan.logs.readers.ros.storage import BAG, METADATA, bag_files, kind_of, parts_of
from replan.logs.scenario import Scenario


def _claims(path: Path) -> bool:
    try:
        if not path.is_dir():
            return path.is_file() and kind_of(path) is not None
        metadata = path / METADATA
        is_bag = metadata.is_file() and BAG in metadata.read_bytes()[:4096]
        return is_bag or bool(parts_of(path))
    except (OSError, ValueError):
        return False


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
        small = sum(file.stat().st_size for file in bag_files(path)) <= LISTED_BYTES
        with opened(path) as bag:
            topics = []
            for topic in bag.topics:
                times = sorted(time for time, _ in bag.raw(topic)) if small else []
                first, last = (times[0], times[-1]) if times else (None, None)
                coded = ("cdr", "ros2msg") if bag.is_ros2 else ("ros1", "ros1msg")
                topics.append(
                    TopicSummary(topic.name, topic.kind, *coded, topic.count, first, last)
                )
            return LogContents("ROS 2 bag" if bag.is_ros2 else "ROS 1 bag", tuple(topics))
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
    ("topics", "frames", "clock", "car", "ego_axes", "driver"),
    cuts=True,
)
