"""Settings of all tests, and where the recorded data are."""

import gc
import os
import signal
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import is_hypothesis_test, settings
from sparse import LATER, SPARSE

# The tests start some hundred processes, each of which imports the packages
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# A background job: its children would ignore Ctrl-C, too
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Kernels compile when first called
settings.register_profile("replan", deadline=None, derandomize=True)
settings.load_profile("replan")
EXAMPLES = {"not slow": (4, 3, 10), "not nightly": (2, 5, 50)}
"""Of the examples that a law asks for: the divisor, the fewest and the most; by what `-m` selects.

At night, all.
"""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what is left to the night (`SPARSE`) and to `.ci/run` (`LATER`), and give each law its
    share of examples.
    """
    seen = Counter[str]()
    for item in items:
        name = item.nodeid.removeprefix("tests/").partition("[")[0]
        for table, mark in ((SPARSE, pytest.mark.nightly), (LATER, pytest.mark.slow)):
            k = table[name].k if name in table else 1
            if not k or seen[name] % k:
                item.add_marker(mark)
        seen[name] += 1
        if item.get_closest_marker("nightly"):
            item.add_marker(pytest.mark.slow)
    if config.option.markexpr not in EXAMPLES:
        return
    divisor, fewest, most = EXAMPLES[config.option.markexpr]
    for law in {
        item.obj
        for item in items
        if isinstance(item, pytest.Function) and is_hypothesis_test(item.obj)
    }:
        asked = law._hypothesis_internal_use_settings
        few = min(max(asked.max_examples // divisor, fewest), most, asked.max_examples)
        law._hypothesis_internal_use_settings = settings(asked, max_examples=few)


def pytest_collection_finish() -> None:
    """What is imported and collected by now lives to the end: no collection of garbage looks
    through it again.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of recorded logs; tests that need it are skipped without it."""
    folder = Path(os.environ.get("REPLAN_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no recorded data in {folder}: set REPLAN_DATA")
    return folder


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three logs; "b" has somebody else in it."""
    from short_logs import short

    from replan.logs.mcap import write_scenario

    folder = tmp_path_factory.mktemp("logs")
    for name in ("c", "a", "b"):
        write_scenario(
            folder / f"{name}.mcap",
            short(f"test/{name}", v=8.0 + ord(name) % 7, parked=name == "b"),
        )
    return folder


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], str]:
    """Writes a user's module, which can be imported here and in workers, into `tmp_path`.

    Its name.
    """
    monkeypatch.syspath_prepend(str(tmp_path))

    def written(name: str, text: str) -> str:
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        return name

    return written
