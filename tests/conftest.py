"""Settings of all tests, and where the recorded data are."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("replan", deadline=None, derandomize=True)  # kernels compile when first called
settings.register_profile("fast", settings.get_profile("replan"), max_examples=20)


def pytest_configure(config: pytest.Config) -> None:
    """Fewer examples of each law where the slow tests are left out, too."""
    settings.load_profile("fast" if config.option.markexpr == "not slow" else "replan")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recorded logs; tests that need it are skipped without it."""
    folder = Path(os.environ.get("REPLAN_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no recorded data in {folder}: set REPLAN_DATA")
    return folder
