"""ROS 2 bags (rosbag2: MCAP and SQLite, one file or a folder with metadata.yaml) and ROS 1 bags, without ROS.

Modules:
    bag.py       rosbags: topics, and fields of their messages between two times
    fields.py    some fields of a serialised message, without objects for the others
    schemas.py   which message types hold what, and where
    frames.py    the tree of coordinate frames; log times and stamps
    ego.py       the ego's poses and speed; motion from jittering positions
    objects.py   the objects of a topic: frames, velocities, sizes
    tracks.py    samples of objects over time: identities and tracks
    read.py      all of it as a scenario, with lights, goal, steering and on-board plans
"""

from __future__ import annotations

from pathlib import Path

from logs.readers.base import Contents, LogSettings, Reader, TopicSummary
from logs.scenario import Scenario

MAGIC = {".bag": b"#ROSBAG V", ".db3": b"SQLite format 3\0", ".mcap": b"\x89MCAP0\r\n"}
METADATA = "metadata.yaml"
BAG = b"rosbag2_bagfile_information"
LISTED_BYTES = 1 << 28
"""Of larger bags `contents` gives no times: they are not in the index."""


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
        return begin.startswith(magic) and begin[8:9] == b"\x01" and begin[17:25] == b"\x04\0\0\0ros2"
    return begin.startswith(magic)


def _read(path: Path, settings: LogSettings) -> Scenario:
    from logs.readers.ros.read import read_bag

    return read_bag(path, settings)


def _files(path: Path) -> tuple[Path, ...]:
    """The files of a bag: a folder's metadata and what it names, as far as it is there."""
    if path.is_file():
        return (path,)
    kinds = (".mcap", ".db3", ".zstd")
    return (path / METADATA, *sorted(each for each in path.iterdir() if each.suffix in kinds))


def _span(path: Path) -> tuple[float, float] | None:
    from logs.errors import LogError
    from logs.readers.ros.bag import opened

    try:
        with opened(path) as bag:
            return 0.0, max(0.0, (bag.end_ns - bag.start_ns) / 1e9)
    except LogError:
        return None


def _contents(path: Path) -> Contents:
    """The topics with their counts; first and last times where the bag is small enough to look through."""
    from logs.errors import LogError
    from logs.readers.ros.bag import opened

    try:
        small = sum(each.stat().st_size for each in _files(path)) <= LISTED_BYTES
        with opened(path) as bag:
            found = []
            for topic in bag.topics:
                times = sorted(time for time, _ in bag.raw(topic)) if small else []
                first, last = (times[0], times[-1]) if times else (None, None)
                coded = "cdr" if bag.is_ros2 else "ros1"
                found.append(
                    TopicSummary(
                        topic.name, topic.kind, coded, "ros2msg" if bag.is_ros2 else "ros1msg", topic.count, first, last
                    )
                )
            return Contents("ROS 2 bag" if bag.is_ros2 else "ROS 1 bag", tuple(found))
    except (LogError, OSError):
        return Contents("ROS bag, damaged")


READER = Reader(
    "ros", "ROS 2 bags (rosbag2 as MCAP or SQLite) and ROS 1 bags", "rosbag2 folder, .bag",
    (".bag", ".db3"), _claims, _read, _files, _span, _contents, ("topics", "frames", "clock", "car"), cuts=True,
)  # fmt: skip
