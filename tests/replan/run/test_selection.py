"""run.toml names the logs of its run: `--config` of it drives them, or names what is wrong."""

import shutil
import tomllib
from pathlib import Path

import pytest
from command_line import one_error, replan as command
from short_logs import free_and_blocked, write_free_and_blocked

import replan
from replan.config import LogSelection, RunConfig, load_run
from replan.core.errors import ConfigError
from replan.run.evaluate import selected

QUICK = {"planners": "constant_speed", "mode": "open", "recording": False, "report": False}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the logs `logs/` and a run over them, `out/run`."""
    folder = tmp_path_factory.mktemp("place")
    (folder / "logs").mkdir()
    write_free_and_blocked(folder / "logs")
    replan.evaluate(folder / "logs", out=folder / "out" / "run", **QUICK)
    return folder


def test_the_logs_of_a_run_are_driven_again_from_another_folder(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before, the built-in suite was driven."""
    text = (place / "out" / "run" / "run.toml").read_text(encoding="utf-8")
    stated = tomllib.loads(text)["selection"]
    run = replan.load(place / "out" / "run")
    assert list(stated["logs"]) == ["../../logs/blocked.mcap", "../../logs/free.mcap"]
    assert list(stated["logs"].values()) == list(run.logs["sha256"])
    monkeypatch.chdir(tmp_path)
    words = ["--config", place / "out" / "run" / "run.toml", "--no-report", "--workers", "0"]
    result = command("evaluate", *words, "--out", "again")
    assert result.exit_code == run.exit_code
    for name in ("metrics.parquet", "verdicts.parquet"):
        assert Path("again", name).read_bytes() == (place / "out" / "run" / name).read_bytes()
    # a run over other logs names those
    made = replan.evaluate(free_and_blocked()[0], config=words[1], out="other", report=False)
    assert list(made.run.selection.logs) == ["memory:test/free"]
    with pytest.raises(ConfigError, match="in memory was test/free; put them back, or name"):
        selected((), made.run, None, None)


def test_logs_that_are_not_there_or_have_other_content_are_named(
    place: Path, tmp_path: Path
) -> None:
    shutil.copytree(place, tmp_path / "moved")
    config, logs = tmp_path / "moved" / "out" / "run" / "run.toml", tmp_path / "moved" / "logs"
    assert len(selected((), load_run(config), None, None).sources) == 2
    (logs / "free.mcap").write_bytes((logs / "free.mcap").read_bytes() + b"\n")
    result = command("evaluate", "--config", config, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert f"1 of the 2 logs that the configuration names have other content now: {logs}" in (
        one_error(result)
    )
    (logs / "free.mcap").unlink()
    result = command("evaluate", "--config", config, "--out", tmp_path / "out")
    assert result.exit_code == 2 and not (tmp_path / "out").exists()
    assert f"are not there: {logs / 'free.mcap'}; put them back" in one_error(result)
    (logs / "free.mcap").write_bytes((logs / "blocked.mcap").read_bytes())
    with pytest.raises(ConfigError, match=r"other content now: .*free\.mcap"):  # a twin now
        selected((), load_run(config), None, None)


def test_suites_and_windows_are_kept(place: Path) -> None:
    suite = selected((), RunConfig(), None, "paper/free_road")
    assert suite.chosen == LogSelection(suite="paper/free_road")
    again = selected((), RunConfig(selection=suite.chosen), None, None)
    assert again == suite
    windows = selected([place / "logs"], RunConfig(), 1.0, None, 0.5)
    assert windows.chosen.window_s == 1.0 and len(windows.chosen.logs) == 2
    again = selected((), RunConfig(selection=windows.chosen), None, None)
    assert again == windows and len(again.sources) > 4
    assert selected((), RunConfig(), None, None).chosen == LogSelection()
    other = selected([place / "logs" / "free.mcap"], RunConfig(selection=suite.chosen), None, None)
    assert len(other.sources) == 1
