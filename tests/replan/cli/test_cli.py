"""The command line: exit codes, one-line errors, and a report that a stranger can read."""

import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from command_line import evaluate, gates, one_error, replan
from typer.main import get_command

from replan.cli import app
from replan.cli.one_drive import matching_drives
from replan.config import RunConfig
from replan.core.errors import ConfigError
from replan.draw.drawn_results import load
from replan.draw.report.overview import overview
from replan.draw.view import recordings
from replan.logs.mcap import read_scenario
from replan.run import evaluate_logs
from replan.run.sources import select


def test_help_names_every_command_and_teaches_by_example() -> None:
    words = replan("--help").stdout
    for command in ("evaluate", "synth", "convert", "inspect", "view"):
        assert command in words
    for command in (["evaluate"], ["synth"], ["convert", "commonroad"], ["view"]):
        assert f"replan {command[0]}" in replan(*command, "--help").stdout
    assert "Exit codes" in replan("evaluate", "--help").stdout
    assert "its [log] table" in replan("inspect", "--help").stdout


def test_the_help_of_evaluate_fits_on_a_screen_and_a_half(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    assert len(replan("evaluate", "--help").stdout.splitlines()) <= 75


@pytest.mark.parametrize(
    "words",
    [
        ("report", "run", "--diagnosis", "a", "--diagnosis=b"),
        ("evaluate", "--suite", "smoke", "--suite", "full"),
        ("explain", "run", "-p", "idm", "--planner", "pdm"),
        ("mine", "log.mcap", "-oa", "-o", "b"),
    ],
)
def test_an_option_of_one_value_is_not_given_twice(words: tuple[str, ...]) -> None:
    refused = replan(*words)
    assert refused.exit_code == 2
    assert "2 times" in refused.stderr


@pytest.mark.parametrize("words", [("evaluate", "--logs", "a"), ("compare", "--runs=a")])
def test_an_argument_that_is_given_as_an_option_is_named(words: tuple[str, ...]) -> None:
    refused = replan(*words)
    name = words[1].partition("=")[0]
    assert refused.exit_code == 2
    assert "by position" in refused.stderr and name[2:].upper() in refused.stderr


def test_options_of_several_values_and_values_like_options_are_taken() -> None:
    assert (
        "2 times"
        not in replan(
            "evaluate", "nowhere", "-p", "idm", "-p", "pdm", "--config", "--config"
        ).stderr
    )
    assert "2 times" not in replan("inspect", "--", "--ego", "--ego").stderr


def test_version() -> None:
    assert re.match(r"replan \S", replan("--version").stdout)


@pytest.mark.parametrize(
    ("log", "rule", "code", "words"),
    [
        ("free", "", 0, ["test/free", " goal ", "PASS", "Planning time", "{out}", "exit code 0"]),
        ("blocked", "", 1, ["FAIL", "collision_at_fault.count", "wall", "exit code 1"]),
        ("free", 'metric = "gap.min"\nmin = 0.5', 4, ["INCONCLUSIVE"]),
    ],
)
def test_the_report_says_what_the_exit_code_says_and_why(
    folder: Path, tmp_path: Path, log: str, rule: str, code: int, words: list[str]
) -> None:
    judged_by = ["--gates", gates(tmp_path / "gates.toml", rule)] if rule else []
    result = evaluate(folder / f"{log}.mcap", *judged_by, "--out", tmp_path / "out")
    assert result.exit_code == code, result.output
    for word in words:
        assert word.format(out=tmp_path / "out") in result.stdout
    assert "error" not in result.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "nowhere: no such file or folder"),
        (["{empty}"], "no logs in this folder"),
        (["{free}", "--planner", "constant_sped"], "did you mean 'constant_speed'?"),
        (["{free}", "--gates", "nowhere.toml"], "nowhere.toml"),
        (["{free}", "--gates", "{wrong_gate}"], "did you mean 'gap.min'"),
        (["{free}", "--config", "{wrong_key}"], "did you mean 'loop.plan_period_s'?"),
        (["{free}", "--set", "plan_period_s=1"], "did you mean 'loop.plan_period_s'?"),
        (
            ["{free}", "--set", "loop.plan_period_s=ab"],
            "loop.plan_period_s: expected float, got str",
        ),
        (["{free}", "--set", "loop"], "write it as KEY=VALUE"),
        (["{free}", "--set", "planner.dp_pq.w=1"], "did you mean 'dp_qp'?"),
        (["{free}", "--set", "loop.plant.foo=1"], "no key is called 'foo'"),
        (["{free}", "--set", "loop.plant.mass=heavy"], "expected a number"),
        (["{free}", "--set", "loop.plant.mass=-1"], "mass must be positive"),
        # Of a planner that is not driven
        (["{free}", "--config", "{wrong_table}"], "planner.dp_qp"),
        (["{free}", "--planner", "needy:Needy"], "argument: 'path'"),
        (["{free}", "--out", "{empty}/../foreign"], "not results of `replan evaluate`"),
        (["synth", "paper/free_raod", "-o", "{out}"], "did you mean 'paper/free_road'?"),
        (["synth", "paper/free_road"], "replan synth all -o"),
        (["synth", "paper/free_road", "-o", "{out}", "--set", "radius_m"], "parameter=number"),
        (
            ["synth", "paper/free_road", "-o", "{out}", "--set", "radius_m=wide"],
            "'wide' is no number",
        ),
        (
            ["synth", "paper/free_road", "-o", "{out}", "--set", "radios_m=1"],
            "no parameter radios_m",
        ),
    ],
)
def test_exit_2(
    folder: Path, tmp_path: Path, module: Callable[[str, str], str], words: list[str], said: str
) -> None:
    module(
        "needy",
        "class Needy:\n    def __init__(self, context, *, path): ...\n    def plan(self, frame): "
        "...\n",
    )
    (tmp_path / "empty").mkdir()
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "diary.txt").write_text("", encoding="utf-8")
    wrong_key, wrong_table = tmp_path / "run.toml", tmp_path / "table.toml"
    wrong_key.write_text("[loop]\nplan_perod_s = 0.1", encoding="utf-8")
    wrong_table.write_text('[planner.dp_qp]\nhorizon = "far"\n', encoding="utf-8")
    places = {
        "out": tmp_path / "out",
        "empty": tmp_path / "empty",
        "free": folder / "free.mcap",
        "wrong_gate": gates(tmp_path / "gates.toml", 'metric = "gap.mim"\nmin = 1'),
        "wrong_key": wrong_key,
        "wrong_table": wrong_table,
    }
    given = [word.format(**places) for word in words]
    out = [] if "--out" in words else ["--out", places["out"]]
    result = replan(*given) if words[0] == "synth" else evaluate(*given, *out)
    assert result.exit_code == 2
    assert said in one_error(result)
    assert not (tmp_path / "out").exists()


def test_options_win_over_the_configuration(folder: Path, tmp_path: Path) -> None:
    config = tmp_path / "run.toml"
    config.write_text(
        'planners = ["dp_qp"]\nmode = "both"\n[loop]\nplan_period_s = 0.2\n', encoding="utf-8"
    )
    words = ("--mode", "open", "--set", "loop.control_period_s=0.02", "--set", "internals=none")
    evaluate(folder / "free.mcap", "--config", config, *words, "--out", tmp_path / "out")
    written = (tmp_path / "out" / "run.toml").read_text(encoding="utf-8")
    settings = ("plan_period_s = 0.2", "control_period_s = 0.02", 'internals = "none"')
    for line in ('"constant_speed"', 'mode = "open"', "recording = false", *settings):
        assert line in written


def test_without_out_the_folder_is_numbered(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for number in (1, 2):
        result = evaluate(folder / "free.mcap", "--mode", "open")
        assert str(Path("results") / f"run-00{number}") in result.stdout
        assert (tmp_path / "results" / f"run-00{number}" / "metrics.csv").exists()


def test_synth_lists_writes_and_repeats_itself(tmp_path: Path) -> None:
    listing = replan("synth", "--list").stdout
    assert "paper/free_road" in listing
    assert "radius_m=50" in listing
    for out in ("one", "two"):
        assert replan("synth", "paper", "everyday/nudge", "-o", tmp_path / out).exit_code == 0
    written = sorted(
        path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*.mcap")
    )
    assert Path("everyday/nudge.mcap") in written
    assert Path("paper/free_road.mcap") in written
    assert all(
        (tmp_path / "one" / p).read_bytes() == (tmp_path / "two" / p).read_bytes() for p in written
    )


def test_synth_keeps_all_digits_of_a_name(tmp_path: Path) -> None:
    """Logs whose long names differ in the last digit are two files."""
    common = ("--set", "ego_speed_mps=9.5", "--set", "kerb_distance_m=0.65")
    for speed in ("0.82", "0.84"):
        value = ("--set", f"pedestrian_speed_mps={speed}")
        result = replan("synth", "paper/crossing_pedestrian", "-o", tmp_path, *common, *value)
        assert result.exit_code == 0, result.output
    speeds = {
        read_scenario(path).metadata["parameter.pedestrian_speed_mps"]
        for path in tmp_path.glob("paper/*.mcap")
    }
    assert speeds == {"0.82", "0.84"}


@pytest.mark.parametrize("names", [["paper"], ["--suite", "everyday/cut_in"]])
def test_two_logs_for_one_file_are_refused_before_one_is_written(
    names: list[str], tmp_path: Path
) -> None:
    result = replan("synth", *names, "-o", tmp_path / "one.mcap")
    assert result.exit_code == 2, result.output
    assert "one.mcap: two files of this command would have this name; name a folder with -o" in (
        result.output
    )
    assert not list(tmp_path.iterdir())


def test_synth_with_parameters_says_so_in_the_log(tmp_path: Path) -> None:
    result = replan("synth", "paper/free_road", "-o", tmp_path, "--set", "ego_speed_mps=9")
    (path,) = tmp_path.rglob("*.mcap")
    assert str(path) in result.stdout.replace("\n", "")
    log = read_scenario(path)
    assert log.ego.v[0] == pytest.approx(9.0)
    assert "9.0" in log.metadata["parameter.ego_speed_mps"]


def test_inspect_says_what_a_log_holds(folder: Path, tmp_path: Path) -> None:
    result = replan("inspect", folder / "blocked.mcap")
    assert result.exit_code == 0
    for word in ("test/blocked", "obstacles: 1", "closed loop"):
        assert word in result.stdout
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"not an MCAP file")
    assert replan("inspect", bad).exit_code == 3
    assert replan("inspect", tmp_path / "nowhere.mcap").exit_code == 2


def test_inspect_and_evaluate_find_the_same_logs_in_a_folder(folder: Path, tmp_path: Path) -> None:
    place = tmp_path / "week"
    place.mkdir()
    for name in ("first.mcap", "second copy.mcap"):
        (place / name).write_bytes((folder / "blocked.mcap").read_bytes())
    shown = replan("inspect", place)
    assert shown.exit_code == 0 and "test/blocked" in shown.stdout
    assert len(select([place]).sources) == 1
    (place / "third.mcap").write_bytes((folder / "free.mcap").read_bytes())
    several = replan("inspect", place)
    assert several.exit_code == 2
    assert "week: a folder of 2 logs, first.mcap, third.mcap; name one of them" in several.stderr
    assert len(select([place]).sources) == 2
    (tmp_path / "empty").mkdir()
    nothing = replan("inspect", tmp_path / "empty")
    assert nothing.exit_code == 3 and "the folder holds nothing" in nothing.stdout


def test_convert_commonroad(shared_data: Path, tmp_path: Path) -> None:
    files = sorted((shared_data / "commonroad").glob("USA_US101-6*.xml"))
    assert replan("convert", "commonroad", *files, "-o", tmp_path / "one.mcap").exit_code == 0
    assert len(read_scenario(tmp_path / "one.mcap").tracks)
    broken = tmp_path / "broken.xml"
    broken.write_text("<commonRoad>", encoding="utf-8")
    result = replan("convert", "commonroad", broken, *files, "-o", tmp_path / "many")
    assert result.exit_code == 3
    assert str(broken) in one_error(result)
    assert [path.name for path in (tmp_path / "many").iterdir()] == [f"{files[0].stem}.mcap"]
    assert (
        replan("convert", "commonroad", broken, broken, "-o", tmp_path / "two.mcap").exit_code == 2
    )


def test_convert_writes_over_no_log(folder: Path, tmp_path: Path) -> None:
    log = tmp_path / "monday" / "drive.mcap"
    twin = tmp_path / "tuesday" / "drive.mcap"
    for path in (log, twin):
        path.parent.mkdir()
        path.write_bytes((folder / "free.mcap").read_bytes())
    before = log.read_bytes()
    for words, said in (
        ((log, "--to", 1, "-o", log), "this command did not write it, or reads it"),
        ((log.parent, "--to", 1, "-o", log.parent), "this command did not write it, or reads it"),
        (
            (tmp_path, "-o", tmp_path / "out"),
            f"{log} and {twin} would both become {tmp_path / 'out' / 'drive.mcap'}",
        ),
        ((log, tmp_path / "nowhere", "-o", tmp_path / "out"), "nowhere: no such file or folder"),
    ):
        result = replan("convert", *words)
        assert result.exit_code == 2
        assert said in one_error(result)
        assert log.read_bytes() == before and not (tmp_path / "out").exists()


def test_convert_names_what_it_cannot_take_or_write(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "cut.bag").write_bytes(b"")
    (tmp_path / "in" / "free.mcap").write_bytes((folder / "free.mcap").read_bytes())
    result = replan("convert", tmp_path / "in", "-o", tmp_path / "out")
    assert result.exit_code == 0
    assert result.stdout.startswith(
        f"left out {tmp_path / 'in' / 'cut.bag'}: no reader recognises it\n"
    )
    (tmp_path / "file").touch()
    result = replan("convert", folder / "free.mcap", "-o", tmp_path / "file")
    assert result.exit_code == 2
    assert "file: cannot be the result folder" in one_error(result)


def test_view_saves_over_nothing_but_recordings(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.mcap"
    other.write_bytes(b"mine")
    result = replan("view", folder / "free.mcap", "--save", other)
    assert result.exit_code == 2
    assert "name a file that ends in .rrd" in one_error(result)
    assert other.read_bytes() == b"mine"
    result = replan("view", folder / "free.mcap", "--save", other / "free.rrd")
    assert result.exit_code == 3
    assert "free.rrd: cannot be written" in one_error(result)


def test_view_opens_recordings_with_the_viewer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[list[str]] = []

    def viewer(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        calls.append(command)
        return subprocess.CompletedProcess(command, 0 if len(calls) < 3 else 1)

    monkeypatch.setattr("replan.draw.view.subprocess.run", viewer)
    monkeypatch.setenv("DISPLAY", ":0")
    for name in ("a/closed.rrd", "a/open.rrd"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    assert replan("view", tmp_path).exit_code == 0
    assert calls[0][-2:] == [str(tmp_path / "a" / "closed.rrd"), str(tmp_path / "a" / "open.rrd")]
    assert replan("view", tmp_path / "a" / "open.rrd").exit_code == 0
    assert calls[1][-1] == str(tmp_path / "a" / "open.rrd")
    result = replan("view", tmp_path)
    assert result.exit_code == 3
    assert "without a display" in one_error(result)


@pytest.fixture(scope="module")
def recorded(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results with recordings: one log passes, one fails."""
    run = RunConfig(planners=("constant_speed",))
    return evaluate_logs([folder], run, tmp_path_factory.mktemp("recorded")).path


def test_view_of_results_opens_index_and_worst(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[list[str]] = []

    def viewer(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        opened.append([part for part in command if part.endswith(".rrd")])
        assert Path(opened[-1][-1]).is_file()
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr("replan.draw.view.subprocess.run", viewer)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("replan.draw.view.MOST", 1)
    assert replan("view", recorded).exit_code == 0
    assert [Path(file).name for file in opened[0]] == ["closed.rrd", "index.rrd"]
    assert "blocked" in opened[0][0], "the worst"
    assert replan("view", recorded, "--log", "test/free").exit_code == 2, (
        "two recordings, one may be open"
    )
    monkeypatch.setattr("replan.draw.view.MOST", 2)
    assert replan("view", recorded, "--log", "test/free").exit_code == 0
    assert all("test_free" in file for file in opened[1]) and len(opened[1]) == 2


def test_the_index_lists_the_worst_first_and_says_how_others_are_opened(
    recorded: Path, tmp_path: Path
) -> None:
    from recordings import Recording

    from replan.draw.view import write_index

    worst = write_index(tmp_path / "index.rrd", recorded, 1)
    (page,) = Recording(tmp_path / "index.rrd").static("/index", "TextDocument:text").to_pylist()
    assert page.index("test/blocked") < page.index("test/free") and "1 of 2 recordings" in page
    for row in load(recorded).drives.query("mode == 'closed'").itertuples():
        (file,) = (recorded.resolve() / file for file in row.files if file.endswith(".rrd"))
        assert f"| [{row.log}](<{file.as_posix()}>) |" in page and file.is_file()
    assert "--log LOG" in page and [file.parent.name.split("-")[0] for file in worst] == [
        "test_blocked"
    ]


def test_a_log_is_found_by_its_name_as_the_index_has_it(tmp_path: Path) -> None:
    folder = tmp_path / "unece_r157_cut_in_accel_mps2_-3_gap_m_0-0a1b2c3d"
    folder.mkdir()
    (folder / "closed.rrd").write_bytes(b"")
    assert recordings(tmp_path, "unece_r157/cut_in@accel_mps2=-3,gap_m=0") == [
        folder / "closed.rrd"
    ]
    with pytest.raises(ConfigError, match="called 'cut_out'"):
        recordings(tmp_path, "cut_out")


def test_log_planner_and_mode_choose_the_same_drives_in_every_command(
    recorded: Path, tmp_path: Path
) -> None:
    for words in (("--log", "test/free"), ("--log", "free"), ("test_free",)):
        drives = matching_drives(load(recorded), words[-1], "constant_speed", "both")
        assert sorted((drive.log, drive.mode) for drive in drives) == [
            ("test/free", "closed"),
            ("test/free", "open"),
        ]
        one = (*words, "-p", "constant_speed", "--mode", "open")
        for command in (("explain",), ("plot", "--chart", "curves", "-o", tmp_path / "x.svg")):
            assert (
                "test/free, constant_speed, open loop"
                in replan(command[0], recorded, *command[1:], *one).stdout
            )
    for command in (
        ("explain",),
        ("plot",),
        ("frame", "--at", 1),
        ("view", "--screenshot", "x.png"),
    ):
        for word, value, known in (("--log", "fre_", "test/free"), ("-p", "idm", "constant_speed")):
            said = one_error(replan(command[0], recorded, *command[1:], word, value))
            assert value in said and known in said, command
    for command in (("explain",), ("plot",), ("frame", "--at", 1)):
        said = one_error(replan(command[0], recorded, "fre_", *command[1:]))
        assert "fre_" in said and "test/free" in said, command
        twice = replan(command[0], recorded, "free", *command[1:], "--log", "free")
        assert twice.exit_code == 2 and "once" in one_error(twice)
    assert "--screenshot" in one_error(replan("view", recorded, "--at", 3))
    assert "is none" in one_error(
        replan("view", next(recorded.glob("test_free*")), "--mode", "open")
    )
    assert "of results" in one_error(
        replan("view", next(recorded.glob("test_free*/open.rrd")), "-p", "idm")
    )


def test_an_option_is_spelled_and_shown_the_same_way_in_every_command() -> None:
    shapes: dict[str, set[Any]] = {}
    commands: dict[str, list[str]] = {}
    for name, command in get_command(app).commands.items():  # type: ignore[attr-defined]
        for parameter in command.params:
            for spelling in parameter.opts if parameter.param_type_name == "option" else ():
                commands.setdefault(spelling, []).append(name)
                shapes.setdefault(spelling, set()).add(
                    (tuple(parameter.opts), parameter.metavar, parameter.is_flag)
                )
    assert commands["-p"] == commands["--planner"] and {
        "evaluate",
        "view",
        "plot",
        "explain",
        "frame",
    } <= {*commands["-p"]}
    assert {*commands["--log"]} >= {"view", "plot", "explain", "frame", "diagnose"}
    shared = (
        "--planner",
        "--log",
        "--mode",
        "--at",
        "--config",
        "--gates",
        "--baseline",
        "--set",
        "--ego",
        "--map",
    )
    assert {option: shapes[option] for option in shared if len(shapes[option]) > 1} == {}


def test_a_picture_of_a_run_is_its_worst_drive(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Path] = []
    monkeypatch.setattr(
        "replan.draw.view.picture", lambda recording, *rest: drawn.append(recording)
    )
    every = replan("view", recorded, "--screenshot", tmp_path / "x.png")
    row = overview(load(recorded)).drives[0]
    assert drawn[0] == recorded / row.recording
    assert (
        f"{row.log}, constant_speed, " in every.stdout and "the worst of 4 drives" in every.stdout
    )
    free = replan("view", recorded, "--log", "test/free", "--screenshot", tmp_path / "x.png")
    assert (
        drawn[1].parent.name.startswith("test_free")
        and "test/free, constant_speed, closed loop" in free.stdout
    )
    assert "the worst of 2 drives" in free.stdout


def test_view_of_two_drives_writes_them_as_one(recorded: Path, tmp_path: Path) -> None:
    one = next(recorded.glob("test_free*/closed.rrd"))
    both = tmp_path / "both.rrd"
    assert replan("view", one, one.with_name("open.rrd"), "--save", both).exit_code == 0
    assert both.is_file()
    assert "2 recordings are in both" in one_error(
        replan("view", recorded, recorded, "--log", "free")
    )
    other = next(recorded.glob("test_blocked*/closed.rrd"))
    assert "both drives must be of the same log" in one_error(
        replan("view", one, other, "--save", both)
    )
    assert "two folders" in one_error(replan("view", one, recorded, "--save", both))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--layout", "nothing"], "overview, planner, control"),
        (["--screenshot", "x.png", "--size", "big"], "1920x1080"),
        (["--video", "x.mp4", "--from", "1", "--to", "2"], "ffmpeg"),
        (["--video", "x.gif", "--from", "2", "--to", "1"], "no time between"),
    ],
)
def test_view_refuses_in_words(
    recorded: Path, options: list[str], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("replan.draw.recording.pictures.shutil.which", lambda name: None)
    assert said in one_error(replan("view", next(recorded.glob("test_free*/closed.rrd")), *options))


def test_view_refuses_what_holds_no_recording(folder: Path, tmp_path: Path) -> None:
    assert "no recording" in one_error(replan("view", tmp_path))
    assert replan("view", tmp_path / "nowhere").exit_code == 2
    for number in range(20):
        (tmp_path / f"{number}.rrd").write_bytes(b"")
    assert "too many" in one_error(replan("view", tmp_path))
