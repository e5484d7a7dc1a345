"""What commands write is claimed first: all commands (rows) by what may go wrong (tests).

A row has the words of a command, the end of the name of its file ("": a folder), and whether it has --resume.
"""

from __future__ import annotations

import errno
import os
import shlex
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from command_line import one_error, replan
from full_disk import room
from short_logs import short, write_free_and_blocked

from logs.errors import OutputError
from logs.mcap import read_scenario, write_scenario
from replay.cli import app
from replay.mine.driven_log import Event, EventKind
from replay.results.tables import LOCK, write_text
from replay.run.output import held, locked

pytest.importorskip("duckdb")
pytest.importorskip("optuna")


@dataclass(frozen=True)
class Row:
    words: str
    ending: str = ""
    resumes: bool = False

    def given(self, place: Path, out: object) -> list[str]:
        return [word.format(place=place) if "{" in word else word for word in shlex.split(self.words)] + [
            "-o",
            str(out),
        ]


ROWS = {
    "evaluate": Row("evaluate {place}/free.mcap -p constant_speed --workers 0 --no-recording", resumes=True),
    "merge": Row("merge {place}/shard"),
    "mine": Row("mine {place}/free.mcap {place}/blocked.mcap --workers 0", resumes=True),
    "cut": Row("cut {place}/mined --where true --before 0.5 --after 0.5", resumes=True),
    "vary": Row(
        "vary {place}/free.mcap -p constant_speed --workers 0 --vary ego_speed=0.9:1.1:2 --resolution 9", resumes=True
    ),
    "falsify": Row(
        "falsify {place}/blocked.mcap -p idm --workers 0 --axis ego_speed=0.9:1.1 --budget 16", resumes=True
    ),
    "tune": Row("tune {place}/logs -p idm --space {place}/space.toml --trials 1 --workers 0", resumes=True),
    "diagnose": Row("diagnose {place}/run --workers 0", resumes=True),
    "report": Row("report {place}/run"),
    "query": Row("query {place}/mined 'SELECT * FROM range(500)'", ".csv"),
    "suite": Row("suite {place}/mined", ".toml"),
    "coverage": Row("coverage {place}/mined --against {place}/mined --workers 0"),
    "score": Row("score {place}/run --as nuplan-cls", ".csv"),
    "baseline": Row("baseline {place}/run", ".parquet"),
    "repair": Row("repair {place}/free.mcap", ".mcap"),
    "convert": Row("convert {place}/free.mcap", ".mcap"),
    "synth": Row("synth paper/free_road"),
    "export": Row("export commonroad-solution {place}/run"),
    "plot": Row("plot {place}/run", ".svg"),
    "paper": Row("paper"),
    "calibrate": Row("calibrate"),
}
CLAIMED = (
    "evaluate", "merge", "mine", "cut", "vary", "falsify", "tune", "diagnose", "report", "query", "suite", "baseline",
    "repair", "score", "coverage",
)  # fmt: skip
"""The commands that lock; the others write each file whole, and of two at once the last counts."""
URLS = ("evaluate", "merge")
FILES = tuple(name for name in CLAIMED if ROWS[name].ending)
SLOW = [pytest.param("diagnose", marks=pytest.mark.slow), pytest.param("falsify", marks=pytest.mark.slow)]
RUN = [*(name for name in CLAIMED if name not in ("diagnose", "falsify", "tune")), *SLOW]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs, a run of both, a shard of it, and both mined."""
    place = tmp_path_factory.mktemp("claim")
    for folder in (place, place / "logs"):
        write_free_and_blocked(folder)
    (place / "space.toml").write_text("[planner.idm]\ntime_gap_s = { low = 1.0, high = 2.0 }\n", encoding="utf-8")
    quick = ("-p", "constant_speed", "--workers", 0, "--no-recording")
    replan("evaluate", place / "logs", *quick, "-o", place / "run")
    replan("evaluate", place / "logs", *quick, "--shard", "1/1", "-o", place / "shard")
    replan("mine", place / "logs", "--workers", 0, "--kind", ALWAYS, "-o", place / "mined")
    return place


KIND = EventKind("always", lambda log: [Event(0.5, 1.5, 1.0)], "Always.", "one", "1")
ALWAYS = f"{__name__}:KIND"


def target(name: str, tmp_path: Path) -> Path:
    return tmp_path / f"out{ROWS[name].ending}"


def test_every_command_that_writes_has_a_row() -> None:
    commands = {command.name or command.callback.__name__ for command in app.registered_commands if command.callback}
    writers = {name for name in commands if "--out" in replan(name, "--help").stdout}
    assert writers == set(ROWS) - {"export"}


@pytest.mark.parametrize("name", sorted(set(ROWS) - set(URLS)))
def test_a_url_is_refused_before_any_work(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    url = f"s3://bucket/out{ROWS[name].ending}"
    line = one_error(replan(*ROWS[name].given(place, url)))
    assert line.startswith(f"error: {url}: only `replan evaluate` and `replan merge` write to a URL")
    assert not list(tmp_path.iterdir())


@contextmanager
def another_command_writes(name: str, out: Path) -> Iterator[None]:
    with locked(out.with_name(f".{out.name}{LOCK}"), out) if ROWS[name].ending else held(out):
        yield


@pytest.mark.parametrize("name", CLAIMED)
def test_of_two_at_once_the_second_is_refused(place: Path, tmp_path: Path, name: str) -> None:
    out = target(name, tmp_path)
    with another_command_writes(name, out):
        result = replan(*ROWS[name].given(place, out))
    assert result.exit_code == 2 and "another run writes it" in one_error(result)
    assert not out.exists()


@pytest.mark.parametrize("name", CLAIMED)
def test_what_the_command_did_not_write_is_refused_and_left(place: Path, tmp_path: Path, name: str) -> None:
    out = target(name, tmp_path)
    file = out if ROWS[name].ending else out / "thesis.tex"
    file.parent.mkdir(exist_ok=True)
    file.write_text("two years of work\n", encoding="utf-8")
    result = replan(*ROWS[name].given(place, out))
    assert result.exit_code == 2 and file.name in one_error(result)
    assert file.read_text(encoding="utf-8") == "two years of work\n" and len(list(file.parent.iterdir())) == 1


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("results", ["run/metrics", "mined/events", "mined/new"])
def test_results_are_never_an_output(place: Path, name: str, results: str) -> None:
    out = place / f"{results}{ROWS[name].ending}"
    before = out.read_bytes() if out.exists() else b""
    result = replan(*ROWS[name].given(place, out))
    assert result.exit_code == 2 and "lies in the results" in one_error(result)
    assert (out.read_bytes() if out.exists() else b"") == before


@pytest.mark.parametrize("name", FILES)
def test_another_ending_is_refused(place: Path, tmp_path: Path, name: str) -> None:
    result = replan(*ROWS[name].given(place, tmp_path / "thesis.doc"))
    assert result.exit_code == 2 and "name a file that ends in" in one_error(result)


@pytest.mark.parametrize("name", [name for name in CLAIMED if not ROWS[name].ending])
def test_a_folder_of_another_command_is_refused(place: Path, tmp_path: Path, name: str) -> None:
    for theirs in ("run", "mined"):
        out = Path(shutil.copytree(place / theirs, tmp_path / theirs))
        if (theirs == "run" and name in URLS) or (theirs, name) == ("mined", "mine"):
            continue
        before = {file: file.read_bytes() for file in out.rglob("*") if file.is_file()}
        assert replan(*ROWS[name].given(place, out)).exit_code == 2
        assert {file: file.read_bytes() for file in out.rglob("*") if file.is_file()} == before


@pytest.mark.parametrize("name", CLAIMED)
def test_a_read_only_place_is_one_line(place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    def refuse(path: Path, what: Path) -> int:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    monkeypatch.setattr("replay.run.output._lock", refuse)
    out = target(name, tmp_path)
    assert f"error: {out}: cannot be written: Read-only file system" in one_error(replan(*ROWS[name].given(place, out)))


def contents(out: Path) -> dict[str, bytes]:
    """Files by name, without those that hold a clock."""
    files = [out] if out.is_file() else [file for file in out.rglob("*") if file.is_file()]
    clocks = ("timings.parquet", "origin.json", ".rrd", "report.html", "report.md")
    return {
        file.relative_to(out.parent).as_posix(): file.read_bytes() for file in files if not str(file).endswith(clocks)
    }


@pytest.mark.parametrize("name", RUN)
def test_a_full_disk_says_the_command_that_helps_and_it_does(place: Path, tmp_path: Path, name: str) -> None:
    row, out = ROWS[name], target(name, tmp_path)
    assert replan(*row.given(place, out)).exit_code in (0, 1, 3, 4)
    whole = contents(out)
    out.unlink() if row.ending else shutil.rmtree(out)
    with room(max(map(len, whole.values())) // 2):
        stopped = replan(*row.given(place, out))
    assert stopped.exit_code == 3 and "cannot be written: File too large" in one_error(stopped)
    if not row.ending:
        assert f"give the same command with --out {out}{' --resume' if row.resumes else ''}" in one_error(stopped)
    left = [
        path for path in out.parent.rglob("*") if path.name.startswith((".partial", ".lock")) or ".part" in path.name
    ]
    assert not left
    assert replan(*row.given(place, out), *(["--resume"] if row.resumes else [])).exit_code in (0, 1, 3, 4)
    assert contents(out) == whole


@pytest.mark.parametrize("name", RUN)
def test_run_again_it_gives_the_same_bytes_and_leaves_nothing(place: Path, tmp_path: Path, name: str) -> None:
    out = target(name, tmp_path)
    seen = []
    for _ in range(2):
        assert replan(*ROWS[name].given(place, out)).exit_code in (0, 1, 3, 4)
        seen.append(contents(out))
    assert seen[0] == seen[1] and list(tmp_path.iterdir()) == [out] and not list(tmp_path.rglob(LOCK))


def test_an_error_while_a_file_is_written_is_not_hidden_by_cleaning_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args: object, **more: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr("pathlib.Path.write_text", refuse)
    monkeypatch.setattr("pathlib.Path.unlink", refuse)
    with pytest.raises(OutputError, match=r"file\.txt: cannot be written: Read-only file system"):
        write_text(tmp_path / "file.txt", "x")


def test_a_copied_configuration_does_not_make_a_folder_results(place: Path, tmp_path: Path) -> None:
    shutil.copy(place / "run" / "run.toml", tmp_path)
    assert replan("baseline", place / "run", "-o", tmp_path / "b.parquet").exit_code == 0


def test_names_that_would_be_equal_are_not(tmp_path: Path) -> None:
    names = ("a b", "a/b", "a_b", "A_B", "x" * 90 + "1", "x" * 90 + "2")
    (tmp_path / "logs").mkdir()
    for number, name in enumerate(names):
        write_scenario(tmp_path / "logs" / f"{number}.mcap", short(name, v=8.0 + number))
    replan("mine", tmp_path / "logs", "--workers", 0, "--kind", ALWAYS, "-o", tmp_path / "mined")
    words = ("--where", "kind = 'always'", "--before", 0, "--after", 0, "-o", tmp_path / "cuts")
    said = replan("cut", tmp_path / "mined", *words).stdout.split()
    files = sorted((tmp_path / "cuts").glob("*.mcap"))
    assert len(said) == len(set(said)) == len(files) == len(names)
    assert {read_scenario(file).metadata["cut.of"] for file in files} >= {name for name in names if len(name) < 80}
