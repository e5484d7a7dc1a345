"""CommonRoad scenarios, XML of 2018b and 2020a: `document` parses the file, `read` makes the Scenario."""

from __future__ import annotations

from pathlib import Path

from logs.readers.base import LogSettings, Reader
from logs.scenario import Scenario


def _claims(path: Path) -> bool:
    if path.suffix.lower() != ".xml" or not path.is_file():
        return False
    try:
        with path.open("rb") as stream:
            return b"<commonRoad" in stream.read(4096)
    except OSError:
        return True  # reading it says why it cannot be read


def _read(path: Path, settings: LogSettings) -> Scenario:
    from logs.readers.commonroad.read import read_commonroad

    return read_commonroad(path, ego=settings.ego or None, problem=settings.problem or None)


READER = Reader(
    "commonroad", "CommonRoad scenarios, 2018b and 2020a", "CommonRoad *.xml", (".xml",), _claims, _read,
    settings=("ego", "problem"),
)  # fmt: skip
