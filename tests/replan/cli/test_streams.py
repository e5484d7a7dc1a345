"""What becomes of stdout and stderr changes neither results nor exit code, and is no traceback."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="descriptors are closed by a POSIX shell"
)
REPLAN = f"{sys.executable} -P -c 'from replan.cli import main; main()'"


def shell(words: str, place: Path) -> tuple[int, str]:
    """Exit code of `replan` in a shell's words (REPLAN stands for it), and what the shell still
    prints.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    line = f"set -o pipefail; {words.replace('REPLAN', REPLAN)}"
    done = subprocess.run(
        ["bash", "-c", line],
        cwd=place,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("words", "code"),
    [
        ("list --json <&- >&- 2>&-", 0),
        ("inspect nowhere 2>&1 | true", 2),
        pytest.param("list --json >&-", 0, marks=pytest.mark.slow),
        pytest.param("list --json | true", 0, marks=pytest.mark.slow),
        pytest.param("inspect nowhere 2>&-", 2, marks=pytest.mark.slow),
    ],
)
def test_exit_codes_with_closed_streams_are_those_with_open_ones(
    words: str, code: int, tmp_path: Path
) -> None:
    found, said = shell(f"REPLAN {words}", tmp_path)
    assert found == code, said
    assert "Traceback" not in said and "BrokenPipe" not in said


@pytest.mark.slow
@pytest.mark.parametrize("closed", [">&- 2>&-", "| true"])
def test_a_run_with_closed_streams_has_its_results_and_exit_code(
    closed: str, folder: Path, tmp_path: Path
) -> None:
    run = f"REPLAN evaluate {folder}/free.mcap -p constant_speed --workers 1 --no-recording"
    (tmp_path / "fails.toml").write_text('[[gate]]\nmetric = "fallback.rate"\nmin = 1\n')
    codes = [
        shell(f"{run} --gates fails.toml -o {out} {more}", tmp_path)
        for out, more in (("a", ""), ("b", closed))
    ]
    assert codes[0][0] == codes[1][0] == 1
    assert "Traceback" not in codes[1][1]
    for name in ("metrics.csv", "junit.xml"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
@pytest.mark.parametrize("words", ["list --json", "--help", "--version"])
def test_a_full_disk_is_still_said(words: str, tmp_path: Path) -> None:
    code, said = shell(f"REPLAN {words} >/dev/full", tmp_path)
    assert code == 3
    assert said == "error: standard output: cannot be written: No space left on device\n"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
def test_an_error_that_cannot_be_said_has_its_exit_code(tmp_path: Path) -> None:
    assert shell("REPLAN inspect nowhere 2>/dev/full", tmp_path) == (2, "")


@pytest.mark.slow
def test_too_little_memory_is_said(tmp_path: Path) -> None:
    code, said = shell("ulimit -v 600000; REPLAN evaluate --suite smoke", tmp_path)
    assert code == 3, said
    assert "error: the memory is used up; " in said and "Traceback" not in said
