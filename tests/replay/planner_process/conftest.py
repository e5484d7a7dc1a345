"""Where tests of planners' processes write their planners."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The working directory, where modules are written: one for all of a file, as each has a
    launcher of its own.
    """
    before, here = Path.cwd(), tmp_path_factory.mktemp("planners")
    os.chdir(here)
    yield here
    os.chdir(before)
