"""What commands write holds: all commands (rows) by what may go wrong (columns). A cell is a test,
or says why not.

A file's columns beside these: which byte of it a full disk cuts (test_full_disk.py). Kills at
random times: test_killed_commands.py, `python -m studies.kills`. URLs that are written:
test_urls.py. Locks: test_lock.py.
"""

import errno
import os
import re
import shlex
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
from command_line import one_error, replan
from commonroad_files import problem, straight, written
from full_disk import room
from short_logs import short, write_free_and_blocked

from replan.cli import app, options
from replan.cli.logs import export_app
from replan.core.errors import OutputError
from replan.logs.mcap import read_scenario, write_scenario
from replan.mine.driven_log import Event, EventKind
from replan.paper import pedestrian_grid, reproduce
from replan.results.tables import LOCK, write_text
from replan.run.output import held, locked

pytest.importorskip("duckdb")
pytest.importorskip("optuna")
ROOT = Path(__file__).parents[3]
URL, WORK = "url", "work"
"""Columns with a stated no: refused URLs.

And all in which a command works: full, interrupted, again.
"""
WRITTEN = {URL: "it is written there: test_urls.py"}
SLOW, NIGHTLY = (pytest.mark.slow,), (pytest.mark.slow, pytest.mark.nightly)
VIEWER = {WORK: "needs a graphics driver; the file is claimed and written as that of --save"}


@dataclass(frozen=True)
class Row:
    """A command that writes.

    Attributes:
        words: Its words; OUT is what it writes.
        ending: The end of the name of its file; "": a folder.
        resumes: Whether it has --resume.
        file: A file of it in a folder that may have other files; "": the folder is its own.
        no: Columns that it does not have, and why.
        marks: Of the tests of its work, which takes long.
    """

    words: str
    ending: str = ""
    resumes: bool = False
    file: str = ""
    no: Mapping[str, str] = field(default_factory=dict)
    marks: Sequence[pytest.MarkDecorator] = ()

    def given(self, place: Path, out: object) -> list[str]:
        return [
            word.format(place=place).replace("OUT", str(out)) for word in shlex.split(self.words)
        ]


DRIVE = "-p constant_speed --workers 0"
ROWS = {
    "evaluate": Row(
        f"evaluate {{place}}/free.mcap {DRIVE} --no-recording -o OUT", resumes=True, no=WRITTEN
    ),
    "merge": Row("merge {place}/shard -o OUT", no=WRITTEN),
    "mine": Row("mine {place}/free.mcap {place}/blocked.mcap --workers 0 -o OUT", resumes=True),
    "cut": Row("cut {place}/mined --where true --before 0.5 --after 0.5 -o OUT", resumes=True),
    "vary": Row(
        f"vary {{place}}/free.mcap {DRIVE} --vary ego_speed=0.9:1.1:2 --resolution 9 -o OUT",
        resumes=True,
    ),
    "falsify": Row(
        "falsify {place}/blocked.mcap -p idm --workers 0 --axis ego_speed=0.9:1.1 --budget 16 -o "
        "OUT",
        resumes=True,
        marks=SLOW,
    ),
    "tune": Row(
        "tune {place}/many -p idm --space {place}/space.toml --trials 1 --held-out 0.75 --workers "
        "0 -o OUT",
        resumes=True,
        marks=SLOW,
    ),
    "diagnose": Row("diagnose {place}/run --workers 0 -o OUT", resumes=True, marks=SLOW),
    "report": Row("report {place}/run -o OUT"),
    "query": Row("query {place}/mined 'SELECT * FROM range(500)' -o OUT", ".csv"),
    "suite": Row("suite {place}/mined -o OUT", ".toml"),
    "coverage": Row("coverage {place}/mined --against {place}/mined --workers 0 -o OUT"),
    "score": Row("score {place}/run --as nuplan-cls -o OUT", ".csv"),
    "baseline": Row("baseline {place}/run -o OUT", ".parquet"),
    "repair": Row("repair {place}/free.mcap -o OUT", ".mcap"),
    "repair --table": Row("repair {place}/free.mcap -o OUT.mcap --table OUT", ".csv"),
    "convert": Row("convert {place}/free.mcap -o OUT", ".mcap"),
    "convert, folder": Row("convert {place}/logs -o OUT", file="free.mcap"),
    "salvage": Row("salvage {place}/cut_off.mcap OUT", ".mcap"),
    "synth": Row("synth paper/free_road -o OUT", file="paper/free_road.mcap"),
    "synth, suite": Row("synth --suite paper/free_road -o OUT", file="suite.csv"),
    "synth, bag": Row("synth raw/parked --as ros2 -o OUT", file="raw/parked"),
    "export commonroad-solution": Row(
        "export commonroad-solution {place}/us101 -o OUT", file="USA_US101-6_1_T-1.xml"
    ),
    "export features": Row("export features {place}/free.mcap --workers 0 -o OUT"),
    "export commonroad-solution, drive": Row(
        "export commonroad-solution {place}/us101/closed.mcap -o OUT", ".xml"
    ),
    "plot": Row("plot {place}/run -o OUT", ".svg"),
    "plot, picture": Row("plot {place}/run --chart st -o OUT", ".png"),
    "plot, folder": Row(
        "plot {place}/run --log free --mode closed --chart st -o OUT",
        file="test_free-constant_speed-closed-st.png",
    ),
    "explain --table": Row("explain {place}/run --table OUT", ".parquet"),
    "frame --dump": Row("frame {place}/run --at 1 --dump OUT", ".msgpack"),
    "view --save": Row("view {place}/free.mcap --save OUT", ".rrd"),
    "view --screenshot": Row("view {place}/free.mcap --screenshot OUT", ".png", no=VIEWER),
    "view --video": Row("view {place}/free.mcap --video OUT", ".gif", no=VIEWER),
    "paper": Row("paper --roads 0 --workers 0 -o OUT", marks=NIGHTLY),
    "calibrate": Row("calibrate -o OUT"),
}
READS = {
    "list": "prints",
    "metrics": "prints",
    "inspect": "prints",
    "compare": "prints",
    "warmup": (
        "writes the cache of kernels, each file whole: tests/core/test_kernel_cache.py, "
        "test_warmup.py"
    ),
}
"""The commands that write nothing of the user's."""
FILES = [name for name, row in ROWS.items() if row.ending]
FOLDERS = [name for name, row in ROWS.items() if not row.ending and not row.file]


def rows(column: str) -> list[Any]:
    """The rows that have a column, as parameters of its test."""
    return [
        pytest.param(name, marks=row.marks if column == WORK else ())
        for name, row in ROWS.items()
        if column not in row.no
    ]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs, a run of both, a shard of it, both mined.

    Eight logs; a damaged one; a drive of CommonRoad's.
    """
    place = tmp_path_factory.mktemp("hold")
    for folder in (place, place / "logs"):
        write_free_and_blocked(folder)
    (place / "space.toml").write_text(
        "[planner.idm]\ntime_gap_s = { low = 1.0, high = 2.0 }\n", encoding="utf-8"
    )
    quick = ("-p", "constant_speed", "--workers", 0, "--no-recording")
    replan("evaluate", place / "logs", *quick, "-o", place / "run")
    replan("evaluate", place / "logs", *quick, "--shard", "1/1", "-o", place / "shard")
    replan("mine", place / "logs", "--workers", 0, "--kind", ALWAYS, "-o", place / "mined")
    (place / "many").mkdir()
    for k in range(8):
        write_scenario(place / "many" / f"{k}.mcap", short(f"test/{k}", v=8.0 + k))
    (place / "cut_off.mcap").write_bytes((place / "free.mcap").read_bytes()[:-100])
    name = "USA_US101-6_1_T-1"
    written(place, straight(1), problem(7, 0.0, 0.0, 10.0), benchmark=name).rename(
        place / f"{name}.xml"
    )
    car = ("--vehicle", "kinematic_bicycle", "--car", "bmw_320i", "--mode", "closed")
    replan("evaluate", place / f"{name}.xml", *car, *quick, "-o", place / "us101")
    shutil.copy(next((place / "us101").rglob("closed.mcap")), place / "us101")
    return place


KIND = EventKind("always", lambda log: [Event(0.5, 1.5, 1.0)], "Always.", "one", "1")
ALWAYS = f"{__name__}:KIND"


def target(name: str, tmp_path: Path) -> Path:
    return tmp_path / f"out{ROWS[name].ending}"


def paths(callback: Callable[..., Any]) -> Iterator[tuple[str, bool]]:
    """The parameters of a command that are paths, and whether it writes there."""
    for name, hint in get_type_hints(callback, include_extras=True).items():
        kind, *more = get_args(hint) or (hint,)
        if "Path" in str(kind):
            yield (
                name,
                name == "out"
                or any(getattr(each, "callback", None) is options.local_path for each in more),
            )


READ = {
    "logs",
    "log",
    "runs",
    "run",
    "results",
    "result",
    "shards",
    "targets",
    "damaged",
    "baseline",
    "diagnosis",
    "gates",
    "config",
    "road_map",
    "space",
    "changes",
    "trajectories",
    "against",
}
"""Parameters of commands that are paths to be read."""


def test_every_command_that_writes_has_a_row() -> None:
    commands = [("", command) for command in app.registered_commands]
    commands += [("export ", command) for command in export_app.registered_commands]
    found = {
        f"{group}{command.name or command.callback.__name__}": command.callback
        for group, command in commands
        if command.callback
    }
    writes, reads = set[tuple[str, str]](), set[tuple[str, str]]()
    for command, callback in found.items():
        for name, is_written in paths(callback):
            (writes if is_written else reads).add((command, name))
    assert {name for _, name in reads} == READ
    assert {command if name == "out" else f"{command} --{name}" for command, name in writes} == {
        name.partition(",")[0] for name in ROWS
    }
    assert {command for command, _ in writes} | set(READS) == set(found)


def test_the_table_of_the_documentation_has_these_rows() -> None:
    lines = re.findall(
        r"^\| (`.*)\| .* \| (.*?) \| (yes|refused) \|$",
        (ROOT / "docs" / "use.md").read_text(),
        re.MULTILINE,
    )
    said = {name: words for names, *words in lines for name in re.findall("`([^`]+)`", names)}
    of_rows = {
        name.partition(",")[0].replace("repair --table", "repair"): row
        for name, row in ROWS.items()
    }
    assert said.keys() == of_rows.keys()
    for name, row in of_rows.items():
        assert (said[name][0] == "yes") is row.resumes and (said[name][1] == "yes") is (
            URL in row.no
        )


@pytest.mark.parametrize("name", rows(URL))
def test_a_url_is_refused_at_once(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    url = f"s3://bucket/out{ROWS[name].ending}"
    line = one_error(replan(*ROWS[name].given(place, url)))
    assert (
        "s3://bucket/out" in line
        and "only `replan evaluate` and `replan merge` write to a URL" in line
    )
    assert not list(tmp_path.iterdir())


@contextmanager
def another_command_writes(name: str, out: Path) -> Iterator[None]:
    with locked(out.with_name(f".{out.name}{LOCK}"), out) if ROWS[name].ending else held(out):
        yield


@pytest.mark.parametrize("name", ROWS)
def test_a_second_command_at_the_same_time_is_refused(
    place: Path, tmp_path: Path, name: str
) -> None:
    out = target(name, tmp_path)
    with another_command_writes(name, out):
        result = replan(*ROWS[name].given(place, out))
    assert result.exit_code == 2 and "another run writes it" in one_error(result)
    assert not out.exists()


@pytest.mark.parametrize("name", ROWS)
def test_foreign_files_are_refused_and_left_as_they_are(
    place: Path, tmp_path: Path, name: str
) -> None:
    row, out = ROWS[name], target(name, tmp_path)
    file = out if row.ending else out / (row.file or "thesis.tex")
    file.parent.mkdir(exist_ok=True, parents=True)
    file.write_text("two years of work\n", encoding="utf-8")
    result = replan(*row.given(place, out))
    assert result.exit_code == 2 and file.name in one_error(result)
    assert (
        file.read_text(encoding="utf-8") == "two years of work\n"
        and len(list(file.parent.iterdir())) == 1
    )


@pytest.mark.parametrize("name", [name for name in ROWS if name not in FOLDERS])
@pytest.mark.parametrize("results", ["run/metrics", "mined/events", "mined/new"])
def test_results_are_never_an_output(place: Path, name: str, results: str) -> None:
    out = place / f"{results}{ROWS[name].ending}"
    before = out.read_bytes() if out.is_file() else b""
    result = replan(*ROWS[name].given(place, out))
    assert result.exit_code == 2 and "lies in the results" in one_error(result)
    assert (out.read_bytes() if out.is_file() else b"") == before


@pytest.mark.parametrize("name", FILES)
def test_another_ending_is_refused(place: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "thesis.doc").touch()
    result = replan(*ROWS[name].given(place, tmp_path / "thesis.doc"))
    assert result.exit_code == 2 and re.search("ends? (in|with)|cannot be", one_error(result))


@pytest.mark.parametrize("name", FOLDERS)
def test_a_folder_of_another_command_is_refused(place: Path, tmp_path: Path, name: str) -> None:
    for theirs in ("run", "mined"):
        out = Path(shutil.copytree(place / theirs, tmp_path / theirs))
        if (theirs == "run" and name in ("evaluate", "merge")) or (theirs, name) == (
            "mined",
            "mine",
        ):
            continue
        before = {file: file.read_bytes() for file in out.rglob("*") if file.is_file()}
        assert replan(*ROWS[name].given(place, out)).exit_code == 2
        assert {file: file.read_bytes() for file in out.rglob("*") if file.is_file()} == before


@pytest.mark.parametrize("name", ROWS)
def test_a_read_only_place_is_one_line(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    def refuse(path: Path, what: Path) -> int:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    monkeypatch.setattr("replan.run.output._lock", refuse)
    result = replan(*ROWS[name].given(place, target(name, tmp_path)))
    assert result.exit_code == 2 and "cannot be written: Read-only file system" in one_error(result)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


CLOCKS = (
    "timings.parquet",
    "origin.json",
    "log.json",
    ".rrd",
    "report.html",
    "report.md",
    ".msgpack",
    "summary.json",
    "diagnosis.md",
)


def contents(out: Path) -> dict[str, bytes]:
    """Files by name; of those that hold a clock, nothing else."""
    files = [out] if out.is_file() else [file for file in out.rglob("*") if file.is_file()]
    return {
        file.relative_to(out.parent).as_posix(): b""
        if str(file).endswith(CLOCKS)
        else file.read_bytes()
        for file in files
    }


def left(folder: Path) -> list[Path]:
    """Locks and unfinished files."""
    return [path for path in folder.rglob("*") if path.name.startswith(".") or ".part" in path.name]


@dataclass
class Whole:
    """An undisturbed run of a command: what it writes, its exit code, its largest file, and the
    files it renames.
    """

    out: Path
    contents: dict[str, bytes]
    code: int
    largest: int
    renamed: int


@contextmanager
def stopped_at(last: int) -> Iterator[list[Path]]:
    """Interrupt as the file of this number gets its final name; the files until then."""
    names, replace, rename = list[Path](), Path.replace, Path.rename

    def counted(move: Callable[[Path, Path], Path], path: Path, to: Path) -> Path:
        names.append(path)
        if len(names) == last:
            raise KeyboardInterrupt
        return move(path, to)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "replace", lambda path, to: counted(replace, path, to))
        patch.setattr(Path, "rename", lambda path, to: counted(rename, path, to))
        yield names


@pytest.fixture(scope="module")
def whole(
    place: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[[str], Whole]]:
    """The undisturbed run of a command, made once; the paper with four pedestrians."""
    made = dict[str, Whole]()

    def of(name: str) -> Whole:
        if name not in made:
            out = target(name, tmp_path_factory.mktemp("whole"))
            with stopped_at(0) as renamed:
                code = replan(*ROWS[name].given(place, out)).exit_code
            files = [out] if out.is_file() else [file for file in out.rglob("*") if file.is_file()]
            largest = max(file.stat().st_size for file in files)
            made[name] = Whole(out, contents(out), code, largest, len(renamed))
        return made[name]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            reproduce,
            "PaperConfig",
            partial(reproduce.PaperConfig, cells=pedestrian_grid.CELLS[:4]),
        )
        yield of


@pytest.mark.parametrize("name", rows(WORK))
def test_a_full_disk_says_which_command_helps(
    place: Path, tmp_path: Path, whole: Callable[[str], Whole], name: str
) -> None:
    row, out, sound = ROWS[name], target(name, tmp_path), whole(name)
    with room(sound.largest // 2):
        stopped = replan(*row.given(place, out))
    assert stopped.exit_code == 3 and "cannot be written: File too large" in one_error(stopped)
    if name in FOLDERS:
        assert (
            f"give the same command with --out {out}{' --resume' if row.resumes else ''}"
            in one_error(stopped)
        )
    assert not left(tmp_path)
    assert (
        replan(*row.given(place, out), *(["--resume"] if row.resumes else [])).exit_code
        == sound.code
    )
    assert contents(out) == sound.contents


@pytest.mark.parametrize("name", rows(WORK))
def test_interrupted_it_is_whole_and_goes_on(
    place: Path, tmp_path: Path, whole: Callable[[str], Whole], name: str
) -> None:
    row, out, sound = ROWS[name], target(name, tmp_path), whole(name)
    with stopped_at((sound.renamed + 1) // 2):
        stopped = replan(*row.given(place, out))
    assert stopped.exit_code == 130 and "interrupted" in one_error(stopped)
    assert (
        not left(tmp_path)
        and (contents(out) if out.exists() else {}).keys() <= sound.contents.keys()
    )
    assert (
        replan(*row.given(place, out), *(["--resume"] if row.resumes else [])).exit_code
        == sound.code
    )
    assert contents(out) == sound.contents


@pytest.mark.parametrize("name", rows(WORK))
def test_run_again_it_gives_the_same_bytes(
    place: Path, whole: Callable[[str], Whole], name: str
) -> None:
    sound = whole(name)
    assert replan(*ROWS[name].given(place, sound.out)).exit_code == sound.code
    assert contents(sound.out) == sound.contents and not left(sound.out.parent)


@pytest.mark.parametrize("name", [name for name, row in ROWS.items() if row.file])
def test_other_files_of_the_folder_are_left(place: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").write_text("two years of work\n", encoding="utf-8")
    assert replan(*ROWS[name].given(place, tmp_path / "out")).exit_code == 0
    assert (tmp_path / "out" / "thesis.tex").read_text(encoding="utf-8") == "two years of work\n"


def test_an_error_while_writing_is_not_hidden_by_cleaning_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args: object, **more: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr("pathlib.Path.write_bytes", refuse)
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
    assert {read_scenario(file).metadata["cut.of"] for file in files} >= {
        name for name in names if len(name) < 80
    }
