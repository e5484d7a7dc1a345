"""What tests of `replay` share."""

from collections.abc import Callable
from pathlib import Path

import pytest
from short_logs import short

from replan.logs.mcap import write_scenario


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three logs; "b" has somebody else in it."""
    folder = tmp_path_factory.mktemp("logs")
    for name in ("c", "a", "b"):
        write_scenario(folder / f"{name}.mcap", short(f"test/{name}", v=8.0 + ord(name) % 7, parked=name == "b"))
    return folder


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], str]:
    """Writes a user's module, which can be imported here and in workers, into `tmp_path`; its name."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def written(name: str, text: str) -> str:
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        return name

    return written
