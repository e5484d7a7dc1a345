"""What tests of `replay` share."""

from __future__ import annotations

from pathlib import Path

import pytest
from short_logs import short

from logs.mcap import write_scenario


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three logs; "b" has somebody else in it."""
    folder = tmp_path_factory.mktemp("logs")
    for name in ("c", "a", "b"):
        write_scenario(folder / f"{name}.mcap", short(f"test/{name}", v=8.0 + ord(name) % 7, parked=name == "b"))
    return folder
