"""Results at a store that is in memory: what goes there, and when that of an earlier run goes
away.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import replan
from short_logs import short

from replan.core.errors import ConfigError
from replan.draw.drawn_results import load
from replan.logs.mcap import write_scenario
from replan.results.log_result import LogResult
from replan.results.tables import LOG_CARD
from replan.run.output import output_location

fsspec = pytest.importorskip(
    "fsspec", reason="the extra s3 is not installed: pip install 'replan[s3]'"
)
OUT = "memory://fleet/out"
BEFORE = {
    "run.toml": b"#",
    "metrics.parquet": b"old",
    f"a-1/{LOG_CARD}": b"old",
    "a-1/frames.parquet": b"old",
}


@pytest.fixture
def store() -> Iterator[Any]:
    """A store with the results of an earlier run."""
    system = fsspec.filesystem("memory")
    system.pipe({f"/fleet/out/{name}": content for name, content in BEFORE.items()})
    yield system
    system.store.clear()


def there(store: Any) -> dict[str, bytes]:
    return {key.removeprefix("/fleet/out/"): store.cat(key) for key in store.find("/fleet/out")}


def folder(out: Path, **files: str) -> Path:
    """The folder of a log, with files of these names and contents."""
    (out / "a-1").mkdir(parents=True, exist_ok=True)
    (out / "run.toml").write_text("#", encoding="utf-8")
    for name, text in {"log.json": "new", **files}.items():
        (out / "a-1" / name).write_text(text, encoding="utf-8")
    return out


def test_a_run_that_cannot_begin_removes_nothing(store: Any) -> None:
    with pytest.raises(ConfigError, match="no such log"), output_location(OUT):
        raise ConfigError("no such log")
    assert there(store) == BEFORE


def test_the_results_before_go_as_the_first_log_is_sent(store: Any) -> None:
    with output_location(OUT) as place:
        assert place.folder is not None and there(store).keys() == {*BEFORE, ".lock"}
        folder(place.folder)
        place.keep(LogResult("a", "a", folder="a-1"))
        assert there(store).keys() == {"run.toml", f"a-1/{LOG_CARD}", ".lock"}
    assert there(store) == {"run.toml": b"#", f"a-1/{LOG_CARD}": b"new"}


def test_logs_that_are_driven_again_are_sent_again(store: Any) -> None:
    """`--resume` drives a log again whose folder is not whole: its files have the same names."""
    with output_location(OUT, resume=True) as place:
        assert place.folder is not None
        assert (place.folder / "a-1" / "frames.parquet").read_bytes() == b"old"
        folder(place.folder, **{"frames.parquet": "new"})
        place.keep(LogResult("a", "a", folder="a-1"))
    assert there(store) == {
        "run.toml": b"#",
        f"a-1/{LOG_CARD}": b"new",
        "a-1/frames.parquet": b"new",
    }


def test_logs_in_the_place_of_the_results_are_refused(store: Any, tmp_path: Path) -> None:
    write_scenario(tmp_path / "log.mcap", short("test/a"))
    store.put(str(tmp_path / "log.mcap"), "/fleet/out/a-1/log.mcap")
    words = ["evaluate", f"{OUT}/a-1/log.mcap", "-p", "constant_speed", "--workers", "0", "-o", OUT]
    refused = replan(*words)
    assert refused.exit_code == 2
    assert (
        f"error: {OUT}/a-1/log.mcap: lies in the results {OUT}, which are replaced"
        in refused.stderr
    )
    assert there(store).keys() == {*BEFORE, "a-1/log.mcap"}


def test_messages_about_remote_results_name_their_url(store: Any, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=f"^{OUT}: no results of a finished run"):
        load(OUT)
    write_scenario(tmp_path / "log.mcap", short("test/a"))
    words = [
        "evaluate",
        str(tmp_path / "log.mcap"),
        "-p",
        "constant_speed",
        "--workers",
        "0",
        "--no-recording",
    ]
    done = replan(*words, "--set", "internals=none", "--no-report", "--json", "-o", OUT)
    assert json.loads(done.stdout)["results"] == OUT
