"""Commands that are killed or interrupted at any time, and run again: the same bytes, and nothing
is left behind.
"""

import random
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from process_tree import started
from short_logs import write_free_and_blocked

from replan.run.claim import STUDY

pytestmark = [
    pytest.mark.slow,
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform != "linux", reason="processes are read from /proc"),
]
COMMANDS = {
    "evaluate": (
        "evaluate logs -p constant_speed --workers 2 --no-recording --no-report -o out --resume"
    ),
    "mine": "mine logs --workers 2 -o out --resume",
    "cut": "cut mined --where true --before 0.5 --after 0.5 -o out --resume",
    "vary": "vary logs/free.mcap -p constant_speed --workers 0 --vary ego_speed=0.9:1.1:3 -o out",
    "falsify": (
        "falsify logs/blocked.mcap -p idm --workers 0 --axis ego_speed=0.9:1.1 --budget 16 -o out"
    ),
    "diagnose": "diagnose run --workers 0 -o out",
    "report": "report run -o out",
    "query": "query mined 'SELECT * FROM range(300000)' -o out.csv",
    "suite": "suite mined -o out.toml",
    "baseline": "baseline run -o out.parquet",
    "repair": "repair logs/free.mcap -o out.mcap --table out.csv",
}
WITH_TIMES = ("timings.parquet", "summary.json", ".rrd", "report.html", "report.md")
"""Endings of files that state when or how long something ran; they differ from run to run."""
SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM)


ALWAYS = """\
import replan

KIND = replan.EventKind("always", lambda log: [replan.Event(0.5, 1.5, 1.0)], "Always.", "one")
"""
"""A kind of events of which each log has one."""
STRIKES = 3


def begun(place: Path, words: str) -> subprocess.Popen[str]:
    """A command that runs; a study that has begun is resumed."""
    resumes = ["--resume"] if (place / "out" / STUDY).is_file() else []
    return started(*shlex.split(words), *resumes, cwd=place)


def exit_code(place: Path, words: str) -> int:
    """Run a command to its end."""
    run = begun(place, words)
    run.communicate(timeout=300)
    return run.returncode


def contents(place: Path) -> dict[str, bytes]:
    """The files of the output, hidden ones too."""
    files = [
        file for out in place.glob("*out*") for file in (out, *out.rglob("*")) if file.is_file()
    ]
    return {
        file.relative_to(place).as_posix(): file.read_bytes()
        for file in files
        if not file.name.endswith(WITH_TIMES)
    }


def processes_of(session: int) -> list[int]:
    """Processes of a session that run."""
    running = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session_of, *_ = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(session_of) == session and state not in "ZX":
            running.append(int(stat.parent.name))
    return running


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("killed")
    write_free_and_blocked(place / "logs")
    (place / "always.py").write_text(ALWAYS, encoding="utf-8")
    for words in (
        "evaluate logs -p constant_speed --workers 0 --no-recording -o run",
        "mine logs --workers 0 --kind always:KIND -o mined",
    ):
        assert exit_code(place, words) in (0, 1), words
    return place


def clear(place: Path) -> None:
    for out in place.glob("*out*"):
        shutil.rmtree(out) if out.is_dir() else out.unlink()


def strike(place: Path, words: str, rng: random.Random, whole_s: float) -> None:
    """End a command at a random time by a random signal.

    It leaves no process, and does not end by an error of replan's own (70).
    """
    run, number = begun(place, words), rng.choice(SIGNALS)
    try:
        run.wait(rng.uniform(0.3, whole_s))
    except subprocess.TimeoutExpired:
        run.send_signal(number)
    errors = run.communicate(timeout=60)[1]
    assert run.returncode in (-signal.SIGKILL, 0, 1, 2, 3, 4, 130), errors
    for _ in range(50):
        if not processes_of(run.pid):
            break
        time.sleep(0.1)
    assert not processes_of(run.pid)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_was_killed_and_run_again_gives_the_same_bytes(
    place: Path, name: str
) -> None:
    rng, words = random.Random(name), COMMANDS[name]
    clear(place)
    begin = time.monotonic()
    code = exit_code(place, words)
    whole_s, whole = time.monotonic() - begin, contents(place)
    clear(place)
    for _ in range(STRIKES):
        strike(place, words, rng, whole_s)
    assert exit_code(place, words) == code
    assert contents(place) == whole
    assert not [path for path in place.rglob("*") if path.name.startswith(".")]
