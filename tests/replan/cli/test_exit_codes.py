"""What the command line ends with, over every case: 0, 1, 2, 3, 4 or 130, and never a traceback."""

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from replan.cli import app, main

PLANNERS = """
from replan.planners.constant_speed import ConstantSpeed

class Raising(ConstantSpeed):
    def plan(self, frame):
        raise RuntimeError("out of ideas")

class Interrupted(ConstantSpeed):
    def plan(self, frame):
        raise KeyboardInterrupt
"""
GATES = {
    "pass": 'metric = "fallback.rate"\nmax = 0',
    "fail": 'metric = "fallback.rate"\nmin = 1',
    "inconclusive": 'metric = "gap.min"\nmin = 0.5',
    "tag": 'metric = "fallback.rate"\nmax = 0\ntags = ["rian"]',
    "hour": 'metric = "coverage.driven_s.final"\nmin = 3600\nover = "sum"',
    "sure": (
        'metric = "fallback.rate"\nmax = 0\nover = "pass_share"\nmin_share = 0.9\nconfident = true'
    ),
    "key": 'metric = "fallback.rate"\nmaximum = 0',
}


@pytest.fixture(scope="module")
def place(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs, gates, planners that misbehave, and results of two runs."""
    folder = Path(shutil.copytree(folder, tmp_path_factory.mktemp("cases"), dirs_exist_ok=True))
    (folder / "broken.mcap").write_bytes((folder / "free.mcap").read_bytes()[:-100])
    (folder / "misbehaving_cases.py").write_text(PLANNERS, encoding="utf-8")
    for name, rule in GATES.items():
        (folder / f"{name}.toml").write_text(f"[[gate]]\n{rule}\n", encoding="utf-8")
    both = (GATES[name] for name in ("fail", "inconclusive"))
    (folder / "both.toml").write_text(
        "".join(f"[[gate]]\n{rule}\n" for rule in both), encoding="utf-8"
    )
    quick = ("--workers", "0", "--no-recording", "--gates", str(folder / "pass.toml"))
    for name, log in (("run", "free"), ("other", "blocked")):
        CliRunner().invoke(
            app,
            [
                "evaluate",
                str(folder / f"{log}.mcap"),
                "-p",
                "constant_speed",
                *quick,
                "-o",
                str(folder / name),
            ],
        )
    rule = '[[compare]]\nmetric = "ttc.min"\nmax_decrease = 0.1\n'
    (folder / "nothing.toml").write_text(f"[[gate]]\n{GATES['pass']}\n{rule}", encoding="utf-8")
    (folder / "damaged.parquet").write_bytes(b"PAR1")
    shutil.copytree(folder / "run", folder / "unfinished")
    (folder / "unfinished" / "summary.json").unlink()
    return folder


EVALUATE = "evaluate {log} -p {planner} --gates {gates}.toml --workers 0 --no-recording -o {out}"


def case(
    log: str = "free.mcap", planner: str = "constant_speed", gates: str = "pass", more: str = ""
) -> str:
    return EVALUATE.format(log=log, planner=planner, gates=gates, out="OUT") + more


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (case(), 0),
        (case(more=" --quiet"), 0),
        (case(more=" --json"), 0),
        (case(more=" --no-report"), 0),
        (case(gates="fail", more=" --shard 1/1"), 0),  # a shard is not judged
        (case(gates="fail"), 1),
        (case(gates="fail", more=" --quiet"), 1),
        (case(gates="hour"), 1),
        (case(more=" --baseline run"), 0),
        # Its gate passes; the log of the baseline is missing
        (case("blocked.mcap", more=" --baseline run"), 1),
        (case("blocked.mcap", more=" --baseline run --quiet"), 1),
        (case("broken.mcap", more=" --baseline run"), 3),  # 3 beats 1
        (case(more=" --baseline nowhere"), 2),
        (case(gates="both"), 1),  # 1 beats 4
        (case("nowhere.mcap"), 2),
        (case(gates="nowhere"), 2),
        (case(gates="key"), 2),
        (case(planner="constant_sped"), 2),
        (case(more=" --sideways"), 2),
        (case(more=" --mode sideways"), 2),
        (case(more=" --shard 3/2"), 2),
        ("report nowhere", 2),
        ("report unfinished -o OUT", 2),
        ("merge run -o OUT", 2),
        ("compare run nowhere", 2),
        (case("broken.mcap"), 3),
        (case("broken.mcap free.mcap", gates="fail"), 3),  # 3 beats 1
        (case("broken.mcap free.mcap", gates="inconclusive"), 3),  # and 4
        (case(planner="misbehaving_cases:Raising"), 3),
        (case(planner="misbehaving_cases:Raising -p constant_speed", gates="fail"), 3),
        (case(planner="no_such_module:X"), 3),
        (case("broken.mcap", more=" --quiet"), 3),
        (case(gates="inconclusive"), 4),
        (case(gates="tag"), 4),
        (case(gates="sure"), 4),  # one log shows no share of 90 %
        (case(planner="misbehaving_cases:Interrupted"), 3),  # it raises, in its own process
        (case(planner="misbehaving_cases:Interrupted --set loop.apart.trust=true"), 130),
        ("report run -o OUT", 0),
        ("report run --baseline run -o OUT", 0),
        ("report other --baseline run -o OUT", 0),  # they are written, whatever they say
        ("report run --baseline nowhere -o OUT", 2),
        # Rules of a comparison, and nothing to compare with
        ("report run --gates nothing.toml -o OUT", 2),
        ("compare run run", 0),
        ("compare run other", 1),  # the log of the baseline is missing
        ("compare damaged.parquet run", 3),
        ("compare run run --gates nothing.toml", 4),
        ("baseline run -o OUT.parquet", 0),
    ],
)
def test_exit_codes(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, code: int
) -> None:
    monkeypatch.chdir(place)
    monkeypatch.syspath_prepend(str(place))
    done = CliRunner(env={"COLUMNS": "100"}).invoke(
        app, words.replace("OUT", str(tmp_path / "out")).split()
    )
    assert done.exit_code == code, done.output
    assert done.exception is None or isinstance(done.exception, SystemExit)
    assert "Traceback" not in done.stdout
    if code in (2, 130):
        assert "error" in done.stderr.lower() and not (tmp_path / "out" / "summary.json").exists()


def test_a_bug_has_its_own_exit_code(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def fails(*args: object) -> object:
        raise RuntimeError("two\nlines")

    monkeypatch.setattr("replan.cli.convert.listing", fails)
    monkeypatch.setattr("replan.cli.end_at_once", lambda: None)  # the tests' own signals
    monkeypatch.setattr("sys.argv", ["replan", "convert", "--formats"])
    for variable, lines in (("", 1), ("1", 5)):
        monkeypatch.setenv("REPLAN_TRACEBACK", variable)
        with pytest.raises(SystemExit) as ended:
            main()
        said = capfd.readouterr().err
        assert ended.value.code == 70 and "error: a bug in replan: RuntimeError: two lines" in said
        assert len(said.splitlines()) >= lines and ("Traceback" in said) is bool(variable)


SIGNALLED = """
import atexit, os, signal, sys

signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job inherits that it is ignored

def stop():
    os.kill(os.getpid(), {stop})

class Watch:
    def find_spec(self, name, *rest):
        if name == "{moment}":
            stop()

sys.meta_path.insert(0, Watch())
if "{moment}" == "exit":
    atexit.register(stop)
sys.argv = ["replan", "list"]
from replan.__main__ import main
main()
"""  # noqa: E501


@pytest.mark.skipif(sys.platform == "win32", reason="its signals end a process")
@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(
    ("moment", "code"), [("typer", 130), ("replan.cli.listing", 130), ("exit", 0)]
)
def test_a_signal_before_and_in_a_command_ends_it_with_130_and_after_it_changes_nothing(
    moment: str, code: int, stop: signal.Signals
) -> None:
    script = SIGNALLED.format(moment=moment, stop=int(stop))
    ended = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stderr) == (code, "error: interrupted\n" if code else "")
    assert bool(ended.stdout) is not bool(code)
