"""One run at a time writes into a result folder, whatever becomes of the others."""

import errno
import json
import os
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from command_line import evaluate, replan
from short_logs import QUICK, run

from replan.core.errors import ConfigError
from replan.results.tables import LOCK
from replan.run.output import held

HOLDER = (
    "import sys, time; from pathlib import Path; from replan.run.output import held\n"
    "with held(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
)


def refuse_locks(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    def refuse(handle: int, kind: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("fcntl.flock", refuse)


@pytest.fixture(params=["locks", pytest.param("no locks", marks=pytest.mark.slow)])
def system(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """The file system: one with locks, and one that has none."""
    if request.param == "no locks":
        refuse_locks(monkeypatch, errno.ENOSYS)
    return str(request.param)


def test_a_second_run_is_refused_and_says_who_holds_the_folder(
    logs: Path, tmp_path: Path, system: str
) -> None:
    out = tmp_path / "out"
    with held(out):
        for more in ([], ["--resume"]):
            done = evaluate(logs, "-o", out, *more)
            assert done.exit_code == 2
            assert f"process {os.getpid()} on {socket.gethostname()} since 20" in done.stderr
        assert [entry.name for entry in out.iterdir()] == [LOCK]
        vary = replan("vary", "paper/free_road", "--vary", "ego_speed=1:1:1", "-o", out)
        assert vary.exit_code == 2, vary.output
    assert not out.exists()  # it was made for the lock alone


@pytest.mark.slow
def test_a_released_lock_leaves_no_file_and_frees_the_folder(
    logs: Path, tmp_path: Path, system: str
) -> None:
    for _ in range(2):
        result = run(logs / "a.mcap", tmp_path / "out", QUICK)
        assert not (result.path / LOCK).exists()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").touch()
    with pytest.raises(ConfigError, match=r"thesis\.tex"):
        run(logs, tmp_path / "mine")
    assert [entry.name for entry in (tmp_path / "mine").iterdir()] == ["thesis.tex"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "wait", ["killed", pytest.param("of an earlier life", marks=pytest.mark.slow)]
)
def test_the_lock_of_a_dead_process_is_taken_over(tmp_path: Path, system: str, wait: str) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None and holder.stdout.readline() == "held\n"
    with pytest.raises(ConfigError, match=f"process {holder.pid} "), held(tmp_path):
        pass
    holder.send_signal(signal.SIGKILL)
    holder.communicate()
    if wait == "of an earlier life":  # its number has been given to another process since
        card = json.loads((tmp_path / LOCK).read_text())
        (tmp_path / LOCK).write_text(json.dumps({**card, "pid": os.getpid()}))
    with held(tmp_path):
        assert json.loads((tmp_path / LOCK).read_text())["pid"] == os.getpid()
    assert not any(tmp_path.iterdir())


def test_without_locks_one_of_another_machine_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse_locks(monkeypatch, errno.ENOLCK)
    card = {
        "pid": 999999999,
        "host": "elsewhere",
        "since": "2026-01-01T00:00:00+00:00",
        "started": "1",
    }
    (tmp_path / LOCK).write_text(json.dumps(card))
    with (
        pytest.raises(ConfigError, match=r"on elsewhere since 2026.*if it has ended: rm .*\.lock"),
        held(tmp_path),
    ):
        pass
    assert (tmp_path / LOCK).exists()


def test_many_at_once_one_after_the_other(tmp_path: Path) -> None:
    """Removed and made anew between two of them, it never lets in two."""
    inside: list[int] = []

    def enter(number: int) -> bool:
        for _ in range(400):
            try:
                with held(tmp_path / "out"):
                    inside.append(number)
                    time.sleep(0.001)
                    alone = inside == [number]
                    inside.remove(number)
                    return alone
            except ConfigError:
                time.sleep(0.001)
        return False

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(enter, range(24)))


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with (
        pytest.raises(ConfigError, match=r"file: cannot be the result folder"),
        held(tmp_path / "file"),
    ):
        pass
