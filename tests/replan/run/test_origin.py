"""Results know where their logs are: read from any directory, moved with or without them.

Another log is refused.
"""

import shutil
from pathlib import Path

import pytest
from command_line import evaluate, one_error, replan
from short_logs import short

from replan.core.errors import ConfigError
from replan.draw.drawn_results import load
from replan.logs.mcap import write_scenario
from replan.logs.readers import LogSettings
from replan.run.log_source import log_hash
from replan.run.output import log_of, write_origin

SOURCE = Path("my_logs", "a.mcap")


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Results of a run that was started in `work`, which we have left."""
    (tmp_path / "work" / SOURCE).parent.mkdir(parents=True)
    write_scenario(tmp_path / "work" / SOURCE, short("test/a"))
    out = tmp_path / "results" / "run"
    out.mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    write_origin(out)
    monkeypatch.chdir(tmp_path / "elsewhere")
    return out


def found(out: Path, digest: str) -> str:
    return log_of(out, str(SOURCE), digest, LogSettings()).name


def test_the_log_is_found_from_any_directory_and_where_both_or_one_was_moved(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    digest = log_hash(tmp_path / "work" / SOURCE)
    assert found(run, digest) == "test/a"
    shutil.move(run, tmp_path / "far" / "away")  # without its log
    assert found(tmp_path / "far" / "away", digest) == "test/a"
    shutil.move(tmp_path / "far" / "away", run)
    new = tmp_path / "new"
    new.mkdir()
    for name in ("work", "results"):  # together
        shutil.move(tmp_path / name, new / name)
    assert found(new / "results" / "run", digest) == "test/a"
    # Where we are
    shutil.move(new / "work" / SOURCE.parent, tmp_path / "elsewhere" / SOURCE.parent)
    assert found(new / "results" / "run", digest) == "test/a"
    monkeypatch.chdir(new)
    with pytest.raises(ConfigError, match="is not at") as error:
        found(new / "results" / "run", digest)
    assert all(
        str(place / SOURCE) in str(error.value) for place in (new / "work", tmp_path / "work", new)
    )


def test_a_log_with_other_bytes_is_refused_and_passed_over_for_the_right_one(
    run: Path, tmp_path: Path
) -> None:
    digest = log_hash(tmp_path / "work" / SOURCE)
    shutil.move(tmp_path / "work" / SOURCE.parent, tmp_path / "elsewhere" / SOURCE.parent)
    (tmp_path / "work" / SOURCE).parent.mkdir()
    write_scenario(tmp_path / "work" / SOURCE, short("test/other"))
    assert found(run, digest) == "test/a"
    (tmp_path / "elsewhere" / SOURCE).unlink()
    with pytest.raises(ConfigError, match="its bytes differ"):
        found(run, digest)


def test_frames_and_resumed_runs_work_from_another_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "work" / SOURCE).parent.mkdir(parents=True)
    write_scenario(tmp_path / "work" / SOURCE, short("test/a"))
    monkeypatch.chdir(tmp_path / "work")
    evaluate(SOURCE, "--mode", "closed", "-o", "out")
    monkeypatch.chdir(tmp_path)
    assert "to the bit" in replan("frame", "work/out", "--at", "0.5").stdout
    resumed = evaluate(Path("work") / SOURCE, "--mode", "closed", "-o", "work/out", "--resume")
    assert resumed.exit_code != 2, resumed.stderr
    assert "to the bit" in replan("frame", "work/out", "--at", "0.5").stdout
    (tmp_path / "work" / SOURCE).unlink()
    assert "is not at" in one_error(replan("frame", "work/out", "--at", "0.5"))


def test_the_logs_of_merged_shards_are_where_those_were_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "work" / SOURCE).parent.mkdir(parents=True)
    write_scenario(tmp_path / "work" / SOURCE, short("test/a"))
    monkeypatch.chdir(tmp_path / "work")
    evaluate(SOURCE, "--mode", "open", "--shard", "1/1", "-o", "shard")
    monkeypatch.chdir(tmp_path)
    replan("merge", "work/shard", "-o", "merged")
    (row,) = load(tmp_path / "merged").logs.itertuples()
    assert log_of(tmp_path / "merged", row.source, row.sha256, LogSettings()).name == "test/a"
