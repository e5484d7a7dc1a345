"""Logs and results at an S3-compatible server: the bytes of local ones.

What is wrong there is one line.
"""

import json
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from command_line import replan
from process_tree import started
from short_logs import short

from replan.core.urls import listed, local_path, url_of
from replan.draw.drawn_results import load
from replan.logs.mcap import write_scenario
from replan.run.sources import select

# Open sockets
pytestmark = [pytest.mark.slow, pytest.mark.nightly, pytest.mark.filterwarnings("ignore")]
moto: Any = pytest.importorskip(
    "moto.server", reason="moto is not installed: pip install moto[s3] flask flask-cors"
)
pytest.importorskip("s3fs", reason="the extra s3 is not installed: pip install 'replan[s3]'")
QUICK = (
    "-p",
    "constant_speed",
    "--no-recording",
    "--set",
    "internals=none",
    "--workers",
    "0",
    "--no-report",
)


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    running = moto.ThreadedMotoServer(port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    yield f"http://{'127.0.0.1' if host == '0.0.0.0' else host}:{port}"
    running.stop()


@pytest.fixture
def bucket(server: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """A file system of an empty bucket "fleet"; the environment says who we are."""
    import s3fs

    words = {
        "ENDPOINT_URL": server,
        "ACCESS_KEY_ID": "a",
        "SECRET_ACCESS_KEY": "b",
        "DEFAULT_REGION": "us-east-1",
    }
    for word, value in words.items():
        monkeypatch.setenv(f"AWS_{word}", value)
    monkeypatch.chdir(tmp_path)
    s3fs.S3FileSystem.clear_instance_cache()
    system = s3fs.S3FileSystem()
    if system.exists("fleet"):
        system.rm("fleet", recursive=True)
    system.mkdir("fleet")
    return system


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """Two logs as files, one as a folder of tables, and a second copy of the first."""
    folder = tmp_path / "logs"
    (folder / "deep" / "tables").mkdir(parents=True)
    for name in ("a", "b"):
        write_scenario(folder / f"{name}.mcap", short(f"test/{name}", v=8.0 + ord(name) % 7))
    (folder / "copy.mcap").write_bytes((folder / "a.mcap").read_bytes())
    t = [0.1 * k for k in range(31)]
    table = pd.DataFrame({"t": t, "x": [10.0 * s for s in t], "y": 0.0, "yaw": 0.0, "v": 10.0})
    table.to_csv(folder / "deep" / "tables" / "ego.csv", index=False)
    (folder / "deep" / "tables" / "video.hevc").write_bytes(bytes(1000))
    return folder


def files_of(folder: Path) -> dict[str, bytes]:
    """What must be the same: all but clocks, and where the logs were."""
    names = {"timings.parquet", "summary.json", "log.json", "origin.json"}
    return {
        str(path.relative_to(folder)): path.read_bytes().partition(b"\n[selection.logs]")[0]
        for path in folder.rglob("*")
        if path.is_file() and path.name not in names
    }


def test_logs_by_url_give_the_bytes_of_the_same_logs_here(
    bucket: Any, logs: Path, tmp_path: Path
) -> None:
    bucket.put(str(logs), "fleet/logs", recursive=True)
    here = replan("evaluate", str(logs), *QUICK, "-o", "here")
    there = replan("evaluate", "s3://fleet/logs", *QUICK, "-o", "there")
    assert here.exit_code == there.exit_code
    assert files_of(tmp_path / "here") == files_of(tmp_path / "there")
    assert (
        "left out: s3://fleet/logs/copy.mcap: the same log as s3://fleet/logs/a.mcap"
        in there.stderr
    )
    summary = json.loads((tmp_path / "there" / "summary.json").read_text(encoding="utf-8"))
    assert [log["source"] for log in summary["logs"]] == [
        f"s3://fleet/logs/{name}" for name in ("a.mcap", "b.mcap", "deep/tables")
    ]
    tables = select(["s3://fleet/logs"]).sources[2]
    assert [file.name for file in tables.remote] == ["tables/ego.csv"]  # its video is not fetched
    assert select(["s3://fleet/logs/b.mcap"]).sources[0].label == "s3://fleet/logs/b.mcap"


def test_results_at_a_url_are_those_of_a_folder_and_are_resumed(
    bucket: Any, logs: Path, tmp_path: Path
) -> None:
    code = replan("evaluate", str(logs), *QUICK, "-o", "here").exit_code
    assert code == 4  # the tables hold no road users: no evidence of safety
    words = ("evaluate", str(logs), *QUICK, "-o", "s3://fleet/results/one")
    # The second replaces those of the first
    assert replan(*words).exit_code == replan(*words).exit_code == code
    bucket.get("fleet/results/one", str(tmp_path / "there"), recursive=True)
    assert files_of(tmp_path / "here") == files_of(tmp_path / "there")
    whole = {
        key: bucket.info(key)["LastModified"]
        for key in bucket.find("fleet/results/one")
        if key.endswith(".mcap")
    }
    (card,) = bucket.glob("fleet/results/one/test_a-*/log.json")
    bucket.rm(card)
    assert replan(*words, "--resume").exit_code == code
    bucket.invalidate_cache()
    for key, before in whole.items():
        assert (bucket.info(key)["LastModified"] == before) or key.startswith(
            card.rpartition("/")[0]
        )
    bucket.get("fleet/results/one", str(tmp_path / "again"), recursive=True)
    assert files_of(tmp_path / "here") == files_of(tmp_path / "again")
    assert not bucket.exists("fleet/results/one/.lock")


@pytest.mark.parametrize("objects", [1, 4, 9])
def test_a_run_that_is_killed_as_it_sends_is_resumed(
    bucket: Any, logs: Path, tmp_path: Path, objects: int
) -> None:
    """A run is killed after some objects are sent: `--resume` takes over its lock and gives the
    same bytes.
    """
    code = replan("evaluate", str(logs), *QUICK, "-o", "here").exit_code
    words = ("evaluate", str(logs), *QUICK, "-o", "s3://fleet/results/one")
    running, until = started(*words, cwd=tmp_path), time.monotonic() + 120.0
    while (
        len(bucket.find("fleet/results/one", refresh=True)) < objects + 1
        and time.monotonic() < until
    ):  # and its lock
        time.sleep(0.01)
    assert running.poll() is None
    running.kill()
    running.communicate()
    bucket.invalidate_cache()
    assert bucket.exists("fleet/results/one/.lock") and not bucket.exists(
        "fleet/results/one/summary.json"
    )
    assert replan(*words, "--resume").exit_code == code
    bucket.invalidate_cache()
    bucket.get("fleet/results/one", str(tmp_path / "there"), recursive=True)
    assert files_of(tmp_path / "here") == files_of(tmp_path / "there")
    assert not bucket.exists("fleet/results/one/.lock")


def test_results_at_a_url_are_looked_at(bucket: Any, logs: Path, tmp_path: Path) -> None:
    """Each command says of them what it says of the same folder here."""
    words = [
        "evaluate",
        str(logs / "a.mcap"),
        "-p",
        "constant_speed",
        "--mode",
        "closed",
        "--workers",
        "0",
    ]
    assert replan(*words, "-o", "here").exit_code == 4  # no road users: no evidence of safety
    bucket.put("here", "fleet/there", recursive=True)
    bucket.put(str(logs / "a.mcap"), "fleet/log.mcap")
    there = "s3://fleet/there"
    assert load(there).metrics.equals(load("here").metrics)
    for words in (["explain"], ["explain", "--at", "1"]):
        assert (
            replan(words[0], there, *words[1:]).stdout
            == replan(words[0], "here", *words[1:]).stdout
        )
    for words in (
        ["compare", there, "here"],
        ["frame", there, "--at", "1"],
        ["report", there, "-o", "reports"],
    ):
        assert replan(*words).exit_code == 0
    for words in (
        ["plot", there, "-o", "one.png"],
        ["baseline", there, "-o", "one.parquet"],
        ["view", there, "here", "--log", "test/a", "--save", "one.rrd"],
        ["view", "s3://fleet/log.mcap", "--save", "two.rrd"],
    ):
        assert replan(*words).exit_code == 0
        assert Path(words[-1]).stat().st_size > 1000
    assert replan("vary", "s3://fleet/nothing.mcap", "--list-agents").exit_code == 2


def test_shards_at_urls_are_merged(bucket: Any, logs: Path, tmp_path: Path) -> None:
    replan("evaluate", str(logs), *QUICK, "-o", "here")
    for number in (1, 2):
        replan(
            "evaluate",
            str(logs),
            *QUICK,
            "--shard",
            f"{number}/2",
            "-o",
            f"s3://fleet/shard-{number}",
        )
    merged = replan(
        "merge", "s3://fleet/shard-1", "s3://fleet/shard-2", "-o", "s3://fleet/all", "--no-report"
    )
    assert merged.exit_code == 4  # as above
    bucket.get("fleet/all", str(tmp_path / "all"), recursive=True)
    assert files_of(tmp_path / "here") == files_of(tmp_path / "all")


def test_a_url_takes_one_run_at_a_time_and_keeps_foreign_files(bucket: Any, logs: Path) -> None:
    held = json.dumps({"pid": 1, "host": "elsewhere", "since": "noon", "started": ""}).encode()
    bucket.pipe("fleet/out/.lock", held)
    refused = replan("evaluate", str(logs), *QUICK, "-o", "s3://fleet/out")
    assert refused.exit_code == 2
    assert "process 1 on elsewhere since noon" in refused.stderr
    bucket.rm("fleet/out/.lock")
    bucket.pipe("fleet/out/thesis.tex", b"years")
    refused = replan("evaluate", str(logs), *QUICK, "-o", "s3://fleet/out")
    assert refused.exit_code == 2
    assert "contains thesis.tex, not a replan result" in refused.stderr
    assert bucket.find("fleet/out") == ["fleet/out/thesis.tex"]


def test_a_log_that_goes_costs_itself(
    bucket: Any, logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from replan.run import evaluate as run

    bucket.put(str(logs), "fleet/logs", recursive=True)
    found = select(["s3://fleet/logs"])
    bucket.rm("fleet/logs/b.mcap")
    monkeypatch.setattr(run, "select", lambda *_: found)
    result = replan("evaluate", "s3://fleet/logs", *QUICK, "-o", "out")
    assert result.exit_code == 3
    assert "error: s3://fleet/logs/b.mcap: not there; look at bucket and key" in result.stderr
    assert len(list((tmp_path / "out").glob("*/log.json"))) == 2


@pytest.mark.parametrize("words", [("evaluate",), ("inspect",)])
def test_a_missing_url_is_an_error_of_one_line(bucket: Any, words: tuple[str, ...]) -> None:
    for url in ("s3://fleet/nothing", "s3://no-such-bucket/logs", "nowhere://logs"):
        result = replan(*words, url)
        assert result.exit_code == 2
        assert result.stderr.startswith(f"error: {url}")
        assert result.stderr.count("\n") == 1


def test_a_lost_connection_is_one_line(bucket: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{unused.getsockname()[1]}")
    type(bucket).clear_instance_cache()
    result = replan("evaluate", "s3://fleet/logs")
    assert result.exit_code == 2
    assert "no connection or an error there: " in result.stderr


def test_a_part_of_a_log_by_url_gives_the_bytes_of_the_part_here(
    bucket: Any, logs: Path, tmp_path: Path
) -> None:
    bucket.put(str(logs / "a.mcap"), "fleet/a.mcap")
    for place, out in ((str(logs / "a.mcap"), "here"), ("s3://fleet/a.mcap", "there")):
        replan("evaluate", place, "--from", "0.5", "--to", "1.8", *QUICK, "-o", out)
    assert len(files_of(tmp_path / "here")) > 8
    there = files_of(tmp_path / "there")
    assert {
        name: data for name, data in files_of(tmp_path / "here").items() if name != "run.toml"
    } == {name: data for name, data in there.items() if name != "run.toml"}


def test_inspect_reads_a_url(bucket: Any, logs: Path) -> None:
    bucket.put(str(logs / "a.mcap"), "fleet/a.mcap")
    result = replan("inspect", "s3://fleet/a.mcap")
    assert result.exit_code == 0
    assert "test/a" in result.stdout


def test_a_url_is_one_as_a_path_too(tmp_path: Path) -> None:
    assert url_of(Path("s3://bucket/a/b/")) == "s3://bucket/a/b"
    assert (
        url_of("C:/logs")
        == url_of("logs/s3")
        == url_of(tmp_path)
        == url_of(f"file://{tmp_path}")
        == ""
    )
    assert local_path(Path(f"file://{tmp_path}")) == tmp_path
    assert listed("memory://nothing") == ()
