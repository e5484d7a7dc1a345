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
    "vary": (
        "vary logs/free.mcap -p constant_speed --workers 0 --vary ego_speed=0.9:1.1:3 -o out "
        "--resume"
    ),
    "falsify": (
        "falsify logs/blocked.mcap -p idm --workers 0 --axis ego_speed=0.9:1.1 --budget 16 "
        "-o out --resume"
    ),
    "diagnose": "diagnose run --workers 0 -o out --resume",
    "report": "report run -o out",
    "query": "query mined 'SELECT * FROM range(300000)' -o out.csv",
    "suite": "suite mined -o out.toml",
    "baseline": "baseline run -o out.parquet",
    "repair": "repair logs/free.mcap -o out.mcap --table out.csv",
}
CLOCKS = ("timings.parquet", "summary.json", ".rrd", "report.html", "report.md")
SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM)


def finished(place: Path, words: str) -> tuple[int, str]:
    """Exit code and errors.

    A command that cannot be resumed, because nothing was begun, is started anew.
    """
    run = started(*shlex.split(words), cwd=place)
    errors = run.communicate(timeout=300)[1]
    if run.returncode == 2 and "no study to resume" in errors:
        return finished(place, words.removesuffix(" --resume"))
    return run.returncode, errors


def contents(place: Path) -> dict[str, bytes]:
    """The files of the output, hidden ones too."""
    files = [
        file for out in place.glob("*out*") for file in (out, *out.rglob("*")) if file.is_file()
    ]
    kept = (file for file in files if not file.name.endswith(CLOCKS))
    return {file.relative_to(place).as_posix(): file.read_bytes() for file in kept}


def processes_of(session: int) -> list[int]:
    """Processes of a session that run."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, *fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[2]) == session and state not in "ZX":
            found.append(int(stat.parent.name))
    return found


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("killed")
    write_free_and_blocked(place / "logs")
    (place / "always.py").write_text(ALWAYS, encoding="utf-8")
    for words in (
        "evaluate logs -p constant_speed --workers 0 --no-recording -o run",
        "mine logs --workers 0 --kind always:KIND -o mined",
    ):
        assert finished(place, words)[0] in (0, 1), words
    return place


ALWAYS = (
    'import replan\n\nKIND = replan.EventKind("always", lambda log: [replan.Event(0.5, 1.5, '
    '1.0)], "Always.", "one")\n'
)


def cleared(place: Path) -> None:
    for out in place.glob("*out*"):
        shutil.rmtree(out) if out.is_dir() else out.unlink()


def strike(place: Path, words: str, rng: random.Random, whole_s: float) -> None:
    """End a command at a random time by a random signal.

    It leaves no process, and no line that speaks of a bug.
    """
    run, number = started(*shlex.split(words), cwd=place), rng.choice(SIGNALS)
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


def check(place: Path, name: str, seed: int, blows: int) -> None:
    rng, words = random.Random(f"{name} {seed}"), COMMANDS[name]
    cleared(place)
    begin = time.monotonic()
    code, _ = finished(place, words)
    whole_s, whole = time.monotonic() - begin, contents(place)
    cleared(place)
    for _ in range(blows):
        strike(place, words, rng, whole_s)
    assert finished(place, words)[0] == code
    assert contents(place) == whole
    assert not [path for path in place.rglob("*") if path.name.startswith(".")]


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_was_killed_and_run_again_gives_the_same_bytes(
    place: Path, name: str
) -> None:
    check(place, name, seed=0, blows=3)
