"""What tests of the command line share."""

from pathlib import Path

import pytest
from short_logs import write_free_and_blocked


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`free.mcap` and `blocked.mcap`, once in each process of the tests: to be read only."""
    return write_free_and_blocked(tmp_path_factory.mktemp("logs"))
