"""What tests of the command line share."""

from __future__ import annotations

from pathlib import Path

import pytest
from short_logs import free_and_blocked

from logs.mcap import write_scenario


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`free.mcap` and `blocked.mcap`, once in each process of the tests: to be read only."""
    out = tmp_path_factory.mktemp("logs")
    for log in free_and_blocked():
        write_scenario(out / f"{log.name.removeprefix('test/')}.mcap", log)
    return out
