"""replan's own MCAP, and ASAM OSI ground truth in MCAP; any other .mcap is told here what it lacks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from logs.readers.base import Contents, LogSettings, Reader, TopicSummary
from logs.scenario import Scenario

if TYPE_CHECKING:
    from logs.mcap.container import Container, Stream


def _claims(path: Path) -> bool:
    return path.suffix.lower() == ".mcap" and path.is_file()


def _read(path: Path, settings: LogSettings) -> Scenario:
    from logs.mcap.reader import read_scenario

    return read_scenario(path, settings.ego)


def _contents(path: Path) -> Contents:
    """The topics up to the file's end or damage."""
    from logs.mcap.container import read_container

    container = read_container(path)
    return Contents(_profile(container), tuple(_topic(stream) for stream in container.streams.values()))


def _profile(container: Container) -> str:
    from logs.mcap import native, osi

    if native.SCENARIO_RECORD in container.metadata:
        version = container.metadata[native.SCENARIO_RECORD].get("format_version", "?")
        what = "trace of a drive" if native.TRACE_RECORD in container.metadata else "scenario log"
        return f"{what}, native format {version}"
    stream = container.of_schema(*osi.SCHEMAS)
    if stream is not None:
        return f"ASAM OSI log, {stream.schema}"
    return "not a log that replan reads" if container.streams else "no log"


def _topic(stream: Stream) -> TopicSummary:
    first, last = (stream.times[0], stream.times[-1]) if len(stream) else (None, None)
    return TopicSummary(stream.topic, stream.schema, stream.encoding, stream.schema_encoding, len(stream), first, last)


READER = Reader(
    "native", "replan's own MCAP, traces included; ASAM OSI ground truth in MCAP", "*.mcap", (".mcap",), _claims, _read,
    contents=_contents, settings=("ego",),
)  # fmt: skip
