"""A run in shards, merged, is the run without shards, byte for byte.

A log that is selected twice is driven once.
"""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
import ros_bags as bags
from command_line import gates, one_error, replan
from hypothesis import given, strategies as st
from ros_bags import message, seconds, values_of
from short_logs import QUICK, short

from replan.config import RunConfig
from replan.core.errors import ConfigError
from replan.draw.drawn_results import Results
from replan.logs.mcap import write_scenario
from replan.logs.readers import LogSettings, read_log
from replan.results.tables import REPORTS, TABLES, finish_folder
from replan.run import evaluate_logs
from replan.run.shards import Shard, merge
from replan.run.sources import select

CLOCK = {"timings.parquet", "report.md", "report.html", "origin.json"}
"""Not the same twice."""


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five logs: two share a name, one cannot be read, one begins in a collision."""
    folder = tmp_path_factory.mktemp("logs")
    for file, log in {
        "a": short("test/a"),
        "b": short("test/b", parked=True),
        "c": short("test/a", v=9.0),
        "e": short("test/e", v=8.0),
    }.items():
        write_scenario(folder / f"{file}.mcap", log)
    (folder / "d.mcap").write_bytes((folder / "a.mcap").read_bytes()[:-80])
    return folder


@pytest.fixture(scope="module")
def whole(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Results:
    return evaluate_logs([logs], QUICK, tmp_path_factory.mktemp("whole") / "out")


def shards(logs: Path, out: Path, of: int, run: RunConfig = QUICK) -> list[Path]:
    """The folders of all shards."""
    numbers = range(1, of + 1)
    return [
        evaluate_logs([logs], run, out / f"{number}", shard=Shard(number, of)).path
        for number in numbers
    ]


@pytest.fixture(scope="module")
def two(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return shards(logs, tmp_path_factory.mktemp("two"), 2)


def files(out: Path) -> dict[str, bytes]:
    """Every file of a result folder that holds no clock, by its place."""
    found = (file for file in sorted(out.rglob("*")) if file.is_file() and file.name not in CLOCK)
    return {str(file.relative_to(out)): file.read_bytes() for file in found}


@given(st.integers(1, 12), st.integers(0, 50))
def test_each_log_is_in_one_shard_and_shards_differ_by_one_log_at_most(of: int, count: int) -> None:
    places = [Shard(number, of).places(count) for number in range(1, of + 1)]
    assert sorted(place for part in places for place in part) == list(range(count))
    assert max(map(len, places)) - min(map(len, places)) <= 1


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "a/b", "1/0", "-1/2", "1/2/3"])
def test_a_folder_that_is_no_shard_is_an_error(text: str) -> None:
    with pytest.raises(ConfigError, match="2/5"):
        Shard.parsed(text)


@pytest.mark.parametrize("of", [2, *(pytest.param(of, marks=pytest.mark.slow) for of in (1, 3, 7))])
def test_merged_shards_are_the_run_byte_for_byte(
    logs: Path, tmp_path: Path, whole: Results, of: int
) -> None:
    """Seven shards of five logs: two of them have none."""
    merged = merge(shards(logs, tmp_path, of)[::-1], tmp_path / "merged")
    expected = files(whole.path)
    assert {*TABLES} - CLOCK - {*REPORTS} - {"shard.json"} <= expected.keys()
    assert files(merged.path) == expected
    assert merged.exit_code == whole.exit_code == 3


def test_a_shard_measures_and_does_not_judge(two: Sequence[Path]) -> None:
    first, second = (
        json.loads((folder / "summary.json").read_text(encoding="utf-8")) for folder in two
    )
    assert (first["exit_code"], first["outcome"], first["gates"], first["shard"]) == (
        0,
        "not judged",
        [],
        "1/2",
    )
    assert (second["exit_code"], second["shard"]) == (3, "2/2")  # its log d cannot be read
    assert [log["source"][-6:] for log in first["logs"]] == ["a.mcap", "c.mcap", "e.mcap"]


@pytest.mark.slow
def test_gates_and_ensembles_are_those_of_the_whole_run(logs: Path, tmp_path: Path) -> None:
    rules = tmp_path / "gates.toml"
    rules.write_text('[[gate]]\nmetric = "speed.mean"\nmin = 8.5\n', encoding="utf-8")
    run = replace(QUICK, mode="closed", ensemble=1, gates=str(rules))
    alone = evaluate_logs([logs], run, tmp_path / "alone")
    parts = shards(logs, tmp_path / "parts", 2, run)
    rules.unlink()  # they hold the gates themselves
    assert files(merge(parts, tmp_path / "merged").path) == files(alone.path)


def test_merging_twice_and_after_resuming_gives_the_same(
    logs: Path, tmp_path: Path, two: Sequence[Path]
) -> None:
    begun = tmp_path / "begun"
    shutil.copytree(two[0], begun)
    (begun / "shard.json").unlink()
    with pytest.raises(ConfigError, match="no whole shard"):
        merge([begun, two[1]], tmp_path / "merged")
    evaluate_logs([logs], QUICK, begun, resume=True, shard=Shard(1, 2))
    once = files(merge([begun, two[1]], tmp_path / "merged").path)
    assert files(merge(two, tmp_path / "merged").path) == once


@pytest.mark.parametrize(
    ("which", "said"),
    [
        ((0,), "shards are missing: 2/2"),
        ((0, 0, 1), "are both shard 1/2"),
        ((1,), "shards are missing: 1/2"),
    ],
)
def test_not_one_of_each_shard_is_refused(
    two: Sequence[Path], tmp_path: Path, which: tuple[int, ...], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        merge([two[index] for index in which], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_shards_of_other_runs_are_refused(logs: Path, two: Sequence[Path], tmp_path: Path) -> None:
    def second(name: str, source: Path = logs, run: RunConfig = QUICK, of: int = 2) -> Path:
        return evaluate_logs([source], run, tmp_path / name, shard=Shard(2, of)).path

    fewer = tmp_path / "fewer"
    fewer.mkdir()
    for file in ("a", "b", "c"):
        shutil.copy(logs / f"{file}.mcap", fewer)
    rules = tmp_path / "gates.toml"
    rules.write_text('[[gate]]\nmetric = "gap.min"\nmin = 0.5\n', encoding="utf-8")
    coded = shutil.copytree(two[1], tmp_path / "coded")
    card = json.loads((coded / "shard.json").read_text(encoding="utf-8"))
    (coded / "shard.json").write_text(json.dumps({**card, "code": "other"}), encoding="utf-8")
    cases = {
        second("of", of=3): "shard 1/2 and shard 2/3",
        second("logs", fewer): "5 and 3 logs; they differ in [de].mcap",
        second("config", run=replace(QUICK, mode="open")): "mode was 'both', is 'open'",
        second("gates", run=replace(QUICK, gates=str(rules))): "gates was 'default'",
        coded: "driven with replan",
    }
    for folder, said in cases.items():
        with pytest.raises(ConfigError, match=said):
            merge([two[0], folder], tmp_path / "merged")


def test_a_damaged_or_foreign_folder_is_refused(
    two: Sequence[Path], whole: Results, tmp_path: Path
) -> None:
    damaged = shutil.copytree(two[0], tmp_path / "damaged")
    next(damaged.rglob("closed.mcap")).unlink()
    for folder, said in (
        (damaged, "not there or not whole"),
        (whole.path, "no whole shard"),
        (two[0], "lies there"),
    ):
        with pytest.raises(ConfigError, match=said):
            merge([folder, two[1]], two[1] if folder == two[0] else tmp_path / "merged")


@pytest.mark.slow
def test_the_command_line_drives_shards_and_judges_when_merged(logs: Path, tmp_path: Path) -> None:
    one = logs / "b.mcap"
    rules = gates(tmp_path / "gates.toml", 'metric = "speed.mean"\nmin = 50')
    words = ("--planner", "constant_speed", "--gates", rules, "--no-recording", "--workers", 0)
    for number in (1, 2):
        result = replan(
            "evaluate",
            logs / "a.mcap",
            one,
            *words,
            "--shard",
            f"{number}/2",
            "-o",
            tmp_path / f"{number}",
        )
        assert result.exit_code == 0, result.output
        assert f"shard {number}/2" in result.stdout
        assert "NOT JUDGED" in result.stdout
    result = replan("merge", tmp_path / "1", tmp_path / "2", "-o", tmp_path / "merged")
    assert result.exit_code == 1
    assert "FAIL" in result.stdout
    replan("evaluate", logs / "a.mcap", one, *words, "-o", tmp_path / "whole")
    assert files(tmp_path / "merged") == files(tmp_path / "whole")
    again = ("merge", tmp_path / "1", tmp_path / "2", "--baseline", tmp_path / "whole", "-q", "-o")
    compared = replan(*again, tmp_path / "merged")
    assert (compared.exit_code, len(compared.stdout.splitlines())) == (1, 4)
    assert one_error(replan(*again, tmp_path))
    assert "junit.xml" in files(tmp_path / "merged")
    lacking = replan("merge", tmp_path / "1", "-o", tmp_path / "other")
    assert lacking.exit_code == 2
    assert "2/2" in one_error(lacking)
    assert "2/5" in one_error(replan("evaluate", one, *words, "--shard", "5"))


OPEN = replace(QUICK, mode="open")


@pytest.fixture(scope="module")
def twice(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag as a folder, as its file, renamed, as SQLite and as ROS 1.

    Another drive with the same times and name.
    """
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
    left = {
        twice / "a" / "drive",
        twice / "b" / "drive.mcap",
        twice / "b" / "renamed.mcap",
        twice / "c" / "drive",
    }
    reasons = dict(each.split(": ", 1) for each in selection.dropped)
    assert set(map(Path, reasons)) == left
    assert set(reasons.values()) == {f"the same log as {first}"}
    windows = select([twice / "a"], window=1.0)
    assert len(windows.sources) == 3 and not windows.dropped


@pytest.fixture(scope="module")
def converted(twice: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag and its conversion, of which only the content of the results shows that they are the
    same; and another.
    """
    root = tmp_path_factory.mktemp("converted")
    shutil.copytree(twice / "a" / "drive", root / "a" / "drive")
    (root / "b").mkdir()
    write_scenario(root / "b" / "drive.mcap", read_log(twice / "a" / "drive"))
    shutil.copytree(twice / "e" / "drive", root / "c" / "drive")
    return root


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_a_twin_that_is_known_late_costs_no_other_log(
    converted: Path, workers: int, tmp_path: Path
) -> None:
    results = evaluate_logs([converted], OPEN, tmp_path / "out", workers=workers)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [Path(log["source"]) for log in summary["logs"]] == [
        converted / "a" / "drive",
        converted / "c" / "drive",
    ]
    assert summary["logs_left_out"] == [
        f"{converted / 'b' / 'drive.mcap'}: the same log as {converted / 'a' / 'drive'}"
    ]
    assert summary["failures"] == [] and len({log["folder"] for log in summary["logs"]}) == 2
    assert len(results.logs) == 2 and results.logs.log.is_unique
    again = evaluate_logs([converted], OPEN, tmp_path / "out", resume=True)
    assert again.resumed == 2 and len(again.logs) == 2


def test_twins_in_two_shards_become_one_log(converted: Path, tmp_path: Path) -> None:
    whole = evaluate_logs([converted], OPEN, tmp_path / "whole")
    for k in (1, 2):
        evaluate_logs([converted], OPEN, tmp_path / f"shard{k}", shard=Shard(k, 2))
    merged = merge([tmp_path / "shard1", tmp_path / "shard2"], tmp_path / "merged")
    assert merged.logs.folder.tolist() == whole.logs.folder.tolist()
    for name in ("metrics.parquet", "verdicts.parquet"):
        assert (tmp_path / "merged" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_the_same_log_with_other_settings_is_another_one(twice: Path) -> None:
    labels = [
        len(select([twice / "a"], replace(LogSettings(), begin=begin)).sources)
        for begin in (0.0, 1.0)
    ]
    assert labels == [1, 1]


def test_a_folder_that_is_there_is_kept(tmp_path: Path) -> None:
    for name in ("partial", "there"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "log.json").write_text(name, encoding="utf-8")
    assert not finish_folder(tmp_path / "partial", tmp_path / "there")
    assert (tmp_path / "there" / "log.json").read_text() == "there"
    assert finish_folder(tmp_path / "partial", tmp_path / "new")
