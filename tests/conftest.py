"""Settings of all tests, and where the recorded data are."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import is_hypothesis_test, settings

sys.dont_write_bytecode = False  # the tests start some hundred processes, each of which imports the packages
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a background job: its children would ignore Ctrl-C, too
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("replan", deadline=None, derandomize=True)  # kernels compile when first called
settings.load_profile("replan")
FEWEST, MOST = 3, 10
"""Examples of a law where the slow tests are left out."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """A quarter of the examples that each law asks for where the slow tests are left out, too."""
    if config.option.markexpr != "not slow":
        return
    for law in {item.obj for item in items if isinstance(item, pytest.Function) and is_hypothesis_test(item.obj)}:
        asked = law._hypothesis_internal_use_settings
        few = min(max(asked.max_examples // 4, FEWEST), MOST, asked.max_examples)
        law._hypothesis_internal_use_settings = settings(asked, max_examples=few)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recorded logs; tests that need it are skipped without it."""
    folder = Path(os.environ.get("REPLAN_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no recorded data in {folder}: set REPLAN_DATA")
    return folder
