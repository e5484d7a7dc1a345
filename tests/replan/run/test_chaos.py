"""Chaos: killed workers and runs, a full disk, damaged logs and several resumes change no byte of
the tables.
"""

import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest
from process_tree import started
from short_logs import identical, short

from replan.logs.mcap import write_scenario

SEED = 5
BLOWS = ("worker", "run", "interrupt", "disk", "worker", "run", "interrupt")
COMMAND = ("evaluate", "logs", "-p", "constant_speed", "-p", "idm", "--workers", "2")
TABLES = (
    "metrics.parquet",
    "metrics.csv",
    "verdicts.parquet",
    "groups.parquet",
    "health.parquet",
    "junit.xml",
)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform != "linux", reason="children are read from /proc"),
]


@pytest.fixture
def here(tmp_path: Path) -> Path:
    """Six logs, and three that are damaged: cut, of nothing but noise, and with a hole."""
    folder = tmp_path / "logs"
    folder.mkdir()
    for i in range(6):
        write_scenario(folder / f"{i}.mcap", short(f"test/{i}", v=8.0 + i, parked=i % 2 == 0))
    whole, rng = (folder / "3.mcap").read_bytes(), random.Random(SEED)
    (folder / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    (folder / "noise.mcap").write_bytes(rng.randbytes(5000))
    (folder / "hole.mcap").write_bytes(whole[:2000] + bytes(500) + whole[2500:])
    return tmp_path


def begun(here: Path, *words: str, room: int = resource.RLIM_INFINITY) -> subprocess.Popen[str]:
    """A run on a disk with so much room for a file."""
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
    return started(*COMMAND, *words, cwd=here, preexec_fn=limit)


def workers_of(pid: int) -> list[int]:
    """The run's worker processes."""
    with suppress(FileNotFoundError):
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        return [int(c) for c in children if "spawn_main" in Path(f"/proc/{c}/cmdline").read_text()]
    return []


def disturbed(here: Path, what: str, rng: random.Random) -> tuple[int, str]:
    """One attempt to end the run, and how it ended: exit code and errors."""
    run = begun(
        here, "--out", "out", "--resume", room=rng.randrange(500, 40_000) if what == "disk" else -1
    )
    ends = time.monotonic() + rng.uniform(0.5, 8.0)
    while what in ("worker", "run", "interrupt") and run.poll() is None and time.monotonic() < ends:
        time.sleep(0.02)
    if run.poll() is None:
        with suppress(ProcessLookupError):
            if what == "worker" and workers_of(run.pid):
                os.kill(rng.choice(workers_of(run.pid)), signal.SIGKILL)
            elif what == "run":
                os.kill(run.pid, signal.SIGKILL)
            elif what == "interrupt":
                os.kill(run.pid, rng.choice((signal.SIGINT, signal.SIGTERM)))
    _, errors = run.communicate(timeout=300)
    return run.returncode, errors


def test_whatever_is_killed_or_full_the_tables_are_those_of_an_undisturbed_run(here: Path) -> None:
    calm = begun(here, "--out", "calm")
    _, errors = calm.communicate(timeout=300)
    assert calm.returncode == 3 and errors.count("\nerror:") == 3, errors  # the three damaged logs
    rng = random.Random(SEED)
    for what in BLOWS:
        code, errors = disturbed(here, what, rng)
        assert "Traceback" not in errors, errors
        assert code in {"run": (-9, 3), "interrupt": (130, 3)}.get(what, (3,)), (what, code, errors)
        assert not list((here / "out").glob("*/.partial-*")), what
    last = begun(here, "--out", "out", "--resume")
    _, errors = last.communicate(timeout=300)
    assert last.returncode == 3, errors
    assert identical(here / "calm", here / "out")
    for name in TABLES:
        assert (here / "calm" / name).read_bytes() == (here / "out" / name).read_bytes(), name
    first, second = (
        json.loads((here / out / "summary.json").read_text()) for out in ("calm", "out")
    )
    assert first == second
    assert {entry.name for entry in (here / "calm").iterdir()} == {
        entry.name for entry in (here / "out").iterdir()
    }
