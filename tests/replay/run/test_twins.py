"""A log that is selected twice is driven once, whatever its name and container; logs that differ are all driven."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import ros_bags as bags
from ros_bags import message, seconds, values_of

from logs.mcap import write_scenario
from logs.readers import LogSettings, read_log
from replay.config import RunConfig
from replay.results.tables import finish_folder
from replay.run import evaluate_logs
from replay.run.shards import Shard, merge
from replay.run.sources import select

QUICK = RunConfig(planners=("constant_speed",), mode="open", recording=False)


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag as a folder, as its file, renamed, as SQLite and as ROS 1; another drive with the same times and name."""
    root = tmp_path_factory.mktemp("twice")
    rows = bags.odometry(duration=3.0)
    bags.write_ros2(root / "a" / "drive", rows)
    (root / "b").mkdir()
    for name in ("drive.mcap", "renamed.mcap"):
        shutil.copy(next((root / "a" / "drive").glob("*.mcap")), root / "b" / name)
    bags.write_ros2(root / "c" / "drive", rows, sqlite=True)
    types = bags.store(ros1=True)
    old = [(t, k, n, message(k, types, **values_of(each))) for t, k, n, each in rows]
    bags.write_ros1(root / "d.bag", old, types)
    for _, _, ns, each in rows:
        each.pose.pose.position.y += 0.5 * seconds(ns)
    bags.write_ros2(root / "e" / "drive", rows)
    return root


def test_the_same_drive_in_any_container_is_left_out_by_name(twice: Path) -> None:
    selection = select([twice])
    first = twice / "d.bag"  # files and folders of the top come first
    assert [source.path for source in selection.sources] == [first, twice / "e" / "drive"]
    left = {twice / "a" / "drive", twice / "b" / "drive.mcap", twice / "b" / "renamed.mcap", twice / "c" / "drive"}
    reasons = dict(each.split(": ", 1) for each in selection.dropped)
    assert set(map(Path, reasons)) == left
    assert set(reasons.values()) == {f"the same log as {first}"}
    windows = select([twice / "a"], window=1.0)
    assert len(windows.sources) == 3 and not windows.dropped


@pytest.fixture(scope="module")
def converted(twice: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag and its conversion, of which only the content of the results shows that they are the same; and another."""
    root = tmp_path_factory.mktemp("converted")
    shutil.copytree(twice / "a" / "drive", root / "a" / "drive")
    (root / "b").mkdir()
    write_scenario(root / "b" / "drive.mcap", read_log(twice / "a" / "drive"))
    shutil.copytree(twice / "e" / "drive", root / "c" / "drive")
    return root


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_a_twin_that_is_known_late_costs_no_other_log(converted: Path, workers: int, tmp_path: Path) -> None:
    results = evaluate_logs([converted], QUICK, tmp_path / "out", workers=workers)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [Path(log["source"]) for log in summary["logs"]] == [converted / "a" / "drive", converted / "c" / "drive"]
    assert summary["logs_left_out"] == [
        f"{converted / 'b' / 'drive.mcap'}: the same log as {converted / 'a' / 'drive'}"
    ]
    assert summary["failures"] == [] and len({log["folder"] for log in summary["logs"]}) == 2
    assert len(results.logs) == 2 and results.logs.log.is_unique
    again = evaluate_logs([converted], QUICK, tmp_path / "out", resume=True)
    assert again.resumed == 2 and len(again.logs) == 2


def test_twins_in_two_shards_become_one_log(converted: Path, tmp_path: Path) -> None:
    whole = evaluate_logs([converted], QUICK, tmp_path / "whole")
    for k in (1, 2):
        evaluate_logs([converted], QUICK, tmp_path / f"shard{k}", shard=Shard(k, 2))
    merged = merge([tmp_path / "shard1", tmp_path / "shard2"], tmp_path / "merged")
    assert merged.logs.folder.tolist() == whole.logs.folder.tolist()
    for name in ("metrics.parquet", "verdicts.parquet"):
        assert (tmp_path / "merged" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_the_same_log_with_other_settings_is_another_one(twice: Path) -> None:
    labels = [len(select([twice / "a"], replace(LogSettings(), begin=begin)).sources) for begin in (0.0, 1.0)]
    assert labels == [1, 1]


def test_a_folder_that_is_there_is_kept(tmp_path: Path) -> None:
    for name in ("partial", "there"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "log.json").write_text(name, encoding="utf-8")
    assert not finish_folder(tmp_path / "partial", tmp_path / "there")
    assert (tmp_path / "there" / "log.json").read_text() == "there"
    assert finish_folder(tmp_path / "partial", tmp_path / "new")
