"""Formats that are not read: named in one sentence, with the remedy."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from rich_scenario import rich_scenario

from replan.core.errors import ConfigError, LogError
from replan.logs.mcap import write_scenario
from replan.logs.readers import LogSettings, foreign, read_log
from replan.run.sources import select

POINTER = f"version https://git-lfs.github.com/spec/v1\noid sha256:{'0' * 64}\nsize 3434\n"


def database(path: Path, table: str) -> None:
    with closing(sqlite3.connect(path)) as file:
        file.execute(f"CREATE TABLE {table} (token blob)")
        file.commit()


def made(folder: Path, name: str) -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if name.endswith(".db"):
        database(path, "ego_pose")
    else:
        path.write_text("[]")
    return path


@pytest.mark.parametrize(
    ("file", "up", "what", "remedy"),
    [
        ("2021.05.12_log.db", 0, "nuPlan", "py123d"),
        ("mini/2021.05.12_log.db", 1, "nuPlan", "py123d"),
        ("nuscenes/v1.0-mini/sample.json", 0, "nuScenes", "py123d"),
        ("nuscenes/v1.0-mini/sample.json", 1, "nuScenes", "py123d"),
        ("nuscenes/v1.0-mini/sample.json", 2, "nuScenes", "py123d"),
        ("training.tfrecord-00000-of-01000", 0, "Waymo", "py123d"),
        ("waymo/segment-1_with_camera_labels.tfrecord", 1, "Waymo", "py123d"),
        ("20190918.record.00000", 0, "Apollo", "cyber_record"),
        ("demo.record", 0, "Apollo", "cyber_record"),
        ("route/rlog.zst", 0, "openpilot", "logreader"),
        ("a2a0ccea32023010--2023-07-27--13-01-19--0--qlog.bz2", 0, "openpilot", "logreader"),
        ("ego.csv", 0, "table", "in a folder"),
    ],
)
def test_known_formats_have_a_remedy(
    tmp_path: Path, file: str, up: int, what: str, remedy: str
) -> None:
    path = made(tmp_path, file)
    path = (path, *path.parents)[up]
    error = foreign(path)
    assert what in str(error) and remedy in (error.remedy or "") and "\n" not in str(error)
    with pytest.raises((ConfigError, LogError), match=what):
        select([path], LogSettings())


@pytest.mark.parametrize(
    "name", ["drive.mcap", "drive.bag", "log/ego.csv", "scene.xml", "notes.txt"]
)
def test_a_pointer_of_git_lfs_is_named_whatever_it_stands_for(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(POINTER)
    with pytest.raises(LogError, match="Git LFS pointer") as error:
        read_log(path.parent if name.startswith("log/") else path)
    assert "git lfs pull" in (error.value.remedy or "")


def test_other_databases_and_tables_are_not_called_nuplan(tmp_path: Path) -> None:
    database(tmp_path / "mine.db", "customers")
    (tmp_path / "text.db").write_text("not a database")
    for name in ("mine.db", "text.db"):
        assert "nuPlan" not in str(foreign(tmp_path / name))


@pytest.mark.parametrize("name", ["drive.bag", "drive", "drive.mcap.bak"])
def test_a_log_of_replan_that_was_renamed_says_so(name: str, tmp_path: Path) -> None:
    write_scenario(tmp_path / "drive.mcap", rich_scenario(4))
    path = (tmp_path / "drive.mcap").rename(tmp_path / name)
    with pytest.raises(ConfigError, match=r"does not end in \.mcap.*rename it to NAME\.mcap"):
        select([path])
