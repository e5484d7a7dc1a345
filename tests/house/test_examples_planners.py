"""The examples of planners that are programs: over stdin and stdout, over TCP, in Python and in
C++.
"""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from replan.core.errors import PlannerError
from replan.logs.catalogue import CATALOGUE
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS
from replan.logs.trace import EndReason, Trace
from replan.replay.loop.closed_loop import run_closed_loop
from replan.run.one_log import LOOPS

EXAMPLES = Path(__file__).parents[2] / "examples"
PYTHON = f"exec:{sys.executable} {EXAMPLES / 'planner_exec.py'}"


@pytest.fixture(scope="module")
def log() -> Scenario:
    return CATALOGUE["paper/static_obstacles"].scenario()


def assert_same(one: Trace, two: Trace, within: float = 0.0) -> None:
    assert (one.end, one.detail, len(one.frames)) == (two.end, two.detail, len(two.frames))
    for a, b in zip(one.frames, two.frames, strict=True):
        for name in TRAJECTORY_COLUMNS:
            mine, other = getattr(a.plan.trajectory, name), getattr(b.plan.trajectory, name)
            np.testing.assert_allclose(mine, other, rtol=0.0, atol=within)


@pytest.fixture(scope="module")
def node() -> Iterator[str]:
    """The address of a node that runs already."""
    command = [sys.executable, EXAMPLES / "planner_exec.py", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        yield f"tcp://127.0.0.1:{process.stderr.readline().split()[1]}"
        process.kill()


@pytest.mark.slow
def test_a_program_and_a_node_drive_as_any_planner(log: Scenario, node: str) -> None:
    for run in LOOPS.values():
        program, reached = run(log, PYTHON).trace, run(log, node).trace
        assert program.end is not EndReason.PLANNER_FAILURE, program.detail
        assert min(frame.plan.trajectory.a.min() for frame in program.frames) < -0.5, (
            "it brakes for who is ahead"
        )
        assert_same(program, reached)


def test_the_error_shows_the_last_lines_of_a_program(tmp_path: Path, log: Scenario) -> None:
    script = tmp_path / "bad.sh"
    script.write_text(
        "#!/bin/sh\nprintf 'no model\\033[2J found\\n' >&2\nexit 4\n", encoding="utf-8"
    )
    script.chmod(0o755)
    with pytest.raises(
        PlannerError,
        match=r"while it was built: its process ended with code 4; it printed last: no model",
    ):
        run_closed_loop(log, f"exec:{script}")
    script.write_text(
        "#!/bin/sh\necho 'INFO: listening to replan and talking back'\ncat\n", encoding="utf-8"
    )
    with pytest.raises(PlannerError, match="sent an invalid message while it was built"):
        run_closed_loop(log, f"exec:{script}")


@pytest.mark.slow
def test_the_planner_in_cpp_is_built_and_drives_as_that_in_python(
    tmp_path: Path, log: Scenario
) -> None:
    if shutil.which("cmake") is None or shutil.which("c++") is None:
        pytest.skip("no cmake or no C++ compiler")
    build = ["cmake", "-S", str(EXAMPLES / "planner_cpp"), "-B", str(tmp_path)]
    configured = subprocess.run(build, capture_output=True, text=True)
    if "nlohmann_json" in configured.stderr:
        pytest.skip(
            "nlohmann_json is not installed (Debian: nlohmann-json3-dev, or set CMAKE_PREFIX_PATH)"
        )
    assert configured.returncode == 0, configured.stderr
    built = subprocess.run(["cmake", "--build", str(tmp_path)], capture_output=True, text=True)
    assert built.returncode == 0 and "warning" not in built.stdout + built.stderr, (
        built.stdout + built.stderr
    )
    for run in LOOPS.values():
        cpp, python = run(log, f"exec:{tmp_path / 'planner'}").trace, run(log, PYTHON).trace
        assert cpp.end is not EndReason.PLANNER_FAILURE, cpp.detail
        assert_same(cpp, python, within=1e-9)
